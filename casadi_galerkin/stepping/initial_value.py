"""Initial problems: the first state from position and momentum or velocity, and the path from the steps."""

from __future__ import annotations

import time
from collections.abc import Callable

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.discrete_calculus import mesh_of
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.mesh_adaptation import FEWEST, halved, higher_degree_method, method_for, truncation_error
from casadi_galerkin.calculus.numbers import told_apart
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.constrained_motion import off_constraint
from casadi_galerkin.problems.initial_problem import InitialProblem
from casadi_galerkin.problems.tables import off_tables
from casadi_galerkin.solution.errors import ConvergenceError, LimitReached, Limits
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solution.quantity import Quantity
from casadi_galerkin.solution.trajectory import Comparisons, Trajectory, compared
from casadi_galerkin.solvers.stationarity import ACCEPTED
from casadi_galerkin.stepping.stepper import Roll, Stepper


def integrate(problem: InitialProblem, method: Galerkin, mesh: np.ndarray, verbose: int = 0) -> Trajectory:
    """Solve an initial problem step by step on the joints of a mesh; see `solve`.

    Where a path meets a singularity, a step may still have a solution that lies beyond it, because the discrete
    equations do not see what lies between quadrature points.  The energy then jumps.
    """
    began = time.perf_counter()
    p, v = problem.start_state
    roll = Stepper(problem, method).roll(np.array(problem.start), p, v, mesh)
    check_steps(roll)
    path = trajectory(problem, roll, int(roll.iterations.sum()), "step by step", began, comparisons)
    if verbose:
        print(path)
    return path


def comparisons(path: Trajectory) -> Comparisons:
    """With the path of a higher degree on the same joints, from the same start."""
    assert isinstance(path.problem, InitialProblem)
    return compared(path, integrate(path.problem, higher_degree_method(path.method.degree), path.t))


def started(path: Trajectory, force: ca.Function | None) -> InitialProblem:
    """The initial problem of a path under a force: its position and momentum at the start."""
    problem = path.problem
    return InitialProblem(
        problem.lagrangian,
        problem.t_span,
        path.x[:, 0].tolist(),
        momentum=path.momentum[:, 0].tolist(),
        parameters=problem.parameters,
        force=force,
        constraint=problem.constraint,
    )


def to_tolerance(
    steps: Callable[[Galerkin, np.ndarray], Trajectory],
    problem: InitialProblem | BoundaryProblem,
    tol: float,
    method: Galerkin | None,
    intervals: int | None,
    mesh: ArrayLike | None,
    limits: Limits,
    of: Quantity | None = None,
) -> Trajectory:
    """The path on steps that are halved until its estimated error, or that of a quantity of it, is at most `tol`.

    All steps are halved, so that equal ones stay equal, and what they conserve is conserved; a failure on long steps
    is no end, either.
    """
    method, deadline = method_for(tol) if method is None else method, time.perf_counter() + limits.seconds
    if intervals is None and mesh is None:
        intervals = FEWEST + len(problem.breakpoints)
    joints = mesh_of(problem.t_span, intervals, mesh, problem.breakpoints)
    path, error, reached = None, np.inf, ConvergenceError("no path")
    while len(joints) - 1 <= limits.intervals and time.perf_counter() <= deadline:
        try:
            path = steps(method, joints)
            error = path.estimate_error()
            if of is not None:
                path = path.asked_for(of)
                error = path.asked_error or 0.0
            if error <= tol:
                return path
            when = path.t[np.argmax(truncation_error(path.polynomial))]
            words = f"the last path has an estimated error of {error:.1e}, and is least resolved near t = {when:.6g}"
            reached = ConvergenceError(words, path)
        except ConvergenceError as failure:
            reached = reached if path else failure
        joints = halved(joints)
    raise LimitReached(
        f"tolerance {tol:g} was not reached within {limits.intervals:g} intervals and {limits.seconds:g} seconds: "
        f"{reached}. Raise the limits or tol; where neighboring paths part fast, steps keep few digits",
        reached.path,
    )


def check_steps(roll: Roll) -> None:
    """Refuse a roll of which a step was not solved to roundoff, and name the first."""
    good, n = roll.solved_steps, len(roll.mesh) - 1
    if good == n:
        return
    start, end = told_apart(*roll.mesh[good : good + 2])
    raise ConvergenceError(
        f"step {good + 1} of {n}, from t = {start} to {end}, was not solved: its residual is "
        f"{roll.residual[good]:.1e} times its roundoff floor, up to {ACCEPTED:g} is accepted. Take shorter steps "
        "there, or another start; the path may run into a collision or another singularity",
        Path(roll.path(good)) if good else None,
        float(roll.residual[good]),
        int(np.nansum(roll.iterations[: good + 1])),
    )


def trajectory(
    problem: InitialProblem | BoundaryProblem,
    roll: Roll,
    iterations: int,
    solver: str,
    began: float,
    find_comparisons: Callable[[Trajectory], Comparisons],
) -> Trajectory:
    """Wrap verified steps as an answer; there is no Hessian of the whole action, so no Morse index."""
    build = roll.stepper.build_seconds
    path, residual = roll.path(), float(roll.residual.max())
    off = off_constraint(problem, path) or off_tables(problem, path)
    if off is not None:
        raise ConvergenceError(off, Path(path), residual, iterations)
    return Trajectory(
        polynomial=path,
        momentum=roll.p,
        action=float(roll.action.sum()),
        iterations=iterations,
        residual=residual,
        solver=solver,
        build_seconds=build,
        solve_seconds=time.perf_counter() - began - build,
        method=roll.stepper.method,
        problem=problem,
        find_comparisons=find_comparisons,
    )
