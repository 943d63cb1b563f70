"""Derivatives of solutions: against closed forms, against differences, and nothing unverified gets out."""

import casadi as ca
import numpy as np
import pytest
from scenes import bratu_problem
from slow import slow

import casadi_galerkin as cg

AGREEMENT = 1e-9  # what is promised of derivatives; degree 8 on 10 intervals leaves nothing of the discretization
SAME = 1e-12  # two ways to solve the same linear system, whose condition number is about 1e3
RATE, DURATION = 1.3, 2.0


def oscillator(t, x, v, p):
    """Mass p[0], spring constant p[1]."""
    return p[0] * v[0] ** 2 / 2 - p[1] * x[0] ** 2 / 2


def pendulum(t, x, v, p):
    return p[0] * v[0] ** 2 / 2 + p[1] * ca.cos(x[0]) + p[2] * x[0] * ca.sin(t)


def spring(start=(0.4,), end=(1.0,)):
    return cg.BoundaryProblem(oscillator, (0.0, DURATION), start, end, parameters=[1.0, RATE**2])


def solved(problem, degree=8, intervals=10):
    method = cg.Galerkin(degree)
    path = cg.solve(problem, method, intervals)
    return cg.solution_function(problem, method, intervals), path


def numbers(path):
    """The data of a path as its solution function takes them."""
    problem = path.problem
    fixed = {name: [value for value in getattr(problem, name) if value is not None] for name in ("start", "end")}
    given = {name: values for name, values in fixed.items() if values}
    given |= {} if problem.parameters is None else {"parameters": list(problem.parameters)}
    return given | {"guess": path.polynomial.values}


def dense(value):
    return np.array(ca.densify(value))


@pytest.fixture(scope="module")
def swing():
    problem = cg.BoundaryProblem(pendulum, (0.0, 3.0), [0.2], [1.0], parameters=[1.1, 0.9, 0.5])
    return solved(problem, 6, 12)


# values


@pytest.mark.parametrize(
    ("start", "end", "inputs"),
    [
        ([0.3, 0.1], [1.0, 0.5], ["start", "end", "parameters", "guess"]),
        ([0.3, None], [None, 0.5], ["start", "end", "parameters", "guess"]),
        ([None, None], [1.0, 0.5], ["end", "parameters", "guess"]),
    ],
)
def test_function_gives_what_solve_gives(start, end, inputs):
    def lagrangian(t, x, v, p):
        return ca.dot(v, v) / 2 - p[0] * x[0] ** 2 * x[1] ** 2 - ca.dot(x, x) / 4

    f, path = solved(cg.BoundaryProblem(lagrangian, (0.0, 1.0), start, end, parameters=[0.7]), 4, 6)
    assert [f.name_in(i) for i in range(f.n_in())] == inputs
    assert [f.name_out(i) for i in range(f.n_out())] == ["x", "momentum", "action"]
    result = f(**numbers(path))
    for name in ("x", "momentum"):
        np.testing.assert_allclose(result[name], getattr(path, name), rtol=SAME, atol=SAME)
    assert float(result["action"]) == pytest.approx(path.action, rel=SAME, abs=0)


def test_function_without_parameters_on_a_periodic_path_has_the_guess_only():
    def forced(t, x, v):
        return v[0] ** 2 / 2 - 9 * x[0] ** 2 / 8 + x[0] * ca.cos(t)

    f, path = solved(cg.BoundaryProblem(forced, (0.0, 2 * np.pi), [None], periodic=True))
    assert [f.name_in(i) for i in range(f.n_in())] == ["guess"]
    exact = 0.8 * np.cos(path.t)[None, :]
    np.testing.assert_allclose(f(path.polynomial.values)[0], exact, rtol=0, atol=1e-9)  # N = 10 on a whole period


def test_graded_meshes_are_taken_over():
    problem, method, mesh = spring(), cg.Galerkin(4), [0.0, 0.1, 0.5, 0.6, DURATION]
    path = cg.solve(problem, method, mesh=mesh)
    np.testing.assert_allclose(
        cg.solution_function(problem, method, mesh=mesh)(**numbers(path))["x"], path.x, rtol=SAME, atol=SAME
    )


@pytest.mark.parametrize("unit", [1e-9, *slow(1e9)])
def test_data_of_any_size_are_solved_to_roundoff(unit):
    f, path = solved(spring())
    x = f(start=[0.4 * unit], end=[unit], parameters=[1.0, RATE**2], guess=path.polynomial.values)["x"]
    np.testing.assert_allclose(x, unit * path.x, rtol=0, atol=SAME * unit)


def test_guess_chooses_among_several_solutions():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - ca.exp(x[0]), (0.0, 1.0), [0.0], [0.0])
    method = cg.Galerkin(8)
    low = cg.solve(problem, method, 10)
    high = cg.solve(problem, method, 10, guess=lambda t: [16 * t * (1 - t)])
    assert high.x.max() > low.x.max() + 1
    f = cg.solution_function(problem, method, 10)
    for path in (low, high):
        np.testing.assert_allclose(f(**numbers(path))["x"], path.x, rtol=SAME, atol=SAME)


# derivatives


def closed_form(times):
    """(x0, x1, mass, constant) -> x at the times, momentum at the times, action."""
    data = ca.SX.sym("data", 4)
    first, last, mass, constant = ca.vertsplit(data)
    rate = ca.sqrt(constant / mass)
    x = [(first * ca.sin(rate * (DURATION - t)) + last * ca.sin(rate * t)) / ca.sin(rate * DURATION) for t in times]
    p = [
        mass * rate * (last * ca.cos(rate * t) - first * ca.cos(rate * (DURATION - t))) / ca.sin(rate * DURATION)
        for t in times
    ]
    return data, {"x": ca.horzcat(*x), "momentum": ca.horzcat(*p), "action": (p[-1] * last - p[0] * first) / 2}


def at_data(f, guess):
    """The same outputs as expressions of the same four data, through the solution function."""
    data = ca.MX.sym("data", 4)
    return data, f(start=data[0], end=data[1], parameters=data[2:], guess=guess)


def derivatives(data, answer, order):
    """Values of the derivative of that order of x, momentum and action by the data."""
    results = []
    for name in ("x", "momentum", "action"):
        value = ca.vec(answer[name])
        for _ in range(order):
            value = ca.vec(ca.jacobian(value, data))
        results.append(value)
    return [dense(value) for value in ca.Function("derivatives", [data], results)([0.4, 1.0, 1.0, RATE**2])]


def test_jacobian_is_that_of_the_closed_form():
    f, path = solved(spring())
    ours = derivatives(*at_data(f, path.polynomial.values), order=1)
    for got, expected in zip(ours, derivatives(*closed_form(path.t), order=1), strict=True):
        np.testing.assert_allclose(got, expected, rtol=0, atol=AGREEMENT)
        assert np.abs(expected).max() > 0.1


@pytest.mark.slow
def test_second_derivatives_are_those_of_the_closed_form():
    f, path = solved(spring())
    ours = derivatives(*at_data(f, path.polynomial.values), order=2)
    for got, expected in zip(ours, derivatives(*closed_form(path.t), order=2), strict=True):
        np.testing.assert_allclose(got, expected, rtol=AGREEMENT, atol=AGREEMENT)


def difference(solve, data, j):
    """Derivative by the number at place j in the data, by differences of fourth order: error 1e-12, roundoff 1e-12."""
    data, total = list(data), 0.0
    for factor, weight in ((-2, 1), (-1, -8), (1, 8), (2, -1)):
        moved = [value + 1e-3 * factor if i == j else value for i, value in enumerate(data)]
        total = total + weight * solve(moved)
    return total / 12e-3


@pytest.mark.parametrize("name", ["start", "end", "parameters"])
@pytest.mark.parametrize("output", ["x", "momentum", "action"])
def test_jacobian_agrees_with_differences_of_solves(swing, name, output):
    f, path = swing
    given = numbers(path)
    jacobian = dense(f.jacobian()(**given)[f"jac_{output}_{name}"])
    for j in range(len(given[name])):
        expected = difference(lambda data: dense(f(**{**given, name: data})[output]).ravel(), given[name], j)
        got = jacobian.reshape(len(expected), -1)[:, j]
        np.testing.assert_allclose(got, expected, rtol=AGREEMENT, atol=AGREEMENT)


def test_derivative_of_the_action_by_the_ends_is_the_momentum(swing):
    f, path = swing
    jacobian = f.jacobian()(**numbers(path))
    assert float(jacobian["jac_action_end"]) == pytest.approx(path.momentum[0, -1], rel=SAME, abs=0)
    assert float(jacobian["jac_action_start"]) == pytest.approx(-path.momentum[0, 0], rel=SAME, abs=0)


def test_guess_has_no_derivative(swing):
    f, path = swing
    jacobian = f.jacobian()(**numbers(path))
    assert all(jacobian[f"jac_{name}_guess"].nnz() == 0 for name in ("x", "momentum", "action"))


def test_sensitivity_is_the_jacobian_of_the_function(swing):
    f, path = swing
    jacobian, found = f.jacobian()(**numbers(path)), cg.sensitivity(path)
    for name in ("start", "end", "parameters"):
        expected = dense(jacobian[f"jac_x_{name}"]).reshape(1, len(path.t), -1)
        assert found.x[name].shape == expected.shape
        np.testing.assert_allclose(found.x[name], expected, rtol=0, atol=AGREEMENT)
    assert found.t is path.t


def test_sensitivity_keeps_components_apart():
    def lagrangian(t, x, v, p):
        return ca.dot(v, v) / 2 - p[0] * x[0] * x[1] - ca.dot(x, x) ** 2 / 4

    problem = cg.BoundaryProblem(lagrangian, (0.0, 0.5), [0.3, 0.1], [None, 0.5], parameters=[0.7])
    path = cg.solve(problem, cg.Galerkin(5), 6)
    found = cg.sensitivity(path)
    assert [by.shape for by in found.x.values()] == [(2, 7, 2), (2, 7, 1), (2, 7, 1)]
    np.testing.assert_array_equal(found.x["start"][:, 0], np.eye(2))
    np.testing.assert_array_equal(found.x["end"][1, -1], [1.0])
    tr = cg.transcribe(problem, path.method, 6)
    for name, data in (("start", [0.3, 0.1]), ("end", [None, 0.5]), ("parameters", [0.7])):
        fixed = [i for i, value in enumerate(data) if value is not None]
        for column, i in enumerate(fixed):
            expected = difference(lambda moved, name=name: tr.solve(guess=path, **{name: moved}).x, data, i)
            np.testing.assert_allclose(found.x[name][:, :, column], expected, rtol=AGREEMENT, atol=AGREEMENT)


def test_sensitivity_of_a_path_found_to_a_tolerance():
    path = cg.solve(spring(), tol=1e-10)
    x = np.sin(RATE * path.t) / np.sin(RATE * DURATION)
    np.testing.assert_allclose(cg.sensitivity(path).x["end"][0, :, 0], x, rtol=0, atol=AGREEMENT)


def test_sensitivity_belongs_to_the_data_of_the_path_not_of_the_first_problem():
    tr = cg.transcribe(spring(), cg.Galerkin(8), 10)
    moved = cg.sensitivity(tr.solve(parameters=[1.0, 1.0], mesh=np.linspace(0, 1, 11)))
    np.testing.assert_allclose(moved.x["end"][0, :, 0], np.sin(moved.t) / np.sin(1), rtol=0, atol=AGREEMENT)


def test_sensitivity_without_unknowns_is_that_of_the_given_ends():
    found = cg.sensitivity(cg.solve(spring(), cg.Galerkin(1), intervals=1))
    np.testing.assert_array_equal(found.x["start"][0], [[1.0], [0.0]])
    np.testing.assert_array_equal(found.x["end"][0], [[0.0], [1.0]])
    np.testing.assert_array_equal(found.x["parameters"][0], 0)


def test_sensitivity_refuses_what_is_no_path():
    with pytest.raises(TypeError, match="takes a Trajectory, got BoundaryProblem"):
        cg.sensitivity(spring())


# one graph in another


def test_function_survives_serialization_with_its_derivatives(swing):
    f, path = swing
    again = ca.Function.deserialize(f.serialize())
    for original, copy in ((f, again), (f.jacobian(), again.jacobian())):
        for name, value in original(**numbers(path)).items():
            np.testing.assert_array_equal(dense(copy(**numbers(path))[name]), dense(value))


def test_function_maps_over_many_data():
    f, path = solved(spring(), 4, 6)
    ends = np.linspace(0.5, 2.0, 7)[None, :]
    repeated = [ca.repmat(ca.DM(path.polynomial.values), 1, 7)]
    many = f.map(7)(np.full((1, 7), 0.4), ends, np.tile([[1.0], [RATE**2]], (1, 7)), *repeated)[0]
    for k, x in enumerate(np.split(np.array(many), 7, axis=1)):
        one = f(start=[0.4], end=[ends[0, k]], parameters=[1.0, RATE**2], guess=path.polynomial.values)["x"]
        np.testing.assert_array_equal(x, np.array(one))


@pytest.mark.parametrize("side", ["start", "end"])
def test_action_is_that_of_the_path_where_a_momentum_is_given(side):
    given = {"start": [0.4], "end": [0.4], side: [None], f"{side}_momentum": [0.3]}
    problem = cg.BoundaryProblem(lambda t, x, v: (v[0] ** 2 - x[0] ** 2) / 2, (0.0, 1.2), **given)
    path = cg.solve(problem, cg.Galerkin(4), 6)
    f = cg.solution_function(problem, cg.Galerkin(4), 6)
    assert float(f(0.4, path.polynomial.values)[2]) == pytest.approx(path.action, rel=1e-12)


# nothing unverified


@pytest.mark.parametrize("derivative", [ca.jacobian, ca.gradient, lambda x, p: ca.hessian(x, p)[0]])
def test_without_a_solution_its_derivatives_are_nan(derivative):
    f, path = solved(bratu_problem())
    rate = ca.MX.sym("rate")
    middle = f(start=0, end=0, parameters=rate, guess=path.polynomial.values)["x"][0, 5]
    slope = ca.Function("slope", [rate], [derivative(middle, rate)])
    assert np.isfinite(float(slope(1.0)))
    assert np.isnan(float(slope(3.6)))


@pytest.mark.parametrize("rate", [3.6, *slow(10.0)])
def test_without_a_solution_every_output_is_nan(rate, capfd):
    f, path = solved(bratu_problem())
    result = f(start=[0], end=[0], parameters=[rate], guess=path.polynomial.values)
    assert all(np.isnan(dense(value)).all() for value in result.values())
    assert capfd.readouterr() == ("", "")


def test_just_below_the_critical_value_there_is_a_solution():
    f, path = solved(bratu_problem())
    near = cg.solve(bratu_problem().varied({"parameters": [3.51]}, (0.0, 1.0)), cg.Galerkin(8), 10)
    result = f(start=[0], end=[0], parameters=[3.51], guess=path.polynomial.values)
    np.testing.assert_allclose(result["x"], near.x, rtol=0, atol=1e-9)  # next to the fold, condition number 1e3


def test_guess_that_is_not_finite_gives_nan(swing, capfd):
    f, path = swing
    result = f(**{**numbers(path), "guess": np.full(path.polynomial.values.shape, np.nan)})
    assert all(np.isnan(dense(value)).all() for value in result.values())
    assert capfd.readouterr() == ("", "")


def test_without_a_given_value_every_output_is_nan(swing):
    f, path = swing
    for name in set(numbers(path)) - {"guess"}:
        result = f(**{key: value for key, value in numbers(path).items() if key != name})
        assert all(np.isnan(dense(value)).all() for value in result.values())


def test_domain_left_gives_nan(capfd):
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.log(x[0]), (0.0, 1.0), [1.0], [2.0])
    f, path = solved(problem)
    result = f(start=[-1], end=[2], guess=path.polynomial.values)
    assert all(np.isnan(dense(value)).all() for value in result.values())
    assert capfd.readouterr() == ("", "")


def test_ends_off_a_constraint_that_follows_parameters_give_nan():
    rod = cg.BoundaryProblem(
        lambda t, x, v, p: ca.sumsqr(v) / 2 - x[1],
        (0.0, 1.0),
        start=[0.0, -1.0],
        end=[1.0, 0.0],
        constraint=lambda t, x, p: ca.sumsqr(x) - p[0] ** 2,
        parameters=[1.0],
    )
    f, path = solved(rod)
    given = {"start": [0, -1], "end": [1, 0], "parameters": 1, "guess": path.polynomial.values}
    np.testing.assert_allclose(f(**given)["x"], path.x, rtol=0, atol=1e-12)
    for off in ({"start": [0, -1.01]}, {"end": [1, 0.1]}, {"parameters": 1 + 1e-9}):
        assert all(np.isnan(dense(value)).all() for value in f(**(given | off)).values())
    longer = {name: 2 * np.array(given[name]) for name in ("start", "end", "guess")}
    assert np.isfinite(dense(f(**longer, parameters=2)["action"])).all()


def test_a_problem_without_a_solution_is_refused_when_the_function_is_built():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 4 * ca.exp(x[0]), (0.0, 1.0), [0.0], [0.0])
    with pytest.raises(cg.ConvergenceError, match="no path was found"):
        cg.solution_function(problem, cg.Galerkin(4), 10)


def test_conjugate_ends_are_refused_when_the_function_is_built():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0.0, np.pi), [0.0], [0.0])
    with pytest.raises(cg.ConjugatePointError):
        cg.solution_function(problem, cg.Galerkin(10), 10)


def coupled(units):
    """∂x/∂x_N of two coupled oscillators in units of their own, taken back to one."""
    a, b = units
    problem = cg.BoundaryProblem(
        lambda t, x, v: (v[0] / a) ** 2 / 2 + (v[1] / b) ** 2 / 2 + x[0] / a * x[1] / b, (0, 1), [0.0, 0.0], [a, b]
    )
    by_end = cg.sensitivity(cg.solve(problem, cg.Galerkin(6), 10)).x["end"]
    return by_end / np.array(units)[:, None, None] * units


def test_derivatives_do_not_depend_on_units():
    np.testing.assert_allclose(coupled((1e-10, 1e10)), coupled((1.0, 1.0)), rtol=0, atol=1e-12)


@pytest.mark.parametrize("unit", [1e-12, *slow(1e12)])
def test_jacobian_beside_multipliers_has_any_unit_of_the_action(unit):
    """x = cos(√p t)/cos √p from rest to x(1) = 1, an end condition; in units of 1e12 QR took pivots for zero."""
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: unit * (v[0] ** 2 - p[0] * x[0] ** 2) / 2,
        (0, 1),
        [None],
        [None],
        start_momentum=[0.0],
        end_conditions=lambda a, b, p: b[0] - 1,
        parameters=[0.7],
    )
    path = cg.solve(problem, cg.Galerkin(8), 4)
    f = cg.solution_function(problem, path.method, 4)
    jacobian = f.jacobian()(parameters=[0.7], guess=path.polynomial.values)["jac_x_parameters"]
    root = np.sqrt(0.7)
    assert float(jacobian[0]) == pytest.approx(np.tan(root) / np.cos(root) / (2 * root), rel=1e-9)


@pytest.mark.parametrize("angle", [0.0, *slow(0.5)])
def test_function_of_a_pendulum_on_a_rod_may_be_built_at_rest(angle):
    """Its equations are scaled by terms that vanish there."""

    def at(angle):
        return [np.sin(angle), -np.cos(angle)]

    rod = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 - 9.81 * x[1],
        (0, 1),
        at(0.0),
        at(0.0),
        constraint=lambda t, x: ca.sumsqr(x) - 1,
    )
    by_angle = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + 9.81 * ca.cos(x[0]), (0, 1), [0.0], [angle])
    function, turned = cg.solution_function(rod, cg.Galerkin(8), 8), cg.solve(by_angle, cg.Galerkin(8), 8)
    nodes = [at(value) for value in turned.polynomial.values[0]]
    found = function(start=at(0.0), end=at(angle), guess=np.transpose(nodes))
    assert float(found["action"]) == pytest.approx(turned.action, rel=AGREEMENT)
