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
    CoefficientFunction,
    Grad,
    GridFunction,
    InnerProduct,
    Integrate,
    LinearForm,
    Periodic,
    TaskManager,
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

Float = NDArray[np.float64]
Walls = Literal["symmetry", "no-slip"]

#: Orders of the velocity tried.
LOWEST, HIGHEST = 2, 8
#: Sweeps of iterative refinement at most, and the relative change that ends them.
SWEEPS, ROUNDOFF = 20, 1e-11
#: Share of the pressure's own stiffness that is added to its diagonal for the factorisation only.
PIVOT = 1e-8
#: The steps from order to order are taken to shrink by no less and no more than this.
RATIO = (0.2, 0.5)


@dataclass(frozen=True, eq=False)
class Resolved:
    """Resolved Stokes flow through a box of discs.

    Attributes
    ----------
    tensor : ndarray, shape (2, 2)
        Permeability [m2]; column k belongs to a pressure gradient along axis k.
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
        Largest element [m]; by default one mean diameter.
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
    pores = pore_mesh(unit_box, unit, (maxh or scale) / scale)
    solid = cells(unit_box, unit).solid
    orders = range(LOWEST, HIGHEST + 1) if order is None else (order - 1, order)
    found: list[_Solution] = []
    error = np.inf
    for k in orders:
        progress(f"Stokes flow, order {k}")
        found.append(_stokes(unit_box, pores, k, walls))
        error = _estimate([s.mean for s in found])
        if order is None and error < tol:
            break
    last = found[-1]
    vertex, disc = pores.disc_vertices()
    force = np.zeros((2, len(unit), 2))
    held = solid * ((unit_box.area - last.area) / solid.sum())  # areas as the mesh has them
    for along in range(2):
        for axis in range(2):
            reaction = last.reaction[along][axis][vertex]
            force[along, :, axis] = np.bincount(disc, reaction, len(unit))
        force[along, :, along] += held
    return Resolved(
        tensor=last.mean * scale**2,
        force=force * scale**2,
        error=float(error),
        order=k,
        dofs=last.dofs,
        closed=pores.closed,
        mesh=pores.mesh,
        velocity=last.velocity,
        scale=scale,
    )


def _estimate(tensors: list[Float]) -> float:
    """Relative error of the last of a sequence of tensors of growing order.

    The steps between orders shrink by a ratio q, so what is left is step * q / (1 - q).
    """
    if len(tensors) < 2:
        return np.inf
    size = np.linalg.norm(tensors[-1])
    steps = [float(np.linalg.norm(b - a) / size) for a, b in pairwise(tensors)]
    ratio = np.clip(steps[-1] / steps[-2], *RATIO) if len(steps) > 1 else RATIO[1]
    return float(steps[-1] * ratio / (1.0 - ratio))


@dataclass(frozen=True, eq=False)
class _Solution:
    mean: Float  # (2, 2) mean velocities, column per direction
    reaction: tuple[Float, Float]  # per direction (2, mesh vertices): residual at each vertex
    area: float  # of the fluid
    dofs: int
    velocity: tuple[Any, Any]


def _stokes(box: Box, pores: Any, order: int, walls: Walls) -> _Solution:
    mesh = pores.mesh
    mesh.Curve(order)
    runs = [(0, 1)] if box.periodic else [(0,), (1,)]
    with TaskManager():
        parts = [_run(box, mesh, order, walls, axes) for axes in runs]
        area = Integrate(CoefficientFunction(1.0), mesh, order=3 * order)
    flows = [flow for part in parts for flow in part]
    return _Solution(
        mean=np.column_stack([f[0] for f in flows]),
        reaction=(flows[0][1], flows[1][1]),
        area=area,
        dofs=flows[0][2],
        velocity=(flows[0][3], flows[1][3]),
    )


def _run(box: Box, mesh: Any, order: int, walls: Walls, axes: tuple[int, ...]) -> list[Any]:
    """Flows along `axes`: mean velocity, reaction at mesh vertices, unknowns, velocity."""
    if box.periodic:
        V = Periodic(VectorH1(mesh, order=order, dirichlet="disc"))
        Q = Periodic(H1(mesh, order=order - 1))
    else:
        ends, sides = ("left|right", "bottom|top")[:: 1 if axes[0] == 0 else -1]
        still = {"x": "disc", "y": "disc"}
        along, across = ("x", "y")[:: 1 if axes[0] == 0 else -1]
        still[across] += "|" + ends + "|" + sides
        if walls == "no-slip":
            still[along] += "|" + sides
        V = VectorH1(mesh, order=order, dirichletx=still["x"], dirichlety=still["y"])
        Q = H1(mesh, order=order - 1, dirichlet=ends)
    X = V * Q
    (u, p), (v, q) = X.TnT()
    stokes = InnerProduct(Grad(u), Grad(v)) - div(u) * q - div(v) * p
    a = BilinearForm(stokes * dx, condense=True).Assemble()
    inverse = _factorised(a.mat, X, V.ndof)
    loads = [LinearForm(v[k] * dx).Assemble().vec for k in range(2)]
    flows = []
    for k in axes:
        f = loads[k].CreateVector()
        f.data = loads[k] + a.harmonic_extension_trans * loads[k]
        flow = GridFunction(X)
        residual, change = f.CreateVector(), f.CreateVector()
        for _ in range(SWEEPS):
            residual.data = f - a.mat * flow.vec
            change.data = inverse * residual
            flow.vec.data += change
            new, whole = (np.linalg.norm(z.FV().NumPy()[: V.ndof]) for z in (change, flow.vec))
            if new <= ROUNDOFF * whole:
                break
        else:
            raise RuntimeError("the linear solver did not converge")
        residual.data = a.mat * flow.vec - f
        flow.vec.data += a.harmonic_extension * flow.vec
        flow.vec.data += a.inner_solve * f
        values = residual.FV().NumPy()
        n = V.ndof // 2
        reaction = -np.stack([values[: mesh.nv], values[n : n + mesh.nv]])
        velocity = flow.components[0]
        mean = np.array([load.InnerProduct(flow.vec) for load in loads]) / box.area
        flows.append((mean, reaction, X.ndof, velocity))
    return flows


def _factorised(matrix: Any, space: Any, first: int) -> Any:
    """Factorisation L D Lᵀ of a saddle-point matrix whose pressures start at unknown `first`.

    A zero on the diagonal is no pivot, so the pressures get -PIVOT diag(B A⁻¹ Bᵀ), with diag(A) for
    A. The matrix itself is left as it was: refinement with it removes what was added.
    """
    values, columns, start = matrix.CSR()
    values, columns = values.NumPy(), np.asarray(columns)
    row = np.repeat(np.arange(matrix.height), np.diff(np.asarray(start).astype(np.int64)))
    diagonal = np.flatnonzero(columns == row)
    stiffness = np.ones(matrix.height)
    stiffness[row[diagonal]] = values[diagonal]
    coupling = np.flatnonzero((row >= first) & (columns < first))
    own = np.bincount(
        row[coupling], values[coupling] ** 2 / stiffness[columns[coupling]], matrix.height
    )
    pressure = diagonal[row[diagonal] >= first]
    kept = values[pressure].copy()
    values[pressure] -= PIVOT * own[row[pressure]]
    inverse = matrix.Inverse(space.FreeDofs(True), "sparsecholesky")
    values[pressure] = kept
    return inverse
