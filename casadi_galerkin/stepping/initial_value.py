"""Initial problems: the first state from position and momentum or velocity, and the path from the steps."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.discrete_calculus import mesh_of
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.mesh_adaptation import FEWEST, higher_degree_method, method_for
from casadi_galerkin.calculus.numbers import told_apart
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.constrained_motion import off_constraint
from casadi_galerkin.problems.initial_problem import InitialProblem
from casadi_galerkin.problems.tables import off_tables
from casadi_galerkin.solution.errors import ConvergenceError, LimitReached
from casadi_galerkin.solution.limits import Limits
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solution.quantity import Quantity
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.solvers.stationarity import ACCEPTED
from casadi_galerkin.stepping.stepper import Roll, Stepper


def integrate(problem: InitialProblem, method: Galerkin, mesh: np.ndarray, verbose: int = 0) -> Trajectory:
    """Solve an initial problem step by step on the joints of a mesh; see `solve`.

    Where a path meets a singularity, a step may still have a solution that lies beyond it, because the discrete
    equations do not see what lies between quadrature points.  The energy then jumps.
    """
    began = time.perf_counter()
    p, v = problem.start_state
    stepper = Stepper(problem, method)
    roll = verified(stepper.roll(np.array(problem.start), p, v, mesh), stepper)
    build = stepper.build_seconds
    seconds = time.perf_counter() - began - build
    path = trajectory(problem, stepper, roll, int(roll.iterations.sum()), "step by step", build, seconds)
    path = replace(path, find_finer=finer)
    if verbose:
        print(path)
    return path


def finer(path: Trajectory) -> tuple[Trajectory]:
    """The path of a higher degree on the same joints, from the same start."""
    assert isinstance(path.problem, InitialProblem)
    return (integrate(path.problem, higher_degree_method(path.method.degree), path.t),)


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
    path: Trajectory | None = None
    error, failure = np.inf, None
    while len(joints) - 1 <= limits.intervals and time.perf_counter() <= deadline:
        try:
            path = steps(method, joints)
        except ConvergenceError as caught:
            failure = caught
        else:
            error = path.estimate_error()
            if of is not None:
                path = path.asked_for(of)
                error = path.asked_error or 0.0
            if error <= tol:
                return path
        joints = np.insert(joints, range(1, len(joints)), (joints[:-1] + joints[1:]) / 2)
    reached = f"the last path has an estimated error of {error:.1e}" if path else failure or "no path"
    raise LimitReached(
        f"tolerance {tol:g} was not reached within {limits.intervals:g} intervals and {limits.seconds:g} seconds: "
        f"{reached}. Raise the limits or tol; where neighboring paths part fast, steps keep few digits",
        path or getattr(failure, "path", None),
    ) from failure


def verified(roll: Roll, stepper: Stepper) -> Roll:
    """Return the roll if all of its steps were solved to roundoff; else name the first that was not."""
    good, n = roll.solved_steps, len(roll.mesh) - 1
    if good == n:
        return roll
    start, end = told_apart(*roll.mesh[good : good + 2])
    raise ConvergenceError(
        f"step {good + 1} of {n}, from t = {start} to {end}, was not solved: its residual is "
        f"{roll.residual[good]:.1e} times its roundoff floor, up to {ACCEPTED:g} is accepted. Take shorter steps "
        "there; the path may run into a collision or another singularity",
        Path(path_of(roll, stepper, good)) if good else None,
        float(roll.residual[good]),
        int(np.nansum(roll.iterations[: good + 1])),
    )


def path_of(roll: Roll, stepper: Stepper, count: int) -> PiecewisePolynomial:
    """The path over the first `count` intervals."""
    nodes, d = stepper.method.element.nodes, len(roll.x)
    inner = roll.x[:, :count, None] + roll.slopes[:, :count] @ stepper.basis.values(nodes[:-1]).T
    values = np.column_stack((inner.reshape(d, -1), roll.x[:, count]))
    return PiecewisePolynomial(roll.mesh[: count + 1], nodes, values)


def trajectory(
    problem: InitialProblem | BoundaryProblem,
    stepper: Stepper,
    roll: Roll,
    iterations: int,
    solver: str,
    build_seconds: float,
    solve_seconds: float,
) -> Trajectory:
    """Wrap verified steps as an answer; there is no Hessian of the whole action, so no Morse index."""
    path = path_of(roll, stepper, len(roll.mesh) - 1)
    off = off_constraint(problem, path) or off_tables(problem, path)
    if off is not None:
        raise ConvergenceError(off, Path(path), float(roll.residual.max()), iterations)
    return Trajectory(
        polynomial=path,
        momentum=roll.p,
        action=float(roll.action.sum()),
        iterations=iterations,
        residual=float(roll.residual.max()),
        solver=solver,
        build_seconds=build_seconds,
        solve_seconds=solve_seconds,
        method=stepper.method,
        problem=problem,
    )
