r"""A triangulation kept alive while its vertices move.

Vertices move and triangles go with them, until an edge fails the test of a power triangulation: the
corner opposite it lies inside the power circle of the triangle on its other side
(`grainmesh.predicates`, Eq. 4). The edge is then replaced by the other diagonal of its two
triangles (C. L. Lawson, Mathematical Software III (1977) 161),

          c                    c
        / | \                /   \
       a  |  d     --->     a --- d                                                           (1)
        \ | /                \   /
          b                    b

and their four outer edges are looked at again. Triangles turned over by a move are treated alike:
an edge is flipped if one of its triangles is not positive and both new ones are. So each flip
leaves fewer triangles that are not positive, or as many and a lower surface of the points lifted to
(x, y, x² + y² - w): with exact signs, flips never go round in circles.

If in the end all triangles are positive and all inner edges pass, this is the power triangulation,
unique but for ties: the triangles, glued together to a disc or a torus as ever, lie in the plane
without folds. Where no flip helps, because a vertex has crossed the boundary, has moved too far, or
would have to vanish behind larger ones, the triangulation must be made anew
(`grainmesh.triangulation`).

A vertex v leaves by flips too. Those of its edges whose other end is an ear of the ring around it,
a triangle of three vertices in a row that has not v inside, are flipped away until three are left;
a ring of more has two ears, and v is in one at most (G. H. Meisters, Amer. Math. Monthly 82 (1975)
648). Then three triangles become one,

           c                    c
         / | \                /   \
        /  v  \     --->     /     \                                                          (2)
       / /   \ \            /       \
      a --------- b        a ------- b

and a vertex enters the same way back: a walk towards it finds the triangle that holds it, Eq. (2)
is done in reverse, and edges opposite v that fail are flipped. On an edge, one of the three
triangles is flat and is flipped away at once, or dropped at the boundary.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from grainmesh.predicates import in_circle, orientation

#: At more flips than this for each triangle, a new triangulation is the faster way.
MOST_FLIPS = 4


@njit(cache=True)
def repair(points, weight, period, triangles, neighbours, shifts):  # type: ignore[no-untyped-def]
    """Flip edges in place until the triangulation is the power triangulation of its points.

    Parameters
    ----------
    points : (m, 2) float64
        Vertices [m]. In a periodic box they move on beyond its edge and are never wrapped.
    weight : (m,) float64
        Power weights [m2], r_i² for discs.
    period : (2,) float64
        Size of a periodic box [m]; zeros for a box with walls.
    triangles : (t, 3) int32
        Corners, counter-clockwise before the points moved; changed.
    neighbours : (t, 3) int32
        Triangle across the edge opposite each corner, -1 at the boundary; changed.
    shifts : (t, 3, 2) int32
        Periodic images: corners lie at ``points[triangles] + shifts * period``; changed.

    Returns
    -------
    flips : int
        Number of edges flipped.
    inverted : int
        Number of triangles whose area was not positive at the start.
    ok : bool
        Whether now all triangles are positive and all inner edges are locally power-Delaunay,
        exactly. If not, the arrays still fit together but the triangulation must be made anew.

    Notes
    -----
    Edges of the boundary are never flipped. They must not cross each other, and must enclose a
    convex region if the result is to be the power triangulation of all points. Equal input gives
    equal output, to the bit.
    """
    positive = np.empty(len(triangles), np.bool_)
    arrays = points, weight, period, triangles, neighbours, shifts
    stack, depth = _failing(*arrays, positive)
    inverted = len(positive) - positive.sum()
    flips, doubt = 0, inverted > 0
    while depth > 0:
        depth -= 1
        t, k = stack[depth, 0], stack[depth, 1]
        u = neighbours[t, k]
        if u < 0:
            continue
        j = _back(triangles, neighbours, shifts, t, k, u)
        a, b, c, d = _corners(triangles, shifts, t, k, u, j)
        if positive[t] and positive[u] and in_circle(points, weight, period, a, b, c, d) <= 0:
            continue
        if (
            orientation(points, period, a, b, d) <= 0
            or orientation(points, period, d, c, a) <= 0
            or flips == MOST_FLIPS * len(triangles)
        ):
            doubt = True  # unless another flip helps
            continue
        _flip(triangles, neighbours, shifts, t, k, u, j, a, d)
        positive[t] = positive[u] = True
        flips += 1
        if depth + 4 > len(stack):
            stack = np.concatenate((stack, np.empty_like(stack)))
        k2, j2 = (k + 2) % 3, (j + 2) % 3
        stack[depth, 0], stack[depth, 1] = t, k
        stack[depth + 1, 0], stack[depth + 1, 1] = t, k2
        stack[depth + 2, 0], stack[depth + 2, 1] = u, j
        stack[depth + 3, 0], stack[depth + 3, 1] = u, j2
        depth += 4
    # Every edge has passed since its triangles last changed; the edge of a flip passes by itself if
    # its triangles were positive. In doubt, all are looked at again.
    ok = positive.all() and (not doubt or _failing(*arrays, positive)[1] == 0)
    return flips, inverted, ok


@njit(cache=True)
def remove(points, period, triangles, neighbours, shifts, vertices):  # type: ignore[no-untyped-def]
    """Take vertices out in place, by flips and Eq. (2); what is left is for `repair`.

    Parameters
    ----------
    points, period, triangles, neighbours, shifts
        As for `repair`, with positive triangles.
    vertices : (q,) int
        Vertices to take out, each once. The others keep their numbers.

    Returns
    -------
    size : int
        Number of triangles left, the first rows of the arrays.
    ok : bool
        Whether all went. If not, because a vertex is on the boundary or its own neighbour in a
        small periodic box, the triangulation must be made anew.
    """
    size = len(triangles)
    star = np.full(len(points), -1, np.int32)  # a triangle of each vertex
    for t in range(size):
        for k in range(3):
            star[triangles[t, k]] = t
    for v in vertices:
        t, k = star[v], 0
        while triangles[t, k] != v:
            k += 1
        degree, tries = _degree(triangles, neighbours, shifts, t, k), 0
        if degree == 0:
            return size, False
        while True:
            u, j = _next(triangles, neighbours, shifts, t, k)
            k1, j2 = (k + 1) % 3, (j + 2) % 3
            a, b, o, c = _corners(triangles, shifts, t, k1, u, j2)  # (o, a, b) and (o, b, c)
            if degree == 3:
                break
            convex = orientation(points, period, a, b, c) > 0
            if convex and orientation(points, period, a, c, o) >= 0:  # 0: v on ac
                _flip(triangles, neighbours, shifts, t, k1, u, j2, a, c)
                star[a[0]] = star[b[0]] = star[c[0]] = t
                degree, tries = degree - 1, 0
            elif tries > degree:
                return size, False
            t, k, tries = u, j, tries + 1
        w, i = _next(triangles, neighbours, shifts, u, j)
        _hand_over(triangles, neighbours, shifts, u, j, t, k1)
        _hand_over(triangles, neighbours, shifts, w, i, t, (k + 2) % 3)
        triangles[t, k], shifts[t, k, 0], shifts[t, k, 1] = c  # Eq. (2)
        star[a[0]] = star[b[0]] = star[c[0]] = t
        for hole in (max(u, w), min(u, w)):
            size -= 1
            if hole < size:
                _fill(triangles, neighbours, shifts, star, hole, size)
    return size, True


@njit(cache=True)
def insert(points, weight, period, triangles, neighbours, shifts, size, vertices):  # type: ignore[no-untyped-def]
    """Put vertices into the triangles that hold them, by Eq. (2) in reverse and flips.

    Parameters
    ----------
    points, weight, period
        As for `repair`.
    triangles, neighbours, shifts
        As for `repair`, with positive triangles, in the first `size` rows, and two rows to spare
        for each vertex.
    size : int
        Number of triangles.
    vertices : (q,) int
        Vertices to put in, in no triangle so far. It is faster if one is near the one before.

    Returns
    -------
    size : int
        Number of triangles now, the first rows of the arrays.
    put : int
        How many vertices went in: all, or those before the first that has no place of its own,
        because it lies outside, where another vertex is, or is not found.

    Notes
    -----
    If the triangulation was the power triangulation of the other points, it is that of all now (but
    for small periodic boxes, where a vertex may meet itself, and hidden vertices): `repair` tells.
    """
    stack = np.empty((64, 2), np.int32)
    t, put = 0, 0
    for new in vertices:
        t, k, zeros, v = _locate(points, period, triangles, neighbours, shifts, size, t, new)
        if zeros > 1:
            return size, put
        u, j = neighbours[t, k], 0
        if u >= 0:
            j = _back(triangles, neighbours, shifts, t, k, u)
        _split(triangles, neighbours, shifts, t, k, size, v)
        stack, depth = _push(stack, 0, t, 2)
        stack, depth = _push(stack, depth, size, 2)
        last = size + 1  # (b, c, v)
        size += 2
        if zeros == 0:
            stack, depth = _push(stack, depth, last, 2)
        elif u >= 0:  # v on bc
            a, _, _, d = _corners(triangles, shifts, last, 2, u, j)
            _flip(triangles, neighbours, shifts, last, 2, u, j, a, d)
            stack, depth = _push(stack, depth, last, 2)
            stack, depth = _push(stack, depth, u, (j + 2) % 3)
        else:
            size -= 1
            neighbours[t, 0], neighbours[last - 1, 1] = -1, -1
        put += 1
        while depth > 0:
            depth -= 1
            s, k = stack[depth, 0], stack[depth, 1]  # v is corner k
            u = neighbours[s, k]
            if u < 0:
                continue
            j = _back(triangles, neighbours, shifts, s, k, u)
            a, b, c, d = _corners(triangles, shifts, s, k, u, j)
            if (
                in_circle(points, weight, period, a, b, c, d) <= 0
                or orientation(points, period, a, b, d) <= 0
                or orientation(points, period, d, c, a) <= 0
            ):
                continue
            _flip(triangles, neighbours, shifts, s, k, u, j, a, d)
            stack, depth = _push(stack, depth, s, k)
            stack, depth = _push(stack, depth, u, (j + 2) % 3)
    return size, put


@njit(cache=True, forceinline=True)
def _push(stack, depth, t, k):  # type: ignore[no-untyped-def]
    """Corner k of triangle t on top of the stack, which grows if it must; its depth."""
    if depth == len(stack):
        stack = np.concatenate((stack, np.empty_like(stack)))
    stack[depth, 0], stack[depth, 1] = t, k
    return stack, depth + 1


@njit(cache=True)
def _locate(points, period, triangles, neighbours, shifts, size, t, v):  # type: ignore[no-untyped-def]
    """The triangle that holds vertex v, found by a walk from triangle t.

    Also a corner k, the number of edges that v lies on, the one opposite k if it is one, and the
    site of v among the images of that triangle. Edges: 3 if there is no such triangle.
    """
    first = _site(triangles, shifts, t, 0)
    p, q = np.int64(0), np.int64(0)
    if period[0] > 0.0:  # the image near the start
        p = np.int64(np.round((points[first[0], 0] - points[v, 0]) / period[0])) + first[1]
        q = np.int64(np.round((points[first[0], 1] - points[v, 1]) / period[1])) + first[2]
    site = np.int64(v), p, q
    for _ in range(2 * size + 8):  # it never turns back among power triangles
        k, zeros, beyond = 0, 0, -1
        for i in range(3):
            b, c = (i + 1) % 3, (i + 2) % 3
            side = orientation(
                points, period, _site(triangles, shifts, t, b), _site(triangles, shifts, t, c), site
            )
            if side < 0:
                beyond = i
                break
            if side == 0:
                k, zeros = i, zeros + 1
        if beyond < 0:
            return t, k, zeros, site
        u = neighbours[t, beyond]
        if u < 0:
            break
        j = _back(triangles, neighbours, shifts, t, beyond, u)
        here, there = (
            _site(triangles, shifts, t, (beyond + 1) % 3),
            _site(triangles, shifts, u, (j + 2) % 3),
        )
        site = site[0], site[1] + there[1] - here[1], site[2] + there[2] - here[2]
        t = u
    return t, 0, 3, site


@njit(cache=True)
def _split(triangles, neighbours, shifts, t, k, size, v):  # type: ignore[no-untyped-def]
    """Eq. (2) in reverse: t = (a, b, c), from k on, becomes abv; rows `size` on are cav and bcv."""
    rows = t, size, size + 1
    a, b = _site(triangles, shifts, t, k), _site(triangles, shifts, t, (k + 1) % 3)
    c = _site(triangles, shifts, t, (k + 2) % 3)
    # Beyond ab, ca and bc, before any of it changes: two may be one triangle in a periodic box.
    w, back = np.empty(3, np.int32), np.zeros(3, np.int32)
    for i in range(3):
        at = (k + 2 - i) % 3
        w[i] = neighbours[t, at]
        if w[i] >= 0:
            back[i] = _back(triangles, neighbours, shifts, t, at, w[i])
    corners = (a, b), (c, a), (b, c)
    beside = (size + 1, size), (t, size + 1), (size, t)
    for i in range(3):
        row = rows[i]
        for end in range(2):
            site = corners[i][end]
            triangles[row, end], shifts[row, end, 0], shifts[row, end, 1] = site
            neighbours[row, end] = beside[i][end]
        triangles[row, 2], shifts[row, 2, 0], shifts[row, 2, 1] = v
        neighbours[row, 2] = w[i]
        if w[i] >= 0:
            neighbours[w[i], back[i]] = row


@njit(cache=True)
def _next(triangles, neighbours, shifts, t, k):  # type: ignore[no-untyped-def]
    """The next triangle anticlockwise round corner k of triangle t, and its corner there."""
    u = neighbours[t, (k + 1) % 3]
    return u, (_back(triangles, neighbours, shifts, t, (k + 1) % 3, u) + 1) % 3 if u >= 0 else 0


@njit(cache=True)
def _degree(triangles, neighbours, shifts, t, k):  # type: ignore[no-untyped-def]
    """Triangles round a corner; 0 on the boundary and where it is its own neighbour."""
    u, j, degree = t, k, 0
    while degree == 0 or u != t:
        if triangles[u, (j + 1) % 3] == triangles[t, k]:
            return 0
        u, j = _next(triangles, neighbours, shifts, u, j)
        if u < 0:
            return 0
        degree += 1
    return degree


@njit(cache=True)
def _hand_over(triangles, neighbours, shifts, u, j, t, k):  # type: ignore[no-untyped-def]
    """Put what lies opposite corner j of triangle u opposite corner k of triangle t."""
    w = neighbours[u, j]
    if w >= 0:
        neighbours[w, _back(triangles, neighbours, shifts, u, j, w)] = t
    neighbours[t, k] = w


@njit(cache=True)
def _fill(triangles, neighbours, shifts, star, hole, last):  # type: ignore[no-untyped-def]
    """Move triangle `last` to the row `hole`."""
    for k in range(3):
        u = neighbours[last, k]
        for j in range(3):
            if u >= 0 and neighbours[u, j] == last:
                neighbours[u, j] = hole
        star[triangles[last, k]] = hole
    for rows in (triangles, neighbours):
        rows[hole] = rows[last]
    shifts[hole] = shifts[last]


@njit(cache=True)
def _failing(points, weight, period, triangles, neighbours, shifts, positive):  # type: ignore[no-untyped-def]
    """Edges that fail, each a triangle and its corner opposite, and their number.

    `positive` (t,) is set to whether the area of each triangle is positive.
    """
    for t in range(len(triangles)):
        a = _site(triangles, shifts, t, 0)
        b, c = _site(triangles, shifts, t, 1), _site(triangles, shifts, t, 2)
        positive[t] = orientation(points, period, a, b, c) > 0
    found, size = np.empty((64, 2), np.int32), 0
    for t in range(len(triangles)):
        for k in range(3):
            u = neighbours[t, k]
            if u < t:  # boundary, or looked at from the other side
                continue
            j = _back(triangles, neighbours, shifts, t, k, u)
            a, b, c, d = _corners(triangles, shifts, t, k, u, j)
            if positive[t] and positive[u] and in_circle(points, weight, period, a, b, c, d) <= 0:
                continue
            if size == len(found):
                found = np.concatenate((found, np.empty_like(found)))
            found[size, 0], found[size, 1] = t, k
            size += 1
    return found, size


@njit(cache=True, forceinline=True)
def _site(triangles, shifts, t, k):  # type: ignore[no-untyped-def]
    """Corner k of triangle t: its vertex and image."""
    return np.int64(triangles[t, k]), np.int64(shifts[t, k, 0]), np.int64(shifts[t, k, 1])


@njit(cache=True, forceinline=True)
def _back(triangles, neighbours, shifts, t, k, u):  # type: ignore[no-untyped-def]
    """Corner of triangle u opposite the edge that is opposite corner k of triangle t."""
    at_1, at_2 = neighbours[u, 1] == t, neighbours[u, 2] == t
    if (neighbours[u, 0] == t) + at_1 + at_2 == 1:
        return at_1 + 2 * at_2
    return _back_by_edge(triangles, shifts, t, k, u)


@njit(cache=True)
def _back_by_edge(triangles, shifts, t, k, u):  # type: ignore[no-untyped-def]
    """The same where t and u share several edges, by both ends and the image of one from the other.

    It happens in small periodic boxes, and for a moment round a vertex that crossed an edge.
    """
    k1, k2 = (k + 1) % 3, (k + 2) % 3
    for j in range(3):
        j1, j2 = (j + 1) % 3, (j + 2) % 3
        if (
            triangles[u, j1] == triangles[t, k2]
            and triangles[u, j2] == triangles[t, k1]
            and shifts[u, j1, 0] - shifts[u, j2, 0] == shifts[t, k2, 0] - shifts[t, k1, 0]
            and shifts[u, j1, 1] - shifts[u, j2, 1] == shifts[t, k2, 1] - shifts[t, k1, 1]
        ):
            return j
    raise ValueError("neighbours do not fit the triangles")


@njit(cache=True, forceinline=True)
def _corners(triangles, shifts, t, k, u, j):  # type: ignore[no-untyped-def]
    """Sites a, b, c of triangle t from corner k on, and d of triangle u beyond the edge bc."""
    b = _site(triangles, shifts, t, (k + 1) % 3)
    far = _site(triangles, shifts, u, (j + 2) % 3)  # b again, as triangle u has it
    d = _site(triangles, shifts, u, j)
    d = (d[0], d[1] + b[1] - far[1], d[2] + b[2] - far[2])
    return _site(triangles, shifts, t, k), b, _site(triangles, shifts, t, (k + 2) % 3), d


@njit(cache=True)
def _flip(triangles, neighbours, shifts, t, k, u, j, a, d):  # type: ignore[no-untyped-def]
    """Eq. (1): triangles t = (a, b, c) and u = (d, c, b), from k and j on, become abd and dca."""
    k1, k2, j1, j2 = (k + 1) % 3, (k + 2) % 3, (j + 1) % 3, (j + 2) % 3
    # What lies beyond bd goes from u to t, what lies beyond ca from t to u.
    v, w = neighbours[u, j1], neighbours[t, k1]
    at_v = _back(triangles, neighbours, shifts, u, j1, v) if v >= 0 else 0
    at_w = _back(triangles, neighbours, shifts, t, k1, w) if w >= 0 else 0
    if v == t and at_v == k1:  # both are one edge, in a small periodic box
        v, w = u, t
    else:
        if v >= 0:
            neighbours[v, at_v] = t
        if w >= 0:
            neighbours[w, at_w] = u
    neighbours[t, k], neighbours[t, k1] = v, u
    neighbours[u, j], neighbours[u, j1] = w, t
    for axis in range(2):
        hop = d[1 + axis] - shifts[u, j, axis]  # from the images of u to those of t
        shifts[t, k2, axis] = d[1 + axis]
        shifts[u, j2, axis] = a[1 + axis] - hop
    triangles[t, k2], triangles[u, j2] = d[0], a[0]


__all__ = ["insert", "remove", "repair"]
