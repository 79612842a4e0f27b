"""Finite-element meshes and spaces of NGSolve on a triangulation of particles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from netgen.meshing import IdentificationType
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import (
    H1,
    TRIG,
    VERTEX,
    CoefficientFunction,
    GridFunction,
    LinearForm,
    Mesh,
    Periodic,
    VectorH1,
    dx,
)
from numpy.typing import NDArray

from grainmesh.domain import SIDES, Box

Float = NDArray[np.float64]
Int = NDArray[np.integer[Any]]


class Grid(NamedTuple):
    """A finite-element mesh and what its vertices are.

    Attributes
    ----------
    mesh : ngsolve.Mesh
        Its boundaries are named as in `domain.SIDES`.
    vertex : ndarray, shape (v,)
        Point of the triangulation that each vertex shows.
    shift : ndarray, shape (v, 2)
        At which periodic image.
    corner : ndarray, shape (t, 3)
        Vertices of each triangle.
    """

    mesh: Any
    vertex: NDArray[np.int64]
    shift: NDArray[np.int64]
    corner: NDArray[np.int64]


def flow_mesh(box: Box, points: Float, triangles: Int, shifts: Int, neighbours: Int) -> Grid:
    """NGSolve mesh of a triangulation.

    A torus is cut open along edges: each triangle lies where its middle is inside the box, and
    images of a particle are identified with each other. The first vertices are the points that are
    corners, at one of their images, in their order.

    Parameters
    ----------
    box : Box
        Periodic, with at most one edge between two particles; or with nodes on its walls.
    points : ndarray, shape (m, 2)
        Vertices [m]; those that are no corner are left out.
    triangles, shifts, neighbours : ndarray, shapes (t, 3), (t, 3, 2), (t, 3)
        As of `triangulation.Triangulation`.

    Returns
    -------
    Grid
    """
    if box.periodic:
        shift = shifts.astype(np.int64)
        middle = (points[triangles] + shift * box.size).mean(axis=1)
        shift = shift - np.floor(middle / box.size).astype(np.int64)[:, None]
        images = np.column_stack([triangles.reshape(-1, 1), shift.reshape(-1, 2)])
        images, corner = np.unique(images, axis=0, return_inverse=True)
        # The lowest image of each point comes first, in the order of the points.
        first = np.ones(len(images), dtype=bool)
        first[1:] = np.diff(images[:, 0]) > 0
        number = np.where(first, np.cumsum(first) - 1, first.sum() + np.cumsum(~first) - 1)
        images = images[np.argsort(number)]
        vertex, shift = images[:, 0], images[:, 1:]
        corner = number[corner].reshape(-1, 3)
    else:
        used = np.zeros(len(points), dtype=bool)
        used[triangles] = True
        vertex, corner = np.flatnonzero(used), (np.cumsum(used) - 1)[triangles]
        shift = np.zeros((len(vertex), 2), np.int64)

    ngmesh = NetgenMesh(dim=2)
    places = points[vertex] + shift * box.size
    ngmesh.AddPoints(np.column_stack([places, np.zeros(len(vertex))]))
    region = ngmesh.AddRegion("fluid", dim=2)
    ngmesh.AddElements(dim=2, index=region, data=corner.astype(np.int32), base=0)
    if box.periodic:
        point = np.searchsorted(vertex[: first.sum()], vertex)  # the vertex of its lowest image
        for group, pairs in enumerate(_identifications(corner, point, shift), start=1):
            for master, slave in np.column_stack(pairs).tolist():
                ngmesh.AddPointIdentification(
                    master + 1, slave + 1, group, IdentificationType.PERIODIC
                )
    else:
        t, k = np.nonzero(neighbours < 0)
        ends = np.stack([corner[t, (k + 1) % 3], corner[t, (k + 2) % 3]], axis=1).astype(np.int32)
        for side, name in enumerate(SIDES):
            axis, end = divmod(side, 2)
            on = (places[ends][:, :, axis] == end * box.size[axis]).all(axis=1)
            region = ngmesh.AddRegion(name, dim=1)
            ngmesh.AddElements(dim=1, index=region, data=ends[on], base=0)
    return Grid(Mesh(ngmesh), vertex, shift, corner)


def _identifications(triangles: Int, point: Int, shift: Int) -> list[tuple[Int, Int]]:
    """Groups of (master, slave) vertices that make a periodic space of a cell cut open.

    NGSolve goes through the groups in order; the last group with a vertex among its slaves decides
    what the vertex becomes, so the groups that lead to the lowest image of each point come last.
    An edge is identified where both its ends are slaves in one group. All such edges of a group,
    and no triangle at all, must have an image, or NGSolve stops: hence more than one group for a
    translation.
    """
    v = len(point)
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    copies = np.bincount(point)[point] > 1
    sides = np.unique(sides[copies[sides].all(axis=1)], axis=0)
    corners = triangles[copies[triangles].all(axis=1)]
    known = sides[:, 0] * v + sides[:, 1]

    def groups(master: Int, wanted: Int) -> list[tuple[Int, Int]]:
        """Groups of slaves v -> master[v], so that each wanted pair is together in one of them."""
        image = np.sort(master[sides], axis=1)
        lost = sides[~np.isin(image[:, 0] * v + image[:, 1], known)]
        forbidden = np.vstack([corners, lost[:, [0, 1, 1]]])
        near: dict[int, list[set[int]]] = {}  # loops over the vertices on the cut only: few
        for row in map(set, forbidden.tolist()):
            for end in row:
                near.setdefault(end, []).append(row)
        found, left = [], [set(pair) for pair in wanted.tolist()]
        while left:
            slave: set[int] = set()
            later = []
            for pair in left:
                if any(row - pair <= slave for end in pair for row in near.get(end, ())):
                    later.append(pair)
                else:
                    slave |= pair
            slaves = np.array(sorted(slave))
            found.append((master[slaves], slaves))
            left = later
        return found

    # The two copies of an edge that was cut follow each other here, the lower image first.
    ends = np.where((point[sides[:, 0]] > point[sides[:, 1]])[:, None], sides[:, ::-1], sides)
    order = np.lexsort([*shift[ends[:, 0]].T[::-1], *point[ends].T])
    low, high = ends[order[:-1]], ends[order[1:]]
    twice = (point[low] == point[high]).all(axis=1)
    low, high = low[twice], high[twice]
    step = shift[high[:, 0]] - shift[low[:, 0]]
    result = []
    for translation in np.unique(step, axis=0):
        here = (step == translation).all(axis=1)
        master = np.arange(v)
        master[high[here]] = low[here]
        result += groups(master, high[here])
    slaves = np.flatnonzero(point != np.arange(v))
    return result + groups(point, np.column_stack([slaves, slaves]))


def spaces(
    mesh: Any, order: int, pressure: Sequence[str], slip: Sequence[str], no_slip: Sequence[str]
) -> tuple[Any, Any]:
    """Velocity and pressure space, periodic if the mesh is."""
    upright, level = {"left", "right"}, {"bottom", "top"}
    x = [*no_slip, *upright.intersection(slip), *level.intersection(pressure)]
    y = [*no_slip, *level.intersection(slip), *upright.intersection(pressure)]
    V = VectorH1(mesh, order=order, dirichletx="|".join(x), dirichlety="|".join(y))
    Q = H1(mesh, order=max(order - 1, 1), dirichlet="|".join(pressure))
    if order == 1:
        V.SetOrder(TRIG, 3)  # the bubble of MINI
        V.Update()
    if mesh.GetPeriodicNodePairs(VERTEX):  # only then: the wrapper forgets dirichletx
        V, Q = Periodic(V), Periodic(Q)
    return V, Q


def linear(mesh: Any, values: Float) -> Any:
    """Field that is linear between values at the vertices."""
    field = GridFunction(H1(mesh, order=1))
    field.vec.FV().NumPy()[:] = values
    return field


def moments(mesh: Any, field: Any, degree: int) -> Float:
    """Integrals of a field of this degree times the hat function of each vertex, (v,)."""
    space = H1(mesh, order=1)
    form = LinearForm(field * space.TestFunction() * dx(bonus_intorder=degree))
    return np.array(form.Assemble().vec.FV().NumPy())


def hats(mesh: Any) -> Float:
    """Integral of the hat function of each vertex, (v,)."""
    return moments(mesh, CoefficientFunction(1.0), 0)


__all__ = ["Grid", "flow_mesh", "hats", "linear", "moments", "spaces"]
