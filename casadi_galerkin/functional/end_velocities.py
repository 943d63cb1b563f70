"""Velocities at the ends of a path: those that are given, and those that are unknowns beside the path.

Where the momentum of a given velocity depends on another velocity that is not given, the latter is an unknown
(`functional.boundary_terms`).  Unlike a multiplier it need not enter linearly, and L may not be defined where it is
zero, so that it begins with the velocity of the guess.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from casadi_galerkin.functional.numbering import CACHE_SIZE
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.legendre_transform import coupled_by_mass
from casadi_galerkin.problems.problem import ENDS


class EndVelocities(NamedTuple):
    """The velocities at one end.

    Attributes
    ----------
    given : components whose velocity is given
    unknown : components whose velocity is not given, but on which the momentum of a given or unknown one depends
    """

    given: list[int]
    unknown: list[int]


@lru_cache(2 * CACHE_SIZE)
def _at_end(lagrangian: ca.Function, given: tuple[bool, ...]) -> EndVelocities:
    is_given = np.array(given)
    reached = coupled_by_mass(lagrangian, is_given) if any(given) else is_given
    return EndVelocities(*(np.flatnonzero(which).tolist() for which in (is_given, reached & ~is_given)))


def end_velocities(problem: BoundaryProblem) -> list[EndVelocities]:
    """The velocities at the start and at the end of a problem."""
    stated = [tuple(value is not None for value in getattr(problem, f"{end}_velocity")) for end in ENDS]
    return [_at_end(problem.lagrangian, given) for given in stated]
