"""What is tried in turn where an optimization finds nothing."""

import re

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator, first_order, plane
from paths import script
from slow import slow

import casadi_galerkin as cg

guesses = script("guesses")


def swing_to_rest(duration):
    """A mass on a spring, from x = 3 to rest at 0 in least time: its force is the weaker one, so it has to swing."""
    return double_integrator(
        lagrangian=lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2,
        t_span=(0.0, duration),
        start=[3.0],
        end=[0.0],
        running_cost=lambda t, x, v, u: 1 + 0 * u[0],
        control_bounds=(-1.0, 1.0),
        duration_bounds=(0.5, 30.0),
    )


LEAST_TIME = np.pi + 2 * np.arcsin(0.75)  # semicircles about 1 and -1 in the phase plane, by their angles


@pytest.mark.parametrize("duration", [5.0, *slow(8.0)])
def test_a_free_duration_is_begun_with_longer_ones_where_none_is_found(duration):
    path = cg.solve(swing_to_rest(duration), cg.Galerkin(4), intervals=30)
    assert "times the duration of the guess" in path.solver
    assert path.t[-1] == pytest.approx(LEAST_TIME, rel=2e-3)
    near = cg.solve(swing_to_rest(20.0), cg.Galerkin(4), intervals=30)
    assert "times the duration" not in near.solver
    assert path.cost == pytest.approx(near.cost, rel=1e-6)


def test_a_higher_barrier_leads_to_a_path_where_the_straight_line_is_far_from_any():
    """Least time of x' = v, v' = u with a speed limit, where neither velocity at the ends leads to the other end."""
    drive = first_order(
        t_span=(0.0, 2.36),
        start=[0.0, -0.375],
        end=[2.2, -0.534],
        start_velocity=[None] * 2,
        end_velocity=[None] * 2,
        rates=lambda t, x, v, u: [x[1], u[0]],
        running_cost=lambda t, x, v, u: 1,
        control_bounds=(-1.154, 1.246),
        position_bounds=([-np.inf, -0.774], [np.inf, 1.351]),
        duration_bounds=(0.02, 60.0),
    )
    path = cg.solve(drive, tol=1e-4)
    up, down = (1.351 + 0.375) / 1.246, (1.351 + 0.534) / 1.154
    along = 2.2 - (1.351**2 - 0.375**2) / (2 * 1.246) - (1.351**2 - 0.534**2) / (2 * 1.154)
    assert path.cost == pytest.approx(up + down + along / 1.351, rel=1e-4)
    coarse = cg.solve(drive, cg.Galerkin(4), intervals=8)
    assert "after IPOPT stopped with 'Infeasible Problem Detected'" in coarse.solver


def test_longer_durations_that_lead_nowhere_are_told():
    far = double_integrator(end=[100.0], control_bounds=(-1.0, 1.0), duration_bounds=(0.5, 10.0))
    tried = "No path was found from 4 times the duration of the guess or 10 times the duration of the guess, either"
    with pytest.raises(cg.ConvergenceError, match=tried):
        cg.solve(far, cg.Galerkin(3), intervals=10)


def test_a_wild_guess_is_drawn_halfway_to_the_straight_line_where_it_leads_nowhere():
    """Of 40 guesses for this acrobot, 11 led nowhere; of these 6 lead somewhere with half of their waves."""
    program = cg.transcribe(guesses.acrobot(), cg.Galerkin(guesses.DEGREE), guesses.INTERVALS)
    wild = guesses.guess(program.problem, seed=1)
    path = program.solve(guess=(wild.x, wild.u))
    assert "halfway between the straight line and the guess" in path.solver
    assert path.iterations > 400  # 54 of them not in vain
    again = program.solve(guess=path)
    assert "halfway" not in again.solver
    assert again.cost == pytest.approx(path.cost, rel=1e-9)


def test_the_straight_line_is_begun_from_where_a_guess_and_half_of_its_waves_lead_nowhere():
    """Of 40 guesses for this acrobot it was needed for 5."""
    program = cg.transcribe(guesses.acrobot(), cg.Galerkin(guesses.DEGREE), guesses.INTERVALS)
    wild = guesses.guess(program.problem, seed=3)
    path, straight = program.solve(guess=(wild.x, wild.u)), program.solve()
    assert "from the straight line between the ends" in path.solver
    assert path.cost == pytest.approx(straight.cost, rel=1e-9)
    assert path.iterations > straight.iterations + 500


def test_a_gentler_guess_on_which_a_callable_is_not_finite_is_none():
    """The guess leaps over the gap in which the cost is not defined, halfway to the straight line is within."""
    pushed = double_integrator(
        end=[0.0],
        running_cost=lambda t, x, v, u: u[0] ** 2 / 2 + ca.sqrt((x[0] - 0.89) ** 2 - 0.0025),
        control_bounds=(1.0, 2.0),
    )
    program = cg.transcribe(pushed, cg.Galerkin(4), intervals=2)
    with pytest.raises(ValueError, match="not finite"):
        program.solve(guess=lambda t: [4 * t * (1 - t)])
    nothing = "No path was found from halfway between the straight line and the guess or the straight line between"
    with pytest.raises(cg.ConvergenceError, match=nothing):
        program.solve(guess=lambda t: [8 * t * (1 - t)])


def test_a_feasible_path_that_noise_keeps_from_the_usual_accuracy_is_accepted_with_less():
    """A rocket below a speed limit, whose thrust is singular at first: 0.6337169 of its mass is left (other meshes)."""
    rocket = cg.ControlProblem(
        lambda t, x, v: x[1] * v[0] ** 2 / 2 + x[1] / x[0],
        (0, 0.17),
        [1.0, 1.0],
        [1.01, None],
        [0.0, None],
        [None, None],
        force=lambda t, x, v, u: 3.5 * u[0] - 310 * v[0] ** 2 * ca.exp(-500 * (x[0] - 1)) - 7 * u[0] * v[0],
        running_cost=lambda t, x, v, u: 0,
        controls=1,
        terminal_cost=lambda t, x, v: -x[1],
        rates=lambda t, x, v, u: -7 * u[0],
        control_bounds=(0, 1),
        duration_bounds=(0.05, 1),
        path_constraint=(lambda t, x, v, u: v[0], -np.inf, 0.1),
    )
    paths = [cg.solve(rocket, cg.Galerkin(4), intervals) for intervals in (100, 110, 120)]  # on most there is noise
    assert [path.cost for path in paths] == pytest.approx([-0.6337169] * 3, abs=2e-7)
    words = r"IPOPT \(Solved To Acceptable Level\), after IPOPT stopped with '(?!Infeasible)"
    assert any(re.match(words, path.solver) for path in paths)


@pytest.mark.parametrize(
    ("costs", "which"),
    [
        ({"running_cost": lambda t, x, v, u: ca.fabs(x[0] - 0.1) + u[0] ** 2 / 2}, "running"),
        ({"terminal_cost": lambda t, x, v: 3 * ca.fmax(x[0] - 0.5, 0.5 - x[0])}, "terminal"),
    ],
)
def test_a_cost_with_a_kink_of_the_position_that_stops_the_solver_is_named(costs, which):
    gliding = {"t_span": (0.0, 3.0), "start": [1.0], "end": [None], "rates": lambda t, x, v, u: u}
    problem = first_order(**({"running_cost": lambda t, x, v, u: u[0] ** 2 / 2} | gliding | costs))
    with pytest.raises(cg.ConvergenceError, match=rf"The {which} cost holds fabs, fmax, .* sqrt\(z\*\*2 \+ 1e-6\)"):
        cg.solve(problem, cg.Galerkin(4), 8)


@pytest.mark.parametrize("kinked", [lambda u: ca.fmax(0, u), lambda u: ca.if_else(u > 0, u, 0)])
def test_a_cost_with_a_kink_that_stops_the_solver_is_named(kinked):
    problem = double_integrator(running_cost=lambda t, x, v, u: kinked(u[0]) + u[0] ** 2, control_bounds=(-20.0, 20.0))
    with pytest.raises(cg.ConvergenceError, match=r"Maximum Iterations .* fmax, fmin or a comparison of a control"):
        cg.solve(problem, cg.Galerkin(3), 10)
    lifted = double_integrator(
        controls=2,
        force=lambda t, x, v, u: u[0],
        running_cost=lambda t, x, v, u: u[1] + u[0] ** 2,
        path_constraint=(lambda t, x, v, u: [u[1] - u[0], u[1]], 0.0, np.inf),
    )
    assert cg.solve(lifted, cg.Galerkin(3), 20).cost == pytest.approx(13.4852, rel=1e-3)


def test_a_cost_with_a_norm_that_stops_the_solver_is_named():
    """Where the thrust is zero in between, the derivative of its size jumps."""

    def carried(size):
        return plane(
            t_span=(0.0, 1.0),
            end=[1.0, 1.0],
            running_cost=lambda t, x, v, u: size(u),
            path_constraint=(lambda t, x, v, u: ca.sumsqr(u), 0.0, 100.0),
        )

    guess = (lambda t: [t, t], lambda t: [0.1, 0.1])
    with pytest.raises(cg.ConvergenceError, match=r"all constraints hold, .* root or norm of controls, .* \+ 1e-4"):
        cg.solve(carried(ca.norm_2), cg.Galerkin(3), 6, guess=guess)
    path = cg.solve(carried(ca.norm_2), cg.Galerkin(3), 10, guess=guess)  # met in passing
    smooth = cg.solve(carried(lambda u: ca.sqrt(ca.sumsqr(u) + 1e-8)), cg.Galerkin(3), 10, guess=guess)
    assert path.cost == pytest.approx(smooth.cost, rel=2e-5)
