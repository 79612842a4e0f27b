"""The fluid between discs as a curved Netgen mesh: a periodic cell or a box with walls.

A periodic cell is not cut along straight lines, which would graze discs, but along edges of the
Delaunay triangulation of the centres: every cut leaves a disc at right angles, the same mesh comes
out wherever the origin lies, and no cut has a corner in the fluid.

Discs that touch, overlap or nearly touch are bridged (`links`). The outline of a pore is then a
closed walk from disc to disc over the bridges, as one walks round the faces of a planar graph.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from netgen.geom2d import SplineGeometry
from netgen.meshing import MeshingParameters
from ngsolve import TRIG, VOL, Det, IntegrationRule, Mesh, specialcf
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.links import (
    SHORTEST,
    TURN,
    Links,
    around_periodic,
    around_walled,
    off_corners,
    ordered,
    perimeter,
)
from grainmesh.particles import Particles

Float = NDArray[np.float64]
Int = NDArray[np.int64]

#: The neck of a closed gap is filled up to this width, in smaller radii; where bridges meet so
#: closely that the outline would cross itself, the next width is tried.
FILLED = (1e-2, 4e-3, 2e-2, 5e-2)
#: Longest arc of one curve [rad].
LONGEST = np.pi / 3.0
#: Order at which elements are tested for being turned inside out, and meshes tried without such.
CURVED, REMESH = 5, 6


@dataclass(frozen=True, eq=False)
class Pores:
    """Mesh of the fluid between discs.

    Attributes
    ----------
    mesh : ngsolve.Mesh
        Boundaries are named ``disc``, ``cut`` (periodic) or as in `domain.SIDES`.
    closed : int
        Number of gaps between discs that were closed.
    disc_of_curve : ndarray, shape (c,)
        Disc of each boundary curve, which is what Netgen numbers segments by; -1: none.
    """

    mesh: Any
    closed: int
    disc_of_curve: Int

    def disc_vertices(self) -> tuple[Int, Int]:
        """Mesh vertices on discs, and the disc of each: two arrays of shape (k,)."""
        segments = self.mesh.ngmesh.Elements1D().NumPy()
        disc = np.repeat(self.disc_of_curve[segments["index"].astype(np.int64) - 1], 2)
        vertex = segments["nodes"][:, :2].astype(np.int64).ravel() - 1
        vertex, first = np.unique(vertex[disc >= 0], return_index=True)
        return vertex, disc[disc >= 0][first]


def pore_mesh(box: Box, particles: Particles, maxh: float, grading: float = 0.7) -> Pores:
    """Mesh the fluid between discs.

    Parameters
    ----------
    box : Box
    particles : Particles
        As `particles.settle` returns them.
    maxh : float
        Largest element [m]; narrow gaps are meshed by their width.
    grading : float
        How fast elements may grow (Netgen's).

    Returns
    -------
    Pores
        In the units of `box`; straight-sided until ``mesh.Curve(order)`` is called.

    Raises
    ------
    InputError
        If discs overlap in such a way that no outline is found.
    """
    n, around = len(particles), around_periodic if box.periodic else around_walled
    particles = particles if box.periodic else off_corners(box, particles)
    for filled in FILLED:
        links, sizes = around(box, particles, filled)
        bridged = links.closed.any()
        outline = _outline(box, particles, ordered(links, n))
        place = outline.crossing(box) if bridged and outline.curves else None
        if place is None:
            break
    else:
        raise InputError(
            f"the discs around particle {place} overlap so much that the space between them "
            "cannot be meshed: reduce their diameters a little"
        )
    if not outline.curves:
        raise InputError("the discs fill the box: there is no fluid in it")
    geometry = outline.geometry()
    for attempt in range(REMESH):
        parameters = MeshingParameters(maxh=maxh, grading=grading)
        for x, y, h in sizes[sizes[:, 2] < maxh].tolist():
            parameters.RestrictH(x=x, y=y, z=0.0, h=h)
        mesh = Mesh(geometry.GenerateMesh(mp=parameters))
        folded = _folded(mesh)
        if len(folded) == 0:
            between = links.closed & (np.maximum(links.owner, links.owner[links.partner]) < n)
            disc_of_curve = np.array([curve.disc for curve in outline.curves])
            return Pores(mesh, int(between.sum()) // 2, disc_of_curve)
        sizes = np.concatenate([sizes, folded * (1.0, 1.0, 0.5**attempt)])
    raise InputError(
        f"no sound mesh near ({folded[0, 0]:g}, {folded[0, 1]:g}) mean diameters: "
        "move the discs there, or the edge of the box, a little"
    )


def _folded(mesh: Any) -> Float:
    """Middle (x, y) of the elements that curving turns inside out, and half their size: (k, 3)."""
    mesh.Curve(CURVED)
    rule = IntegrationRule(TRIG, 2 * CURVED)
    jacobian = Det(specialcf.JacobianMatrix(2))(mesh.MapToAllElements(rule, VOL))
    bad = np.flatnonzero(np.asarray(jacobian).reshape(mesh.ne, -1).min(axis=1) <= 0.0)
    nodes = mesh.ngmesh.Elements2D().NumPy()["nodes"][bad, :3].astype(np.int64) - 1
    corner = np.array(mesh.ngmesh.Coordinates())[nodes][..., :2]
    size = np.hypot(*np.moveaxis(corner - np.roll(corner, 1, axis=1), -1, 0)).max(axis=1)
    return np.column_stack([corner.mean(axis=1), 0.5 * size])


@dataclass(frozen=True)
class _Curve:
    """A straight line, or an arc with the point where the tangents of its ends meet.

    The fluid is on the right; a cut of the cell has an image, `original` curves before it.
    """

    ends: tuple[int, ...]
    name: str
    disc: int = -1
    reverse: bool = False
    original: int = 0


@dataclass(frozen=True, eq=False)
class _Outline:
    points: list[tuple[float, float]]
    curves: list[_Curve]

    def geometry(self) -> SplineGeometry:
        """As Netgen takes it; three-point splines are exact arcs."""
        geometry = SplineGeometry()
        for x, y in self.points:
            geometry.AppendPoint(x, y)
        for number, curve in enumerate(self.curves):
            geometry.Append(
                ["line" if len(curve.ends) == 2 else "spline3", *curve.ends],
                leftdomain=int(curve.reverse),
                rightdomain=int(not curve.reverse),
                bc=curve.name,
                **({"copy": number - curve.original} if curve.original else {}),
            )
        return geometry

    def crossing(self, box: Box) -> int | None:
        """A disc whose outline crosses another curve or leaves the box with walls, if any."""
        points = np.array(self.points)
        curves = [c for c in self.curves if c.disc >= 0 or c.name == "cut"]
        first = points[[c.ends[0] for c in curves]]
        tangents = points[[c.ends[1] if len(c.ends) == 3 else c.ends[0] for c in curves]]
        last = points[[c.ends[-1] for c in curves]]
        chord = np.hypot(*(last - first).T)
        weight = chord / np.maximum(np.hypot(*(tangents - first).T), 1e-12 * chord + 1e-300)
        t = np.linspace(0.0, 1.0, 6)[:, None]
        basis = np.stack(
            [(1 - t) ** 2 + 0 * weight, weight * t * (1 - t), t**2 + 0 * weight], axis=-1
        )
        straight = np.array([len(c.ends) == 2 for c in curves])
        basis[:, straight] = np.stack([1 - t, 0 * t, t], axis=-1)
        basis /= basis.sum(axis=-1, keepdims=True)
        line = np.einsum("tcb,bcx->tcx", basis, np.stack([first, tangents, last]))
        a, b = line[:-1].reshape(-1, 2), line[1:].reshape(-1, 2)
        owner = np.tile([c.disc for c in curves], len(line) - 1)
        if not box.periodic:
            slack = 1e-9 * box.size
            outside = ((a < -slack) | (a > box.size + slack)).any(axis=1)
            if outside.any():
                return int(owner[outside].max())
        reach = float(np.hypot(*(b - a).T).max())
        i, j = cKDTree(0.5 * (a + b)).query_pairs(reach, output_type="ndarray").T

        def side(p: Float, q: Float, z: Float) -> Float:
            u, v = q - p, z - p
            area: Float = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
            return area

        tiny = -1e-20 * reach**4
        crossed = (side(a[i], b[i], a[j]) * side(a[i], b[i], b[j]) < tiny) & (
            side(a[j], b[j], a[i]) * side(a[j], b[j], b[i]) < tiny
        )
        return int(np.maximum(owner[i], owner[j])[crossed].max()) if crossed.any() else None


def _position(box: Box, particles: Particles, owner: Int, at: Float) -> Float:
    """Points (m, 2) [m] at the way `at` round each owner."""
    n = len(particles)
    disc = np.minimum(owner, n - 1)
    angle = np.column_stack([np.cos(at), np.sin(at)])
    point = particles.x[disc] + particles.radius[disc][:, None] * angle
    way = perimeter(box)
    corner = np.array([[0, 0], [0, 1], [1, 1], [1, 0], [0, 0]]) * box.size
    s = np.mod(at, TURN) * way[-1] / TURN
    wall = np.column_stack([np.interp(s, way, corner[:, k]) for k in (0, 1)])
    return np.where((owner == n)[:, None], wall, point)


def _outline(box: Box, particles: Particles, links: Links) -> _Outline:
    """Curves round the fluid, from half-links in order."""
    n, m = len(particles), len(links.owner)
    owner, closed, cut, partner = links.owner, links.closed, links.cut, links.partner
    head = np.flatnonzero(np.concatenate([[True], owner[1:] != owner[:-1]]))
    following = np.arange(1, m + 1)
    following[np.concatenate([head[1:] - 1, [m - 1]])] = head
    # Arc k runs from the far end of half-link k to the near end of the next one round its owner.
    span = np.mod(links.middle[following] - links.middle, TURN)
    span[following == np.arange(m)] = TURN
    half = links.high - links.middle
    length = span - half - half[following]
    alive = (length > SHORTEST) | ((length > 0.0) & ~(closed & closed[following]))
    start = _position(box, particles, owner, links.high) + links.after * box.size
    end = _position(box, particles, owner, links.low) + links.before * box.size
    # Both ends of a half-link are one point unless it is a bridge or a cut.
    begins = np.arange(m)
    stops = np.where(closed | cut, m + np.arange(m), begins)
    points = [*map(tuple, start.tolist()), *map(tuple, end.tolist())]
    curves = []

    for h in np.flatnonzero(cut & (partner > np.arange(m))):
        # Cuts come first: Netgen numbers a periodic identification by its curve.
        p = partner[h]
        curves.append(_Curve((begins[h], stops[p]), "cut", reverse=True))
        curves.append(_Curve((stops[h], begins[p]), "cut", original=1))
    touching = 1e-9 * particles.radius.min()
    for k in np.flatnonzero(alive & closed[following]):
        b = following[k]
        a = partner[b]
        while not alive[a]:  # over arcs that bridges have swallowed
            a = partner[following[a]]
        if a == k and partner[b] != k:  # nothing but this arc is left of the pore
            alive[k] = False
        elif np.hypot(*(start[a] - end[b])) < touching:
            stops[b] = a
        else:
            disc = min(owner[b], owner[a])
            curves.append(_Curve((stops[b], begins[a]), "disc", disc if disc < n else -1))
    way = perimeter(box)
    for k in np.flatnonzero(alive):
        i, last = int(owner[k]), stops[following[k]]
        if i == n:
            s = np.mod(links.high[k] + 0.5 * length[k], TURN) / TURN * way[-1]
            side = ("left", "top", "right", "bottom")[np.searchsorted(way[1:4], s)]
            curves.append(_Curve((begins[k], last), side))
            continue
        pieces = int(np.ceil(length[k] / LONGEST - 1e-9))
        step = length[k] / pieces
        at = links.high[k] + np.arange(1, 2 * pieces) * (0.5 * step)
        reach = np.where(np.arange(1, 2 * pieces) % 2, 1.0 / np.cos(0.5 * step), 1.0)
        centre = particles.x[i] + links.after[k] * box.size
        knots = centre + particles.radius[i] * reach[:, None] * np.column_stack(
            [np.cos(at), np.sin(at)]
        )
        numbers = [begins[k], *range(len(points), len(points) + len(knots)), last]
        points += map(tuple, knots.tolist())
        curves += [_Curve(tuple(numbers[q : q + 3]), "disc", i) for q in range(0, 2 * pieces, 2)]
    return _Outline(points, curves)
