"""The gallery holds every scene, drawn small."""

import importlib
import re

import matplotlib as mpl
import pytest
from paths import EXAMPLES

PICTURES = EXAMPLES / "pictures"
BYTES = 60_000  # of one picture, so that the whole page stays below a megabyte or two


@pytest.fixture
def gallery(monkeypatch):
    mpl.use("Agg")
    monkeypatch.syspath_prepend(EXAMPLES)
    return importlib.import_module("gallery")


def test_every_scene_has_its_picture_and_its_words_in_the_manual(gallery):
    text = (EXAMPLES / "gallery.md").read_text(encoding="utf-8")
    shown = re.findall(r"!\[(\w+)\]\(pictures/\1\.png\) \[`\1\.py`\]\(\1\.py\): \S", text)
    assert sorted(shown) == gallery.SCENES


def test_pictures_are_those_of_scenes_of_the_peers_and_of_the_first_page_and_small(gallery):
    assert {file.stem for file in PICTURES.glob("*.png")} == {*gallery.SCENES, "peers", "swings"}
    assert {file.name for file in PICTURES.iterdir() if file.stat().st_size > BYTES} == set()


@pytest.mark.slow
def test_the_gallery_draws_a_scene_in_few_colors(gallery, tmp_path):
    from PIL import Image

    with Image.open(gallery.draw("great_circle", tmp_path)) as picture:
        assert (picture.format, picture.mode) == ("PNG", "P")
    assert {file.name for file in tmp_path.iterdir()} == {"great_circle.png"}
