"""From particle positions to permeability, by three methods.

================== ==============================================================================
``resolved``       Stokes flow around the discs as holes (`resolved`): the truth, to a tolerance.
``mesoscale``      Porosity-scaled Stokes flow on the Delaunay mesh of the centres (`fluid`), with
                   a drag law: a few unknowns per particle.
``microstructure`` Eq. (4): lambda = C γ^2.5 (1 - exp(-3 γ)/2) from the gaps γ of the triangulation
                   (or another law of `closures`): milliseconds.
================== ==============================================================================
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from math import hypot, isfinite, isnan, nan
from time import perf_counter
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from grainmesh import fluid, resolved
from grainmesh.cells import cells
from grainmesh.closures import ClosureWarning, Law, Microstructural
from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.links import CLOSED
from grainmesh.particles import Particles, settle
from grainmesh.plain import plain
from grainmesh.triangulation import Triangulation, triangulate

Method = Literal["resolved", "mesoscale", "microstructure"]
METHODS: tuple[str, ...] = get_args(Method)

#: An arrangement counts as regular if its gaps scatter by less than this share of their mean, as
#: random if by more than the second, and as neither if there are fewer triangles than the third.
REGULAR, RANDOM, FEW = 1e-3, 0.2, 8


@dataclass(frozen=True, eq=False)
class Permeability:
    """Permeability of a box of discs, Darcy's law (1): U = -K ∇p / mu, U superficial (2).

    Attributes
    ----------
    method : str
    tensor : ndarray, shape (2, 2)
        K [m2]; column k belongs to a pressure gradient along axis k.
    diameter : float
        Mean diameter d [m].
    porosity : float
        Fluid share of the box.
    gap : float
        γ, mean shortest edge of the Delaunay triangles over d, minus 1; nan without a triangle of
        three discs.
    n : int
        Number of discs.
    dofs : int
        Unknowns solved for.
    seconds : float
        Wall time.
    error : float
        Estimated relative error: of discretisation, and of the law where one is used.
    notes : tuple of str
        What a careful reader must know of this result.
    detail : Resolved, Mesoscale or None
        The flow: fields, forces on each disc.
    """

    method: str
    tensor: NDArray[np.float64]
    diameter: float
    porosity: float
    gap: float
    n: int
    dofs: int
    seconds: float
    error: float
    notes: tuple[str, ...]
    detail: resolved.Resolved | fluid.Mesoscale | None

    def __repr__(self) -> str:
        (xx, _), (_, yy) = self.tensor
        return (
            f"Permeability ({self.method}): K/d² = {self.normalised:.4g} ± "
            f"{percent(self.error)}, Kxx = {xx:.3g} m², Kyy = {yy:.3g} m²; "
            f"{self.n} discs, d = {self.diameter:.4g} m, porosity {self.porosity:.4f}, "
            f"gap {'-' if isnan(self.gap) else f'{self.gap:.4g}'}; {self.dofs} unknowns, "
            f"{self.seconds:.2g} s" + "".join(f"; {note}" for note in self.notes)
        )

    def to_dict(self) -> dict[str, Any]:
        """As plain numbers, ready for JSON, without `detail`; SI, None for what is not finite."""
        names = ("method", "porosity", "n", "diameter", "gap", "tensor", "normalised", "dofs")
        found: dict[str, Any] = plain(
            {name: getattr(self, name) for name in (*names, "seconds", "error", "notes")}
        )
        return found

    @property
    def normalised(self) -> float:
        """λ = tr(K) / 2 / d²."""
        return float(np.trace(self.tensor)) / 2.0 / self.diameter**2


def percent(error: float) -> str:
    """A relative error with two digits, without a power of ten; "-" for what is not finite."""
    if not isfinite(error):
        return "-"
    return f"{100 * error:.0f} %" if error >= 0.1 else f"{100 * error:.2g} %"


def permeability(
    box: Box,
    particles: Particles,
    method: str = "resolved",
    *,
    walls: resolved.Walls = "symmetry",
    law: Law | None = None,
    tol: float = 1e-3,
    order: int | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Permeability:
    """Permeability of a box of discs.

    Parameters
    ----------
    box : Box
        Periodic, or with walls: then a pressure drop along x gives the first column of the tensor,
        along y the second, and of a disc cut by the edge the part inside counts in every method.
    particles : Particles
    method : {"resolved", "mesoscale", "microstructure"}
    walls : {"symmetry", "no-slip"}
        The two sides along the flow, in a box with walls.
    law : closures.Law, optional
        Drag law of ``mesoscale`` and ``microstructure``; by default Eq. (4), for random discs.
    tol : float
        Relative tolerance of ``resolved``.
    order : int, optional
        Polynomial order of the velocity: by default raised to meet `tol` (``resolved``), or 2.
    progress : callable, optional
        Is told each stage in a few words.

    Returns
    -------
    Permeability

    Raises
    ------
    InputError
        No box, no particles, unknown method, or discs that no method can use (see
        `particles.settle`).
    """
    if not (isinstance(box, Box) and isinstance(particles, Particles)):
        raise InputError("permeability takes the box first, then the particles")
    if method not in METHODS:
        raise InputError(f"method '{method}' unknown: use one of {', '.join(METHODS)}")
    if walls not in get_args(resolved.Walls):
        raise InputError(f"walls '{walls}' unknown: use {' or '.join(get_args(resolved.Walls))}")
    if not 0.0 < tol < 1.0:
        raise InputError(f"tolerance {tol:g} must lie between 0 and 1")
    if order is not None and order != int(order):
        raise InputError(f"order {order:g} must be a whole number")
    start = perf_counter()
    particles = settle(box, particles)
    progress("triangulating")
    triangulation = triangulate(box, particles)
    porosity = 1.0 - float(cells(box, particles).solid.sum()) / box.area
    try:
        gap = triangulation.gap_shortest
    except InputError:
        if method != "resolved":
            raise
        gap = nan
    notes: tuple[str, ...] = ()
    detail: resolved.Resolved | fluid.Mesoscale | None = None
    if method == "resolved":
        flow = resolved.solve(box, particles, walls=walls, tol=tol, order=order, progress=progress)
        detail, tensor, error, dofs = flow, flow.tensor, flow.error, flow.dofs
        notes = _resolved_notes(flow, tol if order is None else 1.0)
    else:
        law = Microstructural() if law is None else law
        misfit = _misfit(law, triangulation)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", ClosureWarning)
            if method == "mesoscale":
                coarse = fluid.solve(
                    box, particles, law, order=2 if order is None else order, walls=walls
                )
                detail, tensor, dofs, error = coarse, coarse.tensor, coarse.dofs, coarse.error
            else:
                value = float(law(porosity, gap))
                tensor, dofs, error = value * particles.mean_diameter**2 * np.eye(2), 0, 0.0
        notes = tuple(dict.fromkeys((*misfit, *(str(w.message) for w in caught))))
        for note in notes:
            warnings.warn(note, ClosureWarning, stacklevel=2)
        error = hypot(error, _sampling_error(law, porosity, triangulation), law.error)
        error = max(error, 1.0) if misfit else error  # the law says nothing of this medium
    return Permeability(
        method=method,
        tensor=tensor,
        diameter=particles.mean_diameter,
        porosity=porosity,
        gap=gap,
        n=len(particles),
        dofs=dofs,
        seconds=perf_counter() - start,
        error=error,
        notes=notes,
        detail=detail,
    )


def _sampling_error(law: Law, porosity: float, triangulation: Triangulation) -> float:
    """Relative error of λ because the mean gap is one of finitely many triangles."""
    gap = triangulation.gap_shortest
    relative = triangulation.gap_scatter / np.sqrt(len(triangulation.triangles))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClosureWarning)
        low, high = np.log(law(porosity, gap * np.array([0.99, 1.01])))
    return float(abs(high - low) / np.log(1.01 / 0.99) * relative)


def _misfit(law: Law, triangulation: Triangulation) -> tuple[str, ...]:
    """Says so if a law for random discs meets a lattice, or a law of a lattice random discs."""
    scatter = triangulation.gap_scatter
    if len(triangulation.triangles) < FEW:
        return ()
    if "random" in law.medium and scatter < REGULAR:
        return (
            f"the discs form a regular lattice, but the law {law.name} is for random ones: "
            "choose square-lattice or hexagonal-lattice",
        )
    if "lattice" in law.medium and scatter > RANDOM:
        return (
            f"the discs are at random, but the law {law.name} is for a regular lattice: "
            "choose microstructural",
        )
    return ()


def _resolved_notes(flow: resolved.Resolved, tol: float) -> tuple[str, ...]:
    notes = []
    blocked = [axis for axis, k in zip("xy", np.diag(flow.tensor), strict=True) if k == 0.0]
    if blocked:
        notes.append(f"no flow along {' and '.join(blocked)}: the pores are blocked")
    if flow.closed:
        notes.append(f"{flow.closed} gaps below {CLOSED:g} of the smaller radius were closed")
    if flow.error > tol:
        notes.append(f"order {flow.order} reaches an estimated error of {flow.error:.1g} only")
    return tuple(notes)


__all__ = ["METHODS", "Method", "Permeability", "permeability"]
