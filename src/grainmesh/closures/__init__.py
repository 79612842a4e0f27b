"""Closures: the permeability of a medium of discs (fibres across the flow) from one number.

With the superficial velocity U, viscosity μ, diameter d, porosity ε and solid fraction φ = 1 - ε::

    U = -(K/μ) ∇p                                           Darcy                       (1)
    U = ε <u>                                               superficial, interstitial   (2)
    β = μ ε²/(d² λ),  λ = K/d²                              drag coefficient            (3)
    λ = C γ^2.5 (1 - a exp(-b γ))                           microstructural law         (4)

where γ is the mean over Delaunay triangles of their shortest edge, divided by d, minus 1. Numbers
of equations are those of Yazdchi, Srivastava & Luding, Powders & Grains 2013.

A law holds for one class of microstructure in one range, and says so: every law carries its
`medium`, `valid` range, stated `error` and `reference`, warns outside the range, and refuses
arguments that have no meaning. Every law takes porosity and gap, and uses the one it needs, so that
any of them can stand in the coupled model.
"""

from __future__ import annotations

from grainmesh.closures.lattices import (
    DrummondTahir,
    Gebart,
    HexagonalLattice,
    LeeYang,
    SquareLattice,
    lattice_gap,
)
from grainmesh.closures.law import ClosureWarning, Law, drag_coefficient
from grainmesh.closures.media import (
    CarmanKozeny,
    Ergun2D,
    Forchheimer,
    Happel,
    Kuwabara,
    Microstructural,
)

#: Every law by its name, with the parameters of its source.
LAWS: dict[str, Law] = {
    law.name: law
    for law in (
        Microstructural(),
        SquareLattice(),
        HexagonalLattice(),
        Gebart("square"),
        Gebart("hexagonal"),
        DrummondTahir("square"),
        DrummondTahir("hexagonal"),
        LeeYang(),
        Kuwabara(),
        Happel(),
        CarmanKozeny(),
        Ergun2D(),
        Forchheimer(),
    )
}

__all__ = [
    "LAWS",
    "CarmanKozeny",
    "ClosureWarning",
    "DrummondTahir",
    "Ergun2D",
    "Forchheimer",
    "Gebart",
    "Happel",
    "HexagonalLattice",
    "Kuwabara",
    "Law",
    "LeeYang",
    "Microstructural",
    "SquareLattice",
    "drag_coefficient",
    "lattice_gap",
]
