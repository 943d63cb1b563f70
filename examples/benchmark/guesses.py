"""Random guesses of three swing-ups: how many solves succeed, and how fast, against Gauss collocation in casadi.Opti.

Both are built once, with the same degree on the same intervals, and start from the same guesses: the straight line
with a few random waves upon it, and random controls within half their bounds.  A solve counts that ends in what the
solver itself calls an optimum; ours are verified besides.  Times are medians over the solves of each that succeed.
"""

import statistics
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

import casadi_galerkin as cg
from casadi_galerkin.calculus.nodes import differentiation_matrix, lagrange_values

sys.path.insert(0, str(Path(__file__).parents[1]))

import cart_pole
import two_link_arm

DEGREE, INTERVALS, WAVES, HEIGHT = 4, 25, 4, 1.0


def acrobot(duration=3.0):
    """M. W. Spong (1995): two uniform rods of 1 kg and 1 m with a torque in the elbow only, from hanging to upright.

    Angles are from below, that of the second rod absolute; the torque turns it, and the first one back.
    """

    def lagrangian(t, x, v):
        kinetic = v[0] ** 2 * 2 / 3 + v[1] ** 2 / 6 + v[0] * v[1] * ca.cos(x[0] - x[1]) / 2
        return kinetic + 9.81 * (1.5 * ca.cos(x[0]) + 0.5 * ca.cos(x[1]))

    return cg.ControlProblem(
        lagrangian, (0.0, duration), [0.0, 0.0], [np.pi, np.pi], [0.0, 0.0], [0.0, 0.0],
        force=lambda t, x, v, u: [-u[0], u[0]],
        running_cost=lambda t, x, v, u: u[0] ** 2,
        controls=1,
        control_bounds=(-30.0, 30.0),
    )  # fmt: skip


SCENES = {  # problem, guesses
    "cart-pole": (cart_pole.problem, 100),
    "two-link arm": (two_link_arm.problem, 100),
    "acrobot": (acrobot, 40),
}


@dataclass(frozen=True)
class Guess:
    """A path, its velocity and controls, functions of time."""

    path: np.ndarray
    control: np.ndarray
    problem: cg.ControlProblem

    def part(self, t):
        """Part of the duration that has passed."""
        return t / self.problem.t_span[1]

    def x(self, t):
        """Positions."""
        start, end = (np.array(side) for side in (self.problem.start, self.problem.end))
        return start + (end - start) * self.part(t) + self.path @ np.sin(np.pi * np.arange(1, WAVES + 1) * self.part(t))

    def v(self, t):
        """Velocities."""
        start, end = (np.array(side) for side in (self.problem.start, self.problem.end))
        k = np.pi * np.arange(1, WAVES + 1)
        return (end - start + self.path @ (k * np.cos(k * self.part(t)))) / self.problem.t_span[1]

    def u(self, t):
        """Controls."""
        return self.control @ np.cos(np.pi * np.arange(WAVES) * self.part(t))


def guess(problem, seed):
    """The guess of a seed."""
    random = np.random.default_rng(seed)
    waves = HEIGHT * random.standard_normal((problem.dimension, WAVES)) / np.arange(1, WAVES + 1)
    highest = np.array(problem.control_bounds[1])[:, None]
    return Guess(waves, highest * random.uniform(-0.5, 0.5, (problem.controls, WAVES)) / WAVES, problem)


class ByHand:
    """Gauss collocation of the first-order system in casadi.Opti."""

    def __init__(self, problem):
        self.problem, d, n = problem, problem.dimension, problem.controls
        states, u = ca.SX.sym("states", 2 * d), ca.SX.sym("u", n)
        x, v = states[:d], states[d:]
        value = problem.lagrangian(0, x, v)
        momentum = ca.gradient(value, v)
        push = ca.gradient(value, x) + problem.force(0, x, v, u) - ca.jtimes(momentum, x, v)
        acceleration = ca.solve(ca.jacobian(momentum, v), push)
        f = ca.Function("f", [states, u], [ca.vertcat(v, acceleration), problem.running_cost(0, x, v, u)])
        rule = cg.gauss(DEGREE)
        self.points, weights = np.array(rule.points), np.array(rule.weights)
        nodes = np.append(0.0, self.points)
        slope, last = differentiation_matrix(nodes)[1:].T, lagrange_values(nodes, np.array([1.0]))[0]
        self.opti, self.intervals, h = ca.Opti(), [], problem.t_span[1] / INTERVALS
        opti, now, cost = self.opti, self.opti.variable(2 * d), 0
        self.first = now
        opti.subject_to(now == ca.vertcat(*problem.start, *problem.start_velocity))
        for _ in range(INTERVALS):
            inner, controls, after = opti.variable(2 * d, DEGREE), opti.variable(n, DEGREE), opti.variable(2 * d)
            self.intervals.append((inner, controls, after))
            rate, running = f(inner, controls)
            everything = ca.horzcat(now, inner)
            opti.subject_to(ca.mtimes(everything, slope) == h * rate)
            opti.subject_to(after == ca.mtimes(everything, last))
            for i, (low, high) in enumerate(zip(*problem.control_bounds, strict=True)):
                opti.subject_to(opti.bounded(low, controls[i, :], high))
            for i, (low, high) in enumerate(zip(*problem.position_bounds, strict=True)):
                if np.isfinite(high - low):
                    opti.subject_to(opti.bounded(low, inner[i, :], high))
            cost, now = cost + h * ca.mtimes(running, weights), after
        opti.subject_to(now == ca.vertcat(*problem.end, *problem.end_velocity))
        opti.minimize(cost)
        self.cost = cost
        opti.solver("ipopt", {"print_time": False, "expand": True, "ipopt": {"print_level": 0, "sb": "yes"}})

    def solve(self, given):
        """Cost from a guess; RuntimeError where there is none."""
        opti, times = self.opti, np.linspace(*self.problem.t_span, INTERVALS + 1)

        def states(t):
            return np.append(given.x(t), given.v(t))

        opti.set_initial(self.first, states(times[0]))
        for begin, end, (inner, controls, after) in zip(times[:-1], times[1:], self.intervals, strict=True):
            at = begin + (end - begin) * self.points
            opti.set_initial(inner, np.stack([states(t) for t in at], axis=1))
            opti.set_initial(controls, np.stack([given.u(t) for t in at], axis=1))
            opti.set_initial(after, states(end))
        began = time.perf_counter()
        cost = float(opti.solve().value(self.cost))
        return cost, time.perf_counter() - began


class Ours:
    """The chain of stages."""

    def __init__(self, problem):
        self.program = cg.transcribe(problem, cg.Galerkin(DEGREE), INTERVALS)

    def solve(self, given):
        """Cost from a guess; ConvergenceError, a RuntimeError, where there is none."""
        began = time.perf_counter()
        cost = self.program.solve(guess=(given.x, given.u)).cost
        return cost, time.perf_counter() - began


def main(**counts):
    """Print what each of both solves, and in what time."""
    heads = ["guesses", "solved", "by hand", "ms", "by hand", "ratio", "cheapest", "by hand"]
    print(f"{'scene':14}" + "".join(f"{head:>10}" for head in heads))
    for name, (make, count) in SCENES.items():
        problem, found, seeds = make(), {}, range(counts.get(name, count))
        programs = {kind: kind(problem) for kind in (Ours, ByHand)}
        for seed in seeds:
            for kind, program in programs.items():
                try:
                    found.setdefault(kind, []).append(program.solve(guess(problem, seed)))
                except RuntimeError:
                    continue
        (ours, theirs) = (found.get(kind, [(np.nan, np.nan)]) for kind in (Ours, ByHand))
        times = [statistics.median(t for _, t in one) for one in (ours, theirs)]
        costs = [min(c for c, _ in one) for one in (ours, theirs)]
        row = f"{len(seeds):10d}{len(ours):10d}{len(theirs):10d}{1e3 * times[0]:10.1f}{1e3 * times[1]:10.1f}"
        print(f"{name:14}{row}{times[0] / times[1]:10.2f}{costs[0]:10.4f}{costs[1]:10.4f}", flush=True)


if __name__ == "__main__":
    main()
