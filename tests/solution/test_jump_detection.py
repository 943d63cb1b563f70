"""Jumps are told from what is only steep, and bound what they do to an integral."""

import numpy as np
import pytest

import casadi_galerkin as cg
from casadi_galerkin.solution.jump_detection import JumpDetector

RULES = [cg.gauss(3), cg.gauss(8), cg.lobatto(4), cg.radau(3)]
NEWTON_COTES = np.array([989, 5888, -928, 10496, -4540, 10496, -928, 5888, 989]) / 28350
NEGATIVE = cg.Quadrature(np.linspace(0, 1, 9), NEWTON_COTES)  # some of its weights are


def jump_effects(mesh, rule, values, rates):
    detector = JumpDetector(mesh, rule)
    return detector.jump_effects(values(detector.times), rates(detector.times))


@pytest.mark.parametrize("rule", [*RULES, NEGATIVE], ids=repr)
def test_a_smooth_function_has_no_jumps(rule):
    mesh = np.linspace(0, 1, 9)
    found = jump_effects(mesh, rule, lambda t: np.exp(3 * t), lambda t: 3 * np.exp(3 * t))
    assert found.shape == (8,)
    assert np.max(found) < 1e-12


@pytest.mark.parametrize("rule", RULES, ids=repr)
@pytest.mark.parametrize("when", [0.03, 0.3, 0.51, 0.97])
def test_what_a_jump_does_to_an_integral_is_bounded_on_its_interval(rule, when):
    mesh = np.array([0.0, 0.25, 0.5, 1.0])
    found = jump_effects(mesh, rule, lambda t: 7.0 * (t > when), lambda t: 0 * t)
    integral = cg.DiscreteCalculus(cg.Galerkin(2, quadrature=rule), mesh)
    missed = abs(integral.integral(7.0 * (integral.quadrature_times > when))[-1] - 7.0 * (1 - when))
    struck = np.searchsorted(mesh, when) - 1
    assert found[struck] >= missed
    assert np.count_nonzero(found) == 1


@pytest.mark.parametrize("begin", [0.0, 1e6, -1e9])
def test_a_jump_at_a_joint_is_inside_of_no_interval(begin):
    """Far from zero too, where times beside the joint are rounded to it."""
    mesh = begin + np.linspace(0, 1, 5)
    for after in (True, False):
        found = jump_effects(
            mesh, cg.gauss(4), lambda t, after=after: 1.0 * (t >= mesh[2] if after else t > mesh[2]), lambda t: 0 * t
        )
        np.testing.assert_array_equal(found, 0.0)


def test_a_jump_beside_a_joint_is_one_at_the_joint_up_to_rounding():
    mesh = np.linspace(0, 1, 5)
    for when in (0.5 - 1e-12, 0.5 + 1e-12):
        found = jump_effects(mesh, cg.gauss(4), lambda t, when=when: 1.0 * (t > when), lambda t: 0 * t)
        np.testing.assert_array_equal(found, 0.0)


def test_where_a_rate_is_undefined_the_jumps_elsewhere_are_seen():
    """A jump from 0 to 1 by the half of an interval that the second of two points stands for."""
    mesh = np.array([0.0, 1.0])
    found = jump_effects(mesh, cg.gauss(2), lambda t: 1.0 * (t > 0.7), lambda t: np.where(t < 0.2, np.nan, 0.0))
    np.testing.assert_allclose(found, [0.5], rtol=1e-6)
