"""Derivatives of optima: against differences of problems that are solved again, for each kind of datum."""

import pickle

import casadi as ca
import numpy as np
import pytest
from slow import slow

import casadi_galerkin as cg
from casadi_galerkin.problems.problem import with_values

METHOD, INTERVALS = cg.Galerkin(4), 10
STEP = 1e-4  # of central differences, whose error is its square
AGREEMENT = 1e-6
LIMITS = "path_constraint", "end_conditions"
ENDS = [0.2], [1.0], [0.1], [0.0]


def pushed(**changes):
    rules = {
        "force": lambda t, x, v, u, p: u - p[0] * ca.sin(2 * x),
        "running_cost": lambda t, x, v, u, p: u**2 / 2 + p[1] * x[0] ** 2,
        "controls": 1,
        "parameters": [1.3, 0.4],
    }
    return cg.ControlProblem(lambda t, x, v, p: v[0] ** 2 / 2, (0, 1), *ENDS, **{**rules, **changes})


def fastest(**changes):
    rules = {
        "force": lambda t, x, v, u, p: u - p[0] * v,
        "running_cost": lambda t, x, v, u, p: 1.0 + u**2 / 20,
        "controls": 1,
        "parameters": [0.3],
        "duration_bounds": (0.1, 10.0),
    }
    return cg.ControlProblem(lambda t, x, v, p: v[0] ** 2 / 2, (0, 1), *ENDS, **{**rules, **changes})


def chosen_parameter():
    return cg.ControlProblem(
        lambda t, x, v, p: v[0] ** 2 / 2,
        (0, 1),
        *ENDS,
        force=lambda t, x, v, u, p: u - p[0] * x,
        running_cost=lambda t, x, v, u, p: u**2 / 2 + (p[0] - 1) ** 2,
        controls=1,
        parameters=[1.0],
        parameter_bounds=([0.5], [2.0]),
    )


def tank():  # a component that follows a rate
    return cg.ControlProblem(
        lambda t, x, v, p: v[0] ** 2 / 2,
        (0, 1),
        [0.0, 2.0],
        [1.0, None],
        [0.0, None],
        [0.0, None],
        force=lambda t, x, v, u, p: u,
        rates=lambda t, x, v, u, p: [-p[0] * u[0] ** 2],
        running_cost=lambda t, x, v, u, p: u**2 / 2,
        terminal_cost=lambda t, x, v, p: -p[1] * x[1] ** 2,
        controls=1,
        parameters=[0.02, 0.1],
    )


PROBLEMS = {
    "free": pushed,
    "bounded control": lambda: pushed(control_bounds=([-4.0], [3.3])),
    "free end": lambda: pushed_to(None),
    "path constraint": lambda: pushed(path_constraint=(lambda t, x, v, u, p: v[0], -np.inf, 1.25)),
    "held": lambda: pushed(hold=True),
    "free duration": fastest,
    "bounded duration": lambda: fastest(duration_bounds=(0.1, 1.1)),
    "free parameter": chosen_parameter,
    "rate": tank,
    "jump": lambda: pushed(jumps=[(0.4, lambda x, v, p: (x, 0.8 * v))], breakpoints=[0.4]),
    "waypoint": lambda: pushed(waypoints=[(0.5, [0.3])], breakpoints=[0.5]),
}


def pushed_to(end):
    problem = pushed()
    terminal = {"terminal_cost": lambda t, x, v, p: 5 * (x[0] - 1) ** 2, "controls": 1, "parameters": [1.3, 0.4]}
    rules = {"force": lambda t, x, v, u, p: u - p[0] * ca.sin(2 * x), "running_cost": lambda t, x, v, u, p: u**2 / 2}
    return cg.ControlProblem(
        lambda t, x, v, p: v[0] ** 2 / 2, problem.t_span, [0.2], [end], [0.1], [None], **rules, **terminal
    )


def solved(problem, guess=None):
    return cg.solve(problem, METHOD, INTERVALS, guess=guess)


def sides(problem, name):
    stated = getattr(problem, name)
    return np.array(stated[1:] if name in LIMITS else stated, dtype=float)


def varied(problem, name, index, by):
    values = sides(problem, name).astype(object)
    values[index] += by
    moved = [tuple(row) if values.ndim == 2 else None if np.isnan(row) else row for row in values]
    return with_values(problem, **{name: (getattr(problem, name)[0], *moved) if name in LIMITS else tuple(moved)})


def measured(path):
    found = {"x": path.x, "control": path.control.values, "cost": np.array(path.cost)}
    return found | {"durations": np.ptp(path.t, keepdims=True), "parameters": np.array(path.parameters)}


@pytest.mark.parametrize("name", ["bounded control", *slow(*PROBLEMS)])
@pytest.mark.slow
def test_derivatives_are_those_of_problems_solved_again(name):
    problem = PROBLEMS[name]()
    path = solved(problem)
    by = cg.sensitivity(path)
    for datum, of_cost in by.cost.items():
        values = sides(problem, datum)
        for k, index in enumerate(map(tuple, np.argwhere(~np.isnan(values)))):
            if np.isinf(values[index]):
                continue
            low, high = (measured(solved(varied(problem, datum, index, sign * STEP), path)) for sign in (-1, 1))
            for what in ("x", "control", "durations", "cost", *(["parameters"] * (datum != "parameters"))):
                found = getattr(by, what)[datum][(..., *(index if of_cost.ndim == 2 else (k,)))]
                difference = (high[what] - low[what]) / (2 * STEP)
                assert np.max(np.abs(found - difference)) <= AGREEMENT * max(1.0, np.max(np.abs(found))), (what, index)


def test_the_cost_of_bounds_is_their_multiplier():
    path = solved(pushed(control_bounds=([-np.inf], [3.3])))
    by = cg.sensitivity(path)
    assert by.cost["control_bounds"][1, 0] < 0 == by.cost["control_bounds"][0, 0]
    assert by.cost["position_bounds"].tolist() == [[0.0], [0.0]]
    assert np.all(by.x["control_bounds"][:, :, 0] == 0)
    assert "by control_bounds: of the cost" in repr(by)


def test_another_process_finds_the_same_derivatives():
    path = solved(pushed())
    again = cg.sensitivity(pickle.loads(pickle.dumps(path)))
    assert np.array_equal(again.x["start"], cg.sensitivity(path).x["start"])


def test_a_bound_that_hardly_acts_is_said():
    free = solved(pushed())
    problem = pushed(control_bounds=([-np.inf], [float(free.control.values.max())]))
    with pytest.raises(ValueError, match="whose bounds either act or are not met, got one that is met but hardly acts"):
        cg.sensitivity(solved(problem, free))


def test_an_optimum_that_cost_and_bounds_do_not_determine_is_said():
    idle = pushed(
        controls=2,
        force=lambda t, x, v, u, p: u[0] + u[1] - p[0] * ca.sin(x),
        running_cost=lambda t, x, v, u, p: (u[0] + u[1]) ** 2 + p[1] * x[0] ** 2,
    )
    with pytest.raises(ValueError, match="takes optima that cost and bounds determine to second order"):
        cg.sensitivity(solved(idle))


def test_a_saddle_is_said():
    above = cg.ControlProblem(
        lambda t, x, v: v[0] ** 2 / 2,
        (0, 1),
        [0.0],
        [0.0],
        [0.0],
        [0.0],
        force=lambda t, x, v, u: u,
        running_cost=lambda t, x, v, u: u**2 / 2 - 1000 * x[0] ** 2,
        controls=1,
    )
    path = cg.solve(above, METHOD, INTERVALS)
    assert path.morse_index > 0
    first = repr(path).splitlines()[2]
    assert first.startswith("  SADDLE      no minimum: the cost decreases in ")
    assert first.endswith("; try a guess beside it, several `starts`")
    with pytest.raises(ValueError, match="sensitivity takes minima, got a saddle, from which the cost decreases in"):
        cg.sensitivity(path)


def arguments(problem, path, **changes):
    given = {name: getattr(problem, name) for name in ("start", "end", "start_velocity", "end_velocity", "parameters")}
    return {**given, "guess": path.polynomial.values, "controls": path.control.values, **changes}


@pytest.mark.parametrize("solver", [cg.ipopt, *slow(cg.fatrop)], ids=str)
@pytest.mark.slow
def test_the_function_of_an_optimum_has_its_derivatives(solver):
    problem = PROBLEMS["bounded control"]()
    path = solved(problem)
    by = cg.sensitivity(path)
    jacobian = cg.solution_function(problem, METHOD, INTERVALS, solver=solver).jacobian()(**arguments(problem, path))
    for datum in ("start", "end", "start_velocity", "end_velocity", "parameters"):
        found = [by.x[datum], by.control[datum], by.durations[datum], by.cost[datum]]
        for what, derivative in zip(("x", "u", "duration", "cost"), found, strict=True):
            own = jacobian[f"jac_{what}_{datum}"].full()
            assert np.max(np.abs(own - derivative.reshape(own.shape))) <= AGREEMENT


@pytest.mark.slow
def test_derivatives_of_the_function_are_not_finite_where_a_bound_hardly_acts():
    free = solved(pushed())
    problem = pushed(control_bounds=([-np.inf], [float(free.control.values.max())]))
    f = cg.solution_function(problem, METHOD, INTERVALS)
    given = arguments(problem, free)
    assert float(f(**given)["cost"]) == pytest.approx(free.cost, rel=1e-9)
    assert not np.isfinite(f.jacobian()(**given)["jac_cost_end"].full()).any()


@pytest.mark.slow
def test_an_optimizer_around_an_optimization_finds_the_best_design():
    problem = pushed()
    path = solved(problem)
    f, p = cg.solution_function(problem, METHOD, INTERVALS), ca.MX.sym("p")
    cost = f(**arguments(problem, path, parameters=ca.vertcat(p, 0.4)))["cost"] + 0.1 * (p - 5) ** 2
    options = {"hessian_approximation": "limited-memory", "print_level": 0, "sb": "yes", "tol": 1e-10}
    design = ca.nlpsol("design", "ipopt", {"x": p, "f": cost}, {"ipopt": options, "print_time": False})
    best = float(design(x0=1.3)["x"])
    by = cg.sensitivity(solved(with_values(problem, parameters=(best, 0.4)), path))
    assert abs(by.cost["parameters"][0] + 0.2 * (best - 5)) <= 1e-7
    assert abs(best - 1.3) > 0.1


def test_second_derivatives_of_the_function_are_refused():
    problem = pushed()
    path = solved(problem)
    f, p = cg.solution_function(problem, METHOD, INTERVALS), ca.MX.sym("p", 2)
    with pytest.raises(RuntimeError, match="Derivatives cannot be calculated for jac_changes"):
        ca.hessian(f(**arguments(problem, path, parameters=p))["cost"], p)
