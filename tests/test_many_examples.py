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
