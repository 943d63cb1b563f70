"""Branch points of known problems are found to rounding, and what crosses there is followed."""

import casadi as ca
import numpy as np
import pytest
from scenes import bratu_problem
from scipy.special import ellipk

import casadi_galerkin as cg

CRITICAL = (np.pi * np.arange(1, 4)) ** 2  # loads of a rod of length one


def rod(load=5.0, clamped=False, friction=0.0, unit=1.0):
    """x is the angle of a rod under a load, given at both ends or, at pinned ends, free."""
    force = (lambda s, x, v, p: -friction * v) if friction else None
    ends = ([0.0], [0.0]) if clamped else ([None], [None])
    return cg.BoundaryProblem(
        lambda s, x, v, p: v[0] ** 2 / 2 + p[0] * unit**2 * ca.cos(x[0] / unit),
        (0, 1),
        *ends,
        parameters=[load],
        force=force,
    )


@pytest.mark.parametrize("clamped", [True, False])
@pytest.mark.slow
def test_loads_at_which_a_rod_buckles_are_found_to_rounding(clamped):
    branch = cg.continuation(rod(clamped=clamped), [100.0], intervals=12)
    assert branch.reached
    assert branch.missed == ()
    found = np.array([point.parameters[0] for point in branch.branch_points])
    np.testing.assert_allclose(found, CRITICAL, rtol=1e-11, atol=0)
    for k, point in enumerate(branch.branch_points, start=1):
        before, after = branch.trajectories[point.after - 1 : point.after + 1]
        assert after.morse_index == before.morse_index + 1
        s = np.linspace(0, 1, 7)
        mode = np.sin(k * np.pi * s) if clamped else np.cos(k * np.pi * s)
        shape = point.null_vector(s)[0]
        np.testing.assert_allclose(shape * np.sign(shape @ mode), mode, rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1e-9, 1e-6, 1e6])
def test_branch_points_are_found_in_any_unit(unit):
    """Where the path is zero, nothing but the equations tells how large a change is."""
    branch = cg.continuation(rod(clamped=True, unit=unit), [50.0], intervals=12)
    found = [point.parameters[0] for point in branch.branch_points]
    np.testing.assert_allclose(found, CRITICAL[:2], rtol=1e-11, atol=0)


@pytest.mark.slow
def test_a_buckled_rod_is_the_elastica():
    """The load of the k-th branch is (2 k K(m))², with m = sin²(α/2) of the angle α at its ends.

    As long as it is free to turn over, the angle of a straight rod has index 1 already, and so on.
    """
    diagram = cg.continuation(rod(), [100.0], intervals=12, branches=12)
    assert len(diagram.branches) == 7
    assert diagram.waiting == 0
    assert len(diagram.branch_points) == 3
    for branch in diagram.branches[1:]:
        mode = 1 + int(np.argmin(np.abs(CRITICAL - branch.origin.parameters)))
        assert branch.reached
        for (load,), path in zip(branch.parameters, branch.trajectories, strict=True):
            assert path.morse_index == mode
            modulus = np.sin(path.x[0, 0] / 2) ** 2
            assert load == pytest.approx((2 * mode * ellipk(modulus)) ** 2, rel=1e-9)
    assert str(diagram).endswith("\n  ... 2 more\n  7 branches in all")
    assert "  branch point at [9.8696" in str(diagram)


@pytest.mark.slow
def test_no_more_branches_are_followed_than_asked_for():
    diagram = cg.continuation(rod(), [100.0], intervals=12, branches=2)
    assert (len(diagram.branches), diagram.waiting) == (2, 5)
    assert diagram.others[0].origin is not None
    assert "2 branches in all, 5 more not followed" in str(diagram)


@pytest.mark.slow
def test_a_branch_point_without_symmetry_is_found():
    """Of x'' = -p x + x² the branch x = 0 is crossed by one that leads through it (transcritical)."""
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * x[0] ** 2 / 2 + x[0] ** 3 / 3, (0, 1), [0.0], [0.0], parameters=[5.0]
    )
    diagram = cg.continuation(problem, [15.0], intervals=10, branches=5)
    (point,) = diagram.branch_points
    assert point.parameters[0] == pytest.approx(np.pi**2, rel=1e-12)
    assert len(diagram.branches) == 3
    assert sorted(branch.trajectories[-1].morse_index for branch in diagram.others) == [0, 1]
    assert sorted(branch.stopped for branch in diagram.others) == ["the target", "turned back to the start"]


@pytest.mark.slow
def test_under_a_force_branch_points_are_found_without_an_index():
    """x'' + f x' + p sin x = 0 between zeros: x = exp(-f s/2) sin(k π s) where p = (kπ)² + f²/4."""
    friction = 0.7
    branch = cg.continuation(rod(clamped=True, friction=friction), [50.0], intervals=12)
    found = [point.parameters[0] for point in branch.branch_points]
    np.testing.assert_allclose(found, CRITICAL[:2] + friction**2 / 4, rtol=1e-10)
    assert branch.trajectories[0].morse_index is None


@pytest.mark.slow
def test_the_apex_of_a_pitchfork_is_a_branch_point_of_the_bent_branch():
    bent = cg.continuation(rod(20.0), [5.0], intervals=12, guess=lambda s: [1.5 * np.cos(np.pi * s)], branches=4)
    assert bent.branch_points[0].parameters[0] == pytest.approx(np.pi**2, rel=1e-11)
    assert bent.folds[0].parameters[0] == bent.branch_points[0].parameters[0]
    np.testing.assert_allclose(bent.trajectories[-1].x, -bent.trajectories[0].x, rtol=0, atol=1e-8)
    assert {branch.stopped for branch in bent.branches} == {"the target", "turned back to the start"}
    assert len(bent.branches) == 3  # straight before and beyond


@pytest.mark.slow
def test_curves_that_only_come_near_are_no_branch_point():
    beside = cg.BoundaryProblem(
        lambda s, x, v, p: v[0] ** 2 / 2 + p[0] * ca.cos(x[0]), (0, 1), [0.0], [1e-4], parameters=[5.0]
    )
    diagram = cg.continuation(beside, [20.0], intervals=12, branches=5)
    assert not diagram.others
    assert diagram.branch_points == ()


def test_where_a_family_crosses_no_other_branch_is_followed():
    rest = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * x[0] ** 2 / 2, (0, 1), [0.0], [0.0], parameters=[5.0]
    )
    diagram = cg.continuation(rest, [15.0], intervals=6, branches=5)
    assert diagram.branch_points[0].parameters[0] == pytest.approx(np.pi**2, rel=1e-11)
    assert not diagram.others


def test_where_the_index_changes_by_two_it_is_said():
    """Two rods that do not touch buckle at the same load."""
    two = cg.BoundaryProblem(
        lambda s, x, v, p: ca.sumsqr(v) / 2 + p[0] * ca.sum1(ca.cos(x)),
        (0, 1),
        [0.0, 0.0],
        [0.0, 0.0],
        parameters=[5.0],
    )
    branch = cg.continuation(two, [20.0], intervals=8)
    assert branch.reached
    assert len(branch.missed) == 1
    before, after = branch.trajectories[branch.missed[0] - 1 : branch.missed[0] + 1]
    assert (before.morse_index, after.morse_index) == (0, 2)
    assert "something is missed" in str(branch)


@pytest.mark.slow
def test_of_carriers_problem_four_paths_are_one_component():
    """They meet in one fold, and in a pitchfork on the branch of the symmetric ones."""
    carrier = cg.BoundaryProblem(
        lambda t, x, v, p: p[0] ** 2 * v[0] ** 2 / 2 - (1 - t**2) * x[0] ** 2 - x[0] ** 3 / 3 + x[0],
        (-1, 1),
        [0.0],
        [0.0],
        parameters=[0.15],
    )
    found = cg.paths(carrier, cg.Galerkin(8), 24, count=20)
    assert len(found) == 12
    assert [path.morse_index for path in found] == [0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6]
    highest = cg.continuation(carrier, [0.3], cg.Galerkin(8), 24, guess=found[-1], branches=12)
    assert len(highest.branches) == 3
    np.testing.assert_allclose([at.parameters[0] for at in highest.folds], [0.171870], atol=1e-6)
    np.testing.assert_allclose([at.parameters[0] for at in highest.branch_points], [0.157039], atol=1e-6)
    assert all(branch.parameters[-1, 0] == 0.15 for branch in highest.branches)


def test_bad_numbers_of_branches_are_refused():
    with pytest.raises(TypeError, match=r"branches must be a whole number, got 2\.5"):
        cg.continuation(bratu_problem(), [2.0], intervals=4, branches=2.5)
    with pytest.raises(ValueError, match="branches must be at least 0, got -1"):
        cg.continuation(bratu_problem(), [2.0], intervals=4, branches=-1)
    plain = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0])
    with pytest.raises(ValueError, match="changes the parameters of a problem, and this one has none"):
        cg.continuation(plain, [1.0], intervals=4, branches=3)
