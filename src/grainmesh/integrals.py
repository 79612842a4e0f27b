"""Integrals over the triangles of a mesh: the inner loops of `navier`.

Corners (t, 3) rise; unknowns are kept by row, (size, 2) for velocity and (size,) for pressure, rows
(t, l); `gradient` (t, 2, 2) holds ∇λ_1 and ∇λ_2. Fields are linear between points, (m, c). Tables
are integrals over a triangle of area 1, by the functions of `element` that are named; `shape`
(q, l), `slope` (q, l, 2) and `weight` (q,) are of a rule of integration. The first three shape
functions are the hats λ.

`BLOCK` triangles go together: what they need is gathered, in columns of one triangle each, so that
the innermost loops run over columns, with the vector instructions of the machine; what comes out is
added row by row, in the order of the triangles. Columns that the last block leaves over hold
anything. Arrays of a block have capitals. Entries of tables become scalars before a loop over
columns: the compiler does not know that its results do not overlap the tables.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float = NDArray[np.float64]
Int = NDArray[np.int64]

#: Triangles that go together: few enough for the nearest cache.
BLOCK = 64


@njit(cache=True, inline="always")
def _gather(values: Float, rows: Int, first: int, X: Float) -> None:
    """Values (size, c) at the rows of a block, X (l, c, BLOCK)."""
    for b in range(min(BLOCK, len(rows) - first)):
        for i in range(X.shape[0]):
            row = rows[first + b, i]
            for c in range(X.shape[1]):
                X[i, c, b] = values[row, c]


@njit(cache=True, inline="always")
def _shapes(gradient: Float, first: int, D: Float) -> None:
    """∂_x λ_1, ∂_y λ_1, ∂_x λ_2 and ∂_y λ_2 of a block, D (4, BLOCK)."""
    for b in range(min(BLOCK, len(gradient) - first)):
        for k in range(2):
            for c in range(2):
                D[2 * k + c, b] = gradient[first + b, k, c]


@njit(cache=True, inline="always")
def _add(total: Float, rows: Int, first: int, area: Float, X: Float) -> None:
    """Add X (l, c, BLOCK), times area, to the rows (size, c) of a block."""
    for b in range(min(BLOCK, len(rows) - first)):
        for i in range(X.shape[0]):
            row = rows[first + b, i]
            for c in range(X.shape[1]):
                total[row, c] += area[first + b] * X[i, c, b]


@njit(cache=True)
def gradients(corners: Float) -> tuple[Float, Float]:
    """∇λ_1 and ∇λ_2 (t, 2, 2) [1/m], and area (t,) [m2], of triangles (t, 3, 2)."""
    t = len(corners)
    gradient, area = np.empty((t, 2, 2)), np.empty(t)
    for e in range(t):
        ax, ay = corners[e, 1, 0] - corners[e, 0, 0], corners[e, 1, 1] - corners[e, 0, 1]
        bx, by = corners[e, 2, 0] - corners[e, 0, 0], corners[e, 2, 1] - corners[e, 0, 1]
        twice = ax * by - ay * bx
        gradient[e, 0, 0], gradient[e, 0, 1] = by / twice, -bx / twice
        gradient[e, 1, 0], gradient[e, 1, 1] = -ay / twice, ax / twice
        area[e] = 0.5 * abs(twice)
    return gradient, area


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def matrices(
    corner: Int, gradient: Float, area: Float, outer: int,
    fields: Float, mu: Float, M: Float, T: Float, R: Float, P: Float, K: Float, inner: Float,
) -> None:  # fmt: skip
    """Symmetric matrices of navier, Eqs. (1) to (3), the last unknowns eliminated.

    Unknowns are u_x and u_y of the first `outer` shape functions in turn, then p, then the rest of
    u. `fields` are ε, c ρ ε/Δt + B, E and S, mu (t,) the viscosity; tables `masses`, `slopes`,
    `divergences`, and `slopes` of the pressure. K (t, left, left) is for the first unknowns; rows
    of the others, up to their diagonal, as they are once all behind them are eliminated, go to
    `inner` (t, n - left, n).
    """
    t, count, lp = len(corner), len(M), len(P)
    n, left = 2 * count + lp, K.shape[1]
    place = np.empty(count, np.int64)
    for i in range(count):
        place[i] = 2 * i if i < outer else 2 * i + lp
    D, X, share = np.zeros((4, BLOCK)), np.zeros((3, 4, BLOCK)), np.zeros(BLOCK)
    B = np.zeros((n, n, BLOCK))  # its lower half
    for first in range(0, t, BLOCK):
        size = min(BLOCK, t - first)
        _shapes(gradient, first, D)
        _gather(fields, corner, first, X)
        for b in range(size):
            for c in range(3):
                for k in range(4):
                    X[c, k, b] *= area[first + b]
                X[c, 0, b] *= mu[first + b]
        for i in range(count):
            row = place[i]
            for j in range(i + 1):
                column = place[j]
                m0, m1, m2 = M[i, j]
                (r00, r01), (r10, r11) = T[i, j, 0]
                (s00, s01), (s10, s11) = T[i, j, 1]
                (t00, t01), (t10, t11) = T[i, j, 2]
                for b in range(BLOCK):
                    mass = m0 * X[0, 1, b] + m1 * X[1, 1, b] + m2 * X[2, 1, b]
                    w0, w1, w2 = X[0, 0, b], X[1, 0, b], X[2, 0, b]
                    d00, d01 = w0 * r00 + w1 * s00 + w2 * t00, w0 * r01 + w1 * s01 + w2 * t01
                    d10, d11 = w0 * r10 + w1 * s10 + w2 * t10, w0 * r11 + w1 * s11 + w2 * t11
                    ax, ay, bx, by = D[0, b], D[1, b], D[2, b], D[3, b]
                    x0, x1 = ax * d00 + bx * d10, ax * d01 + bx * d11
                    y0, y1 = ay * d00 + by * d10, ay * d01 + by * d11
                    # ∫mu ε ∂φ_i ∂φ_j by x, x; x, y; y, x; y, y
                    xx, xy, yx, yy = (
                        x0 * ax + x1 * bx, x0 * ay + x1 * by, y0 * ax + y1 * bx, y0 * ay + y1 * by
                    )  # fmt: skip
                    both = mass + xx + yy  # Eq. (3)
                    B[row, column, b] = both + xx / 3.0
                    B[row + 1, column + 1, b] = both + yy / 3.0
                    B[row, column + 1, b] = yx - 2.0 / 3.0 * xy
                    B[row + 1, column, b] = xy - 2.0 / 3.0 * yx
        for i in range(lp):
            at = 2 * outer + i
            for j in range(count):
                (r00, r01), (r10, r11), (r20, r21) = R[i, j]
                row, column, step = (at, 2 * j, 0) if j < outer else (place[j], at, 1)
                for b in range(BLOCK):
                    d0 = X[0, 2, b] * r00 + X[1, 2, b] * r10 + X[2, 2, b] * r20
                    d1 = X[0, 2, b] * r01 + X[1, 2, b] * r11 + X[2, 2, b] * r21
                    B[row, column, b] = d0 * D[0, b] + d1 * D[2, b]
                    B[row + step, column + 1 - step, b] = d0 * D[1, b] + d1 * D[3, b]
            for j in range(i + 1):
                (r00, r01), (r10, r11) = P[i, j, 0]
                (s00, s01), (s10, s11) = P[i, j, 1]
                (t00, t01), (t10, t11) = P[i, j, 2]
                for b in range(BLOCK):
                    z0, z1, z2 = X[0, 3, b], X[1, 3, b], X[2, 3, b]
                    ax, ay, bx, by = D[0, b], D[1, b], D[2, b], D[3, b]
                    d00, d11 = z0 * r00 + z1 * s00 + z2 * t00, z0 * r11 + z1 * s11 + z2 * t11
                    cross = z0 * (r01 + r10) + z1 * (s01 + s10) + z2 * (t01 + t10)
                    B[at, 2 * outer + j, b] = -(
                        d00 * (ax * ax + ay * ay)
                        + cross * (ax * bx + ay * by)
                        + d11 * (bx * bx + by * by)
                    )
        for k in range(n - 1, left - 1, -1):
            for i in range(k):
                for b in range(BLOCK):
                    share[b] = B[k, i, b] / B[k, k, b]
                for j in range(i + 1):
                    for b in range(BLOCK):
                        B[i, j, b] -= share[b] * B[k, j, b]
        for b in range(size):
            for i in range(left):
                for j in range(i + 1):
                    value = B[i, j, b]
                    K[first + b, i, j] = value
                    K[first + b, j, i] = value
            for i in range(left, n):
                for j in range(i + 1):
                    inner[first + b, i - left, j] = B[i, j, b]


@njit(cache=True)
def condensed(inner: Float, rows: Int, f: Float) -> Float:
    """Right-hand side for the unknowns that `matrices` has left, from that for all."""
    f = f.copy()
    more, n = inner.shape[1:]
    taken = np.empty(n)
    for e in range(len(inner) if more else 0):
        taken[:] = 0.0
        for k in range(more - 1, -1, -1):
            at = n - more + k
            share = (f[rows[e, at]] - taken[at]) / inner[e, k, at]
            for i in range(at):
                taken[i] += share * inner[e, k, i]
        for i in range(n):
            f[rows[e, i]] -= taken[i]
    return f


@njit(cache=True)
def completed(inner: Float, rows: Int, f: Float, x: Float) -> None:
    """Put in the unknowns that `matrices` has taken out; f is of `condensed`."""
    more, n = inner.shape[1:]
    local = np.empty(n)
    for e in range(len(inner) if more else 0):
        for i in range(n - more):
            local[i] = x[rows[e, i]]
        for k in range(more):
            at = n - more + k
            value = f[rows[e, at]]
            for i in range(at):
                value -= inner[e, k, i] * local[i]
            local[at] = value / inner[e, k, at]
            x[rows[e, at]] = local[at]


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def product(K: Float, rows: Int, x: Float) -> Float:
    """K x of the first unknowns of each triangle, as many as K has."""
    outer = K.shape[1]
    y, local = np.zeros_like(x), np.empty(outer)
    for e in range(len(K)):
        for i in range(outer):
            local[i] = x[rows[e, i]]
        for i in range(outer):
            value = 0.0
            for j in range(outer):
                value += K[e, i, j] * local[j]
            y[rows[e, i]] += value
    return y


@njit(cache=True)
def diagonal(K: Float, rows: Int, first: int, size: int) -> Float:
    """That of A, and for pressures, from `first` on, of -S - B A⁻¹ Bᵀ, triangle by triangle."""
    found, outer = np.zeros(size), K.shape[1]
    for e in range(len(K)):
        for i in range(outer):
            value = K[e, i, i]
            if rows[e, i] >= first:
                for j in range(outer):
                    if rows[e, j] < first:
                        value -= K[e, i, j] ** 2 / K[e, j, j]
            found[rows[e, i]] += value
    return found


@njit(cache=True, fastmath={"contract"})
def spread(corner: Int, rows: Int, area: Float, f: Float, H: Float, size: int) -> Float:
    """∫f φ_i (size, c) of a field f (m, c), by `hats`."""
    found = np.zeros((size, f.shape[1]))
    for e in range(len(corner)):
        v0, v1, v2 = corner[e]
        for c in range(f.shape[1]):
            f0, f1, f2 = area[e] * f[v0, c], area[e] * f[v1, c], area[e] * f[v2, c]
            for i in range(len(H)):
                found[rows[e, i], c] += f0 * H[i, 0] + f1 * H[i, 1] + f2 * H[i, 2]
    return found


@njit(cache=True, fastmath={"contract"})
def weighted(corner: Int, rows: Int, area: Float, eps: Float, u: Float, M: Float) -> Float:
    """∫ε u φ_i (size, 2), for ε (m, 1), by `masses`."""
    found, count = np.zeros_like(u), len(M)
    E, U = np.zeros((3, 1, BLOCK)), np.zeros((count, 2, BLOCK))
    F = np.zeros((count, 2, BLOCK))
    for first in range(0, len(corner), BLOCK):
        _gather(eps, corner, first, E)
        _gather(u, rows, first, U)
        F[:] = 0.0
        for i in range(count):
            for j in range(count):
                m0, m1, m2 = M[i, j]
                for b in range(BLOCK):
                    m = m0 * E[0, 0, b] + m1 * E[1, 0, b] + m2 * E[2, 0, b]
                    F[i, 0, b] += m * U[j, 0, b]
                    F[i, 1, b] += m * U[j, 1, b]
        _add(found, rows, first, area, F)
    return found


@njit(cache=True, fastmath={"contract"})
def convected(
    corner: Int, rows: Int, gradient: Float, area: Float, fields: Float, u: Float,
    hat: Float, shape: Float, slope: Float, weight: Float,
) -> Float:  # fmt: skip
    """∫ε u (u - w)·∇φ_i and ∫ε (u - w)·∇φ_i (size, 3); `fields` are w and ε."""
    found, count = np.zeros((len(u), 3)), shape.shape[1]
    D, X, U = np.zeros((4, BLOCK)), np.zeros((3, 3, BLOCK)), np.zeros((count, 2, BLOCK))
    V, Q, F = np.zeros((2, BLOCK)), np.zeros((2, BLOCK)), np.zeros((count, 3, BLOCK))
    for first in range(0, len(corner), BLOCK):
        _shapes(gradient, first, D)
        _gather(fields, corner, first, X)
        _gather(u, rows, first, U)
        F[:] = 0.0
        for q in range(len(weight)):
            (h0, h1, h2), part = hat[q], weight[q]
            for c in range(2):  # u
                for b in range(BLOCK):
                    V[c, b] = h0 * U[0, c, b] + h1 * U[1, c, b] + h2 * U[2, c, b]
                for i in range(3, count):
                    s = shape[q, i]
                    for b in range(BLOCK):
                        V[c, b] += s * U[i, c, b]
            for b in range(BLOCK):
                x, y = V[0, b], V[1, b]
                eps = part * (h0 * X[0, 2, b] + h1 * X[1, 2, b] + h2 * X[2, 2, b])
                along = eps * (x - (h0 * X[0, 0, b] + h1 * X[1, 0, b] + h2 * X[2, 0, b]))
                up = eps * (y - (h0 * X[0, 1, b] + h1 * X[1, 1, b] + h2 * X[2, 1, b]))
                f, g = along * D[0, b] + up * D[1, b], along * D[2, b] + up * D[3, b]
                F[1, 0, b] += f * x
                F[1, 1, b] += f * y
                F[1, 2, b] += f
                F[2, 0, b] += g * x
                F[2, 1, b] += g * y
                F[2, 2, b] += g
                Q[0, b], Q[1, b] = f, g
            for i in range(3, count):
                s0, s1 = slope[q, i]
                for b in range(BLOCK):
                    through = s0 * Q[0, b] + s1 * Q[1, b]
                    F[i, 0, b] += through * V[0, b]
                    F[i, 1, b] += through * V[1, b]
                    F[i, 2, b] += through
        for c in range(3):  # λ_0 = 1 - λ_1 - λ_2
            for b in range(BLOCK):
                F[0, c, b] = -F[1, c, b] - F[2, c, b]
        _add(found, rows, first, area, F)
    return found


@njit(cache=True, fastmath={"contract"})
def averages(
    corner: Int, rows: Int, rows_p: Int, gradient: Float, area: Float, u: Float, p: Float, m: int,
    H: Float, L: Float, J: Float,
) -> Float:  # fmt: skip
    """Integrals of u, ∇p and ∇×u times the hats of the points (m, 5), p being (size_p, 1).

    Tables: `hats`, `tilts`, and `tilts` of the pressure.
    """
    found, count, lp = np.zeros((m, 5)), len(H), len(J)
    D, F = np.zeros((4, BLOCK)), np.zeros((3, 5, BLOCK))
    U, N = np.zeros((count, 2, BLOCK)), np.zeros((lp, 1, BLOCK))
    for first in range(0, len(corner), BLOCK):
        _shapes(gradient, first, D)
        _gather(u, rows, first, U)
        _gather(p, rows_p, first, N)
        F[:] = 0.0
        for c in range(3):
            for i in range(count):
                h, (s0, s1) = H[i, c], L[i, c]
                for b in range(BLOCK):
                    x, y = U[i, 0, b], U[i, 1, b]
                    F[c, 0, b] += h * x
                    F[c, 1, b] += h * y
                    F[c, 4, b] += s0 * (y * D[0, b] - x * D[1, b]) + s1 * (
                        y * D[2, b] - x * D[3, b]
                    )
            for i in range(lp):
                s0, s1 = J[i, c]
                for b in range(BLOCK):
                    F[c, 2, b] += N[i, 0, b] * (s0 * D[0, b] + s1 * D[2, b])
                    F[c, 3, b] += N[i, 0, b] * (s0 * D[1, b] + s1 * D[3, b])
        _add(found, corner, first, area, F)
    return found


@njit(cache=True)
def crossing(
    corner: Int, gradient: Float, area: Float, flow: Float, most: float, smooth: float
) -> float:
    """How fast flow (m, 2) crosses triangles: |u·∇λ|, mean around each point, the largest [1/s].

    Taken `most` times, but no more than u² times `smooth`.
    """
    crossed, whole = np.zeros(len(flow)), np.zeros(len(flow))
    least = area.min()
    for e in range(len(corner)):
        x = (flow[corner[e, 0], 0] + flow[corner[e, 1], 0] + flow[corner[e, 2], 0]) / 3.0
        y = (flow[corner[e, 0], 1] + flow[corner[e, 1], 1] + flow[corner[e, 2], 1]) / 3.0
        b = x * gradient[e, 0, 0] + y * gradient[e, 0, 1]
        c = x * gradient[e, 1, 0] + y * gradient[e, 1, 1]
        top = smooth * (x * x + y * y)
        for k, value in enumerate((-b - c, b, c)):
            crossed[corner[e, k]] += area[e] * min(most * abs(value), top)
            whole[corner[e, k]] += area[e]
    return (crossed / np.maximum(whole, least)).max()


@njit(cache=True)
def passing(
    corner: Int, gradient: Float, area: Float, speed: Float, n: int, way: float, share: float
) -> Float:
    """How fast discs, the first n points, pass their neighbours [1/s], at edges of triangles (e,).

    Relative speed over `way` [m], and over this share of the distance if one is no disc.
    """
    rate, count = np.empty(3 * len(corner)), 0
    for e in range(len(corner)):
        (ax, ay), (bx, by) = gradient[e, 0], gradient[e, 1]
        for k, (x, y) in enumerate(((ax, ay), (bx, by), (ax + bx, ay + by))):
            i, j = corner[e, k], corner[e, k - 1]
            if i >= n and j >= n:
                continue
            u, v = speed[i, 0] - speed[j, 0], speed[i, 1] - speed[j, 1]
            free = way
            if i >= n or j >= n:  # (x, y) is ∇λ of the corner opposite
                free = share * 2.0 * area[e] * np.sqrt(x * x + y * y)
            rate[count] = np.sqrt(u * u + v * v) / free
            count += 1
    return rate[:count]


@njit(cache=True)
def roughness(corner: Int, gradient: Float, area: Float, flow: Float) -> Float:
    """Largest speed of a flow (m, 2) at the corners times the longest edge [m2/s], (t,)."""
    found = np.empty(len(corner))
    for e in range(len(corner)):
        (ax, ay), (bx, by), speed = gradient[e, 0], gradient[e, 1], 0.0
        longest = max(ax * ax + ay * ay, bx * bx + by * by, (ax + bx) ** 2 + (ay + by) ** 2)
        for k in range(3):
            v = corner[e, k]
            speed = max(speed, flow[v, 0] ** 2 + flow[v, 1] ** 2)
        found[e] = 2.0 * area[e] * np.sqrt(longest * speed)
    return found


def at_sides(
    edges: Int, corner: Int, rows: Int, gradient: Float, area: Float, eps: Float, u: Float,
    hat: Float, shape: Float, weight: Float,
) -> tuple[Any, Any, Any]:  # fmt: skip
    """Velocity u (b, q, 2), ε (b, q) and n weight |L| (b, q, 2) on edges (b, 2) of triangles.

    Edges are numbers of a triangle, and 0, 1 or 2 for its edge 01, 02 or 12; n points out.
    """
    t, k = edges.T
    third = np.concatenate([-gradient.sum(axis=1, keepdims=True), gradient], axis=1)
    out = -2.0 * (area[:, None, None] * third)[t, 2 - k]
    e = np.einsum("bqc,bc->bq", hat[k], eps[corner[t]])
    velocity = np.einsum("bql,blc->bqc", shape[k], u[rows[t]])
    return velocity, e, out[:, None] * weight[:, None]


__all__ = [
    "at_sides", "averages", "completed", "condensed", "convected", "crossing", "diagonal",
    "gradients", "matrices", "passing", "product", "roughness", "spread", "weighted",
]  # fmt: skip
