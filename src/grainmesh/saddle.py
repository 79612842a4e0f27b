"""Symmetric saddle-point systems: L D Lᵀ of a nearby matrix, and refinement to round-off.

    [ A  Bᵀ ] [u]   [f]
    [ B  0  ] [p] = [g]

A zero on the diagonal is no pivot. For the factorisation only, the pressures get

    -PIVOT diag(B diag(A)⁻¹ Bᵀ)

which makes the matrix quasi-definite, so that it has an L D Lᵀ in any order of elimination; sweeps
of refinement with the matrix itself then remove what was added. A pressure that is fixed by nothing
(the constant in a periodic box, or in a pore that is shut off) needs no care.
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np
from ngsolve import TaskManager
from numpy.typing import NDArray

#: Share of the pressures' own stiffness added to their diagonal.
PIVOT = 1e-10
#: Meshes of no more elements than this are not worth a second thread.
FEW = 10_000
#: Sweeps at most; they end when one no longer reduces the residual by `STALLED`.
SWEEPS, STALLED = 60, 0.9
#: Residual, relative to the right-hand side, that must be reached.
REACHED = 1e-9


def threads(mesh: Any) -> AbstractContextManager[Any]:
    """NGSolve's threads for large meshes; small ones are faster without, much so when busy."""
    return TaskManager() if mesh.ne > FEW else nullcontext()


def entries(matrix: Any) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Stored values of an NGSolve matrix (writable), and the column and row of each."""
    values, columns, start = (np.asarray(part) for part in matrix.CSR())
    count = np.diff(start.astype(np.int64)).astype(np.int64)
    return values, columns, np.repeat(np.arange(matrix.height), count)


class SaddleFactor:
    """Solver for a square sparse NGSolve matrix whose pressures start at unknown `first`.

    Parameters
    ----------
    matrix : ngsolve.SparseMatrix
        Symmetric, both triangles stored; left as it is.
    first : int
        Number of the first pressure.
    free : ngsolve.BitArray
        Unknowns to solve for.
    """

    def __init__(self, matrix: Any, first: int, free: Any) -> None:
        values, columns, row = entries(matrix)
        diagonal = np.flatnonzero(columns == row)
        stiffness = np.ones(matrix.height)
        stiffness[row[diagonal]] = values[diagonal]
        coupling = np.flatnonzero((row >= first) & (columns < first))
        weight = values[coupling] ** 2 / stiffness[columns[coupling]]
        own = np.bincount(row[coupling], weight, matrix.height)
        place = diagonal[row[diagonal] >= first]
        kept = values[place].copy()
        values[place] -= PIVOT * own[row[place]]
        self.inverse = matrix.Inverse(free, "sparsecholesky")
        values[place] = kept
        self.matrix = matrix
        self.free = np.asarray(free)

    def solve(self, f: Any, x: Any) -> Any:
        """Solve for the free unknowns of vector `x`, from zero; returns the residual f - M x.

        Raises
        ------
        RuntimeError
            If refinement does not reach round-off.
        """
        residual = f.CreateVector()
        residual.data = f
        x[:] = 0.0
        size = norm = float(np.linalg.norm(f.FV().NumPy()[self.free]))
        for sweep in range(SWEEPS):
            x += self.inverse * residual
            residual.data = f - self.matrix * x
            last, norm = norm, float(np.linalg.norm(residual.FV().NumPy()[self.free]))
            if sweep > 0 and norm >= STALLED * last:
                break
        if not norm <= REACHED * size:
            raise RuntimeError(
                f"linear solver: residual {norm / size:.1e} after {sweep + 1} sweeps"
            )
        return residual
