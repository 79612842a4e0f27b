r"""An L D Lᵀ kept from step to step as preconditioner of GMRES, while the matrix changes.

    [ A   Bᵀ ] [u]   [f]
    [ B  -S  ] [p] = [g]

Pressures are counted in a unit s in which both rows weigh alike, and get the small extra diagonal
of `grainmesh.saddle`, so that the matrix is quasi-definite. An indefinite factor cannot
precondition MINRES; GMRES takes it. Unknowns are known by name (`grainmesh.carry`): those that came
after the factor was made are only divided by their diagonal.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from ngsolve import la
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.sparse import block_array, csr_array, diags_array

from grainmesh.saddle import PIVOT

Float = NDArray[np.float64]
Int = NDArray[np.int64]


def csr(matrix: Any) -> csr_array:
    """An NGSolve matrix as one of SciPy, not copied."""
    values, columns, start = (np.asarray(part) for part in matrix.CSR())
    return csr_array((values, columns, start.astype(np.int64)), (matrix.height, matrix.width))


class Lagged:
    """The factor of a matrix, for unknowns with names.

    Parameters
    ----------
    a, b, s : ngsolve.SparseMatrix
        Blocks as above.
    free : (N,) bool
        Unknowns to solve for, velocities first.
    names : (N,) int
        Names of all unknowns; images of one unknown that are not free may share its name.
    unit : float
        s [Pa s/m].
    """

    def __init__(self, a: Any, b: Any, s: Any, free: NDArray[np.bool_], names: Int, unit: float):
        split = a.height
        rows = np.flatnonzero(free)
        u, p = rows[rows < split], rows[rows >= split] - split
        A, B, S = csr(a)[u][:, u], unit * csr(b)[p][:, u], unit**2 * csr(s)[p][:, p]
        own = (B**2) @ (1.0 / A.diagonal())
        matrix = block_array([[A, B.T], [B, -S - diags_array(PIVOT * own)]], format="coo")
        held = la.SparseMatrixd.CreateFromCOO(
            matrix.row.astype(np.int32), matrix.col.astype(np.int32), matrix.data, *matrix.shape
        )
        self._inverse = held.Inverse(inverse="sparsecholesky")
        self._f, self._x = held.CreateColVector(), held.CreateColVector()
        self.unit, self.size = unit, len(rows)
        name = names[rows]
        self._order = np.argsort(name)
        self._names = name[self._order]

    def where(self, names: Int) -> tuple[NDArray[np.bool_], Int]:
        """Which of some unknowns it has, and where."""
        place = np.searchsorted(self._names, names).clip(max=len(self._names) - 1)
        return self._names[place] == names, self._order[place]

    def __call__(self, f: Float) -> Float:
        """Solution for a right-hand side, in its own numbering and unit of pressure."""
        self._f.FV().NumPy()[:] = f
        self._x.data = self._inverse * self._f
        return np.array(self._x.FV().NumPy())


def gmres(
    apply: Callable[[Float], Float],
    precondition: Callable[[Float], Float],
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


__all__ = ["Lagged", "csr", "gmres"]
