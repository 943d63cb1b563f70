"""Guesses in all their forms as arrays of node values, random guesses, and the phase that a guess fixes.

A periodic path of given energy may begin anywhere on its orbit.  It begins in the plane through the start of the guess,
orthogonal to its velocity there, or where one component of its start is given.  Either leaves two values for one
momentum at the start, so that a path may come back reversed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus, time_scale
from casadi_galerkin.calculus.numbers import counted, real_array
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.roundoff import EPS, component_sizes
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.solution.path import Path

MODES = 6  # number of waves of a random path
FAR_FROM_GUESS = 0.5  # distance from a guess, over its size, above which a path counts as another one

Values = Callable[[float], ArrayLike] | ArrayLike
Guess = Values | Path | PiecewisePolynomial | tuple[Values | Path | PiecewisePolynomial, Values]  # times, or controls


def sampled(name: str, function: Callable[[float], ArrayLike], times: np.ndarray, dimension: int) -> np.ndarray:
    """Values (d, K) of a path that is given as a callable, called once for every time."""
    values = np.empty((dimension, len(times)))
    for k, t in enumerate(times.tolist()):
        try:
            value = function(t)
        except Exception as error:
            kind = TypeError if isinstance(error, TypeError) else ValueError
            raise kind(f"{name} failed at t = {t}: {error}") from error
        column = real_array(f"values of {name}", value)
        if column.shape != (dimension,):
            raise ValueError(f"{name} must return an array of shape ({dimension},), got {column.shape} at t = {t}")
        values[:, k] = column
    return values


def meeting_ends(values: np.ndarray, parts: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Bend a guess (K, d) to meet the fixed ends (2, d) by adding a straight line.

    A component that is free at one end, NaN there, is moved as at the other end; one that is free at both ends is not
    changed.  `parts` (K,) are the times as fractions of the duration, from 0 to 1.
    """
    moves = ends - values[:: len(values) - 1]
    moves = np.where(np.isnan(moves), moves[::-1], moves)
    moves[np.isnan(moves)] = 0.0
    first, last = moves
    return values + first + parts[:, None] * (last - first)


def relative_distance(values: np.ndarray, guessed: np.ndarray) -> float:
    """Largest distance of node values (d, K) from those of a guess, over the sizes of the guess's components."""
    return float(np.max(np.abs(values - guessed) / component_sizes(guessed)[:, None]))


def guess_values(guess: Guess | None, calculus: DiscreteCalculus, dimension: int) -> np.ndarray:
    """Values (d, N m + 1) of a guess as it was given, or zeros; refuses what does not fit or is not finite."""
    mesh, times, nodes, d = calculus.mesh, calculus.node_times, calculus.method.element.nodes, dimension
    if guess is None:
        return np.zeros((d, len(times)))
    if isinstance(guess, tuple) and len(guess) == 2:
        guess = joined_by_lines(*guess, d)
    elif isinstance(guess, Path):
        guess = guess.polynomial
    elif isinstance(guess, list) and any(map(callable, guess)):
        raise TypeError("a pair as guess, such as (path, controls), must be a tuple, got a list")
    elif not callable(guess):
        array = real_array("the guess", guess)
        if array.shape not in ((d, len(mesh)), (d, len(times))):
            raise ValueError(
                f"the guess must have the shape ({d}, {len(mesh)}) for values at the joints or ({d}, {len(times)}) at "
                f"all nodes, got {array.shape}; a pair (times, values) fits any mesh, for a control problem "
                "((times, values), None)"
            )
        guess = PiecewisePolynomial(mesh, nodes if array.shape[1] == len(times) else np.array([0.0, 1.0]), array)
    if not isinstance(guess, PiecewisePolynomial):
        values = sampled("the guess", guess, times, d)
    elif len(guess.values) != d:
        raise ValueError(f"the guess must be a path of {counted(d, 'component')}, got {len(guess.values)}")
    elif np.array_equal(guess.mesh, mesh) and np.array_equal(guess.nodes, nodes):
        values = guess.values
    else:
        first, last = guess.mesh[[0, -1]]
        same = first == times[0] and last == times[-1]
        values = guess(times if same else first + calculus.node_parts * (last - first))
    check_finite_values("the guess", values, times)
    return values


def check_finite_values(name: str, values: np.ndarray, times: np.ndarray) -> None:
    """Refuse values (d, K) of a path that are not finite."""
    finite = np.isfinite(values).all(axis=0)
    if not finite.all():
        i = int(np.argmin(finite))
        raise ValueError(f"{name} must be finite, got {values[:, i]} at t = {times[i]:.6g}")


def waves(random: np.random.Generator, sizes: np.ndarray, period: float = 2.0) -> Callable[[ArrayLike], np.ndarray]:
    """A random smooth path, a sum of cosines of decreasing amplitude, as a function of fractions of the duration.

    Parameters
    ----------
    random : generator of amplitudes and phases
    sizes : (d,), sizes of the components
    period : period of the longest wave, over the duration

    Returns
    -------
    callable, fractions -> (d,) + fractions.shape
    """
    shape, modes = (len(sizes), MODES), np.arange(1, MODES + 1)
    factors = sizes[:, None] * random.normal(size=shape) / modes
    phases = random.uniform(0, 2 * np.pi, size=shape)

    def path(parts: ArrayLike) -> np.ndarray:
        angles = np.multiply.outer(2 * np.pi / period * modes, parts)
        shifts = phases.reshape(*shape, *[1] * np.ndim(parts))
        return np.einsum("dk,dk...->d...", factors, np.cos(angles + shifts))

    return path


def joined_by_lines(times: Any, values: Any, dimension: int) -> PiecewisePolynomial:
    """Values (d, K) of a guess at increasing times (K,), joined by straight lines."""
    try:
        joints = time_scale(times)
    except (TypeError, ValueError) as error:
        raise type(error)(f"a pair as guess is (times, values), and its times are no mesh: {error}") from None
    given = real_array("the values of the guess", values)
    if given.shape != (dimension, len(joints)):
        raise ValueError(
            f"a pair as guess is (times, values) with values of shape ({dimension}, {len(joints)}) for "
            f"{len(joints)} times, got {given.shape}"
        )
    return PiecewisePolynomial(joints, np.array([0.0, 1.0]), given)


def refuse_free_phase(name: str, problem: BoundaryProblem) -> None:
    """Refuse a problem with a free phase where there is no guess that fixes it; `name` is what refuses it."""
    if problem.free_phase:
        raise ValueError(
            f"{name} takes no periodic problem of given energy: its paths have a phase that only a guess fixes; give "
            "one component of start"
        )


def phase_plane(path: PiecewisePolynomial) -> np.ndarray:
    """Normal and point, (2d,), of the plane through the start of a path, orthogonal to its scaled velocity."""
    sizes = path.sizes
    speeds = np.linalg.norm(path(path.mesh, 1) / sizes[:, None], axis=0)
    if not speeds[0] > np.sqrt(EPS) * np.max(speeds):  # else half of the phase is rounding
        raise ValueError(
            "a periodic path of given energy needs a guess that moves at its start, got one that rests there: its "
            "duration and its phase follow from the guess"
        )
    normal = path(path.mesh[0], 1) / sizes**2
    return np.concatenate((normal / np.linalg.norm(normal), path.values[:, 0]))


def turned_back(problem: BoundaryProblem, path: PiecewisePolynomial, plane: np.ndarray | None) -> str | None:
    """The message that a periodic path of given energy returns to its start with reversed velocity; else None.

    The phase is fixed by a plane or by the one given component of the start.  All other momenta are equal at both ends,
    and the given energy leaves two values for the momentum across the plane or of the component.  Where that momentum
    has changed its sign, the multiplier of the plane, or of the component, is not zero.
    """
    if not problem.periodic or problem.energy is None:
        return None
    fixed = np.array([value is not None for value in problem.start])
    if plane is None and np.count_nonzero(fixed) != 1:
        return None
    normal = fixed if plane is None else plane[: len(fixed)]
    left, back = normal @ path(path.mesh[[0, -1]], 1)
    if left * back > 0:
        return None
    return (
        "the path found is not periodic: it comes back to its start against the way it left. Give a guess of a whole "
        "turn that starts further from a turning point, where it moves faster"
    )
