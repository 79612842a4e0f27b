"""Signs of determinants that round-off cannot turn.

A site (i, p, q) is the image of point i that lies at x_i + (p L_x, q L_y), with the period L, or 0
in a box with walls. With the differences seen from one of the sites, here d,

    ξ_j = x_j - x_d + (p_j - p_d) L_x,    η_j = y_j - y_d + (q_j - q_d) L_y,                  (1)
    ζ_j = ξ_j² + η_j² - w_j + w_d,                                                            (2)

three sites turn left if and only if

    | ξ_a  η_a |
    | ξ_b  η_b |  > 0    (seen from c),                                                       (3)

and, if a, b, c turn left, d lies inside the circle orthogonal to the three circles of centres
x_j and radii √w_j (their circumcircle if all weights are equal: w_d counts) if and only if

    | ξ_a  η_a  ζ_a |
    | ξ_b  η_b  ζ_b |  > 0.                                                                   (4)
    | ξ_c  η_c  ζ_c |

The determinant is taken in doubles first. With u = 2^-53 and X = |x_j - x_d| + |(p_j - p_d) L_x|,
the difference (1) is wrong by at most 2u X; products and sums add up to at most 6u (3) and 16u (4)
times the same determinant with X, Y, Z = X² + Y² + |w_d - w_j| for ξ, η, ζ and only plus signs, to
first order in u. Within a bound somewhat larger than that the sign is in doubt. It then comes from
exact arithmetic with expansions, sums of doubles none of which overlaps another, see J. R. Shewchuk
(Discrete & Computational Geometry 18 (1997) 305): their products and sums are expansions again, and
the largest term has the sign of all. So a sign depends on the sites only, not on their order nor on
the image they are seen from, and a tie is a tie.

This holds if all lengths (coordinates, periods, √w) that are not zero lie between 1e-60 and
1e70 m, so that nothing under- or overflows. The sign with a site that is not finite is 0.
"""

from __future__ import annotations

import numpy as np
from numba import njit

#: Unit round-off u of a double.
ROUND_OFF = 2.0**-53
#: Bounds of the error of Eqs. (3) and (4), proven 6u and 16u, with room for the terms in u².
ORIENTATION_BOUND, CIRCLE_BOUND = 8.0 * ROUND_OFF, 20.0 * ROUND_OFF
#: 2^27 + 1 cuts a double into two halves of 26 bits (Dekker).
SPLITTER = 134217729.0


@njit(cache=True, forceinline=True)
def orientation(points, period, a, b, c):  # type: ignore[no-untyped-def]
    """Sign of the area of the triangle of three sites, Eq. (3).

    Parameters
    ----------
    points : (m, 2)
        Coordinates [m].
    period : (2,)
        Period L of the images [m].
    a, b, c : tuple of int
        Sites (i, p, q).

    Returns
    -------
    int
        1 if the sites turn left, -1 if they turn right, 0 if they lie on a line.
    """
    ax, ax_most = _difference(points, period, a, c, 0)
    ay, ay_most = _difference(points, period, a, c, 1)
    bx, bx_most = _difference(points, period, b, c, 0)
    by, by_most = _difference(points, period, b, c, 1)
    det = ax * by - ay * bx  # Eq. (3)
    if abs(det) > ORIENTATION_BOUND * (ax_most * by_most + ay_most * bx_most):
        return 1 if det > 0.0 else -1
    return _exact_orientation(points, period, a, b, c)


@njit(cache=True, forceinline=True)
def in_circle(points, weight, period, a, b, c, d):  # type: ignore[no-untyped-def]
    """Sign that tells whether site d lies inside the power circle of three others, Eq. (4).

    Parameters
    ----------
    points : (m, 2)
        Coordinates [m].
    weight : (m,)
        Power weights [m2], r_i² for discs.
    period : (2,)
        Period L of the images [m].
    a, b, c, d : tuple of int
        Sites (i, p, q), the first three in an order that turns left.

    Returns
    -------
    int
        1 if d lies inside, -1 if it lies outside, 0 if it lies on the circle.
    """
    ax, ax_most = _difference(points, period, a, d, 0)
    ay, ay_most = _difference(points, period, a, d, 1)
    bx, bx_most = _difference(points, period, b, d, 0)
    by, by_most = _difference(points, period, b, d, 1)
    cx, cx_most = _difference(points, period, c, d, 0)
    cy, cy_most = _difference(points, period, c, d, 1)
    wa = weight[d[0]] - weight[a[0]]
    wb = weight[d[0]] - weight[b[0]]
    wc = weight[d[0]] - weight[c[0]]
    az, az_most = ax * ax + ay * ay + wa, ax_most * ax_most + ay_most * ay_most + abs(wa)  # Eq. (2)
    bz, bz_most = bx * bx + by * by + wb, bx_most * bx_most + by_most * by_most + abs(wb)
    cz, cz_most = cx * cx + cy * cy + wc, cx_most * cx_most + cy_most * cy_most + abs(wc)
    det = az * (bx * cy - by * cx) + bz * (cx * ay - cy * ax) + cz * (ax * by - ay * bx)  # Eq. (4)
    most = (
        az_most * (bx_most * cy_most + by_most * cx_most)
        + bz_most * (cx_most * ay_most + cy_most * ax_most)
        + cz_most * (ax_most * by_most + ay_most * bx_most)
    )
    if abs(det) > CIRCLE_BOUND * most:
        return 1 if det > 0.0 else -1
    return _exact_in_circle(points, weight, period, a, b, c, d)


@njit(cache=True, forceinline=True)
def _difference(points, period, a, d, axis):  # type: ignore[no-untyped-def]
    """Eq. (1) in doubles, and the magnitude X that bounds its error."""
    near = points[a[0], axis] - points[d[0], axis]
    far = (a[1 + axis] - d[1 + axis]) * period[axis]
    return near + far, abs(near) + abs(far)


@njit(cache=True)
def _exact_orientation(points, period, a, b, c):  # type: ignore[no-untyped-def]
    ax = _exact_difference(points, period, a, c, 0)
    ay = _exact_difference(points, period, a, c, 1)
    bx = _exact_difference(points, period, b, c, 0)
    by = _exact_difference(points, period, b, c, 1)
    return _sign(_minor(ax, ay, bx, by))


@njit(cache=True)
def _exact_in_circle(points, weight, period, a, b, c, d):  # type: ignore[no-untyped-def]
    rows = (
        _exact_row(points, weight, period, a, d),
        _exact_row(points, weight, period, b, d),
        _exact_row(points, weight, period, c, d),
    )
    minors = (  # each beside the ζ that it multiplies
        _minor(rows[1][0], rows[1][1], rows[2][0], rows[2][1]),
        _minor(rows[2][0], rows[2][1], rows[0][0], rows[0][1]),
        _minor(rows[0][0], rows[0][1], rows[1][0], rows[1][1]),
    )
    room = 0
    for k in range(3):
        room += 2 * len(rows[k][2]) * len(minors[k])
    det, size = np.empty(room), 0
    for k in range(3):
        size = _add_product(det, size, rows[k][2], minors[k], 1.0)
    return _sign(det[:size])


@njit(cache=True)
def _exact_difference(points, period, a, d, axis):  # type: ignore[no-untyped-def]
    """Eq. (1) as an expansion."""
    e = np.empty(4)
    high, low = _two_product(float(a[1 + axis] - d[1 + axis]), period[axis])
    size = _grow(e, 0, low)
    size = _grow(e, size, high)
    size = _grow(e, size, points[a[0], axis])
    size = _grow(e, size, -points[d[0], axis])
    return e[:size]


@njit(cache=True)
def _exact_row(points, weight, period, a, d):  # type: ignore[no-untyped-def]
    """ξ, η and ζ of site a seen from d as expansions."""
    x = _exact_difference(points, period, a, d, 0)
    y = _exact_difference(points, period, a, d, 1)
    z = np.empty(2 * len(x) ** 2 + 2 * len(y) ** 2 + 2)
    size = _grow(z, 0, weight[d[0]])
    size = _grow(z, size, -weight[a[0]])
    size = _add_product(z, size, x, x, 1.0)
    size = _add_product(z, size, y, y, 1.0)  # Eq. (2)
    return x, y, z[:size]


@njit(cache=True)
def _minor(ax, ay, bx, by):  # type: ignore[no-untyped-def]
    """ax by - ay bx of four expansions as an expansion."""
    e = np.empty(2 * len(ax) * len(by) + 2 * len(ay) * len(bx))
    size = _add_product(e, 0, ax, by, 1.0)
    size = _add_product(e, size, ay, bx, -1.0)
    return e[:size]


@njit(cache=True)
def _add_product(e, size, f, g, factor):  # type: ignore[no-untyped-def]
    """Add the product of the expansions f and g, times ±1, to e; its new size."""
    for i in range(len(f)):
        for j in range(len(g)):
            high, low = _two_product(factor * f[i], g[j])
            size = _grow(e, size, low)
            size = _grow(e, size, high)
    return size


@njit(cache=True)
def _grow(e, size, b):  # type: ignore[no-untyped-def]
    """Add the double b to the first `size` terms of the expansion e; its new size, without zeros.

    The terms grow in magnitude and do not overlap.
    """
    kept = 0
    for i in range(size):
        b, low = _two_sum(b, e[i])
        if low != 0.0:
            e[kept] = low
            kept += 1
    if b != 0.0:
        e[kept] = b
        kept += 1
    return kept


@njit(cache=True)
def _sign(e):  # type: ignore[no-untyped-def]
    """Sign of an expansion: that of its largest term; 0 also for nan."""
    if len(e) == 0:
        return 0
    return int(e[-1] > 0.0) - int(e[-1] < 0.0)


@njit(cache=True)
def _two_sum(a, b):  # type: ignore[no-untyped-def]
    """a + b as the rounded sum and its error."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


@njit(cache=True)
def _two_product(a, b):  # type: ignore[no-untyped-def]
    """a b as the rounded product and its error."""
    p = a * b
    a_high, a_low = _split(a)
    b_high, b_low = _split(b)
    return p, a_low * b_low - (((p - a_high * b_high) - a_low * b_high) - a_high * b_low)


@njit(cache=True)
def _split(a):  # type: ignore[no-untyped-def]
    """Upper and lower half of the bits of a."""
    c = SPLITTER * a
    high = c - (c - a)
    return high, a - high


__all__ = ["in_circle", "orientation"]
