"""Judges the point where the solver stopped: how far every constraint is violated, and what it is called."""

from __future__ import annotations

import numpy as np

from casadi_galerkin.control.graph import Report
from casadi_galerkin.control.numbering import ControlNumbering
from casadi_galerkin.control.optimizer import ProgramBounds
from casadi_galerkin.problems.control_problem import ControlProblem

VANISHED = 1e-13  # part of its terms along the guess below which a component's are taken for their roundoff


def limits_of(problem: ControlProblem, numbering: ControlNumbering) -> ProgramBounds:
    """Bounds of the unknowns and of the equations."""
    sides = []
    for k, infinite in ((0, -np.inf), (1, np.inf)):
        values = {name: np.full(index.shape, infinite) for name, index in numbering.fields.items()}
        values["path"] = np.broadcast_to(problem.position_bounds[k], (numbering.nodes, problem.dimension))
        values["controls"] = np.broadcast_to(problem.control_bounds[k], (numbering.points, problem.controls))
        if problem.duration_bounds is not None:
            values["duration"] = np.array([problem.duration_bounds[k]])
        if problem.parameter_bounds is not None:
            values["parameters"] = np.array(problem.parameter_bounds[k])
        constraint = () if problem.path_constraint is None else problem.path_constraint[1 + k]
        equations = np.append(np.zeros(numbering.nodes * problem.dimension), np.tile(constraint, numbering.points))
        sides.append((numbering.pack(values)[0], equations))
    (lower, equations_lower), (upper, equations_upper) = sides
    return ProgramBounds(lower, upper, equations_lower, equations_upper)


def violations(
    numbering: ControlNumbering,
    limits: ProgramBounds,
    unknowns: np.ndarray,
    report: Report,
    terms_before: np.ndarray,
) -> np.ndarray:
    """Violation of every equation, then of every unknown's bounds, relative to the sizes of what is compared.

    The equations of motion of a component are measured by the largest sum of terms that one of them has along the path,
    or along the guess (`terms_before`) where it has vanished and its terms are what rounding left of those; a path
    constraint by the sizes of what its value is made of, |∇g||z|, or its finite bound, a bound by itself.
    """
    motion, d, c = numbering.nodes * numbering.dimension, numbering.dimension, numbering.constraints
    now, before = (np.max(given[:motion].reshape(-1, d), axis=0) for given in (report.terms, terms_before))
    sizes = [_or_one(np.where(now <= VANISHED * before, before, now))] * numbering.nodes
    if c:
        sides = (limits.equations_lower, limits.equations_upper, report.terms)
        finite = [np.abs(np.where(np.isfinite(side), side, 0.0))[motion:].reshape(-1, c).max(axis=0) for side in sides]
        sizes += [_or_one(np.max(finite, axis=0))] * numbering.points
    excess = _excess(report.equations, limits.equations_lower, limits.equations_upper)
    beyond = _excess(unknowns, limits.lower, limits.upper)
    return np.concatenate((excess / np.concatenate(sizes), beyond / _or_one(np.abs(unknowns))))


def _excess(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """By how much values leave their bounds; infinite where they are not numbers."""
    excess = np.maximum(np.maximum(low - values, values - high), 0.0)
    return np.asarray(np.where(np.isfinite(values), excess, np.inf))


def _or_one(sizes: np.ndarray) -> np.ndarray:
    return np.asarray(np.where(sizes > 0, sizes, 1.0))


def name_equation(numbering: ControlNumbering, row: int) -> tuple[str, float]:
    """What an equation is called, and where it stands, in intervals since the start."""
    motion = numbering.nodes * numbering.dimension
    if row < motion:
        node, i = divmod(row, numbering.dimension)
        interval = min(node // numbering.method.degree, numbering.intervals - 1)
        inner = numbering.method.element.nodes[node - interval * numbering.method.degree]
        return f"the equation of motion of x[{i}]", float(interval + inner)
    point, i = divmod(row - motion, numbering.constraints)
    return f"path constraint {i}", _at_point(numbering, point)


def name_unknown(numbering: ControlNumbering, index: int) -> tuple[str, float]:
    """What an unknown is called, and where it stands, in intervals since the start."""
    names = {"path": "x", "controls": "u", "duration": "the duration", "parameters": "p"}
    for field, entries in numbering.fields.items():
        found = np.argwhere(entries == index)
        if len(found) == 0:
            continue
        name = names.get(field, field)
        label = name if field == "duration" else f"{name}[{found[0][-1]}]"
        if field == "path":
            node, degree = int(found[0][0]), numbering.method.degree
            interval = min(node // degree, numbering.intervals - 1)
            return label, float(interval + numbering.method.element.nodes[node - interval * degree])
        if field == "controls":
            return label, _at_point(numbering, int(found[0][0]))
        return label, float(numbering.intervals if field == "end_velocity" else 0)
    raise IndexError(index)


def _at_point(numbering: ControlNumbering, point: int) -> float:
    interval, k = divmod(point, len(numbering.method.quadrature))
    return float(interval + numbering.method.quadrature.points[k])
