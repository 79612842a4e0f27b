r"""L D Lᵀ of a sum over triangles, by fronts: halves of halves of the mesh.

    [ A   Bᵀ ] [u]   [f]
    [ B  -S  ] [p] = [g]

The triangles are halved, again and again; the parts are the nodes of a binary
tree. An unknown is eliminated in the smallest part that has all its triangles, so that of a part
with its own unknowns 1 and those 2 that it shares with others there remains

    F = [ F_11  F_12 ]  ->  F_22 - F_12ᵀ F_11⁻¹ F_12,    F_11 = Uᵀ D U,                          (1)

which is added to the F of the part twice as large: no sparse matrix is ever put together, and an
edge that flips asks for nothing. A zero on the diagonal is no pivot. In each part velocities go
first, which makes the diagonal of the pressures negative, and from each triangle all of these get a
little of their own stiffness,

    -pivot diag(B diag(A)⁻¹ Bᵀ),                                                               (2)

so that none of them lacks a pivot. Something must give them a level, or one must be left out.
Numbers are of single precision, which halves what has to be read: this is a preconditioner.

References
----------
A. George, Nested dissection of a regular finite element mesh, SIAM J. Numer. Anal. 10 (1973) 345.
I. S. Duff, J. K. Reid, The multifrontal solution of indefinite sparse symmetric linear equations,
ACM Trans. Math. Softw. 9 (1983) 302.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Mask = NDArray[np.bool_]

#: Share of the pressures' own stiffness added to their diagonal, Eq. (2).
PIVOT = 1e-6
#: In place of a pivot that is zero.
HUGE = np.float32(1e30)
#: Unknowns of the triangles of the smallest parts, each counted for each triangle, about.
LEAF = 150
#: Triangles whose median is taken for that of all.
SAMPLE = 65
#: Unknowns from which on both halves are done at once.
MANY = 10_000
#: Rows that are eliminated together.
BLOCK = 32


class Fronts:
    """The factor of a matrix.

    Parameters
    ----------
    K : (t, n, n)
        Symmetric matrices of triangles; what is more than `rows` has is left out.
    rows : (t, l)
        Their unknowns.
    sought : (N,) bool
        Unknowns to solve for.
    first : int
        Number of the first pressure.
    corners : (t, 3, 2)
        Of the triangles [m].
    pivot : float, optional
        Share of the pressures' own stiffness in Eq. (2).

    Attributes
    ----------
    unknown : (k,)
        Unknowns sought, in the order of elimination.
    """

    def __init__(
        self,
        K: Float,
        rows: Int,
        sought: Mask,
        first: int,
        corners: Float,
        pivot: float = PIVOT,
    ) -> None:
        depth = max(0, int(np.log2(max(1.0, rows.size / LEAF))))
        a, b, c = corners.swapaxes(0, 1)
        low, high = (pick(pick(a, b), c) for pick in (np.minimum, np.maximum))
        order = halved(low, high, depth)
        *self._plan, at, room = _plan(rows, order, depth, sought, first)
        panel, self.unknown = self._plan[:2]
        self._parts = len(panel) - 1
        self._panels = np.empty(panel[-1], np.float32)
        self._pivots, heap = np.empty(len(self.unknown), np.float32), np.empty(room, np.float32)
        about = (
            K, rows, order, depth, first, pivot, at, heap,
            self._panels, self._pivots, *self._plan,
        )  # fmt: skip
        self._halves(_factor, about, about)
        _factor(self._parts - 1, self._parts, *about)

    def solve(self, f: Float) -> Float:
        """What K x = f about has as solution (N,), 0 where nothing is sought."""
        x, y = np.zeros(len(f)), f[self.unknown].astype(np.float32)
        self.divide(y)
        x[self.unknown] = y
        return x

    def divide(self, y: NDArray[np.float32]) -> None:
        """The same in place, for the unknowns in the order of elimination (k,)."""
        about, last = (self._panels, *self._plan), (self._parts - 1, self._parts)
        start = self._plan[2]
        top = np.zeros((2, len(y) - start[-2]), np.float32)
        self._halves(_forward, (y, top[0], *about), (y, top[1], *about))
        y[start[-2] :] += top[0] + top[1]
        _forward(*last, y, top[0], *about)
        y *= self._pivots
        _backward(*last, y, *about)
        self._halves(_backward, (y, *about), (y, *about))

    def _halves(self, call: Callable[..., None], one: Any, other: Any) -> None:
        """Do the parts of both halves of the mesh, at once if they are large."""
        half, whole = self._parts // 2, self._parts - 1
        both(call, (0, half, *one), (half, whole, *other), len(self._pivots) > MANY)


def both(
    call: Callable[..., Any], one: tuple[Any, ...], other: tuple[Any, ...], threads: bool
) -> tuple[Any, Any]:
    """The results of two calls, made at once by two threads or one after the other."""
    if not threads:
        return call(*one), call(*other)
    second = _second(os.getpid()).submit(call, *other)
    return call(*one), second.result()


@lru_cache(1)
def _second(_: int) -> ThreadPoolExecutor:
    """A second thread of this process: a fork has none."""
    return ThreadPoolExecutor(1)


@njit(cache=True)
def halved(low, high, depth):  # type: ignore[no-untyped-def]
    """Triangles, so that those of each part of the tree follow one another (t,).

    Part k of 2^level has those from (k t) >> level on. It is cut at the median of the lowest
    corners (t, 2) of its triangles, which leaves one line of vertices between the halves, along the
    axis on which fewer of them reach, with their highest corners (t, 2), over the cut.
    """
    t = len(low)
    order = np.arange(t)
    some = np.empty(SAMPLE)
    for level in range(depth):
        for part in range(1 << level):
            begin, end = (part * t) >> level, ((part + 1) * t) >> level
            axis, fewest = 0, end - begin + 1
            for c in range(2):
                n = min(SAMPLE, end - begin)
                for i in range(n):
                    some[i] = low[order[begin + i * (end - begin) // n], c]
                middle, over = np.sort(some[:n])[n // 2], 0
                for e in order[begin:end]:
                    over += (low[e, c] < middle) & (high[e, c] > middle)
                if over < fewest:
                    axis, fewest = c, over
            _select(low, axis, order, begin, end - 1, ((2 * part + 1) * t) >> (level + 1))
    return order


@njit(cache=True)
def _select(x, axis, order, low, high, cut):  # type: ignore[no-untyped-def]
    """Order, in place, such that no x before place `cut` is larger than one from there on."""
    while low < high:
        pivot = x[order[(low + high) >> 1], axis]
        i, j = low, high
        while i <= j:
            while x[order[i], axis] < pivot:
                i += 1
            while x[order[j], axis] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if cut <= j:
            high = j
        elif cut >= i:
            low = i
        else:
            return


@njit(cache=True)
def _plan(rows, order, depth, sought, first):  # type: ignore[no-untyped-def]
    """Who is eliminated where, and what is kept where.

    First entry of each part's rows of U; unknown at each place in the order of elimination; first
    place of each part, and its height in the tree; first entry of each part in the places that it
    shares with others, and these; place of each unknown, -1 if it is not sought; where in memory
    what is left of each part stands, and how much room is needed.
    """
    t, leaves, outer = len(order), 1 << depth, rows.shape[1]
    low, high = np.full(len(sought), leaves, np.int32), np.full(len(sought), -1, np.int32)
    for leaf in range(leaves):
        for e in order[(leaf * t) >> depth : ((leaf + 1) * t) >> depth]:
            for i in range(outer):
                u = rows[e, i]
                low[u], high[u] = min(low[u], leaf), max(high[u], leaf)
    # The number of a part in the order in which parts are done: halves before their whole.
    parts = 2 * leaves - 1
    done = np.empty(2 * leaves, np.int32)
    height = np.empty(parts, np.int8)
    k = 0
    for leaf in range(leaves):
        node, h = leaf + leaves, 0
        done[node], height[k] = k, h
        k += 1
        while node & 1 and node > 1:
            node, h = node >> 1, h + 1
            done[node], height[k] = k, h
            k += 1
    where = np.full(len(sought), -1, np.int32)
    count = np.zeros(2 * parts + 1, np.int64)
    for u in range(len(sought)):
        if sought[u] and high[u] >= 0:
            node, differ = high[u] + leaves, low[u] ^ high[u]
            while differ:
                node, differ = node >> 1, differ >> 1
            where[u] = 2 * done[node] + (u >= first)
            count[where[u] + 1] += 1
    count = np.cumsum(count)
    start = count[::2].copy()
    place, unknown = np.full(len(sought), -1, np.int32), np.empty(count[-1], np.int32)
    for u in range(len(sought)):
        if where[u] >= 0:
            place[u] = count[where[u]]
            unknown[place[u]] = u
            count[where[u]] += 1
    # What a part shares with others, by place.
    begin, shared = np.zeros(parts + 1, np.int64), np.empty(16 * len(unknown) + 64, np.int32)
    seen = np.full(len(unknown), -1, np.int32)
    size = leaf = 0
    for k in range(parts):
        end = start[k + 1]
        if size + len(unknown) > len(shared):
            shared = np.concatenate((shared, np.empty_like(shared)))
        if height[k] == 0:
            for e in order[(leaf * t) >> depth : ((leaf + 1) * t) >> depth]:
                for i in range(outer):
                    p = place[rows[e, i]]
                    if p >= end and seen[p] != k:
                        seen[p] = k
                        shared[size] = p
                        size += 1
            shared[begin[k] : size] = np.sort(shared[begin[k] : size])
            leaf += 1
        else:
            left = k - (1 << height[k])
            i, j = begin[left], begin[k - 1]
            i_end, j_end = begin[left + 1], begin[k]
            while i < i_end or j < j_end:
                if j == j_end or (i < i_end and shared[i] < shared[j]):
                    p, i = shared[i], i + 1
                elif i == i_end or shared[j] < shared[i]:
                    p, j = shared[j], j + 1
                else:
                    p, i, j = shared[i], i + 1, j + 1
                if p >= end:
                    shared[size] = p
                    size += 1
        begin[k + 1] = size
    # Places in memory: of each part's rows of U, and of what is left of it, on two stacks.
    panel, at = np.zeros(parts + 1, np.int64), np.zeros(parts, np.int64)
    free = room = 0
    for k in range(parts):
        mine, others = start[k + 1] - start[k], begin[k + 1] - begin[k]
        panel[k + 1] = panel[k] + mine * (mine + others)
        if k == parts // 2:  # the other half of the mesh
            free = room
        at[k] = free if height[k] == 0 else at[k - (1 << height[k])]
        free = at[k] + others * others
        room = max(room, free)
    return panel, unknown, start, height, begin, shared[:size].copy(), place, at, room


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _eliminate(F, own, size, c):  # type: ignore[no-untyped-def]
    """Eq. (1) on the upper half of F (size, size), in place: D U in the first rows."""
    for k0 in range(0, own, BLOCK):
        k1 = min(k0 + BLOCK, own)
        for k in range(k0, k1):
            if F[k, k] == 0.0:  # nothing holds this unknown: it is left out
                F[k, k] = HUGE
            u = F[k, k:size]
            d = u[0]
            for i in range(k + 1, k1):
                a, row = u[i - k] / d, F[i, i:size]
                v = u[i - k :]
                for j in range(len(row)):
                    row[j] -= a * v[j]
        for k in range(k0, k1):
            inverse = np.float32(1.0) / F[k, k]
            u, row = F[k, k1:size], c[k - k0, k1:size]
            for j in range(len(row)):
                row[j] = u[j] * inverse
        for k in range(k1 - k0, BLOCK):  # none: F[k0] times zero
            c[k, k1:size] = 0.0
        for i in range(k1, size, 4):
            if i + 4 > size:
                for m in range(i, size):
                    row = F[m, m:size]
                    for k in range(k0, k1):
                        a, u = c[k - k0, m], F[k, m:size]
                        for j in range(len(row)):
                            row[j] -= a * u[j]
                continue
            r0, r1, r2, r3 = F[i, i:size], F[i + 1, i:size], F[i + 2, i:size], F[i + 3, i:size]
            for k in range(k0, k1, 4):
                q = k - k0
                l1, l2, l3 = min(k + 1, k1 - 1), min(k + 2, k1 - 1), min(k + 3, k1 - 1)
                u0, u1, u2, u3 = F[k, i:size], F[l1, i:size], F[l2, i:size], F[l3, i:size]
                a0, a1, a2, a3 = c[q, i], c[q + 1, i], c[q + 2, i], c[q + 3, i]
                b0, b1, b2, b3 = c[q, i + 1], c[q + 1, i + 1], c[q + 2, i + 1], c[q + 3, i + 1]
                d0, d1, d2, d3 = c[q, i + 2], c[q + 1, i + 2], c[q + 2, i + 2], c[q + 3, i + 2]
                e0, e1, e2, e3 = c[q, i + 3], c[q + 1, i + 3], c[q + 2, i + 3], c[q + 3, i + 3]
                for j in range(len(r0)):
                    r0[j] -= a0 * u0[j] + a1 * u1[j] + a2 * u2[j] + a3 * u3[j]
                    r1[j] -= b0 * u0[j] + b1 * u1[j] + b2 * u2[j] + b3 * u3[j]
                    r2[j] -= d0 * u0[j] + d1 * u1[j] + d2 * u2[j] + d3 * u3[j]
                    r3[j] -= e0 * u0[j] + e1 * u1[j] + e2 * u2[j] + e3 * u3[j]


@njit(cache=True, nogil=True, error_model="numpy")
def _factor(  # type: ignore[no-untyped-def]
    low, high, K, rows, order, depth, pressure, pivot, at, heap, panels, pivots,
    panel, unknown, start, height, begin, shared, place,
):  # fmt: skip
    """Rows of U of some parts, one part after the other, without the diagonal; and 1/D."""
    t, outer = len(order), rows.shape[1]
    most = 0
    for k in range(low, high):
        most = max(most, start[k + 1] - start[k] + begin[k + 1] - begin[k])
    work, c = np.empty(most * most, np.float32), np.zeros((BLOCK, most), np.float32)
    index, local = np.empty(len(unknown), np.int32), np.empty(outer, np.int32)
    run = np.empty((most + 1, 2), np.int32)
    leaf = (low + 1) // 2  # parts come in pairs
    for k in range(low, high):
        mine, others = start[k + 1] - start[k], begin[k + 1] - begin[k]
        size = mine + others
        F = work[: size * size].reshape(size, size)
        for i in range(size):
            F[i, i:] = 0.0
        for i in range(mine):
            index[start[k] + i] = i
        for i in range(others):
            index[shared[begin[k] + i]] = mine + i
        if height[k] == 0:
            for e in order[(leaf * t) >> depth : ((leaf + 1) * t) >> depth]:
                for i in range(outer):
                    p = place[rows[e, i]]
                    local[i] = index[p] if p >= 0 else -1
                for i in range(outer):
                    if local[i] < 0:
                        continue
                    own = 0.0
                    for j in range(i + 1):
                        if local[j] >= 0:
                            a, b = min(local[i], local[j]), max(local[i], local[j])
                            F[a, b] += np.float32(K[e, i, j])
                            if rows[e, j] < pressure:
                                own += K[e, i, j] ** 2 / K[e, j, j]
                    if rows[e, i] >= pressure:
                        F[local[i], local[i]] -= np.float32(pivot * own)  # Eq. (2)
            leaf += 1
        else:
            for child in (k - (1 << height[k]), k - 1):
                n = begin[child + 1] - begin[child]
                G = heap[at[child] : at[child] + n * n].reshape(n, n)
                names = shared[begin[child] : begin[child + 1]]
                count = 0  # runs of columns that stay next to each other
                for i in range(n):
                    if i == 0 or index[names[i]] != index[names[i - 1]] + 1:
                        run[count, 0], run[count, 1] = i, index[names[i]]
                        count += 1
                run[count, 0] = n
                first = 0
                for i in range(n):
                    if run[first + 1, 0] <= i:
                        first += 1
                    row, part = F[index[names[i]]], G[i]
                    for r in range(first, count):
                        a, b = max(i, run[r, 0]), run[r + 1, 0]
                        into = run[r, 1] + a - run[r, 0]
                        x, y = row[into : into + b - a], part[a:b]
                        for j in range(len(y)):
                            x[j] += y[j]
        _eliminate(F, mine, size, c)
        for i in range(mine):
            inverse = np.float32(1.0) / F[i, i]
            pivots[start[k] + i] = inverse
            row, into = F[i], panels[panel[k] + i * size : panel[k] + (i + 1) * size]
            for j in range(i + 1, size):
                into[j] = row[j] * inverse
        for i in range(others):
            a = at[k] + i * others
            heap[a + i : a + others] = F[mine + i, mine + i :]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _forward(  # type: ignore[no-untyped-def]
    low, high, y, top, panels, panel, unknown, start, height, begin, shared, place
):
    """y = U⁻ᵀ y for some parts; what belongs to the last part goes to `top`."""
    most = 0
    for k in range(low, high):
        most = max(most, start[k + 1] - start[k] + begin[k + 1] - begin[k])
    w, last = np.empty(most, np.float32), start[-2]
    for k in range(low, high):
        mine, others = start[k + 1] - start[k], begin[k + 1] - begin[k]
        size = mine + others
        own, names = y[start[k] : start[k + 1]], shared[begin[k] : begin[k + 1]]
        w[:mine], w[mine:size] = own, 0.0
        for i in range(mine):
            at = panel[k] + i * size
            a, row, into = w[i], panels[at + i + 1 : at + size], w[i + 1 : size]
            for j in range(len(row)):
                into[j] -= a * row[j]
        own[:] = w[:mine]
        for j in range(others):
            if names[j] < last:
                y[names[j]] += w[mine + j]
            else:
                top[names[j] - last] += w[mine + j]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _backward(  # type: ignore[no-untyped-def]
    low, high, y, panels, panel, unknown, start, height, begin, shared, place
):
    """y = U⁻¹ y for some parts, when those larger are done."""
    most = 0
    for k in range(low, high):
        most = max(most, start[k + 1] - start[k] + begin[k + 1] - begin[k])
    w = np.empty(most, np.float32)
    for k in range(high - 1, low - 1, -1):
        mine, others = start[k + 1] - start[k], begin[k + 1] - begin[k]
        size = mine + others
        own, names = y[start[k] : start[k + 1]], shared[begin[k] : begin[k + 1]]
        w[:mine] = own
        for j in range(others):
            w[mine + j] = y[names[j]]
        for i in range(mine - 1, -1, -1):
            at = panel[k] + i * size
            row, of, total = panels[at + i + 1 : at + size], w[i + 1 : size], np.float32(0.0)
            for j in range(len(row)):
                total += row[j] * of[j]
            w[i] -= total
        own[:] = w[:mine]


__all__ = ["Fronts", "both"]
