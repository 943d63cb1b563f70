"""Constrained optimization, all derivatives supplied: minimize f(ξ) within bounds on ξ and G(ξ), by three solvers.

`solvers` solve ∇S = 0 to roundoff; this is the counterpart for costs and constraints.  It returns the last point and
the status of the solver; the caller, who knows the meaning of the rows of G, verifies the point.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.roundoff import EPS, largest_of, or_one
from casadi_galerkin.control.control_graph import ControlGraph
from casadi_galerkin.control.control_numbering import Numbering, ProgramBounds
from casadi_galerkin.functional.buffers import Evaluator, evaluating
from casadi_galerkin.problems.linear_equations import NO_CUTOFF
from casadi_galerkin.problems.statements import FEASIBLE
from casadi_galerkin.solvers.deadline import limited, seconds_left

ITERATION_LIMIT = 500  # the scenes take 5 to 100; with an unbounded cost the iteration does not end
TOLERANCE = 1e-12  # for IPOPT's scaled optimality error; with 1e-10 errors of the cost of 3e-9 were seen
# Accepted after `ACCEPTABLE_ITERATIONS` where roundoff keeps IPOPT from TOLERANCE, in one of ten problems, and by
# fatrop; its costs differ from IPOPT's by 1e-9 to 2e-8 of themselves.  Momenta that change by less are of no force.
ACCEPTABLE = 1e-9
ACCEPTABLE_ITERATIONS = 4
# IPOPT's barrier grows with the number of bounds.  With its default of 0.1 on a fine mesh, which has many bounds, the
# first iterates move far from the guess: the cart-pole of degree 8 on 60 intervals took 207 iterations to another
# minimum, and 19 with this.
FIRST_BARRIER = 1e-2
# In a warm start, from a near optimum with its multipliers, the barrier starts at its final size, and values stay at
# their bounds: five problems with starts moved by 1 to 20 % took 2 to 8 iterations, and 5 to 14 from the path alone.
PUSHES = [f"warm_start_{which}" for which in ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")]
# Fatrop treats rows with smaller pivots, in units of the unknowns, as dependent, and adds a constant to the diagonal
# until they are not.  Where the constant is too small it never ends: with its default 1e-5 for lengths of 1e-6, with
# 1e-7 for constraints at many nodes.  This value solves both; but lengths of 1e-7, one of 40 guesses of an acrobot and
# 6 of 15 meshes of a hanging chain hang, and so do controls other than zero that are bounded by 1e-5, where none are
# needed.  With 5e-5 and `delta_c_stripe` 1e-2 no chain does, but a robot arm.
PIVOT = 1e-6
FATROP_WORDS = {"0": "Solve Succeeded", "1": "No Optimum Found"}  # fatrop returns only numbers
# part of max(1, |b|) by which a solver relaxes bounds b; fatrop has no option for it
BOUND_RELAXATION = {"ipopt": 0.0, "fatrop": 1e-8, "sqp": 0.0}
WARM = {**dict.fromkeys(["mu_init", *PUSHES], TOLERANCE), "warm_start_init_point": "yes"}


@dataclass(frozen=True)
class Optimum:
    """The last point of a solver.

    Attributes
    ----------
    data, bounds : those of the program
    unknowns, multipliers, bound_multipliers : ξ, the λ of the equations and the μ of the bounds on ξ (casadi's sign:
        f + λ·G + μ·ξ is stationary)
    success : whether the solver reports an optimum
    status : its return status
    iterations : int
    doubtful : whether it may be a saddle: IPOPT's last step needed a regularized Hessian, or it took none
    """

    data: np.ndarray
    bounds: ProgramBounds
    unknowns: np.ndarray
    multipliers: np.ndarray
    bound_multipliers: np.ndarray
    success: bool
    status: str
    iterations: int
    doubtful: bool


def with_ipopt(graph: ControlGraph, warm: bool, verbose: int, given: Mapping[str, Any]) -> ca.Function:
    """Build IPOPT for a program, for warm starts or not, with the given options.

    Bounds are exact (``bound_relax_factor`` 0): IPOPT's default relaxes them by 1e-8, which changes the cost of every
    problem with active bounds.
    """
    options = {
        "sb": "yes",
        "tol": TOLERANCE,
        "acceptable_tol": ACCEPTABLE,
        "acceptable_iter": ACCEPTABLE_ITERATIONS,
        "acceptable_constr_viol_tol": FEASIBLE,  # IPOPT's own is 1e-2
        "tiny_step_tol": 0.0,  # tiny steps, where roundoff keeps an optimum from TOLERANCE, are no failure
        "bound_relax_factor": 0.0,
        **(WARM if warm else {}),
        **limited(given),
    }
    derivatives = {"grad_f": graph.gradient, "jac_g": graph.jacobian, "hess_lag": graph.hessian}
    return _built(graph, "ipopt", verbose, {**derivatives, "calc_lam_p": False, "no_nlp_grad": True}, options)


def with_fatrop(graph: ControlGraph, bounds: ProgramBounds, verbose: int, given: Mapping[str, Any]) -> ca.Function:
    """Build fatrop for a program, stage by stage; arguments as for `with_ipopt`.  It does not start warm."""
    _check_stages(graph.numbering, bounds)
    (chain,) = graph.numbering.chains
    states, others, equations = (list(column) for column in zip(*chain.stages, strict=True))
    structure = {"N": chain.intervals, "nx": states, "nu": others, "ng": equations}
    options = {"tol": ACCEPTABLE, "linsol_lu_fact_tol": PIVOT, **given}
    # it takes no options for derivatives, but finds them in its cache
    unknowns, data = graph.unknowns, graph.data
    gradient = ca.Function("nlp_grad_f", [unknowns, data], [graph.gradient(unknowns, data)[1]])
    derivatives = {"nlp_grad_f": gradient, "nlp_jac_g": graph.jacobian, "nlp_hess_l": graph.whole_hessian}
    staged = {"cache": derivatives, "structure_detection": "manual", **structure}
    return _built(graph, "fatrop", verbose, staged, options)


def _check_stages(numbering: Numbering, bounds: ProgramBounds) -> None:
    """Refuse problems that fatrop cannot divide into stages, or refuses itself when it runs."""
    if len(numbering.chains) > 1:
        raise ValueError("fatrop takes no phases, such as jumps and breakpoints with free times make: take cg.ipopt")
    (chain,) = numbering.chains
    if chain.changes:
        raise ValueError("fatrop takes no control_rate_bounds, which join intervals: take cg.ipopt")
    if any(chain.end_conditions[0].sparsity_jac(k, 0).nnz() for k in (0, 1)):
        raise ValueError(
            "fatrop takes end_conditions on the end alone, stage by stage: give what is known of the start as "
            "start and start_velocity, or take cg.ipopt"
        )
    states, others, counts = (np.array(column) for column in zip(*chain.stages, strict=True))
    rows, unknowns = np.cumsum(np.append(states[1:], 0) + counts), np.cumsum(states + others)
    fixed, given = (np.append(0, np.cumsum(np.equal(*sides))) for sides in (bounds.equations, bounds.unknowns))
    equations = fixed[rows] - fixed[rows - counts] + given[unknowns] - given[unknowns - states - others]
    for i in np.flatnonzero(equations > states + others)[:1]:
        where = f"interval {i}" if i < chain.intervals else "the end"
        raise ValueError(
            f"fatrop takes no more equations than unknowns in a stage, got {equations[i]} for {states[i] + others[i]} "
            f"at {where}: state nothing twice, or take cg.ipopt"
        )


def with_sqp(graph: ControlGraph, verbose: int, given: Mapping[str, Any]) -> ca.Function:
    """Build CasADi's method of sequential quadratic programs, with piqp for these; arguments as for `with_ipopt`.

    From an earlier optimum it takes two steps where IPOPT takes five; elsewhere it is lost more often.  With the active
    sets of qrqp a solve may take seconds; with piqp's own tolerance, 1e-8, one of ten solves does not come to an end.
    """
    x, p, factor = graph.unknowns, graph.data, ca.MX.sym("factor")
    multipliers, told = ca.MX.sym("multipliers", graph.numbering.equations), verbose > 1
    everything = ca.Function("nlp_jac_fg", [x, p], [*graph.gradient(x, p), *graph.jacobian(x, p)])
    curvature = [ca.triu2symm(graph.hessian(x, p, factor, multipliers))]
    options = {
        "jac_fg": everything,
        "hess_lag": ca.Function("nlp_hess_l", [x, p, factor, multipliers], curvature),
        "qpsol": "piqp",
        "qpsol_options": {"error_on_fail": False, "piqp": {"eps_abs": TOLERANCE, "eps_rel": TOLERANCE}},
        "print_header": told,
        "print_iteration": told,
        "print_status": False,
        "print_time": False,
        "error_on_fail": False,
        "calc_lam_p": False,
        "tol_pr": ACCEPTABLE,
        "tol_du": ACCEPTABLE,
        **given,
    }
    return ca.nlpsol("optimizer", "sqpmethod", {"x": x, "p": p, "f": graph.cost, "g": graph.equations}, options)


def _built(
    graph: ControlGraph, plugin: str, verbose: int, program: dict[str, Any], options: dict[str, Any]
) -> ca.Function:
    """Build a solver from what CasADi is told of the program, and the options of the solver itself."""
    nlp = {"x": graph.unknowns, "p": graph.data, "f": graph.cost, "g": graph.equations}
    shared = {"print_level": 5 if verbose > 1 else 0, "mu_init": FIRST_BARRIER, "max_iter": ITERATION_LIMIT}
    quiet = {"print_time": False, "show_eval_warnings": False}
    return ca.nlpsol("optimizer", plugin, nlp, {**quiet, **program, plugin: {**shared, **options}})


def optimize(
    solver: Evaluator,
    guess: np.ndarray,
    data: np.ndarray,
    bounds: ProgramBounds,
    relaxation: float,
    *duals: Any,
) -> Optimum:
    """Run a solver that relaxes bounds from a guess and, for a warm start, the multipliers of bounds and equations."""
    narrow = bounds.narrowed(relaxation)
    with evaluating():
        given = guess, data, *narrow.unknowns, *narrow.equations
        x, _, _, of_bounds, of_equations, _ = solver(*given, *(duals or (0.0, 0.0)))
        stats = solver.stats
    status = str(stats["return_status"]).replace("_", " ")
    status = FATROP_WORDS.get(status, status)
    low, high = narrow.unknowns
    unknowns = np.where(low == high, low, x)  # in fatrop given values are equations
    shifts = stats.get("iterations", {}).get("regularization_size", [])
    ended = bool(stats["success"]), status, int(stats["iter_count"]), len(shifts) == 1 or any(shifts[-1:])
    return Optimum(data, bounds, unknowns, of_equations, of_bounds, *ended)


def newton_step(graph: ControlGraph, bounds: ProgramBounds) -> ca.Function | None:
    """Build Newton's step where as many equations as unknowns leave nothing to choose; else None.

    A Function of the point of the derivatives, the point of the equations, data and right-hand sides: the step of the
    free unknowns by which the linearized equations are solved.
    """
    free, rows = (np.flatnonzero(a) for a in (np.less(*bounds.unknowns), np.equal(*bounds.equations)))
    if len(free) != len(rows):
        return None
    at, point = ca.MX.sym("at", graph.unknowns.numel()), ca.MX.sym("point", graph.unknowns.numel())
    wanted = ca.MX.sym("wanted", len(rows))
    slopes = graph.jacobian(at, graph.data)[1][rows.tolist(), free.tolist()]
    missed = graph.jacobian(point, graph.data)[0][rows.tolist()] - wanted
    step = -ca.solve(slopes, missed, "qr", NO_CUTOFF)
    return ca.Function("newton_step", [at, point, graph.data, wanted], [step])


def newton(
    solver: Evaluator, kinds: np.ndarray, guess: np.ndarray, data: np.ndarray, bounds: ProgramBounds
) -> Optimum | None:
    """The point at which all equations hold, by Newton's method with natural monotonicity, or None where it is lost.

    See `solvers.newton`.  Steps are relative to the largest value of their kind.
    """
    (low, high), rows = bounds.unknowns, np.equal(*bounds.equations)
    free, unknowns, wanted = low < high, np.where(low < high, guess, low), bounds.equations[0][rows]
    iteration = 0

    def step_at(at: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, float]:
        (step,) = solver(at, point, data, wanted)
        moved = np.zeros(len(at))
        moved[free] = step.ravel()
        return moved, float(np.max(np.abs(moved) / or_one(largest_of(np.abs(unknowns), kinds))[kinds]))

    while iteration < ITERATION_LIMIT and seconds_left() > 0:
        iteration, damping = iteration + 1, 1.0
        step, size = step_at(unknowns, unknowns)
        simplified, next_size = step_at(unknowns, unknowns + step)
        if size * next_size <= EPS:  # the next but one would be rounding
            found, zeros = unknowns + step + simplified, np.zeros(len(rows))
            return Optimum(data, bounds, found, zeros, np.zeros(len(found)), True, "Solve Succeeded", iteration, False)
        while not next_size <= (1 - damping / 4) * size:
            damping /= 2
            if not damping > np.sqrt(EPS):
                return None
            _, next_size = step_at(unknowns, unknowns + damping * step)
        unknowns = unknowns + damping * step
    return None
