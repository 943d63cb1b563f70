"""The solver `rootfinder`: CasADi's Newton method for ∇S = 0, whose answer Newton's method of this package verifies.

CasADi's ``newton`` plugin shortens its steps until they lower the residual, or with ``line_search=False`` takes full
ones, until an absolute residual is reached.  So residuals are measured by the sizes of the terms that they sum.  With
multipliers among the unknowns, full steps are the default: the first of them leaves a constraint that was met, and from
then on the residual falls, while a line search was measured to stall.  It reports NaN as success, and from a straight
line it may diverge on large swings: what it finds is verified as any other answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.functional.buffers import interrupts_raised
from casadi_galerkin.functional.functional import Functional
from casadi_galerkin.functional.numbering import Data
from casadi_galerkin.problems.linear_equations import NO_CUTOFF
from casadi_galerkin.solvers.newton import SEARCH_ITERATIONS, Solution, SolveFailure, polished
from casadi_galerkin.solvers.stationarity import ACCEPTED, Stationarity

# In large units of the action, pivots beside multipliers are smaller than those that QR takes for zero.
FACTORIZATION = {"linear_solver": "qr", "linear_solver_options": NO_CUTOFF}
REPORT = "CasADi's rootfinder"
RESERVED_OPTIONS = "jacobian_function", "error_on_fail", "show_eval_warnings"  # options that are set here


def casadi_newton(functional: Functional, options: Mapping[str, Any]) -> ca.Function:
    """CasADi's Newton method (guess, *data, rows) -> ξ, until residuals are accepted, or to its limit of iterations.

    It is not stopped by an error, which would print all inputs and end a map over many at the first of them; an answer
    may be NaN, or no solution.  `rows` are factors on the rows of ∇S = 0: one over the sizes of the terms that they
    sum.
    """
    derivatives = functional.function("derivatives")
    symbols, names = derivatives.mx_in(), derivatives.name_in()
    matrix, gradient, _ = derivatives.call(symbols)
    rows = ca.MX.sym("rows", gradient.numel())
    symbols, names = [*symbols, rows], [*names, "rows"]
    residual = ca.Function("residual", symbols, [rows * gradient], names, ["residual"])
    scaled = [ca.mtimes(ca.diag(rows), matrix), rows * gradient]
    common = {
        "max_iter": SEARCH_ITERATIONS,
        "abstol": ACCEPTED * EPS,
        "line_search": not functional.numbering.multipliers,
        "jacobian_function": ca.Function("jacobian", symbols, scaled, names, ["matrix", "residual"]),
        "show_eval_warnings": False,
        "error_on_fail": False,
        "abstolStep": 0.0,  # it is absolute, whatever the unit of x
    }
    factorization = {} if "linear_solver" in options else FACTORIZATION
    return ca.rootfinder("root", "newton", residual, {**common, **factorization, **options})


def embeddable(functional: Functional, weights: np.ndarray) -> ca.Function:
    """CasADi's Newton method as a Function (guess, *data) -> ξ, differentiable by the implicit function theorem.

    The answer is not verified.

    Parameters
    ----------
    functional : Functional
    weights : factor on every row of ∇S = 0, one over the sizes of the terms it sums
    """
    derivatives = functional.function("derivatives")
    symbols, names = derivatives.mx_in(), derivatives.name_in()
    near = casadi_newton(functional, {})(*symbols, ca.DM(weights))
    last = casadi_newton(functional, {"abstol": 0.0, "max_iter": 2})  # the weights may be those of other data
    root = last(near, *symbols[1:], ca.DM(weights))
    return ca.Function("embedded", symbols, [root], ["guess", *names[1:]], ["unknowns"])


def casadi_root(
    stationarity: Stationarity, guess: np.ndarray, data: Data, verbose: int = 0, **options: Any
) -> Solution:
    """CasADi's Newton method, verified; arguments and failures are those of a `Solver`."""
    rows = 1 / stationarity.sizes_of_terms(guess, data)
    with stationarity.linearization() as at:
        key = f"rootfinder {sorted(options.items())}"
        solver = at.keep(key, lambda: casadi_newton(stationarity.functional, options))
        try:
            with interrupts_raised():
                root = solver(guess, *data, rows)
        except RuntimeError as error:
            raise SolveFailure("CasADi's rootfinder met a casadi Function that fails", guess, 0) from error
        iterations = int(solver.stats()["iter_count"])
    x = np.array(root).ravel()
    return polished(stationarity, x, data, verbose, REPORT, iterations, "")


def check_option(name: str, value: object) -> None:
    """Refuse an option that CasADi's Newton method does not know, by building one with it."""
    if name in RESERVED_OPTIONS:
        raise ValueError(f"the option {name} of CasADi's rootfinder is set by the package, got {value!r}")
    x = ca.MX.sym("x")
    try:
        ca.rootfinder("asked", "newton", {"x": x, "g": x}, {name: value})
    except (RuntimeError, NotImplementedError, TypeError) as error:
        raise ValueError(f"CasADi's rootfinder has no option {name} that takes {value!r}") from error
