"""Lagrangians given as callables: traced, or refused with a reason."""

import math

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator
from scenes import oscillator, oscillator_problem

import casadi_galerkin as cg


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
        (
            lambda t, x, v: v[0] ** 2 + v[1] + np.linalg.norm(x),
            (TypeError, ValueError),
            "not with math or NumPy ones",
        ),
        (lambda t, x, v: v[0] ** 2 + v[1] ** 2 + ca.MX.sym("k"), TypeError, "of SX, .* nor with MX symbols"),
        (lambda t, x, v: v[0] ** 2 + v[1] if x[0] > 0 else 0, ValueError, "failed when called with CasADi.*if_else"),
        (lambda t, x, v: sum(v**2), (TypeError, ValueError), r"failed [^\n]*[^.]\. Write it with"),
        (lambda t, x: x[0], TypeError, r"lagrangian is called as lagrangian\(t, x, v\), got one of \(t, x\)$"),
        (lambda x, v: v[0], TypeError, r"lagrangian is called as lagrangian\(t, x, v\), got one of \(x, v\)$"),
        (lambda x, v, t: v[0] * t, TypeError, r"lagrangian\(t, x, v\), in this order, got one of \(x, v, t\)"),
        (
            lambda t, x, v: v[2] ** 2,
            ValueError,
            "index is out of range of so many components, t has 1, x has 2, v has 2$",
        ),
        (lambda t, x, v: v[0, 2], ValueError, "lagrangian failed .* index is out of range of so many components"),
        (lambda t, x, v: [v[0]][2], ValueError, "lagrangian failed .* index is out of range of so many components"),
        (lambda t, x, v: np.array([v[0], v[1]]), TypeError, "lagrangian must return a CasADi expression, got ndarray"),
        (lambda t, x, v: 1j, TypeError, "lagrangian must return a CasADi expression, got complex: 1j"),
        (lambda t, x, v: 1 / 0, ValueError, "lagrangian failed when called.*division by zero"),
        ("v**2", TypeError, r"lagrangian must be a callable of \(t, x, v\), got 'v\*\*2'"),
        (None, TypeError, r"lagrangian must be a callable of \(t, x, v\), got None"),
    ],
)
def test_a_lagrangian_that_cannot_be_traced_is_refused(lagrangian, kind, message):
    with pytest.raises(kind, match=message):
        oscillator_problem(lagrangian=lagrangian, start=[0.0, 0.0], end=[1.0, 1.0])


def test_a_lagrangian_of_parameters_is_called_with_them():
    with pytest.raises(TypeError, match=r"is called as lagrangian\(t, x, v, p\), .* p because parameters are given"):
        oscillator_problem(parameters=[1.0, 2.0])
    with pytest.raises(ValueError, match=r"failed when called with CasADi symbols t, x, v, p \(2,\):"):
        oscillator_problem(lagrangian=lambda t, x, v, p: p[2] * v[0] ** 2, parameters=[1.0, 2.0])
    with pytest.raises(TypeError, match=r"is called as lagrangian\(t, x, v\), .* If it takes p, give parameters"):
        oscillator_problem(lagrangian=lambda t, x, v, p: p * v[0] ** 2)


def function(output, kind=ca.SX, arguments="txv"):
    """Function of t, x, v and p, one number each, whose value may depend on another symbol q."""
    symbols = {name: kind.sym(name) for name in "txvpq"}
    values = [output(**symbols)] if not isinstance(output, list) else [value(**symbols) for value in output]
    return ca.Function("L", [symbols[name] for name in arguments], values, {"allow_free": True})


def kinetic(v, **others):
    return v**2 / 2


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
@pytest.mark.parametrize(
    ("output", "arguments", "error", "message"),
    [
        (lambda v, q, **_: q * v**2, "txv", ValueError, "lagrangian depends on q besides its arguments t, x, v"),
        (lambda v, **_: np.nan * v**2, "txv", TypeError, "lagrangian holds a constant that is not a number"),
        (lambda x, **_: x**2, "txv", ValueError, r"the lagrangian ignores v\[0\]"),
        (lambda x, v, **_: ca.vertcat(x, v), "txv", ValueError, r"lagrangian must return a scalar, got shape \(2, 1\)"),
        ([kinetic, kinetic], "txv", ValueError, r"lagrangian must be a Function of one output, got 2: \['o0', 'o1'\]"),
        ([], "txv", ValueError, "lagrangian must be a Function of one output, got 0"),
        (kinetic, "xv", ValueError, r"of inputs of lengths \[1, 1\], expected \[1, 1, 1\] for t, x, v"),
        (kinetic, "txvp", ValueError, r"lengths \[1, 1, 1, 1\], expected \[1, 1, 1\].* If it takes p, give parameters"),
    ],
)
def test_a_function_is_checked_like_any_callable(kind, output, arguments, error, message):
    with pytest.raises(error, match=message):
        oscillator_problem(lagrangian=function(output, kind, arguments))


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        (
            "force",
            "txv",
            r"force is a Function of inputs of lengths \[1, 1, 1\], expected \[1, 1, 1, 1\] for t, x, v, u",
        ),
        ("running_cost", "txvpq", r"running_cost is a Function of inputs of lengths \[1, 1, 1, 1, 1\]"),
        ("terminal_cost", "txvp", r"terminal_cost is a Function of inputs of lengths \[1, 1, 1, 1\]"),
    ],
)
def test_forces_and_costs_that_are_functions_are_checked_as_well(name, arguments, message):
    with pytest.raises(ValueError, match=message):
        double_integrator(**{name: function(kinetic, arguments=arguments)})
    right = "txv" if name == "terminal_cost" else "txvp"
    with pytest.raises(ValueError, match=f"{name} depends on q besides its arguments"):
        double_integrator(**{name: function(lambda q, **_: q, arguments=right)})
    with pytest.raises(TypeError, match=f"{name} holds a constant that is not a number"):
        double_integrator(**{name: function(lambda v, **_: v * np.nan, arguments=right)})


def test_a_function_with_parameters_takes_them_last():
    with pytest.raises(ValueError, match=r"expected \[1, 1, 1, 1\].* It is called with p because parameters are given"):
        oscillator_problem(lagrangian=function(kinetic), parameters=[1.0])
    assert oscillator_problem(lagrangian=function(kinetic, arguments="txvp"), parameters=[1.0]).dimension == 1


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_a_function_gives_the_path_of_the_callable(kind):
    given = function(lambda x, v, **_: v**2 / 2 - x**2 / 2, kind)
    paths = [cg.solve(oscillator_problem(lagrangian=L), cg.Galerkin(3), 4) for L in (given, oscillator)]
    assert paths[0].action == pytest.approx(paths[1].action, rel=1e-14)


def test_a_function_that_was_traced_before_is_kept():
    """What is derived of it is kept by its identity."""
    traced = oscillator_problem().lagrangian
    assert oscillator_problem(lagrangian=traced).lagrangian is traced


def test_a_function_of_other_sizes_is_refused():
    traced = oscillator_problem(start=[0, 0], end=[1, 1], lagrangian=lambda t, x, v: ca.sumsqr(v)).lagrangian
    with pytest.raises(ValueError, match=r"Function of inputs of lengths \[1, 2, 2\], expected \[1, 1, 1\]"):
        oscillator_problem(lagrangian=traced)


@pytest.mark.parametrize("force", [[0, 1.5], np.array([0, 1.5]), np.array([0, 1.5], dtype=object), ca.DM([0, 1.5])])
def test_forces_may_be_an_array(force):
    L = lambda t, x, v: ca.sumsqr(v)  # noqa: E731
    problem = cg.InitialProblem(L, (0, 1), [0, 0], velocity=[0, 0], force=lambda t, x, v: force)
    np.testing.assert_array_equal(np.array(problem.force(0, [0, 0], [0, 0])).ravel(), [0, 1.5])


def test_an_array_of_symbols_is_a_force_and_a_number_is_none_of_two():
    given = {"lagrangian": lambda t, x, v: ca.sumsqr(v), "t_span": (0, 1), "start": [0, 0], "velocity": [0, 0]}
    assert cg.InitialProblem(**given, force=lambda t, x, v: np.array([v[1], 0])).force.numel_out(0) == 2
    with pytest.raises(TypeError, match="force must return one CasADi expression per component, got array"):
        cg.InitialProblem(**given, force=lambda t, x, v: np.array(1.0))


@pytest.mark.filterwarnings(r"ignore:\s*casadi. a numpy function:FutureWarning")
@pytest.mark.parametrize("function", [np.cos, np.sqrt, np.exp])
def test_numpy_functions_that_casadi_can_trace_are_taken(function):
    """NumPy's ufuncs call the symbols' own methods: no reason to refuse them."""
    L = lambda t, x, v: v[0] ** 2 / 2 + function(x[0] + 1)  # noqa: E731
    assert oscillator_problem(lagrangian=L).lagrangian.n_in() == 3


def test_a_callback_needs_derivatives():
    class Sine(ca.Callback):
        def __init__(self):
            ca.Callback.__init__(self)
            self.construct("sine")

        def get_n_in(self):
            return 1

        def get_n_out(self):
            return 1

        def eval(self, values):
            return [ca.sin(values[0])]

    class Differentiated(Sine):
        def has_jacobian(self):
            return True

        def get_jacobian(self, name, inputs, outputs, options):
            x, y = ca.MX.sym("x"), ca.MX.sym("y")
            return ca.Function(name, [x, y], [ca.cos(x)], inputs, outputs, options)

    def stated(sine):
        return cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - sine(x[0]), (0, 1), [0.0], [1.0])

    plain, smooth = Sine(), Differentiated()
    with pytest.raises(TypeError, match="lagrangian calls a casadi Function that has no derivatives"):
        stated(plain)
    found, expected = (cg.solve(stated(sine), cg.Galerkin(4), 5).action for sine in (smooth, ca.sin))
    assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
@pytest.mark.parametrize(
    "condition",
    [
        lambda x: x[0] == 1,
        lambda x: ca.vertcat(x[1], x[0] <= 1),
        lambda x: ca.vertcat(x[0] <= 1, x[1], x[0]),
        lambda x: ca.logic_and(x[0] > 0, x[1] > 0),
    ],
    ids=["equal", "second of two", "first of three", "and"],
)
def test_a_comparison_is_no_condition(condition, symbol):
    t, x = symbol.sym("t"), symbol.sym("x", 2)
    for constraint in (lambda t, x: condition(x), ca.Function("constraint", [t, x], [condition(x)])):
        with pytest.raises(TypeError, match=r"constraint must return numbers, got a comparison"):
            oscillator_problem(
                lagrangian=lambda t, x, v: ca.sumsqr(v) / 2, start=[1, 0], end=[0, 1], constraint=constraint
            )


def test_a_comparison_may_choose_a_value():
    problem = oscillator_problem(lagrangian=lambda t, x, v: v[0] ** 2 / 2 - (x[0] > 0) * x[0] ** 2)
    assert cg.solve(problem, cg.Galerkin(4), 2).residual <= 50
