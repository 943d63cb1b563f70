"""Bad input: a clear error that names what came and what was expected, before anything is solved."""

import math

import casadi as ca
import numpy as np
import pytest
from scenes import oscillator

import casadi_galerkin as cg


def problem(**changes):
    fields = {"lagrangian": oscillator, "t_span": (0.0, 1.0), "start": [0.0], "end": [1.0]} | changes
    return cg.BoundaryProblem(**fields)


METHOD = cg.Galerkin(2)


@pytest.mark.parametrize(
    ("changes", "kind", "message"),
    [
        ({"end": [1.0, 2.0]}, ValueError, r"end must have 1 component\(s\), got 2"),
        ({"start": []}, ValueError, r"start must have at least one component\(s\), got 0"),
        ({"start": 0.0}, TypeError, "start must be a sequence of numbers, one for each component, got 0.0"),
        ({"start": "0"}, TypeError, "start must be a sequence of numbers.* got '0'"),
        ({"start": (v for v in [0.0])}, TypeError, "start must be a sequence of numbers.* got <generator"),
        ({"start": {0.0}}, TypeError, "start must be a sequence of numbers"),
        ({"start": np.array(0.0)}, (TypeError, ValueError), "start must be"),
        ({"start": np.zeros((1, 1))}, ValueError, r"start must be one-dimensional, got an array of shape \(1, 1\)"),
        ({"start": ca.DM([[0.0, 1.0], [2.0, 3.0]])}, TypeError, "start must be a sequence of numbers"),
        ({"start": ca.MX.sym("x", 1)}, TypeError, r"start must be a sequence of numbers.* got MX"),
        ({"start": ca.SX.sym("x", 1)}, TypeError, r"start must be a sequence of numbers.* got SX"),
        ({"start": ["0.0"]}, TypeError, r"start\[0\] must be a number or None, got '0.0'"),
        ({"start": [True]}, TypeError, r"start\[0\] must be a number or None, got True"),
        ({"start": [1j]}, TypeError, r"start\[0\] must be a number or None, got 1j"),
        ({"start": np.array([1j])}, TypeError, r"start\[0\] must be a number or None"),
        ({"start": [[0.0]]}, TypeError, r"start\[0\] must be a number or None, got \[0.0\]"),
        ({"end": [np.nan]}, ValueError, r"end\[0\] must be finite, got nan"),
        ({"end": [np.inf]}, ValueError, r"end\[0\] must be finite, got inf"),
        ({"end": None}, ValueError, r"end must have 1 component\(s\), got None; None is for a periodic path"),
        ({"periodic": True}, ValueError, r"a periodic path ends where it starts: leave out end, got \[1.0\]"),
        ({"periodic": "yes", "end": None}, TypeError, "periodic must be True or False, got 'yes'"),
        ({"t_span": (1.0, 0.0)}, ValueError, r"t_span must increase, got \(1.0, 0.0\)"),
        ({"t_span": (1.0, 1.0)}, ValueError, r"t_span must increase, got \(1.0, 1.0\)"),
        ({"t_span": (0.0,)}, ValueError, r"t_span must have 2 component\(s\), got 1"),
        ({"t_span": (0.0, 1.0, 2.0)}, ValueError, r"t_span must have 2 component\(s\), got 3"),
        ({"t_span": (0.0, None)}, ValueError, r"t_span must be all numbers, got \(0.0, None\)"),
        ({"t_span": (0.0, np.inf)}, ValueError, r"t_span\[1\] must be finite, got inf"),
        ({"t_span": 1.0}, TypeError, "t_span must be a sequence of numbers.* got 1.0"),
        ({"parameters": [None]}, ValueError, r"parameters must be all numbers, got \[None\]"),
        ({"parameters": 2.0}, TypeError, "parameters must be a sequence of numbers.* got 2.0"),
        ({"parameters": []}, ValueError, r"parameters must have at least one component\(s\), got 0"),
    ],
    ids=lambda value: str(value)[:40] if isinstance(value, dict) else "",
)
def test_a_problem_that_does_not_fit_is_refused(changes, kind, message):
    with pytest.raises(kind, match=message):
        problem(**changes)


@pytest.mark.parametrize(
    ("lagrangian", "kind", "message"),
    [
        (lambda t, x, v: v, ValueError, r"lagrangian must return a scalar, got shape \(2, 1\)"),
        (lambda t, x, v: ca.vertcat(v[0], x[0], v[1]), ValueError, r"must return a scalar, got shape \(3, 1\)"),
        (lambda t, x, v: 1.0, ValueError, r"the lagrangian ignores v\[0\], v\[1\]: without a velocity"),
        (lambda t, x, v: None, TypeError, "must return a CasADi expression.* got NoneType: None"),
        (lambda t, x, v: "L", TypeError, "must return a CasADi expression.* got str: 'L'"),
        (lambda t, x, v: ca.DM(1.0), ValueError, r"the lagrangian ignores v\[0\], v\[1\]"),
        (lambda t, x, v: True, TypeError, "must return a CasADi expression.* got bool: True"),
        (lambda t, x, v: ca.MX.sym("a"), TypeError, "must return a CasADi expression, got MX"),
        (lambda t, x, v: ca.SX.sym("a") * v[0] + v[1], ValueError, "lagrangian depends on .*a.* besides its arguments"),
        (lambda t, x, v: v[0] ** 2 + x[1], ValueError, r"ignores v\[1\]: without a velocity"),
        (lambda t, x, v: ca.sum1(x), ValueError, r"ignores v\[0\], v\[1\]"),
        (lambda t, x, v: v[0] ** 2 + v[1] + math.cos(x[0]), TypeError, "not with math or NumPy ones"),
        (lambda t, x, v: v[0] ** 2 + v[1] + np.linalg.norm(x), (TypeError, ValueError), "not with math or NumPy ones"),
        (lambda t, x, v: v[0] ** 2 + v[1] if x[0] > 0 else 0, ValueError, "lagrangian failed when called with CasADi"),
        (lambda t, x: x[0], TypeError, r"lagrangian is called as lagrangian\(t, x, v\):"),
        (lambda t, x, v: v[2] ** 2, ValueError, "lagrangian failed when called with CasADi symbols"),
        (lambda t, x, v: 1 / 0, ValueError, "lagrangian failed when called.*division by zero"),
        ("v**2", TypeError, r"lagrangian must be a callable of \(t, x, v\), got 'v\*\*2'"),
        (None, TypeError, r"lagrangian must be a callable of \(t, x, v\), got None"),
    ],
)
def test_a_lagrangian_that_cannot_be_traced_is_refused(lagrangian, kind, message):
    with pytest.raises(kind, match=message):
        problem(lagrangian=lagrangian, start=[0.0, 0.0], end=[1.0, 1.0])


def test_a_lagrangian_without_second_derivatives_is_refused():
    with pytest.raises(ValueError, match="linear in x and v"):
        cg.solve(problem(lagrangian=lambda t, x, v: v[0] - 2 * x[0]), METHOD, 6)


def test_a_lagrangian_of_parameters_is_called_with_them():
    with pytest.raises(TypeError, match=r"is called as lagrangian\(t, x, v, p\):"):
        problem(parameters=[1.0, 2.0])
    with pytest.raises(ValueError, match=r"failed when called with CasADi symbols t, x, v, p \(2,\):"):
        problem(lagrangian=lambda t, x, v, p: p[2] * v[0] ** 2, parameters=[1.0, 2.0])
    with pytest.raises(TypeError, match=r"is called as lagrangian\(t, x, v\):"):
        problem(lagrangian=lambda t, x, v, p: p * v[0] ** 2)


def test_a_function_of_other_sizes_is_refused():
    traced = problem(start=[0, 0], end=[1, 1], lagrangian=lambda t, x, v: ca.sumsqr(v)).lagrangian
    with pytest.raises(ValueError, match=r"Function of inputs of lengths \[1, 2, 2\], expected \[1, 1, 1\]"):
        problem(lagrangian=traced)
    assert problem(lagrangian=problem().lagrangian).dimension == 1


@pytest.mark.filterwarnings(r"ignore:\s*casadi. a numpy function:FutureWarning")
@pytest.mark.parametrize("function", [np.cos, np.sqrt, np.exp])
def test_numpy_functions_that_casadi_can_trace_are_taken(function):
    """NumPy's ufuncs call the symbols' own methods: no reason to refuse them."""
    L = lambda t, x, v: v[0] ** 2 / 2 + function(x[0] + 1)  # noqa: E731
    assert problem(lagrangian=L).lagrangian.n_in() == 3


@pytest.mark.parametrize(
    ("arguments", "kind", "message"),
    [
        ({"degree": 0}, ValueError, "degree must be at least 1, got 0"),
        ({"degree": -2}, ValueError, "degree must be at least 1, got -2"),
        ({"degree": 2.0}, TypeError, "degree must be a whole number, got 2.0"),
        ({"degree": True}, TypeError, "degree must be a whole number, got True"),
        ({"degree": "4"}, TypeError, "degree must be a whole number, got '4'"),
        ({"degree": 3, "control_points": [0.5]}, ValueError, r"degree 3 takes 2 control points, got .* \(1,\)"),
        ({"degree": 3, "control_points": [0.0, 0.5]}, ValueError, r"increase within \]0, 1\[, got \[0.  0.5\]"),
        ({"degree": 3, "control_points": [0.5, 1.0]}, ValueError, r"must increase within \]0, 1\["),
        ({"degree": 3, "control_points": [0.7, 0.3]}, ValueError, r"must increase within \]0, 1\["),
        ({"degree": 3, "control_points": [0.5, 0.5]}, ValueError, r"must increase within \]0, 1\["),
        ({"degree": 3, "control_points": [0.5, np.nan]}, ValueError, r"must increase within \]0, 1\["),
        ({"degree": 3, "control_points": "ab"}, TypeError, "control points must be real numbers, got 'ab'"),
        ({"degree": 3, "control_points": [[0.2, 0.5]]}, ValueError, r"takes 2 control points, got .* \(1, 2\)"),
        ({"degree": 3, "control_points": [0.2, 0.5j]}, TypeError, "control points must be real numbers"),
        ({"degree": 3, "quadrature": 4}, TypeError, "quadrature must be a Quadrature such as gauss.3., got 4"),
        ({"degree": 3, "quadrature": cg.gauss}, TypeError, "quadrature must be a Quadrature"),
        ({"degree": 3, "quadrature": cg.gauss(2)}, ValueError, "degree 3 needs at least 3 quadrature points, got 2"),
    ],
)
def test_a_method_that_does_not_fit_is_refused(arguments, kind, message):
    with pytest.raises(kind, match=message):
        cg.Galerkin(**arguments)


@pytest.mark.parametrize(
    ("arguments", "kind", "message"),
    [
        ({"intervals": 0}, ValueError, "intervals must be at least 1, got 0"),
        ({"intervals": -1}, ValueError, "intervals must be at least 1, got -1"),
        ({"intervals": 2.0}, TypeError, "intervals must be a whole number, got 2.0"),
        ({"intervals": True}, TypeError, "intervals must be a whole number, got True"),
        ({"intervals": "3"}, TypeError, "intervals must be a whole number, got '3'"),
        ({}, ValueError, "give either intervals or mesh, got intervals=None and mesh=None"),
        ({"intervals": 2, "mesh": [0, 1]}, ValueError, "give either intervals or mesh, got intervals=2"),
        ({"mesh": [0, 0.7, 0.4, 1]}, ValueError, r"must increase, got t\[1\] = 0.7 and t\[2\] = 0.4"),
        ({"mesh": [0, 0.5, 0.5, 1]}, ValueError, r"must increase, got t\[1\] = 0.5 and t\[2\] = 0.5"),
        ({"mesh": [0, np.nan, 1]}, ValueError, "joints of a mesh must be finite"),
        ({"mesh": [0.1, 1]}, ValueError, "the mesh must run from 0.0 to 1.0, got 0.1 to 1.0"),
        ({"mesh": [0]}, ValueError, r"a sequence of at least 2 joints, got shape \(1,\)"),
        ({"mesh": 1.0}, ValueError, r"a sequence of at least 2 joints, got shape \(\)"),
        ({"mesh": [[0, 1]]}, ValueError, r"a sequence of at least 2 joints, got shape \(1, 2\)"),
        ({"mesh": "01"}, TypeError, "the joints of a mesh must be real numbers, got '01'"),
        ({"mesh": [0, 0.5j, 1]}, TypeError, "the joints of a mesh must be real numbers"),
    ],
)
def test_a_mesh_that_does_not_fit_is_refused(arguments, kind, message):
    with pytest.raises(kind, match=message):
        cg.solve(problem(), METHOD, **arguments)


@pytest.mark.parametrize(
    ("guess", "kind", "message"),
    [
        (
            np.zeros((1, 3)),
            ValueError,
            r"shape \(1, 5\) for values at the joints or \(1, 9\) at all nodes, got \(1, 3\)",
        ),
        (np.zeros(5), ValueError, r"the guess must have the shape \(1, 5\).* got \(5,\)"),
        (np.zeros((2, 5)), ValueError, r"the guess must have the shape \(1, 5\).* got \(2, 5\)"),
        (3.0, ValueError, r"the guess must have the shape .* got \(\)"),
        ("line", TypeError, "the guess must be real numbers, got 'line'"),
        (np.zeros((1, 5)) * 1j, TypeError, "the guess must be real numbers"),
        (np.full((1, 5), np.nan), ValueError, "the guess must be finite, got .nan. at t = 0.0"),
        (lambda t: t, ValueError, r"the guess must return an array of shape \(1,\), got \(\)"),
        (lambda t: [t, t], ValueError, r"the guess must return an array of shape \(1,\), got \(2,\)"),
        (lambda t: [np.nan if t > 0.6 else t], ValueError, r"the guess must be finite, got \[nan\] at t = 0.625"),
        (lambda t: None, TypeError, "values of the guess must be real numbers, got None"),
        (lambda: [0.0], TypeError, "takes 0 positional arguments but 1 was given"),
        (lambda t: ["a"], TypeError, "values of the guess must be real numbers, got"),
    ],
)
def test_a_guess_that_does_not_fit_is_refused(guess, kind, message):
    with pytest.raises(kind, match=message):
        cg.solve(problem(), METHOD, intervals=4, guess=guess)


def test_a_path_of_other_components_is_refused_as_guess():
    other = cg.solve(problem(lagrangian=lambda t, x, v: ca.sumsqr(v), start=[0, 0], end=[1, 1]), METHOD, intervals=2)
    for guess in (other, other.polynomial):
        with pytest.raises(ValueError, match=r"the guess must be a path of 1 component\(s\), got 2"):
            cg.solve(problem(), METHOD, intervals=2, guess=guess)


@pytest.mark.parametrize(
    ("changes", "kind", "message"),
    [
        ({"start": [0.0, 1.0]}, ValueError, r"start must have 1 component\(s\), got 2"),
        ({"start": [None]}, ValueError, r"start must have None where the problem has it, \(0.0,\), got \(None,\)"),
        ({"end": [np.nan]}, ValueError, r"end\[0\] must be finite, got nan"),
        ({"end": ["1"]}, TypeError, r"end\[0\] must be a number or None, got '1'"),
        ({"parameters": [1.0]}, ValueError, r"the problem has no parameters, got parameters=\[1.0\]"),
        ({"mesh": [0, 0.5, 1]}, ValueError, "this transcription has 4 intervals, got a mesh of 2"),
        ({"mesh": [0, 0.6, 0.5, 0.7, 1]}, ValueError, "the joints of a mesh must increase"),
        ({"solver": "ipopt"}, TypeError, "solver must be newton, rootfinder, ipopt or minimizer, got 'ipopt'"),
        ({"solver": None}, TypeError, "solver must be newton, rootfinder, ipopt or minimizer, got None"),
        ({"finish": [1.0]}, TypeError, "unexpected keyword argument 'finish'"),
    ],
)
def test_a_repeated_solve_with_input_that_does_not_fit_is_refused(changes, kind, message):
    tr = cg.transcribe(problem(), METHOD, 4)
    with pytest.raises(kind, match=message):
        tr.solve(**changes)


def test_parameters_of_another_length_are_refused():
    tr = cg.transcribe(problem(lagrangian=lambda t, x, v, p: p * v[0] ** 2, parameters=[1.0]), METHOD, 2)
    with pytest.raises(ValueError, match=r"parameters must have 1 component\(s\), got 2"):
        tr.solve(parameters=[1.0, 2.0])


def test_a_free_component_cannot_be_given_later():
    tr = cg.transcribe(problem(end=[None]), METHOD, 2)
    with pytest.raises(ValueError, match=r"end must have None where the problem has it, \(None,\), got \(1.0,\)"):
        tr.solve(end=[1.0])


@pytest.mark.parametrize("other", [None, oscillator, {"lagrangian": oscillator}, "problem"])
def test_what_is_no_problem_is_refused(other):
    with pytest.raises(TypeError, match=f"problem must be a BoundaryProblem, got {type(other).__name__}"):
        cg.solve(other, METHOD, intervals=2)


@pytest.mark.parametrize("other", [None, 4, "gauss", cg.Galerkin, cg.gauss(3)])
def test_what_is_no_method_is_refused(other):
    with pytest.raises(TypeError, match=r"method must be a Galerkin, such as Galerkin.degree=4., got"):
        cg.solve(problem(), other, intervals=2)


@pytest.mark.parametrize("other", [None, oscillator, {"lagrangian": oscillator}, "problem"])
def test_what_is_no_problem_is_refused_with_a_tolerance(other):
    with pytest.raises(TypeError, match=f"problem must be a BoundaryProblem, got {type(other).__name__}"):
        cg.solve(other, tol=1e-6)


@pytest.mark.parametrize("other", [0, 6, "gauss", cg.Galerkin, cg.gauss(3)])
def test_what_is_no_method_is_refused_with_a_tolerance(other):
    with pytest.raises(TypeError, match=r"method must be a Galerkin, such as Galerkin.degree=4., got"):
        cg.solve(problem(), other, tol=1e-3)


@pytest.mark.parametrize("name", ["lagrange", "tspan", "ends", "params"])
def test_unknown_names_are_refused(name):
    with pytest.raises(TypeError, match=f"unexpected keyword argument '{name}'"):
        problem(**{name: 1})
    with pytest.raises(TypeError, match=f"unexpected keyword argument '{name}'"):
        cg.solve(problem(), METHOD, intervals=2, **{name: 1})
    with pytest.raises(TypeError, match=f"unexpected keyword argument '{name}'"):
        cg.Galerkin(2, **{name: 1})


@pytest.mark.parametrize("call", ["emb", "delta"])
@pytest.mark.parametrize("shape", [(4,), (1, 4), (2, 3, 5)])
def test_node_values_of_another_shape_are_refused(call, shape):
    calculus = cg.DiscreteCalculus(METHOD, [0.0, 0.5, 1.0])
    with pytest.raises(ValueError, match=r"node values must have the shape \(d, 5\), got \("):
        getattr(calculus, call)(np.zeros(shape))


@pytest.mark.parametrize("values", [np.zeros(3), np.zeros((4, 3)), 1.0])
def test_integrands_of_another_shape_are_refused(values):
    calculus = cg.DiscreteCalculus(METHOD, [0.0, 0.5, 1.0])
    with pytest.raises(ValueError, match=r"quadrature points must have the shape \(\.\.\., 4\), got"):
        calculus.integral(values)


@pytest.mark.parametrize("numbers", [np.array([0, 1]), (0, 1), [np.float32(0), np.int64(1)], ca.DM([0, 1])])
def test_numbers_of_any_kind_are_taken(numbers):
    free = problem(lagrangian=lambda t, x, v: ca.sumsqr(v), start=numbers, end=numbers)
    assert free.start == (0.0, 1.0)
    assert all(type(value) is float for value in free.start)


def test_fewer_points_than_the_degree_would_be_silently_wrong():
    """Why they are refused: with the check passed by, the equations have a solution far from the path."""
    method = cg.Galerkin(3)
    object.__setattr__(method, "quadrature", cg.gauss(2))
    tr = cg.transcribe(problem(), method, 4)
    hessian = np.array(ca.DM(tr.hessian(np.zeros(tr.gradient.size1_in(0)), [0.0], [1.0], tr.mesh)))
    assert np.count_nonzero(np.linalg.eigvalsh(hessian) < 0) == 4  # one spurious direction an interval
