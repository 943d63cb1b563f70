"""Constant sparse matrices from the unknowns to the inputs of pointwise functions, and from their outputs to equations.

The inputs of the pointwise functions are linear in the vector ξ of unknowns and data (`control_numbering`),

    (x, x', u, T, π, t_0, s, σ, S) at all quadrature points,    (x, v, π, t, S) at either end    =  A ξ,

and so are those at both ends together, at the nodes of a constraint, and at crossings.  The x' = h v are reference
slopes, and π the parameters.  Here t_0 is the start and T the duration of a phase, and s and σ are fractions of it:
the time is t = t_0 + T s and the step h = T σ.  S are the units of the momenta.  The derivatives are products with

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

At a crossing, with p_- before it and x_+ and p_+ after it, these equations are x_{i+1} - x_+ = 0 and p_{i+1} - p_+ = 0,
and p_- - Σ ( l_m f + l_m' g ) = 0 determines the velocity just before the crossing.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.nodes import lagrange_values
from casadi_galerkin.calculus.quadrature import gauss
from casadi_galerkin.control.control_numbering import Chain

Triplet = tuple[np.ndarray, np.ndarray, np.ndarray | float]  # rows, columns, entries, to be broadcast


def sparse(triplets: Iterable[Triplet], shape: tuple[int, int]) -> ca.DM:
    """Constant sparse matrix from triplets without repetitions; zeros are dropped."""
    flat = [[a.ravel() for a in np.broadcast_arrays(*triplet)] for triplet in triplets]
    rows, columns, entries = (np.concatenate(parts) for parts in zip(*flat, strict=True))
    rows, columns, entries = (a[entries != 0] for a in (rows, columns, entries))
    return ca.DM.triplet(rows.tolist(), columns.tolist(), ca.DM(entries), *shape)


@dataclass(frozen=True, eq=False)
class PlaceLayout:
    """The layout of the inputs, or of the outputs, of a pointwise function at all places of one kind.

    A kind of place is the quadrature points, either end, both ends together, the nodes, or one crossing.  The values at
    one place are consecutive rows of A (inputs) or Θᵀ (outputs).

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


def stacked(counts: Iterable[int], rows: Iterable[dict[str, int]]) -> list[PlaceLayout]:
    """Layouts of several kinds of places, one after the other, from the number and the rows of each."""
    layouts, first = list[PlaceLayout](), 0
    for count, named in zip(counts, rows, strict=True):
        layouts.append(PlaceLayout(count, named, first))
        first = layouts[-1].last
    return layouts


class ChainEmbedding:
    """A, Ê, Θ and Λ of a chain.

    At a quadrature point the outputs are f and g of the mechanical components, the defects of the others, and the path
    constraints; at either end ∂L/∂v and the time derivative of the constraint; at both ends the end conditions; at the
    nodes the constraint and its impulse; at a crossing x after it, ∂L/∂v before and after it, and the condition there.

    Attributes
    ----------
    points, either_end, both_ends, nodes : layouts of the inputs at the quadrature points, at each end, at both ends
        together, and at the nodes with a constraint
    crossings : layouts of the inputs at each crossing
    inputs, outputs : layouts of the inputs, and of the outputs, at all kinds of places that exist
    """

    def __init__(self, chain: Chain) -> None:
        self.chain = chain
        d, dm, constraints = chain.dimension, chain.mechanical, chain.constraints
        common = {"parameters": chain.parameters}
        at_end = {"x": d, "velocity": dm, **common, "time": 1, "sizes": dm}
        both = {f"{name}{k}": at_end[name] for k in (0, 1) for name in ("x", "velocity")} | {**common, "time": 1}
        when = {"duration": 1, **common, "begin": 1, "fraction": 1}
        at_point = {"x": d, "slope": d, "controls": chain.controls, **when, "part": 1, "sizes": dm}
        at_node = {"x": d, "impulse": constraints, **when, "sizes": dm}
        crossing = {"x": d, "velocity": dm, **when, "sizes": dm}
        r, m, joined = len(chain.method.quadrature), chain.method.degree, chain.conditions > 0 or chain.terminal_cost
        counts, inputs, outputs = zip(
            (chain.intervals * r, at_point, {"f": dm, "g": dm, "defect": d - dm, "path": chain.path_constraints}),
            (2, at_end, {"momentum": dm, "tangent": constraints}),
            (int(joined), both, {"conditions": chain.conditions}),
            ((chain.intervals * m + 1) * (constraints > 0), at_node, {"constraint": constraints, "push": dm}),
            *((1, crossing, {"x": d, "before": dm, "after": dm, "condition": k}) for k in chain.conditions_there),
            strict=True,
        )
        all_inputs, self._all_outputs = stacked(counts, inputs), stacked(counts, outputs)
        self.points, self.either_end, self.both_ends, self.nodes, *self.crossings = all_inputs
        self.inputs, self.outputs = (
            [place for place in layouts if place.count] for layouts in (all_inputs, self._all_outputs)
        )

    @cached_property
    def matrix(self) -> ca.DM:
        """A: inputs at all places x ξ."""
        f, p, m = self.chain.fields, self.points, self.chain.method.degree
        element, r = self.chain.method.element, len(self.chain.method.quadrature)
        nodes = np.concatenate((f["x"][:-1, None], f["nodes"]), axis=1)[:, None]  # (N, 1, m + 1, d)
        interval, k = np.divmod(np.arange(p.count), r)
        basis = [a[None, :, :, None] for a in (element.values, element.slopes)]
        shape = (self.chain.intervals, r, 1, -1)
        triplets: list[Triplet] = [
            (p.row("x").reshape(shape), nodes, basis[0]),
            (p.row("slope").reshape(shape), nodes, basis[1]),
            (p.row("controls"), f["controls"][interval, k % f["controls"].shape[1]], 1.0),
            (p.row("part"), f["part"][interval][:, None], 1.0),
            *self._times_and_parameters(p, interval, element.points[k]),
        ]
        x, velocity = f["x"][[0, -1]], np.stack((f["start_velocity"], f["end_velocity"]))
        at_either = {"x": x, "velocity": velocity, "parameters": f["parameters"][[0, -1]], "sizes": f["sizes"]}
        at_both = {"x0": x[0], "velocity0": velocity[0], "x1": x[1], "velocity1": velocity[1]}
        at_both["parameters"] = f["parameters"][-1]
        for place, entries in ((self.either_end, at_either), (self.both_ends, at_both)):
            triplets += [(place.row(name), index, 1.0) for name, index in entries.items()]
            triplets += [(place.row("time"), f["begin"], 1.0), (place.row("time")[-1:], f["durations"][-1], 1.0)]
        if self.chain.constraints:  # at the first node, then at those after it on every interval
            interval, a = np.divmod(np.arange(self.chain.intervals * m), m)
            impulses = f["impulses"].reshape(-1, self.chain.constraints)
            triplets += [
                (self.nodes.row("x"), np.vstack((f["x"][:1], f["nodes"].reshape(-1, self.chain.dimension))), 1.0),
                (self.nodes.row("impulse"), np.vstack((f["start_impulse"], impulses)), 1.0),
                *self._times_and_parameters(self.nodes, np.append(0, interval), np.append(0.0, element.nodes[1:][a])),
            ]
        for i, (place, before) in enumerate(zip(self.crossings, self.chain.crossed - 1, strict=True)):
            triplets += [
                (place.row("x"), f["nodes"][before, -1], 1.0),
                (place.row("velocity"), f["velocity"][i], 1.0),
                *self._times_and_parameters(place, np.array([before]), np.ones(1)),
            ]
        return sparse(triplets, (self.inputs[-1].last, self.chain.size))

    def _times_and_parameters(self, place: PlaceLayout, interval: np.ndarray, fraction: np.ndarray) -> list[Triplet]:
        """Entries of A for times, parameters and S at K places at the fractions `fraction` of their intervals."""
        f, phases = self.chain.fields, self.chain.phases[interval, None]
        earlier = np.arange(f["durations"].shape[1]) < phases
        return [
            (place.row("duration"), f["durations"][interval[:, None], phases], 1.0),
            (place.row("parameters"), f["parameters"][interval], 1.0),
            (place.row("begin"), f["begin"], 1.0),
            (place.row("begin"), f["durations"][interval], earlier.astype(float)),
            (place.row("fraction"), f["left"][interval][:, None], 1.0),
            (place.row("fraction"), f["part"][interval][:, None], fraction[:, None]),
            (place.row("sizes"), f["sizes"], 1.0),
        ]

    @cached_property
    def active(self) -> list[np.ndarray]:
        """For every kind of place, the numbers of the inputs that depend on unknowns."""
        depends = np.zeros(self.matrix.shape[0], dtype=bool)
        depends[self.matrix[:, : self.chain.unknowns].sparsity().row()] = True
        parts = np.split(depends, [place.last for place in self.inputs[:-1]])
        return [
            np.flatnonzero(part.reshape(place.count, -1).any(axis=0))
            for part, place in zip(parts, self.inputs, strict=True)
        ]

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
        return self.differentiated[:, : self.chain.unknowns]

    @cached_property
    def test(self) -> ca.DM:
        """Θᵀ: outputs of the pointwise functions at all places x equations."""
        chain, rows, m = self.chain, self.chain.rows, self.chain.method.degree
        n, dm, element = chain.intervals, chain.mechanical, chain.method.element
        points, either_end, both_ends, nodes, *crossings = self._all_outputs
        weights, sign = element.weights[:, None], np.append(np.ones(m), -1.0)
        tests = weights * lagrange_values(np.array(gauss(m).points), element.points)
        works = np.concatenate((rows["motion"], chain.arrivals[:, None]), axis=1)[:, None]  # (N, 1, m + 1, dm)
        at_points = {name: points.row(name).reshape(n, len(weights), -1) for name in points.rows}
        triplets: list[Triplet] = [
            (at_points["f"][:, :, None], works, (weights * element.values * sign)[None, :, :, None]),
            (at_points["g"][:, :, None], works, (weights * element.slopes * sign)[None, :, :, None]),
            (at_points["defect"][:, :, None], rows["rates"][:, None], tests[None, :, :, None]),
            (at_points["path"], rows["path"], 1.0),
            (either_end.row("momentum"), np.stack((rows["start"], rows["end"])), -1.0),
            (either_end.row("tangent"), np.stack((rows["start_tangent"], rows["end_tangent"])), 1.0),
            (both_ends.row("conditions"), rows["ends"], 1.0),
        ]
        if chain.constraints:
            later = np.concatenate((rows["motion"][:, 1:], rows["momentum"][:, None]), axis=1).reshape(-1, dm)
            of_constraint = np.vstack((rows["start_constraint"], rows["constraint"].reshape(-1, chain.constraints)))
            signs = np.append(-1.0, np.tile(sign[1:], n))[:, None]
            triplets += [
                (nodes.row("constraint"), of_constraint, 1.0),
                (nodes.row("push"), np.vstack((rows["start"], later)), signs),
            ]
        for i, (place, joint) in enumerate(zip(crossings, chain.crossed.tolist(), strict=True)):
            after = [rows["x"][joint - 1], rows["arrival"][i], rows["momentum"][joint - 1], rows[f"waypoint {i}"]]
            signs = np.repeat([-1.0, 1.0, -1.0, 1.0], [len(part) for part in after])
            triplets.append((place.first + np.arange(place.width), np.concatenate(after), signs))
        return sparse(triplets, (self._all_outputs[-1].last, chain.equations))

    @cached_property
    def linear(self) -> ca.DM:
        """Λ: equations x unknowns."""
        chain = self.chain
        f, rows = chain.fields, chain.rows
        free = [f[name] for name in chain.free]
        constants = np.concatenate(free, axis=1) if free else np.zeros((chain.intervals + 1, 0), dtype=np.int64)
        smooth = np.delete(np.arange(chain.intervals), chain.crossed - 1)
        triplets: list[Triplet] = [
            (rows["x"], f["x"][1:], 1.0),
            (rows["x"][smooth], f["nodes"][smooth, -1], -1.0),
            (rows["momentum"], f["momentum"][1:], 1.0),
            (rows["motion"][:, 0], f["momentum"][:-1], 1.0),
            (rows["constants"], constants[1:], 1.0),
            (rows["constants"], constants[:-1], -1.0),
            (rows["start"], f["momentum"][0], 1.0),
            (rows["end"], f["momentum"][-1], 1.0),
        ]
        return sparse(triplets, (chain.equations, chain.unknowns))
