"""Pictures and numbers as HTML: nothing is loaded, and colours and fonts are those of the page."""

from __future__ import annotations

import re
from base64 import b64encode
from html import escape
from io import BytesIO, StringIO
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from grainmesh.domain import Box

#: Pixels of a picture for one of the page.
SHARP = 2
#: Behind discs, in the light and in the dark.
GROUND = "#eceff1"
#: Colours of a plot that stand for those of the page, and what they become there.
INK = "#010203"
LINES = {f"#0a0b{i:02x}": f"var(--c{i})" for i in range(6)}

#: For `matplotlib.rc_context`: plots as the page wants them, text as text.
STYLE: dict[str, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "grainmesh",
    "text.parse_math": False,
    **dict.fromkeys(
        ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), INK
    ),
    "axes.prop_cycle": f"cycler('color', {list(LINES)})",
    "axes.linewidth": 0.6,
    "axes.formatter.limits": (-3, 4),
    "font.size": 9.0,
}


def canvas(box: Box, width: float) -> tuple[Figure, Axes]:
    """A figure that is all box, without axes; `width` in pixels of the page."""
    size = np.asarray(box.size) * width / box.width / 100.0
    figure = Figure(figsize=tuple(size), dpi=100 * SHARP, facecolor=GROUND)
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    ax.set_axis_off()
    return figure, ax


def png(figure: Figure, when: str) -> str:
    """An image with its caption, all in the text of the page."""
    data = BytesIO()
    figure.savefig(data, format="png")
    width, height = (figure.get_size_inches() * 100.0).round().astype(int)
    source = f"data:image/png;base64,{b64encode(data.getvalue()).decode()}"
    return (
        f'<div><img src="{source}" width="{width}" height="{height}" alt="the box at {when}">'
        f"<span>{when}</span></div>"
    )


def scale(low: float, high: float, unit: str, colours: str) -> str:
    """A bar of the colours from low to high; of an end that is only round-off, 0."""
    low, high = (0.0 if abs(end) < 1e-12 * (high - low) else end for end in (low, high))
    steps = ",".join(map(to_hex, colormaps[colours](np.linspace(0.0, 1.0, 9))))
    bar = f'<i style="background:linear-gradient(to right,{steps})"></i>'
    return f"{number(low)}{bar}{number(high)} {unit}"


def svg(figure: Figure, title: str, number: int) -> str:
    """A figure made with `STYLE` as inline SVG; its ids are its own by `number`."""
    text = StringIO()
    figure.savefig(text, format="svg", transparent=True, metadata={"Date": None})
    found = text.getvalue()
    found = found[found.index("<svg") :]
    found = re.sub(r"<metadata>.*?</metadata>", "", found, flags=re.DOTALL)
    found = re.sub(r'<svg ([^>]*?)width="[^"]*" height="[^"]*"', r"<svg \1", found, count=1)
    found = re.sub(r"""font: ([\d.]+)px [^;"]*""", r"font-size: \1px", found)
    found = re.sub(r'id="', f'id="p{number}-', found)
    found = re.sub(r'(url\(|href=")#', rf"\1#p{number}-", found)
    for colour, here in {INK: "currentColor", **LINES}.items():
        found = found.replace(colour, here)
    return found.replace("<svg ", f'<svg role="img" aria-label="{escape(title)}" ', 1)


def words(value: Any) -> str:
    """What a JSON file holds, in a line."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {words(part)}" for name, part in value.items())
    return ", ".join(map(words, value)) if isinstance(value, list) else str(value)


def number(value: float) -> str:
    """Four digits, with a power of ten where that is shorter, and true signs."""
    text = f"{float(value):.4g}"
    if "e" in text:
        digits, power = text.split("e")
        text = f"{digits}·10<sup>{int(power)}</sup>"
    return text.replace("-", "−")


def metres(value: float) -> str:
    """A length with the unit that fits."""
    for unit, size in (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6)):
        if abs(value) >= size:
            return f"{value / size:.4g} {unit}"
    return f"{value * 1e9:.4g} nm"


def duration(seconds: float) -> str:
    """A time with the unit that fits."""
    for unit, size in (("h", 3600.0), ("min", 60.0), ("s", 1.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{1e3 * seconds:.0f} ms"


__all__ = ["STYLE", "canvas", "duration", "metres", "number", "png", "scale", "svg", "words"]
