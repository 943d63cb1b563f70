"""``python -m casadi_galerkin``: versions, what CasADi brings to solve with, and a self-test of a second."""

from __future__ import annotations

import argparse
import math
import platform
import sys
import time
from collections.abc import Sequence

import casadi as ca
import matplotlib
import numpy as np

import casadi_galerkin as cg
from casadi_galerkin.calculus.roundoff import EPS

SMALL = EPS**0.5  # relative error up to which a solver passes
PLUGINS = {
    "rootfinder": (ca.has_rootfinder, ("newton", "kinsol")),
    "nlpsol": (ca.has_nlpsol, ("ipopt", "fatrop")),
    "linear solver": (ca.has_linsol, ("ldl", "qr", "csparse", "mumps", "ma27")),
}


def errors() -> dict[str, float]:
    """Relative errors: of an oscillator's action by every solver and step by step; of a move's cost, from rest to rest.

    The move, over a unit of length in a unit of time, costs 6.
    """

    def lagrangian(t: ca.SX, x: ca.SX, v: ca.SX) -> ca.SX:
        return v[0] ** 2 / 2 - x[0] ** 2 / 2

    method, exact = cg.Galerkin(degree=8), 0.5 / math.tan(1)
    problem = cg.BoundaryProblem(lagrangian, (0, 1), [0.0], [1.0])
    start = cg.InitialProblem(lagrangian, (0, 1), [0.0], velocity=[1 / math.sin(1)])
    move = cg.ControlProblem(
        lambda t, x, v: v[0] ** 2 / 2,
        (0, 1),
        [0.0],
        [1.0],
        start_velocity=[0.0],
        end_velocity=[0.0],
        force=lambda t, x, v, u: u,
        running_cost=lambda t, x, v, u: u**2 / 2,
        controls=1,
    )
    found = {s.name: cg.solve(problem, method, 4, solver=s) for s in (cg.newton, cg.rootfinder, cg.ipopt, cg.minimizer)}
    found |= {"to a tolerance": cg.solve(problem, tol=1e-12), "step by step": cg.solve(start, method, 4)}
    missed = {name: abs(path.action / exact - 1) for name, path in found.items()}
    return missed | {"optimal control": abs(cg.solve(move, cg.Galerkin(degree=3), 4).cost / 6 - 1)}


def main(arguments: Sequence[str]) -> int:
    """Print all; returns 0 if every test passed."""
    argparse.ArgumentParser(
        "python -m casadi_galerkin",
        description="Print versions and what CasADi brings to solve with, then solve a problem of known solution with "
        "each solver, which takes a second. The exit status is 0 if all are right.",
    ).parse_args(arguments)
    print(f"casadi_galerkin {cg.__version__}, Python {platform.python_version()}, {platform.platform()}")
    print(f"CasADi {ca.__version__}, NumPy {np.__version__}, Matplotlib {matplotlib.__version__}")
    for kind, (has, names) in PLUGINS.items():
        print(f"{kind + ':':16} " + ", ".join(name if has(name) else f"no {name}" for name in names))
    began = time.perf_counter()
    found = errors()
    for name, error in found.items():
        print(f"{name + ':':16} {'passed' if error <= SMALL else 'FAILED'}, relative error {error:.0e}")
    print(f"{len(found)} tests in {time.perf_counter() - began:.2f} s")
    return int(not all(error <= SMALL for error in found.values()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
