"""The mesh of the flow: a triangulation of the box by its particles, and nodes for the fluid.

Its vertices are the n particles, nodes on the walls (none in a periodic box), and nodes inside. How
far apart these are is a field, from s at particles and walls to S, with the distance l from both:

    h = min(S, s + l/4),                                                                      (1)

and the room of a place c is the radius of the largest circle about it that is at right angles to
discs or farther out, has no node in it, and none of its own image behind a wall,

    g_c² = min(|x_c - x_i|² - r_i², |x_c - x_node|², 4 l_wall²).                               (2)

A node comes in where g_c > 0.75 h and leaves where g_c < 0.45 h (`ROOM`, `NEAR`). The places with
most room are the centres of such circles of three corners of a triangle, so they are all that is
looked at, and who has least room for a node are its neighbours. Where S = s angles of triangles
between nodes are therefore above asin(0.45/1.5) = 17 degrees, however the particles move.

Nodes go along with the particles: each moves as its neighbours do on average, in `SWEEPS` sweeps
from rest (in a periodic box, from the mean motion). Where no particle moves no node does.

All vertices in use make one power triangulation, of weights r² for particles and 0 for nodes. So

- discs that touch are joined by an edge: at a point p of both, |p - x|² - r² <= 0 <= |p - x_c|²,
  no node is nearer;
- no node is hidden: inside it lies outside all discs, in its own cell, and nodes on a line that has
  all points on one side are hidden by none of them.

It is made from the two triangles of the corners, or from the lattice of images of one particle, by
putting in all other vertices (`grainmesh.flips`), and from then on kept by flips. `alone` makes
that of the particles without such nodes, where neighbours are those of the power cells. Vertices
keep their numbers; those of nodes that have left are given away again, the oldest first.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, log, pi, sqrt
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from grainmesh.clearance import GROWTH, carried, covered, crowded, openings, sizes
from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.flips import insert, remove, repair
from grainmesh.living import Living
from grainmesh.predicates import orientation

Float = NDArray[np.float64]
Int = NDArray[np.int32]
Bool = NDArray[np.bool_]
Spacing = float | tuple[float, float] | None

#: Spacing of the nodes on walls, in mean diameters, and its least share of sqrt(area/n), the mean
#: distance between particles.
WALL_SPACING, WALL_SPACING_DILUTE = 2.0, 1.0 / 3.0
#: Numbers for nodes inside, over how many are asked for, and most of these.
SPARE, MANY = 1.5, 1e6


@dataclass(kw_only=True)
class Bounded(Living):
    """A living triangulation of the box itself: particles, nodes on walls, nodes in the fluid.

    Parameters
    ----------
    box, points, weight, triangles, neighbours, shifts, flips, inverted, made
        As of `Living`, but the points are [n particles | nodes on walls | nodes inside], some of
        which are in no triangle.
    in_use : (m,) bool
        Whether each point is a vertex of the triangulation; particles and walls always are.
    spacing : (2,)
        s and S of Eq. (1) [m].
    inside : int
        How many of the points, the last ones, are for nodes inside.
    given : int
        Which of them was the last to be given away.
    """

    in_use: Bool
    spacing: Float
    inside: int
    given: int = -1

    @property
    def n(self) -> int:
        """Number of particles."""
        return int(np.count_nonzero(self.weight))

    @property
    def first(self) -> int:
        """The first of the points for nodes inside."""
        return len(self.points) - self.inside

    def carried(self, values: Float) -> Float:
        """Velocities of the particles or the like (n, 2), and of nodes that go along (m, 2)."""
        found = np.zeros((len(self.points), 2))
        if self.box.periodic:
            found[:] = values.mean(axis=0)
        found[: len(values)] = values
        if self.inside:
            carried(self.triangles, self.first, found)
        return found

    def move(self, x: Float) -> bool:
        """Move the particles to `x` (n, 2) [m], and nodes; whether all triangles are positive.

        No triangle changes.
        """
        self.points += self.carried(x - self.points[: len(x)])
        self.points[: len(x)] = x
        return bool(_positive(self.points, self.period, self.triangles, self.shifts))

    def mend(self) -> bool:
        """Make it the power triangulation of particles and nodes again; whether a triangle changed.

        Nodes that have no room leave, others come in where there is room.

        Raises
        ------
        InputError
            If a particle has left the box, or the discs overlap so much that one is hidden.
        """
        before, free = self.flips, self._free
        if not self._repair():
            self.renew(self.points[: self.n])
            return True
        out = self._crowded()
        fits = len(out) == 0 or (self._take_out(out) and self._repair())
        put = self._fill(free) if fits else 0
        if not (fits and (put == 0 or self._repair())):
            self.renew(self.points[: self.n], free)
            return True
        return len(out) > 0 or put > 0 or self.flips > before

    def follow(self, x: Float) -> None:
        """Move the particles to `x` (n, 2) [m], and `mend`."""
        self.points[: len(x)] = x
        self.mend()

    def renew(self, x: Float, free: NDArray[np.int64] | None = None) -> None:
        """The same, made from nothing, with the nodes inside that have room.

        Others get numbers that are free at present, or these.

        Raises
        ------
        InputError
            As `mend`.
        """
        n, first = len(x), self.first
        self.points[:n] = x
        self._within(x)
        free = self._free if free is None else free[~self.in_use[free]]
        nodes = self.points[first:]
        if not self.box.periodic:
            self.in_use[first:] &= ((nodes > 0.0) & (nodes < self.box.size)).all(axis=1)
        some = np.flatnonzero(self.in_use[first:])
        radius = np.sqrt(self.weight[:n])
        self.in_use[first + some] = ~covered(nodes[some], x, radius, self.period)
        self._build(n)
        while len(out := self._crowded()):
            self.in_use[out] = False
            self._build(n)
        self._fill(free)
        if not self._repair():
            raise InputError(self._deepest())
        self.made += 1

    def _build(self, n: int) -> None:
        """The triangulation of the points in use, of which n are particles, or raise."""
        corners, self.triangles, self.neighbours, self.shifts = _start(self.box, n)
        rest = self.in_use.copy()
        rest[corners] = False
        order = np.flatnonzero(rest)
        order = order[np.argsort(_along_a_curve(self.points[order], self.box.size), kind="stable")]
        if self._put_in(order) < len(order):
            name = order[~np.isin(order, self.triangles)][0]
            raise InputError(
                f"particle {name} has no place in the triangulation: another has the same centre "
                "or covers it, remove one of them"
            )
        if not self._repair():
            raise InputError(self._deepest())

    def drop(self, stay: Bool) -> None:
        """Keep only the particles where `stay` (n,) holds; then `follow` where they are now."""
        self.in_use = np.concatenate([self.in_use[: len(stay)][stay], self.in_use[len(stay) :]])
        super().drop(stay)

    @property
    def _free(self) -> NDArray[np.int64]:
        """Numbers for nodes inside that are not in use, those longest so first."""
        number = self.first + np.roll(np.arange(self.inside), -1 - self.given)
        free: NDArray[np.int64] = number[~self.in_use[number]]
        return free

    @property
    def _about(self) -> tuple[Any, ...]:
        """What `grainmesh.clearance` looks at."""
        return (
            self.points, np.sqrt(self.weight), self.box.size, self.period, self.triangles,
            self.shifts,
        )  # fmt: skip

    def _sizes(self) -> Float:
        """h of Eq. (1) (m,)."""
        found: Float = sizes(*self._about, self.first, *self.spacing)
        return found

    def _crowded(self) -> NDArray[np.int64]:
        """Nodes that are to leave."""
        if self.inside == 0:
            return np.empty(0, np.int64)
        return np.flatnonzero(crowded(*self._about, self.first, self._sizes()))

    def _fill(self, free: NDArray[np.int64]) -> int:
        """Put nodes of these numbers where there is room, as far as they go; how many."""
        total = 0
        while len(free):
            places = self._openings()[: len(free)]
            some, free = free[: len(places)], free[len(places) :]
            self.points[some] = places
            put = self._put_in(some)
            total += put
            if put == 0:
                break
            self.given = int(some[put - 1]) - self.first
        return total

    def _openings(self) -> Float:
        """Places (k, 2) [m] where nodes have room at once, that with most of it first."""
        places: Float
        places, room, wanted = openings(*self._about, *self.spacing, self._sizes())
        if len(places) < 2:
            return places
        order = np.argsort(-room, kind="stable")
        places, wanted = places[order], wanted[order]
        around = self.box.size if self.box.periodic else None
        tree = cKDTree(self.box.wrapped(places), boxsize=around)
        taken = np.zeros(len(places), bool)
        for c, near in enumerate(tree.query_ball_point(tree.data, wanted)):
            taken[c] = not taken[near].any()
        return places[taken]

    def _take_out(self, vertices: NDArray[np.int64]) -> bool:
        arrays = self.triangles, self.neighbours, self.shifts
        size, gone = remove(self.points, self.period, *arrays, vertices)
        self.triangles, self.neighbours, self.shifts = (array[:size] for array in arrays)
        self.in_use[vertices] = not gone  # made anew, it asks again
        return bool(gone)

    def _put_in(self, vertices: NDArray[np.int64]) -> int:
        """How many could be put in."""
        size = len(self.triangles)
        arrays = [
            np.concatenate([array, np.empty((2 * len(vertices), *array.shape[1:]), np.int32)])
            for array in (self.triangles, self.neighbours, self.shifts)
        ]
        size, put = insert(self.points, self.weight, self.period, *arrays, size, vertices)
        self.triangles, self.neighbours, self.shifts = (array[:size] for array in arrays)
        self.in_use[vertices[:put]] = True
        return int(put)

    def _repair(self) -> bool:
        flips, inverted, fits = repair(
            self.points, self.weight, self.period, self.triangles, self.neighbours, self.shifts
        )
        self.flips += flips
        self.inverted += inverted
        return bool(fits)

    def _within(self, x: Float) -> None:
        """Raise if a centre is not strictly inside a box with walls."""
        inside = np.isfinite(x) & (self.box.periodic | ((x > 0.0) & (x < self.box.size)))
        out = np.flatnonzero(~inside.all(axis=1))
        if len(out):
            i = out[0]
            raise InputError(
                f"particle {i} at ({x[i, 0]:g}, {x[i, 1]:g}) m is not inside the box of the flow, "
                f"{self.box.width:g} m x {self.box.height:g} m: move it or enlarge the box"
            )

    def _deepest(self) -> str:
        """Which two discs overlap most, of a triangulation that is not to be had."""
        ends, hops = self.triangles, self.shifts
        i, j = np.roll(ends, -1, 1).ravel(), np.roll(ends, -2, 1).ravel()
        hop = (np.roll(hops, -2, 1) - np.roll(hops, -1, 1)).reshape(-1, 2)
        away = np.hypot(*(self.points[j] + hop * self.period - self.points[i]).T)
        reach = np.sqrt(self.weight)
        worst = int(np.argmax(reach[i] + reach[j] - away))
        a, b = sorted((int(i[worst]), int(j[worst])))
        return (
            f"particles {a} and {b} overlap by {reach[a] + reach[b] - away[worst]:.3g} m, so that "
            "one is hidden behind others: correct the centres or reduce the diameters"
        )


def bounded(box: Box, x: Float, radius: Float, spacing: Spacing = None) -> Bounded:
    """The triangulation of a box by discs at `x` (n, 2) [m] of radii (n,) [m], and its nodes.

    Parameters
    ----------
    box : Box
        With walls: corners, and nodes evenly spaced on each side, two at least, about 2 mean
        diameters apart, sqrt(area/n)/3 if that is more, `spacing` if that is less. Periodic: no
        nodes on walls, and `x` may lie in any image of the box.
    x, radius : (n, 2), (n,)
        Centres, strictly inside if the box has walls, and radii.
    spacing : float or (float, float), optional
        Distance of nodes for the fluid where there are no particles [m]; two: beside particles and
        walls, and far from them. None for no such nodes.

    Returns
    -------
    Bounded

    Raises
    ------
    InputError
        A centre outside, two at one place, a disc hidden behind others, a spacing that is not
        positive or makes too many nodes.
    """
    two, count = np.full(2, np.inf), 0.0
    if spacing is not None:
        two[:] = spacing
        if not (np.isfinite(two).all() and 0.0 < two[0] <= two[1]):
            raise InputError(
                f"spacing {spacing} m of fluid nodes must be a positive number, or two that ascend"
            )
        count = _asked(box, radius, *two.tolist())
        if not count < MANY:
            raise InputError(
                f"fluid: a spacing of {two[0]:g} m makes {count:.1g} nodes in this box: check the "
                "unit, or take a larger one"
            )
    nodes = np.vstack([x, _on_walls(box, radius, float(two[0]))])
    return _made(box, nodes, radius, two, ceil(SPARE * count))


def _asked(box: Box, radius: Float, near: float, far: float) -> float:
    """How many nodes a lattice of pitch h has at most, however discs of radii (n,) [m] lie.

    It has 2/√3 dA/h²: by Eq. (1) no more than with h = S everywhere and what each disc, where
    dA = 2π (r + l) dl, and the walls would have alone; nor more than with h = s everywhere.
    """
    dense = box.area / near / near
    if near < far:
        wide, less = 1.0 / GROWTH, 1.0 / near - 1.0 / far
        discs = (float(radius.sum()) - len(radius) * wide * near) * less
        discs = 2.0 * pi * wide * (discs + len(radius) * wide * log(far / near))
        walls = 0.0 if box.periodic else 2.0 * (box.width + box.height) * wide * less
        dense = min(dense, box.area / far / far + discs + walls)
    return dense / sqrt(0.75)


def alone(box: Box, x: Float, radius: Float, reach: float) -> Bounded:
    """The power triangulation of discs alone, for all places within `reach` of their centres.

    Parameters
    ----------
    box, x, radius
        As of `bounded`.
    reach : float
        With walls, nodes stand around the box, farther than this [m] from all that is inside.

    Returns
    -------
    Bounded

    Raises
    ------
    InputError
        As `bounded`, or a reach that is not positive.
    """
    if not reach > 0.0:
        raise InputError(f"the reach of the particles is {reach:g} m, it must be positive")
    points = np.array(x)
    if not box.periodic:
        margin = min(1.1 * reach, 2.0 * float(np.hypot(*box.size)))
        margin = max(margin, 0.02 * float(box.size.max()))  # else they were too many
        around = _around(box.size + 2.0 * margin, margin)
        points = np.vstack([x, around - margin])
    return _made(box, points, radius, np.full(2, np.inf), 0)


def _made(box: Box, used: Float, radius: Float, spacing: Float, inside: int) -> Bounded:
    """The triangulation of points in use, the first of which are discs, made from nothing."""
    points = np.vstack([used, np.zeros((inside, 2))])
    weight = np.zeros(len(points))
    weight[: len(radius)] = radius**2
    none = np.empty((0, 3), np.int32)
    mesh = Bounded(
        box, points, weight, none, none, np.empty((0, 3, 2), np.int32),
        in_use=np.arange(len(points)) < len(used), spacing=spacing, inside=inside,
    )  # fmt: skip
    mesh.renew(used[: len(radius)].copy())
    mesh.flips = mesh.made = 0
    return mesh


def _on_walls(box: Box, radius: Float, spacing: float) -> Float:
    """Nodes on walls (k, 2) [m], the four corners first."""
    if box.periodic:
        return np.empty((0, 2))
    aim = max(
        WALL_SPACING * 2.0 * float(radius.mean()),
        WALL_SPACING_DILUTE * sqrt(box.area / len(radius)),
    )
    return _around(box.size, min(aim, spacing))


def _around(size: Float, pitch: float) -> Float:
    """Points (k, 2) on the sides of a rectangle from the origin on, the four corners first."""
    width, height = size
    nodes = [np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])]
    for axis in (0, 1):
        parts = max(3, round(size[axis] / pitch))
        along = np.linspace(0.0, size[axis], parts + 1)[1:-1]
        for wall in (0.0, size[1 - axis]):
            line = np.full((len(along), 2), wall)
            line[:, axis] = along
            nodes.append(line)
    return np.vstack(nodes)


@njit(cache=True)
def _positive(points, period, triangles, shifts):  # type: ignore[no-untyped-def]
    """Whether all triangles are positive, exactly."""
    for t in range(len(triangles)):
        a = np.int64(triangles[t, 0]), np.int64(shifts[t, 0, 0]), np.int64(shifts[t, 0, 1])
        b = np.int64(triangles[t, 1]), np.int64(shifts[t, 1, 0]), np.int64(shifts[t, 1, 1])
        c = np.int64(triangles[t, 2]), np.int64(shifts[t, 2, 0]), np.int64(shifts[t, 2, 1])
        if orientation(points, period, a, b, c) <= 0:
            return False
    return True


def _start(box: Box, n: int) -> tuple[list[int], Int, Int, Int]:
    """Two triangles to begin with: their vertices, and the arrays of a triangulation."""
    shifts = np.zeros((2, 3, 2), np.int32)
    if box.periodic:  # the first particle and its images
        shifts[0], shifts[1] = [[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]
        return [0], np.zeros((2, 3), np.int32), np.array([[1] * 3, [0] * 3], np.int32), shifts
    corners = np.array([[n, n + 1, n + 2], [n, n + 2, n + 3]], np.int32)
    beyond = np.array([[-1, 1, -1], [-1, -1, 0]], np.int32)
    return list(range(n, n + 4)), corners, beyond, shifts


def _along_a_curve(points: Float, size: Float) -> NDArray[np.int64]:
    """Keys that sort points so that the next one is near: Morton's curve, (k,)."""
    square = (np.mod(points / size, 1.0) * 2**16).astype(np.int64)
    key = np.zeros(len(points), np.int64)
    for bit in range(16):
        for axis in (0, 1):
            key |= ((square[:, axis] >> bit) & 1) << (2 * bit + axis)
    return key


__all__ = ["Bounded", "alone", "bounded"]
