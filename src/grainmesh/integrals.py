"""Integrals over the triangles of a mesh, one after the other: the inner loops of `navier`.

Corners (t, 3) rise; unknowns are kept by row, (size, 2) for velocity and (size,) for pressure;
`gradient` (t, 2, 2) holds ∇λ_1 and ∇λ_2. Fields `eps`, `E`, ... are linear between points, (m,) or
(m, 2). `shape` (q, l), `slope` (q, l, 2) and `weight` (q,) are of a rule of integration.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float = NDArray[np.float64]
Int = NDArray[np.int64]


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


@njit(cache=True)
def matrices(
    corner: Int, gradient: Float, area: Float, outer: int,
    inertia: Float, eps: Float, mu: Float, E: Float, S: Float,
    M: Float, T: Float, R: Float, P: Float,
) -> Float:  # fmt: skip
    """Symmetric matrices (t, n, n) of navier, Eqs. (1) to (3).

    Unknowns are u_x and u_y of the first `outer` shape functions in turn, then p, then the rest of
    u; mu (t,) is the viscosity; M, T, R, P are `masses`, `slopes` and `divergences` of `element`.
    """
    t, count, lp = len(corner), len(M), len(P)
    n = 2 * count + lp
    K = np.zeros((t, n, n))
    place = np.empty(count, np.int64)
    for i in range(count):
        place[i] = 2 * i if i < outer else 2 * i + lp
    for e in range(t):
        v0, v1, v2 = corner[e]
        ax, ay, bx, by = gradient[e, 0, 0], gradient[e, 0, 1], gradient[e, 1, 0], gradient[e, 1, 1]
        A = area[e]
        m0, m1, m2 = A * inertia[v0], A * inertia[v1], A * inertia[v2]
        w = A * mu[e]
        e0, e1, e2 = w * eps[v0], w * eps[v1], w * eps[v2]
        for i in range(count):
            row = place[i]
            for j in range(i + 1):
                column = place[j]
                mass = m0 * M[i, j, 0] + m1 * M[i, j, 1] + m2 * M[i, j, 2]
                t00 = e0 * T[i, j, 0, 0, 0] + e1 * T[i, j, 1, 0, 0] + e2 * T[i, j, 2, 0, 0]
                t01 = e0 * T[i, j, 0, 0, 1] + e1 * T[i, j, 1, 0, 1] + e2 * T[i, j, 2, 0, 1]
                t10 = e0 * T[i, j, 0, 1, 0] + e1 * T[i, j, 1, 1, 0] + e2 * T[i, j, 2, 1, 0]
                t11 = e0 * T[i, j, 0, 1, 1] + e1 * T[i, j, 1, 1, 1] + e2 * T[i, j, 2, 1, 1]
                # ∫mu ε ∂φ_i ∂φ_j by x, x; x, y; y, x; y, y
                xx = t00 * ax * ax + t01 * ax * bx + t10 * bx * ax + t11 * bx * bx
                xy = t00 * ax * ay + t01 * ax * by + t10 * bx * ay + t11 * bx * by
                yx = t00 * ay * ax + t01 * ay * bx + t10 * by * ax + t11 * by * bx
                yy = t00 * ay * ay + t01 * ay * by + t10 * by * ay + t11 * by * by
                both = mass + xx + yy  # Eq. (3)
                K[e, row, column] = both + xx / 3.0
                K[e, row + 1, column + 1] = both + yy / 3.0
                K[e, row, column + 1] = yx - 2.0 / 3.0 * xy
                K[e, row + 1, column] = xy - 2.0 / 3.0 * yx
                K[e, column, row] = K[e, row, column]
                K[e, column + 1, row + 1] = K[e, row + 1, column + 1]
                K[e, column + 1, row] = K[e, row, column + 1]
                K[e, column, row + 1] = K[e, row + 1, column]
        e0, e1, e2 = A * E[v0], A * E[v1], A * E[v2]
        s0, s1, s2 = A * S[v0], A * S[v1], A * S[v2]
        for i in range(lp):
            row = 2 * outer + i
            for j in range(count):
                r0 = e0 * R[i, j, 0, 0] + e1 * R[i, j, 1, 0] + e2 * R[i, j, 2, 0]
                r1 = e0 * R[i, j, 0, 1] + e1 * R[i, j, 1, 1] + e2 * R[i, j, 2, 1]
                for c in range(2):
                    value = r0 * gradient[e, 0, c] + r1 * gradient[e, 1, c]
                    K[e, row, place[j] + c] = value
                    K[e, place[j] + c, row] = value
            for j in range(i + 1):
                value = 0.0
                for a in range(2):
                    for b in range(2):
                        p = s0 * P[i, j, 0, a, b] + s1 * P[i, j, 1, a, b] + s2 * P[i, j, 2, a, b]
                        value -= p * (
                            gradient[e, a, 0] * gradient[e, b, 0]
                            + gradient[e, a, 1] * gradient[e, b, 1]
                        )
                K[e, row, 2 * outer + j] = value
                K[e, 2 * outer + j, row] = value
    return K


@njit(cache=True)
def condense(K: Float, outer: int) -> None:
    """Eliminate, in place, all unknowns from `outer` on: the last first."""
    n = K.shape[1]
    for e in range(len(K)):
        for k in range(n - 1, outer - 1, -1):
            for i in range(k):
                share = K[e, i, k] / K[e, k, k]
                for j in range(k):
                    K[e, i, j] -= share * K[e, k, j]


@njit(cache=True)
def condensed(K: Float, rows: Int, f: Float, outer: int) -> Float:
    """Right-hand side for the unknowns that `condense` has left."""
    f = f.copy()
    n = K.shape[1]
    for e in range(len(K)):
        for k in range(n - 1, outer - 1, -1):
            share = f[rows[e, k]] / K[e, k, k]
            for i in range(k):
                f[rows[e, i]] -= share * K[e, k, i]
    return f


@njit(cache=True)
def completed(K: Float, rows: Int, f: Float, x: Float, outer: int) -> None:
    """Put in the unknowns that `condense` has taken out; f is of `condensed`."""
    n = K.shape[1]
    for e in range(len(K)):
        for k in range(outer, n):
            value = f[rows[e, k]]
            for i in range(k):
                value -= K[e, k, i] * x[rows[e, i]]
            x[rows[e, k]] = value / K[e, k, k]


@njit(cache=True)
def entries(K: Float, rows: Int, number: Int, count: int) -> tuple[Any, Any, Float, Float]:
    """Entries i >= j of the sum of matrices (t, n, n), some more than once, and its diagonal.

    `number` (N,) is -1 for unknowns that are left out.
    """
    n, size = rows.shape[1], 0
    local, diagonal = np.empty(n, np.int64), np.zeros(count)
    for e in range(len(rows)):
        known = 0
        for i in range(n):
            known += number[rows[e, i]] >= 0
        size += known * (known + 1) // 2
    row, column, value = np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size)
    size = 0
    for e in range(len(rows)):
        for i in range(n):
            local[i] = number[rows[e, i]]
        for i in range(n):
            if local[i] >= 0:
                diagonal[local[i]] += K[e, i, i]
                for j in range(i + 1):
                    if local[j] >= 0:
                        row[size] = max(local[i], local[j])
                        column[size] = min(local[i], local[j])
                        value[size] = K[e, i, j]
                        size += 1
    return row, column, value, diagonal


@njit(cache=True)
def weighted(corner: Int, rows: Int, area: Float, eps: Float, u: Float, M: Float) -> Float:
    """∫ε u φ_i, (size, c)."""
    found = np.zeros_like(u)
    size, parts = len(M), u.shape[1]
    for e in range(len(corner)):
        e0, e1, e2 = eps[corner[e, 0]], eps[corner[e, 1]], eps[corner[e, 2]]
        for i in range(size):
            row = rows[e, i]
            for j in range(size):
                m = area[e] * (e0 * M[i, j, 0] + e1 * M[i, j, 1] + e2 * M[i, j, 2])
                for c in range(parts):
                    found[row, c] += m * u[rows[e, j], c]
    return found


@njit(cache=True)
def convected(
    corner: Int, rows: Int, gradient: Float, area: Float, eps: Float, u: Float, w: Float,
    hat: Float, shape: Float, slope: Float, weight: Float,
) -> tuple[Float, Float]:  # fmt: skip
    """∫ε u (u - w)·∇φ_i (size, 2) and ∫ε (u - w)·∇φ_i (size,)."""
    C, drained = np.zeros_like(u), np.zeros(len(u))
    count = shape.shape[1]
    for e in range(len(corner)):
        v0, v1, v2 = corner[e]
        for q in range(len(weight)):
            x = y = 0.0
            for i in range(count):
                x += shape[q, i] * u[rows[e, i], 0]
                y += shape[q, i] * u[rows[e, i], 1]
            h0, h1, h2 = hat[q]
            flux = area[e] * weight[q] * (h0 * eps[v0] + h1 * eps[v1] + h2 * eps[v2])
            along = x - (h0 * w[v0, 0] + h1 * w[v1, 0] + h2 * w[v2, 0])
            up = y - (h0 * w[v0, 1] + h1 * w[v1, 1] + h2 * w[v2, 1])
            a = flux * (along * gradient[e, 0, 0] + up * gradient[e, 0, 1])
            b = flux * (along * gradient[e, 1, 0] + up * gradient[e, 1, 1])
            for i in range(count):
                crossing = a * slope[q, i, 0] + b * slope[q, i, 1]
                row = rows[e, i]
                C[row, 0] += crossing * x
                C[row, 1] += crossing * y
                drained[row] += crossing
    return C, drained


@njit(cache=True)
def averages(
    corner: Int, rows: Int, rows_p: Int, gradient: Float, area: Float, u: Float, p: Float, m: int,
    hat: Float, shape: Float, slope: Float, slope_p: Float, weight: Float,
) -> Float:  # fmt: skip
    """Integrals of u, ∇p and ∇×u times the hats of the points (m, 5)."""
    found = np.zeros((m, 5))
    count, lp = shape.shape[1], slope_p.shape[1]
    for e in range(len(corner)):
        ax, ay, bx, by = gradient[e, 0, 0], gradient[e, 0, 1], gradient[e, 1, 0], gradient[e, 1, 1]
        for q in range(len(weight)):
            w = area[e] * weight[q]
            x = y = a = b = xa = xb = ya = yb = 0.0
            for i in range(count):
                ux, uy = u[rows[e, i], 0], u[rows[e, i], 1]
                x += shape[q, i] * ux
                y += shape[q, i] * uy
                xa += slope[q, i, 0] * ux
                xb += slope[q, i, 1] * ux
                ya += slope[q, i, 0] * uy
                yb += slope[q, i, 1] * uy
            for i in range(lp):
                a += slope_p[q, i, 0] * p[rows_p[e, i]]
                b += slope_p[q, i, 1] * p[rows_p[e, i]]
            curl = ya * ax + yb * bx - xa * ay - xb * by
            for c in range(3):
                s = w * hat[q, c]
                v = corner[e, c]
                found[v, 0] += s * x
                found[v, 1] += s * y
                found[v, 2] += s * (a * ax + b * bx)
                found[v, 3] += s * (a * ay + b * by)
                found[v, 4] += s * curl
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
def passing(corner: Int, places: Float, speed: Float, n: int, way: float, share: float) -> Float:
    """How fast discs, the first n points, pass their neighbours [1/s], at edges of triangles (e,).

    Relative speed over `way` [m], and over this share of the distance if one is no disc.
    """
    rate, count = np.empty(3 * len(corner)), 0
    for e in range(len(corner)):
        for k in range(3):
            i, j = corner[e, k], corner[e, k - 1]
            if i >= n and j >= n:
                continue
            u, v = speed[i, 0] - speed[j, 0], speed[i, 1] - speed[j, 1]
            free = way
            if i >= n or j >= n:
                x = places[e, k, 0] - places[e, k - 1, 0]
                y = places[e, k, 1] - places[e, k - 1, 1]
                free = share * np.sqrt(x * x + y * y)
            rate[count] = np.sqrt(u * u + v * v) / free
            count += 1
    return rate[:count]


@njit(cache=True)
def roughness(corner: Int, gradient: Float, area: Float, flow: Float) -> Float:
    """Largest speed of a flow (m, 2) at the corners times the longest edge [m2/s], (t,)."""
    found = np.empty(len(corner))
    for e in range(len(corner)):
        longest = speed = 0.0
        third = gradient[e, 0] + gradient[e, 1]
        for g in (gradient[e, 0], gradient[e, 1], third):
            longest = max(longest, g[0] ** 2 + g[1] ** 2)
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
    "at_sides", "averages", "completed", "condense", "condensed", "convected", "crossing",
    "entries", "gradients", "matrices", "passing", "roughness", "weighted",
]  # fmt: skip
