"""Discs that overlap at the start, pushed apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from grainmesh.errors import InputError
from grainmesh.measure import wall_overlaps
from grainmesh.model import Model, fixed_of
from grainmesh.motion import R
from grainmesh.pairs import Near, walls_closer
from grainmesh.particles import Particles, close_pairs, touches
from grainmesh.walls import table

#: Overlap that may stay, in smaller radii, and rounds to get there.
SMALL, ROUNDS = 1e-2, 2000
#: Push of each disc in its overlap, small for the many neighbours, and what is kept of the last.
PUSH, KEEP = 0.2, 0.9


def relax(model: Model, particles: Particles, fixed: ArrayLike | None = None) -> Particles:
    """Discs pushed apart, and off the walls of a model, until hardly any overlap is left.

    Each round pushes all discs that overlap apart, and keeps part of the last push (a heavy ball).

    Parameters
    ----------
    model : Model
    particles : Particles
    fixed : array_like, optional
        Particles that stay where they are, as in `Simulation`, whatever they overlap each other.

    Returns
    -------
    Particles
        With overlaps of at most 1 % of the smaller radius.

    Raises
    ------
    InputError
        If a particle lies outside the box, or `ROUNDS` do not suffice: the discs do not fit.
    """
    if not isinstance(model, Model) or not isinstance(particles, Particles):
        raise InputError("relax takes a grainmesh.Model, then grainmesh.Particles")
    box, r = model.box, particles.radius
    held = fixed_of(fixed, len(r))
    for i in np.flatnonzero(~touches(box, particles)) if not box.periodic else ():
        raise InputError(f"relax: particle {i} lies outside the box: check the unit, or drop it")
    walls = table(model.all_walls, 0.0)
    moved = np.zeros((len(walls), 6))
    state = np.zeros((len(r), 12))
    state[:, R] = r
    x, step, worst = np.array(particles.x), np.zeros((len(r), 2)), np.inf
    still = np.append(np.where(held, -np.inf, 0.0), np.zeros(len(walls)))  # fixed meet no wall
    angle = np.arange(len(r))  # where discs that share a place are pushed to
    period = box.size if box.periodic else np.zeros(2)
    for _ in range(ROUNDS):
        found = close_pairs(box, Particles(x, 2.0 * r), 0.0)
        i, j = found[(found[:, 0] != found[:, 1]) & ~held[found].all(axis=1)].T
        away = box.separation(x[i], x[j])
        distance = np.hypot(*away.T)
        same = distance < 1e-9 * r[i]
        away[same] = np.stack([np.cos(angle[j[same]]), np.sin(angle[j[same]])], axis=1)
        distance[same] = 1.0
        overlap = r[i] + r[j] - np.where(same, 0.0, distance)
        start, wall, image = walls_closer(x, r, period, still, walls, moved)
        none = np.zeros((len(wall), 1))
        owner = np.repeat(np.arange(len(r), dtype=np.int32), np.diff(start))
        near = Near(start, owner, wall, image, image * period, none[:, 0], none[:, 0], none)
        state[:, :2] = x
        depth, normal = wall_overlaps(state, near, walls, moved)
        share = np.concatenate([overlap / np.minimum(r[i], r[j]), depth / r[owner]])
        worst = float(share.max(initial=0.0))
        if worst <= SMALL:
            return Particles(x, particles.diameter, particles.density)
        # A little too far, or many discs in a pile would take for ever.
        push = (PUSH * (overlap + 0.5 * SMALL * r.min()) / distance)[:, None] * away
        step *= KEEP
        np.add.at(step, j, push)
        np.add.at(step, i, -push)
        np.add.at(step, owner, -2.0 * PUSH * np.maximum(depth, 0.0)[:, None] * normal)
        step[held] = 0.0
        x += step
    raise InputError(
        f"relax: discs still overlap by {100.0 * worst:.3g} % of a radius, they do not fit: "
        "enlarge the box or reduce the diameters"
    )


__all__ = ["relax"]
