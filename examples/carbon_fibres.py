"""A carbon-fibre composite
========================

Permeability of a real composite across its fibres, by three methods.

.. image:: /_static/gallery/carbon_fibres.png
   :alt: Carbon fibres, the mesh on them, and the resolved flow

Run it with::

    python examples/carbon_fibres.py --out out/demo

The fibres are those of one X-ray CT slice (data/carbon_fibres.csv says whose). Their radii are
known to some 10 %, which matters more than any error of the computation: every method runs with the
radii as given, 5 % smaller and 5 % larger. The source does not give the size of a pixel, so K/d² is
the result; the pixel is declared here to make the mean fibre 7 micrometres thick.
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/carbon_fibres.png"

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

import grainmesh as gm
from grainmesh import plot, report
from grainmesh.particles import touches
from grainmesh.permeability import METHODS

DATA = Path(__file__).parent / "data" / "carbon_fibres.csv"
PIXEL = 0.722e-6  # [m], declared: the mean fibre is 7 micrometres thick
SCALES = (1.0, 0.95, 1.05)  # of the radii
BAND_TOL = 3e-2  # for the band: small against its width

Results = dict[tuple[str, float], gm.Permeability]

# %%
# Fibres that touch the window. The radii are given, and 5 % smaller and larger.


def load(side: float, scale: float) -> tuple[gm.Box, gm.Particles]:
    """Fibres that touch the window of `side` pixels, radii times `scale`."""
    box, fibres = gm.arrange.from_csv(DATA, unit=PIXEL, width=side * PIXEL, height=side * PIXEL)
    fibres = fibres.with_diameter(scale * fibres.diameter)
    return box, fibres.select(touches(box, fibres))


# %%
# Three methods at three radii; files are written whole or not at all.


def run(out: Path, *, side: float = 200.0, tol: float = 1e-3) -> Results:
    """All methods at all radii; writes carbon.png and carbon.csv into `out`."""
    report.prove_writable(out, ["carbon.png", "carbon.csv"])
    results: Results = {}
    columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("reading", total=None)
        for scale in SCALES:
            box, fibres = load(side, scale)
            for method in METHODS:
                name = f"{method}, radii x {scale:g}: "
                results[method, scale] = gm.permeability(
                    box,
                    fibres,
                    method,
                    tol=tol if scale == 1.0 else max(tol, BAND_TOL),
                    progress=lambda text, name=name: bar.update(task, description=name + text),
                )
        bar.update(task, description="drawing")
        box, fibres = load(side, 1.0)
        figure = plot.overview(box, fibres, [results[method, 1.0] for method in METHODS])
        rows = [
            {"radii": scale} | report.rows([result])[0] for (_, scale), result in results.items()
        ]
        comments = [
            "made by: python examples/carbon_fibres.py; SI units",
            f"declared, not measured: one pixel = {PIXEL:g} m. K/d2 (normalised) does not need it",
        ]
        report.write(
            out,
            {
                "carbon.png": lambda path: plot.save(figure, path),
                "carbon.csv": lambda path: report.write_csv(path, rows, comments),
            },
        )
    return results


# %%
# What is printed, and the command line.


def table(results: Results) -> Table:
    """K/d² with its band over the radii, unknowns, time and error of each method."""
    screen = Table()
    for title in ("method", "K/d²", "radii ± 5 %", "unknowns", "seconds", "error"):
        screen.add_column(title, justify="left" if title == "method" else "right")
    for method in METHODS:
        found = results[method, 1.0]
        band = sorted(results[method, scale].normalised for scale in SCALES)
        screen.add_row(
            method,
            f"{found.normalised:.3g}",
            f"{band[0]:.2g} .. {band[-1]:.2g}",
            f"{found.dofs}",
            f"{found.seconds:.2g}",
            f"{100 * found.error:.2g} %",
        )
    return screen


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="folder to write to")
    out = parser.parse_args().out
    matplotlib.use("Agg")
    results = run(out)
    fibres = results["resolved", 1.0]
    print(
        f"{fibres.n} carbon fibres, porosity {fibres.porosity:.3f}, mean gap {fibres.gap:.3f} d; "
        f"d = {1e6 * fibres.diameter:.2f} micrometres is declared, K/d² does not need it"
    )
    Console().print(table(results))
    for note in fibres.notes:
        print(f"resolved: {note}")
    print("The error of mesoscale and microstructure is that of the law for its own medium,")
    print("equal discs at random; the band is that of the radii, which are known to 10 %.")
    print(f"{out / 'carbon.png'}\n{out / 'carbon.csv'}")


if __name__ == "__main__":
    main()
