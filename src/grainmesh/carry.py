r"""Fields of any order on a triangulation that changes: carried by key, not by search.

The unknowns of a continuous field of order k belong to vertices, edges (k - 1 each) and triangles.
A vertex is known by its number, an edge by the numbers of its two ends, a triangle by those of its
three corners. What is there before and after a change of the triangulation keeps its unknowns; only
on edges and triangles that are new, and at vertices that came in, the field is interpolated from
the triangles that were there before. Edges are numbered as the triangles meet them, in their order,
so that the triangulation alone says which unknown is whose.

The basis (`grainmesh.element`) is that of NGSolve, which numbers the edges of a mesh by (lower,
higher) vertex and triangles as they were given, and whose shape functions are fixed by the order of
the corners alone: a field is one of NGSolve's as soon as its unknowns are put in that order.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from ngsolve import H1, TRIG, VERTEX, GridFunction, Periodic, VectorH1
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from grainmesh import integrals
from grainmesh.domain import Box
from grainmesh.element import PAIRS, Element
from grainmesh.mesh import Grid

Float = NDArray[np.float64]
Int = NDArray[np.int64]

#: Old triangles, nearest by their middle, among which the one that holds a node is looked for.
NEAREST = 16
#: How far outside of a triangle, in barycentric coordinates, is inside but for round-off.
OUTSIDE = 1e-9


@dataclass(frozen=True, eq=False)
class Topology:
    """Points joined by triangles, their edges and triangles numbered by their ends.

    Parameters
    ----------
    box : Box
    count : int
        Number of points, m.
    triangles, shifts : (t, 3), (t, 3, 2)
        As of `triangulation.Triangulation`.
    """

    box: Box
    count: int
    triangles: NDArray[np.integer[Any]]
    shifts: NDArray[np.integer[Any]]

    @cached_property
    def _rising(self) -> tuple[Int, Int, NDArray[np.bool_]]:
        return _risen(self.triangles, self.shifts, self.count)  # type: ignore[no-any-return]

    @property
    def corners(self) -> Int:
        """Corners of each triangle, rising (t, 3)."""
        return self._rising[0]

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which points are corners (m,)."""
        return self._rising[2]

    @cached_property
    def _edges(self) -> tuple[Int, Int]:
        return _met(self.corners, self.count)  # type: ignore[no-any-return]

    @property
    def edges(self) -> Int:
        """A number for each edge, in the order in which the triangles meet them (e,)."""
        return self._edges[0]

    @property
    def edges_of_triangles(self) -> Int:
        """Which are the edges 01, 02 and 12 of each triangle (t, 3)."""
        return self._edges[1]

    @cached_property
    def numbers(self) -> Int:
        """A number for each triangle (t,)."""
        return self.triangle(self.corners)

    def edge(self, ends: Int) -> Int:
        """The number of edges (..., 2), lower end first."""
        found: Int = ends[..., 0] * self.count + ends[..., 1]
        return found

    def triangle(self, corners: Int) -> Int:
        """The number of triangles (..., 3), corners rising."""
        return self.edge(corners) * self.count + corners[..., 2]

    def places(self, points: Float, which: Int | slice = slice(None)) -> Float:
        """Coordinates of the corners, as in `corners`, of triangles [m], (len(which), 3, 2).

        Those of a periodic box have their middle inside.
        """
        corners, hops, _ = self._rising
        on, box = (corners[which], hops[which]), self.box
        found: Float = _placed(points, *on, box.size, box.periodic)
        return found


@dataclass(frozen=True, eq=False)
class Keys:
    """Where the unknowns of a scalar field live: of points, then edges, then triangles.

    Those of points that are no corner are 0.
    """

    topology: Topology
    element: Element

    @property
    def first(self) -> int:
        """The first unknown inside of a triangle."""
        per_edge, on = self.element.counts[0], self.topology
        return on.count + (len(on.edges) * per_edge if per_edge else 0)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.first + len(self.topology.triangles) * self.element.counts[1]

    @cached_property
    def rows(self) -> Int:
        """Unknowns of each triangle, in the order of its element (t, l)."""
        per_edge, per_face = self.element.counts
        on = self.topology
        if not (per_edge or per_face):
            return on.corners
        edges = on.edges_of_triangles if per_edge else on.corners
        found: Int = _numbered(on.corners, edges, on.count, self.first, per_edge, per_face)
        return found

    def of_edges(self, edge: Int) -> Int:
        """Unknowns of edges (..., b), from the lower end on, those of each row in one row."""
        per_edge = self.element.counts[0]
        found = self.topology.count + edge[..., None] * per_edge + np.arange(per_edge)
        return found.reshape(*edge.shape[:-1], -1)

    @cached_property
    def names(self) -> Int:
        """A number of each unknown that no other has, on any triangulation of these points."""
        per_edge, per_face = self.element.counts
        on, m = self.topology, self.topology.count
        parts = [np.arange(m)]
        if per_edge:
            parts.append((m + on.edges[:, None] * per_edge + np.arange(per_edge)).ravel())
        if per_face:
            third = (
                m + m * m * max(per_edge, 1) + on.numbers[:, None] * per_face + np.arange(per_face)
            )
            parts.append(third.ravel())
        return np.concatenate(parts)

    def values(self, fields: Float, places: Float) -> Float:
        """Fields (size, c) at barycentric places (q, 3) of all triangles (t, q, c)."""
        found: Float = np.einsum("ql,tlc->tqc", self.element.shape(places), fields[self.rows])
        return found

    def of_mesh(self, grid: Grid) -> Int:
        """The unknown behind each unknown of NGSolve's space on a mesh of this triangulation."""
        per_edge, per_face = self.element.counts
        on, parts = self.topology, [grid.vertex]
        if per_edge:
            corner, v = np.sort(grid.corner, axis=1), len(grid.vertex)
            pair = np.unique(corner[:, PAIRS].reshape(-1, 2) @ np.array([v, 1]))
            ends = np.sort(grid.vertex[np.stack([pair // v, pair % v], axis=1)], axis=1)
            order = np.argsort(on.edges)
            edge = order[np.searchsorted(on.edges, on.edge(ends), sorter=order)]
            parts.append(self.of_edges(edge[:, None]).ravel())
        if per_face:
            parts.append(np.arange(self.first, self.size))
        return np.concatenate(parts)

    def field(self, grid: Grid, values: Float) -> Any:
        """A field (size,), or a velocity (size, 2), as an ngsolve.GridFunction."""
        space = (H1 if values.ndim == 1 else VectorH1)(grid.mesh, order=self.element.order)
        if self.element.bubble:
            space.SetOrder(TRIG, 3)
            space.Update()
        if grid.mesh.GetPeriodicNodePairs(VERTEX):
            space = Periodic(space)
        found = GridFunction(space)
        found.vec.FV().NumPy()[:] = values[self.of_mesh(grid)].T.ravel()
        return found


class Transfer:
    """From one triangulation to another one of the same points, which are at places (m, 2) [m].

    Attributes
    ----------
    face : (t,)
        Which of the old triangles each new one is, -1 for none.
    fresh, gone : (c,), (d,)
        New triangles that were not there before, and old ones that are no more.
    """

    def __init__(self, old: Topology, new: Topology, points: Float) -> None:
        self.old, self.new, self.points = old, new, points
        # Flips leave the others where they are.
        self.face, rest = _in_place(old.corners, new.corners)
        fresh = np.flatnonzero(self.face < 0)
        there, place = _found(old.triangle(old.corners[rest]), new.triangle(new.corners[fresh]))
        self.face[fresh[there]] = rest[place[there]]
        left = np.ones(len(rest), dtype=bool)
        left[place[there]] = False
        self.fresh, self.gone = fresh[~there], rest[left]

    @cached_property
    def edge(self) -> Int:
        """Which of the old edges each new one is, -1 for none (e,)."""
        old, new = self.old, self.new
        source = _edges_kept(
            self.face, old.edges_of_triangles, new.edges_of_triangles, len(new.edges)
        )
        some = new.edges_of_triangles[self.fresh].ravel()
        some = some[source[some] < 0]  # those that lie between triangles that have changed
        known = old.edges_of_triangles[self.gone].ravel()
        there, place = _found(old.edges[known], new.edges[some])
        source[some[there]] = known[place[there]]
        found: Int = source
        return found

    def loads(self, old: Keys, new: Keys, values: Float) -> Float:
        """Integrals against the shape functions, (new.size, c): those of vertices as they were."""
        m = self.new.count
        per_edge, per_face = new.element.counts
        result = np.empty((new.size, values.shape[1]))
        result[:m] = values[:m]
        if per_edge:
            _carried(values, m, self.edge, per_edge, result, m)
        if per_face:
            _carried(values, old.first, self.face, per_face, result, new.first)
        return result

    def fields(self, old: Keys, new: Keys, *fields: Float) -> list[Float]:
        """Unknowns of fields, from (old.size, c) to (new.size, c) each."""
        m, results = self.new.count, [self.loads(old, new, values) for values in fields]
        left = self.old.used & ~self.new.used
        for result in results:
            result[:m][left] = 0.0
        lacking = self._lacking(new)
        some = np.flatnonzero(lacking.any(axis=1))
        if len(some) == 0:
            return results
        which, lacking = self.fresh[some], lacking[some]
        t, weight = self._holding(which, new.element.nodes)
        shape = old.element.shape(weight.reshape(-1, 3)).reshape(*t.shape, -1)
        for values, result in zip(fields, results, strict=True):
            # Values at the nodes of the new triangles, made unknowns of them.
            at = np.einsum("tql,tqlc->tqc", shape, values[old.rows[t]])
            coefficient = np.einsum("kl,tlc->tkc", new.element.from_values, at)
            result[new.rows[which][lacking]] = coefficient[lacking]
        return results

    def _lacking(self, new: Keys) -> NDArray[np.bool_]:
        """Which unknowns of the fresh triangles were not there before (c, l)."""
        per_edge, per_face = new.element.counts
        on, fresh = self.new, self.fresh
        parts = [~self.old.used[on.corners[fresh]]]
        if per_edge:
            parts.append(np.repeat(self.edge[on.edges_of_triangles[fresh]] < 0, per_edge, axis=1))
        if per_face:
            parts.append(np.ones((len(fresh), per_face), dtype=bool))
        return np.concatenate(parts, axis=1)

    def _holding(self, which: Int, nodes: Float) -> tuple[Int, Float]:
        """Old triangles (b, q) that hold nodes (q, 3) of new ones (b,), and places (b, q, 3)."""
        places = self.new.places(self.points, which)
        gradient, _ = integrals.gradients(self.old.places(self.points, self.gone))
        t, weight = _holding(
            self.new.corners[which], places, nodes, self.old.corners[self.gone], gradient,
            self.new.count,
        )  # fmt: skip
        t = self.gone[t]
        lost = np.nonzero(weight.min(axis=2) < -OUTSIDE)
        if len(lost[0]):
            find = Finder(self.old, self.points, self.gone)
            t[lost], weight[lost] = find(np.einsum("lk,tkc->tlc", nodes, places)[lost])
        return t, weight


class Finder:
    """Which of some triangles hold places: one of those with the nearest middles, nearly always."""

    def __init__(self, on: Topology, points: Float, which: Int) -> None:
        self.box, self.which = on.box, which
        corners = on.places(points, which)
        self.middle = corners.mean(axis=1)
        self.size = on.box.size if on.box.periodic else None
        self.tree = cKDTree(self.box.wrapped(self.middle), boxsize=self.size)
        edge = corners[:, 1:] - corners[:, :1]
        self.inverse = np.linalg.inv(np.swapaxes(edge, 1, 2))
        self.reach = np.hypot(*np.moveaxis(corners - self.middle[:, None], 2, 0)).max(axis=1)

    def __call__(self, places: Float) -> tuple[Int, Float]:
        """Triangles (q,) that hold places (q, 2) [m] best, and barycentric coordinates (q, 3)."""
        near = min(NEAREST, len(self.which))
        t = self.tree.query(self.box.wrapped(places), k=near)[1].reshape(-1, near)
        weight = self._weights(t, self.box.separation(self.middle[t], places[:, None]))
        best, row = np.argmax(weight.min(axis=-1), axis=1), np.arange(len(places))
        t, weight = t[row, best], weight[row, best]
        lost = np.flatnonzero(weight.min(axis=1) < -OUTSIDE)  # beside much smaller triangles
        if len(lost):
            self._search(self.box.wrapped(places[lost]), lost, t, weight)
        return self.which[t], weight

    def _weights(self, t: Int, offset: Float) -> Float:
        """Barycentric coordinates (..., 3) of places at offsets (..., 2) from middles."""
        weight = np.einsum("...cd,...d->...c", self.inverse[t], offset) + 1.0 / 3.0
        return np.concatenate([1.0 - weight.sum(axis=-1, keepdims=True), weight], axis=-1)

    def _search(self, places: Float, rows: Int, t: Int, weight: Float) -> None:
        """Put into `rows` of t and weight what is better, of all triangles that reach so far."""
        images = np.zeros((1, 2))
        if self.size is not None:
            images = np.array(list(product((-1, 0, 1), repeat=2))) * self.size
        level = np.ceil(np.log2(self.reach)).astype(int)
        for size in np.unique(level):
            some = np.flatnonzero(level == size)
            tree = cKDTree(self.middle[some])
            for image in images:
                near = tree.query_ball_point(places + image, 2.0**size)
                q = np.repeat(np.arange(len(places)), [len(found) for found in near])
                found = some[np.concatenate([*near]).astype(int)]
                w = self._weights(found, places[q] + image - self.middle[found])
                order = np.argsort(w.min(axis=1))  # the best is written last
                order = order[w[order].min(axis=1) > weight[rows[q[order]]].min(axis=1)]
                t[rows[q[order]]], weight[rows[q[order]]] = found[order], w[order]


def regions(old: Topology, new: Topology, changed: NDArray[np.bool_]) -> tuple[Int, Int]:
    """Points (i,) in parts that change apart from each other, and the lowest of its part (i,).

    A part is all corners of triangles, old and new, one of whose corners has `changed` (m,), as
    far as these triangles hang together.
    """
    root = _rooted(old.corners, new.corners, changed)
    points = np.flatnonzero(root >= 0)
    return points, root[points]


def unknowns(own: Keys, other: Keys, outer: int) -> Int:
    """Unknowns of a velocity and a pressure on each triangle (t, n).

    u_x and u_y in turn of its first `outer` shape functions, then p, numbered after all those of
    the velocity, then the rest of u.
    """
    found: Int = _joined(own.rows, other.rows, outer, 2 * own.size)
    return found


def _found(among: Int, wanted: Int) -> tuple[NDArray[np.bool_], Int]:
    """Which of the wanted numbers are among others, and where."""
    if len(among) == 0:
        return np.zeros(len(wanted), dtype=bool), np.zeros(len(wanted), np.int64)
    order = np.argsort(among)
    place = order[np.minimum(np.searchsorted(among, wanted, sorter=order), len(among) - 1)]
    return among[place] == wanted, place


@njit(cache=True)
def _risen(triangles, shifts, count):  # type: ignore[no-untyped-def]
    """Corners of triangles, rising (t, 3), their shifts (t, 3, 2), and which points these are."""
    corners, hops = np.empty((len(triangles), 3), np.int64), np.empty_like(shifts)
    used = np.zeros(count, np.bool_)
    for t in range(len(triangles)):
        i, j, k = 0, 1, 2
        i, j = (j, i) if triangles[t, j] < triangles[t, i] else (i, j)
        j, k = (k, j) if triangles[t, k] < triangles[t, j] else (j, k)
        i, j = (j, i) if triangles[t, j] < triangles[t, i] else (i, j)
        for at, end in enumerate((i, j, k)):
            corners[t, at] = triangles[t, end]
            used[triangles[t, end]] = True
            for c in range(2):
                hops[t, at, c] = shifts[t, end, c]
    return corners, hops, used


@njit(cache=True)
def _placed(points, corners, hops, size, periodic):  # type: ignore[no-untyped-def]
    """`Topology.places`."""
    found = np.empty((len(corners), 3, 2))
    for t in range(len(corners)):
        for c in range(2):
            for k in range(3):
                found[t, k, c] = points[corners[t, k], c] + hops[t, k, c] * size[c]
            if periodic:
                middle = (found[t, 0, c] + found[t, 1, c] + found[t, 2, c]) / 3.0
                way = np.floor(middle / size[c]) * size[c]
                for k in range(3):
                    found[t, k, c] -= way
    return found


@njit(cache=True)
def _met(corners, count):  # type: ignore[no-untyped-def]
    """Numbers of edges (e,) as triangles meet them, and which each of them has (t, 3)."""
    most = 3 * len(corners)
    first, following = np.full(count, -1, np.int32), np.empty(most, np.int32)  # by their lower end
    upper, number = np.empty(most, np.int32), np.empty(most, np.int64)
    found, size = np.empty((len(corners), 3), np.int64), 0
    for t in range(len(corners)):
        for k in range(3):
            a, b = corners[t, k // 2], corners[t, 1 + (k + 1) // 2]
            e = first[a]
            while e >= 0 and upper[e] != b:
                e = following[e]
            if e < 0:
                e, size = size, size + 1
                upper[e], number[e] = b, a * count + b
                following[e], first[a] = first[a], e
            found[t, k] = e
    return number[:size].copy(), found


@njit(cache=True)
def _numbered(corners, edges, count, first, per_edge, per_face):  # type: ignore[no-untyped-def]
    """`Keys.rows`: of corners, of edges, and of the inside."""
    found = np.empty((len(corners), 3 + 3 * per_edge + per_face), np.int64)
    for t in range(len(corners)):
        for k in range(3):
            found[t, k] = corners[t, k]
            for i in range(per_edge):
                found[t, 3 + k * per_edge + i] = count + edges[t, k] * per_edge + i
        for i in range(per_face):
            found[t, 3 + 3 * per_edge + i] = first + t * per_face + i
    return found


@njit(cache=True)
def _joined(rows, rows_p, outer, split):  # type: ignore[no-untyped-def]
    """`unknowns`."""
    count, size = rows.shape[1], rows_p.shape[1]
    found = np.empty((len(rows), 2 * count + size), np.int64)
    for t in range(len(rows)):
        for i in range(count):
            at = 2 * i if i < outer else 2 * i + size
            found[t, at], found[t, at + 1] = 2 * rows[t, i], 2 * rows[t, i] + 1
        for i in range(size):
            found[t, 2 * outer + i] = split + rows_p[t, i]
    return found


@njit(cache=True)
def _carried(values, begin, source, per, result, start):  # type: ignore[no-untyped-def]
    """Put what the sources had, so many rows each from `begin` on, or 0, into the result."""
    for i in range(len(source)):
        for row in range(per):
            for c in range(values.shape[1]):
                value = values[begin + source[i] * per + row, c] if source[i] >= 0 else 0.0
                result[start + i * per + row, c] = value


@njit(cache=True)
def _in_place(old, new):  # type: ignore[no-untyped-def]
    """Rows of new corners: their own number if the old ones are equal, or -1; other old rows."""
    face, rest, size = np.full(len(new), -1, np.int64), np.empty(len(old), np.int64), 0
    for t in range(len(old)):
        same = t < len(new)
        for k in range(3):
            same = same and old[t, k] == new[t, k]
        if same:
            face[t] = t
        else:
            rest[size] = t
            size += 1
    return face, rest[:size].copy()


@njit(cache=True)
def _edges_kept(face, old, new, count):  # type: ignore[no-untyped-def]
    """Old edges of triangles that stay, by their new numbers, or -1 (count,)."""
    source = np.full(count, -1, np.int64)
    for t in range(len(new)):
        if face[t] >= 0:
            for k in range(3):
                source[new[t, k]] = old[face[t], k]
    return source


@njit(cache=True)
def _holding(corners, places, nodes, others, gradient, count):  # type: ignore[no-untyped-def]
    """Which of other triangles hold nodes best (c, q), barycentric coordinates there (c, q, 3).

    Only those with a corner in common are looked at: at it both stand in one image of the box.
    """
    first, following = np.full(count, -1, np.int32), np.empty(3 * len(others), np.int32)
    for t in range(len(others)):
        for k in range(3):
            following[3 * t + k], first[others[t, k]] = first[others[t, k]], 3 * t + k
    found = np.zeros((len(corners), len(nodes)), np.int64)
    weight = np.full((len(corners), len(nodes), 3), -np.inf)
    for t in range(len(corners)):
        for q in range(len(nodes)):
            best = -np.inf
            for k in range(3):
                x = y = 0.0
                for j in range(3):
                    x += nodes[q, j] * (places[t, j, 0] - places[t, k, 0])
                    y += nodes[q, j] * (places[t, j, 1] - places[t, k, 1])
                i = first[corners[t, k]]
                while i >= 0 and best < 0.0:
                    s, at = i // 3, i % 3
                    b = (at == 1) + x * gradient[s, 0, 0] + y * gradient[s, 0, 1]
                    c = (at == 2) + x * gradient[s, 1, 0] + y * gradient[s, 1, 1]
                    a = 1.0 - b - c
                    least = min(a, b, c)
                    if least > best:
                        best, found[t, q] = least, s
                        weight[t, q, 0], weight[t, q, 1], weight[t, q, 2] = a, b, c
                    i = following[i]
    return found, weight


@njit(cache=True)
def _rooted(old, new, changed):  # type: ignore[no-untyped-def]
    """The lowest point of the part of each, -1 outside of all (m,), see `regions`."""
    root = np.full(len(changed), -1, np.int64)
    for corners in (old, new):
        for t in range(len(corners)):
            a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
            if changed[a] or changed[b] or changed[c]:
                low = _root(root, a)
                for v in (b, c):
                    other = _root(root, v)
                    low, other = min(low, other), max(low, other)
                    root[other] = low
    for v in range(len(root)):
        if root[v] >= 0:
            root[v] = root[root[v]]
    return root


@njit(cache=True)
def _root(root, v):  # type: ignore[no-untyped-def]
    """The root of v, which becomes one if it has none."""
    if root[v] < 0:
        root[v] = v
    while root[v] != v:
        root[v] = root[root[v]]
        v = root[v]
    return v


__all__ = ["Finder", "Keys", "Topology", "Transfer", "regions", "unknowns"]
