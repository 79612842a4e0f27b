r"""Fields of any order on a triangulation that changes: carried by key, not by search.

The unknowns of a continuous field of order k belong to vertices, edges (k - 1 each) and triangles.
A vertex is known by its number, an edge by the numbers of its two ends, a triangle by those of its
three corners. What is there before and after a change of the triangulation keeps its unknowns; only
on edges and triangles that are new, and at vertices that came in, the field is interpolated from
the triangles that were there before.

NGSolve numbers the edges of a mesh by (lower, higher) vertex and triangles as they were given, and
its shape functions are fixed by the order of the corners alone. So one matrix takes the local
unknowns of any triangle, corners sorted, to its values at nodes, and back.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import H1, TRIG, GridFunction, Mesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from grainmesh.domain import Box
from grainmesh.mesh import Grid

Float = NDArray[np.float64]
Int = NDArray[np.int64]

#: Old triangles, nearest by their middle, among which the one that holds a node is looked for.
NEAREST = 16
PAIRS = np.array([[0, 1], [0, 2], [1, 2]])


@dataclass(frozen=True, eq=False)
class Keys:
    """Where the unknowns of a scalar field live: of points, then edges, then triangles.

    Parameters
    ----------
    box : Box
    points : (m, 2)
        Vertices [m], where they were when the field was there.
    triangles, shifts : (t, 3), (t, 3, 2)
        As of `triangulation.Triangulation`.
    grid : Grid
        The finite-element mesh; more than one of its vertices may show the same point.
    order : int
        k >= 1.
    bubble : bool
        For k = 1: a cubic bubble on each triangle (MINI).
    """

    box: Box
    points: Float
    triangles: NDArray[np.integer[Any]]
    shifts: NDArray[np.integer[Any]]
    grid: Grid
    order: int
    bubble: bool = False

    @property
    def counts(self) -> tuple[int, int]:
        """Unknowns of an edge, and of a triangle."""
        k = self.order
        return k - 1, int(self.bubble) if k == 1 else (k - 1) * (k - 2) // 2

    @cached_property
    def corners(self) -> Int:
        """Corners of each triangle, rising (t, 3)."""
        return np.sort(self.triangles.astype(np.int64), axis=1)

    @cached_property
    def edges(self) -> Int:
        """A number for each edge, rising (e,)."""
        return np.unique(self._edge(self.corners[:, PAIRS]))

    @cached_property
    def faces(self) -> Int:
        """A number for each triangle, rising (t,)."""
        return np.sort(self.faces_of_triangles)

    @cached_property
    def faces_of_triangles(self) -> Int:
        """The number of each triangle, in their order (t,)."""
        return self._face(self.corners)

    def _edge(self, ends: Int) -> Int:
        return ends[..., 0] * len(self.points) + ends[..., 1]

    def _face(self, corners: Int) -> Int:
        return self._edge(corners[..., :2]) * len(self.points) + corners[..., 2]

    @property
    def size(self) -> int:
        """Number of unknowns; those of points that are no corner are 0."""
        per_edge, per_face = self.counts
        return len(self.points) + len(self.edges) * per_edge + len(self.faces) * per_face

    def unknowns(self, vertex: Int, edge: Int, face: Int) -> Int:
        """Unknowns of vertices (..., a), edges (..., b) and triangles (..., c), in a row each."""
        per_edge, per_face = self.counts
        second = len(self.points)
        third = second + len(self.edges) * per_edge
        rows = edge.shape[:-1]
        of_edge = second + edge[..., None] * per_edge + np.arange(per_edge)
        of_face = third + face[..., None] * per_face + np.arange(per_face)
        parts = vertex, of_edge.reshape(*rows, -1), of_face.reshape(*rows, -1)
        return np.concatenate(parts, axis=-1)

    def local(self, which: Int) -> Int:
        """Unknowns of triangles, in NGSolve's order (len(which), l)."""
        corners = self.corners[which]
        edge = np.searchsorted(self.edges, self._edge(corners[:, PAIRS]))
        face = np.searchsorted(self.faces, self._face(corners))
        return self.unknowns(corners, edge, face[:, None])

    @cached_property
    def names(self) -> Int:
        """A number of each unknown that no other has, on any triangulation of these points."""
        per_edge, per_face = self.counts
        m = len(self.points)
        second = m + self.edges[:, None] * per_edge + np.arange(per_edge)
        third = m + m * m * per_edge + self.faces[:, None] * per_face + np.arange(per_face)
        return np.concatenate([np.arange(m), second.ravel(), third.ravel()])

    @cached_property
    def of_mesh(self) -> Int:
        """The unknown behind each unknown of the space on the finite-element mesh."""
        vertex = self.grid.vertex
        if self.box.periodic:
            corner, v = np.sort(self.grid.corner, axis=1), len(vertex)
            pair = np.unique(corner[:, PAIRS].reshape(-1, 2) @ np.array([v, 1]))
            ends = np.sort(vertex[np.stack([pair // v, pair % v], axis=1)], axis=1)
            edge = np.searchsorted(self.edges, self._edge(ends))
        else:  # vertices are points in their order, and so are edges
            edge = np.arange(len(self.edges))
        return self.unknowns(vertex, edge, np.searchsorted(self.faces, self.faces_of_triangles))

    def places(self, which: Int) -> Float:
        """Coordinates of the corners, as sorted, of triangles [m], (len(which), 3, 2).

        Those of a periodic box have their middle inside.
        """
        order = np.argsort(self.triangles[which], axis=1, kind="stable")
        x: Float = self.points[self.triangles[which]] + self.shifts[which] * self.box.size
        x = np.take_along_axis(x, order[..., None], axis=1)
        if self.box.periodic:
            x = x - (np.floor(x.mean(axis=1) / self.box.size) * self.box.size)[:, None]
        return x


def carry(old: Keys, new: Keys, values: Float) -> Float:
    """Fields on a new triangulation of the same points, (new.size, c).

    Parameters
    ----------
    old, new : Keys
        With points of the same numbers at the same places.
    values : (old.size, c)
        Unknowns of c fields.
    """
    m, result = len(new.points), carry_load(old, new, values)
    fresh = np.flatnonzero(~_found(old.faces, new.faces_of_triangles)[0])
    gone = np.flatnonzero(~_found(new.faces, old.faces_of_triangles)[0])
    if len(fresh) == 0:
        return result
    known, now = np.zeros(new.size, dtype=bool), np.zeros(m, dtype=bool)
    known[old.triangles], now[new.triangles] = True, True
    result[:m][~now] = 0.0
    for target, _ in _kept(old, new):
        known[target] = True
    # Values at the nodes of the new triangles, made unknowns of them.
    nodes, to_values, _ = _element(new.order, new.bubble)
    place = np.einsum("lk,tkc->tlc", nodes, new.places(fresh))
    at = _evaluate(old, gone, values, place.reshape(-1, 2)).reshape(*place.shape[:2], -1)
    coefficient = np.einsum("kl,tlc->tkc", np.linalg.inv(to_values), at)
    target = new.local(fresh)
    write = ~known[target]
    result[target[write]] = coefficient[write]
    return result


def carry_load(old: Keys, new: Keys, values: Float) -> Float:
    """Integrals against the shape functions, (new.size, c): those of vertices sum up as before."""
    result = np.zeros((new.size, values.shape[1]))
    result[: len(new.points)] = values[: len(new.points)]
    for target, source in _kept(old, new):
        result[target] = values[source]
    return result


def _kept(old: Keys, new: Keys) -> list[tuple[Int, Int]]:
    """Unknowns of edges, and of triangles, that are there before and after: new and old ones."""
    none = np.empty(0, np.int64)
    edge, from_edge = _found(old.edges, new.edges)
    face, from_face = _found(old.faces, new.faces)
    return [
        (
            new.unknowns(none, np.flatnonzero(edge), none),
            old.unknowns(none, from_edge[edge], none),
        ),
        (
            new.unknowns(none, none, np.flatnonzero(face)),
            old.unknowns(none, none, from_face[face]),
        ),
    ]


def along_edge(order: int, values: Float) -> Float:
    """Unknowns of edges, lower end first, from values at k + 1 even places (e, k + 1, c).

    Those of the two ends, then of the edge, (e, k + 1, c).
    """
    nodes, to_values, _ = _element(order, False)
    on = np.flatnonzero(nodes[:, 2] == 0.0)
    on = on[np.argsort(nodes[on, 1])]
    matrix = to_values[np.ix_(on, np.r_[0, 1, 3 : 2 + order])]
    found: Float = np.einsum("kl,elc->ekc", np.linalg.inv(matrix), values)
    return found


def lattice(parts: int) -> tuple[Float, Int]:
    """Even nodes (l, 3) of a triangle whose edges are cut, and small triangles of them (c, 3).

    Nodes as of a field of order `parts`: barycentric, corners first, then edges.
    """
    nodes, steps = [], range(1, parts)
    nodes += (parts * np.eye(3, dtype=int)).tolist()
    for a, b in PAIRS.tolist():
        for step in steps:
            node = [0, 0, 0]
            node[a], node[b] = parts - step, step
            nodes.append(node)
    nodes += [[parts - i - j, i, j] for i in steps for j in range(1, parts - i)]
    number = {(i, j): row for row, (_, i, j) in enumerate(nodes)}
    small = []
    for i in range(parts):
        for j in range(parts - i):
            small.append([number[i, j], number[i + 1, j], number[i, j + 1]])
            if i + j < parts - 1:
                small.append([number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]])
    return np.array(nodes) / parts, np.array(small)


def values_at(keys: Keys, values: Float, weights: Float) -> Float:
    """Fields (size, c) at barycentric places (l, 3), corners rising, in all triangles (t, l, c)."""
    _, to_values, of_values = _element(keys.order, keys.bubble)
    shape = _monomials(weights, keys.order, keys.bubble) @ of_values @ to_values
    local = values[keys.local(np.arange(len(keys.triangles)))]
    found: Float = np.einsum("ql,tlc->tqc", shape, local)
    return found


def _found(among: Int, wanted: Int) -> tuple[NDArray[np.bool_], Int]:
    """Which of the wanted numbers are among sorted ones, and where."""
    place = np.searchsorted(among, wanted).clip(max=len(among) - 1)
    return among[place] == wanted, place


def _evaluate(keys: Keys, which: Int, values: Float, place: Float) -> Float:
    """Fields at places (q, 2) [m] in the triangles `which`, (q, c)."""
    corners = keys.places(which)
    size = keys.box.size if keys.box.periodic else None
    middle = corners.mean(axis=1)
    tree = cKDTree(middle if size is None else np.mod(middle, size), boxsize=size)
    near = min(NEAREST, len(which))
    t = tree.query(place if size is None else np.mod(place, size), k=near)[1].reshape(-1, near)
    offset = keys.box.separation(middle[t], place[:, None])  # from the middle of each candidate
    edge = corners[:, 1:] - corners[:, :1]
    inverse = np.linalg.inv(np.swapaxes(edge, 1, 2))
    weight = np.einsum("qncd,qnd->qnc", inverse[t], offset) + 1.0 / 3.0
    weight = np.concatenate([1.0 - weight.sum(axis=-1, keepdims=True), weight], axis=-1)
    best = np.argmax(weight.min(axis=-1), axis=1)
    row = np.arange(len(place))
    _, to_values, of_values = _element(keys.order, keys.bubble)
    node = np.einsum("lk,tkc->tlc", to_values, values[keys.local(which)])
    shape = _monomials(weight[row, best], keys.order, keys.bubble) @ of_values
    found: Float = np.einsum("ql,qlc->qc", shape, node[t[row, best]])
    return found


@lru_cache
def _element(order: int, bubble: bool) -> tuple[Float, Float, Float]:
    """Nodes of a triangle (l, 3), unknowns to values there (l, l), values to monomials (l, l)."""
    if bubble:
        nodes = np.vstack([np.eye(3), np.full((1, 3), 1.0 / 3.0)])
    else:
        i, j = np.meshgrid(np.arange(order + 1), np.arange(order + 1), indexing="ij")
        i, j = i[i + j <= order], j[i + j <= order]
        nodes = np.stack([order - i - j, i, j], axis=1) / order
    ngmesh = NetgenMesh(dim=2)
    ngmesh.AddPoints(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    region = ngmesh.AddRegion("one", dim=2)
    ngmesh.AddElements(dim=2, index=region, data=np.array([[0, 1, 2]], np.int32), base=0)
    mesh = Mesh(ngmesh)
    space = H1(mesh, order=order)
    if bubble:
        space.SetOrder(TRIG, 3)
        space.Update()
    field, columns = GridFunction(space), []
    inside = 1e-13 + (1.0 - 3e-13) * nodes  # corners must be found inside the mesh
    for unknown in range(space.ndof):
        field.vec[:] = 0.0
        field.vec[unknown] = 1.0
        columns.append([field(mesh(*x)) for x in inside[:, 1:].tolist()])
    values: Float = np.array(columns).T
    return nodes, values, np.asarray(np.linalg.inv(_monomials(nodes, order, bubble)))


def _monomials(weight: Float, order: int, bubble: bool) -> Float:
    """A basis of the polynomials on a triangle at barycentric coordinates (q, 3), (q, l)."""
    a, b, c = weight.T
    if bubble:
        return np.stack([a, b, c, a * b * c], axis=1)
    powers = ((order - i - j, i, j) for i in range(order + 1) for j in range(order + 1 - i))
    return np.stack([a**p * b**q * c**r for p, q, r in powers], axis=1)


__all__ = ["Keys", "along_edge", "carry", "carry_load", "lattice", "values_at"]
