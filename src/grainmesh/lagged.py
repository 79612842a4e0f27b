r"""A factor kept from step to step as preconditioner of GMRES, while matrix and mesh change.

    [ A   Bᵀ ] [u]   [f]
    [ B  -S  ] [p] = [g]

An indefinite factor cannot precondition MINRES; GMRES takes it. Unknowns are known by name
(`grainmesh.carry`). On triangles that have come since the factor was made a second, small system
is solved for what the factor leaves,

    z = P r,    z += Rᵀ (R K Rᵀ)⁻¹ R (r - K z),                                               (1)

with R the restriction to their unknowns. Without it each flip costs iterations of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from ngsolve import GetNumThreads, SetNumThreads
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.sparse import block_array, csr_array, diags_array
from scipy.sparse.linalg import splu

from grainmesh.saddle import PIVOT, SaddleFactor

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Apply = Callable[[Float], Float]

#: Factors of more unknowns are made by all threads; of fewer, equal input gives equal bits.
MANY = 40_000


def csr(matrix: Any) -> csr_array:
    """An NGSolve matrix as one of SciPy, not copied."""
    values, columns, start = (np.asarray(part) for part in matrix.CSR())
    return csr_array((values, columns, start.astype(np.int64)), (matrix.height, matrix.width))


class Lagged:
    """The factor of a matrix, for unknowns with names.

    Parameters
    ----------
    matrix : ngsolve.SparseMatrix
        The whole matrix.
    first : int
        Number of the first pressure.
    free : ngsolve.BitArray
        Unknowns to solve for.
    names : (N,) int
        Names of all unknowns; images of one unknown that are not free may share its name.
    """

    def __init__(self, matrix: Any, first: int, free: Any, names: Int) -> None:
        # The factor of several threads is another one each time, by round-off.
        count = GetNumThreads()
        SetNumThreads(count if matrix.height > MANY else 1)
        try:
            self._inverse = SaddleFactor(matrix, first, free).inverse
        finally:
            SetNumThreads(count)
        self._f, self._x = matrix.CreateColVector(), matrix.CreateColVector()
        rows = np.flatnonzero(np.asarray(free))
        order = np.argsort(names[rows])
        self._names, self._place = names[rows][order], rows[order]

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
            self._x.data = self._inverse * self._f  # one thread: to wake others takes longer
            z[known] = x[place]
            return z

        return apply


def mended(first: Apply, apply: Apply, a: Any, b: Any, s: Any, inside: NDArray[np.bool_]) -> Apply:
    """Eq. (1), from P and K, for the unknowns `inside` (N,) of blocks of the matrix."""
    split = a.shape[0]
    rows = np.flatnonzero(inside)
    u, p = rows[rows < split], rows[rows >= split] - split
    A, B, S = a[u][:, u], b[p][:, u], s[p][:, p]
    own = (B**2) @ (1.0 / A.diagonal())
    patch = splu(block_array([[A, B.T], [B, -S - diags_array(PIVOT * own)]], format="csc"))

    def both(r: Float) -> Float:
        z = first(r)
        z[rows] += patch.solve((r - apply(z))[rows])
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
    size = float(np.linalg.norm(f))
    if size <= tolerance:
        return np.zeros_like(f), 0, size
    basis, kept = [f / size], []
    H, rotations, g = np.zeros((most + 1, most)), np.zeros((most, 2)), np.zeros(most + 1)
    g[0] = size
    for j in range(most):
        kept.append(precondition(basis[j]))
        w = apply(kept[j])
        for _ in range(2):  # twice is enough
            for i in range(j + 1):
                h = float(basis[i] @ w)
                H[i, j] += h
                w -= h * basis[i]
        H[j + 1, j] = np.linalg.norm(w)
        for i, (cos, sin) in enumerate(rotations[:j]):
            H[i : i + 2, j] = cos * H[i, j] + sin * H[i + 1, j], cos * H[i + 1, j] - sin * H[i, j]
        length = float(np.hypot(H[j, j], H[j + 1, j]))
        if length == 0.0:
            break
        rotations[j] = H[j, j] / length, H[j + 1, j] / length
        basis.append(w / H[j + 1, j] if H[j + 1, j] > 0.0 else w)
        H[j, j], H[j + 1, j] = length, 0.0
        g[j], g[j + 1] = rotations[j, 0] * g[j], -rotations[j, 1] * g[j]
        if abs(g[j + 1]) <= tolerance:
            break
    count = len(kept)
    y = solve_triangular(H[:count, :count], g[:count])
    return sum(c * z for c, z in zip(y, kept, strict=True)), count, abs(float(g[count]))


__all__ = ["Apply", "Lagged", "csr", "gmres", "mended"]
