"""Newton's method for ∇S = 0 with an affine-invariant line search, and the verification of its answer.

The natural monotonicity test: P. Deuflhard, "Newton Methods for Nonlinear Problems", 2004, algorithm NLEQ-ERR.  Where
it ends, Newton's method begins again from the guess with free steps, which are no longer than the guess itself: on 7
families of random problems this led to paths from 165 of 224 straight or noisy lines, and line searches to 123.

A solution is accepted if every residual is within `ACCEPTED` times its own roundoff floor, eps times the sizes of
the terms it sums and of what the rounding of the unknowns themselves does to it, |H||ξ|, with H of the last iterate.
The equations of a component are rounded like those of the component that matters most for the energy: with stiffnesses
K on the diagonal of H, it would matter as much at the size max_d √K_d ‖x_d‖ / √K_c.  It is measured by √eps times that
size at least, and is set to zero where it is not above rounding of it, `ROUNDED`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from casadi_galerkin.calculus.roundoff import EPS, TINY
from casadi_galerkin.functional.numbering import Data
from casadi_galerkin.solvers.deadline import seconds_left
from casadi_galerkin.solvers.second_variation import SINGULAR, smallest_curvature
from casadi_galerkin.solvers.stationarity import ACCEPTED, Iterate, Linearization, Stationarity, joined

NEWTON = "Newton"  # its report
QUADRATIC = 1e-3  # relative step from which convergence should be quadratic: it needs no line search
CONTRACTION = 0.25  # a full step is taken if the next one is as much shorter; with 0.1 half of all solves search lines
SMALLEST_DAMPING = EPS**0.5
POLISHING = 20  # most iterations from where another search stopped; with more it wanders, 4 times as long
SEARCH_ITERATIONS = 50  # most of other searches; with 200, free steps led to 180 paths for 165, in twice the time
ROUNDED = 4 * EPS  # size of a component, over that at which it would matter, up to which it is zero
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
    data : what they were found for, where ends that are zero to rounding error are zero
    iterations : Newton (and IPOPT) iterations together
    residual : largest residual over its own roundoff floor
    report : what was used to find it
    action, momentum : S, and the momenta at the joints, component fastest
    regularity : second variation along a direction near that of smallest curvature, over a bound of the sum of its
        terms, for the last iterate's Hessian, less what the last step may have changed; times the size of the least
        component over that at which it would matter.  Rounding changes the path by about eps over that; zero, a
        negative number or NaN tells nothing
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
    """Newton's method with natural monotonicity line search; where that ends, from the guess again with free steps.

    Arguments and failures are those of a `Solver`.
    """
    with stationarity.linearization(linear_solver) as linear:
        try:
            return _iterate(linear, guess, data, verbose, max_iter, _monotone_step)
        except SolveFailure as failure:
            first, left = failure, min(max_iter - failure.iterations, SEARCH_ITERATIONS)
            if failure.iterations == 0 or left == 0 or seconds_left() < 0:
                raise
        try:
            found = _iterate(linear, guess, data, verbose, left, _free_step)
        except SolveFailure as failure:
            first.iterations += failure.iterations
            raise first from None
        return replace(found, iterations=first.iterations + found.iterations)


def polished(
    stationarity: Stationarity, found: np.ndarray, data: Data, verbose: int, name: str, iterations: int, status: str
) -> Solution:
    """The verified solution near where the search of a `name` has stopped; a status says that it found none."""
    words = f"{name} stopped with '{status}'" if status else name
    if not np.isfinite(found).all():
        raise SolveFailure(f"{words} at a point that is not finite", np.nan_to_num(found), iterations)
    try:
        solution = damped_newton(stationarity, found, data, verbose, POLISHING)
    except SolveFailure as failure:
        words += f", then Newton's method: {failure}"
        raise SolveFailure(words, found, iterations, failure.singular and not status) from None
    return replace(solution, iterations=iterations + solution.iterations, report=f"{name}, then Newton")


def _iterate(
    linear: Linearization,
    guess: np.ndarray,
    data: Data,
    verbose: int,
    max_iter: int,
    search: Callable[..., tuple[Iterate, float, float]],
) -> Solution:
    """Newton's method with the steps of a search."""
    at, damping, forecast = linear.newton_step(guess, data), 1.0, 1.0
    if not (math.isfinite(at.norm) or np.isfinite(linear.relinearize(guess, data)).all()):
        raise SolveFailure("the gradient of the action is not finite at the guess", guess, 0)
    last = math.sqrt(at.norm)  # the first step is taken for one of quadratic convergence
    for iteration in range(1, max_iter + 1):
        if verbose > 1:
            print(f"  {iteration:4d}   step {at.norm:9.2e}   damping {damping:7.1e}")
        if not math.isfinite(at.norm):
            finite = bool(np.isfinite(linear.matrix).all())
            words = f"the Hessian of the action is {'singular' if finite else 'not finite'}"
            raise SolveFailure(words, at.unknowns, iteration, singular=finite)
        if seconds_left() < 0:
            raise SolveFailure("the time was up", at.unknowns, iteration)
        end = _final_iterate(linear, at, last, data)
        if end is not None:
            drift = DRIFT * (at.norm + min(1.0, at.norm / max(last, TINY)) ** 2)
            solution = verified(linear, end, data, iteration, NEWTON, drift)
            if solution is not None:
                return solution
        last = at.norm
        at, damping, forecast = search(linear, at, forecast, data, iteration)
    reason = f"no convergence in {max_iter} iterations, last relative step {at.norm:.1e}"
    raise _failed(linear, at, data, max_iter, reason)


def _monotone_step(
    linear: Linearization, at: Iterate, damping: float, data: Data, iteration: int
) -> tuple[Iterate, float, float]:
    """The next iterate by natural monotonicity, its damping, and the one to begin with next.

    A full step is accepted at once if the next one is much shorter, which needs no solution beyond the next iteration's
    own.  Where steps shrink by less, full ones were measured to jump to other paths.
    """
    whole = None
    if damping == 1.0:
        whole = linear.newton_step(at.unknowns + at.step, data)
        if whole.norm <= CONTRACTION * at.norm or (at.norm < QUADRATIC and math.isfinite(whole.norm)):
            return whole, 1.0, 1.0
    x, simplified, damping = _line_search(linear, at, damping, data, iteration)
    trial = whole if whole is not None and damping == 1.0 else linear.newton_step(x, data)
    return trial, damping, min(1.0, damping * _forecast(at.step, simplified, trial))


def _free_step(
    linear: Linearization, at: Iterate, longest: float, data: Data, iteration: int
) -> tuple[Iterate, float, float]:
    """The next iterate by the Newton step, wherever it leads, but no longer than the guess; see `_monotone_step`.

    Monotone steps stay near the guess, but end wherever the Hessian is singular on the way.
    """
    longest = (at.length or at.step_length) if iteration == 1 else longest
    damping = min(1.0, longest / max(at.step_length, TINY))
    return linear.newton_step(at.unknowns + damping * at.step, data), damping, longest


def _final_iterate(linear: Linearization, at: Iterate, last: float, data: Data) -> np.ndarray | None:
    """The point where Newton's method may end, or None: after a step that is roundoff, or whose next one would be.

    Residuals alone do not tell: at 1e5 intervals they are at roundoff while the path is off by 1e-9.  Nor does the
    ratio of the last two steps, which may be of different components: the next step is expected to be no shorter than
    the square of this one.  Short steps that hardly shrink may be roundoff, over a small second variation of any length
    next to a conjugate point: they are right but for the direction of smallest curvature.  At kinks, they are not.
    """
    stays = last / 2 <= at.norm
    if at.norm**2 <= EPS and (stays or at.norm**3 <= EPS * last**2):
        return at.unknowns + at.step
    if not stays or last > QUADRATIC:
        return None
    direction, quotient = smallest_curvature(linear, at.unknowns, data)
    if quotient * at.norm > SINGULAR:  # of rounding it was at most 90 eps, at kinks 1e8 eps
        return None
    with np.errstate(over="ignore", invalid="ignore"):  # of a singular Hessian it may be of any size
        direction, step = direction / at.sizes, at.step / at.sizes
        return at.unknowns + at.sizes * (step - direction * ((direction @ step) / max(direction @ direction, TINY)))


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
    if smallest_curvature(linear, at.unknowns, data)[1] < SINGULAR:
        return SolveFailure("the Hessian of the action is singular", at.unknowns, iteration, singular=True)
    return SolveFailure(reason, at.unknowns, iteration)


def verified(
    linear: Linearization, x: np.ndarray, data: Data, iterations: int, report: str, drift: float = 0.0
) -> Solution | None:
    """Judge the residuals at x by their roundoff floors: a solution, or None.

    Hessian and direction of smallest curvature are those of the last `newton_step`, at x or before a step that changed
    the second variation by up to `drift` of its terms.  Components that are `ROUNDED` are set to zero, with their ends,
    if that is a solution as well.
    """
    action, momentum, residual, regularity, importance = linear.verification(x, data)
    if not residual <= ACCEPTED:
        return None
    rounded = (importance > 0) & (importance <= ROUNDED)
    if np.any(rounded):
        numbering, u = linear.stationarity.functional.numbering, joined(x, data)
        along = np.where(rounded[numbering.component], 0.0, u)
        along[numbering.positions : numbering.free] = u[numbering.positions : numbering.free]
        unknowns, *ends = numbering.parted(along)
        zeroed = verified(linear, unknowns, (*ends, *data[2:]), iterations, report, drift)
        if zeroed is not None:
            return zeroed
    least = np.min(importance, where=importance > 0, initial=1.0)
    return Solution(x, data, iterations, residual, report, action, momentum, float(least * (regularity - drift)))
