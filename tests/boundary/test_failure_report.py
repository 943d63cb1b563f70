"""A solve that fails says where, why and what to try, and prints nothing."""

import casadi as ca
import pytest
from scenes import bratu, catenoid, kepler

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


@pytest.mark.parametrize("engine", [cg.newton, cg.rootfinder, cg.ipopt])
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
