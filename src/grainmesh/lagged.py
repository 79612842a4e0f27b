"""A factor kept from step to step as preconditioner of GMRES, while matrix and mesh change.

    [ A   Bᵀ ] [u]   [f]
    [ B  -S  ] [p] = [g]

An indefinite factor cannot precondition MINRES; GMRES takes it. Unknowns are known by name
(`grainmesh.carry`); those that have come since the factor was made (`grainmesh.fronts`), on edges
that have flipped, are divided by a diagonal.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from grainmesh.fronts import Fronts

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Mask = NDArray[np.bool_]
Apply = Callable[[Float], Float]


class Lagged:
    """A factor, for unknowns with names.

    Parameters
    ----------
    factor : Fronts
    sought : (N,) bool
        Unknowns that it solves for.
    names : (N,) int
        Names of all unknowns.
    """

    def __init__(self, factor: Fronts, sought: Mask, names: Int) -> None:
        kept = np.flatnonzero(sought)
        order = np.argsort(names[kept])
        # What is held at zero has a place, too, beyond all others.
        place = np.full(len(sought), len(factor.unknown))
        place[factor.unknown] = np.arange(len(factor.unknown))
        self._factor, self._place, self._names = factor, place[kept][order], names[kept][order]

    def preconditioner(self, names: Int, diagonal: Float) -> Apply:
        """About K⁻¹ for unknowns of these names (k,), with this diagonal (k,)."""
        place = np.searchsorted(self._names, names).clip(max=len(self._names) - 1)
        there = self._names[place] == names
        new, known, place = ~there, np.flatnonzero(there), self._place[place[there]]
        share, size = 1.0 / diagonal[new], len(self._factor.unknown)

        def apply(r: Float) -> Float:
            y, z = np.zeros(size + 1, np.float32), np.empty_like(r)
            y[place] = r[known]
            self._factor.divide(y[:size])
            y[size] = 0.0
            z[known] = y[place]
            z[new] = share * r[new]
            return z

        return apply


def gmres(
    apply: Apply,
    precondition: Apply,
    f: Float,
    tolerance: float,
    most: int,
) -> tuple[Float, int, Float]:
    """Solution from zero by preconditioned GMRES, iterations, and the residual (N,).

    The residual is f less what `apply` has made of the vectors that the solution is a sum of: it is
    true, to round-off of that sum, whether or not the tolerance is reached.

    Parameters
    ----------
    apply, precondition : callable
        (N,) to (N,).
    f : (N,)
    tolerance : float
        |residual| to reach.
    most : int
        Iterations at most.

    References
    ----------
    Y. Saad, Iterative Methods for Sparse Linear Systems (2003), Algorithm 9.5 (right
    preconditioning).
    """
    size = norm(f)
    if size <= tolerance or not np.isfinite(size):
        return np.zeros_like(f), 0, f
    basis, kept = np.empty((most + 1, len(f))), np.empty((most, len(f)))
    basis[0] = f / size
    H, R = np.zeros((2, most + 1, most))  # apply(kept[j]) = sum_i H_ij basis[i]; rotated
    rotations, g = np.zeros((most, 2)), np.zeros(most + 1)
    g[0] = size
    for j in range(most):
        kept[j] = precondition(basis[j])
        w = apply(kept[j])
        H[: j + 1, j] = _orthogonalise(basis[: j + 1], w)
        H[j + 1, j] = norm(w)
        if not np.isfinite(H[j + 1, j]):
            return np.zeros_like(f), j + 1, np.full_like(f, np.inf)
        R[: j + 2, j] = H[: j + 2, j]
        for i, (cos, sin) in enumerate(rotations[:j]):
            R[i : i + 2, j] = cos * R[i, j] + sin * R[i + 1, j], cos * R[i + 1, j] - sin * R[i, j]
        length = float(np.hypot(R[j, j], R[j + 1, j]))
        if length == 0.0:  # `apply` is singular: the vectors before are of use
            break
        rotations[j] = R[j, j] / length, R[j + 1, j] / length
        basis[j + 1] = w / H[j + 1, j] if H[j + 1, j] > 0.0 else w
        R[j, j], R[j + 1, j] = length, 0.0
        g[j], g[j + 1] = rotations[j, 0] * g[j], -rotations[j, 1] * g[j]
        if abs(g[j + 1]) <= tolerance:
            break
    count = j + 1 if length > 0.0 else j
    y = solve_triangular(R[:count, :count], g[:count]) if count else g[:0]
    left = -H[: count + 1, :count] @ y
    left[0] += size
    return _combined(kept[:count], y), j + 1, _combined(basis[: count + 1], left)


# Not by BLAS, whose threads would wait for each other, and spin.
@njit(cache=True, fastmath={"reassoc", "contract"})
def norm(x: Float) -> float:
    """|x|."""
    total = 0.0
    for value in x:
        total += value * value
    return float(np.sqrt(total))


@njit(cache=True)
def _combined(vectors: Float, shares: Float) -> Float:
    """Sum of vectors (j, N) times shares (j,)."""
    found = np.zeros(vectors.shape[1])
    for j in range(len(shares)):
        share = shares[j]
        for i in range(len(found)):
            found[i] += share * vectors[j, i]
    return found


@njit(cache=True, fastmath={"reassoc", "contract"})
def _orthogonalise(basis: Float, w: Float) -> Float:
    """Take from w, in place, what it has of orthonormal vectors (j, N); returns how much."""
    found = np.zeros(len(basis))
    for _ in range(2):  # twice is enough
        for j in range(len(basis)):
            h = 0.0
            for i in range(len(w)):
                h += basis[j, i] * w[i]
            for i in range(len(w)):
                w[i] -= h * basis[j, i]
            found[j] += h
    return found


__all__ = ["Apply", "Lagged", "gmres", "norm"]
