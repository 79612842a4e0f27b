"""Fields of the fluid on the mesh that lives: built, carried, solved for, kept in checkpoints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np
from ngsolve import BND, InnerProduct, Integrate
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from grainmesh.carry import Keys, along_edge, carry, carry_load, lattice, values_at
from grainmesh.cells import Diagram
from grainmesh.domain import SIDES, Box
from grainmesh.errors import InputError, RunError
from grainmesh.lagged import Apply, Lagged, gmres, mended
from grainmesh.medium import Fluid, Inflow, NoSlip, Outlet, Slip
from grainmesh.mesh import Grid, flow_mesh
from grainmesh.navier import Operator
from grainmesh.nodes import Bounded, bounded
from grainmesh.spread import spread

Float = NDArray[np.float64]
Arrays = dict[str, NDArray[Any]]

#: Least porosity of a vertex.
LEAST_POROSITY = 0.02
#: Most nodes in open places.
MANY = 1e6
#: Iterations after which the factor is made anew, and at most.
FEW, MOST = 8, 60
#: What a checkpoint holds besides the mesh and the unknowns.
NUMBERS = ("time", "dt", "stirring_since", "iterations", "factors")
STATE = (
    "velocity", "last", "slid", "force", "around", "curl", "drag", "mobility",
    "extra", "D", "du", "Q",
)  # fmt: skip
MATRIX = ("eps", "inertia", "E", "S", "stirred")
TOPOLOGY = ("points", "triangles", "neighbours", "shifts")
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


@dataclass(frozen=True, eq=False)
class Kernel:
    """Eq. (2) at one moment.

    Attributes
    ----------
    share : (n, m)
        S_iv.
    hats : (m,)
        h_v; 1 for points that are no vertex.
    area : (n,)
        A_i.
    porosity : (m,)
        ε at the points, 1 for those that are no vertex.
    cells : Diagram
        The cells of the discs.
    """

    share: csr_array
    hats: Float
    area: Float
    porosity: Float
    cells: Diagram

    def field(self, values: Float) -> Float:
        """Values at the vertices of sum_i values_i ψ_i, (m,) or (m, 2)."""
        found: Float = (self.share.T @ values) / (
            self.hats if values.ndim == 1 else self.hats[:, None]
        )
        return found

    def mean(self, moments: Float) -> Float:
        """<f>_i from ∫φ_v f, (m,) or (m, 2)."""
        found: Float = self.share @ (
            moments / (self.hats if moments.ndim == 1 else self.hats[:, None])
        )
        return found


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
    operator : Operator
        Velocity and pressure on it.
    kernel : Kernel
        For the present places.
    velocity, force : (n, 2)
        Of the discs [m/s]; of the fluid on them, without buoyancy [N/m].
    drag : (n,)
        b [N s/m2].
    Q, D, extra : ndarray
        Momentum of the fluid, its last change, and what the solver left, `navier` Eq. (4).
    iterations, factors : int
        Of the linear solver in the last step; factors made so far.
    seconds : dict
        Time spent on each part.
    """

    mesh: Bounded
    grid: Grid
    operator: Operator
    keys: Keys
    pressure_keys: Keys
    kernel: Kernel
    time: float
    dt: float
    stirring_since: float
    _built: Float
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
        if fluid.spacing is not None and box.area > MANY * fluid.spacing**2:
            raise InputError(
                f"fluid: a spacing of {fluid.spacing:g} m makes {box.area / fluid.spacing**2:.1g} "
                "nodes in this box: check the unit, or take a larger one"
            )
        self.mesh = bounded(box, x, 0.5 * discs.diameter, fluid.spacing)
        n = len(x)
        self.velocity, self.last = np.array(velocity), np.zeros((n, 2))
        self.force, self.around, self.curl = np.zeros((n, 2)), np.zeros((n, 2)), np.zeros(n)
        self.slid = np.zeros((n, 2))
        self.drag, self.mobility = np.zeros(n), np.zeros(n)
        self.time = self.dt = self.stirring_since = 0.0
        self.iterations = self.factors = 0
        self.seconds = dict.fromkeys(PARTS, 0.0)
        self._factor: Lagged | None = None
        self._recipe: Arrays = {}
        self._build()
        self.kernel = self._kernel()
        self._set_sides()
        self._load_porosity()
        size = self.operator.V.ndof
        self.extra, self.D, self.du = np.zeros(size), np.zeros(size), np.zeros(size)
        self.Q = self.operator.vector("momentum")

    # --- the state ----------------------------------------------------------------------------

    def numbers(self) -> dict[str, Any]:
        """What goes into a checkpoint beside `arrays`."""
        mesh = {key: value for key, value in vars(self.mesh).items() if isinstance(value, int)}
        return {"mesh": mesh} | {name: getattr(self, name) for name in NUMBERS}

    def arrays(self) -> Arrays:
        """The state as arrays by name."""
        found = {name: getattr(self, name) for name in STATE} | {"x": self.operator.x}
        found |= {"built": self._built}
        for key, value in vars(self.mesh).items():
            if isinstance(value, np.ndarray):
                found[f"mesh/{key}"] = value
        return found | {f"factor/{key}": value for key, value in self._recipe.items()}

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
        parts: dict[str, Any] = {k[5:]: v for k, v in arrays.items() if k.startswith("mesh/")}
        self.mesh = Bounded(box=box, **parts, **numbers["mesh"])
        for name in NUMBERS:
            setattr(self, name, numbers[name])
        for name in STATE:
            setattr(self, name, arrays[name])
        self.seconds = dict.fromkeys(PARTS, 0.0)
        self._factor, self._recipe = None, {}
        recipe = {k[7:]: v for k, v in arrays.items() if k.startswith("factor/")}
        if recipe:
            topology: dict[str, Any] = {key: recipe[key] for key in TOPOLOGY}
            now, self.mesh = self.mesh, replace(self.mesh, **topology)
            self._build()
            self.operator.mesh.ngmesh.Coordinates()[:, :2] = recipe["places"]
            self.operator.load(**{name: recipe[name] for name in MATRIX})
            self.operator.assemble()
            self._make_factor()
            self.factors -= 1
            self.mesh = now
        latest, self.mesh.points = self.mesh.points, arrays["built"].copy()
        self._build()
        self.mesh.points = latest
        self._old = latest.copy()
        self.operator.mesh.ngmesh.Coordinates()[:, :2] = self._places(latest)
        self.kernel = self._kernel()
        self._load_porosity()
        self.operator.x = arrays["x"]
        return self

    def measure(self) -> dict[str, float]:
        """Numbers of the present flow.

        fluid kinetic [J/m], slip (mean speed of fluid against discs [m/s]), flow step [s], added
        viscosity (largest, over mu; see `coupling.ROUGH`), iterations; of a box with walls, the
        mean dynamic pressure at each side [Pa].
        """
        op, u = self.operator, self.operator.u
        energy = 0.5 * op.density * op.eps * InnerProduct(u, u)
        found = {
            "fluid kinetic": float(Integrate(energy, op.mesh, order=2 * op.order + 1)),
            "slip": float(np.hypot(*(self.around - self.velocity).T).mean()),
            "flow step": self.dt,
            "added viscosity": float(op.stirred.vec.FV().NumPy().max()) / self.fluid.viscosity,
            "iterations": self.iterations,
        }
        for number, side in enumerate(() if self.box.periodic else SIDES):
            on = op.mesh.Boundaries(side)
            total = Integrate(op.p, op.mesh, BND, definedon=on, order=op.order)
            found[f"pressure {side}"] = float(total) / float(self.box.size[1 - number // 2])
        return found

    def sample(self, cuts: int = 1) -> Sample:
        """Flow at the vertices, or on triangles each of whose edges is cut into `cuts` pieces.

        In a periodic box each triangle has points of its own, and lies where its middle is inside.
        """
        own, p = self.keys, self.pressure_keys
        rows = np.arange(len(own.triangles))
        nodes, pattern = lattice(cuts)
        now = replace(own, points=self.mesh.points)
        corners = now.places(rows)
        number: NDArray[np.int64]
        if self.box.periodic:
            number = np.arange(len(rows) * len(nodes)).reshape(len(rows), -1)
        else:
            found = replace(own, order=cuts, bubble=False).local(rows)
            number = np.unique(found, return_inverse=True)[1].reshape(found.shape)
        u = self.operator.u.vec.FV().NumPy()
        parts = (
            np.einsum("lk,tkc->tlc", nodes, corners),
            values_at(own, _gathered(self.operator, own, u), nodes),
            values_at(p, self._pressures(), nodes),
            np.einsum("lk,tk->tl", nodes, self.kernel.porosity[own.corners])[..., None],
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

    def _pressures(self) -> Float:
        """Unknowns of the pressure by key (size, 1)."""
        p, op = self.pressure_keys, self.operator
        found = np.zeros((p.size, 1))
        use = op.free[op.V.ndof :] | (not self.box.periodic)
        found[p.of_mesh[use], 0] = op.p.vec.FV().NumPy()[use]
        return found

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
        self._factor, self._recipe = None, {}
        self._remesh()

    def back(self, arrays: Arrays, numbers: dict[str, Any]) -> None:
        """Take back a step that failed, to the state that these were of."""
        for name in ("time", "dt", "stirring_since"):
            setattr(self, name, numbers[name])
        for name in STATE:
            setattr(self, name, arrays[name])
        self.operator.x = arrays["x"]
        self.mesh.points[:] = self._old
        self.operator.mesh.ngmesh.Coordinates()[:, :2] = self._places(self._old)
        self.kernel = self._kernel()
        self._load_porosity()

    # --- linear solver ------------------------------------------------------------------------

    def _linear(self, f: Float, inertia: float) -> Float:
        """Solve for the unknowns of the operator; returns what is left of f, 0 where not free."""
        op, free = self.operator, self.operator.free
        h = np.sqrt(self.box.area / len(self.mesh.triangles))
        # Pressures are counted in a unit in which both kinds of equations weigh alike.
        unit = h * (inertia + self.fluid.viscosity / h**2 + float(self.drag.sum()) / self.box.area)
        scale = np.where(np.arange(len(free)) < op.V.ndof, 1.0, unit) * free
        x0 = op.x
        r = scale * (f - op.apply(x0))
        size = max(float(np.linalg.norm(scale * f)), float(np.linalg.norm(r)))
        goal = max(self.fluid.tolerance * size, 1e-300)
        for attempt in range(2):
            fresh = self._factor is None or attempt == 1
            if fresh:
                self._make_factor()
            apply, precondition = _scaled(op.apply, self._levelled(self._preconditioner()), scale)
            delta, self.iterations, left = gmres(apply, precondition, r, goal, MOST)
            if left <= goal:
                break
        else:
            raise RunError(
                f"the linear solver does not converge at t = {self.time:g} s: residual "
                f"{left / size:.1e} after {MOST} iterations, with a step of the flow that is "
                "perhaps too long (Fluid(dt=...))"
            )
        if self.iterations > FEW and not fresh:
            self._factor, self._recipe = None, {}
        op.x = self._levelled(lambda x: x)(x0 + scale * delta)
        residual = f - op.apply(op.x)
        residual[~free] = 0.0
        return residual

    def _levelled(self, solve: Apply) -> Apply:
        """The same with a mean pressure of 0, where nothing else gives it a level."""
        if not self.box.periodic and self.fluid.names(Outlet):
            return solve
        op, split = self.operator, self.operator.V.ndof
        level = split + np.flatnonzero(op.free[split:][: len(self.grid.vertex)])

        def levelled(f: Float) -> Float:
            x = solve(f)
            x[level] -= x[level].mean()
            return x

        return levelled

    def _make_factor(self) -> None:
        """A factor of the matrix at hand, and all that is needed to make it again."""
        op, mesh = self.operator, self.mesh
        self._factor = op.factor(self._names())
        self._factor_faces = self.keys.faces
        self.factors += 1
        fields = {name: getattr(op, name) for name in MATRIX}
        self._recipe = {key: np.array(getattr(mesh, key)) for key in TOPOLOGY}
        self._recipe |= {key: np.array(f.vec.FV().NumPy()) for key, f in fields.items()}
        self._recipe["points"] = self._built.copy()
        self._recipe["places"] = np.array(op.mesh.ngmesh.Coordinates())[:, :2]

    def _preconditioner(self) -> Apply:
        """The factor at hand, mended on the triangles that have come since it was made."""
        op = self.operator
        assert self._factor is not None
        first = self._factor.preconditioner(np.where(op.free, self._names(), -1))
        fresh = np.flatnonzero(~np.isin(self.keys.faces_of_triangles, self._factor_faces))
        if len(fresh) == 0:
            return first
        near = np.zeros(len(self.mesh.points), dtype=bool)
        near[self.mesh.triangles[fresh]] = True
        fresh = np.flatnonzero(near[self.mesh.triangles].any(axis=1))
        inside = []
        for keys, parts in ((self.keys, 2), (self.pressure_keys, 1)):
            there = np.zeros(keys.size, dtype=bool)
            there[keys.local(fresh)] = True
            inside.append(np.tile(there[keys.of_mesh], parts))
        return mended(first, op.apply, *op.blocks, np.concatenate(inside) & op.free)

    def _names(self) -> NDArray[np.int64]:
        """Names of the unknowns of u_x, u_y and p."""
        own, p = self.keys, self.pressure_keys
        of_u = 3 * own.names[own.of_mesh]
        return np.concatenate([of_u, of_u + 1, 3 * p.names[p.of_mesh] + 2])

    # --- the mesh -----------------------------------------------------------------------------

    def _build(self) -> None:
        """Finite elements on the present triangulation."""
        mesh, fluid = self.mesh, self.fluid
        arrays = mesh.points, mesh.triangles, mesh.shifts
        if self.box.periodic:
            pairs = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
            pairs = np.unique(pairs, axis=0)
            if (pairs[:, 0] == pairs[:, 1]).any() or 2 * len(pairs) != 3 * len(mesh.triangles):
                raise InputError(
                    "the periodic box holds too few particles for a mesh: repeat it, so that no "
                    "particle is joined to itself, or to another twice"
                )
        self.grid = flow_mesh(self.box, *arrays, mesh.neighbours)
        self._built, self._old = mesh.points.copy(), mesh.points.copy()
        self.operator = Operator(
            self.grid.mesh,
            fluid.order,
            fluid.viscosity,
            fluid.density,
            *((), (), ()) if self.box.periodic
            else (fluid.names(Outlet), fluid.names(Slip), fluid.names(NoSlip, Inflow)),
        )  # fmt: skip
        about = self.box, self._old, mesh.triangles.copy(), mesh.shifts.copy(), self.grid
        self.keys = Keys(*about, fluid.order, fluid.order == 1)
        self.pressure_keys = Keys(*about, max(fluid.order - 1, 1))

    def _remesh(self) -> None:
        """Carry all fields to the triangulation that `mesh` has become."""
        old_op, old_keys, old_p = self.operator, self.keys, self.pressure_keys
        loads = [_gathered(old_op, old_keys, values) for values in (self.extra, self.D)]
        fields = [_gathered(old_op, old_keys, v) for v in (old_op.u.vec.FV().NumPy(), self.du)]
        p = self._pressures()
        old_porosity = self.kernel.porosity
        before = _gathered(old_op, old_keys, self.Q)[: len(old_porosity)]
        self._build()
        op, keys = self.operator, self.keys
        u, du = (_spread_out(keys, carry(old_keys, keys, values)) for values in fields)
        op.u.vec.FV().NumPy()[:], self.du = u, du
        op.p.vec.FV().NumPy()[:] = carry(old_p, self.pressure_keys, p)[
            self.pressure_keys.of_mesh, 0
        ]
        loads = [carry_load(old_keys, keys, values) for values in loads]
        used = np.zeros(len(old_porosity), dtype=bool)
        used[keys.triangles] = True
        lost = np.where(used[:, None], 0.0, loads[1][: len(used)])  # of nodes that have left
        for load in loads:
            load[: len(used)][~used] = 0.0
        self.kernel = self._kernel(self.kernel.cells)
        self._load_porosity()
        self._set_sides()
        moved = np.abs(self.kernel.porosity - old_porosity) > 1e-13
        weight = self.kernel.porosity * self.kernel.hats
        momentum = op.vector("momentum")
        after = _gathered(op, keys, momentum)[: len(weight)] + loads[0][: len(weight)]
        for load, missing in zip(loads, (before - after, lost), strict=True):
            load[: len(weight)] += _made_up(old_keys, keys, missing, moved, weight)
        self.extra, self.D = (_load_of(op, keys, values) for values in loads)
        self.Q = momentum + self.extra

    def _kernel(self, cells: Diagram | None = None) -> Kernel:
        """Eq. (2) for the present places of discs and vertices."""
        mesh, r = self.mesh, 0.5 * self.discs.diameter
        n, m = len(r), len(mesh.points)
        reach = self.fluid.reach * float(self.discs.diameter.max())
        arrays = mesh.points, mesh.triangles, mesh.neighbours, mesh.shifts
        found = spread(self.box, mesh.points[:n], r, reach, *arrays, cells)
        place = self._corners()
        a, b = place[:, 1] - place[:, 0], place[:, 2] - place[:, 0]
        area = 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        hats: Float = np.bincount(mesh.triangles.ravel(), np.repeat(area / 3.0, 3), m).astype(float)
        hats[hats == 0.0] = 1.0
        porosity = 1.0 - (found.share.T @ self.discs.volume) / hats
        low = int(np.argmin(porosity))
        if porosity[low] < LEAST_POROSITY:
            at = mesh.points[low]
            raise RunError(
                f"the particles about ({at[0]:.4g}, {at[1]:.4g}) m leave a porosity of "
                f"{porosity[low]:.3g} at t = {self.time:g} s, at least {LEAST_POROSITY} is needed: "
                "raise the stiffness of their contacts, or correct their diameters"
            )
        return Kernel(found.share, hats, found.area, porosity, found.cells)

    def _corners(self) -> Float:
        mesh = self.mesh
        found: Float = mesh.points[mesh.triangles] + mesh.shifts * mesh.period
        return found

    def _places(self, points: Float) -> Float:
        """Coordinates of the vertices of the finite-element mesh [m], (v, 2)."""
        found: Float = points[self.grid.vertex] + self.grid.shift * self.box.size
        return found

    def _load_porosity(self) -> None:
        self.operator.load(eps=self.kernel.porosity[self.grid.vertex])

    def _at_points(self, moments: Float) -> Float:
        """Moments with the hats of the points, (m, 2) or (m,), from those of the vertices."""
        vertex, m = self.grid.vertex, len(self.mesh.points)
        if moments.ndim == 1:
            return np.bincount(vertex, moments, m).astype(float)
        return np.stack([np.bincount(vertex, part, m) for part in moments.T], axis=1)

    def _points_of(self, field: Any) -> Float:
        """Values of a velocity at the points (m, 2); 0 at those that are no vertex."""
        v = len(self.grid.vertex)
        found = np.zeros((len(self.mesh.points), 2))
        values = field.vec.FV().NumPy().reshape(2, -1)[:, :v].T
        first = np.unique(self.grid.vertex, return_index=True)[1]  # slaves hold no values
        found[self.grid.vertex[first]] = values[first]
        return found

    def _set_sides(self) -> None:
        """Velocity and pressure that are given at the sides, at the present time."""
        if self.box.periodic:
            return
        op, keys, fluid = self.operator, self.keys, self.fluid
        given, through = np.zeros((keys.size, 2)), np.zeros((keys.size, 2))
        t, k = np.nonzero(self.mesh.neighbours < 0)
        corner = self.mesh.triangles
        ends = np.stack([corner[t, (k + 1) % 3], corner[t, (k + 2) % 3]], axis=1).astype(np.int64)
        ends.sort(axis=1)
        along = np.linspace(0.0, 1.0, fluid.order + 1)[:, None]
        a, b = self.mesh.points[ends[:, 0], None], self.mesh.points[ends[:, 1], None]
        place = (1.0 - along) * a + along * b  # (e, k + 1, 2)
        eps = self.kernel.porosity[ends]
        eps = (1.0 - along[:, 0]) * eps[:, :1] + along[:, 0] * eps[:, 1:]
        p = np.zeros(len(self.mesh.points))
        kinds = sorted(
            enumerate(map(fluid.side, SIDES)), key=lambda item: isinstance(item[1], NoSlip)
        )  # at corners walls have the last word
        for side, kind in kinds:
            axis, end = divmod(side, 2)
            on = (place[:, [0, -1], axis] == end * self.box.size[axis]).all(axis=1)
            if isinstance(kind, Outlet):
                p[ends[on]] = kind.pressure
                continue
            if isinstance(kind, Slip):
                continue
            value, volume = (np.zeros((on.sum(), fluid.order + 1, 2)) for _ in range(2))
            if isinstance(kind, NoSlip):
                value[..., 1 - axis] = kind.speed
            else:
                volume[:] = kind.at(place[on].reshape(-1, 2), self.time).reshape(value.shape)
                value = volume / eps[on][..., None]
            edge = np.searchsorted(keys.edges, keys._edge(ends[on]))
            none = np.empty((len(edge), 0), np.int64)
            where = keys.unknowns(ends[on], edge[:, None], none)
            given[where] = along_edge(fluid.order, value)
            if isinstance(kind, Inflow):  # all of it, though walls hold the fluid at corners
                through[where] = along_edge(fluid.order, volume)
        held = ~op.free
        split = op.V.ndof
        u, pressure = op.u.vec.FV().NumPy(), op.p.vec.FV().NumPy()
        u[held[:split]] = given[keys.of_mesh].T.ravel()[held[:split]]
        op.given.vec.FV().NumPy()[:] = through[keys.of_mesh].T.ravel()
        level = np.zeros(self.pressure_keys.size)
        level[: len(p)] = p
        pressure[held[split:]] = level[self.pressure_keys.of_mesh][held[split:]]
        if fluid.names(Inflow):
            flux = op.vector("inflow")[: len(self.grid.vertex)]
            net, gross = float(flux.sum()), float(np.abs(flux).sum())
            if not fluid.names(Outlet) and abs(net) > 1e-6 * gross:
                raise InputError(
                    f"fluid: {abs(net):.4g} m2/s flow {'into' if net < 0.0 else 'out of'} the box "
                    "and nothing the other way: give one side an Outlet(), or inflows that add up "
                    "to zero"
                )


def _scaled(apply: Apply, precondition: Apply, scale: Float) -> tuple[Apply, Apply]:
    """D K D and D⁻¹ P D⁻¹, with 0 where the scale D is."""
    back = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0.0)
    return lambda z: scale * apply(scale * z), lambda r: back * precondition(back * r)


def _gathered(op: Operator, keys: Keys, values: Float) -> Float:
    """Unknowns of a velocity by key, (size, 2)."""
    found = np.zeros((keys.size, 2))
    parts = values.reshape(2, -1)
    use = np.ones(parts.shape[1], bool)
    if keys.box.periodic:  # images hold no values
        use = op.free[: op.V.ndof].reshape(2, -1)[0]
    found[keys.of_mesh[use]] = parts.T[use]
    return found


def _spread_out(keys: Keys, values: Float) -> Float:
    """Unknowns of a velocity on the finite-element mesh, images too."""
    return values[keys.of_mesh].T.ravel()


def _load_of(op: Operator, keys: Keys, values: Float) -> Float:
    """A load vector on the finite-element mesh, images empty."""
    found = _spread_out(keys, values)
    if keys.box.periodic:
        found[~op.free[: op.V.ndof]] = 0.0
    return found


def _made_up(
    old: Keys, new: Keys, missing: Float, moved: NDArray[np.bool_], weight: Float
) -> Float:
    """Momentum to add at the points (m, 2), so that each region that changed keeps its own.

    Regions are sets of points, linked by edges, whose porosity or triangles have changed, and the
    corners of all triangles around them; `missing` (m, 2) is the momentum that their hats have
    lost, spread over a region by `weight` (m,).
    """
    m = len(new.points)
    changed = moved.copy()
    for one, other in ((old, new), (new, old)):
        changed[one.triangles[~np.isin(one.faces_of_triangles, other.faces)]] = True
    links = [
        keys.triangles[changed[keys.triangles].any(axis=1)][:, [[0, 1], [1, 2]]].reshape(-1, 2)
        for keys in (old, new)
    ]
    i, j = np.concatenate(links).T
    graph = coo_array((np.ones(len(i), np.int8), (i, j)), shape=(m, m))
    count, region = connected_components(graph, directed=False)
    inside = np.zeros(m, dtype=bool)
    inside[i] = inside[j] = True
    used = np.zeros(m, dtype=bool)
    used[new.triangles] = True
    heavy = np.where(inside & used, weight, 0.0)
    share = np.divide(
        heavy, np.bincount(region, heavy, count)[region], where=heavy > 0.0, out=heavy
    )
    lost = [np.bincount(region, np.where(inside, part, 0.0), count) for part in missing.T]
    found: Float = share[:, None] * np.stack(lost, axis=1)[region]
    return found


__all__ = ["Discs", "Fields", "Kernel"]
