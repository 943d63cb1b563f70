"""Trajectory optimisation against the same problems written by hand in casadi.Opti, at equal cost error.

The rival is what CasADi's own example shows: Gauss-Legendre collocation of the first-order system, one loop over the
intervals, collocated states of an interval as one matrix.  Both use the same degree and IPOPT; each gets the
fewest intervals with which its cost is within the target of the reference.  Times are of building and solving together,
medians over repeated runs in one process.
"""

import statistics
import sys
import time
from pathlib import Path

import casadi as ca
import numpy as np

import casadi_galerkin as cg
from casadi_galerkin.calculus.nodes import differentiation_matrix, lagrange_values

sys.path.insert(0, str(Path(__file__).parents[1]))

import cart_pole
import low_thrust
import minimum_time
import obstacle
import two_link_arm

TARGET = 1e-6
REPEATS = 15
INTERVALS = (2, 4, 6, 8, 10, 12, 16, 20, 24, 30, 40, 50, 60)


def cart_pole_rates(x, v, u):
    """Accelerations of cart and pole, solved for by hand."""
    m, length, gravity = cart_pole.POLE, cart_pole.LENGTH, cart_pole.GRAVITY
    s, c, total = ca.sin(x[1]), ca.cos(x[1]), cart_pole.CART + m
    push = u[0] + m * length * s * v[1] ** 2
    below = total - m * c**2
    return [(push + m * gravity * s * c) / below, -(push * c + total * gravity * s) / (length * below)]


def arm_rates(x, v, u):
    """Accelerations of both rods, from their 2 by 2 mass matrix."""
    s, c, g = ca.sin(x[0] - x[1]), ca.cos(x[0] - x[1]) / 2, two_link_arm.GRAVITY
    first = u[0] - u[1] - s * v[1] ** 2 / 2 - 1.5 * g * ca.sin(x[0])
    second = u[1] + s * v[0] ** 2 / 2 - 0.5 * g * ca.sin(x[1])
    below = 4 / 9 - c**2
    return [(first / 3 - c * second) / below, (4 / 3 * second - c * first) / below]


def orbit_rates(x, v, u):
    """Radial and angular acceleration."""
    return [x[0] * v[1] ** 2 - 1 / x[0] ** 2 + u[0], (u[1] - 2 * v[0] * v[1]) / x[0]]


def free_rates(x, v, u):
    """Accelerations of a free unit mass."""
    return [u[i] for i in range(x.numel())]


# scene -> accelerations, degree, quadrature of ours, guess, exact cost, fewest intervals worth measuring.
# The two exact ones are exact on any even number of intervals; both solvers then use the scene's own mesh.
SCENES = {
    "cart_pole": (cart_pole, cart_pole_rates, 4, cg.gauss(4), None, None, 2),
    "minimum_time": (minimum_time, free_rates, 2, cg.gauss(2), None, 2.0, 10),
    "two_link_arm": (two_link_arm, arm_rates, 4, cg.gauss(4), None, None, 2),
    "low_thrust": (low_thrust, orbit_rates, 5, cg.gauss(5), low_thrust.guess, None, 2),
    "obstacle": (obstacle, free_rates, 4, cg.lobatto(5), None, obstacle.EXACT, 20),
}


def ours(scene, intervals):
    """Build and solve with this package: cost and number of unknowns."""
    module, _, degree, quadrature, guess, *_ = SCENES[scene]
    program = cg.transcribe(module.problem(), cg.Galerkin(degree, quadrature=quadrature), intervals)
    return program.solve(guess=guess).cost, program.numbering.unknowns


def by_hand(scene, intervals):
    """Build and solve with casadi.Opti: cost and number of unknowns."""
    module, rates, degree, _, guess, *_ = SCENES[scene]
    problem = module.problem()
    opti, d, n = ca.Opti(), problem.dimension, problem.controls
    states, u = ca.MX.sym("states", 2 * d), ca.MX.sym("u", n)
    x, v = states[:d], states[d:]
    slopes = ca.vertcat(v, *rates(x, v, u))
    f = ca.Function("f", [states, u], [slopes, problem.running_cost(0, x, v, u)])
    points, weights = (np.array(a) for a in (cg.gauss(degree).points, cg.gauss(degree).weights))
    nodes = np.append(0.0, points)
    slope, last = differentiation_matrix(nodes)[1:].T, lagrange_values(nodes, np.array([1.0]))[0]
    guessed = states_guess(problem, guess)
    span = free_duration(opti, problem)
    h, cost, now = span / intervals, 0, opti.variable(2 * d)
    opti.set_initial(now, guessed(0.0))
    fix(opti, now, problem.start, problem.start_velocity)
    for i in range(intervals):
        inner, controls, after = opti.variable(2 * d, degree), opti.variable(n, degree), opti.variable(2 * d)
        opti.set_initial(inner, np.stack([guessed((i + c) / intervals) for c in points], axis=1))
        opti.set_initial(after, guessed((i + 1) / intervals))
        rate, running = f(inner, controls)
        everything = ca.horzcat(now, inner)
        opti.subject_to(ca.mtimes(everything, slope) == h * rate)
        opti.subject_to(after == ca.mtimes(everything, last))
        bound(opti, controls, *problem.control_bounds)
        bound(opti, inner[:d, :], *problem.position_bounds)
        if problem.path_constraint:
            g, low, _ = problem.path_constraint
            opti.subject_to(g(0, inner[:d, :], 0, 0) >= low[0])
            opti.subject_to(g(0, after[:d], 0, 0) >= low[0])
        cost, now = cost + h * ca.mtimes(running, weights), after
    fix(opti, now, problem.end, problem.end_velocity)
    opti.minimize(cost)
    opti.solver("ipopt", {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}})
    return float(opti.solve().value(cost)), opti.nx


def free_duration(opti, problem):
    """Duration, a variable if it is free."""
    duration = problem.t_span[1] - problem.t_span[0]
    if problem.duration_bounds is None:
        return duration
    span = opti.variable()
    opti.subject_to(opti.bounded(problem.duration_bounds[0], span, problem.duration_bounds[1]))
    opti.set_initial(span, duration)
    return span


def states_guess(problem, guess):
    """The guess our solver starts from, as states at a fraction of the duration."""
    begin, duration = problem.t_span[0], problem.t_span[1] - problem.t_span[0]
    if guess is None:
        start, end = np.array(problem.start), np.array(problem.end)
        return lambda part: np.append(start + part * (end - start), (end - start) / duration)

    def states(part):
        t, step = begin + part * duration, 1e-4 * duration
        after, before = np.array(guess(t + step)), np.array(guess(t - step))
        return np.append(guess(t), (after - before) / (2 * step))

    return states


def fix(opti, states, positions, velocities):
    """Impose what is given of the states at an end."""
    for i, value in enumerate((*positions, *velocities)):
        if value is not None:
            opti.subject_to(states[i] == value)


def bound(opti, values, low, high):
    """Impose the finite bounds of every row."""
    for i, (a, b) in enumerate(zip(low, high, strict=True)):
        if np.isfinite(a) and np.isfinite(b):
            opti.subject_to(opti.bounded(a, values[i, :], b))


def fewest(solver, scene, reference):
    """Fewest intervals with which the cost is within the target: them, unknowns, relative error."""
    for intervals in INTERVALS[INTERVALS.index(SCENES[scene][-1]) :]:
        try:
            cost, unknowns = solver(scene, intervals)
        except cg.ConvergenceError:
            continue
        except RuntimeError as error:
            if "Solver failed" not in str(error):
                raise
            continue
        error = abs(cost / reference - 1)
        if error <= TARGET:
            return intervals, unknowns, error
    raise RuntimeError(f"{solver.__name__} does not reach {TARGET} on {scene}")


def seconds(scene, solvers, intervals):
    """Median times of building and solving, the solvers taking turns so that both see the same machine."""
    times = {solver: [] for solver in solvers}
    for _ in range(REPEATS):
        for solver, count in zip(solvers, intervals, strict=True):
            began = time.perf_counter()
            solver(scene, count)
            times[solver].append(time.perf_counter() - began)
    return [statistics.median(times[solver]) for solver in solvers]


def reference_cost(scene):
    """The exact cost, or that of a much finer solution."""
    module, guess, exact = SCENES[scene][0], *SCENES[scene][4:6]
    if exact is not None:
        return exact
    return cg.solve(module.problem(), cg.Galerkin(degree=6), intervals=80, guess=guess).cost


def main():
    """Print the table; returns the ratio of times of every scene."""
    print(f"relative error of the cost at most {TARGET}; times of building and solving, medians of {REPEATS}")
    print("                      casadi_galerkin                      casadi.Opti")
    print("scene         intervals unknowns      ms    error  intervals unknowns      ms    error   ratio")
    ratios = {}
    for scene in SCENES:
        reference = reference_cost(scene)
        found = [fewest(solver, scene, reference) for solver in (ours, by_hand)]
        times = seconds(scene, (ours, by_hand), [intervals for intervals, _, _ in found])
        cells = "".join(
            f"  {intervals:9d} {unknowns:8d} {1e3 * taken:7.1f} {error:8.1e}"
            for (intervals, unknowns, error), taken in zip(found, times, strict=True)
        )
        ratios[scene] = times[1] / times[0]
        print(f"{scene:12s}{cells} {ratios[scene]:7.1f}")
    print(f"median ratio {statistics.median(ratios.values()):.1f}")
    return ratios


if __name__ == "__main__":
    main()
