"""The shortest way from New York to London on a sphere: a geodesic, by its energy functional in two angles.

The straight line of the map is near enough for CasADi's own rootfinder, whose steps need only
make the residual smaller.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

RADIUS = 6371.0  # km, the Earth's mean radius
NEW_YORK = np.radians([40.6413, -73.7781])  # latitude, longitude
LONDON = np.radians([51.47, -0.4543])


def lagrangian(t, x, v):
    """Half the squared speed on the unit sphere; x holds latitude and longitude."""
    return (v[0] ** 2 + ca.cos(x[0]) ** 2 * v[1] ** 2) / 2


def main():
    """Solve on the unit of time, so that the constant speed is the length of the arc."""
    problem = cg.BoundaryProblem(lagrangian, (0.0, 1.0), NEW_YORK, LONDON)
    return cg.solve(problem, cg.Galerkin(degree=8), intervals=8, solver=cg.rootfinder)


def arc(path):
    """Length of the path in radians: its speed is constant, and S = arc²/2."""
    return np.sqrt(2 * path.action)


def haversine():
    """The same by the haversine formula."""
    (latitude, longitude), (other, east) = NEW_YORK, LONDON
    chord = np.sin((other - latitude) / 2) ** 2
    chord += np.cos(latitude) * np.cos(other) * np.sin((east - longitude) / 2) ** 2
    return 2 * np.arcsin(np.sqrt(chord))


def seen(x):
    """Where latitudes and longitudes (2, K) are seen from far above 25° N, 40° W; NaN on the far side."""
    (north, east), (up, over) = x, np.radians([25.0, -40.0])
    right = np.cos(north) * np.sin(east - over)
    above = np.cos(up) * np.sin(north) - np.sin(up) * np.cos(north) * np.cos(east - over)
    near = np.sin(up) * np.sin(north) + np.cos(up) * np.cos(north) * np.cos(east - over)
    return np.where(near > 0, [right, above], np.nan)


def draw(path):
    """Draw the sphere from above the middle of the path, and the straight line of the map; returns the figure."""
    axes = cg.panels(size=(4.6, 4.4))
    north, east = np.meshgrid(np.radians(np.arange(-90, 91, 2)), np.radians(np.arange(-180, 181, 2)), indexing="ij")
    for line in (*np.stack((north, east), 1)[::10], *np.stack((north, east), 2).transpose(1, 2, 0)[::10]):
        axes.plot(*seen(line), color="0.85", linewidth=0.8)
    times = np.linspace(0, 1, 200)
    axes.plot(*seen(path(times)), label=f"great circle, {RADIUS * arc(path):.0f} km")
    axes.plot(*seen(path.x), ".", color=axes.lines[-1].get_color())
    straight = NEW_YORK[:, None] + (LONDON - NEW_YORK)[:, None] * times
    axes.plot(*seen(straight), "--", label="straight on the map")
    for name, place, side in (("New York", NEW_YORK, "right"), ("London", LONDON, "left")):
        axes.annotate(name, seen(place[:, None])[:, 0], xytext=(0, -14), textcoords="offset points", ha=side)
    axes.set(title="New York to London", aspect="equal")
    axes.axis("off")
    axes.legend(fontsize="small", loc="lower center")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    print(f"  length      {arc(answer):.15f} rad, exact {haversine():.15f}; {RADIUS * arc(answer):.3f} km")
    draw(answer).savefig("great_circle.png")
