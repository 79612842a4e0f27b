"""Fields of the fluid on the mesh that lives: built, carried, solved for, kept in checkpoints."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from grainmesh import sides
from grainmesh.carry import Finder, Keys, Topology, Transfer, regions
from grainmesh.domain import SIDES, Box
from grainmesh.element import element, lattice
from grainmesh.errors import InputError, RunError
from grainmesh.medium import Fluid, Inflow, Outlet
from grainmesh.mesh import flow_mesh
from grainmesh.navier import Operator
from grainmesh.nodes import Bounded, alone, bounded
from grainmesh.solver import Solver
from grainmesh.spread import Kernel, Spread, spread

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Mask = NDArray[np.bool_]
Arrays = dict[str, NDArray[Any]]
Kept = tuple[Bounded, Bounded, Float, Solver, dict[str, Any]]

#: Least porosity of a vertex.
LEAST_POROSITY = 0.02
#: What is made anew in a step, not changed.
REFERENCES = ("operator", "kernel", "fluid", "gravity", "_edges")
#: What a checkpoint holds besides the mesh and the unknowns.
NUMBERS = ("time", "dt", "span", "stirring_since", "stirring_flips", "added")
STATE = (
    "velocity", "last", "slid", "force", "around", "curl", "drag", "mobility",
    "extra", "owed", "D", "du", "Q",
)  # fmt: skip
#: Triangulations that are kept.
MESHES = ("mesh", "bed")
PARTS = ("mesh", "kernel", "matrix", "solve", "rest")


@dataclass(frozen=True, eq=False)
class Discs:
    """What does not change of the discs: diameter [m], mass and volume per unit depth."""

    diameter: Float
    mass: Float
    free: NDArray[np.bool_]

    @property
    def volume(self) -> Float:
        """V [m2]."""
        return 0.25 * np.pi * self.diameter**2

    @property
    def inverse(self) -> Float:
        """1/m, 0 for discs that are held [m/kg]."""
        return np.where(self.free, 1.0 / self.mass, 0.0)


class Sample(NamedTuple):
    """Flow at points, joined by straight triangles.

    Attributes
    ----------
    points : (p, 2)
        [m]
    triangles : (c, 3)
        Counter-clockwise.
    velocity : (p, 2)
        Of the fluid between the discs [m/s].
    pressure, porosity : (p,)
        Dynamic pressure [Pa], and share of fluid.
    """

    points: Float
    triangles: NDArray[np.int64]
    velocity: Float
    pressure: Float
    porosity: Float


class Fields:
    """Velocity and pressure on the triangulation of discs that move, and the state of both.

    Parameters
    ----------
    box : Box
    fluid : Fluid
    gravity : (float, float)
        [m/s2].
    discs : Discs
    x : (n, 2)
        Centres [m].
    velocity : (n, 2)
        [m/s].

    Attributes
    ----------
    mesh : Bounded
        The triangulation.
    bed : Bounded
        That of the discs alone.
    operator : Operator
        Velocity and pressure on it.
    kernel : Kernel
        For the present places.
    velocity, force : (n, 2)
        Of the discs [m/s]; of the fluid on them, without buoyancy [N/m].
    drag : (n,)
        b [N s/m2].
    Q, D, extra, owed : ndarray
        Momentum of the fluid, its last change, and what the solver left of momentum, `navier`
        Eq. (4), and of volume [m2], owed over the next `span` [s].
    solver : Solver
        Linear solver.
    seconds : dict
        Time spent on each part.
    """

    mesh: Bounded
    bed: Bounded
    operator: Operator
    kernel: Kernel
    time: float
    dt: float
    span: float
    stirring_since: float
    stirring_flips: int
    added: float
    _old: Float

    def __init__(
        self,
        box: Box,
        fluid: Fluid,
        gravity: tuple[float, float],
        discs: Discs,
        x: Float,
        velocity: Float,
    ) -> None:
        self.box, self.fluid, self.discs = box, fluid, discs
        self.gravity = np.array(gravity)
        self.mesh = bounded(box, x, 0.5 * discs.diameter, fluid.spacing)
        self.bed = alone(box, x, 0.5 * discs.diameter, self._reach)
        n = len(x)
        self.velocity, self.last = np.array(velocity), np.zeros((n, 2))
        self.force, self.around, self.curl = np.zeros((n, 2)), np.zeros((n, 2)), np.zeros(n)
        self.slid = np.zeros((n, 2))
        self.drag, self.mobility = np.zeros(n), np.zeros(n)
        self.time = self.dt = self.span = self.stirring_since = 0.0
        self.stirring_flips, self.added = 0, 0.0
        self.seconds = dict.fromkeys(PARTS, 0.0)
        self.solver = Solver()
        self._build()
        self.kernel = self._kernel()
        self._set_sides()
        self._load_porosity()
        self.extra, self.D, self.du = (np.zeros_like(self.operator.u) for _ in range(3))
        self.owed = np.zeros(len(self.operator.p))
        self.Q = self.operator.momentum()

    def __repr__(self) -> str:
        op = self.operator
        kind = "MINI" if op.order == 1 else f"P{op.order}/P{op.order - 1}"
        return (
            f"{type(self).__name__}: {kind} on {len(op.area)} triangles, {op.free.sum()} unknowns, "
            f"{len(self.discs.mass)} discs, t = {self.time:.4g} s, step {self.dt:.3g} s, porosity "
            f"from {self.kernel.porosity.min():.3g}"
        )

    @property
    def iterations(self) -> int:
        """Of the linear solver in the last step."""
        return self.solver.iterations

    @property
    def factors(self) -> int:
        """Made so far by the linear solver."""
        return self.solver.factors

    # --- the state ----------------------------------------------------------------------------

    def numbers(self) -> dict[str, Any]:
        """What goes into a checkpoint beside `arrays`."""
        found: dict[str, Any] = {name: getattr(self, name) for name in NUMBERS}
        for name in MESHES:
            parts = vars(getattr(self, name)).items()
            found[name] = {key: value for key, value in parts if isinstance(value, int)}
        return {"solver": self.solver.numbers()} | found

    def arrays(self) -> Arrays:
        """The state as arrays by name."""
        found = {name: getattr(self, name) for name in STATE} | {"x": self.operator.x}
        for name in MESHES:
            for key, value in vars(getattr(self, name)).items():
                if isinstance(value, np.ndarray):
                    found[f"{name}/{key}"] = value
        found |= {f"kernel/{key}": value for key, value in vars(self.kernel.spread).items()}
        return found | {f"factor/{key}": value for key, value in self.solver.recipe.items()}

    @classmethod
    def resumed(
        cls,
        box: Box,
        fluid: Fluid,
        gravity: tuple[float, float],
        discs: Discs,
        numbers: dict[str, Any],
        arrays: Arrays,
    ) -> Self:
        """The state that `numbers` and `arrays` were of."""
        self = cls.__new__(cls)
        self.box, self.fluid, self.discs, self.gravity = box, fluid, discs, np.array(gravity)
        for name in MESHES:
            parts: dict[str, Any] = _under(name, arrays) | numbers[name]
            setattr(self, name, Bounded(box=box, **parts))
        for name in NUMBERS:
            setattr(self, name, numbers[name])
        for name in STATE:
            setattr(self, name, arrays[name])
        self.seconds = dict.fromkeys(PARTS, 0.0)
        self._build()
        self.kernel = self._kernel_of(Spread(**_under("kernel", arrays)))
        self._load_porosity()
        self.operator.x = arrays["x"]
        recipe = _under("factor", arrays)
        self.solver = Solver.resumed(numbers["solver"], recipe, self.operator)
        return self

    def measure(self) -> dict[str, float]:
        """Numbers of the present flow.

        fluid momentum x, y [N s/m], fluid kinetic [J/m], slip (mean speed of fluid against discs
        [m/s]), flow step [s], added viscosity (largest, over mu; see `coupling.ROUGH`), iterations;
        of a box with walls, the mean dynamic pressure at each side [Pa].
        """
        op = self.operator
        found = {
            **dict(zip(("fluid momentum x", "fluid momentum y"), self._momentum(), strict=True)),
            "fluid kinetic": 0.5 * float((op.momentum() * op.u).sum()),
            "slip": float(np.hypot(*(self.around - self.velocity).T).mean()),
            "flow step": self.dt,
            "added viscosity": self.added / self.fluid.viscosity,
            "iterations": self.solver.iterations,
        }
        for number, side in enumerate(() if self.box.periodic else SIDES):
            found[f"pressure {side}"] = self.pressure_at(side) / self.box.size[1 - number // 2]
        return found

    def _momentum(self) -> list[float]:
        found: list[float] = self.Q[: self.operator.topology.count].sum(axis=0).tolist()
        return found

    def pressure_at(self, side: str) -> float:
        """∫p along a side of a box with walls [N/m], without that of the fluid at rest."""
        op = self.operator
        return float(op.along(self._side(side), op.p[:, None], op.pressure_keys)[0])

    def flux(self, side: str) -> float:
        """Volume of fluid that leaves through a side, per depth and time, ∫ε u·n [m2/s]."""
        op, edges, number = self.operator, self._side(side), SIDES.index(side)
        found = op.along(edges, op.u, op.keys, op.eps)
        return float(found[number // 2]) * (1.0 if number % 2 else -1.0)

    def mean(self) -> Float:
        """Mean superficial velocity of the fluid, ∫ε u over the area of the box [m/s], (2,)."""
        op = self.operator
        found: Float = op.momentum()[: op.topology.count].sum(axis=0) / op.density / self.box.area
        return found

    def sample(self, cuts: int = 1) -> Sample:
        """Flow at the vertices, or on triangles each of whose edges is cut into `cuts` pieces.

        In a periodic box each triangle has points of its own, and lies where its middle is inside.
        """
        op, on = self.operator, self.operator.topology
        nodes, pattern = lattice(cuts)
        corners = on.places(self.mesh.points)
        number: NDArray[np.int64]
        if self.box.periodic:
            number = np.arange(len(corners) * len(nodes)).reshape(len(corners), -1)
        else:
            found = Keys(on, element(cuts)).rows
            number = np.unique(found, return_inverse=True)[1].reshape(found.shape)
        parts = (
            np.einsum("lk,tkc->tlc", nodes, corners),
            op.keys.values(op.u, nodes),
            op.pressure_keys.values(op.p[:, None], nodes),
            np.einsum("lk,tk->tl", nodes, self.kernel.porosity[on.corners])[..., None],
        )
        values = [np.empty((number.max() + 1, part.shape[-1])) for part in parts]
        for into, part in zip(values, parts, strict=True):
            into[number] = part
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        over = a[:, 0] * b[:, 1] < a[:, 1] * b[:, 0]
        triangles = number[:, pattern]
        triangles[over] = triangles[over][..., ::-1]
        return Sample(
            values[0], triangles.reshape(-1, 3), values[1], values[2][:, 0], values[3][:, 0]
        )

    def at(self, places: ArrayLike) -> tuple[Float, Float, Float]:
        """Velocity (q, 2) [m/s], dynamic pressure (q,) [Pa] and porosity (q,) at places (q, 2) [m].

        Raises
        ------
        InputError
            If a place lies outside a box with walls, or is not finite.
        """
        x = np.atleast_2d(np.asarray(places, dtype=float))
        if x.ndim != 2 or x.shape[1] != 2 or not np.isfinite(x).all():
            raise InputError("flow.at takes places (q, 2) [m], all of them finite")
        if not self.box.periodic and ((x < 0.0) | (x > self.box.size)).any():
            raise InputError("flow.at: some places lie outside the box")
        op, on = self.operator, self.operator.topology
        t, weight = Finder(on, self.mesh.points, np.arange(len(on.triangles)))(x)
        u = np.einsum("ql,qlc->qc", op.keys.element.shape(weight), op.u[op.keys.rows[t]])
        q = op.pressure_keys
        p = np.einsum("ql,ql->q", q.element.shape(weight), op.p[q.rows[t]])
        return u, p, np.einsum("qk,qk->q", weight, self.kernel.porosity[on.corners[t]])

    def ngsolve(self) -> tuple[Any, Any, Any]:
        """Velocity [m/s], dynamic pressure [Pa] and porosity as GridFunctions of NGSolve."""
        mesh, op = self.mesh, self.operator
        grid = flow_mesh(self.box, mesh.points, mesh.triangles, mesh.shifts, mesh.neighbours)
        linear = Keys(op.topology, element(1))
        return (
            op.keys.field(grid, op.u),
            op.pressure_keys.field(grid, op.p),
            linear.field(grid, self.kernel.porosity),
        )

    def refuse_other(self, fluid: Fluid) -> None:
        """Raise if the mesh or the elements of another fluid would be others."""
        for name in ("order", "spacing", "reach"):
            if getattr(fluid, name) != getattr(self.fluid, name):
                raise InputError(f"change: {name} of the fluid must stay as it is")

    def change(self, fluid: Fluid, gravity: tuple[float, float]) -> None:
        """Go on with another fluid, or other sides, on the same mesh.

        Raises
        ------
        InputError
            If order, spacing or reach differ.
        """
        self.refuse_other(fluid)
        self.fluid, self.gravity = fluid, np.array(gravity)
        self._remesh()
        self.solver.forget()

    def keep(self) -> Kept:
        """The state before a step, for `back`."""
        state = {name: getattr(self, name) for name in (*STATE, *NUMBERS, *REFERENCES)}
        meshes = _copied(self.mesh), _copied(self.bed)
        return *meshes, self.operator.x, copy(self.solver), state

    def back(self, kept: Kept) -> None:
        """Undo a step that failed, and whatever of it was done."""
        mesh, bed, x, solver, state = kept
        self.mesh, self.bed, self.solver = _copied(mesh), _copied(bed), copy(solver)
        for name, value in state.items():
            setattr(self, name, value)
        self._old = self.mesh.points.copy()
        self.operator.at(self._old)
        self.operator.x = x
        self._load_porosity()

    # --- the mesh -----------------------------------------------------------------------------

    def _build(self) -> None:
        """Finite elements on the present triangulation."""
        mesh, fluid = self.mesh, self.fluid
        on = Topology(self.box, len(mesh.points), mesh.triangles.copy(), mesh.shifts.copy())
        if self.box.periodic and (
            2 * len(on.edges) != 3 * len(on.corners)
            or (on.corners[:, :2] == on.corners[:, 1:]).any()
        ):
            raise InputError(
                "the periodic box holds too few particles for a mesh: repeat it, so that no "
                "particle is joined to itself, or to another twice"
            )
        self._old = mesh.points.copy()
        own = Keys(on, element(fluid.order, fluid.order == 1))
        other = Keys(on, element(max(fluid.order - 1, 1)))
        self._edges = sides.edges_of(self.box, on, mesh.points, mesh.neighbours)
        self.operator = Operator(
            on, mesh.points, fluid.order, fluid.viscosity, fluid.density,
            *sides.held(fluid, self._edges, own, other),
        )  # fmt: skip

    def _side(self, side: str) -> Int:
        """Edges of one side of a box with walls."""
        if side not in self._edges:
            raise InputError(f"side '{side}' must be one of {', '.join(self._edges) or 'none'}")
        return self._edges[side]

    def _remesh(self) -> None:
        """Carry all fields to the triangulation that `mesh` has become."""
        old = self.operator
        old_porosity = self.kernel.porosity
        self._build()
        op = self.operator
        op.memory = old.memory
        over = Transfer(old.topology, op.topology, self.mesh.points)
        keys = old.keys, op.keys
        op.u, self.du = over.fields(*keys, old.u, self.du)
        (p,) = over.fields(old.pressure_keys, op.pressure_keys, old.p[:, None])
        op.p = p[:, 0]
        self.extra, self.D = (over.loads(*keys, load) for load in (self.extra, self.D))
        owed = over.loads(old.pressure_keys, op.pressure_keys, self.owed[:, None])
        changed = np.zeros(len(old_porosity), dtype=bool)
        changed[op.topology.corners[over.fresh]] = True
        changed[old.topology.corners[over.gone]] = True
        self.kernel = k = self._kernel(changed)
        self._load_porosity()
        self._set_sides()
        changed |= np.abs(k.porosity - old_porosity) > 1e-13
        if self.dt > 0.0 and changed.any():
            op.load(inertia=op.density * k.porosity / self.dt, E=k.porosity)
            op.load(g=k.field(self.discs.volume[:, None] * self.velocity))
            volume = op.source()[op.split :]
            if self.fluid.names(Inflow):
                volume += op.inflow(self._through)
            op.close(volume, changed)
        # Each region that changed keeps its momentum, and the volume owed to it.
        at, region = regions(old.topology, op.topology, changed)
        used = op.topology.used[at]
        gone = at[~used]  # nodes that have left
        lost, unpaid = (np.where(used[:, None], 0.0, load[at]) for load in (self.D, owed))
        self.D[gone] = self.extra[gone] = owed[gone] = 0.0
        momentum = op.momentum()
        missing = self.Q[at] - momentum[at] - self.extra[at]
        weight = k.porosity[at] * k.hats[at] * used
        self.extra[at] += _made_up(region, weight, missing)
        self.D[at] += _made_up(region, weight, lost)
        owed[at] += _made_up(region, weight, unpaid)
        self.owed = owed[:, 0]
        self.Q = momentum + self.extra

    @property
    def _reach(self) -> float:
        return self.fluid.reach * float(self.discs.diameter.max())

    def _kernel(self, changed: Mask | None = None) -> Kernel:
        """Eq. (2) for the present places; if given, only corners of triangles have `changed`."""
        if changed is None:
            self.bed.follow(self.mesh.points[: len(self.discs.mass)])
            return self._kernel_of(spread(self.bed, self._reach, self.mesh))
        before = self.kernel.spread
        return self._kernel_of(spread(self.bed, self._reach, self.mesh, before, changed))

    def _kernel_of(self, found: Spread) -> Kernel:
        mesh, hats = self.mesh, np.where(found.hats == 0.0, 1.0, found.hats)
        porosity = 1.0 - found.sums(self.discs.volume) / hats
        low = int(np.argmin(porosity))
        if porosity[low] < LEAST_POROSITY:
            at = mesh.points[low]
            raise RunError(
                f"the particles about ({at[0]:.4g}, {at[1]:.4g}) m leave a porosity of "
                f"{porosity[low]:.3g} at t = {self.time:g} s, at least {LEAST_POROSITY} is needed: "
                "raise the stiffness of their contacts, or correct their diameters"
            )
        return Kernel(hats, porosity, found)

    def _corners(self) -> Float:
        mesh = self.mesh
        found: Float = mesh.points[mesh.triangles] + mesh.shifts * mesh.period
        return found

    def _load_porosity(self) -> None:
        self.operator.load(eps=self.kernel.porosity)

    def _set_sides(self) -> None:
        """Velocity and pressure that are given at the sides, at the present time."""
        if self.box.periodic:
            return
        op, fluid, split = self.operator, self.fluid, self.operator.split
        about = op.keys, op.pressure_keys, self.mesh.points, self.kernel.porosity, self.time
        u, p, self._through = sides.given(fluid, self._edges, *about)
        held = ~op.free[:split].reshape(-1, 2)
        op.u[held] = u[held]
        if fluid.names(Outlet):
            op.p[~op.free[split:]] = p[~op.free[split:]]
        elif fluid.names(Inflow):
            flux = op.inflow(self._through)[: op.topology.count]
            net, gross = float(flux.sum()), float(np.abs(flux).sum())
            if abs(net) > 1e-6 * gross:
                raise InputError(
                    f"fluid: {abs(net):.4g} m2/s flow {'into' if net < 0.0 else 'out of'} the box "
                    "and nothing the other way: give one side an Outlet(), or inflows that add up "
                    "to zero"
                )


def _under(name: str, arrays: Arrays) -> Arrays:
    """Arrays whose names begin with ``name/``, without that."""
    return {k[len(name) + 1 :]: v for k, v in arrays.items() if k.startswith(f"{name}/")}


def _copied(mesh: Bounded) -> Bounded:
    arrays: dict[str, Any] = {k: v.copy() for k, v in vars(mesh).items() if hasattr(v, "copy")}
    return replace(mesh, **arrays)


def _made_up(region: Int, weight: Float, missing: Float) -> Float:
    """What the points of each region have lost (i, c), spread over all of it by weight (i,)."""
    total = np.bincount(region, weight, 1)[region]
    share = np.divide(weight, total, where=weight > 0.0, out=np.zeros_like(weight))
    lost = [np.bincount(region, part, 1)[region] for part in missing.T]
    found: Float = share[:, None] * np.stack(lost, axis=1)
    return found


__all__ = ["Discs", "Fields", "Kernel", "Sample"]
