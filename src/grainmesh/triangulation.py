"""The triangulation of the particles: contact graph, finite-element mesh, gaps and porosity.

Particle i is vertex i. Vertices are joined to a triangle where three power cells meet
(`grainmesh.cells`, Eq. 1): the Delaunay triangulation for equal discs, the regular (power,
Laguerre) triangulation for unequal ones, which joins discs in contact also where their sizes
differ much. Reading the triangles from the cells needs no images of a periodic box and no special
case for one, two or three particles.

Where four cells meet in one point, as on a square lattice, either diagonal is right, but all cells
must take the same. So the cells are built from separations under a homogeneous strain of 1e-7
(`STRAIN`), which is the same for all points and images: the choice becomes unique and the same in
every image. Coordinates are kept as they are.

The gap measure of Yazdchi, Srivastava and Luding (Powders & Grains 2013), with d the mean diameter
and s_ij the distance between the surfaces of the discs i and j,

    γ = <min over the sides of a triangle of s_ij> / d,    mean over the triangles,           (1)

is the pitch over d minus 1 for both lattices of equal discs. Close to it,

    γ_2 = <second smallest of s_ij over the neighbours j of i> / d,    mean over particles i. (2)

The porosity of a triangle shares the solid V_j of each cell by the angles α at the vertex j,

    ε_T = 1 - sum_j (α_Tj / sum_T' α_T'j) V_j / A_T,                                          (3)

which is 1 - sum_j α_j r_j² / (2 A_T) for whole discs. It can be negative, and
sum (1 - ε_T) A_T = sum V_j always.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from grainmesh.cells import Cells, diagram
from grainmesh.domain import SIDES, Box
from grainmesh.errors import InputError
from grainmesh.particles import Particles

Float = NDArray[np.float64]
Int = NDArray[np.int32]
Bool = NDArray[np.bool_]
T = TypeVar("T", bound=np.generic)

#: Corners of the unit square.
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
#: Strain that decides between the diagonals of a square: far above round-off, far below any gap.
STRAIN = (1.1e-7, 0.7e-7)
#: A particle closer to a wall than this share of its diameter becomes a point of the wall.
WALL_LAYER = 0.25
#: Spacing of the nodes on the walls: in mean diameters, and its least share of the mean distance
#: between particles, sqrt(area/n), which takes over beyond a porosity of 0.98.
WALL_SPACING, WALL_SPACING_DILUTE = 2.0, 1.0 / 3.0


@dataclass(frozen=True, eq=False)
class Triangulation:
    """Triangles between particles and wall nodes; each triangle of a periodic box once.

    Parameters
    ----------
    box : Box
    particles : Particles
        With centres inside the box if it is periodic.
    points : (m, 2)
        Vertices [m]: first the n particles, in their order, then the wall nodes. A particle outside
        the box or closer to a wall than `WALL_LAYER` diameters stands at the nearest point of the
        wall, so that no sliver arises; gaps are taken from its true centre.
    triangles : (t, 3)
        Corners, counter-clockwise.
    shifts : (t, 3, 2)
        Periodic image of each corner: it lies at ``points[triangles] + shifts * box.size``.
    """

    box: Box
    particles: Particles
    points: Float
    triangles: Int
    shifts: Int

    def __post_init__(self) -> None:
        for array in (self.points, self.triangles, self.shifts):
            array.setflags(write=False)

    def __repr__(self) -> str:
        return (
            f"Triangulation: {len(self.triangles)} triangles of {self.n} particles and "
            f"{len(self.points) - self.n} nodes on walls"
        )

    @property
    def n(self) -> int:
        """Number of particles."""
        return len(self.particles)

    @cached_property
    def corners(self) -> Float:
        """Coordinates of the corners of each triangle [m], (t, 3, 2)."""
        return _fixed(self.points[self.triangles] + self.shifts * self.box.size)

    @cached_property
    def areas(self) -> Float:
        """Area of each triangle [m2], (t,)."""
        a, b, c = np.moveaxis(self.corners, 1, 0)
        return _fixed(0.5 * _cross(b - a, c - a))

    @cached_property
    def angles(self) -> Float:
        """Angle at each corner of each triangle [rad], (t, 3)."""
        ahead = np.roll(self.corners, -1, axis=1) - self.corners
        back = np.roll(self.corners, 1, axis=1) - self.corners
        return _fixed(np.arctan2(2.0 * self.areas[:, None], (ahead * back).sum(axis=-1)))

    @cached_property
    def _graph(self) -> tuple[Int, Int, Int, Int]:
        """Edges (e, 2), their shifts (e, 2), edges of triangles (t, 3) and neighbours (t, 3)."""
        return _graph(self.triangles, self.shifts)

    @property
    def edges(self) -> Int:
        """Pairs of vertices joined by an edge, first <= second, (e, 2)."""
        return self._graph[0]

    @property
    def edge_shifts(self) -> Int:
        """Periodic image of the second end of each edge seen from the first, (e, 2)."""
        return self._graph[1]

    @property
    def triangle_edges(self) -> Int:
        """Edge opposite each corner of each triangle, (t, 3)."""
        return self._graph[2]

    @property
    def neighbours(self) -> Int:
        """Triangle across the edge opposite each corner, -1 at the boundary, (t, 3)."""
        return self._graph[3]

    @cached_property
    def edge_lengths(self) -> Float:
        """Length of each edge, between the vertices as they stand in the mesh [m], (e,)."""
        a, b = self.points[self.edges.T]
        return _fixed(np.hypot(*(b + self.edge_shifts * self.box.size - a).T))

    @cached_property
    def gaps(self) -> Float:
        """Distance between the surfaces of the two discs of each edge [m], (e,).

        From true centres; negative where discs overlap, nan where an end is a wall node.
        """
        gaps = np.full(len(self.edges), np.nan)
        pair = (self.edges < self.n).all(axis=1)
        i, j = self.edges[pair].T
        x, r = self.particles.x, self.particles.radius
        away = x[j] + self.edge_shifts[pair] * self.box.size - x[i]
        gaps[pair] = np.hypot(*away.T) - r[i] - r[j]
        return _fixed(gaps)

    @cached_property
    def wall_edges(self) -> Int:
        """Edges of the boundary as pairs of vertices, the inside on their left, (b, 2)."""
        t, k = np.nonzero(self.neighbours < 0)
        return _fixed(np.stack([self.triangles[t, k - 2], self.triangles[t, k - 1]], axis=1))

    @cached_property
    def wall_sides(self) -> Int:
        """Side of the box of each of the `wall_edges`, an index into `domain.SIDES`, (b,).

        -1 for an edge that is not on a wall; there is none if the walls have nodes.
        """
        ends = self.points[self.wall_edges]
        side = np.full(len(ends), -1, np.int32)
        for s in range(len(SIDES)):
            axis, wall = s // 2, (0.0, self.box.size[s // 2])[s % 2]
            side[(ends[:, :, axis] == wall).all(axis=1)] = s
        return _fixed(side)

    @cached_property
    def _shortest(self) -> Float:
        """Smallest gap of each triangle of three particles [m]."""
        full = (self.triangles < self.n).all(axis=1)
        if not full.any():
            raise InputError(
                "no triangle joins three particles, so there is no mean gap: at least 3 particles "
                "that are not in one row are needed"
            )
        return _fixed(self.gaps[self.triangle_edges[full]].min(axis=1))

    @property
    def gap_shortest(self) -> float:
        """γ, Eq. (1): mean of the smallest gap of each triangle of three particles, over d."""
        return float(self._shortest.mean() / self.particles.mean_diameter)

    @property
    def gap_scatter(self) -> float:
        """Standard deviation of the smallest gap of a triangle over its mean; 0 for a lattice."""
        mean, deviation = self._shortest.mean(), self._shortest.std()
        if deviation <= 1e-12 * self.particles.mean_diameter:  # round-off, also where discs touch
            return 0.0
        return float(deviation / mean)

    @cached_property
    def gap_of_particle(self) -> Float:
        """Second smallest gap of each particle to a neighbour, over d, (n,).

        nan for a particle with fewer than two particles as neighbours.
        """
        pair = (self.edges < self.n).all(axis=1)
        gap = _second_smallest(self.edges[pair], self.gaps[pair], self.n)
        return _fixed(gap / self.particles.mean_diameter)

    @property
    def gap_second(self) -> float:
        """γ_2, Eq. (2): mean second smallest gap of a particle, over d."""
        if np.isnan(self.gap_of_particle).all():
            raise InputError("no particle has two neighbours, so there is no second gap")
        return float(np.nanmean(self.gap_of_particle))

    def vertex_porosity(self, cells: Cells) -> Float:
        """Porosity of each vertex, (m,).

        Of its cell for a particle; at a wall node the mean of the particles joined to it, or 1.
        """
        m = len(self.points)
        value = np.ones(m)
        value[: self.n] = cells.porosity
        ends = np.vstack([self.edges, self.edges[:, ::-1]])
        node, particle = ends[(ends[:, 0] >= self.n) & (ends[:, 1] < self.n)].T
        count = np.bincount(node, minlength=m)
        total = np.bincount(node, value[particle], minlength=m)
        np.divide(total, count, out=value, where=count > 0)
        return value

    def triangle_porosity(self, cells: Cells) -> Float:
        """Porosity of each triangle, Eq. (3), (t,); can be negative, conserves the solid."""
        weight = np.zeros(len(self.points))
        turn = np.bincount(self.triangles.ravel(), self.angles.ravel(), minlength=len(weight))
        weight[: self.n] = cells.solid / turn[: self.n]
        solid: Float = (self.angles * weight[self.triangles]).sum(axis=1)
        return 1.0 - solid / self.areas


def triangulate(box: Box, particles: Particles, *, wall_nodes: bool = True) -> Triangulation:
    """Power triangulation of particles and wall nodes.

    Parameters
    ----------
    box : Box
        Periodic: the torus is triangulated, any number of particles. Walls: the rectangle.
    particles : Particles
        Discs that touch the box and do not hide each other (see `particles.settle`).
    wall_nodes : bool
        Put nodes on the walls: the corners, and nodes about 2 d apart (more where particles are
        few: one particle in a square has 12 triangles, as the paper's Fig. 3) that are moved
        along the wall by up to d/2 to where the nearest disc is farthest away, at most d/2. The
        mesh is then the whole box. All points on walls have the power weight of the smallest disc.
        False: particles alone, at their true centres, joined where their power cells meet inside
        the box enlarged on each side by half of its longer side.

    Returns
    -------
    Triangulation

    Raises
    ------
    InputError
        A particle hidden behind others, or particles at one place.
    """
    if box.periodic:
        particles = Particles(box.wrapped(particles.x), particles.diameter, particles.density)
    points, on_wall = np.array(particles.x), np.zeros(len(particles), dtype=bool)
    if wall_nodes and not box.periodic:
        points, on_wall = _at_walls(box, particles)
        nodes = _wall_nodes(box, points, particles)
        points = np.vstack([points, nodes])
        on_wall = np.concatenate([on_wall, np.ones(len(nodes), dtype=bool)])
    # One weight for all that is on a wall: no wall point can then hide another, nor a particle.
    weight = np.full(len(points), particles.radius.min() ** 2)
    weight[: len(particles)] = particles.radius**2
    weight[on_wall] = particles.radius.min() ** 2

    return _connect(box, particles, points, weight, whole=box.periodic or wall_nodes)


def enclose(box: Box, particles: Particles) -> tuple[Triangulation, Float]:
    """Power triangulation of all particles, wherever they are, with their own weights r².

    Parameters
    ----------
    box : Box
        Only its period counts, if it is periodic.
    particles : Particles

    Returns
    -------
    mesh : Triangulation
        Periodic, or of a rectangle around all particles, with room to move, and a few nodes on its
        edge.
    weight : (m,)
        Power weights of the vertices [m2], 0 for those nodes: so all discs that touch are
        joined, also at the outer edge.

    Raises
    ------
    InputError
        As `triangulate`.
    """
    weight = particles.radius**2
    if box.periodic:
        inside = Particles(box.wrapped(particles.x), particles.diameter, particles.density)
        return _connect(box, inside, np.array(inside.x), weight, whole=True), weight
    low, high = particles.x.min(axis=0), particles.x.max(axis=0)
    # Nodes farther away make large cells, slow to find; closer ones would be too many.
    margin = max(20.0 * float(particles.diameter.max()), 0.02 * float((high - low).max()))
    around = Box(*(high - low + 2.0 * margin))
    nodes = [CORNERS * around.size]
    for axis in (0, 1):  # closer than they are to the particles, for well-shaped triangles
        along = np.linspace(0.0, around.size[axis], int(around.size[axis] / margin) + 2)[1:-1]
        for wall in (0.0, around.size[1 - axis]):
            line = np.full((len(along), 2), wall)
            line[:, axis] = along
            nodes.append(line)
    points = np.vstack([particles.x - low + margin, *nodes])
    weight = np.concatenate([weight, np.zeros(len(points) - len(weight))])
    mesh = _connect(around, particles, points, weight, whole=True)
    return replace(mesh, points=points - margin + low), weight


def _connect(
    box: Box, particles: Particles, points: Float, weight: Float, whole: bool
) -> Triangulation:
    """Triangles where three power cells meet; `whole`: they must cover the box."""
    margin = 4.0 * float(particles.diameter.max()) if whole else 0.5 * float(box.size.max())
    for attempt in range(8):
        window = np.array([-np.ones(2) * margin, box.size + margin])
        strain = ((1 + attempt) * STRAIN[0], STRAIN[1])
        found = diagram(box, points, weight, np.zeros(len(points)), window, strain)
        hidden = np.flatnonzero(found.area[: len(particles)] <= 0.0)
        if len(hidden):
            raise InputError(
                f"particle {hidden[0]} is hidden behind the discs around it: they overlap too much,"
                " correct the centres or reduce the diameters"
            )
        triangles, shifts, agreed = _meetings(found.start, found.neighbour, found.shift)
        mesh = Triangulation(box, particles, points, triangles, shifts)
        if agreed and (not whole or _fills(mesh)):
            return mesh
        margin *= 8.0  # a flat triangle at a wall has its three cells meet far outside
    raise InputError(
        "the particles have no valid triangulation: two of them share a place, remove one"
    )


def _fills(mesh: Triangulation) -> bool:
    """Whether the triangles cover the box exactly once."""
    if len(mesh.triangles) == 0 or not (mesh.areas > 0.0).all():
        return False
    if abs(mesh.areas.sum() - mesh.box.area) > 1e-10 * mesh.box.area:
        return False
    if len(np.unique(mesh.triangles)) != len(mesh.points):
        return False
    if mesh.box.periodic:
        return len(mesh.triangles) == 2 * mesh.n and bool((mesh.neighbours >= 0).all())
    return bool((mesh.wall_sides >= 0).all())


def _meetings(start: NDArray[np.int64], other: Int, shift: Int) -> tuple[Int, Int, bool]:
    """Triangles (t, 3) with shifts (t, 3, 2) where three cells meet; whether all three agree.

    Each meeting appears in three cells. It is kept in the cell of its smallest corner, by number
    and then by image, which is a rule that no change of the image alters.
    """
    cell = np.repeat(np.arange(len(start) - 1), np.diff(start))
    ahead = np.arange(1, len(cell) + 1)
    ahead[start[1:] - 1] = start[:-1]
    meets = (other >= 0) & (other[ahead] >= 0)
    later = (shift[:, 0] > 0) | ((shift[:, 0] == 0) & (shift[:, 1] > 0))
    larger = (other > cell) | ((other == cell) & later)
    keep = np.flatnonzero(meets & larger & larger[ahead])
    triangles = np.stack([cell[keep], other[keep], other[ahead[keep]]], axis=1).astype(np.int32)
    shifts = np.stack([np.zeros_like(shift[keep]), shift[keep], shift[ahead[keep]]], axis=1)
    return triangles, shifts, int(meets.sum()) == 3 * len(keep)


def _graph(triangles: Int, shifts: Int) -> tuple[Int, Int, Int, Int]:
    """Edges, edge shifts, edges of triangles and neighbours, see `Triangulation`."""
    i, j = np.roll(triangles, -1, axis=1).ravel(), np.roll(triangles, -2, axis=1).ravel()
    shift = (np.roll(shifts, -2, axis=1) - np.roll(shifts, -1, axis=1)).reshape(-1, 2)
    back = (i > j) | ((i == j) & ((shift[:, 0] < 0) | ((shift[:, 0] == 0) & (shift[:, 1] < 0))))
    shift[back] *= -1
    i, j = np.where(back, j, i), np.where(back, i, j)
    # One integer a side: both ends and the image.
    m, s = int(triangles.max(initial=0)) + 1, int(np.abs(shift).max(initial=0))
    if m * m * (2 * s + 1) ** 2 >= 2**63:
        raise InputError("too many particles in a box too narrow to number its edges")
    key = (i.astype(np.int64) * m + j) * (2 * s + 1) + shift[:, 0] + s
    key = key * (2 * s + 1) + shift[:, 1] + s
    order = np.argsort(key, kind="stable")
    new = np.ones(len(key), dtype=bool)
    new[1:] = np.diff(key[order]) != 0
    first = order[new]
    edge = np.empty(len(key), np.int32)
    edge[order] = np.cumsum(new) - 1
    across = np.full(len(key), -1, np.int32)
    second = np.flatnonzero(~new)
    across[order[second]] = order[second - 1] // 3
    across[order[second - 1]] = order[second] // 3
    edges = np.stack([i[first], j[first]], axis=1).astype(np.int32)
    return (
        _fixed(edges),
        _fixed(shift[first]),
        _fixed(edge.reshape(-1, 3)),
        _fixed(across.reshape(-1, 3)),
    )


def _at_walls(box: Box, particles: Particles) -> tuple[Float, Bool]:
    """Particles moved to the wall where they are near it, (n, 2), and which, (n,)."""
    x = particles.x
    depth = np.minimum(x, box.size - x)  # below the nearer wall of each direction, (n, 2)
    near = depth < WALL_LAYER * particles.diameter[:, None]
    # A corner takes the nearest particle; others near it go to one wall only.
    corner = np.flatnonzero(near.all(axis=1))
    name = (x[corner] > 0.5 * box.size) @ np.array([1, 2])
    order = np.lexsort((np.hypot(*depth[corner].T), name))
    spare = corner[order][1:][np.diff(name[order]) == 0]
    near[spare, np.argmax(depth[spare], axis=1)] = False
    near |= depth < 0.0
    walls = np.where(x > 0.5 * box.size, box.size, 0.0)
    return np.where(near, walls, x), np.asarray(near.any(axis=1))


def _wall_nodes(box: Box, points: Float, particles: Particles) -> Float:
    """Nodes on the walls [m], (k, 2): free corners, and nodes in between as `triangulate` says."""
    d = particles.mean_diameter
    aim = max(WALL_SPACING * d, WALL_SPACING_DILUTE * float(np.sqrt(box.area / len(particles))))
    corners = CORNERS * box.size
    taken = (corners[:, None] == points).all(axis=-1).any(axis=1)
    nodes = [corners[~taken]]
    tree, nearest = cKDTree(points), np.arange(1, min(8, len(points)) + 1)
    trial = np.linspace(0.0, 1.0, 11)[1:]
    trial = np.concatenate([[0.0], np.stack([trial, -trial], axis=1).ravel()])  # the middle first
    for axis in (0, 1):
        for wall in (0.0, box.size[1 - axis]):
            on = points[:, 1 - axis] == wall
            held = np.unique(np.concatenate([[0.0, box.size[axis]], points[on, axis]]))
            length = np.diff(held)
            parts = np.ceil(length / aim - 0.25).clip(1.0).astype(int)
            spacing = np.repeat(length / parts, parts - 1)
            number = np.arange(len(spacing)) - np.repeat(
                np.cumsum(parts - 1) - parts + 1, parts - 1
            )
            middle = np.repeat(held[:-1], parts - 1) + (number + 1) * spacing
            along = middle[:, None] + np.minimum(0.5 * d, 0.25 * spacing)[:, None] * trial
            place = np.empty((*along.shape, 2))
            place[..., axis], place[..., 1 - axis] = along, wall
            distance, disc = tree.query(place, k=nearest)
            room = (distance - particles.radius[disc]).min(axis=-1)
            # d/2 of room is enough: moving on would only stretch the triangle on the other side.
            best = np.argmax(np.minimum(room, 0.5 * d), axis=1)
            nodes.append(place[np.arange(len(place)), best])
    return np.vstack(nodes)


@njit(cache=True)
def _second_smallest(edges, gaps, n):  # type: ignore[no-untyped-def]
    """Second smallest gap at each of n particles, nan if there are fewer than two."""
    low = np.full((n, 2), np.inf)
    for e in range(len(edges)):
        for i in edges[e]:
            if gaps[e] < low[i, 0]:
                low[i, 0], low[i, 1] = gaps[e], low[i, 0]
            elif gaps[e] < low[i, 1]:
                low[i, 1] = gaps[e]
    return np.where(np.isinf(low[:, 1]), np.nan, low[:, 1])


def _cross(a: Float, b: Float) -> Float:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _fixed(array: NDArray[T]) -> NDArray[T]:
    array.setflags(write=False)
    return array


__all__ = ["Triangulation", "enclose", "triangulate"]
