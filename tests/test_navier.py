"""One implicit step of the flow: manufactured solutions, order in time, what must not change."""

import numpy as np
import pytest
from ngsolve import (
    CF,
    BilinearForm,
    Grad,
    InnerProduct,
    Integrate,
    LinearForm,
    Sym,
    div,
    ds,
    dx,
    grad,
    specialcf,
)

from flows import SIDES, Beside, Nothing, flow, some_flow
from grainmesh import integrals
from grainmesh.averaged import Averaged
from grainmesh.carry import Keys, Topology
from grainmesh.coupling import Coupling, Discs
from grainmesh.domain import Box
from grainmesh.element import element
from grainmesh.medium import Fluid, Inflow, NoSlip, Outlet, Slip
from grainmesh.navier import Operator


def slopes(flows):
    """Slopes of the errors of u and p over the size of the triangles."""
    errors = np.array([one.errors() for one in flows])
    h = [one.mesh.ne**-0.5 for one in flows]
    return flow.slope_of(h, errors[:, 0]), flow.slope_of(h, errors[:, 1])


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_errors_at_rest_have_the_slopes_of_their_order(order):
    u, p = slopes([flow.steady(flow.all_terms(free=False), order, n, n) for n in (30, 120, 480)])
    assert u > order + 1 - 0.2
    assert p > order - 0.2


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_errors_on_a_mesh_that_moves_have_the_slopes_of_their_order(order):
    exact = flow.all_terms(free=False)
    u, p = slopes([flow.transient(exact, order, n, 20, 0.002, seed=n) for n in (30, 120)])
    assert u > order + 1 - 0.2
    assert p > order - 0.2


@pytest.mark.parametrize(("order", "least"), [(1, 2), (2, 2), (3, 4), (4, 5)])
def test_free_discs_cost_an_order_where_k_is_2_only(order, least):
    # S ∇p in the volume: O(h^(k-1)) against test functions of the same order.
    u, p = slopes([flow.steady(flow.all_terms(free=True), order, n, n) for n in (30, 120, 480)])
    assert u > least - 0.2
    assert p > order - 0.2


@pytest.mark.parametrize("far", [0.0, 0.05])
@pytest.mark.parametrize(("scheme", "order"), [("euler", 1), ("bdf2", 2)])
def test_order_in_time(scheme, order, far):
    counts = (5, 10, 20)
    errors = np.array(
        [flow.transient(flow.all_terms(), 4, 30, k, 0.5, scheme, far).errors() for k in counts]
    )
    for error in errors.T:
        assert flow.slope_of([1.0 / k for k in counts], error) == pytest.approx(order, abs=0.2)


def test_porosity_of_lethe_falls_with_the_mesh():
    u, p = slopes([flow.steady(flow.lethe(), 2, n, n, 2.0) for n in (30, 120, 480)])
    assert u > 2.0 - 0.2  # porosity is linear between vertices
    assert p > 1.0 - 0.2


def test_lethe_at_equal_unknowns():
    found = flow.steady(flow.lethe(), 2, 320, 320, 2.0)
    assert len(found.op.free) < 3267  # of Lethe, Q1-Q1 on 1024 squares: 1.99e-2, 0.244
    u, p = found.errors()
    assert u < 1.99e-2
    assert p < 0.244


@pytest.mark.slow
def test_cylinder_in_a_channel():
    # M. Schäfer and S. Turek (1996), case 2D-1.
    drag, lift, _ = flow.cylinder(3, 48)
    assert drag == pytest.approx(5.5795, rel=1e-3)
    assert lift == pytest.approx(0.0106, rel=0.05)
    drag, lift, _ = flow.cylinder(4, 48)
    assert drag == pytest.approx(5.57954, rel=1e-4)
    assert lift == pytest.approx(0.010619, rel=3e-3)


# --- beside NGSolve ----------------------------------------------------------------------------


def close(a, b):
    return np.abs(a - b).max() < 1e-12 * np.abs(b).max()


EACH = pytest.mark.parametrize(
    ("order", "periodic"), [(k, periodic) for k in (1, 2, 3, 4) for periodic in (False, True)]
)


@EACH
def test_loads_are_those_of_ngsolve(order, periodic):
    found, _ = some_flow(order, periodic)
    op, it = found.operator, Beside(found)
    v, q, h = (space.TestFunction() for space in (it.V, it.Q, it.P))
    eps, u, much = it.eps * op.density, it.u, dx(bonus_intorder=3 * max(order, 3))
    assert close(op.momentum(), it.load("u", LinearForm(eps * u * v * much)))
    mass = it.load("u", LinearForm(eps * v[0] * much))
    assert close(op.mass(), mass[:, 0])
    F, G = op.source()[: op.split].reshape(-1, 2), op.source()[op.split :]
    assert close(F, it.load("u", LinearForm(it.f * v * much)))
    assert close(G, it.load("p", LinearForm(-it.g * grad(q) * much)))
    fields, means = (u, grad(it.p), Grad(u)[1, 0] - Grad(u)[0, 1]), np.split(op.means(), [2, 4], 1)
    for mean, field in zip(means, fields, strict=True):
        parts = [field[k] for k in range(field.dim)] if field.dim > 1 else [field]
        assert close(
            mean, np.column_stack([it.load("h", LinearForm(part * h * much)) for part in parts])
        )


@EACH
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_convection_is_that_of_ngsolve(order, periodic, sign):
    found, _ = some_flow(order, periodic)
    op = found.operator
    op.u[: op.topology.count, 0] += sign * 20.0  # so that it is out, or in, all along the outlet
    it = Beside(found)
    v, u, w, eps = it.V.TestFunction(), it.u, it.w, it.eps * op.density
    much = {"bonus_intorder": 3 * max(order, 3)}
    C = eps * InnerProduct(u, Grad(v) * (u - w)) * dx(**much)
    drained = eps * InnerProduct(CF((1.0, 0.0)), Grad(v) * (u - w)) * dx(**much)
    if not periodic and sign > 0.0:
        out = eps * (u * specialcf.normal(2))
        C -= out * InnerProduct(u, v) * ds("right", **much)
        drained -= out * v[0] * ds("right", **much)
    mine = op.convection(op.u)
    assert close(mine[0], it.load("u", LinearForm(C)))
    assert close(mine[1], it.load("u", LinearForm(drained))[:, 0])


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_inflow_is_that_of_ngsolve(order):
    found, rng = some_flow(order, False)
    op, it = found.operator, Beside(found)
    given = rng.normal(size=op.u.shape)
    flux = op.keys.field(it.grid, given) * specialcf.normal(2)
    sides = "|".join(side for side, kind in SIDES.items() if isinstance(kind, NoSlip | Inflow))
    exact = LinearForm(flux * it.Q.TestFunction() * ds(sides, bonus_intorder=2 * order))
    assert close(op.inflow(given), it.load("p", exact))


@EACH
def test_matrix_is_that_of_ngsolve_whole_or_condensed(order, periodic):
    found, rng = some_flow(order, periodic)
    op, it = found.operator, Beside(found)
    X = it.V * it.Q
    (u, p), (v, q) = X.TnT()
    form = (
        it.inertia * InnerProduct(u, v)
        + 2.0 * it.mu * it.eps * InnerProduct(Sym(Grad(u)), Sym(Grad(v)))
        - 2.0 / 3.0 * it.mu * it.eps * div(u) * div(v)
        + it.E * (InnerProduct(grad(p), v) + InnerProduct(u, grad(q)))
        - it.S * InnerProduct(grad(p), grad(q))
    )
    A = BilinearForm(form * dx(bonus_intorder=3)).Assemble().mat
    columns = np.concatenate([2 * it.rows[0], 2 * it.rows[0] + 1, op.split + it.rows[1]])
    i, j, values = A.COO()
    K = np.zeros((len(op.free), len(op.free)))
    np.add.at(K, (columns[np.array(i)], columns[np.array(j)]), np.array(values))

    def of_triangles():
        return np.array([op.apply(row) for row in np.eye(len(K))])

    condensed = op.outer
    op.outer = op.rows.shape[1]  # nothing is eliminated
    op.assemble()
    assert close(of_triangles(), K)
    op.outer = condensed
    op.assemble()
    # The Schur complement, and what is eliminated is found again.
    free = op.free.copy()
    if periodic:  # a level of the pressure
        free[op.split + np.flatnonzero(op.topology.used)[0]] = False
    inner = op.within
    schur = (
        K - K[:, inner] @ np.linalg.solve(K[np.ix_(inner, inner)], K[inner]) if inner.any() else K
    )
    assert close(of_triangles()[np.ix_(~inner, ~inner)], schur[np.ix_(~inner, ~inner)])
    f, x = rng.normal(size=len(K)), rng.normal(size=len(K))
    exact = x.copy()
    exact[free] = np.linalg.solve(K[np.ix_(free, free)], (f - K @ (x * ~free))[free])
    sought = free & op.sought
    x[op.within] = np.nan  # is not looked at
    x[sought] = exact[sought]
    left = op.condensed(f) - op.apply(np.where(op.within, 0.0, x))
    assert np.abs(left[sought]).max() < 1e-9 * np.abs(f).max()
    op.completed(op.condensed(f), x)
    assert np.abs(x - exact).max() < 1e-9 * np.abs(exact).max()


@pytest.mark.parametrize("order", [1, 2, 3])
def test_bits_of_a_triangle_do_not_depend_on_its_place_among_them(order):
    found, rng = some_flow(order, False)
    op = found.operator
    op.assemble()
    on, some = op.topology, rng.integers(len(op.area), size=2 * integrals.BLOCK + 1)
    K, inner = op.K[some], np.tril(op.inner, op.outer)[some]
    part = Topology(on.box, on.count, on.triangles[some], on.shifts[some])
    other = Operator(part, found.mesh.points, order, op.viscosity, op.density)
    other.fields[:], other.stirred[:] = op.fields, op.stirred[some]
    other.assemble()
    assert np.array_equal(other.K, K)
    assert np.array_equal(np.tril(other.inner, op.outer), inner)


@EACH
def test_averages_are_in_the_matrix_condensed_with_it(order, periodic):
    """Eq. (1) of averaged, from integrals of NGSolve, beside the matrices of the triangles."""
    found, rng = some_flow(order, periodic)
    op, k, n = found.operator, found.kernel, len(found.velocity)
    condensed, op.outer = op.outer, op.rows.shape[1]
    op.assemble()
    K = np.array([op.apply(row) for row in np.eye(len(op.free))])
    E, S, it = rng.uniform(0.5, 1.0, n), rng.uniform(0.5, 1.0, n), Beside(found)
    v, q, much = it.V.TestFunction(), it.Q.TestFunction(), dx(bonus_intorder=3 * max(order, 3))
    for one, disc in enumerate(np.eye(n)):
        psi = Keys(op.topology, element(1)).field(it.grid, k.field(disc))
        for axis in range(2):
            u = np.append(it.load("u", LinearForm(psi * v[axis] * much)).ravel(), 0.0 * op.p)
            slope = np.append(0.0 * op.u, it.load("p", LinearForm(psi * grad(q)[axis] * much)))
            K += E[one] * (np.outer(u, slope) + np.outer(slope, u))
            K -= S[one] * np.outer(slope, slope)
    op.averaged = Averaged(k, E, S)
    assert close(np.array([op.apply(row) for row in np.eye(len(K))]), K)
    op.outer = condensed
    op.assemble()
    x, rest = rng.normal(size=len(K)), ~op.within
    f = K @ x
    y = np.where(op.within, np.nan, x)
    assert close(op.apply(y)[rest], op.condensed(f)[rest])
    op.completed(op.condensed(f), y)
    assert close(y, x)


@EACH
def test_matrix_is_symmetric_and_one_factor_solves(order, periodic):
    found, rng = some_flow(order, periodic)
    op = found.operator
    op.assemble()
    a, b = rng.normal(size=(2, len(op.free)))
    scale = np.linalg.norm(a) * np.linalg.norm(op.apply(b))
    assert abs(a @ op.apply(b) - b @ op.apply(a)) < 1e-13 * scale
    inside = op.sought
    if periodic:
        inside[op.split + np.flatnonzero(op.topology.used)[0]] = False
    P = flow.preconditioner(op, inside)
    r = inside * op.apply(inside * b)
    assert np.linalg.norm(inside * op.apply(P(r)) - r) < 1e-6 * np.linalg.norm(r)


@EACH
def test_a_vertex_that_moves_takes_no_momentum_with_it(order, periodic):
    # Q of all vertices is the momentum, and convection moves it about only.
    found, _ = some_flow(order, periodic)
    op = found.operator
    op.outlets = op.outlets[:0]
    it, m = Beside(found), op.topology.count
    Q, (C, drained) = op.momentum(), op.convection(op.u)
    whole = [
        Integrate(op.density * it.eps * it.u[axis], it.mesh, order=2 * max(order, 3))
        for axis in range(2)
    ]
    assert Q[:m].sum(axis=0) == pytest.approx(whole, rel=1e-12)
    assert np.abs(C[:m].sum(axis=0)).max() < 1e-12 * np.abs(C).max()
    assert abs(drained[:m].sum()) < 1e-12 * np.abs(drained).max()


# --- uniform flow stays uniform ---------------------------------------------------------------


ALONG = (2.0, -1.0)
FLOWS = {
    "periodic": (True, {}, ALONG),
    "inflow": (False, dict.fromkeys(("left", "right", "bottom", "top"), Inflow(ALONG)), ALONG),
    "through": (
        False,
        {"left": Inflow((2.0, 0.0)), "right": Outlet(), "bottom": Slip(), "top": Slip()},
        (2.0, 0.0),
    ),
}


@pytest.mark.parametrize("scheme", ["euler", "bdf2"])
@pytest.mark.parametrize("order", [1, 2, 4])
@pytest.mark.parametrize("kind", FLOWS)
def test_uniform_flow_stays_uniform_on_any_mesh(kind, order, scheme):
    periodic, sides, along = FLOWS[kind]
    box, n, rng = Box(1.0, 1.2, periodic), 40, np.random.default_rng(order)
    fluid = Fluid(
        density=1.5, viscosity=1.0, drag=Nothing(), sides=sides, order=order, scheme=scheme,
        reach=1e9, spacing=0.25, torque=False, tolerance=1e-15,
    )  # fmt: skip
    grid = (np.stack(np.divmod(np.arange(n), 8), axis=1) + 0.5) / (5, 8)
    at = (grid + rng.uniform(-0.03, 0.03, (n, 2))) * box.size
    discs = Discs(np.full(n, 1e-9), np.ones(n), np.zeros(n, bool))
    coupling = Coupling(box, fluid, (0.0, 0.0), discs, at, np.zeros((n, 2)))
    coupling.operator.u[: coupling.operator.topology.count] = along
    coupling.Q = coupling.operator.momentum()
    flips, moved = coupling.mesh.flips, 0
    for _ in range(15):
        way = rng.normal(0.0, 0.03, (n, 2))
        if not periodic:  # they stay inside
            there = np.clip(coupling.mesh.points[:n] + way, 0.02, box.size - 0.02)
            way = there - coupling.mesh.points[:n]
        while not coupling.move(way):
            way = 0.5 * way
        moved += np.abs(way).max() > 1e-3
        coupling.solve(rng.uniform(0.01, 0.02), np.zeros((n, 2)), np.zeros((n, 2)))
        u = coupling.ngsolve()[0]
        error = u - CF(along)
        size = np.hypot(*along) * np.sqrt(box.area)
        error = Integrate(InnerProduct(error, error), u.space.mesh, order=8)
        assert np.sqrt(error) < 1e-12 * size
    assert moved > 10
    assert coupling.mesh.flips > flips + 10
