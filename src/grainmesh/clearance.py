"""Where nodes of the fluid have room, where they have none, and how they go along with particles.

Loops over the triangles of `grainmesh.nodes`, whose Eqs. (1) and (2) these are. Points are discs,
of radius r, then nodes on walls and, from `first` on, those inside, of radius 0. Taken as s - r/4
at centres of discs and s on walls, Eq. (1) is at a node, with distances along edges,

    h_v = min(S, s + l_wall/4, h_u + |x_v - x_u|/4)                                           (1)

of all neighbours u.
"""

from __future__ import annotations

from math import inf, sqrt

import numpy as np
from numba import njit

#: How h grows with the distance from particles and walls.
GROWTH = 0.25
#: A node comes in where it has more room than this, and leaves where it has less, in h.
ROOM, NEAR = 0.75, 0.45
#: Means over neighbours that make the motion of nodes.
SWEEPS = 8


@njit(cache=True)
def sizes(points, radius, size, period, triangles, shifts, first, near, far):  # type: ignore[no-untyped-def]
    """Eq. (1) at all points, (m,) [m]; `size` is that of the box, `period` 0 if it has walls."""
    h = near - GROWTH * radius
    for v in range(first, len(points)):
        h[v] = min(far, near + GROWTH * _from_wall(points[v, 0], points[v, 1], size, period))
    better = True
    while better:
        better = False
        for t in range(len(triangles)):
            for k in range(3):
                v, u = triangles[t, k], triangles[t, k - 1]
                if v < first and u < first:
                    continue
                dx, dy = _between(points, period, triangles, shifts, t, k, k - 1)
                rise = GROWTH * sqrt(dx * dx + dy * dy)
                if v >= first and h[u] + rise < h[v]:
                    h[v], better = h[u] + rise, True
                if u >= first and h[v] + rise < h[u]:
                    h[u], better = h[v] + rise, True
    return h


@njit(cache=True)
def crowded(points, radius, size, period, triangles, shifts, first, h):  # type: ignore[no-untyped-def]
    """Which nodes inside are to leave (m,); of two too near for either, the later."""
    out = np.zeros(len(points), np.bool_)
    for among_nodes in (False, True):
        for t in range(len(triangles)):
            for k in range(3):
                v = triangles[t, k]
                if v < first:
                    continue
                if 2.0 * _from_wall(points[v, 0], points[v, 1], size, period) < NEAR * h[v]:
                    out[v] = True
                for j in (k - 1, k - 2):
                    u = triangles[t, j]
                    if (u >= first) != among_nodes or (among_nodes and (u >= v or out[u])):
                        continue
                    dx, dy = _between(points, period, triangles, shifts, t, k, j)
                    least = NEAR * (max(h[u], h[v]) if among_nodes else h[v])
                    if dx * dx + dy * dy - radius[u] ** 2 < least**2:  # Eq. (2)
                        out[v] = True
    return out


@njit(cache=True)
def openings(points, radius, size, period, triangles, shifts, near, far, h):  # type: ignore[no-untyped-def]
    """Places where there is room for a node: all that have most of it around them.

    These are centres of the circles at right angles to three discs; no other is nearer.

    Returns
    -------
    places : (k, 2)
        [m]
    room, wanted : (k,)
        g, Eq. (2), and `ROOM` h [m].
    """
    places = np.empty((len(triangles), 2))
    room, wanted, count = np.empty(len(triangles)), np.empty(len(triangles)), 0
    for t in range(len(triangles)):
        ax, ay = _between(points, period, triangles, shifts, t, 1, 0)
        bx, by = _between(points, period, triangles, shifts, t, 2, 0)
        v = triangles[t, 0]
        w = radius[v] ** 2
        a = 0.5 * (ax * ax + ay * ay + w - radius[triangles[t, 1]] ** 2)
        b = 0.5 * (bx * bx + by * by + w - radius[triangles[t, 2]] ** 2)
        area = ax * by - ay * bx
        x, y = (a * by - b * ay) / area, (b * ax - a * bx) / area
        g = x * x + y * y - w
        if g <= (ROOM * near) ** 2:
            continue
        x += points[v, 0] + shifts[t, 0, 0] * period[0]
        y += points[v, 1] + shifts[t, 0, 1] * period[1]
        wall = _from_wall(x, y, size, period)
        g, aim = min(sqrt(g), 2.0 * wall), min(far, near + GROWTH * wall)
        for k in range(3):
            v = triangles[t, k]
            dx = x - points[v, 0] - shifts[t, k, 0] * period[0]
            dy = y - points[v, 1] - shifts[t, k, 1] * period[1]
            aim = min(aim, h[v] + GROWTH * sqrt(dx * dx + dy * dy))
        if g > ROOM * aim:
            places[count, 0], places[count, 1], room[count], wanted[count] = x, y, g, ROOM * aim
            count += 1
    return places[:count], room[:count], wanted[:count]


@njit(cache=True)
def covered(places, x, radius, period):  # type: ignore[no-untyped-def]
    """Which places (k, 2) lie in one of the discs (k,)."""
    found = np.zeros(len(places), np.bool_)
    for q in range(len(places)):
        for i in range(len(x)):
            dx, dy = places[q, 0] - x[i, 0], places[q, 1] - x[i, 1]
            if period[0] > 0.0:
                dx -= period[0] * np.round(dx / period[0])
                dy -= period[1] * np.round(dy / period[1])
            if dx * dx + dy * dy <= radius[i] ** 2:
                found[q] = True
                break
    return found


@njit(cache=True)
def carried(triangles, first, values):  # type: ignore[no-untyped-def]
    """Give nodes inside the mean of their neighbours' values (m, 2), `SWEEPS` times, in place."""
    some, count = np.empty(len(triangles), np.int64), 0
    degree = np.zeros(len(values))
    for t in range(len(triangles)):
        if max(triangles[t, 0], triangles[t, 1], triangles[t, 2]) >= first:
            some[count] = t
            count += 1
            for k in range(3):
                degree[triangles[t, k]] += 2.0
    for _ in range(SWEEPS):
        total = np.zeros_like(values)
        for t in some[:count]:
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            for j in range(2):
                all_three = values[a, j] + values[b, j] + values[c, j]
                total[a, j] += all_three - values[a, j]
                total[b, j] += all_three - values[b, j]
                total[c, j] += all_three - values[c, j]
        for v in range(first, len(values)):
            if degree[v] > 0.0:
                for j in range(2):
                    values[v, j] = total[v, j] / degree[v]


@njit(cache=True, forceinline=True)
def _between(points, period, triangles, shifts, t, k, j):  # type: ignore[no-untyped-def]
    """From corner j of triangle t to its corner k."""
    v, u = triangles[t, k], triangles[t, j]
    dx = points[v, 0] - points[u, 0] + (shifts[t, k, 0] - shifts[t, j, 0]) * period[0]
    dy = points[v, 1] - points[u, 1] + (shifts[t, k, 1] - shifts[t, j, 1]) * period[1]
    return dx, dy


@njit(cache=True, forceinline=True)
def _from_wall(x, y, size, period):  # type: ignore[no-untyped-def]
    """Distance of a place from the nearest wall [m], below 0 outside."""
    return inf if period[0] > 0.0 else min(x, y, size[0] - x, size[1] - y)


__all__ = ["GROWTH", "NEAR", "ROOM", "carried", "covered", "crowded", "openings", "sizes"]
