"""Unknown velocities at an end, from the momentum of the path there.

Where the momentum of a given velocity depends on another velocity that is not given, the latter is an unknown beside
the path (`functional.boundary_terms`).  Unlike a multiplier it need not enter linearly, and L may not be defined where
it is zero.  But its momentum is that of the path, -∂S/∂x_0 or ∂S/∂x_N, so that the Legendre transform gives a first
guess.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.functional.numbering import CACHE_SIZE
from casadi_galerkin.functional.velocities import velocities
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.legendre_transform import coupled_by_mass, legendre_transform
from casadi_galerkin.problems.problem import ENDS


class EndVelocities:
    """The velocities at one end that are given, and those that are unknowns.

    Parameters
    ----------
    lagrangian : Function (t, x, v[, p]) -> scalar
    given : (d,), whether the velocity of each component is given

    Attributes
    ----------
    given : components whose velocity is given
    unknown : components whose velocity is not given, but on which the momentum of a given or unknown one depends
    """

    def __init__(self, lagrangian: ca.Function, given: tuple[bool, ...]) -> None:
        self._lagrangian = lagrangian
        is_given = np.array(given)
        reached = coupled_by_mass(lagrangian, is_given) if any(given) else is_given
        self.given, self.unknown = (np.flatnonzero(which).tolist() for which in (is_given, reached & ~is_given))

    @cached_property
    def _transform(self) -> ca.Function:
        """(t, (x, v, p), unknown velocities) -> their momenta, mass matrix; v holds the other velocities."""
        t, x, v, *p = self._lagrangian.sx_in()
        unknown, velocity = ca.SX.sym("unknown", len(self.unknown)), v[:]
        velocity[self.unknown] = unknown
        lagrangian = self._lagrangian(t, x, velocity, *p)
        return legendre_transform(ca.Function("of_unknown", [t, ca.vertcat(x, v, *p), unknown], [lagrangian]))

    def of_momentum(
        self, t: float, x: np.ndarray, v: np.ndarray, momentum: np.ndarray, parameters: tuple[np.ndarray, ...]
    ) -> np.ndarray:
        """The unknown velocities whose momentum is that of a path at the end.

        Parameters
        ----------
        t : time of the end
        x, momentum : (d,), of the path there
        v : (d,), the given velocities and, for the unknown ones, a guess, which is returned where none is found
        parameters : the parameters, if there are some
        """
        at, guess = np.concatenate((x, v, *parameters)), v[self.unknown]
        found = velocities(self._transform, np.array([t]), at[:, None], momentum[self.unknown, None], guess[:, None])
        return np.where(np.isnan(found[:, 0]), guess, found[:, 0])


_kept = lru_cache(2 * CACHE_SIZE)(EndVelocities)


def end_velocities(problem: BoundaryProblem) -> list[EndVelocities]:
    """The velocities at the start and at the end of a problem, cached."""
    stated = [tuple(value is not None for value in getattr(problem, f"{end}_velocity")) for end in ENDS]
    return [_kept(problem.lagrangian, given) for given in stated]
