"""What errors are measured against: an exact, solved or given path, or one that is refused."""

from importlib import import_module

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator, first_order

import casadi_galerkin as cg

INTERVALS = (4, 8, 16, 32)
REFERENCE = 1e-12  # own error of a solved reference, with room to its roundoff of some 1e-15


@pytest.mark.slow
def test_solved_and_exact_reference_give_the_same_errors(oscillator, measured):
    exact = cg.trade(oscillator, [cg.Galerkin(1), cg.Galerkin(2)], INTERVALS, reference=lambda t: [np.sin(t)])
    assert measured.reference_error < REFERENCE
    assert exact.reference_error == 0.0
    for ours, theirs in zip(measured.rows, exact.rows, strict=False):
        for name in ("error", "joint_error"):
            assert getattr(ours, name) == pytest.approx(getattr(theirs, name), rel=1e-9, abs=3 * REFERENCE)


@pytest.mark.slow
def test_errors_are_those_of_a_fresh_solve(oscillator, measured):
    worst = measured.rows[4]
    path = cg.solve(oscillator, worst.method, worst.intervals)
    at = np.linspace(0, 2, 4001)
    between, joints = np.abs(path(at)[0] - np.sin(at)), np.abs(path.x[0] - np.sin(path.t))
    assert worst.error == pytest.approx(between.max(), rel=1e-3, abs=0)  # both sample a curve's maximum
    # the component's size, 1, is the largest value where both are compared, some 3e-5 short of the maximum between
    assert worst.joint_error == pytest.approx(joints.max(), rel=1e-4, abs=0)


def path_of(lagrangian, t_span, *ends, **changes):
    return cg.solve(cg.BoundaryProblem(lagrangian, t_span, *ends, **changes), cg.Galerkin(3), 4)


def free(t, x, v):
    return ca.sumsqr(v) / 2


@pytest.mark.parametrize(
    ("reference", "error", "message"),
    [
        (path_of(free, (0, 1), [0.0], [1.0]), ValueError, r"reference must be a path of 2 components, got 1"),
        (path_of(free, (0, 2), [0, 0], [1, 1]), ValueError, r"reference must run from 0\.0 to 1\.0, got 0\.0 to 2\.0"),
        (lambda t: t, ValueError, r"the reference must return an array of shape \(2,\), got \(\)"),
        (lambda t: [t], ValueError, r"the reference must return an array of shape \(2,\), got \(1,\)"),
        (lambda t: [t, np.nan], ValueError, r"the reference must be finite, got \[ 0\. nan\] at t = 0"),
        (lambda t: ["a", "b"], TypeError, "values of the reference must be real numbers, got"),
        ("x", TypeError, r"the reference must be a Trajectory or a callable t -> \(2,\), got 'x'"),
    ],
    ids=["components", "span", "scalar", "length", "nan", "text", "no path"],
)
def test_a_reference_that_does_not_fit_is_refused_before_any_cell(reference, error, message, monkeypatch):
    module = import_module("casadi_galerkin.studies.trade")
    monkeypatch.setattr(module, "_measured", lambda *given: pytest.fail("solved before the reference was checked"))
    problem = cg.BoundaryProblem(free, (0.0, 1.0), [0.0, 0.0], [1.0, 1.0])
    with pytest.raises(error, match=message):
        cg.trade(problem, [cg.Galerkin(2)], [4], reference=reference)


@pytest.mark.slow
def test_a_kink_that_tolerances_resolve_is_resolved_by_the_reference():
    """On equal intervals its own error was 1e-4; those of the way to the tolerance are some 1e-8."""
    kink = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2 + ca.if_else(t < 1.1, 0.0, 1.0) * x[0], (0.0, 2.0), [0.0], [1.0]
    )
    measured = cg.trade(kink, [cg.Galerkin(3)], [8], tolerances=[1e-5])
    assert measured.reference_error < 1e-7
    assert measured.cheapest(1e-5).tol == 1e-5


@pytest.mark.slow
def test_a_reference_across_a_jump_of_the_control_has_a_joint_there():
    """Else the energy along its polynomial would err around the jump, where ways to a tolerance have a joint."""
    fastest = double_integrator(
        running_cost=lambda t, x, v, u: 1.0, control_bounds=(-1.0, 0.5), duration_bounds=(0.5, 10.0)
    )
    measured = cg.trade(fastest, [cg.Galerkin(3)], [8], tolerances=[1e-3])
    assert measured.reference_error < 1e-5


def test_periodic_paths_count_their_first_joint_once():
    forced = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 + x[0] * ca.cos(t), (0.0, 2 * np.pi), [None], periodic=True
    )
    measured = cg.trade(forced, [cg.Galerkin(3)], (8,))
    assert measured.rows[0].unknowns == 24


def test_parameters_reach_the_reference():
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * x[0] ** 2 / 2, (0.0, 1.0), [0.0], [np.sin(2.0)], parameters=[4.0]
    )
    measured = cg.trade(problem, [cg.Galerkin(8)], (8,), reference=lambda t: [np.sin(2 * t)])
    assert measured.rows[0].error < REFERENCE


@pytest.mark.slow
def test_a_quantity_is_relative_to_its_value_on_the_reference(oscillator):
    """The position at t = 1 under a reference of sin(t) that is half of it, then all of it."""
    row = cg.trade(oscillator, [cg.Galerkin(8)], [8], lambda t: [np.sin(t) / 2], of=lambda path: path(1.0)[0])
    assert row.rows[0].error == pytest.approx(1.0, rel=REFERENCE)
    exact = cg.trade(oscillator, [cg.Galerkin(8)], [8], lambda t: [np.sin(t)], of=lambda path: path(1.0)[0])
    assert exact.rows[0].error < REFERENCE


def test_a_quantity_that_vanishes_has_an_absolute_error(oscillator):
    still = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0.0, 1.0), [1.0], [2.0])
    measured = cg.trade(still, [cg.Galerkin(1)], [2], lambda t: [1 + t], of=lambda path: path(0.0)[0] - 1.0)
    assert measured.rows[0].error < REFERENCE


@pytest.mark.parametrize(("value", "error"), [(None, TypeError), (np.nan, ValueError), ("far", TypeError)])
def test_a_quantity_that_is_no_number_is_refused_before_any_cell(oscillator, value, error, monkeypatch):
    module = import_module("casadi_galerkin.studies.trade")
    monkeypatch.setattr(module, "_measured", lambda *given: pytest.fail("solved before the quantity was tried"))
    with pytest.raises(error, match=r"of (must return finite|returns must be real) numbers, got"):
        cg.trade(oscillator, [cg.Galerkin(2)], [4], lambda t: [np.sin(t)], of=lambda path: value)


def test_a_way_whose_quantity_is_not_defined_fails_alone(oscillator):
    def at_the_finest_joint(path):
        return path.x[0, 1] if len(path.t) > 5 else np.nan

    coarse, fine = cg.trade(oscillator, [cg.Galerkin(4)], [4, 8], of=at_the_finest_joint).rows
    assert coarse.failure == "of must return finite numbers, got nan"
    assert fine.failure is None


def test_an_exception_of_a_quantity_is_a_failure_that_names_it(oscillator):
    coarse, fine = cg.trade(oscillator, [cg.Galerkin(4)], [4, 8], of=lambda path: path.momentum[0, 5]).rows
    assert coarse.failure.startswith("of raised IndexError(")
    assert fine.failure is None
    with pytest.raises(ValueError, match="of raised KeyError"):
        cg.trade(oscillator, [cg.Galerkin(4)], [4], lambda t: [np.sin(t)], of=lambda path: {}["reach"])


def test_a_callable_of_many_waves_is_compared_between_the_joints(oscillator):
    measured = cg.trade(oscillator, [cg.Galerkin(8)], [4], lambda t: [np.sin(t) + 1e-6 * abs(np.sin(9e3 * t))])
    assert measured.rows[0].error == pytest.approx(1e-6, rel=0.01)


def free_durations():
    """A ball thrown up with a given energy, at 6 m/s, and a move of free duration."""
    fall = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 10 * x[0], (0.0, 1.0), [0.0], [1.0], energy=18.0)
    return [fall, double_integrator(running_cost=lambda t, x, v, u: 1 + u[0] ** 2 / 2, duration_bounds=(0.1, 5.0))]


@pytest.mark.parametrize("problem", free_durations(), ids=["energy", "bounds"])
def test_where_the_duration_is_free_a_reference_has_its_own(problem):
    fine = cg.solve(problem, tol=1e-10)
    assert fine.t[-1] != problem.t_span[1]
    assert cg.trade(problem, [cg.Galerkin(4)], [8], fine).rows[0].error < 1e-8


@pytest.mark.parametrize("problem", free_durations(), ids=["energy", "bounds"])
def test_where_the_duration_is_free_a_callable_is_no_reference(problem):
    with pytest.raises(TypeError, match="where the duration is free, the reference must be a Trajectory, got"):
        cg.trade(problem, [cg.Galerkin(2)], [4], lambda t: [6 * t - 5 * t**2])


@pytest.mark.parametrize("kind", ["boundary", "initial", "rates"])
def test_paths_at_rest_are_compared(kind):
    """At rest, and where all components follow rates."""
    still = lambda t, x, v: v[0] ** 2 / 2  # noqa: E731
    problem = {
        "boundary": lambda: cg.BoundaryProblem(still, (0.0, 1.0), [1.0], [1.0]),
        "initial": lambda: cg.InitialProblem(still, (0.0, 1.0), [1.0], velocity=[0.0]),
        "rates": first_order,
    }[kind]()
    row = cg.trade(problem, [cg.Galerkin(2)], [4]).rows[0]
    assert row.error < REFERENCE
