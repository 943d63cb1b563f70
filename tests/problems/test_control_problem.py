"""Control problems that are stated badly are refused, with what came and what was expected."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator, first_order, plane

import casadi_galerkin as cg

BADLY_STATED = {
    "bounds that are a table": (
        {"control_bounds": {"lo": 0, "hi": 1}},
        TypeError,
        r"must be a pair \(lo, hi\), got {'lo'",
    ),
    "bounds that are masked": (
        {"control_bounds": np.ma.array([0, 1], mask=[0, 1])},
        ValueError,
        r"control_bounds must have no masked values, got one at \[1\]",
    ),
    "half a control": ({"controls": 1.0}, TypeError, "controls must be a whole number, got 1.0"),
    "start as a table": ({"start": {"x": 0}}, TypeError, "start must be a sequence of numbers.* got {'x': 0}"),
    "no start": ({"start": None}, TypeError, "give start, or the number of `components` where all of it is free"),
    "another number of components": ({"components": 2}, ValueError, "start must have 2 components, got 1"),
    "half a component": ({"components": 0.5}, TypeError, "components must be a whole number, got 0.5"),
    "no time": ({"t_span": None}, TypeError, "t_span must be a sequence of numbers, got None"),
    "cost of parameters": (
        {"running_cost": lambda t, x, v, u, p: u**2},
        TypeError,
        r"called as running_cost\(t, x, v, u\), .* If it takes p, give parameters",
    ),
    "bounds that contradict": (
        {"control_bounds": (1, -1)},
        ValueError,
        "control_bounds must have lo <= hi, got 1.0 and -1.0$",
    ),
    "a pair for each control": (
        {"controls": 2, "control_bounds": [(-1, 1), (-1, 1)], "force": lambda t, x, v, u: u[0]},
        ValueError,
        r"control_bounds must be \(lo, hi\), .* not a pair for each component: .* leaves nothing free",
    ),
    "bounds of a wrong length": ({"control_bounds": ([0, 0], 1)}, ValueError, "lo of control_bounds .* 1 number"),
    "bounds that are no pair": ({"control_bounds": 3}, TypeError, "must be a pair"),
    "bounds that are no numbers": ({"control_bounds": ("a", 1)}, TypeError, "lo of control_bounds"),
    "bounds with NaN": ({"control_bounds": (np.nan, 1)}, ValueError, "must be a number .* got nan"),
    "bounds with None": ({"control_bounds": (None, 1)}, TypeError, "lo of control_bounds, -inf where there is none"),
    "bounds in words": ({"control_bounds": ("-1", "1")}, TypeError, "lo of control_bounds, .* got '-1'"),
    "bounds without an order": ({"control_bounds": {0, 1}}, TypeError, r"must be a pair \(lo, hi\), got {0, 1}"),
    "bounds that are truths": (
        {"control_bounds": (False, True)},
        TypeError,
        "lo of control_bounds, .* must be real numbers, got False",
    ),
    "nothing above": (
        {"control_bounds": (np.inf, np.inf)},
        ValueError,
        "lo of control_bounds must be a number .* got inf",
    ),
    "nothing below": (
        {"position_bounds": (-np.inf, [-np.inf])},
        ValueError,
        r"hi of position_bounds must be a number .* got \[-inf\]",
    ),
    "constraint of no value": (
        {"path_constraint": (lambda t, x, v, u: u, np.inf, np.inf)},
        ValueError,
        "lo of path_constraint must be a number .* -inf where there is none",
    ),
    "nested forces": (
        {"force": lambda t, x, v, u: [[u[0]]]},
        TypeError,
        "force must return one CasADi expression per component",
    ),
    "lagrangian as an expression": ({"lagrangian": ca.SX.sym("v") ** 2}, TypeError, "lagrangian must be a callable"),
    "force as a number": ({"force": 3.0}, TypeError, "force must be a callable"),
    "terminal cost of controls": ({"terminal_cost": lambda t, x, v, u: u}, TypeError, "terminal_cost is called as"),
    "end outside": ({"position_bounds": (-1, 0.5)}, ValueError, r"end\[0\] = 1.0 lies outside"),
    "start outside": ({"position_bounds": (0.5, 2)}, ValueError, r"start\[0\] = 0.0 lies outside"),
    "end outside the path": (
        {"path_constraint": (lambda t, x, v, u: x[0], -1, 0.5)},
        ValueError,
        "path constraint 0 is 1.0 at the end",
    ),
    "no duration": ({"t_span": (1, 1)}, ValueError, "t_span must increase"),
    "duration bound of zero": ({"duration_bounds": (0, 2)}, ValueError, "duration_bounds must be positive"),
    "duration guess outside": (
        {"duration_bounds": (2, 3)},
        ValueError,
        "the duration = 1.0 lies outside its duration_bounds",
    ),
    "controls below none": ({"controls": -1}, ValueError, "controls must be at least 0, got -1"),
    "u without controls": ({"controls": 0}, TypeError, r"force is called as force\(t, x, v\)"),
    "controls by name": ({"controls": "u"}, TypeError, "controls must be a whole number, got .u."),
    "unused control": (
        {"controls": 2, "force": lambda t, x, v, u: u[0]},
        ValueError,
        r"u\[1\] occurs in no force, rate, cost or constraint",
    ),
    "too many forces": (
        {"force": lambda t, x, v, u: [u[0], 0]},
        ValueError,
        "force must return a vector of length 1, got",
    ),
    "cost that is no scalar": (
        {"running_cost": lambda t, x, v, u: ca.vertcat(u, u)},
        ValueError,
        "running_cost must return a scalar",
    ),
    "cost that fails": ({"running_cost": lambda t, x, v, u: u[7]}, ValueError, "running_cost failed"),
    "path constraint alone": ({"path_constraint": ca.sin}, TypeError, r"path_constraint must be \(g, lo, hi\)"),
    "parameter bounds alone": ({"parameter_bounds": (0, 1)}, ValueError, "parameter_bounds need parameters"),
    "rates as numbers": ({"rates": 3}, TypeError, r"rates must be a callable of \(t, x, v, u\), got 3"),
    "more rates than components": (
        {"rates": lambda t, x, v, u: [u[0], 0]},
        ValueError,
        r"rates must be those of at most all 1 component, got 2 values",
    ),
    "mechanics of rates": (
        {"rates": lambda t, x, v, u: u},
        ValueError,
        "all components follow rates: leave out lagrangian, got",
    ),
    "no lagrangian": (
        {"lagrangian": None, "force": None},
        ValueError,
        r"nothing moves x\[0\]: give a lagrangian, or rates of all 1 component, got 0",
    ),
    "force without a lagrangian": (
        {"lagrangian": None, "rates": lambda t, x, v, u: u},
        ValueError,
        "all components follow rates: leave out force, got",
    ),
    "a component that nothing moves": (
        {"start": [0.0] * 3, "end": [1.0] * 3, "start_velocity": None, "end_velocity": None}
        | {"force": lambda t, x, v, u: [u, 0], "rates": lambda t, x, v, u: u},
        ValueError,
        r"the lagrangian ignores v\[1\]: .* nor is its rate among the rates, which are those of the last components",
    ),
    "condition alone": (
        {"end_conditions": lambda x0, v0, x1, v1: x1},
        TypeError,
        r"end_conditions must be \(g, lo, hi\), a callable g and .* its values, got",
    ),
    "condition of two arguments": (
        {"end_conditions": (lambda x0, x1: x1 - x0, 0, 0)},
        TypeError,
        r"end_conditions is called as end_conditions\(x0, v0, x1, v1\)",
    ),
    "condition that contradicts": (
        {"end_conditions": (lambda x0, v0, x1, v1: x1, 2, 0)},
        ValueError,
        "end_conditions must have lo <= hi, got",
    ),
    "condition that the ends violate": (
        {"end_conditions": (lambda x0, v0, x1, v1: [v1[0] ** 2, x1[0] - x0[0]], 0, [9, 0.5])},
        ValueError,
        r"end condition 1 is 1.0 with the ends given, outside its bounds \[0.0, 0.5\]",
    ),
    "breakpoint outside": (
        {"breakpoints": [0.5, 1.0]},
        ValueError,
        r"breakpoints.* must increase inside of \(0.0, 1.0\) by more than roundoff, got \(0.5, 1.0\)",
    ),
    "bounds of three phases": (
        {"breakpoints": [0.5], "duration_bounds": ([0.1, 0.1, 0.1], 2)},
        ValueError,
        r"lo of duration_bounds must be a number or 2 numbers, .* got \[",
    ),
    "a phase outside its bounds": (
        {"breakpoints": [0.3], "duration_bounds": (0.4, 2)},
        ValueError,
        r"the duration of the phase from 0.0 to 0.3 = 0.3 lies outside its duration_bounds",
    ),
    "equations of one end": (
        {"end": [None], "end_conditions": (lambda x0, v0, x1, v1: [x1[0] ** 2, ca.sin(x1[0])], [1, 2], [1, 2])},
        ValueError,
        "end_conditions with equal bounds are 2, but only 1 can be met by the 1 value free at the ends",
    ),
    "hold as a number": ({"hold": 1}, TypeError, "hold must be True or False, got 1"),
    "velocity of a wrong length": ({"end_velocity": [0, 0]}, ValueError, "end_velocity must have 1"),
}


@pytest.mark.parametrize("name", BADLY_STATED)
def test_badly_stated_problem_is_refused(name):
    changes, kind, message = BADLY_STATED[name]
    with pytest.raises(kind, match=message):
        double_integrator(**changes)


UNLIMITED = {
    "least time": {"running_cost": lambda t, x, v, u: 1, "duration_bounds": (0.1, 10)},
    "a cost of positions": {"running_cost": lambda t, x, v, u: x[0] ** 2},
    "a cost of velocities, between rests": {"running_cost": lambda t, x, v, u: v[0] ** 2},
    "a cost of the end": {"running_cost": None, "terminal_cost": lambda t, x, v: (x[0] - 2) ** 2},
    "a limit of the speed": {
        "running_cost": lambda t, x, v, u: 1,
        "duration_bounds": (0.1, 10),
        "path_constraint": (lambda t, x, v, u: v, -1, 1),
    },
}
LIMITED = {
    "bounds": UNLIMITED["least time"] | {"control_bounds": (-1, 1)},
    "a bound on the force": UNLIMITED["least time"] | {"path_constraint": (lambda t, x, v, u: u**2, 0, 1)},
    "a velocity that may begin and end anyhow": {
        "running_cost": lambda t, x, v, u: x[0] ** 2 + v[0] ** 2,
        "start_velocity": [None],
        "end_velocity": [None],
    },
    "a direction": UNLIMITED["least time"] | {"force": lambda t, x, v, u: ca.sin(u)},
    "an equation that determines it": UNLIMITED["least time"] | {"path_constraint": (lambda t, x, v, u: v - t, 0, 0)},
    "intervals on which it is held": UNLIMITED["a cost of positions"] | {"hold": True},
    "all paths cost the same": {"running_cost": lambda t, x, v, u: t},
}


@pytest.mark.parametrize("name", UNLIMITED)
def test_a_control_that_nothing_limits_is_refused(name):
    with pytest.raises(ValueError, match=r"nothing limits the control u\[0\].* impulse: .* Give control_bounds"):
        double_integrator(**UNLIMITED[name])


@pytest.mark.parametrize("name", LIMITED)
def test_a_control_that_something_limits_is_taken(name):
    assert double_integrator(**LIMITED[name]).controls == 1


def test_a_rate_that_nothing_limits_is_refused():
    with pytest.raises(ValueError, match=r"nothing limits the control u\[0\]"):
        first_order(running_cost=lambda t, x, v, u: x[0] ** 2)
    assert first_order(running_cost=lambda t, x, v, u: v[0] ** 2).mechanical == 0  # which is that of the rate


def test_a_duration_is_within_its_bounds_up_to_rounding():
    assert 0.1 + 0.2 - 0.1 > 0.2
    assert double_integrator(t_span=(0.1, 0.1 + 0.2), duration_bounds=(0.2, 0.2)).t_span == (0.1, 0.1 + 0.2)


def test_a_condition_is_met_by_ends_as_a_solve_leaves_them():
    def closed(end):
        return double_integrator(end=[end], end_conditions=(lambda x0, v0, x1, v1: x1 - x0, 1, 1))

    assert closed(1 + 1e-9).end == (1 + 1e-9,)
    with pytest.raises(ValueError, match=r"end condition 0 is 1\.000001 with the ends given"):
        closed(1 + 1e-6)


def test_parameter_guess_outside_its_bounds_is_refused():
    with pytest.raises(ValueError, match=r"parameters\[0\] = 3.0 lies outside"):
        double_integrator(
            lagrangian=lambda t, x, v, p: p * v[0] ** 2,
            force=lambda t, x, v, u, p: u,
            running_cost=lambda t, x, v, u, p: u**2,
            parameters=[3],
            parameter_bounds=(0, 1),
        )


@pytest.mark.parametrize(
    "pair", [(-1, 2), np.array([-1, 2]), np.array([[-1], [2]]), ca.DM([-1, 2]), (ca.DM([-1]), [2])]
)
def test_bounds_of_any_kind_are_read(pair):
    assert double_integrator(control_bounds=pair).control_bounds == ((-1.0,), (2.0,))


@pytest.mark.parametrize(
    ("waypoints", "kind", "message"),
    [
        ([(1.0, [1.0])], ValueError, r"at t = 1: waypoint must be a list of 2 positions, .* got \[1.0\]"),
        ([(3.0, [1.0, 1.0])], ValueError, r"must increase inside of \(0.0, 2.0\) by more than roundoff, got \(3.0,\)"),
        ([(1.0, [1.0, (2, 1)])], ValueError, r"at t = 1: the bounds of x\[1\] must have lo <= hi, got 2.0 and 1.0"),
        ([1.0], TypeError, r"waypoints must be pairs \(t, positions\) or .*, got 1.0"),
        ([("noon", [1, 2])], ValueError, "time of a waypoint must be a finite number, got 'noon'"),
        ([(1.0, [np.nan, 1])], ValueError, r"at t = 1: the lo of the bounds of x\[0\] must be .* got nan"),
        (3.0, TypeError, r"waypoints must be pairs \(t, positions\) or .*, got 3.0"),
        ([(1.0, [0.2, 0.0]), (1.0, [0.8, 0.0])], ValueError, "different times, got two at t = 1"),
        (
            [(0.3, [0.2, 0.0]), (0.1 + 0.2, [0.2, 0.0])],
            ValueError,
            r"must increase inside of .* by more than roundoff, got ",
        ),
    ],
)
def test_bad_waypoints_are_refused(waypoints, kind, message):
    with pytest.raises(kind, match=message):
        plane(waypoints=waypoints)


@pytest.mark.parametrize("second", [(-1, 2), np.array([-1, 2]), ca.DM([-1, 2])])
def test_bounds_of_any_kind_are_read_at_a_waypoint(second):
    assert plane(waypoints=[(1.0, [np.int64(1), second])]).waypoints == ((1.0, ((1.0, 1.0), (-1.0, 2.0))),)


def test_a_waypoint_beyond_the_position_bounds_is_refused():
    with pytest.raises(ValueError, match=r"at t = 1: waypoint bounds x\[0\] by \[3.0, 4.0\], outside .* \[-1.0, 2.0\]"):
        plane(waypoints=[(1.0, [(3.0, 4.0), None])], position_bounds=(-1.0, 2.0))


def test_a_free_parameter_of_the_constraint_alone_is_taken():
    rod = cg.ControlProblem(
        lambda t, x, v, p: ca.dot(v, v) / 2,
        (0.0, 1.0),
        [0.0, None],
        [1.0, None],
        [0.0, 0.0],
        [None, None],
        force=lambda t, x, v, u, p: [u[0], 0.0],
        running_cost=lambda t, x, v, u, p: u[0] ** 2,
        controls=1,
        parameters=[1.5],
        parameter_bounds=(1.2, 2.0),
        constraint=lambda t, x, p: ca.dot(x, x) - p[0] ** 2,
    )
    assert rod.parameter_bounds == ((1.2,), (2.0,))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"start_velocity": [0.0]}, r"x\[0\] follows a rate: start_velocity\[0\] must be None, got 0.0"),
        ({"rates": lambda t, x, v, u: u + v}, r"rates must not depend on v\[0\], the rate of x\[0\]"),
        ({"terminal_cost": lambda t, x, v: v[0]}, r"terminal_cost must not depend on v\[0\]"),
        ({"end_conditions": (lambda x0, v0, x1, v1: v1, 0, 0)}, r"end_conditions must not depend on v\[0\]"),
    ],
)
def test_what_depends_on_the_velocity_of_a_rate_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        first_order(**changes)


def test_a_lagrangian_of_the_velocity_of_a_rate_is_refused():
    fields = {"start": [0, 0], "end": [1, None], "start_velocity": [0, None], "end_velocity": [0, None]}
    with pytest.raises(ValueError, match=r"the lagrangian depends on v\[1\], but x\[1\] follows a rate"):
        double_integrator(
            lagrangian=lambda t, x, v: ca.sumsqr(v), force=lambda t, x, v, u: u, rates=lambda t, x, v, u: u, **fields
        )


def test_what_does_not_change_is_neither_traced_nor_checked_again():
    problem = double_integrator(start=[0.5], position_bounds=(0.0, 1.0))
    other = replace(problem, end=[0.25])
    assert (other.lagrangian, other.force) == (problem.lagrangian, problem.force)
    assert problem.varied({"start": None, "end": None}) is problem
    assert problem.varied({"start": [0.25]}).start == (0.25,)
    with pytest.raises(ValueError, match=r"start\[0\] = 2.0 lies outside its position_bounds"):
        problem.varied({"start": [2.0]})


def test_fields_of_problems_with_and_without_rates_are_replaced():
    changes = {"force": lambda t, x, v, u: u[0] + u[1], "running_cost": lambda t, x, v, u: ca.dot(u, u)}
    assert replace(double_integrator(), controls=2, control_bounds=(-1, 1), **changes).controls == 2
    longer = replace(first_order(), t_span=(0.0, 3.0))
    assert longer.t_span == (0.0, 3.0)
    assert longer.mechanical == 0
    assert "on (0.0, 3.0): start (0.0,), end (1.0,), running_cost, controls 1, rates, hold" in str(
        replace(longer, hold=True)
    )


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_ends_that_leave_their_bounds_by_rounding_alone_are_taken(unit):
    def between(low, high, **given):
        return double_integrator(position_bounds=(low * unit, high * unit), **given)

    beyond = between(0.0, 0.3, start=[-3e-17 * unit], end=[0.1 * 3 * unit], start_velocity=[-1e-17 * unit])
    assert beyond.varied({"end": [0.1 * 3 * unit]}).end == beyond.end == (0.1 * 3 * unit,)
    between(0.0, 0.3, end=[0.2 * unit], waypoints=[(0.5, [0.1 * 3 * unit])])
    for given in ({"end": [0.3 * (1 + 1e-14) * unit]}, {"start": [-1e-14 * unit], "end": [0.2 * unit]}):
        with pytest.raises(ValueError, match="lies outside its position_bounds"):
            between(0.0, 0.3, **given)


def test_an_end_meets_a_path_constraint_as_a_solve_leaves_it():
    limited = (lambda t, x, v, u: x[0], 0, 0.3)
    beyond = double_integrator(start=[-1e-9], end=[0.1 * 3], path_constraint=limited)
    assert (beyond.start, beyond.end) == ((-1e-9,), (0.1 * 3,))
    for free in ({}, {"duration_bounds": (0.5, 2)}):
        with pytest.raises(ValueError, match="path constraint 0 is -1e-06 at the start whatever the controls"):
            double_integrator(start=[-1e-6], end=[0.3], path_constraint=limited, **free)
    in_time = (lambda t, x, v, u: x[0] - t, -1.0, 0.0)
    with pytest.raises(ValueError, match=r"path constraint 0 is 1\.0 at the end whatever the controls"):
        double_integrator(end=[2.0], path_constraint=in_time)
    assert double_integrator(end=[2.0], path_constraint=in_time, duration_bounds=(0.5, 3)).end == (2.0,)


def test_a_given_end_keeps_to_a_path_constraint_in_small_units():
    with pytest.raises(
        ValueError, match=r"path constraint 0 is 1e-09 at the end whatever the controls, outside its bo"
    ):
        double_integrator(end=[1e-9], path_constraint=(lambda t, x, v, u: x[0], 0, 0.5e-9))
    assert double_integrator(start=[-1e-10], path_constraint=(lambda t, x, v, u: x[0], 0, 1)).start == (-1e-10,)


def test_a_problem_of_first_order_is_stated_by_keywords_alone():
    short = cg.ControlProblem(
        rates=lambda t, x, v, u: u - x,
        t_span=(0, 1),
        start=1.0,
        controls=1,
        running_cost=lambda t, x, v, u: x**2 + u**2,
    )
    assert (short.dimension, short.mechanical, short.end, short.start_velocity) == (1, 0, (None,), (None,))
    assert repr(short) == "ControlProblem of 1 component on (0.0, 1.0): start (1.0,), running_cost, controls 1, rates"
    assert repr(replace(short, end=2.0)).startswith("ControlProblem of 1 component on (0.0, 1.0): start (1.0,),")


def test_components_are_counted_where_the_start_is_free():
    free = cg.ControlProblem(
        rates=lambda t, x, v, u: [x[1], u],
        t_span=(0, 1),
        components=2,
        controls=1,
        running_cost=lambda t, x, v, u: ca.sumsqr(x - t) + u**2,
    )
    assert free.start == free.end == (None, None)


CONDITIONS = {
    "too few": (
        {"start": [0.0, None]},
        r"2 conditions determine the path, 1 for every rate; got 1, 1 by start: give more of them, or a cost",
    ),
    "none": ({"start": None, "components": 2}, "determine the path, 1 for every rate; got 0, none: give more"),
    "too many": ({"start": [0.0, 0.0], "end": [0.0, None]}, "got 3, 2 by start, 1 by end: leave out some"),
    "too many in all": (
        {"start": [0.0, None], "end": [0.0, None], "end_conditions": (lambda x0, v0, x1, v1: x0[1], 1, 1)},
        "got 3, 1 by start, 1 by end, 1 by end_conditions: leave out some",
    ),
    "a waypoint too many": (
        {"start": [0.0, 0.0], "waypoints": [(0.5, [1.0, None])]},
        "got 3, 2 by start, 1 by waypoints: leave out some",
    ),
    "one less than a parameter needs": (
        {"start": [0.0, 0.0], "parameters": 1.0, "parameter_bounds": (0, 2), "rates": lambda t, x, v, p: [x[1], p]},
        "3 conditions determine the path, 1 for every rate and 1 for every free parameter; got 2, 2 by start",
    ),
    "mechanics": (
        {"lagrangian": lambda t, x, v: v[0] ** 2, "rates": lambda t, x, v: x[0], "start": [0.0, 0.0]},
        "3 conditions determine the path, 2 for every component with an equation of motion and 1 for every rate; got 2",
    ),
}


@pytest.mark.parametrize("name", CONDITIONS)
def test_conditions_without_controls_are_counted(name):
    changes, message = CONDITIONS[name]
    stated = {"rates": lambda t, x, v: [x[1], -ca.exp(x[0])], "t_span": (0, 1), **changes}
    with pytest.raises(ValueError, match=message):
        cg.transcribe(cg.ControlProblem(**stated), cg.Galerkin(2), 2)


def test_without_controls_a_cost_may_choose_what_conditions_leave_free():
    fit = cg.ControlProblem(
        rates=lambda t, x, v, p: -p * x,
        t_span=(0, 1),
        start=1.0,
        parameters=1.0,
        parameter_bounds=(0, 5),
        terminal_cost=lambda t, x, v, p: (x - 0.2) ** 2,
    )
    assert fit.controls == 0


@pytest.mark.slow
def test_callables_of_first_order_leave_out_velocities_or_take_them():
    short = cg.ControlProblem(
        rates=lambda t, x, u: u - x,
        t_span=(0, 1),
        start=1.0,
        controls=1,
        running_cost=lambda t, x, u: x**2 + u**2,
        terminal_cost=lambda t, x: x**2,
        path_constraint=(lambda t, x, u: u, -9, 9),
        end_conditions=(lambda x0, x1: x1 - x0, -5, 5),
        jumps=[(0.5, lambda x: x - 0.1)],
        waypoints=[(0.5, (lambda x: x, -3, 3))],
    )
    whole = replace(
        short,
        rates=lambda t, x, v, u: u - x,
        jumps=[(0.5, lambda x, v: (x - 0.1, v))],
        end_conditions=(lambda x0, v0, x1, v1: x1 - x0, -5, 5),
    )
    costs = [cg.solve(problem, cg.Galerkin(2), 2).cost for problem in (short, whole)]
    assert costs[0] == pytest.approx(costs[1], rel=1e-12)


def test_a_control_that_is_not_told_of_is_asked_for():
    with pytest.raises(TypeError, match=r"rates is called as rates\(t, x\), got one of \(t, x, u\). Controls u are"):
        cg.ControlProblem(rates=lambda t, x, u: u, t_span=(0, 1), start=1.0)


@pytest.mark.parametrize("rates", [lambda t: 1, lambda t, x, w, u, p: u])
def test_callables_of_first_order_of_other_arguments_are_refused(rates):
    with pytest.raises(TypeError, match=r"rates is called as rates\(t, x, u\), got one of \(t"):
        cg.ControlProblem(rates=rates, t_span=(0, 1), start=1.0, controls=1)
