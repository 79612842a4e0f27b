"""Particles in a case file: generators, lattices, lists, and centres that stand in the file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.keys import (
    MANY,
    MANY_AT_RANDOM,
    Count,
    Density,
    Diameters,
    Flag,
    NotNegative,
    Place,
    Pure,
    Region,
    Section,
    Seed,
    Share,
    Size,
    Text,
)
from grainmesh.particles import Particles
from grainmesh.units import shown

Float = NDArray[np.float64]


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
        try:
            found = arrange.loose(
                part, self.number, diameter=self.diameter, gap=self.gap, seed=self.seed
            )
        except InputError as fault:
            raise InputError(str(fault).replace("reduce n,", "reduce number,")) from None
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
    unit: Size = Field(1.0, description='Unit of the columns [m], as "1 um".')
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


__all__ = ["Arrangement", "Listed"]
