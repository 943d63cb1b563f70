"""The functions for every kind of problem: `solve`, `transcribe` for many solves, and `solution_function`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, TypeVar, overload

import casadi as ca
from numpy.typing import ArrayLike

from casadi_galerkin.boundary.repeated_refinement import RepeatedRefinement
from casadi_galerkin.boundary.sensitivity import boundary_function, boundary_sensitivity
from casadi_galerkin.boundary.transcription import Transcription
from casadi_galerkin.calculus.discrete_calculus import mesh_of
from casadi_galerkin.calculus.galerkin import Galerkin, check_method
from casadi_galerkin.calculus.numbers import check_verbose, counted, whole
from casadi_galerkin.control.control_refinement import RepeatedOptimization
from casadi_galerkin.control.control_sensitivity import control_function
from casadi_galerkin.control.control_transcription import ControlTranscription
from casadi_galerkin.control.starts import best_of
from casadi_galerkin.functional.buffers import interrupts_raised
from casadi_galerkin.functional.pointwise import PointMap, by_rows, one_by_one
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.initial_problem import InitialProblem
from casadi_galerkin.problems.phases import Phases
from casadi_galerkin.problems.problem import check_kind, check_types
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.errors import Limits, check_tolerance
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solution.optimal_path import PhasesTrajectory
from casadi_galerkin.solution.quantity import Quantity, check_asked
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.solvers.deadline import until
from casadi_galerkin.solvers.derivatives import Sensitivity
from casadi_galerkin.solvers.solver import Solver, ipopt, newton
from casadi_galerkin.stepping.initial_value import integrate, to_tolerance

Answer = TypeVar("Answer", bound=Trajectory)

if TYPE_CHECKING:
    from typing_extensions import TypedDict, Unpack

    class Refined(TypedDict, total=False):
        """Where a refinement begins, and what it is of."""

        mesh: ArrayLike | None
        of: Quantity | None
        limits: Limits | None

    class Options(Refined, total=False):
        """What `solve` takes."""

        tol: float | None
        guess: Any
        solver: Solver | None
        starts: int
        verbose: int


@overload
def solve(
    problem: ControlProblem, method: Galerkin | None = None, intervals: int | None = None, **options: Unpack[Options]
) -> ControlTrajectory: ...


@overload
def solve(
    problem: Phases, method: Galerkin | None = None, intervals: Any = None, **options: Unpack[Options]
) -> PhasesTrajectory: ...


@overload
def solve(
    problem: BoundaryProblem | InitialProblem,
    method: Galerkin | None = None,
    intervals: int | None = None,
    **options: Unpack[Options],
) -> Trajectory: ...


@interrupts_raised()
def solve(
    problem: BoundaryProblem | InitialProblem | ControlProblem | Phases,
    method: Galerkin | None = None,
    intervals: Any = None,
    *,
    tol: float | None = None,
    of: Quantity | None = None,
    mesh: ArrayLike | None = None,
    guess: Guess | None = None,
    solver: Solver | None = None,
    limits: Limits | None = None,
    starts: int = 1,
    verbose: int = 0,
) -> Trajectory | PhasesTrajectory:
    """Solve a problem: with a fixed discretization, or to a tolerance.

    With `method` and `intervals` or `mesh`, this is `transcribe` followed by `Transcription.solve`.  With `tol`, the
    degree and the mesh are chosen so that the estimated error of x, at the joints and between them and relative to
    the largest value of each component, is at most `tol`; `method` then fixes the degree, and `intervals` or `mesh`
    are where refinement begins.

    With ``of``, a quantity of the path, it is this that is known to `tol`, relative to the size of its largest entry:
    the path may be known to fewer digits, or has to be known to more.  Its error is the difference to the path of a
    higher degree on the same mesh (see `Trajectory.error_of`).

    An `InitialProblem` is solved step by step, with `method` and `intervals` or `mesh`, or with `tol`: all steps are
    then halved until the error is small enough, and stay equal, as conserving energy wants.  A `ControlProblem`, whose
    answer is a ControlTrajectory, is solved by IPOPT or fatrop, with these or a tolerance, and a `guess`.  Its `tol`
    bounds the relative errors of cost and duration as well, but not those of controls and free parameters.  With
    ``of=lambda path: path.cost`` it bounds that of the cost alone, which is known long before the path, and even where
    many paths cost the same.  An earlier answer to a tolerance, as guess, brings its mesh, where it has more intervals
    than refinement else begins with.

    Parameters
    ----------
    problem : BoundaryProblem, InitialProblem, ControlProblem or Phases
    method : Galerkin
    intervals : number of equal intervals, or a list with one for each phase or section between breakpoints; or
    mesh : (N + 1,) joints from t_span[0] to t_span[1]
    tol : relative tolerance between 0 and 1
    of : callable, a path -> a number, or an array whose shape does not depend on the mesh, such as
        ``lambda path: path.momentum[:, -1]``: what `tol` is the tolerance of; the answer has it as `asked`, and its
        estimated relative error as `asked_error`
    guess : of a boundary or control problem, where the search begins; default the straight line between the ends.  A
        callable t -> d numbers; a pair (times, values) of arrays (K,) and (d, K); an array (d, N + 1) of values at
        the joints; an earlier answer, or what `load` has read of it.  For a ControlProblem also a pair (path, controls)
        of one of these, or None, and a callable t -> n numbers.  For Phases one of all this for all of them, or a list
        with one for each.  `Transcription.solve` and `ControlTranscription.solve` have all forms
    solver : newton (the default), rootfinder, ipopt or minimizer for a BoundaryProblem, ipopt (the default), fatrop
        or sqp for a ControlProblem; each also ``.with_options(...)``
    limits : Limits that stop a refinement, by default after 120 s; without a tolerance, their seconds stop the solver
        and its retries, by default never
    starts : how often to solve a ControlProblem, from `guess` first and then from random paths, always the same ones;
        the cheapest optimum is returned, and its `solver` says how many were met.  With a tolerance all are solved
        on the first mesh, and those refined that may be the best.  (`paths` finds several paths of a BoundaryProblem.)
    verbose : 1 prints a summary, of several starts one each, and, with a tolerance, a line for each mesh; 2 also
        the solver's lines

    Returns
    -------
    Trajectory, of a ControlProblem a ControlTrajectory, of Phases a PhasesTrajectory

    Raises
    ------
    TypeError, ValueError
        for input that does not fit, before anything is solved; naming what came and what was expected
    ConvergenceError
        if no path is found that can be verified: ConjugatePointError where the ends do not determine it, LimitReached,
        with the best path, where the tolerance is not reached within the limits

    Examples
    --------
    >>> from casadi_galerkin import BoundaryProblem, Galerkin, solve
    >>> problem = BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), start=[0.0], end=[1.0])
    >>> path = solve(problem, Galerkin(degree=4), intervals=10)
    >>> float(path(0.5)[0].round(6))
    0.569747

    A launch velocity to ten digits:

    >>> path = solve(problem, tol=1e-10, of=lambda path: path.velocity[:, 0])
    >>> path.asked.round(9).tolist(), path.asked_error <= 1e-10
    ([1.188395106], True)
    """
    check_kind(problem, BoundaryProblem, InitialProblem, ControlProblem, Phases)
    check_verbose(verbose)
    if not isinstance(problem, ControlProblem) and whole(starts) != 1:
        several = "`paths` finds several paths of a BoundaryProblem"
        raise ValueError(f"starts is for a ControlProblem, got {starts!r}; {several}")
    limited = not isinstance(problem, InitialProblem) or tol is not None
    tolerance = _tolerance(method, tol, of, limits, limited)
    if isinstance(problem, InitialProblem):
        extra = [name for name, value in {"guess": guess, "solver": solver}.items() if value is not None]
        if extra:
            raise ValueError(f"an InitialProblem is solved step by step, and takes no {' and '.join(extra)}")
        steps = partial(integrate, problem, verbose=verbose)
        if tolerance is not None:
            return to_tolerance(steps, problem, tolerance, method, intervals, mesh, limits or Limits(), of)
        return steps(_given(method), mesh_of(problem.t_span, intervals, mesh, problem.breakpoints))
    if solver is None:
        solver = newton if isinstance(problem, BoundaryProblem) else ipopt
    if tolerance is not None:
        given = problem, tolerance, method, intervals, mesh, limits or Limits(), of
        path: Any = _refinement(*given, mapping=one_by_one, starts=starts)(problem, guess, None, solver, verbose)
        if verbose:
            print(path)
        return path
    graph = _graph(problem, method, intervals, mesh, one_by_one if starts == 1 else by_rows)
    with until(math.inf if limits is None else time.perf_counter() + limits.seconds):
        if starts == 1:
            return graph.solve(guess=guess, solver=solver, verbose=verbose)
        return best_of(starts, problem, guess, partial(graph.solve, solver=solver, verbose=verbose))


def _graph(
    problem: BoundaryProblem | ControlProblem | Phases,
    method: Galerkin | None,
    intervals: Any,
    mesh: ArrayLike | None,
    mapping: PointMap = by_rows,
) -> Transcription | ControlTranscription:
    """Build the graph of a fixed discretization; `mapping` is how terms are evaluated at many points."""
    build: Callable[..., Any] = Transcription if isinstance(problem, BoundaryProblem) else ControlTranscription
    return build(problem, _given(method), mesh_of(problem.t_span, intervals, mesh, problem.breakpoints), mapping)


def _refinement(problem: Any, *given: Any, mapping: PointMap = by_rows, starts: int = 1) -> Callable[..., Any]:
    """Refuse what does not fit; a function (problem, guess, first path, solver, verbose) -> path to the tolerance."""
    boundary = isinstance(problem, BoundaryProblem)
    made: Any = RepeatedRefinement if boundary else RepeatedOptimization
    return made(problem, *given, mapping if boundary else starts).found


def _given(method: Galerkin | None) -> Galerkin:
    """Refuse that neither a method nor a tolerance is given."""
    if method is None:
        raise TypeError("method must be a Galerkin, such as Galerkin(degree=4), got None; or give tol instead")
    return method


def _tolerance(
    method: object, tol: float | None, of: Quantity | None, limits: Limits | None, limited: bool
) -> float | None:
    """Refuse what no kind of problem takes, or limits where nothing is limited; the tolerance, if one is given."""
    check_method(method, optional=True)
    tolerance = None if tol is None else check_tolerance(tol)
    if limits is not None and not isinstance(limits, Limits):
        raise TypeError(f"limits must be Limits, such as Limits(intervals=500), got {limits!r}")
    if limits is not None and not limited:
        raise ValueError("limits stop a refinement: give tol with them")
    check_asked(of, tol)
    return tolerance


class AdaptiveTranscription(Generic[Answer]):
    """A boundary or control problem with a tolerance, solved often: each solve begins on the mesh of an earlier path.

    Parameters
    ----------
    problem : BoundaryProblem or ControlProblem
    tol : as for `solve`
    find : (problem, guess, first path, solver, verbose) -> the path of a problem that is varied from this one's

    Attributes
    ----------
    first : the first path that was found, whose mesh and degree later solves begin with; None before

    Raises
    ------
    TypeError, ValueError
        as for `transcribe`

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> swing = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + x[0] ** 4, (0, 1), start=[0.0], end=[1.0])
    >>> transcription = cg.transcribe(swing, tol=1e-9)
    >>> paths = [transcription.solve(end=[end]) for end in (1.0, 1.1, 1.2)]
    >>> all(path.error_estimate <= 1e-9 for path in paths), {len(path.t) for path in paths}
    (True, {7})

    An optimization, of which the cost is asked:

    >>> move = cg.ControlProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0], [0.0], [0.0],
    ...     force=lambda t, x, v, u: u, running_cost=lambda t, x, v, u: u**2 / 2, controls=1)
    >>> transcription = cg.transcribe(move, tol=1e-6, of=lambda path: path.cost)
    >>> [round(transcription.solve(end=[end]).asked, 5) for end in (1.0, 2.0)]
    [6.0, 24.0]
    """

    def __init__(self, problem: Any, tol: float, find: Callable[..., Answer]) -> None:
        self.problem, self.tol, self.find = problem, tol, find
        self.first: Answer | None = None

    @interrupts_raised()
    def solve(
        self,
        start: Sequence[float | None] | None = None,
        end: Sequence[float | None] | None = None,
        *,
        parameters: Sequence[float] | None = None,
        guess: Guess | None = None,
        t_span: Sequence[float] | None = None,
        solver: Solver | None = None,
        verbose: int = 0,
        **given: Any,
    ) -> Answer:
        """Solve for the path to the tolerance; whatever is left out is taken from the problem.

        Parameters
        ----------
        t_span : times of the ends, to which meshes are stretched
        start, end, parameters, solver, given : as for `Transcription.solve` or `ControlTranscription.solve`
        guess : the same.  From an earlier path of a boundary problem, with other ends, times or parameters, the path is
            followed to the new ones on its own mesh.  Where it is lost, it is a guess as any other; near a fold its
            `morse_index` tells whether it has changed its branch.  A control problem begins with the first path that
            was found, unless another guess is given
        verbose : 1 prints a line for each mesh and a summary, 2 also the solver's lines

        Raises
        ------
        LimitReached, ConjugatePointError, ConvergenceError, ValueError, TypeError
            as for `solve`
        """
        check_verbose(verbose)
        problem = self.problem.varied({"start": start, "end": end, "parameters": parameters, **given}, t_span)
        path = self.find(problem, guess, self.first, solver, verbose)
        self.first = self.first or path
        if verbose:
            print(path)
        return path

    def __repr__(self) -> str:
        """Say what was built, and what mesh is kept."""
        kind, size = type(self.problem).__name__, counted(self.problem.dimension, "component")
        kept = "nothing solved yet"
        if self.first is not None:
            degree, intervals = self.first.method.degree, counted(len(self.first.t) - 1, "interval")
            kept = f"first path of degree {degree} on {intervals}"
        return f"AdaptiveTranscription of a {kind} of {size}, tol={self.tol:g}: {kept}"


@overload
def transcribe(
    problem: BoundaryProblem, method: Galerkin, intervals: int | None = None, *, mesh: ArrayLike | None = None
) -> Transcription: ...


@overload
def transcribe(
    problem: ControlProblem | Phases, method: Galerkin, intervals: Any = None, *, mesh: ArrayLike | None = None
) -> ControlTranscription: ...


@overload
def transcribe(
    problem: BoundaryProblem,
    method: Galerkin | None = None,
    intervals: int | None = None,
    *,
    tol: float,
    **refined: Unpack[Refined],
) -> AdaptiveTranscription[Trajectory]: ...


@overload
def transcribe(
    problem: ControlProblem,
    method: Galerkin | None = None,
    intervals: int | None = None,
    *,
    tol: float,
    **refined: Unpack[Refined],
) -> AdaptiveTranscription[ControlTrajectory]: ...


def transcribe(
    problem: BoundaryProblem | ControlProblem | Phases,
    method: Galerkin | None = None,
    intervals: Any = None,
    *,
    mesh: ArrayLike | None = None,
    tol: float | None = None,
    of: Quantity | None = None,
    limits: Limits | None = None,
) -> Transcription | ControlTranscription | AdaptiveTranscription[Any]:
    """Build the graph of a problem once, to solve it often: with a fixed discretization, or to a tolerance.

    With `tol`, mesh and degree are those that the first path needed; they are adapted where they no longer serve.

    Parameters
    ----------
    problem : BoundaryProblem, ControlProblem or, without `tol`, Phases
    method : Galerkin
    intervals : number of equal intervals, or a list as for `solve`; or
    mesh : (N + 1,) joints from t_span[0] to t_span[1]
    tol : relative tolerance, as for `solve`, which also says what method, intervals and mesh then are
    of : the quantity that `tol` is the tolerance of, as for `solve`; default x
    limits : Limits that stop a refinement, by default after 120 s; only with `tol`

    Returns
    -------
    Transcription or ControlTranscription, with a tolerance AdaptiveTranscription, whose ``solve`` takes other ends,
    parameters, times and guesses

    Raises
    ------
    TypeError, ValueError
        naming what came and what was expected

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> fall = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 10 * x[0], (0, 1), start=[0.0], end=[0.0])
    >>> transcription = cg.transcribe(fall, cg.Galerkin(degree=2), intervals=4)
    >>> [float(transcription.solve(end=[height]).momentum[0, 0].round(6)) for height in (1.0, 2.0)]
    [6.0, 7.0]
    """
    check_kind(problem, BoundaryProblem, ControlProblem, Phases)
    tolerance = _tolerance(method, tol, of, limits, tol is not None)
    if tolerance is None:
        return _graph(problem, method, intervals, mesh)
    if isinstance(problem, Phases):
        check_kind(problem, BoundaryProblem)
    find = _refinement(problem, tolerance, method, intervals, mesh, limits or Limits(), of)
    return AdaptiveTranscription(problem, tolerance, find)


def solution_function(
    problem: BoundaryProblem | ControlProblem,
    method: Galerkin,
    intervals: int | None = None,
    *,
    mesh: ArrayLike | None = None,
    guess: Guess | None = None,
    solver: Solver | None = None,
) -> ca.Function:
    """Turn the solve into a CasADi Function of the data, to embed in larger graphs, to serialize, to map.

    The problem is solved once as it stands, so that one that cannot be solved is refused here and not in the middle
    of a larger calculation, and so that residuals can be measured by the sizes of their terms.

    Parameters
    ----------
    problem : BoundaryProblem or ControlProblem
    method : Galerkin
    intervals : number of equal intervals; or
    mesh : (N + 1,) joints from t_span[0] to t_span[1]
    guess : for the first solve, as for `Transcription.solve` and `ControlTranscription.solve`
    solver : for a ControlProblem ipopt, the default, fatrop or sqp; for a BoundaryProblem it is left out

    Returns
    -------
    For a BoundaryProblem, a Function (start, end, parameters, guess) -> (x, momentum, action), inputs by these names

    start, end : the components that the problem fixes, in their order; left out where it fixes none
    parameters : all; left out where the problem has none, or frees them
    guess : (d, N m + 1), values at all nodes, such as ``path.polynomial.values`` of an earlier path; those at fixed
        components are not used.  It chooses among several solutions, and has no derivative
    x, momentum : (d, N + 1), at the joints; a momentum under a constraint holds some of the constraint's impulse
    action : scalar

    It has derivatives.  C code cannot be generated from it, because CasADi's rootfinder `newton` has none.

    For a ControlProblem, a Function (start, end, start_velocity, end_velocity, parameters, guess, controls) -> (x, u,
    duration, cost)

    start_velocity, end_velocity : as start and end
    u : (n, N r), the controls at the quadrature points; (n, N) where they are held
    controls : as u, a guess such as ``path.control.values``
    duration, cost : scalars

    It has first derivatives, no second ones, with the bounds that act; they are not finite where a bound is met but
    hardly acts.  IPOPT around it takes ``{"hessian_approximation": "limited-memory"}``.  With fatrop, C code can be
    generated.

    The Function runs CasADi's Newton method, or the solver, and has none of the rescues of `solve`: the guess should
    be a path for data nearby.  Where residuals are above their roundoff floors or, of a ControlProblem, an equation or
    a bound is violated or the cost not stationary, all outputs are NaN, which IPOPT takes for a step too far.  They are
    NaN, too, where an input other than the guess is left out.  The Function does not see what else `solve` refuses,
    such as a singular Hessian.

    Raises
    ------
    ConvergenceError, ConjugatePointError, ValueError, TypeError
        as for `solve`; of a boundary problem also where `sensitivity` refuses the path

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> oscillator = lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * x[0] ** 2 / 2
    >>> problem = cg.BoundaryProblem(oscillator, (0, 1), start=[0.0], end=[1.0], parameters=[1.0])
    >>> f = cg.solution_function(problem, cg.Galerkin(degree=4), intervals=10)
    >>> path = cg.solve(problem, cg.Galerkin(degree=4), intervals=10)
    >>> float(f(start=[0], end=[2], parameters=[1], guess=path.polynomial.values)["x"][0, 5].full()[0, 0].round(6))
    1.139494
    """
    check_types(problem, method, BoundaryProblem, ControlProblem)
    if isinstance(problem, ControlProblem):
        solver = ipopt if solver is None else solver
        transcription: Any = _graph(problem, method, intervals, mesh)
        return control_function(transcription, transcription.solve(guess=guess, solver=solver), solver)
    if solver is not None:
        raise ValueError(f"the Function of a BoundaryProblem runs CasADi's Newton method, got solver={solver!r}")
    return boundary_function(problem, method, intervals, mesh, guess)


def sensitivity(path: Trajectory) -> Sensitivity:
    """Derivatives of a solution by the data of its problem, by one factorization and a back-substitution for each.

    Of the path of a BoundaryProblem, by parameters and ends, from its Hessian; of an optimum, also by velocities and
    bounds, from its optimality conditions with the bounds that act.  The derivative of a cost is that of the optimal
    cost, as which bounds act does not change to first order.

    Parameters
    ----------
    path : Trajectory of a BoundaryProblem or ControlTrajectory; found to a tolerance or on a fixed discretization

    Returns
    -------
    Sensitivity

    Raises
    ------
    TypeError, ValueError
        for what is no such path; of a BoundaryProblem for a path of given energy, and where ∂L/∂x or the force steps
        in x or v on the path, as with |x| or dry friction: the derivatives contain that impulse, which is in no
        Hessian; for an optimum that is a saddle or not determined to second order, or with a bound that is met but
        hardly acts, so that the derivatives on its two sides differ

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), start=[0.0], end=[1.0])
    >>> float(cg.sensitivity(cg.solve(problem, cg.Galerkin(degree=2), intervals=4)).x["end"][0, 1, 0].round(9))
    0.25
    """
    if isinstance(path, ControlTrajectory):
        if path.number is not None:
            raise ValueError("a phase has no derivatives of its own: ask the whole path")
        derivatives: Sensitivity = path.variations.sensitivity(path)
        return derivatives
    if not isinstance(path, Trajectory):
        raise TypeError(f"sensitivity takes a Trajectory, got {type(path).__name__}")
    return boundary_sensitivity(path)
