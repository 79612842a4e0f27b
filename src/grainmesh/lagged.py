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
        self._factor, self._size = factor, len(sought)
        self._place, self._names = kept[order], names[kept][order]

    def preconditioner(self, sought: Mask, names: Int, diagonal: Float) -> Apply:
        """About K⁻¹ for the unknowns sought, of these names, with this diagonal (N,)."""
        known = np.flatnonzero(sought)
        place = np.searchsorted(self._names, names[known]).clip(max=len(self._names) - 1)
        there = self._names[place] == names[known]
        new, known, place = known[~there], known[there], self._place[place[there]]
        share = 1.0 / diagonal[new]

        def apply(r: Float) -> Float:
            f, z = np.zeros(self._size), np.zeros_like(r)
            f[place] = r[known]
            z[known] = self._factor.solve(f)[place]
            z[new] = share * r[new]
            return z

        return apply


def gmres(
    apply: Apply,
    precondition: Apply,
    f: Float,
    tolerance: float,
    most: int,
) -> tuple[Float, int, float]:
    """Solution from zero by preconditioned GMRES, iterations, and |residual|.

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
        return np.zeros_like(f), 0, size
    basis, kept = np.empty((most + 1, len(f))), []
    basis[0] = f / size
    H, rotations, g = np.zeros((most + 1, most)), np.zeros((most, 2)), np.zeros(most + 1)
    g[0] = size
    for j in range(most):
        kept.append(precondition(basis[j]))
        w = apply(kept[j])
        H[: j + 1, j] = _orthogonalise(basis[: j + 1], w)
        H[j + 1, j] = norm(w)
        if not np.isfinite(H[j + 1, j]):
            return np.zeros_like(f), j + 1, np.inf
        for i, (cos, sin) in enumerate(rotations[:j]):
            H[i : i + 2, j] = cos * H[i, j] + sin * H[i + 1, j], cos * H[i + 1, j] - sin * H[i, j]
        length = float(np.hypot(H[j, j], H[j + 1, j]))
        if length == 0.0:
            break
        rotations[j] = H[j, j] / length, H[j + 1, j] / length
        basis[j + 1] = w / H[j + 1, j] if H[j + 1, j] > 0.0 else w
        H[j, j], H[j + 1, j] = length, 0.0
        g[j], g[j + 1] = rotations[j, 0] * g[j], -rotations[j, 1] * g[j]
        if abs(g[j + 1]) <= tolerance:
            break
    count = len(kept)
    y = solve_triangular(H[:count, :count], g[:count])
    return sum(c * z for c, z in zip(y, kept, strict=True)), count, abs(float(g[count]))


# Not by BLAS, whose threads would wait for each other, and spin.
@njit(cache=True, fastmath={"reassoc", "contract"})
def norm(x: Float) -> float:
    """|x|."""
    total = 0.0
    for value in x:
        total += value * value
    return float(np.sqrt(total))


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
