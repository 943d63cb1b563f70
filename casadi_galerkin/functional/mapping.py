"""Maps of a pointwise Function over many points, in a graph or on arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.functional.buffers import Evaluator
from casadi_galerkin.functional.numbering import CACHE_SIZE
from casadi_galerkin.problems.callables import calls_functions, replayed

PointMap: TypeAlias = Callable[[ca.Function, int, tuple[int, ...]], ca.Function]

# points in a row; rows are 1.5 to 4 times faster from 24 points on, and these values still fit in the cache
POINTS_IN_A_ROW = 400


@lru_cache(4 * CACHE_SIZE)
def one_by_one(f: ca.Function, count: int, shared: tuple[int, ...]) -> ca.Function:
    """Map a Function over `count` points; inputs in `shared` are the same at all of them."""
    return f.map(f.name(), "serial", count, list(shared), [])


@lru_cache(4 * CACHE_SIZE)
def by_rows(f: ca.Function, count: int, shared: tuple[int, ...]) -> ca.Function:
    """Map an SX Function over points by evaluating each of its instructions for a row of points at once.

    Dispatching an instruction takes CasADi 3 ns, computing it less than one.  The points that do not fill a row, fewer
    than there are rows, are evaluated one by one.
    """
    if calls_functions(f):
        return one_by_one(f, count, shared)
    rows = -(-count // POINTS_IN_A_ROW)
    size = count // rows
    whole = one_by_one(_row(f, size, shared), rows, shared) if rows > 1 else _row(f, size, shared)
    rest = count - rows * size
    if rest == 0:
        return whole
    inputs = _inputs(f, count, shared)
    parts = [[a] * 2 if i in shared else ca.horzsplit(a, [0, count - rest, count]) for i, a in enumerate(inputs)]
    first, last = zip(*parts, strict=True)
    results = zip(whole.call(first), one_by_one(f, rest, shared).call(last), strict=True)
    return ca.Function(f.name(), inputs, [ca.horzcat(*pair) for pair in results], f.name_in(), f.name_out())


def _inputs(f: ca.Function, count: int, shared: tuple[int, ...]) -> list[ca.MX]:
    return [ca.MX.sym(f.name_in(i), f.size1_in(i), 1 if i in shared else count) for i in range(f.n_in())]


def _row(f: ca.Function, count: int, shared: tuple[int, ...]) -> ca.Function:
    """All points of an SX Function at once: its instructions, applied to rows instead of numbers."""
    inputs = _inputs(f, count, shared)
    results = replayed(f, ca.MX, [ca.vertsplit(a) for a in inputs])
    rows = [[a if a.size2() == count else ca.repmat(a, 1, count) for a in entries] for entries in results]
    return ca.Function(f.name(), inputs, [ca.vertcat(*entries) for entries in rows], f.name_in(), f.name_out())


def at_places(f: ca.Function, *given: np.ndarray, shared: Sequence[ArrayLike] = ()) -> list[np.ndarray]:
    """Outputs of a Function, dense columns, at K places, (rows, K) each; the last of its inputs are `shared` by all.

    The other inputs are (rows, K), or (K,) of a scalar.  A call on CasADi's own arrays takes two to four times as long
    at hundreds of places.
    """
    count, last = given[0].shape[-1], tuple(range(len(given), len(given) + len(shared)))
    values = Evaluator(one_by_one(f, count, last))(*(a.ravel(order="F") for a in given), *shared)
    return [value.reshape(count, -1).T for value in values]
