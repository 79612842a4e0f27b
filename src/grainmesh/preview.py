"""What a case will be like, before it runs: the regime, the cost, and what is off.

With b the drag on a disc (`grainmesh.drag`), V its volume and m its mass per unit depth, ε the
porosity about it and Δρ the difference of densities, discs and fluid pass each other in balance at
the superficial velocity

    U = ε w,   b(w, ε) w = ε V Δρ g,                                                          (1)

since the pressure gradient that holds up the bed acts on the disc itself, too. It is the settling
velocity of a suspension in a closed box, and in a bed at rest that of minimum fluidisation. A bed
in an upward flow grows to the porosity at which Eq. (1) gives that flow.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, hypot, inf, isfinite, nan, pi, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from grainmesh.case import Case
from grainmesh.closures import LAWS, ClosureWarning
from grainmesh.domain import SIDES, Box
from grainmesh.drag import Bed, Drag, Permeability
from grainmesh.errors import InputError
from grainmesh.history import places
from grainmesh.particles import Particles, settle
from grainmesh.sections import PermeabilitySection
from grainmesh.stream import FluidSection, Inflow, NoSlip, Outlet

if TYPE_CHECKING:
    from grainmesh.simulation import Simulation

#: Rough constants, measured on one slow core with beds of 400 to 10 000 grains: seconds of a step
#: of one disc, and of a step of the flow per unknown; MiB of the program, and more per unknown,
#: the factor of the matrix included.
DISC_STEP, FLOW_STEP, PROGRAM, UNKNOWN = 4e-8, 2.5e-6, 320.0, 3e-3
#: Of methods for particles at rest: unknowns and seconds of a disc.
RESTING = {"resolved": (1000, 1e-2), "mesoscale": (10, 3e-4), "microstructure": (0, 2e-5)}
#: Porosity of settled discs, and Reynolds number up to which laws without inertia will do.
SETTLED, CREEPING = 0.18, 10.0
#: Overlaps in smallest radii that are too deep: as discs meet, and under the weight of the bed.
MEETING, RESTING_OVERLAP = 0.2, 0.03
#: Longest way in a step of the flow in diameters, and how much of the longest step is taken: steps
#: are powers of two of those of the contacts.
WAY, TAKEN = 1.0 / 7.0, 0.6


@dataclass(frozen=True)
class Number:
    """One number of a preview: its name, value, unit and what it says."""

    name: str
    value: float
    unit: str
    words: str


@dataclass(frozen=True)
class Preview:
    """Numbers of a case, and what is off; nothing is if there are no reasons."""

    numbers: tuple[Number, ...]
    reasons: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON: numbers, units (both by name) and reasons."""
        return {
            "numbers": {n.name: n.value if isfinite(n.value) else None for n in self.numbers},
            "units": {n.name: n.unit for n in self.numbers},
            "reasons": list(self.reasons),
        }


class _Found:
    """Numbers and reasons as they come."""

    def __init__(self) -> None:
        self.numbers: list[Number] = []
        self.reasons: list[str] = []

    def add(self, name: str, value: float, unit: str, words: str) -> None:
        self.numbers.append(Number(name, value, unit, words))

    def cost(self, unknowns: float, seconds: float) -> None:
        self.add("memory", PROGRAM + UNKNOWN * unknowns, "MiB", "estimate, factor included")
        self.add("run time", seconds, "s", "rough estimate, one core")

    def done(self) -> Preview:
        return Preview(tuple(self.numbers), tuple(dict.fromkeys(self.reasons)))


def preview(case: Case, begun: Simulation | None = None) -> Preview:
    """Arrange the particles of a case and mesh them, run nothing.

    Parameters
    ----------
    case : Case
    begun : Simulation, optional
        That of a case of particles that move, if it is there already.

    Returns
    -------
    Preview

    Raises
    ------
    InputError
        If the case could not even be started.
    """
    if case.permeability is not None:
        return _resting(case, case.permeability)
    return _moving(case, begun or case.simulation())


def _resting(case: Case, about: PermeabilitySection) -> Preview:
    from grainmesh.triangulation import triangulate

    box, particles, _ = case.arrangement()
    found = _Found()
    try:
        particles = settle(box, particles)
    except InputError as fault:
        raise InputError(f"{case.path}: {fault}") from None
    porosity = _porosity(box, particles)
    found.add("particles", len(particles), "", "")
    found.add("porosity", porosity, "", "of the box")
    try:
        gap = triangulate(box, particles).gap_shortest
    except InputError as fault:
        gap = nan
        if set(about.method) != {"resolved"}:
            found.reasons.append(str(fault))
    found.add("gap", gap, "d", "mean shortest edge of triangles / d - 1")
    if isfinite(gap) and set(about.method) != {"resolved"}:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", ClosureWarning)
            LAWS[about.law](porosity, gap)
        found.reasons += [str(w.message) for w in caught]
    if (particles.diameter > 2.0).any():
        found.reasons.append("particles: discs are thicker than 2 m: check the unit of the file")
    cost = [RESTING[name] for name in about.method]
    unknowns = len(particles) * max(c[0] for c in cost)
    found.add("unknowns", unknowns, "", "of the largest method, estimate")
    found.cost(unknowns, len(particles) * sum(c[1] for c in cost))
    return found.done()


def _moving(case: Case, simulation: Simulation) -> Preview:
    assert case.run is not None
    model, particles, free = simulation.model, simulation.particles, ~simulation.fixed
    found = _Found()
    try:
        places(case.run.probes, model.box)
    except InputError as fault:
        found.reasons.append(str(fault))
    if case.fluid is not None and not model.box.periodic:
        _sides(case, case.fluid, model.box, found)
    found.add("particles", len(particles), "", f"{np.count_nonzero(~free)} of them fixed")
    found.add("porosity", _porosity(model.box, particles), "", "of the whole box")
    moving = particles.select(free) if free.any() else particles
    mass = np.sort(moving.density * pi * moving.diameter**2 / 4.0)
    steps = case.run.until / simulation.dt
    pair = mass[0] * mass[min(1, len(mass) - 1)] / (mass[0] + mass[min(1, len(mass) - 1)])
    found.add("contact time", model.contact.contact_time(pair), "s", "of the lightest pair")
    found.add("dt", simulation.dt, "s", "step of the contacts")
    found.add("steps", ceil(steps), "", "of the contacts")
    seconds, unknowns = DISC_STEP * steps * len(particles), 0
    speed = hypot(*case.start.velocity)
    if case.fluid is None:
        drop = _drop(model.box, moving, model.gravity)
        speed = max(speed, sqrt(2.0 * hypot(*model.gravity) * drop))
    else:
        speed = max(speed, _regime(case, case.fluid, simulation, moving, free, found))
        unknowns = _unknowns(simulation, case.fluid.order)
        found.add("unknowns", unknowns, "", "of the flow")
        length = _flow_step(case.fluid, moving, model.gravity, speed, case.run.until)
        count = case.run.until / max(TAKEN * length, simulation.dt)
        found.add("flow steps", ceil(count), "", "estimate")
        seconds += FLOW_STEP * unknowns * count
    _overlaps(case, simulation, moving, float(mass[-1]), speed, found)
    found.cost(unknowns, seconds)
    return found.done()


def _porosity(box: Box, particles: Particles) -> float:
    return 1.0 - float((pi / 4.0 * particles.diameter**2).sum()) / box.area


def _drop(box: Box, particles: Particles, gravity: tuple[float, float]) -> float:
    """How far the topmost discs can fall until the bed has settled [m]."""
    g = np.array(gravity)
    if not g.any() or box.periodic:
        return 0.0
    axis = int(np.argmax(np.abs(g)))
    place = particles.x[:, axis] if g[axis] < 0.0 else box.size[axis] - particles.x[:, axis]
    solid = float((pi / 4.0 * particles.diameter**2).sum()) / (1.0 - SETTLED)
    return max(0.0, float(place.max()) - solid / float(box.size[1 - axis]))


def _regime(
    case: Case,
    fluid: FluidSection,
    simulation: Simulation,
    moving: Particles,
    free: np.ndarray[Any, np.dtype[np.bool_]],
    found: _Found,
) -> float:
    """Numbers of discs in a fluid; the greatest speed of one against the other [m/s]."""
    flow, model = simulation.flow, simulation.model
    assert flow is not None
    box, d, g = model.box, moving.mean_diameter, hypot(*model.gravity)
    law, quiet = fluid.build(box).drag, fluid.build(box).drag  # a law warns only once
    porosity = np.asarray(flow.kernel.porosity[: len(free)])[free]
    eps = float(np.median(porosity))
    excess = float(moving.density.mean()) - fluid.density
    V = pi / 4.0 * d**2
    try:
        balance = _balance(case, quiet, box, simulation.particles, d, V * excess * g)
        settled = case.start.settle is not None
        # Fluid seeks the open cells of a packed bed: they all carry their share side by side.
        rate = float(np.mean([balance(e) for e in porosity])) if settled else balance(eps)
        fastest = max((hypot(*velocity) for _, velocity in _inflows(fluid)), default=0.0)
        U = max(abs(rate), fastest, eps * hypot(*case.start.velocity))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", ClosureWarning)
            w = U / eps
            b = float(law.coefficient(_bed(fluid, law, box, d, eps, w, balance.gap))[0])
    except InputError as fault:
        found.reasons.append(f"fluid.drag: {fault}")
        return 0.0
    found.reasons += [f"fluid.drag: {warning.message}" for warning in caught]
    mass = V * float(moving.density.mean())
    reynolds = fluid.density * U * d / fluid.viscosity
    found.add("bed porosity", eps, "", "median about the particles at t = 0")
    found.add("Re_p", reynolds, "", "rho U d / mu, U superficial")
    found.add(
        "St",
        mass * w / (b * d),
        "",
        "Stokes number: m w / (b d)",
    )
    archimedes = fluid.density * abs(excess) * g * d**3 / fluid.viscosity**2
    found.add("Ar", archimedes, "", "Archimedes number")
    moved = (getattr(fluid.sides, name) for name in SIDES)
    w = max(w, *(abs(side.speed) if isinstance(side, NoSlip) else 0.0 for side in moved))
    length = _flow_step(fluid, moving, model.gravity, w, case.run.until if case.run else inf)
    found.add("flow dt", TAKEN * length, "s", "step of the flow, estimate")
    found.add("b dt/m", b * TAKEN * length / mass, "", "drag number")
    if settled:
        found.add("U_mf", rate, "m/s", "superficial, minimum fluidisation")
    elif g > 0.0:
        found.add("settling velocity", rate, "m/s", "superficial, at the bed porosity")
    if isinstance(law, Permeability) and reynolds > CREEPING:
        one = np.array([reynolds])
        if float(law.law.inertia(one, np.array([eps]), np.array([0.01]))[0]) == 1.0:
            found.reasons.append(
                f"fluid.drag: Re_p is {reynolds:.3g}, but {law.name} is for slow flow, Re_p "
                f"up to {CREEPING:g} or so: take forchheimer or ergun-2d"
            )
    _fluidised(fluid, model.gravity, box, simulation.particles, balance, excess, found)
    widest = 2.0 * sqrt(float((V / np.maximum(1.0 - porosity, 1e-9)).max()) / pi)
    if widest > float(box.size.min()):
        found.reasons.append(
            f"fluid.reach: a particle is spread over a circle {widest:.3g} m wide, wider than the "
            "box: enlarge box.size, lower fluid.reach or fluid.spacing"
        )
    if fluid.dt is not None and g > 0.0 and fluid.dt > 10.0 * sqrt(2.0 * WAY * d / g):
        found.reasons.append(
            f"fluid.dt: {fluid.dt:g} s is far above the {sqrt(2.0 * WAY * d / g):.2g} s in which "
            "particles fall by a seventh of a diameter: such steps are never taken, lower it"
        )
    return w


class _balance:
    """Eq. (1): the superficial velocity at which the weight of a disc is carried [m/s]."""

    def __init__(
        self, case: Case, law: Drag, box: Box, particles: Particles, d: float, weight: float
    ) -> None:
        from grainmesh.triangulation import triangulate

        assert case.fluid is not None
        self.fluid, self.law, self.box, self.d, self.weight = case.fluid, law, box, d, weight
        self.gap = nan
        if law.variable == "gap":
            self.gap = triangulate(box, particles).gap_shortest

    def __call__(self, eps: float) -> float:
        if self.weight == 0.0:
            return 0.0
        force, low, high = eps * abs(self.weight), 1e-15, 1e6
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ClosureWarning)
            while high / low > 1.0001:
                w = sqrt(low * high)
                bed = _bed(self.fluid, self.law, self.box, self.d, eps, w, self.gap)
                heavier = float(self.law.coefficient(bed)[0]) * w < force
                low, high = (w, high) if heavier else (low, w)
        return eps * low * (1.0 if self.weight > 0.0 else -1.0)


def _bed(
    fluid: FluidSection, law: Drag, box: Box, d: float, eps: float, w: float, gap: float
) -> Bed:
    """One disc of diameter d, at a porosity and a speed against the fluid."""
    area = pi / 4.0 * d**2 / max(1.0 - eps, 1e-9)
    return Bed(
        mu=fluid.viscosity,
        rho=fluid.density,
        diameter=np.array([d]),
        porosity=np.array([eps]),
        area=np.array([area]),
        slip=np.array([w]),
        gap=gap,
        width=inf if box.periodic else box.width,
    )


def _inflows(fluid: FluidSection) -> list[tuple[str, tuple[float, float]]]:
    """Sides with an inflow, and its mean velocity when it is strongest."""
    found = []
    for name in SIDES:
        side = getattr(fluid.sides, name)
        if isinstance(side, Inflow):
            most = max((factor for _, factor in side.ramp), key=abs, default=1.0)
            found.append((name, (most * side.velocity[0], most * side.velocity[1])))
    return found


def _inwards(name: str, velocity: tuple[float, float]) -> float:
    """What of a velocity goes into the box through a side."""
    axis, end = divmod(SIDES.index(name), 2)
    return velocity[axis] * (-1.0 if end else 1.0)


def _sides(case: Case, fluid: FluidSection, box: Box, found: _Found) -> None:
    """What the sides of the fluid cannot be, or hardly are meant to be."""
    sides = {name: getattr(fluid.sides, name) for name in SIDES}
    inflows = {name: side for name, side in sides.items() if isinstance(side, Inflow)}
    assert case.run is not None
    if not any(isinstance(side, Outlet) for side in sides.values()):
        times = {0.0, case.run.until} | {t for side in inflows.values() for t, _ in side.ramp}
        for t in sorted(t for t in times if 0.0 <= t <= case.run.until):
            volumes = []
            for name, side in inflows.items():
                factor = float(np.interp(t, *np.transpose(side.ramp))) if side.ramp else 1.0
                length = float(box.size[1 - SIDES.index(name) // 2])
                volumes.append(factor * _inwards(name, side.velocity) * length)
            if abs(sum(volumes)) > 1e-9 * sum(map(abs, volumes)):
                found.reasons.append(
                    f"fluid.sides: {sum(volumes):.3g} m2/s flow into the box at t = {t:g} s and "
                    'nothing the other way: make one side an "outlet", or let inflows add up to 0'
                )
                break
    entering = []
    for name, velocity in _inflows(fluid):
        entering.append(_inwards(name, velocity))
        if entering[-1] == 0.0:
            found.reasons.append(
                f"fluid.sides.{name}: nothing flows through the side, at most along it at "
                f"{hypot(*velocity):g} m/s: check velocity = [to the right, upwards] and the ramp"
            )
    if entering and max(entering) < 0.0:
        found.reasons.append("fluid.sides: all inflows draw fluid out: check the signs of velocity")
    for number, name in enumerate(SIDES):
        wall, side = getattr(case.walls, name), sides[name]
        moved = wall.velocity[1 - number // 2] if wall else 0.0
        speed = side.speed if isinstance(side, NoSlip) else 0.0
        if moved not in (0.0, speed) and (side is None or isinstance(side, NoSlip)):
            found.reasons.append(
                f"walls.{name}.velocity: the fluid does not move with the wall: give "
                f'fluid.sides.{name} = {{ kind = "no-slip", speed = {moved:g} }}'
            )


def _fluidised(
    fluid: FluidSection,
    gravity: tuple[float, float],
    box: Box,
    particles: Particles,
    balance: Callable[[float], float],
    excess: float,
    found: _Found,
) -> None:
    """Say so if a flow against gravity carries the particles to the end of the box."""
    g = hypot(*gravity)
    if g == 0.0 or excess <= 0.0:
        return
    full = _porosity(box, particles)
    for name, velocity in _inflows(fluid):
        axis = SIDES.index(name) // 2
        inwards = velocity[axis] * (1.0 if SIDES.index(name) % 2 == 0 else -1.0)
        up = -(velocity[0] * gravity[0] + velocity[1] * gravity[1]) / g
        if inwards > 0.0 and up > balance(full):
            found.reasons.append(
                f"fluid.sides.{name}: an inflow of {up:.3g} m/s against gravity carries all "
                f"particles away, {balance(full):.3g} m/s would spread them over the whole box, "
                "which they cannot leave: lower it, or make the box higher"
            )


def _flow_step(
    fluid: FluidSection,
    moving: Particles,
    gravity: tuple[float, float],
    speed: float,
    until: float,
) -> float:
    """Longest step that the flow may take [s], as `coupling` has it."""
    d, g = float(moving.diameter.min()), hypot(*gravity)
    longest = fluid.dt or (0.1 * sqrt(d / g) if g > 0.0 else until)
    if g > 0.0:
        longest = min(longest, sqrt(2.0 * WAY * d / g))
    return min(longest, WAY * d / speed if speed > 0.0 else inf, until)


def _unknowns(simulation: Simulation, order: int) -> int:
    """Unknowns of velocity and pressure on the mesh of the flow."""
    assert simulation.flow is not None
    triangles = simulation.flow.mesh.triangles
    corners, faces = len(np.unique(triangles)), len(triangles)
    edges = corners + faces - (0 if simulation.model.box.periodic else 1)  # Euler

    def of(k: int) -> int:
        return corners + (k - 1) * edges + (k - 1) * (k - 2) // 2 * faces

    return 2 * (of(order) + (faces if order == 1 else 0)) + of(max(order - 1, 1))


def _overlaps(
    case: Case,
    simulation: Simulation,
    moving: Particles,
    mass: float,
    speed: float,
    found: _Found,
) -> None:
    """Overlaps as discs meet and under the weight of the bed, in smallest radii."""
    model, least = simulation.model, float(moving.radius.min())
    k, volume = model.contact.stiffness, pi / 4.0 * moving.diameter**2
    meeting = speed * sqrt(mass / k) / least
    found.add("overlap as they meet", meeting, "r", f"at {speed:.3g} m/s")
    lighter = case.fluid.density if case.fluid else 0.0
    weight = np.abs((moving.density - lighter) * volume).sum() * np.array(model.gravity)
    floor = 0.0 if model.box.periodic else float(np.abs(weight / model.box.size[::-1]).max())
    resting = 2.0 * floor / k
    found.add("overlap under weight", resting, "r", "at the floor of the bed")
    if meeting > MEETING or resting > RESTING_OVERLAP:
        needed = k * max((meeting / (0.5 * MEETING)) ** 2, resting / 0.01)
        found.reasons.append(
            f"contact.stiffness: {k:.3g} N/m2 is too low, particles would overlap by "
            f"{100 * max(meeting, resting):.2g} % of a radius: raise it, perhaps to {needed:.1g}"
        )


__all__ = ["Number", "Preview", "preview"]
