"""A triangulation that lives on while its particles move: flips first, made anew if need be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from grainmesh.domain import Box
from grainmesh.flips import remove, repair
from grainmesh.particles import Particles
from grainmesh.triangulation import enclose

Float = NDArray[np.float64]
Int = NDArray[np.int32]


@dataclass
class Living:
    """Arrays of a power triangulation that change in place, and what was done to them.

    Parameters
    ----------
    box : Box
    points, weight : (m, 2), (m,)
        Vertices [m], the n particles first, where they are (never wrapped), and weights [m2].
    triangles, neighbours : (t, 3)
        Corners; triangle across the edge opposite each corner, -1 at the boundary.
    shifts : (t, 3, 2)
        Periodic image of each corner, at ``points[triangles] + shifts * box.size``.
    flips, inverted, made : int
        Edges flipped, triangles found turned over, and triangulations made from nothing, so far.
    """

    box: Box
    points: Float
    weight: Float
    triangles: Int
    neighbours: Int
    shifts: Int
    flips: int = 0
    inverted: int = 0
    made: int = 0

    @property
    def period(self) -> Float:
        """Period [m], (2,); zeros for a box with walls."""
        return self.box.size if self.box.periodic else np.zeros(2)

    def follow(self, x: Float) -> None:
        """Take the power triangulation of the particles where they are now, (n, 2) [m]."""
        self.points[: len(x)] = x
        if not self.box.periodic and not self._holds(x):
            self.renew(x)
            return
        flips, inverted, fits = repair(
            self.points, self.weight, self.period, self.triangles, self.neighbours, self.shifts
        )
        self.flips += flips
        self.inverted += inverted
        if not fits:
            self.renew(x)

    def _holds(self, x: Float) -> bool:
        """Whether all centres are more than a radius away from the nodes around them."""
        rim = self.points[len(x) :]
        room = np.sqrt(self.weight.max())
        inside = x.min(axis=0) - rim.min(axis=0), rim.max(axis=0) - x.max(axis=0)
        return bool(min(inside[0].min(), inside[1].min()) > room)

    def renew(self, x: Float) -> None:
        """The same, made from nothing."""
        radius = np.sqrt(self.weight[: len(x)])
        fresh = living(self.box, x, radius)
        for name in ("points", "weight", "triangles", "neighbours", "shifts"):
            setattr(self, name, getattr(fresh, name))
        self.flips += fresh.flips
        self.made += 1

    def drop(self, stay: NDArray[np.bool_]) -> None:
        """Keep only the particles where `stay` (n,) holds; then `follow` where they are now."""
        keep = np.append(stay, np.ones(len(self.points) - len(stay), np.bool_))
        size, gone = remove(
            self.points, self.period, self.triangles, self.neighbours, self.shifts,
            np.flatnonzero(~stay),
        )  # fmt: skip
        self.points, self.weight = self.points[keep], self.weight[keep]
        if not gone:
            self.renew(self.points[: stay.sum()])
            return
        number = np.cumsum(keep, dtype=np.int32) - np.int32(1)
        self.triangles = number[self.triangles[:size]]
        self.neighbours, self.shifts = self.neighbours[:size], self.shifts[:size]

    def renumber(self, new: Int) -> None:
        """Give particle i the number ``new[i]``."""
        n = len(new)
        number = np.concatenate([new, np.arange(n, len(self.points), dtype=np.int32)])
        points, weight = np.empty_like(self.points), np.empty_like(self.weight)
        points[number], weight[number] = self.points, self.weight
        self.points, self.weight = points, weight
        triangles = number[self.triangles]
        order = np.argsort(triangles.min(axis=1), kind="stable")  # near in space, near in memory
        place = np.empty(len(order) + 1, np.int32)
        place[order], place[-1] = np.arange(len(order)), -1
        self.triangles = triangles[order].astype(np.int32)
        self.neighbours = place[self.neighbours[order]]
        self.shifts = np.ascontiguousarray(self.shifts[order])


def living(box: Box, x: Float, radius: Float) -> Living:
    """The power triangulation of discs at `x` (n, 2) [m] of given radii (n,) [m], made to live.

    See `triangulation.enclose`. In a periodic box `x` may lie outside of it.
    """
    mesh, weight = enclose(box, Particles(x, 2.0 * radius))
    points, shifts = np.array(mesh.points), np.array(mesh.shifts)
    points[: len(x)] = x
    if box.periodic:
        # The mesh holds wrapped points: x = points + cell * size.
        cell = np.round((x - mesh.points) / box.size).astype(np.int32)
        shifts = shifts - cell[mesh.triangles]
    found = Living(box, points, weight, np.array(mesh.triangles), np.array(mesh.neighbours), shifts)
    # Made with a tiny strain, it is within a few flips of the exact one.
    found.flips = repair(
        points, weight, found.period, found.triangles, found.neighbours, found.shifts
    )[0]
    return found


__all__ = ["Living", "living"]
