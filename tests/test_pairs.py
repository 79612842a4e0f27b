"""Near pairs: no pair is missed (theorem, its sharp limit, brute force), and memory is kept."""

from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import differential_evolution

from grainmesh import arrange, pairs
from grainmesh.contact import Contact
from grainmesh.domain import Box
from grainmesh.living import living
from grainmesh.walls import Wall, table

close = partial(pytest.approx, abs=0.0)

#: Longest gap for which pairs must be joined, in smallest radii: two discs that move their way.
SKIN = 2.0 * pairs.WAY
LIMIT = 2.0 - np.sqrt(2.0)  # of overlap + skin/sqrt(2), `pairs` Eq. (2)
CONTACT = Contact(1e4)


# The theorem -------------------------------------------------------------------------------------


def margin(v, skin, overlap):
    """Power of a third disc, less that of a pair, at the point between the pair.

    The numbers `v` are: log of the radii of both and of the third, gap of the pair, and how much
    farther away than at its deepest the third disc is from each of the two.
    """
    (ri, rj, rk), gap = np.exp(v[:3]), min(v[3], skin)
    d = ri + rj + gap
    ai = (d + (ri**2 - rj**2) / d) / 2
    aj = d - ai
    assert min(ai, aj) > 0.0
    ki, kj = ri + rk - overlap + v[4], rj + rk - overlap + v[5]
    if ki + kj < d or abs(ki - kj) > d:
        return np.inf  # no such triangle
    # Place of the third disc, by cosines, rather than by the theorem of Stewart of the proof.
    x = (ki**2 - kj**2 + d**2) / (2 * d)
    y2 = ki**2 - x**2
    return ((x - ai) ** 2 + y2 - rk**2) - (ai**2 - ri**2)


def least_margin(skin, overlap):
    bounds = [(0, np.log(10)), (0, np.log(10)), (0, np.log(100)), (-overlap, skin), (0, 2), (0, 2)]
    found = differential_evolution(
        margin, bounds, (skin, overlap), seed=0, popsize=8, maxiter=120, tol=1e-9
    )
    return found.fun, np.exp(found.x[:3])


@pytest.mark.parametrize("skin", [0.0, SKIN, 0.4])
def test_no_discs_of_any_size_break_the_limit_and_the_smallest_reach_it(skin):
    limit = LIMIT - skin / np.sqrt(2.0)
    below, at, above = (least_margin(skin, share * limit) for share in (0.97, 1.0, 1.03))
    assert below[0] > 0.01
    assert abs(at[0]) < 1e-4
    assert above[0] < -0.01
    assert at[1] == pytest.approx(np.ones(3), abs=1e-3)


def test_what_the_lists_allow_is_within_the_limit():
    assert pairs.DEEPEST + SKIN / np.sqrt(2.0) < LIMIT
    assert least_margin(SKIN, pairs.DEEPEST)[0] > 0.0


@pytest.mark.parametrize("overlap", [0.3, 0.6, 0.9])
def test_the_deepest_pair_is_always_joined(overlap):
    # However deep: so the check of the overlaps on the edges cannot miss one.
    assert least_margin(-overlap, overlap)[0] > 0.0


def four(skin, overlap):
    """Two unit discs at a gap, and one on each side that overlaps both."""
    half = 1.0 + skin / 2
    height = np.sqrt((2.0 - overlap) ** 2 - half**2)
    return np.array([[-half, 0], [half, 0], [0, height], [0, -height]])


@pytest.mark.parametrize("skin", [0.01, SKIN, 0.4])
def test_the_limit_is_that_of_the_triangulation(skin):
    limit = LIMIT - skin / np.sqrt(2.0)
    for share, joined in (0.99, True), (1.01, False):
        x = four(skin, share * limit)
        mesh = living(Box(1.0, 1.0), x, np.ones(4))
        found = near(mesh, np.ones(4), skin + 1e-9)
        assert ((0, 1, 0, 0) in found) == joined


# Brute force -------------------------------------------------------------------------------------


def near(mesh, radius, skin):
    ways = np.full(len(radius), 0.5 * skin)
    found = pairs.near_discs(mesh, radius, radius**2, CONTACT, ways, pairs.nothing(1))
    rows = np.column_stack([found.owner, found.other, found.image]).tolist()
    assert rows == sorted(rows)  # in order, whatever the triangles are called
    assert all(a != b for a, b in pairwise(rows))
    assert found.offset == close(found.image * mesh.period)
    return set(map(tuple, rows))


def all_near(x, radius, period, skin):
    """The same from all pairs and images."""
    i, j = np.triu_indices(len(x), 1)
    hops = np.zeros((1, 2), int)
    if period.any():
        hops = np.stack(np.meshgrid(*2 * [np.arange(-1, 2)]), axis=-1).reshape(-1, 2)
        nearest = -np.round((x[j] - x[i]) / period).astype(int)
    else:
        nearest = np.zeros((len(i), 2), int)
    image = nearest[:, None] + hops
    away = (x[j] - x[i])[:, None] + image * period
    pair, hop = np.nonzero(
        np.hypot(*np.moveaxis(away, 2, 0)) < (radius[i] + radius[j])[:, None] + skin
    )
    return set(map(tuple, np.column_stack([i[pair], j[pair], image[pair, hop]]).tolist()))


def deepest(x, radius, period):
    """Largest overlap in smallest radii."""
    rows = np.array(sorted(all_near(x, radius, period, 0.0)))
    if len(rows) == 0:
        return 0.0
    i, j = rows[:, :2].T
    away = x[j] - x[i] + rows[:, 2:] * period
    return float((radius[i] + radius[j] - np.hypot(*away.T)).max() / radius.min())


def squeezed(x, radius, period):
    """Radii, larger by one factor, of which some pair overlaps by as much as is allowed."""
    low, high = 0.1, 10.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        if deepest(x, middle * radius, period) < pairs.DEEPEST:
            low = middle
        else:
            high = middle
    return low * radius


@settings(max_examples=40, deadline=None)
@given(
    n=st.integers(1, 80),
    seed=st.integers(0, 10**6),
    ratio=st.sampled_from([1.0, 2.0, 10.0]),
    porosity=st.sampled_from([0.3, 0.5]),
    periodic=st.booleans(),
)
def test_squeezed_discs_are_all_found(n, seed, ratio, porosity, periodic):
    rng = np.random.default_rng(seed)
    diameter = ratio ** rng.uniform(0, 1, n)
    box, p = arrange.random(
        n, porosity=max(porosity, 0.5 if n < 12 else 0.0), diameter=diameter, seed=seed
    )
    if not periodic:
        box = Box(box.width, box.height)
    mesh = living(box, p.x, p.radius)
    radius = squeezed(p.x, p.radius, mesh.period)
    if periodic and 2 * radius.max() > 0.999 * box.size.min():
        return  # touches itself
    mesh = living(box, p.x, radius)
    skin = SKIN * radius.min()
    found = near(mesh, radius, skin)
    wanted = all_near(mesh.points[:n], radius, mesh.period, skin)
    assert found == wanted
    assert n < 2 or len(all_near(mesh.points[:n], radius, mesh.period, 0.0)) > 0


def test_a_disc_that_nearly_fills_its_box_is_near_another_on_many_sides():
    # Two discs on a square lattice: four images of each touch, or nearly, the other.
    box, r = Box(1.0, 1.0, periodic=True), 0.25 * np.sqrt(2.0) * np.ones(2)
    mesh = living(box, np.array([[0.25, 0.25], [0.75, 0.75]]), r)
    assert near(mesh, r, 0.01) == {(0, 1, a, b) for a in (-1, 0) for b in (-1, 0)}
    alone = living(box, np.array([[0.25, 0.25]]), r[:1])
    assert near(alone, r[:1], 0.01) == set()


def test_discs_stay_near_over_the_edge_of_the_box():
    box, p = arrange.random(60, porosity=0.3, diameter=1.0, seed=2)
    hops = np.random.default_rng(0).integers(-3, 4, p.x.shape)
    x = p.x + hops * box.size
    found = near(living(box, x, p.radius), p.radius, SKIN * 0.5)
    assert found == all_near(x, p.radius, box.size, SKIN * 0.5)
    assert any(max(map(abs, row[2:])) > 1 for row in found)


def distance_to(x, a, z):
    """Distance of points to a segment, by its nearest of many points and then exactly."""
    along = ((x - a) @ (z - a)) / ((z - a) @ (z - a))
    return np.hypot(*(x - a - np.clip(along, 0, 1)[:, None] * (z - a)).T)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 150), periodic=st.booleans())
def test_walls_near_discs_equal_a_search_over_all(seed, n, periodic):
    rng = np.random.default_rng(seed)
    box = Box(3.0, 2.0, periodic)
    x, radius = rng.uniform(-1.0, 4.0, (n, 2)), rng.uniform(0.01, 0.2, n)
    order = np.lexsort(x.T)
    x = x[order]
    walls = [Wall(*rng.uniform(-1, 3, (2, 2))) for _ in range(4)]
    if not periodic:
        walls += [Wall.of(box, side) for side in ("left", "top")]
    moved = rng.uniform(-5.0, 5.0, (len(walls), 6)) if periodic else np.zeros((len(walls), 6))
    ways = rng.uniform(0.0, 0.1, n + len(walls))
    mesh = living(box, x, np.full(n, 1e-3))
    found = pairs.near_walls(
        mesh, radius, radius**2, CONTACT, ways, pairs.nothing(1),
        table(tuple(walls), 0.0), moved,
    )  # fmt: skip
    rows = set(map(tuple, np.column_stack([found.owner, found.other, found.image]).tolist()))
    assert len(rows) == len(found.other)
    hops = [(a, b) for a in range(-6, 7) for b in range(-6, 7)] if periodic else [(0, 0)]
    wanted = set()
    for w, wall in enumerate(walls):
        for hop in hops:
            a, z = (np.array(e) + moved[w, :2] + hop * box.size for e in (wall.start, wall.end))
            if wall.side:
                gap = x[:, 0] if wall.side == "left" else box.height - x[:, 1]
            else:
                gap = distance_to(x, a, z)
            on = np.flatnonzero(gap < radius + ways[:n] + ways[n + w])
            wanted |= {(i, w, *hop) for i in on.tolist()}
    assert rows == wanted


# Memory ------------------------------------------------------------------------------------------


def a_memory(rng, n, width):
    box, p = arrange.random(n, porosity=0.3, diameter=1.0, seed=3)
    mesh = living(box, p.x, p.radius)
    ways = np.full(n, 0.05)
    found = pairs.near_discs(mesh, p.radius, p.radius**2, CONTACT, ways, pairs.nothing(width))
    found.history[:] = rng.normal(size=found.history.shape)
    return box, p, pairs.memory(found)


def as_dict(memory):
    keys = np.column_stack([memory.owner, memory.other, memory.image]).tolist()
    return dict(zip(map(tuple, keys), memory.history.tolist(), strict=True))


def test_memory_follows_new_numbers_and_changes_sign_where_discs_change_places():
    rng = np.random.default_rng(0)
    _, _, memory = a_memory(rng, 50, 3)
    new = rng.permutation(50).astype(np.int32)
    there = pairs.renumbered(memory, new, True, (1,))
    assert (there.owner < there.other).all()
    before, after = as_dict(memory), as_dict(there)
    turned = 0
    for (i, j, a, b), (p0, p1, p2) in before.items():
        if new[i] < new[j]:
            assert after[new[i], new[j], a, b] == [p0, p1, p2]
        else:
            assert after[new[j], new[i], -a, -b] == [p0, -p1, p2]
            turned += 1
    assert 0 < turned < len(before)
    back = pairs.renumbered(there, np.argsort(new).astype(np.int32), True, (1,))
    assert as_dict(back) == before


def test_memory_of_those_that_are_gone_is_dropped():
    _, _, memory = a_memory(np.random.default_rng(1), 50, 1)
    gone = [3, 17, 20]
    stay = ~np.isin(np.arange(50), gone)
    new = np.where(stay, np.cumsum(stay) - 1, -1).astype(np.int32)
    left = as_dict(pairs.renumbered(memory, new, True, ()))
    kept = {
        (new[i], new[j], a, b): q
        for (i, j, a, b), q in as_dict(memory).items()
        if stay[i] and stay[j]
    }
    assert left == kept
    assert len(left) < len(memory.owner)


def test_a_new_list_remembers_pairs_of_the_old_one_and_no_others():
    rng = np.random.default_rng(2)
    box, p, memory = a_memory(rng, 50, 2)
    x = p.x + rng.normal(0, 0.02, p.x.shape)
    mesh = living(box, x, p.radius)
    ways = np.full(50, 0.05)
    found = pairs.near_discs(mesh, p.radius, p.radius**2, CONTACT, ways, memory)
    before, after = as_dict(memory), as_dict(pairs.memory(found))
    same = before.keys() & after.keys()
    assert 0 < len(same) < len(after)
    for key, q in after.items():
        assert q == before.get(key, [0.0, 0.0])
