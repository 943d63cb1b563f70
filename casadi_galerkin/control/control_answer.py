"""The answer of an optimization: the path of every phase with its controls and multipliers, and the whole of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.control.control_graph import ControlGraph, Report
from casadi_galerkin.control.control_numbering import Chain
from casadi_galerkin.control.failed_optimization import undefined
from casadi_galerkin.control.optimizer import Optimum
from casadi_galerkin.control.second_order import SecondOrder
from casadi_galerkin.problems.constrained_motion import off_constraint, tangent_at_joints
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.phases import Phases
from casadi_galerkin.problems.tables import off_tables
from casadi_galerkin.solution.control_path import ControlPath
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solution.phases_trajectory import PhasesTrajectory


def answer(
    problem: ControlProblem | Phases,
    phases: Sequence[ControlProblem],
    graph: ControlGraph,
    optimum: Optimum,
    report: Report,
    found_values: Sequence[dict[str, np.ndarray]],
    paths: Sequence[PiecewisePolynomial],
    second_order: SecondOrder,
    **solve: Any,
) -> ControlTrajectory | PhasesTrajectory:
    """The answer to a problem.

    Parameters
    ----------
    problem, phases : as it was solved, and what it is parted into
    graph, optimum, report : of the program, and the point that was found
    found_values, paths : values of the fields, and the path, of every phase
    second_order : SecondOrder
    solve : attributes of the path that report on the solve
    """
    numbers, multipliers = graph.numbering, optimum.multipliers / graph.numbering.units(found_values)
    bound_multipliers = optimum.bound_multipliers
    whole = {**solve, "cost_size": report.cost_size, "duals": (multipliers, bound_multipliers)}
    hamiltonians = np.split(report.hamiltonian, np.cumsum([chain.intervals for chain in numbers.chains])[:-1])
    starts = np.split(report.starts, np.cumsum([chain.dimension - chain.mechanical for chain in numbers.chains])[:-1])
    found = list[ControlTrajectory]()
    for k, (phase, chain, values, path) in enumerate(zip(phases, numbers.chains, found_values, paths, strict=True)):
        joints, mechanical, rule = path.mesh, chain.mechanical, chain.method.element.points
        parameters = None if phase.parameters is None else tuple(values["parameters"].tolist())
        span = float(joints[0]), float(joints[-1])
        solved = phase.found(span, parameters, tuple(joints[chain.breaks].tolist()))
        controls = np.concatenate(values["controls"]).T
        control = ControlPath(joints, chain.control_times, controls, rule, phase.control_bounds)
        for reason, residual in (
            (off_constraint(solved, path) or off_tables(solved, path, control), solve["residual"]),
            (undefined(phase, path, control, parameters), math.inf),
        ):
            if reason is not None:
                where = "" if numbers.alike else f"of phase {k} "
                raise ConvergenceError(f"no path {where}was found: {reason}", Path(path), residual, solve["iterations"])
        momentum = np.zeros((chain.dimension, len(joints)))
        momentum[:mechanical] = (values["momentum"] * values["sizes"]).T
        rates = path.at_parts(np.array([0.0, 1.0]))[1][mechanical:, [0, -1], [0, 1]].T
        costate = chain.costate(multipliers, bound_multipliers, joints, starts[k])
        found.append(
            ControlTrajectory(
                polynomial=path,
                momentum=tangent_at_joints(solved, path, momentum),
                action=float(report.actions[k]),
                problem=solved,
                find_remaining_error=partial(second_order.remaining_error, k),
                find_sensitivity=second_order.sensitivity,
                cost=report.cost if len(phases) == 1 else float(report.costs[k]),
                control=control,
                costate=costate,
                path_multipliers=_path_multipliers(chain, multipliers, joints),
                hamiltonian=hamiltonians[k],
                start_velocity=np.append(values["start_velocity"], rates[0]),
                end_velocity=np.append(values["end_velocity"], rates[1]),
                **whole,
            )
        )
    if isinstance(problem, Phases):
        solved_phases = problem.found([one.problem for one in found])
        return PhasesTrajectory(phases=_parts(found), problem=solved_phases, cost=report.cost, **whole)
    return found[0] if len(found) == 1 else _in_one(problem, phases, found, report.cost, second_order)


def _path_multipliers(chain: Chain, multipliers: np.ndarray, joints: np.ndarray) -> ControlPath | None:
    """Multipliers of the path constraints as functions of time: those of the points over their steps of time."""
    if not chain.path_constraints:
        return None
    rule = chain.method.element
    values = multipliers[chain.rows["path"]] / np.multiply.outer(np.diff(joints), rule.weights)[:, :, None]
    return ControlPath(joints, rule.points, np.concatenate(values).T, rule.points)


def _in_one(
    problem: ControlProblem,
    phases: Sequence[ControlProblem],
    parts: list[ControlTrajectory],
    cost: float,
    second_order: SecondOrder,
) -> ControlTrajectory:
    """The phases into which one problem was parted as its answer."""
    first, last, laws = parts[0], parts[-1], dict(problem.jumps)
    breakpoints = tuple(t for part in parts for t in (*part.problem.breakpoints, part.problem.t_span[1]))[:-1]
    span = first.problem.t_span[0], last.problem.t_span[1]
    limits = [part.path_multipliers for part in parts if part.path_multipliers is not None]
    return replace(
        first,
        polynomial=_connected([part.polynomial for part in parts], [phase.t_span[1] in laws for phase in phases]),
        momentum=np.hstack([*(part.momentum[:, :-1] for part in parts[:-1]), last.momentum]),
        action=sum(part.action for part in parts),
        problem=problem.found(span, first.parameters, breakpoints),
        find_remaining_error=second_order.remaining_error,
        cost=cost,
        control=_one_after_the_other([part.control for part in parts]),
        costate=_connected([part.costate for part in parts], [True] * len(parts)),
        path_multipliers=_one_after_the_other(limits) if limits else None,
        hamiltonian=np.concatenate([part.hamiltonian for part in parts]),
        end_velocity=last.end_velocity,
        parts=_parts(parts),
    )


def _parts(parts: list[ControlTrajectory]) -> tuple[ControlTrajectory, ...]:
    """Phases that are not asked for what only the whole knows."""
    errors, derivatives = partial(_refuse, "errors"), partial(_refuse, "derivatives")
    return tuple(replace(part, find_comparisons=errors, find_sensitivity=derivatives) for part in parts)


def _refuse(what: str, _: object) -> Any:
    raise ValueError(f"a phase has no {what} of its own: ask the whole path")


def _one_after_the_other(parts: list[ControlPath]) -> ControlPath:
    first, values = parts[0], np.hstack([part.values for part in parts])
    mesh = np.append(np.concatenate([part.mesh[:-1] for part in parts]), parts[-1].mesh[-1])
    return ControlPath(mesh, first.points, values, first.rule, first.bounds)


def _connected(parts: Sequence[PiecewisePolynomial], jumping: Sequence[bool]) -> PiecewisePolynomial:
    """Paths one after the other as one, which may jump at the ends of some."""
    last = parts[-1]
    mesh = np.append(np.concatenate([part.mesh[:-1] for part in parts]), last.mesh[-1])
    values = np.hstack([*(part.values[:, :-1] for part in parts[:-1]), last.values])
    arrivals = np.hstack([part.local[:, :, -1] for part in parts])
    for joint, jumps in zip(np.cumsum([len(part.mesh) - 1 for part in parts]).tolist(), jumping, strict=True):
        if not jumps:
            arrivals[:, joint - 1] = values[:, joint * last.degree]
    return PiecewisePolynomial(mesh, last.nodes, values, arrivals)
