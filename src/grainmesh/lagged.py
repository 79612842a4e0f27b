r"""A factor kept from step to step as preconditioner of GMRES, while matrix and mesh change.

    [ A   Bᵀ ] [u]   [f]
    [ B  -S  ] [p] = [g]

An indefinite factor cannot precondition MINRES; GMRES takes it. A zero on the diagonal is no
pivot, so the pressures get a little of their own stiffness, as in `grainmesh.saddle`. Unknowns are
known by name (`grainmesh.carry`). On triangles that have come since the factor was made a second,
small system is solved for what the factor leaves,

    z = P r,    z += Rᵀ (R K Rᵀ)⁻¹ R (r - K z),                                               (1)

with R the restriction to their unknowns. Without it each flip costs iterations of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from ngsolve import GetNumThreads, SetNumThreads, TaskManager
from ngsolve.la import SparseMatrixd
from numba import njit
from numpy.typing import NDArray
from pyngcore import Array_D_S, Array_I_S
from scipy.linalg import solve_triangular

from grainmesh import integrals
from grainmesh.saddle import PIVOT

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Mask = NDArray[np.bool_]
Apply = Callable[[Float], Float]

#: Factors of more unknowns are made by all threads, and no two of those equal by round-off.
MANY = 40_000


class Lagged:
    """The factor of a matrix, for unknowns with names.

    Parameters
    ----------
    K : (t, n, n)
        Symmetric matrices of triangles; what is more than `rows` has is left out.
    rows : (t, n)
        Their unknowns.
    inside : (N,) bool
        Unknowns to solve for.
    first : int
        Number of the first pressure.
    names : (N,) int
        Names of all unknowns.
    """

    def __init__(self, K: Float, rows: Int, inside: Mask, first: int, names: Int) -> None:
        kept = np.flatnonzero(inside)
        number = np.full(len(inside), -1)
        number[kept] = np.arange(len(kept))
        i, j, values, diagonal = integrals.entries(K, rows, number, len(kept))
        # About ``PIVOT`` diag(B diag(A)⁻¹ Bᵀ) for the pressures.
        split = int(np.searchsorted(kept, first))
        coupling = (i >= split) & (j < split)
        own = np.bincount(
            i[coupling], values[coupling] ** 2 / diagonal[j[coupling]], minlength=len(kept)
        )
        at = np.arange(split, len(kept), dtype=np.int32)
        i, j = np.append(i, at), np.append(j, at)
        values = np.append(values, -PIVOT * own[split:])
        made = SparseMatrixd.CreateFromCOO(
            _array(Array_I_S, i), _array(Array_I_S, j), _array(Array_D_S, values), *2 * [len(kept)]
        )
        many = _threads()
        SetNumThreads(many if len(kept) > MANY else 1)
        try:
            with TaskManager():
                self._inverse = made.Inverse(inverse="sparsecholesky")
        finally:
            SetNumThreads(many)
        self._f, self._x = made.CreateColVector(), made.CreateColVector()
        order = np.argsort(names[kept])
        self._names, self._place = names[kept][order], order

    def preconditioner(self, names: Int) -> Apply:
        """P of Eq. (1) for unknowns of these names; 0 for those that it does not have."""
        place = np.searchsorted(self._names, names).clip(max=len(self._names) - 1)
        known = np.flatnonzero(self._names[place] == names)
        place = self._place[place[known]]
        f, x = self._f.FV().NumPy(), self._x.FV().NumPy()

        def apply(r: Float) -> Float:
            z = np.zeros_like(r)
            f[:] = 0.0
            f[place] = r[known]
            self._x.data = self._inverse * self._f  # by one thread: memory is what it waits for
            z[known] = x[place]
            return z

        return apply


@lru_cache
def _threads() -> int:
    """How many threads NGSolve has been told to use; it says so only while it uses them."""
    with TaskManager():
        return int(GetNumThreads())


def _array(kind: Any, values: NDArray[Any]) -> Any:
    found = kind(len(values))
    found.NumPy()[:] = values
    return found


def mended(first: Apply, apply: Apply, patch: Apply) -> Apply:
    """Eq. (1), from P, K and Rᵀ (R K Rᵀ)⁻¹ R."""

    def both(r: Float) -> Float:
        z = first(r)
        z += patch(r - apply(z))
        return z

    return both


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


__all__ = ["Apply", "Lagged", "gmres", "mended", "norm"]
