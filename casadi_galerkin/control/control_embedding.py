"""Constant sparse matrices from the unknowns to the inputs of pointwise functions, and from their outputs to equations.

The inputs of the pointwise functions are linear in the vector ξ of unknowns and data (`control_numbering`),

    (x, x', u, T, π, t_0, s, σ, S) at all quadrature points,    (x, v, π, t, S) at either end    =  A ξ,

and so are those at both ends together, at the nodes of a constraint, and at the ends of all phases together.  The
x' = h v are reference slopes, and π the parameters.  Here t_0 is the start and T the duration of a phase, and s and σ
are fractions of it: the time is t = t_0 + T s and the step h = T σ.  S are the units of the momenta.  The derivatives
are products with

    Ê = the rows of A whose inputs depend on unknowns, and the columns of the unknowns     (inputs <- unknowns)
    Θ = the transpose of the test matrix        (equations <- outputs of the pointwise functions)
    Λ = the part that is linear in the unknowns     (equations <- unknowns).

Θ sums the virtual work on every interval: its row of node a has the quadrature weights times l_a and l_a'.  Together
with Λ, these are the discrete Legendre transforms (a = 0 and m) and the control equations (a between),

    p_i + Σ ( l_0 f + l_0' g ) = 0,      Σ ( l_a f + l_a' g ) = 0,      p_{i+1} - Σ ( l_m f + l_m' g ) = 0,

with f = ∂L̂/∂x + h F and g = ∂L̂/∂x' at the points and Σ the quadrature sum.  Together they are the discrete
Lagrange-d'Alembert equations.  Momenta are measured in units S, the sizes of the terms of these equations, and the
equations are divided by S.  A component that follows a rate has no momentum: there Θ tests its defect z' - h ρ with the
polynomials of degree m - 1.  Λ also makes every state equal to the value at the end of the interval before, x_{i+1} -
X_m = 0.  A constraint adds its impulse GᵀI_a to the equation of every node after the path's first; at the first, to the
equation of the velocity at the start.

The places of all phases, and their rows, follow one another; what joins the phases is one more place.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain as chained

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.nodes import lagrange_values
from casadi_galerkin.calculus.quadrature import gauss
from casadi_galerkin.control.control_numbering import Chain, Numbering

Triplet = tuple[np.ndarray, np.ndarray, np.ndarray | float]  # rows, columns, entries, to be broadcast


def sparse(triplets: Iterable[Triplet], shape: tuple[int, int]) -> ca.DM:
    """Constant sparse matrix from triplets without repetitions; zeros are dropped."""
    flat = list[np.ndarray]()
    for triplet in triplets:
        block = np.empty((3, *np.broadcast(*triplet).shape))
        block[0], block[1], block[2] = triplet
        flat.append(block.reshape(3, -1))
    entries = np.concatenate(flat, axis=1)
    rows, columns = entries[:2, entries[2] != 0].astype(int).tolist()
    return ca.DM.triplet(rows, columns, ca.DM(entries[2, entries[2] != 0]), *shape)


@dataclass(frozen=True, eq=False)
class PlaceLayout:
    """The layout of the inputs, or of the outputs, of a pointwise function at all places of one kind.

    A kind of place is, in one phase, the quadrature points, either end, both ends together or the nodes, or it is the
    ends of all phases.  The values at one place are consecutive rows of A (inputs) or Θᵀ (outputs).

    Attributes
    ----------
    count : number of places
    rows : names and lengths of the inputs or outputs at one place, in their order
    first : first row of the first place
    """

    count: int
    rows: dict[str, int]
    first: int

    @property
    def width(self) -> int:
        """Number of rows of one place."""
        return sum(self.rows.values())

    @property
    def last(self) -> int:
        """The row after those of the last place."""
        return self.first + self.count * self.width

    def row(self, name: str) -> np.ndarray:
        """Rows of the input or output with a name, (count, length)."""
        names = list(self.rows)
        offset = sum(self.rows[other] for other in names[: names.index(name)])
        starts = self.first + offset + self.width * np.arange(self.count)
        return starts[:, None] + np.arange(self.rows[name])


class PhaseEmbedding:
    """Entries of A, Θ and Λ of one phase.

    At a quadrature point the outputs are f and g of the mechanical components, the defects of the others, and the path
    constraints; at either end ∂L/∂v and the time derivative of the constraint; at both ends the end conditions; at the
    nodes the constraint and its impulse.

    Parameters
    ----------
    chain : Chain
    first : first rows of its inputs and outputs

    Attributes
    ----------
    points, either_end, both_ends, nodes, changes : layouts of the inputs at the quadrature points, at each end, at both
        ends together, at the nodes with a constraint, and of the changes of bounded controls
    inputs, outputs : layouts of the inputs, and of the outputs, at all kinds of places that exist
    """

    def __init__(self, chain: Chain, first: tuple[int, int]) -> None:
        self.chain = chain
        d, dm, constraints = chain.dimension, chain.mechanical, chain.constraints
        common = {"parameters": chain.parameters}
        at_end = {"x": d, "velocity": dm, **common, "time": 1, "sizes": dm}
        when = {"duration": 1, **common, "begin": 1, "fraction": 1}
        at_point = {"x": d, "slope": d, "controls": chain.controls, **when, "part": 1, "sizes": dm}
        at_node = {"x": d, "impulse": constraints, **when, "sizes": dm}
        n = chain.changes
        at_change = {"before": n, "after": n, "duration": 1, "part": 1}
        r, m, joined = len(chain.method.quadrature), chain.method.degree, chain.conditions > 0 or chain.cost_of_ends
        kinds: list[tuple[int, dict[str, int], dict[str, int]]] = [
            (chain.intervals * r, at_point, {"f": dm, "g": dm, "defect": d - dm, "path": chain.path_constraints}),
            (2, at_end, {"momentum": dm, "tangent": constraints}),
            (int(joined), self.ends, {"conditions": chain.conditions}),
            ((chain.intervals * m + 1) * (constraints > 0), at_node, {"constraint": constraints, "push": dm}),
            ((chain.intervals * len(chain.control_times) - 1) * (n > 0), at_change, {"changes": n}),
        ]
        made = list[PlaceLayout](), list[PlaceLayout]()
        for count, *rows in kinds:
            for layouts, named, begin in zip(made, rows, first, strict=True):
                layouts.append(PlaceLayout(count, named, layouts[-1].last if layouts else begin))
        (self.points, self.either_end, self.both_ends, self.nodes, self.changes), self._all_outputs = made
        self.inputs, self.outputs = ([place for place in layouts if place.count] for layouts in made)

    @property
    def ends(self) -> dict[str, int]:
        """Names and lengths of the inputs at both ends together."""
        d, dm = self.chain.dimension, self.chain.mechanical
        return {"t0": 1, "x0": d, "v0": dm, "t1": 1, "x1": d, "v1": dm, "parameters": self.chain.parameters}

    def at_ends(self, place: PlaceLayout, of_phase: str = "") -> Iterator[Triplet]:
        """Entries of A for both ends together, at a place where names have this ending."""
        f = self.chain.fields
        entries = {"t0": f["begin"][0], "t1": f["begin"][-1], "parameters": f["parameters"][-1]}
        entries |= {"x0": f["x"][0], "v0": f["start_velocity"], "x1": f["x"][-1], "v1": f["end_velocity"]}
        for name, index in entries.items():
            yield place.row(name + of_phase), index, 1.0
        yield place.row("t1" + of_phase), f["duration"][-1], 1.0

    def given(self) -> Iterator[Triplet]:
        """Entries of A: inputs at all places x ξ."""
        f, p, m = self.chain.fields, self.points, self.chain.method.degree
        element, r = self.chain.method.element, len(self.chain.method.quadrature)
        nodes = np.concatenate((f["x"][:-1, None], f["nodes"]), axis=1)[:, None]  # (N, 1, m + 1, d)
        interval, k = np.divmod(np.arange(p.count), r)
        basis = [a[None, :, :, None] for a in (element.values, element.slopes)]
        shape = (self.chain.intervals, r, 1, -1)
        yield p.row("x").reshape(shape), nodes, basis[0]
        yield p.row("slope").reshape(shape), nodes, basis[1]
        yield p.row("controls"), f["controls"][interval, k % f["controls"].shape[1]], 1.0
        yield p.row("part"), f["part"][interval][:, None], 1.0
        yield from self._times_and_parameters(p, interval, element.points[k])
        for name, field in {"x": "x", "time": "begin", "parameters": "parameters"}.items():
            yield self.either_end.row(name), f[field][[0, -1]], 1.0
        yield self.either_end.row("velocity"), np.stack((f["start_velocity"], f["end_velocity"])), 1.0
        yield self.either_end.row("sizes"), f["sizes"], 1.0
        yield self.either_end.row("time")[-1:], f["duration"][-1], 1.0
        if self.both_ends.count:
            yield from self.at_ends(self.both_ends)
        if self.chain.constraints:  # at the first node, then at those after it on every interval
            interval, a = np.divmod(np.arange(self.chain.intervals * m), m)
            impulses = f["impulses"].reshape(-1, self.chain.constraints)
            yield self.nodes.row("x"), np.vstack((f["x"][:1], f["nodes"].reshape(-1, self.chain.dimension))), 1.0
            yield self.nodes.row("impulse"), np.vstack((f["start_impulse"], impulses)), 1.0
            where = np.append(0, interval), np.append(0.0, element.nodes[1:][a])
            yield from self._times_and_parameters(self.nodes, *where)
        if self.changes.count:
            times, n = self.chain.control_times, self.chain.controls
            u, last = f["controls"].reshape(-1, n), np.arange(1, self.chain.intervals) * len(times) - 1
            within = np.setdiff1d(np.arange(len(u) - 1), last)
            order = np.append(within, last)
            yield self.changes.row("before"), u[order], 1.0
            yield self.changes.row("after"), u[order + 1], 1.0
            yield self.changes.row("duration"), f["duration"][0], 1.0
            part, inside = self.changes.row("part"), len(within)
            apart = np.tile(np.diff(times), self.chain.intervals)[:, None]
            yield part[:inside], f["part"][within // len(times)][:, None], apart
            yield part[inside:], f["part"][:-1][:, None], 1 - times[-1]
            yield part[inside:], f["part"][1:][:, None], times[0]

    def _times_and_parameters(
        self, place: PlaceLayout, interval: np.ndarray, fraction: np.ndarray
    ) -> Iterator[Triplet]:
        """Entries of A for times, parameters and S at K places at the fractions `fraction` of their intervals."""
        f = self.chain.fields
        for name in ("duration", "parameters", "begin"):
            yield place.row(name), f[name][interval], 1.0
        yield place.row("fraction"), f["left"][interval][:, None], 1.0
        yield place.row("fraction"), f["part"][interval][:, None], fraction[:, None]
        yield place.row("sizes"), f["sizes"], 1.0

    def tested(self) -> Iterator[Triplet]:
        """Entries of Θᵀ: outputs of the pointwise functions at all places x equations."""
        chain, rows, m = self.chain, self.chain.rows, self.chain.method.degree
        n, dm, element = chain.intervals, chain.mechanical, chain.method.element
        points, either_end, both_ends, nodes, changes = self._all_outputs
        weights, sign = element.weights[:, None], np.append(np.ones(m), -1.0)
        tests = weights * lagrange_values(np.array(gauss(m).points), element.points)
        works = np.concatenate((rows["motion"], rows["momentum"][:, None]), axis=1)[:, None]  # (N, 1, m + 1, dm)
        at_points = {name: points.row(name).reshape(n, len(weights), -1) for name in points.rows}
        yield at_points["f"][:, :, None], works, (weights * element.values * sign)[None, :, :, None]
        yield at_points["g"][:, :, None], works, (weights * element.slopes * sign)[None, :, :, None]
        yield at_points["defect"][:, :, None], rows["rates"][:, None], tests[None, :, :, None]
        yield at_points["path"], rows["path"], 1.0
        yield either_end.row("momentum"), np.stack((rows["start"], rows["end"])), -1.0
        yield either_end.row("tangent"), np.stack((rows["start_tangent"], rows["end_tangent"])), 1.0
        yield both_ends.row("conditions"), rows["ends"], 1.0
        if changes.count:
            changed = np.vstack((rows["changes"].reshape(-1, chain.changes), rows["joint_changes"]))
            yield changes.row("changes"), changed, 1.0
        if chain.constraints:
            later = np.concatenate((rows["motion"][:, 1:], rows["momentum"][:, None]), axis=1).reshape(-1, dm)
            of_constraint = np.vstack((rows["start_constraint"], rows["constraint"].reshape(-1, chain.constraints)))
            signs = np.append(-1.0, np.tile(sign[1:], n))[:, None]
            yield nodes.row("constraint"), of_constraint, 1.0
            yield nodes.row("push"), np.vstack((rows["start"], later)), signs

    def linear(self) -> Iterator[Triplet]:
        """Entries of Λ: equations x unknowns."""
        f, rows = self.chain.fields, self.chain.rows
        yield rows["x"], f["x"][1:], 1.0
        yield rows["x"], f["nodes"][:, -1], -1.0
        yield rows["momentum"], f["momentum"][1:], 1.0
        yield rows["motion"][:, 0], f["momentum"][:-1], 1.0
        yield rows["start"], f["momentum"][0], 1.0
        yield rows["end"], f["momentum"][-1], 1.0
        for name in self.chain.free:
            yield rows[name], f[name][1:], 1.0
            yield rows[name], f[name][:-1], -1.0


class Embedding:
    """A, Ê, Θ and Λ of a program.

    Attributes
    ----------
    phases : PhaseEmbedding of all phases
    joins : the layout of the inputs at the ends of all phases, where something joins these, or None
    inputs, outputs : layouts of the inputs, and of the outputs, at all kinds of places that exist
    """

    def __init__(self, numbering: Numbering) -> None:
        self.numbering, self.phases, first = numbering, list[PhaseEmbedding](), (0, 0)
        self.inputs, self.outputs = list[PlaceLayout](), list[PlaceLayout]()
        for chain in numbering.chains:
            self.phases.append(PhaseEmbedding(chain, first))
            self.inputs += self.phases[-1].inputs
            self.outputs += self.phases[-1].outputs
            first = self.inputs[-1].last, self.outputs[-1].last
        self.joins = None
        if len(self.phases) > 1:
            ends = {f"{name} {k}": size for k, phase in enumerate(self.phases) for name, size in phase.ends.items()}
            self.joins = PlaceLayout(1, ends, first[0])
            self.inputs.append(self.joins)
            self.outputs.append(PlaceLayout(1, {name: index.size for name, index in numbering.joins.items()}, first[1]))

    @cached_property
    def matrix(self) -> ca.DM:
        """A: inputs at all places x ξ."""
        triplets = [phase.given() for phase in self.phases]
        if self.joins is not None:
            triplets += [phase.at_ends(self.joins, f" {k}") for k, phase in enumerate(self.phases)]
        return sparse(chained(*triplets), (self.inputs[-1].last, self.numbering.size))

    @cached_property
    def active(self) -> list[np.ndarray]:
        """For every kind of place, the numbers of the inputs that depend on unknowns."""
        depends = np.zeros(self.matrix.shape[0], dtype=bool)
        depends[self.matrix[:, : self.numbering.unknowns].sparsity().row()] = True
        parts = np.split(depends, [place.last for place in self.inputs[:-1]])
        at_one = [part.reshape(place.count, -1) for part, place in zip(parts, self.inputs, strict=True)]
        return [np.flatnonzero(some.any(axis=0)) for some in at_one]

    @cached_property
    def differentiated(self) -> ca.DM:
        """Rows of A of the inputs that depend on unknowns, at all places x ξ."""
        rows = [
            (place.first + place.width * np.arange(place.count)[:, None] + active).ravel()
            for place, active in zip(self.inputs, self.active, strict=True)
        ]
        return self.matrix[np.concatenate(rows).tolist(), :]

    @cached_property
    def derivative(self) -> ca.DM:
        """Ê: the same rows, columns of the unknowns only."""
        return self.differentiated[:, : self.numbering.unknowns]

    @cached_property
    def test(self) -> ca.DM:
        """Θᵀ: outputs of the pointwise functions at all places x equations."""
        triplets = [phase.tested() for phase in self.phases]
        if self.joins is not None:
            triplets.append(((self.outputs[-1].row(name), index, 1.0) for name, index in self.numbering.joins.items()))
        return sparse(chained(*triplets), (self.outputs[-1].last, self.numbering.equations))

    @cached_property
    def linear(self) -> ca.DM:
        """Λ: equations x unknowns."""
        triplets = chained(*(phase.linear() for phase in self.phases))
        return sparse(triplets, (self.numbering.equations, self.numbering.unknowns))
