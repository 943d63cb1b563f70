"""Velocities at an end that are unknowns: those that belong to the momentum of the path there.

Where a velocity is given and its momentum depends on another one, that is an unknown beside the path
(`functional.statement`).  Unlike a multiplier it need not enter linearly, nor L be defined where it is zero.  But its
momentum is that of the path, -∂S/∂x_0 or ∂S/∂x_N, so that it follows from the path by the Legendre transform.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.functional.numbering import CACHE_SIZE
from casadi_galerkin.problems.boundary_problem import ENDS, BoundaryProblem
from casadi_galerkin.problems.legendre_transform import legendre_transform, velocities


class EndVelocities:
    """The velocities at one end that are given, and those that are unknowns.

    Parameters
    ----------
    lagrangian : Function (t, x, v[, p]) -> scalar
    given : (d,), whose velocities are given
    joint : number of the joint there, 0 or -1

    Attributes
    ----------
    given : components whose velocity is given
    unknown : components whose velocity is not given, but occurs in a momentum that follows from given velocities
    """

    def __init__(self, lagrangian: ca.Function, given: tuple[bool, ...], joint: int) -> None:
        self._lagrangian, self.joint = lagrangian, joint
        chosen = found = np.array(given)
        if any(given):
            symbols = lagrangian.sx_in()
            mass = ca.hessian(lagrangian(*symbols), symbols[2])[0]
            coupled = np.array(ca.DM(mass.sparsity(), 1.0).full(), dtype=bool)
            for _ in given:
                found = found | coupled[found].any(axis=0)
        self.given, self.unknown = (np.flatnonzero(which).tolist() for which in (chosen, found & ~chosen))

    @cached_property
    def _transform(self) -> ca.Function:
        """(t, (x, v, p), unknown velocities) -> their momenta, mass matrix; v has the others."""
        t, x, v, *p = self._lagrangian.sx_in()
        own, mixed = ca.SX.sym("own", len(self.unknown)), v[:]
        mixed[self.unknown] = own
        lagrangian = self._lagrangian(t, x, mixed, *p)
        return legendre_transform(ca.Function("of_unknown", [t, ca.vertcat(x, v, *p), own], [lagrangian]))

    def of_momentum(
        self, t: float, x: np.ndarray, v: np.ndarray, momentum: np.ndarray, parameters: tuple[np.ndarray, ...]
    ) -> np.ndarray:
        """The unknown velocities that have the momentum of a path at the end.

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
    """The velocities at the start and at the end of a problem; those of the last problems are kept."""
    stated = [tuple(value is not None for value in getattr(problem, f"{end}_velocity")) for end in ENDS]
    return [_kept(problem.lagrangian, given, -k) for k, given in enumerate(stated)]
