"""The fit of `drag.RandomDiscs` and the tables of drag.md: ``python docs/drag.py [--quick]``.

Periodic samples of 50 equilibrated hard discs, eight at each porosity; permeability resolved to
1 %, and once more on the coarse mesh with the fitted law.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

import grainmesh as gm
from grainmesh.closures import ClosureWarning, HexagonalLattice
from grainmesh.drag import DRAGS, RandomDiscs

POROSITIES = (0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98)
SAMPLES, N = 8, 50
LAWS = ("<!-- laws: python docs/drag.py -->\n", "<!-- end of laws -->\n")
FIT = ("<!-- fit: python docs/drag.py -->\n", "<!-- end of fit -->\n")


def measure(porosities: tuple[float, ...], samples: int) -> np.ndarray:
    """λ resolved and on the coarse mesh, shape (porosities, samples, 2)."""
    found = np.empty((len(porosities), samples, 2))
    for i, porosity in enumerate(porosities):
        for seed in range(samples):
            box, discs = gm.arrange.random(N, porosity=porosity, diameter=1.0, seed=seed)
            found[i, seed] = (
                gm.permeability(box, discs, tol=1e-2).normalised,
                gm.permeability(box, discs, "mesoscale", law=RandomDiscs()).normalised,
            )
    return found


def fitted(porosity: np.ndarray, lam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """a, b, c of Eq. (3) by least squares of ln λ, and their standard errors."""
    phi = 1.0 - porosity
    ratio = np.log(lam / HexagonalLattice()(porosity, 1.0))

    def misfit(abc: np.ndarray) -> np.ndarray:
        a, b, c = abc
        return np.log1p(a / (1.0 - np.log(phi))) - b * phi**c - ratio

    fit = least_squares(misfit, (2.0, 3.0, 1.0))
    variance = 2.0 * fit.cost / (len(phi) - 3) * np.linalg.inv(fit.jac.T @ fit.jac)
    return fit.x, np.sqrt(np.diag(variance))


def fit_table(porosities: tuple[float, ...], found: np.ndarray) -> str:
    """What was measured, and a, b, c."""
    lines = [
        "| porosity | resolved K/d² | scatter of one | law / resolved | coarse mesh / resolved |",
        "|---|---|---|---|---|",
    ]
    for porosity, (lam, coarse) in zip(porosities, np.swapaxes(found, 1, 2), strict=True):
        mean = np.exp(np.log(lam).mean())
        lines.append(
            f"| {porosity:g} | {mean:.3e} | {np.log(lam).std(ddof=1):.0%} "
            f"| {RandomDiscs()(porosity, 1.0) / mean:.2f} "
            f"| {np.exp(np.log(coarse / lam).mean()):.2f} |"
        )
    values, errors = fitted(np.repeat(porosities, found.shape[1]), found[..., 0].ravel())
    best = ", ".join(
        f"{n} = {v:.2f} ± {e:.2f}" for n, v, e in zip("abc", values, errors, strict=True)
    )
    return "\n".join(lines) + f"\n\nLeast squares of ln λ: {best}.\n"


def law_table() -> str:
    """Name, medium, range and reference of every law."""
    lines = ["| Law | Medium | Range | `<u>` is | Reference |", "|---|---|---|---|---|"]
    for name, law in DRAGS.items():
        drag = law(depth=1.0) if name in ("stokes", "schiller-naumann") else law()
        low, high = drag.valid
        velocity = "far away" if drag.undisturbed else "in the bed"
        lines.append(
            f"| `{name}` | {drag.medium} | {drag.variable} {low:.3g} to {high:.3g} "
            f"| {velocity} | {drag.reference} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, print, and rewrite the tables of drag.md (not with --quick)."""
    warnings.simplefilter("ignore", ClosureWarning)
    if "--quick" in sys.argv:
        few = (0.3, 0.5, 0.7, 0.9)
        print(fit_table(few, measure(few, 2)))
        return
    page = Path(__file__).with_suffix(".md")
    text = page.read_text(encoding="utf-8")
    for (begin, end), table in (
        (LAWS, law_table()),
        (FIT, fit_table(POROSITIES, measure(POROSITIES, SAMPLES))),
    ):
        print(table)
        head, rest = text.split(begin)
        text = head + begin + table + end + rest.split(end)[1]
    page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
