"""Controls that act alike are made continuous, and what they miss between the points counts as an error."""

from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
from control_problems import minimum_time, pendulum, plane
from scipy.integrate import solve_ivp
from slow import slow

import casadi_galerkin as cg
from casadi_galerkin.control.continuous_controls import continuous_controls
from casadi_galerkin.solution.control_path import ControlPath

WEIGHT = 0.3


def steered(**changes):
    """From rest to rest in least time, by a thrust whose direction is the control."""
    stated = {
        "lagrangian": lambda t, x, v: ca.sumsqr(v) / 2 - WEIGHT * x[1],
        "t_span": (0, 3),
        "end": [2, 1],
        "force": lambda t, x, v, u: [ca.cos(u[0]), ca.sin(u[0])],
        "running_cost": lambda t, x, v, u: 1.0,
        "controls": 1,
        "duration_bounds": (0.5, 20),
    }
    return plane(**(stated | changes))


@lru_cache
def arrived(tol):
    return cg.solve(steered(), tol=tol)


def flown(path):
    """Where SciPy arrives with the controls as a function of time."""
    state = np.zeros(4)
    for start, end in zip(path.t[:-1], path.t[1:], strict=True):
        before_end = np.nextafter(end, start)

        def rates(t, y, last=before_end):
            angle = path.control(min(t, last))[0]
            return [y[2], y[3], np.cos(angle), np.sin(angle) - WEIGHT]

        state = solve_ivp(rates, (start, end), state, rtol=1e-10, atol=1e-12).y[:, -1]
    return state


@pytest.mark.parametrize("tol", [1e-4, *slow(1e-6)])
@pytest.mark.slow
def test_an_angle_is_found_that_can_be_flown(tol):
    path = arrived(tol)
    np.testing.assert_allclose(flown(path), [2, 1, 0, 0], rtol=0, atol=tol)
    assert np.ptp(path.control.values) < np.pi  # without turns


@pytest.mark.slow
def test_the_angle_of_a_fixed_mesh_is_continuous_too():
    path = cg.solve(steered(), cg.Galerkin(6), 10)
    np.testing.assert_allclose(flown(path), [2, 1, 0, 0], rtol=0, atol=1e-6)


def scrambled(path):
    """The same path with turns added to its control, at random."""
    turns = np.random.default_rng(0).integers(-3, 4, path.control.values.shape)
    control, values = path.control, path.control.values + 2 * np.pi * turns
    return replace(path, control=ControlPath(control.mesh, control.points, values, control.rule))


def continued(path):
    transcription = cg.transcribe(path.problem, path.method, mesh=path.t)
    (chain,) = transcription.numbering.chains
    values = path.control.values.T.reshape(chain.intervals, -1, chain.controls)
    found = continuous_controls(path.problem, chain, path.polynomial, {"controls": values})
    return values, found.reshape(-1, chain.controls).T


@pytest.mark.slow
def test_turns_are_taken_away():
    path = arrived(1e-6)
    _, found = continued(scrambled(path))
    turns = (found - path.control.values) / (2 * np.pi)
    np.testing.assert_allclose(turns, turns[0, 0], rtol=0, atol=1e-9)


@pytest.mark.slow
def test_turns_are_taken_away_where_a_component_of_the_force_is_rounding():
    """Along a line the thrust has the angle 0 or π, and its other component is zero up to rounding."""
    angles = np.repeat([[[0.0]], [[np.pi]]], 3, axis=0) + np.zeros((6, 4, 1))
    turns = np.random.default_rng(1).integers(-3, 4, angles.shape)
    problem = steered()
    (chain,) = cg.transcribe(problem, cg.Galerkin(4), 6).numbering.chains
    path = cg.solve(problem, cg.Galerkin(4), 6).polynomial
    found = continuous_controls(problem, chain, path, {"controls": angles + 2 * np.pi * turns}).ravel()
    jumps = np.flatnonzero(np.abs(np.diff(found)) > 1e-9)
    assert jumps.tolist() in ([], [11])  # a half turn may remain
    np.testing.assert_allclose(np.cos(found), np.cos(angles).ravel(), rtol=0, atol=1e-12)


@pytest.mark.parametrize("problem", [pendulum(3.0), minimum_time(), steered(control_bounds=(-10, 10))], ids=str)
def test_controls_that_are_continuous_or_jump_between_bounds_are_kept(problem):
    path = cg.solve(problem, cg.Galerkin(4), 6)
    values, found = continued(path)
    np.testing.assert_array_equal(found, values.reshape(-1, values.shape[-1]).T)


@pytest.mark.slow
def test_an_angle_stays_within_its_bounds():
    path = arrived(1e-6)
    path = replace(path, problem=steered(control_bounds=(-10, 10), t_span=path.problem.t_span))
    values, found = continued(scrambled(path))
    inside = np.abs(values.reshape(-1, 1).T) < 10
    assert np.max(np.abs(found[inside])) < 10
    np.testing.assert_array_equal(found[~inside], values.reshape(-1, 1).T[~inside])


@pytest.mark.slow
def test_the_misfit_tells_how_far_a_flight_with_controls_misses():
    path = arrived(1e-6)
    wrong = scrambled(path)
    assert path.control_misfit.sum() <= 1e-6
    missed = np.max(np.abs(flown(wrong) - [2, 1, 0, 0]))
    assert wrong.control_misfit.sum() > max(missed / 20, 0.1)


def test_the_misfit_is_of_the_order_of_the_method():
    coarse, fine = (cg.solve(pendulum(3.0), cg.Galerkin(2), n).control_misfit.sum() for n in (10, 20))
    assert np.log2(coarse / fine) == pytest.approx(4, abs=0.5)
