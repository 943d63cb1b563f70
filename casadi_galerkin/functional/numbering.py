"""The numbering of the unknowns of a path, which graphs, arrays and solutions have in common."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.galerkin import Galerkin

CACHE_SIZE = 8  # a graph of 1e5 intervals holds some 100 MB

Data = tuple[np.ndarray, ...]  # inputs beside the unknowns: start, end, mesh and, if there are some, parameters, given


@dataclass(frozen=True)
class Numbering:
    """The correspondence of the entries of a vector u and the values of a path.

    u holds the unknowns ξ, then the fixed components of the start, then those of the end.  ξ holds the free values of
    the path in the order of time, then the multipliers, those of given integrals last, and, where the duration is free,
    the logarithm of the stretch of the mesh.

    Parameters
    ----------
    method : Galerkin
    intervals : int, N
    dimension : int, d
    fixed_start, fixed_end : indices of the components that are given at the ends
    periodic : bool, whether the last joint is the first one; `fixed_start` then holds for both
    multipliers : int, unknowns beside the path
    integrals : int, those of them that are multipliers of given integrals
    free_duration : bool, whether the duration is unknown; the last of ξ is then the logarithm of its ratio to that of
        the mesh
    """

    method: Galerkin
    intervals: int
    dimension: int
    fixed_start: tuple[int, ...]
    fixed_end: tuple[int, ...]
    periodic: bool
    multipliers: int
    integrals: int
    free_duration: bool

    @cached_property
    def of_ends(self) -> np.ndarray:
        """Numbers of the positions at the ends among the given ones, of start and then end; -1 if not given; (2, d)."""
        ends, starts = np.full((2, self.dimension), -1), len(self.fixed_start)
        ends[0, list(self.fixed_start)] = np.arange(starts)
        ends[1, list(self.fixed_end)] = starts + np.arange(len(self.fixed_end))
        if self.periodic:
            ends[1] = ends[0]
        return ends

    @cached_property
    def of_nodes(self) -> np.ndarray:
        """Entries of u of the values at every node in the order of time; (N m + 1, d)."""
        nodes = np.zeros((self.intervals * self.method.degree + 1, self.dimension), dtype=np.int64)
        given = np.zeros(nodes.shape, dtype=bool)
        given[[0, -1]] = self.of_ends >= 0
        free = ~given[: self.distinct]
        nodes[: self.distinct][free] = np.arange(self.positions)
        nodes[[0, -1]] = np.where(given[[0, -1]], self.free + self.of_ends, nodes[[0, -1]])
        if self.periodic:  # numbered with the first joint
            nodes[-1] = nodes[0]
        return nodes

    @cached_property
    def component(self) -> np.ndarray:
        """Component of the path to which every entry of u belongs, 0 for those that are no values of it; (size,)."""
        component = np.zeros(self.size, dtype=np.int64)
        component[self.of_nodes] = np.arange(self.dimension)
        component[self.free :] = self.fixed_start + self.fixed_end
        return component

    @cached_property
    def place(self) -> np.ndarray:
        """Position of every free value among the node values, component fastest; (positions,)."""
        return np.unique(self.of_nodes, return_index=True)[1][: self.positions]  # of a periodic joint the first

    @cached_property
    def distinct(self) -> int:
        """Number of distinct nodes: all, except the last one of a periodic path, which is the first."""
        return self.intervals * self.method.degree + (0 if self.periodic else 1)

    @cached_property
    def positions(self) -> int:
        """Number of free values of the path."""
        return self.distinct * self.dimension - len(self.fixed_start) - len(self.fixed_end)

    @cached_property
    def free(self) -> int:
        """Number of unknowns, the length of ξ."""
        return self.positions + self.multipliers + self.free_duration

    @property
    def everywhere(self) -> slice:
        """The unknowns that enter at all points: the multipliers of integrals and the stretch of a free duration."""
        return slice(self.free - self.integrals - self.free_duration, self.free)

    @property
    def size(self) -> int:
        """Length of u."""
        return self.free + len(self.fixed_start) + len(self.fixed_end)

    def parted(self, u: np.ndarray) -> list[np.ndarray]:
        """Views of the unknowns ξ, the start and the end in a vector u."""
        return np.split(u, [self.free, self.free + len(self.fixed_start)])

    @property
    def local(self) -> np.ndarray:
        """Entries of u of the values at every local node; (m + 1, N, d)."""
        m = self.method.degree
        return self.of_nodes[m * np.arange(self.intervals)[None, :] + np.arange(m + 1)[:, None]]

    @property
    def points(self) -> int:
        """Number of quadrature points, N r."""
        return self.intervals * len(self.method.quadrature)


@lru_cache(CACHE_SIZE)
def kept(numbering: Numbering) -> Numbering:
    """An equal numbering made before, if there is one, with its cached properties."""
    return numbering


def joints_of(numbering: Numbering, unknowns: np.ndarray, data: Data) -> np.ndarray:
    """Joints of a path, (N + 1,): those of its mesh, stretched where the duration is free."""
    mesh = data[2]
    if not numbering.free_duration:
        return mesh
    with np.errstate(over="ignore", invalid="ignore"):  # a solver that fails may leave any number
        return mesh[0] + np.exp(unknowns[-1]) * (mesh - mesh[0])
