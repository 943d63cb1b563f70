"""A solve that fails says where, why and what to try, and prints nothing."""

import casadi as ca
import numpy as np
import pytest
from scenes import bratu, catenoid, kepler
from slow import slow

import casadi_galerkin as cg


@pytest.mark.parametrize("rate", [3.52, 10.0])
def test_bratu_above_its_critical_value_fails_with_time_and_advice(rate):
    problem = cg.BoundaryProblem(bratu(rate), (0, 1), [0.0], [0.0])
    with pytest.raises(cg.ConvergenceError, match=r"no path was found.*t = [\d.]+.*Try a guess nearer") as caught:
        cg.solve(problem, cg.Galerkin(6), intervals=10)
    error = caught.value
    assert not isinstance(error, cg.ConjugatePointError)
    assert "Newton's method: " in str(error)
    assert "IPOPT on the action stopped with" in str(error)
    assert "there may be no path" in str(error)
    assert error.path.polynomial.values.shape == (1, 61)
    assert error.residual > 50
    assert error.iterations > 0


@pytest.mark.parametrize("half", [0.67, 1.5])
def test_catenoid_above_its_critical_height_fails(half):
    problem = cg.BoundaryProblem(catenoid, (-half, half), [1.0], [1.0])
    with pytest.raises(cg.ConvergenceError, match="no path was found") as caught:
        cg.solve(problem, cg.Galerkin(6), intervals=10)
    assert not isinstance(caught.value, cg.ConjugatePointError)


def test_a_lagrangian_not_finite_at_the_guess_is_named_with_its_time():
    problem = cg.BoundaryProblem(kepler(1.0), (0, 1), [1.0, 0.0], [-1.0, 0.0])
    with pytest.raises(cg.ConvergenceError, match=r"not finite at the guess.*t = 0\.5"):
        cg.solve(problem, cg.Galerkin(2, quadrature=cg.lobatto(3)), intervals=2)


@pytest.mark.parametrize("engine", [cg.newton, cg.rootfinder, cg.ipopt, cg.minimizer])
def test_every_engine_names_a_guess_outside_the_lagrangians_domain(engine):
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - ca.sqrt(x[0] - t), (0, 1), [1.0], [0.5])
    with pytest.raises(cg.ConvergenceError, match=r"not finite at t = 0\.[67].*where x = .* and v = "):
        cg.solve(problem, cg.Galerkin(4), intervals=5, solver=engine)


def under_a_root(start, root):
    """A pull that is a root of x, which is defined for x > 0 alone."""
    return cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + root(x[0]), (0, 1), [start], [0.6])


def root_by_newton(y):
    x, square = ca.MX.sym("x"), ca.MX.sym("square")
    return ca.rootfinder("root", "newton", {"x": x, "p": square, "g": x**2 - square})(1, y)


@pytest.mark.parametrize("engine", [cg.newton, *slow(cg.rootfinder, cg.ipopt)])
@pytest.mark.slow
def test_a_rootfinder_in_the_lagrangian_that_fails_at_the_guess_is_named_with_its_time(engine):
    with pytest.raises(cg.ConvergenceError, match=r"calls a casadi Function that fails at t = 0\.0563508") as caught:
        cg.solve(under_a_root(-0.5, root_by_newton), cg.Galerkin(3), 2, solver=engine)
    assert "rootfinder process failed" in str(caught.value.__cause__)
    assert caught.value.path(0.0) == -0.5


def test_a_rootfinder_in_the_lagrangian_may_fail_on_the_way_to_a_path():
    """At the guess, from which IPOPT leads back into the domain."""
    paths = [
        cg.solve(under_a_root(0.1, root), cg.Galerkin(3), 2, guess=lambda t: [-1.0])
        for root in (ca.sqrt, root_by_newton)
    ]
    assert paths[1].action == pytest.approx(paths[0].action, rel=1e-12)


def test_a_derivative_not_finite_at_a_guess_at_rest_is_no_singular_hessian():
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2, (0, 1), [0.0, 0.0], [0.0, 0.0], force=lambda t, x, v: t - v * ca.norm_2(v)
    )
    where = r"a derivative of the equations of motion is not finite at t = 0\.0.*v = \[0\. 0\.\]"
    with pytest.raises(cg.ConvergenceError, match=f"the Hessian of the action is not finite.*{where}"):
        cg.solve(problem, cg.Galerkin(2), intervals=4)


def test_a_condition_on_the_ends_not_finite_at_the_guess_is_not_laid_to_the_lagrangian():
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2,
        (0, 1),
        [0.0, 0.0],
        [None, None],
        end_conditions=lambda first, last: ca.norm_2(last) - 1,
    )
    with pytest.raises(cg.ConvergenceError, match="a derivative of a constraint, of a condition on the ends"):
        cg.solve(problem, cg.Galerkin(2), intervals=4)


def test_a_path_on_which_the_action_is_not_finite_is_not_returned():
    """The derivative of log(x - t) continues to x < t, where the logarithm itself does not exist."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - ca.log(x[0] - t), (0, 1), [1.0], [0.5])
    with pytest.raises(cg.ConvergenceError, match=r"the Lagrangian is not finite at t = 0\.\d+, where x = "):
        cg.solve(problem, cg.Galerkin(4), intervals=5)


@pytest.mark.parametrize("solver", [cg.newton, cg.rootfinder, cg.ipopt, cg.minimizer], ids=str)
def test_failure_prints_nothing(solver, capfd):
    with pytest.raises(cg.ConvergenceError):
        cg.solve(cg.BoundaryProblem(catenoid, (-1, 1), [1.0], [1.0]), cg.Galerkin(4), 5, solver=solver)
    out, err = capfd.readouterr()
    assert (out, err) == ("", "")


@pytest.mark.slow
def test_terms_beyond_all_numbers_are_reported_without_a_warning():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.exp(ca.exp(x[0])), (0, 1), [2.4], [13.4])
    with pytest.raises(cg.ConvergenceError, match="no path was found"):
        cg.solve(problem, tol=1e-6)


@pytest.mark.parametrize(
    ("start", "end", "energy", "change"),
    [
        (-1.0, 1.0, 0.5, "shrunk"),
        (-1.3, 1.2, 0.3, "grown"),
    ],
)
def test_a_free_duration_that_left_the_doubles_is_named(start, end, energy, change, recwarn):
    """Between the ends there is a hill that is higher than the energy."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - ca.exp(-(x[0] ** 2)), (0, 1), [start], [end], energy=energy
    )
    with pytest.raises(cg.ConvergenceError, match=rf"the duration, which is free, has {change} by a factor of e\^\d+"):
        cg.solve(problem, cg.Galerkin(4), intervals=4, solver=cg.rootfinder)
    assert not recwarn.list


@pytest.mark.slow
def test_a_first_path_whose_duration_shrinks_to_nothing_does_not_keep_others_from_being_found():
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2,
        (-1.3, 0.27),
        [None],
        [-0.41],
        start_velocity=[-0.55],
        energy=13252.0,
    )
    path = cg.solve(problem, tol=1e-8)
    assert path.energy == pytest.approx(13252.0, rel=1e-9)


@pytest.mark.slow
def test_a_path_that_runs_away_along_a_singular_direction_is_refused_without_warnings(recwarn):
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 * (1 + 0.25 * ca.sin(x[0]) ** 2) - x[2],  # nothing holds x[2]
        (0.0, 2 * ca.pi),
        [0.7624525767212539, None, None],
        periodic=True,
        force=lambda t, x, v: -0.2 * v + ca.vertcat(0.4 * ca.cos(t), 0, 0),
    )
    with pytest.raises(cg.ConjugatePointError, match="the Hessian of the action is singular"):
        cg.solve(problem, cg.Galerkin(8), intervals=16, solver=cg.rootfinder)
    assert not recwarn.list


@pytest.mark.slow
def test_warnings_of_casadi_do_not_reach_the_terminal(capfd):
    """A zero pivot shows in the numbers; CasADi's LDL factorization also writes a line for each."""
    with pytest.raises(cg.ConvergenceError, match="no path was found"):
        cg.solve(cg.BoundaryProblem(bratu(20.0), (0, 1), [0.0], [0.0]), tol=1e-6)
    assert capfd.readouterr() == ("", "")


def test_a_path_through_a_place_without_a_lagrangian_ends_a_refinement_at_once():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - ca.log(x[0]), (0, 1), [-1.0], [1.0])
    with pytest.raises(cg.ConvergenceError, match=r"the Lagrangian is not finite at t = 0\.0.*, where x = \[-0\.9"):
        cg.solve(problem, tol=1e-6, limits=cg.Limits(levels=2))


@pytest.mark.slow
def test_a_refinement_may_begin_without_a_free_position():
    """The straight line is the only path of degree 1 on one interval; finer meshes show that there is none."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 3 * x[0] ** 4, (0, 3), [-1.0], [2.0])
    with pytest.raises(cg.ConvergenceError, match="no path was found"):
        cg.solve(problem, cg.Galerkin(1), 1, tol=1e-3)


@pytest.mark.parametrize(
    ("lagrangian", "ends", "match"),
    [
        (lambda t, x, v: v[0] ** 2 / 2, ([None], [None]), r"holds x\[0\]: moved by any amount, .* give it at one end"),
        (
            lambda t, x, v: ca.dot(v, v) / 2 - (x[0] - x[1]) ** 2 - x[2] ** 4,
            ([None, None, 0.0], [None, None, 1.0]),
            r"holds x\[0\] and x\[1\]: moved together by any amount, .* give one of them at one end",
        ),
    ],
    ids=["one", "two of three"],
)
def test_components_that_nothing_holds_are_named(lagrangian, ends, match):
    with pytest.raises(cg.ConjugatePointError, match=match):
        cg.solve(cg.BoundaryProblem(lagrangian, (0, 1), *ends), cg.Galerkin(3), 4)


@pytest.mark.parametrize("duration", [20.0, 60.0])
def test_a_passage_between_two_rests_is_said_to_be_free_in_time(duration):
    well = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 + (x[0] ** 2 - 1) ** 2 / 2, (-duration / 2, duration / 2), [-1.0], [1.0]
    )
    with pytest.raises(cg.ConvergenceError, match=r"rests near both ends for so long .* solve one half of it"):
        cg.solve(well, tol=1e-6)


def test_half_of_a_passage_between_two_rests_is_solved():
    half = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + (x[0] ** 2 - 1) ** 2 / 2, (0, 30), [0.0], [1.0])
    path = cg.solve(half, tol=1e-6)
    assert abs(path(1.0)[0] - np.tanh(1.0)) < 1e-6
