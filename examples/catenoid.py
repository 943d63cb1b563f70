"""A soap film between two rings of radius 1, near the distance at which it tears.

Two catenoids x = c cosh(t/c) with c cosh(h/c) = 1 span the rings at t = -h and h; the wide one is stable, the narrow
one is not.  At h = 0.66274 they become one, and beyond there is none.  Either area is π c (2 h + c sinh(2 h/c)); two
discs of radius 1 have less, 2π, so the wide film is a local minimum only.

IPOPT finds both: minimizing the area it finds the wide film, and solving the stationarity conditions the narrow one,
which is a saddle that no minimizer holds on to.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

HALF_DISTANCE = 0.66  # in units of the rings' radius


def lagrangian(t, x, v):
    """Area per length and 2π of the surface of revolution with radius x."""
    return x[0] * ca.sqrt(1 + v[0] ** 2)


def sagging(depth):
    """Guess: a parabola that leaves radius 1 - depth in the middle."""
    return lambda t: [1 - depth * (1 - (t / HALF_DISTANCE) ** 2)]


def main():
    """Solve from a wide and a narrow guess; returns the two films."""
    problem = cg.BoundaryProblem(lagrangian, (-HALF_DISTANCE, HALF_DISTANCE), start=[1.0], end=[1.0])
    film = cg.transcribe(problem, cg.Galerkin(degree=8), intervals=16)
    return [
        film.solve(guess=sagging(0.3), solver=cg.minimizer),
        film.solve(guess=sagging(0.6), solver=cg.ipopt),
    ]


def draw(films):
    """Draw both films, mirrored at the axis; returns the figure."""
    axes = cg.panels(size=(4.6, 3.8))
    axes.set(title="Two soap films between the same rings", aspect="equal")
    axes.set(xlabel="place on the axis, in radii", ylabel="radius, in radii of the rings")
    times = np.linspace(-HALF_DISTANCE, HALF_DISTANCE, 200)
    for film in films:
        radius = film(times)[0]
        label = f"area {2 * np.pi * film.action:.4f}\nMorse index {film.morse_index}"
        (line,) = axes.plot(times, radius, label=label)
        axes.plot(times, -radius, color=line.get_color())
    for end in (-HALF_DISTANCE, HALF_DISTANCE):
        axes.plot([end, end], [-1, 1], color="0.7", zorder=0)
    axes.legend(fontsize="small", loc="center")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    for film in answer:
        c = film(0.0)[0]
        print(f"narrowest radius c = {c:.12f}, c cosh(h/c) = {c * np.cosh(HALF_DISTANCE / c):.12f}, exact 1")
        exact = np.pi * c * (2 * HALF_DISTANCE + c * np.sinh(2 * HALF_DISTANCE / c))
        print(f"area {2 * np.pi * film.action:.12f}, of the catenoid of this c {exact:.12f}\n{film}")
    draw(answer).savefig("catenoid.png")
