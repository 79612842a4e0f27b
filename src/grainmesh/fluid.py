r"""Mesoscale model: steady Stokes flow on the mesh of the particles, held back by their drag.

With porosity ε, interstitial velocity u, pressure p and a mean pressure gradient -G,

    -∇·[2 mu ε D(u) - 2/3 mu ε (∇·u) I] + B u + ε ∇p = ε G,    ∇·(ε u) = 0,                 (1)

the porosity-scaled Stokes equations of Yazdchi, Srivastava and Luding (Powders & Grains 2013) for
particles at rest. Particle i is vertex i of the mesh. It holds the fluid by the drag coefficient

    β_i = mu ε_i² / (d² λ),    λ = K/d² from a closure,                                       (2)

times the area A_i of its power cell, spread over the kernel ψ_i,

    B = sum_i β_i A_i ψ_i,    ψ_i = φ_i / ∫φ_i,                                               (3)

where φ_i is the linear hat function of vertex i. A node on a wall is no particle: its hat is shared
equally by the particles joined to it and added to their φ_i, as its porosity is their mean. So the
φ_i sum to one, and a uniform bed is uniform up to its walls. The force on particle i is the adjoint
of (3) plus the pressure on the solid (1 - ε_i) φ_i that the mesh gives it,

    F_i = β_i A_i ∫ψ_i u + (1 - ε_i) ∫φ_i (G - ∇p),                                           (4)

so the forces in a periodic box sum to G times its area.

Between a disc and a no-slip wall the passage, of width h, is half of that between the disc and its
mirror image, and conducts h³/12, where half of the whole passage conducts (2h)³/24 = h³/3. So

    λ at a no-slip wall = λ/4:    the nodes of such a wall have the weight `WALL` = 4 in B.    (5)

Half of the drag there is on the particle, half on the wall.

The elements are P_k/P_{k-1} (Taylor-Hood), for k = 1 P_1 with a cubic bubble (MINI). Porosity and B
are linear. The mean superficial velocity U = ∫ε u / area gives the permeability, K G = mu U.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from ngsolve import (
    H1,
    VERTEX,
    BilinearForm,
    CoefficientFunction,
    Grad,
    GridFunction,
    InnerProduct,
    Integrate,
    LinearForm,
    NodeId,
    Sym,
    div,
    dx,
    grad,
)
from numpy.typing import NDArray
from scipy.sparse import csr_array

from grainmesh.cells import cells
from grainmesh.closures import Law
from grainmesh.domain import SIDES, Box
from grainmesh.errors import InputError
from grainmesh.mesh import flow_mesh, hats, linear, moments, spaces
from grainmesh.particles import Particles, settle
from grainmesh.plain import plain
from grainmesh.saddle import SaddleFactor, entries, threads
from grainmesh.triangulation import Triangulation, triangulate

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]
Kernel = Literal["hat", "delta"]
Walls = Literal["symmetry", "no-slip"]
Gap = Literal["global", "local"]

#: Drag at a no-slip wall, in that of the bed, Eq. (5).
WALL = 4.0
#: Least porosity of a vertex: the cells of cut or overlapping discs may be solid altogether.
LEAST_POROSITY = 0.05
#: Least γ of a single particle (gap="local"): discs that touch have none.
LEAST_GAP = 1e-3


@dataclass(frozen=True, eq=False)
class Flow:
    """A solution of (1) in the units of the mesh, with mu = 1.

    Attributes
    ----------
    fields : ngsolve.GridFunction
        Velocity and pressure together; keeps the memory of both.
    dofs : int
        Unknowns of velocity and pressure that are free, before condensation.
    """

    fields: Any
    dofs: int

    @property
    def velocity(self) -> Any:
        """Interstitial velocity u, a vector field on the mesh."""
        return self.fields.components[0]

    @property
    def pressure(self) -> Any:
        """Pressure p, without the part of the mean gradient."""
        return self.fields.components[1]


def stokes(
    mesh: Any,
    porosity: Float,
    drag: Float,
    forces: Sequence[Any],
    *,
    order: int = 2,
    kernel: Kernel = "hat",
    pressure: Sequence[str] = (),
    slip: Sequence[str] = (),
    no_slip: Sequence[str] = (),
) -> list[Flow]:
    """Solve (1) for given porosity and drag, mu = 1; one factorisation for all forces.

    Parameters
    ----------
    mesh : ngsolve.Mesh
        As `flow_mesh` makes it; periodic if its points are identified.
    porosity, drag : ndarray, shape (v,)
        Values of ε and B at the vertices of the mesh, linear between them.
    forces : sequence of ngsolve.CoefficientFunction
        Vectors G, one solution each.
    order : int
        Polynomial order k >= 1 of the velocity.
    kernel : {"hat", "delta"}
        ``delta`` puts the drag of each hat function into its vertex alone. It lets the fluid slip
        round the vertex and does not converge: for comparison only.
    pressure, slip, no_slip : sequence of str
        Sides of the box (see `domain.SIDES`) where the pressure is zero and the flow at right
        angles, where it is tangential without friction, and where there is none.

    Returns
    -------
    list of Flow
    """
    V, Q = spaces(mesh, order, pressure, slip, no_slip)
    X = V * Q
    (u, p), (v, q) = X.TnT()
    P1 = H1(mesh, order=1)
    eps, B = GridFunction(P1), GridFunction(P1)
    eps.vec.FV().NumPy()[:] = porosity
    B.vec.FV().NumPy()[:] = drag if kernel == "hat" else 0.0
    # Eq. (1): 2 ε D(u):D(v) - 2/3 ε ∇·u ∇·v + B u·v + ε ∇p·v + ε u·∇q
    form = (
        eps * (2.0 * InnerProduct(Sym(Grad(u)), Sym(Grad(v))) - 2.0 / 3.0 * div(u) * div(v))
        + B * InnerProduct(u, v)
        + eps * (InnerProduct(grad(p), v) + InnerProduct(u, grad(q)))
    )
    with threads(mesh):
        # One degree more than the elements have, for ε and B: all integrals are exact.
        a = BilinearForm(form * dx(bonus_intorder=1), condense=True).Assemble()
        if kernel == "delta":
            values, columns, row = entries(a.mat)
            diagonal = np.flatnonzero(columns == row)
            dof = np.array([V.GetDofNrs(NodeId(VERTEX, i)) for i in range(mesh.nv)])
            shared = np.bincount(dof.ravel(), np.repeat(drag * hats(mesh), 2), a.mat.height)
            values[diagonal] += shared[row[diagonal]]
        factor = SaddleFactor(a.mat, V.ndof, X.FreeDofs(True))
        flows = []
        for force in forces:
            f = LinearForm(eps * InnerProduct(force, v) * dx(bonus_intorder=1)).Assemble().vec
            f.data += a.harmonic_extension_trans * f
            fields = GridFunction(X)
            factor.solve(f, fields.vec)
            fields.vec.data += a.harmonic_extension * fields.vec
            fields.vec.data += a.inner_solve * f
            flows.append(Flow(fields, sum(X.FreeDofs())))
    return flows


@dataclass(frozen=True, eq=False)
class Mesoscale:
    """Mesoscale flow through a box of discs.

    Attributes
    ----------
    tensor : ndarray, shape (2, 2)
        Permeability [m2]; column k belongs to a pressure gradient along axis k. Times G/mu it is
        the mean superficial velocity, also of a channel. Diagonal in a box with walls, through
        whose sides nothing flows.
    force : ndarray, shape (2, n, 2)
        Force on each disc, per unit depth and unit pressure gradient [m2], for each direction,
        Eq. (4); it includes the part of the mean pressure gradient, so that periodic forces sum
        to the area.
    error : float
        Estimated relative error of the tensor from discretisation, not from the law: the change
        from the order below (for order 1, to the order above).
    order : int
        Polynomial order of the velocity.
    dofs : int
        Unknowns of velocity and pressure.
    mesh : ngsolve.Mesh
        In units of `scale`. Vertex i is particle i, at one of its images if the box is periodic.
        A periodic cell of few discs is repeated.
    velocity : tuple of ngsolve.CoefficientFunction
        Interstitial velocity mu u / (G scale^2) for the two directions, on `mesh`.
    porosity : ngsolve.CoefficientFunction
        ε on `mesh`.
    scale : float
        Length unit of `mesh` [m]: the mean diameter.
    """

    tensor: Float
    force: Float
    error: float
    order: int
    dofs: int
    mesh: Any
    velocity: tuple[Any, Any]
    porosity: Any
    scale: float

    def __repr__(self) -> str:
        (xx, _), (_, yy) = self.tensor
        return (
            f"Mesoscale: Kxx = {xx:.4g} m², Kyy = {yy:.4g} m² ± {100 * self.error:.2g} %, "
            f"{self.force.shape[1]} discs, order {self.order}, {self.dofs} unknowns"
        )

    def to_dict(self) -> dict[str, Any]:
        """As plain numbers, ready for JSON, without the fields on the mesh."""
        names = ("tensor", "force", "error", "order", "dofs")
        found: dict[str, Any] = plain({name: getattr(self, name) for name in names})
        return found


def solve(
    box: Box,
    particles: Particles,
    law: Law,
    *,
    order: int = 2,
    kernel: Kernel = "hat",
    walls: Walls = "symmetry",
    gap: Gap = "global",
) -> Mesoscale:
    """Permeability tensor and forces by the mesoscale model.

    Parameters
    ----------
    box : Box
    particles : Particles
    law : closures.Law
        λ of the medium, K/d² with d the mean diameter.
    order : int
        Polynomial order k of the velocity, from 1.
    kernel : {"hat", "delta"}
        See `stokes`.
    walls : {"symmetry", "no-slip"}
        What the two sides along the flow are; no matter in a periodic box.
    gap : {"global", "local"}
        ``global``: one λ, of the overall porosity and mean gap. ``local``: the gap of each
        particle, its second smallest, in place of the mean gap; all scaled to the same mean.

    Raises
    ------
    InputError
        For particles that `particles.settle` refuses, a law that cannot take them, an unknown
        `kernel`, `walls` or `gap`, or an order below 1.
    """
    for name, value, known in (
        ("kernel", kernel, Kernel),
        ("walls", walls, Walls),
        ("gap", gap, Gap),
    ):
        if value not in get_args(known):
            raise InputError(f"{name} '{value}' unknown: use {' or '.join(get_args(known))}")
    if order < 1:
        raise InputError(f"order {order} must be at least 1")
    particles = settle(box, particles)
    n, scale = len(particles), particles.mean_diameter
    unit = Box(box.width / scale, box.height / scale, box.periodic)
    bed = _bed(unit, Particles(particles.x / scale, particles.diameter / scale), law, gap)
    other = order - 1 if order > 1 else 2
    rough = _run(bed, other, kernel, walls).tensor
    found = _run(bed, order, kernel, walls)
    return Mesoscale(
        tensor=found.tensor * scale**2,
        force=found.force[:, :n] * scale**2,
        error=float(np.linalg.norm(found.tensor - rough) / np.linalg.norm(found.tensor)),
        order=order,
        dofs=found.flows[0].dofs,
        mesh=bed.mesh,
        velocity=(found.flows[0].velocity, found.flows[1].velocity),
        porosity=linear(bed.mesh, bed.porosity),
        scale=scale,
    )


@dataclass(frozen=True, eq=False)
class _Bed:
    """A bed in mean diameters: its mesh with ε and B, and how particles own the vertices."""

    box: Box
    mesh: Any
    vertex: Int  # point of the triangulation that each vertex shows (v,)
    share: csr_array  # (n, v): φ_i = sum of the hats of the vertices, by these weights
    porosity: Float  # ε (v,)
    drag: Float  # β_i A_i (n,)
    solid: Float  # 1 - ε_i (n,)

    def kernel(self, sides: Sequence[str], weight: float) -> csr_array:
        """ψ_i in values at the vertices (n, v), nodes of no-slip `sides` with a weight, Eq. (5)."""
        points = np.array(self.mesh.ngmesh.Coordinates())
        still = np.zeros(len(self.vertex), dtype=bool)
        for side in sides:
            axis, end = divmod(SIDES.index(side), 2)
            still |= points[:, axis] == end * self.box.size[axis]
        still &= self.vertex >= len(self.drag)  # particles on the wall keep their weight
        psi = self.share.multiply((1.0 / (self.share @ hats(self.mesh)))[:, None])
        return csr_array(psi * np.where(still, weight, 1.0))


@dataclass(frozen=True, eq=False)
class _Run:
    tensor: Float  # (2, 2)
    force: Float  # (2, n, 2)
    flows: list[Flow]


def _bed(box: Box, particles: Particles, law: Law, gap: Gap) -> _Bed:
    once, triangulation = (box, particles), triangulate(box, particles)
    times = np.ones(2, dtype=int)
    while box.periodic and not _simple(triangulation):
        times[np.argmin(box.size)] += 1
        box, particles = _repeated(*once, times)
        triangulation = triangulate(box, particles)
    cell = cells(box, particles)
    eps = np.maximum(cell.porosity, LEAST_POROSITY)
    lam = _permeability(law, 1.0 - cell.solid.sum() / box.area, triangulation, gap)
    mesh, vertex, _, _ = flow_mesh(
        triangulation.box,
        triangulation.points,
        triangulation.triangles,
        triangulation.shifts,
        triangulation.neighbours,
    )
    share = _share(triangulation)[:, vertex]
    drag = eps**2 / lam * cell.area  # Eq. (2) times A_i, d = 1
    alone = 1.0 - np.asarray(share.sum(axis=0))  # a node that no particle is joined to: pure fluid
    return _Bed(box, mesh, vertex, share, eps @ share + alone, drag, 1.0 - eps)


def _permeability(law: Law, porosity: float, triangulation: Triangulation, gap: Gap) -> Float:
    """λ of each particle, (n,)."""
    n = triangulation.n
    if law.variable != "gap":
        if gap == "local":
            raise InputError(f"law {law.name} does not depend on the gap: use gap='global'")
        return np.full(n, law(porosity, np.nan))
    gamma = np.full(n, triangulation.gap_shortest)
    if gap == "local":
        own = np.maximum(triangulation.gap_of_particle, LEAST_GAP)
        own *= gamma / np.nanmean(own)
        gamma = np.where(np.isnan(own), gamma, own)
    return law(porosity, gamma)


def _run(bed: _Bed, order: int, kernel: Kernel, walls: Walls) -> _Run:
    """Flows along x and y: permeability and forces, Eq. (4)."""
    unit = (CoefficientFunction((1.0, 0.0)), CoefficientFunction((0.0, 1.0)))
    mesh = bed.mesh
    if bed.box.periodic:
        psi = [bed.kernel((), 1.0)] * 2
        flows = stokes(mesh, bed.porosity, bed.drag @ psi[0], unit, order=order, kernel=kernel)
    else:
        flows, psi = [], []
        for along in range(2):
            ends, sides = SIDES[2 * along :][:2], SIDES[2 - 2 * along :][:2]
            still = sides if walls == "no-slip" else ()
            psi.append(bed.kernel(still, 0.5 * WALL))  # half the drag of the passage is the wall's
            flows += stokes(
                mesh,
                bed.porosity,
                bed.drag @ bed.kernel(still, WALL),  # Eqs. (3), (5)
                [unit[along]],
                order=order,
                kernel=kernel,
                pressure=ends,
                slip=() if still else sides,
                no_slip=still,
            )
    eps, share, degree = linear(mesh, bed.porosity), hats(mesh), max(order, 3)
    mean, force = np.empty((2, 2)), np.empty((2, len(bed.drag), 2))
    with threads(mesh):
        for along, flow in enumerate(flows):
            flux = Integrate(eps * flow.velocity, mesh, order=degree + 1)
            mean[:, along] = np.array(flux) / bed.box.area
            if not bed.box.periodic:  # nothing flows through the sides
                mean[1 - along, along] = 0.0
            slope = grad(flow.pressure)
            for axis in range(2):
                if kernel == "hat":
                    around = psi[along] @ moments(mesh, flow.velocity[axis], degree)
                else:
                    at = flow.fields.components[0].components[axis].vec.FV().NumPy()[: mesh.nv]
                    around = psi[along] @ (share * at)
                pull = bed.share @ ((along == axis) * share - moments(mesh, slope[axis], degree))
                force[along, :, axis] = bed.drag * around + bed.solid * pull  # Eq. (4)
    return _Run(mean, force, flows)


# --- the bed --------------------------------------------------------------------------------


def _simple(triangulation: Triangulation) -> bool:
    """Whether every edge joins two different particles, and no two edges join the same."""
    edges = triangulation.edges
    return bool((edges[:, 0] != edges[:, 1]).all()) and len(np.unique(edges, axis=0)) == len(edges)


def _repeated(box: Box, particles: Particles, times: Int) -> tuple[Box, Particles]:
    """The same periodic medium in a box repeated (2,) times along x and y, this cell first."""
    cell = np.stack(np.meshgrid(*map(np.arange, times), indexing="ij"), axis=-1).reshape(-1, 2)
    x = (particles.x + (cell * box.size)[:, None]).reshape(-1, 2)
    large = Box(box.width * times[0], box.height * times[1], periodic=True)
    return large, Particles(x, np.tile(particles.diameter, len(cell)))


def _share(triangulation: Triangulation) -> csr_array:
    """Weights (n, m) that extend particle values to all points: a wall node is their mean."""
    n, m = triangulation.n, len(triangulation.points)
    ends = np.vstack([triangulation.edges, triangulation.edges[:, ::-1]])
    node, particle = ends[(ends[:, 0] >= n) & (ends[:, 1] < n)].T
    weight = 1.0 / np.bincount(node, minlength=m)[node]
    i = np.concatenate([np.arange(n), particle])
    j = np.concatenate([np.arange(n), node])
    return csr_array((np.concatenate([np.ones(n), weight]), (i, j)), shape=(n, m))


__all__ = ["Flow", "Mesoscale", "solve", "stokes"]
