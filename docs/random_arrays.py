"""Eq. (4) against resolved Stokes flow in random periodic arrays: the table in random_arrays.md.

    python docs/random_arrays.py [--quick]

Five samples of 100 equilibrated hard discs at each porosity, without and with a minimum gap of
0.05 and 0.1 d; permeability resolved to 0.1 %, gamma of each sample from its triangulation.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import xarray

import grainmesh as gm

POROSITIES = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
MIN_GAPS = (0.0, 0.05, 0.1)
SAMPLES, N = 5, 100
BEGIN, END = "<!-- table: python docs/random_arrays.py -->", "<!-- end of table -->"


def measure(n: int, samples: int, porosities: tuple[float, ...]) -> xarray.Dataset:
    """Resolved permeabilities, and the ratio Eq. (4) / resolved, by min_gap, porosity and seed."""

    def sample(min_gap: float, porosity: float, seed: int) -> gm.Permeability:
        print(f"min_gap {min_gap} porosity {porosity} sample {seed}", end="\r", flush=True)
        return gm.permeability(
            *gm.arrange.random(n, porosity=porosity, diameter=1.0, min_gap=min_gap, seed=seed)
        )

    found = gm.sweep(sample, min_gap=MIN_GAPS, porosity=porosities, seed=range(samples))
    law = gm.closures.Microstructural()
    return found.assign(ratio=law(found.porosity, found.gap) / found.normalised)


def fit(ratio: np.ndarray) -> tuple[float, float, float]:
    """C by least squares of log lambda, its standard error, the relative scatter of a sample."""
    log = -np.log(ratio)
    scatter = log.std(ddof=1)
    C = gm.closures.Microstructural().C * np.exp(log.mean())
    return float(C), float(C * scatter / np.sqrt(len(log))), float(scatter)


def table(found: xarray.Dataset) -> str:
    """The measured ratios and the fits, as Markdown."""
    lines = [
        "| min. gap / d | porosity | γ | resolved K/d² | scatter | Eq. (4) / resolved | range |",
        "|---|---|---|---|---|---|---|",
    ]
    for min_gap in found.min_gap.values:
        for porosity in found.porosity.values:
            of = found.sel(min_gap=min_gap, porosity=porosity)
            gap, K, ratio = of.gap.values, of.normalised.values, of.ratio.values
            lines.append(
                f"| {min_gap:g} | {porosity:g} | {gap.mean():.3f} | {K.mean():.3e} "
                f"| {K.std(ddof=1) / K.mean():.0%} | {ratio.mean():.2f} "
                f"| {ratio.min():.2f} to {ratio.max():.2f} |"
            )
    lines += ["", "| fitted to | C | standard error | scatter of one sample |", "|---|---|---|---|"]
    for name, gaps in (
        ("all samples", MIN_GAPS),
        ("no minimum gap", [0.0]),
        ("minimum gap 0.05 d", [0.05]),
        ("minimum gap 0.1 d", [0.1]),
    ):
        C, error, scatter = fit(found.ratio.sel(min_gap=list(gaps)).values.ravel())
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
