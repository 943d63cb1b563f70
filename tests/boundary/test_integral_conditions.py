"""Given integrals: catenary, Dido's arc, eigenvalues as multipliers, and integrals beside whatever else is stated."""

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import mathieu_b
from slow import slow

import casadi_galerkin as cg

CLOSED_FORM = 1e-12
EIGENVALUE = 1e-10
METHOD = cg.Galerkin(8)


def free(t, x, v):
    """L of a free particle of mass one."""
    return ca.dot(v, v) / 2


def arc(t, x, v):
    """Length of the graph of x(t)."""
    return ca.sqrt(1 + v[0] ** 2)


def area(t, x, v):
    return x[0]


def bump(scale=1.0):
    """A guess that is zero at 0 and 1."""
    return lambda t: np.array([scale * t * (1 - t)])


def held(integrand=area, values=(1.0,), start=(0.0,), end=(0.0,), lagrangian=free, t_span=(0, 1), **others):
    return cg.BoundaryProblem(lagrangian, t_span, start, end, integral_conditions=(integrand, values), **others)


def hanging(length=3.0):
    """A cable between (-1, 0) and (1, 0); x is its height and L its potential energy."""
    return held(arc, [length], lagrangian=lambda t, x, v: x[0] * arc(t, x, v), t_span=(-1, 1))


def catenary(length=3.0):
    """The parameter a of x = a cosh(t / a) + constant."""
    return brentq(lambda a: 2 * a * np.sinh(1 / a) - length, 0.05, 50)


def dido(length=1.3):
    return held(arc, [length], lagrangian=lambda t, x, v: -x[0])


def radius(length=1.3):
    """Radius of the circle, and half the angle of the arc over a chord of length one."""
    half = brentq(lambda angle: angle / np.sin(angle) - length, 1e-3, np.pi / 2)
    return 0.5 / np.sin(half), half


def mathieu(q):
    """x'' + (a - 2q cos 2t) x = 0 with zero ends: -a is the multiplier."""
    return held(
        lambda t, x, v: x[0] ** 2 / 2,
        [0.5],
        lagrangian=lambda t, x, v: v[0] ** 2 / 2 + q * ca.cos(2 * t) * x[0] ** 2,
        t_span=(0, np.pi),
    )


def string():
    """A string of density (1 + t)^-2, whose eigenvalues are 1/4 + (n π / log 2)²."""
    return held(lambda t, x, v: x[0] ** 2 / (1 + t) ** 2 / 2, [0.5])


def mode(number, last):
    return lambda t: np.array([np.sin(number * np.pi * t / last)])


@pytest.mark.slow
def test_a_hanging_cable_is_a_catenary_with_its_tension_as_multiplier():
    path, a = cg.solve(hanging(), tol=1e-13, guess=bump_down), catenary()
    np.testing.assert_allclose(path.x[0], a * np.cosh(path.t / a) - a * np.cosh(1 / a), rtol=0, atol=CLOSED_FORM)
    assert path.integral_multipliers == pytest.approx([a * np.cosh(1 / a)], abs=CLOSED_FORM)
    assert path.energy == pytest.approx(-a, abs=CLOSED_FORM)  # that of L + μ g, the horizontal pull
    assert path.morse_index == 0


def bump_down(t):
    return np.array([0.9 * (t**2 - 1)])


@pytest.mark.slow
def test_didos_arc_is_that_of_a_circle():
    path, (r, half) = cg.solve(dido(), tol=1e-13, guess=bump()), radius()
    height = np.sqrt(r**2 - (path.t - 0.5) ** 2) - r * np.cos(half)
    np.testing.assert_allclose(path.x[0], height, rtol=0, atol=CLOSED_FORM)
    assert path.integral_multipliers == pytest.approx([r], abs=CLOSED_FORM)
    assert path.action == pytest.approx(-(r**2) * (half - np.sin(half) * np.cos(half)), abs=CLOSED_FORM)
    assert path.morse_index == 0


@pytest.mark.parametrize("number", [1, 2, 10, *slow(*range(3, 10))])
@pytest.mark.parametrize("q", [1.0, *slow(5.0)])
def test_multipliers_are_mathieus_eigenvalues_and_the_index_tells_their_number(number, q):
    path = cg.solve(mathieu(q), METHOD, 20, guess=mode(number, np.pi))
    assert -path.integral_multipliers[0] == pytest.approx(mathieu_b(number, q), abs=EIGENVALUE)
    assert path.morse_index == number - 1


@pytest.mark.parametrize("number", [1, 2, 10, *slow(*range(3, 10))])
def test_the_modes_of_a_string_of_varying_density(number):
    path = cg.solve(string(), METHOD, 20, guess=lambda t: np.array([np.sin(number * np.pi * np.log2(1 + t))]))
    assert -path.integral_multipliers[0] == pytest.approx(0.25 + (number * np.pi / np.log(2)) ** 2, rel=EIGENVALUE)
    assert path.morse_index == number - 1


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_multiplier_is_of_order_2m(degree):
    exact, errors = mathieu_b(2, 5.0), []
    counts = np.array([16, 32, 64]) // degree
    for count in counts:
        path = cg.solve(mathieu(5.0), cg.Galerkin(degree), int(count), guess=mode(2, np.pi))
        errors.append(abs(path.integral_multipliers[0] + exact))
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert order == pytest.approx(2 * degree, abs=0.2)


@pytest.mark.parametrize("method", [cg.Galerkin(2), cg.Galerkin(4)])
def test_the_estimated_error_holds_for_the_multiplier(method):
    path = cg.solve(mathieu(5.0), method, 8, guess=mode(3, np.pi))
    error = abs(path.integral_multipliers[0] / mathieu_b(3, 5.0) + 1)
    assert error <= path.estimate_error()


@pytest.mark.slow
def test_paths_finds_modes_up_to_their_sign():
    found = cg.paths(mathieu(1.0), METHOD, 12, count=4, symmetries=[lambda x: -x])
    for path in found:
        assert -path.integral_multipliers[0] == pytest.approx(mathieu_b(path.morse_index + 1, 1.0), rel=1e-6)
    assert len({path.morse_index for path in found}) == len(found) == 4


@pytest.mark.parametrize("solver", [cg.newton, cg.ipopt, cg.minimizer, cg.rootfinder])
def test_every_solver_finds_the_multiplier(solver):
    path = cg.solve(mathieu(1.0), METHOD, 6, guess=lambda t: np.array([np.sin(t) + 0.2 * np.sin(2 * t)]), solver=solver)
    assert -path.integral_multipliers[0] == pytest.approx(mathieu_b(1, 1.0), abs=1e-8)


def test_two_integrals_have_two_multipliers():
    path = cg.solve(held(lambda t, x, v: [x[0], t * x[0]], [1.0, 0.6]), METHOD, 4)  # x'' = μ_0 + μ_1 t
    np.testing.assert_allclose(path.integral_multipliers, [24.0, -72.0], rtol=CLOSED_FORM)
    np.testing.assert_allclose(path.x[0], 12 * path.t**2 - 12 * path.t**3, rtol=0, atol=CLOSED_FORM)


def test_a_natural_end_is_free_beside_an_integral():
    path = cg.solve(held(end=[None]), METHOD, 4)  # x'' = μ with x'(1) = 0
    np.testing.assert_allclose(path.integral_multipliers, [-3.0], rtol=CLOSED_FORM)
    np.testing.assert_allclose(path.x[0], 3 * path.t - 1.5 * path.t**2, rtol=0, atol=CLOSED_FORM)


def test_a_force_acts_beside_an_integral():
    path, k = cg.solve(held(force=lambda t, x, v: -v), METHOD, 6), -1 / (1 - np.exp(-1))  # x'' = μ - x'
    shape = path.t + k * (1 - np.exp(-path.t))
    mu = 1 / (0.5 + k * np.exp(-1))
    np.testing.assert_allclose(path.integral_multipliers, [mu], rtol=CLOSED_FORM)
    np.testing.assert_allclose(path.x[0], mu * shape, rtol=0, atol=CLOSED_FORM)
    assert path.morse_index is None


@pytest.mark.slow
def test_a_holonomic_constraint_holds_beside_an_integral():
    problem = held(
        lambda t, x, v: x[2],
        start=[1.0, 0.0, 0.0],
        end=[0.0, 1.0, 1.0],
        constraint=lambda t, x: x[0] ** 2 + x[1] ** 2 - 1,
    )
    path = cg.solve(problem, METHOD, 6)  # z'' = μ on a cylinder
    np.testing.assert_allclose(path.integral_multipliers, [-6.0], rtol=CLOSED_FORM)
    np.testing.assert_allclose(path.x[2], path.t + 3 * path.t * (1 - path.t), rtol=0, atol=CLOSED_FORM)
    np.testing.assert_allclose(path.x[0], np.cos(np.pi / 2 * path.t), rtol=0, atol=CLOSED_FORM)
    assert path.morse_index == 0


def test_an_energy_is_given_beside_an_integral():
    problem = held(values=[0.3], end=[1.0], lagrangian=lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, energy=2.0)
    path = cg.solve(problem, tol=1e-11)
    fine = np.linspace(*path.t[[0, -1]], 20001)
    assert np.trapezoid(path(fine)[0], fine) == pytest.approx(0.3, abs=1e-9)
    np.testing.assert_allclose(path.energy, 2.0, rtol=1e-10)


def test_a_given_velocity_whose_momentum_depends_on_the_multiplier():
    problem = held(
        arc,
        [2.6],
        start=[None],
        lagrangian=lambda t, x, v: x[0] * arc(t, x, v),
        t_span=(-1, 1),
        start_velocity=[-1.0],
    )
    path = cg.solve(problem, METHOD, 12, guess=lambda t: np.array([0.5 * (t**2 - 1)]))
    a = -path.energy[0]
    lowest = -1 + a * np.arcsinh(1)  # where x' = 0
    assert a * (np.sinh((1 - lowest) / a) + 1) == pytest.approx(2.6, abs=1e-10)
    assert path(-1.0, 1)[0] == pytest.approx(-1.0, abs=1e-8)


def test_other_values_need_no_other_graph():
    transcription = cg.transcribe(held(), METHOD, 4)
    multipliers = [transcription.solve(integral_values=[value]).integral_multipliers[0] for value in (1.0, 2.0)]
    assert multipliers == pytest.approx([-12.0, -24.0], rel=CLOSED_FORM)


@pytest.mark.slow
def test_values_of_integrals_are_swept_and_continued():
    swept = cg.sweep(held(), [{"integral_values": [value]} for value in (1.0, 2.0, 3.0)], tol=1e-9)
    assert [path.integral_multipliers[0] for path in swept] == pytest.approx([-12.0, -24.0, -36.0], rel=1e-9)
    problem = held(lambda t, x, v, p: p[0] * x[0], lagrangian=lambda t, x, v, p: v[0] ** 2 / 2, parameters=[1.0])
    branch = cg.continuation(problem, [2.0], METHOD, 4)
    assert branch.reached
    assert branch.trajectories[-1].integral_multipliers == pytest.approx([-3.0], rel=1e-9)


def test_derivatives_by_values_and_parameters():
    problem = held(lambda t, x, v, p: p[0] * x[0], lagrangian=lambda t, x, v, p: v[0] ** 2 / 2, parameters=[2.0])
    by = cg.sensitivity(cg.solve(problem, METHOD, 4))
    np.testing.assert_allclose(by.x["integral_values"][0, :, 0], 3 * by.t * (1 - by.t), rtol=0, atol=CLOSED_FORM)
    np.testing.assert_allclose(by.x["parameters"][0, :, 0], -1.5 * by.t * (1 - by.t), rtol=0, atol=CLOSED_FORM)


@pytest.mark.parametrize(("end", "how"), [(0.0, {"tol": 1e-10}), *slow((0.1, {"tol": 1e-10}), (0.1, {}))])
def test_a_line_is_bent_to_the_length_that_small_changes_do_not_change(end, how):
    """A straight line has the least length: from there the side of less action is taken."""
    problem = held(arc, [1.3], end=[end], lagrangian=lambda t, x, v: x[0] * arc(t, x, v))
    path = cg.solve(problem, **how) if how else cg.solve(problem, METHOD, 8)
    a = -path.energy[0]
    assert 2 * a * np.sinh(1 / (2 * a)) == pytest.approx(np.sqrt(1.3**2 - end**2), abs=1e-9)
    assert path(0.5)[0] < 0
    assert path.morse_index == 0
    assert path.solver == "Newton"


@pytest.mark.parametrize("length", [0.5, 1.0])
@pytest.mark.parametrize("how", [{"tol": 1e-8}, {"method": METHOD, "intervals": 4}], ids=["tol", "mesh"])
def test_a_length_that_only_the_line_has_or_no_path_is_refused(length, how):
    with pytest.raises(
        cg.ConvergenceError, match=r"small changes of the guess do not change its integrals, \[.*\], and no arch"
    ):
        cg.solve(dido(length), **how)


def test_the_mode_of_no_guess_is_the_first():
    path = cg.solve(mathieu(1.0), tol=1e-10)
    assert -path.integral_multipliers[0] == pytest.approx(mathieu_b(1, 1.0), abs=EIGENVALUE)


def test_a_guess_of_many_waves_is_taken_to_a_mesh_of_its_own():
    path = cg.solve(mathieu(0.0), tol=1e-8, guess=mode(40, np.pi))
    assert -path.integral_multipliers[0] == pytest.approx(1600, rel=1e-8)
    assert path.morse_index == 39


def test_a_path_of_negative_masses_has_no_index():
    """The same arc, with the area as L: the multiplier, and with it the mass, is negative."""
    largest = held(arc, [1.3], lagrangian=area)
    path = cg.solve(largest, METHOD, 8, guess=bump())
    assert path.integral_multipliers == pytest.approx([-radius()[0]], abs=1e-7)
    assert "no Morse index, its smallest variation" in repr(path)


def test_a_path_without_given_integrals_has_no_multipliers():
    assert cg.solve(cg.BoundaryProblem(free, (0, 1), [0.0], [1.0]), METHOD, 2).integral_multipliers.shape == (0,)


@pytest.mark.slow
def test_an_integral_that_no_path_has_is_named():
    problem = held(lambda t, x, v: x[0] ** 2, [-1.0])
    with pytest.raises(cg.ConvergenceError, match=r"there may be no path with the integrals \[-1.0\]: here they are"):
        cg.solve(problem, METHOD, 6, guess=bump())


@pytest.mark.parametrize(
    ("conditions", "kind", "message"),
    [
        (area, TypeError, r"integral_conditions must be \(g, values\), a callable g and the values of its integrals"),
        ((area, [1.0, 2.0]), ValueError, "the values of integral_conditions must have 1 component, got 2"),
        ((area, [None]), ValueError, "the values of integral_conditions must be all numbers"),
        ((lambda t, x: x[0], [1.0]), TypeError, r"integral_conditions is called as integral_conditions\(t, x, v\)"),
        ((lambda t, x, v: v[0], [1.0]), ValueError, "integral_conditions are 1, but only 0 of the integrals can be"),
        ((lambda t, x, v: t, [1.0]), ValueError, "the same for all paths between these ends, or follow from them"),
        ((lambda t, x, v: [x[0], x[0] + t * v[0]], [1.0, 2.0]), ValueError, "are 2, but only 1 of the integrals"),
    ],
)
def test_conditions_that_do_not_fit_are_refused(conditions, kind, message):
    with pytest.raises(kind, match=message):
        cg.BoundaryProblem(free, (0, 1), [0.0], [0.0], integral_conditions=conditions)


@pytest.mark.parametrize(("action", "length", "time"), [(1e9, 1e-6, 1e3), (1e-8, 1e5, 1e-4)])
def test_units_change_no_digit_of_a_multiplier(action, length, time):
    def stretched(t, x, v):
        return ca.sqrt(1 + (v[0] * time / length) ** 2) / time

    problem = held(
        stretched, [3.0], lagrangian=lambda t, x, v: action * x[0] / length * stretched(t, x, v), t_span=(-time, time)
    )
    mu = catenary() * np.cosh(1 / catenary())
    assert cg.solve(problem, tol=1e-11).integral_multipliers == pytest.approx([action * mu], rel=1e-11)


def test_powers_of_one_component_are_two_integrals():
    path = cg.solve(held(lambda t, x, v: [x[0] ** 2, x[0] ** 4], [1.0, 1.6]), tol=1e-9)
    assert path.estimate_error() <= 1e-9


def test_an_integral_of_the_velocity_is_given_where_an_end_is_free():
    path = cg.solve(held(lambda t, x, v: v[0], [2.0], end=[None]), METHOD, 2)
    assert path.x[0, -1] == pytest.approx(2.0, abs=CLOSED_FORM)


@pytest.mark.parametrize(
    ("lagrangian", "integrand", "message"),
    [
        (area, lambda t, x, v: x[0] ** 2, r"the lagrangian ignores v\[0\]"),
        (lambda t, x, v: x[0] + v[0], lambda t, x, v: v[0] * x[0] ** 2 + x[0] ** 2, "the lagrangian is degenerate"),
    ],
)
def test_velocity_and_mass_of_the_lagrangian_with_integrals_are_checked(lagrangian, integrand, message):
    with pytest.raises(ValueError, match=message):
        held(integrand, lagrangian=lagrangian)


@pytest.mark.parametrize("solve", [cg.shoot, cg.compare])
def test_steps_know_no_integrals(solve):
    with pytest.raises(ValueError, match="integral_conditions hold along a whole path: take cg"):
        solve(held(), METHOD, 4)
