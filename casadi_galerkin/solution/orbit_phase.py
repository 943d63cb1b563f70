"""The phase of a periodic path of given energy, which may begin anywhere on its orbit.

It begins in the plane through the start of the guess, orthogonal to its velocity there, or where one component of its
start is given.  Either leaves two values for one momentum at the start, so that a path may come back reversed.
"""

from __future__ import annotations

import numpy as np

from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.problems.boundary_problem import BoundaryProblem


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
