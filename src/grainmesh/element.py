"""Polynomials on a triangle: the basis of NGSolve at any place, and integrals of its products.

Places are barycentric, (q, 3), corners in rising order of their numbers: then one basis serves all
triangles. Unknowns are those of the corners, of the edges 01, 02 and 12, and of the inside.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import H1, SEGM, TRIG, GridFunction, IntegrationRule, Mesh
from numpy.typing import NDArray

Float = NDArray[np.float64]
Int = NDArray[np.int64]

PAIRS = np.array([[0, 1], [0, 2], [1, 2]])


@dataclass(frozen=True)
class Element:
    """Polynomials of order k >= 1; with a cubic bubble for k = 1, if so said (MINI)."""

    order: int
    bubble: bool = False

    @property
    def counts(self) -> tuple[int, int]:
        """Unknowns of an edge, and of the inside."""
        k = self.order
        return k - 1, int(self.bubble) if k == 1 else (k - 1) * (k - 2) // 2

    @property
    def degree(self) -> int:
        """Of the polynomials."""
        return 3 if self.bubble else self.order

    @cached_property
    def nodes(self) -> Float:
        """Places that tell the polynomials apart (l, 3)."""
        if self.bubble:
            return np.vstack([np.eye(3), np.full((1, 3), 1.0 / 3.0)])
        return lattice(self.order)[0]

    @cached_property
    def to_values(self) -> Float:
        """Values at the nodes from unknowns (l, l)."""
        return self.shape(self.nodes)

    @cached_property
    def from_values(self) -> Float:
        """Unknowns from values at the nodes (l, l)."""
        return np.asarray(np.linalg.inv(self.to_values), np.float64)

    @cached_property
    def ends(self) -> Int:
        """Shape functions that are not 0 on the edges 01, 02 and 12, its ends first (3, k + 1)."""
        per_edge = self.counts[0]
        own = 3 + np.arange(3)[:, None] * per_edge + np.arange(per_edge)
        return np.concatenate([PAIRS, own], axis=1)

    @cached_property
    def from_edge(self) -> Float:
        """Unknowns of an edge, its ends first, from values at k + 1 even places (k + 1, k + 1)."""
        s = np.linspace(0.0, 1.0, self.order + 1)
        shape = self.shape(np.stack([1.0 - s, s, np.zeros_like(s)], axis=1))
        return np.asarray(np.linalg.inv(shape[:, self.ends[0]]), np.float64)

    @cached_property
    def _coefficients(self) -> Float:
        """Those of monomials from unknowns (l, l)."""
        inside = 0.9 * self.nodes + 0.1 / 3.0  # NGSolve finds no triangle for a corner
        matrix = self._monomials(inside)
        return np.asarray(np.linalg.solve(matrix, _values_of_basis(self, inside)), np.float64)

    def shape(self, places: Float) -> Float:
        """Values of the basis (q, l)."""
        found: Float = self._monomials(places) @ self._coefficients
        return found

    def slope(self, places: Float) -> Float:
        """Derivatives by the second and third barycentric coordinate (q, l, 2)."""
        d = self._derivatives(places)
        found: Float = np.einsum("aqn,nl->qla", d[1:] - d[:1], self._coefficients)
        return found

    @cached_property
    def _powers(self) -> Int:
        """Those of the three coordinates in each monomial (3, l)."""
        if self.bubble:
            return np.column_stack([np.eye(3, dtype=np.int64), np.ones(3, np.int64)])
        k = self.order
        return np.array([(i, j, k - i - j) for i in range(k + 1) for j in range(k + 1 - i)]).T

    def _monomials(self, places: Float) -> Float:
        """A basis of the polynomials (q, l)."""
        a, b, c = self._raised(places)
        return (a * b * c).T

    def _derivatives(self, places: Float) -> Float:
        """Those of the monomials by the three coordinates (3, q, l)."""
        (a, b, c), (da, db, dc) = self._raised(places), self._raised(places, 1)
        return np.swapaxes(np.stack([da * b * c, a * db * c, a * b * dc]), 1, 2)

    def _raised(self, places: Float, less: int = 0) -> list[Float]:
        """The powers of each coordinate, or their derivatives if one `less`, three of (l, q)."""
        x = places.T
        up = np.ones((self.order + 1, *x.shape))
        for n in range(self.order):
            up[n + 1] = up[n] * x
        found = [up[np.maximum(power - less, 0), axis] for axis, power in enumerate(self._powers)]
        if not less:
            return found
        return [power[:, None] * part for power, part in zip(self._powers, found, strict=True)]


@lru_cache
def element(order: int, bubble: bool = False) -> Element:
    """The same element each time: what it has found out is kept."""
    return Element(order, bubble)


def lattice(parts: int) -> tuple[Float, Int]:
    """Even nodes (l, 3) of a triangle whose edges are cut, and small triangles of them (c, 3).

    Nodes as of a field of order `parts`: barycentric, corners first, then edges.
    """
    steps = range(1, parts)
    nodes = (parts * np.eye(3, dtype=int)).tolist()
    for a, b in PAIRS.tolist():
        for step in steps:
            node = [0, 0, 0]
            node[a], node[b] = parts - step, step
            nodes.append(node)
    nodes += [[parts - i - j, i, j] for i in steps for j in range(1, parts - i)]
    number = {(i, j): row for row, (_, i, j) in enumerate(nodes)}
    small = []
    for i in range(parts):
        for j in range(parts - i):
            small.append([number[i, j], number[i + 1, j], number[i, j + 1]])
            if i + j < parts - 1:
                small.append([number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]])
    return np.array(nodes) / parts, np.array(small)


@lru_cache
def rule(degree: int) -> tuple[Float, Float]:
    """Places (q, 3) and weights (q,), of sum 1, exact for polynomials of a degree."""
    found = IntegrationRule(TRIG, degree)
    b, c = np.array([point[:2] for point in found.points]).T
    # The corners of NGSolve's triangle are (1, 0), (0, 1), (0, 0).
    weights = np.array(found.weights)  # their sum is right to 1e-14 only
    return np.stack([b, c, 1.0 - b - c], axis=1), weights / weights.sum()


@lru_cache
def edge_rule(degree: int) -> tuple[Float, Float]:
    """Places (3, q, 3) on the edges 01, 02, 12 and weights (q,), of sum 1."""
    found = IntegrationRule(SEGM, degree)
    s = np.array([point[0] for point in found.points])
    places = np.zeros((3, len(s), 3))
    for row, (a, b) in enumerate(PAIRS):
        places[row, :, a], places[row, :, b] = 1.0 - s, s
    weights = np.array(found.weights)
    return places, weights / weights.sum()


@lru_cache
def at_rule(one: Element, degree: int) -> tuple[Float, Float, Float, Float]:
    """Places, values (q, l) and derivatives (q, l, 2) of the basis there, and weights of `rule`."""
    places, weights = rule(degree)
    return places, one.shape(places), one.slope(places), weights


@lru_cache
def at_edges(one: Element, degree: int) -> tuple[Float, Float, Float]:
    """Places, values of the basis there (3, q, l), and weights of `edge_rule`."""
    places, weights = edge_rule(degree)
    return places, one.shape(places.reshape(-1, 3)).reshape(*places.shape[:2], -1), weights


def _values_of_basis(kind: Element, places: Float) -> Float:
    """What NGSolve's basis is at places (q, 3) inside (q, l)."""
    ngmesh = NetgenMesh(dim=2)
    ngmesh.AddPoints(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    region = ngmesh.AddRegion("one", dim=2)
    ngmesh.AddElements(dim=2, index=region, data=np.array([[0, 1, 2]], np.int32), base=0)
    mesh = Mesh(ngmesh)
    space = H1(mesh, order=kind.order)
    if kind.bubble:
        space.SetOrder(TRIG, 3)
        space.Update()
    field, columns = GridFunction(space), []
    for unknown in range(space.ndof):
        field.vec[:] = 0.0
        field.vec[unknown] = 1.0
        columns.append([field(mesh(*x)) for x in places[:, 1:].tolist()])
    return np.array(columns).T


@lru_cache
def hats(one: Element) -> Float:
    """∫λ_c φ_i over a triangle of area 1 (l, 3)."""
    places, weights = rule(one.degree + 1)
    return np.ascontiguousarray(np.einsum("q,qc,qi->ic", weights, places, one.shape(places)))


@lru_cache
def tilts(one: Element) -> Float:
    """∫λ_c ∂_a φ_i over a triangle of area 1 (l, 3, 2)."""
    places, weights = rule(one.degree)
    return np.ascontiguousarray(np.einsum("q,qc,qia->ica", weights, places, one.slope(places)))


@lru_cache
def masses(one: Element) -> Float:
    """∫λ_c φ_i φ_j over a triangle of area 1 (l, l, 3)."""
    places, weights = rule(2 * one.degree + 1)
    phi = one.shape(places)
    return np.ascontiguousarray(np.einsum("q,qc,qi,qj->ijc", weights, places, phi, phi))


@lru_cache
def slopes(one: Element) -> Float:
    """∫λ_c ∂_a φ_i ∂_b φ_j over a triangle of area 1 (l, l, 3, 2, 2)."""
    places, weights = rule(2 * one.degree - 1)
    d = one.slope(places)
    found = np.einsum("q,qc,qia,qjb->ijcab", weights, places, d, d)
    return np.ascontiguousarray(found)


@lru_cache
def divergences(one: Element, other: Element) -> Float:
    """∫λ_c φ_j ∂_a q_i over a triangle of area 1, q of the other element (p, l, 3, 2)."""
    places, weights = rule(one.degree + other.degree)
    found = np.einsum("q,qc,qj,qia->ijca", weights, places, one.shape(places), other.slope(places))
    return np.ascontiguousarray(found)


__all__ = [
    "PAIRS", "Element", "at_edges", "at_rule", "divergences", "edge_rule", "element", "hats",
    "lattice", "masses", "rule", "slopes", "tilts",
]  # fmt: skip
