"""What the sides of the box do to the flow: which unknowns are given there, and their values."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from grainmesh.carry import Keys, Topology
from grainmesh.domain import SIDES, Box
from grainmesh.element import PAIRS
from grainmesh.medium import Fluid, Inflow, NoSlip, Outlet, Slip

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Mask = NDArray[np.bool_]
#: Edges (b, 2) of each side: number of a triangle, and 0, 1 or 2 for its edge 01, 02 or 12.
Edges = dict[str, Int]


def edges_of(box: Box, on: Topology, points: Float, neighbours: NDArray[Any]) -> Edges:
    """The edges of each side of a box with walls; none of a periodic one."""
    if box.periodic:
        return {}
    t, k = np.divmod(np.flatnonzero(neighbours < 0), 3)
    which = 2 - (on.corners[t] < on.triangles[t, k][:, None]).sum(axis=1)
    ends, found = points[on.corners[t[:, None], PAIRS[which]]], {}
    for number, side in enumerate(SIDES):
        axis, end = divmod(number, 2)
        there = (ends[:, :, axis] == end * box.size[axis]).all(axis=1)
        found[side] = np.column_stack([t, which])[there]
    return found


def held(fluid: Fluid, edges: Edges, own: Keys, other: Keys) -> tuple[Mask, Mask, Int, Int]:
    """Unknowns of velocity (size, 2) and pressure (size,) that are given; outlets and inlets."""
    u, p = np.zeros((own.size, 2), dtype=bool), np.zeros(other.size, dtype=bool)
    none = np.empty((0, 2), np.int64)
    out, into = [none], [none]
    for number, (side, on) in enumerate(edges.items()):
        kind, axis, rows = fluid.side(side), number // 2, unknowns(own, on)
        if isinstance(kind, Slip):
            u[rows, axis] = True
        elif isinstance(kind, Outlet):
            u[rows, 1 - axis] = True
            p[unknowns(other, on)] = True
            out.append(on)
        else:
            u[rows] = True
            into.append(on)
    return u, p, np.concatenate(out), np.concatenate(into)


def given(
    fluid: Fluid, edges: Edges, own: Keys, other: Keys, points: Float, porosity: Float, time: float
) -> tuple[Float, Float, Float]:
    """Velocity (size, 2) [m/s], pressure (size,) [Pa], and what flows in, ε u (size, 2)."""
    u, through, p = np.zeros((own.size, 2)), np.zeros((own.size, 2)), np.zeros(other.size)
    along = np.linspace(0.0, 1.0, fluid.order + 1)[:, None]
    # At corners walls have the last word.
    for side in sorted(edges, key=lambda side: isinstance(fluid.side(side), NoSlip)):
        kind, on = fluid.side(side), edges[side]
        ends = own.topology.corners[on[:, :1], PAIRS[on[:, 1]]]
        if isinstance(kind, Outlet):
            p[ends] = kind.pressure
        elif isinstance(kind, NoSlip):
            value = np.zeros((len(ends), fluid.order + 1, 2))
            value[..., 1 - SIDES.index(side) // 2] = kind.speed
            u[unknowns(own, on)] = own.element.from_edge @ value
        elif isinstance(kind, Inflow):
            a, b = points[ends[:, 0], None], points[ends[:, 1], None]
            place = (1.0 - along) * a + along * b  # (b, k + 1, 2)
            volume = kind.at(place.reshape(-1, 2), time).reshape(place.shape)
            eps = (1.0 - along[:, 0]) * porosity[ends[:, :1]] + along[:, 0] * porosity[ends[:, 1:]]
            u[unknowns(own, on)] = own.element.from_edge @ (volume / eps[..., None])
            # All of it, though walls hold the fluid at corners.
            through[unknowns(own, on)] = own.element.from_edge @ volume
    return u, p, through


def unknowns(keys: Keys, edges: Int) -> Int:
    """Unknowns of the two ends and of the edge, for edges (b, 2) of triangles, (b, k + 1)."""
    t, k = edges.T
    found: Int = keys.rows[t[:, None], keys.element.ends[k]]
    return found


__all__ = ["Edges", "edges_of", "given", "held", "unknowns"]
