"""The mesh of the flow: a triangulation of the box by its particles, and nodes for the fluid.

Its vertices are the n particles, nodes on the walls (none in a periodic box), and the sites of a
hexagonal lattice of pitch s that stay where they are: candidates, which are in use only where the
fluid has room. With the clearance of a candidate c,

    g_c = min_i (|x_c - x_i| - r_i),                                                          (1)

it comes into use where g_c > 0.9 s and leaves where g_c < 0.5 s (`ROOM`, `NEAR`), so a particle
must move by 0.4 s before a node changes twice. Vertices keep their numbers for ever, in use or not.

All vertices in use make one power triangulation, of weights r² for particles and 0 for nodes. So

- discs that touch are joined by an edge: at a point p of both, |p - x|² - r² <= 0 <= |p - x_c|²,
  no node is nearer;
- no node is hidden: a candidate in use lies outside all discs, in its own cell, and nodes on a line
  that has all points on one side are hidden by none of them.

It is made from the two triangles of the corners, or from the lattice of images of one particle, by
putting in all other vertices (`grainmesh.flips`), and from then on kept by flips. `alone` makes
that of the particles without such nodes, where neighbours are those of the power cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor, isfinite, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.flips import insert, remove, repair
from grainmesh.living import Living
from grainmesh.predicates import orientation

Float = NDArray[np.float64]
Int = NDArray[np.int32]
Bool = NDArray[np.bool_]

#: A candidate is used where it is farther than this from all discs, in spacings.
ROOM = 0.9
#: A node leaves when it is nearer than this to a disc, in spacings.
NEAR = 0.5
#: Spacing of the nodes on walls, in mean diameters, and its least share of sqrt(area/n), the mean
#: distance between particles.
WALL_SPACING, WALL_SPACING_DILUTE = 2.0, 1.0 / 3.0
#: Distance of the rows of a hexagonal lattice, in spacings.
RISE = sqrt(0.75)


@dataclass(kw_only=True)
class Bounded(Living):
    """A living triangulation of the box itself: particles, nodes on walls, nodes in the fluid.

    Parameters
    ----------
    box, points, weight, triangles, neighbours, shifts, flips, inverted, made
        As of `Living`, but the points are [n particles | nodes on walls | candidates], some of
        which are in no triangle.
    in_use : (m,) bool
        Whether each point is a vertex of the triangulation; particles and walls always are.
    rows, columns : int
        Of the lattice of candidates, the last of the points, row by row.
    """

    in_use: Bool
    rows: int
    columns: int

    @property
    def n(self) -> int:
        """Number of particles."""
        return int(np.count_nonzero(self.weight))

    @property
    def spacing(self) -> float:
        """Distance s of neighbours in the lattice of candidates [m]; inf if there are none."""
        if self.rows * self.columns == 0:
            return float("inf")
        return sqrt(float(_pitch(self.box, self.rows, self.columns).prod()) / RISE)

    def move(self, x: Float) -> bool:
        """Move the particles to `x` (n, 2) [m]; whether all triangles still are positive.

        No triangle changes, so another `move` takes it back.
        """
        self.points[: len(x)] = x
        return bool(_positive(self.points, self.period, self.triangles, self.shifts))

    def mend(self) -> bool:
        """Make it the power triangulation of particles and nodes again; whether a triangle changed.

        Nodes that particles come near leave, others come into use where there is room.

        Raises
        ------
        InputError
            If a particle has left the box, or the discs overlap so much that one is hidden.
        """
        before = self.flips
        out, into = self._changes()
        some, fits = len(out) > 0 or len(into) > 0, True
        if some:
            positive = _positive(self.points, self.period, self.triangles, self.shifts)
            fits = (positive or self._repair()) and self._take_out(out) and self._put_in(into)
        if not (fits and self._repair()):
            self.renew(self.points[: self.n])
            return True
        return some or self.flips > before

    def follow(self, x: Float) -> None:
        """Move the particles to `x` (n, 2) [m], and `mend`."""
        self.points[: len(x)] = x
        self.mend()

    def renew(self, x: Float) -> None:
        """The same, made from nothing.

        Raises
        ------
        InputError
            As `mend`.
        """
        n = len(x)
        self.points[:n] = x
        self._inside(x)
        out, into = self._changes()
        self.in_use[out], self.in_use[into] = False, True
        corners, self.triangles, self.neighbours, self.shifts = _start(self.box, n)
        rest = self.in_use.copy()
        rest[corners] = False
        order = np.flatnonzero(rest)
        order = order[np.argsort(_along_a_curve(self.points[order], self.box.size), kind="stable")]
        if not self._put_in(order):
            name = order[~np.isin(order, self.triangles)][0]
            raise InputError(
                f"particle {name} has no place in the triangulation: another has the same centre "
                "or covers it, remove one of them"
            )
        if not self._repair():
            raise InputError(self._deepest())
        self.made += 1

    def drop(self, stay: Bool) -> None:
        """Keep only the particles where `stay` (n,) holds; then `follow` where they are now."""
        self.in_use = np.concatenate([self.in_use[: len(stay)][stay], self.in_use[len(stay) :]])
        super().drop(stay)

    def _changes(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Nodes in use that particles are near, and candidates not in use that have room."""
        s, first = self.spacing, len(self.points) - self.rows * self.columns
        clearance = np.empty(0)
        if isfinite(s):
            pitch = _pitch(self.box, self.rows, self.columns)
            sites = self.box.periodic, self.rows, self.columns, self.points[first], pitch
            clearance = _clearance(
                self.points[: self.n], np.sqrt(self.weight[: self.n]), *sites, ROOM * s
            )
        used = self.in_use[first:]
        out = np.flatnonzero(used & (clearance < NEAR * s))
        into = np.flatnonzero(~used & (clearance > ROOM * s))
        return first + out, first + into

    def _take_out(self, vertices: NDArray[np.int64]) -> bool:
        if len(vertices) == 0:
            return True
        arrays = self.triangles, self.neighbours, self.shifts
        size, gone = remove(self.points, self.period, *arrays, vertices)
        self.triangles, self.neighbours, self.shifts = (array[:size] for array in arrays)
        self.in_use[vertices] = not gone  # made anew, it asks again
        return bool(gone)

    def _put_in(self, vertices: NDArray[np.int64]) -> bool:
        if len(vertices) == 0:
            return True
        size = len(self.triangles)
        arrays = [
            np.concatenate([array, np.empty((2 * len(vertices), *array.shape[1:]), np.int32)])
            for array in (self.triangles, self.neighbours, self.shifts)
        ]
        size, put = insert(self.points, self.weight, self.period, *arrays, size, vertices)
        self.triangles, self.neighbours, self.shifts = (array[:size] for array in arrays)
        self.in_use[vertices] = True
        return bool(put == len(vertices))

    def _repair(self) -> bool:
        flips, inverted, fits = repair(
            self.points, self.weight, self.period, self.triangles, self.neighbours, self.shifts
        )
        self.flips += flips
        self.inverted += inverted
        return bool(fits)

    def _inside(self, x: Float) -> None:
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


def bounded(box: Box, x: Float, radius: Float, spacing: float | None = None) -> Bounded:
    """The triangulation of a box by discs at `x` (n, 2) [m] of radii (n,) [m], and its nodes.

    Parameters
    ----------
    box : Box
        With walls: corners, and nodes evenly spaced on each side, two at least, about 2 mean
        diameters apart, sqrt(area/n)/3 if that is more, `spacing` if that is less. Periodic: no
        nodes on walls, and `x` may lie in any image of the box.
    x, radius : (n, 2), (n,)
        Centres, strictly inside if the box has walls, and radii.
    spacing : float, optional
        Distance of nodes for the fluid where there are no particles [m]; None for no such nodes.

    Returns
    -------
    Bounded

    Raises
    ------
    InputError
        A centre outside, two at one place, a disc hidden behind others, a spacing that is not
        positive.
    """
    rows = columns = 0
    if spacing is not None:
        if not (isfinite(spacing) and spacing > 0.0):
            raise InputError(f"spacing {spacing:g} m of fluid nodes must be a positive number")
        rows, columns = _count(box, spacing)
    nodes = np.vstack([x, _on_walls(box, radius, spacing)])
    return _made(box, nodes, radius, _candidates(box, rows, columns), rows, columns)


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
    return _made(box, points, radius, np.empty((0, 2)), 0, 0)


def _made(
    box: Box, used: Float, radius: Float, candidates: Float, rows: int, columns: int
) -> Bounded:
    """The triangulation of points in use, the first of which are discs, made from nothing."""
    points = np.vstack([used, candidates])
    weight = np.zeros(len(points))
    weight[: len(radius)] = radius**2
    none = np.empty((0, 3), np.int32)
    mesh = Bounded(
        box, points, weight, none, none, np.empty((0, 3, 2), np.int32),
        in_use=np.arange(len(points)) < len(used), rows=rows, columns=columns,
    )  # fmt: skip
    mesh.renew(used[: len(radius)].copy())
    mesh.flips = mesh.made = 0
    return mesh


def _on_walls(box: Box, radius: Float, spacing: float | None) -> Float:
    """Nodes on walls (k, 2) [m], the four corners first."""
    if box.periodic:
        return np.empty((0, 2))
    aim = max(
        WALL_SPACING * 2.0 * float(radius.mean()),
        WALL_SPACING_DILUTE * sqrt(box.area / len(radius)),
    )
    if spacing is not None:
        aim = min(aim, spacing)
    return _around(box.size, aim)


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


def _count(box: Box, spacing: float) -> tuple[int, int]:
    """Rows and columns of a lattice that fits into the box, its pitch near `spacing` [m]."""
    width, height = box.size / spacing
    if box.periodic:
        return 2 * max(1, round(0.5 * height / RISE)), max(1, round(width))
    return max(0, round((height - 1.0) / RISE + 1.0)), max(0, round(width - 0.5))


def _pitch(box: Box, rows: int, columns: int) -> Float:
    """Distance of columns and of rows [m], (2,): with walls, these are half a spacing away."""
    if box.periodic:
        return np.array([box.width / columns, box.height / rows])
    return np.array([box.width / (columns + 0.5), box.height / (rows - 1.0 + 1.0 / RISE)])


def _candidates(box: Box, rows: int, columns: int) -> Float:
    """Sites of the lattice (k, 2) [m], row by row; odd rows are half a pitch further on."""
    if rows * columns == 0:
        return np.empty((0, 2))
    pitch = _pitch(box, rows, columns)
    row, column = np.divmod(np.arange(rows * columns), columns)
    return pitch * np.stack([column + 0.5 * (row % 2) + 0.5, row + 0.5 / RISE], axis=1)


@njit(cache=True)
def _clearance(x, radius, periodic, rows, columns, origin, pitch, most):  # type: ignore[no-untyped-def]
    """Eq. (1) for the candidates, the first at `origin`; inf where it is more than `most`."""
    g = np.full(rows * columns, np.inf)
    for i in range(len(x)):
        reach = radius[i] + most
        low = ceil((x[i, 1] - reach - origin[1]) / pitch[1])
        high = floor((x[i, 1] + reach - origin[1]) / pitch[1])
        if not periodic:
            low, high = max(low, 0), min(high, rows - 1)
        for row in range(low, high + 1):
            start = origin[0] + 0.5 * (row % 2) * pitch[0]
            dy = origin[1] + row * pitch[1] - x[i, 1]
            left = ceil((x[i, 0] - reach - start) / pitch[0])
            right = floor((x[i, 0] + reach - start) / pitch[0])
            if not periodic:
                left, right = max(left, 0), min(right, columns - 1)
            for column in range(left, right + 1):
                dx = start + column * pitch[0] - x[i, 0]
                c = (row % rows) * columns + column % columns
                g[c] = min(g[c], sqrt(dx * dx + dy * dy) - radius[i])  # Eq. (1)
    return g


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
