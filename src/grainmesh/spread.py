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

The triangles that C_i overlaps hang together by the edges it crosses: a walk from x_i over these
edges finds them all. The circle is a regular polygon of `CORNERS` corners with the same area.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import csr_array

from grainmesh.cells import Diagram, diagram, wrapped
from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.flips import _back

Float = NDArray[np.float64]
Int = NDArray[np.int32]

#: Corners of the polygon that stands for the circle; a multiple of 4 keeps mirror symmetry.
CORNERS = 24
#: Share of a cell that the walk may miss, by round-off, before it looks farther.
MISSED = 1e-9


@dataclass(frozen=True, eq=False)
class Spread:
    """How particles are spread over vertices.

    Parameters
    ----------
    area : (n,)
        Area A_i of the cell, cut by the walls and by the reach [m2].
    share : csr_array (n, m)
        S_iv, Eq. (1): not negative but for round-off, rows sum to 1.
    cells : Diagram
        Neighbours of the cells.
    """

    area: Float
    share: csr_array
    cells: Diagram


def spread(
    box: Box,
    x: Float,
    radius: Float,
    reach: float,
    points: Float,
    triangles: Int,
    neighbours: Int,
    shifts: Int,
    before: Spread | None = None,
    changed: NDArray[np.bool_] | None = None,
) -> Spread:
    """Shares of the vertices in the power cells of the particles, Eqs. (1)-(3).

    Parameters
    ----------
    box : Box
        Cells end at its walls, if it has any.
    x, radius : (n, 2), (n,)
        Discs [m]; in a periodic box anywhere.
    reach : float
        Radius of the circle that cuts the cells [m]; ``np.inf`` for none.
    points, triangles, neighbours, shifts
        Mesh as in `living.Living`; the first n points are `x`. Vertices may be unused.

    before, changed : Spread, (m,) bool, optional
        What was found with all points at the same places, and the corners of the triangles, old
        and new, in which the meshes differ: only what touches these is computed again.

    Returns
    -------
    Spread

    Raises
    ------
    InputError
        A reach that is not positive; a particle whose cell is empty or leaves the mesh.
    """
    if not reach > 0.0:
        raise InputError(f"the reach of the particles is {reach:g} m, it must be positive")
    window = np.array([[0.0, 0.0], box.size])
    inside = wrapped(box, x)
    # No cell has a point farther from its particle than this: all is finite without a reach.
    far = box.size if box.periodic else np.maximum(np.abs(x), np.abs(x - box.size)).max(axis=0)
    reach = min(reach, 2.0 * float(np.hypot(*far)))
    if before is None or changed is None:
        found = diagram(box, inside, radius**2, radius, window, far=2.0 * reach)
        kept = csr_array((len(x), len(points)))
        again, area = np.ones(len(x), dtype=bool), np.zeros(len(x))
    else:
        found, kept, area = before.cells, before.share, before.area.copy()
        touched = np.zeros(kept.nnz + 1, np.int64)
        np.cumsum(changed[kept.indices], out=touched[1:])
        again = touched[kept.indptr[1:]] > touched[kept.indptr[:-1]]
    square, circle = _regular(4, 2.0 * reach), _regular(CORNERS, reach)
    period = box.size if box.periodic else np.zeros(2)
    # Copies: a read-only array would be compiled for once more.
    bonds = found.start, found.neighbour, found.shift
    cell = inside.copy(), radius**2, *bonds, period, square, circle
    mesh = points.copy(), triangles.copy(), neighbours.copy(), shifts.copy()
    old = again, area, kept.indptr, kept.indices, kept.data
    missed, start, vertex, share = _shares(*cell, window, not box.periodic, *mesh, *old)
    if missed.any():
        i = int(np.flatnonzero(missed)[0])
        if area[i] <= 0.0:
            raise InputError(
                f"the cell of particle {i} is empty: it lies outside the box, beyond the reach or "
                "behind the discs around it, correct the centres or reduce the diameters"
            )
        raise InputError(
            f"the mesh does not cover the cell of particle {i}: it must cover the box once, with "
            "positive triangles"
        )
    area.setflags(write=False)
    return Spread(area, csr_array((share, vertex, start), shape=(len(x), len(points))), found)


def _regular(corners: int, radius: float) -> Float:
    """Regular polygon with the area of a circle about 0, sides across the axes, (corners, 2)."""
    angle = np.pi / corners
    turn = angle * (2.0 * np.arange(corners) + 1.0)
    distance = radius * np.sqrt(2.0 * angle / np.sin(2.0 * angle))
    polygon: Float = distance * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return polygon


@njit(cache=True)
def _moments(p, m):  # type: ignore[no-untyped-def]
    """Area and centroid of a polygon of m vertices."""
    area = cx = cy = 0.0
    for k in range(2, m):  # in triangles from vertex 0, so that no digits are lost
        ax, ay = p[k - 1, 0] - p[0, 0], p[k - 1, 1] - p[0, 1]
        bx, by = p[k, 0] - p[0, 0], p[k, 1] - p[0, 1]
        part = 0.5 * (ax * by - ay * bx)
        area += part
        cx += part * (ax + bx) / 3.0
        cy += part * (ay + by) / 3.0
    if area <= 0.0:
        return 0.0, 0.0, 0.0
    return area, p[0, 0] + cx / area, p[0, 1] + cy / area


@njit(cache=True)
def _clip(p, m, q, du, dv, c, edge):  # type: ignore[no-untyped-def]
    """Keep the part u du + v dv <= c of polygon `p`, written to `q`; its vertex count, -1 if whole.

    Rows are u, v, room for a number, and the name of the side to the next vertex; the new one is
    named `edge`.
    """
    outside = 0
    for k in range(m):
        p[k, 2] = p[k, 0] * du + p[k, 1] * dv - c
        outside += p[k, 2] > 0.0
    if outside == 0:
        return -1
    size, b = 0, m - 1
    for k in range(m):
        a, b = b, k  # the side from a to b
        s, t = p[a, 2], p[b, 2]
        if (s <= 0.0) != (t <= 0.0):
            f = s / (s - t)
            q[size, 0] = p[a, 0] + f * (p[b, 0] - p[a, 0])
            q[size, 1] = p[a, 1] + f * (p[b, 1] - p[a, 1])
            q[size, 3] = edge if s <= 0.0 else p[a, 3]
            size += 1
        if t <= 0.0:
            q[size, 0], q[size, 1], q[size, 3] = p[b, 0], p[b, 1], p[b, 3]
            size += 1
    return size


@njit(cache=True)
def _cell(  # type: ignore[no-untyped-def]
    i, x, weight, start, other, image, period, outline, window, walls, p, q
):
    """C_i within an outline, relative to x_i: number of vertices, polygon, and what is spare."""
    m, at_wall = len(outline), False
    if start[i] == start[i + 1]:  # not even sides of the window
        m = 0
    for k in range(m):
        p[k, 0], p[k, 1] = outline[k, 0], outline[k, 1]
    for e in range(start[i], start[i + 1]):
        j = other[e]
        if j < 0:
            at_wall = walls
            continue
        dx = x[j, 0] - x[i, 0] + image[e, 0] * period[0]
        dy = x[j, 1] - x[i, 1] + image[e, 1] * period[1]
        c = 0.5 * (dx * dx + dy * dy + weight[i] - weight[j])  # Eq. (2) of cells, times D
        size = _clip(p, m, q, dx, dy, c, -1)
        if size >= 0:
            m, p, q = size, q, p
    if at_wall:
        for axis in range(2):
            for side in range(2):
                out = 2.0 * side - 1.0
                c = out * (window[side, axis] - x[i, axis])
                size = _clip(p, m, q, out * (1 - axis), out * axis, c, -1)
                if size >= 0:
                    m, p, q = size, q, p
    return m, p, q


@njit(cache=True)
def _overlap(cell, m, corner, p, q):  # type: ignore[no-untyped-def]
    """C_i ∩ T: number of vertices, the polygon, and what is spare.

    A side on an edge of T has the name of the corner opposite, other sides -1.
    """
    for k in range(m):
        p[k, 0], p[k, 1], p[k, 3] = cell[k, 0], cell[k, 1], -1.0
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        du, dv = corner[b, 1] - corner[a, 1], corner[a, 0] - corner[b, 0]
        size = _clip(p, m, q, du, dv, du * corner[a, 0] + dv * corner[a, 1], k)
        if size >= 0:
            m, p, q = size, q, p
    return m, p, q


@njit(cache=True)
def _shares(  # type: ignore[no-untyped-def]
    x, weight, start, other, image, period, square, circle, window, walls,
    points, triangles, neighbours, shifts, again, area, old_first, old_vertex, old_share,
):  # fmt: skip
    """Whose walk failed, and the rows of S: first entries, vertices, values; areas in place.

    Rows that are not to be found `again` are the old ones.
    """
    n, t_max = len(x), len(triangles)
    star = np.full(len(points), -1, np.int32)  # a triangle of each vertex
    for t in range(t_max):
        for k in range(3):
            star[triangles[t, k]] = t
    room = len(circle) + 8 + (start[1:] - start[:-1]).max()  # a cut adds one vertex at most
    cell, spare = np.empty((room, 4)), np.empty((room, 4))
    p, q = np.empty((room, 4)), np.empty((room, 4))
    corner, phi = np.empty((3, 2)), np.empty(3)
    missed = np.zeros(n, np.bool_)
    first = np.zeros(n + 1, np.int32)
    vertex, share = np.empty(16 * n + 64, np.int32), np.empty(16 * n + 64)
    slot = np.full(len(points), -1, np.int64)  # entry of each vertex in the row
    seen = np.full(t_max, -1, np.int32)  # the last particle that came by
    todo = np.empty((64, 3), np.int32)  # triangles of the walk and their images
    inner = 0.25 * ((circle[0] + circle[-1]) ** 2).sum()  # of the circle inscribed, squared
    size = 0
    for i in range(n):
        first[i] = size
        if not again[i]:
            while size + old_first[i + 1] - old_first[i] > len(vertex):
                vertex = np.concatenate((vertex, np.empty_like(vertex)))
                share = np.concatenate((share, np.empty_like(share)))
            for e in range(old_first[i], old_first[i + 1]):
                vertex[size], share[size] = old_vertex[e], old_share[e]
                size += 1
            continue
        for outline in (square, circle):  # few cells of a dense bed come near the circle
            m, cell, spare = _cell(
                i, x, weight, start, other, image, period, outline, window, walls, cell, spare
            )
            farthest = 0.0
            for k in range(m):
                farthest = max(farthest, cell[k, 0] ** 2 + cell[k, 1] ** 2)
            if farthest <= inner:
                break
        area[i] = _moments(cell, m)[0]
        t = star[i]
        if area[i] <= 0.0 or t < 0:
            missed[i] = True
            continue
        for k in range(3):
            if triangles[t, k] == i:  # images are counted from the one that stands at x_i
                todo[0, 0], todo[0, 1], todo[0, 2] = t, -shifts[t, k, 0], -shifts[t, k, 1]
        seen[t] = i
        done, widened, count, covered = 0, 0, 1, 0.0
        while done < count:
            t, sx, sy = todo[done, 0], todo[done, 1], todo[done, 2]
            for k in range(3):
                v = triangles[t, k]
                corner[k, 0] = points[v, 0] - points[i, 0] + (shifts[t, k, 0] + sx) * period[0]
                corner[k, 1] = points[v, 1] - points[i, 1] + (shifts[t, k, 1] + sy) * period[1]
            sides, p, q = _overlap(cell, m, corner, p, q)
            part, cx, cy = _moments(p, sides)
            if part > 0.0:  # Eq. (3)
                covered += part
                ax, ay = corner[1, 0] - corner[0, 0], corner[1, 1] - corner[0, 1]
                bx, by = corner[2, 0] - corner[0, 0], corner[2, 1] - corner[0, 1]
                cx, cy, twice = cx - corner[0, 0], cy - corner[0, 1], ax * by - ay * bx
                phi[1], phi[2] = (cx * by - cy * bx) / twice, (ax * cy - ay * cx) / twice
                phi[0] = 1.0 - phi[1] - phi[2]
                if size + 3 > len(vertex):
                    vertex = np.concatenate((vertex, np.empty_like(vertex)))
                    share = np.concatenate((share, np.empty_like(share)))
                for k in range(3):
                    v = triangles[t, k]
                    if slot[v] < first[i]:
                        slot[v], vertex[size], share[size] = size, v, 0.0
                        size += 1
                    share[slot[v]] += part * phi[k]
            crossed = 0  # edges of T that the cell crosses, as bits
            for k in range(sides):
                if p[k, 3] >= 0.0:
                    crossed |= 1 << int(p[k, 3])
            todo, count = _beyond(
                t, sx, sy, crossed, i, triangles, neighbours, shifts, seen, todo, count
            )
            done += 1
            # Round-off, or x_i is not in C_i: one more ring, whether or not the cell crosses.
            while done == count and widened < count and covered < (1.0 - MISSED) * area[i]:
                t, sx, sy = todo[widened, 0], todo[widened, 1], todo[widened, 2]
                todo, count = _beyond(
                    t, sx, sy, 7, i, triangles, neighbours, shifts, seen, todo, count
                )
                widened += 1
            if count > 64 + 9 * t_max:
                break
        missed[i] = covered < (1.0 - MISSED) * area[i]
        share[first[i] : size] /= covered
    first[n] = size
    return missed, first, vertex[:size].copy(), share[:size].copy()


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


__all__ = ["Spread", "spread"]
