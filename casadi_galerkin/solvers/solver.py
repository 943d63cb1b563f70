"""The solvers by name: each takes the stationarity conditions and a guess, and returns what was verified, or raises.

`newton`, the default, is Newton's method.  Where it fails, IPOPT minimizes the action (long pendulum swings: 10
iterations where the stationarity conditions alone took 60 to 500), or solves the equations where no action is to be
minimized; Newton's method finishes from where IPOPT stopped.  At last the load is taken away that holds the guess in
place (of 80 problems of stiff springs, whose paths are many and far from the straight line, it solved 36 of the 58 that
were lost).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

import casadi_galerkin.solvers.ipopt as interior_point
import casadi_galerkin.solvers.rootfinder as casadi_rootfinder
from casadi_galerkin.calculus.numbers import whole
from casadi_galerkin.functional.numbering import Data
from casadi_galerkin.solvers.curve import remove_load
from casadi_galerkin.solvers.deadline import seconds_left
from casadi_galerkin.solvers.newton import SEARCH_ITERATIONS, Solution, SolveFailure, damped_newton
from casadi_galerkin.solvers.stationarity import Stationarity

SolverLike: TypeAlias = Callable[[Stationarity, np.ndarray, Data, int], Solution]


@dataclass(frozen=True)
class Solver:
    """A way to solve the equations of a problem, with its options: one of six, each verified in the same way.

    - `newton`, the default of a BoundaryProblem, is Newton's method, with a line search and then with longer steps.
      Where it fails, IPOPT on the action rescues it, or the load of the guess taken away.
    - `rootfinder` is CasADi's own Newton method, whose steps lower the residual.
    - `ipopt`, the default of a ControlProblem, takes the equations as constraints.
    - `minimizer` is IPOPT on the action of a BoundaryProblem, and finds minima only.
    - `sqp`, for a ControlProblem alone, is sequential quadratic programming, from an earlier answer of the same method
      and intervals, in half the iterations of `ipopt` or less; elsewhere, and where it fails, `ipopt` solves.
    - `fatrop`, for a ControlProblem alone, goes through it stage by stage, mostly in less time than `ipopt`; but what
      CasADi builds for it grows with the square of the intervals, to 9 s for 20 components on 200 of them.

    `fatrop` takes any rule of quadrature, but no `end_conditions` on the start, and no multipliers to start warm from.
    It stalls where `ipopt` does not, as where a position touches its bound in a point, or where equations depend on one
    another.  It needs units in which positions and controls are of order one, 1e-5 to 1e4.  Far from these, and now and
    then elsewhere (6 of 15 meshes of a hanging chain, one of 40 random guesses of an acrobot), it runs for ever: no
    iteration ends, so that neither a limit nor an interrupt stops it.  Another mesh or guess may do, or the options
    ``linsol_lu_fact_tol=5e-5, delta_c_stripe=1e-2``.  Where it stops without an answer, `ipopt` solves, and the report
    says so.

    Attributes
    ----------
    name : such as "newton"
    options : what `with_options` has set

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> cg.ipopt.with_options(max_iter=50)
    cg.ipopt.with_options(max_iter=50)
    """

    name: str
    _run: Callable[..., Solution]
    _check: Callable[[str, object], None]
    options: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def __call__(self, *arguments: Any, **options: object) -> Solution:
        """Solve from a guess; called by `solve`, which takes the solver itself.

        Parameters
        ----------
        arguments : Stationarity; first iterate ξ; values of the other inputs of the graph, which are start, end, mesh
            and, if there are some, parameters and given values; and `verbose`, of which 2 prints a line per iteration

        Raises
        ------
        SolveFailure
            if no point was found that can be verified
        """
        if options or not (arguments and isinstance(arguments[0], Stationarity)):
            name, given = f"cg.{self.name}", ", ".join(f"{key}={value!r}" for key, value in options.items())
            asked = f"{name}.with_options({given or '...'})"
            raise TypeError(f"{name} is handed to a solve and not called: write solver={name}, or solver={asked}")
        return self._run(*arguments, **self.options)

    def with_options(self, **options: Any) -> Solver:
        """The same solver with options of what is underneath, added to those it has.

        `newton` takes `max_iter`, the most iterations before its rescues begin, and `linear_solver`, one of CasADi's,
        such as "qr" or "csparse"; `rootfinder` takes all options of CasADi's ``newton`` rootfinder; `ipopt` and
        `minimizer` take all options of IPOPT, after which Newton's method still polishes and verifies; `fatrop` takes
        those of fatrop, and `sqp` those of CasADi's ``sqpmethod``.

        Raises
        ------
        ValueError
            naming the option that the solver does not have, or the value that it does not take
        """
        for name, value in options.items():
            self._check(name, value)
        return replace(self, options={**self.options, **options})

    def __repr__(self) -> str:
        """Write it as it is called."""
        given = ", ".join(f"{name}={value!r}" for name, value in self.options.items())
        return f"cg.{self.name}" + (f".with_options({given})" if given else "")


def rescues(stationarity: Stationarity) -> dict[str, SolverLike]:
    """The solvers that are tried in turn where Newton's method finds nothing from a guess, by name."""
    action = stationarity.variational
    ipopt = partial(interior_point.critical_point, minimize=action, max_iter=SEARCH_ITERATIONS)
    strategies: dict[str, SolverLike] = {"IPOPT on the action" if action else "IPOPT": ipopt}
    if stationarity.functional.numbering.positions:
        strategies["taking away the load of the guess"] = remove_load
    return strategies


def _newton(stationarity: Stationarity, guess: np.ndarray, data: Data, verbose: int = 0, **options: Any) -> Solution:
    """Newton's method, then its rescues."""
    try:
        return damped_newton(stationarity, guess, data, verbose, **options)
    except SolveFailure as failure:
        if failure.iterations == 0:
            raise
        reasons, iterations = [f"Newton's method: {failure}"], failure.iterations
        for rescue in rescues(stationarity).values():
            if seconds_left() < 0:
                break
            try:
                return rescue(stationarity, guess, data, verbose)
            except SolveFailure as another:
                reasons.append(str(another))
                iterations += another.iterations
        raise SolveFailure("; ".join(reasons), failure.unknowns, iterations, failure.singular) from None


def _check_newton(name: str, value: object) -> None:
    if name == "max_iter":
        if (whole(value) or 0) < 1:
            raise ValueError(f"max_iter must be a whole number from 1 on, got {value!r}")
    elif name == "linear_solver":
        if not isinstance(value, str) or not ca.has_linsol(value):
            raise ValueError(f"linear_solver must be one that CasADi has, such as 'qr' or 'csparse', got {value!r}")
    else:
        raise ValueError(f"newton takes the options max_iter and linear_solver, got {name}")


newton = Solver("newton", _newton, _check_newton)
rootfinder = Solver("rootfinder", casadi_rootfinder.casadi_root, casadi_rootfinder.check_option)
ipopt = Solver("ipopt", interior_point.critical_point, interior_point.check_option)
minimizer = Solver("minimizer", interior_point.minimum, interior_point.check_option)


def _no_boundary_problem(*_: object, **__: Any) -> Solution:
    raise ValueError(
        "fatrop and sqp are for a ControlProblem; a BoundaryProblem is solved by newton, rootfinder, ipopt or minimizer"
    )


fatrop = Solver("fatrop", _no_boundary_problem, partial(interior_point.check_option, plugin="fatrop"))
sqp = Solver("sqp", _no_boundary_problem, partial(interior_point.check_option, plugin="sqpmethod"))
