"""Eq. (4) against resolved Stokes flow in random periodic arrays: the table in random_arrays.md.

    python docs/random_arrays.py [--quick]

Five samples of 100 equilibrated hard discs at each porosity, without and with a minimum gap of
0.05 and 0.1 d; permeability resolved to 0.1 %, gamma of each sample from its triangulation.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import grainmesh as gm

POROSITIES = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
MIN_GAPS = (0.0, 0.05, 0.1)
SAMPLES, N = 5, 100
BEGIN, END = "<!-- table: python docs/random_arrays.py -->", "<!-- end of table -->"


def measure(n: int, samples: int, porosities: tuple[float, ...]) -> np.ndarray:
    """Rows (min_gap, porosity, gamma, resolved K/d2, ratio Eq. (4) / resolved)."""
    law = gm.closures.Microstructural()
    rows = []
    for min_gap in MIN_GAPS:
        for porosity in porosities:
            for seed in range(samples):
                box, discs = gm.arrange.random(
                    n, porosity=porosity, diameter=1.0, min_gap=min_gap, seed=seed
                )
                K = gm.permeability(box, discs)
                rows.append(
                    (min_gap, porosity, K.gap, K.normalised, law(porosity, K.gap) / K.normalised)
                )
                print(f"min_gap {min_gap} porosity {porosity} sample {seed}", end="\r", flush=True)
    return np.array(rows)


def fit(ratio: np.ndarray) -> tuple[float, float, float]:
    """C by least squares of log lambda, its standard error, the relative scatter of a sample."""
    log = -np.log(ratio)
    scatter = log.std(ddof=1)
    C = gm.closures.Microstructural().C * np.exp(log.mean())
    return float(C), float(C * scatter / np.sqrt(len(log))), float(scatter)


def table(rows: np.ndarray) -> str:
    """The measured ratios and the fits, as Markdown."""
    lines = [
        "| min. gap / d | porosity | γ | resolved K/d² | scatter | Eq. (4) / resolved | range |",
        "|---|---|---|---|---|---|---|",
    ]
    for min_gap in MIN_GAPS:
        for porosity in np.unique(rows[:, 1]):
            _, _, gap, K, ratio = rows[(rows[:, 0] == min_gap) & (rows[:, 1] == porosity)].T
            lines.append(
                f"| {min_gap:g} | {porosity:g} | {gap.mean():.3f} | {K.mean():.3e} "
                f"| {K.std(ddof=1) / K.mean():.0%} | {ratio.mean():.2f} "
                f"| {ratio.min():.2f} to {ratio.max():.2f} |"
            )
    lines += ["", "| fitted to | C | standard error | scatter of one sample |", "|---|---|---|---|"]
    for name, keep in (
        ("all samples", rows[:, 0] >= 0.0),
        ("no minimum gap", rows[:, 0] == 0.0),
        ("minimum gap 0.05 d", rows[:, 0] == 0.05),
        ("minimum gap 0.1 d", rows[:, 0] == 0.1),
    ):
        C, error, scatter = fit(rows[keep, 4])
        lines.append(f"| {name} | {C:.4f} | {error:.4f} | {scatter:.0%} |")
    return "\n".join(lines)


def main() -> None:
    """Measure, and rewrite the table of random_arrays.md (not with --quick)."""
    if "--quick" in sys.argv:
        print(table(measure(40, 2, (0.5, 0.8))))
        return
    text = table(measure(N, SAMPLES, POROSITIES))
    print(text)
    page = Path(__file__).with_suffix(".md")
    before, rest = page.read_text(encoding="utf-8").split(BEGIN)
    after = rest.split(END)[1]
    page.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
