"""Trajectory optimization here, with IPOPT and with fatrop, against the same problems by hand in CasADi.

The rivals are what CasADi's own example shows: Gauss-Legendre collocation of the first-order system, one loop over the
intervals, collocated states of an interval as one matrix.  "By hand" gives it to `casadi.nlpsol`, "Opti" to
`casadi.Opti`, both to IPOPT and expanded.  All use the same degree and the same guess; each gets the fewest intervals
with which its cost is within the target of the reference.  Times are CPU times, medians over repeated runs in one
process in which all take turns: of a solve on what was built, and of building and solving.
"""

import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np

import casadi_galerkin as cg
from casadi_galerkin.calculus.nodes import differentiation_matrix, lagrange_values

sys.path.insert(0, str(Path(__file__).parents[1]))

import cart_pole
import literature
import low_thrust
import moon_landing
import two_link_arm

TARGET = 1e-6
REPEATS = 15
SWING = 2.5  # s, for the acrobot
INTERVALS = (2, 3, 4, 6, 8, 9, 10, 12, 15, 18, 20, 24, 30, 40, 50, 60, 80, 100)
QUIET = {"print_time": False, "expand": True, "ipopt": {"print_level": 0, "sb": "yes"}}


def pole_rates(x, v, u):
    """Accelerations of cart and pole, solved for by hand."""
    m, length, gravity = cart_pole.POLE, cart_pole.LENGTH, cart_pole.GRAVITY
    s, c, total = ca.sin(x[1]), ca.cos(x[1]), cart_pole.CART + m
    push = u[0] + m * length * s * v[1] ** 2
    below = total - m * c**2
    return [(push + m * gravity * s * c) / below, -(push * c + total * gravity * s) / (length * below)]


def arm_rates(x, v, u):
    """Accelerations of both rods, from their 2 by 2 mass matrix."""
    s, c, g = ca.sin(x[0] - x[1]), ca.cos(x[0] - x[1]) / 2, two_link_arm.GRAVITY
    shoulder, elbow = (u[0], u[1]) if u.numel() == 2 else (0, u[0])
    first = shoulder - elbow - s * v[1] ** 2 / 2 - 1.5 * g * ca.sin(x[0])
    second = elbow + s * v[0] ** 2 / 2 - 0.5 * g * ca.sin(x[1])
    below = 4 / 9 - c**2
    return [(first / 3 - c * second) / below, (4 / 3 * second - c * first) / below]


def orbit_rates(x, v, u):
    """Radial and angular acceleration."""
    return [x[0] * v[1] ** 2 - 1 / x[0] ** 2 + u[0], (u[1] - 2 * v[0] * v[1]) / x[0]]


def free_rates(x, v, u):
    """Acceleration of a free unit mass."""
    return [u[0]]


def rocket_rates(x, v, u):
    """Loss of mass, and acceleration."""
    return [-u[0] / moon_landing.EXHAUST, u[0] / x[1] - moon_landing.GRAVITY]


def acrobot():
    """The two-link arm with a motor in its elbow only."""
    return replace(
        two_link_arm.problem(),
        t_span=(0.0, SWING),
        force=lambda t, x, v, u: [-u[0], u[0]],
        running_cost=lambda t, x, v, u: u[0] ** 2 / 2,
        controls=1,
        control_bounds=(-100.0, 100.0),
    )


def swinging(t):
    """Back first, the forearm twice as far: from a straight line every way finds another optimum, or none."""
    part, back = np.pi * t / SWING, np.sin(2 * np.pi * t / SWING)
    return [part - 1.5 * back, part - 3.0 * back]


def crane():
    """The cart carries its pole, hanging, a meter further, and is to swing it little."""
    return replace(cart_pole.problem(), end=[1.0, 0.0], running_cost=lambda t, x, v, u: u[0] ** 2 + 100 * x[1] ** 2)


def rocket():
    """The landing on the Moon as one phase, whose thrust may jump anywhere."""
    return moon_landing.problem(breakpoints=(), hold=False, duration_bounds=(0.5, 4.0))


# name -> problem, rates and accelerations, degree, guess, known cost
PROBLEMS = {
    "cart-pole": (cart_pole.problem, pole_rates, 4, None, None),
    "orbit raising": (low_thrust.problem, orbit_rates, 5, low_thrust.guess, None),
    "double integrator": (literature.mass, free_rates, 3, None, 6.0),
    "Bryson-Denham": (lambda: literature.bryson_denham().problem, free_rates, 3, None, 4.0),
    "two-link arm": (two_link_arm.problem, arm_rates, 4, None, None),
    "acrobot": (acrobot, arm_rates, 5, swinging, None),
    "crane": (crane, pole_rates, 4, None, None),
    "rocket": (rocket, rocket_rates, 4, None, 1.4203125990491976),
}


def here(solver):
    """A way that builds with this package, to solve often with one of its solvers."""

    def build(name, intervals):
        make, _, degree, guess, _ = PROBLEMS[name]
        program = cg.transcribe(make(), cg.Galerkin(degree), intervals)
        return lambda: program.solve(guess=guess, solver=solver).cost

    return build


def once(way, name, intervals):
    """Build and solve once."""
    make, _, degree, guess, _ = PROBLEMS[name]
    if way in SOLVERS:
        return cg.solve(make(), cg.Galerkin(degree), intervals, guess=guess, solver=SOLVERS[way]).cost
    return WAYS[way](name, intervals)()


class Collocation:
    """Variables, equations and bounds of the same problem by hand; states are positions, then velocities."""

    def __init__(self, name, intervals, variable):
        make, rates, degree, guess, _ = PROBLEMS[name]
        problem = make()
        self.variable, self.unknowns, self.bounds, self.guess = variable, [], [], []
        self.equations, self.cost = [], 0
        d, n, count = problem.dimension, problem.controls, problem.dimension + problem.mechanical
        states, u = ca.MX.sym("states", count), ca.MX.sym("u", n)
        x, v = ca.vertsplit(states, [0, d, count])
        slopes = ca.vertcat(v, *rates(x, v, u))
        f = ca.Function(
            "f", [states, u], [slopes, problem.running_cost(0, x, ca.vertcat(v, np.zeros(d - v.numel())), u)]
        )
        points, weights = (np.array(a) for a in (cg.gauss(degree).points, cg.gauss(degree).weights))
        nodes = np.append(0.0, points)
        slope, last = differentiation_matrix(nodes)[1:].T, lagrange_values(nodes, np.array([1.0]))[0]
        guessed, free = states_guess(problem, guess), np.full(problem.mechanical, np.inf)
        low, high = (np.append(side, sign * free) for side, sign in zip(problem.position_bounds, (-1, 1), strict=True))
        span = problem.t_span[1] - problem.t_span[0]
        if problem.duration_bounds is not None:
            span = self.new(1, 1, *problem.duration_bounds, span)
        h = span / intervals
        now = self.new(count, 1, *self.given(problem, "start", low, high), guessed(0.0))
        for i in range(intervals):
            inside = np.stack([guessed((i + c) / intervals) for c in points], axis=1)
            inner = self.new(count, degree, low, high, inside)
            controls = self.new(n, degree, *problem.control_bounds, np.zeros((n, degree)))
            ends = self.given(problem, "end", low, high) if i == intervals - 1 else (low, high)
            after = self.new(count, 1, *ends, guessed((i + 1) / intervals))
            rate, running = f(inner, controls)
            everything = ca.horzcat(now, inner)
            self.equations += [ca.mtimes(everything, slope) - h * rate, after - ca.mtimes(everything, last)]
            self.cost, now = self.cost + h * ca.mtimes(running, weights), after

    def new(self, rows, columns, low, high, guess):
        """New variables with their bounds and their guess."""
        fresh = self.variable(rows, columns)
        self.unknowns.append(fresh)
        self.bounds.append([np.broadcast_to(np.reshape(side, (-1, 1)), (rows, columns)) for side in (low, high)])
        self.guess.append(np.reshape(guess, (rows, columns)))
        return fresh

    @staticmethod
    def given(problem, end, low, high):
        """Bounds at an end, which meet where a state is given."""
        values = [*getattr(problem, end), *getattr(problem, f"{end}_velocity")[: problem.mechanical]]
        return [[a if b is None else b for a, b in zip(side, values, strict=True)] for side in (low, high)]


def states_guess(problem, guess):
    """The guess this package starts from, as states at a fraction of the duration."""
    begin, duration = problem.t_span[0], problem.t_span[1] - problem.t_span[0]
    start, end = (np.array(side, dtype=float) for side in (problem.start, problem.end))
    end, dm = np.where(np.isnan(end), start, end), problem.mechanical
    path = guess or (lambda t: start + (t - begin) / duration * (end - start))

    def states(part):
        t, step = begin + part * duration, 1e-4 * duration
        slope = (np.array(path(t + step)) - np.array(path(t - step))) / (2 * step)
        return np.append(path(t), slope[:dm])

    return states


def by_hand(name, intervals):
    """Build with `casadi.nlpsol`."""
    stated = Collocation(name, intervals, lambda *shape: ca.MX.sym("w", *shape))
    x, g = (ca.vertcat(*map(ca.vec, parts)) for parts in (stated.unknowns, stated.equations))
    solver = ca.nlpsol("by_hand", "ipopt", {"x": x, "f": stated.cost, "g": g}, QUIET)
    low, high = (np.concatenate([b[k].ravel("F") for b in stated.bounds]) for k in (0, 1))
    first = np.concatenate([guess.ravel("F") for guess in stated.guess])

    def solve():
        answer = solver(x0=first, lbx=low, ubx=high, lbg=0, ubg=0)
        if not solver.stats()["success"]:
            raise RuntimeError("Solver failed")
        return float(answer["f"])

    return solve


def with_opti(name, intervals):
    """Build with `casadi.Opti`."""
    opti = ca.Opti()
    stated = Collocation(name, intervals, opti.variable)
    for fresh, (low, high), guess in zip(stated.unknowns, stated.bounds, stated.guess, strict=True):
        opti.set_initial(fresh, guess)
        for i, j in np.ndindex(*low.shape):
            if low[i, j] == high[i, j]:
                opti.subject_to(fresh[i, j] == low[i, j])
            elif np.isfinite([low[i, j], high[i, j]]).any():
                opti.subject_to(opti.bounded(low[i, j], fresh[i, j], high[i, j]))
    for equations in stated.equations:
        opti.subject_to(ca.vec(equations) == 0)
    opti.minimize(stated.cost)
    opti.solver("ipopt", {name: value for name, value in QUIET.items() if name != "ipopt"}, QUIET["ipopt"])
    return lambda: float(opti.solve().value(stated.cost))


SOLVERS = {"IPOPT": cg.ipopt, "fatrop": cg.fatrop}
WAYS = {**{way: here(solver) for way, solver in SOLVERS.items()}, "by hand": by_hand, "Opti": with_opti}


def reference_cost(name):
    """The exact cost, or that of a much finer solution."""
    make, _, _, guess, known = PROBLEMS[name]
    if known is not None:
        return known
    return cg.solve(make(), cg.Galerkin(degree=8), intervals=60, guess=guess).cost


def fewest(build, name, reference):
    """Fewest intervals with which the cost is within the target, and its relative error."""
    for intervals in INTERVALS:
        try:
            cost = build(name, intervals)()
        except (cg.ConvergenceError, ValueError):
            continue
        except RuntimeError as error:
            if "Solver failed" not in str(error) and "solver failed" not in str(error):
                raise
            continue
        error = abs(cost / reference - 1)
        if error <= TARGET:
            return intervals, error
    return None, np.inf


def medians(name, counts):
    """Median times of solving on what was built and of building and solving, in ms, for every way that solves it."""
    solved, both = ({way: [] for way in counts} for _ in range(2))
    programs = {way: WAYS[way](name, count) for way, count in counts.items()}
    for _ in range(REPEATS):
        for way, count in counts.items():
            began = time.process_time()
            programs[way]()
            between = time.process_time()
            once(way, name, count)
            solved[way].append(between - began)
            both[way].append(time.process_time() - between)
    return [{way: 1e3 * statistics.median(times) for way, times in all_.items()} for all_ in (solved, both)]


def main(names=tuple(PROBLEMS)):
    """Print the tables; returns ratios of times: by hand over IPOPT and fatrop here, Opti over building with IPOPT."""
    print(f"relative error of the cost at most {TARGET}; CPU times in ms, medians of {REPEATS}")
    print(f"{'':18s}" + "".join(f"{way:>30s}" for way in WAYS))
    print(f"{'problem':18s}" + f"{'intervals  solve  build+solve':>30s}" * len(WAYS))
    ratios = {"IPOPT": {}, "fatrop": {}, "built with IPOPT": {}}
    for name in names:
        reference = reference_cost(name)
        counts = {way: fewest(build, name, reference)[0] for way, build in WAYS.items()}
        solved, both = medians(name, {way: count for way, count in counts.items() if count})
        cells = [
            f"{counts[way]:13d} {solved[way]:7.2f} {both[way]:8.1f}" if counts[way] else f"{'fails':>30s}"
            for way in WAYS
        ]
        print(f"{name:18s}" + "".join(cells), flush=True)
        for way in ("IPOPT", "fatrop"):
            if counts[way] and counts["by hand"]:
                ratios[way][name] = solved["by hand"] / solved[way]
        if counts["Opti"] and counts["IPOPT"]:
            ratios["built with IPOPT"][name] = both["Opti"] / both["IPOPT"]
    for what, found in ratios.items():
        rival = "Opti, built and solved" if what == "built with IPOPT" else "by hand, solved"
        values = ", ".join(f"{name} {ratio:.1f}" for name, ratio in found.items())
        print(f"{rival}, over {what} here: median {statistics.median(found.values()):.1f} ({values})")
    return ratios


if __name__ == "__main__":
    main()
