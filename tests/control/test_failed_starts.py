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


def test_a_free_duration_is_begun_with_a_longer_one_where_none_is_found():
    """A mass on a spring, from x = 3 to rest at 0 in least time: its force is the weaker one, so it has to swing."""
    swing = double_integrator(
        lagrangian=lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2,
        t_span=(0.0, 5.0),
        start=[3.0],
        end=[0.0],
        running_cost=lambda t, x, v, u: 1 + 0 * u[0],
        control_bounds=(-1.0, 1.0),
        duration_bounds=(0.5, 30.0),
    )
    path = cg.solve(swing, cg.Galerkin(4), intervals=30)
    assert "from 4 times the duration, after IPOPT stopped with 'Infeasible" in path.solver
    assert path.t[-1] == pytest.approx(np.pi + 2 * np.arcsin(0.75), rel=2e-3)  # semicircles about 1 and -1


def test_a_longer_duration_that_leads_nowhere_is_told():
    far = double_integrator(end=[100.0], control_bounds=(-1.0, 1.0), duration_bounds=(0.5, 10.0))
    with pytest.raises(cg.ConvergenceError, match="IPOPT found no path from 4 times the duration, either"):
        cg.solve(far, cg.Galerkin(3), intervals=10)


@pytest.mark.slow
def test_the_straight_line_is_begun_from_where_a_guess_leads_nowhere():
    """Of 40 guesses for this acrobot, 11 led nowhere."""
    program = cg.transcribe(guesses.acrobot(), cg.Galerkin(guesses.DEGREE), guesses.INTERVALS)
    wild = guesses.guess(program.problem, seed=3)
    path, straight = program.solve(guess=(wild.x, wild.u)), program.solve()
    assert re.match(r"IPOPT \(.*\), from the straight line, after IPOPT stopped with 'Infeasible", path.solver)
    assert path.cost == pytest.approx(straight.cost, rel=1e-9)
    assert path.iterations > straight.iterations + 50
    assert "straight line" not in program.solve(guess=path).solver


def test_a_straight_line_on_which_a_callable_is_not_finite_is_no_start():
    """The guess leaps over the gap in which the cost is not defined, and the straight line is within."""
    pushed = double_integrator(
        end=[0.0],
        running_cost=lambda t, x, v, u: u[0] ** 2 / 2 + ca.sqrt((x[0] - 0.05) ** 2 - 0.0064),
        control_bounds=(1.0, 2.0),
    )
    program = cg.transcribe(pushed, cg.Galerkin(4), intervals=2)
    with pytest.raises(ValueError, match="not finite"):
        program.solve()
    with pytest.raises(cg.ConvergenceError, match="IPOPT found no path from the straight line, either"):
        program.solve(guess=lambda t: [8 * t * (1 - t)])


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


@pytest.mark.parametrize("kinked", [lambda u: ca.if_else(u > 0, u, 0), *slow(lambda u: ca.fmax(0, u))])
@pytest.mark.slow
def test_a_cost_with_a_kink_that_stops_the_solver_is_named(kinked):
    problem = double_integrator(running_cost=lambda t, x, v, u: kinked(u[0]) + u[0] ** 2, control_bounds=(-20.0, 20.0))
    with pytest.raises(cg.ConvergenceError, match=r"Maximum Iterations .* cost holds .*fmax, fmin, a comparison"):
        cg.solve(problem, cg.Galerkin(3), 10)
    lifted = double_integrator(
        controls=2,
        force=lambda t, x, v, u: u[0],
        running_cost=lambda t, x, v, u: u[1] + u[0] ** 2,
        path_constraint=(lambda t, x, v, u: [u[1] - u[0], u[1]], 0.0, np.inf),
    )
    assert cg.solve(lifted, cg.Galerkin(3), 20).cost == pytest.approx(13.4852, rel=1e-3)


@pytest.mark.slow
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
    smooth, smoother = (
        cg.solve(carried(lambda u, e=e: ca.sqrt(ca.sumsqr(u) + e)), cg.Galerkin(3), 10, guess=guess)
        for e in (1e-6, 1e-8)
    )
    assert smoother.cost == pytest.approx(smooth.cost, rel=1e-3)
