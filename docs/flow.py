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
    CF,
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
    cos,
    div,
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
from grainmesh.lagged import gmres
from grainmesh.mesh import flow_mesh
from grainmesh.navier import Operator
from grainmesh.nodes import bounded

Float = np.ndarray
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

    def operator(self, mesh: Any, order: int) -> Operator:
        """Velocity given on all other sides."""
        rest = tuple(s for s in ("left", "right", "bottom", "top") if s not in self.pressure)
        return Operator(mesh, order, self.mu, self.rho, pressure=self.pressure, no_slip=rest)

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
        self.exact, self.op = exact, exact.operator(mesh, order)
        op, n = self.op, specialcf.normal(2)
        v, q = op.V.TestFunction(), op.Q.TestFunction()
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
        self.du, self.D = np.zeros(op.V.ndof), np.zeros(op.V.ndof)
        self.dt, self.factor = 0.0, None

    def start(self, time: float) -> None:
        """The exact flow at this time."""
        op, exact = self.op, self.exact
        exact.time.Set(time)
        self._load("eps")
        op.u.Set(exact.u)
        op.p.Set(exact.p)
        self.Q = op.vector("momentum")

    def step(self, dt: float, now: Float, scheme: str) -> None:
        """Move the vertices to `now` (v, 2) and go on by dt, Eq. (4) of `navier`."""
        op, exact, at = self.op, self.exact, places(self.op.mesh)
        omega = dt / self.dt if scheme == "bdf2" and self.dt > 0.0 else 0.0
        c, c1 = (1.0 + 2.0 * omega) / (1.0 + omega), omega**2 / (1.0 + omega)
        before, w = self._at_vertices("eps"), (now - at) / dt
        at += 0.5 * dt * w
        was = op.u.vec.FV().NumPy().copy()
        op.foretold.vec.FV().NumPy()[:] = was + 0.5 * omega * self.du
        moved = now - at
        at += moved
        exact.time.Set(exact.time.Get() + dt)
        after = self._at_vertices("eps")
        at -= moved
        op.load(eps=0.5 * (before + after), w=w)
        C = op.vector("convection")
        at[:] = now
        self._load("eps", "E", "S", "f", "g")
        op.load(inertia=c * exact.rho / dt * after + self._at_vertices("B"))
        if self.dt > 0.0:
            op.u.vec.FV().NumPy()[:] += dt / self.dt * self.du
        loads = self._loads(steady=False)
        loads[: op.V.ndof] += (c * (self.Q + dt * C) + c1 * self.D) / dt
        op.assemble()
        self._solve(loads)
        Q = op.vector("momentum")
        self.du, self.D = op.u.vec.FV().NumPy() - was, Q - self.Q - dt * C
        self.Q, self.dt = Q, dt

    def settle(self) -> None:
        """The flow at rest by Newton's method: R(x) = K x - C(u) - f is quadratic in u."""
        op = self.op
        self._load("eps", "E", "S", "f", "g")
        op.load(inertia=self._at_vertices("B"))
        loads = self._loads(steady=True)
        op.assemble()
        settle(op, loads)

    def errors(self) -> tuple[float, float]:
        """L2 norms of the errors of u and p, the latter less its mean unless it is given."""
        op, exact = self.op, self.exact
        q = 2 * op.order + 4
        e, d = op.u - exact.u, op.p - exact.p
        if not exact.pressure:
            d = d - Integrate(d, op.mesh, order=q) / Integrate(CF(1.0), op.mesh)
        return tuple(float(np.sqrt(Integrate(part, op.mesh, order=q))) for part in (e * e, d * d))

    def _at_vertices(self, name: str) -> Float:
        """Values of a field of the exact solution at the vertices, (v,) or (v, 2)."""
        value = getattr(self.exact, name)
        space = self.op.W if value.dim == 2 else self.op.P1
        found = GridFunction(space)
        found.Set(value)
        values = found.vec.FV().NumPy()
        return values.reshape(2, -1).T.copy() if value.dim == 2 else values.copy()

    def _load(self, *names: str) -> None:
        self.op.load(**{name: self._at_vertices(name) for name in names})

    def _loads(self, steady: bool) -> Float:
        """Right-hand sides besides inertia, (N,); sets what is given at the sides."""
        op, exact = self.op, self.exact
        for mine, given in ((op.u, exact.u), (op.p, exact.p), (op.given, exact.eps * exact.u)):
            side = GridFunction(mine.space)
            side.Set(given, definedon=op.mesh.Boundaries(".*"))
            held = ~np.asarray(mine.space.FreeDofs())
            mine.vec.FV().NumPy()[held] = side.vec.FV().NumPy()[held]
        force = self.forms[0 if steady else 1]
        force.Assemble()
        self.beyond.Assemble()
        at_sides = op.vector("inflow") + self.beyond.vec.FV().NumPy()
        return op.vector("source") + np.concatenate([force.vec.FV().NumPy(), at_sides])

    def _solve(self, loads: Float) -> None:
        op = self.op
        r = (loads - op.apply(op.x)) * op.free
        goal = TOLERANCE * np.linalg.norm(loads)
        for _ in range(2):
            if self.factor is None:
                self.factor = preconditioner(op)
            delta, _, left = gmres(lambda z: op.apply(z) * op.free, self.factor, r, goal, 30)
            if left <= goal:
                op.x = op.x + delta
                return
            self.factor = None
        raise RuntimeError(f"residual {left:.1e}, wanted {goal:.1e}")


def preconditioner(op: Operator) -> Callable[[Float], Float]:
    """A factor of the present matrix."""
    names = np.arange(len(op.free))
    return op.factor(names).preconditioner(np.where(op.free, names, -1))


def settle(op: Operator, loads: Float, most: int = 20) -> None:
    """Newton's method for K x = C(u) + f on the free unknowns, with the factor of K."""
    inverse, split = preconditioner(op), op.V.ndof
    e = op.foretold.vec.FV().NumPy()

    def convection(u: Float) -> Float:
        e[:] = u
        return op.vector("convection")

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


def cylinder(order: int, fine: float) -> tuple[float, float, int]:
    """Drag and lift coefficient of the cylinder of case 2D-1, Re = 20, and unknowns.

    References
    ----------
    M. Schäfer, S. Turek, Benchmark computations of laminar flow around a cylinder (1996): C_D
    5.5795, C_L 0.0106.
    """
    geometry = SplineGeometry()
    sides = "bottom", "right", "top", "left"
    geometry.AddRectangle((0.0, 0.0), (2.2, 0.41), bcs=sides)
    hole = {"leftdomain": 0, "rightdomain": 1, "bc": "cylinder", "maxh": fine}
    geometry.AddCircle((0.2, 0.2), 0.05, **hole)
    mesh = Mesh(geometry.GenerateMesh(maxh=0.1, grading=0.2))
    mesh.Curve(order)
    walls = "left", "bottom", "top", "cylinder"
    op = Operator(mesh, order, 1e-3, 1.0, pressure=("right",), no_slip=walls)
    one = np.ones(mesh.nv)
    op.load(eps=one, E=one)
    op.u.Set(CF((1.2 * y * (0.41 - y) / 0.41**2, 0.0)), definedon=mesh.Boundaries("left"))
    op.assemble()
    loads, split = np.zeros(len(op.free)), op.V.ndof
    op.given.vec.data = op.u.vec
    loads[split:] = op.vector("inflow")
    settle(op, loads)
    # What is left of momentum against a test function that is 1 on the cylinder: ∮τ·n. And ∮p n
    # is the integral of ∇·(p v).
    left = op.apply(op.x)[:split]
    op.foretold.vec.data = op.u.vec
    left -= op.vector("convection")
    found = []
    for axis in range(2):
        v = GridFunction(op.V)
        v.Set(CF((1.0 - axis, axis)), definedon=mesh.Boundaries("cylinder"))
        push = InnerProduct(grad(op.p), v) + op.p * div(v)
        found.append(
            Integrate(push * dx(bonus_intorder=2 * order), mesh) - v.vec.FV().NumPy() @ left
        )
    drag, lift = 2.0 * np.array(found) / (0.2**2 * 0.1)
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
                h.append(flow.op.mesh.ne**-0.5)
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
        drag, lift, unknowns = cylinder(k, 0.02)
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
