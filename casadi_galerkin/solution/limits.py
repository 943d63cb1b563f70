"""The public `Limits`: how many intervals and seconds a solve to a tolerance may take."""

from __future__ import annotations

from dataclasses import dataclass

from casadi_galerkin.calculus.numbers import number


@dataclass(frozen=True)
class Limits:
    """Limits at which a refinement stops if it has not reached its tolerance; ``math.inf`` is no limit.

    Parameters
    ----------
    intervals : largest number of intervals of a mesh
    seconds : longest time.  No solve on a new mesh begins after it, and Newton's method and IPOPT stop after the
        iteration, which may take seconds on a fine mesh; fatrop has no such limit, and a solve by it is finished first
    levels : largest number of meshes, one for each level of the refinement

    Raises
    ------
    ValueError
        for a limit that is not positive, or of intervals or levels and not whole

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> layer = cg.BoundaryProblem(lambda t, x, v: 1e-8 * v[0] ** 2 / 2 + x[0] ** 2 / 2, (0, 1), start=[1.0], end=[0.0])
    >>> cg.solve(layer, tol=1e-6, limits=Limits(intervals=5000, seconds=30)).error_estimate < 1e-6
    True
    """

    intervals: float = 20_000
    seconds: float = 120.0
    levels: float = 80

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (number(value) or 0) > 0:
                raise ValueError(f"the limit of {name} must be a positive number, got {value!r}")
            if name != "seconds" and value % 1 > 0:  # not a number where it is infinite
                raise ValueError(f"the limit of {name} must be a whole number or inf, got {value!r}")


def check_tolerance(tol: float) -> float:
    """Refuse a relative tolerance that is not between 0 and 1."""
    checked = number(tol)
    if checked is None or not 0 < checked < 1:
        raise ValueError(f"tol must be a number between 0 and 1, got {tol!r}")
    return checked
