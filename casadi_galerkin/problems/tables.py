"""Tables of data as splines that callables may call, and whether a path stays within their grids.

Beyond its grid a spline of CasADi is zero, without a word.  Here arguments are held at the nearest edge, so that a
solver that looks beyond on its way comes back, and an answer that is beyond is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.numbers import numbers, real_array
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial, sampling_parts
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.problems.callables import calls_functions

OUTSIDE = "outside"  # the output of a table by which it is told from other Functions


def table(values: ArrayLike, *grids: Sequence[float], linear: bool = False) -> Callable[..., Any]:
    """Make a function of values on a grid, to be called in Lagrangians, forces, rates, costs and constraints.

    Parameters
    ----------
    values : (n_1, ..., n_k), at all points of the grid
    grids : k sequences of n_1 to n_k increasing numbers, the places along every axis, at least four for splines
    linear : True for straight lines between places in place of cubic splines (not-a-knot), which have two derivatives.
        Of a table of time, name the places as `breakpoints` then

    Returns
    -------
    a callable of k scalars.  Beyond the grid it goes on as at the edge; an answer that comes there is refused

    Raises
    ------
    ValueError
        naming what came and what was expected

    Examples
    --------
    >>> wind = table([0.0, 1.0, 4.0, 9.0, 16.0], [0.0, 1.0, 2.0, 3.0, 4.0])
    >>> round(float(wind(1.5)), 12), round(float(wind(7.0)), 12)
    (2.25, 16.0)
    """
    axes, array = [np.array(numbers(f"grid {k}", grid)) for k, grid in enumerate(grids)], real_array("values", values)
    shape, least = tuple(map(len, axes)), 2 if linear else 4
    if not axes or array.shape != shape:
        raise ValueError(f"values must have the shape of their grids, {shape}, got {array.shape}")
    for k, axis in enumerate(axes):
        if len(axis) < least or not np.all(np.diff(axis) > 0):
            raise ValueError(f"grid {k} must be at least {least} increasing numbers, got {axis.tolist()}")
    spline = ca.interpolant("spline", "linear" if linear else "bspline", [*map(list, axes)], array.ravel(order="F"))
    at = [ca.MX.sym(f"x{k}") for k in range(len(axes))]
    held = [ca.fmin(ca.fmax(x, axis[0]), axis[-1]) for x, axis in zip(at, axes, strict=True)]
    beyond = [ca.fabs(x - inside) / np.ptp(axis) for x, inside, axis in zip(at, held, axes, strict=True)]
    outputs = [spline(ca.vertcat(*held)), ca.mmax(ca.vertcat(*beyond))]
    function = ca.Function("table", at, outputs, [x.name() for x in at], ["value", OUTSIDE], {"never_inline": True})
    return lambda *places: function(*places)[0]


@lru_cache(64)
def beyond_tables(function: ca.Function) -> ca.Function | None:
    """How far arguments of the tables that a Function calls are beyond their grids, over these; None without any."""
    if not calls_functions(function):
        return None
    symbols = function.sx_in()
    left, seen, beyond = list(ca.vertsplit(ca.vertcat(*map(ca.vec, function.call(symbols))))), set[int](), list[ca.SX]()
    while left:
        node = left.pop()
        if node.element_hash() in seen or node.is_leaf():
            continue
        seen.add(node.element_hash())
        arguments = [node.dep(i) for i in range(node.n_dep())]
        left += arguments
        if node.is_call() and OUTSIDE in node.which_function().name_out():
            beyond.append(node.which_function()(*arguments)[1])
    return ca.Function("beyond", symbols, [ca.mmax(ca.vertcat(*beyond))]) if beyond else None


def off_tables(problem: Any, path: PiecewisePolynomial, control: Any = None) -> str | None:
    """Say where a path, with the controls of a ControlProblem, leaves a table; None if nowhere."""
    functions = [problem.lagrangian, *([problem.force] if control is None else problem.along)]
    called = [(f, beyond) for f in functions if f is not None and (beyond := beyond_tables(f)) is not None]
    if not called:
        return None
    parts = sampling_parts(path.degree)
    t, x, v = path.sampled(parts)
    places = [t[None, :], x, v, *([] if control is None else [control.at(parts)])]
    p = () if problem.parameters is None else (np.repeat(np.vstack(problem.parameters), len(t), axis=1),)
    for function, beyond in called:
        far = np.array(beyond.map(len(t))(*places[: function.n_in() - len(p)], *p)).ravel()
        k = int(np.argmax(far))
        if far[k] > EPS**0.5:
            return (
                f"{function.name()} calls a table beyond its grid near t = {t[k]:.6g}, by {far[k]:.1%} of the grid's "
                "length: bound what it is a table of, or give more of it"
            )
    return None
