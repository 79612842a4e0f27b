"""Laws of the square and the hexagonal lattice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from math import pi, sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from grainmesh.closures.law import Float, Law, check
from grainmesh.errors import InputError

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline


def _dilute_square(phi: Float) -> Float:
    # Drummond & Tahir 1984, with the constant of Sangani & Acrivos 1982 to seven digits.
    tail = (2.0 * phi - 0.796 * phi**2) / (1.0 + 0.489 * phi - 1.605 * phi**2)
    return np.asarray((-np.log(phi) - 1.476336 + tail) / (32.0 * phi))


def _dilute_hexagonal(phi: Float) -> Float:
    tail = 2.0 * phi - 0.5 * phi**2 - 0.739 * phi**4 + 2.534 * phi**5 / (1.0 + 1.2758 * phi)
    return np.asarray((-np.log(phi) - 1.497504 + tail) / (32.0 * phi))


@dataclass(frozen=True)
class _Lattice:
    """Exact permeability of a lattice of equal discs across the flow."""

    name: str
    phi_max: float
    c: float  # λ -> c γ^2.5 towards close packing
    dilute: Callable[[Float], Float]

    def gap(self, phi: Float) -> Float:
        """γ = pitch/d - 1; the shortest edge of every triangle is the pitch."""
        return np.asarray(np.sqrt(self.phi_max / phi) - 1.0)

    def lubrication(self, phi: Float) -> Float:
        """λ if all the resistance lay in the gaps.

        Through a gap of width γ d + x²/r goes the flux q = 2 √2 (γ d)^2.5 Δp/(9 π μ √d). The pores
        and gaps are a network of the conductance q/Δp: square, or a honeycomb with its 1/√3.
        """
        return np.asarray(self.c * self.gap(phi) ** 2.5)

    @cached_property
    def _table(self) -> tuple[float, CubicSpline]:
        # log(λ/lubrication) is smooth in s = √(φ/φ_max), and 0 at s = 1.
        from scipy.interpolate import CubicSpline  # late: a tenth of a second

        table = files("grainmesh").joinpath("data/lattice_permeability.csv").read_text("utf-8")
        lines = [line for line in table.splitlines() if not line.startswith("#")]
        rows = np.genfromtxt(lines, delimiter=",", names=True)
        known = np.isfinite(rows[self.name])
        phi, lam = rows["solid_fraction"][known], rows[self.name][known]
        s = np.append(np.sqrt(phi / self.phi_max), 1.0)
        ratio = np.append(np.log(lam / self.lubrication(phi)), 0.0)
        near = phi[0] * np.array([1.0 - 1e-5, 1.0 + 1e-5])  # the slope of the series, below
        rise = np.diff(np.log(self.dilute(near) / self.lubrication(near)))
        slope = float(rise[0] / np.diff(np.sqrt(near / self.phi_max))[0])
        return float(phi[0]), CubicSpline(s, ratio, bc_type=((1, slope), "not-a-knot"))

    def permeability(self, phi: Float) -> Float:
        """λ: the dilute series below the table, the spline from there to close packing."""
        first, log_ratio = self._table
        inside = np.maximum(phi, first)
        dense = self.lubrication(inside) * np.exp(log_ratio(np.sqrt(inside / self.phi_max)))
        return np.where(phi < first, self.dilute(phi), dense)


_LATTICES = {
    lattice.name: lattice
    for lattice in (
        _Lattice("square", pi / 4.0, 4.0 / (9.0 * pi * sqrt(2.0)), _dilute_square),
        _Lattice("hexagonal", pi / sqrt(12.0), 4.0 / (9.0 * pi * sqrt(6.0)), _dilute_hexagonal),
    )
}


def _lattice(name: str) -> _Lattice:
    if name not in _LATTICES:
        raise InputError(f"unknown lattice {name!r}: use {' or '.join(_LATTICES)}")
    return _LATTICES[name]


def lattice_gap(lattice: str, porosity: ArrayLike) -> Float:
    """γ = pitch/d - 1 = √(φ_max/φ) - 1 of a ``"square"`` or ``"hexagonal"`` lattice.

    Raises
    ------
    InputError
        If the lattice is unknown or the porosity not between 0 and 1.
    """
    eps = np.asarray(porosity, float)
    check("porosity", eps)
    return _lattice(lattice).gap(1.0 - eps)[()]


class _LatticeLaw(Law):
    """A porosity law that comes for the square and the hexagonal lattice."""

    lattice: str
    variable = "porosity"

    @property
    def _cell(self) -> _Lattice:
        return _lattice(self.lattice)

    @property
    def medium(self) -> str:
        return f"{self.lattice} lattice"


class _ExactLattice(_LatticeLaw):
    """Table, dilute series and lubrication limit as one law."""

    reference = (
        "multipole collocation and finite elements; dilute: Sangani & Acrivos, "
        "Int. J. Multiphase Flow 8 (1982) 193; dense: lubrication theory"
    )
    error = 1e-4

    @property
    def name(self) -> str:
        return f"{self.lattice}-lattice"

    @property
    def valid(self) -> tuple[float, float]:
        return (1.0 - self._cell.phi_max, 1.0)

    def _permeability(self, x: Float) -> Float:
        return self._cell.permeability(1.0 - x)


@dataclass(frozen=True)
class SquareLattice(_ExactLattice):
    """The exact law of the square lattice, interpolated to 1e-4 at every porosity."""

    lattice = "square"


@dataclass(frozen=True)
class HexagonalLattice(_ExactLattice):
    """The exact law of the hexagonal lattice, interpolated to 1e-4 at every porosity."""

    lattice = "hexagonal"


@dataclass(frozen=True)
class Gebart(_LatticeLaw):
    """Lubrication theory carried to all porosities, K/r² = c₁ (√(φ_max/φ) - 1)^2.5."""

    lattice: str

    reference = "Gebart, J. Compos. Mater. 26 (1992) 1100"

    def __post_init__(self) -> None:
        _lattice(self.lattice)

    @property
    def name(self) -> str:
        return f"gebart-{self.lattice}"

    @property
    def valid(self) -> tuple[float, float]:
        return (1.0 - self._cell.phi_max, 0.5 if self.lattice == "square" else 0.8)

    @property
    def error(self) -> float:
        return 0.1 if self.lattice == "square" else 0.02

    def _permeability(self, x: Float) -> Float:
        return self._cell.lubrication(1.0 - x)


@dataclass(frozen=True)
class DrummondTahir(_LatticeLaw):
    """The dilute series of a lattice."""

    lattice: str

    reference = "Drummond & Tahir, Int. J. Multiphase Flow 10 (1984) 515"

    def __post_init__(self) -> None:
        _lattice(self.lattice)

    @property
    def name(self) -> str:
        return f"drummond-tahir-{self.lattice}"

    @property
    def valid(self) -> tuple[float, float]:
        return (0.75 if self.lattice == "square" else 0.65, 1.0)

    @property
    def error(self) -> float:
        return 0.015 if self.lattice == "square" else 0.005

    def _permeability(self, x: Float) -> Float:
        return self._cell.dilute(1.0 - x)


@dataclass(frozen=True)
class LeeYang(Law):
    """λ = ε³ (ε - 0.2146)/(31 φ^1.3), fitted to flow across square arrays."""

    name = "lee-yang"
    reference = "Lee & Yang, Int. J. Heat Mass Transfer 40 (1997) 3149"
    medium = "square lattice"
    variable = "porosity"
    valid = (0.4, 0.9)
    error = 0.04

    def _permeability(self, x: Float) -> Float:
        return x**3 * (x - 0.2146) / (31.0 * (1.0 - x) ** 1.3)
