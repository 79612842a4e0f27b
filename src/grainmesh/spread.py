"""Each particle spread over the vertices of a mesh by its power cell.

With C_i the power cell of particle i among the particles alone (`grainmesh.cells`, Eq. 1; other
vertices of the mesh own no cell), cut by the walls and by a circle of radius `reach` about x_i, and
φ_v the linear hat of vertex v,

    S_iv = (1/A_i) ∫_{C_i} φ_v,    A_i = |C_i|,    sum_v S_iv = 1,                            (1)

is the share of particle i that stands at vertex v. Whatever it holds, its solid V_i say, is then
conserved, and where the cells fill the mesh so is its uniformity,

    sum_i A_i S_iv = h_v = ∫ φ_v,                                                             (2)

since the cells do not overlap. Both are integrals over the cell, which moves smoothly: at a flip of
the mesh only hats of the four vertices of the edge change, and those inside one quadrilateral.

C_i ∩ T, with T a triangle, is a convex polygon, over which a hat integrates exactly to

    ∫_{C_i ∩ T} φ_v = |C_i ∩ T| φ_v(centroid of C_i ∩ T).                                     (3)

Neighbours come from a power triangulation of the particles alone, kept by flips (`nodes.alone`).
With D = x_j - x_i, c = (|D|² + r_i² - r_j²)/2 and the same D', c' of the next neighbour, their
cells and C_i meet in

    x_i + (c D'_y - c' D_y, c' D_x - c D'_x) / (D × D').                                      (4)

If x_i is in C_i, a triangle x_i a b of the mesh holds the sector of C_i between the rays to a and
b, but for what lies beyond ab. A walk over the edges that C_i crosses finds all other triangles.
The circle is a regular polygon of `CORNERS` corners with the same area. Neighbours are taken from
the one of the smallest number on, so that S does not depend on the order of the triangles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import csr_array

from grainmesh.errors import InputError
from grainmesh.flips import _back
from grainmesh.living import Living

Float = NDArray[np.float64]
Int = NDArray[np.int32]

#: Corners of the polygon that stands for the circle; a multiple of 4 keeps mirror symmetry.
CORNERS = 24
#: Share of a cell that the walk may miss, by round-off, before it looks farther.
MISSED = 1e-9
#: The next corner of a triangle.
NEXT = (1, 2, 0)


@dataclass(frozen=True, eq=False)
class Spread:
    """How n particles are spread over m vertices: S_iv of Eq. (1), row by row.

    Parameters
    ----------
    area : (n,)
        Area A_i of the cell, cut by the walls and by the reach [m2].
    start : (n + 1,)
        First entry of each row.
    vertex, value : (l,)
        v and S_iv of the entries: not negative but for round-off, rows sum to 1.
    hats : (m,)
        h_v, Eq. (2) [m2]; 0 for points that are no vertex.
    """

    area: Float
    start: Int
    vertex: Int
    value: Float
    hats: Float

    @property
    def share(self) -> csr_array:
        """S (n, m)."""
        shape = len(self.area), len(self.hats)
        return csr_array((self.value, self.vertex, self.start), shape=shape)

    def sums(self, values: Float) -> Float:
        """sum_i S_iv f_i of values (n,) or (n, k), as (m,) or (m, k)."""
        columns = np.ascontiguousarray(values.reshape(len(values), -1))
        found: Float = _sums(self.start, self.vertex, self.value, columns, len(self.hats))
        return found.reshape(-1, *values.shape[1:])

    def means(self, values: Float) -> Float:
        """sum_v S_iv f_v of values (m,) or (m, k), as (n,) or (n, k)."""
        columns = np.ascontiguousarray(values.reshape(len(values), -1))
        found: Float = _means(self.start, self.vertex, self.value, columns)
        return found.reshape(-1, *values.shape[1:])


@dataclass(frozen=True, eq=False)
class Kernel:
    """The kernels ψ_i = sum_v S_iv φ_v / h_v of particles with solid, Eq. (2) of `coupling`.

    Attributes
    ----------
    hats : (m,)
        h_v; 1 for points that are no vertex.
    porosity : (m,)
        ε at the points, 1 for those that are no vertex.
    spread : Spread
        Areas of the cells of the discs, and S.
    """

    hats: Float
    porosity: Float
    spread: Spread

    @property
    def area(self) -> Float:
        """A_i [m2], (n,)."""
        return self.spread.area

    def field(self, values: Float) -> Float:
        """Values at the vertices of sum_i values_i ψ_i, (m,) or (m, 2)."""
        hats = self.hats if values.ndim == 1 else self.hats[:, None]
        return self.spread.sums(values) / hats

    def mean(self, moments: Float) -> Float:
        """<f>_i from ∫φ_v f, (m,) or (m, c)."""
        hats = self.hats if moments.ndim == 1 else self.hats[:, None]
        return self.spread.means(moments / hats)


def spread(
    bed: Living,
    reach: float,
    mesh: Living,
    before: Spread | None = None,
    changed: NDArray[np.bool_] | None = None,
) -> Spread:
    """Shares of the vertices in the power cells of the particles, Eqs. (1)-(4).

    Parameters
    ----------
    bed : Living
        Power triangulation of the particles where they are, `nodes.alone` for the same reach.
    reach : float
        Radius of the circle that cuts the cells [m]; ``np.inf`` for none.
    mesh : Living
        Any triangulation of the box by positive triangles, the first n points as those of `bed`.
        Others may be unused.
    before, changed : Spread, (m,) bool, optional
        What was found with all points at the same places, and the corners of the triangles, old
        and new, in which the meshes differ: only what touches these is computed again.

    Returns
    -------
    Spread

    Raises
    ------
    InputError
        A particle whose cell is empty or leaves the mesh.
    """
    size, n = bed.box.size, int(np.count_nonzero(bed.weight))
    # No cell has a point farther from its particle than the diagonal: all is finite.
    circle = _circle(min(reach, 2.0 * float(np.hypot(*size))))
    if before is None or changed is None:
        old = np.zeros(n + 1, np.int32), np.empty(0, np.int32), np.empty(0), np.empty(0)
        changed = np.empty(0, np.bool_)
    else:
        old = before.start, before.vertex, before.value, before.area
    own = bed.points, bed.triangles, bed.shifts, bed.weight
    arrays = mesh.points, mesh.triangles, mesh.neighbours, mesh.shifts
    missed, area, start, vertex, value = _shares(
        *own, n, bed.period, size, circle, *arrays, changed, *old
    )
    if missed >= 0:
        if area[missed] <= 0.0:
            raise InputError(
                f"the cell of particle {missed} is empty: it lies outside the box, beyond the "
                "reach or behind the discs around it, correct the centres or reduce the diameters"
            )
        raise InputError(
            f"the mesh does not cover the cell of particle {missed}: it must cover the box once, "
            "with positive triangles"
        )
    return Spread(area, start, vertex, value, _hats(*arrays, mesh.period))


def _circle(radius: float) -> Float:
    """Regular polygon with the area of a circle about 0, (CORNERS, 2)."""
    angle = np.pi / CORNERS
    turn = angle * (2.0 * np.arange(CORNERS) + 1.0)
    distance = radius * np.sqrt(2.0 * angle / np.sin(2.0 * angle))
    polygon: Float = distance * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return polygon


@njit(cache=True)
def _sums(start, vertex, value, columns, m):  # type: ignore[no-untyped-def]
    found = np.zeros((m, columns.shape[1]))
    for k in range(columns.shape[1]):
        for i in range(len(columns)):
            here = columns[i, k]
            for e in range(np.uint64(start[i]), np.uint64(start[i + 1])):  # see `_means`
                found[np.uint64(vertex[e]), k] += value[e] * here
    return found


@njit(cache=True)
def _means(start, vertex, value, columns):  # type: ignore[no-untyped-def]
    found = np.empty((len(start) - 1, columns.shape[1]))
    for k in range(columns.shape[1]):
        for i in range(len(found)):
            here = 0.0
            # Without a sign, Numba does not ask whether to count from the end: twice as fast.
            for e in range(np.uint64(start[i]), np.uint64(start[i + 1])):
                here += value[e] * columns[np.uint64(vertex[e]), k]
            found[i, k] = here
    return found


@njit(cache=True)
def _hats(points, triangles, neighbours, shifts, period):  # type: ignore[no-untyped-def]
    """h_v of all points."""
    found = np.zeros(len(points))
    for t in range(len(triangles)):
        ax, ay = _away(points, triangles, shifts, period, t, 0, 1)
        bx, by = _away(points, triangles, shifts, period, t, 0, 2)
        for k in range(3):
            found[triangles[t, k]] += (ax * by - ay * bx) / 6.0
    return found


@njit(cache=True, forceinline=True)
def _away(points, triangles, shifts, period, t, k, a):  # type: ignore[no-untyped-def]
    """Corner a of triangle t, seen from corner k."""
    i, j = triangles[t, k], triangles[t, a]
    x, y = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
    if period[0] > 0.0:
        x += (shifts[t, a, 0] - shifts[t, k, 0]) * period[0]
        y += (shifts[t, a, 1] - shifts[t, k, 1]) * period[1]
    return x, y


@njit(cache=True)
def _incident(triangles, m):  # type: ignore[no-untyped-def]
    """Triangles of each of m vertices: first entries, and entries 4 t + k for corner k of t."""
    first, entry = np.zeros(m + 2, np.int32), np.empty(3 * len(triangles), np.int32)
    for t in range(len(triangles)):
        for k in range(3):
            first[triangles[t, k] + 2] += 1
    for v in range(m):
        first[v + 2] += first[v + 1]
    for t in range(len(triangles)):
        for k in range(3):
            v = triangles[t, k] + 1
            entry[first[v]] = 4 * t + k
            first[v] += 1
    return first, entry


@njit(cache=True, forceinline=True)
def _ring(points, triangles, shifts, period, i, first, entry, ring, place):  # type: ignore[no-untyped-def]
    """Triangles around vertex i, counter-clockwise; their number, 0 if they do not close.

    Rows of `ring` are a triangle, its corner i, and the next two vertices; rows of `place` the
    first of these two, seen from i: in row 0 the one of the smallest number, and of its images the
    lowest, which comes again at the end of `place`.
    """
    begin, size, periodic = first[i], first[i + 1] - first[i], period[0] > 0.0
    if size == 0:
        return 0
    e = 0
    for d in range(size):
        t, k = entry[begin + d] >> 2, entry[begin + d] & 3
        ring[d, 0], ring[d, 1] = t, k
        ring[d, 2], ring[d, 3] = triangles[t, NEXT[k]], triangles[t, NEXT[NEXT[k]]]
        if ring[d, 2] < ring[e, 2] or (
            periodic
            and ring[d, 2] == ring[e, 2]
            and _image(shifts, ring, d, 1) < _image(shifts, ring, e, 1)
        ):
            e = d
    d = 0
    while True:
        for k in range(4):
            ring[d, k], ring[e, k] = ring[e, k], ring[d, k]
        v, last = ring[d, 2], ring[d, 3]
        place[d, 0], place[d, 1] = points[v, 0] - points[i, 0], points[v, 1] - points[i, 1]
        if periodic:
            x, y = _image(shifts, ring, d, 1)
            place[d, 0] += x * period[0]
            place[d, 1] += y * period[1]
        e = d + 1
        if e == size:
            break
        while e < size and (
            ring[e, 2] != last
            or (periodic and _image(shifts, ring, e, 1) != _image(shifts, ring, d, 2))
        ):
            e += 1
        if e == size:
            return 0
        d += 1
    place[size, 0], place[size, 1] = place[0, 0], place[0, 1]
    return size if last == ring[0, 2] else 0


@njit(cache=True)
def _image(shifts, ring, d, after):  # type: ignore[no-untyped-def]
    """Image of the first or second vertex after i in a row of a ring, seen from i."""
    t, k = ring[d, 0], ring[d, 1]
    j = (k + after) % 3
    return shifts[t, j, 0] - shifts[t, k, 0], shifts[t, j, 1] - shifts[t, k, 1]


@njit(cache=True, forceinline=True)
def _moments(poly, p, m):  # type: ignore[no-untyped-def]
    """Area and its first moments of polygon p, of m vertices."""
    area = mx = my = 0.0
    ox, oy = poly[p, 0, 0], poly[p, 0, 1]
    for k in range(2, m):  # in triangles from vertex 0, so that no digits are lost
        ax, ay = poly[p, k - 1, 0] - ox, poly[p, k - 1, 1] - oy
        bx, by = poly[p, k, 0] - ox, poly[p, k, 1] - oy
        part = 0.5 * (ax * by - ay * bx)
        area += part
        mx += part * (ax + bx) / 3.0
        my += part * (ay + by) / 3.0
    return area, mx + area * ox, my + area * oy


@njit(cache=True)
def _clip(poly, p, q, m, du, dv, c, edge):  # type: ignore[no-untyped-def]
    """Keep the part u du + v dv <= c of polygon p, written to q; its vertex count, -1 if whole.

    Rows are u, v, room for a number, and the name of the side to the next vertex; the new one is
    named `edge`.
    """
    outside = 0
    for k in range(m):
        poly[p, k, 2] = poly[p, k, 0] * du + poly[p, k, 1] * dv - c
        outside += poly[p, k, 2] > 0.0
    if outside == 0:
        return -1
    size, b = 0, m - 1
    for k in range(m):
        a, b = b, k  # the side from a to b
        s, t = poly[p, a, 2], poly[p, b, 2]
        if (s <= 0.0) != (t <= 0.0):
            f = s / (s - t)
            poly[q, size, 0] = poly[p, a, 0] + f * (poly[p, b, 0] - poly[p, a, 0])
            poly[q, size, 1] = poly[p, a, 1] + f * (poly[p, b, 1] - poly[p, a, 1])
            poly[q, size, 3] = edge if s <= 0.0 else poly[p, a, 3]
            size += 1
        if t <= 0.0:
            poly[q, size, 0], poly[q, size, 1] = poly[p, b, 0], poly[p, b, 1]
            poly[q, size, 3] = poly[p, b, 3]
            size += 1
    return size


@njit(cache=True, forceinline=True)
def _cell(points, weight, i, ring, place, degree, walls, size, circle, inner, poly):  # type: ignore[no-untyped-def]
    """C_i seen from x_i: whether that is inside, number of vertices, polygon 0 or 1."""
    inside, farthest = True, 0.0
    for d in range(degree + 1):
        x, y, j = place[d, 0], place[d, 1], ring[d, 2] if d < degree else ring[0, 2]
        c = 0.5 * (x * x + y * y + weight[i] - weight[j])
        place[d, 2] = c
        inside &= c > 0.0
        if d > 0:
            ax, ay, a = place[d - 1, 0], place[d - 1, 1], place[d - 1, 2]
            cross = ax * y - ay * x
            over = 1.0 / cross if cross > 0.0 else np.inf  # by round-off
            u, v = (a * y - c * ay) * over, (c * ax - a * x) * over  # Eq. (4)
            poly[0, d - 1, 0], poly[0, d - 1, 1] = u, v
            away = u * u + v * v
            farthest = max(farthest, away if away < np.inf else np.inf)
    m, p = degree, 0
    if farthest > inner:  # cut out of the circle, so that no digits are lost
        m = len(circle)
        for k in range(m):
            poly[0, k, 0], poly[0, k, 1] = circle[k, 0], circle[k, 1]
        for d in range(degree):
            left = _clip(poly, p, 1 - p, m, place[d, 0], place[d, 1], place[d, 2], -1)
            if left >= 0:
                m, p = left, 1 - p
    for side in range(4 * walls):
        axis, out = side // 2, 2.0 * (side % 2) - 1.0
        c = out * ((side % 2) * size[axis] - points[i, axis])
        inside &= c > 0.0
        if c <= 0.0 or c * c < farthest:
            left = _clip(poly, p, 1 - p, m, out * (1 - axis), out * axis, c, -1)
            if left >= 0:
                m, p = left, 1 - p
    return inside, m, p


@njit(cache=True)
def _overlap(poly, cell, m, corner):  # type: ignore[no-untyped-def]
    """C_i ∩ T: number of vertices, and polygon 2 or 3.

    A side on an edge of T has the name of the corner opposite, other sides -1.
    """
    p = 2
    for k in range(m):
        poly[p, k, 0], poly[p, k, 1], poly[p, k, 3] = poly[cell, k, 0], poly[cell, k, 1], -1.0
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        du, dv = corner[b, 1] - corner[a, 1], corner[a, 0] - corner[b, 0]
        size = _clip(poly, p, 5 - p, m, du, dv, du * corner[a, 0] + dv * corner[a, 1], k)
        if size >= 0:
            m, p = size, 5 - p
    return m, p


@njit(cache=True, forceinline=True)
def _crossed(poly, cell, m, ux, uy):  # type: ignore[no-untyped-def]
    """The side of a polygon about 0 that the ray along u crosses, -1 for none by round-off."""
    for s in range(m):
        o = s + 1 if s + 1 < m else 0
        if (
            poly[cell, s, 0] * uy >= poly[cell, s, 1] * ux
            and poly[cell, o, 0] * uy < poly[cell, o, 1] * ux
        ):
            return s
    return -1


@njit(cache=True, forceinline=True)
def _sector(poly, cell, m, s, ax, ay, bx, by):  # type: ignore[no-untyped-def]
    """The part of a polygon about 0 between the rays along a, which crosses side s, and b.

    Its vertices, as polygon 2, the side that b crosses, whether all lies before ab, area, moments.
    """
    twice, ex, ey = ax * by - ay * bx, bx - ax, by - ay
    px = py = poly[2, 0, 0] = poly[2, 0, 1] = 0.0
    size, within = 1, True
    area = mx = my = 0.0
    for k in range(m + 2):
        o = s + 1 if s + 1 < m else 0
        last = poly[cell, o, 0] * by < poly[cell, o, 1] * bx
        if k > 0 and not last:
            s = o
            x, y = poly[cell, s, 0], poly[cell, s, 1]
        else:
            ux, uy = (bx, by) if k > 0 else (ax, ay)
            ox, oy = poly[cell, s, 0], poly[cell, s, 1]
            sx, sy = poly[cell, o, 0] - ox, poly[cell, o, 1] - oy
            f = (ox * sy - oy * sx) / (ux * sy - uy * sx)
            x, y = f * ux, f * uy
        part = 0.5 * (px * y - py * x)
        area += part
        mx += part * (px + x)
        my += part * (py + y)
        within &= ex * y - ey * x + twice >= 0.0
        px = poly[2, size, 0] = x
        py = poly[2, size, 1] = y
        size += 1
        if k > 0 and last:
            break
    return size, s, within, area, mx / 3.0, my / 3.0


@njit(cache=True)
def _shares(  # type: ignore[no-untyped-def]
    centres, sides, images, weight, n, period, extent, circle,
    points, triangles, neighbours, shifts, changed, old_first, old_vertex, old_share, old_area,
):  # fmt: skip
    """A particle whose walk failed or -1, areas, and rows of S: first entries, vertices, values.

    Rows of which no triangle has `changed` are the old ones, if there are any.
    """
    at_centre, by_centre = _incident(sides, len(centres))
    at_point, by_point = _incident(triangles, len(points))
    most = 0
    for i in range(n):
        most = max(most, at_centre[i + 1] - at_centre[i], at_point[i + 1] - at_point[i])
    ring, place = np.empty((most, 4), np.int32), np.empty((most + 1, 3))
    room = len(circle) + most + 8  # a cut adds one vertex at most
    poly, corner = np.empty((4, room, 4)), np.empty((3, 2))
    inner = 0.25 * ((circle[0] + circle[-1]) ** 2).sum()  # of the circle inscribed, squared
    area, first = np.zeros(n), np.zeros(n + 1, np.int32)
    vertex, share = np.empty(10 * n + most + 64, np.int32), np.empty(10 * n + most + 64)
    slot = np.full(len(points), -1, np.int64)  # entry of each vertex in the row
    seen = np.full(len(triangles), -1, np.int32)  # the last particle that came by
    todo = np.empty((most + 64, 3), np.int32)  # triangles of the walk and their images
    size, missed = 0, -1
    for i in range(n):
        first[i] = size
        touched = 3 if len(old_area) == 0 else 0
        for e in range(old_first[i], old_first[i + 1]):
            touched += changed[old_vertex[e]]
        while size + max(most + 1, old_first[i + 1] - old_first[i]) > len(vertex):
            vertex, share = _grown(vertex, share)
        if touched < 3:  # a triangle in its walk has all three corners in the row
            for e in range(old_first[i], old_first[i + 1]):
                vertex[size], share[size] = old_vertex[e], old_share[e]
                size += 1
            area[i] = old_area[i]
            continue
        count = _ring(centres, sides, images, period, i, at_centre, by_centre, ring, place)
        if count == 0:
            missed = i
            break
        inside, m, cell = _cell(
            centres, weight, i, ring, place, count, period[0] == 0.0, extent, circle, inner, poly
        )
        area[i] = _moments(poly, cell, m)[0]
        count = _ring(points, triangles, shifts, period, i, at_point, by_point, ring, place)
        if area[i] <= 0.0 or count == 0:
            missed = i
            break
        # The walk begins with the triangles around x_i.
        done, widened, covered, within = 0, 0, 0.0, True
        s = _crossed(poly, cell, m, place[0, 0], place[0, 1]) if inside else -1
        if s >= 0:
            done, vertex[size], share[size] = count, i, 0.0
            for d in range(count):
                vertex[size + 1 + d], share[size + 1 + d] = ring[d, 2], 0.0
            for d in range(count):
                ax, ay, bx, by = place[d, 0], place[d, 1], place[d + 1, 0], place[d + 1, 1]
                corners, s, place[d, 2], part, mx, my = _sector(poly, cell, m, s, ax, ay, bx, by)
                if place[d, 2] == 0.0:
                    within = False
                    left = _clip(poly, 2, 3, corners, by - ay, ax - bx, ax * by - ay * bx, -1)
                    if left >= 0:
                        part, mx, my = _moments(poly, 3, left)
                covered += part
                at_a, at_b = _hats_at(ax, ay, bx, by, mx, my)
                share[size] += part - at_a - at_b
                share[size + 1 + d] += at_a
                share[size + 2 + d if d + 1 < count else size + 1] += at_b
            size += 1 + count
            for e in range(first[i], size if not within else 0):
                slot[vertex[e]] = e
        if s < 0 or not within:
            # Triangles and images, counted from the one that stands at x_i.
            for d in range(count):
                t, k = ring[d, 0], ring[d, 1]
                todo[d, 0], todo[d, 1], todo[d, 2] = t, -shifts[t, k, 0], -shifts[t, k, 1]
                seen[t] = i
            for d in range(done):
                if place[d, 2] == 0.0:
                    todo, count = _beyond(
                        todo[d, 0], todo[d, 1], todo[d, 2], 1 << ring[d, 1], i,
                        triangles, neighbours, shifts, seen, todo, count,
                    )  # fmt: skip
        while done < count:
            t, sx, sy = todo[done, 0], todo[done, 1], todo[done, 2]
            for k in range(3):
                v = triangles[t, k]
                corner[k, 0] = points[v, 0] - points[i, 0] + (shifts[t, k, 0] + sx) * period[0]
                corner[k, 1] = points[v, 1] - points[i, 1] + (shifts[t, k, 1] + sy) * period[1]
            corners, p = _overlap(poly, cell, m, corner)
            part, mx, my = _moments(poly, p, corners)
            if part > 0.0:  # Eq. (3)
                covered += part
                if size + 3 > len(vertex):
                    vertex, share = _grown(vertex, share)
                for k in range(3):
                    v = triangles[t, k]
                    if slot[v] < first[i]:
                        slot[v], vertex[size], share[size] = size, v, 0.0
                        size += 1
                at_a, at_b = _hats_at(
                    corner[1, 0] - corner[0, 0], corner[1, 1] - corner[0, 1],
                    corner[2, 0] - corner[0, 0], corner[2, 1] - corner[0, 1],
                    mx - part * corner[0, 0], my - part * corner[0, 1],
                )  # fmt: skip
                share[slot[triangles[t, 0]]] += part - at_a - at_b
                share[slot[triangles[t, 1]]] += at_a
                share[slot[triangles[t, 2]]] += at_b
            edges = 0  # of T that the cell crosses, as bits
            for k in range(corners):
                if poly[p, k, 3] >= 0.0:
                    edges |= 1 << int(poly[p, k, 3])
            todo, count = _beyond(
                t, sx, sy, edges, i, triangles, neighbours, shifts, seen, todo, count
            )
            done += 1
            # Round-off, or x_i is not in C_i: one more ring, whether or not the cell crosses.
            while done == count and widened < count and covered < (1.0 - MISSED) * area[i]:
                t, sx, sy = todo[widened, 0], todo[widened, 1], todo[widened, 2]
                todo, count = _beyond(
                    t, sx, sy, 7, i, triangles, neighbours, shifts, seen, todo, count
                )
                widened += 1
            if count > most + 64 + 9 * len(triangles):
                break
        if covered < (1.0 - MISSED) * area[i]:
            missed = i
            break
        share[first[i] : size] /= covered
    first[n] = size
    return missed, area, first, vertex[:size].copy(), share[:size].copy()


@njit(cache=True, forceinline=True)
def _hats_at(ax, ay, bx, by, mx, my):  # type: ignore[no-untyped-def]
    """Eq. (3) for the corners a and b of a triangle with the third at 0, from moments there."""
    twice = ax * by - ay * bx
    return (mx * by - my * bx) / twice, (ax * my - ay * mx) / twice


@njit(cache=True)
def _grown(vertex, share):  # type: ignore[no-untyped-def]
    """Entries with room for more."""
    return np.concatenate((vertex, vertex)), np.concatenate((share, share))


@njit(cache=True)
def _beyond(  # type: ignore[no-untyped-def]
    t, sx, sy, edges, i, triangles, neighbours, shifts, seen, todo, count
):
    """Add to the walk of particle i what lies across some edges of triangle t and is new."""
    for k in range(3):
        u = neighbours[t, k]
        if u < 0 or not edges & (1 << k):
            continue
        # The vertex k + 1 of t, as both triangles have it.
        k1, j2 = (k + 1) % 3, (_back(triangles, neighbours, shifts, t, k, u) + 2) % 3
        ux = sx + shifts[t, k1, 0] - shifts[u, j2, 0]
        uy = sy + shifts[t, k1, 1] - shifts[u, j2, 1]
        new = True
        if seen[u] == i:
            for e in range(count):
                if todo[e, 0] == u and todo[e, 1] == ux and todo[e, 2] == uy:
                    new = False
                    break
        if new:
            if count == len(todo):
                todo = np.concatenate((todo, np.empty_like(todo)))
            todo[count, 0], todo[count, 1], todo[count, 2] = u, ux, uy
            seen[u] = i
            count += 1
    return todo, count


__all__ = ["Kernel", "Spread", "spread"]
