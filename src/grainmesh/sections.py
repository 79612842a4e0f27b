"""The sections of a case file: what may stand in each, and what it becomes.

Every quantity is a number in the SI unit of its description, or text with a unit ("2 mm",
`grainmesh.units`). Unknown and missing keys are found here; ranges that the objects of the library
check themselves are left to them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainValidator, model_validator
from pydantic_core import PydanticCustomError

from grainmesh import medium
from grainmesh.closures import LAWS
from grainmesh.domain import SIDES, Box
from grainmesh.drag import DRAGS, from_name
from grainmesh.errors import InputError
from grainmesh.particles import Particles
from grainmesh.units import shown, si

if TYPE_CHECKING:
    from grainmesh.contact import Contact as Law
    from grainmesh.walls import Wall

Float = NDArray[np.float64]
#: Most discs of one arrangement, and of one at random.
MANY, MANY_AT_RANDOM = 1_000_000, 50_000


def nearest(word: str, names: Iterable[str]) -> str:
    """The name most like a word."""
    return get_close_matches(word, list(names), n=1, cutoff=0.0)[0]


def _in(unit: str) -> BeforeValidator:
    return BeforeValidator(lambda value: si(value, unit), json_schema_input_type=float | str)


def _one_of(names: Iterable[str], what: str) -> BeforeValidator:
    known = list(names)

    def check(value: object) -> object:
        if value not in known:
            near = nearest(str(value), known)
            raise InputError(f"{what} {shown(value)} unknown, did you mean '{near}'?")
        return value

    return BeforeValidator(check, json_schema_input_type=Literal[tuple(known)])


def _diameters(value: object) -> float | tuple[float, float]:
    if not isinstance(value, (list, tuple)):
        return _positive(si(value, "m"))
    if len(value) != 2:
        raise InputError("expected one diameter, or two as bounds: [least, largest]")
    low, high = (_positive(si(part, "m")) for part in value)
    if low > high:
        raise InputError("the first bound must not be above the second")
    return low, high


def _positive(value: float) -> float:
    if value <= 0.0:
        raise InputError(f"{value:g} must be positive")
    return value


def _whole(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, int):
        raise InputError(f"{shown(value)} must be a whole number")
    return value


def _yes_or_no(value: object) -> object:
    if not isinstance(value, bool):
        raise InputError(f"{shown(value)} must be true or false")
    return value


Pure = Annotated[float, _in("1")]
Length = Annotated[float, _in("m")]
Time = Annotated[float, _in("s")]
Speed = Annotated[float, _in("m/s")]
Rate = Annotated[float, _in("1/s")]
Acceleration = Annotated[float, _in("m/s2")]
Density = Annotated[float, _in("kg/m3"), Field(gt=0)]
Stiffness = Annotated[float, _in("N/m2"), Field(gt=0)]
Viscosity = Annotated[float, _in("Pa s"), Field(gt=0)]
Pressure = Annotated[float, _in("Pa")]
Slope = Annotated[float, _in("Pa/m")]
Size = Annotated[Length, Field(gt=0)]
Span = Annotated[Time, Field(gt=0)]
Share = Annotated[Pure, Field(gt=0, lt=1)]
NotNegative = Annotated[Pure, Field(ge=0)]
Whole = Annotated[int, BeforeValidator(_whole, json_schema_input_type=int)]
Count = Annotated[Whole, Field(ge=1, le=MANY)]
Seed = Annotated[Whole, Field(ge=0, lt=2**63)]
Flag = Annotated[bool, BeforeValidator(_yes_or_no, json_schema_input_type=bool)]
Text = Annotated[str, Field(strict=True)]
Place = tuple[Length, Length]
Velocity = tuple[Speed, Speed]
Region = tuple[Length, Length, Length, Length]
Diameters = Annotated[
    float | tuple[float, float],
    PlainValidator(
        _diameters, json_schema_input_type=float | str | tuple[float | str, float | str]
    ),
]
SideName = Annotated[str, _one_of(SIDES, "side")]


class Section(BaseModel):
    """Keys that are known, and no others."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _keys(cls, data: Any) -> Any:
        """Name the first key that is unknown or missing: one line, however many follow from it."""
        if not isinstance(data, dict):
            return data
        for key in data:
            if key not in cls.model_fields:
                near = nearest(str(key), cls.model_fields)
                raise PydanticCustomError("key", "unknown key", {"key": key, "near": near})
        for key, item in cls.model_fields.items():
            if item.is_required() and key not in data:
                about = item.description or ""
                raise PydanticCustomError("lack", "missing", {"key": key, "about": about})
        return data


class BoxSection(Section):
    """The region of space that holds the particles."""

    size: tuple[Size, Size] | None = Field(
        None, description="Width and height [m]; by default those of the lattice or of the list."
    )
    periodic: Flag = Field(False, description="Periodic in both directions, or with four walls.")


# --- particles ------------------------------------------------------------------------------------


class _Discs(Section):
    density: Density = Field(2500.0, description="Density of the particles [kg/m3].")

    def build(self, box: Box | None, periodic: bool, folder: Path) -> tuple[Box, Particles]:
        """The box, its own if none is given, and the discs."""
        raise NotImplementedError


class _Drawn(_Discs):
    """Discs drawn by a generator of random numbers, into a part of the box."""

    diameter: Diameters = Field(
        description="Diameter [m], or two: bounds of a uniform distribution."
    )
    seed: Seed = Field(0, description="The same seed gives the same particles.")
    region: Region | None = Field(
        None,
        description="x0, y0, x1, y1 [m] of the part of the box to fill; all of it if not given.",
    )

    @model_validator(mode="after")
    def _region(self) -> _Drawn:
        if self.region and not (
            self.region[0] < self.region[2] and self.region[1] < self.region[3]
        ):
            raise InputError("region must be x0, y0, x1, y1 with x0 < x1 and y0 < y1")
        return self

    def _part(self, box: Box) -> tuple[Box, Float]:
        """The part to fill as a box of its own, and its corner."""
        if self.region is None:
            return box, np.zeros(2)
        x0, y0, x1, y1 = self.region
        return Box(x1 - x0, y1 - y0), np.array([x0, y0])

    def _diameters(self, n: int) -> Float:
        low, high = self.diameter if isinstance(self.diameter, tuple) else (self.diameter,) * 2
        return np.random.default_rng(self.seed).uniform(low, high, n)


class Loose(_Drawn):
    """Row upon row from the floor up, loosely, to fall."""

    arrange: Literal["loose"]
    number: Count = Field(description="How many particles.")
    gap: Annotated[Pure, Field(gt=0)] = Field(
        0.1, description="Mean gap between particles, in largest diameters."
    )

    def build(self, box: Box | None, periodic: bool, folder: Path) -> tuple[Box, Particles]:
        from grainmesh import arrange

        if box is None:
            raise InputError("box.size is missing: loose particles need it")
        part, corner = self._part(box)
        found = arrange.loose(
            part, self.number, diameter=self.diameter, gap=self.gap, seed=self.seed
        )
        return box, Particles(found.x + corner, found.diameter, self.density)


class Random(_Drawn):
    """At random, without overlaps, as many as are asked for or as make the porosity."""

    arrange: Literal["random"]
    number: Annotated[Count, Field(le=MANY_AT_RANDOM)] | None = Field(
        None, description="How many particles; or give porosity, and both if the box has no size."
    )
    porosity: Share | None = Field(None, description="Share of the box outside the particles.")
    min_gap: NotNegative = Field(
        0.0, description="Least distance of two surfaces, in mean diameters."
    )

    def build(self, box: Box | None, periodic: bool, folder: Path) -> tuple[Box, Particles]:
        from grainmesh import arrange

        about: dict[str, Any] = {"min_gap": self.min_gap, "seed": self.seed}
        if box is None:
            if self.number is None or self.porosity is None or self.region:
                raise InputError(
                    "box.size is missing: give it, or both number and porosity and no region"
                )
            box, found = arrange.random(
                self.number,
                porosity=self.porosity,
                diameter=self._diameters(self.number),
                periodic=periodic,
                **about,
            )
            return box, Particles(found.x, found.diameter, self.density)
        if (self.number is None) == (self.porosity is None):
            raise InputError(
                "particles at random need number or porosity, one of them: box has a size"
            )
        part, corner = self._part(box)
        n = self.number
        if n is None:
            one = np.pi / 4.0 * float((self._diameters(10_000) ** 2).mean())
            wanted = (1.0 - (self.porosity or 0.0)) * part.area / one
            if wanted > MANY_AT_RANDOM:
                raise InputError(
                    f"this porosity makes {wanted:.2g} particles, at most {MANY_AT_RANDOM} can be "
                    "placed at random: check the units, or make the box smaller"
                )
            n = max(1, round(wanted))
        d = self._diameters(n)
        porosity = 1.0 - np.pi / 4.0 * float((d**2).sum()) / part.area
        if porosity <= 0.0:
            raise InputError(f"{n} particles are more than fit there: reduce number or diameter")
        _, found = arrange.random(
            n,
            porosity=porosity,
            diameter=d,
            periodic=periodic and self.region is None,
            aspect=part.width / part.height,
            **about,
        )
        return box, Particles(found.x + corner, d, self.density)


class Lattice(_Discs):
    """Rows of a lattice."""

    arrange: Literal["square", "hexagonal"]
    columns: Count = Field(description="Particles in a row.")
    rows: Count = Field(description="Rows; an even number in a periodic hexagonal lattice.")
    porosity: Share = Field(description="Share of the lattice outside the particles.")
    diameter: Size = Field(description="Diameter [m].")
    corner: Place | None = Field(
        None, description="Lower left corner [m] in a box with a size; the origin if not given."
    )

    def build(self, box: Box | None, periodic: bool, folder: Path) -> tuple[Box, Particles]:
        from grainmesh import arrange

        if self.columns * self.rows > MANY:
            raise InputError(f"columns times rows must be at most {MANY}")
        if box is None and self.corner is not None:
            raise InputError("a corner needs box.size, drop it or give that")
        make = arrange.square if self.arrange == "square" else arrange.hexagonal
        tile, found = make(
            self.columns,
            self.rows,
            porosity=self.porosity,
            diameter=self.diameter,
            periodic=periodic and box is None,
        )
        x = found.x if self.corner is None else found.x + np.array(self.corner)
        return box or tile, Particles(x, self.diameter, self.density)


class Listed(_Discs):
    """A list in a text file with columns x, y and one of d, r."""

    arrange: Literal["file"]
    file: Text = Field(description="Path of the file, from the folder of the case file.")
    unit: Size = Field(1.0, description='Metres per unit of the columns, or "um" as "1 um".')
    diameter: Size | None = Field(None, description="One diameter [m] in place of the column.")
    window: Region | None = Field(
        None, description="x0, y0, x1, y1 [m]: cut this out as the box; box.size is left out then."
    )
    crop: Flag = Field(False, description="Drop discs wholly outside the box.")

    def build(self, box: Box | None, periodic: bool, folder: Path) -> tuple[Box, Particles]:
        from grainmesh import arrange

        path = folder / self.file
        if "\0" in self.file or not path.is_file():
            raise InputError(
                f"file: there is no file {shown(str(path))}; give its path from {folder}"
            )
        found_box, found = arrange.from_csv(
            path,
            unit=self.unit,
            diameter=self.diameter,
            width=box.width if box else None,
            height=box.height if box else None,
            window=self.window,
            periodic=periodic,
            crop=self.crop,
        )
        return found_box, Particles(found.x, found.diameter, self.density)


class Places(_Discs):
    """Centres that stand in the case file."""

    arrange: Literal["places"]
    places: Annotated[list[Place], Field(min_length=1, max_length=10_000)] = Field(
        description="Centres [m], as [[x, y], [x, y]]."
    )
    diameter: Size = Field(description="Diameter [m].")

    def build(self, box: Box | None, periodic: bool, folder: Path) -> tuple[Box, Particles]:
        if box is None:
            raise InputError("box.size is missing: particles given by places need it")
        return box, Particles(np.array(self.places), self.diameter, self.density)


Arrangement = Annotated[Loose | Random | Lattice | Listed | Places, Field(discriminator="arrange")]


class StartSection(Section):
    """What happens before time 0."""

    velocity: Velocity = Field((0.0, 0.0), description="Of all particles that move [m/s].")
    spin: Rate = Field(0.0, description="Of the same, counter-clockwise [1/s].")
    relax: Flag = Field(False, description="Push apart particles that overlap.")
    settle: Span | None = Field(
        None, description="Let the particles fall for this time [s] without fluid first."
    )


# --- what acts on them ----------------------------------------------------------------------------


class ContactSection(Section):
    """The contact law: linear springs and dashpots with friction."""

    stiffness: Stiffness = Field(
        description="Normal force per unit depth over overlap [N/m2]; overlaps should stay below a "
        "hundredth of a radius."
    )
    restitution: Annotated[Pure, Field(gt=0, le=1)] | None = Field(
        None, description="Speed after over speed before a collision; 0.9 if not given."
    )
    damping: Annotated[Rate, Field(ge=0)] | None = Field(
        None, description="In place of restitution: dashpot over effective mass [1/s]."
    )
    friction: NotNegative = Field(0.3, description="Coefficient of friction.")
    tangential: Annotated[Pure, Field(gt=0, le=1)] = Field(
        2.0 / 7.0, description="Tangential over normal stiffness."
    )
    tangential_damping: Annotated[Pure, Field(ge=0, le=1)] = Field(
        0.5, description="Tangential over normal damping."
    )
    rolling: NotNegative = Field(0.0, description="Coefficient of rolling resistance.")
    dt: Span | None = Field(
        None, description="Step of the contacts [s]; a fiftieth of the contact time if not given."
    )

    @model_validator(mode="after")
    def _law(self) -> ContactSection:
        self.build()
        return self

    def build(self) -> Law:
        from grainmesh.contact import Contact

        return Contact(**self.model_dump(exclude={"dt"}))


class _Moving(Section):
    velocity: Velocity = Field((0.0, 0.0), description="Constant velocity [m/s].")
    amplitude: Place = Field((0.0, 0.0), description="Amplitude of an oscillation [m].")
    frequency: Annotated[Rate, Field(ge=0)] = Field(0.0, description="Its frequency [1/s].")
    friction: NotNegative | None = Field(
        None, description="Coefficient of friction on this wall; that of the contacts if not given."
    )


class SideWall(_Moving):
    """A side of the box as the particles see it."""


class Segment(_Moving):
    """A straight wall in the box, touched from both sides."""

    start: Place = Field(description="One end at time 0 [m].")
    end: Place = Field(description="The other end [m].")


class WallsSection(Section):
    """Walls as the particles see them; what is not named is a wall at rest."""

    left: SideWall | None = Field(None, description="The left side of the box.")
    right: SideWall | None = Field(None, description="The right side.")
    bottom: SideWall | None = Field(None, description="The floor.")
    top: SideWall | None = Field(None, description="The lid.")
    segments: Annotated[list[Segment], Field(max_length=1000)] = Field(
        [], description="Further walls in the box."
    )
    open: list[SideName] = Field([], description="Sides through which particles may leave.")
    escape: Literal["error", "remove"] = Field(
        "error", description="What to do with particles that have left."
    )

    def build(self, box: Box) -> tuple[Wall, ...]:
        from grainmesh.walls import Wall

        sides = [
            Wall.of(box, name, **wall.model_dump())
            for name in SIDES
            if (wall := getattr(self, name)) is not None
        ]
        return (*sides, *(Wall(**segment.model_dump()) for segment in self.segments))


# --- fluid ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Stream:
    """Velocity at an inflow that changes along the side or in time; see `Inflow`."""

    velocity: tuple[float, float]
    axis: int
    length: float
    parabolic: bool
    ramp: tuple[tuple[float, float], ...]

    def __call__(self, places: Float, time: float) -> Float:
        """Velocity [m/s] at places (k, 2) [m] and a time [s], (k, 2)."""
        factor = np.interp(time, *np.transpose(self.ramp)) if self.ramp else 1.0
        s = places[:, self.axis] / self.length
        shape = 6.0 * s * (1.0 - s) if self.parabolic else np.ones(len(s))
        found: Float = factor * shape[:, None] * np.array(self.velocity)
        return found


class _Side(Section):
    def build(self, box: Box, name: str) -> medium.Side:
        """What the fluid does at this side."""
        raise NotImplementedError


class NoSlip(_Side):
    """A wall that the fluid sticks to."""

    kind: Literal["no-slip"]
    speed: Speed = Field(
        0.0, description="Of the wall, along itself, to the right or upwards [m/s]."
    )

    def build(self, box: Box, name: str) -> medium.Side:
        return medium.NoSlip(self.speed)


class Slip(_Side):
    """A wall without friction, or a plane of symmetry."""

    kind: Literal["slip"]

    def build(self, box: Box, name: str) -> medium.Side:
        return medium.Slip()


class Outlet(_Side):
    """A given pressure, which flow passes at right angles."""

    kind: Literal["outlet"]
    pressure: Pressure = Field(0.0, description="Without the hydrostatic part [Pa].")

    def build(self, box: Box, name: str) -> medium.Side:
        return medium.Outlet(self.pressure)


class Inflow(_Side):
    """A given superficial velocity."""

    kind: Literal["inflow"]
    velocity: Velocity = Field(
        description="Its mean along the side, volume per area and time [m/s]."
    )
    profile: Literal["flat", "parabolic"] = Field("flat", description="Along the side.")
    ramp: Annotated[list[tuple[Time, Pure]], Field(max_length=10_000)] = Field(
        [], description="Times [s] and what the velocity is multiplied by then, linear in between."
    )

    @model_validator(mode="after")
    def _ascending(self) -> Inflow:
        times = [time for time, _ in self.ramp]
        if any(a >= b for a, b in pairwise(times)):
            raise InputError("the times of the ramp must ascend")
        return self

    def build(self, box: Box, name: str) -> medium.Side:
        if self.profile == "flat" and not self.ramp:
            return medium.Inflow(self.velocity)
        axis = 1 - SIDES.index(name) // 2
        parabolic = self.profile == "parabolic"
        about = self.velocity, axis, float(box.size[axis]), parabolic, tuple(self.ramp)
        return medium.Inflow(Stream(*about))


def _named(value: object) -> object:
    return {"kind": value} if isinstance(value, str) else value


Side = Annotated[
    Annotated[NoSlip | Slip | Outlet | Inflow, Field(discriminator="kind")],
    BeforeValidator(_named),
]


class SidesSection(Section):
    """The sides of the box as the fluid sees them: a kind, or a table with kind and more."""

    left: Side | None = Field(None, description="The left side; no-slip if not given.")
    right: Side | None = Field(None, description="The right side.")
    bottom: Side | None = Field(None, description="The floor.")
    top: Side | None = Field(None, description="The lid.")


class FluidSection(Section):
    """The fluid, and how its flow is computed."""

    density: Density = Field(description="Density of the fluid [kg/m3].")
    viscosity: Viscosity = Field(description="Viscosity [Pa s].")
    drag: Annotated[str, _one_of(DRAGS, "drag law")] = Field(
        "random-discs", description="Drag law, see the page on drag laws."
    )
    depth: Size | None = Field(None, description="Of the sheet, for drag laws of spheres only [m].")
    order: Annotated[Whole, Field(ge=1, le=8)] = Field(
        2, description="Polynomial order of the velocity."
    )
    dt: Span | None = Field(
        None, description="Longest step of the flow [s]; a tenth of sqrt(d/g) if not given."
    )
    scheme: Literal["euler", "bdf2"] = Field("euler", description="Of first or of second order.")
    reach: Annotated[Pure, Field(gt=0)] = Field(
        3.0, description="A particle is spread over this radius at most, in largest diameters."
    )
    spacing: Size | None = Field(
        None, description="Distance of nodes where no particles are [m]; none if not given."
    )
    torque: Flag = Field(True, description="Viscous torque on each particle.")
    added_mass: NotNegative = Field(0.0, description="Coefficient of the added mass.")
    push: tuple[Slope, Slope] = Field(
        (0.0, 0.0), description="Minus a mean pressure gradient [Pa/m]."
    )
    tolerance: Annotated[Pure, Field(gt=0, le=0.01)] = Field(
        1e-6, description="Of the linear solver."
    )
    sides: SidesSection = Field(
        SidesSection(), description="What the fluid does at the sides of the box."
    )

    @model_validator(mode="after")
    def _drag(self) -> FluidSection:
        from_name(self.drag, **self._parameters)
        return self

    @property
    def _parameters(self) -> dict[str, float]:
        return {} if self.depth is None else {"depth": self.depth}

    def build(self, box: Box) -> medium.Fluid:
        sides = {
            name: side.build(box, name)
            for name in SIDES
            if (side := getattr(self.sides, name)) is not None
        }
        rest = self.model_dump(exclude={"drag", "depth", "sides"})
        return medium.Fluid(drag=from_name(self.drag, **self._parameters), sides=sides, **rest)


# --- what is done ---------------------------------------------------------------------------------


class RunSection(Section):
    """How long particles move, and what is written meanwhile."""

    until: Span = Field(description="Time to reach [s].")
    every: Span | None = Field(
        None,
        description="Interval of history and checkpoints [s]; a hundredth of until if not given.",
    )
    frames: Span | None = Field(
        None,
        description="Interval of the frames of the flow and the particles [s]; every if not given.",
    )

    cuts: Annotated[Whole, Field(ge=1, le=8)] = Field(
        1, description="Pieces that edges of triangles are cut into where frames are written."
    )
    probes: Annotated[list[Place], Field(max_length=1000)] = Field(
        [], description="Places [m] whose velocity and pressure the history holds."
    )

    @model_validator(mode="after")
    def _intervals(self) -> RunSection:
        for name in ("every", "frames"):
            value = getattr(self, name)
            if value is not None and value < 1e-5 * self.until:
                raise InputError(f"{name} = {value:g} s makes over 100000 rows: raise it")
        return self


class PermeabilitySection(Section):
    """Flow through particles at rest, in place of a run."""

    method: Annotated[
        list[Annotated[str, _one_of(("resolved", "mesoscale", "microstructure"), "method")]],
        Field(min_length=1),
    ] = Field(["resolved", "mesoscale", "microstructure"], description="One or more methods.")
    law: Annotated[str, _one_of(LAWS, "law")] = Field(
        "microstructural", description="Drag law of mesoscale and microstructure."
    )
    tol: Share = Field(1e-3, description="Relative tolerance of resolved.")
    order: Annotated[Whole, Field(ge=1, le=8)] | None = Field(
        None, description="Order of the velocity; as tol needs, or 2 for mesoscale, if not given."
    )
    walls: Literal["symmetry", "no-slip"] = Field(
        "symmetry", description="Sides along the flow, of a box that is not periodic."
    )

    @model_validator(mode="after")
    def _order(self) -> PermeabilitySection:
        if self.order is not None and self.order < 3 and "resolved" in self.method:
            raise InputError(
                "an order below 3 is too low for resolved, which compares with the one below"
            )
        return self


__all__ = [
    "Arrangement",
    "BoxSection",
    "ContactSection",
    "FluidSection",
    "PermeabilitySection",
    "RunSection",
    "Section",
    "StartSection",
    "Stream",
    "WallsSection",
    "nearest",
]
