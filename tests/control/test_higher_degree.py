"""The path of a higher degree on the same mesh, and the errors that it tells of paths on meshes that were given."""

from dataclasses import replace

import numpy as np
import pytest
from control_problems import cart_pole, double_integrator, everything, minimum_time, pendulum, staged
from slow import slow

import casadi_galerkin as cg
from casadi_galerkin.control import transcription
from casadi_galerkin.control.higher_degree import perturbed

SHARP = 10.0  # estimated over true error of a cost that is resolved


def test_a_perturbed_path_jumps_where_the_path_does():
    """It jumped at every joint by the part of its size by which it is perturbed."""
    path = cg.solve(staged(), cg.Galerkin(3), 10)
    away = perturbed(path, 1e-3).polynomial
    assert len(path.polynomial.jumps) == 1
    np.testing.assert_array_equal(away.jumps, path.polynomial.jumps)
    assert 1e-5 < np.max(np.abs(away.local - path.polynomial.local)) < 1e-2


def reference(path):
    """A path of much higher degree: with held controls on the same intervals, else on half as long ones."""
    count = len(path.t) - 1
    mesh = path.t if path.problem.hold else np.interp(np.linspace(0, count, 2 * count + 1), range(count + 1), path.t)
    return cg.solve(path.problem, cg.Galerkin(path.method.degree + 4), mesh=mesh, guess=path)


def true_errors(path, fine):
    """Relative errors of cost and path, at the same fractions of the duration."""
    parts = np.linspace(0, 1, 1001)
    x, exact = (p(p.t[0] + parts * np.ptp(p.t)) for p in (path, fine))
    return abs(path.cost - fine.cost) / path.cost_size, np.max(np.abs(x - exact) / path.sizes[:, None])


@pytest.mark.parametrize("intervals", [12, *slow(24)])
@pytest.mark.parametrize("stated", [*slow(cart_pole), lambda: pendulum(3.0), lambda: pendulum(3.0, hold=True), staged])
def test_errors_on_a_given_mesh_are_known_when_asked_for(stated, intervals):
    path = cg.solve(stated(), cg.Galerkin(3), intervals)
    assert (path.error_estimate, path.cost_error) == (None, None)
    fine = reference(path)
    of_cost, of_path = true_errors(path, fine)
    assert path.estimate_error() == path.error_estimate
    assert 0.8 * of_path <= path.error_estimate <= SHARP * of_path
    assert of_cost <= path.cost_error <= SHARP * of_cost
    assert f"{path.cost_error:.1e} of the cost" in repr(path)


def test_a_jump_inside_an_interval_is_seen_on_a_given_mesh():
    """Both degrees share the wrong time of the switch."""
    path = cg.solve(minimum_time(), cg.Galerkin(3), 5)
    path.estimate_error()
    assert 1e-4 < abs(path.cost / 2 - 1) <= path.cost_error < 0.1


@pytest.mark.parametrize("solver", [cg.ipopt, cg.fatrop])
def test_a_path_that_the_degree_holds_has_errors_of_the_solver_only(solver):
    path = cg.solve(double_integrator(), cg.Galerkin(3), 4, solver=solver)
    assert path.estimate_error() < 1e-8
    assert path.cost_error < 1e-8


def test_an_estimate_is_kept_by_its_path_and_made_anew_for_a_copy():
    path = cg.solve(everything(), cg.Galerkin(3), 4)
    copy = replace(path)
    path.estimate_error()
    assert copy.error_estimate is None
    assert copy.estimate_error() == path.error_estimate


def test_where_the_higher_degree_has_no_answer_errors_are_infinite(monkeypatch):
    path = cg.solve(double_integrator(), cg.Galerkin(3), 4)

    def refused(*_, **__):
        raise cg.ConvergenceError("no path", None)

    monkeypatch.setattr(transcription.ControlTranscription, "solve", refused)
    assert (path.estimate_error(), path.cost_error) == (np.inf, np.inf)


def test_a_perturbation_from_which_nothing_is_found_is_left_out(monkeypatch):
    path, tried = cg.solve(double_integrator(), cg.Galerkin(2), 4), []
    solve = transcription.ControlTranscription.solve

    def unperturbed_only(self, *, guess, solver):
        tried.append(np.max(np.abs(guess.polynomial.values - path.polynomial.values)))
        if tried[-1] > 0:
            raise cg.ConvergenceError("no path", None)
        return solve(self, guess=guess, solver=solver)

    monkeypatch.setattr(transcription.ControlTranscription, "solve", unperturbed_only)
    assert 1e-4 < path.estimate_error() < 1
    assert len(tried) == 2
