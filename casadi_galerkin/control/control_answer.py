"""The answer of an optimization: the path of every phase with its controls and multipliers, and the whole of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.control.control_graph import Report
from casadi_galerkin.control.failed_optimization import undefined
from casadi_galerkin.control.second_order import SecondOrder
from casadi_galerkin.problems.constrained_motion import off_constraint, tangent_at_joints
from casadi_galerkin.problems.phases import Phases, parted
from casadi_galerkin.problems.statements import FEASIBLE
from casadi_galerkin.problems.tables import off_tables
from casadi_galerkin.solution.control_path import ControlPath, joined_controls, side_by_side
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.optimal_path import PhasesTrajectory
from casadi_galerkin.solution.path import Path


def answer(
    variations: SecondOrder,
    report: Report,
    found_values: Sequence[dict[str, np.ndarray]],
    paths: Sequence[PiecewisePolynomial],
    **solve: Any,
) -> ControlTrajectory | PhasesTrajectory:
    """The answer to a problem.

    Parameters
    ----------
    variations, report : of the point that was found
    found_values, paths : values of the fields, and the path, of every phase
    solve : attributes of the path that report on the solve
    """
    problem, optimum, numbers = variations.problem, variations.optimum, variations.known_graph.numbering
    parts, multipliers = parted(problem), optimum.multipliers / numbers.units(found_values)
    solve |= {"variations": variations, "cost_size": report.cost_size}
    hamiltonians = np.split(report.hamiltonian, np.cumsum([chain.intervals for chain in numbers.chains])[:-1])
    starts = np.split(report.starts, np.cumsum([chain.dimension - chain.mechanical for chain in numbers.chains])[:-1])
    found, limits = list[ControlTrajectory](), list[ControlPath]()
    for k, (phase, chain, values, path) in enumerate(
        zip(parts.phases, numbers.chains, found_values, paths, strict=True)
    ):
        joints, mechanical, rule = path.mesh, chain.mechanical, chain.method.element.points
        parameters = None if phase.parameters is None else tuple(values["parameters"].tolist())
        span = float(joints[0]), float(joints[-1])
        solved = phase.found(span, parameters, tuple(joints[chain.breaks].tolist()))
        controls = np.concatenate(values["controls"]).T
        control = ControlPath(joints, chain.control_times, controls, rule, phase.control_bounds)
        reason = off_constraint(solved, path) or off_tables(solved, path, control)
        reason = reason or undefined(phase, path, control, parameters)
        if reason is not None:
            words = f"no path {'' if numbers.alike else f'of phase {k} '}was found: {reason}"
            raise ConvergenceError(words, Path(path), solve["residual"], solve["iterations"])
        still = np.zeros((chain.dimension - mechanical, len(joints)))
        momentum = np.vstack(((values["momentum"] * values["sizes"]).T, still))
        rates = path.at_parts(np.array([0.0, 1.0]))[1][mechanical:, [0, -1], [0, 1]].T
        weights = np.multiply.outer(np.diff(joints), chain.method.element.weights)
        pushes = np.zeros((weights.size, 0))
        if chain.path_constraints:  # multipliers of the points over their steps of time
            pushes = np.concatenate(multipliers[chain.rows["path"]] / weights[:, :, None])
        limits.append(ControlPath(joints, rule, pushes.T, rule))
        costate = chain.costate(multipliers, optimum.bound_multipliers, joints, starts[k])
        found.append(
            ControlTrajectory(
                polynomial=path,
                momentum=tangent_at_joints(solved, path, momentum),
                action=float(report.actions[k]),
                problem=solved,
                cost=report.cost if len(parts.phases) == 1 else float(report.costs[k]),
                number=k if len(parts.phases) > 1 else None,
                control=control,
                costate=costate,
                path_multipliers=limits[k] if chain.path_constraints else None,
                hamiltonian=hamiltonians[k],
                start_velocity=np.append(values["start_velocity"], rates[0]),
                end_velocity=np.append(values["end_velocity"], rates[1]),
                **(solve if len(parts.phases) == 1 else solve | {"find_comparisons": None}),
            )
        )
    if len(found) == 1:
        return found[0]
    first, last = found[0], found[-1]
    whole: dict[str, Any] = {
        "polynomial": _connected([part.polynomial for part in found]),
        "control": joined_controls([part.control for part in found]),
        "costate": _connected([part.costate for part in found]),
        "path_multipliers": joined_controls(limits) if any(len(each.values) for each in limits) else None,
        "cost": report.cost,
        "parts": tuple(found),
    }
    solved_phases = parts.found([part.problem for part in found])
    if isinstance(problem, Phases):
        return PhasesTrajectory(problem=solved_phases, **whole, **solve)
    return replace(
        first,
        momentum=np.hstack([*(part.momentum[:, :-1] for part in found[:-1]), last.momentum]),
        action=sum(part.action for part in found),
        problem=problem.found(solved_phases.t_span, first.parameters, solved_phases.breakpoints),
        hamiltonian=report.hamiltonian,
        end_velocity=last.end_velocity,
        number=None,
        find_comparisons=solve["find_comparisons"],
        **whole,
    )


def _connected(parts: Sequence[PiecewisePolynomial]) -> PiecewisePolynomial:
    """Paths one after the other as one, which may jump where one ends, by more than what a solver leaves."""
    last, inner = parts[-1], np.cumsum([len(part.mesh) - 1 for part in parts[:-1]])
    mesh = np.append(np.concatenate([part.mesh[:-1] for part in parts]), last.mesh[-1])
    values = side_by_side([*(part.values[:, :-1] for part in parts[:-1]), last.values])
    arrivals, after = side_by_side([part.local[:, :, -1] for part in parts]), values[:, last.degree * inner]
    same = np.abs(arrivals[:, inner - 1] - after) <= FEASIBLE * np.nanmax(np.abs(values), axis=1, keepdims=True)
    arrivals[:, inner - 1] = np.where(same, after, arrivals[:, inner - 1])
    return PiecewisePolynomial(mesh, last.nodes, values, arrivals)
