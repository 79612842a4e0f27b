r"""Fields of any order on a triangulation that changes: carried by key, not by search.

The unknowns of a continuous field of order k belong to vertices, edges (k - 1 each) and triangles.
A vertex is known by its number, an edge by the numbers of its two ends, a triangle by those of its
three corners. What is there before and after a change of the triangulation keeps its unknowns; only
on edges and triangles that are new, and at vertices that came in, the field is interpolated from
the triangles that were there before.

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
from numpy.typing import NDArray
from scipy.spatial import cKDTree

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
    def _rising(self) -> Int:
        return np.argsort(self.triangles, axis=1, kind="stable")

    @cached_property
    def corners(self) -> Int:
        """Corners of each triangle, rising (t, 3)."""
        return np.sort(self.triangles.astype(np.int64), axis=1)

    @cached_property
    def _edges(self) -> tuple[Int, Int]:
        edges, which = np.unique(self.edge(self.corners[:, PAIRS]), return_inverse=True)
        return edges, which.reshape(-1, 3)

    @property
    def edges(self) -> Int:
        """A number for each edge, rising (e,)."""
        return self._edges[0]

    @property
    def edges_of_triangles(self) -> Int:
        """Which are the edges 01, 02 and 12 of each triangle (t, 3)."""
        return self._edges[1]

    @cached_property
    def numbers(self) -> Int:
        """The number of each triangle, in their order (t,)."""
        return self.edge(self.corners[:, :2]) * self.count + self.corners[:, 2]

    @cached_property
    def faces(self) -> Int:
        """A number for each triangle, rising (t,)."""
        return np.sort(self.numbers)

    @cached_property
    def used(self) -> NDArray[np.bool_]:
        """Which points are corners (m,)."""
        found = np.zeros(self.count, dtype=bool)
        found[self.triangles] = True
        return found

    def edge(self, ends: Int) -> Int:
        """The number of edges (..., 2), lower end first."""
        found: Int = ends[..., 0] * self.count + ends[..., 1]
        return found

    def places(self, points: Float, which: Int | slice = slice(None)) -> Float:
        """Coordinates of the corners, as in `corners`, of triangles [m], (len(which), 3, 2).

        Those of a periodic box have their middle inside.
        """
        x: Float = points[self.triangles[which]] + self.shifts[which] * self.box.size
        x = np.take_along_axis(x, self._rising[which][..., None], axis=1)
        if self.box.periodic:
            x = x - (np.floor(x.mean(axis=1) / self.box.size) * self.box.size)[:, None]
        return x


@dataclass(frozen=True, eq=False)
class Keys:
    """Where the unknowns of a scalar field live: of points, then edges, then triangles.

    Those of points that are no corner are 0.
    """

    topology: Topology
    element: Element

    @property
    def size(self) -> int:
        """Number of unknowns."""
        per_edge, per_face = self.element.counts
        on = self.topology
        edges = len(on.edges) * per_edge if per_edge else 0
        return on.count + edges + len(on.triangles) * per_face

    @cached_property
    def rows(self) -> Int:
        """Unknowns of each triangle, in the order of its element (t, l)."""
        per_edge, per_face = self.element.counts
        on = self.topology
        parts = [on.corners]
        if per_edge:
            parts.append(self.of_edges(on.edges_of_triangles))
        if per_face:
            parts.append(self.of_faces(np.searchsorted(on.faces, on.numbers)))
        return np.concatenate(parts, axis=1)

    def of_edges(self, edge: Int) -> Int:
        """Unknowns of edges (..., b), from the lower end on, those of each row in one row."""
        per_edge = self.element.counts[0]
        found = self.topology.count + edge[..., None] * per_edge + np.arange(per_edge)
        return found.reshape(*edge.shape[:-1], -1)

    def of_faces(self, face: Int) -> Int:
        """Unknowns of triangles, by their place in `Topology.faces` (c,), (c, per face)."""
        per_face = self.element.counts[1]
        return (
            self.size
            - (len(self.topology.triangles) - face[:, None]) * per_face
            + np.arange(per_face)
        )

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
                m + m * m * max(per_edge, 1) + on.faces[:, None] * per_face + np.arange(per_face)
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
            edge = np.searchsorted(on.edges, on.edge(ends))
            parts.append(self.of_edges(edge[:, None]).ravel())
        if per_face:
            parts.append(self.of_faces(np.searchsorted(on.faces, on.numbers)).ravel())
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
    fresh, gone : (c,), (d,)
        New triangles that were not there before, and old ones that are no more.
    """

    def __init__(self, old: Topology, new: Topology, points: Float) -> None:
        self.old, self.new, self.points = old, new, points
        self._there, self._face = _found(old.faces, new.faces)
        self.fresh = np.flatnonzero(~_found(old.faces, new.numbers)[0])
        self.gone = np.flatnonzero(~_found(new.faces, old.numbers)[0])

    @cached_property
    def _edge(self) -> tuple[NDArray[np.bool_], Int]:
        return _found(self.old.edges, self.new.edges)

    def loads(self, old: Keys, new: Keys, values: Float) -> Float:
        """Integrals against the shape functions, (new.size, c): those of vertices as they were."""
        m = self.new.count
        result = np.zeros((new.size, values.shape[1]))
        result[:m] = values[:m]
        for target, source in self._kept(old, new):
            result[target] = values[source]
        return result

    def fields(self, old: Keys, new: Keys, values: Float) -> Float:
        """Unknowns of c fields, from (old.size, c) to (new.size, c)."""
        m, result = self.new.count, self.loads(old, new, values)
        if len(self.fresh) == 0:
            return result
        known = np.zeros(new.size, dtype=bool)
        known[:m] = self.old.used
        result[:m][~self.new.used] = 0.0
        for target, _ in self._kept(old, new):
            known[target] = True
        # Values at the nodes of the new triangles, made unknowns of them.
        one = new.element
        place = np.einsum("lk,tkc->tlc", one.nodes, self.new.places(self.points, self.fresh))
        at = self._evaluate(old, values, place.reshape(-1, 2)).reshape(*place.shape[:2], -1)
        coefficient = np.einsum("kl,tlc->tkc", np.linalg.inv(one.to_values), at)
        target = new.rows[self.fresh]
        write = ~known[target]
        result[target[write]] = coefficient[write]
        return result

    def _kept(self, old: Keys, new: Keys) -> list[tuple[Int, Int]]:
        """Unknowns of edges and triangles that are there before and after: new and old ones."""
        per_edge, per_face = new.element.counts
        found = []
        if per_edge:
            edge, source = self._edge
            target = np.flatnonzero(edge)[:, None]
            found.append((new.of_edges(target), old.of_edges(source[edge][:, None])))
        if per_face:
            target = np.flatnonzero(self._there)
            found.append((new.of_faces(target), old.of_faces(self._face[self._there])))
        return found

    def _evaluate(self, keys: Keys, values: Float, place: Float) -> Float:
        """Fields at places (q, 2) [m] in the triangles that have gone, (q, c)."""
        t, weight = Finder(self.old, self.points, self.gone)(place)
        shape = keys.element.shape(weight)
        found: Float = np.einsum("ql,qlc->qc", shape, values[keys.rows[t]])
        return found


class Finder:
    """Which of some triangles hold places: one of those with the nearest middles, nearly always."""

    def __init__(self, on: Topology, points: Float, which: Int) -> None:
        self.box, self.which = on.box, which
        corners = on.places(points, which)
        self.middle = corners.mean(axis=1)
        self.size = on.box.size if on.box.periodic else None
        self.tree = cKDTree(self._inside(self.middle), boxsize=self.size)
        edge = corners[:, 1:] - corners[:, :1]
        self.inverse = np.linalg.inv(np.swapaxes(edge, 1, 2))
        self.reach = np.hypot(*np.moveaxis(corners - self.middle[:, None], 2, 0)).max(axis=1)

    def _inside(self, x: Float) -> Float:
        return x if self.size is None else np.mod(x, self.size)

    def __call__(self, places: Float) -> tuple[Int, Float]:
        """Triangles (q,) that hold places (q, 2) [m] best, and barycentric coordinates (q, 3)."""
        near = min(NEAREST, len(self.which))
        t = self.tree.query(self._inside(places), k=near)[1].reshape(-1, near)
        weight = self._weights(t, self.box.separation(self.middle[t], places[:, None]))
        best, row = np.argmax(weight.min(axis=-1), axis=1), np.arange(len(places))
        t, weight = t[row, best], weight[row, best]
        lost = np.flatnonzero(weight.min(axis=1) < -OUTSIDE)  # beside much smaller triangles
        if len(lost):
            self._search(self._inside(places[lost]), lost, t, weight)
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


def along_edge(one: Element, values: Float) -> Float:
    """Unknowns of edges, lower end first, from values at k + 1 even places (e, k + 1, c).

    Those of the two ends, then of the edge, (e, k + 1, c).
    """
    k = one.order
    s = np.linspace(0.0, 1.0, k + 1)
    shape = one.shape(np.stack([1.0 - s, s, np.zeros(k + 1)], axis=1))
    matrix = shape[:, np.r_[0, 1, 3 : 2 + k]]
    found: Float = np.einsum("kl,elc->ekc", np.linalg.inv(matrix), values)
    return found


def _found(among: Int, wanted: Int) -> tuple[NDArray[np.bool_], Int]:
    """Which of the wanted numbers are among sorted ones, and where."""
    place = np.searchsorted(among, wanted).clip(max=len(among) - 1)
    return among[place] == wanted, place


__all__ = ["Finder", "Keys", "Topology", "Transfer", "along_edge"]
