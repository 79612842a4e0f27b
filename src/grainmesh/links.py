"""What lies round each disc: gaps, bridges over closed gaps, and cuts of a periodic cell.

The fluid between discs is bounded by arcs. Going round a disc, its arcs are interrupted by
half-links, each the disc's end of a link to a neighbouring disc or to the wall:

- a gap below `CLOSED` times the smaller radius is closed by a bridge: the neck is filled up to
  where it is `filled` smaller radii wide. Pushed together by that width, two circles of radii r_i
  and r_j at distance L = a + `filled` r would cross at the angle

      cos(alpha_i) = (a² + r_i² - r_j²) / (2 a r_i)                                             (1)

  on either side of the link, and there the bridge ends. A wall is a mirror.
- a periodic cell is cut along edges of the Delaunay triangulation, so that every cut leaves a disc
  at right angles; no cut passes near a third disc.
- a narrow gap only asks for small elements: as wide as the gap is there.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from grainmesh.domain import Box
from grainmesh.particles import Particles, close_pairs
from grainmesh.triangulation import Triangulation, triangulate

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]

#: Gaps below this share of the smaller radius are closed.
CLOSED = 5e-4
#: Gaps below this share of the smaller radius are meshed by their width.
NARROW = 0.7
#: Shortest arc kept between two bridges [rad].
SHORTEST = 5e-3
#: A cut of the cell keeps this clearance from discs, in radii from their centres.
CLEARANCE = 1.15
#: Size of elements where a disc ends on a wall, in radii.
CORNER = 0.1
#: Circles that pass a corner of the box within this share of their radius are moved off it.
GRAZING = 5e-3
#: A disc cut by a wall meets it at an angle, with nothing to fill, up to this distance in radii.
STEEP = 0.9

TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class Links:
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

    def take(self, index: Int) -> Links:
        """The half-links `index`, partners renumbered (-1: partner left out)."""
        place = np.full(len(self.owner) + 1, -1)
        place[index] = np.arange(len(index))
        parts = {f.name: getattr(self, f.name)[index] for f in fields(self)}
        return Links(**{**parts, "partner": place[parts["partner"]]})

    def join(self, other: Links) -> Links:
        """These half-links and `other`, whose partners count from its own first."""
        n = len(self.owner)
        moved = np.where(other.partner < 0, -1, other.partner + n)
        parts = {
            f.name: np.concatenate([getattr(self, f.name), getattr(other, f.name)])
            for f in fields(self)
        }
        return Links(**{**parts, "partner": np.concatenate([self.partner, moved])})


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Discs i and what they face at `vector` from their centres: discs, or their mirror images."""

    i: Int
    vector: Float
    radius: Float
    other: Float

    @property
    def direction(self) -> Float:
        direction: Float = self.vector / np.hypot(*self.vector.T)[:, None]
        return direction

    @property
    def angle(self) -> Float:
        angle: Float = np.arctan2(self.vector[:, 1], self.vector[:, 0])
        return angle

    @property
    def gap(self) -> Float:
        gap: Float = np.hypot(*self.vector.T) - self.radius - self.other
        return gap

    @property
    def smaller(self) -> Float:
        smaller: Float = np.minimum(self.radius, self.other)
        return smaller

    @property
    def closed(self) -> Bool:
        return self.gap < CLOSED * self.smaller

    @property
    def narrow(self) -> Bool:
        return self.gap < NARROW * self.smaller

    def covering(self, push: Float) -> Float:
        """Half-angle alpha_i [rad] under the other once pushed together by `push` [m], Eq. (1)."""
        a = np.hypot(*self.vector.T) - push
        cosine = (a**2 + self.radius**2 - self.other**2) / (2.0 * a * self.radius)
        alpha: Float = np.arccos(np.clip(cosine, -1.0, 1.0))
        return alpha

    def sizes(self, middle: Float, filled: float, turn: float = 1.0) -> Float:
        """Points and element sizes (k, 3) along the necks, to the left of `vector` (or right).

        At s from the `middle` of the gap its width is gap + (1/r_i + 1/r_j) s²/2.
        """
        left = turn * np.column_stack([-self.direction[:, 1], self.direction[:, 0]])
        curvature = 1.0 / self.radius + 1.0 / self.other
        start = np.where(self.closed, filled * self.smaller, self.gap)
        found = []
        for octave in range(13):
            width = start * 2.0**octave
            s = np.sqrt(np.maximum(2.0 * (width - self.gap) / curvature, 0.0))
            keep = width < NARROW * self.smaller
            found.append(np.column_stack([middle + s[:, None] * left, width])[keep])
        return np.concatenate(found)


def around_periodic(box: Box, particles: Particles, filled: float) -> tuple[Links, Float]:
    """Half-links of a periodic cell, cut along Delaunay edges, and its element sizes (k, 3)."""
    tri = triangulate(box, particles)
    ends = np.stack([tri.triangles, np.roll(tri.triangles, -1, axis=1)]).astype(np.int64)
    images = np.stack([tri.shifts, np.roll(tri.shifts, -1, axis=1)]).astype(np.int64)
    i, j = ends.reshape(2, -1)
    start, end = images.reshape(2, -1, 2)
    step = end - start
    partner = np.empty(len(i), dtype=np.int64)
    partner[np.lexsort((-step[:, 1], -step[:, 0], i, j))] = np.lexsort(
        (step[:, 1], step[:, 0], j, i)
    )
    x, r = particles.x, particles.radius
    pairs = _Pairs(i, x[j] - x[i] + step * box.size, r[i], r[j])
    half = np.where(pairs.closed, pairs.covering(filled * pairs.smaller), 0.0)
    links = Links(i, pairs.angle - half, pairs.angle + half, partner, pairs.closed, start, start)
    blocked = _covered(links, len(particles))
    blocked |= blocked[partner]
    image = np.repeat(_cell(box, particles, tri, links, step, blocked), 3, axis=0)
    links = replace(links, after=start + image, before=(end + image)[partner])
    middle = x[i] + links.after * box.size + (r[i] + 0.5 * pairs.gap)[:, None] * pairs.direction
    keep = links.closed | links.cut | pairs.narrow
    lonely = np.bincount(i[keep], minlength=len(x)) == 0
    keep[np.unique(i, return_index=True)[1][lonely]] = True  # gives the disc its periodic image
    return links.take(np.flatnonzero(keep)), pairs.sizes(middle, filled)


def around_walled(box: Box, particles: Particles, filled: float) -> tuple[Links, Float]:
    """Half-links of a box with walls, and its element sizes (k, 3)."""
    x, r, n = particles.x, particles.radius, len(particles)
    outside = np.hypot(*(x - np.clip(x, 0.0, box.size)).T)
    gone = r - outside < filled * r  # hardly anything is inside
    close = close_pairs(box, particles, NARROW * float(r.max()))
    i, j = np.concatenate([close, close[:, ::-1]]).T
    partner = np.roll(np.arange(len(i)), len(close))
    pairs = _Pairs(i, x[j] - x[i], r[i], r[j])
    half = np.where(pairs.closed, pairs.covering(filled * pairs.smaller), 0.0)
    links = _open(i, pairs.angle - half, pairs.angle + half, partner, pairs.closed)
    middle = x[i] + (r[i] + 0.5 * pairs.gap)[:, None] * pairs.direction
    sizes = [pairs.sizes(middle, filled)]
    inside = np.zeros(len(i), dtype=bool)
    for at in (links.low, links.middle, links.high):  # of a bridge at least one end
        point = x[i] + r[i][:, None] * np.column_stack([np.cos(at), np.sin(at)])
        inside |= ((point > 0.0) & (point < box.size)).all(axis=1)
    inside = (inside | inside[partner]) & ~gone[i] & ~gone[j]
    links = links.take(np.flatnonzero(pairs.narrow & inside))

    way = perimeter(box)
    walls = (  # outward normal, distance of each disc, its foot and the ends along the perimeter
        ((-1.0, 0.0), x[:, 0], way[0] + x[:, 1], way[0:2]),
        ((0.0, 1.0), box.height - x[:, 1], way[1] + x[:, 0], way[1:3]),
        ((1.0, 0.0), box.width - x[:, 0], way[3] - x[:, 1], way[2:4]),
        ((0.0, -1.0), x[:, 1], way[4] - x[:, 0], way[3:5]),
    )
    for normal, distance, foot, ends in walls:
        near = np.flatnonzero((distance - r < 0.5 * NARROW * r) & ~gone)
        away = np.where(distance == 0.0, 1e-9 * r, distance)[near, None]  # has a direction
        mirror = _Pairs(near, 2.0 * away * np.array(normal), r[near], r[near])
        middle = x[near] + distance[near, None] * np.array(normal)
        for turn in (1.0, -1.0):
            sizes.append(mirror.sizes(middle, filled, turn) * (1.0, 1.0, 0.5))
        near = near[distance[near] - r[near] < 0.5 * CLOSED * r[near]]
        push = np.where(distance[near] < STEEP * r[near], 0.0, filled * r[near])
        half = np.arccos(np.clip((distance[near] - 0.5 * push) / r[near], -1.0, 1.0))  # Eq. (1)
        angle = np.arctan2(normal[1], normal[0])
        reach = r[near] * np.sin(half)
        tangent = np.array([-normal[1], normal[0]])
        for turn in (1.0, -1.0):  # where a disc ends on a wall, the flow is not smooth
            end = x[near] + distance[near, None] * np.array(normal)
            end = end + turn * reach[:, None] * tangent
            sizes.append(np.column_stack([end, CORNER * r[near]]))
        low = np.clip(foot[near] - reach, *ends) * (TURN / way[-1])
        high = np.clip(foot[near] + reach, *ends) * (TURN / way[-1])
        m = len(near)
        both = _open(
            np.concatenate([near, np.full(m, n)]),
            np.concatenate([angle - half, low]),
            np.concatenate([angle + half, high]),
            np.roll(np.arange(2 * m), m),
            np.ones(2 * m, dtype=bool),
        )
        links = links.join(both.take(np.flatnonzero(np.tile(high > low, 2))))
    # The corners of the wall, and one point on every disc that has no link.
    lonely = np.setdiff1d(np.flatnonzero(~gone), links.owner)
    owner = np.concatenate([np.full(4, n), lonely])
    at = np.concatenate([way[:4] * (TURN / way[-1]), np.zeros(len(lonely))])
    points = _open(owner, at, at, np.full(len(owner), -1), np.zeros(len(owner), dtype=bool))
    return links.join(points), np.concatenate(sizes)


def off_corners(box: Box, particles: Particles) -> Particles:
    """Discs of a box with walls, radii changed by `GRAZING` at most: none grazes a corner."""
    corners = np.array([[0, 0], [0, 1], [1, 1], [1, 0]]) * box.size
    far = np.hypot(*np.moveaxis(particles.x[:, None] - corners, -1, 0))
    r = particles.radius
    for distance in far.T:
        graze = np.abs(distance - r) < GRAZING * r
        r = np.where(graze, distance + np.where(distance < r, GRAZING, -GRAZING) * r, r)
    return particles.with_diameter(2.0 * r)


def perimeter(box: Box) -> Float:
    """Way along the walls to the corners, clockwise from (0, 0) and back to it [m], shape (5,)."""
    return np.cumsum([0.0, box.height, box.width, box.height, box.width])


def _open(owner: Int, low: Float, high: Float, partner: Int, closed: Bool) -> Links:
    """Half-links of a box that is not periodic."""
    zero = np.zeros((len(owner), 2), dtype=np.int64)
    return Links(owner, low, high, partner, closed, zero, zero)


def ordered(links: Links, n: int) -> Links:
    """Half-links in their order round each owner, without those under a bridge."""
    keep = np.flatnonzero(~_covered(links, n))
    middle = np.mod(links.middle[keep], TURN)
    return links.take(keep[np.lexsort((middle, links.owner[keep]))])


def _covered(links: Links, n: int) -> Bool:
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


def _cell(
    box: Box, particles: Particles, tri: Triangulation, links: Links, step: Int, blocked: Bool
) -> Int:
    """Periodic image of each triangle (t, 2) such that no disc lies across a cut of the cell.

    Half-link 3 t + k runs along side k of triangle t. Triangles on the two sides of an edge that a
    disc crosses, or that is `blocked`, stay together as a group; the middle of each group lies in
    the box. A disc that reaches an edge crosses every triangle on its way to it, so it is enough to
    test the discs of a group against the open edges of that group, until none is crossed.
    """
    x, radius, corner = particles.x, particles.radius, tri.shifts.astype(np.int64)
    t, partner, start = len(corner), links.partner, links.after
    home = np.arange(3 * t) // 3
    there = home[partner]
    image = np.zeros((t, 2), dtype=np.int64)
    while True:
        h = np.flatnonzero(blocked)
        graph = coo_array((np.ones(len(h)), (home[h], there[h])), shape=(t, t))
        _, group = connected_components(graph, directed=False)
        image[:] = 0
        placed = np.zeros(t, dtype=bool)
        placed[np.unique(group, return_index=True)[1]] = True
        while not placed.all():  # unfold each group from its first triangle
            new = h[placed[home[h]] & ~placed[there[h]]]
            other = partner[new]
            image[there[new]] = image[home[new]] + start[new] - start[other] - step[other]
            placed[there[new]] = True
        # Edge `row`, from p along u, against the discs at the corners of triangle `inside`.
        h = np.flatnonzero(~links.closed & (group[home] != group[there]))
        members = coo_array((np.ones(t), (group, np.arange(t)))).tocsr()
        which, inside = members[group[home[h]]].tocoo().coords
        row, inside = np.repeat(h[which], 3), np.repeat(inside, 3)
        k = np.tile(np.arange(3), len(which))
        disc = tri.triangles[inside, k]
        i, j = links.owner[row], links.owner[partner[row]]
        p = x[i] + (start[row] + image[home[row]]) * box.size
        u = x[j] - x[i] + step[row] * box.size
        q = x[disc] + (corner[inside, k] + image[inside]) * box.size - p
        s = np.clip((q * u).sum(axis=1) / (u**2).sum(axis=1), 0.0, 1.0)
        far = np.hypot(*(q - s[:, None] * u).T)
        hit = row[(far < CLEARANCE * radius[disc]) & (s > 0.0) & (s < 1.0)]
        if len(hit) == 0:
            break
        blocked = blocked.copy()
        blocked[hit] = blocked[partner[hit]] = True
    centre = (x[tri.triangles] + (corner + image[:, None]) * box.size).mean(axis=1)
    count = np.bincount(group)
    middle = np.column_stack([np.bincount(group, c) / count for c in centre.T])
    moved: Int = image - np.floor(middle / box.size).astype(np.int64)[group]
    return moved
