"""One Newton iteration as one C function, compiled for a Lagrangian, a degree and a number of quadrature points.

`iteration.c` passes over the intervals once: it embeds, evaluates pointwise, integrates, and eliminates the control
values and then the joint of each; a pass back finds the step.  Intervals go through it several at once, each in a
lane of a vector, so everything within one is as fast for one component as for many.  No matrix is stored but the
factors, as far as the way back needs them.

The factorisation is LDLᵀ without pivoting.  Its defect is found without the Hessian, which is never assembled: from
the second derivatives at the points, as ∇²S y = Eᵀ blockdiag(·) E y.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping

import numpy as np

from casadi_galerkin.algebra import LOCAL
from casadi_galerkin.functional import Pointwise
from casadi_galerkin.kernel import library, translatable
from casadi_galerkin.layout import Layout
from casadi_galerkin.stages import Call, Workspace

MOST_LANES = 8
MOST_COMPONENTS = 10  # of a sparse L: a chain of 6 takes 0.2 to 0.8 times as long as in CasADi, one of 20 up to 1.1
FEWEST_INTERVALS = 4  # with fewer, lanes are empty: 6 components of degree 12 took 1.8 times as long on one interval
INTEGERS = "intervals", "unknowns", "shift"
POINTERS = (
    *("first", "last", "points", "values", "slopes", "by_x", "by_slope", "weights", "products"),
    *("factors", "derivatives", "joints"),
    *("u", "mesh", "p", "probe", "rhs", "gradient", "step", "soft", "solution", "excess"),
)


class _Bound(ctypes.Structure):
    """`struct iteration`."""

    _fields_ = [
        *((name, ctypes.c_long) for name in INTEGERS),
        ("missed", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in POINTERS),
    ]


def _aligned(size: int) -> np.ndarray:
    """Zeros that begin where a vector may."""
    array = np.zeros(size + MOST_LANES)
    skipped = -(array.ctypes.data // 8) % MOST_LANES
    return array[skipped : skipped + size]


class CompiledIteration:
    """A Newton iteration for one layout, and solutions with its factors; one thread at a time.

    Parameters
    ----------
    pointwise : Pointwise
    layout : Layout; what `takes` accepts
    arrays : arrays for inputs and outputs by name, those of `arrays` below; others are allocated

    Attributes
    ----------
    arrays : by name; inputs u (size), mesh (N + 1), p (as many as there are parameters), probe (free), rhs (free);
        outputs gradient, step, soft, solution (free) and excess (1)

    Raises
    ------
    ValueError
        if there is no C compiler, layout or Lagrangian are not what it `takes`, or an array has the wrong size
    """

    def __init__(self, pointwise: Pointwise, layout: Layout, arrays: Mapping[str, np.ndarray] | None = None) -> None:
        if not takes(pointwise, layout):
            raise ValueError(
                "a compiled iteration needs ends that are not joined, a kinetic energy of every component, "
                "and operations that C knows"
            )
        method, free = layout.method, layout.free
        self._library = library(pointwise, method.degree, len(method.quadrature))
        lanes = ctypes.c_int.in_dll(self._library, "lanes_at_once").value
        inputs = {
            "u": layout.size,
            "mesh": layout.intervals + 1,
            "p": _parameters(pointwise),
            "probe": free,
            "rhs": free,
        }
        sizes = inputs | dict.fromkeys(("gradient", "step", "soft", "solution"), free) | {"excess": 1}
        given = arrays or {}
        self.arrays = {name: given[name] if name in given else np.zeros(size) for name, size in sizes.items()}
        for name, size in sizes.items():
            array = self.arrays[name]
            if array.shape != (size,) or array.dtype != float or not array.flags.c_contiguous:
                raise ValueError(f"{name} must be {size} contiguous doubles, got {array.dtype} of {array.shape}")
        self._kept = {**self.arrays, **_tables(pointwise, layout), **_memory(pointwise, layout, lanes)}
        numbers = (layout.intervals, free, len(layout.fixed_start))
        self._bound = _Bound(*numbers, LOCAL, *(self._kept[name].ctypes.data for name in POINTERS))
        self._address = ctypes.addressof(self._bound)

    @property
    def stages(self) -> dict[str, Call]:
        """Its two calls as stages of chains."""
        parameters = [self.arrays["p"]] if self.arrays["p"].size else []
        return {"iterate": Call(self.run, parameters), "resolve": Call(self.resolve, [])}

    def run(self) -> None:
        """From u, mesh, p and probe: gradient ∇S, step -∇²S⁻¹∇S, soft -∇²S⁻¹ probe, and excess.

        The last is ‖∇²S step + ∇S‖₁ - LOCAL ‖∇S‖₁, as in `Algebra`: the step is right if it is at most zero.
        """
        self._library.run(self._address)

    def resolve(self) -> None:
        """From rhs: solution -∇²S⁻¹ rhs with the factors of the last run, and its excess."""
        self._library.resolve(self._address)


def compiled_stages(pointwise: Pointwise, layout: Layout, workspace: Workspace) -> dict[str, Call]:
    """The stages of a compiled iteration that works on the arrays of a workspace.

    - iterate : (u, mesh, leaning) -> (gradient, step, soft, excess)
    - resolve : gradient -> (simplified, excess), with the factors of the last `iterate`
    """
    names = {"probe": "leaning", "rhs": "gradient", "solution": "simplified"}
    sizes = {"u": layout.size, "mesh": layout.intervals + 1, "excess": 1}
    own = "gradient", "step", "soft", *names
    arrays = {name: workspace.array(names.get(name, name), sizes.get(name, layout.free)) for name in (*sizes, *own)}
    return CompiledIteration(pointwise, layout, arrays).stages


def _parameters(pointwise: Pointwise) -> int:
    f = pointwise.derivatives
    return int(f.size1_in(4)) if f.n_in() > 4 else 0


def _tables(pointwise: Pointwise, layout: Layout) -> dict[str, np.ndarray]:
    """Numbers of the joints at both ends, and the reference element with its nodes in the order of the kernel."""
    element, m = layout.method.element, layout.method.degree
    order = [*range(1, m), 0, m]
    basis = [np.ascontiguousarray(table[:, order]) for table in (element.values, element.slopes)]
    a, b = np.tril_indices(m + 1)
    pairs = [element.weights[:, None] * basis[i][:, a] * basis[j][:, b] for i, j in pointwise.blocks]
    numbering = layout.numbering.astype(np.dtype("long"))
    weights = element.weights[:, None]
    return {
        "first": numbering[0].copy(),
        "last": numbering[-1].copy(),
        "points": np.array(element.points),
        "values": basis[0],
        "slopes": basis[1],
        "by_x": weights * basis[0],
        "by_slope": weights * basis[1],
        "weights": np.array(element.weights),
        "products": np.ascontiguousarray(np.stack(pairs, axis=-1).transpose(1, 0, 2)),
    }


def _memory(pointwise: Pointwise, layout: Layout, lanes: int) -> dict[str, np.ndarray]:
    """Room for the factors and the second derivatives, by the sizes in `iteration.c`."""
    n, d, m = layout.intervals, layout.dimension, layout.method.degree
    groups, rows = -(-n // lanes), (m + 1) * d + 2
    derivatives = len(layout.method.quadrature) * len(pointwise.blocks) * pointwise.stored.nnz()
    return {
        "factors": _aligned((groups * _packed((m - 1) * d, rows) + _packed(2 * d, 2 * d + 2)) * lanes),
        "derivatives": _aligned(groups * derivatives * lanes),
        "joints": np.zeros((n + 1) * _packed(d, 2 * d + 2)),
    }


def _packed(columns: int, rows: int) -> int:
    """Numbers in the first columns of a lower triangle."""
    return columns * rows - columns * (columns - 1) // 2


def takes(pointwise: Pointwise, layout: Layout) -> bool:
    """Whether a compiled iteration is possible.

    The path must not be periodic, every component must have a kinetic energy, as for LDLᵀ without pivoting, and C must
    know all operations of the Lagrangian.  Any degree, quadrature, mesh, parameters and ends will do.
    """
    return not layout.periodic and pointwise.kinetic and translatable(pointwise.derivatives)


def suits(pointwise: Pointwise, layout: Layout) -> bool:
    """Whether a compiled iteration is possible, and faster than one by stages."""
    dense = layout.dimension <= MOST_COMPONENTS or pointwise.pattern.is_dense()
    return dense and layout.intervals >= FEWEST_INTERVALS and takes(pointwise, layout)
