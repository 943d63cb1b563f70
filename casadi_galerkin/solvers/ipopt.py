"""IPOPT on the action, or on its stationarity conditions; Newton's method finishes and verifies what it finds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.functional.buffers import Evaluator
from casadi_galerkin.functional.functional import Functional
from casadi_galerkin.functional.numbering import Data
from casadi_galerkin.solvers.deadline import limited, seconds_left
from casadi_galerkin.solvers.newton import Solution, SolveFailure, polished
from casadi_galerkin.solvers.second_variation import negative_eigenvalues
from casadi_galerkin.solvers.stationarity import Stationarity


def critical_point(
    stationarity: Stationarity, guess: np.ndarray, data: Data, verbose: int = 0, minimize: bool = False, **options: Any
) -> Solution:
    """IPOPT on the conditions ∇S = 0 under a constant objective or, to `minimize`, on the action.

    The other arguments are those of a `Solver`.
    """
    name = "IPOPT on the action" if minimize else "IPOPT"
    sizes, unit = _units(stationarity, guess, data)
    own = len(guess) - (stationarity.functional.numbering.multipliers if minimize else 0)
    with stationarity.linearization() as at:
        key = f"ipopt {minimize} {verbose > 1} {sorted(options.items())}"

        def build() -> Evaluator:
            return Evaluator(_nlpsol(stationarity.functional, minimize, verbose, limited(options)))

        run, first = at.keep(key, build) if math.isinf(seconds_left()) else build(), guess / sizes
        zero, parameters = np.zeros(1), np.concatenate((*data, sizes, [unit]))
        multipliers = first[own:] if minimize else zero
        found = run(first[:own], parameters, zero - np.inf, zero + np.inf, zero, zero, zero, multipliers)
        stats = run.stats
    status = "" if stats["success"] else str(stats["return_status"]).replace("_", " ")
    x = sizes * np.append(found[0], found[4])[: len(guess)]  # with the multipliers of the conditions
    return polished(stationarity, x, data, verbose, name, int(stats["iter_count"]), status)


def minimum(stationarity: Stationarity, guess: np.ndarray, data: Data, verbose: int = 0, **options: Any) -> Solution:
    """IPOPT on the action itself: finds a minimum, or fails where there is none; arguments as of a `Solver`."""
    if not stationarity.variational:
        raise ValueError(
            "minimizer lowers the action, which a force, a given energy, and a given velocity whose momentum depends "
            "on the path do not allow: take newton or ipopt"
        )
    solution = critical_point(stationarity, guess, data, verbose, minimize=True, **options)
    index = negative_eigenvalues(stationarity, solution.unknowns, data)
    if index != 0:
        reason = f"IPOPT on the action ended at a path that is no minimum (Morse index {index})"
        raise SolveFailure(reason, solution.unknowns, solution.iterations)
    return solution


def _units(stationarity: Stationarity, guess: np.ndarray, data: Data) -> tuple[np.ndarray, float]:
    """Scales of the unknowns at a guess, and of the action: the median of the terms of ∇S in units of the former.

    The largest term would not do: on a graded mesh it belongs to its shortest interval.
    """
    sizes, terms = stationarity.sizes(guess, data), stationarity.sizes_of_terms(guess, data)
    measured = np.isfinite(sizes)
    unit = float(np.median((sizes * terms)[measured])) if np.any(measured) else 1.0
    unit = unit if 0 < unit < np.inf else 1.0
    return np.where(measured, sizes, unit / terms), unit  # a multiplier by what gives its row terms of that size


def _nlpsol(functional: Functional, minimize: bool, verbose: int, given: Mapping[str, Any]) -> ca.Function:
    """IPOPT with all derivatives supplied from the one graph.

    Its tolerances are absolute, so unknowns and action are measured by units that follow the data as parameters.  All
    rows of ∇S are constraints, or, where the action is minimized, those of the multipliers, which then are IPOPT's own.
    """
    slope = functional.function("gradient")
    n, *lengths = [slope.size1_in(i) for i in range(slope.n_in())]
    positions = n - functional.numbering.multipliers
    own, begin = (positions, positions) if minimize else (n, 0)  # unknowns; the first row that is a constraint
    x, multipliers = ca.MX.sym("x", own), ca.MX.sym("lam_g", n - begin)
    p, factor = ca.MX.sym("p", sum(lengths) + n + 1), ca.MX.sym("lam_f")
    *data, sizes, unit = ca.vertsplit(p, np.cumsum([0, *lengths, n, 1]).tolist())
    rows = sizes / unit

    def at(further: ca.MX) -> tuple[list[ca.MX], ca.MX, ca.MX]:
        """Arguments of the graph, and its gradient and Hessian in these units, with multipliers."""
        arguments = [sizes * ca.vertcat(x, further), *data]
        hessian = ca.mtimes(ca.mtimes(ca.diag(rows), functional.function("hessian")(*arguments)), ca.diag(sizes))
        return arguments, rows * slope(*arguments), hessian

    arguments, gradient, hessian = at(ca.MX.zeros(n - own))
    action, upper = ca.MX(0), ca.MX(n, n)  # the curvature of the conditions is left out
    if minimize:
        action = functional.function("action")(*arguments) / unit
        upper = factor * ca.triu(hessian[:own, :own])
        if own < n:  # linear in the multipliers
            upper += ca.triu((at(multipliers)[2] - hessian)[:own, :own])
    options = {
        "grad_f": ca.Function("grad_f", [x, p], [action, gradient[:own] if minimize else ca.MX.zeros(own)]),
        "jac_g": ca.Function("jac_g", [x, p], [gradient[begin:], hessian[begin:, :own]]),
        "hess_lag": ca.Function("hess_lag", [x, p, factor, multipliers], [upper]),
        "print_time": False,
        "calc_lam_p": False,
        "no_nlp_grad": True,
        "show_eval_warnings": verbose > 1,  # IPOPT shortens a step that leaves the Lagrangian's domain
        "ipopt": {"print_level": 5 if verbose > 1 else 0, "sb": "yes", **given},
    }
    return ca.nlpsol("ipopt", "ipopt", {"x": x, "p": p, "f": action, "g": gradient[begin:]}, options)


def check_option(name: str, value: object, plugin: str = "ipopt") -> None:
    """Refuse an option that the solver does not know, by building one with it and running it.

    fatrop knows its options only when it runs, and IPOPT whether the linear solver that one names is installed.
    """
    x, quiet = ca.MX.sym("x"), {"print_level": 0} | ({"sb": "yes"} if plugin == "ipopt" else {})
    called = {"ipopt": "IPOPT", "sqpmethod": "sqp"}.get(plugin, plugin)
    refusal = ValueError(f"{called} has no option {name} that takes {value!r}")
    if value != value:  # NaN, which it would take
        raise refusal
    try:
        options = {name: value} if plugin == "sqpmethod" else {plugin: {**quiet, name: value}}
        asked = ca.nlpsol("asked", plugin, {"x": x, "f": x**2}, {"print_time": False, **options})
        if name == "print_level":
            return  # which would print
        asked(x0=1.0)
    except (RuntimeError, NotImplementedError, TypeError) as error:
        raise refusal from error
    stats = asked.stats()
    if stats["return_status"] == "Invalid_Option" if plugin == "ipopt" else not stats["success"]:
        raise refusal
