"""The discrete action of a boundary problem as named CasADi Functions, each built when it is first needed.

All are Functions of (unknowns, start, end, mesh[, parameters]); `start` and `end` hold the fixed components only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import cached_property

import casadi as ca
import numpy as np

from casadi_galerkin.algebra import algebra
from casadi_galerkin.calculus import Galerkin
from casadi_galerkin.functional import Evaluation, Functional, pointwise
from casadi_galerkin.iteration import compiled_stages, suits
from casadi_galerkin.kernel import translatable
from casadi_galerkin.layout import Layout
from casadi_galerkin.problems import BoundaryProblem
from casadi_galerkin.system import System


class ActionGraph:
    """The graph of a boundary problem on N intervals.

    Parameters
    ----------
    problem : BoundaryProblem
    method : Galerkin
    mesh : (N + 1,), joints; only their number enters the graph
    evaluation : of gradient and Hessian at the points, as for `Functional`; "compiled" compiles the whole Newton
        iteration where that suits

    Attributes
    ----------
    functional : Functional, the expressions behind the Functions below
    layout : Layout, which unknown is which value of the path
    system : the Functions below as the engines take them
    build_seconds : float
    """

    def __init__(
        self, problem: BoundaryProblem, method: Galerkin, mesh: np.ndarray, evaluation: Evaluation = "vectorised"
    ) -> None:
        began = time.perf_counter()
        self.problem, self.method, self.mesh = problem, method, mesh
        fixed_start, fixed_end = (
            tuple(i for i, value in enumerate(end) if value is not None) for end in (problem.start, problem.end)
        )
        layout = Layout(method, len(mesh) - 1, problem.dimension, fixed_start, fixed_end, problem.periodic)
        compiles = False
        if evaluation == "compiled":
            derived = pointwise(problem.lagrangian)
            compiles = suits(derived, layout)
            if compiles or not translatable(derived.derivatives):
                evaluation = "vectorised"  # of what is left
        self.functional = Functional(problem.lagrangian, layout, evaluation)
        self.layout = self.functional.layout
        at_point, linear = self.functional.pointwise, algebra(*self.functional.pattern_key)
        self.system = System(
            self._build,
            self._mapped,
            linear,
            at_point.blocks,
            at_point.kinetic,
            at_point.quadratic,
            compiled_stages(at_point, layout, linear.workspace) if compiles else {},
            evaluation == "single",
        )
        self.build_seconds = time.perf_counter() - began

    def _build(self, name: str) -> ca.Function:
        """One of the Functions below; what is built only now counts as building too."""
        return self._timed(lambda: getattr(self, name))

    def _mapped(self, name: str) -> ca.Function:
        """A pointwise Function over all points."""
        return self._timed(lambda: self.functional.mapped(name))

    def _timed(self, build: Callable[[], ca.Function]) -> ca.Function:
        began = time.perf_counter()
        function = build()
        self.build_seconds += time.perf_counter() - began
        return function

    def _function(
        self, name: str, *outputs: ca.MX, extra: tuple[ca.MX, ...] = (), results: Sequence[str] | None = None
    ) -> ca.Function:
        symbols = self.functional.symbols
        names = list(symbols) + [f"extra{i}" for i in range(len(extra))]
        results = results or ([name] if len(outputs) == 1 else [f"{name}{i}" for i in range(len(outputs))])
        return ca.Function(name, [*symbols.values(), *extra], list(outputs), names, results)

    @cached_property
    def action(self) -> ca.Function:
        """S of (unknowns, start, end, mesh[, parameters])."""
        return self._function("action", self.functional.action())

    @cached_property
    def gradient(self) -> ca.Function:
        """∇S by the unknowns."""
        return self._function("gradient", self.functional.gradient())

    @cached_property
    def hessian(self) -> ca.Function:
        """∇²S by the unknowns, sparse."""
        return self._function("hessian", self.functional.hessian())

    @cached_property
    def derivatives(self) -> ca.Function:
        """∇²S and ∇S together."""
        return self._function("derivatives", *self.functional.derivatives(), results=["matrix", "gradient"])

    @cached_property
    def curvature(self) -> ca.Function:
        """Second variation along one more input, a direction, and the sum of the sizes of its terms."""
        direction = ca.MX.sym("direction", self.layout.free)
        terms = self.functional.curvature(direction)
        return self._function("curvature", *terms, extra=(direction,))

    @cached_property
    def floor(self) -> ca.Function:
        """Roundoff floor of every entry of ∇S, as `Algebra.floor`."""
        terms = self.functional.first()[3]
        return self._function(
            "floor", self.system.algebra.floor(self.functional.hessian(), self.functional.u, terms)[0]
        )

    @cached_property
    def sensitivity(self) -> ca.Function:
        """Derivative of ∇S along one more input, a direction of the parameters."""
        parameters = self.functional.symbols["parameters"]
        direction = ca.MX.sym("direction", parameters.shape[0])
        return self._function(
            "sensitivity", ca.jtimes(self.functional.gradient(), parameters, direction), extra=(direction,)
        )

    @cached_property
    def timing(self) -> ca.Function:
        """∂S/∂t_i, ∂²S/∂t_i² and ∂²S/∂t_i∂t_{i+1} at fixed node values: the first are the jumps of the energy."""
        return self._function("timing", *self.functional.timing())

    @cached_property
    def summary(self) -> ca.Function:
        """S; momenta (d, N + 1) at all joints; ∇S; sizes of the terms that ∇S sums.

        The first momentum is -∂S/∂x_0, the others are ∂S_k/∂x_{k+1} of interval k.
        """
        outputs = self.functional.first()
        return self._function("summary", *outputs, results=["action", "momentum", "gradient", "terms"])
