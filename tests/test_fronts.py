"""The factor by fronts, against dense solutions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from grainmesh import Box, arrange, fronts
from grainmesh.carry import Topology
from grainmesh.coupling import Coupling, Discs
from grainmesh.fronts import Fronts, halved
from grainmesh.medium import Fluid
from grainmesh.navier import Operator
from grainmesh.nodes import bounded


def operator(order, periodic=False, seed=0, held=0.2, n=60, viscosity=1.0, inertia=10.0):
    """An operator on the mesh of random discs; some velocities are given."""
    if periodic:
        box, discs = arrange.random(n, porosity=0.7, diameter=0.1, seed=seed)
    else:
        box = Box(1.0, 1.0)
        discs = arrange.loose(box, n, diameter=0.05, density=1.0, seed=seed)
    mesh = bounded(box, discs.x, discs.radius)
    on = Topology(box, len(mesh.points), mesh.triangles, mesh.shifts)
    op = Operator(on, mesh.points, order, viscosity, 1.0)
    rng = np.random.default_rng(seed)
    op.free[: op.split] &= rng.random(op.split) > held
    one = np.ones(len(mesh.points))
    op.load(eps=0.7 * one, E=one, S=0.01 * one, inertia=inertia * (1.0 + rng.random(len(one))))
    op.assemble()
    return op


def dense(op, inside):
    kept = np.flatnonzero(inside)
    columns = []
    for i in kept:
        one = np.zeros(len(inside))
        one[i] = 1.0
        columns.append(op.apply(one)[kept])
    return np.array(columns)


@pytest.mark.parametrize("many", [0, 10**9])  # both halves at once, or one after the other
@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_factor_is_the_inverse(order, periodic, many, monkeypatch):
    monkeypatch.setattr(fronts, "MANY", many)
    op, rng = operator(order, periodic), np.random.default_rng(1)
    sought, factor = op.sought, op.factor()
    goal = sought * rng.normal(size=len(sought))
    goal[op.split :] -= goal[op.split :].mean()  # nothing gives the pressure a level
    goal *= sought
    f = sought * op.apply(goal)
    x = factor.solve(f)
    x += factor.solve(f - sought * op.apply(x))  # single precision, and PIVOT
    assert not x[~sought].any()
    level = op.split + np.flatnonzero(op.topology.used)
    for z in (x, goal):
        z[level] -= z[level].mean()
    assert np.linalg.norm(x - goal) < 1e-5 * np.linalg.norm(goal)


def test_both_halves_at_once_give_the_same_bits(monkeypatch):
    op, r = operator(2), np.random.default_rng(2)
    r = op.sought * r.normal(size=len(op.free))
    found = []
    for many in (0, 10**9):
        monkeypatch.setattr(fronts, "MANY", many)
        found.append(op.factor().solve(r))
    assert np.array_equal(*found)


@given(seed=st.integers(0, 10**6), order=st.integers(1, 3))
@settings(max_examples=10, deadline=None)
def test_inertia_is_that_of_a_saddle_point(seed, order):
    """As many negative pivots as pressures (Sylvester), and the inverse is symmetric."""
    op, rng = operator(order, seed=seed, n=30), np.random.default_rng(seed)
    factor = op.factor()
    assert (factor._pivots < 0.0).sum() == op.sought[op.split :].sum() - 1  # one has the level
    x, y = op.sought * rng.normal(size=(2, len(op.free)))
    x[op.split :] = y[op.split :] = 0.0
    assert x @ factor.solve(y) == pytest.approx(
        y @ factor.solve(x), rel=1e-4, abs=1e-5 * np.linalg.norm(factor.solve(x))
    )


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("seed", range(6))
def test_inertia_between_walls_that_hold_the_fluid(order, seed):
    """Pressures of triangles with two sides on walls have next to nothing that holds them."""
    box = Box(0.0035, 0.03) if seed % 2 else Box(0.012, 0.014)
    discs = arrange.loose(box, 20, diameter=1e-3, density=2500.0, seed=seed)
    flow = Coupling(
        box, Fluid(1000.0, 1e-3, order=order), (0.0, -9.81),
        Discs(discs.diameter, np.ones(20), np.ones(20, bool)), discs.x, np.zeros((20, 2)),
    )  # fmt: skip
    op = flow.operator
    op.load(inertia=1e6 * op.eps, E=op.eps)
    op.assemble()
    pivots = op.factor()._pivots
    assert np.isfinite(pivots).all()
    assert (pivots < 0.0).sum() == op.sought[op.split :].sum() - 1


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("viscosity", [1e-9, 1e9])
def test_factor_does_not_care_what_rules(order, viscosity):
    op, rng = operator(order, viscosity=viscosity), np.random.default_rng(3)
    sought, factor = op.sought, op.factor()
    goal = sought * rng.normal(size=len(sought))
    goal[op.split :] *= viscosity + 10.0
    level = op.split + np.flatnonzero(op.topology.used)
    goal[level] -= goal[level].mean()
    f = sought * op.apply(goal)
    x = np.zeros_like(f)
    for _ in range(3):
        x += factor.solve(f - sought * op.apply(x))
    x[level] -= x[level].mean()
    for part in (slice(0, op.split), slice(op.split, None)):
        assert np.linalg.norm((x - goal)[part]) < 1e-4 * np.linalg.norm(goal[part])


def test_part_of_the_unknowns():
    op, rng = operator(2), np.random.default_rng(4)
    inside = np.zeros_like(op.free)
    middle = op.corners.mean(axis=1)
    inside[op.rows[np.hypot(*(middle - 0.5).T) < 0.2]] = True
    inside &= op.sought
    assert 0 < inside.sum() < op.sought.sum()
    r = rng.normal(size=len(inside))
    x = op.factor(inside).solve(r)
    assert not x[~inside].any()
    exact = np.linalg.solve(dense(op, inside), r[inside])
    assert np.linalg.norm(x[inside] - exact) < 1e-3 * np.linalg.norm(exact)


@given(seed=st.integers(0, 10**6), t=st.integers(1, 300))
@settings(max_examples=25, deadline=None)
def test_halves_are_equal_and_lie_side_by_side(seed, t):
    rng = np.random.default_rng(seed)
    low = rng.random((t, 2)).round(1 + seed % 3)  # ties too
    depth = max(0, int(np.log2(t / 4)))
    order = halved(low, low + 0.01, depth)
    assert np.array_equal(np.sort(order), np.arange(t))
    for level in range(depth):
        cut = [(k * t) >> (level + 1) for k in range(2 ** (level + 1) + 1)]
        for a, b, c in zip(cut[:-2:2], cut[1:-1:2], cut[2::2], strict=True):
            below, above = low[order[a:b]], low[order[b:c]]
            assert (below.max(axis=0) <= above.min(axis=0)).any()


def test_fill_grows_as_n_log_n():
    """Nested dissection: per unknown, rows of U grow by the same with each doubling."""
    sizes = []
    for n in (300, 1200, 4800):
        op = operator(1, n=n, held=0.0) if n < 400 else _large(n)
        factor = op.factor()
        sizes.append(len(factor._panels) / len(factor._pivots))
    first, second = np.diff(sizes)
    assert second < 1.5 * first


def _large(n):
    box, discs = arrange.square(int(n**0.5), int(n**0.5), porosity=0.7, diameter=0.1)
    x = discs.x + np.random.default_rng(0).uniform(-0.01, 0.01, discs.x.shape)
    mesh = bounded(Box(box.width, box.height), x, discs.radius)
    on = Topology(mesh.box, len(mesh.points), mesh.triangles, mesh.shifts)
    op = Operator(on, mesh.points, 1, 1.0, 1.0)
    one = np.ones(len(mesh.points))
    op.load(eps=one, E=one, S=0.01 * one, inertia=10.0 * one)
    op.assemble()
    return op


def test_one_triangle():
    K = np.diag([2.0, 2.0, 2.0, 2.0, 2.0, 2.0, -1.0, -1.0, -1.0])[None]
    K[0, 6:, :6] = K[0, :6, 6:] = 0.0
    corners = np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])
    factor = Fronts(K, np.arange(9)[None], np.ones(9, dtype=bool), 6, corners)
    assert np.allclose(factor.solve(np.ones(9)), [0.5] * 6 + [-1.0] * 3)
