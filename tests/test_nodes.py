"""The mesh of the flow: whatever particles do, the power triangulation of them and their nodes."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from grainmesh import arrange
from grainmesh.clearance import GROWTH, NEAR, ROOM, openings
from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.flips import repair
from grainmesh.nodes import Bounded, bounded

close = partial(pytest.approx, abs=0.0)


def areas(mesh):
    a, b, c = np.moveaxis(mesh.points[mesh.triangles] + mesh.shifts * mesh.period, 1, 0)
    (x, y), (z, w) = (b - a).T, (c - a).T
    return 0.5 * (x * w - y * z)


def edges(mesh):
    """Edges both ways, with the image of the second end from the first."""
    t, s = mesh.triangles, mesh.shifts
    i, j = np.roll(t, -1, 1).ravel(), np.roll(t, -2, 1).ravel()
    hop = (np.roll(s, -2, 1) - np.roll(s, -1, 1)).reshape(-1, 2)
    rows = np.vstack([np.column_stack([i, j, hop]), np.column_stack([j, i, -hop])])
    return set(map(tuple, rows.tolist()))


def lifted_hull(mesh):
    """The same of the power triangulation: the lower hull of (x, y, x² + y² - w) and its images."""
    used, period = np.flatnonzero(mesh.in_use), mesh.period
    m, wraps, steps = len(used), np.zeros((len(used), 2), int), np.zeros((1, 2), int)
    if mesh.box.periodic:
        wraps = np.floor(mesh.points[used] / period).astype(int)
        steps = np.stack(np.meshgrid(*2 * [np.arange(-1, 2)]), -1).reshape(-1, 2)
    home = mesh.points[used] - wraps * period
    x = (home + (steps * period)[:, None]).reshape(-1, 2) - 0.5 * mesh.box.size
    lifted = (x**2).sum(axis=1) - np.tile(mesh.weight[used], len(steps))
    hull = ConvexHull(np.column_stack([x, lifted]))
    below = hull.simplices[hull.equations[:, 2] < -1e-9]
    i, j = below[:, [0, 1, 2]].ravel(), below[:, [1, 2, 0]].ravel()
    i, j = np.concatenate([i, j]), np.concatenate([j, i])
    here = (steps[i // m] == 0).all(axis=1)
    i, j = i[here], j[here]
    s = steps[j // m] - steps[i // m] - wraps[j % m] + wraps[i % m]
    return set(map(tuple, np.column_stack([used[i % m], used[j % m], s]).tolist()))


def of_particles(edges, n):
    """Those that end at a particle: among nodes, four may lie on one circle."""
    return {edge for edge in edges if min(edge[:2]) < n}


def clearances(mesh):
    """Distance of each node inside from the nearest disc [m]."""
    n, radius, nodes = mesh.n, np.sqrt(mesh.weight[: mesh.n]), inside(mesh)
    away = mesh.box.separation(mesh.points[:n], mesh.points[nodes][:, None])
    return (np.hypot(away[..., 0], away[..., 1]) - radius).min(axis=1)


def rooms(mesh):
    """Room of each node inside beside discs, walls and other nodes [m]."""
    nodes, used = inside(mesh), np.flatnonzero(mesh.in_use)
    p = mesh.points[nodes]
    away = (mesh.box.separation(mesh.points[used], p[:, None]) ** 2).sum(axis=2)
    away -= mesh.weight[used]
    away[np.arange(len(nodes)), np.searchsorted(used, nodes)] = np.inf
    found = np.sqrt(away.min(axis=1))
    if not mesh.box.periodic:
        found = np.minimum(found, 2.0 * np.minimum(p, mesh.box.size - p).min(axis=1))
    return found


def inside(mesh):
    """Numbers of the nodes inside that are in use."""
    return mesh.first + np.flatnonzero(mesh.in_use[mesh.first :])


def room(mesh):
    """Places where another node has room."""
    return openings(*mesh._about, *mesh.spacing, mesh._sizes())[0]


def is_mended(mesh):
    """Exactly a power triangulation of what is in use, which fills the box and has room."""
    assert (areas(mesh) > 0.0).all()
    assert areas(mesh).sum() == close(mesh.box.area, rel=1e-12)
    assert (np.unique(mesh.triangles) == np.flatnonzero(mesh.in_use)).all()
    rim = int((mesh.neighbours < 0).sum())
    assert len(mesh.triangles) == 2 * mesh.in_use.sum() - (0 if mesh.box.periodic else rim + 2)
    arrays = mesh.triangles, mesh.neighbours, mesh.shifts
    assert repair(mesh.points, mesh.weight, mesh.period, *arrays) == (0, 0, True)
    if len(inside(mesh)):
        assert rooms(mesh).min() > (NEAR - 1e-9) * mesh.spacing[0]
    if mesh.inside > len(inside(mesh)):
        assert len(room(mesh)) == 0


def discs(n, seed, ratio, periodic, porosity=0.9):
    rng = np.random.default_rng(seed)
    box, p = arrange.random(
        n, porosity=porosity, diameter=ratio ** rng.uniform(0, 1, n), seed=seed, periodic=periodic
    )
    x = p.x.copy()
    if not periodic:
        x = x.clip(0.1 * p.radius[:, None], box.size - 0.1 * p.radius[:, None])
    return box, x, p.radius


def apart(box, x, radius):
    i, j = np.triu_indices(len(x), 1)
    return bool((np.hypot(*box.separation(x[i], x[j]).T) > radius[i] + radius[j]).all())


def walk(box, x, radius, step, rng):
    """A random step of all discs that may: they stay inside and apart."""
    y = x + step * rng.normal(size=x.shape)
    stuck = np.zeros(len(x), bool)
    while True:
        if not box.periodic:
            low = radius[:, None]
            stuck |= ((y < low) | (y > box.size - low)).any(axis=1)
        i, j = np.triu_indices(len(x), 1)
        hit = np.hypot(*box.separation(y[i], y[j]).T) < radius[i] + radius[j]
        bad = stuck.copy()
        bad[i[hit]] = bad[j[hit]] = True
        if (y[bad] == x[bad]).all():
            return y
        stuck |= bad
        y[stuck] = x[stuck]


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("ratio", [1.0, 5.0])
def test_it_is_the_power_triangulation_after_hundreds_of_moves(ratio, periodic):
    box, x, radius = discs(40, 1, ratio, periodic, porosity=0.95)
    mesh, rng = bounded(box, x, radius, 2.5 * radius.mean()), np.random.default_rng(0)
    is_mended(mesh)
    came = left = 0
    for turn in range(400):
        x = walk(box, x, radius, 0.15 * radius.mean(), rng)
        before, old, were = mesh.in_use.copy(), mesh.triangles.copy(), mesh.points.copy()
        mesh.move(x)
        moved = mesh.points.copy()
        changed = mesh.mend()
        came += int((mesh.in_use & ~before).sum())
        left += int((before & ~mesh.in_use).sum())
        # No number leaves one place and comes in at another.
        assert (mesh.points[before] == moved[before]).all()
        assert (mesh.points[40 : mesh.first] == were[40 : mesh.first]).all()  # walls
        assert changed or np.array_equal(mesh.triangles, old)
        is_mended(mesh)
        if turn % 50 == 0:
            assert of_particles(edges(mesh), 40) == of_particles(lifted_hull(mesh), 40)
    assert mesh.made == 0  # by flips alone
    assert min(came, left) > 100
    assert (mesh.points[:40] == x).all()


@settings(max_examples=40, deadline=None)
@given(
    n=st.integers(1, 12),
    seed=st.integers(0, 10**6),
    step=st.sampled_from([0.1, 1.0, 30.0]),
    ratio=st.sampled_from([1.0, 10.0]),
    periodic=st.booleans(),
    spacing=st.sampled_from([None, 0.5, 2.0, 20.0]),
)
def test_it_follows_any_jump(n, seed, step, ratio, periodic, spacing):
    box, x, radius = discs(n, seed, ratio, periodic, porosity=0.8)
    radius = 0.2 * radius  # so that none hides another
    rng = np.random.default_rng(seed)
    mesh = bounded(box, x, radius, spacing)
    is_mended(mesh)
    for _ in range(3):
        y = x + step * rng.normal(size=x.shape)
        if not periodic:
            y = y.clip(0.01 * box.size, 0.99 * box.size)
        if apart(box, y, radius):
            x = y
            mesh.follow(x)
            is_mended(mesh)


@pytest.mark.parametrize("periodic", [False, True])
def test_flips_give_what_making_it_anew_gives(periodic):
    box, x, radius = discs(60, 2, 3.0, periodic)
    mesh, rng = bounded(box, x, radius, 2.0), np.random.default_rng(0)
    for _ in range(100):
        x = walk(box, x, radius, 0.05, rng)
        mesh.follow(x)
    flipped, used = edges(mesh), mesh.in_use.copy()
    mesh.renew(x)
    assert mesh.made > 0
    assert (mesh.in_use == used).all()
    assert of_particles(edges(mesh), 60) == of_particles(flipped, 60)


def test_a_move_changes_no_triangle():
    box, x, radius = discs(40, 3, 1.0, False)
    mesh = bounded(box, x, radius, 2.0)
    before = [a.copy() for a in (mesh.triangles, mesh.neighbours, mesh.shifts, mesh.in_use)]
    far = x.copy()
    far[[0, 1]] = far[[1, 0]]
    for y, fits in ((x + 1e-9, True), (far, False), (x, True), (-x, False)):
        points = mesh.points.copy()
        assert mesh.move(y) is fits
        assert (mesh.points[:40] == y).all()
        mesh.points[:] = points
        after = mesh.triangles, mesh.neighbours, mesh.shifts, mesh.in_use
        assert all(map(np.array_equal, before, after))
    assert mesh.mend() is False
    mesh.move(far)
    mesh.mend()
    is_mended(mesh)


@pytest.mark.parametrize("periodic", [False, True])
def test_nodes_do_not_flicker(periodic):
    # A disc comes near a node and trembles where that leaves.
    box = Box(20.0, 20.0, periodic)
    mesh = bounded(box, np.array([[1.0, 1.0]]), np.array([0.5]), 2.0)
    place, changes = mesh.points[inside(mesh)[len(inside(mesh)) // 2]].copy(), []
    for tremble in (1, -1) * 10:
        x = place + np.array([0.5 + (NEAR + 1e-3 * tremble) * 2.0, 0.0])
        before = mesh.in_use.copy()
        mesh.follow(x[None])
        changes.append(int((before != mesh.in_use).sum()))
        is_mended(mesh)
    assert sum(changes[:3]) > 0
    assert not any(changes[3:])


@pytest.mark.parametrize("periodic", [False, True])
def test_nodes_go_along(periodic):
    box, x, radius = discs(60, 4, 2.0, periodic)
    mesh = bounded(box, x, radius, 2.0)
    way = np.random.default_rng(4).normal(size=x.shape)
    found, nodes = mesh.carried(way), inside(mesh)
    assert (found[:60] == way).all()
    assert (found[60 : mesh.first] == 0.0).all()  # walls
    low, high = (part(way, axis=0) for part in (np.min, np.max))
    assert ((found[nodes] > low) & (found[nodes] < high)).all()
    assert np.ptp(found[nodes], axis=0).min() > 0.0
    np.testing.assert_allclose(mesh.carried(3.0 * way), 3.0 * found, rtol=1e-12)  # linear
    rest = mesh.points.copy()
    assert mesh.move(x)
    assert (mesh.points == rest).all()
    if not periodic:
        return
    triangles = mesh.triangles.copy()
    for turn in range(1, 50):  # seen from a train
        assert mesh.move(x + turn * np.array([0.7, -0.3]))
        assert mesh.mend() is False
        train = turn * np.array([0.7, -0.3])
        used = mesh.in_use
        np.testing.assert_allclose(mesh.points[used], (rest + train)[used], rtol=0.0, atol=1e-9)
    assert (mesh.triangles == triangles).all()


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("spacing", [1.0, (1.0, 3.0), (1.5, np.inf)])
def test_nodes_are_as_far_apart_as_the_size_field_says(periodic, spacing):
    box, x, radius = discs(40, 11, 1.0, periodic, porosity=0.97)
    if not periodic:
        radius = 0.1 * radius
    near, far = np.broadcast_to(spacing, 2)
    mesh = bounded(box, x, radius, (near, min(far, 1e3)))
    rng = np.random.default_rng(0)
    for turn in range(60):
        nodes, h = inside(mesh), mesh._sizes()
        away = clearances(mesh)
        if not periodic:
            p = mesh.points[nodes]
            away = np.minimum(away, np.minimum(p, box.size - p).min(axis=1))
        exact = np.minimum(far, near + GROWTH * away)
        # Along edges it is a little farther than straight on.
        assert (h[nodes] > (1.0 - 1e-12) * exact).all()
        assert (h[nodes] < 1.2 * exact).all()
        among = np.array([e for e in edges(mesh) if min(e[:2]) >= mesh.first and e[0] != e[1]])
        a, b = among[:, 0], among[:, 1]
        length = np.hypot(*(mesh.points[b] + among[:, 2:] * mesh.period - mesh.points[a]).T)
        assert (length > (NEAR if turn else 0.8 * ROOM) * np.minimum(h[a], h[b])).all()
        assert (length < 2.0 * ROOM * 1.5 * np.maximum(h[a], h[b])).all()
        x = walk(box, x, radius, 0.2, rng)
        mesh.move(x)
        mesh.mend()
    assert len(room(mesh)) == 0


def test_angles_stay_wide_however_the_particles_move():
    box, x, radius = discs(40, 12, 1.0, True, porosity=0.97)
    mesh, rng, least = bounded(box, x, radius, 1.2), np.random.default_rng(12), 90.0
    for _ in range(200):
        x = walk(box, x, radius, 0.2, rng)
        mesh.move(x)
        mesh.mend()
        some = (mesh.triangles >= mesh.first).all(axis=1)
        p = mesh.points[mesh.triangles[some]] + mesh.shifts[some] * mesh.period
        side = np.hypot(*np.moveaxis(p - np.roll(p, 1, axis=1), 2, 0))
        sine = 2.0 * areas(mesh)[some] * side.min(axis=1) / side.prod(axis=1)
        least = min(least, np.degrees(np.arcsin(sine.min())))
    assert least > np.degrees(np.arcsin(0.5 * NEAR / ROOM)) - 1e-6


@pytest.mark.parametrize("make", [arrange.square, arrange.hexagonal])
@pytest.mark.parametrize("spacing", [1.0, 1.5, (1.0, 4.0)])
def test_a_periodic_lattice_has_nodes(make, spacing):
    """Whose open places lie at the edges of the box, to round-off on one side or the other."""
    for n, porosity in ((2, 0.8), (3, 0.9), (4, 0.85), (5, 0.95), (6, 0.8)):
        box, lattice = make(n, 2 * (n // 2), porosity=porosity, diameter=1e-3)
        two = tuple(1e-3 * np.broadcast_to(spacing, 2))
        is_mended(bounded(box, lattice.x, lattice.radius, two))


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("n", [1, 40])
def test_numbers_are_enough_and_not_many_more(n, periodic):
    for near, far in ((1.0, 1.0), (1.0, 8.0), (0.3, 30.0)):
        rng = np.random.default_rng(n)
        box, radius = Box(40.0, 40.0, periodic), np.full(n, 0.3)
        x = rng.uniform(1.0, 39.0, (n, 2))
        mesh = bounded(box, x, radius, (near, far))
        for _ in range(20):
            x = walk(box, x, radius, 0.3, rng)
            mesh.move(x)
            mesh.mend()
            assert len(inside(mesh)) < 0.9 * mesh.inside
        if n == 1:
            assert 4.0 * len(inside(mesh)) > mesh.inside


def test_when_numbers_run_out_no_node_comes_in():
    box, x, radius = discs(20, 13, 1.0, False, porosity=0.98)
    mesh = bounded(box, x, radius, 2.0)
    mesh.in_use[mesh.first :] = True
    assert mesh._fill(mesh._free) == 0


@pytest.mark.parametrize("ratio", [1.0, 10.0])
@pytest.mark.parametrize("periodic", [False, True])
def test_discs_that_touch_are_joined(ratio, periodic):
    rng = np.random.default_rng(5)
    for seed in range(4):
        box, x, radius = discs(30, seed, ratio, periodic, porosity=0.95)
        pairs = []
        for i in range(0, 30, 2):  # every other one comes to touch the one before
            for _ in range(50):
                a = rng.uniform(0, 2 * np.pi)
                trial = x.copy()
                far = 0.99 * (radius[i] + radius[i + 1])
                trial[i + 1] = x[i] + far * np.array([np.cos(a), np.sin(a)])
                others = np.delete(np.arange(30), [i, i + 1])
                gap = np.hypot(*box.separation(trial[others], trial[i + 1]).T)
                inside = ((trial[i + 1] > 0.01) & (trial[i + 1] < box.size - 0.01)).all()
                if (inside or periodic) and (gap > radius[others] + radius[i + 1]).all():
                    x, pairs = trial, [*pairs, (i, i + 1)]
                    break
        assert len(pairs) > 5
        mesh = bounded(box, x, radius, radius.mean())  # many nodes around
        is_mended(mesh)
        assert set(pairs) <= {(i, j) for i, j, *_ in edges(mesh)}


def test_discs_that_touch_at_a_wall_are_joined_over_its_nodes():
    box, radius = Box(12.0, 6.0), np.ones(3)
    start = bounded(box, np.array([[2.0, 3.0], [5.0, 3.0], [8.0, 3.0]]), radius, 1.0)
    for node in start.points[start.points[:, 1] == 0.0][1:-1]:
        for height in (1.2, 1.0, 0.99, 0.9):
            x = np.array([[node[0] - 1.0, height], [node[0] + 1.0, height], [6.0, 4.9]])
            if (x[:, 0] > 0.0).all() and (x[:, 0] < 12.0).all():
                start.follow(x)
                is_mended(start)
                assert (0, 1, 0, 0) in edges(start)


@settings(max_examples=60, deadline=None)
@given(
    width=st.floats(1.0, 60.0),
    height=st.floats(1.0, 60.0),
    diameter=st.floats(0.05, 0.9),
    spacing=st.none() | st.floats(0.5, 20.0),
)
def test_walls_have_nodes_and_others_keep_away_from_them(width, height, diameter, spacing):
    box = Box(width, height)
    mesh = bounded(box, np.array([[width / 2, height / 3]]), np.array([diameter / 2]), spacing)
    walls = mesh.points[1 : mesh.first]
    aim = max(2.0 * diameter, np.sqrt(width * height) / 3.0)
    aim = aim if spacing is None else min(aim, spacing)
    for axis in (0, 1):
        for wall in (0.0, box.size[1 - axis]):
            along = np.sort(walls[walls[:, 1 - axis] == wall, axis])
            assert along[[0, -1]] == close([0.0, box.size[axis]])
            assert len(along) >= 4
            assert np.ptp(np.diff(along)) < 1e-12 * box.size[axis]
            assert np.diff(along).max() < 1.51 * aim
            assert len(along) == 4 or np.diff(along).min() > 0.6 * aim
    nodes = mesh.points[inside(mesh)]
    if len(nodes):
        away = np.minimum(nodes, box.size - nodes).min()
        assert away > 0.5 * ROOM * spacing
    if spacing is not None and min(width, height) > 6.0 * spacing:
        count = (len(nodes) + 0.5 * len(walls)) * np.sqrt(0.75) * spacing**2
        assert count == close(box.area, rel=0.35)
    is_mended(mesh)


@pytest.mark.parametrize("periodic", [False, True])
def test_discs_leave_and_get_new_numbers_and_nodes_keep_theirs(periodic):
    box, x, radius = discs(60, 7, 3.0, periodic)
    mesh, rng = bounded(box, x, radius, 2.0), np.random.default_rng(7)
    n = 60
    while n > 3:
        stay = rng.random(n) < 0.8
        stay[0] = True
        mesh.drop(stay)
        x, radius, n = x[stay] + 1e-3, radius[stay], int(stay.sum())
        if not periodic:
            x = x.clip(1e-3, box.size - 1e-3)
        mesh.follow(x)
        is_mended(mesh)
        nodes = mesh.points[n:].copy()
        new = rng.permutation(n).astype(np.int32)
        before, used = edges(mesh), mesh.in_use.copy()
        mesh.renumber(new)
        name = np.append(new, np.arange(n, len(mesh.points)))
        assert edges(mesh) == {(name[i], name[j], a, b) for i, j, a, b in before}
        assert (mesh.in_use == used).all()
        y, r = np.empty_like(x), np.empty_like(radius)
        y[new], r[new] = x, radius
        x, radius = y, r
        assert (mesh.weight == np.append(radius**2, np.zeros(len(nodes)))).all()
        assert (mesh.points == np.vstack([x, nodes])).all()
        assert mesh.mend() is False
        is_mended(mesh)
    assert mesh.made < 5


def test_it_goes_on_from_its_arrays_and_numbers_bit_by_bit():
    box, x, radius = discs(40, 8, 2.0, False)
    mesh, rng = bounded(box, x, radius, 2.0), np.random.default_rng(8)
    for _ in range(20):
        x = walk(box, x, radius, 0.1, rng)
        mesh.follow(x)
    kept = {k: v.copy() if isinstance(v, np.ndarray) else v for k, v in vars(mesh).items()}
    assert all(isinstance(v, np.ndarray | int | Box) for v in kept.values())
    again = Bounded(**kept)
    for _ in range(20):
        x = walk(box, x, radius, 0.1, rng)
        for one in (mesh, again):
            one.move(x)
            one.mend()
        for key, value in vars(mesh).items():
            np.testing.assert_array_equal(value, getattr(again, key))


def test_the_unit_of_length_does_not_matter():
    box, x, radius = discs(40, 9, 2.0, False)
    mesh = bounded(box, x, radius, 2.0)
    for unit in (2.0**-20, 2.0**20):  # exact
        other = bounded(Box(*(unit * box.size)), unit * x, unit * radius, unit * 2.0)
        assert edges(other) == edges(mesh)


def test_what_cannot_be_is_refused():
    box, x, radius = discs(40, 3, 1.0, False)
    for spacing in (0.0, -1.0, np.nan, np.inf, (2.0, 1.0), (0.0, 1.0), (1.0, np.nan)):
        with pytest.raises(InputError, match="spacing"):
            bounded(box, x, radius, spacing)
    for spacing in (1e-300, (1e-200, 1.0), (5e-324, 1e300), 1e-4):
        with pytest.raises(InputError, match=r"a spacing of .* nodes in this box: check the unit"):
            bounded(box, x, radius, spacing)
    assert bounded(box, x, radius, 1e100).inside == 1
    for bad in ([-0.1, 1.0], [0.0, 1.0], [1.0, box.height], [np.nan, 1.0]):
        y = x.copy()
        y[5] = bad
        with pytest.raises(InputError, match=r"particle 5 at .* not inside"):
            bounded(box, y, radius)
        mesh = bounded(box, x, radius)
        assert not mesh.move(y) or bad[0] == 0.0
        with pytest.raises(InputError, match=r"particle 5 at .* not inside"):
            mesh.mend()
    y = x.copy()
    y[5] = y[6]
    with pytest.raises(InputError, match=r"particle [56] has no place"):
        bounded(box, y, radius)
    corner = np.array([[1.0, 0.0], [-0.5, 0.9], [-0.5, -0.9], [0.0, 0.0]])
    for periodic in (False, True):
        with pytest.raises(InputError, match=r"particles \d and \d overlap by .* hidden"):
            bounded(Box(9.0, 8.0, periodic), corner + 4.0, np.array([1.5, 1.5, 1.5, 0.1]))
