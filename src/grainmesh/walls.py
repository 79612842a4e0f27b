"""Walls: the sides of the box, and straight segments anywhere, at rest or moving as prescribed.

A wall moves without turning; a point of it that starts at a is at time t at

    a + u t + A sin(2 π f t),     with the velocity  u + 2 π f A cos(2 π f t).                 (1)
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite, pi

import numpy as np
from numpy.typing import NDArray

from grainmesh.domain import SIDES, Box
from grainmesh.errors import InputError

Float = NDArray[np.float64]
Pair = tuple[float, float]

#: Columns of the table of walls that the kernels read.
AX, AY, TX, TY, LENGTH, UX, UY, SX, SY, OMEGA, FRICTION = range(11)


@dataclass(frozen=True)
class Wall:
    """A straight segment that discs touch from both sides, its ends included.

    A point a of it is at a + u t + A sin(2 π f t) at time t. In a periodic box all images count.

    Parameters
    ----------
    start, end : (float, float)
        Ends at time 0 [m].
    velocity : (float, float)
        u, constant [m/s].
    amplitude, frequency : (float, float), float
        A [m] and f [1/s] of an oscillation.
    friction : float, optional
        mu of contacts with this wall, else that of the contact law.
    side : str, optional
        Set by `of`: the wall is then the whole line, with the box on its one side.

    Raises
    ------
    InputError
        If a value is not finite or the ends coincide.
    """

    start: Pair
    end: Pair
    velocity: Pair = (0.0, 0.0)
    amplitude: Pair = (0.0, 0.0)
    frequency: float = 0.0
    friction: float | None = None
    side: str | None = None

    def __post_init__(self) -> None:
        for name in ("start", "end", "velocity", "amplitude"):
            given = tuple(float(c) for c in getattr(self, name))
            if len(given) != 2 or not all(isfinite(c) for c in given):
                raise InputError(f"wall: {name} {given} must be two finite numbers")
            object.__setattr__(self, name, given)
        if self.side is not None and self.side not in SIDES:
            raise InputError(f"wall: side {self.side!r} must be one of {', '.join(SIDES)}")
        if self.start == self.end:
            raise InputError(f"wall: start and end are both {self.start}, a wall needs a length")
        if not (isfinite(self.frequency) and self.frequency >= 0.0):
            raise InputError(f"wall: frequency {self.frequency:g} 1/s must be at least 0")
        if any(self.amplitude) != (self.frequency > 0.0):
            raise InputError("wall: amplitude and frequency belong together, one of them is zero")
        if self.friction is not None and not (isfinite(self.friction) and self.friction >= 0.0):
            raise InputError(f"wall: friction {self.friction:g} must be at least 0")

    @classmethod
    def of(
        cls,
        box: Box,
        side: str,
        velocity: Pair = (0.0, 0.0),
        amplitude: Pair = (0.0, 0.0),
        frequency: float = 0.0,
        friction: float | None = None,
    ) -> Wall:
        """The wall that is a side of the box, "left", "right", "bottom" or "top"."""
        if side not in SIDES:
            raise InputError(f"wall: side {side!r} must be one of {', '.join(SIDES)}")
        w, h = box.width, box.height
        start, end = {
            "left": ((0.0, h), (0.0, 0.0)),
            "right": ((w, 0.0), (w, h)),
            "bottom": ((0.0, 0.0), (w, 0.0)),
            "top": ((w, h), (0.0, h)),
        }[side]
        return cls(start, end, velocity, amplitude, frequency, friction, side)


def table(walls: tuple[Wall, ...], friction: float) -> Float:
    """Walls as rows of numbers, (w, 11): see the columns above."""
    rows = np.zeros((len(walls), 11))
    for row, wall in zip(rows, walls, strict=True):
        a, b = np.array(wall.start), np.array(wall.end)
        length = float(np.hypot(*(b - a)))
        row[AX : AY + 1], row[TX : TY + 1] = a, (b - a) / length
        row[LENGTH] = inf if wall.side else length
        row[UX : UY + 1], row[SX : SY + 1] = wall.velocity, wall.amplitude
        row[OMEGA] = 2.0 * pi * wall.frequency
        row[FRICTION] = friction if wall.friction is None else wall.friction
    return rows


__all__ = ["Wall", "table"]
