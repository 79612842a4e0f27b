"""Resolved Stokes flow: exact lattices, balances, invariances, limits."""

import numpy as np
import pytest

from grainmesh import arrange, closures, resolved
from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.particles import Particles

# K/d2 of square and hexagonal arrays by multipole collocation (Sangani & Acrivos 1982 for square).
SQUARE = {
    0.95: 1.009651,
    0.9: 0.3162888,
    0.8: 0.07621237,
    0.7: 0.02544674,
    0.6: 0.009011228,
    0.5: 0.002949586,
    0.4: 0.0007422414,
    0.3: 8.299319e-05,
}
HEXAGONAL = {
    0.95: 0.9981084,
    0.9: 0.3125089,
    0.8: 0.07677759,
    0.7: 0.02704724,
    0.6: 0.01056946,
    0.5: 0.004109636,
    0.4: 0.001451849,
    0.3: 0.0004050662,
}


def shifted(box, particles, shift):
    return box, Particles(particles.x + np.asarray(shift) * box.size, particles.diameter)


@pytest.fixture(scope="module")
def random_cell():
    return arrange.random(40, porosity=0.6, diameter=2e-3, seed=7)


@pytest.fixture(scope="module")
def random_flow(random_cell):
    return resolved.solve(*random_cell, tol=1e-3)


@pytest.mark.parametrize("porosity", SQUARE)
@pytest.mark.parametrize(("n", "shift"), [(1, (0.0, 0.0)), (1, (0.4321, 0.9)), (2, (0.123, 0.25))])
def test_square_lattice(porosity, n, shift):
    box, particles = shifted(*arrange.square(n, n, porosity=porosity, diameter=1e-3), shift)
    flow = resolved.solve(box, particles, tol=2e-5)
    np.testing.assert_allclose(
        flow.tensor / 1e-6, SQUARE[porosity] * np.eye(2), atol=1e-4 * SQUARE[porosity]
    )


@pytest.mark.parametrize("porosity", HEXAGONAL)
@pytest.mark.parametrize(("n", "shift"), [((1, 2), (0.0, 0.0)), ((2, 2), (0.77, 0.011))])
def test_hexagonal_lattice(porosity, n, shift):
    box, particles = shifted(*arrange.hexagonal(*n, porosity=porosity, diameter=1.0), shift)
    flow = resolved.solve(box, particles, tol=2e-5)
    exact = HEXAGONAL[porosity]
    np.testing.assert_allclose(flow.tensor, exact * np.eye(2), atol=1e-4 * exact)


def test_tensor_is_symmetric_and_positive(random_flow):
    K = random_flow.tensor
    assert abs(K[0, 1] - K[1, 0]) < 1e-10 * np.trace(K)
    assert np.linalg.eigvalsh(K).min() > 0.0


def test_forces_balance_the_pressure_gradient(random_cell, random_flow):
    # Permeability from drag: K = mu U A / sum F, so sum F = G A says it equals K from flux.
    box, particles = random_cell
    assert random_flow.force.shape == (2, len(particles), 2)
    total = random_flow.force.sum(axis=1)
    np.testing.assert_allclose(total, box.area * np.eye(2), atol=1e-9 * box.area)


def test_dissipation_equals_the_work_of_the_pressure(random_cell, random_flow):
    # Energy: int |grad u|2 dx = int u.G dx = K A, here per direction and mixed.
    from ngsolve import Grad, InnerProduct, Integrate

    box, _ = random_cell
    u, mesh, s = random_flow.velocity, random_flow.mesh, random_flow.scale
    energy = np.array(
        [
            [Integrate(InnerProduct(Grad(u[i]), Grad(u[j])), mesh, order=14) for j in range(2)]
            for i in range(2)
        ]
    )
    # Discrete velocities are divergence free only against the pressures: equal to round-off of
    # the quadrature on curved elements.
    np.testing.assert_allclose(energy * s**4 / box.area, random_flow.tensor, rtol=1e-5)


def test_origin_does_not_matter(random_cell, random_flow):
    rng = np.random.default_rng(0)
    for shift in rng.random((2, 2)):
        flow = resolved.solve(*shifted(*random_cell, shift), tol=1e-3)
        change = np.abs(flow.tensor - random_flow.tensor).max()
        assert change < 1e-3 * np.trace(random_flow.tensor) / 2


@pytest.mark.slow
def test_hundred_origins(random_cell, random_flow):
    rng = np.random.default_rng(1)
    size = np.trace(random_flow.tensor) / 2
    for shift in rng.random((100, 2)):
        flow = resolved.solve(*shifted(*random_cell, shift), tol=1e-3)
        assert np.abs(flow.tensor - random_flow.tensor).max() < 1e-3 * size


def test_quarter_turn_turns_the_tensor(random_cell, random_flow):
    box, particles = random_cell
    x = np.column_stack([box.height - particles.x[:, 1], particles.x[:, 0]])
    turned = resolved.solve(Box(box.height, box.width, True), Particles(x, particles.diameter))
    R = np.array([[0.0, -1.0], [1.0, 0.0]])
    expected = R @ random_flow.tensor @ R.T
    np.testing.assert_allclose(turned.tensor, expected, atol=1e-3 * np.trace(expected) / 2)


def test_unit_of_length_does_not_matter(random_cell, random_flow):
    box, particles = random_cell
    unit = 2.0**-10  # exact in floating point, so the mesh is the same too
    small = Particles(particles.x * unit, particles.diameter * unit)
    flow = resolved.solve(Box(box.width * unit, box.height * unit, True), small)
    np.testing.assert_allclose(flow.tensor, random_flow.tensor * unit**2, rtol=1e-9)


def test_estimate_covers_the_error(random_cell):
    reference = resolved.solve(*random_cell, order=7).tensor
    for order in (3, 4, 5):
        flow = resolved.solve(*random_cell, order=order)
        error = np.linalg.norm(flow.tensor - reference) / np.linalg.norm(reference)
        assert error < flow.error < 100.0 * error


def test_window_is_a_quarter_of_its_mirror_images():
    box, particles = arrange.random(
        6, porosity=0.7, diameter=1.0, min_gap=0.1, seed=2, periodic=False
    )
    window = resolved.solve(box, particles, tol=1e-4)
    x, size = particles.x, box.size
    mirrored = np.concatenate(
        [x, (-1, 1) * x + (2, 0) * size, (1, -1) * x + (0, 2) * size, 2 * size - x]
    )
    whole = resolved.solve(
        Box(2 * box.width, 2 * box.height, True), Particles(mirrored, 1.0), tol=1e-4
    )
    np.testing.assert_allclose(np.diag(window.tensor), np.diag(whole.tensor), rtol=5e-4)
    assert abs(whole.tensor[0, 1]) < 1e-4 * whole.tensor[0, 0]
    assert window.tensor[0, 1] == window.tensor[1, 0] == 0.0


def test_cut_corners_do_not_fool_the_estimate():
    box = Box(2.0, 2.0)
    caps = Particles([[1.0, -0.3], [-0.3, 1.0], [2.3, 1.0], [1.0, 2.3]], 1.0)
    flow = resolved.solve(box, caps, tol=1e-3)
    fine = resolved.solve(box, caps, order=6, maxh=0.15)
    error = np.abs(flow.tensor - fine.tensor).max() / fine.tensor[0, 0]
    assert error < 1e-3


def test_dilute_limit():
    # Square lattice: 32 phi K/d2 = ln(1/phi) - 1.476336 + 2 phi + O(phi2).
    box, particles = Box(100.0, 100.0, True), Particles([[1.0, 2.0]], 1.0)
    phi = np.pi / 4.0 / box.area
    exact = (-np.log(phi) - 1.476336 + 2.0 * phi) / (32.0 * phi)
    assert resolved.solve(box, particles).tensor[0, 0] == pytest.approx(exact, rel=1e-3)


def test_no_slip_walls_hold_the_flow_back():
    box, particles = arrange.square(3, 3, porosity=0.8, diameter=1.0, periodic=False)
    free = resolved.solve(box, particles, walls="symmetry")
    held = resolved.solve(box, particles, walls="no-slip")
    np.testing.assert_allclose(free.tensor[0, 0], SQUARE[0.8], rtol=2e-3)
    assert held.tensor[0, 0] < 0.95 * free.tensor[0, 0]


@pytest.mark.parametrize("gap", [1e-1, 1e-2, 1e-3])
def test_narrow_gaps_follow_lubrication(gap):
    # Square lattice whose discs leave a gap of 1e-3 radii: beyond any table, where the closed
    # lubrication limit of the closure is asymptotically exact, K ~ gap^2.5.
    pitch = 2.0 + gap
    box, particles = Box(pitch, pitch, True), Particles([[0.1, 0.2]], 2.0)
    flow = resolved.solve(box, particles, tol=1e-4)
    porosity = 1.0 - np.pi / pitch**2
    law = closures.SquareLattice()
    assert flow.closed == 0
    np.testing.assert_allclose(flow.tensor[0, 0] / 4.0, law(porosity, gap / 2.0), rtol=1e-3)


def test_touching_discs_let_nothing_through():
    # A column of touching discs from edge to edge: no flow along x, free flow along y.
    box = Box(3.0, 2.0, True)
    particles = Particles([[1.0, 0.5], [1.0, 1.5]], 1.0)
    flow = resolved.solve(box, particles, tol=1e-3)
    assert flow.closed == 2
    assert abs(flow.tensor[0, 0]) < 1e-9
    assert flow.tensor[1, 1] > 0.1


def test_slight_overlap_changes_little():
    box, particles = arrange.random(20, porosity=0.6, diameter=1.0, min_gap=0.2, seed=4)
    x = np.array(particles.x)
    d = np.full(len(x), 1.0)
    tree = box.separation(x[:, None], x[None])
    distance = np.hypot(*np.moveaxis(tree, -1, 0)) + 9.0 * np.eye(len(x))
    d[:] = 1.0 + 0.5 * (distance.min() - 1.0)  # no contact
    i, j = np.unravel_index(distance.argmin(), distance.shape)
    found = []
    for overlap in (-1e-3, 1e-3):  # of the closest pair, in diameters
        grown = d.copy()
        grown[[i, j]] = distance.min() + overlap
        found.append(resolved.solve(box, Particles(x, grown), tol=1e-3))
    assert [flow.closed for flow in found] == [0, 1]
    np.testing.assert_allclose(found[0].tensor, found[1].tensor, atol=0.01 * found[0].tensor[0, 0])


def test_unequal_cut_and_overlapping_discs_keep_the_balance():
    rng = np.random.default_rng(5)
    outer, discs = arrange.random(40, porosity=0.5, diameter=np.exp(rng.uniform(-1, 1, 40)), seed=5)
    box = Box(0.6 * outer.width, 0.5 * outer.height)
    grown = Particles(discs.x - 0.2 * outer.size, 1.03 * discs.diameter)
    from grainmesh.particles import touches

    grown = grown.select(touches(box, grown))
    flow = resolved.solve(box, grown, tol=1e-2)
    assert flow.closed > 0
    total = np.diag(flow.force.sum(axis=1))
    np.testing.assert_allclose(total, box.area, rtol=1e-9)
    assert np.diag(flow.tensor).min() > 0.0


def test_bad_words_are_refused(random_cell):
    with pytest.raises(InputError, match="walls 'sticky' unknown"):
        resolved.solve(*random_cell, walls="sticky")
    with pytest.raises(InputError, match="order 2 "):
        resolved.solve(*random_cell, order=2)
