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

from grainmesh.integrals import BLOCK
from grainmesh.spread import Kernel

Float = NDArray[np.float64]
Int = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Averaged:
    """The discs of Eq. (1).

    Parameters
    ----------
    kernel : Kernel
        Of the discs.
    E, S : (n,)
    """

    kernel: Kernel
    E: Float
    S: Float

    def force(self, slope: Float) -> Float:
        """Density, linear (m, 2), of the first of Eq. (1), from <∇p>_i (n, 2)."""
        return self.kernel.field(self.E[:, None] * slope)

    def flux(self, u: Float, slope: Float) -> Float:
        """What stands before ∇q in the second of Eq. (1), linear (m, 2), from <u>_i too."""
        return self.kernel.field(self.E[:, None] * u - self.S[:, None] * slope)


@njit(cache=True, nogil=True, fastmath={"contract"})
def within(
    inner: Float, rows: Int, outer: int, x: Float, y: Float,
    corner: Int, area: Float, f: Float, H: Float, order: int,
) -> Float:  # fmt: skip
    """Add ∫f·v to rows y of u, and find ∫φ_v u (m, 2), unknowns inside of triangles eliminated.

    `inner` is of `integrals.matrices`, which has left `outer` unknowns, H of `element.hats`.
    Unknowns inside are those that their rows give then: f is condensed, too.
    """
    found, more, count = np.zeros_like(f), inner.shape[1], len(H)
    n = outer + more
    X, L, B = np.zeros((n, BLOCK)), np.zeros((n, BLOCK)), np.ones((more, n, BLOCK))
    F, M, share = np.zeros((3, 2, BLOCK)), np.zeros((3, 2, BLOCK)), np.zeros(BLOCK)
    for first in range(0, len(corner), BLOCK):
        size = min(BLOCK, len(corner) - first)
        for b in range(size):
            e = first + b
            for c in range(3):
                for k in range(2):
                    F[c, k, b] = area[e] * f[corner[e, c], k]
            for i in range(outer):
                X[i, b] = x[rows[e, i]]
            for k in range(more):
                for i in range(outer + k + 1):
                    B[k, i, b] = inner[e, k, i]
        L[:outer] = 0.0
        for i in range(count):
            at, (h0, h1, h2) = 2 * i if i < 3 * order else 2 * i + n - 2 * count, H[i]
            for k in range(2):
                for b in range(BLOCK):
                    L[at + k, b] = h0 * F[0, k, b] + h1 * F[1, k, b] + h2 * F[2, k, b]
        for k in range(more - 1, -1, -1):
            for b in range(BLOCK):
                share[b] = L[outer + k, b] / B[k, outer + k, b]
            for i in range(outer + k):
                for b in range(BLOCK):
                    L[i, b] -= share[b] * B[k, i, b]
        for k in range(more):
            for b in range(BLOCK):
                share[b] = L[outer + k, b]
            for i in range(outer + k):
                for b in range(BLOCK):
                    share[b] += B[k, i, b] * X[i, b]
            for b in range(BLOCK):
                X[outer + k, b] = -share[b] / B[k, outer + k, b]
        M[:] = 0.0
        for i in range(count):
            at = 2 * i if i < 3 * order else 2 * i + n - 2 * count
            for c in range(3):
                for k in range(2):
                    for b in range(BLOCK):
                        M[c, k, b] += H[i, c] * X[at + k, b]
        for b in range(size):
            e = first + b
            for i in range(outer):
                y[rows[e, i]] += L[i, b]
            for c in range(3):
                for k in range(2):
                    found[corner[e, c], k] += area[e] * M[c, k, b]
    return found


@njit(cache=True)
def moments(corner: Int, rows: Int, area: Float, u: Float, H: Float, m: int) -> Float:
    """∫φ_v u (m, 2), H of `element.hats`, the adjoint of `integrals.spread`."""
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


__all__ = ["Averaged", "moments", "slopes", "spilled", "within"]
