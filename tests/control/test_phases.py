"""Phases with statements of their own: exact values, what links and joins them, and the same digits as with jumps."""

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize

import casadi_galerkin as cg
from casadi_galerkin.control.initial_guess import starting_point

SOLVED = 1e-8  # what a solver leaves of the optimality conditions, amplified by their conditioning


def moving(begin, end_time, start=None, end=None, **changes):
    """A unit mass with the force u, at the cost ∫u²/2."""
    fields = {
        "lagrangian": lambda t, x, v: v[0] ** 2 / 2,
        "t_span": (begin, end_time),
        "start": start,
        "end": end,
        "force": lambda t, x, v, u: u,
        "running_cost": lambda t, x, v, u: u[0] ** 2 / 2,
        "controls": 1,
        "components": 1,
    }
    return cg.ControlProblem(**(fields | changes))


def two_bodies():
    """Two unit masses, of which the second comes to rest at 1."""
    return cg.ControlProblem(
        lambda t, x, v: ca.dot(v, v) / 2,
        (0.0, 1.0),
        [0.0, 0.0],
        [None, 1.0],
        [0.0, 0.0],
        [None, 0.0],
        force=lambda t, x, v, u: u,
        running_cost=lambda t, x, v, u: ca.dot(u, u) / 2,
        controls=2,
    )


def bouncing(**changes):
    """From rest at 1 to a wall at 0, where it bounces with 0.8 of its velocity, and back to rest at 1."""
    first = moving(0.0, 1.0, 1.0, 0.0, start_velocity=0.0, **changes)
    second = moving(1.0, 2.0, end=1.0, end_velocity=0.0, **changes)
    return cg.Phases([first, second], links=[lambda x, v: (x, -0.8 * v)])


def in_one(**changes):
    """The same as one problem with a jump."""
    stated = {"waypoints": [(1.0, [0.0])], "jumps": [(1.0, lambda x, v: (x, -0.8 * v))]}
    return moving(0.0, 2.0, 1.0, 1.0, start_velocity=0.0, end_velocity=0.0, **(stated | changes))


@pytest.mark.slow
def test_a_bounce_is_the_same_as_one_problem_with_a_jump():
    path, other = cg.solve(bouncing(), cg.Galerkin(3), 4), cg.solve(in_one(), cg.Galerkin(3), 4)
    speed = 10.8 / 6.56
    assert path.cost == pytest.approx(12 - 5.4 * speed, rel=1e-12)
    assert path.cost == pytest.approx(other.cost, rel=1e-12)
    times = np.linspace(0, 2, 30)
    for name in ("__call__", "before", "control", "costate"):
        np.testing.assert_allclose(getattr(path, name)(times), getattr(other, name)(times), rtol=0, atol=1e-10)
    assert path.before(1.0, 1)[0] == pytest.approx(-speed, abs=SOLVED)
    assert path(1.0, 1)[0] == pytest.approx(0.8 * speed, abs=SOLVED)
    assert [len(phase.t) for phase in path.phases] == [3, 3]
    assert sum(phase.cost for phase in path.phases) == pytest.approx(path.cost, rel=1e-12)
    assert path.morse_index == other.morse_index == 0
    assert path.estimate_error() < 1e-9


@pytest.mark.slow
def test_free_durations_follow_one_another():
    timed = {"duration_bounds": (0.3, 5.0), "running_cost": lambda t, x, v, u: u[0] ** 2 / 2 + 1}
    path = cg.solve(bouncing(**timed), cg.Galerkin(4), 8)
    other = cg.solve(in_one(**timed), cg.Galerkin(4), 8)
    assert path.cost == pytest.approx(other.cost, rel=1e-10)
    np.testing.assert_allclose(path.t, other.t, rtol=0, atol=SOLVED)
    assert path.phases[0].t[-1] == path.phases[1].t[0]
    np.testing.assert_allclose(path.problem.breakpoints, other.problem.breakpoints, rtol=0, atol=SOLVED)
    np.testing.assert_allclose(path.phases[1].hamiltonian, 0, atol=SOLVED)
    assert cg.transcribe(bouncing(**timed), cg.Galerkin(4), 8).solve(guess=path).iterations <= 2


@pytest.mark.slow
def test_a_component_goes_with_the_body_that_is_dropped():
    """Two bodies move side by side; after a third of the time one of them is left, which then goes on alone."""
    path = cg.solve(
        cg.Phases([two_bodies(), moving(1.0, 2.0, end=1.0, end_velocity=0.0)], links=[lambda x, v: (x[0], v[0])]),
        cg.Galerkin(3),
        2,
    )
    assert path.cost == pytest.approx(6 + 6 / 8, rel=1e-10)
    assert path(np.array([0.5, 1.5])).shape == (2, 2)
    np.testing.assert_array_equal(np.isnan(path(np.array([0.5, 1.5]))), [[False, False], [False, True]])
    np.testing.assert_allclose(path.before(1.0), [0.5, 1.0], rtol=0, atol=SOLVED)
    top = path.plot(labels=["way", "other way"])
    assert top.get_legend().get_texts()[1].get_text() == "other way"
    assert [axes.get_ylabel() for axes in top.figure.axes] == ["", "u", "λ"]
    joints, begins = top.lines[1], top.lines[-1]
    np.testing.assert_array_equal(joints.get_xydata(), np.stack((path.t, path.x[0]), axis=1))
    assert begins.get_xdata()[0] == path.phases[1].t[0]
    table = path.to_dict()
    assert list(table)[:4] == ["phase", "t", "x[0]", "x[1]"]
    assert table["t"].count(1.0) == 2  # the last of one phase, and the first of the next
    for k, phase in enumerate(path.phases):
        rows = np.array(table["phase"]) == k
        times, velocities = (np.array(table[name])[rows] for name in ("t", "velocity[0]"))
        np.testing.assert_array_equal(velocities, phase.table(times)["velocity[0]"])
    assert np.all(np.isnan(np.array(table["x[1]"])[rows]))
    assert "<svg" in path._repr_html_()
    at_times = path.to_dict([0.5, 1.0, 1.5])
    assert at_times["phase"] == [0, 1, 1]
    np.testing.assert_allclose(at_times["x[1]"], path([0.5, 1.0, 1.5])[1], rtol=1e-15)
    assert path.to_dict([1.5])["phase"] == [1]


def test_conditions_and_costs_join_phases():
    """At half time, which is free, the speed is twice the place; the earlier phase lasts as long as the later."""
    free = {"duration_bounds": (0.2, 3.0)}
    phases = cg.Phases(
        [moving(0.0, 1.0, 0.0, start_velocity=0.0, **free), moving(1.0, 2.0, end=1.0, end_velocity=0.0, **free)],
        links=[(lambda x, v, x_after, v_after: [x - x_after, v - v_after, v - 2 * x], 0.0, 0.0)],
        conditions=(lambda first, second: [second.t1 - 2 * first.t1 + first.t0], 0.0, 0.0),
        cost=lambda first, second: (second.t1 - 3.0) ** 2,
    )
    path = cg.solve(phases, cg.Galerkin(4), 4)
    assert path.t[-1] == pytest.approx(2 * path.phases[1].t[0], rel=1e-9)
    place, speed = path.phases[0](path.phases[1].t[0])[0], path.phases[1].start_velocity[0]
    assert speed == pytest.approx(2 * place, rel=1e-8)
    assert sum(phase.cost for phase in path.phases) + (path.t[-1] - 3) ** 2 == pytest.approx(path.cost, rel=1e-10)


@pytest.mark.parametrize("make", [bouncing, in_one])
def test_a_phase_has_neither_errors_nor_derivatives_of_its_own(make):
    path = cg.solve(make(), cg.Galerkin(3), 4)
    for ask, what in ((lambda phase: phase.estimate_error(), "errors"), (cg.sensitivity, "derivatives")):
        with pytest.raises(ValueError, match=f"a phase has no {what} of its own: ask the whole path"):
            ask(path.phases[1])


def test_phases_are_asked_for_a_quantity():
    speed = 10.8 / 6.56
    path = cg.solve(bouncing(control_bounds=(-20.0, 20.0)), cg.Galerkin(3), tol=1e-6, of=arrival)
    assert path.asked == pytest.approx(-speed, rel=1e-6)
    assert path.asked_error <= 1e-6
    assert "asked       -1.646341463" in repr(path)
    assert path.error_of(lambda path: path.cost) <= 1e-6 * path.cost


def arrival(path):
    """The speed before the wall."""
    return path.before(1.0, 1)[0]


def test_phases_with_equal_statements_share_their_functions():
    base = moving(0.0, 1.0, 0.0, start_velocity=0.0)
    others = [moving(float(k), k + 1.0) for k in range(1, 4)]
    last = moving(4.0, 5.0, end=1.0, end_velocity=0.0)
    graph = cg.transcribe(cg.Phases([base, *others, last]), cg.Galerkin(3), 5).graph
    assert len({id(place.terms) for place in graph.places if place.integrated}) == 1


def test_each_phase_has_intervals_of_its_own():
    phases = bouncing()
    path = cg.solve(phases, cg.Galerkin(3), intervals=[1, 3])
    assert [len(phase.t) - 1 for phase in path.phases] == [1, 3]
    with pytest.raises(ValueError, match=r"intervals must be a number, or one for each of 2 sections, got \[1\]"):
        cg.solve(phases, cg.Galerkin(3), [1])


def test_one_guess_of_all_phases_is_read_at_the_times_of_each(tmp_path):
    path = cg.solve(bouncing(), cg.Galerkin(3), 4)
    path.to_npz(tmp_path / "bounce.npz")
    program = cg.transcribe(bouncing(), cg.Galerkin(3), 4)
    guess = cg.load(tmp_path / "bounce.npz")
    begun = starting_point(program.graph, program.problem, program.calculus, guess)
    for phase, values in zip(path.phases, begun.values, strict=True):
        np.testing.assert_allclose(np.concatenate(values["controls"]).T, phase.control.values, rtol=0, atol=SOLVED)
        np.testing.assert_allclose(values["x"].T, phase.x, rtol=0, atol=SOLVED)


def test_other_ends_are_those_of_the_first_and_the_last_phase():
    program = cg.transcribe(bouncing(), cg.Galerkin(3), 4)
    assert program.solve(start=[2.0], end=[2.0]).cost == pytest.approx(4 * program.solve().cost, rel=1e-9)
    with pytest.raises(ValueError, match="control_bounds are those of single phases: state phases with others"):
        program.solve(control_bounds=(-1, 1))


def test_a_summary_has_every_phase():
    text = repr(cg.solve(bouncing(), cg.Galerkin(3), 4))
    assert "PhasesTrajectory of 2 phases on [0, 2], 4 intervals" in text
    assert "phase 1     1 component and 1 control on [1, 2]" in text


@pytest.mark.parametrize(
    ("make", "kind", "message"),
    [
        (lambda: cg.Phases([moving(0, 1, 0.0)]), ValueError, "phases must be two or more ControlProblems"),
        (lambda: cg.Phases([moving(0, 1, 0.0), 3]), TypeError, "phase 1 must be a ControlProblem, got int"),
        (
            lambda: cg.Phases([moving(0, 1, 0.0), moving(2, 3)]),
            ValueError,
            r"phase 1 must begin when phase 0 ends, at t = 1.0, got t_span \(2.0, 3.0\)",
        ),
        (
            lambda: cg.Phases([moving(0, 1, 0.0), moving(1, 2)], links=[]),
            ValueError,
            "links must be 1, one for every phase but the last",
        ),
        (
            lambda: cg.Phases([moving(0, 1, 0.0), moving(1, 2)], links=[lambda x, v: (ca.vertcat(x, x), v)]),
            ValueError,
            r"link 0 failed .*it must return 1 position and as many velocities, got \[2, 1\]",
        ),
        (
            lambda: cg.Phases([moving(0, 1, 0.0), moving(1, 2)], links=[(lambda x, v, y, w: [x - y, 3.0], 0, 0)]),
            ValueError,
            "condition 1 of link 0 depends on nothing that is free: it is 3.0, whatever the path",
        ),
        (
            lambda: cg.Phases([moving(0, 1, 0.0, 1.0), moving(1, 2, 2.0)]),
            ValueError,
            r"the continuity of x\[0\] is missed by 1.0 by what both give",
        ),
        (
            lambda: cg.Phases([two_bodies(), moving(1, 2)]),
            ValueError,
            r"phase 0 has 2 components, and phase 1 has 1: give a law \(x, v\) -> \(x, v\) as link 0",
        ),
        (lambda: cg.transcribe(bouncing(), tol=1e-3), TypeError, "problem must be a BoundaryProblem, got Phases"),
    ],
)
def test_what_is_no_sequence_of_phases_is_refused(make, kind, message):
    with pytest.raises(kind, match=message):
        make()


def test_a_failure_names_the_phase():
    with pytest.raises(cg.ConvergenceError, match="of phase 1 at t"):
        cg.solve(
            cg.Phases(
                [moving(0, 1, 0.0), moving(1, 2, end=5.0, path_constraint=(lambda t, x, v, u: v[0] ** 2, -2.0, -1.0))]
            ),
            cg.Galerkin(3),
            4,
        )


def treated():
    """Growth of a tumor and of its vessels, which a drug hinders until it is used up: Betts (2010), section 6.17."""

    def rates(t, x, v, u):
        size = (5.83 / 0.00873) * x[0] ** (2 / 3)
        return [-0.084 * x[0] * ca.log(x[0] / x[1]), x[1] * (5.83 - 0.00873 * size - 0.15 * 75 * u), 5 * u]

    dosed = cg.ControlProblem(
        rates=lambda t, x, v, u: rates(t, x, v, u[0]),
        t_span=(0.0, 0.2),
        start=[0.5, 0.25, 0.0],
        end=[None, None, 1.0],
        controls=1,
        control_bounds=(0, 1),
        duration_bounds=(0.1, 1.1),
    )
    without = cg.ControlProblem(
        rates=lambda t, x, v: rates(t, x, v, 0.0)[:2],
        t_span=(0.2, 1.2),
        components=2,
        duration_bounds=(0.1, 1.2),
        terminal_cost=lambda t, x, v: x[0],
    )
    return cg.Phases([dosed, without], links=[lambda x, v: (x[:2], v[:2])])


@pytest.mark.slow
def test_a_tumor_shrinks_as_published_in_two_phases_of_which_one_has_no_control():
    """Without a guess, the second phase begins where the law of the first leads, as its rates have no value at zero."""
    phases = treated()
    path = cg.solve(phases, cg.Galerkin(4), intervals=[32, 8])
    assert path.cost * (5.83 / 0.00873) ** 1.5 == pytest.approx(7571.67158, rel=3e-7)
    assert np.isnan(path.control(1.0)).all()


def test_without_a_guess_lines_lead_to_the_next_positions_that_are_given():
    program = cg.transcribe(
        cg.Phases(
            [moving(0, 1, 1.0), moving(1, 2), moving(2, 4, end=5.0), moving(4, 5, 2.0)],
            links=[None, None, (lambda x, v, y, w: v - w, 0, 0)],
        ),
        cg.Galerkin(2),
        5,
    )
    values = starting_point(program.graph, program.problem, program.calculus, None).values
    ends = [of_phase["x"][[0, -1], 0].tolist() for of_phase in values]
    np.testing.assert_allclose(ends, [[1, 2], [2, 3], [3, 5], [2, 2]], rtol=0, atol=1e-15)


@pytest.mark.slow
def test_a_tolerance_is_met_by_every_phase():
    timed = {"duration_bounds": (0.3, 5.0), "running_cost": lambda t, x, v, u: u[0] ** 2 / 2 + 1 + ca.sin(3 * x[0])}
    exact = cg.solve(bouncing(**timed), cg.Galerkin(10), 12)
    path = cg.solve(bouncing(**timed), tol=1e-6)
    assert abs(path.cost / exact.cost - 1) <= path.cost_error
    assert path.error_estimate <= 1e-6
    parts = np.linspace(0, 1, 40)
    for one, other in zip(path.phases, exact.phases, strict=True):
        found, known = (phase(phase.t[0] + parts * np.ptp(phase.t)) for phase in (one, other))
        assert np.max(np.abs(found - known)) <= 1e-6 * np.max(np.abs(known))


def test_a_phase_may_begin_where_an_earlier_one_ends():
    """One state from which two ends are reached: the least effort of both, by the closed form."""

    def effort(state, end):
        way, speed = end - state[0], state[1]
        return 6 * way**2 - 6 * way * speed + 2 * speed**2

    ways = [moving(1, 2, end=1.0, end_velocity=0.0), moving(2, 3, end=-0.5, end_velocity=0.0)]
    phases = cg.Phases(
        [moving(0, 1, 0.0, start_velocity=0.0), *ways],
        links=[None, (lambda x, v, y, w: y, -np.inf, np.inf)],
        conditions=(lambda one, two, three: [three.x0 - one.x1, three.v0 - one.v1], 0.0, 0.0),
    )
    path = cg.solve(phases, cg.Galerkin(3), 3)
    least = minimize(lambda z: 6 * z[0] ** 2 - 6 * z[0] * z[1] + 2 * z[1] ** 2 + effort(z, 1) + effort(z, -0.5), [0, 0])
    assert path.cost == pytest.approx(least.fun, rel=1e-8)
    assert path.phases[2].x[0, 0] == pytest.approx(path.phases[0].x[0, -1], abs=SOLVED)
