"""What a tolerance returns can be flown: DOP853 with `control(t)`, from the start, arrives where the path does."""

import casadi as ca
import numpy as np
import pytest
from paths import script
from scipy.integrate import solve_ivp

import casadi_galerkin as cg

NAMES = "bryson_denham speed_limit moon_lander robot_arm van_der_pol zermelo crane hang_glider orbit_raising"  # stable
TOL = 1e-4


def rates_of(problem):
    """(t, x, v, u) -> rates of x and of the velocities, from the Lagrangian, the force and the rates alone."""
    d, mechanical = problem.dimension, problem.mechanical
    t, x, v, u = ca.SX.sym("t"), ca.SX.sym("x", d), ca.SX.sym("v", d), ca.SX.sym("u", problem.controls)
    velocity = ca.vertcat(v[:mechanical], problem.rates(t, x, v, u))
    lagrangian = problem.lagrangian(t, x, v)
    momentum = ca.gradient(lagrangian, v)[:mechanical]
    push = ca.gradient(lagrangian, x)[:mechanical] + problem.force(t, x, v, u)[:mechanical]
    push -= ca.jacobian(momentum, t) + ca.jtimes(momentum, x, velocity)
    mass = ca.jacobian(momentum, v[:mechanical])
    rates = ca.vertcat(velocity, ca.solve(mass, push) if mechanical else ca.SX(0, 1))
    inserted = ca.substitute(rates, v, ca.vertcat(v[:mechanical], ca.SX.zeros(d - mechanical)))
    return ca.Function("rates", [t, x, v[:mechanical], u], [inserted])


def flown(path):
    """Largest distance of the flight to the path, relative to the sizes of the components."""
    rates, d, mechanical = rates_of(path.problem), path.problem.dimension, path.problem.mechanical
    state, worst = np.append(path.x[:, 0], path.start_velocity[:mechanical]), 0.0
    for begin, end in zip(path.t[:-1], path.t[1:], strict=True):
        before_end = np.nextafter(end, begin)

        def slope(t, y, begin=begin, last=before_end):
            u = path.control(np.clip(t, begin, last))
            return np.array(rates(t, y[:d], y[d:], u)).ravel()

        state = solve_ivp(slope, (begin, end), state, method="DOP853", rtol=1e-8, atol=1e-10).y[:, -1]
        worst = max(worst, float(np.max(np.abs(state[:d] - path(before_end)) / path.sizes)))
    return worst


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES.split())
def test_an_optimum_is_flown_by_its_control(name):
    case = script("literature").CASES[name]()
    path = cg.solve(case.problem, tol=TOL, guess=case.guess)
    assert flown(path) <= 10 * TOL
    low, high = (np.array(side)[:, None] for side in path.problem.control_bounds)
    u = path.control(np.linspace(*path.t[[0, -1]], 10_000))
    assert np.all((low <= u) & (u <= high))
