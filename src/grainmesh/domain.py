"""The region of space that holds the particles."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from grainmesh.errors import InputError

SIDES = ("left", "right", "bottom", "top")


@dataclass(frozen=True)
class Box:
    """A rectangle [0, width] x [0, height].

    Parameters
    ----------
    width, height : float
        Side lengths [m].
    periodic : bool
        True: periodic in both directions, particles near an edge have images beyond it.
        False: four sides named ``left``, ``right``, ``bottom``, ``top`` (see `SIDES`).

    Raises
    ------
    InputError
        If a side is not a positive, finite number.
    """

    width: float
    height: float
    periodic: bool = False

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            value = float(getattr(self, name))
            if not (isfinite(value) and value > 0.0):
                raise InputError(f"box {name} {value:g} m must be a positive number")
            object.__setattr__(self, name, value)

    @property
    def size(self) -> NDArray[np.float64]:
        """Width and height [m], shape (2,)."""
        return np.array([self.width, self.height])

    @property
    def area(self) -> float:
        """Area [m2]."""
        return self.width * self.height

    def wrapped(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points `x` [m], (n, 2), moved into the box if it is periodic."""
        if not self.periodic:
            return x
        inside = np.mod(x, self.size)
        return np.where(inside >= self.size, 0.0, inside)  # a tiny negative x rounds to the size

    def separation(self, a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
        """Vector from points `a` to points `b`, to the nearest image if periodic [m], (..., 2)."""
        r = b - a
        if self.periodic:
            r = r - self.size * np.round(r / self.size)
        return r
