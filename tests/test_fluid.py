"""Mesoscale flow: exact profiles and slopes, balances, invariances, resolved channels."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ngsolve import CoefficientFunction, Integrate, cos, cosh, sin, x, y

from grainmesh import arrange, fluid, resolved
from grainmesh.closures import HexagonalLattice, Microstructural, SquareLattice
from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.mesh import flow_mesh
from grainmesh.particles import Particles
from grainmesh.triangulation import triangulate

ALONG = CoefficientFunction((1.0, 0.0))
CHANNEL = {"pressure": ("left", "right"), "no_slip": ("bottom", "top")}
LAW = Microstructural()


def mesh_of(t):
    """Finite-element mesh of a triangulation."""
    return flow_mesh(t.box, t.points, t.triangles, t.shifts, t.neighbours)[0]


def random_mesh(n, seed=0, aspect=1.0):
    """Delaunay mesh of random discs in a box of height 1, wall nodes included."""
    box, particles = arrange.random(
        n, porosity=0.7, diameter=1.0, min_gap=0.3, seed=seed, periodic=False, aspect=aspect
    )
    unit = Box(box.width / box.height, 1.0)
    return mesh_of(triangulate(unit, Particles(particles.x / box.height, 1.0 / box.height)))


@pytest.fixture(scope="module")
def random_cell():
    return arrange.random(60, porosity=0.6, diameter=1e-3, min_gap=0.1, seed=3)


@pytest.fixture(scope="module")
def random_flow(random_cell):
    return fluid.solve(*random_cell, LAW, order=2)


@pytest.mark.parametrize("order", [2, 3, 5])
def test_poiseuille_without_drag_is_exact(order):
    mesh = random_mesh(60)
    one = np.ones(mesh.nv)
    (flow,) = fluid.stokes(mesh, one, 0.0 * one, [ALONG], order=order, **CHANNEL)
    error = flow.velocity - CoefficientFunction((0.5 * y * (1.0 - y), 0.0))
    assert np.sqrt(Integrate(error * error, mesh, order=12)) < 1e-12


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_uniform_bed_with_slip_walls_follows_darcy(order):
    mesh = random_mesh(60)
    one = np.ones(mesh.nv)
    sides = {"pressure": ("left", "right"), "slip": ("bottom", "top")}
    (flow,) = fluid.stokes(mesh, 0.6 * one, 300.0 * one, [ALONG], order=order, **sides)
    error = flow.velocity - CoefficientFunction((0.6 / 300.0, 0.0))
    assert np.sqrt(Integrate(error * error, mesh, order=12)) < 1e-10 * 0.6 / 300.0


@pytest.mark.parametrize(("order", "slope"), [(1, 2), (2, 3), (3, 4)])
def test_brinkman_profile_between_no_slip_walls(order, slope):
    # u = (eps G/beta) [1 - cosh(k y)/cosh(k H/2)],  k2 = beta/eps, y from the middle.
    eps, beta = 0.5, 50.0
    k = np.sqrt(beta / eps)
    exact = eps / beta * (1.0 - cosh(k * (y - 0.5)) / np.cosh(0.5 * k))
    sizes, errors = [], []
    for n in (60, 960):
        mesh = random_mesh(n, seed=n)
        one = np.ones(mesh.nv)
        (flow,) = fluid.stokes(mesh, eps * one, beta * one, [ALONG], order=order, **CHANNEL)
        difference = flow.velocity - CoefficientFunction((exact, 0.0))
        errors.append(np.sqrt(Integrate(difference * difference, mesh, order=14)))
        sizes.append(mesh.ne**-0.5)
    measured = np.log(errors[0] / errors[1]) / np.log(sizes[0] / sizes[1])
    assert abs(measured - slope) < 0.5
    assert errors[1] < 5e-3 * eps / beta


def test_far_from_no_slip_walls_darcy_holds():
    mesh = random_mesh(300, aspect=0.08)
    one = np.ones(mesh.nv)
    eps, beta = 0.5, 0.5 * 120.0**2
    (flow,) = fluid.stokes(mesh, eps * one, beta * one, [ALONG], order=4, **CHANNEL)
    width = Integrate(CoefficientFunction(1.0), mesh)
    middle = flow.velocity(mesh(0.5 * width, 0.5))[0]
    assert middle == pytest.approx(eps / beta, rel=1e-10)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("n", [(1, 1), (2, 2), (5, 4)])
def test_periodic_lattice_has_the_permeability_of_its_law(order, n):
    for make, law in ((arrange.square, SquareLattice()), (arrange.hexagonal, HexagonalLattice())):
        if make is arrange.hexagonal and n[1] % 2:
            continue
        box, particles = make(*n, porosity=0.5, diameter=2.0)
        flow = fluid.solve(box, particles, law, order=order)
        expected = 4.0 * law(0.5, np.nan) * np.eye(2)
        np.testing.assert_allclose(flow.tensor, expected, atol=1e-10 * expected[0, 0])


@pytest.mark.parametrize("order", [2, 3, 4])
def test_unknowns_of_a_torus(order):
    # Euler: n vertices, 3 n edges, 2 n triangles; k-1 nodes an edge, (k-1)(k-2)/2 a triangle.
    box, particles = arrange.random(80, porosity=0.6, diameter=1.0, seed=2)
    flow = fluid.solve(box, particles, LAW, order=order)

    def nodes(k):
        return 80 * (1 + 3 * (k - 1) + (k - 1) * (k - 2))

    assert flow.dofs == 2 * nodes(order) + nodes(order - 1)


@given(
    n=st.integers(1, 60),
    seed=st.integers(0, 10**6),
    aspect=st.sampled_from([0.3, 1.0, 4.0]),
    spread=st.sampled_from([0.0, 0.6]),
)
@settings(max_examples=40, deadline=None)
def test_any_torus_closes(n, seed, aspect, spread):
    # Wherever the cut runs: no unknown twice and none lost, each triangle once.
    d = np.random.default_rng(seed).uniform(1.0 - spread, 1.0 + spread, n)
    box, particles = arrange.random(
        n, porosity=0.8, diameter=d, seed=seed, aspect=aspect if n > 8 else 1.0
    )
    flow = fluid.solve(box, particles, SquareLattice(), order=3)
    cells, rest = divmod(flow.dofs, 2 * 9 + 4)  # 9 n cubic and 4 n quadratic nodes on a torus
    assert rest == 0
    assert cells % n == 0
    area = Integrate(CoefficientFunction(1.0), flow.mesh) * flow.scale**2
    assert area == pytest.approx(box.area * cells / n, rel=1e-12)


@pytest.mark.parametrize("order", [2, 3, 4])
def test_smooth_flow_on_a_torus_is_met_across_the_cut(order):
    # u = rot sin(2 pi x) sin(2 pi y), p = 0: f = (B + 8 pi2) u; slope order + 1 as in the bulk.
    s, c, k = (sin(2.0 * np.pi * z) for z in (x, y)), (cos(2.0 * np.pi * z) for z in (x, y)), 30.0
    (sx, sy), (cx, cy) = s, c
    exact = CoefficientFunction((sx * cy, -cx * sy))
    sizes, errors = [], []
    for n in (60, 960):
        box, discs = arrange.random(n, porosity=0.7, diameter=1.0, min_gap=0.3, seed=n)
        unit = Particles(discs.x / box.width, 1.0 / box.width)
        mesh = mesh_of(triangulate(Box(1.0, 1.0, True), unit))
        one = np.ones(mesh.nv)
        force = (k + 8.0 * np.pi**2) * exact
        (flow,) = fluid.stokes(mesh, one, k * one, [force], order=order)
        difference = flow.velocity - exact
        errors.append(np.sqrt(Integrate(difference * difference, mesh, order=14)))
        sizes.append(mesh.ne**-0.5)
    measured = np.log(errors[0] / errors[1]) / np.log(sizes[0] / sizes[1])
    assert abs(measured - (order + 1)) < 0.5


def test_tensor_is_symmetric_and_forces_balance(random_cell, random_flow):
    box, particles = random_cell
    K = random_flow.tensor
    assert abs(K[0, 1] - K[1, 0]) < 1e-10 * np.trace(K)
    assert np.linalg.eigvalsh(K).min() > 0.0
    assert random_flow.force.shape == (2, len(particles), 2)
    np.testing.assert_allclose(
        random_flow.force.sum(axis=1), box.area * np.eye(2), atol=1e-10 * box.area
    )


@pytest.mark.parametrize("periodic", [True, False])
def test_orders_converge(periodic):
    box, particles = arrange.random(
        60, porosity=0.6, diameter=1.0, min_gap=0.1, seed=5, periodic=periodic
    )
    K = [
        fluid.solve(box, particles, LAW, order=k, walls="no-slip").tensor[0, 0]
        for k in (1, 2, 3, 4, 5)
    ]
    steps = np.abs(np.diff(K)) / K[-1]
    assert steps[3] < steps[1] < 0.02
    assert steps[0] < 0.05


def test_numbers_and_units_do_not_matter(random_cell, random_flow):
    box, particles = random_cell
    order = np.random.default_rng(0).permutation(len(particles))
    unit = 2.0**-7
    other = fluid.solve(
        Box(box.width * unit, box.height * unit, True),
        Particles(particles.x[order] * unit, particles.diameter[order] * unit),
        LAW,
    )
    size = np.trace(random_flow.tensor)
    np.testing.assert_allclose(other.tensor / unit**2, random_flow.tensor, atol=1e-9 * size)
    force = random_flow.force[:, order]
    np.testing.assert_allclose(other.force / unit**2, force, atol=1e-8 * force.max())


def test_mirror_image(random_cell, random_flow):
    box, particles = random_cell
    x = np.column_stack([box.width - particles.x[:, 0], particles.x[:, 1]])
    other = fluid.solve(box, Particles(x, particles.diameter), LAW)
    sign = np.array([[1.0, -1.0], [-1.0, 1.0]])
    size = np.trace(random_flow.tensor)
    np.testing.assert_allclose(other.tensor, sign * random_flow.tensor, atol=1e-8 * size)


def test_unequal_and_cut_discs_balance():
    rng = np.random.default_rng(1)
    d = np.exp(rng.uniform(-0.5, 0.5, 80))
    outer, discs = arrange.random(80, porosity=0.5, diameter=d, seed=1)
    flow = fluid.solve(outer, discs, LAW)
    np.testing.assert_allclose(
        flow.force.sum(axis=1), outer.area * np.eye(2), atol=1e-9 * outer.area
    )
    from grainmesh.particles import touches

    box = Box(0.6 * outer.width, 0.7 * outer.height)
    cut = Particles(discs.x - 0.1 * outer.size, discs.diameter)
    flow = fluid.solve(box, cut.select(touches(box, cut)), LAW)
    # With symmetry planes nothing but the discs holds the fluid along the gradient.
    np.testing.assert_allclose(np.diag(flow.force.sum(axis=1)), box.area, rtol=1e-9)


def test_delta_kernel_lets_the_fluid_slip_and_does_not_converge():
    box, particles = arrange.square(10, 10, porosity=0.6, diameter=1.0, periodic=False)
    hat, delta = (
        [
            fluid.solve(
                box, particles, SquareLattice(), order=k, kernel=kernel, walls="no-slip"
            ).tensor[0, 0]
            for k in (2, 4)
        ]
        for kernel in ("hat", "delta")
    )
    assert hat[1] == pytest.approx(hat[0], rel=0.01)
    assert delta[0] > 5.0 * hat[0]
    assert delta[1] > 1.2 * delta[0]


def channel_ratios(box, particles, law, orders=(2, 4), tol=1e-3):
    flow = resolved.solve(box, particles, walls="no-slip", tol=tol)
    return [
        fluid.solve(box, particles, law, order=k, walls="no-slip").tensor[0, 0] / flow.tensor[0, 0]
        for k in orders
    ]


CHANNELS = {
    "10x10": (arrange.square, 10, 10, SquareLattice()),
    "8x14": (arrange.square, 8, 14, SquareLattice()),
    "hexagonal": (arrange.hexagonal, 10, 10, HexagonalLattice()),
}


@pytest.mark.parametrize("porosity", [0.4, 0.95])
def test_ordered_channel_against_resolved(porosity):
    box, particles = arrange.square(6, 6, porosity=porosity, diameter=1.0, periodic=False)
    for ratio in channel_ratios(box, particles, SquareLattice()):
        assert ratio == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("porosity", [0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95])
@pytest.mark.parametrize("name", CHANNELS)
def test_ordered_channels_against_resolved(name, porosity):
    make, nx, ny, law = CHANNELS[name]
    box, particles = make(nx, ny, porosity=porosity, diameter=1.0, periodic=False)
    for ratio in channel_ratios(box, particles, law):
        assert ratio == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("porosity", [0.5, 0.7, 0.9])
def test_random_channel_against_resolved(porosity):
    # Lambda of the same medium: of the same discs with planes of symmetry for walls.
    box, particles = arrange.random(
        200, porosity=porosity, diameter=1.0, min_gap=0.1, seed=1, periodic=False
    )
    free = resolved.solve(box, particles, tol=3e-3).tensor[0, 0]
    coarse = fluid.solve(box, particles, LAW).tensor[0, 0]
    law = Microstructural(C=LAW.C * free / coarse)
    for ratio in channel_ratios(box, particles, law, tol=3e-3):
        assert ratio == pytest.approx(1.0, abs=0.1)


def test_local_gap_keeps_the_balance(random_cell):
    box, particles = random_cell
    flow = fluid.solve(box, particles, LAW, gap="local")
    np.testing.assert_allclose(flow.force.sum(axis=1), box.area * np.eye(2), atol=1e-9 * box.area)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"kernel": "point"}, "kernel 'point' unknown"),
        ({"walls": "sticky"}, "walls 'sticky' unknown"),
        ({"gap": "mean"}, "gap 'mean' unknown"),
        ({"order": 0}, "order 0"),
    ],
)
def test_bad_words_are_refused(random_cell, words, message):
    with pytest.raises(InputError, match=message):
        fluid.solve(*random_cell, LAW, **words)
