"""One implicit step of the flow: manufactured solutions, order in time, what must not change."""

import importlib.util
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from ngsolve import CF, InnerProduct, Integrate, Mesh, unit_square, x, y

from grainmesh.coupling import Coupling, Discs
from grainmesh.domain import Box
from grainmesh.drag import Drag
from grainmesh.medium import Fluid, Inflow, Outlet, Slip
from grainmesh.navier import Operator

# The exact solutions and what drives to them are those of docs/flow.md.
SPEC = importlib.util.spec_from_file_location(
    "flow", Path(__file__).parent.parent / "docs" / "flow.py"
)
flow = importlib.util.module_from_spec(SPEC)
sys.modules["flow"] = flow  # dataclasses look their module up
SPEC.loader.exec_module(flow)


def slopes(flows):
    """Slopes of the errors of u and p over the size of the triangles."""
    errors = np.array([one.errors() for one in flows])
    h = [one.op.mesh.ne**-0.5 for one in flows]
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
    drag, lift, _ = flow.cylinder(3, 0.02)
    assert drag == pytest.approx(5.5795, rel=1e-3)
    assert lift == pytest.approx(0.0106, rel=0.05)
    drag, lift, _ = flow.cylinder(4, 0.02)
    assert drag == pytest.approx(5.57954, rel=1e-4)
    assert lift == pytest.approx(0.010619, rel=3e-3)


@pytest.mark.parametrize("order", [1, 2, 4])
def test_matrix_is_symmetric_and_the_same_in_parts_and_whole(order):
    op = Operator(Mesh(unit_square.GenerateMesh(maxh=0.5)), order, 2.0, 3.0, no_slip=("left",))
    rng = np.random.default_rng(1)
    for name in ("eps", "inertia", "E", "S"):
        op.load(**{name: rng.uniform(0.5, 1.0, op.mesh.nv)})
    op.assemble()
    a, b = rng.normal(size=(2, len(op.free)))
    scale = np.linalg.norm(a) * np.linalg.norm(op.apply(b))
    assert abs(a @ op.apply(b) - b @ op.apply(a)) < 1e-13 * scale
    # The factor is of the same matrix: one application solves.
    P = flow.preconditioner(op)
    r = op.free * op.apply(op.free * b)
    assert np.linalg.norm(op.free * op.apply(P(r)) - r) < 1e-6 * np.linalg.norm(r)


def test_a_vertex_that_moves_takes_no_momentum_with_it():
    # Q of all vertices is the momentum, and convection moves it about only.
    op = Operator(Mesh(unit_square.GenerateMesh(maxh=0.4)), 3, 1.0, 3.0)
    rng = np.random.default_rng(2)
    op.load(eps=rng.uniform(0.5, 1.0, op.mesh.nv), w=rng.normal(size=(op.mesh.nv, 2)))
    op.u.Set(CF((x * y, 1.0 + x)))
    op.foretold.vec.data = op.u.vec
    Q, C = op.vector("momentum").reshape(2, -1), op.vector("convection").reshape(2, -1)
    m = op.mesh.nv
    whole = [Integrate(3.0 * op.eps * op.u[axis], op.mesh, order=6) for axis in range(2)]
    assert Q[:, :m].sum(axis=1) == pytest.approx(whole, rel=1e-13)
    assert np.abs(C[:, :m].sum(axis=1)).max() < 1e-12 * np.abs(C).max()


# --- uniform flow stays uniform ---------------------------------------------------------------


@dataclass(frozen=True)
class Nothing(Drag):
    """A law for discs that are not there."""

    name, reference, medium, variable, valid = "nothing", "-", "-", "porosity", (0.0, 1.0)

    def _argument(self, bed):
        return bed.porosity

    def _coefficient(self, bed):
        return np.zeros(len(bed.diameter))


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
    coupling.operator.u.Set(CF(along))
    coupling.Q = coupling.operator.vector("momentum")
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
        op = coupling.operator
        error = op.u - CF(along)
        size = np.hypot(*along) * np.sqrt(box.area)
        assert np.sqrt(Integrate(InnerProduct(error, error), op.mesh, order=8)) < 1e-12 * size
    assert moved > 10
    assert coupling.mesh.flips > flips + 10
