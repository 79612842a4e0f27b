"""The fluid between the particles, and what it does at the sides of the box."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from grainmesh.closures import Law
from grainmesh.domain import SIDES
from grainmesh.drag import DRAGS, Drag, Permeability, from_name
from grainmesh.errors import InputError

Float = NDArray[np.float64]
Profile = Callable[[Float, float], ArrayLike]


@dataclass(frozen=True)
class NoSlip:
    """A wall that the fluid sticks to.

    Parameters
    ----------
    speed : float
        Of the wall, along itself, to the right or upwards [m/s].
    """

    speed: float = 0.0

    def __post_init__(self) -> None:
        _number("NoSlip: speed", self.speed, "m/s")


@dataclass(frozen=True)
class Slip:
    """A wall without friction, or a plane of symmetry."""


@dataclass(frozen=True)
class Inflow:
    """A side with a given superficial velocity (volume per area and time).

    Parameters
    ----------
    velocity : (float, float) or callable
        [m/s]; or a function of the places (k, 2) [m] and the time [s] that returns (k, 2).
    """

    velocity: tuple[float, float] | Profile

    def __post_init__(self) -> None:
        if not callable(self.velocity):
            object.__setattr__(self, "velocity", _pair("Inflow: velocity", self.velocity, "m/s"))

    def at(self, places: Float, time: float) -> Float:
        """Velocity at places (k, 2) [m] and a time [s], (k, 2)."""
        if not callable(self.velocity):
            return np.broadcast_to(np.array(self.velocity), places.shape)
        try:
            found = np.asarray(self.velocity(places, time), dtype=float)
        except Exception as fault:
            raise InputError(
                f"Inflow: the function of the velocity fails ({type(fault).__name__}: {fault}); it "
                "takes places (k, 2) [m] and the time [s]"
            ) from None
        if found.shape != places.shape or not np.isfinite(found).all():
            raise InputError(
                f"Inflow: the function of the velocity must return {places.shape} finite numbers, "
                f"it returned {found.shape}"
            )
        return found


@dataclass(frozen=True)
class Outlet:
    """A side with a given pressure, which flow passes at right angles.

    What flows in there brings the mean velocity of the fluid in the box.

    Parameters
    ----------
    pressure : float
        Dynamic pressure, without the hydrostatic part [Pa].
    """

    pressure: float = 0.0

    def __post_init__(self) -> None:
        _number("Outlet: pressure", self.pressure, "Pa")


Side = NoSlip | Slip | Inflow | Outlet


@dataclass(frozen=True)
class Fluid:
    """An incompressible Newtonian fluid and how its flow is computed.

    Parameters
    ----------
    density : float
        rho_f [kg/m3].
    viscosity : float
        mu [Pa s].
    drag : Drag, Law or str
        Law for the drag on each disc (`grainmesh.drag`): itself, a permeability law, or a name of
        `drag.DRAGS`. That of discs at random if not given.
    sides : mapping
        From names of sides (see `domain.SIDES`) to `NoSlip`, `Slip`, `Inflow` or `Outlet`; those
        not named are `NoSlip()`. Particles see the walls of the model, which may be others: an
        `Inflow` or `Outlet` is a grid to them unless the side is open.
    order : int
        Polynomial order k >= 1 of the velocity.
    dt : float, optional
        Longest step of the flow [s]; a tenth of sqrt(d/g) if not given. It is shortened so that
        particles move by a seventh of a diameter at most, and for the flow not to cross more than
        half a node. Beds under load take up their state over some of them.
    scheme : str
        "euler" (implicit Euler) or "bdf2", of second order.
    reach : float
        No particle is spread over more than a circle of this radius, in largest diameters.
    spacing : float or (float, float), optional
        Distance of nodes where no particles are [m]; two: beside particles and walls, and far from
        them, where it grows by a quarter of the way. If not given, there are none but on walls, and
        triangles in an empty part of the box are large.
    torque : bool
        Viscous torque pi mu d² (vorticity/2 - spin) on each disc.
    added_mass : float
        Coefficient C of the force C rho_f V (du/dt - du_i/dt).
    push : (float, float)
        Minus a mean pressure gradient [Pa/m]. In a periodic box without fixed particles their
        weight is held up by a mean pressure gradient besides, or all would fall for ever.
    tolerance : float
        Residual of the linear solver, over that of the fields foretold for the step. What is left
        is given to the next steps, so nothing is lost; 1e-4 makes single steps exact.

    Raises
    ------
    InputError
        If a value is out of its range.
    """

    density: float
    viscosity: float
    drag: Drag = field(default_factory=Permeability)
    sides: Mapping[str, Side] = field(default_factory=dict)
    order: int = 2
    dt: float | None = None
    scheme: str = "euler"
    reach: float = 3.0
    spacing: float | tuple[float, float] | None = None
    torque: bool = True
    added_mass: float = 0.0
    push: tuple[float, float] = (0.0, 0.0)
    tolerance: float = 0.02

    def __post_init__(self) -> None:
        for name in ("density", "viscosity", "dt", "reach", "spacing", "tolerance"):
            value = getattr(self, name)
            if value is None and name in ("dt", "spacing"):
                continue
            if name == "spacing" and (isinstance(value, (tuple, list)) or np.ndim(value)):
                value = _pair("fluid: spacing", value, "m")
                object.__setattr__(self, "spacing", value)
                if value[0] > value[1]:
                    raise InputError(
                        f"fluid: spacing = {value}, beside particles and far from them [m], must "
                        "ascend"
                    )
                value = value[0]
            _number(f"fluid: {name}", value, UNITS[name])
            if value <= 0.0:
                raise InputError(f"fluid: {name} = {value:g} must be positive")
        _number("fluid: added_mass", self.added_mass, "-")
        if self.added_mass < 0.0:
            raise InputError(f"fluid: added_mass = {self.added_mass:g} must not be negative")
        if self.tolerance > 0.1:
            raise InputError(f"fluid: tolerance = {self.tolerance:g} must be at most 0.1")
        object.__setattr__(self, "push", _pair("fluid: push", self.push, "Pa/m"))
        drag: object = self.drag
        if isinstance(drag, str):
            object.__setattr__(self, "drag", from_name(drag))
        elif isinstance(drag, Law):
            object.__setattr__(self, "drag", Permeability(drag))
        elif not isinstance(drag, Drag):
            raise InputError(
                f"fluid: drag {drag!r} must be a law of grainmesh.drag, or the name of one: "
                f"{', '.join(DRAGS)}"
            )
        if isinstance(self.drag, Permeability) and not isinstance(self.drag.law, Law):
            raise InputError(
                f"fluid: drag.Permeability({self.drag.law!r}) must be of a permeability law, "
                "grainmesh.closures.LAWS[name] perhaps"
            )
        if isinstance(self.order, bool) or not isinstance(self.order, (int, np.integer)):
            raise InputError(f"fluid: order {self.order!r} must be a whole number from 1")
        if self.order < 1:
            raise InputError(f"fluid: order {self.order} must be a whole number from 1")
        if not isinstance(self.sides, Mapping):
            raise InputError("fluid: sides must be a dict, as {'top': Outlet()}")
        if self.scheme not in ("euler", "bdf2"):
            raise InputError(f"fluid: scheme {self.scheme!r} must be 'euler' or 'bdf2'")
        for side, kind in self.sides.items():
            if side not in SIDES:
                raise InputError(f"fluid: side {side!r} must be one of {', '.join(SIDES)}")
            if not isinstance(kind, Side):
                raise InputError(
                    f"fluid: the {side} side must be NoSlip(), Slip(), Inflow() or Outlet(), "
                    f"not {kind!r}"
                )

    def side(self, name: str) -> Side:
        """What the fluid does at a side of the box."""
        return self.sides.get(name, NoSlip())

    def names(self, *kinds: type) -> tuple[str, ...]:
        """Sides of these kinds."""
        return tuple(name for name in SIDES if isinstance(self.side(name), kinds))


UNITS = {
    "density": "kg/m3", "viscosity": "Pa s", "dt": "s", "reach": "largest diameters",
    "spacing": "m", "tolerance": "-",
}  # fmt: skip


def _number(name: str, value: object, unit: str) -> None:
    """Raise if this is no finite number."""
    if (
        isinstance(value, bool)
        or not isinstance(value, (int, float, np.number))
        or not isfinite(value)
    ):
        raise InputError(f"{name} = {value!r} must be a finite number [{unit}]")


def _pair(name: str, value: object, unit: str) -> tuple[float, float]:
    """Two finite numbers, or raise."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise InputError(f"{name} {value!r} must be two numbers [{unit}]")
    for part in value:
        _number(name, part, unit)
    return float(value[0]), float(value[1])


KINDS = {kind.__name__: kind for kind in (NoSlip, Slip, Inflow, Outlet)}


def described(fluid: Fluid) -> dict[str, Any] | None:
    """A fluid as text and numbers; None if its drag or an inflow is a function of one's own."""
    found = {item.name: getattr(fluid, item.name) for item in fields(fluid)}
    if any(callable(getattr(side, "velocity", None)) for side in fluid.sides.values()):
        return None
    depth = {"depth": fluid.drag.depth} if hasattr(fluid.drag, "depth") else {}
    if fluid.drag.name not in DRAGS or from_name(fluid.drag.name, **depth) != fluid.drag:
        return None
    return found | {
        "drag": {"name": fluid.drag.name} | depth,
        "sides": {name: [type(s).__name__, vars(s)] for name, s in fluid.sides.items()},
    }


def from_description(text: dict[str, Any]) -> Fluid:
    """The fluid of `described`."""
    sides = {name: KINDS[kind](**values) for name, (kind, values) in text["sides"].items()}
    return Fluid(**(text | {"drag": from_name(**text["drag"]), "sides": sides}))


__all__ = ["Fluid", "Inflow", "NoSlip", "Outlet", "Slip", "described", "from_description"]
