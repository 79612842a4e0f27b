"""A kept factor, and GMRES, against dense solutions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ngsolve import Mesh, unit_square

from flows import flow
from grainmesh.lagged import Lagged, gmres


def operator(order=2, change=0.0, seed=0):
    """An operator with an outlet, its vertices moved by about `change`."""
    mesh = Mesh(unit_square.GenerateMesh(maxh=0.35))
    rng = np.random.default_rng(seed)
    op = flow.Setting(mesh, order, 1.0, 1.0, ("right",), ("left", "bottom", "top")).op
    at = flow.places(mesh).copy()
    inside = ((at > 1e-9) & (at < 1.0 - 1e-9)).all(axis=1)
    at[inside] += change * rng.uniform(-1.0, 1.0, (inside.sum(), 2))
    op.at(at)
    one = np.ones(mesh.nv)
    op.load(eps=one, E=one, S=0.01 * one, inertia=10.0 * one)
    op.assemble()
    return op


def dense(op):
    """The matrix of the unknowns sought."""
    return np.array([op.apply(row) for row in np.eye(len(op.free))])[np.ix_(op.sought, op.sought)]


def applied(op):
    """The same of vectors of unknowns sought."""
    some = np.flatnonzero(op.sought)

    def apply(z):
        x = np.zeros(len(op.free))
        x[some] = z
        return op.apply(x)[some]

    return apply


def lagged(op):
    """A factor whose unknowns are named by their numbers."""
    return Lagged(op.factor(), op.sought, np.arange(len(op.free)))


@pytest.mark.parametrize("kind", ["definite", "indefinite", "not symmetric"])
@given(seed=st.integers(0, 10**6), n=st.integers(1, 25))
@settings(max_examples=25, deadline=None)
def test_gmres_solves_and_tells_the_residual(kind, seed, n):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    if kind != "not symmetric":
        Q = np.linalg.qr(A)[0]
        sign = rng.choice([-1.0, 1.0], n) if kind == "indefinite" else 1.0
        A = Q @ np.diag(sign * rng.uniform(0.5, 3.0, n)) @ Q.T
    A += 0.0 if kind != "not symmetric" else 4.0 * np.sqrt(n) * np.eye(n)
    f = rng.normal(size=n)
    tolerance = 1e-9 * np.linalg.norm(f)
    z, count, rest = gmres(lambda v: A @ v, lambda v: v / 2.0, f, tolerance, n + 1)
    assert count <= n + 1
    assert np.linalg.norm(rest) <= 1.01 * tolerance
    assert np.linalg.norm(f - A @ z - rest) < 1e-2 * tolerance
    assert np.linalg.norm(z - np.linalg.solve(A, f)) < 100.0 * tolerance


@given(seed=st.integers(0, 10**6), most=st.integers(1, 6))
@settings(max_examples=20, deadline=None)
def test_gmres_that_stops_early_tells_what_is_left_and_has_the_least(seed, most):
    rng = np.random.default_rng(seed)
    A, f = rng.normal(size=(20, 20)), rng.normal(size=20)
    z, count, rest = gmres(lambda v: A @ v, lambda v: v, f, 1e-12, most)
    assert count == most
    left = np.linalg.norm(rest)
    assert np.linalg.norm(f - A @ z - rest) < 1e-9 * left
    krylov = [f]
    for _ in range(most - 1):
        krylov.append(A @ krylov[-1] / np.linalg.norm(A @ krylov[-1]))
    basis = A @ np.linalg.qr(np.array(krylov).T)[0]
    best = f - basis @ np.linalg.lstsq(basis, f)[0]
    assert left == pytest.approx(np.linalg.norm(best), rel=1e-6)


def test_gmres_has_nothing_to_do_below_its_tolerance():
    f = np.full(4, 1e-3)
    z, count, rest = gmres(lambda v: v / 0.0, lambda v: v / 0.0, f, 1.0, 5)
    assert count == 0
    assert np.array_equal(rest, f)
    assert not z.any()


def test_gmres_tells_the_residual_where_there_is_no_solution():
    rng = np.random.default_rng(5)
    A = rng.normal(size=(30, 30))
    A[-1] = A[:-1].sum(axis=0)  # so the last of f is to be the sum of the others
    f = rng.normal(size=30)
    z, _, rest = gmres(lambda v: A @ v, lambda v: v, f, 1e-12, 30)
    assert np.linalg.norm(rest) > 0.01
    assert np.linalg.norm(f - A @ z - rest) < 1e-9 * (1.0 + np.linalg.norm(z))


@pytest.mark.parametrize("rank", [0, 1, 2])
def test_gmres_breaks_down_with_what_it_has(rank):
    A = np.diag(np.ones(rank), -1)[: rank + 1, : rank + 1]  # a shift, at last of nothing
    f = np.eye(rank + 1)[0]
    z, _, rest = gmres(lambda v: A @ v, lambda v: v, f, 1e-12, 5)
    assert np.linalg.norm(f - A @ z - rest) < 1e-15
    assert np.linalg.norm(rest) == 1.0


def test_unknowns_may_be_numbered_anew():
    op, rng = operator(), np.random.default_rng(2)
    names, diagonal = np.flatnonzero(op.sought), op.diagonal[op.sought]
    factor, r = lagged(op), rng.normal(size=len(names))
    z = factor.preconditioner(names, diagonal)(r)
    order = rng.permutation(len(r))
    other = factor.preconditioner(names[order], diagonal[order])
    assert np.array_equal(other(r[order]), z[order])


def test_unknowns_that_the_factor_does_not_have_are_divided_and_it_forgets_what_is_gone():
    op, rng = operator(), np.random.default_rng(3)
    names, diagonal = np.flatnonzero(op.sought), op.diagonal[op.sought]
    factor, r = lagged(op), rng.normal(size=len(names))
    new = rng.random(len(r)) < 0.2
    z = factor.preconditioner(np.where(new, names + 10**6, names), diagonal)(r)
    assert np.array_equal(z[new], 1.0 / diagonal[new] * r[new])
    left_out = factor.preconditioner(names, diagonal)(np.where(new, 0.0, r))
    assert np.array_equal(z[~new], left_out[~new])
    # What one application leaves behind does not show in the next.
    fewer = factor.preconditioner(names[~new], diagonal[~new])
    assert np.array_equal(fewer(r[~new]), z[~new])


def test_an_unknown_that_the_factor_holds_at_zero_stays_so():
    op, rng = operator(), np.random.default_rng(4)
    names, inside = np.flatnonzero(op.sought), op.sought
    inside[names[7]] = False
    factor = Lagged(op.factor(inside), op.sought, np.arange(len(inside)))
    z = factor.preconditioner(names, op.diagonal[names])(rng.normal(size=len(names)))
    assert np.array_equal(np.flatnonzero(z == 0.0), [7])


@given(seed=st.integers(0, 10**6), change=st.floats(0.0, 0.05))
@settings(max_examples=8, deadline=None)
def test_old_factor_leads_to_the_solution_of_the_new_matrix(seed, change):
    old, new = operator(), operator(change=change, seed=seed)
    names = np.flatnonzero(old.sought)
    P = lagged(old).preconditioner(names, old.diagonal[names])
    r = np.random.default_rng(seed).normal(size=len(names))
    goal = 1e-10 * np.linalg.norm(r)
    z, _, rest = gmres(applied(new), P, r, goal, 80)
    assert np.linalg.norm(rest) <= 1.01 * goal
    assert np.linalg.norm(r - applied(new)(z)) <= 1.02 * goal
    exact = np.linalg.solve(dense(new), r)
    assert np.linalg.norm(z - exact) < 1e-7 * np.linalg.norm(exact)
