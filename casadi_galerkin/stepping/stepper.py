"""The step (x, p) -> (x, p) of one interval, rolled forward.

Newton's iteration is part of the graph, and starts from the Taylor polynomial of the interval before.  `mapaccum`
chains the step over a piece of √N of N intervals; then all of these are verified by their residuals, which are computed
anew.  Python runs once per piece, of which there are √N: longer ones were not faster, but took longer to build.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.functional.buffers import Evaluator
from casadi_galerkin.functional.interval import SlopeBasis, interval, newton_iteration
from casadi_galerkin.problems.constrained_motion import check_points
from casadi_galerkin.problems.problem import Problem
from casadi_galerkin.solvers.stationarity import ACCEPTED


@dataclass(frozen=True)
class Roll:
    """Steps one after the other, each verified on its own.

    Attributes
    ----------
    stepper : which made the steps
    mesh : (N + 1,), joints
    x, p : (d, N + 1), at the joints
    p_terms : (d, N + 1), sizes of the terms that p sums, which may cancel; the first is that of p itself
    unknowns : (N, rows, columns), s of every interval as `Interval` has it
    iterations : (N,), of Newton's method
    residual : (N,), largest residual of each step over its roundoff floor; not finite where a step failed, or left the
        domain of the Lagrangian
    action : (N,), of each interval
    """

    stepper: Stepper
    mesh: np.ndarray
    x: np.ndarray
    p: np.ndarray
    p_terms: np.ndarray
    unknowns: np.ndarray
    iterations: np.ndarray
    residual: np.ndarray
    action: np.ndarray

    @property
    def slopes(self) -> np.ndarray:
        """Slopes of every interval at the Gauss points, (d, N, m)."""
        d = self.stepper.positions
        columns = self.unknowns.shape[2] - (self.unknowns.shape[1] > d)  # with constraints there is one more
        return self.unknowns[:, :d, :columns].transpose(1, 0, 2)

    @property
    def velocity(self) -> np.ndarray:
        """Velocity at the start, (d,)."""
        first = self.slopes[:, 0] @ self.stepper.basis.slopes(np.zeros(1)).T
        return first.ravel() / (self.mesh[1] - self.mesh[0])

    def path(self, count: int | None = None) -> PiecewisePolynomial:
        """The path over the first `count` intervals, or over all."""
        nodes, slopes = self.stepper.method.element.nodes, self.slopes[:, :count]
        (d, count, _) = slopes.shape
        inner = self.x[:, :count, None] + slopes @ self.stepper.basis.values(nodes[:-1]).T
        values = np.column_stack((inner.reshape(d, -1), self.x[:, count]))
        return PiecewisePolynomial(self.mesh[: count + 1], nodes, values)

    def unstretched(self) -> Roll:
        """The steps at their true times: the stretch is applied to the mesh, and is no component any more."""
        if not self.stepper.free_duration:
            return self
        d = len(self.x) - 1
        mesh = self.mesh[0] + self.x[d, 0] * (self.mesh - self.mesh[0])
        parts = {name: getattr(self, name)[:d] for name in ("x", "p", "p_terms")}
        return replace(self, mesh=mesh, **parts)

    @property
    def solved_steps(self) -> int:
        """Number of steps before the first that failed."""
        failed = ~(self.residual <= ACCEPTED)
        return int(np.argmax(failed)) if failed.any() else len(failed)


class Stepper:
    """The step of a problem, built once and rolled as often as wanted.

    Where it has a `free_duration`, the stretch of all steps is the last component of x.
    """

    def __init__(self, problem: Problem, method: Galerkin, free_duration: bool = False) -> None:
        began = time.perf_counter()
        numeric = problem.numeric
        lagrangian, force, constraint = numeric.lagrangian, numeric.force, numeric.constraint
        self.method, self.free_duration = method, free_duration
        check_points(constraint, method)
        self.positions, self.basis = lagrangian.size1_in(1), SlopeBasis(method.degree)
        self.dimension = self.positions + free_duration
        self.interval = interval(lagrangian, force, constraint, method)
        if free_duration:
            self.interval = self.interval.with_free_duration()
        self._shape = self.interval.system.size_in(0)
        self._newton = newton_iteration(self.interval.system, self.positions)
        self._step = self._predicted(self._newton)
        self._evaluators: dict[tuple[str, int], Evaluator] = {}
        self.build_seconds = time.perf_counter() - began

    def _predicted(self, newton: ca.Function) -> ca.Function:
        """(x, p, velocity, t, h) -> (x, p, velocity, s, iterations); the velocity predicts the next interval.

        With its derivative, too, large steps found other solutions.
        """
        d = self.dimension
        x, p, velocity, t, h = (ca.MX.sym("at", size) for size in (d, d, self.positions, 1, 1))
        guess = ca.repmat(h * velocity, 1, self._shape[1])  # with constraints the velocity of the end is one
        impulses = ca.MX(self._shape[0] - self.positions, self._shape[1])
        s, iterations = newton(ca.densify(ca.vertcat(guess, impulses)), x, p, t, h)
        s = self.interval.denoised(s, x, p, t, h)
        ends = self.interval.end(s, x, p, t, h)
        return ca.Function("step", [x, p, velocity, t, h], [*ends, s, iterations])

    def _rolled(self, count: int) -> ca.Function:
        """Steps rolled forward, then all of them verified; inputs as `_predicted`, with t and h (1, count)."""
        rolled = self._step.mapaccum("rolled", count, 3)
        inputs = rolled.mx_in()
        x, p, velocity, s, iterations = rolled(*inputs)
        before = [ca.horzcat(first, later[:, :-1]) for first, later in zip(inputs[:2], (x, p), strict=True)]
        ratio, action, terms = self.interval.check.map(count)(s, *before, *inputs[3:])
        return ca.Function("piece", inputs, [x, p, velocity[:, -1], s, iterations, ratio, action, terms])

    def _evaluator(self, name: str, count: int) -> Evaluator:
        """Evaluator of the roll through `count` intervals, or of their Jacobians; kept."""
        if (name, count) not in self._evaluators:
            began = time.perf_counter()
            function = self._rolled(count) if name == "roll" else self.interval.jacobian().map(count)
            self._evaluators[name, count] = Evaluator(function)
            self.build_seconds += time.perf_counter() - began
        return self._evaluators[name, count]

    def roll(self, x: np.ndarray, p: np.ndarray, velocity: np.ndarray, mesh: np.ndarray) -> Roll:
        """Step from (x, p), (d,) each, through all joints of the mesh (N + 1,); `velocity` predicts the first.

        Nothing is raised: where a step fails, `Roll.residual` is large or not finite.
        """
        d, n = self.dimension, len(mesh) - 1
        size = 1 + math.isqrt(n - 1)  # of a piece; the last interval is repeated to fill the last piece
        t, h = (np.pad(array, (0, -n % size), mode="edge") for array in (mesh[:-1], np.diff(mesh)))
        piece = self._evaluator("roll", size)
        state, found = (x, p, velocity), []
        for i in range(0, len(h), size):
            *outputs, action, terms = piece(*state, t[i : i + size], h[i : i + size])
            rolled_x, rolled_p, velocity = outputs[:3]
            state = (rolled_x[-d:], rolled_p[-d:], velocity)
            found.append((rolled_x, rolled_p, terms, *outputs[3:], action))
        xs, ps, terms, s, iterations, ratio, action = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
        rows, columns = self._shape
        return Roll(
            self,
            mesh,
            np.column_stack((x, xs.reshape(-1, d).T[:, :n])),
            np.column_stack((p, ps.reshape(-1, d).T[:, :n])),
            np.column_stack((np.abs(p), terms.reshape(-1, d).T[:, :n])),
            s.reshape(-1, columns, rows).transpose(0, 2, 1)[:n],
            iterations[:n],
            np.where(np.isnan(action), np.nan, ratio.reshape(len(action), -1).max(axis=1))[:n],
            action[:n],
        )

    def unknowns(self, mesh: np.ndarray, x: np.ndarray, p: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Unknowns of every interval, as in `Roll`, from slopes (N, d, m) that are theirs or near: with impulses."""
        count, (rows, columns) = len(mesh) - 1, self._shape
        guess = np.zeros((count, rows, columns))
        guess[:, : self.positions, : slopes.shape[2]] = slopes
        flat = guess.transpose(1, 0, 2).reshape(rows, -1)
        s = np.array(self._newton.map(count)(flat, x[:, :-1], p[:, :-1], mesh[None, :-1], np.diff(mesh)[None, :])[0])
        return s.reshape(rows, count, columns).transpose(1, 0, 2)

    def jacobians(self, mesh: np.ndarray, x: np.ndarray, p: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
        """∂(x_{i+1}, p_{i+1})/∂(x_i, p_i) of every step, (N, 2d, 2d); arguments as in `Roll`."""
        d, n = self.dimension, len(mesh) - 1
        columns = (a.ravel() for a in (unknowns.transpose(0, 2, 1), x[:, :n].T, p[:, :n].T))
        (matrices,) = self._evaluator("jacobians", n)(*columns, mesh[:-1], np.diff(mesh))
        return matrices.reshape(n, 2 * d, 2 * d).transpose(0, 2, 1)
