"""Derivatives of solutions by their data: a solve as a CasADi Function, and the sensitivities of one path.

Let ξ(d) solve ∇S(ξ, d) = 0 for the data d, which are ends and parameters.  Where ∇²S is regular, the implicit function
theorem gives its derivative from the same matrix that Newton's method used:

    ∇²S ∂ξ/∂d = -∂∇S/∂d.

CasADi's rootfinder applies this rule, so that `solution_function` has forward and reverse derivatives of any order.
`sensitivity` applies the rule directly: one factorization for all data.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.boundary.transcription import transcribed
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.constrained_motion import relative_residuals
from casadi_galerkin.solution.error_indicators import kinks_in_place
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.solvers.derivatives import Sensitivity, verified_function
from casadi_galerkin.solvers.linear_solver import all_finite
from casadi_galerkin.solvers.rootfinder import embeddable
from casadi_galerkin.solvers.stationarity import ACCEPTED, Stationarity


def boundary_function(
    problem: BoundaryProblem, method: Galerkin, intervals: int | None, mesh: ArrayLike | None, guess: Guess | None
) -> ca.Function:
    """Turn a boundary solve into a differentiable Function; see `solution_function` for the arguments."""
    _refuse_energy("solution_function", problem)
    transcription = transcribed(problem, method, intervals, mesh)
    point = transcription.critical_point(guess=guess)
    _refuse_kinks("solution_function", transcription.trajectory(point, 0.0))  # which refuses a singular Hessian
    functional, numbering = transcription.functional, transcription.numbering
    unknowns, known = point.solution.unknowns, point.solution.data
    weights = 1 / transcription.stationarity.sizes_of_terms(unknowns, known)
    symbols = functional.symbols
    data = {name: symbols[name] for name in ("start", "end", "parameters") if name in symbols}
    joints = {"mesh": ca.DM(known[2])} | ({"given": ca.DM(known[-1])} if "given" in symbols else {})
    nodes = ca.MX.sym("guess", problem.dimension, numbering.of_nodes.shape[0])
    first = ca.vertcat(ca.vec(nodes)[numbering.place.tolist()], unknowns[numbering.positions :])
    root = embeddable(functional, weights)(guess=first, **joints, **data)["unknowns"]
    summary = functional.function("summary")(unknowns=root, **joints, **data)
    u = ca.vertcat(root, data["start"], data["end"])
    x = ca.reshape(u[numbering.of_nodes[:: method.degree].ravel().tolist()], problem.dimension, -1)
    verified = _check(problem, transcription.stationarity)(unknowns=root, **joints, **data)["verified"]
    inputs = {name: symbol for name, symbol in data.items() if symbol.numel()} | {"guess": nodes}
    outputs = {"x": x, "momentum": summary["momentum"], "action": summary["action"]}
    return verified_function(inputs, outputs, verified, ["guess"])


def _check(problem: BoundaryProblem, stationarity: Stationarity) -> ca.Function:
    """(unknowns, *data) -> whether all residuals are within `ACCEPTED` of their floor; without derivatives.

    Ends that are data are also checked against a constraint, which no equation imposes on them.
    """
    symbols = stationarity.functional.symbols
    residual, least = stationarity.floor.call(list(symbols.values()))
    passed = [ca.norm_inf(residual / least) <= ACCEPTED, all_finite(residual)]
    if problem.constraint is not None:
        terms = problem.constraint.sx_in()
        missed = relative_residuals(problem.constraint(*terms), terms[:2], terms[2:])
        for name, when in (("start", symbols["mesh"][0]), ("end", symbols["mesh"][-1])):
            if symbols[name].numel() == problem.dimension:
                further = [symbols["parameters"]] if "parameters" in symbols else []
                passed.append(ca.norm_inf(missed(when, symbols[name], *further)[1]) <= 1)
    verified = ca.mmin(ca.vertcat(*passed))
    expressions = symbols | {"verified": verified}
    return ca.Function("check", expressions, list(symbols), ["verified"], {"is_diff_out": [False]})


def boundary_sensitivity(path: Trajectory) -> Sensitivity:
    """Derivatives of the path of a BoundaryProblem, see `sensitivity`."""
    problem = path.problem
    if not isinstance(problem, BoundaryProblem):
        raise TypeError(
            f"sensitivity takes the path of a BoundaryProblem or a ControlProblem, got one of {type(problem).__name__}"
        )
    _refuse_energy("sensitivity", problem)
    _refuse_kinks("sensitivity", path)
    return at_joints(problem, path)


def at_joints(problem: BoundaryProblem, path: Trajectory) -> Sensitivity:
    """`sensitivity` of the path of a problem, where the energy is given at joints that move with the data."""
    transcription = transcribed(problem, path.method, None, path.t)
    numbering, symbols = transcription.numbering, transcription.functional.symbols
    data = {name: symbols[name] for name in ("start", "end", "parameters") if name in symbols}
    _, gradient, _ = transcription.functional.function("derivatives").call(list(symbols.values()))
    by_values = -ca.DM.eye(numbering.free)[:, numbering.everywhere][:, : numbering.integrals]
    by_data = ca.densify(ca.horzcat(ca.jacobian(gradient, ca.vertcat(*data.values())), by_values))
    unknowns, given = transcription.on_path(path.polynomial)
    rhs = ca.Function("by_data", list(symbols.values()), [by_data]).call([unknowns, *map(ca.DM, given)])[0].full()
    with transcription.stationarity.linearization() as at:
        at.relinearize(unknowns, given)
        columns = list(rhs.T.copy())
        changes = at.refined(unknowns, given, columns, at.solve(*columns)) if rhs.size else columns
    change = np.reshape(changes, rhs.T.shape).T
    by_u = np.concatenate((change, np.eye(numbering.size - numbering.free, change.shape[1])))
    x = by_u[numbering.of_nodes[:: path.method.degree]].transpose(1, 0, 2)  # (d, N + 1, data)
    counts = {name: symbol.numel() for name, symbol in data.items()} | {"integral_values": numbering.integrals}
    parts = np.split(x, np.cumsum(list(counts.values()))[:-1], axis=2)
    return Sensitivity(path.t, {name: by for name, by in zip(counts, parts, strict=True) if by.size})


def _refuse_energy(name: str, problem: BoundaryProblem) -> None:
    """Refuse a free duration: its joints move with the data."""
    if problem.energy is not None:
        raise ValueError(f"{name} takes problems of a given duration, got one of given energy, {problem.energy}")


def _refuse_kinks(name: str, path: Trajectory) -> None:
    """Refuse a path over a step of ∂L/∂x or the force in x or v, whose impulse is in no derivative."""
    kinks = np.flatnonzero(kinks_in_place(path.problem, path.polynomial))
    if len(kinks):
        when = (path.t[kinks[0]] + path.t[kinks[0] + 1]) / 2
        raise ValueError(
            f"{name} takes paths along which ∂L/∂x and the force are continuous in x and v, got one on which they step "
            f"near t = {when:.6g}: smooth them there, as |x| by sqrt(x² + 1e-6), or sign(v) by tanh(1e3 v)"
        )
