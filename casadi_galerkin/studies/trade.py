"""Speed against accuracy, measured on the user's own problem by every way there is to its path.

A way to solve is a `Row` that is not yet measured: a method on a number of intervals, or a tolerance, with a solver; or
shooting.  Each way first solves a copy of the problem, for which nothing is built or differentiated yet, and then
repeats the solve on what it has built.  Errors are differences to a reference, a path or a callable that is given, or
else a solve near rounding, whose own error is estimated.
"""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin._solve import solve, transcribe
from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus, mesh_of
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.numbers import APART, counted, flag
from casadi_galerkin.calculus.piecewise_polynomial import sampling_parts
from casadi_galerkin.calculus.roundoff import EPS, component_sizes
from casadi_galerkin.control.control_refinement import without_idle_breakpoints
from casadi_galerkin.control.control_transcription import check_solver
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.initial_problem import InitialProblem
from casadi_galerkin.problems.problem import Problem, check_kind, check_types, map_times, section_times
from casadi_galerkin.solution.errors import ConvergenceError, LimitReached, check_tolerance
from casadi_galerkin.solution.guess import Guess, check_finite_values, guess_values, sampled
from casadi_galerkin.solution.progress import progress
from casadi_galerkin.solution.quantity import Quantity, check_quantity, quantity, size_of
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.solvers.solver import Solver, ipopt, newton
from casadi_galerkin.studies.parallel import picklable
from casadi_galerkin.studies.trade_table import LEAST_ERROR, AnyProblem, Row, Trade, name_of

Reference: TypeAlias = Trajectory | Callable[[float], ArrayLike]


def _timed(solve: Callable[[], Trajectory]) -> tuple[Trajectory, float]:
    """The path of a solve, and the fewest seconds of a call, as noise only adds to them.

    It is called again, as the first one may load plugins of CasADi, and until twice the time of that has passed.
    """
    calls = list[float]()
    while not calls or sum(calls) < 2 * calls[0]:
        began = time.perf_counter()
        path = solve()
        calls.append(time.perf_counter() - began)
    return path, min(calls)


def _measured(
    problem: AnyProblem, written: bytes, row: Row, guess: Guess | None, of: Quantity | None
) -> tuple[Row, Trajectory | None]:
    """Solve in one way for the first time, and again on what is built; `written` is the pickled problem."""
    try:  # of a deep copy Functions would be shared
        path, first = _timed(lambda: row.solve(pickle.loads(written), guess))
        again: Callable[[], Trajectory] = partial(row.solve, problem, guess)
        if row.method is not None and row.solver is not None:  # a global solve, on a graph that is built
            assert not isinstance(problem, InitialProblem)
            graph = transcribe(problem, row.method, row.intervals if row.mesh is None else None, mesh=row.mesh)
            again = partial(graph.solve, guess=guess, solver=row.solver)
        _, seconds = _timed(again)
        if of is not None:
            quantity(of, path)
    except (RuntimeError, ValueError) as failure:  # a ConvergenceError is a RuntimeError, and so is what CasADi raises
        return replace(row, failure=str(failure)), None
    found = replace(row, method=path.method, intervals=len(path.t) - 1, unknowns=_unknowns(problem, path))
    return replace(found, iterations=path.iterations, first_seconds=first, solve_seconds=seconds), path


def _all_measured(
    problem: AnyProblem, ways: list[Row], guess: Guess | None, of: Quantity | None
) -> list[tuple[Row, Trajectory | None]]:
    """All ways, and then those on the meshes that tolerances have found, where durations are free at their guesses."""
    measured, waiting, written = list[tuple[Row, Trajectory | None]](), list(ways), picklable("the problem", problem)
    with progress("trade", len(ways) + len([way for way in ways if way.adaptive])) as advance:
        while waiting:
            row, path = _measured(problem, written, waiting.pop(0), guess, of)
            measured.append((row, path))
            if row.adaptive and path is not None:
                joints = map_times(path.t, section_times(path.problem), section_times(problem))
                waiting.append(Row(row.method, row.intervals, row.solver, row.tol, row.of, tuple(joints.tolist())))
            advance(1)
    return measured


def _unknowns(problem: AnyProblem, path: Trajectory) -> int:
    """Node values and controls that were solved for."""
    ends = [getattr(problem, name, None) or () for name in ("start", "end")]
    fixed = sum(value is not None for end in ends for value in end)
    periodic = path.x.shape[0] if getattr(problem, "periodic", False) else 0
    controls = path.control.values.size if hasattr(path, "control") else 0
    return path.polynomial.values.size - fixed - periodic + controls


def _ways(
    problem: AnyProblem,
    grid: Sequence[tuple[Galerkin, int]],
    tolerances: Sequence[float],
    solvers: Sequence[Solver],
    shooting: bool,
    of: Quantity | None,
    guess: Guess | None,
) -> list[Row]:
    """All ways, not yet measured; refuses what does not fit."""
    if not grid and not tolerances:
        raise ValueError("give at least one method and one number of intervals, or a tolerance, got neither")
    stepped = isinstance(problem, InitialProblem)
    options = {"solvers": solvers, "guess": [] if guess is None else [guess]}
    extra = [name for name, value in options.items() if value and stepped]
    if extra:
        raise ValueError(f"an InitialProblem is solved step by step, and takes no {' and '.join(extra)}")
    if flag("shooting", shooting) and not isinstance(problem, BoundaryProblem):
        raise ValueError(f"only a BoundaryProblem is solved by shooting, got {type(problem).__name__}")
    for solver in solvers:
        if not isinstance(solver, Solver):
            raise TypeError(f"solvers must be Solvers, such as [newton, ipopt], got {solver!r}")
        if isinstance(problem, ControlProblem):
            check_solver(solver)
    if guess is not None and not isinstance(guess, Trajectory) and (shooting or not callable(guess)):
        fits = "a Trajectory, as shooting needs its start" if shooting else "a callable or a Trajectory"
        raise TypeError(f"the guess of a trade must fit every way: {fits}, got {guess!r}")
    for method, count in grid:
        check_types(problem, method, BoundaryProblem, InitialProblem, ControlProblem)
        calculus = DiscreteCalculus(method, mesh_of(problem.t_span, count, None, problem.breakpoints))
        guess_values(guess, calculus, problem.dimension)
    usual = None if stepped else ipopt if isinstance(problem, ControlProblem) else newton
    chosen: Sequence[Solver | None] = solvers or [usual]
    ways = [Row(method, count, solver) for method, count in grid for solver in chosen]
    ways += [Row(method, count, shooting=True) for method, count in grid if shooting]
    aims = [None] if of is None else [None, of]
    return ways + [
        Row(solver=s, tol=check_tolerance(tol), of=aim) for s in chosen for tol in tolerances for aim in aims
    ]


def trade(
    problem: AnyProblem,
    methods: Iterable[Galerkin],
    intervals: Iterable[int],
    reference: Reference | None = None,
    *,
    tolerances: Iterable[float] = (),
    solvers: Iterable[Solver] = (),
    shooting: bool = False,
    of: Quantity | None = None,
    guess: Guess | None = None,
) -> Trade:
    """Solve a problem in every way that is asked for, and measure time and error of each.

    Every solver solves on every number of intervals by every method, and to every tolerance; the mesh and degree that a
    tolerance finds are a way of their own, on a fixed mesh.  A way that fails is a row that says why.  Memory is not
    measured, as most of it is CasADi's; it grows with the unknowns.

    Parameters
    ----------
    problem : BoundaryProblem, InitialProblem or ControlProblem
    methods : several Galerkin
    intervals : several numbers of equal intervals
    reference : a Trajectory or a callable t -> (d,) over the same time span, that errors are differences to; where the
        duration is free, a Trajectory of any; default a solve several digits finer, whose own error is estimated and
        reported
    tolerances : several numbers, as `solve` takes them
    solvers : several Solvers, as `solve` takes them; default the usual one.  Not for an InitialProblem
    shooting : whether to `shoot` as well, by every method on every number of intervals; for a BoundaryProblem
    of : the quantity whose error counts, as for `solve`: a position at some time, a momentum, the cost.  Tolerances
        then aim at it, beside those that aim at the path.  The path is a Trajectory, unless `reference` is a callable,
        which can only be called; default the path itself, everywhere.  A way fails where `of` is not finite, or raises
        an exception
    guess : a callable t -> (d,) or a Trajectory, for all ways and the reference: where several paths join the ends, it
        chooses one.  With `shooting`, a Trajectory, best a coarse one: it is the answer of a way on its own mesh

    Returns
    -------
    Trade: a table of Rows, which ``cheapest(tol)`` chooses from, and which ``plot`` draws

    Raises
    ------
    TypeError, ValueError
        for input that does not fit, before anything is solved
    ConvergenceError
        if no way led to a path, or no finer solve was found to measure against

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> oscillator = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), start=[0.0], end=[1.0])
    >>> measured = cg.trade(oscillator, [cg.Galerkin(2)], [4, 8, 16])
    >>> round(measured.order(cg.Galerkin(2)), 1)
    3.0
    >>> measured = cg.trade(oscillator, [cg.Galerkin(2)], [4], tolerances=[1e-6], shooting=True,
    ...     of=lambda path: path.action)
    >>> [row.way for row in measured.rows]  # doctest: +NORMALIZE_WHITESPACE
    ['newton', 'shooting', 'newton, tol 1e-06', 'newton, tol 1e-06 of it', 'newton, mesh of 1e-06',
     'newton, mesh of 1e-06 of it']
    >>> row = measured.cheapest(1e-6)
    >>> round(row.solve(oscillator).action, 5)
    0.32105
    """
    check_kind(problem, BoundaryProblem, InitialProblem, ControlProblem)
    if of is not None:
        check_quantity(of)
    ways = _ways(problem, list(product(methods, intervals)), list(tolerances), list(solvers), shooting, of, guess)
    if reference is not None:
        _check_reference(problem, reference, of)
    measured = _all_measured(problem, ways, guess, of)
    paths = [path for _, path in measured if path is not None]
    if not paths:
        raise ConvergenceError(f"no way led to a path; the first failure: {measured[0][0].failure}")
    described, own = "given", 0.0
    if reference is None:
        reference = _finest(problem, max(paths, key=lambda path: path.polynomial.values.size))
        own = reference.estimate_error()
        if of is not None:
            own = float(np.max(reference.error_of(of))) / size_of(quantity(of, reference))
        described = f"{reference.method} on {counted(len(reference.t) - 1, 'interval')}, own error {own:.1e}"
    elif isinstance(reference, Trajectory) and reference.error_estimate:
        own = reference.error_estimate
        described += f", own error {own:.1e}"
    rows = [row if path is None else replace(row, **_errors(reference, of, path)) for row, path in measured]
    return Trade(tuple(rows), described, own, None if of is None else name_of(of))


def _check_reference(problem: AnyProblem, given: Reference, of: Quantity | None) -> None:
    """Refuse a reference that is no path of the problem, or has not the quantity whose errors count."""
    d, span = problem.dimension, problem.t_span
    free = any(getattr(problem, name, None) is not None for name in ("duration_bounds", "energy"))
    if isinstance(given, Trajectory):
        if len(given.x) != d:
            raise ValueError(f"the reference must be a path of {counted(d, 'component')}, got {len(given.x)}")
        if not free and not np.allclose(given.t[[0, -1]], span, rtol=0, atol=APART * (span[1] - span[0])):
            raise ValueError(f"the reference must run from {span[0]} to {span[1]}, got {given.t[0]} to {given.t[-1]}")
    elif not callable(given):
        raise TypeError(f"the reference must be a Trajectory or a callable t -> ({d},), got {given!r}")
    elif free:
        raise TypeError(f"where the duration is free, the reference must be a Trajectory, got {given!r}")
    else:
        times = np.linspace(*span)
        check_finite_values("the reference", sampled("the reference", given, times, d), times)
    if of is not None:
        quantity(of, given)


def _errors(reference: Reference, of: Quantity | None, path: Trajectory) -> dict[str, Any]:
    """Errors of a path by their names in a `Row`, all relative to the sizes of the reference.

    Paths are compared at the same fractions of the durations between breakpoints, because a control problem may leave
    these free; by how much the durations differ is an error, too.
    """
    times = path.polynomial.times(sampling_parts(4 * path.method.degree)[:-1])  # as fine as the largest error asks
    marks = _marks(path.problem)
    if isinstance(reference, Trajectory):
        own = _marks(reference.problem)
        values = reference(map_times(times, marks, own))
    else:
        own, values = marks, sampled("the reference", reference, times, len(path.x))
    missed = np.max(np.abs(path(times) - values) / component_sizes(values)[:, None], axis=0)
    lasting = np.max(np.abs(np.subtract(marks, marks[0]) - np.subtract(own, own[0]))) / (own[-1] - own[0])
    error = float(max(np.max(missed), lasting))
    errors = {"error": error, "path_error": error, "joint_error": float(np.max(missed[np.isin(times, path.t)]))}
    if of is not None:
        value = quantity(of, reference)
        errors["error"] = float(np.max(np.abs(quantity(of, path) - value))) / size_of(value)
    return errors


def _marks(problem: Problem) -> list[float]:
    """Times of the ends, and of the breakpoints that mean the same on every path; idle free ones may be anywhere."""
    return section_times(without_idle_breakpoints(problem) if isinstance(problem, ControlProblem) else problem)


def _finest(problem: AnyProblem, best: Trajectory) -> Trajectory:
    """A path as near as rounding allows, of an optimum to half of the digits, from the best one that is known."""
    tol = EPS**0.5 if isinstance(problem, ControlProblem) else LEAST_ERROR
    try:
        return solve(problem, tol=tol, guess=None if isinstance(problem, InitialProblem) else best)
    except LimitReached as error:
        if not isinstance(error.path, Trajectory):
            raise
        return error.path
