"""The scenes of refinement and continuation give the numbers they are there for, and draw their pictures."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from scenes import TROESCH

SCENES = ("troesch", "boundary_layer", "near_collision", "bratu")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Run a scene once with its picture: module, what main() returned, and the picture's size in bytes."""
    patch = pytest.MonkeyPatch()
    patch.setenv("MPLBACKEND", "Agg")
    patch.syspath_prepend(str(Path(__file__).parents[1] / "examples"))
    folder, done = tmp_path_factory.mktemp("pictures"), {}

    def run(name):
        if name not in done:
            sys.modules.pop(name, None)
            module = importlib.import_module(name)
            file = folder / f"{name}.png"
            done[name] = module, module.main(str(file)), file.stat().st_size
        return done[name]

    yield run
    patch.undo()


@pytest.mark.parametrize("name", SCENES)
def test_a_picture_is_drawn(scene, name):
    assert scene(name)[2] > 1000


def test_troeschs_slopes(scene):
    paths = scene("troesch")[1]
    assert list(paths) == list(TROESCH)
    for rate, path in paths.items():
        np.testing.assert_allclose(path.momentum[0, -1], TROESCH[rate][1], rtol=1e-8, atol=0)


def test_the_layer_is_resolved(scene):
    module, path, _ = scene("boundary_layer")
    times = np.logspace(-7, 0, 1000)
    np.testing.assert_allclose(path(times)[0], module.exact(times), rtol=0, atol=1e-9)
    assert np.count_nonzero(path.t < 10 * module.THICKNESS) > 2


def test_the_comet_goes_round_the_sun(scene):
    module, path, _ = scene("near_collision")
    np.testing.assert_allclose(path(0.0), [1 - module.ECCENTRICITY, 0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(path.energy, -0.5, rtol=0, atol=1e-8)


def test_bratus_fold(scene):
    branch = scene("bratu")[1]
    np.testing.assert_allclose(branch.folds[0].parameters, [3.513830719125162], rtol=1e-12, atol=0)
    assert [path.morse_index for path in branch.trajectories[:: len(branch.trajectories) - 1]] == [0, 1]
