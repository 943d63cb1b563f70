"""What is kept between solves of one layout does not leak from one solve into another."""

from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np

import casadi_galerkin as cg


def swing(gravity):
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + gravity * ca.cos(x[0]), (0.0, 1.0), [0.0], [1.0])
    return cg.transcribe(problem, cg.Galerkin(4), 20)


def test_solves_in_threads_give_the_same_as_one_after_the_other():
    gravities = np.linspace(1.0, 3.0, 16)
    alone = [swing(gravity).solve().action for gravity in gravities]
    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(lambda gravity: swing(gravity).solve().action, gravities))
    np.testing.assert_array_equal(together, alone)


def test_transcriptions_of_one_layout_can_be_solved_in_turn():
    first, second = swing(1.0), swing(2.0)
    expected = [first.solve(), second.solve()]
    again = [first.solve(), second.solve()]
    for before, after in zip(expected, again, strict=True):
        np.testing.assert_array_equal(after.x, before.x)
        assert (after.action, after.morse_index) == (before.action, before.morse_index)
    assert expected[0].action != expected[1].action


def test_a_path_without_unknowns_is_the_straight_line():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0.0, 2.0), [0.0], [1.0])
    path = cg.solve(problem, cg.Galerkin(1), 1)
    assert path.action == 0.25
    np.testing.assert_array_equal(path.momentum, [[0.5, 0.5]])
