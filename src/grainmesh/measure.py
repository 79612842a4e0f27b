"""Contacts and energies of a state."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from grainmesh.motion import IJ, IM, QR, Q, R, X, Y, held, to_wall
from grainmesh.pairs import Near
from grainmesh.plain import plain

Float = NDArray[np.float64]
Int = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contacts of discs with discs, or of discs with walls.

    Parameters
    ----------
    pair : (c, 2)
        Particles i < j in contact, sorted; for walls, particle and number in `Model.all_walls`.
    overlap : (c,)
        δ [m].
    normal : (c, 2)
        Unit vector from i to j, or to the wall.
    force : (c,)
        Normal force of the spring, k δ [N/m].
    friction : (c,)
        Force of the sliding spring, k_t q [N/m]; positive if it turns disc i clockwise.
    """

    pair: Int
    overlap: Float
    normal: Float
    force: Float
    friction: Float

    def __len__(self) -> int:
        return len(self.pair)

    def __repr__(self) -> str:
        if len(self) == 0:
            return "Contacts: none"
        return (
            f"Contacts: {len(self)}, force {self.force.mean():.4g} N/m in the mean, at most "
            f"{self.force.max():.4g} N/m, overlap at most {self.overlap.max():.3g} m"
        )

    def to_dict(self) -> dict[str, Any]:
        """As plain numbers, ready for JSON: one list a field."""
        found: dict[str, Any] = plain(vars(self))
        return found


def contacts_of_discs(s: Float, near: Near, law: Float, slot: Int) -> Contacts:
    """Contacts of discs; `slot` (n,) holds the user's number of each."""
    o, normal = overlaps(s, near)
    on = o > 0.0
    pair = np.stack([slot[near.owner[on]], slot[near.other[on]]], axis=1)
    turn = pair[:, 0] > pair[:, 1]
    pair[turn] = pair[turn, ::-1]
    normal = np.where(turn[:, None], -normal[on], normal[on])
    return _contacts(pair, o[on], normal, near.history[on, Q], law)


def contacts_of_walls(
    s: Float, near: Near, walls: Float, moved: Float, law: Float, slot: Int
) -> Contacts:
    """Contacts of discs with walls."""
    o, normal = wall_overlaps(s, near, walls, moved)
    on = o > 0.0
    pair = np.stack([slot[near.owner[on]], near.other[on].astype(np.int64)], axis=1)
    return _contacts(pair, o[on], normal[on], near.history[on, Q], law)


def _contacts(pair: Int, o: Float, normal: Float, q: Float, law: Float) -> Contacts:
    order = np.lexsort((pair[:, 1], pair[:, 0]))
    return Contacts(pair[order], o[order], normal[order], law[0] * o[order], law[1] * q[order])


def energies(s: Float, p: Float, v: Float, law: Float, pairs: Near, touch: Near,
             walls: Float, moved: Float) -> dict[str, float]:  # fmt: skip
    """Energies per unit depth [J/m]; v (n, 3) are velocities and speeds of the surface by spin."""
    free = p[:, IM] > 0.0  # fixed discs have no energy
    m = np.divide(1.0, p[:, IM], out=np.zeros(len(p)), where=free)
    inertia = np.divide(s[:, R] ** 2, p[:, IJ], out=np.zeros(len(p)), where=free)
    spring = 0.0
    for near, o in (
        (pairs, overlaps(s, pairs)[0]),
        (touch, wall_overlaps(s, touch, walls, moved)[0]),
    ):
        on = o > 0.0
        spring += 0.5 * law[0] * float((o[on] ** 2).sum())
        spring += 0.5 * law[1] * float((near.history[on, Q : QR + 1] ** 2)[:, :2].sum())
    return {
        "kinetic": 0.5 * float((m * (v[:, :2] ** 2).sum(axis=1)).sum()),
        "rotational": 0.5 * float((inertia * (v[:, 2] / s[:, R]) ** 2).sum()),
        "elastic": float(spring),
        "potential": -float((m * (s[:, X] * law[4] + s[:, Y] * law[5])).sum()),
    }


@njit(cache=True)
def overlaps(s, near):  # type: ignore[no-untyped-def]
    """Overlap (l,) [m] of each near pair, negative for a gap, and direction from i to j (l, 2)."""
    o, normal = np.empty(len(near.other)), np.empty((len(near.other), 2))
    for i in range(len(s)):
        for e in range(near.start[i], near.start[i + 1]):
            j = near.other[e]
            dx = s[j, X] + near.offset[e, 0] - s[i, X]
            dy = s[j, Y] + near.offset[e, 1] - s[i, Y]
            distance = sqrt(dx * dx + dy * dy)
            o[e] = s[i, R] + s[j, R] - distance
            normal[e, 0], normal[e, 1] = dx / distance, dy / distance
    return o, normal


@njit(cache=True)
def wall_overlaps(s, near, walls, moved):  # type: ignore[no-untyped-def]
    """The same for near walls; 0 where the end of a wall is covered by another."""
    o, normal = np.empty(len(near.other)), np.empty((len(near.other), 2))
    for i in range(len(s)):
        for e in range(near.start[i], near.start[i + 1]):
            o[e], normal[e, 0], normal[e, 1], at_end = to_wall(s, i, near, e, walls, moved)
            if at_end and o[e] > 0.0 and held(s, i, near, e, o[e], walls, moved):
                o[e] = 0.0
    return o, normal


__all__ = [
    "Contacts",
    "contacts_of_discs",
    "contacts_of_walls",
    "energies",
    "overlaps",
    "wall_overlaps",
]
