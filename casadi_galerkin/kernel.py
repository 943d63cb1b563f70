"""C for a Newton iteration: `iteration.c` with the instructions of a Lagrangian, compiled and loaded.

Arithmetic is done for all lanes of a vector at once, other functions for one after the other.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path

import casadi as ca

from casadi_galerkin.functional import Pointwise
from casadi_galerkin.layout import LAYOUTS_KEPT
from casadi_galerkin.mapping import compiler
from casadi_galerkin.operators import cell

OPTIMISED = "-O2", "-fpeel-loops", "-march=native", "-fno-math-errno", "-fno-trapping-math"  # -O3 only takes longer
SHARED = "-std=gnu99", "-fPIC", "-shared"
ARITHMETIC = {ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_NEG, ca.OP_SQ, ca.OP_TWICE, ca.OP_INV}  # for all lanes
WITHOUT_C = {ca.OP_CALL, ca.OP_ERFINV, ca.OP_PRINTME}
PREAMBLE = """#include <math.h>
#ifdef __AVX512F__ /* one vector; with two of AVX, eight intervals were measured up to 4 times as slow as four */
#define W 8
#else
#define W 4
#endif
typedef double lanes __attribute__((vector_size(8 * W)));
#define sq(a) ((a) * (a))
static inline double sign(double a) { return a < 0 ? -1 : a > 0 ? 1 : a; }
static inline void pointwise(const lanes *t, const lanes *h, const lanes *x, const lanes *slope, const double *p,
                             lanes *fx, lanes *fv, lanes *derivatives) {
"""


def _pointwise(f: ca.Function, stored: int) -> str:
    """C for the instructions of `Pointwise.derivatives`, each for all lanes."""
    lines = [f"lanes {', '.join(f'w{i}' for i in range(f.sz_w()))};"]
    for k in range(f.n_instructions()):
        operation, source, target = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            name, place = f.name_out(target[0]), target[1]
            if target[0] > 2:  # after f, fx and fv the blocks, one behind the other
                name, place = "derivatives", place + stored * (target[0] - 3)
            if name != "f":
                lines.append(f"{name}[{place}] = w{source[0]};")
        elif operation == ca.OP_INPUT:
            spread = " - (lanes){0}" if f.name_in(source[0]) == "p" else ""
            lines.append(f"w{target[0]} = {f.name_in(source[0])}[{source[1]}]{spread};")
        elif operation == ca.OP_CONST:
            value = repr(f.instruction_constant(k)).replace("inf", "INFINITY").replace("nan", "NAN")
            lines.append(f"w{target[0]} = {value} - (lanes){{0}};")
        else:
            lines.append(_operation(operation, source, f"w{target[0]}"))
    return "\n".join(lines)


def _operation(operation: int, source: list[int], target: str) -> str:
    """C for one operation, as CasADi writes it."""
    at_once = operation in ARITHMETIC
    names = [f"w{i}" if at_once else f"w{i}[lane]" for i in source]
    symbols = [ca.SX.sym(name) for name in names]
    value = ca.SX.unary(operation, *symbols) if len(symbols) == 1 else ca.SX.binary(operation, *symbols)
    return f"{target} = {value};" if at_once else f"for (int lane = 0; lane < W; lane++) {target}[lane] = {value};"


def _source(pointwise: Pointwise, degree: int, points: int) -> str:
    """All of the translation unit."""
    stored = pointwise.stored
    row, column, place, _ = (index.tolist() for index in cell(tuple(stored.colind()), tuple(stored.row())))
    sizes = {"D": stored.size1(), "M": degree, "R": points}
    sizes |= {"BLOCKS": len(pointwise.blocks), "NONZEROS": len(row), "STORED": stored.nnz()}
    block_rows, block_columns = zip(*pointwise.blocks, strict=True)
    tables = {"ROW": row, "COLUMN": column, "PLACE": place, "BLOCK_ROW": block_rows, "BLOCK_COLUMN": block_columns}
    constants = [f"#define {name} {value}" for name, value in sizes.items()]
    constants += [f"static const int {name}[] = {{{', '.join(map(str, table))}}};" for name, table in tables.items()]
    function = PREAMBLE + _pointwise(pointwise.derivatives, stored.nnz()) + "\n}\n"
    kernel = Path(__file__).with_name("iteration.c").read_text(encoding="utf-8")
    return "\n".join(constants) + "\n" + function + kernel


@lru_cache(LAYOUTS_KEPT)
def library(pointwise: Pointwise, degree: int, points: int) -> ctypes.CDLL:
    """Compile and load; for any number of intervals, whatever is given at the ends."""
    with tempfile.TemporaryDirectory() as directory:
        source, target = Path(directory, "iteration.c"), Path(directory, "iteration.so")
        source.write_text(_source(pointwise, degree, points), encoding="utf-8")
        command = [compiler(), *OPTIMISED, *SHARED, str(source), "-o", str(target), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{' '.join(command)} failed:\n{done.stderr}")
        loaded = ctypes.CDLL(str(target))
    for function in (loaded.run, loaded.resolve):
        function.argtypes, function.restype = [ctypes.c_void_p], None
    return loaded


def translatable(f: ca.Function) -> bool:
    """Whether C knows all instructions of an SX Function."""
    return not any(f.instruction_id(k) in WITHOUT_C for k in range(f.n_instructions()))
