"""Several starts of an optimization: which optimum is returned, and what is told of the others."""

import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator, plane

import casadi_galerkin as cg
from casadi_galerkin.control import control_refinement

CENTER, RADIUS = 0.05, 0.25  # of a disc beside the straight line, which is cheaper to pass below


def round_a_disc(**changes):
    outside = (lambda t, x, v, u: (x[0] - 0.5) ** 2 + (x[1] - CENTER) ** 2), RADIUS**2, np.inf
    return plane(**{"t_span": (0, 1), "path_constraint": outside, **changes})


METHOD = cg.Galerkin(4, quadrature=cg.lobatto(5))
BELOW, ABOVE = (6 + 96 * (RADIUS + side * CENTER) ** 2 for side in (-1, 1))


def above(t):
    """Guess."""
    return [t, 0.4 * np.sin(np.pi * t)]


@pytest.mark.slow
def test_the_cheapest_optimum_is_returned_and_the_others_are_told():
    one, several = (cg.solve(round_a_disc(), METHOD, 20, guess=above, starts=starts) for starts in (1, 6))
    assert one.cost == pytest.approx(ABOVE, rel=1e-5)  # the disc holds at points only
    assert several.cost == pytest.approx(BELOW, rel=1e-9)
    assert f"best of 6 starts, which met 2 optima, with costs up to {ABOVE:g}" in several.solver
    assert several.iterations > one.iterations


@pytest.mark.slow
def test_the_first_start_is_the_guess_and_the_others_are_always_the_same():
    first, second = (cg.solve(round_a_disc(), METHOD, 10, guess=above, starts=3) for _ in range(2))
    assert first.iterations == second.iterations
    np.testing.assert_array_equal(first.polynomial.values, second.polynomial.values)


@pytest.mark.slow
def test_the_best_is_refined_to_the_tolerance():
    path = cg.solve(round_a_disc(), METHOD, 4, tol=1e-4, guess=above, starts=6)
    assert path.cost == pytest.approx(BELOW, rel=1e-4)
    assert path.error_estimate <= 1e-4
    assert "best of 6 starts, which met 2 optima" in path.solver


def test_where_the_best_start_is_not_refined_the_next_one_is(monkeypatch):
    """What is cheapest on the first mesh need not exist on a finer one."""
    path, seen = cg.solve(round_a_disc(), METHOD, 4), []
    optima = [replace(path, cost=cost) for cost in (1.0, 1.3, 1.5)]

    def refined(self, level):
        seen.append(level.cost)
        if level.cost == 1.0:
            raise cg.ConvergenceError("made to fail")
        return level

    monkeypatch.setattr(control_refinement, "optima_of", lambda *arguments: (optima, "; all of them"))
    monkeypatch.setattr(control_refinement.ControlRefinement, "refined", refined)
    best = cg.solve(round_a_disc(), METHOD, 4, tol=1e-3, starts=3)
    assert seen == [1.0, 1.3]
    assert best.cost == 1.3
    assert best.solver.endswith("; all of them")


def test_where_all_starts_fail_the_first_tells_why():
    with pytest.raises(cg.ConvergenceError, match="IPOPT stopped with 'Maximum Iterations Exceeded' after 3 iterat"):
        cg.solve(round_a_disc(), METHOD, 20, starts=3, solver=cg.ipopt.with_options(max_iter=3))


def test_a_random_path_where_a_callable_is_not_finite_fails_and_a_guess_there_is_refused():
    uphill = {"running_cost": lambda t, x, v, u: u[0] ** 2 / 2 + ca.sqrt(x[0]), "end": [2.0]}
    path = cg.solve(double_integrator(start=[0.2], **uphill), cg.Galerkin(3), 6, starts=8)
    assert re.search("[1-7] of them failed, most often: running_cost is not finite at the guess", path.solver)
    with pytest.raises(ValueError, match="running_cost is not finite at the guess"):
        cg.solve(double_integrator(start=[-1.0], **uphill), cg.Galerkin(3), 6, starts=4)


@pytest.mark.slow
def test_the_time_limit_holds_for_all_starts_together():
    path = cg.solve(round_a_disc(), METHOD, 4, starts=10**6, limits=cg.Limits(seconds=1))
    assert int(re.search(r"best of (\d+) starts?", path.solver)[1]) < 10**6


def test_what_rounding_leaves_of_a_cost_of_zero_is_one_optimum():
    path = cg.solve(double_integrator(end=[0.0]), cg.Galerkin(3), 6, starts=4)
    assert "met one optimum" in path.solver


@pytest.mark.parametrize(
    ("starts", "kind", "message"),
    [(0, ValueError, "starts must be at least 1, got 0"), (1.5, TypeError, "starts must")],
)
def test_a_wrong_number_of_starts_is_refused(starts, kind, message):
    with pytest.raises(kind, match=message):
        cg.solve(round_a_disc(), METHOD, 10, starts=starts)


def test_starts_are_for_control_problems():
    swing = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2, (0, 1), [0], [1])
    with pytest.raises(ValueError, match=r"starts is for a ControlProblem, got .*; `paths` finds several"):
        cg.solve(swing, cg.Galerkin(3), 4, starts=3)
