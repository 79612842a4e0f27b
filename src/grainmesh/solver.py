"""The linear solver of the flow: GMRES with a factor that is kept while it pays.

A factor costs as much as `FACTOR` iterations. It is made anew as soon as a step with the old one
costs more than steps with it did on average, its own cost among them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from grainmesh.errors import RunError
from grainmesh.lagged import Apply, Lagged, gmres, norm
from grainmesh.navier import Operator

Float = NDArray[np.float64]
Arrays = dict[str, NDArray[Any]]

#: Iterations at most, and how many of them a new factor costs.
MOST, FACTOR = 60, 8.0
#: Share of the right-hand side that a residual is compared with at least.
SMALL = 1e-4
#: What can be reached, over the right-hand side.
ROUND_OFF = 1e-15
#: What a checkpoint holds besides the factor.
NUMBERS = ("iterations", "factors", "spent", "since")
FIELDS = ("free", "eps", "inertia", "E", "S", "stirred")


class Solver:
    """Solves for the unknowns of one operator after the other.

    Attributes
    ----------
    iterations : int
        In the last step.
    factors : int
        Made so far.
    spent, since : float, int
        Iterations, or what costs as much, in the steps with the present factor; their number.
    recipe : dict of arrays
        All that is needed to make the factor again; empty if there is none.
    """

    def __init__(self) -> None:
        self.iterations = self.factors = self.since = 0
        self.spent = 0.0
        self.forget()

    def forget(self) -> None:
        """Make a new factor in the next step."""
        self._factor: Lagged | None = None
        self.recipe: Arrays = {}

    def numbers(self) -> dict[str, Any]:
        """What goes into a checkpoint beside `recipe`."""
        return {name: getattr(self, name) for name in NUMBERS}

    @classmethod
    def resumed(cls, numbers: dict[str, Any], recipe: Arrays, now: Operator) -> Self:
        """The solver that these were of; `now` is an operator of the same flow."""
        self = cls()
        if recipe:
            parts: dict[str, Any] = {key: recipe[key] for key in ("triangles", "shifts")}
            on = replace(now.topology, **parts)
            op = Operator(on, recipe["points"], now.order, now.viscosity, now.density)
            op.load(**{name: recipe[name] for name in FIELDS})
            op.floating = now.floating
            op.assemble()
            self._make(op, recipe["points"])
        for name in NUMBERS:
            setattr(self, name, numbers[name])
        return self

    def solve(self, op: Operator, points: Float, f: Float, unit: float, tolerance: float) -> Float:
        """Solve for the unknowns of an operator, from those that it has.

        Parameters
        ----------
        op : Operator
            Assembled.
        points : (m, 2)
            Where its points are [m].
        f : (N,)
            Right-hand side.
        unit : float
            In which pressures are counted, so that both kinds of equations weigh alike.
        tolerance : float
            Residual over that of the unknowns at hand, or over `SMALL` of the right-hand side.

        Where nothing gives the pressure a level, its mean is made 0.

        Returns
        -------
        (N,)
            What is left of f, 0 where nothing is sought.

        Raises
        ------
        RunError
            If it does not converge.
        """
        some = np.flatnonzero(op.sought)
        scale = np.where(some < op.split, 1.0, unit)
        ends = [op.split, op.split + (op.topology.count if op.floating else 0)]
        level = slice(*np.searchsorted(some, ends))  # pressures whose mean is to be 0

        def apply(z: Float) -> Float:
            x = np.zeros_like(f)
            x[some] = scale * z
            found: Float = scale * op.apply(x)[some]
            return found

        f, x = op.condensed(f), op.x
        # What is to come into a closed box, by round-off or so, has no place in it.
        wanted = scale * _levelled(f[some], level)
        r = wanted - scale * op.apply(x)[some]
        size, wrong = norm(wanted), norm(r)
        if not np.isfinite(size + wrong):
            raise RunError("the flow is not finite: forces have blown up, or steps are too long")
        goal = max(tolerance * max(wrong, SMALL * size), ROUND_OFF * size, 1e-300)
        names, diagonal = op.names[some], op.diagonal[some]
        for attempt in range(2):
            fresh = self._factor is None or attempt == 1
            if fresh:
                self._make(op, points)
            assert self._factor is not None
            divide = self._factor.preconditioner(names, diagonal)

            def precondition(r: Float, divide: Apply = divide) -> Float:
                return _levelled(divide(r / scale), level) / scale

            delta, self.iterations, rest = gmres(apply, precondition, r, goal, MOST)
            left = norm(rest)
            if left <= max(2.0 * goal, 100.0 * ROUND_OFF * size):
                break
        else:
            raise RunError(
                f"the linear solver does not converge: residual {left / max(size, wrong):.1e} "
                f"after {MOST} iterations, with a step of the flow that is perhaps too long "
                "(Fluid(dt=...))"
            )
        if fresh:
            self.spent, self.since = FACTOR, 0
        self.spent, self.since = self.spent + self.iterations, self.since + 1
        if self.iterations * self.since > self.spent:
            self.forget()
        x[some] = _levelled(x[some] + scale * delta, level)
        op.completed(f, x)
        op.x = x
        residual = np.zeros_like(f)
        residual[some] = rest / scale
        return residual

    def _make(self, op: Operator, points: Float) -> None:
        on = op.topology
        self._factor = Lagged(op.factor(), op.sought, op.names)
        self.factors += 1
        self.recipe = {"triangles": on.triangles, "shifts": on.shifts, "points": points.copy()}
        self.recipe |= {key: getattr(op, key).copy() for key in FIELDS}


def _levelled(x: Float, level: slice) -> Float:
    """x, from which the mean over a part is taken in place, if that is not empty."""
    if level.start < level.stop:
        x[level] -= x[level].mean()
    return x


__all__ = ["Solver"]
