"""The only caller of CasADi's solvers: solve F(ξ) = ∇S = 0, verify, return or raise.

Three engines share one signature ``engine(system, guess, data, verbose) -> Solution``:

`rootfinder` (the default) is Newton's method with a line search that does not see the scaling of equations or
unknowns (natural monotonicity test; P. Deuflhard, "Newton Methods for Nonlinear Problems", 2004, algorithm
NLEQ-ERR).  CasADi's own ``newton`` plugin was measured beside it: it stops at an absolute residual, which at 1e5
intervals lies below roundoff, reports NaN as success, and from a straight line diverges on large swings.  Where
Newton fails, IPOPT first minimises the action (long pendulum swings: 10 iterations where the stationarity
conditions alone took 60 to 500), then solves the stationarity conditions; Newton finishes from where it stopped.

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
RESCUE = 100  # iterations IPOPT gets after Newton's method; rescues were measured to take 4 to 40
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
        """Evaluate; the returned arrays are copies."""
        for target, argument in zip(self._inputs, arguments, strict=True):
            target[:] = argument
        self._run()
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
    pivots : whether LDLᵀ without pivoting can work: False where ∂²L/∂v_i² is structurally zero for some i
    """

    action: ca.Function
    gradient: ca.Function
    hessian: ca.Function
    terms: ca.Function
    curvature: ca.Function
    component: np.ndarray
    scale: Callable[[np.ndarray, Data], np.ndarray]
    pivots: bool = True
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
        if self.pivots:
            step, defect = self.evaluate("ldl", matrix, gradient)
        if not self.pivots or not np.all(np.isfinite(step)) or defect[0] > LOCAL * largest:
            (step, _) = self.evaluate("qr", matrix, gradient)
        if largest > 0 and not np.any(step):  # CasADi's QR answers a rank-deficient system with zeros
            return np.full_like(step, np.nan)
        return step

    def sizes(self, step: np.ndarray, unknowns: np.ndarray, data: Data) -> np.ndarray:
        """What a change of each unknown is measured by: the largest size or `step` of its component."""
        scale = self.scale(unknowns, data)
        np.maximum.at(scale, self.component, np.abs(step))
        return np.asarray(np.where(scale > 0, scale, 1.0)[self.component])

    def residual(self, gradient: np.ndarray, matrix: np.ndarray, unknowns: np.ndarray, data: Data) -> np.ndarray:
        """Residuals over their own roundoff floors."""
        (terms,) = self.evaluate("terms", unknowns, *data)
        (spread,) = self.evaluate("spread", matrix, self.scale(unknowns, data)[self.component])
        floor = EPS * (terms + spread)
        return np.asarray(np.abs(gradient) / np.where(floor > 0, floor, np.finfo(float).tiny))


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
        sizes = system.sizes(step, x, data)
        norm = _norm(step, sizes)
        if before is not None:
            damping = min(1.0, _predicted(before, step, sizes, damping))
        x, g, simplified, damping = _line_search(system, x, step, sizes, matrix, data, damping, iteration)
        before = (step, simplified) if simplified is not None else None
        if verbose > 1:
            print(f"  {iteration:4d}   step {norm:9.2e}   damping {damping:7.1e}")
        # Only after the step: at 1e5 intervals the residual is at roundoff while the path is still off by 1e-9.
        if norm < NEAR and np.max(system.residual(g, matrix, x, data), initial=0.0) <= ROUNDOFF:
            return _polished(system, x, g, matrix, data, iteration)
    raise SolveFailure(f"no convergence in {limit} iterations, last relative step {norm:.1e}", x, limit)


def _norm(step: np.ndarray, sizes: np.ndarray) -> float:
    """Largest change relative to the sizes; one iteration measures all its steps by the same sizes."""
    return float(np.max(np.abs(step) / sizes, initial=0.0))


def _predicted(before: tuple[np.ndarray, np.ndarray], step: np.ndarray, sizes: np.ndarray, damping: float) -> float:
    """Damping expected to pass, from how far the last simplified step missed this one (Deuflhard, eq. 3.47)."""
    last, simplified = before
    miss = _norm(simplified - step, sizes) * _norm(step, sizes)
    return damping * _norm(last, sizes) * _norm(simplified, sizes) / max(miss, 1e-300)


def _line_search(
    system: System,
    x: np.ndarray,
    step: np.ndarray,
    sizes: np.ndarray,
    matrix: np.ndarray,
    data: Data,
    damping: float,
    iteration: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, float]:
    """Shorten the step until the next one, with the same matrix, is shorter: new x, gradient, that step, damping."""
    norm = _norm(step, sizes)
    while damping >= SMALLEST_DAMPING:
        trial = x + damping * step
        (g,) = system.evaluate("gradient", trial, *data)
        if not np.all(np.isfinite(g)):
            damping /= 2
            continue
        if norm * damping < LOCAL and damping == 1.0:
            return trial, g, None, damping
        simplified = system.direction(matrix, g)
        if _norm(simplified, sizes) <= (1 - damping / 4) * norm:
            return trial, g, simplified, damping
        bend = _norm(simplified - (1 - damping) * step, sizes)
        damping = min(damping / 2, norm * damping**2 / (2 * max(bend, 1e-300)))
    if second_variation(system, matrix, x, data) < SINGULAR:
        raise SolveFailure("the Hessian of the action is singular", x, iteration, singular=True)
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


def _interior_point(
    system: System, guess: np.ndarray, data: Data, verbose: int, minimize: bool, limit: int = 500
) -> Solution:
    name = "IPOPT on the action" if minimize else "IPOPT"
    solver = _nlpsol(system, minimize, verbose, limit)
    bounds = {} if minimize else {"lbg": 0.0, "ubg": 0.0}
    answer = solver(x0=guess, p=np.concatenate(data), **bounds)
    stats = solver.stats()
    iterations, status = int(stats["iter_count"]), str(stats["return_status"]).replace("_", " ")
    x = np.array(answer["x"]).ravel()
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
    return Solution(polished.unknowns, total, polished.residual, f"{name}, then Newton")


def _nlpsol(system: System, minimize: bool, verbose: int, limit: int) -> ca.Function:
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
        "calc_lam_p": False,
        "show_eval_warnings": verbose > 1,  # IPOPT shortens a step that leaves the Lagrangian's domain
        "ipopt": {"print_level": 5 if verbose > 1 else 0, "sb": "yes", "tol": 1e-10, "max_iter": limit},
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
    if len(unknowns) == 0:
        return np.inf  # nothing can vary
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


def negative_eigenvalues(system: System, unknowns: np.ndarray, data: Data) -> int | None:
    """Morse index: number of negative eigenvalues of the Hessian, from the inertia of its LDLᵀ factors.

    None where the kinetic energy is indefinite by structure, such as v_0 v_1: the index then grows without bound
    as the mesh is refined, and LDLᵀ without pivoting does not find it.
    """
    if not system.pivots:
        return None
    if len(unknowns) == 0:
        return 0
    matrix = system.hessian(unknowns, *data)
    solver = ca.Linsol("inertia", "ldl", matrix.sparsity())
    solver.sfact(matrix)
    solver.nfact(matrix)
    return int(solver.neig(matrix))
