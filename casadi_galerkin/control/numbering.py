"""Which entry of one long vector stands for what, and the constant matrix that takes it to every point.

All that an optimiser chooses and all that it is given are one vector ξ = (unknowns, data): node values of the
path, controls at the quadrature points, velocities at the two ends, duration and parameters, the time scale.  What
the pointwise functions see is linear in it,

    (x, x', u, T, p, t_0, s, σ) at all quadrature points,  (x_0, v_0, x_N, v_N, T, p, t_0, s_0, s_N)  =  A ξ,

with reference slopes x' = h v, and times t = t_0 + T s, steps h = T σ from the fractions s of the duration T.  A holds
small constants of the reference element only, and every derivative is a product with its columns:

    Ê = rows of A that are differentiated by, columns of the unknowns        (points <- unknowns)
    Θ = the transposed test matrix                                          (equations <- points).

Θ sums the virtual work: row a of it holds the quadrature weights times l_a and l_a', as Eᵀ does in the boundary
problem, so that Θ [∂L̂/∂x + h F; ∂L̂/∂x'] with the boundary momenta is the discrete Lagrange-d'Alembert equation of
node a.  Below these rows it passes the path constraints through.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.lazy import lazy


def sparse(rows: np.ndarray, columns: np.ndarray, entries: np.ndarray, shape: tuple[int, int]) -> ca.DM:
    """Constant sparse matrix from triplets without repetitions; zeros are dropped."""
    rows, columns, entries = (a[entries != 0] for a in (rows, columns, entries))
    order = np.lexsort((rows, columns))
    starts = np.searchsorted(columns[order], np.arange(shape[1] + 1))
    return ca.DM(ca.Sparsity(*shape, starts.tolist(), rows[order].tolist()), entries[order])


@dataclass(frozen=True)
class ControlNumbering:
    """Numbering of the vector ξ = (unknowns, data) of an optimisation.

    Parameters
    ----------
    method : Galerkin
    intervals : int, N
    dimension, controls, parameters, constraints : numbers of coordinates, controls, parameters, path constraints
    fixed : for start, end, start_velocity, end_velocity: which components are data, d booleans each
    free_duration, free_parameters : whether these are unknowns
    """

    method: Galerkin
    intervals: int
    dimension: int
    controls: int
    parameters: int
    constraints: int
    fixed: Mapping[str, tuple[bool, ...]]
    free_duration: bool
    free_parameters: bool

    @property
    def points(self) -> int:
        """Number of quadrature points, N r."""
        return self.intervals * len(self.method.quadrature)

    @property
    def nodes(self) -> int:
        """Number of nodes, N m + 1."""
        return self.intervals * self.method.degree + 1

    @lazy
    def _free(self) -> dict[str, np.ndarray]:
        """Every field of ξ, and which of its entries are unknowns."""
        d = self.dimension
        path = np.ones((self.nodes, d), dtype=bool)
        path[0], path[-1] = ~np.array(self.fixed["start"]), ~np.array(self.fixed["end"])
        return {
            "path": path,
            "controls": np.ones((self.points, self.controls), dtype=bool),
            "start_velocity": ~np.array(self.fixed["start_velocity"]),
            "end_velocity": ~np.array(self.fixed["end_velocity"]),
            "duration": np.array([self.free_duration]),
            "parameters": np.full(self.parameters, self.free_parameters),
            "begin": np.array([False]),
            "fractions": np.zeros(self.intervals + 1, dtype=bool),
        }

    @lazy
    def fields(self) -> dict[str, np.ndarray]:
        """Entry of ξ that each entry of a field has."""
        numbering: dict[str, np.ndarray] = {}
        next_free, next_given = 0, self.unknowns
        for name, free in self._free.items():
            index = np.empty(free.shape, dtype=np.int64)
            count = int(np.count_nonzero(free))
            index[free] = next_free + np.arange(count)
            index[~free] = next_given + np.arange(free.size - count)
            next_free, next_given = next_free + count, next_given + free.size - count
            numbering[name] = index
        return numbering

    @lazy
    def unknowns(self) -> int:
        """Number of unknowns."""
        return sum(int(np.count_nonzero(free)) for free in self._free.values())

    @lazy
    def size(self) -> int:
        """Length of ξ."""
        return sum(free.size for free in self._free.values())

    def pack(self, values: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns and data out of one array a field."""
        everything = np.zeros(self.size)
        for name, index in self.fields.items():
            everything[index] = values[name]
        return everything[: self.unknowns], everything[self.unknowns :]

    def unpack(self, unknowns: np.ndarray, data: np.ndarray) -> dict[str, np.ndarray]:
        """One array a field out of unknowns and data."""
        everything = np.concatenate((unknowns, data))
        return {name: everything[index] for name, index in self.fields.items()}

    @property
    def equations(self) -> int:
        """Number of equations: of motion at all nodes, then path constraints at all points."""
        return self.nodes * self.dimension + self.points * self.constraints

    @property
    def point_rows(self) -> int:
        """Rows of A at a quadrature point: x, x', u, T, p, t_0, s, σ."""
        return 2 * self.dimension + self.controls + self.parameters + 4

    @property
    def end_rows(self) -> int:
        """Rows of A for the ends: x_0, v_0, x_N, v_N, T, p, t_0, s_0, s_N."""
        return 4 * self.dimension + self.parameters + 4

    def active(self, local: int) -> np.ndarray:
        """Rows of one place that are differentiated by: the `local` first ones, and T and p if they are free."""
        duration = [local] if self.free_duration else []
        parameters = local + 1 + np.arange(self.parameters if self.free_parameters else 0)
        return np.concatenate((np.arange(local), duration, parameters)).astype(np.int64)

    @lazy
    def _element(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Entries of E on a time scale of unit steps: entry, point, whether it is a slope, node."""
        unit = DiscreteCalculus(self.method, np.arange(self.intervals + 1.0))
        entries, (rows, nodes) = unit.operator()
        slope, point = np.divmod(rows, self.points)
        return entries, point, slope, nodes

    @lazy
    def matrix(self) -> ca.DM:
        """A: (N r points, then the ends) x ξ."""
        f = self.fields
        ends = [f["path"][0], f["start_velocity"], f["path"][-1], f["end_velocity"]]
        ends += [f["duration"], f["parameters"], f["begin"], f["fractions"][[0, -1]]]
        first = self.points * self.point_rows
        triplets = [*self._point_triplets(), (first + np.arange(self.end_rows), np.concatenate(ends), np.ones(1))]
        flat = [[a.ravel() for a in np.broadcast_arrays(*triplet)] for triplet in triplets]
        rows, columns, entries = (np.concatenate(parts) for parts in zip(*flat, strict=True))
        return sparse(rows, columns, entries, (first + self.end_rows, self.size))

    def _point_triplets(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        d, fields, one = self.dimension, self.fields, np.ones(1)
        entries, point, slope, node = (a[:, None] for a in self._element)
        component = np.arange(d)
        first = self.point_rows * np.arange(self.points)[:, None]
        after = first + 2 * d + self.controls
        begin, share = after + 1 + self.parameters, after + 2 + self.parameters
        left, part = np.divmod(np.arange(self.points)[:, None], len(self.method.quadrature))
        q, f = np.array(self.method.quadrature.points)[part], fields["fractions"]
        return [
            (self.point_rows * point + d * slope + component, fields["path"][node[:, 0]], entries),
            (first + 2 * d + np.arange(self.controls), fields["controls"], one),
            (after, fields["duration"], one),
            (after + 1 + np.arange(self.parameters), fields["parameters"], one),
            (begin, fields["begin"], one),
            (share, f[left], 1 - q),
            (share, f[left + 1], q),
            (share + 1, f[left], -one),
            (share + 1, f[left + 1], one),
        ]

    @lazy
    def differentiated(self) -> ca.DM:
        """Rows of A that are differentiated by, of all points and of the ends x ξ."""
        inner, ends = self.active(2 * self.dimension + self.controls), self.active(4 * self.dimension)
        starts = self.point_rows * np.arange(self.points)[:, None]
        rows = np.append((starts + inner).ravel(), self.points * self.point_rows + ends)
        return self.matrix[rows.tolist(), :]

    @lazy
    def derivative(self) -> ca.DM:
        """Ê: the same by unknowns only."""
        return self.differentiated[:, : self.unknowns]

    @lazy
    def test(self) -> ca.DM:
        """Θᵀ: (x, x', path constraints at all points, momenta at the two ends) x equations."""
        d, c = self.dimension, self.constraints
        height, width = self.points * (2 * d + c), self.nodes * d
        entries, point, slope, node = (a[:, None] for a in self._element)
        weighted = entries * np.array(self.method.quadrature.weights)[point % len(self.method.quadrature)]
        component, passed = np.arange(d), np.arange(c) if c else np.zeros(0, dtype=np.int64)
        k = np.arange(self.points)[:, None]
        triplets = [
            ((2 * d + c) * point + d * slope + component, d * node + component, weighted + 0 * component),
            ((2 * d + c) * k + 2 * d + passed, width + c * k + passed, np.ones((self.points, c))),
            (height + np.arange(2 * d), np.append(component, width - d + component), np.repeat((1.0, -1.0), d)),
        ]
        rows, columns, values = (np.concatenate([np.ravel(t[i]) for t in triplets]) for i in range(3))
        return sparse(rows, columns, values, (height + 2 * d, width + c * self.points))
