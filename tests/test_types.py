"""A type checker knows which answer belongs to which problem."""

import importlib.util
import re
import subprocess
import sys

import pytest
from paths import ROOT

CODE = """\
import casadi_galerkin as cg

def optimized(problem: cg.ControlProblem) -> float:
    return cg.solve(problem, cg.Galerkin(3), 4).cost

def optimized_often(problem: cg.ControlProblem) -> float:
    return cg.transcribe(problem, cg.Galerkin(3), 4).solve(start=[0.1], guess=(lambda t: [t], lambda t: [0.0])).cost

def warm(problem: cg.ControlProblem, last: cg.ControlTrajectory) -> cg.ControlTrajectory:
    return cg.solve(problem, cg.Galerkin(3), 4, guess=last)

def found(problem: cg.BoundaryProblem) -> float:
    return cg.solve(problem, cg.Galerkin(3), 4).action

def stepped(problem: cg.InitialProblem) -> float:
    return cg.solve(problem, cg.Galerkin(3), 4).action

def with_options(problem: cg.BoundaryProblem) -> cg.Trajectory:
    return cg.solve(problem, tol=1e-6, solver=cg.newton.with_options(max_iter=9))
"""
REFUSED = """
def wrong(problem: cg.BoundaryProblem) -> float:
    return cg.solve(problem, cg.Galerkin(3), 4).cost  # refused

def wrong_often(problem: cg.BoundaryProblem) -> float:
    return cg.transcribe(problem, cg.Galerkin(3), 4).solve().cost  # refused

def wrong_steps(problem: cg.InitialProblem) -> float:
    return cg.solve(problem, cg.Galerkin(3), 4).cost  # refused

def no_problem() -> None:
    cg.solve("problem", cg.Galerkin(3), 4)  # refused
"""


@pytest.mark.skipif(importlib.util.find_spec("mypy") is None, reason="mypy is not installed")
def test_mypy_accepts_the_cost_of_a_control_problem_and_refuses_that_of_a_boundary_problem(tmp_path):
    file = tmp_path / "use.py"
    file.write_text(CODE + REFUSED, encoding="utf-8")
    config, cache = str(ROOT / "pyproject.toml"), str(tmp_path / "cache")
    options = ["--follow-imports=silent", "--no-error-summary", "--config-file", config, "--cache-dir", cache]
    run = subprocess.run(
        [sys.executable, "-m", "mypy", *options, str(file)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
    )
    lines = (CODE + REFUSED).splitlines()
    expected = [number for number, line in enumerate(lines, 1) if line.endswith("# refused")]
    found = {int(number) for number in re.findall(r"use\.py:(\d+): error", run.stdout)}
    assert sorted(found) == expected, run.stdout + run.stderr
    assert run.stdout.count('"Trajectory" has no attribute "cost"') == 3
