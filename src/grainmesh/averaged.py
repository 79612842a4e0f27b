r"""What discs that have been eliminated add to the equations of a flow: products of averages.

A disc i that the flow drags and pushes, and whose volume flows with it, is known by the averages of
u and ∇p over its kernel ψ_i (`grainmesh.coupling`). Taken out, it leaves, for test functions v, q,

    sum_i E_i <∇p>_i·<v>_i,    sum_i (E_i <u>_i - S_i <∇p>_i)·<∇q>_i,    <f>_i = ∫ψ_i f.       (1)

This is symmetric, and full in a neighbourhood of each disc, so it is applied, never stored. ψ_i is
linear on the triangles: averages are those of integrals against the hats φ_v.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from grainmesh.spread import Spread

Float = NDArray[np.float64]
Int = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Averaged:
    """The discs of Eq. (1).

    Parameters
    ----------
    spread : Spread
        Of the discs.
    hats : (m,)
        Integrals of the hats, 1 for points that are no vertex [m2].
    E, S : (n,)
    """

    spread: Spread
    hats: Float
    E: Float
    S: Float

    def mean(self, moments: Float) -> Float:
        """<f>_i (n, 2) from ∫φ_v f (m, 2)."""
        return self.spread.means(moments / self.hats[:, None])

    def force(self, slope: Float) -> Float:
        """Density, linear (m, 2), of the first of Eq. (1), from <∇p>_i (n, 2)."""
        return self._field(self.E[:, None] * slope)

    def flux(self, u: Float, slope: Float) -> Float:
        """What stands before ∇q in the second of Eq. (1), linear (m, 2), from <u>_i too."""
        return self._field(self.E[:, None] * u - self.S[:, None] * slope)

    def _field(self, values: Float) -> Float:
        return self.spread.sums(values) / self.hats[:, None]


@njit(cache=True, fastmath={"contract", "reassoc"})
def product(
    K: Float, inner: Float, rows: Int, x: Float,
    corner: Int, area: Float, f: Float, H: Float, order: int,
) -> tuple[Float, Float]:  # fmt: skip
    """K x with ∫f·v in rows of u, and ∫φ_v u (m, 2), unknowns inside of triangles eliminated.

    K and `inner` are of `integrals.matrices`, H of `element.hats`. Unknowns inside are those that
    their rows give then: f is condensed, too.
    """
    y, found = np.zeros_like(x), np.zeros_like(f)
    outer, more, count = K.shape[1], inner.shape[1], len(H)
    place = np.empty(count, np.int64)
    for i in range(count):
        place[i] = 2 * i if i < 3 * order else 2 * i + outer + more - 2 * count
    local, load = np.empty(outer + more), np.zeros(outer + more)
    for e in range(len(K)):
        for i in range(outer):
            local[i], load[i] = x[rows[e, i]], 0.0
        for k in range(2):
            f0, f1, f2 = (
                area[e] * f[corner[e, 0], k],
                area[e] * f[corner[e, 1], k],
                area[e] * f[corner[e, 2], k],
            )
            for i in range(count):
                load[place[i] + k] = H[i, 0] * f0 + H[i, 1] * f1 + H[i, 2] * f2
        for k in range(more - 1, -1, -1):
            share = load[outer + k] / inner[e, k, outer + k]
            for i in range(outer + k):
                load[i] -= share * inner[e, k, i]
        for i in range(outer):
            value = load[i]
            for j in range(outer):
                value += K[e, i, j] * local[j]
            y[rows[e, i]] += value
        for k in range(more):
            value = load[outer + k]
            for i in range(outer + k):
                value += inner[e, k, i] * local[i]
            local[outer + k] = -value / inner[e, k, outer + k]
        for c in range(3):
            u = v = 0.0
            for i in range(count):
                u += H[i, c] * local[place[i]]
                v += H[i, c] * local[place[i] + 1]
            found[corner[e, c], 0] += area[e] * u
            found[corner[e, c], 1] += area[e] * v
    return y, found


@njit(cache=True)
def moments(corner: Int, rows: Int, area: Float, u: Float, H: Float, m: int) -> Float:
    """∫φ_v u (m, 2), H of `element.hats`."""
    found = np.zeros((m, 2))
    for e in range(len(corner)):
        for c in range(3):
            x = y = 0.0
            for i in range(len(H)):
                x += H[i, c] * u[rows[e, i], 0]
                y += H[i, c] * u[rows[e, i], 1]
            found[corner[e, c], 0] += area[e] * x
            found[corner[e, c], 1] += area[e] * y
    return found


@njit(cache=True)
def loads(corner: Int, rows: Int, area: Float, f: Float, H: Float, size: int) -> Float:
    """∫f·v (size, 2) of a linear field (m, 2), the adjoint of `moments`."""
    found = np.zeros((size, 2))
    for e in range(len(corner)):
        for i in range(len(H)):
            x = y = 0.0
            for c in range(3):
                x += H[i, c] * f[corner[e, c], 0]
                y += H[i, c] * f[corner[e, c], 1]
            found[rows[e, i], 0] += area[e] * x
            found[rows[e, i], 1] += area[e] * y
    return found


@njit(cache=True)
def slopes(
    corner: Int, rows: Int, gradient: Float, area: Float, p: Float, D: Float, m: int
) -> Float:
    """∫φ_v ∇p (m, 2), D of `element.tilts`."""
    found = np.zeros((m, 2))
    for e in range(len(corner)):
        for c in range(3):
            a = b = 0.0
            for i in range(len(D)):
                a += D[i, c, 0] * p[rows[e, i]]
                b += D[i, c, 1] * p[rows[e, i]]
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
        for i in range(len(D)):
            value = 0.0
            for c in range(3):
                v = corner[e, c]
                a = g[v, 0] * gradient[e, 0, 0] + g[v, 1] * gradient[e, 0, 1]
                b = g[v, 0] * gradient[e, 1, 0] + g[v, 1] * gradient[e, 1, 1]
                value += D[i, c, 0] * a + D[i, c, 1] * b
            found[rows[e, i]] += area[e] * value
    return found


__all__ = ["Averaged", "loads", "moments", "product", "slopes", "spilled"]
