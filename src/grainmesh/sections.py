"""The sections of a case file besides particles (`arranged`) and fluid (`stream`).

Ranges that the objects of the library check themselves are left to them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from grainmesh.closures import LAWS
from grainmesh.domain import SIDES, Box
from grainmesh.errors import InputError
from grainmesh.keys import (
    Flag,
    NotNegative,
    Place,
    Pure,
    Rate,
    Section,
    Share,
    SideName,
    Size,
    Span,
    Stiffness,
    Velocity,
    Whole,
    one_of,
)

if TYPE_CHECKING:
    from grainmesh.contact import Contact
    from grainmesh.walls import Wall


class BoxSection(Section):
    """The region of space that holds the particles."""

    size: tuple[Size, Size] | None = Field(
        None, description="Width and height [m]; by default those of the lattice or of the list."
    )
    periodic: Flag = Field(False, description="Periodic in both directions, or with four walls.")


class StartSection(Section):
    """What happens before time 0."""

    velocity: Velocity = Field((0.0, 0.0), description="Of all particles that move [m/s].")
    spin: Rate = Field(0.0, description="Of the same, counter-clockwise [1/s].")
    relax: Flag = Field(False, description="Push apart particles that overlap.")
    settle: Span | None = Field(
        None, description="Let the particles fall for this time [s] without fluid first."
    )


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

    def build(self) -> Contact:
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
        list[Annotated[str, one_of(("resolved", "mesoscale", "microstructure"), "method")]],
        Field(min_length=1),
        BeforeValidator(
            lambda given: [given] if isinstance(given, str) else given,
            json_schema_input_type=str | list[str],
        ),
    ] = Field(
        ["resolved", "mesoscale", "microstructure"], description="One method, or a list of them."
    )
    law: Annotated[str, one_of(LAWS, "law")] = Field(
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
    "BoxSection",
    "ContactSection",
    "PermeabilitySection",
    "RunSection",
    "StartSection",
    "WallsSection",
]
