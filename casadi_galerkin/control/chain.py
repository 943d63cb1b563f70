"""Which entry of one long vector stands for what, and the constant matrices that take it to every point and back.

All that an optimizer chooses and all that it is given are one vector ξ = (unknowns, data).  The unknowns form a chain
of N + 1 stages: at every joint the state (x, p and the free constants: durations and parameters), and on the interval
after it what is chosen there, the path's values at the other nodes and the controls.  The velocities at the two ends
are chosen beside the first state and the last.  What the pointwise functions see is linear in ξ,

    (x, x', u, T, p, t_0, s, σ, S) at all quadrature points,    (x, v, p, t, S) at the start and at the end    =  A ξ,

with reference slopes x' = h v, times t = t_0 + T s and steps h = T σ from the parts s of a phase's duration T.
Derivatives are products with the columns of A:

    Ê = rows of A that are differentiated by, columns of the unknowns        (points <- unknowns)
    Θ = the transposed test matrix,    Λ = what is linear in the unknowns     (equations <- points, unknowns).

Θ sums the virtual work on every interval: the row of node a holds the quadrature weights times l_a and l_a'.  With Λ,
these are the discrete Legendre transforms (a = 0 and m) and the control equations (a between),

    p_i + Σ ( l_0 f + l_0' g ) = 0,      Σ ( l_a f + l_a' g ) = 0,      p_{i+1} - Σ ( l_m f + l_m' g ) = 0,

which join to the discrete Lagrange-d'Alembert equations.  Momenta are measured in units S, the sizes of the terms of
these equations, and the equations are divided by them.  A component that follows a rate of its own has no momentum:
there Θ tests its defect z' - h ρ with the polynomials of degree m - 1.  Λ also ties every state to the value that the
interval before ends with, x_{i+1} - X_m = 0.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.lazy import lazy
from casadi_galerkin.calculus.nodes import lagrange_values
from casadi_galerkin.calculus.quadrature import gauss
from casadi_galerkin.problems.control_problem import ControlProblem

Triplet = tuple[np.ndarray, np.ndarray, np.ndarray | float]  # rows, columns, entries, to be broadcast


def sparse(triplets: Iterable[Triplet], shape: tuple[int, int]) -> ca.DM:
    """Constant sparse matrix from triplets without repetitions; zeros are dropped."""
    flat = [[a.ravel() for a in np.broadcast_arrays(*triplet)] for triplet in triplets]
    rows, columns, entries = (np.concatenate(parts) for parts in zip(*flat, strict=True))
    rows, columns, entries = (a[entries != 0] for a in (rows, columns, entries))
    order = np.lexsort((rows, columns))
    starts = np.searchsorted(columns[order], np.arange(shape[1] + 1))
    return ca.DM(ca.Sparsity(*shape, starts.tolist(), rows[order].tolist()), entries[order])


class Fields:
    """Numbers given to named arrays of entries, one after the other."""

    def __init__(self) -> None:
        self.size = 0
        self._parts: dict[str, list[np.ndarray]] = {}

    def add(self, name: str, *shape: int) -> None:
        """Number the next entries; a name that comes again gets one more row."""
        count = int(np.prod(shape))
        self._parts.setdefault(name, []).append(self.size + np.arange(count).reshape(shape))
        self.size += count

    def arrays(self) -> dict[str, np.ndarray]:
        """Number of every entry, (times it came, *shape) for every name."""
        return {name: np.stack(parts) for name, parts in self._parts.items()}


@dataclass(frozen=True)
class Place:
    """One kind of place: how many there are, and what is known at each.

    Attributes
    ----------
    count : number of places
    rows : name and length of what is known, in this order
    first : first row of A that belongs to them
    """

    count: int
    rows: dict[str, int]
    first: int

    @property
    def width(self) -> int:
        """Rows of A at one place."""
        return sum(self.rows.values())

    def row(self, name: str) -> np.ndarray:
        """Rows of A of a name, (count, length)."""
        names = list(self.rows)
        offset = sum(self.rows[other] for other in names[: names.index(name)])
        starts = self.first + offset + self.width * np.arange(self.count)
        return starts[:, None] + np.arange(self.rows[name])


class Chain:
    """Numbering of ξ, and of the equations, of a control problem on N intervals.

    Parameters
    ----------
    problem : ControlProblem
    method : Galerkin
    mesh : (N + 1,), joints, the breakpoints of the problem among them

    Attributes
    ----------
    breaks : numbers of the joints at the breakpoints
    phases : (N,), number of the phase with a duration of its own that every interval lies in
    unknowns, equations, size : numbers of unknowns, of equations, and of entries of ξ
    fields : name -> entries of ξ: "x" (N + 1, d), "momentum" (N + 1, mechanical), "nodes" (N, m, d), the values at the
        nodes after the first, "controls" (N, points, n), "start_velocity", "end_velocity" (mechanical,), "durations"
        (N + 1, phases) and "parameters" (N + 1, count), alike at all joints, and "begin", "left", "part", "sizes"
    rows : name -> equations: "x", "momentum", "constants" tie (N, ...) states; "motion" (N, m, mechanical) are those of
        the nodes before the last, "rates" (N, m, others); "path" (N, r, count); "start", "end" (mechanical,); "ends"
    kinds : (equations,), equal where equations compare the same quantities
    stages : for every stage the numbers of its states, of what else is unknown there, and of its other equations
    points, start, end, ends : Place of each kind
    control_times : where the controls of an interval stand, in parts of it; one value in the middle where they are held
    """

    def __init__(self, problem: ControlProblem, method: Galerkin, mesh: np.ndarray) -> None:
        self.problem, self.method = problem, method
        self.intervals, self.dimension, self.mechanical = len(mesh) - 1, problem.dimension, problem.mechanical
        self.breaks = np.searchsorted(mesh, problem.breakpoints)
        parted = self.breaks if problem.duration_bounds is not None else ()
        self.phases = np.searchsorted(parted, np.arange(self.intervals), side="right")
        self.controls, self.parameters = problem.controls, len(problem.parameters or ())
        self.constraints = 0 if problem.path_constraint is None else len(problem.path_constraint[1])
        self.conditions = 0 if problem.end_conditions is None else len(problem.end_conditions[1])
        self.control_times = np.array([0.5]) if problem.hold else method.element.points
        self._number_unknowns()
        self._number_equations()
        d, q = self.dimension, len(method.quadrature) * self.intervals
        common = {"parameters": self.parameters}
        at_end = {"x": d, "velocity": self.mechanical, **common, "time": 1, "sizes": self.mechanical}
        along = {"x": d, "slope": d, "controls": self.controls, "duration": 1, **common, "begin": 1, "share": 1}
        self.points = Place(q, {**along, "part": 1, "sizes": self.mechanical}, 0)
        self.start = Place(1, at_end, q * self.points.width)
        self.end = Place(1, at_end, self.start.first + self.start.width)
        both = {f"{name}{k}": at_end[name] for k in (0, 1) for name in ("x", "velocity")}
        self.ends = Place(int(self.conditions > 0), {**both, **common}, self.end.first + self.end.width)

    @property
    def places(self) -> list[Place]:
        """Kinds of places that there are."""
        return [place for place in (self.points, self.start, self.end, self.ends) if place.count]

    def _number_unknowns(self) -> None:
        problem, n, fields, stages = self.problem, self.intervals, Fields(), []
        sizes = {"durations": 1, "parameters": self.parameters}
        free = [name for name in sizes if getattr(problem, f"{name.removesuffix('s')}_bounds") is not None]
        if "durations" in free:
            sizes["durations"] = len(problem.breakpoints) + 1
        for i in range(n + 1):
            before = fields.size
            fields.add("x", self.dimension)
            fields.add("momentum", self.mechanical)
            for name in free:
                fields.add(name, sizes[name])
            states = fields.size - before
            if i < n:
                fields.add("nodes", self.method.degree, self.dimension)
                fields.add("controls", len(self.control_times), self.controls)
            if i in (0, n):
                fields.add("start_velocity" if i == 0 else "end_velocity", self.mechanical)
            stages.append((states, fields.size - before - states))
        self.unknowns, self._widths = fields.size, stages
        for name in set(sizes) - set(free):
            fields.add(name, sizes[name])
        for name, size in {"begin": 1, "left": n, "part": n, "sizes": self.mechanical}.items():
            fields.add(name, size)
        self.size, self.fields = fields.size, fields.arrays()
        for name in ("start_velocity", "end_velocity", "begin", "left", "part", "sizes"):
            self.fields[name] = self.fields[name][0]
        for name, size in sizes.items():
            self.fields[name] = np.broadcast_to(self.fields[name], (n + 1, size))

    def _number_equations(self) -> None:
        rows, free, others = Fields(), self.free_constants, []
        for i in range(self.intervals + 1):
            before = rows.size
            if i < self.intervals:
                rows.add("x", self.dimension)
                rows.add("momentum", self.mechanical)
                rows.add("constants", free)
                before = rows.size
                rows.add("motion", self.method.degree, self.mechanical)
                rows.add("rates", self.method.degree, self.dimension - self.mechanical)
                rows.add("path", len(self.method.quadrature), self.constraints)
            if i == 0:
                rows.add("start", self.mechanical)
            if i == self.intervals:
                rows.add("end", self.mechanical)
                rows.add("ends", self.conditions)
            others.append(rows.size - before)
        self.equations, self.rows = rows.size, rows.arrays()
        for name in ("start", "end", "ends"):
            self.rows[name] = self.rows[name][0]
        self.stages = [(*widths, count) for widths, count in zip(self._widths, others, strict=True)]
        offset, self.kinds = 0, np.empty(rows.size, dtype=np.int64)
        alike = [["x"], ["momentum", "motion", "start", "end"], ["constants"], ["rates"], ["path"], ["ends"]]
        for names in alike:
            for name in names:
                self.kinds[self.rows[name]] = offset + np.arange(self.rows[name].shape[-1])
            offset += self.rows[names[0]].shape[-1]

    @property
    def free_constants(self) -> int:
        """Number of free durations and parameters, which every state passes on."""
        return sum(self.fields[name].shape[1] for name in ("durations", "parameters") if self.is_free(name))

    def marks(self, problem: ControlProblem, mesh: np.ndarray) -> np.ndarray:
        """Where the phases begin and end: ends of the mesh and, where their durations are free, the breakpoints."""
        inner = problem.breakpoints if self.is_free("durations") else ()
        return np.array([mesh[0], *inner, mesh[-1]])

    def is_free(self, name: str) -> bool:
        """Whether the entries of a field are unknowns."""
        return bool(self.fields[name].size and self.fields[name].ravel()[0] < self.unknowns)

    def pack(self, values: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns and data out of one array per field."""
        everything = np.zeros(self.size)
        for name, index in self.fields.items():
            everything[index] = values[name]
        return everything[: self.unknowns], everything[self.unknowns :]

    def unpack(self, unknowns: np.ndarray, data: np.ndarray) -> dict[str, np.ndarray]:
        """One array per field out of unknowns and data; constants once."""
        everything = np.concatenate((unknowns, data))
        values = {name: everything[index] for name, index in self.fields.items()}
        return values | {name: values[name][-1] for name in ("durations", "parameters")}

    def largest(self, terms: np.ndarray) -> np.ndarray:
        """Largest of the terms of every kind of equation; what is not a number is passed over."""
        largest = np.zeros(self.kinds.max() + 1)
        np.fmax.at(largest, self.kinds, terms)
        return largest

    def units(self, sizes: np.ndarray) -> np.ndarray:
        """What each equation is divided by: those of motion by S."""
        units = np.ones(self.equations)
        for name in ("motion", "momentum", "start", "end"):
            units[self.rows[name]] = sizes
        return units

    def path(self, values: dict[str, np.ndarray]) -> np.ndarray:
        """Node values (d, N m + 1) of the path."""
        local = np.concatenate((values["x"][:-1, None], values["nodes"][:, :-1]), axis=1)
        return np.vstack((local.reshape(-1, self.dimension), values["x"][-1])).T

    def costate(self, multipliers: np.ndarray) -> np.ndarray:
        """Node values (d, N m + 1) of the multipliers of the equations of motion, and of the rates.

        The latter are polynomials of degree m - 1 between the joints; at the joints they are those of the continuity.
        """
        m, inner = self.method.degree, self.method.element.nodes[:-1]
        motion = multipliers[self.rows["motion"]].reshape(self.intervals * m, self.mechanical)
        motion = np.vstack((motion, -multipliers[self.rows["momentum"][-1]]))
        basis = lagrange_values(np.array(gauss(m).points), inner)
        rates = -np.einsum("aj,ijz->iaz", basis, multipliers[self.rows["rates"]])
        ends = -multipliers[self.rows["x"]][:, self.mechanical :]
        rates[1:, 0] = ends[:-1]
        others = np.vstack((rates.reshape(self.intervals * m, ends.shape[1]), ends[-1]))
        return np.hstack((motion, others)).T

    @lazy
    def matrix(self) -> ca.DM:
        """A: (all places) x ξ."""
        f, p, r = self.fields, self.points, len(self.method.quadrature)
        element, one = self.method.element, 1.0
        nodes = np.concatenate((f["x"][:-1, None], f["nodes"]), axis=1)[:, None]  # (N, 1, m + 1, d)
        interval, k = np.divmod(np.arange(p.count), r)
        basis = [a[None, :, :, None] for a in (element.values, element.slopes)]
        shape = (self.intervals, r, 1, -1)
        earlier = np.arange(f["durations"].shape[1]) < self.phases[interval, None]
        triplets: list[Triplet] = [
            (p.row("x").reshape(shape), nodes, basis[0]),
            (p.row("slope").reshape(shape), nodes, basis[1]),
            (p.row("controls"), f["controls"][interval, k % f["controls"].shape[1]], one),
            (p.row("duration"), f["durations"][interval, self.phases[interval]][:, None], one),
            (p.row("parameters"), f["parameters"][interval], one),
            (p.row("begin"), f["begin"], one),
            (p.row("begin"), f["durations"][interval], earlier.astype(float)),
            (p.row("share"), f["left"][interval][:, None], one),
            (p.row("share"), f["part"][interval][:, None], element.points[k, None]),
            (p.row("part"), f["part"][interval][:, None], one),
            (p.row("sizes"), f["sizes"], one),
            (self.end.row("time"), f["durations"][-1:], one),
        ]
        for place, i, velocity in ((self.start, 0, "start_velocity"), (self.end, -1, "end_velocity")):
            entries = {"x": f["x"][i], "velocity": f[velocity], "parameters": f["parameters"][i], "time": f["begin"]}
            triplets += [(place.row(name), index, one) for name, index in (entries | {"sizes": f["sizes"]}).items()]
        entries = {"x0": f["x"][0], "velocity0": f["start_velocity"], "x1": f["x"][-1], "velocity1": f["end_velocity"]}
        if self.conditions:
            entries["parameters"] = f["parameters"][-1]
            triplets += [(self.ends.row(name), index, one) for name, index in entries.items()]
        return sparse(triplets, (sum(place.count * place.width for place in self.places), self.size))

    @lazy
    def active(self) -> list[np.ndarray]:
        """For every kind of place, which of its rows depend on unknowns."""
        depends = np.zeros(self.matrix.shape[0], dtype=bool)
        depends[self.matrix[:, : self.unknowns].sparsity().row()] = True
        parts = np.split(depends, np.cumsum([place.count * place.width for place in self.places])[:-1])
        return [
            np.flatnonzero(part.reshape(place.count, -1).any(axis=0))
            for part, place in zip(parts, self.places, strict=True)
        ]

    @lazy
    def differentiated(self) -> ca.DM:
        """Rows of A that are differentiated by, of all places x ξ."""
        rows = [
            (place.first + place.width * np.arange(place.count)[:, None] + active).ravel()
            for place, active in zip(self.places, self.active, strict=True)
        ]
        return self.matrix[np.concatenate(rows).tolist(), :]

    @lazy
    def derivative(self) -> ca.DM:
        """Ê: the same by unknowns only."""
        return self.differentiated[:, : self.unknowns]

    @lazy
    def test(self) -> ca.DM:
        """Θᵀ: what the pointwise functions return, at all places x equations.

        At a quadrature point these are f and g of the mechanical components, the defects of the others, and the path
        constraints; at the start and at the end ∂L/∂v; and the conditions on both.
        """
        dm, z, c, rows = self.mechanical, self.dimension - self.mechanical, self.constraints, self.rows
        element, r = self.method.element, len(self.method.quadrature)
        width, k = 2 * dm + z + c, np.arange(self.points.count).reshape(self.intervals, r, 1, 1)
        weights, height = element.weights[:, None], width * self.points.count
        nodes = np.concatenate((rows["motion"], rows["momentum"][:, None]), axis=1)[:, None]  # (N, 1, m + 1, dm)
        sign = np.append(np.ones(self.method.degree), -1.0)
        f, g = (((weights * a) * sign)[None, :, :, None] for a in (element.values, element.slopes))
        degree = self.method.degree
        tests = (weights * lagrange_values(np.array(gauss(degree).points), element.points))[None, :, :, None]
        component, end = np.arange(dm), height + np.arange(dm)
        triplets: list[Triplet] = [
            (width * k + component, nodes, f),
            (width * k + dm + component, nodes, g),
            (width * k + 2 * dm + np.arange(z), rows["rates"][:, None], tests),
            (width * k[..., 0] + 2 * dm + z + np.arange(c), rows["path"], 1.0),
            (end, rows["start"], -1.0),
            (end + dm, rows["end"], -1.0),
            (height + 2 * dm + np.arange(self.conditions), rows["ends"], 1.0),
        ]
        return sparse(triplets, (height + 2 * dm + self.conditions, self.equations))

    @lazy
    def linear(self) -> ca.DM:
        """Λ: equations x unknowns."""
        f, rows = self.fields, self.rows
        free = [f[name] for name in ("durations", "parameters") if self.is_free(name)]
        constants = np.concatenate(free, axis=1) if free else np.zeros((self.intervals + 1, 0), dtype=np.int64)
        triplets: list[Triplet] = [
            (rows["x"], f["x"][1:], 1.0),
            (rows["x"], f["nodes"][:, -1], -1.0),
            (rows["momentum"], f["momentum"][1:], 1.0),
            (rows["motion"][:, 0], f["momentum"][:-1], 1.0),
            (rows["constants"], constants[1:], 1.0),
            (rows["constants"], constants[:-1], -1.0),
            (rows["start"], f["momentum"][0], 1.0),
            (rows["end"], f["momentum"][-1], 1.0),
        ]
        return sparse(triplets, (self.equations, self.unknowns))
