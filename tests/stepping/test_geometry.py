"""Geometry of steps and of global paths: symplecticity, momentum maps, energy, reversibility."""

import casadi as ca
import numpy as np
import pytest
from constrained import MECHANISMS
from motions import MOTIONS, kepler, oscillator, start_of
from slow import slow

import casadi_galerkin as cg

METHOD = cg.Galerkin(8)


@pytest.mark.slow
def test_geometry_of_a_global_path_is_that_of_its_steps():
    problem = cg.BoundaryProblem(kepler, (0, 2), [1.0, 0.0], [-0.4, 0.9])
    path = cg.solve(problem, METHOD, intervals=10)
    measured = cg.geometry(path, symmetry=lambda x: [-x[1], x[0]])
    assert np.max(measured.symplecticity_defects) <= 1e-12
    np.testing.assert_allclose(measured.momentum_map, measured.momentum_map[0], rtol=0, atol=1e-13)
    assert measured.energy_error < 1e-10
    assert abs(measured.energy_drift) < 1e-10
    for part in ("energy", "symplecticity", "momentum map"):
        assert part in str(measured)
    assert "momentum map" not in str(cg.geometry(path))


def test_a_symmetry_of_the_wrong_length_is_named():
    problem = cg.BoundaryProblem(kepler, (0, 2), [1.0, 0.0], [-0.4, 0.9])
    path = cg.solve(problem, METHOD, intervals=10)
    with pytest.raises(ValueError, match="symmetry must return a vector of length 2"):
        cg.geometry(path, symmetry=lambda x: x[0])


def test_a_symmetry_of_one_component_may_be_a_list():
    path = cg.solve(cg.BoundaryProblem(lambda t, x, v: v[0] ** 2, (0, 2), [0.0], [1.0]), METHOD, intervals=2)
    np.testing.assert_array_equal(cg.geometry(path, symmetry=lambda x: [1.0]).momentum_map, path.momentum[0])


def test_geometry_is_that_of_the_parameters_that_were_solved_for():
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * x[0] ** 2 / 2, (0, 1), [0.0], [1.0], parameters=[1.0]
    )
    path = cg.transcribe(problem, METHOD, 10).solve(parameters=[4.0])
    turned, step = 2 * 0.1, cg.geometry(path).jacobians[0]
    expected = [[np.cos(turned), np.sin(turned) / 2], [-2 * np.sin(turned), np.cos(turned)]]
    np.testing.assert_allclose(step, expected, rtol=0, atol=1e-13)


def test_geometry_refuses_what_is_no_path():
    with pytest.raises(TypeError, match="geometry takes a Trajectory, got BoundaryProblem"):
        cg.geometry(cg.BoundaryProblem(kepler, (0, 2), [1.0, 0.0], [-0.4, 0.9]))


@pytest.mark.parametrize("scene", MOTIONS)
@pytest.mark.parametrize("method", [cg.Galerkin(1), cg.Galerkin(4), cg.Galerkin(4, quadrature=cg.lobatto(4))], ids=str)
def test_steps_are_symplectic(scene, method):
    problem = start_of(scene, 30)
    measured = cg.geometry(cg.solve(problem, method, intervals=30))
    assert np.max(measured.symplecticity_defects) <= 1e-12
    np.testing.assert_allclose(measured.determinants, 1, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", MECHANISMS)
def test_steps_on_a_constraint_are_symplectic_between_its_tangents(name):
    _, cartesian, place, constraint = MECHANISMS[name]
    first, last = np.array([0.3, 0.4]), np.array([1.2, 1.3])
    problem = cg.BoundaryProblem(cartesian, (0, 1), place(first), place(last), constraint=constraint)
    path = cg.solve(problem, cg.Galerkin(4), 12, guess=lambda t: place(first + t * (last - first)))
    measured = cg.geometry(path)
    free = 2 * (len(path.x) - len(path.multipliers(0.5)))
    assert measured.jacobians.shape == (12, free, free)
    assert np.max(measured.symplecticity_defects) <= 1e-12


@pytest.mark.parametrize("length", [1e-9, *slow(1e9)])
@pytest.mark.parametrize("mass", [1e9, *slow(1.0)])
def test_steps_are_symplectic_in_any_units(length, mass):
    orbit = cg.InitialProblem(
        lambda t, x, v: mass * kepler(t, x / length, v / length), (0, 5), [length, 0], velocity=[0, 1.1 * length]
    )
    assert np.max(cg.geometry(cg.solve(orbit, cg.Galerkin(4), intervals=30)).symplecticity_defects) <= 1e-12


@pytest.mark.parametrize("scene", ["pendulum", "kepler", "double pendulum"])
def test_steps_of_a_reversible_lagrangian_run_back_to_their_start(scene):
    lagrangian, x, p, h = MOTIONS[scene]
    mesh = np.concatenate(([0], np.cumsum(h * np.linspace(0.5, 1.5, 40))))
    problem = cg.InitialProblem(lagrangian, (0, mesh[-1]), x, momentum=p)
    there = cg.solve(problem, cg.Galerkin(5), mesh=mesh)
    problem = cg.InitialProblem(lagrangian, (0, mesh[-1]), there.x[:, -1], momentum=-there.momentum[:, -1])
    back = cg.solve(problem, cg.Galerkin(5), mesh=np.clip((mesh[-1] - mesh)[::-1], 0, mesh[-1]))
    growth = 1e3  # of rounding along 40 steps there and back, measured 10 to 100
    np.testing.assert_allclose(back.x[:, ::-1], there.x, rtol=0, atol=growth * 2.3e-16 * np.max(np.abs(there.x)))


@pytest.mark.slow
def test_angular_momentum_does_not_drift_in_2e4_steps_of_kepler_and_energy_stays_in_its_band():
    problem = cg.InitialProblem(kepler, (0, 400 * np.pi), [0.4, 0.0], velocity=[0.0, 2.0])
    path = cg.solve(problem, cg.Galerkin(4), intervals=20_000)
    (x, y), (px, py) = path.x, path.momentum
    assert np.max(np.abs(x * py - y * px - 0.8)) <= 1e-12
    energy = (px**2 + py**2) / 2 - 1 / np.hypot(x, y) + 0.5
    bands = np.max(np.abs(energy[1:].reshape(10, -1)), axis=1)  # of every 20 revolutions
    assert bands[0] < 1e-10
    np.testing.assert_allclose(bands, bands[0], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_linear_momentum_of_a_free_system_stays_within_a_random_walk_of_roundoff():
    def springs(t, x, v):
        return ca.dot(v, v) / 2 - (x[0] - x[1]) ** 2 / 2 - (x[1] - x[2]) ** 4 / 4

    problem = cg.InitialProblem(springs, (0, 2000), [0.0, 1.0, 3.0], velocity=[1.0, 0.0, -0.3])
    path = cg.solve(problem, cg.Galerkin(3), intervals=20_000)
    total = path.momentum.sum(axis=0)
    assert np.max(np.abs(total - total[0])) <= 2e-16 * np.sqrt(20_000) * 10


def test_friction_shrinks_every_step_by_the_same_factor():
    problem = cg.InitialProblem(oscillator, (0, 3), [1.0], momentum=[0.0], force=lambda t, x, v: -0.4 * v)
    measured = cg.geometry(cg.solve(problem, cg.Galerkin(6), intervals=10))
    np.testing.assert_allclose(measured.determinants, np.exp(-0.4 * 0.3), rtol=1e-13)


@pytest.mark.slow
def test_a_momentum_map_that_is_not_affine_is_kept_to_the_order_of_the_method():
    """A particle on a sphere in angles: rotations about the pole are translations, about another axis not affine."""

    def sphere(t, x, v):
        return (v[0] ** 2 + ca.sin(x[0]) ** 2 * v[1] ** 2) / 2

    start = cg.InitialProblem(sphere, (0, 3), [1.2, 0.0], velocity=[0.5, 0.7])
    generators = {
        "pole": lambda x: [0, 1],
        "other": lambda x: [-ca.sin(x[1]), -ca.cos(x[1]) / ca.tan(x[0])],
    }
    spread = {name: [] for name in generators}
    counts = np.array([20, 40, 80])
    for n in counts:
        path = cg.solve(start, cg.Galerkin(2), int(n))
        for name, symmetry in generators.items():
            spread[name].append(np.ptp(cg.geometry(path, symmetry).momentum_map))
    assert max(spread["pole"]) < 1e-14
    assert min(spread["other"]) > 1e-10
    assert -np.polyfit(np.log(counts), np.log(spread["other"]), 1)[0] == pytest.approx(4, abs=0.2)


def test_a_force_without_work_along_a_symmetry_keeps_its_momentum_map():
    def central(t, x, v):
        return -0.1 * ca.dot(x, v) * x

    start = cg.InitialProblem(kepler, (0, 10), [1.0, 0.0], velocity=[0.3, 1.1], force=central)
    kept = cg.geometry(cg.solve(start, cg.Galerkin(2), 40), symmetry=lambda x: [-x[1], x[0]])
    assert np.ptp(kept.momentum_map) < 1e-14
    assert np.max(np.abs(kept.determinants - 1)) > 0.01


def test_a_symmetry_that_is_not_finite_on_the_path_is_refused():
    start = cg.InitialProblem(kepler, (0, 1), [1.0, 0.0], velocity=[0.0, 1.0])
    path = cg.solve(start, cg.Galerkin(2), 4)
    with pytest.raises(ValueError, match=r"what symmetry returns must be finite, got \[ 1. inf\] at t = 0"):
        cg.geometry(path, symmetry=lambda x: [1, 1 / x[1]])


def turned(**changes):
    """A plane move under a force and a cost that a rotation does not change."""
    rules = {
        "force": lambda t, x, v, u: u - x * ca.dot(x, x),
        "running_cost": lambda t, x, v, u: ca.dot(u, u) / 2 + ca.dot(x, x),
        "controls": 2,
    }
    ends = [1.0, 0.0], [0.3, 1.2], [0.0, 0.5], [0.2, 0.0]
    return cg.ControlProblem(lambda t, x, v: ca.dot(v, v) / 2, (0, 2), *ends, **{**rules, **changes})


def rotation(x):
    return [-x[1], x[0]]


@pytest.mark.slow
def test_a_symmetry_of_cost_and_forces_is_conserved_along_an_optimal_path_to_the_methods_order():
    spreads = []
    for intervals in (6, 12, 24):
        kept = cg.geometry(cg.solve(turned(), cg.Galerkin(3), intervals), rotation)
        assert kept.symmetry_defect < 1e-14
        spreads.append(np.ptp(kept.momentum_map))
    np.testing.assert_allclose(np.log2(np.divide(spreads[:-1], spreads[1:])), 6, atol=0.4)


def test_a_cost_without_the_symmetry_is_seen():
    kept = cg.geometry(
        cg.solve(turned(running_cost=lambda t, x, v, u: u[0] ** 2 + 2 * u[1] ** 2), cg.Galerkin(3), 8), rotation
    )
    assert kept.symmetry_defect > 1e-2
    assert "of its terms" in repr(kept)


def test_a_scaling_of_space_and_time_is_conserved():
    """L = v²/2 - a/x² scales like 1/t: x·p/2 - E t is constant."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 0.1 / x[0] ** 2, (0.0, 2.0), [1.0], [2.0])
    kept = cg.geometry(cg.solve(problem, tol=1e-10), (lambda x: x / 2, lambda t: t))
    assert np.ptp(kept.momentum_map) < 1e-10
    assert kept.symmetry_defect < 1e-14
    assert cg.geometry(cg.solve(problem, tol=1e-10), lambda x: x / 2).symmetry_defect > 0.1


def test_a_force_along_the_symmetry_is_seen():
    problem = cg.InitialProblem(
        lambda t, x, v: ca.dot(v, v) / 2, (0, 1), [1.0, 0.0], velocity=[0.0, 1.0], force=lambda t, x, v: -v
    )
    assert cg.geometry(cg.solve(problem, cg.Galerkin(3), 8), rotation).symmetry_defect > 0.1


@pytest.mark.parametrize("changes", [{"symmetry": (rotation, lambda t: t)}])
def test_a_symmetry_of_times_is_refused_for_an_optimal_path(changes):
    with pytest.raises(ValueError, match="moves neither times nor components that follow rates"):
        cg.geometry(cg.solve(turned(), cg.Galerkin(3), 8), **changes)
