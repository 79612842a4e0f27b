"""The fluid in a case file, and what it does at the sides of the box."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from grainmesh import medium
from grainmesh.domain import SIDES, Box
from grainmesh.drag import DRAGS, from_name
from grainmesh.errors import InputError
from grainmesh.keys import (
    Density,
    Flag,
    NotNegative,
    Pressure,
    Pure,
    Section,
    Size,
    Slope,
    Spacing,
    Span,
    Speed,
    Time,
    Velocity,
    Viscosity,
    Whole,
    one_of,
)

Float = NDArray[np.float64]


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
    drag: Annotated[str, one_of(DRAGS, "drag law")] = Field(
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
    spacing: Spacing | None = Field(
        None,
        description="Distance of nodes where no particles are [m], or two, beside particles and "
        "far from them; no nodes if not given.",
    )
    torque: Flag = Field(True, description="Viscous torque on each particle.")
    added_mass: NotNegative = Field(0.0, description="Coefficient of the added mass.")
    push: tuple[Slope, Slope] = Field(
        (0.0, 0.0), description="Minus a mean pressure gradient [Pa/m]."
    )
    tolerance: Annotated[Pure, Field(gt=0, le=0.1)] = Field(
        0.02, description="Of the linear solver, relative to what a step changes."
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
        near = self.spacing[0] if isinstance(self.spacing, tuple) else self.spacing
        if near is not None and near > 10.0 * box.size.max():
            raise InputError(
                f"fluid.spacing: {near:g} m is far more than the box, {box.width:.3g} m x "
                f"{box.height:.3g} m: check the unit, or leave it out"
            )
        sides = {
            name: side.build(box, name)
            for name in SIDES
            if (side := getattr(self.sides, name)) is not None
        }
        rest = self.model_dump(exclude={"drag", "depth", "sides"})
        return medium.Fluid(drag=from_name(self.drag, **self._parameters), sides=sides, **rest)


__all__ = ["FluidSection", "Inflow", "Stream"]
