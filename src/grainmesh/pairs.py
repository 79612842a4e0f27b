"""Near pairs: the edges of the triangulation, and the walls, that may come into contact soon.

Each disc, and each wall, is given a way it may move, longer the faster it is, before lists are made
anew. A list holds every pair whose surfaces are closer than the ways of both together, so two discs
that are not in it cannot touch while none has moved its way.

**Edges suffice.** In the power triangulation (weights r²) discs i and j are joined by an edge if
some point y has a smaller power |y - x|² - r² to both than to any third disc k. Take the y between
x_i and x_j, at distances a_i and a_j, where both powers are the same, p. Let no two discs overlap
by more than δ, and the gap of i and j be s. With A_i = (r_i - δ)² + r_i² + 2 r_k (r_i - δ),
Stewart's theorem for the triangle of i, j, k says

    power_k(y) - p >= (a_i a_j/d) [A_i/a_i + A_j/a_j - 2 d],  d = a_i + a_j = r_i + r_j + s.   (1)

The bracket grows with r_k, so the smallest third disc, of radius 1, is the worst; it falls as d
grows, so a smaller gap is safer. With u = a_i -
r_i and v = a_j - r_j, u + v = s, it is at least 4 (1 - δ - s) - f(u) - f(v), where f(u) = 2 (2 - δ)
- 2 u - (2 - δ)²/(1 + u) is concave, so f(u) + f(v) <= 2 f(s/2), and the bracket is positive if

    δ + s/sqrt(2) < 2 - sqrt(2) = 0.5858  smallest radii,                                      (2)

which four equal discs attain. With s <= 2 `WAY` and δ <= `DEEPEST` no pair is missed. The edges
also hold the deepest overlap itself (δ = -s in Eq. 1) while it is below the smallest radius, which
`start.FARTHEST` sees to (0.3 + 2 * 0.2 + 2 * 0.1), so one beyond `DEEPEST` is noticed. The same δ
is safe if fixed discs overlap each other by up to 0.3 of the smaller radius of both. Nodes of
weight 0 stay away from all centres by the largest radius (`living`), more than they need.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from grainmesh.contact import Contact
from grainmesh.living import Living
from grainmesh.walls import AX, AY, LENGTH, TX, TY

Float = NDArray[np.float64]
Int = NDArray[np.int32]

#: Longest way, and largest overlap, for which edges hold all near pairs, in smallest radii.
WAY, DEEPEST = 0.2, 0.3
#: Discs in a block that is compared with a wall as a whole.
BLOCK = 64


class Near(NamedTuple):
    """Near partners, sorted by the disc that owns the entry.

    Entries ``start[i]:start[i + 1]`` have disc i as `owner` (l,); `other` (l,) is a disc j > i or a
    wall, `image` (l, 2) its periodic image relative to that of i, `offset` (l, 2) the same in
    metres [m], `damping` (l,) is c [kg/s], `mass` (l,) the effective mass [kg], and `history`
    (l, h) what the contact remembers (`motion`). Two fixed discs, or one and a wall, are no pair.
    """

    start: NDArray[np.int64]
    owner: Int
    other: Int
    image: Int
    offset: Float
    damping: Float
    mass: Float
    history: Float


class Memory(NamedTuple):
    """What contacts remember, entry by entry: `owner`, `other` (l,), `image` (l, 2), `history`."""

    owner: Int
    other: Int
    image: Int
    history: Float


def nothing(width: int) -> Memory:
    """No contact, remembered in `width` columns."""
    none = np.zeros(0, np.int32)
    return Memory(none, none, np.zeros((0, 2), np.int32), np.zeros((0, width)))


def memory(near: Near) -> Memory:
    """What the contacts of a list remember."""
    return Memory(near.owner, near.other, near.image, near.history)


def widened(old: Memory, width: int) -> Memory:
    """The same in `width` columns, new ones being zero."""
    history = np.zeros((len(old.other), width))
    same = min(width, old.history.shape[1])
    history[:, :same] = old.history[:, :same]
    return old._replace(history=history)


def renumbered(old: Memory, new: Int, discs: bool, odd: tuple[int, ...]) -> Memory:
    """The same where disc i has the number ``new[i]``, or -1 if it is gone.

    `discs`: partners are discs too. Columns `odd` change sign where i and j change places.
    """
    owner, other = new[old.owner], new[old.other] if discs else old.other
    stay = (owner >= 0) & (other >= 0)
    owner, other, image, history = owner[stay], other[stay], old.image[stay], old.history[stay]
    if discs:
        turn = owner > other
        owner, other = np.where(turn, other, owner), np.where(turn, owner, other)
        image[turn] *= -1
        for column in odd:
            if column < history.shape[1]:
                history[turn, column] *= -1.0
    return Memory(owner, other, image, history)


def near_discs(
    mesh: Living, radius: Float, mass: Float, contact: Contact, ways: Float, old: Memory
) -> Near:
    """Discs that can touch before one has moved its way.

    All (n,): radius [m], mass [kg/m], infinite for fixed discs, and ways [m].
    """
    start, other, image = edges_closer(
        mesh.points, radius, mesh.period, ways, np.isinf(mass), mesh.triangles, mesh.neighbours,
        mesh.shifts,
    )  # fmt: skip
    history = remember(*old, start, other, image)
    owner = _owners(start)
    light, heavy = np.minimum(mass[owner], mass[other]), np.maximum(mass[owner], mass[other])
    m = light / (1.0 + light / heavy)
    return Near(start, owner, other, image, image * mesh.period, contact.coefficient(m), m, history)


def near_walls(
    mesh: Living,
    radius: Float,
    mass: Float,
    contact: Contact,
    ways: Float,
    old: Memory,
    walls: Float,
    moved: Float,
) -> Near:
    """The same for walls, `ways` (n + w,); `walls` and `moved` as in `motion.advance`."""
    ways = ways.copy()
    ways[: len(mass)][np.isinf(mass)] = -np.inf  # fixed discs meet no wall
    start, other, image = walls_closer(mesh.points, radius, mesh.period, ways, walls, moved)
    history = remember(*old, start, other, image)
    owner = _owners(start)
    m = mass[owner]
    return Near(start, owner, other, image, image * mesh.period, contact.coefficient(m), m, history)


def _owners(start: NDArray[np.int64]) -> Int:
    return np.repeat(np.arange(len(start) - 1, dtype=np.int32), np.diff(start))


@njit(cache=True)
def edges_closer(points, radius, period, ways, fixed, triangles, neighbours, shifts):  # type: ignore[no-untyped-def]
    """Edges of discs closer than both their ways: start (n + 1,), other (l,), image (l, 2)."""
    n, t = len(radius), len(triangles)
    found = np.empty((3 * n + 8, 4), np.int32)
    size = 0
    start = np.zeros(n + 1, np.int64)
    for a in range(t):
        for k in range(3):
            if 0 <= neighbours[a, k] < a:
                continue  # seen from the other side
            k1, k2 = (k + 1) % 3, (k + 2) % 3
            i, j = triangles[a, k1], triangles[a, k2]
            if i >= n or j >= n or i == j or (fixed[i] and fixed[j]):
                continue
            sx, sy = shifts[a, k2, 0] - shifts[a, k1, 0], shifts[a, k2, 1] - shifts[a, k1, 1]
            dx = points[j, 0] - points[i, 0] + sx * period[0]
            dy = points[j, 1] - points[i, 1] + sy * period[1]
            reach = radius[i] + radius[j] + ways[i] + ways[j]
            if dx * dx + dy * dy >= reach * reach:
                continue
            if i > j:
                i, j, sx, sy = j, i, -sx, -sy
            if size == len(found):
                found = np.concatenate((found, np.empty_like(found)))
            found[size, 0], found[size, 1], found[size, 2], found[size, 3] = i, j, sx, sy
            start[i + 1] += 1
            size += 1
    start = np.cumsum(start)
    place = start[:-1].copy()
    other, image = np.empty(size, np.int32), np.empty((size, 2), np.int32)
    for e in range(size):
        i, j, sx, sy = found[e, 0], found[e, 1], found[e, 2], found[e, 3]
        # Insertion keeps each row in order, whatever the triangles are called.
        p = place[i]
        while p > start[i] and (
            other[p - 1] > j
            or (other[p - 1] == j and image[p - 1, 0] > sx)
            or (other[p - 1] == j and image[p - 1, 0] == sx and image[p - 1, 1] > sy)
        ):
            other[p], image[p, 0], image[p, 1] = other[p - 1], image[p - 1, 0], image[p - 1, 1]
            p -= 1
        other[p], image[p, 0], image[p, 1] = j, sx, sy
        place[i] += 1
    # In a small periodic box an edge can have the same triangle on both sides: keep it once.
    kept = 0
    for i in range(n):
        begin, end = start[i], place[i]
        start[i] = kept
        for e in range(begin, end):
            j, sx, sy = other[e], image[e, 0], image[e, 1]
            if kept > start[i]:
                last = kept - 1
                if other[last] == j and image[last, 0] == sx and image[last, 1] == sy:
                    continue
            other[kept], image[kept, 0], image[kept, 1] = j, sx, sy
            kept += 1
    start[n] = kept
    return start, other[:kept].copy(), image[:kept].copy()


@njit(cache=True)
def walls_closer(points, radius, period, ways, walls, moved):  # type: ignore[no-untyped-def]
    """Walls closer to discs than both their ways: start (n + 1,), wall (l,), image (l, 2).

    `ways` (n + w,) is how far each disc, then each wall, may move [m];
    `moved` (w, 2) is how far each wall has moved from where its row in `walls` says [m].
    """
    n = len(radius)
    found = np.empty((64, 4), np.int32)
    size = 0
    start = np.zeros(n + 1, np.int64)
    for b in range(0, n, BLOCK):
        e = min(b + BLOCK, n)
        low, high, most = np.full(2, np.inf), np.full(2, -np.inf), 0.0
        for i in range(b, e):
            most = max(most, radius[i] + ways[i])
            for c in range(2):
                low[c] = min(low[c], points[i, c])
                high[c] = max(high[c], points[i, c])
        for w in range(len(walls)):
            sides = walls[w, LENGTH] == np.inf
            first, last = np.zeros(2, np.int64), np.zeros(2, np.int64)
            away = False
            for c in range(2):
                if sides:
                    continue
                a = walls[w, AX + c] + moved[w, c]
                z = a + walls[w, TX + c] * walls[w, LENGTH]
                left, right = min(a, z) - most - ways[n + w], max(a, z) + most + ways[n + w]
                if period[c] > 0.0:
                    first[c] = int(np.ceil((low[c] - right) / period[c]))
                    last[c] = int(np.floor((high[c] - left) / period[c]))
                elif low[c] > right or high[c] < left:
                    away = True
            if away:
                continue
            for sx in range(first[0], last[0] + 1):
                for sy in range(first[1], last[1] + 1):
                    for i in range(b, e):
                        dx = points[i, 0] - walls[w, AX] - moved[w, 0] - sx * period[0]
                        dy = points[i, 1] - walls[w, AY] - moved[w, 1] - sy * period[1]
                        if _distance(dx, dy, walls[w]) < radius[i] + ways[i] + ways[n + w]:
                            if size == len(found):
                                found = np.concatenate((found, np.empty_like(found)))
                            found[size, 0], found[size, 1] = i, w
                            found[size, 2], found[size, 3] = sx, sy
                            start[i + 1] += 1
                            size += 1
    start = np.cumsum(start)
    place = start[:-1].copy()
    rows = np.empty((size, 3), np.int32)
    for k in range(size):
        i = found[k, 0]
        rows[place[i]] = found[k, 1:]
        place[i] += 1
    return start, rows[:, 0].copy(), rows[:, 1:].copy()


@njit(cache=True, inline="always")
def _distance(dx, dy, wall):  # type: ignore[no-untyped-def]
    """Distance to a wall from where it starts; negative behind a side of the box."""
    if wall[LENGTH] == np.inf:
        return dy * wall[TX] - dx * wall[TY]
    along = dx * wall[TX] + dy * wall[TY]
    along = min(max(along, 0.0), wall[LENGTH])
    return np.hypot(dx - along * wall[TX], dy - along * wall[TY])


@njit(cache=True)
def remember(owner, other, image, history, new_start, new_other, new_image):  # type: ignore[no-untyped-def]
    """History (l, h) of the new rows, taken from old entries of the same pair and image, else 0."""
    n = len(new_start) - 1
    head, follow = np.full(n, -1), np.full(len(other), -1)
    for k in range(len(other)):
        follow[k], head[owner[k]] = head[owner[k]], k
    found = np.zeros((len(new_other), history.shape[1]))
    for i in range(n):
        for k in range(new_start[i], new_start[i + 1]):
            o = head[i]
            while o >= 0 and not (
                other[o] == new_other[k]
                and image[o, 0] == new_image[k, 0]
                and image[o, 1] == new_image[k, 1]
            ):
                o = follow[o]
            if o >= 0:
                for h in range(history.shape[1]):
                    found[k, h] = history[o, h]
    return found


__all__ = [
    "DEEPEST",
    "WAY",
    "Memory",
    "Near",
    "memory",
    "near_discs",
    "near_walls",
    "nothing",
    "renumbered",
    "widened",
]
