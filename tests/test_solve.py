"""The two verbs: which arguments go together, and what is neither problem nor method."""

import numpy as np
import pytest
from control_problems import double_integrator
from motions import start_of
from scenes import BY_NAME, oscillator, oscillator_problem

import casadi_galerkin as cg

METHOD = cg.Galerkin(2)


@pytest.mark.parametrize("given", [{"method": METHOD, "intervals": 2}, {"tol": 1e-6}])
@pytest.mark.parametrize("other", [None, oscillator, {"lagrangian": oscillator}, "problem"])
def test_what_is_no_problem_is_refused(other, given):
    kinds = "a BoundaryProblem or InitialProblem or ControlProblem or Phases"
    with pytest.raises(TypeError, match=f"problem must be {kinds}, got {type(other).__name__}"):
        cg.solve(other, **given)


@pytest.mark.parametrize("given", [{"intervals": 2}, {"tol": 1e-3}], ids=list)
@pytest.mark.parametrize("other", [0, 6, "gauss", cg.Galerkin, cg.gauss(3)])
def test_what_is_no_method_is_refused(other, given):
    with pytest.raises(TypeError, match=r"method must be a Galerkin, such as Galerkin.degree=4., got"):
        cg.solve(oscillator_problem(), other, **given)


@pytest.mark.parametrize("given", [{"method": cg.Galerkin(3), "intervals": 2}, {"tol": 1e-3}], ids=list)
@pytest.mark.parametrize("other", [0, [], "newton", np.zeros(2)], ids=repr)
@pytest.mark.parametrize("problem", [oscillator_problem(), double_integrator()], ids=lambda p: type(p).__name__)
def test_what_is_no_solver_is_refused(problem, other, given):
    with pytest.raises((TypeError, ValueError), match=r"(cg.ipopt or cg.minimizer|cg.fatrop or cg.sqp), got"):
        cg.solve(problem, solver=other, **given)


@pytest.mark.parametrize("name", ["lagrange", "tspan", "ends", "params"])
def test_unknown_names_are_refused(name):
    with pytest.raises(TypeError, match=f"unexpected keyword argument '{name}'"):
        oscillator_problem(**{name: 1})
    with pytest.raises(TypeError, match=f"unexpected keyword argument '{name}'"):
        cg.solve(oscillator_problem(), METHOD, intervals=2, **{name: 1})
    with pytest.raises(TypeError, match=f"unexpected keyword argument '{name}'"):
        cg.Galerkin(2, **{name: 1})


@pytest.mark.parametrize(
    "problem", [BY_NAME["oscillator 1.0"].problem, double_integrator(control_bounds=(-5, 5))], ids=["path", "control"]
)
def test_seconds_limit_a_fixed_discretization_too(problem):
    late, ample = cg.Limits(seconds=1e-9), cg.Limits()
    with pytest.raises(cg.ConvergenceError, match=r"the time was up|WallTime"):
        cg.solve(problem, cg.Galerkin(4), 8, limits=late)
    cg.solve(problem, cg.Galerkin(4), 8, limits=ample)


def test_neither_method_nor_tolerance_is_refused():
    with pytest.raises(TypeError, match="got None; or give tol instead"):
        cg.solve(BY_NAME["oscillator 1.0"].problem)


def test_an_initial_problem_takes_a_method_or_a_tolerance_and_no_guess_or_solver():
    problem = start_of("pendulum", 5)
    for option in ({"guess": lambda t: [0.0]}, {"solver": cg.ipopt}):
        with pytest.raises(ValueError, match=f"step by step, and takes no {min(option)}$"):
            cg.solve(problem, cg.Galerkin(3), intervals=5, **option)
    with pytest.raises(TypeError, match="method must be a Galerkin"):
        cg.solve(problem, 3, intervals=5)
    with pytest.raises(TypeError, match="got None; or give tol instead"):
        cg.solve(problem, intervals=5)
    with pytest.raises(ValueError, match="limits stop a refinement: give tol with them"):
        cg.solve(problem, cg.Galerkin(3), 5, limits=cg.Limits())
    with pytest.raises(ValueError, match="give either intervals or mesh"):
        cg.solve(problem, cg.Galerkin(3))


@pytest.mark.parametrize("verbose", ["x", 3, -1, None, 1.5])
@pytest.mark.parametrize(
    "solve",
    [
        lambda verbose: cg.solve(oscillator_problem(), METHOD, 2, verbose=verbose),
        lambda verbose: cg.solve(oscillator_problem(), tol=1e-3, verbose=verbose),
        lambda verbose: cg.solve(start_of("pendulum", 5), METHOD, 2, verbose=verbose),
        lambda verbose: cg.solve(double_integrator(), METHOD, 2, verbose=verbose),
        lambda verbose: cg.solve(double_integrator(), tol=1e-3, verbose=verbose),
        lambda verbose: cg.transcribe(oscillator_problem(), METHOD, 2).solve(verbose=verbose),
        lambda verbose: cg.transcribe(oscillator_problem(), tol=1e-3).solve(verbose=verbose),
        lambda verbose: cg.transcribe(double_integrator(), METHOD, 2).solve(verbose=verbose),
    ],
)
def test_what_tells_not_how_much_to_print_is_refused(solve, verbose):
    with pytest.raises(ValueError, match=f"verbose must be 0, 1 or 2, got {verbose!r}"):
        solve(verbose)
