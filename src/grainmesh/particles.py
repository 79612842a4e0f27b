"""Discs: positions, diameters, densities, and the checks they must pass in a box."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.plain import plain, spread

#: Discs that overlap by more than this share of the smaller radius are refused.
MAX_OVERLAP = 0.3
#: The same across a periodic edge: more overlap there says that the data are not periodic.
MAX_OVERLAP_ACROSS = 1e-3

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Particles:
    """Discs of unit depth.

    Parameters
    ----------
    x : array_like, shape (n, 2)
        Centres [m].
    diameter : array_like, shape () or (n,)
        Diameters [m].
    density : array_like, shape () or (n,)
        Densities [kg/m3].

    Raises
    ------
    InputError
        If a value is no number or not finite, a diameter or density not positive, a shape wrong,
        or there is no particle at all.
    """

    x: Float
    diameter: Float
    density: Float = 1000.0  # type: ignore[assignment]

    def __init__(self, x: ArrayLike, diameter: ArrayLike, density: ArrayLike = 1000.0) -> None:
        centres = _numbers("particle centres", x)
        if centres.ndim != 2 or centres.shape[1] != 2 or len(centres) == 0:
            raise InputError(f"particle centres need shape (n, 2) with n > 0, got {centres.shape}")
        if not np.isfinite(centres).all():
            i = int(np.flatnonzero(~np.isfinite(centres).all(axis=1))[0])
            raise InputError(f"particle {i}: centre ({centres[i, 0]}, {centres[i, 1]}) not finite")
        centres.setflags(write=False)
        object.__setattr__(self, "x", centres)
        for name, values in (("diameter", diameter), ("density", density)):
            given = _numbers(name, values)
            if given.ndim != 0 and given.shape != (len(centres),):
                raise InputError(f"{name} needs one value or {len(centres)}, got {given.shape}")
            array = np.array(np.broadcast_to(given, (len(centres),)))
            bad = np.flatnonzero(~(np.isfinite(array) & (array > 0.0)))
            if len(bad):
                raise InputError(f"particle {bad[0]}: {name} {array[bad[0]]:g} must be positive")
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.x)

    def __repr__(self) -> str:
        return (
            f"Particles: {len(self)}, d = {spread(self.diameter, 'm')}, "
            f"density {spread(self.density, 'kg/m³')}"
        )

    def to_dict(self) -> dict[str, Any]:
        """As plain numbers, ready for JSON: lists of x, diameter and density."""
        found: dict[str, Any] = plain(vars(self))
        return found

    @property
    def radius(self) -> Float:
        """Radii [m], shape (n,)."""
        return 0.5 * self.diameter

    @property
    def mean_diameter(self) -> float:
        """Mean diameter [m], the length of every normalised permeability K/d2."""
        return float(self.diameter.mean())

    def with_diameter(self, diameter: ArrayLike) -> Particles:
        """The same particles with other diameters [m]."""
        return Particles(self.x, diameter, self.density)

    def select(self, keep: NDArray[np.bool_]) -> Particles:
        """The particles where `keep`, a boolean array of shape (n,), holds."""
        return Particles(self.x[keep], self.diameter[keep], self.density[keep])


def _numbers(name: str, values: ArrayLike) -> Float:
    """A copy as floats; text with a unit is for case files."""
    try:
        return np.array(values, dtype=float)
    except (TypeError, ValueError):
        text = repr(values)
        shown = text if len(text) <= 40 else "what was given"
        raise InputError(
            f"{name}: {shown} is no number or array of numbers: give SI units"
        ) from None


def close_pairs(box: Box, particles: Particles, gap: float) -> NDArray[np.int64]:
    """Pairs whose surfaces are closer than `gap` [m], shape (m, 2); periodic images count.

    A particle so close to its own periodic image is listed as the pair (i, i).
    """
    x, r = box.wrapped(particles.x), particles.radius
    reach = 2.0 * float(r.max()) + gap
    # A tree over a torus needs reach below half the box; smaller boxes get their images in full.
    if box.periodic and reach >= 0.5 * float(box.size.min()):
        layers = np.ceil(reach / box.size).astype(int)
        shifts = np.stack(
            np.meshgrid(*(np.arange(-k, k + 1) for k in layers), indexing="ij"), axis=-1
        ).reshape(-1, 2)
        images = (x[None] + (shifts * box.size)[:, None]).reshape(-1, 2)
        owner = np.tile(np.arange(len(x)), len(shifts))
        centre = np.flatnonzero((shifts == 0).all(axis=1))[0] * len(x)
        near = cKDTree(x).query_ball_tree(cKDTree(images), reach)
        i = np.repeat(np.arange(len(x)), [len(k) for k in near])
        k = np.concatenate([np.asarray(k, dtype=int) for k in near])
        distance = np.linalg.norm(images[k] - x[i], axis=1)
        keep = (k != centre + i) & (i <= owner[k]) & (distance < r[i] + r[owner[k]] + gap)
        return np.unique(np.stack([i[keep], owner[k[keep]]], axis=1), axis=0)
    tree = cKDTree(x, boxsize=box.size if box.periodic else None)
    pairs = tree.query_pairs(reach, output_type="ndarray")
    distance = np.linalg.norm(box.separation(x[pairs[:, 0]], x[pairs[:, 1]]), axis=1)
    found: NDArray[np.int64] = pairs[distance < r[pairs].sum(axis=1) + gap].astype(np.int64)
    return found[np.lexsort((found[:, 1], found[:, 0]))]


def touches(box: Box, particles: Particles) -> NDArray[np.bool_]:
    """Whether some part of each disc lies inside the box, shape (n,)."""
    nearest = np.clip(particles.x, 0.0, box.size)
    inside: NDArray[np.bool_] = (
        np.linalg.norm(particles.x - nearest, axis=1) < particles.radius
    ) | (particles.x == nearest).all(axis=1)
    return inside


def settle(box: Box, particles: Particles) -> Particles:
    """The particles as every method uses them: checked, and wrapped into a periodic box.

    One rule for the edge of a box with walls: of a disc that the edge cuts, the part inside counts;
    a disc wholly outside is refused.

    Raises
    ------
    InputError
        Disc wholly outside the box, duplicate centres, overlap beyond `MAX_OVERLAP` of the smaller
        radius or beyond `MAX_OVERLAP_ACROSS` across a periodic edge (the pair is named), or a disc
        too large for a periodic box.
    """
    if box.periodic:
        particles = Particles(box.wrapped(particles.x), particles.diameter, particles.density)
    else:
        outside = np.flatnonzero(~touches(box, particles))
        if len(outside):
            i = outside[0]
            raise InputError(
                f"particle {i} at ({particles.x[i, 0]:g}, {particles.x[i, 1]:g}) m lies outside "
                f"the box {box.width:g} m x {box.height:g} m: enlarge the box or drop what lies "
                "outside (--crop)"
            )
    _refuse_overlap(
        particles,
        close_pairs(replace(box, periodic=False), particles, -MAX_OVERLAP * particles.radius.min()),
        np.zeros(2),
        MAX_OVERLAP,
    )
    if box.periodic:
        # Half of the eight images around the box: the other half shows the same pairs.
        for shift in np.array([[1, 0], [0, 1], [1, 1], [1, -1]]) * box.size:
            _refuse_overlap(particles, _pairs_across(particles, shift), shift, MAX_OVERLAP_ACROSS)
    return particles


def _pairs_across(particles: Particles, shift: Float) -> NDArray[np.int64]:
    """Pairs (i, j) where disc i may touch disc j moved by `shift`, shape (m, 2)."""
    x, reach = particles.x, 2.0 * particles.radius.max()
    moved = x + shift
    low, high = x.min(axis=0) - reach, x.max(axis=0) + reach
    j = np.flatnonzero(((low < moved) & (moved < high)).all(axis=1))
    low, high = low + shift, high + shift
    i = np.flatnonzero(((low < x) & (x < high)).all(axis=1))
    near = cKDTree(x[i]).query_ball_tree(cKDTree(moved[j]), reach)
    first = np.repeat(i, [len(k) for k in near])
    second = j[np.concatenate([np.asarray(k, dtype=int) for k in near])] if near else first
    return np.stack([first, second], axis=1)


def _refuse_overlap(
    particles: Particles, pairs: NDArray[np.int64], shift: Float, most: float
) -> None:
    """Raise if discs i and j, j moved by `shift`, overlap by more than `most` of the smaller."""
    if len(pairs) == 0:
        return
    x, r = particles.x, particles.radius
    i, j = pairs.T
    distance = np.linalg.norm(x[j] + shift - x[i], axis=1)
    overlap = (r[i] + r[j] - distance) / np.minimum(r[i], r[j])
    worst = int(np.argmax(overlap))
    a, b = int(i[worst]), int(j[worst])
    if a != b and distance[worst] <= 1e-9 * r[a]:
        raise InputError(
            f"particles {a} and {b} have the same centre ({x[a, 0]:g}, {x[a, 1]:g}) m: remove one"
        )
    if overlap[worst] <= most:
        return
    if a == b:
        raise InputError(
            f"particle {a} overlaps its own image across the periodic edge: enlarge the box, "
            "reduce the diameter, or drop --periodic"
        )
    across = ", across the periodic edge" if shift.any() else ""
    raise InputError(
        f"particles {a} and {b} overlap by {100 * overlap[worst]:.3g} % of the smaller radius"
        f"{across}; at most {100 * most:g} % is taken: correct the centres, reduce the diameters"
        + (", or drop --periodic" if across else "")
    )


__all__ = ["MAX_OVERLAP", "MAX_OVERLAP_ACROSS", "Particles", "close_pairs", "settle", "touches"]
