"""Why a boundary problem was not solved: what happened, where in time, how far it got, and what to try."""

from __future__ import annotations

import math

import numpy as np

from casadi_galerkin.action_graph import ActionGraph
from casadi_galerkin.calculus import DiscreteCalculus
from casadi_galerkin.layout import Data, clock
from casadi_galerkin.newton import Solution, SolveFailure
from casadi_galerkin.operators import embedding
from casadi_galerkin.polynomial import PiecewisePolynomial
from casadi_galerkin.system import joined
from casadi_galerkin.trajectory import ConjugatePointError, ConvergenceError


def not_finite(graph: ActionGraph, unknowns: np.ndarray, data: Data) -> str:
    """Say at which time the Lagrangian or its derivatives first are not finite."""
    pointwise, parameters = graph.functional.pointwise, data[3:]
    times, steps = clock(graph.layout, data[2])
    x, slope = (np.array(a) for a in embedding(graph.layout)(joined(unknowns, data)))
    for k in np.argsort(times, kind="stable"):
        results = pointwise.first(times[k], steps[k], x[:, k], slope[:, k], *parameters)
        if not all(np.all(np.isfinite(np.array(result))) for result in results):
            v = slope[:, k] / steps[k]
            return f"the Lagrangian is not finite at t = {times[k]:.6g}, where x = {x[:, k]} and v = {v}"
    return "the Lagrangian overflows"


def refuse_undefined(graph: ActionGraph, solution: Solution, path: PiecewisePolynomial, data: Data) -> None:
    """Raise if the action is not finite on a path that solves the equations."""
    if math.isfinite(solution.action):
        return
    place = not_finite(graph, solution.unknowns, data)
    raise ConvergenceError(
        f"no path was found: the equations have a solution, but on it {place}. "
        "Try a guess that stays where the Lagrangian is defined",
        path,
        solution.residual,
        solution.iterations,
    )


def conjugate(solution: Solution, path: PiecewisePolynomial, quotient: float) -> ConjugatePointError:
    """Report that the second variation vanishes at a path that was found."""
    return ConjugatePointError(
        f"the second variation of the action vanishes (relative size {quotient:.0e}): the ends are conjugate points, "
        "or a family of paths joins them. Move an end, change the time span, or fix a component that a symmetry leaves "
        "free",
        path,
        solution.residual,
        solution.iterations,
    )


def explained(graph: ActionGraph, failure: SolveFailure, path: PiecewisePolynomial, data: Data) -> ConvergenceError:
    """Report what an engine failed at; `path` is its last iterate."""
    unknowns, times = failure.unknowns, DiscreteCalculus(graph.method, data[2]).node_times
    *_, g, floor = graph.system.evaluate("judged", unknowns, data)
    residual = np.abs(g) / floor
    worst = int(np.argmax(np.where(np.isfinite(residual), residual, np.inf)))
    when = times[np.argmax((graph.layout.numbering == worst).any(axis=1))]
    place = f"the largest residual is at t = {when:.6g}"
    if not np.all(np.isfinite(g)):
        place = not_finite(graph, unknowns, data)
    where = f"after {failure.iterations} iterations; {place}"
    if failure.singular:
        return ConjugatePointError(
            f"{failure}: {where}. The ends may be conjugate points, or a symmetry leaves a component free: "
            "move an end, change the time span, or fix that component",
            path,
            float(residual[worst]),
            failure.iterations,
        )
    return ConvergenceError(
        f"no path was found: {failure} ({where}). Try a guess nearer to the path, more intervals, "
        "or a shorter time span; there may be no path between these ends",
        path,
        float(residual[worst]),
        failure.iterations,
    )
