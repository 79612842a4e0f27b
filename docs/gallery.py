"""Pictures of the gallery: runs the examples, takes the first picture of each, small.

python docs/gallery.py [NAME ...] writes docs/_static/gallery/NAME.png; without names, of all.
"""

import subprocess
import sys
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parent.parent
SMALL = ROOT / "docs" / "_static" / "gallery"
SIZE = 1100, 800  # width and height [pixel] at most


def picture(name: str) -> Path:
    """Run an example; returns the picture that has its name, or the first there is."""
    out = ROOT / "out" / "gallery" / name
    command = [sys.executable, ROOT / "examples" / f"{name}.py", "--out", out]
    subprocess.run(command, check=True, cwd=ROOT)
    own = out / f"{name}.png"
    return own if own.exists() else min(out.glob("*.png"))


def small(source: Path, path: Path) -> None:
    """Write a picture again, at most `SIZE`, in 64 colours."""
    image = Image.open(source).convert("RGB")
    image.thumbnail(SIZE, Image.Resampling.LANCZOS)
    image.quantize(64, Image.Quantize.MAXCOVERAGE).save(path, optimize=True)


if __name__ == "__main__":
    SMALL.mkdir(parents=True, exist_ok=True)
    for name in sys.argv[1:] or sorted(p.stem for p in (ROOT / "examples").glob("*.py")):
        small(picture(name), SMALL / f"{name}.png")
        print(SMALL / f"{name}.png")
