"""Fibres in a micrograph or a slice of tomography: an image in, discs out.

How they are found is told in `matched`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.matched import SEARCHES, Discs, drawn, is_bright, search
from grainmesh.particles import Particles
from grainmesh.plain import plain, spread

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Float = NDArray[np.float64]

#: A single diameter stands for this range of diameters around it.
AROUND = (0.7, 1.4)
#: Least diameter that can be told from noise [pixel].
SMALLEST = 4.0
#: Weights of red, green and blue in grey.
GREY = (0.2125, 0.7154, 0.0721)


@dataclass(frozen=True, eq=False)
class Fibres:
    """Discs found in an image.

    Parameters
    ----------
    x : (n, 2)
        Centres [pixel], from the lower left corner of the image, y upwards.
    radius : (n,)
        Radii [pixel].
    score : (n,)
        Correlation of the image with the disc, 1 at best.
    size : (int, int)
        Width and height of the image [pixel].
    bright : bool
        Whether the fibres are brighter than what is between them.
    blur : float
        Width of the edges [pixel], as the standard deviation of a Gaussian blur.
    """

    x: Float
    radius: Float
    score: Float
    size: tuple[int, int]
    bright: bool
    blur: float

    def __len__(self) -> int:
        return len(self.x)

    def __repr__(self) -> str:
        return (
            f"Fibres: {len(self)} {'bright' if self.bright else 'dark'} ones in "
            f"{self.size[0]} x {self.size[1]} pixels, d = "
            f"{spread(2.0 * self.radius, 'pixels')}, solid fraction {self.solid_fraction:.3f}, "
            f"{int(self.at_edge.sum())} cut by the edge"
        )

    def to_dict(self) -> dict[str, Any]:
        """As plain numbers, ready for JSON: lists of x, radius and score, and what sums them up."""
        found: dict[str, Any] = plain(
            {
                "n": len(self),
                "diameter": 2.0 * self.radius.mean(),
                "solid_fraction": self.solid_fraction,
                "at_edge": self.at_edge.sum(),
                **vars(self),
            }
        )
        return found

    @property
    def at_edge(self) -> NDArray[np.bool_]:
        """Which discs the edge of the image cuts, (n,)."""
        low, high = self.x - self.radius[:, None], self.x + self.radius[:, None]
        return np.asarray(((low < 0.0) | (high > self.size)).any(axis=1))

    @property
    def solid_fraction(self) -> float:
        """Share of the image that the discs cover."""
        state = Discs(self.x[:, ::-1] - 0.5, self.radius, np.ones(len(self)), 0 * self.radius, 0.3)
        return float(np.clip(drawn(self.size[::-1], state), 0.0, 1.0).mean())

    def particles(self, pixel: float) -> tuple[Box, Particles]:
        """The image as a box of discs.

        Parameters
        ----------
        pixel : float
            Size of a pixel [m].

        Returns
        -------
        box : Box
        particles : Particles
        """
        if not (isfinite(pixel) and pixel > 0.0):
            raise InputError(f"pixel {pixel:g} m must be a positive number")
        box = Box(self.size[0] * pixel, self.size[1] * pixel)
        return box, Particles(self.x * pixel, 2.0 * self.radius * pixel)


def read(path: str | PathLike[str]) -> Float:
    """An image file as grey values (height, width), colours weighed as the eye does.

    Raises
    ------
    InputError
        If there is no such file, it is no image, or one of several pictures.
    """
    from PIL import Image

    try:
        with Image.open(path) as file:
            if getattr(file, "n_frames", 1) > 1:
                raise InputError(
                    f"{path}: holds {file.n_frames} pictures; save one slice by itself"
                )
            if file.mode in ("L", "I", "F") or file.mode.startswith("I;16"):
                return np.asarray(file, dtype=float)
            return np.asarray(file.convert("RGB"), dtype=float) @ GREY
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as fault:
        reason = " ".join(str(fault).split())
        raise InputError(f"{path}: no image that can be read ({reason}); use PNG or TIFF") from None


def find(
    image: str | PathLike[str] | ArrayLike,
    diameter: float | tuple[float, float],
    *,
    bright: bool | None = None,
    score: float = 0.5,
) -> Fibres:
    """Find fibres in an image.

    Parameters
    ----------
    image : path or array_like
        File, or grey values (height, width), or colours (height, width, 3).
    diameter : float or (float, float)
        Diameter of the fibres [pixel], to some 30 %; or the least and the largest.
    bright : bool, optional
        Whether fibres are brighter than what is between them; found out if not given.
    score : float
        Discs that fit worse are dropped, see `Fibres`.

    Returns
    -------
    Fibres
        From the best score to the worst.

    Raises
    ------
    InputError
        If the image cannot be used, diameters do not fit it, nothing is found, or scikit-image is
        not installed.
    """
    name = f"{image}" if isinstance(image, str | PathLike) else "image"
    grey = _grey(name, read(image) if isinstance(image, str | PathLike) else image)
    low, high = _range(diameter, name, grey)
    if not 0.0 < score < 1.0:
        raise InputError(f"score {score:g} must lie between 0 and 1")
    bright = is_bright(grey, low, high, score) if bright is None else bright
    state, fit = search(grey if bright else -grey, low, high, score, SEARCHES)
    if len(state.r) == 0:
        raise InputError(
            f"{name}: no fibre of diameter {2 * low:g} to {2 * high:g} pixels found; measure some "
            "in the image, or lower the score asked for"
        )
    best = np.argsort(-fit, kind="stable")
    height, width = grey.shape
    x = np.stack([state.c[:, 1] + 0.5, height - 0.5 - state.c[:, 0]], axis=1)
    return Fibres(x[best], state.r[best], fit[best], (width, height), bright, state.s)


def overlay(image: ArrayLike, fibres: Fibres, ax: Axes | None = None) -> Axes:
    """The image with the discs found, for checking; those at the edge in another colour.

    Parameters
    ----------
    image : array_like
        Grey values or colours, as given to `find`.
    fibres : Fibres
    ax : matplotlib.axes.Axes, optional
    """
    import matplotlib.pyplot as plt
    from matplotlib.collections import EllipseCollection

    width, height = fibres.size
    shown = np.asarray(image, dtype=float)
    dark, light = np.quantile(shown, [0.005, 0.995])
    ax = plt.subplots()[1] if ax is None else ax
    ax.imshow(
        shown,
        cmap="gray",
        vmin=dark,
        vmax=light,
        extent=(0, width, 0, height),
        interpolation="nearest",
    )
    d = 2.0 * fibres.radius
    ax.add_collection(
        EllipseCollection(
            *(d, d, np.zeros(len(d))),
            units="xy",
            offsets=fibres.x,
            offset_transform=ax.transData,
            facecolors="none",
            edgecolors=np.where(fibres.at_edge, "#edae49", "#d1495b"),
            linewidths=0.8,
        )
    )
    ax.set(xlim=(0, width), ylim=(0, height), aspect="equal")
    ax.set_axis_off()
    return ax


def save_overlay(image: ArrayLike, fibres: Fibres, path: str | PathLike[str]) -> None:
    """Write `overlay` as a picture without margins, two dots a pixel, 1500 to 6000 in all."""
    import matplotlib.pyplot as plt

    largest = max(fibres.size)
    figure = plt.figure(figsize=(10.0 * fibres.size[0] / largest, 10.0 * fibres.size[1] / largest))
    overlay(image, fibres, figure.add_axes((0.0, 0.0, 1.0, 1.0)))
    figure.savefig(path, dpi=min(max(0.2 * largest, 150.0), 600.0))
    plt.close(figure)


def _grey(name: str, image: ArrayLike) -> Float:
    """Grey values of mean 0 and deviation 1, (height, width)."""
    try:
        grey = np.asarray(image, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name}: an image is an array of numbers, (height, width)") from None
    if grey.ndim == 3 and grey.shape[2] in (3, 4):
        grey = grey[..., :3] @ GREY
    if grey.ndim != 2:
        raise InputError(f"{name}: needs shape (height, width), got {grey.shape}; choose one slice")
    if grey.size == 0:
        raise InputError(f"{name}: has no pixels")
    if not np.isfinite(grey).all():
        raise InputError(f"{name}: some pixels are not finite numbers; fill them first")
    if np.ptp(grey) == 0.0:
        raise InputError(f"{name}: all pixels have the same value, there is nothing to see")
    return np.asarray((grey - grey.mean()) / grey.std())


def _range(diameter: float | tuple[float, float], name: str, grey: Float) -> tuple[float, float]:
    """Least and largest radius [pixel]."""
    try:
        given = np.asarray(diameter, dtype=float)
    except (TypeError, ValueError):
        given = np.zeros(3)
    if given.shape not in ((), (2,)) or not (np.isfinite(given).all() and (given > 0.0).all()):
        raise InputError(f"diameter {diameter} must be a positive number of pixels, or two")
    low, high = (given * AROUND).tolist() if given.ndim == 0 else given.tolist()
    if low > high:
        raise InputError(f"diameter {low:g} to {high:g}: the smaller one comes first")
    if given.min() < SMALLEST:
        raise InputError(
            f"diameter {given.min():g} pixels is too small to be seen, at least {SMALLEST:g}: "
            "take an image of higher resolution"
        )
    if given.max() > min(grey.shape):
        height, width = grey.shape
        raise InputError(
            f"{name}: a diameter of {given.max():g} pixels does not fit into {width} x {height}"
        )
    return 0.5 * low, 0.5 * min(high, min(grey.shape))


__all__ = ["Fibres", "find", "overlay", "read", "save_overlay"]
