"""Drag laws: the force of the fluid on each disc, per unit depth, from the flow about it.

With the mean velocity of the fluid about disc i, <u>_i, and its own, u_i::

    F_i = b_i (<u>_i - u_i),   b_i = β_i A_i                                                    (1)

The pressure force -V_i <∇p> acts on the disc besides and is no part of b. A law of a *bed* takes
β from a permeability λ = K/d², Eqs. (2)-(3) of `grainmesh.closures`, f the inertia of the law::

    β = f(Re) μ ε²/(d² λ),   Re = ρ ε |<u> - u_i| d/μ                                           (2)

Discs at random (`RandomDiscs`), against the hexagonal lattice, with φ = 1 - ε::

    λ = λ_hex (1 + a/(1 - ln φ)) exp(-b φ^c)                                                    (3)

A law of a *single particle* takes the velocity far away, Re = ρ |<u> - u_i| d/μ::

    b = 4πμ/S,   S = ln(8/Re) + 1/2 - γ_E                      cylinder, Re -> 0                (4)
    b = 4πμ (1/S - 0.87/S³)                                    the same, next order             (5)
    b = μ Re C_D/2,   C_D = 1 + 10 Re^(-2/3)                   cylinder, 1 < Re < 2e5           (6)
    b = 4πμ/(ln(W/d) - 0.9157 + 1.7244 (d/W)² - 1.7302 (d/W)⁴) cylinder between walls           (7)
    b = 3πμ d/h                                                sphere in a sheet of depth h     (8)
    b = 3πμ d/h max(1 + 0.15 Re^0.687, 0.44 Re/24)             the same with inertia            (9)

Every law answers for every bed with a positive, finite number: beyond the point where a formula
ends it is held there, as its docstring says, and outside its range it warns once.
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property, partial
from math import isfinite, pi

import numpy as np

from grainmesh.closures import LAWS, ClosureWarning, HexagonalLattice
from grainmesh.closures.law import Float, Law
from grainmesh.errors import InputError

#: Porosity of discs in closest packing: overlaps can make a cell denser, the laws are held here.
LEAST_POROSITY = 1.0 - pi / 12.0**0.5

#: Below it the laws of the cylinder in an infinite fluid are held: their b would fall to 0.
LEAST_REYNOLDS = 1e-6

_HEXAGONAL = HexagonalLattice()


@dataclass(frozen=True, eq=False)
class Bed:
    """What a drag law may look at: n discs and the fluid about them.

    Attributes
    ----------
    mu : float
        Viscosity μ [Pa s].
    rho : float
        Density of the fluid ρ [kg/m3].
    diameter : ndarray, shape (n,)
        Diameters d [m].
    porosity : ndarray, shape (n,)
        ε_i = 1 - V_i/A_i of each disc's own cell.
    area : ndarray, shape (n,)
        Areas of the cells A_i [m2].
    slip : ndarray, shape (n,)
        |<u>_i - u_i| [m/s].
    gap : float
        γ: mean over the triangles of their shortest edge / d - 1.
    width : float
        Distance of the walls on both sides of the way of a particle, W [m].
    """

    mu: float
    rho: float
    diameter: Float
    porosity: Float
    area: Float
    slip: Float
    gap: float
    width: float

    @property
    def reynolds(self) -> Float:
        """Re = ρ |<u> - u_i| d/μ, shape (n,)."""
        return self.rho * self.slip * self.diameter / self.mu


class Drag(ABC):
    """A drag law: `coefficient` gives b_i of Eq. (1).

    A subclass is a frozen dataclass with the facts below, `_argument` and `_coefficient`.
    """

    #: Written for the velocity far away: the caller takes out what the particle itself adds to <u>.
    undisturbed: bool = False

    @property
    @abstractmethod
    def name(self) -> str:
        """Name in a case file, the key in `DRAGS`."""

    @property
    @abstractmethod
    def reference(self) -> str:
        """Where the law comes from."""

    @property
    @abstractmethod
    def medium(self) -> str:
        """What it describes."""

    @property
    @abstractmethod
    def variable(self) -> str:
        """The number whose range is `valid`."""

    @property
    @abstractmethod
    def valid(self) -> tuple[float, float]:
        """Range of `variable` in which the law is meant to hold."""

    @abstractmethod
    def _argument(self, bed: Bed) -> Float:
        """`variable` of each disc."""

    @abstractmethod
    def _coefficient(self, bed: Bed) -> Float:
        """b of each disc."""

    def coefficient(self, bed: Bed) -> Float:
        """Drag coefficient b_i, Eq. (1).

        Parameters
        ----------
        bed : Bed

        Returns
        -------
        ndarray, shape (n,)
            b_i [N s/m2 per metre of depth], positive and finite.

        Warns
        -----
        ClosureWarning
            The first time that more than half of the discs are outside `valid`; never again for
            this object. Half, because single cells scatter about the porosity of their bed.
        """
        low, high = self.valid
        x = self._argument(bed)
        outside = (x < low) | (x > high)
        if 2 * np.count_nonzero(outside) > len(x) and "_warned" not in vars(self):
            warnings.warn(
                f"drag law {self.name} used at {self.variable} {np.median(x[outside]):.4g}, "
                f"its range is {low:.4g} to {high:.4g}",
                ClosureWarning,
                stacklevel=2,
            )
            vars(self)["_warned"] = True  # not a field: equal laws stay equal
        return self._coefficient(bed)


@dataclass(frozen=True)
class RandomDiscs(Law):
    """Equal discs at random that may come as near as they like, Eq. (3): suspensions, beds.

    Equilibrated hard discs, as crowded grains in motion are; below porosity 0.3 they order
    themselves. a, b, c are fitted to resolved Stokes flow through 88 periodic samples of 50 discs,
    porosity 0.25 to 0.98 (``python docs/drag.py``): means of eight samples lie within 11 % of it, a
    single one scatters by 3 % (dilute) to 29 % (dense). λ closes as γ^2.5 with the lattice, and
    keeps within 5 % of Brinkman's self-consistent solution down to φ = 1e-8. Discs kept apart
    conduct more: by a minimum gap of 0.1 d, twice as much at porosity 0.4.
    """

    name = "random-discs"
    reference = "fitted to resolved flow, docs/drag.md"
    medium = "random discs, free to touch"
    variable = "porosity"
    valid = (0.2, 1.0)
    error = 0.2

    def _permeability(self, x: Float) -> Float:
        phi = 1.0 - x
        a, b, c = 2.3, 3.75, 1.2
        random = (1.0 + a / (1.0 - np.log(phi))) * np.exp(-b * phi**c)
        return _HEXAGONAL._permeability(x) * random  # Eq. (3)


@dataclass(frozen=True)
class Permeability(Drag):
    """Drag in a bed from any permeability law, Eq. (2).

    A law of the gap gets the gap of the bed, one of the porosity the porosity of each disc's own
    cell, and ε in Eq. (2) as well. Each is held at `least` (and ε at the closest packing), so that
    discs pressed together keep a finite drag.
    """

    law: Law = RandomDiscs()

    @property
    def name(self) -> str:
        return self.law.name

    @property
    def reference(self) -> str:
        return self.law.reference

    @property
    def medium(self) -> str:
        return self.law.medium

    @property
    def variable(self) -> str:
        return self.law.variable

    @property
    def valid(self) -> tuple[float, float]:
        return self.law.valid

    @cached_property
    def least(self) -> float:
        """Least porosity (or gap): the first hundredth from which λ > 0 and the drag falls."""
        x = np.arange(1, 100) / 100.0
        with np.errstate(invalid="ignore", divide="ignore"):
            lam = self.law._permeability(x)
            sound = (lam > 0.0) & (np.diff(x**2 / lam, append=-np.inf) < 0.0)
        first = 0 if sound.all() else np.flatnonzero(~sound)[-1] + 1
        return float(x[first])

    def _argument(self, bed: Bed) -> Float:
        if self.variable == "porosity":
            return bed.porosity
        if not isfinite(bed.gap):
            raise InputError(
                f"drag law {self.name} needs gaps between particles, and there are too few: "
                f"use a law of the porosity, as {RandomDiscs.name}"
            )
        return np.full_like(bed.area, bed.gap)

    def _coefficient(self, bed: Bed) -> Float:
        by_porosity = self.variable == "porosity"
        least = max(self.least, LEAST_POROSITY) if by_porosity else LEAST_POROSITY
        eps = np.clip(bed.porosity, least, 1.0 - 1e-12)
        x = eps if by_porosity else np.maximum(self._argument(bed), self.least)
        lam = self.law._permeability(x)
        beta = bed.mu * eps**2 / (bed.diameter**2 * lam)
        return beta * self.law.inertia(eps * bed.reynolds, eps, lam) * bed.area  # Eqs. (1), (2)


class _Single(Drag):
    """A particle alone, told by its Reynolds number."""

    undisturbed = True
    variable = "Re"

    def _argument(self, bed: Bed) -> Float:
        return bed.reynolds


def _lamb(reynolds: Float) -> Float:
    """S of Eq. (4), held outside 1e-6 < Re < 1: it would grow without limit, or vanish at 7.4."""
    return np.log(8.0 / np.clip(reynolds, LEAST_REYNOLDS, 1.0)) + 0.5 - np.euler_gamma


@dataclass(frozen=True)
class Lamb(_Single):
    """Cylinder in slow flow without end, Eq. (4): 5 % too much at Re = 0.1, 2 % at 0.01.

    b is held below Re = 1e-6 and above 1.
    """

    name = "lamb"
    reference = "Lamb, Phil. Mag. 21 (1911) 112"
    medium = "one cylinder, Re < 0.1"
    valid = (0.0, 0.1)

    def _coefficient(self, bed: Bed) -> Float:
        return 4.0 * pi * bed.mu / _lamb(bed.reynolds)  # Eq. (4)


@dataclass(frozen=True)
class White(_Single):
    """Cylinder in faster flow, Eq. (6); b is held below Re = 1."""

    name = "white"
    reference = "White, Viscous Fluid Flow, McGraw-Hill"
    medium = "one cylinder, Re > 1"
    valid = (1.0, 2e5)

    def _coefficient(self, bed: Bed) -> Float:
        re = np.maximum(bed.reynolds, 1.0)
        return 0.5 * bed.mu * (re + 10.0 * np.cbrt(re))  # Eq. (6)


@dataclass(frozen=True)
class Cylinder(_Single):
    """Cylinder at any Re: Eq. (5) up to 0.2, Eq. (6) from 1 on, a smooth step in ln Re between.

    The two cross at Re = 0.4 and are within 3 % of each other from 0.3 to 0.5. Held below 1e-6.
    """

    name = "cylinder"
    reference = "Kaplun, J. Math. Mech. 6 (1957) 595; White, Viscous Fluid Flow, McGraw-Hill"
    medium = "one cylinder"
    valid = (0.0, 2e5)

    def _coefficient(self, bed: Bed) -> Float:
        re = np.maximum(bed.reynolds, LEAST_REYNOLDS)
        s = _lamb(re)
        slow = 4.0 * pi * bed.mu * (1.0 / s - 0.87 / s**3)  # Eq. (5)
        fast = 0.5 * bed.mu * (re + 10.0 * np.cbrt(re))  # Eq. (6)
        t: Float = np.clip(np.log(re / 0.2) / np.log(5.0), 0.0, 1.0)
        return slow + t**2 * (3.0 - 2.0 * t) * (fast - slow)


@dataclass(frozen=True)
class Channel(Drag):
    """Cylinder midway between two walls in Stokes flow, Eq. (7).

    The next term of the series is 0.4 % at d/W = 0.3 and 4 % at 0.4; b is held above d/W = 0.5,
    since the formula has no answer at 0.6.
    """

    name = "channel"
    reference = "Faxen 1946, in Happel & Brenner, Low Reynolds Number Hydrodynamics"
    medium = "one cylinder between walls, Re << 1"
    variable = "d/W"
    valid = (0.0, 0.3)
    undisturbed = True

    def _argument(self, bed: Bed) -> Float:
        return bed.diameter / bed.width

    def _coefficient(self, bed: Bed) -> Float:
        k = np.clip(self._argument(bed), 1e-12, 0.5)
        s = -np.log(k) - 0.9157 + 1.7244 * k**2 - 1.7302 * k**4
        return 4.0 * pi * bed.mu / s  # Eq. (7)


@dataclass(frozen=True)
class _Sphere(_Single):
    """Spheres, one behind the other at a distance of `depth` [m], seen as discs of unit depth."""

    depth: float

    def __post_init__(self) -> None:
        if not (isfinite(self.depth) and self.depth > 0.0):
            raise InputError(f"drag law {self.name}: depth = {self.depth:g} must be positive [m]")


@dataclass(frozen=True)
class Stokes(_Sphere):
    """Sphere in slow flow, its force over the `depth` [m] of the sheet, Eq. (8)."""

    name = "stokes"
    reference = "Stokes, Trans. Camb. Phil. Soc. 9 (1851) 8"
    medium = "one sphere in a sheet, Re < 0.1"
    valid = (0.0, 0.1)

    def _coefficient(self, bed: Bed) -> Float:
        return 3.0 * pi * bed.mu * bed.diameter / self.depth  # Eq. (8)


@dataclass(frozen=True)
class SchillerNaumann(_Sphere):
    """Sphere at any Re, its force over the `depth` [m] of the sheet, Eq. (9).

    Schiller and Naumann's law up to Re of about 1000, from there Newton's C_D = 0.44.
    """

    name = "schiller-naumann"
    reference = "Schiller & Naumann, Z. Ver. Dtsch. Ing. 77 (1933) 318; Newton's C_D = 0.44"
    medium = "one sphere in a sheet"
    valid = (0.0, 2e5)

    def _coefficient(self, bed: Bed) -> Float:
        re = bed.reynolds
        factor = np.maximum(1.0 + 0.15 * re**0.687, 0.44 * re / 24.0)
        return 3.0 * pi * bed.mu * bed.diameter / self.depth * factor  # Eq. (9)


#: Every drag law by its name: call it, with the depth if it is one of spheres.
DRAGS: dict[str, Callable[..., Drag]] = {
    RandomDiscs.name: Permeability,
    **{name: partial(Permeability, law) for name, law in LAWS.items()},
    Lamb.name: Lamb,
    White.name: White,
    Cylinder.name: Cylinder,
    Channel.name: Channel,
    Stokes.name: Stokes,
    SchillerNaumann.name: SchillerNaumann,
}


def from_name(name: str, **parameters: float) -> Drag:
    """A new drag law by its name, which warns afresh.

    Parameters
    ----------
    name : str
        A key of `DRAGS`.
    **parameters : float
        ``depth`` [m] for the laws of spheres.

    Raises
    ------
    InputError
        If no law has this name, or the parameters are not those of the law.
    """
    if name not in DRAGS:
        near = get_close_matches(name, DRAGS, cutoff=0.4) or list(DRAGS)
        raise InputError(f"drag law '{name}' unknown: did you mean {', '.join(near)}?")
    needed = {"depth"} if name in (Stokes.name, SchillerNaumann.name) else set()
    if set(parameters) != needed:
        raise InputError(
            f"drag law {name} takes {'depth [m] (of the sheet)' if needed else 'no parameter'}, "
            f"not {', '.join(parameters) or 'none'}"
        )
    return DRAGS[name](**parameters)
