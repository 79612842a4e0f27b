"""Axes of a box in metres, the periodic images that reach into it, and pictures as small files."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, MaxNLocator
from matplotlib.tri import Triangulation as Triangles
from numpy.typing import NDArray
from PIL import Image

from grainmesh.domain import Box

Float = NDArray[np.float64]


def save(figure: Figure, path: Path) -> None:
    """Write a figure as a PNG file of 256 colours, a third of the size, and close it."""
    full = BytesIO()
    figure.savefig(full, dpi=110, format="png")
    plt.close(figure)
    Image.open(full).convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE).save(
        path, optimize=True
    )


def frame(box: Box, ax: Axes | None) -> Axes:
    """Axes that show the box in metres."""
    ax = plt.subplots()[1] if ax is None else ax
    ax.set(xlim=(0.0, box.width), ylim=(0.0, box.height), aspect="equal")
    for side in (ax.xaxis, ax.yaxis):
        side.set_major_formatter(EngFormatter(unit="m", sep=" "))
        side.set_major_locator(MaxNLocator(3))
    return ax


def tiled_triangles(box: Box, corners: Float) -> tuple[Triangles, NDArray[np.int64]]:
    """Triangles (t, 3, 2), each on its own, with their periodic images, and whose they are."""
    centre = corners.mean(axis=1)
    place, _, which = tiled(box, centre, np.abs(corners - centre[:, None]).max(axis=(1, 2)))
    drawn = (corners[which] + (place - centre[which])[:, None]).reshape(-1, 2)
    return Triangles(*drawn.T, np.arange(len(drawn)).reshape(-1, 3)), which


def tiled(box: Box, centre: Float, reach: Float) -> tuple[Float, Float, NDArray[np.int64]]:
    """Images of what lies within `reach` of `centre` that touch the box, and whose they are.

    Parameters
    ----------
    box : Box
    centre : (n, 2)
    reach : (n,)

    Returns
    -------
    centre : (m, 2)
    reach : (m,)
    which : (m,)
        Index into the given ones.
    """
    shifts = np.zeros((1, 2))
    if box.periodic:
        low = -np.ceil((centre + reach[:, None]).max(axis=0) / box.size)
        high = np.ceil((box.size - (centre - reach[:, None]).min(axis=0)) / box.size)
        steps = [np.arange(a, b + 1) for a, b in zip(low, high, strict=True)]
        shifts = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
    place = centre + (shifts * box.size)[:, None]
    near = ((place > -reach[:, None]) & (place < box.size + reach[:, None])).all(axis=-1)
    which = np.nonzero(near)[1]
    return place[near], reach[which], which


__all__ = ["frame", "save", "tiled", "tiled_triangles"]
