"""What every closure is: the law λ(ε, γ), its range, its warning, and Eq. (3) made of it."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike, NDArray

from grainmesh.errors import InputError

Float = NDArray[np.float64]


class ClosureWarning(UserWarning):
    """A law was used outside the range for which its error is stated."""


class Law(ABC):
    """A permeability law λ = K/d², called as ``law(porosity, gap)``.

    A subclass is a frozen dataclass with the six facts below and `_permeability`; a law with
    inertia overrides `inertia` as well.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """Name on the command line, the key in `LAWS`."""

    @property
    @abstractmethod
    def reference(self) -> str:
        """Where the law comes from."""

    @property
    @abstractmethod
    def medium(self) -> str:
        """The class of microstructure that it describes."""

    @property
    @abstractmethod
    def variable(self) -> str:
        """The argument that it depends on: ``"porosity"`` or ``"gap"``."""

    @property
    @abstractmethod
    def valid(self) -> tuple[float, float]:
        """Range of that argument in which `error` holds."""

    @property
    @abstractmethod
    def error(self) -> float:
        """Stated relative error of λ inside `valid`."""

    @abstractmethod
    def _permeability(self, x: Float) -> Float:
        """λ at values of `variable` that are known to be physical."""

    def __call__(self, porosity: ArrayLike, gap: ArrayLike) -> Float:
        """Normalised permeability λ = K/d².

        Parameters
        ----------
        porosity : array_like
            Fluid fraction ε, between 0 and 1. Not looked at by a law of the gap.
        gap : array_like
            Mean shortest Delaunay edge per triangle / d - 1, positive. Not looked at by a law of
            the porosity.

        Returns
        -------
        ndarray
            λ, of the common shape of both arguments.

        Raises
        ------
        InputError
            If the argument in use is not physical, the medium has closed there, or the shapes of
            both do not go together.

        Warns
        -----
        ClosureWarning
            Once a call, if the argument in use leaves `valid`.
        """
        given = {"porosity": np.asarray(porosity, float), "gap": np.asarray(gap, float)}
        shapes = [v.shape for v in given.values()]
        try:
            shape = np.broadcast_shapes(*shapes)
        except ValueError:
            raise InputError(
                f"porosity {shapes[0]} and gap {shapes[1]} differ in shape: give both one by one, "
                "or either as a single number"
            ) from None
        x = given[self.variable]
        check(self.variable, x)
        with np.errstate(invalid="ignore", divide="ignore"):
            lam = self._permeability(x)
        closed = ~(np.isfinite(lam) & (lam > 0.0))
        low, high = self.valid
        span = f"its range is {low:.4g} to {high:.4g}"
        if closed.any():
            raise InputError(
                f"law {self.name} has no positive permeability at {self.variable} "
                f"{x[closed].flat[0]:g} ({span}): use a law for that medium"
            )
        outside = (x < low) | (x > high)
        if outside.any():
            worst = x[outside].flat[np.argmax(np.abs(x[outside] - 0.5 * (low + high)))]
            warnings.warn(
                f"law {self.name} used at {self.variable} {worst:.4g}, {span}",
                ClosureWarning,
                stacklevel=2,
            )
        return np.broadcast_to(lam, shape).copy()[()]

    def inertia(self, reynolds: ArrayLike, porosity: ArrayLike, lam: ArrayLike) -> Float:
        """Factor on the Stokes drag at Re = ρ U d/μ, U superficial; 1 for a Stokes law."""
        return np.ones(np.broadcast(reynolds, porosity, lam).shape)[()]


def drag_coefficient(
    law: Law,
    porosity: ArrayLike,
    gap: ArrayLike,
    diameter: ArrayLike,
    viscosity: float,
    density: float = 0.0,
    speed: ArrayLike = 0.0,
) -> Float:
    """Drag coefficient β = μ ε²/(d² λ), Eq. (3), times the inertia of the law [Pa s/m2].

    Parameters
    ----------
    law : Law
        The closure.
    porosity, gap : array_like
        ε and γ, as in `Law.__call__`.
    diameter : array_like
        Diameters d [m].
    viscosity : float
        μ [Pa s].
    density : float
        Density of the fluid ρ [kg/m3].
    speed : array_like
        Superficial speed U relative to the particles [m/s].

    Raises
    ------
    InputError
        If an argument is not physical.
    """
    eps, d = np.asarray(porosity, float), np.asarray(diameter, float)
    check("porosity", eps)
    check("diameter", d)
    check("viscosity", np.asarray(viscosity, float))
    for name, value in (("density", density), ("speed", speed)):
        if not (np.isfinite(value).all() and (np.asarray(value) >= 0.0).all()):
            raise InputError(f"{name} must be finite and not negative")
    lam = law(eps, gap)
    reynolds = density * np.asarray(speed, float) * d / viscosity
    beta = viscosity * eps**2 / (d**2 * lam)  # Eq. (3)
    return np.asarray(beta * law.inertia(reynolds, eps, lam))[()]


def check(name: str, x: Float) -> None:
    """Refuse what no medium can have: porosity outside (0, 1), anything else not positive."""
    bad = ~(np.isfinite(x) & (x > 0.0) & ((x < 1.0) | (name != "porosity")))
    if bad.any():
        need = "lie between 0 and 1" if name == "porosity" else "be positive"
        raise InputError(f"{name} {x[bad].flat[0]:g} must {need}")


def check_positive(law: Law, **parameters: float) -> None:
    """Refuse parameters of a law that are not positive."""
    for name, value in parameters.items():
        if not (isfinite(value) and value > 0.0):
            raise InputError(f"law {law.name}: {name} = {value:g} must be positive")
