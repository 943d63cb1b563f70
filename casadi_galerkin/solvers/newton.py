"""Newton's method with a line search that does not see the scaling of equations or unknowns.

The natural monotonicity test: P. Deuflhard, "Newton Methods for Nonlinear Problems", 2004, algorithm NLEQ-ERR.

A solution is accepted if every residual is within `ACCEPTED` times its own roundoff floor, eps times the sizes of
the terms it sums and of what the rounding of the unknowns themselves does to it, |H||ξ|, with H of the last iterate.
Where terms cancel within the derivatives of L, their sizes are not known, and the floor is measured.  A component that
is zero but for such rounding is set to zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from casadi_galerkin.calculus.roundoff import EPS, TINY, largest_of
from casadi_galerkin.functional.numbering import Data, Numbering
from casadi_galerkin.solvers.deadline import seconds_left
from casadi_galerkin.solvers.second_variation import SINGULAR, softest
from casadi_galerkin.solvers.stationarity import ACCEPTED, Iterate, Linearization, Stationarity, joined

NEWTON = "Newton"  # its report
NEARLY_CONVERGED = 1e-6  # relative step from which the next iterate can be at roundoff
QUADRATIC = 1e-3  # relative step from which convergence should be quadratic: it needs no line search
SHORT, CONTRACTION = 0.3, 0.25  # a shorter relative step is taken in full if the next one is smaller by this factor
STRONG_CONTRACTION = 0.1  # the factor for a long first step: from a straight line, all steps are long
SMALLEST_DAMPING = 1e-7
UNCHANGED = 1e-8  # change of ∇²S over its entries that may count as none
BLURRED = 1e-3  # part of a component that the rounding of its equations may change
LAST_STEPS = 10  # most steps once components that are rounding alone are set to zero: the path is near by then
DRIFT = 10.0  # bound of the second variation's change, over what the last two steps show; along families at most 0.7


class SolveFailure(Exception):
    """A solver's own report that it stopped; carries the last iterate."""

    def __init__(self, reason: str, unknowns: np.ndarray, iterations: int, singular: bool = False) -> None:
        super().__init__(reason)
        self.unknowns, self.iterations, self.singular = unknowns, iterations, singular


@dataclass(frozen=True)
class Solution:
    """A verified critical point.

    Attributes
    ----------
    unknowns : ξ
    data : what they were found for, where ends that are rounding alone are zero
    iterations : Newton (and IPOPT) iterations together
    residual : largest residual over its own roundoff floor
    report : what was used to find it
    action, momentum : S, and the momenta at the joints, component fastest
    regularity : second variation along a direction near the softest one, over a bound of the sum of its terms, for the
        last iterate's Hessian, less what the last step may have changed.  Far above zero the Hessian is regular; zero,
        a negative number or NaN tells nothing
    """

    unknowns: np.ndarray
    data: Data
    iterations: int
    residual: float
    report: str
    action: float
    momentum: np.ndarray
    regularity: float


def damped_newton(
    stationarity: Stationarity,
    guess: np.ndarray,
    data: Data,
    verbose: int = 0,
    max_iter: int = 200,
    linear_solver: str | None = None,
) -> Solution:
    """Newton's method with natural monotonicity line search.

    A short full step is accepted at once if the next one is much shorter, which needs no solution beyond the next
    iteration's own.  Where steps are long or shrink by less, full ones were measured to jump to other paths.

    Arguments and failures are those of a `Solver`.
    """
    with stationarity.linearization(linear_solver) as linear:
        try:
            return _iterate(linear, guess, data, verbose, max_iter)
        except SolveFailure as failure:
            at = linear.newton_step(failure.unknowns, data)
            every = np.ones(stationarity.functional.numbering.dimension, dtype=bool)
            solution = _with_zero_components(linear, at, data, failure.iterations, every)
            if solution is None:
                raise
            return solution


def _iterate(linear: Linearization, guess: np.ndarray, data: Data, verbose: int, max_iter: int) -> Solution:
    at, damping = linear.newton_step(guess, data), 1.0
    if not (math.isfinite(at.norm) or np.isfinite(linear.gradient).all()):
        raise SolveFailure("the gradient of the action is not finite at the guess", guess, 0)
    last = math.sqrt(at.norm)  # the first step is taken for one of quadratic convergence
    for iteration in range(1, max_iter + 1):
        _check_going_on(linear, at, iteration)
        end = _final_iterate(linear, at, last, data)
        if end is not None:
            drift = DRIFT * (at.norm + min(1.0, at.norm / max(last, TINY)) ** 2)
            solution = verified(linear, end, data, iteration, NEWTON, drift)
            if solution is not None:
                _report(iteration, at.norm, damping, verbose)
                return solution
        if at.norm >= last / 2:
            solution = _with_rounded_components(linear, at, data, iteration)
            if solution is not None:
                return solution
        last, whole = at.norm, None
        if damping == 1.0 and (at.norm < SHORT or iteration == 1):
            whole = linear.newton_step(at.unknowns + at.step, data)
        if whole is not None and _contracts(last, whole.norm):
            trial, forecast = whole, 1.0
        else:
            linear.return_to(at)
            x, simplified, damping = _line_search(linear, at, damping, data, iteration)
            trial = whole if whole is not None and damping == 1.0 else linear.newton_step(x, data)
            linear.return_to(trial)
            forecast = min(1.0, damping * _forecast(at.step, simplified, trial))
        _report(iteration, last, damping, verbose)
        at, damping = trial, forecast
    reason = f"no convergence in {max_iter} iterations, last relative step {at.norm:.1e}"
    raise _failed(linear, at, data, max_iter, reason)


def _contracts(norm: float, then: float) -> bool:
    """Whether a full step is accepted for the length of the next one, without a line search."""
    if norm < QUADRATIC:
        return math.isfinite(then)
    return then <= norm * (CONTRACTION if norm < SHORT else STRONG_CONTRACTION)


def _with_rounded_components(linear: Linearization, at: Iterate, data: Data, iterations: int) -> Solution | None:
    """The solution where only some components still change, by what rounding does to them; None otherwise."""
    going = _still_changing(linear.stationarity.functional.numbering, at)
    if np.all(going):
        return None
    solution, x = _with_zero_components(linear, at, data, iterations, going), at.unknowns + at.step
    if solution is not None:
        return solution
    linear.return_to(at)
    blurred = _blurred(linear, x, data, _rounding_floors(linear, x, data)[2])
    return verified(linear, x, data, iterations, NEWTON, DRIFT) if blurred <= BLURRED else None


def _with_zero_components(
    linear: Linearization, at: Iterate, data: Data, iterations: int, candidates: np.ndarray
) -> Solution | None:
    """Solve with those components set to zero that are zero but for rounding; None if there are none, or it fails.

    Where a component should be zero, but terms of other components cancel in its equations, rounding keeps it from
    being zero, and its steps are never small relative to its size.  The same happens with given ends such as sin(π),
    which are then set to zero, too.  Of the `candidates`, (d,), it is tried whether they are such components.  They
    are if their equations hold up to rounding where they are zero, and if that changes ∇²S by no more than `UNCHANGED`,
    so that the solution with zeros is the one that Newton's method is near.
    """
    if not math.isfinite(at.norm):
        return None
    resting = _resting(linear.stationarity.functional.numbering, data)
    nothing, data = _zero_components(linear, at.unknowns, data, candidates, resting)
    if not np.any(nothing):
        return None
    zeroed = linear.newton_step(np.where(nothing, 0.0, at.unknowns), data)
    if not _same_matrix(linear, zeroed.matrix, at.matrix):
        return None
    for _ in range(LAST_STEPS):
        if not math.isfinite(zeroed.norm):
            return None
        x = np.where(nothing, 0.0, zeroed.unknowns + zeroed.step)
        if np.max((np.abs(zeroed.step) / zeroed.sizes)[~nothing], initial=0.0) ** 2 <= EPS:
            gradient, floor, least = _rounding_floors(linear, x, data, resting)
            action, momentum, _, regularity = linear.verification(x, data)
            residual = float(np.max(np.abs(gradient) / np.where(nothing, least, floor)))
            solution = Solution(x, data, iterations, residual, NEWTON, action, momentum, regularity)
            return solution if residual <= ACCEPTED else None
        zeroed = linear.newton_step(x, data)
    return None


def _resting(numbering: Numbering, data: Data) -> np.ndarray:
    """Which components have given ends that are exactly zero, if any; (d,)."""
    ends = np.abs(np.concatenate(data[:2]))
    return largest_of(ends, numbering.component[numbering.free :], numbering.dimension) == 0


def _zero_components(
    linear: Linearization, x: np.ndarray, data: Data, candidates: np.ndarray, resting: np.ndarray
) -> tuple[np.ndarray, Data]:
    """Which unknowns belong to candidates whose equations hold where all of these are zero, and data with zero ends.

    Given ends count as zero where they are not larger than what rounding of the equations does to the component.
    """
    numbering, chosen, u = linear.stationarity.functional.numbering, candidates.copy(), joined(x, data)
    component, free = numbering.component, numbering.free
    while np.any(chosen):
        nothing = chosen[component]
        nothing[numbering.positions : free] = False
        unknowns, *ends = numbering.parted(np.where(nothing, 0.0, u))
        zeroed = (*ends, *data[2:])
        gradient, _, least = _rounding_floors(linear, unknowns, zeroed, resting)
        effects = np.abs(linear.rounding_effects(least)).max(axis=0)
        large = effects > math.sqrt(EPS)  # of a number of size one: by what steps at zero, as a kink
        missed = (np.abs(gradient) > ACCEPTED * least) | (resting[component[:free]] & large)
        blurred = ACCEPTED * _of_components(numbering, effects)
        failed = nothing & np.append(missed, np.abs(u[free:]) > blurred[component[free:]])
        if not np.any(failed):
            return nothing[:free], zeroed
        chosen[component[failed]] = False
    return np.zeros(free, dtype=bool), data


def _rounding_floors(
    linear: Linearization, x: np.ndarray, data: Data, resting: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """∇S, the roundoff floors of its entries, and those that include the rounding within the derivatives of L; (n,).

    Of the latter, all equations of a component have the largest.  For `resting` see `rounding_samples`.
    """
    numbering = linear.stationarity.functional.numbering
    gradient, floor = linear.stationarity.gradient_and_floor(x, data)
    least = np.fmax(floor, np.abs(linear.rounding_samples(x, data, resting)).max(axis=0))
    least[: numbering.positions] = _of_components(numbering, least)[numbering.component[: numbering.positions]]
    return gradient, floor, least


def _blurred(linear: Linearization, x: np.ndarray, data: Data, floors: np.ndarray) -> float:
    """Largest change of an unknown, over its size, by errors of the equations as large as these floors."""
    return float(np.max(np.abs(linear.rounding_effects(floors)) / linear.stationarity.sizes(x, data), initial=0.0))


def _same_matrix(linear: Linearization, matrix: np.ndarray, other: np.ndarray) -> bool:
    """Whether the nonzeros of two ∇²S differ by at most `UNCHANGED` of the largest entries of their components."""
    functional = linear.stationarity.functional
    numbering, d = functional.numbering, functional.numbering.dimension
    row, column = (np.array(index, dtype=int) for index in functional.sparsity.get_triplet())
    along = np.fmax(row, column) < numbering.positions
    block = numbering.component[row[along]] * d + numbering.component[column[along]]
    entries, changes = (
        largest_of(np.abs(values[along]), block, d * d).reshape(d, d) for values in (matrix, matrix - other)
    )
    sizes = np.sqrt(np.diag(entries))
    return bool(np.all(changes <= UNCHANGED * np.outer(sizes, sizes)))


def _of_components(numbering: Numbering, values: np.ndarray) -> np.ndarray:
    """Largest of the values (n,) that belong to each component of the path; (d,)."""
    count = numbering.positions
    return largest_of(values[:count], numbering.component[:count], numbering.dimension)


def _still_changing(numbering: Numbering, at: Iterate) -> np.ndarray:
    """Which components a Newton step still changes by so much that the next one would not be roundoff; (d,)."""
    return _of_components(numbering, np.abs(at.step) / at.sizes) ** 2 > EPS


def _check_going_on(linear: Linearization, at: Iterate, iteration: int) -> None:
    """Stop where there is no step, or no time."""
    if not math.isfinite(at.norm):
        finite = bool(np.isfinite(linear.matrix).all())
        what = "singular" if finite else "not finite"
        raise SolveFailure(f"the Hessian of the action is {what}", at.unknowns, iteration, singular=finite)
    if seconds_left() < 0:
        raise SolveFailure("the time was up", at.unknowns, iteration)


def _report(iteration: int, norm: float, damping: float, verbose: int) -> None:
    if verbose > 1:
        print(f"  {iteration:4d}   step {norm:9.2e}   damping {damping:7.1e}")


def _final_iterate(linear: Linearization, at: Iterate, last: float, data: Data) -> np.ndarray | None:
    """The point where Newton's method may end, or None: after a step that is roundoff, or whose next one would be.

    Residuals alone do not tell: at 1e5 intervals they are at roundoff while the path is off by 1e-9.  Nor does the
    ratio of the last two steps, which may be of different components: the next step is expected to be no shorter than
    the square of this one.
    """
    if at.norm < NEARLY_CONVERGED:
        shrinks = at.norm**2 <= EPS and at.norm**3 <= EPS * last**2
        return at.unknowns + at.step if shrinks or at.norm >= last / 2 else None
    if not (last < QUADRATIC and last <= at.norm):
        return None
    # A nearly singular Hessian makes steps of this length out of roundoff: right but for the softest direction.
    soft, quotient = softest(linear, at.unknowns, data)
    if quotient > max(SINGULAR, EPS / at.norm):
        return None
    with np.errstate(over="ignore", invalid="ignore"):  # of a singular Hessian it may be of any size
        soft, step = soft / at.sizes, at.step / at.sizes
        return at.unknowns + at.sizes * (step - soft * ((soft @ step) / max(soft @ soft, TINY)))


def _forecast(step: np.ndarray, simplified: np.ndarray, now: Iterate) -> float:
    """Factor on the last damping (Deuflhard, eq. 3.47)."""
    if not math.isfinite(now.norm):
        return 1.0  # the next iteration ends with that
    before, after, nonlinearity = (
        np.abs(np.array((step, simplified, simplified - now.step)) / now.sizes).max(axis=1).tolist()
    )
    return float(before * after / max(nonlinearity * now.norm, TINY))


def _line_search(
    linear: Linearization, at: Iterate, damping: float, data: Data, iteration: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Damp the step until the simplified step from its end is shorter; returns that end, that step and the damping."""
    while damping >= SMALLEST_DAMPING:
        trial = at.unknowns + damping * at.step
        simplified, length, nonlinearity = linear.simplified_step(trial, data, at, damping)
        if length <= (1 - damping / 4) * at.norm:
            return trial, simplified, damping
        # half of it where the nonlinearity is not a number
        damping = min(damping / 2, at.norm * damping**2 / (2 * max(nonlinearity, TINY)))
    raise _failed(linear, at, data, iteration, "the line search found no step that comes nearer to a solution")


def _failed(linear: Linearization, at: Iterate, data: Data, iteration: int, reason: str) -> SolveFailure:
    """Report why there is no solution: a singular Hessian, whose steps are anything, or else another reason."""
    if softest(linear, at.unknowns, data)[1] < SINGULAR:
        return SolveFailure("the Hessian of the action is singular", at.unknowns, iteration, singular=True)
    numbering = linear.stationarity.functional.numbering
    going, sizes = _still_changing(numbering, at), _of_components(numbering, at.sizes)
    if np.any(going) and not np.all(going) and at.norm < SHORT:
        rest = ", ".join(f"x[{i}], of size {sizes[i]:.1e}" for i in np.flatnonzero(going))
        reason += f", though all has converged but {rest}: rounding of the others may be all that moves it"
        reason += ", and where an end of it is meant to be zero, give exactly 0"
    return SolveFailure(reason, at.unknowns, iteration)


def verified(
    linear: Linearization, x: np.ndarray, data: Data, iterations: int, report: str, drift: float = 0.0
) -> Solution | None:
    """Judge the residuals at x by their roundoff floors: a solution, or None.

    Where they are above the floors of the terms, by the measured ones, if these leave at least three digits of x.
    Hessian and softest direction are those of the last `newton_step`, at x or before a step that changed the second
    variation by up to `drift` of its terms.
    """
    action, momentum, residual, regularity = linear.verification(x, data)
    if residual > ACCEPTED:
        gradient, _, least = _rounding_floors(linear, x, data)
        if not _blurred(linear, x, data, least) <= BLURRED:
            return None
        residual, regularity = float(np.max(np.abs(gradient) / least)), 0.0
    if not residual <= ACCEPTED:
        return None
    return Solution(x, data, iterations, residual, report, action, momentum, regularity - drift)
