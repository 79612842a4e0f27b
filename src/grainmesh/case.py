"""Case files: a whole computation as TOML text, checked before anything is computed.

    case = grainmesh.case.read("bed.toml", ["fluid.viscosity='2 cP'"])
    case.simulation().run(case.run.until)

A case has a section ``run`` (particles that move) or ``permeability`` (particles at rest).
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import Field, PrivateAttr, ValidationError, model_validator

from grainmesh.arranged import Arrangement, Listed
from grainmesh.domain import Box
from grainmesh.errors import InputError, RunError
from grainmesh.keys import Acceleration, Section, Text, first_mistake, nearest
from grainmesh.particles import Particles
from grainmesh.sections import (
    BoxSection,
    ContactSection,
    PermeabilitySection,
    RunSection,
    StartSection,
    WallsSection,
)
from grainmesh.stream import FluidSection
from grainmesh.units import shown

if TYPE_CHECKING:
    from grainmesh.model import Model
    from grainmesh.permeability import Permeability
    from grainmesh.simulation import Simulation

#: Most steps of a particle, all together, that settling before time 0 may take: a minute or so.
LONGEST = 1e9
#: The same of the whole run: a year or so.
MOST = 1e15


class Case(Section):
    """A case file.

    Attributes
    ----------
    run : RunSection or None
        until, every, frames [s].
    permeability : PermeabilitySection or None
        The other kind of job; exactly one of the two is there.
    """

    title: Text = Field("", description="One line about the case.")
    gravity: tuple[Acceleration, Acceleration] = Field((0.0, -9.81), description="Gravity [m/s2].")
    box: BoxSection = Field(BoxSection(), description="The box.")
    particles: Arrangement = Field(description="The particles, and how they are arranged.")
    fixed: Arrangement | None = Field(
        None, description="Particles held in place for ever, with the same keys."
    )
    start: StartSection = Field(StartSection(), description="What happens before time 0.")
    contact: ContactSection | None = Field(None, description="The contact law.")
    walls: WallsSection = Field(WallsSection(), description="Walls as the particles see them.")
    fluid: FluidSection | None = Field(None, description="The fluid; dry if not given.")
    run: RunSection | None = Field(None, description="Particles that move.")
    permeability: PermeabilitySection | None = Field(
        None, description="In place of run: the permeability of particles at rest."
    )

    _path: Path = PrivateAttr(default=Path("case.toml"))
    _text: str = PrivateAttr(default="")

    @model_validator(mode="after")
    def _one_job(self) -> Case:
        if (self.run is None) == (self.permeability is None):
            raise InputError(
                "a case needs a section [run] or [permeability], one of them"
                + ("; run.until, or --until, is for [run]" if self.run else "")
            )
        if self.run is not None and self.contact is None:
            raise InputError(
                "contact: missing; particles that move need [contact] with a stiffness"
            )
        if self.permeability is not None:
            for name in ("gravity", "fixed", "start", "contact", "walls", "fluid"):
                if name in self.model_fields_set:
                    raise InputError(f"{name}: has no meaning with [permeability], drop it")
        return self

    @property
    def path(self) -> Path:
        """Where the case was read."""
        return self._path

    @property
    def text(self) -> str:
        """The TOML text as it was, with the changes in it."""
        return self._text

    @property
    def files(self) -> tuple[Path, ...]:
        """Other files that the case names."""
        groups = (self.particles, self.fixed)
        return tuple(self._path.parent / g.file for g in groups if isinstance(g, Listed))

    def arrangement(self) -> tuple[Box, Particles, int]:
        """The box, all particles, and how many of them, at the end, are fixed.

        Raises
        ------
        InputError
            If they cannot be arranged like that.
        """
        with self._naming():
            folder, periodic = self._path.parent, self.box.periodic
            given = Box(*self.box.size, periodic) if self.box.size else None
            with _prefixed("particles"):
                box, particles = self.particles.build(given, periodic, folder)
                _refuse_far(box, particles)
            if self.fixed is None:
                return box, particles, 0
            with _prefixed("fixed"):
                held = self.fixed.build(box, periodic, folder)[1]
                _refuse_far(box, held)
            both = [
                np.concatenate([getattr(particles, name), getattr(held, name)])
                for name in ("x", "diameter", "density")
            ]
            return box, Particles(*both), len(held)

    def model(self, box: Box) -> Model:
        """What acts on the particles in a box."""
        from grainmesh.model import Model

        assert self.contact is not None
        with self._naming():
            return Model(
                box,
                self.contact.build(),
                self.gravity,
                self.walls.build(box),
                tuple(self.walls.open),
                self.walls.escape,
                dt=self.contact.dt,
                fluid=self.fluid.build(box) if self.fluid else None,
            )

    def simulation(self) -> Simulation:
        """The particles at time 0, relaxed and settled if the case says so.

        Raises
        ------
        InputError
            If the case is one of permeability, or cannot be started.
        """
        from grainmesh.simulation import Simulation

        self._is("run")
        assert self.run is not None
        box, particles, held = self.arrangement()
        fixed = np.arange(len(particles)) >= len(particles) - held
        with self._naming(), _worded(len(particles) - held):
            model = self.model(box)
            particles = self._prepared(model, particles, fixed)
            start = self.start
            begun = Simulation(model, particles, start.velocity, start.spin, fixed=fixed)
            steps = self.run.until / begun.dt
            if steps * len(particles) > MOST:
                raise InputError(
                    f"run.until: {steps:.2g} steps of {begun.dt:.2g} s would take years: lower "
                    "contact.stiffness, raise contact.dt, or let the run be shorter"
                )
        begun.about = {"case": self._text, "source": str(self._path)}
        return begun

    def resume(self, folder: str | Path) -> Simulation:
        """The simulation of this case saved in a folder.

        A fluid whose inflow changes in time is not in the checkpoint, it comes from the case.
        """
        from grainmesh.medium import described
        from grainmesh.simulation import resume

        self._is("run")
        if self.fluid is None:
            return resume(folder)
        fluid = self.model(self.arrangement()[0] if self.box.size is None else self._box()).fluid
        assert fluid is not None
        return resume(folder, fluid=None if described(fluid) else fluid)

    def solve(self, progress: Callable[[str], None] = lambda _: None) -> list[Permeability]:
        """Permeability by each method of the case, in its order.

        Parameters
        ----------
        progress : callable, optional
            Is told each stage in a few words.

        Raises
        ------
        InputError
            If the case is one of particles that move, or the particles cannot be used.
        """
        from grainmesh.closures import LAWS
        from grainmesh.permeability import permeability

        self._is("permeability")
        assert self.permeability is not None
        about, (box, particles, _) = self.permeability, self.arrangement()
        with self._naming():
            return [
                permeability(
                    box,
                    particles,
                    method,
                    walls=about.walls,
                    law=LAWS[about.law],
                    tol=about.tol,
                    order=about.order,
                    progress=lambda text, name=method: progress(f"{name}: {text}"),  # type: ignore[misc]
                )
                for method in about.method
            ]

    def _box(self) -> Box:
        assert self.box.size is not None
        return Box(*self.box.size, self.box.periodic)

    def _is(self, kind: str) -> None:
        if getattr(self, kind) is None:
            raise InputError(f"{self._path}: has no section [{kind}], it is a case of another kind")

    def _prepared(self, model: Model, particles: Particles, fixed: Any) -> Particles:
        """The particles pushed apart and settled, without fluid, between walls at rest."""
        from grainmesh.relax import relax
        from grainmesh.simulation import Simulation

        still = [
            replace(w, velocity=(0.0, 0.0), amplitude=(0.0, 0.0), frequency=0.0)
            for w in model.walls
        ]
        dry = replace(model, fluid=None, open=(), walls=tuple(still))
        if self.start.relax:
            particles = relax(dry, particles, fixed)
        if self.start.settle is None:
            return particles
        with _prefixed("start.settle"):
            fall = Simulation(dry, particles, fixed=fixed)
            work = self.start.settle / fall.dt * len(particles)
            if work > LONGEST:
                raise InputError(
                    f"takes {work:.1g} steps of a particle, at most {LONGEST:.0g}: let it be "
                    "shorter, or run that as a case of its own"
                )
            try:
                return fall.run(self.start.settle).particles
            except RunError as fault:
                raise InputError(str(fault)) from None

    @contextmanager
    def _naming(self) -> Iterator[None]:
        """Name the case file in what is refused."""
        with _prefixed(str(self._path)):
            yield


def read(path: str | Path, changes: Sequence[str] = ()) -> Case:
    """A case from a file.

    Parameters
    ----------
    path : path
        TOML in UTF-8. Files named in it are relative to its folder.
    changes : sequence of str
        As "fluid.viscosity=2e-3": key and value as in TOML, text also without quotes.

    Returns
    -------
    Case

    Raises
    ------
    InputError
        One line with the file, the key, what is wrong and what to do.
    """
    path = Path(path)
    if "\0" in str(path) or not path.is_file():
        raise InputError(f"{path}: there is no such file; `grainmesh new` makes a case file")
    try:
        text = path.read_text("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file in UTF-8") from None
    except OSError as fault:
        raise InputError(f"{path}: {fault.strerror}") from None
    return parse(text, path, changes)


def parse(text: str, path: str | Path = "case.toml", changes: Sequence[str] = ()) -> Case:
    """The same from text; `path` is the file it stands for."""
    path = Path(path)
    data = _loaded(text, str(path))
    if changes:
        text, data = _changed(text, data, changes, path)
    try:
        case = Case.model_validate(data)
    except ValidationError as fault:
        raise InputError(f"{path}: {first_mistake(fault, data)}") from None
    case._path, case._text = path, text
    return case


def starter(name: str) -> str:
    """The text of a case to begin with, by its name.

    Raises
    ------
    InputError
        If there is none of this name.
    """
    folder = files("grainmesh") / "data" / "starters"
    names = sorted(item.name.removesuffix(".toml") for item in folder.iterdir())
    if name not in names:
        near = nearest(name, names)
        raise InputError(f"starter '{name}' unknown, did you mean {near}? of {', '.join(names)}")
    return (folder / f"{name}.toml").read_text("utf-8")


def schema() -> dict[str, Any]:
    """The JSON schema of case files, for editors."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | Case.model_json_schema()


def _loaded(text: str, name: str) -> dict[str, Any]:
    """TOML as a dict."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{name}: arrays or tables are nested too deep") from None
    except ValueError as fault:  # a TOMLDecodeError, or a number of too many digits
        said = str(fault)
        raise InputError(f"{name}: not valid TOML: {said[:1].lower()}{said[1:]}") from None


def _changed(
    text: str, data: dict[str, Any], changes: Sequence[str], path: Path
) -> tuple[str, dict[str, Any]]:
    """Text and data with changes made; comments stay."""
    import tomlkit

    document: Any = tomlkit.parse(text)
    for change in changes:
        key, equals, value = change.partition("=")
        keys = [part.strip() for part in key.split(".")]
        proper = change.encode("utf-8", "replace").decode() == change
        if not equals or not all(keys) or not proper:
            raise InputError(f"change {shown(change)} must be section.key=value")
        try:
            parsed = tomllib.loads(f"value = {value}")
        except (ValueError, RecursionError):
            parsed = {}
        # Text that is no TOML value is taken as it stands.
        new = parsed["value"] if list(parsed) == ["value"] else value.strip()
        here, there = document, data
        for depth, part in enumerate(keys[:-1], 1):
            if part not in there:
                here[part], there[part] = tomlkit.table(), {}
            if not isinstance(there[part], dict):
                raise InputError(
                    f"{path}: {'.'.join(keys[:depth])} is no section, {key} cannot be changed"
                )
            here, there = here[part], there[part]
        here[keys[-1]], there[keys[-1]] = new, new
    text = tomlkit.dumps(document)
    if _plain(_loaded(text, f"{path} with changes")) != _plain(data):
        raise InputError(f"{path}: the changes cannot be written into this file, edit it by hand")
    return text, data


def _plain(data: dict[str, Any]) -> str:
    """Data as text that can be compared: undefined numbers are equal there."""
    return json.dumps(data, sort_keys=True, default=str)


def _refuse_far(box: Box, particles: Particles) -> None:
    """Refuse what is so large or so far off that a unit must be wrong."""
    far = np.abs(particles.x / box.size - 0.5).max(axis=1) > 2.0
    large = particles.diameter > box.size.max()
    for i in np.flatnonzero(far | large):
        what = f"{particles.diameter[i]:.3g} m thick" if large[i] else "far outside the box"
        raise InputError(
            f"particle {i} is {what}, the box {box.width:.3g} x {box.height:.3g} m: check the unit"
        )


@contextmanager
def _worded(first: int) -> Iterator[None]:
    """Let refusals speak of keys and sections; fixed particles are those from `first` on."""

    def named(pair: re.Match[str]) -> str:
        i, j = map(int, pair.groups())
        if j < first:
            return pair[0]
        one = f"[particles] {i}" if i < first else f"[fixed] {i - first}"
        return f"{one} and [fixed] {j - first} overlap"

    try:
        yield
    except InputError as fault:
        said = str(fault).replace("grainmesh.relax(model, particles)", "start.relax = true")
        said = said.replace("give one side an Outlet()", 'make one side an "outlet"')
        said = said.replace("drop open=; the fluid", "drop walls.open; the fluid")
        said = said.replace("fluid sides={...: Outlet()}", 'fluid.sides = { top = "outlet" }')
        raise InputError(re.sub(r"particles (\d+) and (\d+) overlap", named, said)) from None


@contextmanager
def _prefixed(name: str) -> Iterator[None]:
    """Put a name in front of what is refused, if it is not there already."""
    try:
        yield
    except InputError as fault:
        said = str(fault)
        raise InputError(said if said.startswith(name) else f"{name}: {said}") from None


__all__ = ["Case", "parse", "read", "schema", "starter"]
