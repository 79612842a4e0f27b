"""A living triangulation: whatever its particles do, it is the power triangulation of them."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from grainmesh import arrange
from grainmesh.domain import Box
from grainmesh.living import living

close = partial(pytest.approx, abs=0.0)


def areas(mesh):
    a, b, c = np.moveaxis(mesh.points[mesh.triangles] + mesh.shifts * mesh.period, 1, 0)
    (x, y), (z, w) = (b - a).T, (c - a).T
    return 0.5 * (x * w - y * z)


def edges(mesh, n):
    """Edges between the first n vertices, with the image of the second end from the first."""
    t, s = mesh.triangles, mesh.shifts
    i, j = np.roll(t, -1, 1).ravel(), np.roll(t, -2, 1).ravel()
    hop = (np.roll(s, -2, 1) - np.roll(s, -1, 1)).reshape(-1, 2)
    on = (i < n) & (j < n)
    rows = np.column_stack([i, j, hop])[on]
    back = np.column_stack([j, i, -hop])[on]
    return set(map(tuple, np.vstack([rows, back]).tolist()))


def is_living(mesh, x):
    """Positive triangles that cover what they should, and none that flips would change."""
    n = len(x)
    assert mesh.points[:n] == pytest.approx(x, rel=1e-12, abs=1e-12)
    assert (areas(mesh) > 0.0).all()
    if mesh.box.periodic:
        assert len(mesh.triangles) == 2 * n
        assert areas(mesh).sum() == close(mesh.box.area, rel=1e-10)
        if n > 1:  # the images of one are rectangles, with either diagonal
            assert edges(mesh, n) == edges(living(mesh.box, x, np.sqrt(mesh.weight)), n)
    else:
        rim = mesh.points[n:]
        low, high = rim.min(axis=0), rim.max(axis=0)
        assert areas(mesh).sum() == close((high - low).prod(), rel=1e-10)
        assert (mesh.weight[n:] == 0.0).all()
    before = mesh.flips, mesh.made
    mesh.follow(x)
    assert (mesh.flips, mesh.made) == before


def discs(n, seed, ratio, periodic):
    rng = np.random.default_rng(seed)
    box, p = arrange.random(
        n, porosity=0.5, diameter=ratio ** rng.uniform(0, 1, n), seed=seed, periodic=periodic
    )
    return box, p.x.copy(), p.radius


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("ratio", [1.0, 10.0])
def test_it_follows_a_swirl_by_flips_alone(ratio, periodic):
    box, x, radius = discs(80, 1, ratio, periodic)
    radius = 0.3 * radius  # so that none hides another
    mesh = living(box, x, radius)
    is_living(mesh, x)
    for _ in range(60):
        a, b = (2.0 * np.pi * x / box.size).T
        swirl = np.stack([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b)], axis=1)
        x += 0.1 * (box.area / len(x)) ** 0.5 * swirl
        mesh.follow(x)
        is_living(mesh, x)
    assert mesh.flips > len(x)
    assert mesh.made == 0


@settings(max_examples=40, deadline=None)
@given(
    n=st.integers(1, 12),
    seed=st.integers(0, 10**6),
    step=st.sampled_from([0.1, 1.0, 30.0]),
    ratio=st.sampled_from([1.0, 10.0]),
    periodic=st.booleans(),
)
def test_it_follows_any_jump_if_need_be_made_anew(n, seed, step, ratio, periodic):
    box, x, radius = discs(n, seed, ratio, periodic)
    radius = 0.2 * radius  # so that none hides another
    mesh, rng = living(box, x, radius), np.random.default_rng(seed)
    for _ in range(4):
        y = x + step * rng.normal(size=x.shape)
        if not apart(box, y, radius):
            continue
        x = y
        mesh.follow(x)
        is_living(mesh, x)


def apart(box, x, radius):
    i, j = np.triu_indices(len(x), 1)
    return (np.hypot(*box.separation(x[i], x[j]).T) > radius[i] + radius[j]).all()


def test_a_jump_is_counted_as_made_anew():
    box, x, radius = discs(40, 2, 1.0, False)
    mesh = living(box, x, radius)
    mesh.follow(x[::-1].copy())
    assert mesh.made == 1
    is_living(mesh, x[::-1])
    mesh.follow(10.0 * x)  # beyond the nodes around them
    assert mesh.made == 2
    is_living(mesh, 10.0 * x)


def test_discs_that_come_to_the_nodes_around_them_get_new_ones():
    # Three discs with small gaps settle on the rim, a node between two of them.
    gap = 0.1
    three = np.array([[-1 - gap / 2, 0], [1 + gap / 2, 0], [0, (2 + gap) * np.sqrt(0.75)]])
    x = np.vstack([three + np.array([0, 20]), [[-6, 20], [6, 21], [0, 27]]])
    mesh = living(Box(100.0, 100.0), x, np.ones(6))
    rim = mesh.points[6:]
    low = rim[:, 1].min()
    node = min(rim[rim[:, 1] == low, 0], key=abs)
    for height in [*np.arange(15.0, 0.0, -0.5), 0.2, 0.05, 1e-3, 0.0, -1.0]:
        x[:3] = three + np.array([node, low + height])
        mesh.follow(x)
        assert {(0, 1, 0, 0), (1, 2, 0, 0), (0, 2, 0, 0)} <= edges(mesh, 6)
        assert (areas(mesh) > 0.0).all()


def test_places_may_lie_in_any_image_of_a_periodic_box():
    box, x, radius = discs(30, 3, 10.0, True)
    here = edges(living(box, x, radius), 30)
    hops = np.random.default_rng(0).integers(-4, 5, x.shape)
    there = edges(living(box, x + hops * box.size, radius), 30)
    moved = {(i, j, *(np.array(s) + hops[i] - hops[j]).tolist()) for i, j, *s in here}
    assert there == moved


@pytest.mark.parametrize("periodic", [False, True])
def test_new_numbers_change_names_alone(periodic):
    box, x, radius = discs(50, 4, 10.0, periodic)
    mesh = living(box, x, radius)
    before, corners = edges(mesh, 50), np.sort(areas(mesh))
    new = np.random.default_rng(0).permutation(50).astype(np.int32)
    mesh.renumber(new)
    assert edges(mesh, 50) == {(new[i], new[j], a, b) for i, j, a, b in before}
    assert np.sort(areas(mesh)) == close(corners, rel=1e-9)
    y = np.empty_like(x)
    y[new] = x
    assert (mesh.weight[:50][new] == radius**2).all()
    is_living(mesh, y)
    mesh.follow(y + 0.01)  # and it lives on
    is_living(mesh, y + 0.01)


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("share", [0.9, 0.5, 0.02])
def test_some_leave(periodic, share):
    box, x, radius = discs(60, 5, 10.0, periodic)
    mesh, rng = living(box, x, radius), np.random.default_rng(0)
    stay = rng.random(60) < share
    stay[rng.integers(60)] = True
    mesh.drop(stay)
    x, n = x[stay] + 0.01, stay.sum()
    mesh.follow(x)
    is_living(mesh, x)
    assert (mesh.weight[:n] == radius[stay] ** 2).all()
    again = np.arange(n) > 0  # and one more
    if n > 1:
        mesh.drop(again)
        mesh.follow(x[again])
        is_living(mesh, x[again])


@settings(max_examples=40, deadline=None)
@given(
    n=st.integers(2, 40),
    seed=st.integers(0, 10**6),
    ratio=st.sampled_from([1.0, 10.0]),
    periodic=st.booleans(),
    share=st.sampled_from([0.5, 0.1]),
)
def test_some_leave_until_one_is_left(n, seed, ratio, periodic, share):
    box, x, radius = discs(n, seed, ratio, periodic)
    mesh, rng = living(box, x, radius), np.random.default_rng(seed)
    while len(x) > 1:
        stay = rng.random(len(x)) > share
        stay[rng.integers(len(x))] = True
        mesh.drop(stay)
        x, radius = x[stay], radius[stay]
        assert (areas(mesh) > 0.0).all()
        assert (mesh.weight[: len(x)] == radius**2).all()
        mesh.follow(x)
        is_living(mesh, x)


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("ratio", [1.0, 10.0])
def test_those_that_leave_are_taken_out_not_made_anew(ratio, periodic):
    box, x, radius = discs(120, 7, ratio, periodic)
    mesh, rng = living(box, x, radius), np.random.default_rng(7)
    while len(x) > 30:
        stay = rng.random(len(x)) < 0.95
        mesh.drop(stay)
        x, radius = x[stay] + 0.01 * radius[stay].min(), radius[stay]  # they move on as well
        mesh.follow(x)
        is_living(mesh, x)
    assert mesh.made == 0


def test_weights_keep_their_bits_however_often_it_is_made_anew():
    box, x, _ = discs(50, 6, 1.0, True)
    radius = np.random.default_rng(1).uniform(0.1, 0.3, 50)
    mesh = living(box, x, radius)
    for _ in range(5):
        mesh.renew(x)
    assert (mesh.weight == radius**2).all()
    assert mesh.made == 5
