"""Power cells: the area and the solid that belong to each particle.

The power (Laguerre) cell of particle i is the part of the box nearer to i than to any other j,

    C_i = { y : |y - x_i|² - r_i² <= |y - x_j|² - r_j²  for all j },                          (1)

a convex polygon bounded by straight lines normal to x_j - x_i at the distance

    h_ij = (D² + r_i² - r_j²) / (2 D),    D = |x_j - x_i|,                                    (2)

from x_i: the Voronoi cell where all discs are equal. A line (2) cuts a polygon that reaches R
from x_i only if h_ij < R, so no disc beyond

    D = R + sqrt(R² + r_max² - r_i²)                                                          (3)

matters: neighbours are taken in rings of growing distance until (3) is passed (C. H. Rycroft,
"Voro++", Chaos 19 (2009) 041111). The line between two overlapping discs passes through the
points where their circles cross, hence

    sum A_i = area of the box,    sum V_i = area of the union of the discs inside the box,    (4)

with A_i = |C_i| and V_i = |C_i ∩ disc_i|: equal and unequal, overlapping and cut discs, and discs
whose centre lies outside a box with walls, all by one rule.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.particles import Particles

Float = NDArray[np.float64]
Int = NDArray[np.int32]

#: Mean number of points in a square of the search grid.
PER_SQUARE = 2.0


@dataclass(frozen=True, eq=False)
class Cells:
    """The power cell of every particle.

    Parameters
    ----------
    area : (n,)
        Area A_i of the cell, clipped at the walls [m2].
    solid : (n,)
        Area V_i of the disc inside its own cell [m2].
    """

    area: Float
    solid: Float

    @property
    def porosity(self) -> Float:
        """1 - V_i/A_i, shape (n,); 1 for a particle with no cell inside the box.

        At least 0.093 for equal discs that lie inside and do not overlap; the cell of a disc that
        a wall cuts, or that overlaps others, may be solid altogether.
        """
        filled = np.divide(self.solid, self.area, out=np.zeros_like(self.area), where=self.area > 0)
        return 1.0 - filled


@dataclass(frozen=True, eq=False)
class Diagram:
    """Power diagram of points: per cell its area, its solid and its neighbours in order.

    The neighbours of point i, counter-clockwise, are the entries ``start[i]:start[i + 1]`` of
    `neighbour` (l,) and `shift` (l, 2), the periodic image; -1 marks a side of the window.
    """

    area: Float
    solid: Float
    start: NDArray[np.int64]
    neighbour: Int
    shift: Int


def cells(box: Box, particles: Particles) -> Cells:
    """Area and solid of the power cell of every particle, Eqs. (1)-(4).

    Parameters
    ----------
    box : Box
        With walls, cells end there; the part inside of a disc that a wall cuts counts, also where
        its centre lies outside. Periodic, images beyond the edge bound the cells.
    particles : Particles
        Any number n >= 1 of discs, unequal if need be.

    Returns
    -------
    Cells

    Raises
    ------
    InputError
        If particles share a centre, so that the cells do not fill the box once.
    """
    radius = particles.radius
    window = np.array([[0.0, 0.0], box.size])
    found = diagram(box, box.wrapped(particles.x), radius**2, radius, window)
    if abs(found.area.sum() - box.area) > 1e-9 * box.area:
        raise InputError(
            "the cells of the particles do not fill the box: two particles share a centre, remove "
            "one of them"
        )
    found.area.setflags(write=False)
    found.solid.setflags(write=False)
    return Cells(found.area, found.solid)


def diagram(
    box: Box,
    x: Float,
    weight: Float,
    radius: Float,
    window: Float,
    strain: tuple[float, float] = (0.0, 0.0),
) -> Diagram:
    """Power diagram of points `x` inside a window.

    Parameters
    ----------
    box : Box
        Only its period counts, if it is periodic.
    x : (n, 2)
        Points [m], inside the box if it is periodic.
    weight : (n,)
        Power weights [m2], r_i² for discs.
    radius : (n,)
        Radii of the discs whose share of the cell is `Diagram.solid` [m].
    window : (2, 2)
        Lower and upper corner of the rectangle that bounds all cells of a box with walls [m].
    strain : tuple of float
        (a, b) replaces every separation (dx, dy) by (dx + b dy, dy + a dy): a homogeneous strain,
        the same for all points and images, that leaves no four points on a common circle.
    """
    # A copy: a read-only array would be compiled for once more.
    return Diagram(*_diagram(x.copy(), weight, radius, box.size, box.periodic, window, *strain))


@njit(cache=True)
def _sector(ax, ay, bx, by, r):  # type: ignore[no-untyped-def]
    """Signed area of the triangle (0, a, b) inside the circle of radius r around 0."""
    # From the difference b - a, so that a short side far away loses no digits.
    ex, ey, rr = bx - ax, by - ay, r * r
    cross = ax * ey - ay * ex
    if ax * ax + ay * ay <= rr and bx * bx + by * by <= rr:
        return 0.5 * cross
    angle = atan2(cross, ax * bx + ay * by)
    ll = ex * ex + ey * ey
    room = rr * ll - cross * cross  # positive where the line through a and b meets the circle
    if room <= 0.0:
        return 0.5 * rr * angle
    # a + t (b - a) on the circle: t = [-a.(b - a) ∓ sqrt(room)] / |b - a|²
    root, foot = sqrt(room), -(ax * ex + ay * ey)
    t0, t1 = (foot - root) / ll, (foot + root) / ll
    if t1 <= 0.0 or t0 >= 1.0:
        return 0.5 * rr * angle
    t0, t1 = max(t0, 0.0), min(t1, 1.0)
    px, py = ax + t0 * ex, ay + t0 * ey
    qx, qy = ax + t1 * ex, ay + t1 * ey
    arc = 0.0
    if t0 > 0.0:
        arc += atan2(ax * py - ay * px, ax * px + ay * py)
    if t1 < 1.0:
        arc += atan2(qx * by - qy * bx, qx * bx + qy * by)
    return 0.5 * (rr * arc + (t1 - t0) * cross)


@njit(cache=True)
def _grid(x, low, extent):  # type: ignore[no-untyped-def]
    """Points sorted into squares: counts (2,), side lengths (2,), first entry, order."""
    n = len(x)
    side = sqrt(extent[0] * extent[1] * PER_SQUARE / n)
    count = np.ones(2, np.int64)
    length = np.ones(2)
    for k in range(2):
        if extent[k] > 0.0:
            count[k] = n if extent[k] >= n * side else max(1, int(extent[k] / side))
            length[k] = extent[k] / count[k]
    square = np.empty(n, np.int64)
    first = np.zeros(count[0] * count[1] + 1, np.int64)
    for i in range(n):
        cx = min(int((x[i, 0] - low[0]) / length[0]), count[0] - 1)
        cy = min(int((x[i, 1] - low[1]) / length[1]), count[1] - 1)
        square[i] = cy * count[0] + cx
        first[square[i] + 1] += 1
    first = np.cumsum(first)
    order = np.empty(n, np.int64)
    place = first[:-1].copy()
    for i in range(n):
        order[place[square[i]]] = i
        place[square[i]] += 1
    return count, length, first, order


@njit(cache=True)
def _cut(p, tag, m, q, qtag, du, dv, c, j, sx, sy):  # type: ignore[no-untyped-def]
    """Keep the part u du + v dv <= c of polygon `p`, written to `q`; its vertex count, -1 if whole.

    ``tag[k]`` names the neighbour behind the side from vertex k to vertex k + 1.
    """
    outside = 0
    for k in range(m):
        p[k, 2] = p[k, 0] * du + p[k, 1] * dv - c
        outside += p[k, 2] > 0.0
    if outside == 0:
        return -1
    size = 0
    for k in range(m):
        o = k + 1 if k + 1 < m else 0
        s, t = p[k, 2], p[o, 2]
        if s <= 0.0:
            q[size, 0], q[size, 1] = p[k, 0], p[k, 1]
            qtag[size] = tag[k]
            size += 1
        if (s <= 0.0) != (t <= 0.0):
            f = s / (s - t)
            q[size, 0] = p[k, 0] + f * (p[o, 0] - p[k, 0])
            q[size, 1] = p[k, 1] + f * (p[o, 1] - p[k, 1])
            if s <= 0.0:
                qtag[size, 0], qtag[size, 1], qtag[size, 2] = j, sx, sy
            else:
                qtag[size] = tag[k]
            size += 1
    return size


@njit(cache=True)
def _diagram(x, weight, radius, period, periodic, window, a, b):  # type: ignore[no-untyped-def]
    n = len(x)
    low, extent = np.zeros(2), period.copy()
    if not periodic:
        for k in range(2):
            low[k] = x[:, k].min()
            extent[k] = x[:, k].max() - low[k]
    count, length, first, order = _grid(x, low, extent)
    step = min(length[0], length[1])
    w_max = weight.max()
    area, solid = np.zeros(n), np.zeros(n)
    start = np.zeros(n + 1, np.int64)
    entries = np.empty((8 * n + 64, 3), np.int32)
    p, q = np.empty((64, 3)), np.empty((64, 3))
    tag, qtag = np.empty((64, 3), np.int32), np.empty((64, 3), np.int32)
    for i in range(n):
        xi, yi = x[i, 0], x[i, 1]
        # Twice the period: own images cut it down to the right size.
        x0, x1 = (-period[0], period[0]) if periodic else (window[0, 0] - xi, window[1, 0] - xi)
        y0, y1 = (-period[1], period[1]) if periodic else (window[0, 1] - yi, window[1, 1] - yi)
        p[0, 0], p[1, 0], p[2, 0], p[3, 0] = x0, x1, x1, x0
        p[0, 1], p[1, 1], p[2, 1], p[3, 1] = y0, y0, y1, y1
        tag[:4] = -1
        m = 4
        reach2 = max(x0 * x0, x1 * x1) + max(y0 * y0, y1 * y1)
        cx = min(int((xi - low[0]) / length[0]), count[0] - 1)
        cy = min(int((yi - low[1]) / length[1]), count[1] - 1)
        fx, fy = xi - low[0] - cx * length[0], yi - low[1] - cy * length[1]
        margin = max(min(min(fx, length[0] - fx), min(fy, length[1] - fy)), 0.0)
        ring = 0
        while m > 0 and (periodic or ring < max(count[0], count[1])):
            # Eq. (3); the factor leaves room for the strain.
            nearest = (margin + (ring - 1) * step) * (1.0 - 1e-5)
            if ring > 0 and nearest >= sqrt(reach2) + sqrt(reach2 + w_max - weight[i]):
                break
            for gy in range(cy - ring, cy + ring + 1):
                sy = gy // count[1]
                if sy != 0 and not periodic:
                    continue
                hop = 1 if (abs(gy - cy) == ring) else 2 * ring
                for gx in range(cx - ring, cx + ring + 1, hop):
                    sx = gx // count[0]
                    if sx != 0 and not periodic:
                        continue
                    square = (gy - sy * count[1]) * count[0] + gx - sx * count[0]
                    for e in range(first[square], first[square + 1]):
                        j = order[e]
                        if j == i and sx == 0 and sy == 0:
                            continue
                        dx = (x[j, 0] - xi) + sx * period[0]
                        dy = (x[j, 1] - yi) + sy * period[1]
                        du, dv = dx + b * dy, dy + a * dy
                        dd = du * du + dv * dv
                        c = 0.5 * (dd + weight[i] - weight[j])  # Eq. (2) times D
                        if c > 0.0 and c * c >= reach2 * dd:
                            continue
                        size = _cut(p, tag, m, q, qtag, du, dv, c, j, sx, sy)
                        if size < 0:
                            continue
                        m = size
                        p, q, tag, qtag = q, p, qtag, tag
                        reach2 = 0.0
                        for k in range(m):
                            reach2 = max(reach2, p[k, 0] ** 2 + p[k, 1] ** 2)
                        if m + 2 > len(q):  # a cut adds one vertex at most
                            p = np.concatenate((p, np.empty_like(p)))
                            q = np.empty_like(p)
                            tag = np.concatenate((tag, np.empty_like(tag)))
                            qtag = np.empty_like(tag)
            ring += 1
        if start[i] + m > len(entries):
            entries = np.concatenate((entries, np.empty((len(entries) + m, 3), np.int32)))
        start[i + 1] = start[i] + m
        for k in range(m):
            o = k + 1 if k + 1 < m else 0
            area[i] += 0.5 * (p[k, 0] * p[o, 1] - p[k, 1] * p[o, 0])
            solid[i] += _sector(p[k, 0], p[k, 1], p[o, 0], p[o, 1], radius[i])
            entries[start[i] + k] = tag[k]
    entries = entries[: start[n]]
    return area, solid, start, entries[:, 0].copy(), entries[:, 1:].copy()


__all__ = ["Cells", "Diagram", "cells", "diagram"]
