"""Moving triangulations: a repair gives what a fresh power triangulation is, or is not ok."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from grainmesh import arrange
from grainmesh.domain import Box
from grainmesh.flips import insert, remove, repair
from grainmesh.particles import Particles
from grainmesh.triangulation import triangulate

close = partial(pytest.approx, abs=0.0)


class Mesh:
    """What a caller owns: points, weights, period and the three arrays that `repair` changes."""

    def __init__(self, box, particles):
        made = triangulate(box, particles)
        self.box, self.period = box, box.size * box.periodic
        self.points = made.points.copy()
        self.weight = np.full(len(self.points), particles.radius.min() ** 2)
        self.weight[: made.n] = particles.radius**2
        self.arrays = [np.array(a) for a in (made.triangles, made.neighbours, made.shifts)]
        wall = ((self.points == 0.0) | (self.points == box.size)).any(axis=1)
        self.free = np.flatnonzero(box.periodic | ~wall)
        self.weight[np.flatnonzero(wall & (not box.periodic))] = particles.radius.min() ** 2

    def repair(self):
        return repair(self.points, self.weight, self.period, *self.arrays)

    def remove(self, vertices):
        """Take vertices out; the others close up, in order."""
        size, ok = remove(self.points, self.period, *self.arrays, np.asarray(vertices))
        self.arrays = [array[:size] for array in self.arrays]
        if ok:
            keep = np.ones(len(self.points), dtype=bool)
            keep[vertices] = False
            number = np.cumsum(keep) - 1
            self.arrays[0] = number[self.arrays[0]].astype(np.int32)
            self.free = number[self.free[keep[self.free]]]
            self.points, self.weight = self.points[keep], self.weight[keep]
        return ok

    def insert(self, x, weight):
        """Put points in; how many went."""
        first, size = len(self.points), len(self.arrays[0])
        self.points, self.weight = np.vstack([self.points, x]), np.append(self.weight, weight)
        new = np.arange(first, len(self.points))
        self.free = np.append(self.free, new)
        self.arrays = [
            np.concatenate([a, np.full((2 * len(x), *a.shape[1:]), -9, np.int32)])
            for a in self.arrays
        ]
        size, put = insert(self.points, self.weight, self.period, *self.arrays, size, new)
        self.arrays = [a[:size] for a in self.arrays]
        return put

    def move(self, step):
        """Displace the free points, inside the walls if there are any."""
        self.points[self.free] += step
        if not self.box.periodic:
            low = 0.05 * np.sqrt(self.weight.min())
            self.points[self.free] = self.points[self.free].clip(low, self.box.size - low)

    @property
    def edges(self):
        """All edges as (i, j, image of j seen from i), each once."""
        triangles, _, shifts = self.arrays
        i, j = np.roll(triangles, -1, 1).ravel(), np.roll(triangles, -2, 1).ravel()
        s = (np.roll(shifts, -2, 1) - np.roll(shifts, -1, 1)).reshape(-1, 2)
        return canonical(i, j, s)

    @property
    def areas(self):
        triangles, _, shifts = self.arrays
        a, b, c = np.moveaxis(self.points[triangles] + shifts * self.period, 1, 0)
        (x, y), (z, w) = (b - a).T, (c - a).T
        return 0.5 * (x * w - y * z)


def canonical(i, j, s):
    turn = (i > j) | ((i == j) & ((s[:, 0] < 0) | ((s[:, 0] == 0) & (s[:, 1] < 0))))
    s = np.where(turn[:, None], -s, s)
    rows = np.column_stack([np.where(turn, j, i), np.where(turn, i, j), s])
    return set(map(tuple, rows.tolist()))


def lifted_hull(mesh, reach=1):
    """Edges of the power triangulation: the lower hull of (x, y, x² + y² - w) and its images."""
    m, period = len(mesh.points), mesh.period
    wraps = np.zeros((m, 2), dtype=int)
    steps = np.zeros((1, 2), dtype=int)
    if mesh.box.periodic:
        wraps = np.floor(mesh.points / period).astype(int)
        steps = np.stack(np.meshgrid(*2 * [np.arange(-reach, reach + 1)]), -1).reshape(-1, 2)
    home = mesh.points - wraps * period
    x = (home + (steps * period)[:, None]).reshape(-1, 2) - 0.5 * mesh.box.size
    lifted = (x**2).sum(axis=1) - np.tile(mesh.weight, len(steps))
    hull = ConvexHull(np.column_stack([x, lifted]))
    below = hull.simplices[hull.equations[:, 2] < -1e-9]
    i, j = below[:, [0, 1, 2]].ravel(), below[:, [1, 2, 0]].ravel()
    i, j = np.concatenate([i, j]), np.concatenate([j, i])
    here = (steps[i // m] == 0).all(axis=1)
    i, j = i[here], j[here]
    s = steps[j // m] - steps[i // m] - wraps[j % m] + wraps[i % m]
    return canonical(i % m, j % m, s)


def fits_together(mesh):
    """Neighbours lead back, across an edge of the same two ends."""
    triangles, neighbours, shifts = mesh.arrays
    half = {}
    for t in range(len(triangles)):
        for k in range(3):
            b, c = (k + 1) % 3, (k + 2) % 3
            hop = tuple((shifts[t, c] - shifts[t, b]).tolist())
            half.setdefault((triangles[t, b], triangles[t, c], *hop), []).append(
                (t, int(neighbours[t, k]))
            )
    for (b, c, p, q), sides in half.items():
        across = sorted((u, t) for t, u in half.get((c, b, -p, -q), []))
        inner = sorted(side for side in sides if side[1] >= 0)
        assert inner == sorted((t, u) for t, u in across if t >= 0)


def is_valid(mesh):
    is_whole(mesh)
    assert mesh.repair() == (0, 0, True)


def is_whole(mesh):
    """Some triangulation of all points: it covers the box once, and its arrays fit together."""
    m, t, e = len(mesh.points), len(mesh.arrays[0]), len(mesh.edges)
    assert mesh.areas.min() > 0.0
    assert mesh.areas.sum() == close(mesh.box.area, rel=1e-12)
    assert m - e + t == (0 if mesh.box.periodic else 1)
    assert (np.unique(mesh.arrays[0]) == np.arange(m)).all()
    fits_together(mesh)


def scattered(box, n, seed, ratio=1.0):
    """Up to n discs apart, of diameters 1 to `ratio`, the largest first."""
    rng = np.random.default_rng(seed)
    x, d = np.empty((0, 2)), np.empty(0)
    sizes = np.sort(ratio ** rng.uniform(0, 1, n))[::-1]
    for size in sizes:
        for _ in range(60):
            y = rng.uniform(0, box.size)
            if (np.hypot(*box.separation(x, y).T) > 0.5 * (d + size)).all():
                x, d = np.vstack([x, y]), np.append(d, size)
                break
    return Particles(x, d)


def a_case(n, seed, periodic, ratio):
    side = np.sqrt(n * (1.5 if ratio == 1.0 else 0.3 * ratio**2))
    box = Box(1.3 * side, side, periodic)
    return Mesh(box, scattered(box, n, seed, ratio))


kinds = [(p, r) for p in (False, True) for r in (1.0, 10.0)]


@pytest.mark.parametrize(("periodic", "ratio"), kinds)
@pytest.mark.parametrize("seed", range(5))
def test_small_random_steps_are_repaired_to_the_power_triangulation(seed, periodic, ratio):
    mesh = a_case(60, seed, periodic, ratio)
    rng = np.random.default_rng(seed)
    assert mesh.repair() == (0, 0, True)
    total = 0
    for _ in range(10):
        mesh.move(0.04 * rng.normal(size=(len(mesh.free), 2)))
        flips, _, ok = mesh.repair()
        assert ok
        assert mesh.edges == lifted_hull(mesh)
        is_valid(mesh)
        total += flips
    assert total > 0


@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(12, 50),
    seed=st.integers(0, 10**6),
    kind=st.sampled_from(kinds),
    step=st.sampled_from([0.1, 0.4, 1.5]),
)
def test_large_steps_are_repaired_exactly_or_not_ok(n, seed, kind, step):
    mesh = a_case(n, seed, *kind)
    rng = np.random.default_rng(seed)
    for _ in range(3):
        mesh.move(step * rng.normal(size=(len(mesh.free), 2)))
        turned = int((mesh.areas <= 0.0).sum())
        _, inverted, ok = mesh.repair()
        assert inverted == turned
        fits_together(mesh)
        if not ok:
            return
        assert mesh.edges == lifted_hull(mesh, reach=2)
        is_valid(mesh)


@pytest.mark.parametrize("ratio", [1.0, 10.0])
def test_shear_carries_points_over_the_edge_many_times(ratio):
    mesh = a_case(60, 3, True, ratio)
    width, height = mesh.box.size
    for step in range(150):
        y = mesh.points[:, 1]
        along = 0.1 * np.sin(2 * np.pi * y / height) + 0.02 * width
        mesh.points += np.stack([along, np.full_like(along, 0.03)], axis=1)
        assert mesh.repair()[2]
        if step % 25 == 24:
            assert mesh.edges == lifted_hull(mesh)
            is_valid(mesh)
    assert (mesh.points[:, 0] > 2 * width).any()
    # From the places in the box, a fresh triangulation finds the same gaps.
    fresh = triangulate(mesh.box, Particles(mesh.points, 2 * np.sqrt(mesh.weight)))
    i, j, *s = np.array(sorted(mesh.edges)).T
    away = mesh.points[j] + np.stack(s, axis=1) * mesh.period - mesh.points[i]
    assert np.sort(np.hypot(*away.T)) == close(np.sort(fresh.edge_lengths), rel=1e-12)


@pytest.mark.parametrize(("periodic", "ratio"), kinds)
def test_there_and_back(periodic, ratio):
    mesh = a_case(60, 8, periodic, ratio)
    before, start = mesh.edges, mesh.points.copy()
    rng = np.random.default_rng(0)
    way = [0.04 * rng.normal(size=(len(mesh.free), 2)) for _ in range(8)]
    for step in way:
        mesh.points[mesh.free] += step
        assert mesh.repair()[2]
    assert mesh.edges != before
    for step in way[::-1]:
        mesh.points[mesh.free] -= step
        assert mesh.repair()[2]
    assert mesh.points == pytest.approx(start, abs=1e-13)
    assert mesh.edges == before


@pytest.mark.parametrize(("periodic", "ratio"), kinds)
def test_numbers_and_images_do_not_matter(periodic, ratio):
    mesh, other = a_case(50, 4, periodic, ratio), a_case(50, 4, periodic, ratio)
    rng = np.random.default_rng(1)
    m, t = len(mesh.points), len(mesh.arrays[0])
    name, rank = rng.permutation(m), rng.permutation(t)  # new number of a vertex, of a triangle
    hops = rng.integers(-3, 4, (m, 2)) * periodic  # each vertex is told at some other image
    triangles, neighbours, shifts = other.arrays
    moved = shifts - hops[triangles] + rng.integers(-3, 4, (t, 1, 2)) * periodic
    turn = rng.integers(3, size=t)[:, None] + np.arange(3)
    order = np.argsort(rank)
    triangles, moved = name[triangles][order], moved[order]
    neighbours = np.where(neighbours < 0, -1, rank[neighbours])[order]
    corner = turn % 3
    other.arrays = [
        np.take_along_axis(triangles, corner, 1).astype(np.int32),
        np.take_along_axis(neighbours, corner, 1).astype(np.int32),
        np.take_along_axis(moved, corner[:, :, None], 1).astype(np.int32),
    ]
    mesh.move((0.1 if ratio == 1.0 else 0.3) * rng.normal(size=(len(mesh.free), 2)))
    other.points[name] = mesh.points + hops * mesh.period
    other.weight[name] = mesh.weight
    flips, inverted, ok = mesh.repair()
    assert flips > 0
    assert ok
    found = other.repair()
    assert found[1:] == (inverted, ok)
    i, j, *s = np.array(sorted(mesh.edges)).T
    assert other.edges == canonical(name[i], name[j], np.stack(s, 1) + hops[i] - hops[j])


def test_equal_input_gives_equal_output():
    one, two = a_case(80, 5, True, 1.0), a_case(80, 5, True, 1.0)
    for mesh in (one, two):
        mesh.move(0.3 * np.random.default_rng(2).normal(size=(len(mesh.free), 2)))
    assert one.repair() == two.repair()
    for a, b in zip(one.arrays, two.arrays, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("make", [arrange.square, arrange.hexagonal])
@pytest.mark.parametrize("diameter", [1.0, 1e-4])
def test_ties_of_a_lattice_are_left_alone(make, periodic, diameter):
    box, particles = make(8, 6, porosity=0.6, diameter=diameter, periodic=periodic)
    mesh = Mesh(box, particles)
    assert mesh.repair()[1:] == (0, True)
    is_valid(mesh)
    for angle in 0.1, 0.7:  # turned as a whole: now round-off decides, and stays with it
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        if not periodic:
            mesh.points = mesh.points @ turn.T
            assert mesh.repair()[1] == 0
            assert mesh.repair()[0] == 0


def test_an_exact_square_lattice_needs_no_flip_whatever_the_images():
    # Pitch 1/8 m: coordinates, period and their sums are exact, so all squares are ties.
    x = 0.125 * (np.stack(np.meshgrid(*2 * [np.arange(8)]), axis=-1).reshape(-1, 2) + 0.5)
    mesh = Mesh(Box(1.0, 1.0, periodic=True), Particles(x, 0.1))
    before = mesh.edges
    hops = np.random.default_rng(0).integers(-4, 5, x.shape)
    mesh.points += hops
    mesh.arrays[2] -= hops[mesh.arrays[0]].astype(np.int32)
    assert mesh.repair() == (0, 0, True)
    i, j, *s = np.array(sorted(before)).T
    assert mesh.edges == canonical(i, j, np.stack(s, axis=1) + hops[i] - hops[j])


def test_ties_around_a_flip_are_left_alone():
    # 65² = 16² + 63² = 33² + 56² = ...: on one circle exactly, so any inner edge is right.
    quarter = [(65, 0), (63, 16), (60, 25), (56, 33), (52, 39), (39, 52), (33, 56), (25, 60)]
    ring = np.array([(x, y) for x, y in quarter] + [(-y, x) for x, y in quarter])
    ring = np.concatenate([ring, -ring]) + 100.0
    mesh = Mesh(Box(200.0, 200.0), Particles(ring, 5.0))
    assert mesh.repair()[2]
    for way in (1, -1):
        mesh.points[4] += way * np.array([8.0, 6.0])
        flips, _, ok = mesh.repair()
        assert ok
        assert flips < len(ring)
    np.testing.assert_array_equal(mesh.points[: len(ring)], ring)
    is_valid(mesh)


def test_a_shear_of_a_lattice_by_one_pitch_gives_the_lattice_back():
    mesh = Mesh(Box(8.0, 8.0, periodic=True), square(8))
    row = mesh.points[:, 1] > 4.0
    flips = 0
    for _ in range(50):  # the upper half slides along the lower one, by 1 pitch
        mesh.points[row, 0] += 0.02
        made, inverted, ok = mesh.repair()
        assert (inverted, ok) == (0, True)
        flips += made
    # Along each of the two rows of squares every diagonal is flipped once in a pitch; the exact
    # squares at its end are ties.
    assert 8 <= flips <= 3 * 16
    i, j, *s = np.array(sorted(mesh.edges)).T
    away = mesh.points[j] + np.stack(s, 1) * mesh.period - mesh.points[i]
    lengths = np.sort(np.hypot(*away.T))
    assert lengths[:128] == close(1.0, rel=1e-9)
    assert lengths[128:] == close(np.sqrt(2.0), rel=1e-9)


def square(k):
    return Particles(np.stack(np.meshgrid(*2 * [np.arange(k) + 0.5]), -1).reshape(-1, 2), 0.7)


@pytest.mark.parametrize("periodic", [False, True])
def test_a_vertex_that_jumps_over_an_edge_is_brought_in_order(periodic):
    jumps = mended = 0
    for seed in range(80):
        mesh = a_case(30, seed, periodic, 1.0)
        triangles, neighbours, shifts = mesh.arrays
        t = np.random.default_rng(seed).integers(len(triangles))
        vertex, u = triangles[t, 0], neighbours[t, 0]
        if vertex not in mesh.free or u < 0:
            continue
        # Into the triangle bcd beyond the edge bc.
        a, b, c = mesh.points[triangles[t]] + shifts[t] * mesh.period
        beyond = (neighbours[u] == t).argmax()
        hop = shifts[t, 2] - shifts[u, (beyond + 1) % 3]
        d = mesh.points[triangles[u, beyond]] + (shifts[u, beyond] + hop) * mesh.period
        mesh.points[vertex] += 0.4 * b + 0.4 * c + 0.2 * d - a
        _, inverted, ok = mesh.repair()
        assert inverted > 0
        assert ok == bool((mesh.areas > 0.0).all())
        fits_together(mesh)
        jumps, mended = jumps + 1, mended + ok
        if ok:
            assert mesh.edges == lifted_hull(mesh)
            is_valid(mesh)
    assert jumps > 40
    assert mended >= 0.95 * jumps  # a jump of a whole distance is more than is asked for


def test_what_flips_cannot_mend_is_not_ok():
    # A weight so large that it hides its neighbours: they would have to vanish.
    mesh = a_case(40, 1, True, 1.0)
    mesh.weight[7] = 25.0
    assert len(np.unique([edge[:2] for edge in lifted_hull(mesh)])) < len(mesh.points)
    assert not mesh.repair()[2]
    fits_together(mesh)
    # A vertex outside the walls; two vertices at one place; a place that is no number.
    for target in ([-0.5, 3.0], None, [np.nan, 1.0], [np.inf, 1.0]):
        mesh = a_case(40, 1, False, 1.0)
        i, j = mesh.free[:2]
        mesh.points[i] = mesh.points[j] if target is None else target
        _, inverted, ok = mesh.repair()
        assert inverted > 0
        assert not ok
        fits_together(mesh)
    # One triangle alone, turned over: no edge could be flipped.
    points, weight, period = (
        np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]),
        np.zeros(3),
        np.zeros(2),
    )
    alone = np.arange(3, dtype=np.int32)[None], np.full((1, 3), -1, np.int32)
    shifts = np.zeros((1, 3, 2), np.int32)
    assert repair(points, weight, period, *alone, shifts) == (0, 0, True)
    assert repair(points[::-1].copy(), weight, period, *alone, shifts) == (0, 1, False)
    # All points at random elsewhere: as good as hopeless, but it ends.
    mesh = a_case(200, 1, True, 1.0)
    mesh.points = np.random.default_rng(0).uniform(0, 1, mesh.points.shape) * mesh.box.size
    assert not mesh.repair()[2]
    fits_together(mesh)


@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(1, 4),
    seed=st.integers(0, 10**6),
    step=st.sampled_from([0.02, 0.1, 0.4]),
    aspect=st.sampled_from([1.0, 2.3]),
)
def test_the_smallest_periodic_boxes(n, seed, step, aspect):
    box = Box(aspect, 1.0, periodic=True)
    rng = np.random.default_rng(seed)
    mesh = Mesh(box, Particles(rng.uniform(0, 1, (n, 2)) * box.size, 0.01))
    for _ in range(20):
        mesh.move(step * rng.normal(size=(n, 2)))
        _, _, ok = mesh.repair()
        fits_together(mesh)
        if not ok:
            mesh = Mesh(box, Particles(np.mod(mesh.points, box.size), 0.01))
            continue
        is_valid(mesh)
        if n > 1 or aspect > 2:  # the images of one particle in a square are ties
            missing = lifted_hull(mesh, reach=4) ^ mesh.edges
            assert not missing or n == 1  # a lattice of rectangles: ties of the diagonals


def swirl(x, box):
    """Velocity of a swirl with walls at rest, 0 <= |v| <= 1; its vortices touch every corner."""
    a, b = np.pi * x[:, 0] / box.width, np.pi * x[:, 1] / box.height
    return np.stack([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b)], axis=1)


def test_a_swirl_of_many_steps():
    box, particles = arrange.random(300, porosity=0.6, diameter=1.0, min_gap=0.05, seed=1)
    mesh = Mesh(Box(box.width, box.height), particles)
    mesh.move(0.0)
    flips = 0
    for _ in range(200):
        mesh.move(0.05 * swirl(mesh.points[mesh.free], mesh.box))
        made, _, ok = mesh.repair()
        assert ok
        flips += made
    assert mesh.edges == lifted_hull(mesh)
    is_valid(mesh)
    assert flips > len(mesh.points)


@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(12, 50),
    seed=st.integers(0, 10**6),
    kind=st.sampled_from(kinds),
    share=st.sampled_from([0.0, 0.1, 0.5]),
)
def test_vertices_leave_until_few_are_left(n, seed, kind, share):
    mesh, rng = a_case(n, seed, *kind), np.random.default_rng(seed)
    enough = 7 if mesh.box.periodic else 0
    while len(mesh.free) > enough:
        out = mesh.free[rng.random(len(mesh.free)) < share]
        if len(out) == 0:
            out = rng.choice(mesh.free, 1)
        weight, points = np.delete(mesh.weight, out), np.delete(mesh.points, out, axis=0)
        if not mesh.remove(out):
            assert mesh.box.periodic  # one met itself, which takes a box as small as a star
            assert len(mesh.free) - len(out) < 20
            fits_together(mesh)
            return
        np.testing.assert_array_equal(mesh.points, points)
        np.testing.assert_array_equal(mesh.weight, weight)
        is_whole(mesh)
        if len(mesh.free) > enough:
            assert mesh.repair()[2]
            assert mesh.edges == lifted_hull(mesh, reach=2)


@pytest.mark.parametrize("periodic", [False, True])
def test_neighbours_leave_together_and_in_any_order(periodic):
    for seed in range(10):
        rng = np.random.default_rng(seed)
        meshes = [a_case(60, seed, periodic, 1.0) for _ in range(2)]
        middle = meshes[0].box.size / 2
        away = np.hypot(*meshes[0].box.separation(meshes[0].points, middle).T)
        out = np.argsort(away)[:12]  # a hole opens
        for mesh, order in zip(meshes, (out, rng.permutation(out)), strict=True):
            assert mesh.remove(order)
            is_whole(mesh)
            assert mesh.repair()[2]
        assert meshes[0].edges == meshes[1].edges == lifted_hull(meshes[0])


@pytest.mark.parametrize("periodic", [False, True])
def test_a_vertex_on_a_diagonal_of_its_ring_leaves_no_flat_triangle(periodic):
    # Every other point of a square lattice, exactly: most lie where the diagonals cross.
    mesh = Mesh(Box(8.0, 8.0, periodic), square(8))
    i, j = np.divmod(np.arange(64), 8)
    out = np.flatnonzero((i + j) % 2)
    assert mesh.remove(out)
    is_whole(mesh)
    assert mesh.repair()[2]
    is_valid(mesh)


def test_what_cannot_leave_is_not_ok():
    mesh = a_case(40, 1, False, 1.0)
    t, k = np.argwhere(mesh.arrays[1] < 0)[0]
    assert not mesh.remove([mesh.arrays[0][t, (k + 1) % 3]])  # on the boundary
    is_whole(mesh)
    box = Box(1.0, 1.0, periodic=True)
    mesh = Mesh(box, Particles([[0.3, 0.4]], 0.01))
    assert not mesh.remove([0])  # the last one, surrounded by itself
    is_valid(mesh)
    triangles = len(mesh.arrays[0])
    assert mesh.remove(np.empty(0, int))
    assert len(mesh.arrays[0]) == triangles


@settings(max_examples=60, deadline=None)
@given(n=st.integers(2, 6), seed=st.integers(0, 10**6), aspect=st.sampled_from([1.0, 2.3]))
def test_vertices_leave_the_smallest_periodic_boxes(n, seed, aspect):
    box = Box(aspect, 1.0, periodic=True)
    x = np.random.default_rng(seed).uniform(0, 1, (n, 2)) * box.size
    mesh = Mesh(box, Particles(x, 0.01))
    while len(mesh.points) > 1:
        v = mesh.arrays[0] == 0
        meets = (v.sum(axis=1) > 1).any()
        assert mesh.remove([0]) == (not meets)
        is_whole(mesh)
        if meets:
            return
        assert mesh.repair()[2]


@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(12, 40),
    more=st.integers(1, 40),
    seed=st.integers(0, 10**6),
    kind=st.sampled_from(kinds),
)
def test_vertices_enter_the_power_triangulation(n, more, seed, kind):
    mesh, rng = a_case(n, seed, *kind), np.random.default_rng(seed)
    x = rng.uniform(0.01, 0.99, (20 * more, 2)) * mesh.box.size
    away = np.stack([np.hypot(*mesh.box.separation(x, y).T) for y in mesh.points], axis=1)
    x = x[(away > np.sqrt(mesh.weight)).all(axis=1)][:more]  # outside all discs: none is hidden
    hops = rng.integers(-3, 4, x.shape) * kind[0]
    assert mesh.insert(x + hops * mesh.period, np.zeros(len(x))) == len(x)
    is_valid(mesh)  # without a flip more
    assert mesh.edges == lifted_hull(mesh, reach=2)


@pytest.mark.parametrize("periodic", [False, True])
def test_vertices_come_and_go_while_all_move(periodic):
    mesh, rng = a_case(60, 1, periodic, 1.0), np.random.default_rng(1)
    mesh.weight[:] = 0.0
    came = 0
    for turn in range(300):
        before, step = mesh.points.copy(), 0.05 * rng.normal(size=(len(mesh.free), 2))
        mesh.move(step)
        while (mesh.areas <= 0.0).any():
            mesh.points[:], step = before, 0.5 * step
            mesh.move(step)
        if len(mesh.free) > 40:
            assert mesh.remove(rng.choice(mesh.free, rng.integers(4), replace=False))
        x = rng.uniform(0.1, 0.9, (rng.integers(4), 2)) * mesh.box.size
        came += mesh.insert(x, np.zeros(len(x)))
        is_whole(mesh)
        assert mesh.repair()[2]
        if turn % 20 == 0:
            assert mesh.edges == lifted_hull(mesh, reach=2)
    assert came > 300


def test_what_left_comes_back_to_the_same_triangles():
    for periodic in (False, True):
        mesh = a_case(50, 2, periodic, 1.0)
        x, before, n = mesh.points.copy(), len(mesh.edges), len(mesh.points)
        out = mesh.free[-5:]
        points, weight = mesh.points[out], mesh.weight[out]
        assert mesh.remove(out)
        assert mesh.insert(points, weight) == 5
        assert len(mesh.points) == n
        is_valid(mesh)
        assert len(mesh.edges) == before
        assert mesh.edges == lifted_hull(mesh)
        assert set(map(tuple, mesh.points)) == set(map(tuple, x))


@pytest.mark.parametrize("periodic", [False, True])
def test_vertices_on_edges_split_them(periodic):
    # Pitch 1: sites, centres of squares and middles of sides are exact.
    mesh = Mesh(Box(8.0, 8.0, periodic), square(8))
    size = len(mesh.arrays[0])
    i, j = (a.ravel() for a in np.meshgrid(np.arange(8), np.arange(7)))
    middles = np.column_stack([i + 0.5, j + 1.0])
    assert mesh.insert(middles, np.full(56, mesh.weight[0])) == 56
    assert len(mesh.arrays[0]) == size + 112
    is_whole(mesh)
    assert mesh.repair()[2]
    is_valid(mesh)


def test_vertices_on_the_boundary_split_it():
    mesh = a_case(40, 1, False, 1.0)
    size, width, height = len(mesh.arrays[0]), *mesh.box.size
    s = np.array([0.123, 0.456, 0.789])
    sides = [
        np.column_stack(place)
        for place in (
            (s * width, 0.0 * s), (s * width, 0.0 * s + height),
            (0.0 * s, s * height), (0.0 * s + width, s * height),
        )
    ]  # fmt: skip
    x = np.vstack(sides)
    assert mesh.insert(x, np.full(12, mesh.weight.min())) == 12
    assert len(mesh.arrays[0]) == size + 12  # one each
    is_valid(mesh)
    assert mesh.edges == lifted_hull(mesh)


@pytest.mark.parametrize("periodic", [False, True])
def test_what_has_no_place_does_not_enter(periodic):
    mesh = a_case(40, 1, periodic, 1.0)
    inside, size = [0.4217, 0.3123] * mesh.box.size, len(mesh.arrays[0])
    taken = [mesh.points[3]] if periodic else [mesh.points[3], [-0.1, 1.0], [1.0, 1e9]]
    for bad in taken:
        mesh = a_case(40, 1, periodic, 1.0)
        assert mesh.insert(np.array([inside, bad, inside * 1.1]), np.zeros(3)) == 1
        assert len(mesh.arrays[0]) == size + 2
        fits_together(mesh)
        assert mesh.repair()[2]


@settings(max_examples=60, deadline=None)
@given(n=st.integers(2, 8), seed=st.integers(0, 10**6), aspect=st.sampled_from([1.0, 2.3, 11.0]))
def test_vertices_enter_the_smallest_periodic_boxes(n, seed, aspect):
    box = Box(aspect, 1.0, periodic=True)
    x = np.random.default_rng(seed).uniform(0, 1, (n, 2)) * box.size
    mesh = Mesh(box, Particles(x[:1], 0.01))
    for y in x[1:]:
        assert mesh.insert(y[None], mesh.weight[:1]) == 1
        is_whole(mesh)
        assert mesh.repair()[2]
    assert mesh.edges == lifted_hull(mesh, reach=12 if aspect > 10 else 4)
