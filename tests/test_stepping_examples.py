"""The stepwise scenes run and show what they say."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture
def scene(monkeypatch):
    """Import a scene the way Python runs it: with its folder on the path."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.syspath_prepend(str(EXAMPLES))

    def load(name):
        sys.modules.pop(name, None)
        return importlib.import_module(name)

    return load


def test_mercury_is_back_at_its_perihelion_after_1000_revolutions(scene, tmp_path):
    path, conserved = scene("kepler_revolutions").main(str(tmp_path / "picture.png"))
    assert np.linalg.norm(path.x[:, -1] - path.x[:, 0]) < 1e-9
    assert conserved.energy_error < 1e-12 * abs(path.energy[0])
    np.testing.assert_allclose(conserved.momentum_map, conserved.momentum_map[0], rtol=1e-12)
    assert np.max(conserved.symplecticity_defects) <= 1e-12
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")


def test_chaos_parts_the_double_pendulum_from_its_global_path(scene, tmp_path):
    module = scene("double_pendulum")
    comparison = module.main(str(tmp_path / "picture.png"))
    path = comparison.global_path
    assert np.ptp(path.energy) < 1e-7 * abs(path.energy[0])
    assert path.x[:, -1].tolist() == np.round(path.x[:, -1], 2).tolist()
    assert comparison.shooting.path is None
    assert 1 < comparison.gap_growth < 2.5
    assert 14 < comparison.parting_time < 23  # as roundoff will have it
    assert comparison.condition_global < 1e3
    assert comparison.condition_stepwise > 1e14
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")


def test_the_balanced_pendulum_keeps_its_digits_only_globally(scene, tmp_path):
    for horizon, (comparison, error) in scene("inverted_pendulum").main(str(tmp_path / "picture.png")).items():
        assert error <= 1e-12
        assert np.log(comparison.condition_stepwise) == pytest.approx(horizon, abs=1e-3)
        assert (comparison.shooting.failure is None) == (horizon <= 20)
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")


def test_the_driven_oscillator_settles_into_its_response(scene, tmp_path):
    module = scene("driven_oscillator")
    path, measured = module.main(str(tmp_path / "picture.png"))
    late = path.t > 70
    np.testing.assert_allclose(path.x[0, late], module.response(path.t[late]), rtol=0, atol=1e-7)  # e^{-70 c/2}
    np.testing.assert_allclose(measured.determinants, np.exp(-module.DAMPING * 0.5), rtol=1e-10)
    assert np.max(np.abs(path.x[0, late])) <= 1.0000001 / np.sqrt(3.625)
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")
