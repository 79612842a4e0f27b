"""Fields carried by key: exact for their own polynomials, whatever the triangulation does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ngsolve import IfPos, Integrate, x, y
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from grainmesh.carry import Finder, Keys, Topology, Transfer, regions
from grainmesh.domain import Box
from grainmesh.element import PAIRS, element
from grainmesh.mesh import flow_mesh
from grainmesh.nodes import bounded

ORDERS = [1, 2, 3, 4, 5]


def keys_of(mesh, order):
    """Keys on what a `Bounded` is now; bubbles for k = 1."""
    on = Topology(mesh.box, len(mesh.points), mesh.triangles.copy(), mesh.shifts.copy())
    return Keys(on, element(order, order == 1))


def grid_of(mesh):
    return flow_mesh(mesh.box, mesh.points, mesh.triangles, mesh.shifts, mesh.neighbours)


def gathered(keys, grid, exact):
    """Unknowns (size, 1) of a formula."""
    field = keys.field(grid, np.zeros(keys.size))
    field.Set(exact)
    found, values = np.zeros((keys.size, 1)), field.vec.FV().NumPy()
    free = np.asarray(field.space.FreeDofs())  # images hold no values
    found[keys.of_mesh(grid)[free], 0] = values[free]
    return found


def carry(mesh, old, new, values):
    (found,) = Transfer(old.topology, new.topology, mesh.points).fields(old, new, values)
    return found


def carry_load(mesh, old, new, values):
    return Transfer(old.topology, new.topology, mesh.points).loads(old, new, values)


def made_to_change(periodic, seed, moves=3, far=0.06, n=40):
    """A triangulation before and after `mend`, points at the same places: flips, nodes in and out.

    Only moves that leave triangles positive are made before.
    """
    box, rng = Box(1.0, 0.8, periodic), np.random.default_rng(seed)
    grid = (np.stack(np.divmod(np.arange(n), 8), axis=1) + 0.5) / (n // 8, 8)
    at = (grid + rng.uniform(-0.03, 0.03, (n, 2))) * box.size
    at[at[:, 0] > 0.55 * box.width] *= [0.5, 1.0]  # room for nodes of the fluid
    at += rng.uniform(0.0, 1e-3, at.shape)
    mesh = bounded(box, at, np.full(n, 0.002), spacing=0.08)
    for _ in range(moves):
        way = rng.normal((far, 0.0), far, (n, 2))  # to where the nodes are
        start = mesh.points[:n].copy()
        there = start + way
        if not periodic:
            there = np.clip(there, 0.01, box.size - 0.01)
        share = 1.0
        while not mesh.move(start + share * (there - start)):
            share *= 0.7
        before = mesh.in_use.copy()
        yield mesh, before


def polynomial(order, bubble, X, Y, rng):
    """A random one of this degree."""
    powers = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]
    return sum(float(rng.normal()) * X**i * Y**j for i, j in powers)


@pytest.mark.parametrize("order", ORDERS)
def test_polynomials_of_their_degree_are_carried_exactly(order):
    rng, flips, came, went = np.random.default_rng(order), 0, 0, 0
    for mesh, before in made_to_change(False, 0, moves=20):
        exact = polynomial(order, order == 1, x, y, rng)
        old = keys_of(mesh, order)
        values, count = gathered(old, grid_of(mesh), exact), mesh.flips
        mesh.mend()
        flips += mesh.flips - count
        came += int((mesh.in_use & ~before).sum())
        went += int((before & ~mesh.in_use).sum())
        new = keys_of(mesh, order)
        found = new.field(grid_of(mesh), carry(mesh, old, new, values)[:, 0])
        error = (found - exact) ** 2
        assert np.sqrt(Integrate(error, found.space.mesh, order=2 * order + 6)) < 1e-11
    assert min(flips, came, went) > 3  # all of it has happened


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("jump", [0.0, 0.5])
def test_and_across_the_sides_of_a_periodic_box(order, jump):
    # A polynomial of the distance from a jump is periodic, and one polynomial but near the jump.
    rng, fresh = np.random.default_rng(order), 0
    for mesh, _ in made_to_change(True, 5):
        W, H = mesh.box.size
        X, Y = x / W - jump, y / H - jump
        for _ in range(2):  # triangles reach out of the box
            X, Y = X - IfPos(X - 1.0, 1.0, 0.0), Y - IfPos(Y - 1.0, 1.0, 0.0)
            X, Y = X + IfPos(-X, 1.0, 0.0), Y + IfPos(-Y, 1.0, 0.0)
        exact = polynomial(order, order == 1, X, Y, rng)
        old = keys_of(mesh, order)
        values = gathered(old, grid_of(mesh), exact)
        mesh.mend()
        new = keys_of(mesh, order)
        found = new.field(grid_of(mesh), carry(mesh, old, new, values)[:, 0])
        error = Integrate((found - exact) ** 2, found.space.mesh, order=2 * order + 6,
                          element_wise=True).NumPy()  # fmt: skip
        on = new.topology
        where = np.mod(on.places(mesh.points).mean(axis=1) / mesh.box.size - jump, 1.0)
        reach = 0.3  # longer than any two edges
        far = ((where > reach) & (where < 1.0 - reach)).all(axis=1)
        new_ones = ~np.isin(on.numbers, old.topology.numbers)
        fresh += int((far & new_ones).sum())
        assert np.sqrt(error[far].max()) < 1e-11
    assert fresh > 3


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("order", ORDERS)
def test_what_stays_keeps_its_values_and_nothing_is_carried_twice(order, periodic):
    rng = np.random.default_rng(0)
    mesh, _ = next(made_to_change(periodic, 1))
    old = keys_of(mesh, order)
    values = rng.normal(size=(old.size, 2))
    assert np.array_equal(carry(mesh, old, old, values), values)
    mesh.mend()
    new = keys_of(mesh, order)
    found = carry(mesh, old, new, values)
    stay = np.isin(new.topology.numbers, old.topology.numbers)
    assert 0 < stay.sum() < len(stay)
    order = np.argsort(old.topology.numbers)
    back = order[np.searchsorted(old.topology.numbers, new.topology.numbers[stay], sorter=order)]
    assert np.array_equal(found[new.rows[stay]], values[old.rows[back]])
    # Columns know nothing of each other, and the map is linear.
    alone = carry(mesh, old, new, values[:, :1] + 3.0 * values[:, 1:])
    assert np.allclose(alone, found[:, :1] + 3.0 * found[:, 1:], rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("order", ORDERS)
def test_it_does_not_matter_in_which_order_triangles_stand(order, periodic):
    rng = np.random.default_rng(1)
    mesh, _ = next(made_to_change(periodic, 1))
    old = keys_of(mesh, order)
    values = rng.normal(size=(old.size, 2))
    values[: old.topology.count][~old.topology.used] = 0.0
    mesh.mend()
    new = keys_of(mesh, order)

    def shuffled(keys):
        on, row = keys.topology, rng.permutation(len(keys.topology.triangles))
        turn = (rng.integers(0, 3, len(row))[:, None] + np.arange(3)) % 3
        row = row[:, None]
        on = Topology(on.box, on.count, on.triangles[row, turn], on.shifts[row, turn])
        return Keys(on, keys.element)

    by_name = np.argsort(new.names)
    expected = carry(mesh, old, new, values)[by_name]
    for target in (new, shuffled(new)):
        for source in (old, shuffled(old)):
            there = np.empty_like(values)
            there[np.argsort(source.names)] = values[np.argsort(old.names)]
            found = carry(mesh, source, target, there)[np.argsort(target.names)]
            assert np.allclose(found, expected, rtol=0.0, atol=1e-11)


@given(seed=st.integers(0, 10**6), periodic=st.booleans(), share=st.floats(0.0, 0.1))
@settings(max_examples=15, deadline=None)
def test_regions_are_what_hangs_together(seed, periodic, share):
    mesh, _ = next(made_to_change(periodic, seed))
    old = keys_of(mesh, 1).topology
    mesh.mend()
    new, m = keys_of(mesh, 1).topology, len(mesh.points)
    changed = np.random.default_rng(seed).random(m) < share
    points, lowest = regions(old, new, changed)
    corners = np.concatenate([old.corners, new.corners])
    corners = corners[changed[corners].any(axis=1)]
    links = coo_array((np.ones(2 * len(corners)), corners[:, [0, 1, 1, 2]].reshape(-1, 2).T),
                      shape=(m, m))  # fmt: skip
    label = connected_components(links, directed=False)[1]
    assert np.array_equal(points, np.unique(corners))
    first = {part: point for point, part in reversed(list(enumerate(label)))}
    assert lowest.tolist() == [first[part] for part in label[points]]


@given(seed=st.integers(0, 10**6), order=st.sampled_from(ORDERS), periodic=st.booleans())
@settings(max_examples=15, deadline=None)
def test_loads_keep_their_sum_over_vertices(seed, order, periodic):
    mesh, _ = next(made_to_change(periodic, seed))
    old = keys_of(mesh, order)
    load = np.random.default_rng(seed).normal(size=(old.size, 2))
    mesh.mend()
    new = keys_of(mesh, order)
    m, found = len(mesh.points), carry_load(mesh, old, new, load)
    assert np.array_equal(found[:m], load[:m])
    assert found.shape == (new.size, 2)


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("order", ORDERS)
def test_each_unknown_has_a_name_of_its_own_that_it_keeps(order, periodic):
    mesh, _ = next(made_to_change(periodic, 3))
    old = keys_of(mesh, order)
    mesh.mend()
    new = keys_of(mesh, order)
    assert len(np.unique(new.names)) == new.size
    values = np.arange(old.size, dtype=float)[:, None]
    kept = carry_load(mesh, old, new, values)[:, 0]
    m = len(mesh.points)
    by_name = dict(zip(old.names.tolist(), values[:, 0].tolist(), strict=True))
    for name, value in zip(new.names[m:].tolist(), kept[m:].tolist(), strict=True):
        assert value == by_name.get(name, 0.0)


@pytest.mark.parametrize("order", ORDERS)
def test_unknowns_of_edges_are_those_of_polynomials_on_them(order):
    mesh, _ = next(made_to_change(False, 4))
    keys, grid = keys_of(mesh, order), grid_of(mesh)
    exact = polynomial(order, False, x, y, np.random.default_rng(order))
    edge = np.arange(len(keys.topology.edges))
    ends = np.stack(np.divmod(keys.topology.edges, len(mesh.points)), axis=1)
    along = np.linspace(0.0, 1.0, order + 1)[:, None]
    place = (1.0 - along) * mesh.points[ends[:, 0], None] + along * mesh.points[ends[:, 1], None]
    at = grid.mesh(*np.clip(place, 1e-12, mesh.box.size - 1e-12).reshape(-1, 2).T)
    values = np.asarray(exact(at)).reshape(len(ends), order + 1, 1)
    row = np.column_stack([ends, keys.of_edges(edge[:, None])])
    found, of_field = keys.element.from_edge @ values, gathered(keys, grid, exact)
    assert np.allclose(found, of_field[row], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("periodic", [False, True])
def test_edges_and_triangles_are_known_by_their_corners(periodic):
    mesh, _ = next(made_to_change(periodic, 2))
    mesh.mend()
    on = keys_of(mesh, 2).topology
    m, t = len(mesh.points), mesh.triangles
    assert np.array_equal(on.corners, np.sort(t, axis=1))
    assert np.array_equal(on.used, mesh.in_use)
    ends = np.stack(np.divmod(on.edges, m), axis=1)
    assert np.array_equal(ends[on.edges_of_triangles], on.corners[:, PAIRS])
    assert len(np.unique(on.edges)) == len(on.edges)
    assert np.array_equal(on.numbers, on.corners @ [m * m, m, 1])
    # Corners where they are, up to a period of the box for all three.
    way = on.places(mesh.points) - mesh.points[on.corners]
    if periodic:
        assert np.abs(way / mesh.box.size - np.rint(way / mesh.box.size)).max() < 1e-12
        middle = on.places(mesh.points).mean(axis=1)
        assert ((middle > -1e-12) & (middle < mesh.box.size + 1e-12)).all()
    else:
        assert not way.any()
    a, b, c = np.moveaxis(on.places(mesh.points), 1, 0)
    area = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert area.sum() == pytest.approx(mesh.box.area, rel=1e-12)


@pytest.mark.parametrize("periodic", [False, True])
def test_places_are_found_in_the_triangle_that_holds_them(periodic):
    mesh, _ = next(made_to_change(periodic, 6))
    mesh.mend()
    on, rng = keys_of(mesh, 1).topology, np.random.default_rng(0)
    which = np.arange(len(on.triangles))
    finder, places = Finder(on, mesh.points, which), on.places(mesh.points)
    weight = rng.dirichlet([1.0, 1.0, 1.0], (len(which), 4)) * 0.97 + 0.01
    inside = np.einsum("tqk,tkc->tqc", weight, places)
    if periodic:
        inside = inside + rng.integers(-2, 3, (len(which), 1, 2)) * mesh.box.size
    t, found = finder(inside.reshape(-1, 2))
    assert np.array_equal(t, np.repeat(which, 4))
    assert np.allclose(found, weight.reshape(-1, 3), rtol=0.0, atol=1e-9)
    # Anywhere at all.
    x = rng.uniform(0.0, 1.0, (2000, 2)) * mesh.box.size
    t, found = finder(x)
    assert found.min() > -1e-12
    way = np.einsum("qk,qkc->qc", found, places[t]) - x
    assert np.abs(way - np.rint(way / mesh.box.size) * mesh.box.size * periodic).max() < 1e-12


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("kind", ["cluster", "line"])
def test_places_are_found_beside_much_smaller_triangles(kind, periodic):
    # All nearest middles are those of a crowd that the triangle only touches.
    box, n, rng = Box(1.0, 1.0, periodic), 300, np.random.default_rng(0)
    if kind == "cluster":
        turn = rng.uniform(0.0, 2.0 * np.pi, n)
        far = 0.02 * np.sqrt(rng.uniform(0.0, 1.0, n))
        crowd = 0.5 + far[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    else:
        crowd = np.stack([np.linspace(0.3, 0.7, n), rng.normal(0.5, 1e-4, n)], axis=1)
    rest = (np.stack(np.divmod(np.arange(9), 3), axis=1) + rng.uniform(0.2, 0.3, (9, 2))) / 3.0
    mesh = bounded(box, np.vstack([crowd, rest]), np.full(n + 9, 1e-6))
    on = keys_of(mesh, 1).topology
    x = np.vstack([rng.uniform(0.0, 1.0, (500, 2)), rng.uniform(0.4, 0.6, (500, 2))])
    t, found = Finder(on, mesh.points, np.arange(len(on.triangles)))(x)
    assert found.min() > -1e-9
    way = np.einsum("qk,qkc->qc", found, on.places(mesh.points)[t]) - x
    assert np.abs(way - np.rint(way) * periodic).max() < 1e-12
