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
    sought = op.sought
    return lambda z: sought * op.apply(sought * z)


def preconditioner(op, names, known=None):
    """A factor with these names, for these unknowns."""
    known = op.sought if known is None else known
    return lagged(op).preconditioner(known, names, op.diagonal)


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
    z, count, left = gmres(lambda v: A @ v, lambda v: v / 2.0, f, tolerance, n + 1)
    assert count <= n + 1
    assert left <= tolerance
    assert np.linalg.norm(f - A @ z) == pytest.approx(left, abs=1e-2 * tolerance)
    assert np.linalg.norm(z - np.linalg.solve(A, f)) < 100.0 * tolerance


@given(seed=st.integers(0, 10**6), most=st.integers(1, 6))
@settings(max_examples=20, deadline=None)
def test_gmres_that_stops_early_tells_what_is_left_and_has_the_least(seed, most):
    rng = np.random.default_rng(seed)
    A, f = rng.normal(size=(20, 20)), rng.normal(size=20)
    z, count, left = gmres(lambda v: A @ v, lambda v: v, f, 1e-12, most)
    assert count == most
    assert np.linalg.norm(f - A @ z) == pytest.approx(left, rel=1e-9)
    krylov = [f]
    for _ in range(most - 1):
        krylov.append(A @ krylov[-1] / np.linalg.norm(A @ krylov[-1]))
    basis = A @ np.linalg.qr(np.array(krylov).T)[0]
    best = f - basis @ np.linalg.lstsq(basis, f)[0]
    assert left == pytest.approx(np.linalg.norm(best), rel=1e-6)


def test_gmres_has_nothing_to_do_below_its_tolerance():
    z, count, left = gmres(lambda v: v / 0.0, lambda v: v / 0.0, np.full(4, 1e-3), 1.0, 5)
    assert (count, left) == (0, 2e-3)
    assert not z.any()


def test_unknowns_may_be_numbered_anew():
    op, rng = operator(), np.random.default_rng(2)
    names, known = np.arange(len(op.free)), op.sought
    factor, r = lagged(op), known * rng.normal(size=len(op.free))
    z = factor.preconditioner(known, names, op.diagonal)(r)
    order = rng.permutation(len(r))
    other = factor.preconditioner(known[order], names[order], op.diagonal[order])
    assert np.array_equal(other(r[order]), z[order])


def test_unknowns_that_the_factor_does_not_have_are_divided_and_it_forgets_what_is_gone():
    op, rng = operator(), np.random.default_rng(3)
    names, known, diagonal = np.arange(len(op.free)), op.sought, op.diagonal
    factor, r = lagged(op), known * rng.normal(size=len(op.free))
    new = (rng.random(len(r)) < 0.2) & known
    z = factor.preconditioner(known, np.where(new, names + 10**6, names), diagonal)(r)
    assert np.array_equal(z[new], 1.0 / diagonal[new] * r[new])
    left_out = factor.preconditioner(known, names, diagonal)(np.where(new, 0.0, r))
    assert np.array_equal(z[~new], left_out[~new])
    # What one application leaves behind does not show in the next.
    fewer = factor.preconditioner(known[~new], names[~new], diagonal[~new])
    assert np.array_equal(fewer(r[~new]), z[~new])


@given(seed=st.integers(0, 10**6), change=st.floats(0.0, 0.05))
@settings(max_examples=8, deadline=None)
def test_old_factor_leads_to_the_solution_of_the_new_matrix(seed, change):
    old, new = operator(), operator(change=change, seed=seed)
    P, sought = preconditioner(old, np.arange(len(old.free))), new.sought
    r = sought * np.random.default_rng(seed).normal(size=len(sought))
    goal = 1e-10 * np.linalg.norm(r)
    z, _, left = gmres(applied(new), P, r, goal, 80)
    assert left <= goal
    assert np.linalg.norm(r - applied(new)(z)) <= 1.01 * goal
    exact = np.linalg.solve(dense(new), r[sought])
    assert np.linalg.norm(z[sought] - exact) < 1e-7 * np.linalg.norm(exact)
