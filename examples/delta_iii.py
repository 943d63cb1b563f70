"""A Delta III rocket carries the most mass into a transfer orbit: four phases, of which each has its own engines.

Six boosters burn with the first stage and are dropped, three more burn and are dropped, then the first stage burns
alone, and at last the second one, for a time that is free.  A link drops what is empty.  Units: the radius of the
Earth, the speed of a circular orbit on the ground, the mass at liftoff.

Data and 7529.7123 kg: J. T. Betts, Practical Methods for Optimal Control (2010), section 6.15; M. A. Patterson and
A. V. Rao, ACM Trans. Math. Software 41 (2014), 1.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

LENGTH, MASS, SPEED = 6378145.0, 301454.0, np.sqrt(3.986012e14 / 6378145.0)
TIME, HEIGHT, PUBLISHED = LENGTH / SPEED, 7200.0 / LENGTH, 7529.7123  # that of the air, and the mass that arrives
SPIN, DRAG = ca.DM([0, 0, 7.29211585e-5 * TIME]), 0.5 * 1.225 * 0.5 * 4 * np.pi * LENGTH / MASS
BOOSTER, FIRST, SECOND = (
    np.array([628500, 17010 / 75.2]),
    np.array([1083100, 95550 / 261]),
    np.array([110094, 16820 / 700]),
)
ENGINES = [6 * BOOSTER + FIRST, 3 * BOOSTER + FIRST, FIRST, SECOND]  # thrust, and flow of mass
EMPTY, BEGINS = np.array([6 * 2280, 3 * 2280, 8830]) / MASS, np.array([0, 75.2, 150.4, 261, 961]) / TIME
AXIS, SHAPE, (TILT, NODE, PERIGEE) = 24361140 / LENGTH, 0.7308, np.radians([28.5, 269.8, 130.5])  # of the orbit
TO_NODE = np.array([np.cos(NODE), np.sin(NODE), 0])
NORMAL = np.array([np.sin(TILT) * np.sin(NODE), -np.sin(TILT) * np.cos(NODE), np.cos(TILT)])
TO_PERIGEE = np.cos(PERIGEE) * TO_NODE + np.sin(PERIGEE) * np.cross(NORMAL, TO_NODE)
LAUNCH = np.array([np.cos(TILT), 0, np.sin(TILT)])


def miss(x0, v0, x1, v1):
    """Angular momentum, and place of the perigee, less those of the orbit."""
    spin = ca.cross(x1[:3], v1[:3])
    perigee = ca.cross(v1[:3], spin) - x1[:3] / ca.norm_2(x1[:3])
    return [spin - AXIS**0.5 * (1 - SHAPE**2) ** 0.5 * NORMAL, (perigee - SHAPE * TO_PERIGEE)[:2]]


def phase(k, **stated):
    """State x = (place, mass), and the direction u of the thrust."""
    thrust, flow = ENGINES[k] * [LENGTH / SPEED**2 / MASS, TIME / MASS]

    def force(t, x, v, u):
        wind = v[:3] - ca.cross(SPIN, x[:3])
        return (thrust * u - DRAG * ca.exp((1 - ca.norm_2(x[:3])) / HEIGHT) * ca.norm_2(wind) * wind) / x[3]

    return cg.ControlProblem(
        lambda t, x, v: ca.dot(v[:3], v[:3]) / 2 + 1 / ca.norm_2(x[:3]),
        BEGINS[k : k + 2],
        force=force,
        rates=lambda t, x, v, u: -flow,
        path_constraint=(lambda t, x, v, u: ca.dot(u, u), 1, 1),
        **{"controls": 3, "components": 4, **stated},
    )


def guess(t):
    """Up and round the Earth to the perigee."""
    place = LAUNCH + (t / BEGINS[-1]) ** 2 * (TO_PERIGEE - LAUNCH)
    return [*(1 + 0.03 * t) * place / np.linalg.norm(place), np.interp(t, BEGINS, [1, 0.6, 0.4, 0.1, 0.03])]


def main():
    """Link the phases, and solve with some intervals for each."""
    spin = [0, float(SPIN[2]) * LAUNCH[0], 0, None]
    first, second, third = phase(0, start=[*LAUNCH, 1], start_velocity=spin), phase(1), phase(2)
    heavy = {"terminal_cost": lambda t, x, v: -x[3], "duration_bounds": (0.1, 700 / TIME)}
    links = [lambda x, v, empty=empty: ([x[:3], x[3] - empty], v) for empty in EMPTY]
    phases = cg.Phases([first, second, third, phase(3, end_conditions=(miss, 0, 0), **heavy)], links)
    return cg.solve(phases, cg.Galerkin(degree=4), [5, 4, 5, 8], guess=(guess, lambda t: [0.6, 0.8, 0]))


def draw(path):
    """Draw height and mass over time, dots where phases begin; returns the figure."""
    left, right = cg.panels(columns=2, size=(8, 3.2))
    for times, style in ((np.linspace(*path.t[[0, -1]], 400), "-"), (np.array(path.problem.breakpoints), "o")):
        *place, mass = path(times)
        left.plot(TIME * times, LENGTH / 1000 * (np.linalg.norm(place, axis=0) - 1), style)
        right.semilogy(TIME * times, MASS / 1000 * mass, style)
    left.set(xlabel="time in s", ylabel="height in km", title="A new phase at every dot")
    right.set(xlabel="time in s", ylabel="mass in t", title=f"{-MASS * path.cost:.3f} kg arrive")
    return left.figure


if __name__ == "__main__":
    answer = main()
    print(answer, f"{-MASS * answer.cost:.4f} kg arrive after {TIME * answer.t[-1]:.2f} s", sep="\n  ")
    draw(answer).savefig("delta_iii.png")
