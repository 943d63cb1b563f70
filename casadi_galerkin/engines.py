"""The only caller of CasADi's solvers: solve F(ξ) = ∇S = 0, verify, return or raise.

Three engines share one signature ``engine(system, guess, data, verbose) -> Solution``:

`rootfinder` (the default) is Newton's method with a line search that does not see the scaling of equations or
unknowns (natural monotonicity test; P. Deuflhard, "Newton Methods for Nonlinear Problems", 2004, algorithm
NLEQ-ERR).  CasADi's own ``newton`` plugin was measured beside it: it stops at an absolute residual, which at 1e5
intervals lies below roundoff, reports NaN as success, and from a straight line diverges on large swings.  Where
Newton fails, IPOPT is tried, and Newton finishes from where it stopped.

`ipopt` takes the equations as constraints under a constant objective; `minimizer` minimises the action, so it
finds minima only.  Both are polished and verified by Newton's method.

A solution is accepted if every residual is within `ROUNDOFF` times its own roundoff floor, eps times the sizes of
the terms it sums and of what the rounding of the unknowns themselves does to it, |H||ξ|.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

EPS = float(np.finfo(float).eps)
ROUNDOFF = 50.0  # accepted residual over its roundoff floor; correct solutions were measured at 0.01 to 5
LOCAL = 1e-3  # below this relative step, Newton's method needs no line search
NEAR = 1e-6  # below this relative step, the next iterate can be at roundoff
SMALLEST_DAMPING = 1e-7
SINGULAR = 1e-11  # second variation over the sum of its terms' sizes below which the Hessian is called singular

Data = tuple[np.ndarray, ...]


class SolveFailure(Exception):
    """An engine's own report that it stopped; carries the last iterate."""

    def __init__(self, reason: str, unknowns: np.ndarray, iterations: int, singular: bool = False) -> None:
        super().__init__(reason)
        self.unknowns, self.iterations, self.singular = unknowns, iterations, singular


class Evaluator:
    """Calls a Function on NumPy arrays without conversion: nonzeros in, nonzeros out."""

    def __init__(self, function: ca.Function) -> None:
        self._function = function  # the buffer does not keep it alive
        self._inputs: list[Any] = [np.zeros(function.nnz_in(i)) for i in range(function.n_in())]
        self._outputs: list[Any] = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
        self._buffer, self._run = function.buffer()
        for i, array in enumerate(self._inputs):
            self._buffer.set_arg(i, memoryview(array))
        for i, array in enumerate(self._outputs):
            self._buffer.set_res(i, memoryview(array))

    def __call__(self, *arguments: np.ndarray) -> list[np.ndarray]:
        """Evaluate; the returned arrays are copies, and not numbers where CasADi reports a failure."""
        for target, argument in zip(self._inputs, arguments, strict=True):
            target[:] = argument
        self._run()
        if self._buffer.ret():  # CasADi leaves the outputs as they were
            return [np.full_like(array, np.nan) for array in self._outputs]
        return [array.copy() for array in self._outputs]


@dataclass(frozen=True)
class Solution:
    """A verified critical point.

    Attributes
    ----------
    unknowns : ξ
    iterations : Newton (and IPOPT) iterations together
    residual : largest residual over its own roundoff floor
    report : what was used to find it
    """

    unknowns: np.ndarray
    iterations: int
    residual: float
    report: str


@dataclass(frozen=True)
class System:
    """Stationarity conditions of a discrete action as CasADi Functions of (ξ, *data).

    Attributes
    ----------
    action : -> S
    gradient : -> ∇S by ξ
    hessian : -> ∇²S by ξ, sparse and symmetric
    terms : -> sizes of the terms that `gradient` sums
    curvature : with a direction y as last input -> yᵀ∇²S y, and the same with every term positive
    component : int array, the component of the path that each unknown is a value of
    scale : (ξ, data) -> largest size of each component along the path
    """

    action: ca.Function
    gradient: ca.Function
    hessian: ca.Function
    terms: ca.Function
    curvature: ca.Function
    component: np.ndarray
    scale: Callable[[np.ndarray, Data], np.ndarray]
    _evaluators: dict[str, Evaluator] = field(default_factory=dict, repr=False, compare=False)

    def evaluate(self, name: str, *arguments: np.ndarray) -> list[np.ndarray]:
        """Evaluate one of the Functions by name on NumPy arrays."""
        if name not in self._evaluators:
            self._evaluators[name] = Evaluator(getattr(self, name))
        return self._evaluators[name](*arguments)

    def _linear(self, solver: str) -> ca.Function:
        matrix = ca.MX.sym("matrix", self.hessian.sparsity_out(0))
        rhs = ca.MX.sym("rhs", matrix.shape[0])
        step = -ca.solve(matrix, rhs, solver)
        return ca.Function(solver, [matrix, rhs], [step, ca.norm_inf(ca.mtimes(matrix, step) + rhs)])

    @cached_property
    def ldl(self) -> ca.Function:
        """Solve by LDLᵀ without pivoting: (matrix, g) -> step, defect.  Measured 4 times faster than `qr`."""
        return self._linear("ldl")

    @cached_property
    def qr(self) -> ca.Function:
        """The same by QR, for the matrices that LDLᵀ fails on."""
        return self._linear("qr")

    @cached_property
    def spread(self) -> ca.Function:
        """(matrix, sizes) -> |matrix| sizes."""
        matrix = ca.MX.sym("matrix", self.hessian.sparsity_out(0))
        sizes = ca.MX.sym("sizes", matrix.shape[0])
        return ca.Function("spread", [matrix, sizes], [ca.mtimes(ca.fabs(matrix), sizes)])

    def direction(self, matrix: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Newton step -∇²S⁻¹ ∇S; not finite where the Hessian is singular to the last digit."""
        largest = np.max(np.abs(gradient), initial=0.0)
        step, defect = self.evaluate("ldl", matrix, gradient)
        if not np.all(np.isfinite(step)) or defect[0] > LOCAL * largest:
            step, defect = self.evaluate("qr", matrix, gradient)
        return step

    def relative(self, step: np.ndarray, unknowns: np.ndarray, data: Data) -> float:
        """Largest step of a component over the size of that component along the path."""
        scale = self.scale(unknowns, data)
        change = np.zeros(len(scale))
        np.maximum.at(change, self.component, np.abs(step))
        size = np.maximum(scale, change)
        return float(np.max(change / np.where(size > 0, size, 1.0), initial=0.0))

    def residual(self, gradient: np.ndarray, matrix: np.ndarray, unknowns: np.ndarray, data: Data) -> np.ndarray:
        """Residuals over their own roundoff floors."""
        (terms,) = self.evaluate("terms", unknowns, *data)
        (spread,) = self.evaluate("spread", matrix, self.scale(unknowns, data)[self.component])
        floor = EPS * (terms + spread)
        return np.asarray(np.abs(gradient) / np.where(floor > 0, floor, np.finfo(float).tiny))


def rootfinder(system: System, guess: np.ndarray, data: Data, verbose: int = 0) -> Solution:
    """Newton's method with a scaling-invariant line search, then IPOPT if that fails.

    Parameters
    ----------
    system : System
    guess : first iterate ξ
    data : values of the other inputs of the system's Functions
    verbose : 2 prints a line an iteration

    Raises
    ------
    SolveFailure
        if neither finds a point that can be verified
    """
    try:
        return newton(system, guess, data, verbose)
    except SolveFailure as failure:
        if failure.singular or failure.iterations == 0:
            raise
        try:
            return ipopt(system, guess, data, verbose)
        except SolveFailure as second:
            reason = f"Newton's method: {failure}; IPOPT: {second}"
            raise SolveFailure(reason, failure.unknowns, failure.iterations + second.iterations) from None


def ipopt(system: System, guess: np.ndarray, data: Data, verbose: int = 0) -> Solution:
    """IPOPT on the stationarity conditions as constraints under a constant objective; arguments as `rootfinder`."""
    return _interior_point(system, guess, data, verbose, minimize=False)


def minimizer(system: System, guess: np.ndarray, data: Data, verbose: int = 0) -> Solution:
    """IPOPT on the action itself: finds a minimum, or diverges where there is none; arguments as `rootfinder`."""
    return _interior_point(system, guess, data, verbose, minimize=True)


def newton(system: System, guess: np.ndarray, data: Data, verbose: int = 0, limit: int = 200) -> Solution:
    """Newton's method with natural monotonicity line search; arguments as `rootfinder`, at most `limit` iterations."""
    x, damping, before = guess, 1.0, None
    (g,) = system.evaluate("gradient", x, *data)
    if not np.all(np.isfinite(g)):
        raise SolveFailure("the gradient of the action is not finite at the guess", x, 0)
    for iteration in range(1, limit + 1):
        (matrix,) = system.evaluate("hessian", x, *data)
        step = system.direction(matrix, g)
        if not np.all(np.isfinite(step)):
            raise SolveFailure("the Hessian of the action is singular", x, iteration, bool(np.all(np.isfinite(matrix))))
        norm = system.relative(step, x, data)
        if norm < NEAR and np.max(system.residual(g, matrix, x, data), initial=0.0) <= ROUNDOFF:
            return _polished(system, x, g, matrix, data, iteration)
        if before is not None:
            damping = min(1.0, _predicted(before, step, x, system, data, damping))
        x, g, simplified, damping = _line_search(system, x, step, norm, matrix, data, damping, iteration)
        before = (step, simplified) if simplified is not None else None
        if verbose > 1:
            print(f"  {iteration:4d}   step {norm:9.2e}   damping {damping:7.1e}")
        if norm < NEAR and np.max(system.residual(g, matrix, x, data), initial=0.0) <= ROUNDOFF:
            return _polished(system, x, g, matrix, data, iteration)
    raise SolveFailure(f"no convergence in {limit} iterations, last relative step {norm:.1e}", x, limit)


def _predicted(
    before: tuple[np.ndarray, np.ndarray], step: np.ndarray, x: np.ndarray, system: System, data: Data, damping: float
) -> float:
    """Damping expected to pass, from how far the last simplified step missed this one (Deuflhard, eq. 3.47)."""
    last, simplified = before
    miss = system.relative(simplified - step, x, data) * system.relative(step, x, data)
    return damping * system.relative(last, x, data) * system.relative(simplified, x, data) / max(miss, 1e-300)


def _line_search(
    system: System,
    x: np.ndarray,
    step: np.ndarray,
    norm: float,
    matrix: np.ndarray,
    data: Data,
    damping: float,
    iteration: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, float]:
    """Shorten the step until the next one, with the same matrix, is shorter: new x, gradient, that step, damping."""
    while damping >= SMALLEST_DAMPING:
        trial = x + damping * step
        (g,) = system.evaluate("gradient", trial, *data)
        if not np.all(np.isfinite(g)):
            damping /= 2
            continue
        if norm * damping < LOCAL and damping == 1.0:
            return trial, g, None, damping
        simplified = system.direction(matrix, g)
        shrunk = system.relative(simplified, x, data)
        if shrunk <= (1 - damping / 4) * norm:
            return trial, g, simplified, damping
        bend = system.relative(simplified - (1 - damping) * step, x, data)
        damping = min(damping / 2, norm * damping**2 / (2 * max(bend, 1e-300)))
    raise SolveFailure("the line search found no step that leads on", x, iteration)


def _polished(
    system: System, x: np.ndarray, g: np.ndarray, matrix: np.ndarray, data: Data, iterations: int
) -> Solution:
    """Take one more step with the last matrix if it does not hurt, and report."""
    residual = float(np.max(system.residual(g, matrix, x, data), initial=0.0))
    trial = x + system.direction(matrix, g)
    (g,) = system.evaluate("gradient", trial, *data)
    after = float(np.max(system.residual(g, matrix, trial, data), initial=0.0))
    if after <= residual:
        x, residual = trial, after
    return Solution(x, iterations, residual, "Newton")


def _interior_point(system: System, guess: np.ndarray, data: Data, verbose: int, minimize: bool) -> Solution:
    solver = _nlpsol(system, minimize, verbose)
    bounds = {} if minimize else {"lbg": 0.0, "ubg": 0.0}
    answer = solver(x0=guess, p=np.concatenate(data), **bounds)
    stats = solver.stats()
    iterations, status = int(stats["iter_count"]), str(stats["return_status"]).replace("_", " ")
    x = np.array(answer["x"]).ravel()
    if not np.all(np.isfinite(x)):
        raise SolveFailure(f"IPOPT stopped with '{status}' at a point that is not finite", guess, iterations)
    try:
        polished = newton(system, x, data, verbose, limit=20)
    except SolveFailure as failure:
        if stats["success"]:
            status += f", then Newton's method: {failure}"
        raise SolveFailure(f"IPOPT stopped with '{status}'", x, iterations, failure.singular) from None
    name = "IPOPT on the action" if minimize else "IPOPT"
    total = iterations + polished.iterations
    return Solution(polished.unknowns, total, polished.residual, f"{name}, then Newton")


def _nlpsol(system: System, minimize: bool, verbose: int) -> ca.Function:
    """IPOPT with all derivatives supplied from the pointwise Functions."""
    n, sizes = system.gradient.size1_in(0), [system.gradient.size1_in(i) for i in range(1, system.gradient.n_in())]
    x, p = ca.MX.sym("x", n), ca.MX.sym("p", sum(sizes))
    arguments = [x, *ca.vertsplit(p, np.cumsum([0, *sizes]).tolist())]
    gradient, hessian = system.gradient(*arguments), system.hessian(*arguments)
    factor, multipliers = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", 0 if minimize else n)
    upper = factor * ca.triu(hessian) if minimize else ca.MX(n, n)  # the constraints' curvature is left out
    options = {
        "hess_lag": ca.Function("hess_lag", [x, p, factor, multipliers], [upper]),
        "print_time": False,
        "ipopt": {"print_level": 5 if verbose > 1 else 0, "sb": "yes", "tol": 1e-10, "max_iter": 500},
    }
    if minimize:
        action = system.action(*arguments)
        options["grad_f"] = ca.Function("grad_f", [x, p], [action, gradient])
        return ca.nlpsol("minimizer", "ipopt", {"x": x, "p": p, "f": action}, options)
    options["jac_g"] = ca.Function("jac_g", [x, p], [gradient, hessian])
    return ca.nlpsol("stationary", "ipopt", {"x": x, "p": p, "f": 0, "g": gradient}, options)


def second_variation(system: System, matrix: np.ndarray, unknowns: np.ndarray, data: Data) -> float:
    """Smallest second variation relative to the sizes of its terms; 0 at a conjugate point.

    Three inverse iterations find the direction y, the pointwise sums give its quotient
    yᵀ∇²S y / Σ |z|ᵀ|∇²L̂||z|, which does not depend on scales or on the mesh.
    """
    scale = system.scale(unknowns, data)
    y = np.cos(1.0 + np.arange(len(unknowns))) * np.where(scale > 0, scale, 1.0)[system.component]
    for _ in range(3):
        y = system.direction(matrix, y)
        largest = np.max(np.abs(y), initial=0.0)
        if not np.isfinite(largest) or largest == 0:
            return 0.0
        y = y / largest
    signed, positive = system.evaluate("curvature", unknowns, *data, y)
    return float(abs(signed[0]) / positive[0])


def negative_eigenvalues(system: System, unknowns: np.ndarray, data: Data) -> int:
    """Morse index: number of negative eigenvalues of the Hessian, from the inertia of its LDLᵀ factors."""
    matrix = system.hessian(unknowns, *data)
    solver = ca.Linsol("inertia", "ldl", matrix.sparsity())
    solver.sfact(matrix)
    solver.nfact(matrix)
    return int(solver.neig(matrix))
