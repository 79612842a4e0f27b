"""Fields carried by key: exact for their own polynomials, whatever the triangulation does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ngsolve import H1, TRIG, VERTEX, GridFunction, IfPos, Integrate, Periodic, x, y

from grainmesh.carry import Keys, along_edge, carry, carry_load
from grainmesh.domain import Box
from grainmesh.mesh import flow_mesh
from grainmesh.nodes import bounded

ORDERS = [1, 2, 3, 4, 5]


def keys_of(mesh, order):
    """Keys on what a `Bounded` is now; bubbles for k = 1."""
    grid = flow_mesh(mesh.box, mesh.points, mesh.triangles, mesh.shifts, mesh.neighbours)
    about = mesh.points.copy(), mesh.triangles.copy(), mesh.shifts.copy()
    return Keys(mesh.box, *about, grid, order, order == 1)


def space_of(keys):
    space = H1(keys.grid.mesh, order=keys.order)
    if keys.bubble:
        space.SetOrder(TRIG, 3)
        space.Update()
    return Periodic(space) if keys.grid.mesh.GetPeriodicNodePairs(VERTEX) else space


def gathered(keys, field):
    """Unknowns by key, (size, 1), of a field."""
    found, values = np.zeros((keys.size, 1)), field.vec.FV().NumPy()
    free = np.asarray(field.space.FreeDofs())  # images hold no values
    found[keys.of_mesh[free], 0] = values[free]
    return found


def spread_out(keys, values):
    """The field of unknowns by key."""
    field = GridFunction(space_of(keys))
    field.vec.FV().NumPy()[:] = values[keys.of_mesh, 0]
    return field


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
        field = GridFunction(space_of(old))
        field.Set(exact)
        count = mesh.flips
        mesh.mend()
        flips += mesh.flips - count
        came += int((mesh.in_use & ~before).sum())
        went += int((before & ~mesh.in_use).sum())
        new = keys_of(mesh, order)
        found = spread_out(new, carry(old, new, gathered(old, field)))
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
        field = GridFunction(space_of(old))
        field.Set(exact)
        mesh.mend()
        new = keys_of(mesh, order)
        found = spread_out(new, carry(old, new, gathered(old, field)))
        error = Integrate((found - exact) ** 2, found.space.mesh, order=2 * order + 6,
                          element_wise=True).NumPy()  # fmt: skip
        place = new.places(np.arange(len(new.triangles)))
        where = np.mod(place.mean(axis=1) / mesh.box.size - jump, 1.0)
        reach = 0.3  # longer than any two edges
        far = ((where > reach) & (where < 1.0 - reach)).all(axis=1)
        new_ones = ~np.isin(new.faces_of_triangles, old.faces)
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
    assert np.array_equal(carry(old, old, values), values)
    mesh.mend()
    new = keys_of(mesh, order)
    found = carry(old, new, values)
    stay = np.isin(new.faces_of_triangles, old.faces)
    assert 0 < stay.sum() < len(stay)
    there = np.flatnonzero(stay)
    same = np.searchsorted(old.faces, new.faces_of_triangles[there])
    back = np.argsort(old.faces_of_triangles)[same]
    assert np.array_equal(found[new.local(there)], values[old.local(back)])
    # Columns know nothing of each other, and the map is linear.
    alone = carry(old, new, values[:, :1] + 3.0 * values[:, 1:])
    assert np.allclose(alone, found[:, :1] + 3.0 * found[:, 1:], rtol=0.0, atol=1e-11)


@given(seed=st.integers(0, 10**6), order=st.sampled_from(ORDERS), periodic=st.booleans())
@settings(max_examples=15, deadline=None)
def test_loads_keep_their_sum_over_vertices(seed, order, periodic):
    mesh, _ = next(made_to_change(periodic, seed))
    old = keys_of(mesh, order)
    load = np.random.default_rng(seed).normal(size=(old.size, 2))
    mesh.mend()
    new = keys_of(mesh, order)
    m, found = len(mesh.points), carry_load(old, new, load)
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
    kept = carry_load(old, new, values)[:, 0]
    m = len(mesh.points)
    by_name = dict(zip(old.names.tolist(), values[:, 0].tolist(), strict=True))
    for name, value in zip(new.names[m:].tolist(), kept[m:].tolist(), strict=True):
        assert value == by_name.get(name, 0.0)


@pytest.mark.parametrize("order", ORDERS)
def test_unknowns_of_edges_are_those_of_polynomials_on_them(order):
    mesh, _ = next(made_to_change(False, 4))
    keys = keys_of(mesh, order)
    exact = polynomial(order, False, x, y, np.random.default_rng(order))
    field = GridFunction(space_of(keys))
    field.Set(exact)
    ends = np.stack(np.divmod(keys.edges, len(keys.points)), axis=1)
    along = np.linspace(0.0, 1.0, order + 1)[:, None]
    place = (1.0 - along) * keys.points[ends[:, 0], None] + along * keys.points[ends[:, 1], None]
    at = keys.grid.mesh(*np.clip(place, 1e-12, keys.box.size - 1e-12).reshape(-1, 2).T)
    values = np.asarray(exact(at)).reshape(len(ends), order + 1, 1)
    row = keys.unknowns(ends, np.arange(len(ends))[:, None], np.empty((len(ends), 0), np.int64))
    assert np.allclose(along_edge(order, values), gathered(keys, field)[row], rtol=0.0, atol=1e-9)
