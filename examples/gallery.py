"""Run all scenes in examples/pictures, where their pictures belong: ``python examples/gallery.py``, or some by name."""

import os
import runpy
import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
from PIL import Image

HERE = Path(__file__).parent
SCENES = sorted(path.stem for path in HERE.glob("*.py") if path.stem != "gallery")


def draw(scene, folder=HERE / "pictures"):
    """Run one scene in an empty folder, as its user would, and put its pictures into the folder; returns the first.

    Margins are cut off.  A palette of 256 colors makes it half as large, and no line looks different.
    """
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as empty:
        os.chdir(empty)
        try:
            with mpl.rc_context({"savefig.bbox": "tight"}):
                runpy.run_path(str(HERE / f"{scene}.py"), run_name="__main__")
        finally:
            os.chdir(before)
        for film in Path(empty).glob("*.gif"):
            (Path(folder) / film.name).write_bytes(film.read_bytes())
        with Image.open(Path(empty) / f"{scene}.png") as picture:
            reduced = picture.convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    target = Path(folder) / f"{scene}.png"
    reduced.save(target, optimize=True)
    return target


if __name__ == "__main__":
    mpl.use("Agg")
    for scene in sys.argv[1:] or SCENES:
        draw(scene)
