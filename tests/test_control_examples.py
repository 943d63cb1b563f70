"""Every scene of trajectory optimisation runs and gives its known, or independently computed, numbers."""

import importlib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import casadi_galerkin as cg

EXAMPLES = Path(__file__).parents[1] / "examples"
SCENES = ("cart_pole", "minimum_time", "two_link_arm", "low_thrust", "obstacle")


@pytest.fixture
def scene(monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    return importlib.import_module


@pytest.mark.parametrize("name", SCENES)
def test_scene_runs_and_draws(scene, name, tmp_path, capsys):
    mpl.use("Agg")
    module = scene(name)
    path = module.main(str(tmp_path / "picture.png"))
    assert path.violation < 1e-9
    assert (tmp_path / "picture.png").stat().st_size > 10_000
    assert "picture written" in capsys.readouterr().out


def test_cart_pole_costs_what_kelly_found(scene):
    assert scene("cart_pole").main().cost == pytest.approx(58.80767, abs=1e-3)


def test_cart_pole_has_a_cheaper_swing_up_and_both_do_the_work_of_lifting(scene):
    module = scene("cart_pole")
    lifted = 2 * module.POLE * module.GRAVITY * module.LENGTH
    first, other = (cg.solve(module.problem(), cg.Galerkin(10), 30, guess=g) for g in (None, module.once_more))
    assert first.cost == pytest.approx(58.807667459, abs=1e-8)  # published to fewer digits
    assert other.cost < first.cost - 0.8

    def rates(y, u):
        s, c, m, l = np.sin(y[1]), np.cos(y[1]), module.POLE, module.LENGTH  # noqa: E741
        mass = np.array([[module.CART + m, m * l * c], [m * l * c, m * l**2]])
        load = [u[0] + m * l * s * y[3] ** 2, -m * module.GRAVITY * l * s]
        return np.concatenate((y[2:], np.linalg.solve(mass, load)))

    for path in (first, other):
        assert module.work(path) == pytest.approx(lifted, rel=1e-9)
        np.testing.assert_allclose(flown(rates, path, [0, 0, 0, 0]), [1, np.pi, 0, 0], rtol=0, atol=1e-7)


def test_thrust_is_the_primer_vector_and_costs_little_more_than_a_slow_spiral(scene):
    module = scene("low_thrust")
    path = module.main()
    times = path.control.times
    primer = -path.costate(times) * np.stack((np.ones_like(times), path(times)[0]))
    np.testing.assert_allclose(path.control.values, primer, rtol=0, atol=1e-10)  # IPOPT's tolerance
    assert 1.02 < path.cost / module.SLOW_SPIRAL < 1.05


def test_minimum_time_is_two(scene):
    assert scene("minimum_time").main().t[-1] == pytest.approx(2, abs=1e-9)


def test_with_a_buffer_the_brake_begins_late_and_speed_is_left(scene):
    module = scene("minimum_time")
    path = cg.solve(module.buffered(), cg.Galerkin(2), intervals=12)
    a = module.FULL_THRUST
    found = [path.t[-1], path.end_velocity[0], path.cost]
    assert found == pytest.approx([1.5 * a, a / 2, 1.5 * a + module.PRICE * a**2 / 8], abs=1e-8)
    switch = path.t[np.flatnonzero(np.diff(path.control(path.t)[0]) < -1)[0] + 1]
    assert switch == pytest.approx(a, abs=1e-8)


def test_the_best_gear_matches_the_inertias(scene):
    module = scene("minimum_time")
    path = cg.solve(module.geared(), cg.Galerkin(2), intervals=10)
    assert path.parameters[0] == pytest.approx(4, abs=1e-6)  # the duration is flat there
    assert path.t[-1] == pytest.approx(2**0.5, abs=1e-9)


def test_force_replayed_from_rest_brings_cart_and_pole_to_the_end_with_the_energy_of_lifting(scene):
    module = scene("cart_pole")
    path = module.main()
    again = module.replayed(path)
    np.testing.assert_allclose(again.x, path.x, rtol=0, atol=1e-10)
    assert again.x[:, -1] == pytest.approx([module.DISTANCE, np.pi], abs=1e-10)
    lifted = 2 * module.POLE * module.GRAVITY * module.LENGTH
    assert again.energy[-1] - again.energy[0] == pytest.approx(lifted, abs=1e-9)


def test_vehicle_passes_below_at_the_exact_cost(scene):
    module = scene("obstacle")
    path = module.main()
    assert path.cost == pytest.approx(module.EXACT, abs=1e-9)
    assert path(0.5) == pytest.approx([0.5, -0.2], abs=1e-6)


def flown(rates, path, start):
    """First-order equations under the controls found, by an integrator that knows nothing of the discretisation."""
    state = np.array(start, dtype=float)
    for begin, end in pairwise(path.t):  # the controls may jump at joints
        before = np.nextafter(end, begin)

        def slope(t, y, before=before):
            return rates(y, path.control(min(t, before)))

        state = solve_ivp(slope, (begin, end), state, rtol=1e-10, atol=1e-12).y[:, -1]
    return state


def test_arm_driven_by_its_torques_stands_upright_within_the_torque_limit(scene):
    module = scene("two_link_arm")
    path = module.main()

    def rates(y, u):
        s, c, g = np.sin(y[0] - y[1]), np.cos(y[0] - y[1]) / 2, module.GRAVITY
        mass = np.array([[4 / 3, c], [c, 1 / 3]])
        load = [
            u[0] - u[1] - s / 2 * y[3] ** 2 - 1.5 * g * np.sin(y[0]),
            u[1] + s / 2 * y[2] ** 2 - 0.5 * g * np.sin(y[1]),
        ]
        return np.concatenate((y[2:], np.linalg.solve(mass, load)))

    np.testing.assert_allclose(flown(rates, path, [0, 0, 0, 0]), [np.pi, np.pi, 0, 0], rtol=0, atol=5e-3)
    assert np.all(np.max(np.abs(path.control.values), axis=1) < [module.SHOULDER, module.ELBOW])
    finer = cg.solve(module.problem(), cg.Galerkin(degree=8), intervals=30)
    assert module.work(finer) == pytest.approx(4 * module.GRAVITY, rel=1e-7)
    assert path.cost == pytest.approx(finer.cost, rel=1e-5)
    np.testing.assert_allclose(flown(rates, finer, [0, 0, 0, 0]), [np.pi, np.pi, 0, 0], rtol=0, atol=1e-6)


def test_spacecraft_arrives_on_the_wider_circle(scene):
    module = scene("low_thrust")
    path = module.main()

    def rates(y, u):
        return [y[2], y[3], y[0] * y[3] ** 2 - 1 / y[0] ** 2 + u[0], (u[1] - 2 * y[2] * y[3]) / y[0]]

    r, _, radial, rate = flown(rates, path, [1, 0, 0, 1])
    assert [r, radial, rate] == pytest.approx([2, 0, 2**-1.5], abs=1e-6)


def test_angle_of_arrival_is_the_cheapest(scene):
    module = scene("low_thrust")
    free = module.main()

    def cost(angle):
        problem = replace(module.problem(), end=[module.RADIUS, angle])
        return cg.solve(problem, free.method, intervals=20, guess=free).cost

    best = cost(free.x[1, -1])
    assert best == pytest.approx(free.cost, rel=1e-9)
    assert cost(free.x[1, -1] - 0.05) > best * (1 + 1e-6)
    assert cost(free.x[1, -1] + 0.05) > best * (1 + 1e-6)
