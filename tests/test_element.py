"""Polynomials on a triangle: those of NGSolve, to round-off."""

from math import factorial

import numpy as np
import pytest
from ngsolve import H1, TRIG, GridFunction, Mesh, grad, unit_square

from grainmesh.element import (
    PAIRS,
    Element,
    divergences,
    edge_rule,
    element,
    hats,
    lattice,
    masses,
    rule,
    slopes,
    tilts,
)  # fmt: skip

#: Order, and whether with a bubble.
KINDS = [(1, False), (1, True), (2, False), (3, False), (4, False), (5, False)]
EACH = pytest.mark.parametrize("one", [Element(*kind) for kind in KINDS], ids=str)


def monomial(a, b, c):
    """∫ of λ_0^a λ_1^b λ_2^c over a triangle of area 1, exact."""
    top = factorial(a) * factorial(b) * factorial(c)
    return 2.0 * top / factorial(a + b + c + 2)


@EACH
def test_basis_and_slopes_are_those_of_ngsolve_on_any_triangle(one):
    mesh = Mesh(unit_square.GenerateMesh(maxh=0.5))
    space = H1(mesh, order=one.order)
    if one.bubble:
        space.SetOrder(TRIG, 3)
        space.Update()
    field = GridFunction(space)
    at = np.asarray(mesh.ngmesh.Coordinates())[:, :2]
    weight = np.random.default_rng(0).dirichlet([2.0, 2.0, 2.0], 7)
    shape, slope = one.shape(weight), one.slope(weight)
    for t in list(mesh.Elements())[:6]:
        vertices = sorted(v.nr for v in t.vertices)
        corners = at[vertices]
        inverse = np.linalg.inv((corners[1:] - corners[:1]).T)  # ∇λ_1, ∇λ_2 by row
        places = mesh(*(weight @ corners).T)
        edges = [_edge(mesh, t, vertices[a], vertices[b]) for a, b in PAIRS]
        parts = *edges, t.faces[0]
        unknowns = [*vertices, *(u for part in parts for u in space.GetDofNrs(part))]
        for i, unknown in enumerate(unknowns):
            field.vec[:] = 0.0
            field.vec[unknown] = 1.0
            assert np.allclose(field(places).ravel(), shape[:, i], rtol=0.0, atol=1e-14)
            assert np.allclose(grad(field)(places), slope[:, i] @ inverse, rtol=0.0, atol=1e-12)


def _edge(mesh, t, a, b):
    """The edge of a triangle between two vertices."""
    return next(e for e in t.edges if {v.nr for v in mesh[e].vertices} == {a, b})


@EACH
def test_unknowns_of_edges_and_of_the_inside_vanish_elsewhere(one):
    # What continuity from triangle to triangle needs, to round-off.
    k, s = one.order, np.linspace(0.0, 1.0, 9)
    shared = 3 + 3 * (k - 1)
    assert np.abs(one.shape(np.eye(3))[:, :3] - np.eye(3)).max() < 1e-14
    for row, (a, b) in enumerate(PAIRS):
        edge = np.zeros((len(s), 3))
        edge[:, a], edge[:, b] = 1.0 - s, s
        shape = one.shape(edge)
        own = np.arange(3 + row * (k - 1), 3 + (row + 1) * (k - 1))
        alone = np.setdiff1d(np.arange(shared), [a, b, *own])
        assert np.abs(shape[:, alone]).max(initial=0.0) < 1e-14
        assert np.abs(shape[:, shared:]).max(initial=0.0) < 1e-14
        assert np.abs(shape[:, a] + shape[:, b] - 1.0).max() < 1e-14
        first = one.shape(np.stack([1.0 - s, s, 0.0 * s], axis=1))[:, 3 : 2 + k]
        assert np.abs(shape[:, own] - first).max(initial=0.0) < 1e-14


@EACH
def test_values_at_the_nodes_tell_the_polynomials(one):
    count = 3 + 3 * one.counts[0] + one.counts[1]
    assert one.nodes.shape == (count, 3)
    assert np.linalg.cond(one.to_values) < 1e4
    assert np.allclose(one.shape(one.nodes), one.to_values, rtol=0.0, atol=1e-14)
    assert element(one.order, one.bubble) is element(one.order, one.bubble)


@pytest.mark.parametrize("degree", range(13))
def test_rules_are_exact(degree):
    places, weight = rule(degree)
    assert weight.sum() == pytest.approx(1.0, rel=1e-15)
    assert places.sum(axis=1) == pytest.approx(1.0, abs=1e-15)
    for a in range(degree + 1):
        for b in range(degree + 1 - a):
            found = weight @ (places ** [a, b, degree - a - b]).prod(axis=1)
            assert found == pytest.approx(monomial(a, b, degree - a - b), rel=1e-12)
    edges, weight = edge_rule(degree)
    assert weight.sum() == pytest.approx(1.0, rel=1e-15)
    for row, (a, b) in enumerate(PAIRS):
        assert edges[row].sum(axis=1) == pytest.approx(1.0, abs=1e-15)
        assert not edges[row][:, 3 - a - b].any()
        assert weight @ edges[row][:, b] ** degree == pytest.approx(1.0 / (degree + 1), rel=1e-13)


@EACH
@pytest.mark.parametrize("other", [Element(1), Element(3)], ids=str)
def test_tables_are_integrals_of_products(one, other):
    # By a rule of far higher degree.
    places, weight = rule(20)
    phi, d, of_other = one.shape(places), one.slope(places), other.slope(places)
    args = weight, places, phi, phi
    assert np.allclose(masses(one), np.einsum("q,qc,qi,qj->ijc", *args), rtol=0.0, atol=1e-14)
    exact = np.einsum("q,qc,qia,qjb->ijcab", weight, places, d, d)
    assert np.allclose(slopes(one), exact, rtol=0.0, atol=1e-12)
    exact = np.einsum("q,qc,qj,qia->ijca", weight, places, phi, of_other)
    assert np.allclose(divergences(one, other), exact, rtol=0.0, atol=1e-13)
    assert masses(one)[:3, :3].sum() == pytest.approx(1.0, rel=1e-13)  # hats sum to 1
    assert np.allclose(hats(one), masses(one)[:3].sum(axis=0), rtol=0.0, atol=1e-14)
    assert np.allclose(tilts(other), divergences(one, other)[:, :3].sum(axis=1), atol=1e-13)


@EACH
def test_hats_come_first(one):
    # `integrals` counts on it.
    places = rule(7)[0]
    assert np.allclose(one.shape(places)[:, :3], places, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("parts", [1, 2, 3, 6])
def test_lattice_cuts_a_triangle_into_equal_ones(parts):
    nodes, small = lattice(parts)
    assert len(nodes) == (parts + 1) * (parts + 2) // 2
    assert len(np.unique(nodes.round(12), axis=0)) == len(nodes)
    assert np.array_equal(nodes[:3], np.eye(3))
    for row, (a, b) in enumerate(PAIRS):
        own = nodes[3 + row * (parts - 1) : 3 + (row + 1) * (parts - 1)]
        assert np.allclose(own[:, b], np.arange(1, parts) / parts)
        assert np.allclose(own[:, a], 1.0 - own[:, b])
    at = nodes[:, 1:][small]
    a, b = at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]
    assert np.allclose(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], 1.0 / parts**2)
    assert len(small) == parts**2
