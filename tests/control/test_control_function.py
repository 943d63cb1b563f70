"""An optimization as a Function of its data: the answers of `solve`, NaN for what is not one, C code."""

import os
import shutil
import subprocess

import casadi as ca
import numpy as np
import pytest
from control_problems import NEAR, cartesian_pendulum, double_integrator, pendulum, staged
from slow import slow

import casadi_galerkin as cg

SOLVED = 1e-8  # what a solver leaves of the optimality conditions, amplified by their conditioning


def arguments(problem, path, **changes):
    names = ("start", "end", "start_velocity", "end_velocity")
    given = {name: [v for v in changes.get(name, getattr(problem, name)) if v is not None] for name in names}
    guess = {"guess": path.polynomial.values, "controls": path.control.values}
    return {name: values for name, values in given.items() if values} | guess


@pytest.mark.parametrize("solver", [cg.ipopt, cg.fatrop], ids=str)
@pytest.mark.parametrize("name", ["bang-bang", *slow("cart-pole", "everything")])
def test_function_of_the_data_is_the_solve(name, solver):
    problem, method, changes = NEAR[name]
    program = cg.transcribe(problem(), method, 10)
    first = program.solve()
    path = program.solve(**changes, guess=first)
    f = cg.solution_function(problem(), method, 10, solver=solver)
    found = f(**arguments(problem(), first, **changes))
    assert float(found["cost"]) == pytest.approx(path.cost, rel=SOLVED)
    np.testing.assert_allclose(np.array(found["x"]), path.x, rtol=0, atol=SOLVED)
    np.testing.assert_allclose(np.array(found["u"]), path.control.values, rtol=0, atol=1e-6)
    assert float(found["duration"]) == pytest.approx(np.ptp(path.t), rel=SOLVED)


@pytest.mark.parametrize("solver", [cg.ipopt, cg.fatrop], ids=str)
def test_what_is_no_answer_is_not_a_number(solver):
    problem = double_integrator(control_bounds=(-10, 10))
    f = cg.solution_function(problem, cg.Galerkin(3), 6, solver=solver)
    path = cg.solve(problem, cg.Galerkin(3), 6)
    near, far = (f(**arguments(problem, path, end=[end])) for end in (0.5, 50.0))
    assert float(near["cost"]) == pytest.approx(1.5, rel=SOLVED)
    assert all(np.isnan(np.array(far[name])).all() for name in ("x", "u", "cost", "duration"))
    for value in (np.nan, np.inf):
        assert np.isnan(float(f(**arguments(problem, path, end=[value]))["cost"]))


def test_without_a_given_value_there_is_no_answer():
    problem = double_integrator()
    f, path = cg.solution_function(problem, cg.Galerkin(3), 6), cg.solve(problem, cg.Galerkin(3), 6)
    given = arguments(problem, path)
    assert float(f(**given)["cost"]) == pytest.approx(path.cost, rel=SOLVED)
    for name in set(given) - {"guess", "controls"}:
        assert np.isnan(float(f(**{key: value for key, value in given.items() if key != name})["cost"]))


@pytest.mark.slow
def test_a_guess_that_is_not_a_number_has_no_answer():
    way, method = staged(parameter_bounds=None), cg.Galerkin(3)
    path = cg.solve(way, method, 6)
    f = cg.solution_function(way, method, 6)
    nowhere = np.full_like(path.polynomial.values, np.nan)
    found = f(**arguments(way, path) | {"parameters": way.parameters, "guess": nowhere})
    assert all(np.isnan(np.array(found[name])).all() for name in ("x", "u", "cost", "duration"))


@pytest.mark.parametrize("solver", [cg.ipopt, cg.fatrop], ids=str)
@pytest.mark.slow
def test_ends_beyond_the_bounds_of_positions_have_no_answer(solver):
    problem = double_integrator(position_bounds=(-1.0, 2.0))
    f, path = cg.solution_function(problem, cg.Galerkin(3), 6, solver=solver), cg.solve(problem, cg.Galerkin(3), 6)
    assert float(f(**arguments(problem, path, end=[2.0]))["cost"]) == pytest.approx(24, rel=SOLVED)
    for off in ({"end": [2.5]}, {"start": [-1.5]}):
        assert np.isnan(float(f(**arguments(problem, path, **off))["cost"]))


@pytest.mark.slow
def test_ends_off_the_constraint_have_no_answer():
    rod = cartesian_pendulum(end=[1.0, 0.0])
    path = cg.solve(rod, cg.Galerkin(4), 8, guess=lambda t: [np.sin(np.pi * t / 6), -np.cos(np.pi * t / 6)])
    f = cg.solution_function(rod, cg.Galerkin(4), 8, guess=path)
    assert float(f(**arguments(rod, path))["cost"]) == pytest.approx(path.cost, rel=SOLVED)
    for off in ({"end": [0.0, -2.0]}, {"start": [0.0, -1.1]}, {"start_velocity": [0.0, 0.3]}, {"end_velocity": [1, 0]}):
        assert np.isnan(float(f(**arguments(rod, path, **off))["cost"]))


def test_parameters_are_data():
    problem = double_integrator(
        lagrangian=lambda t, x, v, p: p[0] * v[0] ** 2 / 2,
        force=lambda t, x, v, u, p: u,
        running_cost=lambda t, x, v, u, p: u[0] ** 2 / 2,
        parameters=[1.0],
    )
    path = cg.solve(problem, cg.Galerkin(3), 4)
    f = cg.solution_function(problem, cg.Galerkin(3), 4)
    assert float(f(**arguments(problem, path), parameters=[2.0])["cost"]) == pytest.approx(24, rel=1e-10)


def test_c_code_of_a_function_gives_its_answers(tmp_path, monkeypatch):
    compiler, folder = shutil.which("cc"), os.path.dirname(ca.__file__)
    if compiler is None:
        pytest.skip("no C compiler here")
    monkeypatch.chdir(tmp_path)
    f = cg.solution_function(pendulum(3.0), cg.Galerkin(4), 10, solver=cg.fatrop)
    f.generate("solution.c")
    libraries = ["-I", f"{folder}/include", "-L", folder, "-lfatrop", "-lblasfeo", f"-Wl,-rpath,{folder}"]
    subprocess.run([compiler, "-shared", "-fPIC", "solution.c", "-o", "solution.so", *libraries], check=True)
    path = cg.solve(pendulum(3.0), cg.Galerkin(4), 10)
    given = arguments(pendulum(3.0), path, start=[0.05])
    compiled = ca.external("solution", "./solution.so")(**given)
    assert float(compiled["cost"]) == pytest.approx(float(f(**given)["cost"]), rel=1e-12)


def test_bad_solvers_are_refused():
    with pytest.raises(ValueError, match="solved by cg"):
        cg.solution_function(double_integrator(), cg.Galerkin(3), 4, solver=cg.newton)
    fall = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0], (0, 1), [0.0], [1.0])
    with pytest.raises(ValueError, match=r"CasADi's Newton method, got solver=cg\.ipopt"):
        cg.solution_function(fall, cg.Galerkin(3), 4, solver=cg.ipopt)
