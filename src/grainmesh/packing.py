"""Equilibrated hard discs: event-chain Monte Carlo in which the discs grow.

Points are thrown at random; each is a disc of radius zero. Two moves alternate:

- *Chain.* A disc slides along x or y until it touches another; that one goes on, and so on, until
  a given total length has been slid. A wall sends the disc back. No move is ever rejected, and
  with the radii held the chains sample all arrangements of hard discs evenly.
- *Growth.* Each disc takes half of the room to its nearest neighbour, up to its final radius.

A disc grows as its own surroundings allow, so the number of sweeps does not rise with the number of
discs. When all have their final radius, chains alone wipe out the memory of the growth.

Along the chain axis, with (ξ, η) the vector to the other centre and σ the sum of the radii,
disc i is free to slide by

    s = ξ - sqrt(σ² - η²),   ξ > 0, |η| < σ                                                     (1)

References
----------
E. P. Bernard, W. Krauth, D. B. Wilson, "Event-chain Monte Carlo algorithms for hard-sphere
systems", Phys. Rev. E 80 (2009) 056704. B. D. Lubachevsky, F. H. Stillinger, "Geometric properties
of random disk packings", J. Stat. Phys. 60 (1990) 561 (growing discs).
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float = NDArray[np.float64]
Int = NDArray[np.int64]

#: Sweeps of pure chains once all discs have their radius; a fluid forgets its start in about ten.
EQUILIBRATION = 200
#: Sweeps within which all discs must have reached their radius.
PATIENCE = 3000
#: A disc may be caught in a cage: every so many sweeps all shrink to this share of their goal.
BREATH, DEPTH = 300, 0.9
#: Mean length of a chain, and mean path of a disc in one sweep, in mean spacings of the discs.
#: Chains are short because one that a wall sends back retraces its way.
CHAIN, PATH = 0.5, 0.2

WALL = -2


def pack(
    radius: Float, size: Float, periodic: bool, rng: np.random.Generator
) -> tuple[Float, Float]:
    """Hard discs at random in a box, equilibrated.

    Parameters
    ----------
    radius : ndarray, shape (n,)
        Wanted radii [m].
    size : ndarray, shape (2,)
        Width and height of the box [m].
    periodic : bool
        Periodic box, else the discs lie wholly inside four walls.
    rng : numpy.random.Generator
        Source of all randomness.

    Returns
    -------
    x : ndarray, shape (n, 2)
        Centres [m], in the box.
    reached : ndarray, shape (n,)
        Radii reached [m]; smaller than `radius` somewhere if the discs jammed on the way.
    """
    n = len(radius)
    spacing = sqrt(size.prod() / n)
    # A cell is at least as wide as the largest disc; fewer, larger cells where discs are sparse.
    side = max(2.0 * radius.max(), 0.7 * spacing)
    shape = np.maximum(1, np.floor(size / side)).astype(np.int64)
    x = rng.random((n, 2)) * size
    # Discs that are neighbours in space are neighbours in memory; sizes are dealt out at random.
    cell = np.minimum((x / size * shape).astype(np.int64), shape - 1)
    x = x[np.lexsort((cell[:, 1], cell[:, 0]))]
    order = rng.permutation(n)
    goal = radius[order]
    r = np.zeros(n)
    first, after = _fill(x, size, shape)

    def sweep() -> None:
        m = max(1, round(n * PATH / CHAIN))
        start = rng.integers(n, size=m)
        axis = rng.integers(2, size=m)
        length = rng.uniform(-2.0, 2.0, size=m) * CHAIN * spacing
        _slide(x, r, size, periodic, first, after, start, axis, length)

    for k in range(1, PATIENCE + 1):
        if k % BREATH == 0:
            np.minimum(r, DEPTH * goal, out=r)
        if _grow(x, r, goal, size, periodic, first, after) == n:
            for _ in range(EQUILIBRATION):
                sweep()
            break
        sweep()
    centres, reached = np.empty_like(x), np.empty_like(r)
    centres[order], reached[order] = x, r
    return centres, reached


@njit(cache=True)  # type: ignore[untyped-decorator]
def _cell(v: float, length: float, count: int) -> int:
    return min(int(v / length * count), count - 1)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _wrap(p: int, count: int) -> tuple[int, int]:
    """Cell `p` of an endless row as a cell of the box and the number of its image."""
    image = 0
    while p < 0:
        p, image = p + count, image - 1
    while p >= count:
        p, image = p - count, image + 1
    return p, image


@njit(cache=True)  # type: ignore[untyped-decorator]
def _fill(x: Float, size: Float, shape: Int) -> tuple[Int, Int]:
    """Linked lists of the discs in each cell: the first, and the one after each disc."""
    first = np.full((shape[0], shape[1]), -1)
    after = np.full(len(x), -1)
    for i in range(len(x)):
        p, q = _cell(x[i, 0], size[0], shape[0]), _cell(x[i, 1], size[1], shape[1])
        after[i] = first[p, q]
        first[p, q] = i
    return first, after


@njit(cache=True)  # type: ignore[untyped-decorator]
def _move(x: Float, i: int, to: float, a: int, size: Float, first: Int, after: Int) -> None:
    """Put disc `i` at coordinate `to` of axis `a`, and into its cell."""
    p, q = _cell(x[i, 0], size[0], first.shape[0]), _cell(x[i, 1], size[1], first.shape[1])
    x[i, a] = to
    s, t = _cell(x[i, 0], size[0], first.shape[0]), _cell(x[i, 1], size[1], first.shape[1])
    if s == p and t == q:
        return
    if first[p, q] == i:
        first[p, q] = after[i]
    else:
        j = first[p, q]
        while after[j] != i:
            j = after[j]
        after[j] = after[i]
    after[i] = first[s, t]
    first[s, t] = i


@njit(cache=True)  # type: ignore[untyped-decorator]
def _slide(
    x: Float,
    r: Float,
    size: Float,
    periodic: bool,
    first: Int,
    after: Int,
    start: Int,
    axis: Int,
    length: Float,
) -> None:
    """Event chains from the discs `start` along `axis`, over `length` (its sign: the direction)."""
    # Jammed discs collide without end: a bound far above what free ones need.
    events, most = 0, 50 * len(x) + 1000
    r_max = r.max()
    for k in range(len(start)):
        i, a, left = start[k], axis[k], abs(length[k])
        b = 1 - a
        way = 1 if length[k] > 0.0 else -1
        side = size[a] / first.shape[a]
        while left > 0.0 and events < most:
            events += 1
            # Contacts are sought up to two cells ahead, so a longer slide takes several steps.
            s, hit = min(left, 2.0 * side - r[i] - r_max), -1
            if not periodic:
                room = (size[a] - x[i, a] if way > 0 else x[i, a]) - r[i]
                if room < s:
                    s, hit = max(room, 0.0), WALL
            ca, cb = (
                _cell(x[i, a], size[a], first.shape[a]),
                _cell(x[i, b], size[b], first.shape[b]),
            )
            edge = (ca + 1) * side - x[i, a] if way > 0 else x[i, a] - ca * side
            for m in range(3):
                if m > 0 and edge + (m - 1) * side - r[i] - r_max >= s:
                    break
                pa = ca + way * m
                if not periodic and (pa < 0 or pa >= first.shape[a]):
                    break
                pa, za = _wrap(pa, first.shape[a])
                for pb in range(cb - 1, cb + 2):
                    if not periodic and (pb < 0 or pb >= first.shape[b]):
                        continue
                    wb, zb = _wrap(pb, first.shape[b])
                    j = first[pa, wb] if a == 0 else first[wb, pa]
                    while j >= 0:
                        xi = way * (x[j, a] + za * size[a] - x[i, a])
                        eta = x[j, b] + zb * size[b] - x[i, b]
                        sigma = r[i] + r[j]
                        if j != i and xi > 0.0 and abs(eta) < sigma:
                            t = xi - sqrt(sigma * sigma - eta * eta)  # Eq. (1)
                            if t < s:
                                s, hit = max(t, 0.0), j
                        j = after[j]
            to = x[i, a] + way * s
            if periodic:
                to -= np.floor(to / size[a]) * size[a]
                if to >= size[a]:
                    to = 0.0
            _move(x, i, to, a, size, first, after)
            left -= s
            if hit >= 0:
                i = hit
            elif hit == WALL:
                way = -way


@njit(cache=True)  # type: ignore[untyped-decorator]
def _grow(
    x: Float, r: Float, goal: Float, size: Float, periodic: bool, first: Int, after: Int
) -> int:
    """Let each disc take half of the room around it; the number of discs that have their goal."""
    done = 0
    for i in range(len(x)):
        if r[i] < goal[i]:
            room = goal[i]
            if periodic:
                room = min(room, 0.5 * size[0], 0.5 * size[1])
            else:
                room = min(room, x[i, 0], x[i, 1], size[0] - x[i, 0], size[1] - x[i, 1])
            ca, cb = (
                _cell(x[i, 0], size[0], first.shape[0]),
                _cell(x[i, 1], size[1], first.shape[1]),
            )
            for pa in range(ca - 1, ca + 2):
                for pb in range(cb - 1, cb + 2):
                    wa, za = _wrap(pa, first.shape[0])
                    wb, zb = _wrap(pb, first.shape[1])
                    if not periodic and (za != 0 or zb != 0):
                        continue
                    j = first[wa, wb]
                    while j >= 0:
                        if j != i:
                            xi = x[j, 0] + za * size[0] - x[i, 0]
                            eta = x[j, 1] + zb * size[1] - x[i, 1]
                            room = min(room, sqrt(xi * xi + eta * eta) - r[j])
                        j = after[j]
            r[i] = goal[i] if room >= goal[i] else max(r[i], 0.5 * (r[i] + room))
        if r[i] == goal[i]:
            done += 1
    return done
