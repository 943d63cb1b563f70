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

import math
import threading
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
NEARLY = 1e-9  # residual over the sizes of its terms from which two Newton steps reach roundoff
SINGULAR = 1e-12  # second variation over the sum of its terms below which the Hessian is called singular

Data = tuple[np.ndarray, ...]


class SolveFailure(Exception):
    """An engine's own report that it stopped; carries the last iterate."""

    def __init__(self, reason: str, unknowns: np.ndarray, iterations: int, singular: bool = False) -> None:
        super().__init__(reason)
        self.unknowns, self.iterations, self.singular = unknowns, iterations, singular


class Evaluator:
    """Calls a Function on NumPy arrays without conversion: nonzeros in, nonzeros out.

    An input or output named "matrix" is bound to the array `matrix`, and neither passed nor returned: at degree 30
    copying the Hessian would take longer than all else that is done in Python.
    """

    def __init__(self, function: ca.Function, matrix: np.ndarray | None = None) -> None:
        self._function = function  # the buffer does not keep it alive
        self._buffer, self._run = function.buffer()
        shared: Any = np.zeros(0) if matrix is None else matrix
        inputs: dict[str, Any] = {function.name_in(i): np.zeros(function.nnz_in(i)) for i in range(function.n_in())}
        outputs: dict[str, Any] = {function.name_out(i): np.zeros(function.nnz_out(i)) for i in range(function.n_out())}
        for arrays, bind in ((inputs, self._buffer.set_arg), (outputs, self._buffer.set_res)):
            for i, (name, array) in enumerate(arrays.items()):
                bind(i, memoryview(shared if name == "matrix" else array))
        self._inputs = [array for name, array in inputs.items() if name != "matrix"]
        self._outputs = [array for name, array in outputs.items() if name != "matrix"]

    def __call__(self, *arguments: np.ndarray) -> list[np.ndarray]:
        """Evaluate; the returned arrays are copies."""
        for target, argument in zip(self._inputs, arguments, strict=True):
            target[:] = argument
        self._run()
        if self._buffer.ret():  # aborted, as CasADi's QR does on a small pivot: the arrays hold an earlier answer
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


class Algebra:
    """Newton's method between two evaluations: what depends on the Hessian's sparsity and the scale, but not on L.

    It is kept for all Lagrangians of a layout, with the Hessian in `matrix` as `System.derivatives` left it there, so
    whoever works with it holds `lock`.  The steps of an iteration are bundled into few Functions, since a call from
    Python costs about as much as evaluating a small problem.  Those that solve with ∇²S are built for a linear
    solver, "ldl" or "qr"; their first output is the solution, the last one the excess of the defect over a small
    part of the right-hand side.

    Parameters
    ----------
    sparsity : of ∇²S
    component : int array, the component of the path that each unknown is a value of
    scale : (ξ, start, end) -> largest size of each component along the path
    """

    def __init__(self, sparsity: ca.Sparsity, component: np.ndarray, scale: ca.Function) -> None:
        self.component, self.scale = component, scale
        self._ends = [ca.MX.sym(scale.name_in(i), scale.size1_in(i)) for i in range(3)]
        self._matrix, self._damping = ca.MX.sym("matrix", sparsity), ca.MX.sym("damping")
        self._vectors = [ca.MX.sym(f"vector{i}", sparsity.size1()) for i in range(4)]
        self.matrix, self.lock = np.zeros(sparsity.nnz()), threading.Lock()
        self._evaluators: dict[tuple[str, str | None], Evaluator] = {}

    def evaluate(self, name: str, solver: str | None, *arguments: np.ndarray) -> list[np.ndarray]:
        """Evaluate the Function of that name, built when it is first asked for."""
        evaluator = self._evaluators.get((name, solver))
        if evaluator is None:
            inputs, outputs = getattr(self, name)(*([solver] if solver else []))
            names = ["matrix" if symbol is self._matrix else f"input{i}" for i, symbol in enumerate(inputs)]
            function = ca.Function(name, inputs, outputs, names, [f"output{i}" for i in range(len(outputs))])
            evaluator = self._evaluators[name, solver] = Evaluator(function, self.matrix)
        return evaluator(*arguments)

    @cached_property
    def factors(self) -> ca.Linsol:
        """LDLᵀ without pivoting, its symbolic part done once.  Measured 4 times faster than QR."""
        return ca.Linsol("ldl", "ldl", self._matrix.sparsity())

    def _solve(self, solver: str, rhs: ca.MX) -> list[ca.MX]:
        """Solution of ∇²S y = -rhs, and the excess of its defect; a sum of sizes does not lose a NaN."""
        matrix = self._matrix
        y = -(self.factors.solve(matrix, rhs) if solver == "ldl" else ca.solve(matrix, rhs, solver))
        return [y, ca.norm_1(ca.mac(matrix, y, rhs)) - LOCAL * ca.norm_1(rhs)]

    def _expand(self, values: ca.MX) -> ca.MX:
        """One value a component -> one an unknown."""
        return ca.vec(values.get_nz(False, self.component.tolist()))

    def direction(self, solver: str) -> tuple[list[ca.MX], list[ca.MX]]:
        """(∇²S, g) -> step -∇²S⁻¹ g."""
        return [self._matrix, self._vectors[0]], self._solve(solver, self._vectors[0])

    def descent(self, solver: str) -> tuple[list[ca.MX], list[ca.MX]]:
        """(∇²S, g, ξ, start, end) -> Newton step, the sizes that it is measured by, its norm."""
        step, excess = self._solve(solver, self._vectors[0])
        change = self.scale(step, *(ca.MX.zeros(a.shape) for a in self._ends[1:]))
        largest = ca.fmax(self.scale(*self._ends), change)
        sizes = self._expand(largest + (largest == 0))
        inputs = [self._matrix, self._vectors[0], *self._ends]
        return inputs, [step, sizes, ca.norm_inf(step / sizes), excess]

    def trial(self, solver: str) -> tuple[list[ca.MX], list[ca.MX]]:
        """(∇²S, g, step, sizes, damping) -> next step with the same matrix, norms of it and of the path's bend."""
        g, step, sizes, _ = self._vectors
        y, excess = self._solve(solver, g)
        norms = [ca.norm_inf(y / sizes), ca.norm_inf((y - (1 - self._damping) * step) / sizes)]
        return [self._matrix, g, step, sizes, self._damping], [y, *norms, excess]

    def variation(self, solver: str) -> tuple[list[ca.MX], list[ca.MX]]:
        """(∇²S, ξ, start, end) -> direction after three inverse iterations."""
        scale, excess = self.scale(*self._ends), 0
        y = np.cos(1.0 + np.arange(len(self.component))) * self._expand(scale + (scale == 0))
        for _ in range(3):
            y, defect = self._solve(solver, y)
            y, excess = y / ca.norm_inf(y), ca.fmax(excess, defect) + 0 * defect  # the last term keeps a NaN
        return [self._matrix, *self._ends], [y, excess]

    def forecast(self) -> tuple[list[ca.MX], list[ca.MX]]:
        """(last step, the one simplified after it, step, sizes) -> factor on the damping (Deuflhard, eq. 3.47)."""
        last, simplified, step, sizes = self._vectors
        norms = [ca.norm_inf(y / sizes) for y in (last, simplified, simplified - step, step)]
        return self._vectors, [norms[0] * norms[1] / ca.fmax(norms[2] * norms[3], 1e-300)]

    def length(self) -> tuple[list[ca.MX], list[ca.MX]]:
        """(step, ξ, start, end) -> the step's norm relative to the path's size; not finite where the step is not."""
        step, scale = self._vectors[0], self.scale(*self._ends)
        relative = step / self._expand(scale + (scale == 0))
        return [step, *self._ends], [ca.norm_inf(relative) + 0 * ca.norm_1(step)]

    def ratios(self) -> tuple[list[ca.MX], list[ca.MX]]:
        """(∇²S, g, terms, ξ, start, end) -> residuals over their own roundoff floors."""
        g, terms, *_ = self._vectors
        spread = ca.mtimes(ca.fabs(self._matrix), self._expand(self.scale(*self._ends)))
        floor = ca.fmax(EPS * (terms + spread), float(np.finfo(float).tiny))
        return [self._matrix, g, terms, *self._ends], [ca.fabs(g) / floor]


@dataclass(frozen=True)
class System:
    """Stationarity conditions of a discrete action as CasADi Functions of (ξ, *data), data being (start, end, ...).

    Attributes
    ----------
    build : name -> Function; called when the Function is first needed, since building costs more than evaluating.
        The names are

        - action : -> S
        - gradient : -> ∇S by ξ
        - hessian : -> ∇²S by ξ, sparse and symmetric
        - derivatives : -> both; by `evaluate`, only ∇S is returned and ∇²S is left in `algebra.matrix`
        - terms : -> sizes of the terms that `gradient` sums
        - curvature : with a direction y as last input -> yᵀ∇²S y, and the same with every term positive
        - inertial : with a factor on ∂²L/∂v² as last input -> ∇²S, left in `algebra.matrix`
    algebra : Algebra
    pivots : whether LDLᵀ without pivoting can work: False where ∂²L/∂v_i² is structurally zero for some i
    """

    build: Callable[[str], ca.Function]
    algebra: Algebra
    pivots: bool = True
    _evaluators: dict[str, Evaluator] = field(default_factory=dict, repr=False, compare=False)
    _solvers: dict[tuple[bool, int, int], ca.Function] = field(default_factory=dict, repr=False, compare=False)

    def evaluate(self, name: str, *arguments: np.ndarray) -> list[np.ndarray]:
        """Evaluate one of the Functions by name on NumPy arrays."""
        if name not in self._evaluators:
            self._evaluators[name] = Evaluator(self.build(name), self.algebra.matrix)
        return self._evaluators[name](*arguments)

    def solved(self, name: str, *arguments: np.ndarray) -> list[np.ndarray]:
        """Evaluate one of the Functions that solve with ∇²S: by LDLᵀ, then by QR where that fails.

        The first output is not finite where the Hessian is singular to the last digit.
        """
        for solver in ("ldl", "qr") if self.pivots else ("qr",):
            results = self.algebra.evaluate(name, solver, *arguments)
            if results[-1][0] <= 0:
                return results
        if not np.any(results[0]):  # CasADi's QR answers a rank-deficient system with zeros
            results[0][:] = np.nan
        return results

    def ratios(self, gradient: np.ndarray, unknowns: np.ndarray, data: Data) -> np.ndarray:
        """Residuals over their own roundoff floors."""
        (terms,) = self.evaluate("terms", unknowns, *data)
        return self.algebra.evaluate("ratios", None, gradient, terms, unknowns, *data[:2])[0]


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
    for iteration in range(1, limit + 1):
        (g,) = system.evaluate("derivatives", x, *data)
        step, sizes, (norm,), _ = system.solved("descent", g, x, *data[:2])
        if iteration == 1 and not np.isfinite(g).all():
            raise SolveFailure("the gradient of the action is not finite at the guess", x, 0)
        if not np.isfinite(step).all():
            finite = bool(np.isfinite(system.algebra.matrix).all())
            raise SolveFailure("the Hessian of the action is singular", x, iteration, singular=finite)
        if before is not None:
            damping = min(1.0, damping * float(system.algebra.evaluate("forecast", None, *before, step, sizes)[0][0]))
        x, g, simplified, damping = _line_search(system, x, step, sizes, norm, data, damping, iteration)
        before = (step, simplified) if simplified is not None else None
        if verbose > 1:
            print(f"  {iteration:4d}   step {norm:9.2e}   damping {damping:7.1e}")
        # Only after the step: at 1e5 intervals the residual is at roundoff while the path is still off by 1e-9.
        if norm < NEAR and (residual := system.ratios(g, x, data).max(initial=0.0)) <= ROUNDOFF:
            return _polished(system, x, g, float(residual), data, iteration)
    raise SolveFailure(f"no convergence in {limit} iterations, last relative step {norm:.1e}", x, limit)


def _line_search(
    system: System,
    x: np.ndarray,
    step: np.ndarray,
    sizes: np.ndarray,
    norm: float,
    data: Data,
    damping: float,
    iteration: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, float]:
    """Shorten the step until the next one, with the same matrix, is shorter: new x, gradient, that step, damping."""
    while damping >= SMALLEST_DAMPING:
        trial = x + damping * step
        (g,) = system.evaluate("gradient", trial, *data)
        if not np.isfinite(g).all():
            damping /= 2
            continue
        if damping == 1.0 and norm < LOCAL:
            return trial, g, None, damping
        simplified, (shrunk,), (bend,), _ = system.solved("trial", g, step, sizes, np.array([damping]))
        if shrunk <= (1 - damping / 4) * norm and np.isfinite(simplified).all():
            return trial, g, simplified, damping
        damping = min(damping / 2, norm * damping**2 / (2 * max(bend, 1e-300)))
    if second_variation(system, x, data) < SINGULAR:
        raise SolveFailure("the Hessian of the action is singular", x, iteration, singular=True)
    raise SolveFailure("the line search found no step that leads on", x, iteration)


def _polished(
    system: System,
    x: np.ndarray,
    g: np.ndarray,
    residual: float,
    data: Data,
    iterations: int,
) -> Solution:
    """Take one more step with the last matrix if it does not hurt, and report."""
    trial = x + system.solved("direction", g)[0]
    (g,) = system.evaluate("gradient", trial, *data)
    after = float(system.ratios(g, trial, data).max(initial=0.0))
    if after <= residual:
        x, residual = trial, after
    return Solution(x, iterations, residual, "Newton")


def _interior_point(
    system: System, guess: np.ndarray, data: Data, verbose: int, minimize: bool, limit: int = 500
) -> Solution:
    name = "IPOPT on the action" if minimize else "IPOPT"
    key = (minimize, verbose, limit)
    if key not in system._solvers:
        system._solvers[key] = _nlpsol(system, *key)  # building takes longer than solving a small problem
    solver = system._solvers[key]
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
    slope = system.build("gradient")
    n, *sizes = [slope.size1_in(i) for i in range(slope.n_in())]
    x, p = ca.MX.sym("x", n), ca.MX.sym("p", sum(sizes))
    arguments = [x, *ca.vertsplit(p, np.cumsum([0, *sizes]).tolist())]
    gradient, hessian = slope(*arguments), system.build("hessian")(*arguments)
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
        action = system.build("action")(*arguments)
        options["grad_f"] = ca.Function("grad_f", [x, p], [action, gradient])
        return ca.nlpsol("minimizer", "ipopt", {"x": x, "p": p, "f": action}, options)
    options["jac_g"] = ca.Function("jac_g", [x, p], [gradient, hessian])
    return ca.nlpsol("stationary", "ipopt", {"x": x, "p": p, "f": 0, "g": gradient}, options)


def second_variation(system: System, unknowns: np.ndarray, data: Data) -> float:
    """Smallest second variation relative to the sizes of its terms; 0 at a conjugate point.

    Three inverse iterations find the direction y, the pointwise sums give its quotient
    yᵀ∇²S y / Σ |z|ᵀ|∇²L̂||z|, which does not depend on scales or on the mesh.
    """
    if len(unknowns) == 0:
        return np.inf  # nothing can vary
    system.evaluate("derivatives", unknowns, *data)
    y = system.solved("variation", unknowns, *data[:2])[0]
    signed, positive = (float(value[0]) for value in system.evaluate("curvature", unknowns, *data, y))
    return abs(signed) / positive if math.isfinite(signed) and 0 < positive < math.inf else 0.0


def negative_eigenvalues(system: System, unknowns: np.ndarray, data: Data) -> int | None:
    """Morse index: number of negative eigenvalues of the Hessian, from the inertia of its LDLᵀ factors.

    None where the kinetic energy is indefinite by structure, such as v_0 v_1: the index then grows without bound
    as the mesh is refined, and LDLᵀ without pivoting does not find it.
    """
    if not system.pivots:
        return None
    if len(unknowns) == 0:
        return 0
    (matrix,) = system.build("hessian").call([unknowns, *data])
    system.algebra.factors.nfact(matrix)
    return int(system.algebra.factors.neig(matrix))


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
