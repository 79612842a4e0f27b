"""Laws of random media and of the single cell."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from grainmesh.closures.law import Float, Law, check_positive
from grainmesh.errors import InputError


@dataclass(frozen=True)
class Microstructural(Law):
    """The microstructural law λ = C γ^2.5 (1 - a exp(-b γ)), Eq. (4).

    For **random** arrays of equal discs of porosity 0.4 to 0.9, against resolved Stokes flow:
    C = 0.2 suits discs kept apart by 0.1 d (within 20 %, mostly 10 %); equilibrated hard discs
    without a minimum gap have smaller γ and conduct more, C = 0.27, so that samples of 100 lie up
    to 45 % above the law with C = 0.2 (``docs/random_arrays.md``). For **ordered** arrays it is
    1.3 to 3.7 times too high:
    use `SquareLattice` or `HexagonalLattice` there. The parameters are free, to be fitted to a
    medium of one's own.
    """

    C: float = 0.2
    a: float = 0.5
    b: float = 3.0

    name = "microstructural"
    reference = "Yazdchi, Srivastava & Luding, Powders & Grains 2013, Eq. (4)"
    medium = "random discs"
    variable = "gap"
    valid = (0.07, 1.3)  # γ of random arrays at porosity 0.35 and 0.9
    error = 0.35

    def __post_init__(self) -> None:
        check_positive(self, C=self.C, b=self.b)
        if not (isfinite(self.a) and self.a <= 1.0):
            raise InputError(f"law {self.name}: a = {self.a:g} must not exceed 1")

    def _permeability(self, x: Float) -> Float:
        return self.C * x**2.5 * (1.0 - self.a * np.exp(-self.b * x))  # Eq. (4)


@dataclass(frozen=True)
class CarmanKozeny(Law):
    """λ = ε³/(16 k φ²): a bundle of tubes of the same specific surface, Kozeny constant k.

    It does not know the arrangement. The stated error is against the hexagonal lattice; for random
    arrays it is 2 to 6 times too high.
    """

    k: float = 5.0

    name = "carman-kozeny"
    reference = "Carman, Trans. Inst. Chem. Eng. 15 (1937) 150"
    medium = "hexagonal lattice, order of magnitude"
    variable = "porosity"
    valid = (0.3, 0.7)
    error = 0.8

    def __post_init__(self) -> None:
        check_positive(self, k=self.k)

    def _permeability(self, x: Float) -> Float:
        return x**3 / (16.0 * self.k * (1.0 - x) ** 2)


@dataclass(frozen=True)
class Ergun2D(Law):
    """Ergun's law with the specific surface of cylinders, λ = ε³/(66.7 φ²), with inertia.

    -dp/dx = 66.7 μ φ² U/(ε³ d²) + 1.167 ρ φ U²/(ε³ d). The stated error is against the hexagonal
    lattice at Re = 0; for random arrays λ is 2 to 7 times too high. A third-party form: not checked
    against the original paper; fit your own from resolved flow where inertia matters.
    """

    name = "ergun-2d"
    reference = "Ergun, Chem. Eng. Prog. 48 (1952) 89, rewritten for cylinders"
    medium = "hexagonal lattice, order of magnitude"
    variable = "porosity"
    valid = (0.3, 0.7)
    error = 1.2

    def _permeability(self, x: Float) -> Float:
        return x**3 / (66.7 * (1.0 - x) ** 2)

    def inertia(self, reynolds: ArrayLike, porosity: ArrayLike, lam: ArrayLike) -> Float:
        """1 + (1.167/66.7) Re/φ."""
        re, eps, lam = (np.asarray(v, float) for v in (reynolds, porosity, lam))
        return np.asarray(1.0 + 1.167 / 66.7 * re / (1.0 - eps) + 0.0 * lam)[()]


@dataclass(frozen=True)
class Forchheimer(Law):
    """A Stokes law with small inertia: -dp/dx = (μ U/K) [1 + c (√K/d) Re^p/ε^1.5].

    p = 1 with the permeability of `Ergun2D` is Ergun's law. A third-party form: neither c = 0.1429
    nor p = 1.6 was checked against the original paper; fit your own from resolved flow. Medium,
    range and error are those of the Stokes law at Re = 0; no error is stated for the inertia.
    """

    stokes: Law = Microstructural()
    p: float = 1.6
    coefficient: float = 0.1429

    name = "forchheimer"

    def __post_init__(self) -> None:
        if isinstance(self.stokes, (Forchheimer, Ergun2D)):
            raise InputError(f"law {self.name} needs a Stokes law, {self.stokes.name} has inertia")
        check_positive(self, p=self.p, coefficient=self.coefficient)

    @property
    def reference(self) -> str:
        return f"{self.stokes.reference}; inertia cf. Chem. Eng. J. 207 (2012) 35, not checked"

    @property
    def medium(self) -> str:
        return self.stokes.medium

    @property
    def variable(self) -> str:
        return self.stokes.variable

    @property
    def valid(self) -> tuple[float, float]:
        return self.stokes.valid

    @property
    def error(self) -> float:
        return self.stokes.error

    def _permeability(self, x: Float) -> Float:
        return self.stokes._permeability(x)

    def inertia(self, reynolds: ArrayLike, porosity: ArrayLike, lam: ArrayLike) -> Float:
        """1 + c √λ Re^p/ε^1.5."""
        re, eps, lam = (np.asarray(v, float) for v in (reynolds, porosity, lam))
        return np.asarray(1.0 + self.coefficient * np.sqrt(lam) * re**self.p / eps**1.5)[()]


@dataclass(frozen=True)
class Kuwabara(Law):
    """Disc in a concentric cell without vorticity at its edge: close to the hexagonal lattice."""

    name = "kuwabara"
    reference = "Kuwabara, J. Phys. Soc. Jpn 14 (1959) 527"
    medium = "hexagonal lattice, dilute"
    variable = "porosity"
    valid = (0.6, 1.0)
    error = 0.01

    def _permeability(self, x: Float) -> Float:
        phi = 1.0 - x
        return (-np.log(phi) - 1.5 + 2.0 * phi - 0.5 * phi**2) / (32.0 * phi)


@dataclass(frozen=True)
class Happel(Law):
    """Disc in a concentric cell without shear at its edge: permeable by up to a half too much."""

    name = "happel"
    reference = "Happel, AIChE J. 5 (1959) 174"
    medium = "hexagonal lattice, order of magnitude"
    variable = "porosity"
    valid = (0.5, 1.0)
    error = 0.45

    def _permeability(self, x: Float) -> Float:
        phi = 1.0 - x
        return (-np.log(phi) - (1.0 - phi**2) / (1.0 + phi**2)) / (32.0 * phi)
