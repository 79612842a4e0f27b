"""Triangulations: Euler, areas, empty circles, gaps of lattices, conserved solid, no slivers."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from grainmesh.cells import cells
from grainmesh.domain import SIDES, Box
from grainmesh.errors import InputError
from grainmesh.flips import repair
from grainmesh.particles import MAX_OVERLAP, Particles, settle
from grainmesh.triangulation import WALL_LAYER, enclose, triangulate

close = partial(pytest.approx, abs=0.0)


def scattered(box, n, seed, spread=0.0, overlap=0.0):
    """Up to n random discs of mean diameter 1; with walls some are cut, or have centres outside."""
    rng = np.random.default_rng(seed)
    beyond = 0.0 if box.periodic else 0.5
    x, r = np.empty((0, 2)), np.empty(0)
    for _ in range(20 * n):
        y, s = rng.uniform(-beyond, box.size + beyond), 0.5 * rng.uniform(1 - spread, 1 + spread)
        distance = np.hypot(*box.separation(x, y).T)
        fits = (distance >= r + s - overlap * np.minimum(r, s)).all()
        if fits and (box.periodic or np.hypot(*(y - np.clip(y, 0, box.size))) < s) and len(x) < n:
            x, r = np.vstack([x, y]), np.append(r, s)
    return settle(box, Particles(x, 2 * r))


def square_lattice(k, diameter):
    return Particles(np.stack(np.meshgrid(*2 * [np.arange(k) + 0.5]), -1).reshape(-1, 2), diameter)


def hexagonal_lattice(k, diameter):
    i, j = np.meshgrid(np.arange(k), np.arange(2 * k))
    x = np.stack([i + 0.5 * (j % 2), (j + 0.5) * np.sqrt(0.75)], axis=-1).reshape(-1, 2)
    return Box(k, 2 * k * np.sqrt(0.75), periodic=True), Particles(x, diameter)


def rows(array):
    return {tuple(row) for row in array.tolist()}


any_case = {
    "n": st.integers(1, 40),
    "seed": st.integers(0, 10**6),
    "aspect": st.sampled_from([0.3, 1.0, 4.0]),
    "spread": st.sampled_from([0.0, 0.6]),
    "periodic": st.booleans(),
}


def case(n, seed, aspect, spread, periodic):
    side = np.sqrt(2.5 * n)
    box = Box(max(side * aspect, 2.0), max(side / aspect, 2.0), periodic)
    return box, scattered(box, n, seed, spread, 0.0 if periodic else 0.9 * MAX_OVERLAP)


@settings(max_examples=80, deadline=None)
@given(**any_case)
def test_every_box_is_covered_once_with_the_right_topology(**parameters):
    box, particles = case(**parameters)
    mesh = triangulate(box, particles)
    m, t, e = len(mesh.points), len(mesh.triangles), len(mesh.edges)
    assert mesh.areas.min() > 0
    assert mesh.areas.sum() == close(box.area, rel=1e-12)
    assert mesh.angles.sum(axis=1) == close(np.pi, rel=1e-12)
    if box.periodic:
        assert (m, t, e) == (mesh.n, 2 * mesh.n, 3 * mesh.n)
        assert len(mesh.wall_edges) == 0
    else:
        assert m - e + t == 1
        assert len(mesh.wall_edges) == 2 * e - 3 * t
        assert not mesh.shifts.any()
    np.testing.assert_array_equal(np.unique(mesh.triangles), np.arange(m))

    # The edge and the neighbour opposite each corner, both ways round.
    i, j = np.roll(mesh.triangles, -1, axis=1), np.roll(mesh.triangles, -2, axis=1)
    ends = np.sort(np.stack([i, j], axis=-1), axis=-1)
    np.testing.assert_array_equal(mesh.edges[mesh.triangle_edges], ends)
    side = np.roll(mesh.corners, -1, axis=1) - np.roll(mesh.corners, -2, axis=1)
    assert mesh.edge_lengths[mesh.triangle_edges] == close(
        np.hypot(*np.moveaxis(side, -1, 0)), rel=1e-12
    )
    for here in range(t):
        for k in range(3):
            there = mesh.neighbours[here, k]
            if there >= 0:
                back = mesh.triangle_edges[there] == mesh.triangle_edges[here, k]
                assert here in mesh.neighbours[there][back]


@settings(max_examples=40, deadline=None)
@given(**any_case)
def test_no_point_is_nearer_than_the_corners_to_where_three_cells_meet(**parameters):
    box, particles = case(**parameters)
    mesh = triangulate(box, particles)
    weight = np.full(len(mesh.points), particles.radius.min() ** 2)
    weight[: mesh.n] = particles.radius**2
    if not box.periodic:
        weight[((mesh.points == 0) | (mesh.points == box.size)).any(axis=1)] = weight.min()
    # The point c of equal power: 2 (b - a).c = |b|² - |a|² - w_b + w_a.
    a = mesh.corners[:, :1]
    rest, w = mesh.corners[:, 1:] - a, weight[mesh.triangles]
    right = (rest**2).sum(axis=-1) - w[:, 1:] + w[:, :1]
    c = np.linalg.solve(2 * rest, right[..., None])[..., 0]
    power = (c**2).sum(axis=1) - w[:, 0]
    reach = 4 if box.periodic else 0
    images = np.stack(np.meshgrid(*2 * [np.arange(-reach, reach + 1)]), axis=-1).reshape(-1, 2)
    for image in images:
        away = mesh.points + image * box.size - (c + a[:, 0])[:, None]
        others = (away**2).sum(axis=-1) - weight
        assert (others >= power[:, None] - 1e-5 * (1 + np.abs(power[:, None]))).all()


@pytest.mark.parametrize("wall_nodes", [True, False])
def test_equal_discs_between_walls_have_the_delaunay_triangulation(wall_nodes):
    box = Box(11.0, 8.0)
    mesh = triangulate(box, scattered(box, 40, 2), wall_nodes=wall_nodes)
    expected = Delaunay(mesh.points).simplices
    if not wall_nodes:  # only what meets inside the enlarged box
        np.testing.assert_array_equal(mesh.points, mesh.particles.x)
        assert (mesh.wall_sides == -1).all()
        a, rest = mesh.points[expected[:, 0]], mesh.points[expected[:, 1:]]
        rest = rest - a[:, None]
        c = a + np.linalg.solve(2 * rest, (rest**2).sum(axis=-1)[..., None])[..., 0]
        expected = expected[((c > -5.5) & (c < box.size + 5.5)).all(axis=1)]
    assert rows(np.sort(mesh.triangles, axis=1)) == rows(np.sort(expected, axis=1))


@pytest.mark.parametrize("periodic", [False, True])
def test_unequal_discs_in_contact_are_joined(periodic):
    # Two large discs almost touch, two small ones touch both; Delaunay would join the small ones.
    box = Box(12.0, 9.0, periodic)
    gap = 1e-3
    x, s = 2.0 + gap / 2, 0.55
    y = np.sqrt((2.0 + s) ** 2 - x**2)
    centres = 4.5 + np.array([[-x, 0.0], [x, 0.0], [0.0, y], [0.0, -y]])
    particles = Particles(centres + np.array([1.0, 0.0]), [4.0, 4.0, 2 * s, 2 * s])
    mesh = triangulate(box, particles)
    here = (mesh.edge_shifts == 0).all(axis=1)
    found = dict(zip(map(tuple, mesh.edges[here].tolist()), mesh.gaps[here], strict=True))
    assert found[0, 1] == close(gap, rel=1e-10)
    assert (2, 3) not in found
    for edge in ((0, 2), (1, 2), (0, 3), (1, 3)):
        assert abs(found[edge]) < 1e-14


@pytest.mark.parametrize("k", [1, 2, 3, 10])
@pytest.mark.parametrize("origin", [(0.0, 0.0), (0.5, 0.5), (0.123, 0.987)])
@pytest.mark.parametrize("scale", [1.0, 1e-6])
def test_gaps_of_a_square_lattice_are_exact(k, origin, scale):
    diameter = 0.7
    lattice = square_lattice(k, diameter)
    particles = Particles(scale * (lattice.x + np.array(origin)), scale * diameter)
    mesh = triangulate(Box(scale * k, scale * k, periodic=True), particles)
    gamma = 1.0 / diameter - 1.0
    assert mesh.gap_shortest == close(gamma, rel=1e-12)
    assert mesh.gap_second == close(gamma, rel=1e-12)
    assert mesh.gap_of_particle == close(gamma, rel=1e-12)
    assert mesh.gap_scatter == 0.0
    # All squares are cut by the same diagonal: one right angle, two of 45 degrees each.
    assert np.sort(mesh.angles, axis=1) == close(
        np.pi * np.array([[0.25, 0.25, 0.5]] * 2 * k * k), rel=1e-9
    )


@pytest.mark.parametrize("k", [1, 2, 5])
def test_gaps_of_a_hexagonal_lattice_are_exact(k):
    box, particles = hexagonal_lattice(k, 0.8)
    mesh = triangulate(box, particles)
    assert mesh.gap_shortest == close(0.25, rel=1e-12)
    assert mesh.gap_second == close(0.25, rel=1e-12)
    assert mesh.gap_scatter == 0.0
    assert mesh.gaps == close(0.2, rel=1e-12)
    assert mesh.angles == close(np.pi / 3, rel=1e-9)


@pytest.mark.parametrize("k", [2, 9])
def test_gaps_of_a_lattice_between_walls_leave_out_the_wall_nodes(k):
    mesh = triangulate(Box(k, k), square_lattice(k, 0.7))
    assert mesh.gap_shortest == close(1.0 / 0.7 - 1.0, rel=1e-12)
    assert mesh.gap_second == close(1.0 / 0.7 - 1.0, rel=1e-12)
    wall = (mesh.edges >= mesh.n).any(axis=1)
    np.testing.assert_array_equal(np.isnan(mesh.gaps), wall)


def test_touching_lattice_has_no_gap_and_no_scatter():
    mesh = triangulate(Box(6.0, 6.0, periodic=True), square_lattice(6, 1.0))
    assert mesh.gap_shortest == pytest.approx(0.0, abs=1e-14)
    assert mesh.gap_scatter == 0.0


def test_gaps_of_random_discs_by_brute_force():
    box = Box(9.0, 7.0, periodic=True)
    particles = scattered(box, 25, 4, spread=0.3)
    mesh = triangulate(box, particles)
    d = particles.mean_diameter
    r = particles.radius
    around = [[] for _ in range(mesh.n)]
    for (i, j), shift, gap in zip(mesh.edges, mesh.edge_shifts, mesh.gaps, strict=True):
        away = particles.x[j] + shift * box.size - particles.x[i]
        assert gap == close(np.hypot(*away) - r[i] - r[j], rel=1e-12)
        around[i].append(gap)
        around[j].append(gap)
    second = np.array([sorted(gaps)[1] for gaps in around]) / d
    np.testing.assert_array_equal(mesh.gap_of_particle, second)
    assert mesh.gap_second == close(second.mean(), rel=1e-13)
    shortest = []
    for a, b, c in mesh.triangles:
        corners = mesh.corners[len(shortest)]
        sides = [np.hypot(*(corners[k] - corners[k - 1])) for k in range(3)]
        shortest.append(min(sides - np.array([r[a] + r[c], r[b] + r[a], r[c] + r[b]])))
    assert mesh.gap_shortest == close(np.mean(shortest) / d, rel=1e-12)
    assert mesh.gap_scatter == close(np.std(shortest) / np.mean(shortest), rel=1e-11)


def test_scatter_tells_random_discs_from_a_lattice():
    rng = np.random.default_rng(0)
    lattice = square_lattice(8, 0.7)
    scatter = [
        triangulate(
            Box(8.0, 8.0, periodic=True), Particles(lattice.x + rng.uniform(-a, a, (64, 2)), 0.7)
        ).gap_scatter
        for a in (0.0, 0.01, 0.04, 0.12)
    ]
    assert (np.diff(scatter) > 0).all()
    assert scatter[-1] > 0.2


@settings(max_examples=80, deadline=None)
@given(**any_case)
def test_the_porosity_of_triangles_conserves_the_solid(**parameters):
    box, particles = case(**parameters)
    mesh, found = triangulate(box, particles), cells(box, particles)
    solid = ((1.0 - mesh.triangle_porosity(found)) * mesh.areas).sum()
    assert solid == close(found.solid.sum(), rel=1e-12)


@pytest.mark.parametrize("spread", [0.0, 0.5])
def test_the_porosity_of_a_triangle_of_whole_discs(spread):
    box = Box(8.0, 6.0, periodic=True)
    particles = scattered(box, 20, 1, spread)
    mesh = triangulate(box, particles)
    # 1 - sum_j α_j r_j² / (2 A_T)
    sector = (mesh.angles * particles.radius[mesh.triangles] ** 2).sum(axis=1) / 2
    assert mesh.triangle_porosity(cells(box, particles)) == pytest.approx(
        1.0 - sector / mesh.areas, abs=1e-12
    )


def test_the_porosity_of_vertices():
    box = Box(7.0, 5.0)
    particles = scattered(box, 14, 8)
    mesh, found = triangulate(box, particles), cells(box, particles)
    value = mesh.vertex_porosity(found)
    np.testing.assert_array_equal(value[: mesh.n], found.porosity)
    for node in range(mesh.n, len(mesh.points)):
        near = np.unique(mesh.edges[(mesh.edges == node).any(axis=1)])
        near = near[near < mesh.n]
        assert value[node] == close(found.porosity[near].mean() if len(near) else 1.0, rel=1e-13)
    # The corners of this box are joined to wall nodes only.
    mesh = triangulate(Box(2.0, 2.0), Particles([[1.0, 1.2]], 0.1))
    value = mesh.vertex_porosity(cells(mesh.box, mesh.particles))
    corner = ((mesh.points == 0) | (mesh.points == 2)).all(axis=1)
    assert value[corner].tolist() == 4 * [1.0]
    assert value[~corner] == close(1.0 - np.pi * 0.05**2 / 4.0, rel=1e-13)


@settings(max_examples=60, deadline=None)
@given(n=st.integers(1, 40), seed=st.integers(0, 10**6), spread=st.sampled_from([0.0, 0.6]))
def test_walls_have_nodes_exactly_on_them_and_near_particles_stand_there(n, seed, spread):
    box = Box(7.3, 9.1)
    particles = scattered(box, n, seed, spread, 0.9 * MAX_OVERLAP)
    mesh = triangulate(box, particles)
    x, quarter = particles.x, WALL_LAYER * particles.diameter[:, None]
    for wall in ([0.0, 0.0], [7.3, 0.0], [0.0, 9.1], [7.3, 9.1]):
        assert (mesh.points == wall).all(axis=1).sum() == 1
    inside = ((x >= quarter) & (box.size - x >= quarter)).all(axis=1)
    np.testing.assert_array_equal(mesh.points[: mesh.n][inside], x[inside])
    on_wall = ((mesh.points == 0) | (mesh.points == box.size)).any(axis=1)
    assert on_wall[: mesh.n][~inside].all()
    assert on_wall[mesh.n :].all()
    assert (np.abs(mesh.points[: mesh.n] - x) <= 2 * quarter).all()
    # Each side is covered once by its edges, in the order that keeps the box on their left.
    a, b = mesh.points[mesh.wall_edges[:, 0]], mesh.points[mesh.wall_edges[:, 1]]
    ways = {"left": (0, -9.1), "right": (0, 9.1), "bottom": (7.3, 0), "top": (-7.3, 0)}
    for side, way in ways.items():
        along = (b - a)[mesh.wall_sides == SIDES.index(side)]
        assert along.sum(axis=0) == pytest.approx(np.array(way, dtype=float), abs=1e-13)
        assert np.abs(along).sum() == close(np.abs(way).sum(), rel=1e-13)


@pytest.mark.parametrize(("spread", "bound"), [(0.0, 5.0), (0.3, 5.0), (0.6, 3.5)])
def test_no_sliver_arises_at_walls(spread, bound):
    # The flattest has a particle a quarter of its diameter off the wall over an edge of about 3 d.
    for seed in range(60):
        box = Box(*np.random.default_rng(seed).uniform(2.0, 9.0, 2))
        mesh = triangulate(box, scattered(box, 12, seed, spread, 0.9 * MAX_OVERLAP))
        assert np.degrees(mesh.angles.min()) > bound


def test_a_wall_node_moves_away_from_a_disc_above_it_by_half_a_diameter():
    x = [[4.0, 0.3], [2.5, 3.0], [5.5, 3.0], [2.0, 6.0], [6.0, 6.0]]
    mesh = triangulate(Box(8.0, 8.0), Particles(x, 1.0))
    nodes = mesh.points[mesh.n :]
    along = np.sort(nodes[nodes[:, 1] == 0.0, 0])
    along[2] = 4.0 - abs(along[2] - 4.0)  # to either side
    assert along == close([0.0, 2.0, 3.5, 6.0, 8.0], rel=1e-14)
    assert np.sort(nodes[nodes[:, 1] == 8.0, 0]) == close([0.0, 2.0, 4.0, 6.0, 8.0], rel=1e-14)


def test_one_particle_in_a_square_has_twelve_triangles():
    mesh = triangulate(Box(2.0, 2.0), Particles([[1.0, 1.2]], 0.1))
    assert len(mesh.triangles) == 12
    assert np.isnan(mesh.gap_of_particle).all()


def test_of_two_particles_at_one_corner_only_one_takes_it():
    particles = Particles([[-0.49, 0.24], [0.24, -0.48], [5.0, 5.0]], 1.0)
    mesh = triangulate(Box(10.0, 10.0), particles)
    # The corner takes the nearer one.
    assert mesh.points[:2].tolist() == [[0.0, 0.24], [0.0, 0.0]]
    assert mesh.areas.sum() == close(100.0, rel=1e-12)


def test_the_numbering_of_particles_does_not_matter():
    for periodic in (False, True):
        box = Box(8.0, 6.0, periodic)
        particles = scattered(box, 25, 6, spread=0.4)
        order = np.random.default_rng(1).permutation(len(particles))
        other = Particles(particles.x[order], particles.diameter[order])
        mesh, new = triangulate(box, particles), triangulate(box, other)
        name = np.concatenate([order, np.arange(len(order), len(new.points))])
        assert rows(np.sort(name[new.triangles], axis=1)) == rows(np.sort(mesh.triangles, axis=1))
        assert new.gap_shortest == close(mesh.gap_shortest, rel=1e-12)
        np.testing.assert_allclose(new.gap_of_particle, mesh.gap_of_particle[order], rtol=1e-12)


def test_a_shift_of_the_periodic_origin_does_not_matter():
    box = Box(8.0, 6.0, periodic=True)
    particles = scattered(box, 25, 6, spread=0.4)
    mesh = triangulate(box, particles)
    moved = triangulate(box, Particles(particles.x + np.array([13.7, -2.9]), particles.diameter))
    assert rows(np.sort(moved.triangles, axis=1)) == rows(np.sort(mesh.triangles, axis=1))
    assert moved.gap_second == close(mesh.gap_second, rel=1e-12)


def test_points_on_one_circle_have_one_consistent_choice():
    angle = 2 * np.pi * np.arange(12) / 12
    ring = Particles(5 + 3 * np.stack([np.cos(angle), np.sin(angle)], axis=-1), 0.5)
    for periodic in (False, True):
        mesh = triangulate(Box(10.0, 10.0, periodic), ring)
        assert mesh.areas.sum() == close(100.0, rel=1e-12)


def test_thin_and_overfull_boxes():
    row = Particles(np.stack([np.linspace(1, 99, 30), np.full(30, 0.05)], axis=-1), 0.3)
    for box, particles in (
        (Box(100.0, 0.1), row),
        (Box(100.0, 0.1, periodic=True), row.with_diameter(0.09)),
        (Box(1.0, 1.0), Particles([[0.5, 0.5]], 3.0)),
        (Box(1.0, 1.0), Particles([[-0.7, 0.5], [1.7, 0.5]], 2.0)),
    ):
        mesh = triangulate(box, particles)
        assert mesh.areas.sum() == close(box.area, rel=1e-12)


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="share a place"):
        triangulate(Box(4.0, 4.0), Particles([[1.0, 1.0], [3.0, 2.0], [3.0, 2.0]], 1.0))
    with pytest.raises(InputError, match="particle 1 is hidden"):
        triangulate(Box(8.0, 8.0), Particles([[4.0, 4.0], [4.0, 4.2]], [4.0, 0.5]))
    two = triangulate(Box(8.0, 8.0), Particles([[2.0, 4.0], [5.0, 4.2]], 1.0))
    with pytest.raises(InputError, match="no triangle joins three particles"):
        _ = two.gap_shortest
    with pytest.raises(InputError, match="no particle has two neighbours"):
        _ = two.gap_second


def test_results_are_read_only():
    mesh = triangulate(Box(3.0, 3.0), Particles([[1.0, 1.0]], 1.0))
    for name in ("points", "triangles", "edges", "edge_shifts", "gaps", "areas", "neighbours"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(mesh, name)[0] = 0


# Particles anywhere --------------------------------------------------------------------------


@given(**any_case)
@settings(deadline=None)
def test_enclosed_particles_are_all_vertices_of_a_power_triangulation(
    n, seed, aspect, spread, periodic
):
    box, particles = case(n, seed, aspect, spread, periodic)
    mesh, weight = enclose(box, particles)
    k = len(particles)
    np.testing.assert_array_equal(weight[:k], particles.radius**2)
    assert (weight[k:] == 0.0).all()
    assert (mesh.areas > 0.0).all()
    assert set(range(k)) <= set(mesh.triangles.ravel().tolist())
    if periodic:
        assert len(mesh.points) == k
        assert mesh.areas.sum() == close(box.area, rel=1e-12)
        assert len(mesh.triangles) == 2 * k
    else:
        # A rectangle with room on all sides, which the box does not limit.
        low, high = mesh.points[k:].min(axis=0), mesh.points[k:].max(axis=0)
        assert mesh.areas.sum() == close((high - low).prod(), rel=1e-12)
        room = 4.0 * particles.diameter.max()
        assert (mesh.points[:k].min(axis=0) - low >= 0.999 * room).all()
        assert (high - mesh.points[:k].max(axis=0) >= 0.999 * room).all()
        assert mesh.points[:k] == pytest.approx(particles.x, abs=1e-12 * np.abs(high - low).max())
    # No vertex reaches into the power circle of a triangle.
    period = box.size if periodic else np.zeros(2)
    arrays = [np.array(a) for a in (mesh.triangles, mesh.neighbours, mesh.shifts)]
    flips, inverted, ok = repair(np.array(mesh.points), weight, period, *arrays)
    assert (inverted, ok) == (0, True)
    assert flips <= 2  # ties, told apart by a tiny strain


@given(**any_case)
@settings(deadline=None)
def test_enclosed_particles_that_touch_are_joined(n, seed, aspect, spread, periodic):
    box, particles = case(n, seed, aspect, spread, periodic)
    mesh, _ = enclose(box, particles)
    i, j = np.triu_indices(len(particles), 1)
    distance = np.hypot(*box.separation(particles.x[i], particles.x[j]).T)
    touch = distance < particles.radius[i] + particles.radius[j]
    pairs = set(zip(i[touch].tolist(), j[touch].tolist(), strict=True))
    assert pairs <= rows(mesh.edges)


def test_enclosed_particles_may_be_far_outside_the_box():
    box = Box(1.0, 1.0)
    particles = Particles([[50.0, -20.0], [50.3, -20.0], [50.1, -19.8]], 0.1)
    mesh, _ = enclose(box, particles)
    assert {(0, 1), (0, 2), (1, 2)} <= rows(mesh.edges)
    alone, weight = enclose(box, Particles([[3.0, 3.0]], 0.5))
    assert (weight > 0.0).tolist() == [True] + [False] * (len(weight) - 1)
    assert (alone.areas > 0.0).all()


def test_hidden_particles_cannot_be_enclosed():
    with pytest.raises(InputError, match="particle 1 is hidden"):
        enclose(Box(1.0, 1.0), Particles([[0.5, 0.5], [0.5001, 0.5], [0.2, 0.2]], [0.5, 0.1, 0.1]))
