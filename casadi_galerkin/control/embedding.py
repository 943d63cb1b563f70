"""The constant matrices that take the vector ξ of the `Chain` to every point, and back to the equations.

What the pointwise functions see is linear in ξ,

    (x, x', u, T, p, t_0, s, σ, S) at all quadrature points,    (x, v, p, t, S) at either end    =  A ξ,

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
interval before ends with, x_{i+1} - X_m = 0.  A constraint adds its impulse GᵀΛ_a to the equation of every node but the
first, and there to that of the velocity at the start.

Before a joint that is crossed with a law, Θ and Λ hold the law's values, x_{i+1} - X_+ = 0 and p_{i+1} - p_+ = 0, and
p_- - Σ ( l_m f + l_m' g ) = 0, which says which velocity the law takes.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.nodes import lagrange_values
from casadi_galerkin.calculus.quadrature import gauss
from casadi_galerkin.control.chain import Chain

Triplet = tuple[np.ndarray, np.ndarray, np.ndarray | float]  # rows, columns, entries, to be broadcast


def sparse(triplets: Iterable[Triplet], shape: tuple[int, int]) -> ca.DM:
    """Constant sparse matrix from triplets without repetitions; zeros are dropped."""
    flat = [[a.ravel() for a in np.broadcast_arrays(*triplet)] for triplet in triplets]
    rows, columns, entries = (np.concatenate(parts) for parts in zip(*flat, strict=True))
    rows, columns, entries = (a[entries != 0] for a in (rows, columns, entries))
    order = np.lexsort((rows, columns))
    starts = np.searchsorted(columns[order], np.arange(shape[1] + 1))
    return ca.DM(ca.Sparsity(*shape, starts.tolist(), rows[order].tolist()), entries[order])


@dataclass(frozen=True, eq=False)
class Places:
    """Places of one kind: how many there are, and what is known at each, or what the pointwise functions return there.

    Attributes
    ----------
    count : number of places
    rows : name and length of what is known or returned, in this order
    first : first row of A, or of Θᵀ, that belongs to them
    """

    count: int
    rows: dict[str, int]
    first: int

    @property
    def width(self) -> int:
        """Rows at one place."""
        return sum(self.rows.values())

    @property
    def last(self) -> int:
        """Row after theirs."""
        return self.first + self.count * self.width

    def row(self, name: str) -> np.ndarray:
        """Rows of a name, (count, length)."""
        names = list(self.rows)
        offset = sum(self.rows[other] for other in names[: names.index(name)])
        starts = self.first + offset + self.width * np.arange(self.count)
        return starts[:, None] + np.arange(self.rows[name])


class ChainEmbedding:
    """A, Ê, Θ and Λ of a chain.

    Attributes
    ----------
    points, either_end, both_ends, nodes : Places
    crossings : list of Places, one for each joint crossed
    """

    def __init__(self, chain: Chain) -> None:
        self.chain = chain
        d, mechanical, common = chain.dimension, chain.mechanical, {"parameters": chain.parameters}
        at_end = {"x": d, "velocity": mechanical, **common, "time": 1, "sizes": mechanical}
        when = {"duration": 1, **common, "begin": 1, "share": 1}
        along = {"x": d, "slope": d, "controls": chain.controls, **when, "part": 1, "sizes": mechanical}
        both = {f"{name}{k}": at_end[name] for k in (0, 1) for name in ("x", "velocity")} | {**common, "time": 1}
        at_node = {"x": d, "impulse": chain.constraints, **when, "sizes": mechanical}
        r, m = len(chain.method.quadrature), chain.method.degree
        self.points = Places(chain.intervals * r, along, 0)
        self.either_end = Places(2, at_end, self.points.last)
        joined = chain.conditions > 0 or chain.terminal_cost
        self.both_ends = Places(int(joined), both, self.either_end.last)
        self.nodes = Places((chain.intervals * m + 1) * (chain.constraints > 0), at_node, self.both_ends.last)
        crossing, first = {"x": d, "velocity": mechanical, **when, "sizes": mechanical}, self.nodes.last
        width = sum(crossing.values())
        self.crossings = [Places(1, crossing, first + k * width) for k in range(len(chain.crossed))]

    @property
    def places(self) -> list[Places]:
        """Kinds of places that there are."""
        kinds = (self.points, self.either_end, self.both_ends, self.nodes, *self.crossings)
        return [place for place in kinds if place.count]

    @property
    def with_costs(self) -> list[int]:
        """Numbers of the kinds of places that have a cost: the points, and both ends where there is a terminal cost."""
        return [0, 2] if self.chain.terminal_cost else [0]

    @cached_property
    def _returned(self) -> list[Places]:
        """What the pointwise functions return at all kinds of places, whether there are such places or not.

        At a quadrature point these are f and g of the mechanical components, the defects of the others, and the path
        constraints; at either end ∂L/∂v and the rate of the constraint; the conditions on both; at the nodes it and
        its impulse; at the joints crossed x after, ∂L/∂v before and after, and the condition.
        """
        chain, dm, found, first = self.chain, self.chain.mechanical, list[Places](), 0
        along = {"f": dm, "g": dm, "defect": chain.dimension - dm, "path": chain.path_constraints}
        crossed = {"x": chain.dimension, "before": dm, "after": dm}
        for place, rows in (
            (self.points, along),
            (self.either_end, {"momentum": dm, "tangent": chain.constraints}),
            (self.both_ends, {"conditions": chain.conditions}),
            (self.nodes, {"constraint": chain.constraints, "push": dm}),
            *zip(self.crossings, ({**crossed, "condition": k} for k in chain.conditions_there), strict=True),
        ):
            found.append(Places(place.count, rows, first))
            first = found[-1].last
        return found

    @property
    def returned(self) -> list[Places]:
        """What the pointwise functions return at the kinds of places that there are."""
        return [place for place in self._returned if place.count]

    @cached_property
    def matrix(self) -> ca.DM:
        """A: (all places) x ξ."""
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
            *self._along(p, interval, element.points[k]),
            (self.either_end.row("time")[1], f["durations"][-1], 1.0),
        ]
        velocities = f["start_velocity"], f["end_velocity"]
        entries = {"x": f["x"][[0, -1]], "velocity": np.stack(velocities), "parameters": f["parameters"][[0, -1]]}
        entries |= {"time": f["begin"], "sizes": f["sizes"]}
        triplets += [(self.either_end.row(name), index, 1.0) for name, index in entries.items()]
        if self.both_ends.count:
            entries = {f"x{k}": f["x"][-k] for k in (0, 1)} | {f"velocity{k}": velocities[k] for k in (0, 1)}
            entries |= {"parameters": f["parameters"][-1], "time": f["begin"]}
            triplets += [(self.both_ends.row(name), index, 1.0) for name, index in entries.items()]
            triplets.append((self.both_ends.row("time"), f["durations"][-1:], 1.0))
        if self.chain.constraints:  # at the first node, then at those after it on every interval
            interval, a = np.divmod(np.arange(self.chain.intervals * m), m)
            impulses = f["impulses"].reshape(-1, self.chain.constraints)
            triplets += [
                (self.nodes.row("x"), np.vstack((f["x"][:1], f["nodes"].reshape(-1, self.chain.dimension))), 1.0),
                (self.nodes.row("impulse"), np.vstack((f["start_impulse"], impulses)), 1.0),
                *self._along(self.nodes, np.append(0, interval), np.append(0.0, element.nodes[1:][a])),
            ]
        for i, (place, before) in enumerate(zip(self.crossings, self.chain.crossed - 1, strict=True)):
            triplets += [
                (place.row("x"), f["nodes"][before, -1], 1.0),
                (place.row("velocity"), f["velocity"][i], 1.0),
                *self._along(place, np.array([before]), np.ones(1)),
            ]
        return sparse(triplets, (self.places[-1].last, self.chain.size))

    def _along(self, place: Places, interval: np.ndarray, share: np.ndarray) -> list[Triplet]:
        """Entries of A for the times of places, given as intervals (K,) and parts of these (K,); p and S there."""
        f, phases = self.chain.fields, self.chain.phases[interval, None]
        earlier = np.arange(f["durations"].shape[1]) < phases
        return [
            (place.row("duration"), f["durations"][interval[:, None], phases], 1.0),
            (place.row("parameters"), f["parameters"][interval], 1.0),
            (place.row("begin"), f["begin"], 1.0),
            (place.row("begin"), f["durations"][interval], earlier.astype(float)),
            (place.row("share"), f["left"][interval][:, None], 1.0),
            (place.row("share"), f["part"][interval][:, None], share[:, None]),
            (place.row("sizes"), f["sizes"], 1.0),
        ]

    @cached_property
    def active(self) -> list[np.ndarray]:
        """For every kind of place, which of its rows depend on unknowns."""
        depends = np.zeros(self.matrix.shape[0], dtype=bool)
        depends[self.matrix[:, : self.chain.unknowns].sparsity().row()] = True
        parts = np.split(depends, [place.last for place in self.places[:-1]])
        return [
            np.flatnonzero(part.reshape(place.count, -1).any(axis=0))
            for part, place in zip(parts, self.places, strict=True)
        ]

    @cached_property
    def differentiated(self) -> ca.DM:
        """Rows of A that are differentiated by, of all places x ξ."""
        rows = [
            (place.first + place.width * np.arange(place.count)[:, None] + active).ravel()
            for place, active in zip(self.places, self.active, strict=True)
        ]
        return self.matrix[np.concatenate(rows).tolist(), :]

    @cached_property
    def derivative(self) -> ca.DM:
        """Ê: the same by unknowns only."""
        return self.differentiated[:, : self.chain.unknowns]

    @cached_property
    def test(self) -> ca.DM:
        """Θᵀ: what the pointwise functions return, at all places x equations."""
        chain, rows, m = self.chain, self.chain.rows, self.chain.method.degree
        n, dm, element = chain.intervals, chain.mechanical, chain.method.element
        points, either_end, both_ends, nodes, *crossings = self._returned
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
        return sparse(triplets, (self._returned[-1].last, chain.equations))

    @cached_property
    def linear(self) -> ca.DM:
        """Λ: equations x unknowns."""
        chain = self.chain
        f, rows = chain.fields, chain.rows
        free = [f[name] for name in ("durations", "parameters") if chain.is_free(name)]
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
