"""The only caller of CasADi's solvers: solve F(ξ) = ∇S = 0, verify, return or raise.

Three engines share one signature ``engine(system, guess, data, verbose) -> Solution``:

`rootfinder` (the default) is Newton's method (`newton`).  CasADi's own ``newton`` plugin was measured beside it: it
stops at an absolute residual, which at 1e5 intervals lies below roundoff, reports NaN as success, and from a straight
line diverges on large swings.  Where Newton fails, IPOPT first minimises the action (long pendulum swings: 10
iterations where the stationarity conditions alone took 60 to 500), then solves the stationarity conditions; Newton
finishes from where it stopped.

`ipopt` takes the equations as constraints under a constant objective; `minimizer` minimises the action, so it
finds minima only.  Both are polished and verified by Newton's method.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from casadi_galerkin.layout import Data
from casadi_galerkin.newton import Solution, SolveFailure, newton
from casadi_galerkin.precision import EPS
from casadi_galerkin.system import System, joined, negative_eigenvalues

RESCUE = 100  # iterations IPOPT gets after Newton's method; rescues were measured to take 4 to 40
NEARLY = 1e-9  # residual over the sizes of its terms from which two Newton steps reach roundoff


def rootfinder(system: System, guess: np.ndarray, data: Data, verbose: int = 0) -> Solution:
    """Newton's method with a scaling-invariant line search, then IPOPT on the action, then on its gradient.

    Parameters
    ----------
    system : System
    guess : first iterate ξ
    data : values of the other inputs of the system's Functions
    verbose : 2 prints a line an iteration

    Raises
    ------
    SolveFailure
        if none of them finds a point that can be verified
    """
    try:
        return newton(system, guess, data, verbose)
    except SolveFailure as failure:
        if failure.iterations == 0:
            raise
        reasons, iterations = [f"Newton's method: {failure}"], failure.iterations
        for minimize in (True, False):
            try:
                return _interior_point(system, guess, data, verbose, minimize, RESCUE)
            except SolveFailure as another:
                reasons.append(str(another))
                iterations += another.iterations
        raise SolveFailure("; ".join(reasons), failure.unknowns, iterations, failure.singular) from None


def ipopt(system: System, guess: np.ndarray, data: Data, verbose: int = 0) -> Solution:
    """IPOPT on the stationarity conditions as constraints under a constant objective; arguments as `rootfinder`."""
    return _interior_point(system, guess, data, verbose, minimize=False)


def minimizer(system: System, guess: np.ndarray, data: Data, verbose: int = 0) -> Solution:
    """IPOPT on the action itself: finds a minimum, or fails where there is none; arguments as `rootfinder`."""
    solution = _interior_point(system, guess, data, verbose, minimize=True)
    index = negative_eigenvalues(system, solution.unknowns, data)
    if index != 0:
        reason = f"IPOPT on the action ended at a path that is no minimum (Morse index {index})"
        raise SolveFailure(reason, solution.unknowns, solution.iterations)
    return solution


def _interior_point(
    system: System, guess: np.ndarray, data: Data, verbose: int, minimize: bool, limit: int = 500
) -> Solution:
    name = "IPOPT on the action" if minimize else "IPOPT"
    key = (minimize, verbose, limit)
    if key not in system._solvers:
        system._solvers[key] = _nlpsol(system, *key)  # building takes longer than solving a small problem
    solver = system._solvers[key]
    bounds = {} if minimize else {"lbg": 0.0, "ubg": 0.0}
    sizes, unit = _units(system, guess, data)
    answer = solver(x0=guess / sizes, p=np.concatenate((*data, sizes, [unit])), **bounds)
    stats = solver.stats()
    iterations, status = int(stats["iter_count"]), str(stats["return_status"]).replace("_", " ")
    x = sizes * np.array(answer["x"]).ravel()
    if not np.all(np.isfinite(x)):
        raise SolveFailure(f"{name} stopped with '{status}' at a point that is not finite", guess, iterations)
    try:
        polished = newton(system, x, data, verbose, limit=20)
    except SolveFailure as failure:
        if stats["success"]:
            status += f", then Newton's method: {failure}"
        singular = failure.singular and bool(stats["success"])
        raise SolveFailure(f"{name} stopped with '{status}'", x, iterations, singular) from None
    total = iterations + polished.iterations
    return replace(polished, iterations=total, report=f"{name}, then Newton")


def _units(system: System, guess: np.ndarray, data: Data) -> tuple[np.ndarray, float]:
    """What the unknowns are measured by at a guess, and the action: the median of the terms of ∇S so measured.

    Not the largest, which on a graded mesh belongs to its shortest interval.
    """
    *_, floor = system.evaluate("judged", guess, data)
    with system.algebra.lock:
        sizes = system.algebra.sizes(joined(guess, data))
    unit = float(np.median(sizes * floor / EPS)) if len(guess) else 1.0
    return sizes, unit if 0 < unit < np.inf else 1.0


def _nlpsol(system: System, minimize: bool, verbose: int, limit: int) -> ca.Function:
    """IPOPT with all derivatives supplied from the pointwise Functions.

    Its tolerances are absolute, so unknowns and action are measured by units that follow the data as parameters.
    """
    slope = system.build("gradient")
    n, *lengths = [slope.size1_in(i) for i in range(slope.n_in())]
    x, p = ca.MX.sym("x", n), ca.MX.sym("p", sum(lengths) + n + 1)
    *data, sizes, unit = ca.vertsplit(p, np.cumsum([0, *lengths, n, 1]).tolist())
    arguments, rows = [sizes * x, *data], sizes / unit
    gradient = rows * slope(*arguments)
    hessian = ca.mtimes(ca.mtimes(ca.diag(rows), system.build("hessian")(*arguments)), ca.diag(sizes))
    factor, multipliers = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", 0 if minimize else n)
    upper = factor * ca.triu(hessian) if minimize else ca.MX(n, n)  # the constraints' curvature is left out
    options = {
        "hess_lag": ca.Function("hess_lag", [x, p, factor, multipliers], [upper]),
        "print_time": False,
        "calc_lam_p": False,
        "show_eval_warnings": verbose > 1,  # IPOPT shortens a step that leaves the Lagrangian's domain
        "ipopt": {"print_level": 5 if verbose > 1 else 0, "sb": "yes", "tol": 1e-10, "max_iter": limit},
    }
    if minimize:
        action = system.build("action")(*arguments) / unit
        options["grad_f"] = ca.Function("grad_f", [x, p], [action, gradient])
        return ca.nlpsol("minimizer", "ipopt", {"x": x, "p": p, "f": action}, options)
    options["jac_g"] = ca.Function("jac_g", [x, p], [gradient, hessian])
    return ca.nlpsol("stationary", "ipopt", {"x": x, "p": p, "f": 0, "g": gradient}, options)


def embeddable(system: System, weights: np.ndarray, limit: int = 50) -> ca.Function:
    """Newton's method as a Function (guess, *data) -> ξ, differentiable by the implicit function theorem.

    CasADi's ``newton`` first reduces the residual to `NEARLY` of the sizes of its terms, or stops at the limit; two
    more steps from there, whatever the residual, take it to roundoff.  The answer is not verified: it may be NaN, or
    no solution.  Neither is it an error, which would print all inputs and end a map over many at the first of them.

    Parameters
    ----------
    system : System
    weights : factor on every row of ∇S = 0, one over the sizes of the terms it sums
    limit : most iterations
    """
    derivatives = system.build("derivatives")
    symbols, names = derivatives.mx_in(), [derivatives.name_in(i) for i in range(derivatives.n_in())]
    matrix, gradient = derivatives.call(symbols)
    rows = ca.DM(weights)
    residual = ca.Function("residual", symbols, [rows * gradient], names, ["residual"])
    scaled = [ca.mtimes(ca.diag(rows), matrix), rows * gradient]
    jacobian = ca.Function("jacobian", symbols, scaled, names, ["matrix", "residual"])
    options = {
        "jacobian_function": jacobian,
        "linear_solver": "qr",
        "show_eval_warnings": False,
        "error_on_fail": False,
        "abstolStep": 0.0,  # it is absolute, whatever the unit of x
    }
    near = ca.rootfinder("near", "newton", residual, {**options, "abstol": NEARLY, "max_iter": limit})
    last = ca.rootfinder("last", "newton", residual, {**options, "abstol": 0.0, "max_iter": 2})
    root = last(near(*symbols), *symbols[1:])
    return ca.Function("root", symbols, [root], ["guess", *names[1:]], ["unknowns"])
