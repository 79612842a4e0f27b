"""The state a simulation starts from, and what is refused."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from grainmesh.contact import FEWEST_STEPS, STEPS, below
from grainmesh.errors import InputError
from grainmesh.model import Model
from grainmesh.motion import HS, HX, HY, IJ, IM, VS, VX, VY, R
from grainmesh.pairs import WAY
from grainmesh.particles import Particles, close_pairs
from grainmesh.walls import Wall

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Mask = NDArray[np.bool_]

#: Most overlap of discs, or of a disc and a wall, at the start, in (smaller) radii.
MOST_AT_START = 0.05
#: The same of two fixed discs; `pairs` needs no more.
MOST_OF_FIXED = 0.3
#: Longest way of a disc or wall in one step, in smallest radii: then none jumps over another, and
#: overlaps that grow until the next upkeep do not pass a radius, so that edges show them (`pairs`).
FARTHEST = 0.5 * WAY
#: Least mass per unit depth [kg/m]: squares of its inverse are finite.
LIGHTEST = 1e-150


def state_of(
    particles: Particles, velocity: ArrayLike, spin: ArrayLike, dt: float, fixed: Mask
) -> tuple[Float, Float]:
    """State (n, 12) and constants (n, 6) of discs, see `motion`; arguments as of `Simulation`."""
    n, radius = len(particles), particles.radius
    mass = particles.density * np.pi * particles.diameter**2 / 4.0
    s, p = np.zeros((n, 12)), np.zeros((n, 6))
    s[:, :2], s[:, R] = particles.x, radius
    p[:, IM], p[:, IJ] = 1.0 / mass, 2.0 / mass  # I = m r²/2
    s[:, [HX, HY]] = rows("velocity", velocity, n)
    s[:, HS] = radius * rows("spin", spin, n, width=None)
    p[fixed] = 0.0
    s[np.flatnonzero(fixed)[:, None], [HX, HY, HS]] = 0.0
    speed = np.hypot(s[:, HX], s[:, HY])
    i, farthest = int(np.argmax(speed)), FARTHEST * radius.min()
    if speed[i] * dt > farthest:
        raise InputError(
            f"particle {i} is too fast, {speed[i]:.3g} m/s, for its contacts: check the unit, or "
            f"raise the stiffness, to {stiffness_for(speed[i], mass[i], radius.min())} N/m2 perhaps"
        )
    s[:, [VX, VY, VS]] = s[:, [HX, HY, HS]]
    return s, p


def stiffness_for(speed: float, mass: float, least: float) -> str:
    """Stiffness [N/m2] at which a disc that hits a wall overlaps by a tenth of the least radius."""
    with np.errstate(over="ignore"):
        return f"{mass * np.square(speed / (0.1 * least)):.1g}"


def rows(
    name: str, given: ArrayLike, n: int, width: int | None = 2, ids: Int | None = None
) -> Float:
    """Numbers as (n, 2), from (n, 2) or (2,), or with no width as (n,), from (n,) or a scalar.

    `ids` (n,) are the numbers of the particles, if not 0 to n - 1.
    """
    one, many = (() if width is None else (width,)), ((n,) if width is None else (n, width))
    try:
        value = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be numbers of shape {many} or {one}") from None
    if value.shape not in (one, many):
        raise InputError(f"{name} needs shape {many} or {one}, got {value.shape}")
    bad = np.flatnonzero(~np.isfinite(np.broadcast_to(value, many)).reshape(n, -1).all(axis=1))
    if len(bad):
        who = bad[0] if ids is None else ids[bad[0]]
        raise InputError(f"{name} of particle {who} is not finite")
    return np.broadcast_to(value, many)


def law_of(model: Model) -> Float:
    """Numbers of the contact law and gravity as `motion.advance` takes them."""
    c = model.contact
    springs = c.stiffness, c.tangential * c.stiffness, c.tangential_damping
    return np.array([*springs, c.friction, *model.gravity])


def step_of(model: Model, particles: Particles, fixed: Mask) -> float:
    """Step of a model [s], refused if too large for the lightest pair or overdamped ones."""
    mass = particles.density * np.pi * particles.diameter**2 / 4.0
    mass = np.sort(mass if fixed.all() else mass[~fixed])
    if mass[0] < LIGHTEST:
        raise InputError(
            f"the lightest particle has a mass of {mass[0]:.3g} kg/m, too small to compute with: "
            "check the units of diameter and density"
        )
    pair = mass[0] * mass[min(1, len(mass) - 1)] / (mass[0] + mass[min(1, len(mass) - 1)])
    model.contact.contact_time(mass[-1])  # the heaviest, on a wall, is damped most
    # Dashpots see velocities foretold, stable for rates below 1/Δt; a disc that spins among six
    # others is damped at 12 c_t/m, and twice the normal damping at most adds up in one direction.
    c = float(model.contact.coefficient(np.array([pair]))[0])
    strongest = max(model.contact.tangential_damping, 0.5) * c
    stable = pair / (12.0 * strongest) if strongest > 0.0 else np.inf
    most = min(model.contact.contact_time(pair) / FEWEST_STEPS, stable)
    good = min(model.contact.contact_time(pair) / STEPS, 0.5 * stable)
    if model.dt is None:
        return good
    if model.dt > most:
        raise InputError(
            f"model: dt = {model.dt:g} s is too large for contacts that last "
            f"{model.contact.contact_time(pair):.3g} s: at most {below(most)} s, better "
            f"{below(good)} s"
        )
    return model.dt


def refuse_fast_walls(walls: tuple[Wall, ...], speeds: Float, dt: float, least: float) -> None:
    """Raise if a wall moves too far in a step of `dt`; `least` is the smallest radius [m]."""
    for wall, speed in zip(walls, speeds, strict=True):
        if speed * dt > FARTHEST * least:
            raise InputError(
                f"the wall from {wall.start} to {wall.end} is too fast, {speed:.3g} m/s, for the "
                f"step of {dt:.3g} s: at most {below(FARTHEST * least / speed)} s (Model(dt=...))"
            )


def refuse_overlap(model: Model, particles: Particles, fixed: Mask) -> None:
    """Raise if discs overlap by more than `MOST_AT_START`, or fixed ones by `MOST_OF_FIXED`."""
    r = particles.radius
    found = close_pairs(model.box, particles, 0.0)
    if (found[:, 0] == found[:, 1]).any():
        raise InputError("the box is too small: a particle touches its own periodic image")
    i, j = found.T
    distance = np.hypot(*model.box.separation(particles.x[i], particles.x[j]).T)
    share = (r[i] + r[j] - distance) / np.minimum(r[i], r[j])
    most = np.where(fixed[i] & fixed[j], MOST_OF_FIXED, MOST_AT_START)
    worst = int(np.argmax(share / most)) if len(share) else 0
    if len(share) and share[worst] > most[worst]:
        raise InputError(
            f"particles {i[worst]} and {j[worst]} overlap by {100 * share[worst]:.3g} % of the "
            f"smaller radius, {100 * most[worst]:g} % is taken at the start: move them apart "
            "(grainmesh.relax(model, particles) does)"
        )


__all__ = [
    "FARTHEST",
    "MOST_AT_START",
    "MOST_OF_FIXED",
    "law_of",
    "refuse_fast_walls",
    "refuse_overlap",
    "rows",
    "state_of",
    "step_of",
]
