"""The scenes of fits, sweeps and periodic orbits give the numbers they are there for, and draw their pictures."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture
def scene(monkeypatch):
    """Import a scene the way Python runs it: with its folder on the path."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.syspath_prepend(str(ROOT / "examples"))

    def load(name):
        sys.modules.pop(name, None)
        return importlib.import_module(name)

    return load


def test_fit_recovers_length_and_damping_within_its_own_uncertainty(scene, tmp_path):
    from scipy.stats import chi2

    module, picture = scene("fit_pendulum"), tmp_path / "fit.png"
    runs = [module.main(seed=seed) for seed in range(1, 6)] + [module.main(str(picture), seed=0)]
    distances = []
    for estimate, covariance, _, _ in runs:
        error = estimate - module.TRUE
        distances.append(error @ np.linalg.solve(covariance, error))
    assert distances[-1] < chi2.ppf(0.99, 4)
    # the sum tells an uncertainty that is too large from one that is too small: both ends are 1 in 1000
    assert chi2.ppf(0.001, 4 * len(runs)) < sum(distances) < chi2.ppf(0.999, 4 * len(runs))
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_fit_leaves_residuals_of_the_size_of_the_noise(scene):
    module = scene("fit_pendulum")
    _, _, angles, path = module.main()
    misfit = np.std(path.x[0] - angles) / module.NOISE
    assert 0.7 < misfit < 1.3  # 31 measurements: ± 13 %


def test_porkchop_solves_every_transfer_and_finds_the_cheapest(scene, monkeypatch, tmp_path):
    module, picture = scene("porkchop"), tmp_path / "porkchop.png"
    assert len(module.variations()) >= 2500
    monkeypatch.setattr(module, "LAUNCHES", module.LAUNCHES[::7])
    monkeypatch.setattr(module, "FLIGHTS", module.FLIGHTS[::7])
    transfers, cost = module.main(str(picture))
    assert not transfers.failures
    assert picture.read_bytes().startswith(b"\x89PNG")
    # Hohmann's half ellipse between the circles of the same axes; eccentricity moves it by a few tenths
    inner, outer = module.INNER["axis"], module.OUTER["axis"]
    radii = np.array([inner, outer])
    changes = np.sqrt(module.MU * (2 / radii - 2 / (inner + outer))) - np.sqrt(module.MU / radii)
    hohmann = module.KILOMETRES_A_SECOND * np.sum(np.abs(changes))
    assert abs(np.min(cost) - hohmann) < 0.5
    drifts = []
    # Kepler's orbits: energy and angular momentum are the same at both ends
    for path in transfers:
        spin = path.x[0] * path.momentum[1] - path.x[1] * path.momentum[0]
        np.testing.assert_allclose(spin, spin[0], rtol=1e-12)
        drifts.append(np.ptp(path.energy) / np.max(np.abs(path.energy)))
    # 10 intervals of degree 6: the worst flies close by the Sun, where they are coarse
    assert np.median(drifts) < 1e-9
    assert max(drifts) < 1e-4


def test_planets_of_the_porkchop_move_by_keplers_laws(scene):
    module = scene("porkchop")
    for orbit in (module.INNER, module.OUTER):
        period = orbit["axis"] ** 1.5
        x, v = module.state(orbit, 0.3)
        np.testing.assert_allclose(module.state(orbit, 0.3 + period)[0], x, rtol=0, atol=1e-13)
        energy = v @ v / 2 - module.MU / np.linalg.norm(x)
        assert energy == pytest.approx(-module.MU / (2 * orbit["axis"]), rel=1e-13, abs=0)
        step = 1e-4  # a difference of second order: 1e-7 of the velocity
        slope = (module.state(orbit, 0.3 + step)[0] - module.state(orbit, 0.3 - step)[0]) / (2 * step)
        np.testing.assert_allclose(slope, v, rtol=0, atol=1e-6)


PUBLISHED = 1e-8  # the initial values of the figure eight were published with 8 decimals


def test_figure_eight_has_the_published_place_and_speed_at_time_0(scene, tmp_path):
    module, picture = scene("figure_eight"), tmp_path / "figure_eight.png"
    path = module.main(str(picture))
    x, v = module.bodies(path.x[:, 0]), module.bodies(path.velocity[:, 0])
    first, third = np.array(module.POSITION_1), np.array(module.VELOCITY_3)
    # these do not depend on how the orbit is turned, nor on the direction of time
    assert np.linalg.norm(x[0]) == pytest.approx(np.linalg.norm(first), abs=PUBLISHED)
    assert np.linalg.norm(v[2]) == pytest.approx(np.linalg.norm(third), abs=PUBLISHED)
    assert abs(x[0] @ v[2]) == pytest.approx(abs(first @ third), abs=2 * PUBLISHED)
    np.testing.assert_allclose(x[2], 0.0, atol=1e-12)
    np.testing.assert_allclose(x[0], -x[1], atol=1e-12)
    np.testing.assert_allclose(v[0], -v[2] / 2, atol=PUBLISHED)
    np.testing.assert_allclose(v[1], -v[2] / 2, atol=PUBLISHED)
    energy = 3 * third @ third / 4 - 2 / np.linalg.norm(first) - 1 / np.linalg.norm(2 * first)
    np.testing.assert_allclose(path.energy, energy, rtol=0, atol=4 * PUBLISHED)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_figure_eight_closes_without_a_kink_and_without_angular_momentum(scene):
    module = scene("figure_eight")
    path = module.main()
    # no data of the problem enter these but the path itself; they are good to the error of the discretisation
    np.testing.assert_allclose(path.momentum[:, 0], path.momentum[:, -1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(module.angular_momentum(path), 0.0, atol=1e-12)
    np.testing.assert_allclose(path.energy, path.energy[0], rtol=1e-12)
    assert path.morse_index == 2


def test_figure_eight_is_a_choreography(scene):
    module = scene("figure_eight")
    path = module.main()
    times = np.linspace(0, module.PERIOD, 61)[:-1]
    curves = module.bodies(path(times))
    for follower, shift in ((1, 20), (2, 40)):
        distances = [np.max(np.abs(np.roll(curves[k], -shift, axis=-1) - curves[0])) for k in (follower, 3 - follower)]
        assert min(distances) < PUBLISHED


def test_mechanism_starts_at_rest_and_draws_still_and_moving_pictures(scene, tmp_path):
    picture = tmp_path / "mechanism.png"
    path = scene("mechanism").main(str(picture))
    np.testing.assert_allclose(path.velocity[:, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(path.velocity[:, -1], [-1.7298716095965868, -2.9142006209385097], rtol=1e-12)
    assert path.action == pytest.approx(11.748350447614505, rel=1e-13, abs=0)
    assert path.morse_index == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.with_suffix(".gif").read_bytes().startswith(b"GIF89a")
