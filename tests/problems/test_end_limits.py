"""Path constraints of positions and velocities limit a free end as well, which no quadrature point sees."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator, first_order
from slow import slow

import casadi_galerkin as cg

LIMIT = 0.6
SOLVED = 1e-9  # what the solvers leave of a cost


def rewarded(**changes):
    """From rest, least ∫u²/2 - 3 v(1) at a speed of at most 0.6: a constant force, and the cost 0.18 - 1.8."""
    fields = {
        "end": [None],
        "end_velocity": [None],
        "terminal_cost": lambda t, x, v: -3 * v[0],
        "path_constraint": (lambda t, x, v, u: v, -np.inf, LIMIT),
    }
    return double_integrator(**(fields | changes))


@pytest.mark.parametrize("solver", [cg.ipopt, cg.fatrop])
@pytest.mark.parametrize(
    "options",
    [{"method": cg.Galerkin(3), "intervals": 5}, *slow({"tol": 1e-6}, {"tol": 1e-6, "of": lambda path: path.cost})],
)
def test_a_speed_that_is_rewarded_keeps_to_its_limit(options, solver):
    path = cg.solve(rewarded(), **options, solver=solver)
    assert path.cost == pytest.approx(-1.62, rel=1e-7)
    assert path.end_velocity[0] <= LIMIT + SOLVED


@pytest.mark.slow
def test_a_place_that_is_rewarded_keeps_within_a_disc():
    """A force of constant direction: the cheapest way to the rim of the disc, at (0.3, 0.4)."""
    problem = cg.ControlProblem(
        lambda t, x, v: ca.dot(v, v) / 2,
        (0.0, 1.0),
        [0.0, 0.0],
        [None, None],
        [0.0, 0.0],
        [None, None],
        force=lambda t, x, v, u: u,
        running_cost=lambda t, x, v, u: ca.dot(u, u) / 2,
        controls=2,
        terminal_cost=lambda t, x, v: -6 * x[0] - 8 * x[1],
        path_constraint=(lambda t, x, v, u: ca.sumsqr(x), 0, 0.25),
    )
    path = cg.solve(problem, tol=1e-6)
    np.testing.assert_allclose(path.x[:, -1], [0.3, 0.4], rtol=0, atol=1e-8)
    assert path.cost == pytest.approx(3 / 2 * 0.25 - 5, rel=1e-8)  # 3/2 r² is the least effort to a distance r


@pytest.mark.slow
def test_a_component_that_follows_a_rate_is_limited():
    climbing = first_order(
        t_span=(0.0, 1.0),
        start=[0.0],
        end=[None],
        rates=lambda t, x, v, u: u,
        running_cost=lambda t, x, v, u: u[0] ** 2 / 2,
        terminal_cost=lambda t, x, v: -3 * x[0],
        path_constraint=(lambda t, x, v, u: x, -np.inf, LIMIT),
    )
    assert cg.solve(climbing, tol=1e-6).cost == pytest.approx(0.18 - 1.8, rel=1e-8)


def test_only_inequalities_of_what_is_free_at_the_end_limit_it():
    mixed = rewarded(
        end=[1.0],
        path_constraint=(
            lambda t, x, v, u: ca.vertcat(v, x, v + u, v * t, 2 * v, x * v),
            [-1, -1, -9, -9, 0, -9],
            [1, 1, 9, 9, 0, 9],
        ),
        end_conditions=(lambda x0, v0, x1, v1: v0[0], 0, 2),
    )
    assert mixed.limits_of_ends == [[], [0, 5]]
    function, low, high = mixed.conditions_at_ends
    assert (low, high) == ((0.0, -1.0, -9.0), (2.0, 1.0, 9.0))
    assert np.array(function(0, 0.25, 0.5, 0.75)).ravel().tolist() == [0.25, 0.75, 0.375]
    without = double_integrator()
    assert without.conditions_at_ends is without.end_conditions


@pytest.mark.slow
def test_a_curve_is_kept_to_its_end():
    """Along a parabola the path and the cost are those between ends that are given in full."""

    def held(t, x, v, u):
        return v[1] - 2 * x[0] * v[0]

    riding = {
        "lagrangian": lambda t, x, v: ca.dot(v, v) / 2,
        "start": [0.0, 0.0],
        "start_velocity": [0.0, 0.0],
        "force": lambda t, x, v, u: u,
        "running_cost": lambda t, x, v, u: ca.dot(u, u) / 2,
        "controls": 2,
        "path_constraint": (held, 0, 0),
    }
    whole = double_integrator(**riding, end=[1.0, 1.0], end_velocity=[0.0, 0.0])
    paths = [cg.solve(whole, cg.Galerkin(6), 12)]
    for end in ([1.0, None], [1.0, 1.0]):
        free = double_integrator(**riding, end=end, end_velocity=[0.0, None])
        paths.append(cg.solve(free, cg.Galerkin(6), 12))
    assert [path.cost for path in paths[1:]] == pytest.approx([paths[0].cost] * 2, rel=1e-7)
    np.testing.assert_allclose(paths[1].x, paths[0].x, rtol=0, atol=1e-5)


def test_limits_may_depend_on_parameters():
    limited = rewarded(
        parameters=[LIMIT],
        force=lambda t, x, v, u, p: u,
        running_cost=lambda t, x, v, u, p: u[0] ** 2 / 2,
        terminal_cost=lambda t, x, v, p: -3 * v[0],
        lagrangian=lambda t, x, v, p: v[0] ** 2 / 2,
        path_constraint=(lambda t, x, v, u, p: v - p, -np.inf, 0),
    )
    graph = cg.transcribe(limited, cg.Galerkin(3), 5)
    for limit in (LIMIT, 0.5):
        assert graph.solve(parameters=[limit]).cost == pytest.approx(limit**2 / 2 - 3 * limit, rel=1e-7)


def test_an_answer_is_a_guess_and_states_the_problem_as_it_was():
    path = cg.solve(rewarded(), cg.Galerkin(3), 5)
    assert path.problem.end_conditions[1] == ()
    assert cg.solve(replace(path.problem), cg.Galerkin(3), 5, guess=path).iterations < path.iterations


def test_what_is_given_beyond_the_limit_is_named():
    with pytest.raises(ValueError, match=r"path constraint 0 is 0.7 at the end whatever the controls"):
        rewarded(end_velocity=[0.7])


def root_at_rest(t, x, v, u):
    return ca.norm_2(ca.vertcat(v, 0))


def test_where_end_conditions_speak_of_the_end_nothing_is_added():
    """The speed has no derivative at rest, and the same equation twice has no multipliers."""
    rest = (lambda x0, v0, x1, v1: ca.vertcat(x1 - 1, v1), 0, 0)
    slow = double_integrator(
        end=[None], end_velocity=[None], end_conditions=rest, path_constraint=(root_at_rest, -np.inf, 3.0)
    )
    assert cg.solve(slow, cg.Galerkin(4), 8).cost == pytest.approx(6, rel=1e-8)


@pytest.mark.parametrize("options", [{"method": cg.Galerkin(3), "intervals": 5}, *slow({"tol": 1e-6})])
def test_what_end_conditions_do_not_speak_of_keeps_to_its_limit(options):
    """They give the place, in a strip; the speed is rewarded there, and limited."""
    strip = (lambda x0, v0, x1, v1: x1, 0.2, 0.9)
    path = cg.solve(rewarded(end_conditions=strip), **options)
    assert path.cost == pytest.approx(-1.62, rel=1e-7)
    assert path.x[0, -1] == pytest.approx(0.3, rel=1e-7)  # by a constant force


@pytest.mark.parametrize("intervals", [4, 16])
def test_a_rewarded_speed_at_a_free_start_keeps_to_its_limit(intervals):
    problem = double_integrator(
        t_span=(0, 3),
        start_velocity=None,
        initial_cost=lambda t, x, v: -10 * v[0],
        path_constraint=(lambda t, x, v, u: v, -1, 1),
    )
    assert cg.solve(problem, cg.Galerkin(3), intervals).start_velocity[0] == pytest.approx(1, abs=1e-8)
