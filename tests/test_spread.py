"""Particles spread over vertices: what is conserved, what is exact, what does not matter."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from grainmesh import arrange
from grainmesh.cells import cells
from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.living import Living, living
from grainmesh.nodes import alone, bounded
from grainmesh.particles import Particles
from grainmesh.spread import spread
from grainmesh.triangulation import triangulate

close = partial(pytest.approx, abs=0.0)


def scattered(box, n, rng):
    """Centres on a jittered grid, apart from each other."""
    side = int(np.ceil(np.sqrt(n)))
    pitch = box.size / side
    grid = np.stack(np.meshgrid(*2 * [np.arange(side) + 0.5]), axis=-1).reshape(-1, 2)
    return (rng.permutation(grid)[:n] + rng.uniform(-0.45, 0.45, (n, 2))) * pitch, pitch.min()


def delaunay(box, points):
    """A mesh of all points, where they are, and nodes on the walls if there are any."""
    tiny = np.full(len(points), 1e-3 * min(box.size) / len(points))
    if box.periodic:
        return living(box, points, tiny)
    mesh = triangulate(box, Particles(points, tiny))
    return of(box, mesh.points, mesh.triangles, mesh.neighbours, mesh.shifts)


def of(box, points, *arrays):
    """A mesh of these arrays, that may be written to as those of all that live."""
    points, triangles, neighbours, shifts = map(np.array, (points, *arrays))
    return Living(box, points, np.zeros(len(points)), triangles, neighbours, shifts)


def spread_on(mesh, box, x, radius, reach=np.inf):
    return spread(alone(box, x, radius, reach), reach, mesh)


def corners(mesh):
    return mesh.points[mesh.triangles] + mesh.shifts * mesh.period


def cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def hats(mesh):
    """h_v = ∫ φ_v."""
    a, b, c = np.moveaxis(corners(mesh), 1, 0)
    third = cross(b - a, c - a) / 6.0
    return np.bincount(mesh.triangles.ravel(), np.repeat(third, 3), minlength=len(mesh.points))


def porosity(mesh, found, solid):
    return 1.0 - (found.share.T @ solid) / hats(mesh)


@settings(max_examples=60, deadline=None)
@given(
    n=st.sampled_from([1, 2, 3, 5, 40]),
    nodes=st.sampled_from([0, 1, 30]),
    seed=st.integers(0, 10**6),
    aspect=st.floats(0.3, 3.0),
    scale=st.sampled_from([1e-6, 1.0, 1e3]),
    periodic=st.booleans(),
)
def test_nothing_is_lost_and_cells_fill_the_mesh(n, nodes, seed, aspect, scale, periodic):
    box, rng = Box(scale * aspect, scale, periodic), np.random.default_rng(seed)
    points, pitch = scattered(box, n + nodes, rng)
    if periodic:
        points = points + rng.integers(-3, 4, points.shape) * box.size
    radius = rng.uniform(0.05, 0.3, n) * pitch
    mesh = delaunay(box, points)
    found = spread_on(mesh, box, points[:n], radius)
    assert found.share.shape == (n, len(mesh.points))
    assert found.share.sum(axis=1) == close(np.ones(n), rel=1e-14)
    assert found.share.data.min() > -1e-12
    assert found.area.sum() == close(box.area, rel=1e-10)
    assert found.share.T @ found.area == close(hats(mesh), rel=1e-9)  # Eq. (2)


@pytest.mark.parametrize("periodic", [False, True])
def test_shares_are_integrals_over_the_cells(periodic):
    """Against sums over a fine grid of points, each given to the particle of its cell."""
    box, rng = Box(1.3, 1.0, periodic), np.random.default_rng(3)
    points, pitch = scattered(box, 25, rng)
    n, reach, fine = 9, 0.22, 300
    radius = rng.uniform(0.1, 0.4, n) * pitch
    mesh = delaunay(box, points)
    found = spread_on(mesh, box, points[:n], radius, reach)

    axes = [(np.arange(fine) + 0.5) / fine * s for s in box.size]
    y = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    away = box.separation(points[:n, None], y[None])
    square = (away**2).sum(axis=-1)
    owner = np.argmin(square - radius[:, None] ** 2, axis=0)
    owner[square[owner, np.arange(len(y))] > reach**2] = n  # of nobody
    expected = np.zeros((n + 1, len(mesh.points)))
    hit = np.zeros(len(y), int)
    for t, (a, b, c) in enumerate(corners(mesh)):
        for image in np.ndindex(3, 3) if periodic else [(1, 1)]:
            z = y + (np.array(image) - 1) * box.size
            phi = np.stack([cross(z - b, z - c), cross(z - c, z - a), cross(z - a, z - b)])
            phi *= np.sign(phi.sum(axis=0)) / abs(phi.sum(axis=0))
            inside = (phi >= 0.0).all(axis=0)
            hit += inside
            for k in range(3):
                np.add.at(expected[:, mesh.triangles[t, k]], owner[inside], phi[k, inside])
    assert (hit == 1).mean() > 0.999  # the sum knows where it is
    count = np.bincount(owner, minlength=n + 1)[:n]
    assert (count * box.area / len(y) < 0.9 * np.pi * reach**2).any()  # cells of all kinds
    # The polygon of the circle leaves it by 0.6 % of its area.
    assert found.area == close(count * box.area / len(y), rel=0.01)
    assert found.share.toarray() == pytest.approx(expected[:n] / count[:, None], abs=0.005)


@pytest.mark.parametrize("kind", [arrange.square, arrange.hexagonal])
def test_a_uniform_bed_is_uniform(kind):
    box, p = kind(6, 4, porosity=0.6, diameter=1e-3)
    box = Box(box.width, box.height, periodic=True)
    mesh = living(box, p.x, p.radius)
    # Either diagonal of a square will do, so hats differ; the porosity does not.
    found = spread_on(mesh, box, p.x, p.radius)
    solid = np.pi * p.radius**2
    assert porosity(mesh, found, solid) == close(1.0 - solid.sum() / box.area, rel=1e-12)


def test_particles_that_lie_outside_their_cells():
    """A small disc that a large one covers beyond its centre: the walk starts elsewhere."""
    box, rng = Box(1.0, 1.0), np.random.default_rng(0)
    nodes, _ = scattered(box, 400, rng)
    pair = np.array([[0.5, 0.5], [0.72, 0.53]])
    nodes = nodes[np.hypot(*(nodes - pair[1]).T) > 0.01]
    radius = np.array([0.3, 0.12])
    assert np.hypot(*(pair[1] - pair[0])) ** 2 < radius[0] ** 2 - radius[1] ** 2
    mesh = delaunay(box, np.vstack([pair, nodes]))
    found = spread_on(mesh, box, pair, radius)
    assert found.share.T @ found.area == close(hats(mesh), rel=1e-9)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), reach=st.sampled_from([0.05, 0.1, np.inf]))
def test_place_order_and_handedness_do_not_matter(seed, reach):
    box, rng = Box(1.0, 0.8, periodic=True), np.random.default_rng(seed)
    n = 12
    points, pitch = scattered(box, 30, rng)
    radius = rng.uniform(0.1, 0.4, n) * pitch
    mesh = delaunay(box, points)
    found = spread_on(mesh, box, points[:n], radius, reach)
    share = found.share.toarray()

    moved = points + rng.uniform(-2.0, 2.0, 2)
    away = of(box, moved, mesh.triangles, mesh.neighbours, mesh.shifts)
    away = spread_on(away, box, moved[:n], radius, reach)
    assert away.area == close(found.area, rel=1e-11)
    assert away.share.toarray() == pytest.approx(share, abs=1e-11)

    flip, turn = np.array([-1, 1]), [0, 2, 1]
    mirror = of(
        box, points * flip, mesh.triangles[:, turn], mesh.neighbours[:, turn],
        (mesh.shifts * flip)[:, turn].astype(np.int32),
    )  # fmt: skip
    mirror = spread_on(mirror, box, points[:n] * flip, radius, reach)
    assert mirror.area == close(found.area, rel=1e-11)
    assert mirror.share.toarray() == pytest.approx(share, abs=1e-11)

    order = np.concatenate([rng.permutation(n), n + rng.permutation(len(points) - n)])
    number = np.argsort(order).astype(np.int32)
    mixed = of(box, points[order], number[mesh.triangles], mesh.neighbours, mesh.shifts)
    mixed = spread_on(mixed, box, points[order[:n]], radius[order[:n]], reach)
    assert mixed.area == close(found.area[order[:n]], rel=1e-12)
    assert mixed.share.toarray() == pytest.approx(share[np.ix_(order[:n], order)], abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_vertices_hardly_change_at_a_flip(seed):
    """The hats change, by a third often; the porosity of the vertices does by a few percent."""
    rng = np.random.default_rng(seed)
    box, p = arrange.random(60, porosity=0.5, diameter=rng.uniform(0.8, 1.2, 60), seed=seed)
    solid, way = np.pi * p.radius**2, 0.1 * rng.normal(size=p.x.shape)
    start = living(box, p.x, p.radius)

    def edges(mesh):
        return {tuple(sorted(t)) for t in mesh.triangles.tolist()}

    low, high = 0.0, 1.0
    while high - low > 1e-10:  # until there is one flip between the two
        middle = 0.5 * (low + high)
        same = edges(living(box, p.x + middle * way, p.radius)) == edges(start)
        low, high = (middle, high) if same else (low, middle)
    meshes = [living(box, p.x + t * way, p.radius) for t in (low, high)]
    assert len(edges(meshes[0]) ^ edges(meshes[1])) == 4
    ours = [porosity(m, spread_on(m, box, m.points[:60], p.radius), solid) for m in meshes]
    hat = [1.0 - solid / hats(m) for m in meshes]
    jump = np.abs(ours[1] - ours[0]).max()
    assert jump < 0.04
    assert jump < 0.2 * np.abs(hat[1] - hat[0]).max()


def test_a_lonely_particle_is_spread_over_its_reach():
    box, rng = Box(1.0, 1.0, periodic=True), np.random.default_rng(5)
    points, _ = scattered(box, 900, rng)
    unused = np.vstack([points, rng.uniform(0.0, 1.0, (7, 2))])
    mesh = delaunay(box, points)
    for reach in (0.01, 0.1, 0.3):
        more = of(box, unused, mesh.triangles, mesh.neighbours, mesh.shifts)
        found = spread_on(more, box, points[:1], np.array([0.005]), reach)
        assert found.area == close(np.pi * reach**2, rel=1e-12)
        row = found.share.toarray()[0]
        assert (row[len(points) :] == 0.0).all()
        on = np.flatnonzero(row)
        away = box.separation(points[:1], points[on])
        # The mean of a linear function is its value at the centroid.
        assert row[on] @ away == pytest.approx(0.0, abs=1e-13)
        # The mean of r² over a circle is reach²/2; hats add their own, h²/4 at most.
        assert row[on] @ (away**2).sum(axis=1) == pytest.approx(0.5 * reach**2, rel=0.01, abs=3e-3)


def test_refusals():
    box = Box(1.0, 1.0)
    points = np.array([[0.3, 0.5], [0.7, 0.5], [0.5, 0.2]])
    radius = np.array([0.1, 0.1, 0.1])
    mesh = delaunay(box, points)
    for reach in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match="reach"):
            spread_on(mesh, box, points, radius, reach)
    with pytest.raises(InputError, match="cell of particle 1 is empty"):
        spread_on(mesh, box, points, np.array([0.9, 0.1, 0.1]))
    with pytest.raises(InputError, match="cell of particle 1 is empty"):  # it begins at a distance
        spread_on(mesh, box, points, np.array([0.51, 0.1, 0.1]), 0.05)
    with pytest.raises(InputError, match="does not cover the cell of particle"):
        spread_on(mesh, Box(2.0, 1.0), points, radius)


def test_what_has_not_changed_need_not_be_found_again():
    box, rng = Box(1.0, 1.0), np.random.default_rng(8)
    r = np.full(300, 0.004)
    mesh = bounded(box, rng.uniform(0.02, 0.98, (300, 2)), r)

    def found(*more):
        return spread(alone(box, mesh.points[:300], r, 0.1), 0.1, mesh, *more)

    for _ in range(5):
        while not mesh.move(mesh.points[:300] + rng.uniform(-5e-4, 5e-4, (300, 2))):
            pass
        before, old = found(), {*map(tuple, np.sort(mesh.triangles, axis=1).tolist())}
        mesh.mend()
        differ = old ^ {*map(tuple, np.sort(mesh.triangles, axis=1).tolist())}
        changed = np.zeros(len(mesh.points), dtype=bool)
        changed[np.array(sorted(differ), dtype=int).ravel()] = True
        part, whole = found(before, changed), found()
        assert 0 < changed.sum() < 250
        assert (part.area == whole.area).all()
        assert (part.share != whole.share).nnz == 0


@settings(max_examples=40, deadline=None)
@given(
    n=st.sampled_from([1, 2, 5, 40, 150]),
    seed=st.integers(0, 10**6),
    reach=st.sampled_from([0.07, 0.2, np.inf]),
    way=st.sampled_from([0.02, 0.5, 1.0]),
    periodic=st.booleans(),
)
def test_carried_on_or_made_anew_to_the_bit(n, seed, reach, way, periodic):
    """Unequal discs that go by little or by much, and nodes that come and go."""
    box, rng = Box(1.3, 1.0, periodic), np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(n)))
    pitch = box.size / side
    home = np.stack(np.meshgrid(*2 * [np.arange(side) + 0.5]), axis=-1).reshape(-1, 2)[:n]
    away, radius = np.zeros((n, 2)), rng.uniform(0.05, 0.25, n) * pitch.min()
    carried = alone(box, home * pitch, radius, reach)
    for _ in range(4):
        away += way * (rng.uniform(-0.4, 0.4, (n, 2)) - away)
        x = (home + away) * pitch
        carried.follow(x)
        mesh = delaunay(box, np.vstack([x, rng.uniform(0.01, 0.99, (60, 2)) * box.size]))
        old, new = spread(carried, reach, mesh), spread_on(mesh, box, x, radius, reach)
        for name in vars(old):
            assert (getattr(old, name) == getattr(new, name)).all()
        if reach == np.inf:
            assert old.area == close(cells(box, Particles(x, 2.0 * radius)).area, rel=1e-9)
    assert carried.flips > 0 or n < 40 or way < 0.5
