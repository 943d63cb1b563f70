"""Draw the pictures of all scenes into examples/pictures: ``python examples/gallery.py``, or with names, of some."""

import sys
from importlib import import_module
from pathlib import Path

import matplotlib as mpl
from PIL import Image

HERE = Path(__file__).parent
SCENES = sorted(path.stem for path in HERE.glob("*.py") if path.stem not in ("gallery", "show"))


def draw(scene, folder=HERE / "pictures"):
    """Run one scene, which draws its picture into the folder; returns the file.

    A palette of 256 colours makes it half as large, and no line looks different.
    """
    target = Path(folder) / f"{scene}.png"
    import_module(scene).main(str(target))
    with Image.open(target) as picture:
        reduced = picture.convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    reduced.save(target, optimize=True)
    return target


if __name__ == "__main__":
    mpl.use("Agg")
    for scene in sys.argv[1:] or SCENES:
        draw(scene)
