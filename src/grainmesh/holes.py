"""The fluid between discs as a curved Netgen mesh: a periodic cell or a box with walls.

A periodic cell is not cut along straight lines, which would graze discs, but along edges of the
Delaunay triangulation of the centres: every cut leaves a disc at right angles, the same mesh comes
out wherever the origin lies, and no cut has a corner in the fluid.

Discs that touch, overlap or nearly touch are bridged: a gap below `CLOSED` times the smaller
radius is closed, and its neck filled up to where it is `FILLED` smaller radii wide, which is where
the two circles would cross if they were pushed together by that width. The same holds between disc
and wall, the wall being a mirror. The outline of a pore is then a closed walk from disc to disc
over the bridges, as one walks round the faces of a planar graph.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from netgen.geom2d import SplineGeometry
from netgen.meshing import MeshingParameters
from ngsolve import Mesh
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from grainmesh.domain import Box
from grainmesh.particles import Particles, close_pairs
from grainmesh.triangulation import triangulate

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]

#: Gaps below this share of the smaller radius are closed.
CLOSED = 5e-4
#: The neck of a closed gap is filled up to this width, in smaller radii.
FILLED = 1e-2
#: Gaps below this share of the smaller radius are meshed by their width.
NARROW = 0.7
#: Shortest arc kept between two bridges [rad].
SHORTEST = 5e-3
#: A cut of the cell keeps this clearance from discs, in radii from their centres.
CLEARANCE = 1.15

TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class Pores:
    """Mesh of the fluid between discs.

    Attributes
    ----------
    mesh : ngsolve.Mesh
        Boundaries are named ``disc``, ``cut`` (periodic) or as in `domain.SIDES`.
    closed : int
        Number of gaps that were closed, between discs and between discs and walls.
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


@dataclass(frozen=True, eq=False)
class _Links:
    """Half-links: what lies round each owner (disc i, or the wall, number n), in any order.

    The way round an owner is an angle [rad] (for the wall, the perimeter scaled to one turn) and
    has the fluid on its right. A half-link covers [low, high] of it, and its owner appears as
    periodic image `before` up to there and as image `after` from there on: they differ where the
    periodic cell is cut.
    """

    owner: Int
    low: Float
    high: Float
    partner: Int
    closed: Bool
    before: Int
    after: Int

    @property
    def middle(self) -> Float:
        return 0.5 * (self.low + self.high)

    @property
    def cut(self) -> Bool:
        changes: Bool = (self.before != self.after).any(axis=1) & ~self.closed
        return changes

    def take(self, index: Int) -> _Links:
        """The half-links `index`, partners renumbered (-1: partner left out)."""
        place = np.full(len(self.owner) + 1, -1)
        place[index] = np.arange(len(index))
        parts = {f.name: getattr(self, f.name)[index] for f in fields(self)}
        return _Links(**{**parts, "partner": place[parts["partner"]]})

    def join(self, other: _Links) -> _Links:
        """These half-links and `other`, whose partners count from its own first."""
        n = len(self.owner)
        moved = np.where(other.partner < 0, -1, other.partner + n)
        parts = {
            f.name: np.concatenate([getattr(self, f.name), getattr(other, f.name)])
            for f in fields(self)
        }
        return _Links(**{**parts, "partner": np.concatenate([self.partner, moved])})


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
    """
    links, sizes = (
        _round_periodic(box, particles) if box.periodic else _round_walled(box, particles)
    )
    geometry, disc_of_curve = _outline(box, particles, _ordered(links, len(particles)))
    parameters = MeshingParameters(maxh=maxh, grading=grading)
    for x, y, h in sizes[sizes[:, 2] < maxh].tolist():
        parameters.RestrictH(x=x, y=y, z=0.0, h=h)
    mesh = Mesh(geometry.GenerateMesh(mp=parameters))
    return Pores(mesh, int(links.closed.sum()) // 2, disc_of_curve)


# --- what lies round each disc ------------------------------------------------------------------


def _covering(r_i: Float, r_j: Float, distance: Float, push: Float) -> Float:
    """Half-angle on circle i inside circle j once they are pushed together by `push` [rad]."""
    a = distance - push
    return np.arccos(np.clip((a**2 + r_i**2 - r_j**2) / (2.0 * a * r_i), -1.0, 1.0))


def _neck_sizes(
    base: Float, side: Float, gap: Float, curvature: Float, smaller: Float, closed: Bool
) -> Float:
    """Mesh sizes along necks of width gap + curvature s^2/2, from `base` along unit `side`."""
    sizes = []
    first = np.where(closed, FILLED * smaller, gap)
    for k in range(13):
        width = first * 2.0**k
        keep = width < NARROW * smaller
        s = np.sqrt(np.maximum(2.0 * (width - gap) / curvature, 0.0))
        sizes.append(np.column_stack([base + s[:, None] * side, width])[keep])
    return np.concatenate(sizes)


def _pair_links(
    particles: Particles, i: Int, j: Int, vector: Float, partner: Int, after: Int, before: Int
) -> tuple[_Links, Float, Bool]:
    """Half-links from discs i to discs j at `vector` [m], their gaps [m], and which are narrow."""
    r = particles.radius
    distance = np.hypot(*vector.T)
    smaller = np.minimum(r[i], r[j])
    gap = distance - r[i] - r[j]
    closed = gap < CLOSED * smaller
    angle = np.arctan2(vector[:, 1], vector[:, 0])
    half = np.where(closed, _covering(r[i], r[j], distance, FILLED * smaller), 0.0)
    return (
        _Links(i, angle - half, angle + half, partner, closed, before, after),
        gap,
        gap < NARROW * smaller,
    )


def _pair_sizes(
    box: Box, particles: Particles, links: _Links, j: Int, vector: Float, gap: Float
) -> Float:
    """Mesh sizes on the far side (`after`) of each half-link between discs."""
    i, r = links.owner, particles.radius
    e = vector / np.hypot(*vector.T)[:, None]
    base = particles.x[i] + links.after * box.size + (r[i] + 0.5 * gap)[:, None] * e
    side = np.column_stack([-e[:, 1], e[:, 0]])
    return _neck_sizes(
        base, side, gap, 1.0 / r[i] + 1.0 / r[j], np.minimum(r[i], r[j]), links.closed
    )


def _first_of_lonely(owner: Int, keep: Bool) -> Bool:
    """`keep`, with one half-link more for every owner that would have none."""
    kept = np.bincount(owner[keep], minlength=owner.max() + 1) > 0
    _, first = np.unique(owner, return_index=True)
    more = keep.copy()
    more[first] |= ~kept[owner[first]]
    return more


def _round_periodic(box: Box, particles: Particles) -> tuple[_Links, Float]:
    """Half-links of a periodic cell, cut along Delaunay edges, and its mesh sizes (k, 3)."""
    tri = triangulate(box, particles)
    a, b = tri.triangles.astype(np.int64), np.roll(tri.triangles, -1, axis=1).astype(np.int64)
    image_a, image_b = tri.shifts.astype(np.int64), np.roll(tri.shifts, -1, axis=1).astype(np.int64)
    i, j = a.ravel(), b.ravel()
    start, end = image_a.reshape(-1, 2), image_b.reshape(-1, 2)
    vector = particles.x[j] - particles.x[i] + (end - start) * box.size
    there = np.lexsort(((end - start)[:, 1], (end - start)[:, 0], j, i))
    back = np.lexsort(((start - end)[:, 1], (start - end)[:, 0], i, j))
    partner = np.empty(len(i), dtype=np.int64)
    partner[back] = there
    zero = np.zeros((len(i), 2), dtype=np.int64)
    links, gap, narrow = _pair_links(particles, i, j, vector, partner, zero, zero)
    blocked = _covered(links, len(particles))
    blocked |= blocked[partner]
    image = _cell(
        box, particles, tri.triangles, image_a, partner, start, end, blocked, links.closed
    )
    triangle = np.arange(len(i)) // 3
    after = start + image[triangle]
    before = (end + image[triangle])[partner]
    links = _Links(i, links.low, links.high, partner, links.closed, before, after)
    sizes = _pair_sizes(box, particles, links, j, vector, gap)
    keep = _first_of_lonely(i, links.closed | links.cut | narrow)
    return links.take(np.flatnonzero(keep)), sizes


def _cell(
    box: Box,
    particles: Particles,
    triangles: NDArray[np.int32],
    corner: Int,
    partner: Int,
    start: Int,
    end: Int,
    blocked: Bool,
    closed: Bool,
) -> Int:
    """Periodic image of each triangle (t, 2) such that no disc lies across a cut of the cell.

    Triangles on the two sides of an edge that a disc crosses stay together as a group; the middle
    of each group lies in the box. A disc that reaches an edge crosses every triangle on its way, so
    it is enough to test the discs of a group against the edges of that group, until none is left.
    """
    t = len(triangles)
    home = np.arange(3 * t) // 3
    image = np.zeros((t, 2), dtype=np.int64)
    while True:
        graph = coo_array(
            (np.ones(blocked.sum()), (home[blocked], home[partner][blocked])), shape=(t, t)
        ).tocsr()
        _, group = connected_components(graph, directed=False)
        step = {
            (home[h], home[partner[h]]): start[h] - end[partner[h]] for h in np.flatnonzero(blocked)
        }
        done = np.zeros(t, dtype=bool)
        image[:] = 0
        for first in np.unique(home[blocked]):
            if not done[first]:
                reached, parent = breadth_first_order(graph, first, directed=False)
                done[reached] = True
                for k in reached[1:]:
                    image[k] = image[parent[k]] + step[parent[k], k]
        # Every open edge between two groups against every disc of the group on its left.
        members = coo_array((np.ones(t), (group, np.arange(t)))).tocsr()
        h = np.flatnonzero(~closed & (group[home] != group[home[partner]]))
        near = members[group[home[h]]].tocoo()
        row = np.repeat(h[near.coords[0]], 3)
        other = near.coords[1]
        disc = triangles[other].ravel()
        place = particles.x[disc] + (
            (corner[other] + image[other][:, None]).reshape(-1, 2) * box.size
        )
        p = particles.x[triangles.ravel()[row]] + (start[row] + image[home[row]]) * box.size
        along = end[row] - start[row]
        after = row - row % 3 + (row + 1) % 3
        q = (
            p
            + particles.x[triangles.ravel()[after]]
            - particles.x[triangles.ravel()[row]]
            + (along * box.size)
        )
        u = q - p
        s = np.clip(((place - p) * u).sum(1) / (u**2).sum(1), 0.0, 1.0)
        far = np.hypot(*(place - p - s[:, None] * u).T)
        crossed = (far < CLEARANCE * particles.radius[disc]) & (s > 0.0) & (s < 1.0)
        hit = np.unique(row[crossed])
        if len(hit) == 0:
            break
        blocked = blocked.copy()
        blocked[hit] = blocked[partner[hit]] = True
    middle = (particles.x[triangles] + (corner + image[:, None]) * box.size).mean(axis=1)
    count = np.bincount(group)
    centre = np.column_stack([np.bincount(group, m) / count for m in middle.T])
    moved: Int = image - np.floor(centre / box.size).astype(np.int64)[group]
    return moved


def _round_walled(box: Box, particles: Particles) -> tuple[_Links, Float]:
    """Half-links of a box with walls, and its mesh sizes (k, 3)."""
    x, r, n = particles.x, particles.radius, len(particles)
    pairs = close_pairs(box, particles, NARROW * float(r.max()))
    i, j = np.concatenate([pairs, pairs[:, ::-1]]).T
    partner = np.roll(np.arange(len(i)), len(pairs))
    zero = np.zeros((len(i), 2), dtype=np.int64)
    vector = x[j] - x[i]
    links, gap, narrow = _pair_links(particles, i, j, vector, partner, zero, zero)
    sizes = [_pair_sizes(box, particles, links, j, vector, gap)]
    depth = np.minimum(x, box.size - x).min(axis=1) + r
    gone = depth < FILLED * r  # of these discs hardly anything is inside
    contact = x[i] + ((r[i] + 0.5 * gap) / np.hypot(*vector.T))[:, None] * vector
    inside = ((contact > 0.0) & (contact < box.size)).all(axis=1) & ~gone[i] & ~gone[j]
    links = links.take(np.flatnonzero(narrow & inside))

    way = np.cumsum([0.0, box.height, box.width, box.height, box.width])  # clockwise from (0, 0)
    scale = TURN / way[-1]
    walls = (  # side, its normal, distance of each disc, foot along the perimeter
        ((-1.0, 0.0), x[:, 0], way[0] + x[:, 1], way[0:2]),
        ((0.0, 1.0), box.height - x[:, 1], way[1] + x[:, 0], way[1:3]),
        ((1.0, 0.0), box.width - x[:, 0], way[3] - x[:, 1], way[2:4]),
        ((0.0, -1.0), x[:, 1], way[4] - x[:, 0], way[3:5]),
    )
    for normal, distance, foot, (first, last) in walls:
        gap = 2.0 * (distance - r)
        near = np.flatnonzero((gap < NARROW * r) & ~gone)
        e = np.broadcast_to(np.array(normal), (len(near), 2))
        closed = gap[near] < CLOSED * r[near]
        base = x[near] + distance[near, None] * e
        for turn in (1.0, -1.0):
            side = turn * np.column_stack([-e[:, 1], e[:, 0]])
            half = _neck_sizes(base, side, gap[near], 2.0 / r[near], r[near], closed)
            half[:, 2] *= 0.5
            sizes.append(half)
        near, e = near[closed], e[closed]
        steep = distance[near] < 0.9 * r[near]  # crosses the wall at an angle: nothing to fill
        push = np.where(steep, 0.0, 0.5 * FILLED * r[near])
        half = np.arccos(np.clip((distance[near] - push) / r[near], -1.0, 1.0))
        angle = np.arctan2(e[:, 1], e[:, 0])
        reach = r[near] * np.sin(half)
        m = len(near)
        zero = np.zeros((2 * m, 2), dtype=np.int64)
        low = np.clip(foot[near] - reach, first, last) * scale
        high = np.clip(foot[near] + reach, first, last) * scale
        ends = _Links(
            np.concatenate([near, np.full(m, n)]),
            np.concatenate([angle - half, low]),
            np.concatenate([angle + half, high]),
            np.roll(np.arange(2 * m), m),
            np.ones(2 * m, dtype=bool),
            zero,
            zero,
        )
        links = links.join(ends.take(np.flatnonzero(np.tile(high > low, 2))))
    # Corners of the wall, and one point on every disc that has no link.
    lonely = np.setdiff1d(np.flatnonzero(~gone), links.owner)
    owner = np.concatenate([np.full(4, n), lonely])
    at = np.concatenate([way[:4] * scale, np.zeros(len(lonely))])
    zero = np.zeros((len(owner), 2), dtype=np.int64)
    none = np.full(len(owner), -1)
    points = _Links(owner, at, at, none, np.zeros(len(owner), dtype=bool), zero, zero)
    return links.join(points), np.concatenate(sizes)


# --- from half-links to the outline of the fluid ------------------------------------------------


def _covered(links: _Links, n: int) -> Bool:
    """Which open half-links lie under a bridge of the same owner (or too close beside one)."""
    bridge = np.flatnonzero(links.closed)
    count = np.bincount(links.owner[bridge], minlength=n + 1)
    first = np.concatenate([[0], np.cumsum(count)])
    bridge = bridge[np.argsort(links.owner[bridge], kind="stable")]
    ask = np.flatnonzero(~links.closed)
    times = count[links.owner[ask]]
    row = np.repeat(ask, times)
    within = np.arange(len(row)) - np.repeat(np.cumsum(times) - times, times)
    under = bridge[first[links.owner[row]] + within]
    margin = np.where(links.owner[row] < n, SHORTEST, 0.0)
    ahead = np.mod(links.middle[row] - links.low[under] + margin, TURN)
    covered = np.zeros(len(links.owner), dtype=bool)
    covered[row[ahead <= links.high[under] - links.low[under] + 2.0 * margin]] = True
    return covered


def _ordered(links: _Links, n: int) -> _Links:
    """Half-links in their order round each owner, without those under a bridge."""
    keep = np.flatnonzero(~_covered(links, n))
    middle = np.mod(links.middle[keep], TURN)
    return links.take(keep[np.lexsort((middle, links.owner[keep]))])


def _position(box: Box, particles: Particles, owner: Int, at: Float) -> Float:
    """Points (m, 2) [m] at the way `at` round each owner."""
    n = len(particles)
    disc = np.minimum(owner, n - 1)
    angle = np.column_stack([np.cos(at), np.sin(at)])
    point = particles.x[disc] + particles.radius[disc][:, None] * angle
    way = np.cumsum([0.0, box.height, box.width, box.height, box.width])
    corner = np.array([[0, 0], [0, 1], [1, 1], [1, 0], [0, 0]]) * box.size
    s = np.mod(at, TURN) * way[-1] / TURN
    wall = np.column_stack([np.interp(s, way, corner[:, k]) for k in (0, 1)])
    return np.where((owner == n)[:, None], wall, point)


def _outline(box: Box, particles: Particles, links: _Links) -> tuple[SplineGeometry, Int]:
    """Netgen's geometry of the fluid from half-links in order, and the disc of each curve."""
    n, m = len(particles), len(links.owner)
    owner, closed, cut = links.owner, links.closed, links.cut
    first = np.concatenate([[True], owner[1:] != owner[:-1]])
    head = np.flatnonzero(first)
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

    # Numbers of points: the two ends of a half-link are one point unless it is a bridge or a cut.
    begins = np.arange(m)
    stops = np.where(closed | cut, m + np.arange(m), begins)
    bridges = []
    for k in np.flatnonzero(alive & closed[following]):
        b = following[k]
        a = links.partner[b]
        while not alive[a]:  # over arcs that bridges have swallowed
            a = links.partner[following[a]]
        if a == k and links.partner[b] != k:  # nothing but this arc is left of the pore
            alive[k] = False
        elif np.hypot(*(start[a] - end[b])) < 1e-9 * particles.radius.min():
            stops[b] = a
        else:
            bridges.append((b, a))

    geometry = SplineGeometry()
    disc_of_curve: list[int] = []
    number: dict[int, int] = {}
    points = np.concatenate([start, end])

    def point(k: int) -> int:
        if k not in number:
            number[k] = geometry.AppendPoint(*points[k])
        return number[k]

    def curve(
        kind: str, ends: list[int], bc: str, disc: int = -1, left: int = 0, **copy: int
    ) -> int:
        disc_of_curve.append(disc)
        new: int = geometry.Append(
            [kind, *ends], leftdomain=left, rightdomain=1 - left, bc=bc, **copy
        )
        return new

    # Cuts come first: Netgen numbers a periodic identification by its curve.
    for h in np.flatnonzero(cut & (links.partner > np.arange(m))):
        p = links.partner[h]
        original = curve("line", [point(begins[h]), point(stops[p])], "cut", left=1)
        curve("line", [point(stops[h]), point(begins[p])], "cut", copy=original)
    for k in np.flatnonzero(alive):
        i, b = int(owner[k]), following[k]
        if i == n:
            s = np.mod(links.high[k] + 0.5 * length[k], TURN) / TURN * 2 * (box.width + box.height)
            way = np.cumsum([box.height, box.width, box.height])
            side = ("left", "top", "right", "bottom")[int(np.searchsorted(way, s))]
            curve("line", [point(begins[k]), point(stops[b])], side)
            continue
        pieces = int(np.ceil(length[k] / (0.5 * np.pi) - 1e-9))
        step = length[k] / pieces
        centre = particles.x[i] + links.after[k] * box.size
        radius = particles.radius[i]
        last = point(begins[k])
        for piece in range(pieces):
            at = links.high[k] + (piece + np.array([0.5, 1.0])) * step
            reach = radius * np.array([1.0 / np.cos(0.5 * step), 1.0])
            control, to = centre + reach[:, None] * np.column_stack([np.cos(at), np.sin(at)])
            middle = geometry.AppendPoint(*control)
            new = point(stops[b]) if piece == pieces - 1 else geometry.AppendPoint(*to)
            curve("spline3", [last, middle, new], "disc", i)
            last = new
    for b, a in bridges:
        disc = int(owner[b] if owner[b] < n else owner[a])
        curve("line", [point(stops[b]), point(begins[a])], "disc", disc)
    return geometry, np.array(disc_of_curve)
