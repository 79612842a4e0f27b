"""What acts on particles that move: the box and its walls, the contact law, gravity, forces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike, NDArray

from grainmesh.contact import Contact
from grainmesh.domain import SIDES, Box
from grainmesh.errors import InputError
from grainmesh.medium import Fluid
from grainmesh.walls import Wall

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Stands for a force that is a function where a model is kept in a file.
FUNCTION = "function"

Force = Callable[[float, Float, Float], ArrayLike]


@dataclass(frozen=True)
class Model:
    """What acts on the particles.

    Parameters
    ----------
    box : Box
        Its sides are walls, but for those in `open`; or it is periodic.
    contact : Contact
        The law of all contacts.
    gravity : (float, float)
        [m/s2].
    walls : tuple of Wall
        Further walls; one made by `Wall.of` takes the place of that side of the box.
    open : tuple of str
        Sides without a wall.
    escape : str
        Particles that have left through an open side, wholly: "error" or "remove". When the last
        has left, the run ends with a `RunError`.
    force : callable or array_like, optional
        A force from outside on each particle, per unit depth [N/m]: (n, 2) or (2,), or a function
        of the time [s], the centres (n, 2) [m] and velocities (n, 2) [m/s] that returns it, for
        the particles that are still there (`Simulation.ids`).
    dt : float, optional
        Step [s]; if not given, a fiftieth of the shortest contact time.
    fluid : Fluid, optional
        What flows between the particles.

    Raises
    ------
    InputError
        If a value is not finite or unknown.
    """

    box: Box
    contact: Contact
    gravity: tuple[float, float] = (0.0, -9.81)
    walls: tuple[Wall, ...] = ()
    open: tuple[str, ...] = ()
    escape: str = "error"
    force: Force | ArrayLike | None = None
    dt: float | None = None
    fluid: Fluid | None = None

    def __post_init__(self) -> None:
        for name, kind in (("box", Box), ("contact", Contact)):
            if not isinstance(getattr(self, name), kind):
                raise InputError(f"model: {name} must be a grainmesh.{kind.__name__}")
        try:
            gravity = tuple(float(g) for g in self.gravity)
        except (TypeError, ValueError):
            raise InputError(f"model: gravity {self.gravity!r} must be two numbers") from None
        if len(gravity) != 2 or not all(isfinite(g) for g in gravity):
            raise InputError(f"model: gravity {gravity} must be two finite numbers [m/s2]")
        object.__setattr__(self, "gravity", gravity)
        sides = (self.open,) if isinstance(self.open, str) else tuple(self.open)
        walls = (self.walls,) if isinstance(self.walls, Wall) else tuple(self.walls)
        for wall in walls:
            if not isinstance(wall, Wall):
                raise InputError(f"model: {wall!r} among the walls must be a grainmesh.Wall")
        object.__setattr__(self, "open", sides)
        object.__setattr__(self, "walls", walls)
        for side in sides:
            if side not in SIDES:
                raise InputError(f"model: open side {side!r} must be one of {', '.join(SIDES)}")
        own = [wall.side for wall in walls if wall.side]
        for side in own:
            if own.count(side) > 1 or side in sides:
                raise InputError(f"model: the {side} side is given twice, as walls or as open")
        if self.fluid is not None and not isinstance(self.fluid, Fluid):
            raise InputError("model: fluid must be a grainmesh.Fluid")
        if self.fluid is not None and sides:
            raise InputError(
                "model: particles cannot leave a box with fluid, drop open=; the fluid can, say "
                "fluid sides={...: Outlet()}"
            )
        if self.fluid is not None and self.box.periodic and self.fluid.sides:
            raise InputError("model: a periodic box has no sides, drop those of the fluid")
        if self.box.periodic and (own or sides):
            raise InputError(
                "model: a periodic box has no sides, drop open= and Wall.of, or periodic=True"
            )
        for wall in walls:
            if wall.side and Wall.of(self.box, wall.side).start != wall.start:
                raise InputError(f"model: the {wall.side} wall was made for another box")
        if self.force is not None and not callable(self.force):
            try:
                np.asarray(self.force, dtype=float)
            except (TypeError, ValueError):
                if not (isinstance(self.force, str) and self.force == FUNCTION):
                    raise InputError("model: force must be numbers [N/m], or a function") from None
        if self.escape not in ("error", "remove"):
            raise InputError(f"model: escape {self.escape!r} must be 'error' or 'remove'")
        if self.dt is not None and not (isfinite(self.dt) and self.dt > 0.0):
            raise InputError(f"model: dt {self.dt:g} s must be positive")

    @property
    def all_walls(self) -> tuple[Wall, ...]:
        """The walls given, and the sides of the box that are neither open nor among them."""
        if self.box.periodic:
            return self.walls
        own = {wall.side for wall in self.walls}
        rest = (Wall.of(self.box, side) for side in SIDES if side not in own | set(self.open))
        return (*self.walls, *rest)


def fixed_of(fixed: ArrayLike | None, n: int) -> Mask:
    """Which of n particles are fixed (n,), from such an array, or from their numbers."""
    given = np.asarray([] if fixed is None else fixed)
    if given.dtype == np.bool_ and given.shape == (n,):
        return given.copy()
    if given.ndim != 1 or (len(given) and not np.issubdtype(given.dtype, np.integer)):
        raise InputError(
            f"fixed needs one bool for each of the {n} particles, or the numbers of those fixed"
        )
    found = np.zeros(n, np.bool_)
    for i in given.astype(np.int64):
        if not 0 <= i < n:
            raise InputError(f"fixed: there is no particle {i}, they are numbered 0 to {n - 1}")
        found[i] = True
    return found


__all__ = ["Model", "fixed_of"]
