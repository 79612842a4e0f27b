r"""Stokes flow around discs as holes: the truth that closures are measured against.

    -mu ∇²u + ∇p = G,   ∇·u = 0,   u = 0 on discs,   K G = mu U,   U = ∫u dx / A

with Taylor-Hood elements P_k/P_{k-1} on curved triangles. A mean pressure gradient -G acts along x,
then along y; mean superficial velocities U give the columns of the permeability tensor K.

Periodic boxes: both columns from one factorisation. Boxes with walls: the pressure is given on the
two sides that G crosses, where the flow enters at right angles; the other two are symmetry planes
(the box is then a quarter of a periodic medium made of its mirror images) or no-slip walls.

The force on a disc is the reaction that holds it, the residual of the discrete equations, so
that forces and pressure gradient balance to round-off.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from ngsolve import (
    H1,
    BilinearForm,
    Grad,
    GridFunction,
    InnerProduct,
    LinearForm,
    Periodic,
    VectorH1,
    div,
    dx,
)
from numpy.typing import NDArray

from grainmesh.cells import cells
from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.holes import pore_mesh
from grainmesh.particles import Particles, settle
from grainmesh.plain import plain
from grainmesh.saddle import SaddleFactor, threads

Float = NDArray[np.float64]
Walls = Literal["symmetry", "no-slip"]

#: Orders of the velocity tried.
LOWEST, HIGHEST = 2, 8
#: The steps from order to order are taken to shrink by no less and no more than this.
RATIO = (0.2, 0.9)
#: Their ratio where only one step is known.
FIRST = 0.35
#: No flow: K below this, in mean diameters squared.
BLOCKED = 1e-13


@dataclass(frozen=True, eq=False)
class Resolved:
    """Resolved Stokes flow through a box of discs.

    Attributes
    ----------
    tensor : ndarray, shape (2, 2)
        Permeability [m2]; column k belongs to a pressure gradient along axis k. Diagonal in a box
        with walls, through whose sides nothing flows.
    force : ndarray, shape (2, n, 2)
        Force on each disc, per unit depth and unit pressure gradient [m2], for each direction; it
        includes the part of the mean pressure gradient, so that periodic forces sum to the area.
    error : float
        Estimated relative error of the tensor.
    order : int
        Polynomial order of the velocity.
    dofs : int
        Unknowns of velocity and pressure.
    closed : int
        Gaps closed (see `holes`).
    mesh : ngsolve.Mesh
        In units of `scale`.
    velocity : tuple of ngsolve.CoefficientFunction
        mu u / (G scale^2) for the two directions, on `mesh`.
    scale : float
        Length unit of `mesh` [m]: the mean diameter.
    """

    tensor: Float
    force: Float
    error: float
    order: int
    dofs: int
    closed: int
    mesh: Any
    velocity: tuple[Any, Any]
    scale: float

    def __repr__(self) -> str:
        (xx, _), (_, yy) = self.tensor
        return (
            f"Resolved: Kxx = {xx:.4g} m², Kyy = {yy:.4g} m² ± {100 * self.error:.2g} %, "
            f"{self.force.shape[1]} discs, order {self.order}, {self.dofs} unknowns"
        )

    def to_dict(self) -> dict[str, Any]:
        """As plain numbers, ready for JSON, without the fields on the mesh."""
        names = ("tensor", "force", "error", "order", "dofs", "closed")
        found: dict[str, Any] = plain({name: getattr(self, name) for name in names})
        return found


def solve(
    box: Box,
    particles: Particles,
    *,
    walls: Walls = "symmetry",
    tol: float = 1e-3,
    order: int | None = None,
    maxh: float | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Resolved:
    """Permeability tensor and forces, to a relative tolerance.

    Parameters
    ----------
    box : Box
    particles : Particles
    walls : {"symmetry", "no-slip"}
        What the two sides along the flow are; no matter in a periodic box.
    tol : float
        The order is raised until the estimated relative error is below this.
    order : int, optional
        Solve at this order (and the one below, for the estimate) whatever the error.
    maxh : float, optional
        Largest element [m]; by default one mean diameter, or more in dilute arrays.
    progress : callable, optional
        Is told each stage in a few words.

    Raises
    ------
    InputError
        For particles that `particles.settle` refuses, or an unknown `walls`.
    """
    if walls not in ("symmetry", "no-slip"):
        raise InputError(f"walls '{walls}' unknown: use symmetry or no-slip")
    if order is not None and not LOWEST < order <= HIGHEST:
        raise InputError(f"order {order} of the resolved flow must be {LOWEST + 1} to {HIGHEST}")
    particles = settle(box, particles)
    scale = particles.mean_diameter
    unit_box = Box(box.width / scale, box.height / scale, box.periodic)
    unit = Particles(particles.x / scale, particles.diameter / scale)
    progress("meshing the pores")
    coarse = max(1.0, 0.3 * (unit_box.area / len(unit)) ** 0.5)
    pores = pore_mesh(unit_box, unit, coarse if maxh is None else maxh / scale)
    solid = cells(unit_box, unit).solid
    orders = range(LOWEST, HIGHEST + 1) if order is None else (order - 1, order)
    tensors: list[Float] = []
    for k in orders:
        progress(f"Stokes flow, order {k}")
        flows = _stokes(unit_box, pores.mesh, k, walls)
        mean = np.column_stack([flow.mean for flow in flows])
        if not box.periodic:  # nothing flows through the sides, along which fluid only moves about
            mean = np.diag(np.diag(mean))
        tensors.append(np.where(np.abs(mean) < BLOCKED, 0.0, mean))
        error = _estimate(tensors)
        if order is None and error < tol:
            break
    vertex, disc = pores.disc_vertices()
    force = np.zeros((2, len(unit), 2))
    for along, flow in enumerate(flows):
        for axis in range(2):
            force[along, :, axis] = np.bincount(disc, flow.reaction[axis, vertex], len(unit))
        # The mean pressure gradient acts on the discs too; areas are scaled to the mesh's.
        force[along, :, along] += solid * ((unit_box.area - flow.area) / solid.sum())
    return Resolved(
        tensor=tensors[-1] * scale**2,
        force=force * scale**2,
        error=error,
        order=k,
        dofs=flows[0].dofs,
        closed=pores.closed,
        mesh=pores.mesh,
        velocity=(flows[0].velocity, flows[1].velocity),
        scale=scale,
    )


def _estimate(tensors: list[Float]) -> float:
    """Relative error of the last of a sequence of tensors of growing order.

    The steps between orders shrink by a ratio q, so what is left is step * q / (1 - q).
    """
    if len(tensors) < 2:
        return np.inf
    size = np.linalg.norm(tensors[-1])
    if size < BLOCKED:
        return 0.0
    steps = [float(np.linalg.norm(b - a) / size) for a, b in pairwise(tensors)]
    ratio = np.clip(steps[-1] / steps[-2], *RATIO) if len(steps) > 1 else FIRST
    return float(steps[-1] * ratio / (1.0 - ratio))


@dataclass(frozen=True, eq=False)
class _Flow:
    """Flow along one axis for mu = G = 1."""

    mean: Float  # (2,) superficial velocity
    reaction: Float  # (2, mesh vertices): what holds the fluid there
    area: float  # of the fluid
    dofs: int
    velocity: Any


def _stokes(box: Box, mesh: Any, order: int, walls: Walls) -> list[_Flow]:
    """The flows along x and y."""
    mesh.Curve(order)
    with threads(mesh):
        runs = [(0, 1)] if box.periodic else [(0,), (1,)]
        return [flow for axes in runs for flow in _flows(box, mesh, order, walls, axes)]


def _flows(box: Box, mesh: Any, order: int, walls: Walls, axes: tuple[int, ...]) -> list[_Flow]:
    """The flows along `axes`, which share their boundary conditions and so one factorisation."""
    if box.periodic:
        V = Periodic(VectorH1(mesh, order=order, dirichlet="disc"))
        Q = Periodic(H1(mesh, order=order - 1))
    else:
        forward = slice(None, None, 1 if axes[0] == 0 else -1)
        ends, sides = ["left|right", "bottom|top"][forward]
        along, across = ["dirichletx", "dirichlety"][forward]
        still = {along: "disc", across: f"disc|{ends}|{sides}"}
        if walls == "no-slip":
            still[along] += f"|{sides}"
        V = VectorH1(mesh, order=order, **still)
        Q = H1(mesh, order=order - 1, dirichlet=ends)
    X = V * Q
    (u, p), (v, q) = X.TnT()
    stokes = InnerProduct(Grad(u), Grad(v)) - div(u) * q - div(v) * p
    a = BilinearForm(stokes * dx, condense=True).Assemble()
    factor = SaddleFactor(a.mat, V.ndof, X.FreeDofs(True))
    loads = [LinearForm(v[k] * dx).Assemble().vec for k in range(2)]
    first = [0, V.ndof // 2]  # unknowns of a component start with its values at the vertices
    flows = []
    for k in axes:
        f = loads[k].CreateVector()
        f.data = loads[k] + a.harmonic_extension_trans * loads[k]
        flow = GridFunction(X)
        residual = factor.solve(f, flow.vec).FV().NumPy()
        flow.vec.data += a.harmonic_extension * flow.vec
        flow.vec.data += a.inner_solve * f
        flows.append(
            _Flow(
                mean=np.array([load.InnerProduct(flow.vec) for load in loads]) / box.area,
                reaction=np.stack([residual[c : c + mesh.nv] for c in first]),
                area=float(loads[k].FV().NumPy()[first[k] : first[k] + mesh.nv].sum()),
                dofs=X.ndof,
                velocity=flow.components[0],
            )
        )
    return flows
