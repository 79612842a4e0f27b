r"""The tables of flow.md: ``python docs/flow.py [--quick]``.

Manufactured solutions of `grainmesh.navier`, Eqs. (1) to (3), with every term in use: linear fields
ε(x, t), E, S, B, f and g, and

    E u = (∂ψ/∂y, -∂ψ/∂x) - g + S ∇p                                                           (1)

for any ψ and p, so that ∇·(E u - S ∇p + g) = 0. What Eq. (1) of `navier` leaves, by differentiation
of formulas, is the force that keeps up the flow.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from netgen.geom2d import SplineGeometry
from ngsolve import (
    BND,
    CF,
    H1,
    GridFunction,
    Id,
    InnerProduct,
    Integrate,
    LinearForm,
    Mesh,
    OuterProduct,
    Parameter,
    Sym,
    Trace,
    VectorH1,
    cos,
    ds,
    dx,
    grad,
    pi,
    sin,
    specialcf,
    x,
    y,
)

import grainmesh as gm
from grainmesh.carry import Keys, Topology
from grainmesh.element import element
from grainmesh.lagged import gmres
from grainmesh.mesh import Grid, flow_mesh, spaces
from grainmesh.navier import Operator
from grainmesh.nodes import bounded

Float = Mask = np.ndarray
NONE, ZERO = CF(0.0), CF((0.0, 0.0))
#: Residual of the linear solver over the right-hand side.
TOLERANCE = 1e-12


def random_mesh(n: int, seed: int = 0, size: float = 1.0) -> Any:
    """Mesh of n random discs in a square, and of nodes on its walls."""
    box, discs = gm.arrange.random(
        n, porosity=0.6, diameter=1.0, min_gap=0.3, seed=seed, periodic=False
    )
    square, scale = gm.Box(size, size), size / box.size
    t = bounded(square, discs.x * scale, np.full(n, 0.5 * scale.min()))
    return flow_mesh(square, t.points, t.triangles, t.shifts, t.neighbours).mesh


def places(mesh: Any) -> Float:
    """Coordinates of the vertices (v, 2), a view."""
    return np.asarray(mesh.ngmesh.Coordinates())[:, :2]


class Setting:
    """An operator on a mesh of NGSolve, and the way from its unknowns to NGSolve's.

    Parameters
    ----------
    mesh : ngsolve.Mesh
        Of straight triangles, not periodic.
    pressure, no_slip : tuple of str
        Boundaries where the pressure is given and the flow at right angles, and where the velocity
        is given.

    Attributes
    ----------
    V, Q : ngsolve.FESpace
        With the same unknowns as `op.u` and `op.p`, in another order.
    """

    def __init__(
        self,
        mesh: Any,
        order: int,
        mu: float,
        rho: float,
        pressure: tuple[str, ...],
        no_slip: tuple[str, ...],
    ) -> None:
        self.mesh = mesh
        corner = np.array([[v.nr for v in t.vertices] for t in mesh.Elements()])
        shifts = np.zeros((*corner.shape, 2), np.int64)
        self.grid = Grid(mesh, np.arange(mesh.nv), np.zeros((mesh.nv, 2), np.int64), corner)
        self.topology = Topology(gm.Box(1.0, 1.0), mesh.nv, corner, shifts)
        self.V, self.Q = spaces(mesh, order, pressure, (), no_slip)
        own = Keys(self.topology, element(order, order == 1))
        other = Keys(self.topology, element(max(order - 1, 1)))
        self.own, self.other = own.of_mesh(self.grid), other.of_mesh(self.grid)
        held, level = (~np.asarray(space.FreeDofs()) for space in (self.V, self.Q))
        self.op = Operator(
            self.topology, places(mesh), order, mu, rho, self.velocity(held), self.pressure(level),
            self.edges(pressure), self.edges(no_slip),
        )  # fmt: skip

    def velocity(self, values: Float) -> Float:
        """Unknowns of V as of the operator, (size, 2)."""
        found = np.empty((len(self.own), 2), values.dtype)
        found[self.own] = values.reshape(2, -1).T
        return found

    def pressure(self, values: Float) -> Float:
        """Unknowns of Q as of the operator, (size,)."""
        found = np.empty(len(self.other), values.dtype)
        found[self.other] = values
        return found

    def fields(self) -> tuple[Any, Any]:
        """u and p of the operator as fields of NGSolve."""
        op = self.op
        return op.keys.field(self.grid, op.u), op.pressure_keys.field(self.grid, op.p)

    def edges(self, sides: tuple[str, ...]) -> Float:
        """Edges of these boundaries, as `Operator` takes them."""
        on = self.topology
        ends = [sorted(v.nr for v in e.vertices) for e in self.mesh.Elements(BND) if e.mat in sides]
        wanted = on.edge(np.array(ends, np.int64).reshape(-1, 2))
        return np.argwhere(np.isin(on.edges[on.edges_of_triangles], wanted))


# --- exact solutions ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Exact:
    """A flow, linear fields, and the time they depend on.

    `pressure` names the sides where the pressure is given; fluid must flow out there.
    """

    u: Any
    p: Any
    eps: Any
    E: Any
    S: Any = NONE
    B: Any = NONE
    f: Any = ZERO
    g: Any = ZERO
    rho: float = 1.0
    mu: float = 1.0
    pressure: tuple[str, ...] = ()
    time: Any = field(default_factory=lambda: Parameter(0.0))

    def setting(self, mesh: Any, order: int) -> Setting:
        """Velocity given on all other sides."""
        rest = tuple(s for s in ("left", "right", "bottom", "top") if s not in self.pressure)
        return Setting(mesh, order, self.mu, self.rho, self.pressure, rest)

    def stress(self) -> Any:
        """2 mu ε D(u) - 2/3 mu ε ∇·u."""
        D = Sym(gradient(self.u))
        return self.mu * self.eps * (2.0 * D - 2.0 / 3.0 * Trace(D) * Id(2))

    def force(self, steady: bool) -> Any:
        """What the equation of momentum leaves [N/m3]."""
        flux = self.rho * self.eps * OuterProduct(self.u, self.u) - self.stress()
        rest = self.B * self.u + self.E * slope(self.p) - self.f + divergence(flux)
        return rest if steady else rest + self.rho * (self.eps * self.u).Diff(self.time)


def slope(a: Any) -> Any:
    """∇a."""
    return CF((a.Diff(x), a.Diff(y)))


def gradient(u: Any) -> Any:
    """∂u_i/∂x_j."""
    return CF((u[0].Diff(x), u[0].Diff(y), u[1].Diff(x), u[1].Diff(y)), dims=(2, 2))


def divergence(T: Any) -> Any:
    """∂T_ij/∂x_j."""
    return CF((T[0, 0].Diff(x) + T[0, 1].Diff(y), T[1, 0].Diff(x) + T[1, 1].Diff(y)))


def all_terms(free: bool = True) -> Exact:
    """A flow through the unit square, to the right, in which nothing is 0; S is unless `free`."""
    t = Parameter(0.0)
    psi = y + 0.2 * sin(2.0 * x + t) * cos(3.0 * y - 0.5 * t)
    p = cos(2.0 * x - t) * sin(2.0 * y + 1.0)
    eps = 0.6 + 0.1 * x + 0.1 * y * sin(t)
    E, B = 0.7 + 0.1 * x + 0.05 * y, 2.0 + x + y
    S = 0.02 + 0.01 * x if free else NONE
    f, g = CF((1.0 + x, y - 0.5)), CF((0.1 * x + 0.05 * y, 0.1 * y))
    u = (CF((psi.Diff(y), -psi.Diff(x))) - g + S * slope(p)) / E  # Eq. (1)
    return Exact(u, p, eps, E, S, B, f, g, pressure=("right",), time=t)


def lethe() -> Exact:
    """The case of Lethe's verification, moved to [0, 2]²."""
    a, b = pi * (x - 1.0), pi * (y - 1.0)
    eps = 0.5 + 0.25 * sin(a) * sin(b)
    u = CF((-2.0 * sin(a) ** 2 * cos(b) * sin(b), 2.0 * cos(a) * sin(a) * sin(b) ** 2))
    return Exact(u, sin(a) * sin(b), eps, eps)


# --- solving for them ---------------------------------------------------------------------------


class Flow:
    """An operator driven to an exact solution: at rest, or in time as `Coupling.solve` does."""

    def __init__(self, exact: Exact, mesh: Any, order: int) -> None:
        self.exact, self.mesh, self.on = exact, mesh, exact.setting(mesh, order)
        self.op = self.on.op
        v, q, n = self.on.V.TestFunction(), self.on.Q.TestFunction(), specialcf.normal(2)
        self.forms = []
        for steady in (True, False):
            F = LinearForm(InnerProduct(exact.force(steady).Compile(), v) * dx(bonus_intorder=4))
            if exact.pressure:
                out = ds("|".join(exact.pressure), bonus_intorder=4)
                F += InnerProduct(exact.stress().Compile() * n, v) * out
            self.forms.append(F)
        # Discs at walls: their flux E u - S ∇p + g is not that of the fluid, ε u.
        beyond = (exact.E - exact.eps) * exact.u - exact.S * slope(exact.p) + exact.g
        self.beyond = LinearForm((beyond.Compile() * n) * q * ds(bonus_intorder=4))
        self.du, self.D = np.zeros_like(self.op.u), np.zeros_like(self.op.u)
        self.dt, self.factor = 0.0, None

    def start(self, time: float) -> None:
        """The exact flow at this time."""
        op, exact, on = self.op, self.exact, self.on
        exact.time.Set(time)
        op.at(places(self.mesh))
        self._load("eps")
        op.u[:] = on.velocity(_set(on.V, exact.u))
        op.p[:] = on.pressure(_set(on.Q, exact.p))
        self.Q = op.momentum()

    def step(self, dt: float, now: Float, scheme: str) -> None:
        """Move the vertices to `now` (v, 2) and go on by dt, Eq. (4) of `navier`."""
        op, exact, old = self.op, self.exact, places(self.mesh).copy()
        omega = dt / self.dt if scheme == "bdf2" and self.dt > 0.0 else 0.0
        c, c1 = (1.0 + 2.0 * omega) / (1.0 + omega), omega**2 / (1.0 + omega)
        before, was = self._at_vertices("eps"), op.u.copy()
        places(self.mesh)[:] = now
        exact.time.Set(exact.time.Get() + dt)
        after = self._at_vertices("eps")
        op.at(0.5 * (old + now))
        op.load(eps=0.5 * (before + after), w=(now - old) / dt)
        C, _ = op.convection(was + 0.5 * omega * self.du)
        op.at(now)
        self._load("eps", "E", "S", "f", "g")
        op.load(inertia=c * exact.rho / dt * after + self._at_vertices("B"))
        if self.dt > 0.0:
            op.u += dt / self.dt * self.du
        loads = self._loads(steady=False)
        loads[: op.split] += ((c * (self.Q + dt * C) + c1 * self.D) / dt).ravel()
        op.assemble()
        self._solve(loads)
        Q = op.momentum()
        self.du, self.D = op.u - was, Q - self.Q - dt * C
        self.Q, self.dt = Q, dt

    def settle(self) -> None:
        """The flow at rest by Newton's method: R(x) = K x - C(u) - f is quadratic in u."""
        self._load("eps", "E", "S", "f", "g")
        self.op.load(inertia=self._at_vertices("B"))
        settle(self.op, self._loads(steady=True))

    def errors(self) -> tuple[float, float]:
        """L2 norms of the errors of u and p, the latter less its mean unless it is given."""
        exact, mesh, q = self.exact, self.mesh, 2 * self.op.order + 4
        u, p = self.on.fields()
        e, d = u - exact.u, p - exact.p
        if not exact.pressure:
            d = d - Integrate(d, mesh, order=q) / Integrate(CF(1.0), mesh)
        return tuple(float(np.sqrt(Integrate(part, mesh, order=q))) for part in (e * e, d * d))

    def _at_vertices(self, name: str) -> Float:
        """Values of a field of the exact solution at the vertices, (v,) or (v, 2)."""
        value = getattr(self.exact, name)
        found = _set((VectorH1 if value.dim == 2 else H1)(self.mesh, order=1), value)
        return found.reshape(2, -1).T if value.dim == 2 else found

    def _load(self, *names: str) -> None:
        self.op.load(**{name: self._at_vertices(name) for name in names})

    def _loads(self, steady: bool) -> Float:
        """Right-hand sides besides inertia, (N,); sets what is given at the sides."""
        op, exact, on = self.op, self.exact, self.on
        side = self.mesh.Boundaries(".*")
        free = op.free[: op.split].reshape(-1, 2), op.free[op.split :]
        np.copyto(op.u, on.velocity(_set(on.V, exact.u, side)), where=~free[0])
        np.copyto(op.p, on.pressure(_set(on.Q, exact.p, side)), where=~free[1])
        inflow = op.inflow(on.velocity(_set(on.V, exact.eps * exact.u, side)))
        force, beyond = (
            form.Assemble().vec.FV().NumPy()
            for form in (self.forms[0 if steady else 1], self.beyond)
        )
        at_sides = inflow + on.pressure(beyond)
        return op.source() + np.concatenate([on.velocity(force).ravel(), at_sides])

    def _solve(self, loads: Float) -> None:
        """Unknowns inside of triangles are eliminated."""
        op, sought = self.op, self.op.sought
        f, x = op.condensed(loads), op.x
        r = (f - op.apply(x)) * sought
        goal = TOLERANCE * np.linalg.norm(loads)
        for _ in range(2):
            if self.factor is None:
                self.factor = preconditioner(op, sought)
            delta, _, rest = gmres(lambda z: op.apply(z) * sought, self.factor, r, goal, 30)
            left = np.linalg.norm(rest)
            if left <= goal:
                x += delta
                op.completed(f, x)
                op.x = x
                return
            self.factor = None
        raise RuntimeError(f"residual {left:.1e}, wanted {goal:.1e}")


def _set(space: Any, value: Any, side: Any = None) -> Float:
    """Unknowns of a formula; with a side, those there alone."""
    found = GridFunction(space)
    if side is None:
        found.Set(value)
    else:
        found.Set(value, definedon=side)
    return found.vec.FV().NumPy().copy()


def preconditioner(op: Operator, inside: Mask) -> Callable[[Float], Float]:
    """A factor of the present matrix."""
    return op.factor(inside).solve


def settle(op: Operator, loads: Float, most: int = 20) -> None:
    """Newton's method for K x = C(u) + f on the free unknowns, with the factor of K."""
    op.outer = op.rows.shape[1]  # C couples unknowns inside of triangles: none is eliminated
    op.assemble()
    inverse, split = preconditioner(op, op.free), op.split

    def convection(u: Float) -> Float:
        return op.convection(u.reshape(-1, 2))[0].ravel()

    for _ in range(most):
        u = op.x[:split]
        r = loads - op.apply(op.x)
        r[:split] += convection(u)
        r *= op.free
        size = np.linalg.norm(loads) + np.linalg.norm(op.apply(op.x))
        if np.linalg.norm(r) <= TOLERANCE * size:
            return
        short = 1e-4 * np.linalg.norm(u) + 1e-300

        def linearised(z: Float, u: Float = u, short: float = short) -> Float:
            found, v = op.apply(z), z[:split]
            h = short / (np.linalg.norm(v) + 1e-300)  # C is quadratic until flow turns back
            found[:split] -= (convection(u + h * v) - convection(u - h * v)) / (2.0 * h)
            return found * op.free

        goal = max(1e-4 * np.linalg.norm(r), 0.1 * TOLERANCE * size)
        op.x = op.x + gmres(linearised, inverse, r, goal, 200)[0]
    raise RuntimeError(f"Newton's method: residual {np.linalg.norm(r) / size:.1e}")


def steady(exact: Exact, order: int, n: int, seed: int = 0, size: float = 1.0) -> Flow:
    """The flow at rest on a random mesh."""
    flow = Flow(exact, random_mesh(n, seed, size), order)
    flow.settle()
    return flow


def swirl(X: Float, time: float, far: float = 0.03) -> Float:
    """Places (v, 2) of vertices that stood at X in the unit square: walls stay, all else turns."""
    a, b = np.pi * X.T
    way = np.sin(a) * np.sin(b) * np.stack([np.sin(2.0 * time + b), np.sin(3.0 * time + a)])
    return X + far * way.T


def transient(
    exact: Exact,
    order: int,
    n: int,
    steps: int,
    until: float,
    scheme: str = "bdf2",
    far: float = 0.03,
    seed: int = 0,
) -> Flow:
    """The flow in time, on a mesh that moves unless far = 0."""
    mesh = random_mesh(n, seed)
    X, dt = places(mesh).copy(), until / steps
    places(mesh)[:] = swirl(X, 0.0, far)
    flow = Flow(exact, mesh, order)
    flow.start(0.0)
    for k in range(1, steps + 1):
        flow.step(dt, swirl(X, k * dt, far), scheme)
    return flow


def slope_of(h: list[float], error: list[float]) -> float:
    """Least squares of ln error over ln h."""
    return float(np.polyfit(np.log(h), np.log(error), 1)[0])


# --- a cylinder in a channel --------------------------------------------------------------------


def cylinder(order: int, parts: int) -> tuple[float, float, int]:
    """Drag and lift coefficient of the cylinder of case 2D-1, Re = 20, and unknowns.

    The circle is a polygon of so many `parts` and the same area.

    References
    ----------
    M. Schäfer, S. Turek, Benchmark computations of laminar flow around a cylinder (1996): C_D
    5.5795, C_L 0.0106.
    """
    geometry = SplineGeometry()
    sides = "bottom", "right", "top", "left"
    geometry.AddRectangle((0.0, 0.0), (2.2, 0.41), bcs=sides)
    angle = 2.0 * np.pi / parts
    radius = 0.05 * np.sqrt(angle / np.sin(angle))
    turn = angle * np.arange(parts)
    ring = 0.2 + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    points = [geometry.AppendPoint(*place) for place in ring.tolist()]
    for a, b in zip(points, points[1:] + points[:1], strict=True):
        geometry.Append(["line", a, b], leftdomain=0, rightdomain=1, bc="cylinder")
    mesh = Mesh(geometry.GenerateMesh(maxh=0.1, grading=0.2))
    on = Setting(mesh, order, 1e-3, 1.0, ("right",), ("left", "bottom", "top", "cylinder"))
    op, one = on.op, np.ones(mesh.nv)
    op.load(eps=one, E=one)
    parabola = CF((1.2 * y * (0.41 - y) / 0.41**2, 0.0))
    op.u[:] = on.velocity(_set(on.V, parabola, mesh.Boundaries("left")))
    loads = np.zeros(len(op.free))
    loads[op.split :] = op.inflow(op.u)
    settle(op, loads)
    # What is left of momentum against a test function v that is 1 on the cylinder, of hats: ∮τ·n.
    # And ∮p n is the integral of ∇(p v).
    left = op.apply(op.x)[: op.split].reshape(-1, 2) - op.convection(op.u)[0]
    hat, p = GridFunction(H1(mesh, order=1)), on.fields()[1]
    hat.Set(CF(1.0), definedon=mesh.Boundaries("cylinder"))
    push = np.array(Integrate(grad(p) * hat + p * grad(hat), mesh, order=order))
    drag, lift = 2.0 * (push - hat.vec.FV().NumPy() @ left[: mesh.nv]) / (0.2**2 * 0.1)
    return float(drag), float(lift), int(op.free.sum())


# --- the tables ---------------------------------------------------------------------------------


def slopes(ns: tuple[int, ...], moving: bool) -> str:
    """Errors and slopes for k = 1..4, with and without discs that are free."""
    lines = [
        f"| k | free discs | {' | '.join(f'u, {n}' for n in ns)} | slope | "
        f"{' | '.join(f'p, {n}' for n in ns)} | slope |",
        "|" + "---|" * (2 * len(ns) + 4),
    ]
    for k in (1, 2, 3, 4):
        for free in (False, True):
            h, errors = [], []
            for n in ns:
                exact = all_terms(free)
                if moving:
                    flow = transient(exact, k, n, 40, 0.004, seed=n)
                else:
                    flow = steady(exact, k, n, seed=n)
                h.append(flow.mesh.ne**-0.5)
                errors.append(flow.errors())
            cells = []
            for error in zip(*errors, strict=True):
                cells += [*(f"{e:.2e}" for e in error), f"{slope_of(h, list(error)):.2f}"]
            lines.append(f"| {k} | {'yes' if free else 'no'} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def in_time(counts: tuple[int, ...]) -> str:
    """Errors after half a second on a mesh that moves, and slopes over the steps."""
    lines = [
        f"| scheme | mesh | {' | '.join(f'{k} steps' for k in counts)} | slope |",
        "|" + "---|" * (len(counts) + 3),
    ]
    for scheme in ("euler", "bdf2"):
        for far in (0.0, 0.05):
            error = [transient(all_terms(), 4, 60, k, 0.5, scheme, far).errors()[0] for k in counts]
            slope = slope_of([1.0 / k for k in counts], error)
            cells = " | ".join(f"{e:.2e}" for e in error)
            lines.append(f"| {scheme} | {'moves' if far else 'rests'} | {cells} | {slope:.2f} |")
    return "\n".join(lines) + "\n"


def beside_lethe(quick: bool) -> str:
    """Errors at three numbers of unknowns, beside those of Lethe with Q1-Q1."""
    theirs = ((867, 7.47e-2, 0.691), (3267, 1.99e-2, 0.244), (12675, 5.12e-3, 0.0803))
    particles = {1: (100, 420, 1720), 2: (78, 320, 1320), 3: (28, 125, 520), 4: (14, 65, 275)}
    lines = ["| elements | unknowns | error of u | error of p |", "|---|---|---|---|"]
    lines += [f"| Lethe, Q1-Q1 | {n} | {u:.2e} | {p:.2e} |" for n, u, p in theirs]
    for k, ns in particles.items():
        for n in ns[: 1 if quick else 3]:
            flow = steady(lethe(), k, n, n, 2.0)
            u, p = flow.errors()
            name = "MINI" if k == 1 else f"P{k}/P{k - 1}"
            lines.append(f"| {name} | {len(flow.op.free)} | {u:.2e} | {p:.2e} |")
    return "\n".join(lines) + "\n"


def cylinder_table(orders: tuple[int, ...]) -> str:
    """Coefficients of the cylinder by order."""
    lines = ["| k | unknowns | C_D | C_L |", "|---|---|---|---|"]
    for k in orders:
        drag, lift, unknowns = cylinder(k, 48)
        lines.append(f"| {k} | {unknowns} | {drag:.4f} | {lift:.5f} |")
    return "\n".join([*lines, "| Schäfer & Turek | | 5.5795 | 0.0106 |"]) + "\n"


def main() -> None:
    """Measure, print, and rewrite the tables of flow.md (not with --quick)."""
    quick = "--quick" in sys.argv
    tables = {
        "rest": slopes((30, 120) if quick else (30, 120, 480), moving=False),
        "moving": slopes((15, 30) if quick else (30, 120), moving=True),
        "time": in_time((4, 8) if quick else (5, 10, 20)),
        "lethe": beside_lethe(quick),
        "cylinder": cylinder_table((2, 3) if quick else (2, 3, 4)),
    }
    page = Path(__file__).with_suffix(".md")
    text = page.read_text(encoding="utf-8")
    for name, table in tables.items():
        print(table)
        begin, end = f"<!-- {name}: python docs/flow.py -->\n", f"<!-- end of {name} -->\n"
        head, rest = text.split(begin)
        text = head + begin + table + end + rest.split(end)[1]
    if not quick:
        page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
