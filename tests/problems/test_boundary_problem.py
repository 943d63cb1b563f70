"""Boundary problems: what does not fit is refused, with what came and what was expected."""

from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from given import Series
from scenes import oscillator_problem

import casadi_galerkin as cg


@pytest.mark.parametrize(
    ("changes", "kind", "message"),
    [
        ({"end": [1.0, 2.0]}, ValueError, r"end must have 1 component, got 2"),
        ({"start": []}, ValueError, r"start must have components, got 0"),
        ({"start": [0.0, 0.0], "end": 1.0}, ValueError, "end must have 2 components, got 1: 1.0"),
        ({"start": "0"}, TypeError, "start must be a sequence of numbers.* got '0'"),
        ({"start": (v for v in [0.0])}, TypeError, "start must be a sequence of numbers.* got <generator"),
        ({"start": np.array(0.0)}, (TypeError, ValueError), "start must be"),
        ({"start": np.zeros((1, 1))}, ValueError, r"start must be one-dimensional, got an array of shape \(1, 1\)"),
        ({"start": ca.DM([[0.0, 1.0], [2.0, 3.0]])}, ValueError, "start must be one-dimensional"),
        ({"start": ca.MX.sym("x", 1)}, TypeError, r"start must be a sequence of numbers.* got MX"),
        ({"start": ca.SX.sym("x", 1)}, TypeError, r"start must be a sequence of numbers.* got SX"),
        ({"start": ["0.0"]}, TypeError, r"start\[0\] must be a number, got '0.0'"),
        ({"start": [True]}, TypeError, r"start\[0\] must be a number, got True"),
        ({"start": [1j]}, TypeError, r"start\[0\] must be a number, got 1j"),
        ({"start": [[0.0], [0.0, 1.0]]}, TypeError, r"start\[0\] must be a number, got \[0.0\]"),
        ({"start": {"x": 0.0}}, TypeError, "start must be a sequence of numbers.* got {'x': 0.0}"),
        ({"start": None}, TypeError, "start must be a sequence of numbers.* got None"),
        ({"start": [10**400]}, ValueError, r"start\[0\] must be finite, got inf"),
        ({"start": np.ma.array([0.0], mask=[True])}, ValueError, r"start must have no masked values, got one at \[0\]"),
        ({"start": np.array(["2020"], "M8[ns]")}, TypeError, r"start\[0\] must be a number, got .*datetime64"),
        ({"end": True, "periodic": True}, TypeError, "end must be a sequence of numbers.* got True"),
        ({"end": [np.nan]}, ValueError, r"end\[0\] must be finite, got nan"),
        ({"end": [np.inf]}, ValueError, r"end\[0\] must be finite, got inf"),
        ({"end": None}, ValueError, r"end must have 1 component, got None; None is for a periodic path"),
        ({"periodic": True}, ValueError, r"a periodic path ends where it starts: leave out end, got \[1.0\]"),
        ({"periodic": "yes", "end": None}, TypeError, "periodic must be True or False, got 'yes'"),
        ({"t_span": (1.0, 0.0)}, ValueError, r"t_span must increase, got \(1.0, 0.0\)"),
        (
            {"t_span": (0.0, 1e300)},
            ValueError,
            r"t_span must increase, got \(0.0, 1e\+300\), by 1e-150 to 1e\+150 units of time",
        ),
        ({"t_span": (1.0, 1.0)}, ValueError, r"t_span must increase, got \(1.0, 1.0\)"),
        ({"t_span": (0.0,)}, ValueError, r"t_span must have 2 components, got 1"),
        ({"t_span": np.linspace(0, 1, 99)}, ValueError, r"two times, \(t_0, t_N\), got 99 numbers; .* by mesh$"),
        ({"t_span": (0.0, None)}, ValueError, r"t_span must be all numbers, got \(0.0, None\)"),
        ({"t_span": (0.0, np.inf)}, ValueError, r"t_span\[1\] must be finite, got inf"),
        ({"t_span": 1.0}, TypeError, "t_span must be a sequence of numbers.* got 1.0"),
        ({"parameters": [None]}, ValueError, r"parameters must be all numbers, got \[None\]"),
        ({"breakpoints": None}, TypeError, "breakpoints must be a sequence of numbers.* got None"),
        ({"parameters": "2.0"}, TypeError, "parameters must be a sequence of numbers.* got .2.0."),
        ({"parameters": []}, ValueError, r"parameters must have components, got 0"),
    ],
    ids=lambda value: str(value)[:40] if isinstance(value, dict) else "",
)
def test_a_problem_that_does_not_fit_is_refused(changes, kind, message):
    with pytest.raises(kind, match=message):
        oscillator_problem(**changes)


@pytest.mark.parametrize(
    "numbers",
    [
        np.array([0, 1]),
        (0, 1),
        range(2),
        [np.float32(0), np.int64(1)],
        [np.array(0.0), Fraction(1)],
        np.array([0, 1], dtype=object),
        np.ma.array([0.0, 1.0]),
        ca.DM([0, 1]),
        ca.DM([[0, 1]]),
        Series({1: 0.0, 0: 1.0}),
    ],
    ids=lambda given: type(given).__name__,
)
def test_numbers_of_any_kind_are_taken(numbers):
    free = oscillator_problem(lagrangian=lambda t, x, v: ca.sumsqr(v), start=numbers, end=numbers)
    assert free.start == free.end == oscillator_problem(t_span=numbers).t_span == (0.0, 1.0)
    assert all(type(value) is float for value in free.start)


def one(t, x, v):
    return ca.sumsqr(v) / 2


@pytest.mark.parametrize(
    ("changes", "kind", "message"),
    [
        (
            {"end_velocity": [1.0]},
            ValueError,
            r"only one of position, velocity and momentum may be given at an end, got end\[0\] = 1.0 and end_velo",
        ),
        (
            {"start": [None], "start_velocity": [1.0], "start_momentum": [2.0]},
            ValueError,
            r"got start_velocity\[0\] = 1.0 and start_momentum\[0\] = 2.0",
        ),
        ({"end": [None], "end_velocity": [1.0, 2.0]}, ValueError, r"end_velocity must have 1 component, got 2"),
        ({"end": [None], "end_momentum": ["1"]}, TypeError, r"end_momentum\[0\] must be a number, got '1'"),
        ({"end": [None], "end_momentum": "1"}, TypeError, "end_momentum must be a sequence of numbers.* got .1."),
        (
            {"end": None, "periodic": True, "start_velocity": [1.0], "end_action": lambda x0, x1: x1[0]},
            ValueError,
            "a periodic path has no ends: leave out start_velocity, end_action",
        ),
        (
            {"end_action": lambda x0, x1: x1[0] ** 2},
            ValueError,
            "end_action depends on no component that is free at the ends, so it changes nothing",
        ),
        (
            {"end_conditions": lambda x0, x1: x1[0] - x0[0]},
            ValueError,
            "end_conditions depends on no component that is free at the ends, so it changes nothing",
        ),
        (
            {"end": [None], "end_conditions": lambda x0, x1: [x1[0] - 1, x1[0] ** 2]},
            ValueError,
            r"end_conditions are 2, but only 1 can be met by the 1 value free at the ends: leave out",
        ),
        (
            {"end": [None], "end_velocity": [1.0], "end_conditions": lambda x0, x1: x1[0] - 1},
            ValueError,
            "end_conditions depends on end component 0, where end_velocity is given: leave out one",
        ),
        (
            {"start": [None], "start_momentum": [1.0], "end_action": lambda x0, x1: x0[0] ** 2},
            ValueError,
            "end_action depends on start component 0, where start_momentum is given: leave out one",
        ),
        ({"end": [None], "end_action": lambda x0, x1: [x1[0], 1]}, TypeError, "end_action must return a CasADi exp"),
        ({"end": [None], "end_action": lambda x1: x1[0]}, TypeError, r"end_action is called as end_action\(x0, x1\)"),
        ({"end": [None], "end_conditions": lambda x0, x1: x1[1]}, ValueError, "an index is out of range.* x1 has 1"),
        ({"end_conditions": 1.0}, TypeError, r"end_conditions must be a callable of \(x0, x1\), got 1.0"),
    ],
    ids=lambda value: ", ".join(value) if isinstance(value, dict) else "",
)
def test_ends_that_contradict_one_another_are_refused(changes, kind, message):
    with pytest.raises(kind, match=message):
        oscillator_problem(**changes)


def test_components_of_which_nothing_is_given_are_as_if_left_out():
    stated = cg.BoundaryProblem(one, (0, 1), [0.0, None], [1.0, None], end_velocity=[None, None])
    assert "end_velocity" not in repr(stated)
    assert stated.end_velocity == (None, None)


def test_a_problem_says_what_it_states():
    problem = cg.BoundaryProblem(
        one,
        (0, 1),
        [0.0, None, None],
        [None, None, 3.0],
        constraint=lambda t, x: x[1] - x[0],
        start_momentum=[None, None, 1.0],
        end_momentum=[0.5, None, None],
        end_action=lambda x0, x1: x1[1] ** 2,
        end_conditions=lambda x0, x1: x1[1] - x0[1] - 1,
        energy=2.0,
    )
    words = (
        "start (0.0, None, None), end (None, None, 3.0), constraint, start_momentum (None, None, 1.0), end_momentum "
    )
    assert words + "(0.5, None, None), end_action, end_conditions, energy 2.0" in repr(problem)
    assert "force" not in repr(problem)


@pytest.mark.parametrize("name", ["start_velocity", "end_velocity"])
def test_velocities_that_a_constraint_would_not_keep_are_refused(name):
    ends = (
        {"start": [None, None], "end": [0.0, -1.0]}
        if name == "start_velocity"
        else {"start": [0.0, -1.0], "end": [None, None]}
    )
    with pytest.raises(
        ValueError, match=f"a constraint leaves only tangent velocities: instead of {name} give the mom"
    ):
        cg.BoundaryProblem(
            lambda t, x, v: ca.dot(v, v) / 2 - x[1],
            (0.0, 1.0),
            **ends,
            constraint=lambda t, x: ca.dot(x, x) - 1,
            **{name: [1.0, 1.0]},
        )


@pytest.mark.parametrize("t_span", [(0.0, 0.5), (1.0, 2.0), (0.0, 0.7), (0.7, 2.0)])
def test_another_time_span_must_hold_the_breakpoints(t_span):
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0.0, 2.0), [0.0], [1.0], breakpoints=[0.7])
    with pytest.raises(ValueError, match=r"breakpoints must increase inside of .*, got \(0.7,\)"):
        problem.varied({}, t_span)
    with pytest.raises(ValueError, match=r"breakpoints must increase inside of .*, got \(0.7,\)"):
        cg.transcribe(problem, tol=1e-6).solve(t_span=t_span)
    assert problem.varied({}, (0.5, 1.0)).t_span == (0.5, 1.0)


def test_the_time_span_of_a_varied_problem_is_checked_and_may_be_left_out():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0.0, 2.0), [0.0], [1.0])
    with pytest.raises(ValueError, match=r"t_span must increase, got \(1.0, 0.0\)"):
        problem.varied({}, (1.0, 0.0))
    assert problem.varied({"end": [2.0]}).t_span == (0.0, 2.0)


def test_a_variation_by_the_sign_of_a_zero_is_one():
    """On a branch cut the sign tells the side: the second parameter pushes as hard as the first, the other way."""
    L = lambda t, x, v, p: v[0] ** 2 / 2 + ca.atan2(p[0], -1.0) * x[0]  # noqa: E731
    above = cg.BoundaryProblem(L, (0.0, 1.0), [0.0], [0.0], parameters=[0.0])
    below = above.varied({"parameters": [-0.0]})
    assert str(below.parameters) == "(-0.0,)"
    transcription = cg.transcribe(above, cg.Galerkin(2), 4)
    one, other = (transcription.solve(parameters=p).x for p in ([0.0], [-0.0]))
    np.testing.assert_allclose(one, -other, rtol=1e-12, atol=1e-14)
    assert np.min(one) < -0.3  # -π/8 in the middle


@pytest.mark.parametrize("name", ["breakpoints", "periodic", "lagrangian", "ends"])
def test_what_cannot_be_varied_is_named(name):
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0.0, 2.0), [0.0], [1.0], breakpoints=[1.0])
    with pytest.raises(ValueError, match=rf"what can be varied is start, .*, energy, got {name}=\[5.0\]"):
        problem.varied({name: [5.0]})
