r"""What discs that have been eliminated add to the equations of a flow: products of averages.

A disc i that the flow drags and pushes, and whose volume flows with it, is known by the averages of
u and ∇p over its kernel ψ_i (`grainmesh.coupling`). Taken out, it leaves, for test functions v, q,

    sum_i E_i <∇p>_i·<v>_i,    sum_i (E_i <u>_i - S_i <∇p>_i)·<∇q>_i,    <f>_i = ∫ψ_i f.       (1)

This is symmetric, and full in a neighbourhood of each disc, so it is applied, never stored. ψ_i is
linear on the triangles, sum_v share_iv φ_v: averages are those of integrals against the hats φ_v.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import csr_array

from grainmesh.element import Element, divergences, masses

Float = NDArray[np.float64]
Int = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Averaged:
    """The discs of Eq. (1).

    Parameters
    ----------
    share : csr_array (n, m)
        Values of ψ_i at the points [1/m2].
    E, S : (n,)
    """

    share: csr_array
    E: Float
    S: Float

    def force(self, slope: Float) -> Float:
        """Density, linear (m, 2), of the first of Eq. (1), from ∫φ_v ∇p (m, 2)."""
        found: Float = self.share.T @ (self.E[:, None] * (self.share @ slope))
        return found

    def flux(self, u: Float, slope: Float) -> Float:
        """What stands before ∇q in the second of Eq. (1), linear (m, 2), from ∫φ_v u too."""
        share, E, S = self.share, self.E[:, None], self.S[:, None]
        found: Float = share.T @ (E * (share @ u) - S * (share @ slope))
        return found


@lru_cache
def hats(one: Element, other: Element) -> tuple[Float, Float]:
    """∫λ_c φ_l (3, l) and ∫λ_c ∂_a q_l (3, p, 2) over a triangle of area 1."""
    against = np.ascontiguousarray(masses(one)[:3].sum(axis=2))
    slopes = np.ascontiguousarray(divergences(one, other)[:, :3].sum(axis=2).swapaxes(0, 1))
    return against, slopes


@njit(cache=True)
def product(
    K: Float, rows: Int, x: Float, outer: int,
    corner: Int, area: Float, f: Float, H: Float, order: int, between: int,
) -> tuple[Float, Float]:  # fmt: skip
    """Matrices condensed to `outer` unknowns times x, with ∫f·v in rows of u; and ∫φ_v u (m, 2).

    Unknowns inside of a triangle are those that its rows give then: f is condensed, too. After the
    first 3 `order` shape functions of u come the `between` ones of p.
    """
    y, found = np.zeros_like(x), np.zeros_like(f)
    n, count = rows.shape[1], H.shape[1]
    place = np.empty(count, np.int64)
    for i in range(count):
        place[i] = 2 * i if i < 3 * order else 2 * i + between
    local, load = np.empty(n), np.empty(n)
    for e in range(len(K)):
        for i in range(outer):
            local[i], load[i] = x[rows[e, i]], 0.0
        for i in range(count):
            h0, h1, h2 = area[e] * H[0, i], area[e] * H[1, i], area[e] * H[2, i]
            for k in range(2):
                load[place[i] + k] = (
                    h0 * f[corner[e, 0], k] + h1 * f[corner[e, 1], k] + h2 * f[corner[e, 2], k]
                )
        for k in range(n - 1, outer - 1, -1):
            share = load[k] / K[e, k, k]
            for i in range(k):
                load[i] -= share * K[e, k, i]
        for i in range(outer):
            value = load[i]
            for j in range(outer):
                value += K[e, i, j] * local[j]
            y[rows[e, i]] += value
        for k in range(outer, n):
            value = load[k]
            for i in range(k):
                value += K[e, k, i] * local[i]
            local[k] = -value / K[e, k, k]
        for i in range(count):
            u, v = area[e] * local[place[i]], area[e] * local[place[i] + 1]
            for c in range(3):
                found[corner[e, c], 0] += H[c, i] * u
                found[corner[e, c], 1] += H[c, i] * v
    return y, found


@njit(cache=True)
def moments(corner: Int, rows: Int, area: Float, u: Float, H: Float, m: int) -> Float:
    """∫φ_v u (m, 2), H of `hats`."""
    found = np.zeros((m, 2))
    for e in range(len(corner)):
        for c in range(3):
            x = y = 0.0
            for i in range(H.shape[1]):
                x += H[c, i] * u[rows[e, i], 0]
                y += H[c, i] * u[rows[e, i], 1]
            found[corner[e, c], 0] += area[e] * x
            found[corner[e, c], 1] += area[e] * y
    return found


@njit(cache=True)
def loads(corner: Int, rows: Int, area: Float, f: Float, H: Float, size: int) -> Float:
    """∫f·v (size, 2) of a linear field (m, 2), the adjoint of `moments`."""
    found = np.zeros((size, 2))
    for e in range(len(corner)):
        for i in range(H.shape[1]):
            x = y = 0.0
            for c in range(3):
                x += H[c, i] * f[corner[e, c], 0]
                y += H[c, i] * f[corner[e, c], 1]
            found[rows[e, i], 0] += area[e] * x
            found[rows[e, i], 1] += area[e] * y
    return found


@njit(cache=True)
def slopes(
    corner: Int, rows: Int, gradient: Float, area: Float, p: Float, D: Float, m: int
) -> Float:
    """∫φ_v ∇p (m, 2), D of `hats`."""
    found = np.zeros((m, 2))
    for e in range(len(corner)):
        for c in range(3):
            a = b = 0.0
            for i in range(D.shape[1]):
                a += D[c, i, 0] * p[rows[e, i]]
                b += D[c, i, 1] * p[rows[e, i]]
            for k in range(2):
                found[corner[e, c], k] += area[e] * (a * gradient[e, 0, k] + b * gradient[e, 1, k])
    return found


@njit(cache=True)
def spilled(
    corner: Int, rows: Int, gradient: Float, area: Float, g: Float, D: Float, size: int
) -> Float:
    """∫g·∇q (size,) of a linear field (m, 2), the adjoint of `slopes`."""
    found = np.zeros(size)
    for e in range(len(corner)):
        for i in range(D.shape[1]):
            value = 0.0
            for c in range(3):
                v = corner[e, c]
                a = g[v, 0] * gradient[e, 0, 0] + g[v, 1] * gradient[e, 0, 1]
                b = g[v, 0] * gradient[e, 1, 0] + g[v, 1] * gradient[e, 1, 1]
                value += D[c, i, 0] * a + D[c, i, 1] * b
            found[rows[e, i]] += area[e] * value
    return found


__all__ = ["Averaged", "hats", "loads", "moments", "product", "slopes", "spilled"]
