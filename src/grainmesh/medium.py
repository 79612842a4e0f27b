"""The fluid between the particles, and what it does at the sides of the box."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from grainmesh.domain import SIDES
from grainmesh.drag import DRAGS, Drag, from_name
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


@dataclass(frozen=True)
class Outlet:
    """A side with a given pressure, which flow passes at right angles.

    Parameters
    ----------
    pressure : float
        Dynamic pressure, without the hydrostatic part [Pa].
    """

    pressure: float = 0.0


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
    drag : Drag
        Law for the drag on each disc (`grainmesh.drag`).
    sides : mapping
        From names of sides (see `domain.SIDES`) to `NoSlip`, `Slip`, `Inflow` or `Outlet`; those
        not named are `NoSlip()`. Particles see the walls of the model, which may be others: an
        `Inflow` or `Outlet` is a grid to them unless the side is open.
    order : int
        Polynomial order k >= 1 of the velocity.
    dt : float, optional
        Longest step of the flow [s]. It is shortened so that particles move by a seventh of a
        diameter at most, and for the flow not to cross more than half a node.
    scheme : str
        "euler" (implicit Euler) or "bdf2", of second order.
    reach : float
        No particle is spread over more than a circle of this radius, in mean diameters.
    spacing : float, optional
        Distance of nodes where no particles are [m]; if not given, there are none but on walls.
    torque : bool
        Viscous torque pi mu d² (vorticity/2 - spin) on each disc.
    added_mass : float
        Coefficient C of the force C rho_f V (du/dt - du_i/dt).
    push : (float, float)
        Minus a mean pressure gradient [Pa/m]. In a periodic box the weight of the particles is
        held up by a mean pressure gradient besides, or all would fall for ever.
    tolerance : float
        Residual of the linear solver over right-hand side.

    Raises
    ------
    InputError
        If a value is out of its range.
    """

    density: float
    viscosity: float
    drag: Drag
    sides: Mapping[str, Side] = field(default_factory=dict)
    order: int = 2
    dt: float | None = None
    scheme: str = "euler"
    reach: float = 3.0
    spacing: float | None = None
    torque: bool = True
    added_mass: float = 0.0
    push: tuple[float, float] = (0.0, 0.0)
    tolerance: float = 1e-6

    def __post_init__(self) -> None:
        for name in ("density", "viscosity", "dt", "reach", "spacing", "tolerance"):
            value = getattr(self, name)
            if value is not None and not (isfinite(value) and value > 0.0):
                raise InputError(f"fluid: {name} = {value:g} must be positive")
        if not (isfinite(self.added_mass) and self.added_mass >= 0.0):
            raise InputError(f"fluid: added_mass = {self.added_mass:g} must not be negative")
        if not isinstance(self.drag, Drag):
            raise InputError(f"fluid: drag {self.drag!r} must be a law of grainmesh.drag")
        if self.order != int(self.order) or self.order < 1:
            raise InputError(f"fluid: order {self.order} must be a whole number from 1")
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
