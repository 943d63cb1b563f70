"""Holonomic constraints in control problems: the swing-up of a pendulum in Cartesian coordinates is that in angles."""

import casadi as ca
import numpy as np
import pytest
from control_problems import cartesian_pendulum, pendulum
from slow import slow

import casadi_galerkin as cg

DURATION = 3.0
EXACT = 2.65658286091763  # in angles, of degree 12
ROUNDOFF = 1e-12


def guess(t):
    return [np.sin(np.pi * t / DURATION), -np.cos(np.pi * t / DURATION)]


@pytest.mark.parametrize("solver", [cg.ipopt, *slow(cg.fatrop.with_options(tol=1e-11))], ids=str)
def test_cartesian_swing_up_is_that_in_angles(solver):
    angle = cg.solve(pendulum(DURATION), cg.Galerkin(6), 20)
    path = cg.solve(cartesian_pendulum(), cg.Galerkin(6), 20, guess=guess, solver=solver)
    assert path.cost == pytest.approx(angle.cost, abs=ROUNDOFF)
    np.testing.assert_allclose(path.x, [np.sin(angle.x[0]), -np.cos(angle.x[0])], rtol=0, atol=1e-11)
    np.testing.assert_allclose(np.sum(path.polynomial.values**2, axis=0), 1, rtol=0, atol=1e-13)
    tangent = np.array([np.cos(angle.x[0]), np.sin(angle.x[0])])
    np.testing.assert_allclose(path.momentum, tangent * angle.momentum, rtol=0, atol=1e-10)
    np.testing.assert_allclose(path.control.values, angle.control.values, rtol=0, atol=1e-6)
    np.testing.assert_allclose(path.energy, angle.energy, rtol=0, atol=1e-10)
    tension = angle.velocity[0] ** 2 + np.cos(angle.x[0])  # of the rod, inwards
    np.testing.assert_allclose(path.multipliers(path.t)[0], -tension / 2, rtol=0, atol=1e-8)
    assert np.max(path.dynamics_defect) < 1e-6


@pytest.mark.parametrize("solver", [cg.ipopt, cg.fatrop], ids=str)
@pytest.mark.parametrize("rounding", [np.sin(np.pi), *slow(1e-8)])
def test_an_end_beside_the_vertical_by_rounding_costs_what_the_vertical_does(rounding, solver):
    """The straight line moves x[0] by rounding alone, and fatrop never returned from equations measured by that."""
    path = cg.solve(cartesian_pendulum(end=[rounding, 1.0]), cg.Galerkin(4), 20, guess=guess, solver=solver)
    there = cg.solve(cartesian_pendulum(end=[0.0, 1.0]), cg.Galerkin(4), 20, guess=guess)
    assert path.cost == pytest.approx(there.cost, abs=abs(4 * rounding) + ROUNDOFF)
    assert path.solver == f"{'IPOPT' if solver is cg.ipopt else 'fatrop'} (Solve Succeeded)"


@pytest.mark.parametrize("degree", [2, *slow(4)])
@pytest.mark.parametrize("rule", [cg.gauss, lambda m: cg.lobatto(m + 1)], ids=["gauss", "lobatto"])
@pytest.mark.slow
def test_order_is_twice_the_degree(degree, rule):
    meshes = {1: (20, 40, 80), 2: (10, 20, 40), 4: (8, 10, 12)}[degree]
    method = cg.Galerkin(degree, quadrature=rule(degree))
    errors = [abs(cg.solve(cartesian_pendulum(), method, n, guess=guess).cost - EXACT) for n in meshes]
    assert -np.polyfit(np.log(meshes), np.log(errors), 1)[0] == pytest.approx(2 * degree, abs=0.4)


def test_free_ends_stay_on_the_constraint_and_cost_what_they_do_in_angles():
    def in_angles(t, x, v):
        return 3 * v[0] + 2 * (x[0] - 3) ** 2

    def on_circle(t, x, v):
        return 3 * (x[0] * v[1] - x[1] * v[0]) + 2 * (ca.atan2(x[0], -x[1]) - 3) ** 2

    free = {"end": [None], "end_velocity": [None], "terminal_cost": in_angles}
    angle = cg.solve(pendulum(DURATION, **free), cg.Galerkin(5), 20, guess=lambda t: [t])
    free = {"end": [None, None], "end_velocity": [None, None], "terminal_cost": on_circle}
    path = cg.solve(cartesian_pendulum(**free), cg.Galerkin(5), 20, guess=lambda t: [np.sin(t), -np.cos(t)])
    assert path.cost == pytest.approx(angle.cost, abs=1e-9)
    assert np.hypot(*path.x[:, -1]) == pytest.approx(1, abs=1e-13)
    assert path.x[:, -1] @ path.end_velocity == pytest.approx(0, abs=1e-12)


@pytest.mark.slow
def test_a_tolerance_is_met_and_the_force_replayed_on_the_constraint():
    path = cg.solve(cartesian_pendulum(), tol=1e-7, guess=guess)
    assert abs(path.cost / EXACT - 1) <= path.error_estimate <= 1e-7
    problem = cartesian_pendulum()
    start = {"start": [0.0, -1.0], "velocity": [0.0, 0.0]}
    again = cg.InitialProblem(
        problem.lagrangian, problem.t_span, force=path.replay(), constraint=problem.constraint, **start
    )
    np.testing.assert_allclose(cg.solve(again, path.method, mesh=path.t).x, path.x, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"start": [0.0, -1.1]}, "constraint must be zero at the given start"),
        (
            {"start_velocity": [0.0, 1.0]},
            r"start_velocity must be tangent .* \[0.0, 1.0\]: the rate of",
        ),
        ({"constraint": lambda t, x: [ca.dot(x, x) - 1, x[0]]}, r"2 values for 2 components"),
        (
            {
                "rates": lambda t, x, v, u: u,
                "force": lambda t, x, v, u: u,
                "lagrangian": lambda t, x, v: v[0] ** 2,
                "start_velocity": [0.0, None],
                "end_velocity": [0.0, None],
            },
            "no place beside rates",
        ),
    ],
)
def test_bad_constraints_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        cartesian_pendulum(**changes)


def test_control_points_that_lose_order_are_refused():
    with pytest.raises(ValueError, match="a constraint is held at the control points"):
        cg.solve(cartesian_pendulum(), cg.Galerkin(4, control_points=cg.equispaced_points(4)), 10, guess=guess)


@pytest.mark.parametrize(
    "how", [{"method": cg.Galerkin(4), "intervals": 12}, {"method": cg.Galerkin(6), "intervals": 8}]
)
@pytest.mark.slow
def test_a_path_that_jumps_through_the_center_of_its_circle_is_refused(how):
    """It costs nothing, and all nodes are held."""
    with pytest.raises(cg.ConvergenceError, match=r"leaves its constraint between the nodes, near t = 1\.5"):
        cg.solve(cartesian_pendulum(), **how)
    assert cg.solve(cartesian_pendulum(), **how, starts=4).cost > 1
