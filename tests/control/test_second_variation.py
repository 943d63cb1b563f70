"""Whether an optimum is a minimum or a saddle, which is left."""

import pickle
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator, first_order, pendulum, plane
from slow import slow

import casadi_galerkin as cg
from casadi_galerkin.control import control_transcription

METHOD = cg.Galerkin(degree=4)
CLAMPED = (4.730040744862704, 7.853204624095838, 10.995607838001671)  # roots of cos β cosh β = 1, of a clamped beam


@pytest.fixture
def saddles_kept(monkeypatch):
    """Saddles are not left, so that their directions can be counted."""
    optimize = control_transcription.optimize
    monkeypatch.setattr(control_transcription, "optimize", lambda *args: replace(optimize(*args), doubtful=False))


def over_a_hill(across, height=100.0, length=1.0, price=1.0, unit=1.0):
    """From rest on one side of a hill of cost to rest on the other, with so many directions across the line.

    The bounds of the controls, which are forces in some unit, are far.
    """
    d = 1 + across

    def running_cost(t, x, v, u):
        return price * (ca.sumsqr(u * unit / length) / 2 + height * ca.exp(-8 * ca.sumsqr(x / length)))

    return cg.ControlProblem(
        lambda t, x, v: ca.sumsqr(v) / 2,
        (0.0, 1.0),
        start=[-length] + [0.0] * across,
        end=[length] + [0.0] * across,
        start_velocity=[0.0] * d,
        end_velocity=[0.0] * d,
        force=lambda t, x, v, u: u * unit,
        running_cost=running_cost,
        controls=d,
        control_bounds=(-1e3 * length / unit, 1e3 * length / unit),
    )


@pytest.mark.parametrize("across", [1, 2])
@pytest.mark.parametrize("solver", [cg.ipopt, cg.fatrop], ids=lambda solver: solver.name)
@pytest.mark.slow
@pytest.mark.usefixtures("saddles_kept")
def test_a_line_over_a_hill_is_a_saddle_in_every_direction_across(across, solver):
    path = cg.solve(over_a_hill(across), METHOD, 12, solver=solver)
    assert path.morse_index == across
    assert f"a saddle of Morse index {across}" in repr(path)


@pytest.mark.parametrize("duration", [1.1, *slow(3.7)])
@pytest.mark.parametrize("length", [1e-2, *slow(1e-4)])
def test_the_shortest_way_to_a_circle_is_a_minimum_in_any_unit(length, duration):
    """The component across it is zero, and so are its momenta, whose unit is that of the others."""
    problem = plane(
        t_span=(0.0, duration),
        start=[0.45 * length, 0.0],
        end=[None, None],
        end_velocity=[None, None],
        running_cost=lambda t, x, v, u: ca.sumsqr(u / length) / 2,
        end_conditions=(lambda x0, v0, x1, v1: ca.sumsqr(x1 / length), 1.0, 1.0),
    )
    path = cg.solve(problem, METHOD, 16, guess=lambda t: [length * (0.45 + 0.55 * t / duration), 0.0])
    assert path.cost == pytest.approx(1.5 * 0.55**2 / duration**3, rel=1e-7)
    assert path.morse_index == 0


@pytest.mark.parametrize("across", [1, *slow(2)])
def test_the_line_over_a_hill_is_left_for_the_way_round_it(across):
    problem = over_a_hill(across)
    around = cg.solve(problem, METHOD, 12, guess=lambda t: [2 * t - 1] + [t * (1 - t)] * across)
    path = cg.solve(problem, METHOD, 12)
    assert path.cost == pytest.approx(around.cost, rel=1e-12)
    assert "a local minimum" in repr(path)
    assert ", beside a saddle of cost 44.904" in path.solver
    assert path.iterations > around.iterations


@pytest.mark.parametrize("length", [1.0, *slow(1e-6)])
def test_rest_is_left_where_it_is_no_minimum(length):
    """The solver ends before its first step, at the guess."""
    stiffness = 1.5 * CLAMPED[0] ** 4

    def running_cost(t, x, v, u):
        return (u[0] / length) ** 2 / 2 - stiffness * ((x[0] / length) ** 2 / 2 - (x[0] / length) ** 4 / 4)

    path = cg.solve(double_integrator(end=[0.0], running_cost=running_cost), METHOD, 12)
    assert path.morse_index == 0
    assert path.cost < -1


def test_a_saddle_below_which_costs_have_no_end_is_returned_and_said():
    stiffness = 1.5 * CLAMPED[0] ** 4
    endless = double_integrator(end=[0.0], running_cost=lambda t, x, v, u: (u[0] ** 2 - stiffness * x[0] ** 2) / 2)
    path = cg.solve(endless, METHOD, 4)
    assert (path.cost, path.morse_index) == (0.0, 1)
    assert repr(path).splitlines()[2].startswith("  SADDLE      no minimum: the cost decreases in 1 direction")


def test_from_an_earlier_answer_a_saddle_is_kept(saddles_kept, monkeypatch):
    problem = over_a_hill(1)
    saddle = cg.solve(problem, METHOD, 12)
    monkeypatch.undo()
    assert cg.solve(problem, METHOD, 12, guess=saddle).morse_index == 1


@pytest.mark.slow
def test_a_time_optimal_turn_leaves_its_saddle():
    """Attitude by quaternions about the first axis; the published time is 28.6304 (Betts 2010, 6.8)."""
    j, half = (5621.0, 4547.0, 2364.0), np.radians(75.0)

    def rates(t, x, v, u):
        (a, b, c), (p, q, r, s) = ca.vertsplit(x)[4:], ca.vertsplit(x)[:4]
        turned = [a * s - b * r + c * q, a * r + b * s - c * p, b * p - a * q + c * s, -a * p - b * q - c * r]
        torques = [u[0] - (j[2] - j[1]) * b * c, u[1] - (j[0] - j[2]) * a * c, u[2] - (j[1] - j[0]) * a * b]
        return [rate / 2 for rate in turned] + [torque / of for torque, of in zip(torques, j, strict=True)]

    turn = first_order(
        t_span=(0.0, 35.0),
        start=[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        end=[np.sin(half), 0.0, 0.0, None, 0.0, 0.0, 0.0],
        start_velocity=[None] * 7,
        end_velocity=[None] * 7,
        rates=rates,
        running_cost=lambda t, x, v, u: 1.0,
        controls=3,
        control_bounds=(-50.0, 50.0),
        position_bounds=(-1.1, 1.1),
        duration_bounds=(5.0, 60.0),
    )
    path = cg.solve(turn, cg.Galerkin(3), 30)
    assert path.morse_index == 0
    assert path.cost == pytest.approx(28.6304, rel=1e-4)


@pytest.mark.parametrize(
    ("length", "price", "unit"),
    [(1e-2, 1.0, 1.0), (1e4, 1.0, 1.0), (1.0, 1e-6, 1.0), (1.0, 1e6, 1.0), (1.0, 1.0, 1e10)],
)
@pytest.mark.usefixtures("saddles_kept")
def test_units_change_nothing(length, price, unit):
    assert cg.solve(over_a_hill(1, length=length, price=price, unit=unit), METHOD, 12).morse_index == 1


@pytest.mark.parametrize("length", [1e-6, *slow(1e6)])
@pytest.mark.parametrize("below", [0, 1, *slow(2)])
@pytest.mark.parametrize("side", [0.99, 1.01])
@pytest.mark.usefixtures("saddles_kept")
def test_rest_is_a_saddle_from_the_eigenvalues_of_a_clamped_beam_on(below, side, length):
    """∫ (x''² - k x²)/2 has as many negative directions as there are eigenvalues x'''' = β⁴ x below k."""
    stiffness = side * CLAMPED[below] ** 4

    def running_cost(t, x, v, u):
        return (u[0] / length) ** 2 / 2 - stiffness * ((x[0] / length) ** 2 / 2 - (x[0] / length) ** 4 / 4)

    path = cg.solve(double_integrator(end=[0.0], running_cost=running_cost), METHOD, 12)
    assert np.max(np.abs(path.x)) == 0
    assert path.morse_index == below + (side > 1)


@pytest.mark.parametrize(("side", "index"), [(0.9, 0), (1.1, 1)])
@pytest.mark.parametrize("narrow", [1e-5, 1e-7])
@pytest.mark.usefixtures("saddles_kept")
def test_narrow_intervals_hide_nothing(narrow, side, index):
    """As stand beside a switch."""
    mesh = [0.0, 0.1, 0.2, 0.3, 0.37 - narrow, 0.37, 0.37 + narrow, 0.5, 0.75, 1.0]
    stiffness = side * CLAMPED[0] ** 4
    path = cg.solve(
        double_integrator(end=[0.0], running_cost=lambda t, x, v, u: (u[0] ** 2 - stiffness * x[0] ** 2) / 2),
        cg.Galerkin(degree=8),
        mesh=mesh,
        guess=lambda t: [0.0],
    )
    assert path.morse_index == index


def pendulum_with_breakpoints():
    """Nothing happens at the breakpoints."""
    return double_integrator(
        lagrangian=lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]),
        t_span=(0.0, 2.0),
        end=[2.0],
        running_cost=lambda t, x, v, u: u[0] ** 2 / 2 + 1,
        breakpoints=[0.7, 1.1],
        duration_bounds=(0.1, 5.0),
    )


@pytest.mark.parametrize("intervals", [9, *slow(40)])
def test_a_breakpoint_that_may_be_anywhere_makes_no_saddle(intervals):
    assert cg.solve(pendulum_with_breakpoints(), METHOD, intervals).morse_index == 0


@pytest.mark.parametrize(("unit", "price"), [(1e-3, 1.0), *slow((1e6, 1e-14))])
def test_bounds_that_are_met_hold_what_would_lower_the_cost(unit, price):
    """In any units: the product of a distance and its multiplier is what a solver keeps small."""
    path = cg.solve(
        double_integrator(
            end=[None],
            end_velocity=[None],
            force=lambda t, x, v, u: u / unit,
            running_cost=lambda t, x, v, u: -price * u[0] ** 2 / 2,
            control_bounds=(0.5 * unit, unit),
        ),
        METHOD,
        3,
        guess=(lambda t: [t**2 / 2], lambda t: [0.9 * unit]),
    )
    assert path.cost == pytest.approx(-0.5 * price * unit**2, abs=2e-12)
    assert path.morse_index == 0


def test_where_bounds_hold_everything_nothing_can_lower_the_cost():
    full = first_order(
        start=[1.0],
        end=[None],
        running_cost=lambda t, x, v, u: -x[0],
        control_bounds=(0.0, 1.0),
        position_bounds=(1.0, 1.0),
    )
    assert cg.solve(full, METHOD, 1).morse_index == 0


@pytest.mark.usefixtures("saddles_kept")
def test_a_pickled_path_still_tells():
    path = pickle.loads(pickle.dumps(cg.solve(over_a_hill(1), METHOD, 12)))
    assert path.morse_index == 1
    assert path.regularity is None


@pytest.mark.parametrize("intervals", [4, *slow(12)])
def test_without_a_cost_there_is_no_saddle(intervals):
    assert cg.solve(pendulum(2.0, running_cost=None), METHOD, intervals).morse_index == 0


@pytest.mark.parametrize("added", [1e-9, *slow(1e-3)])
def test_a_convex_cost_whose_terms_cancel_has_a_minimum(added):
    """The least ∫ (u² - x²/4)/2 over the time π is zero, and convex up to the time 2 π."""
    falling = first_order(
        t_span=(0.0, np.pi), running_cost=lambda t, x, v, u: (u[0] ** 2 - x[0] ** 2 / 4) / 2 + added / np.pi
    )
    path = cg.solve(falling, cg.Galerkin(4), intervals=10)
    assert path.cost == pytest.approx(added, abs=1e-13)
    assert path.morse_index == 0


@pytest.mark.parametrize(("duration", "tol"), [(2.0, 1e-5), (3.0, 1e-4)])
@pytest.mark.slow
def test_controls_near_their_bounds_beside_a_switch_make_no_saddle(duration, tol):
    """Jackson's mixing of two catalysts, whose optimum is bang-singular-bang; up to four directions were counted."""

    def rates(t, x, v, u):
        turned = u[0] * (10 * x[1] - x[0])
        return [turned, -turned - (1 - u[0]) * x[1]]

    mixed = first_order(
        t_span=(0.0, duration),
        start=[1.0, 0.0],
        end=[None, None],
        start_velocity=[None, None],
        end_velocity=[None, None],
        rates=rates,
        running_cost=None,
        terminal_cost=lambda t, x, v: x[0] + x[1] - 1,
        control_bounds=(0.0, 1.0),
    )
    path = cg.solve(mixed, tol=tol, of=lambda path: path.cost)
    assert path.cost == pytest.approx({1.0: -0.048055686, 2.0: -0.098612758, 3.0: -0.146484782}[duration], rel=tol)
    assert path.morse_index == 0


@pytest.mark.parametrize("bound", [1.0, *slow(3.0)])
@pytest.mark.parametrize("price", [1e-2, *slow(1e-3)])
@pytest.mark.slow
def test_bounds_that_are_met_at_a_high_price_leave_a_convex_cost_its_minimum(bound, price):
    """Their stiffness was taken for the size of the cost, and nothing was told."""
    braked = double_integrator(
        t_span=(0.0, 5.0),
        start=[1.0],
        end=[None],
        end_velocity=[None],
        running_cost=lambda t, x, v, u: x[0] ** 2 + v[0] ** 2 + price * u[0] ** 2,
        control_bounds=(-bound, bound),
    )
    assert cg.solve(braked, METHOD, 10).morse_index == 0
    assert cg.solve(braked, tol=1e-3).morse_index == 0
