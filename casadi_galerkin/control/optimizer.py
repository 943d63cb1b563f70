"""Constrained optimization, all derivatives supplied: minimize f(ξ) within bounds on ξ and G(ξ), with IPOPT or fatrop.

`solvers` solve ∇S = 0 to roundoff; this is its counterpart for costs and constraints.  What it returns is the
solver's last point with the solver's own words; whether that point is an answer is judged by the caller, who knows
what the rows of G mean.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.control.graph import ControlGraph
from casadi_galerkin.control.program_bounds import ProgramBounds
from casadi_galerkin.functional.buffers import Evaluator, ObjectPool
from casadi_galerkin.solvers.deadline import limited

ITERATION_LIMIT = 500  # the scenes take 5 to 100; a problem without a bound from below walks on for ever
TOLERANCE = 1e-12  # of IPOPT's scaled optimality error; at 1e-10 costs were seen to be wrong by 3e-9
ACCEPTABLE = 1e-9  # good enough where roundoff keeps IPOPT from TOLERANCE for ACCEPTABLE_ITERATIONS
ACCEPTABLE_ITERATIONS = 4
# IPOPT's barrier counts bounds, not time.  With its default of 0.1 a fine mesh, which has many bounds, leaves the guess
# far behind: the cart-pole of degree 8 on 60 intervals took 207 iterations and ended in another minimum; 19 with this.
FIRST_BARRIER = 1e-2
# From an optimum near by with its multipliers the barrier starts where it ends, and nothing is pushed off its bounds:
# five problems with starts moved by 1 to 20 % took 2 to 8 iterations where the path alone took 5 to 14.
WARM_BARRIER = 1e-10
PUSHES = [f"warm_start_{which}" for which in ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")]
# Of fatrop's error, which roundoff keeps above 1e-10 in one problem of ten; costs then differ from IPOPT's by 1e-9 to
# 2e-8 of themselves, with the number of bounds that are met.
FATROP_TOLERANCE = 1e-9
# Fatrop takes rows with smaller pivots, in units of the unknowns, for dependent.  Where it takes them wrongly it damps
# its steps for ever, before the first iteration: with its own 1e-5 on lengths of 1e-6, with 1e-7 on constraints held
# at many nodes.  With this, neither was seen; lengths of 1e-7 hang, and of 1e5 fail.
PIVOT = 1e-6
FATROP_WORDS = {"0": "Solve Succeeded", "1": "No Optimum Found"}  # fatrop returns numbers alone
BOUND_RELAXATION = {
    "ipopt": 0.0,
    "fatrop": 1e-8,
}  # part of max(1, |b|) by which a solver relaxes bounds b; fatrop has no option for it
WARM = {
    **dict.fromkeys(["mu_init", *PUSHES], WARM_BARRIER),
    "warm_start_init_point": "yes",
    "acceptable_iter": 2,  # of Newton steps that converge quadratically
}


@dataclass(frozen=True)
class Optimum:
    """Where the solver stopped.

    Attributes
    ----------
    unknowns, multipliers, bound_multipliers : ξ, the λ of the equations and the μ of the bounds on ξ (casadi's sign:
        f + λ·G + μ·ξ is stationary)
    success : whether the solver itself calls it an optimum
    status : its own words
    iterations : int
    """

    unknowns: np.ndarray
    multipliers: np.ndarray
    bound_multipliers: np.ndarray
    success: bool
    status: str
    iterations: int


def with_ipopt(graph: ControlGraph, warm: bool, verbose: int, given: Mapping[str, Any]) -> ca.Function:
    """Build IPOPT for a program, to start warm or not, with the options given for it.

    Bounds are held exactly (``bound_relax_factor`` 0): IPOPT's default lets them slip by 1e-8, which shows in the
    cost of every problem that lives on its bounds.
    """
    options = {
        "print_level": 5 if verbose > 1 else 0,
        "sb": "yes",
        "tol": TOLERANCE,
        "acceptable_tol": ACCEPTABLE,
        "acceptable_iter": ACCEPTABLE_ITERATIONS,
        "tiny_step_tol": 0.0,  # steps are tiny where roundoff keeps an optimum from TOLERANCE: no failure
        "bound_relax_factor": 0.0,
        "mu_init": FIRST_BARRIER,
        "max_iter": ITERATION_LIMIT,
        **(WARM if warm else {}),
        **limited(given),
    }
    derivatives = {"grad_f": graph.gradient, "jac_g": graph.jacobian, "hess_lag": graph.hessian}
    return _built(graph, "ipopt", {**derivatives, "calc_lam_p": False, "no_nlp_grad": True, "ipopt": options})


def with_fatrop(graph: ControlGraph, verbose: int, given: Mapping[str, Any]) -> ca.Function:
    """Build fatrop for a program, stage by stage; arguments as for `with_ipopt`.  It does not start warm."""
    states, others, equations = (list(column) for column in zip(*graph.chain.stages, strict=True))
    structure = {"N": graph.chain.intervals, "nx": states, "nu": others, "ng": equations}
    options = {
        "print_level": 5 if verbose > 1 else 0,
        "tol": FATROP_TOLERANCE,
        "linsol_lu_fact_tol": PIVOT,
        "mu_init": FIRST_BARRIER,
        "max_iter": ITERATION_LIMIT,
        **given,
    }
    # it takes no options for derivatives, but finds them in its cache
    unknowns, data = graph.unknowns, graph.data
    gradient = ca.Function("nlp_grad_f", [unknowns, data], [graph.gradient(unknowns, data)[1]])
    derivatives = {"nlp_grad_f": gradient, "nlp_jac_g": graph.jacobian, "nlp_hess_l": graph.whole_hessian}
    chain = {"cache": derivatives, "structure_detection": "manual", **structure}
    return _built(graph, "fatrop", {**chain, "fatrop": options})


def _built(graph: ControlGraph, plugin: str, options: dict[str, Any]) -> ca.Function:
    nlp = {"x": graph.unknowns, "p": graph.data, "f": graph.cost, "g": graph.equations}
    common = {"print_time": False, "show_eval_warnings": False}
    return ca.nlpsol("optimizer", plugin, nlp, common | options)


def optimize(
    solver: ObjectPool[Evaluator], guess: np.ndarray, data: np.ndarray, bounds: ProgramBounds, *duals: Any
) -> Optimum:
    """Run the solver from a guess, to start warm with the multipliers of the bounds and of the equations."""
    with solver.lend() as run:
        x, _, _, of_bounds, of_equations, _ = run(guess, data, *bounds.sides, *(duals or (0.0, 0.0)))
        stats = run.stats
    status = str(stats["return_status"]).replace("_", " ")
    status = FATROP_WORDS.get(status, status)
    found = np.where(bounds.lower == bounds.upper, bounds.lower, x)  # fatrop holds what is given as an equation
    return Optimum(found, of_equations, of_bounds, bool(stats["success"]), status, int(stats["iter_count"]))
