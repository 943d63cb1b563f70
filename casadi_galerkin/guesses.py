"""What a user gives beside the problem: a method, a mesh, and a guess in any of its forms, as arrays."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus import DiscreteCalculus, Galerkin, time_scale
from casadi_galerkin.polynomial import PiecewisePolynomial
from casadi_galerkin.quadrature import real_array
from casadi_galerkin.trajectory import Trajectory

Guess = Callable[[float], ArrayLike] | ArrayLike | Trajectory | PiecewisePolynomial


def check_types(problem: object, method: object, *kinds: type) -> None:
    """Refuse what is no problem of these kinds, or no method."""
    if not isinstance(problem, kinds):
        expected = " or ".join(kind.__name__ for kind in kinds)
        raise TypeError(f"problem must be a {expected}, got {type(problem).__name__}")
    if not isinstance(method, Galerkin):
        raise TypeError(f"method must be a Galerkin, such as Galerkin(degree=4), got {method!r}")


def mesh_of(t_span: tuple[float, float], intervals: int | None, mesh: ArrayLike | None) -> np.ndarray:
    """Joints from a number of equal intervals, or from the joints themselves; exactly one must be given."""
    if (intervals is None) == (mesh is None):
        raise ValueError(f"give either intervals or mesh, got intervals={intervals!r} and mesh={mesh!r}")
    if mesh is None:
        if isinstance(intervals, bool) or not isinstance(intervals, (int, np.integer)):
            raise TypeError(f"intervals must be a whole number, got {intervals!r}")
        if intervals < 1:
            raise ValueError(f"intervals must be at least 1, got {intervals}")
        return time_scale(np.linspace(*t_span, int(intervals) + 1))
    joints = time_scale(mesh)
    if (joints[0], joints[-1]) != t_span:
        raise ValueError(f"the mesh must run from {t_span[0]} to {t_span[1]}, got {joints[0]} to {joints[-1]}")
    return joints


def sampled(name: str, function: Callable[[float], ArrayLike], times: np.ndarray, dimension: int) -> np.ndarray:
    """Values (d, K) of a path that is given as a callable."""
    columns = [real_array(f"values of {name}", function(float(t))) for t in times]
    shapes = {column.shape for column in columns}
    if shapes != {(dimension,)}:
        raise ValueError(f"{name} must return an array of shape ({dimension},), got {shapes.pop()}")
    return np.stack(columns, axis=1)


def given_values(guess: Guess, calculus: DiscreteCalculus, dimension: int) -> np.ndarray:
    """Values (d, N m + 1) of a guess as it was given; refuses what does not fit or is not finite."""
    values = _values(guess, calculus, dimension)
    finite = np.isfinite(values)
    if np.count_nonzero(finite) < finite.size:  # a third of the time that `all` takes
        i = int(np.argmin(finite.all(axis=0)))
        raise ValueError(f"the guess must be finite, got {values[:, i]} at t = {calculus.node_times[i]}")
    return values


def _values(guess: Guess, calculus: DiscreteCalculus, dimension: int) -> np.ndarray:
    times, d = calculus.node_times, dimension
    if isinstance(guess, (Trajectory, PiecewisePolynomial)):
        path = guess.path if isinstance(guess, Trajectory) else guess
        old = path.mesh
        if len(path.values) != d:
            raise ValueError(f"the guess must be a path of {d} component(s), got {len(path.values)}")
        same = old[0] == times[0] and old[-1] == times[-1]
        stretched = old[0] + calculus.node_parts * (old[-1] - old[0])
        return path(times if same else np.clip(stretched, old[0], old[-1]))
    if callable(guess):
        return sampled("the guess", guess, times, d)
    array = real_array("the guess", guess)
    if array.shape == (d, len(times)):
        return array
    if array.shape == (d, len(calculus.mesh)):
        return np.stack([np.interp(times, calculus.mesh, row) for row in array])
    raise ValueError(
        f"the guess must have the shape ({d}, {len(calculus.mesh)}) for values at the joints or "
        f"({d}, {len(times)}) at all nodes, got {array.shape}"
    )
