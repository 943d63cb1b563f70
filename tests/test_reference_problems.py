"""Every boundary problem of the table solved: closed forms, known numbers, first integrals, honest reports."""

import casadi as ca
import numpy as np
import pytest
from scenes import SCENES, TROESCH

CLOSED_FORM = 1e-13  # relative to the largest value along the path


# Measured roundoff where double precision does not allow 1e-13: condition numbers of the problems themselves.
CONDITION = {
    "oscillator 10.0": 3e-13,
    "Bratu 1.0 upper": 1e-12,
}
MOMENTUM = 50  # momenta lose a factor |x|/(h |v|) in the differences of positions


def velocities(path):
    """At the ends, by the Legendre transform."""
    return path.velocity[:, 0], path.velocity[:, -1]


@pytest.fixture(scope="module")
def solved():
    return {scene.name: scene.solve() for scene in SCENES}


@pytest.mark.parametrize("scene", [s for s in SCENES if s.path], ids=lambda s: s.name)
def test_closed_form_is_reproduced_between_the_joints(scene, solved):
    t = ca.SX.sym("t")
    exact = ca.Function("exact", [t], [ca.vertcat(*scene.path(t))])
    times = np.sort(np.concatenate((scene.joints, np.random.default_rng(3).uniform(*scene.t_span, 200))))
    wanted = np.array(exact(times[None, :]))
    tolerance = CONDITION.get(scene.name, CLOSED_FORM)
    for got, values in zip(solved[scene.name](times), wanted, strict=True):
        np.testing.assert_allclose(got, values, rtol=0, atol=tolerance * max(1, np.max(np.abs(values))))


@pytest.mark.parametrize("scene", SCENES, ids=lambda s: s.name)
def test_known_numbers_and_morse_index(scene, solved):
    path = solved[scene.name]
    tolerance = max(scene.digits, CONDITION.get(scene.name, 0))
    assert path.morse_index == scene.index
    if scene.action is not None:
        assert path.action == pytest.approx(scene.action, rel=tolerance, abs=tolerance)
    size = np.max(np.abs(velocities(path)))
    for got, known in zip(velocities(path), scene.velocities, strict=True):
        if known is not None:
            np.testing.assert_allclose(got, known, rtol=0, atol=MOMENTUM * tolerance * size)
    for time, x in scene.values.items():
        np.testing.assert_allclose(path(time), x, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("scene", [s for s in SCENES if s.conserved], ids=lambda s: s.name)
def test_first_integral_is_the_same_at_all_joints(scene, solved):
    path, d = solved[scene.name], len(scene.start)
    t, x, v = ca.SX.sym("t"), ca.SX.sym("x", d), ca.SX.sym("v", d)
    integral = ca.Function("integral", [t, x, v], [scene.conserved(t, x, v)])
    values = np.array(integral(path.t[None, :], path.x, path.velocity)).ravel()
    energy = path.energy
    size = np.max(np.abs(values)) + np.max(np.sum(np.abs(path.momentum * path.velocity), axis=0))
    assert np.ptp(values) < 2e-12 * size
    if scene.conserved.__name__ == "<lambda>" and scene.name not in ("great circle", "brachistochrone"):
        np.testing.assert_allclose(energy, values, rtol=0, atol=1e-13 * size)


@pytest.mark.parametrize("scene", SCENES, ids=lambda s: s.name)
def test_answers_are_verified_and_reported(scene, solved):
    path = solved[scene.name]
    assert path.residual <= 50
    assert 1 <= path.iterations <= 100
    assert path.solver in ("Newton", "IPOPT, then Newton", "IPOPT on the action, then Newton")
    text = str(path)
    assert f"{path.action:.15g}" in text
    assert ("minimum" in text) == (scene.index == 0)
    assert (path.t.shape, path.x.shape) == ((len(scene.joints),), (len(scene.start), len(scene.joints)))


@pytest.mark.parametrize("scene", [s for s in SCENES if s.guess is None], ids=lambda s: s.name)
def test_newton_alone_solves_the_scene_from_the_straight_line(scene, solved):
    assert solved[scene.name].solver == "Newton"


@pytest.mark.parametrize("rate", list(TROESCH))
def test_troeschs_layers_are_resolved_at_both_ends(rate, solved):
    """Relative to each end's own velocity, which at λ = 50 are 1.5e-21 and 7.2e10."""
    got = np.concatenate(velocities(solved[f"Troesch {rate:g}"]))
    np.testing.assert_allclose(got, TROESCH[rate], rtol=5e-11, atol=0)
