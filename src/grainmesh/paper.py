"""Figures of the paper again: Yazdchi, Srivastava & Luding, Powders & Grains 2013.

Each function writes a picture and the numbers in it. What the paper does not give is chosen here
and said so: for Fig. 2 the channel is 10 mm high and holds water, which makes it Stokes flow (a
Reynolds number of a fibre below one); the mean velocity scales as G H²/mu. For Fig. 3 it is disc,
fluid and drag law, such that the disc settles at the 0.17 m/s of the paper.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from grainmesh import __version__, arrange, fluid, plot, report
from grainmesh.cells import cells
from grainmesh.closures import Law, Microstructural, SquareLattice
from grainmesh.contact import Contact
from grainmesh.domain import Box
from grainmesh.drag import Channel
from grainmesh.medium import Fluid, Slip
from grainmesh.model import Model
from grainmesh.particles import Particles, touches
from grainmesh.permeability import permeability
from grainmesh.simulation import Simulation
from grainmesh.triangulation import triangulate

Row = dict[str, Any]
Tell = Callable[[str], None]
Run = tuple[Law, fluid.Kernel, int]  # drag law, kernel, order

#: Fig. 2: pressure gradient of the paper [Pa/m]; height [m] and viscosity [Pa s] are ours.
GRADIENT, HEIGHT, VISCOSITY = 5.0, 0.01, 1e-3
#: Least gap of random discs over the diameter, ours: keeps meshes of narrow gaps small.
MIN_GAP = 0.05
#: Fig. 3: box [m] and speed [m/s] of the paper; diameter [m], densities [kg/m3], viscosity [Pa s]
#: are ours.
SIDE, SETTLED = 2.0, 0.17
DISC, LIQUID, SOLID, THICK = 0.1, 1000.0, 2000.0, 75.2
#: Order of the resolved flows; their estimated errors stand in the table.
ORDER = 3


def fig1(out: Path, *, quick: bool = False, progress: Tell = lambda _: None) -> None:
    """800 random discs at porosity 0.6 in a box with walls, and their Delaunay mesh.

    Parameters
    ----------
    out : Path
        Folder for fig1.png and fig1.csv.
    quick : bool
        200 discs.
    progress : callable, optional
        Is told each stage in a few words.
    """
    n = 200 if quick else 800
    progress(f"{n} random discs")
    box, particles = arrange.random(n, porosity=0.6, diameter=0.01, periodic=False, seed=1)
    mesh = triangulate(box, particles)
    angles = np.degrees(mesh.angles)
    numbers = {
        "discs": n,
        "porosity": 1.0 - float(cells(box, particles).solid.sum()) / box.area,
        "triangles": len(mesh.triangles),
        "wall_nodes": len(mesh.points) - n,
        "gamma": mesh.gap_shortest,
        "gamma_second": mesh.gap_second,
        "smallest_angle_deg": float(angles.min()),
        "mean_smallest_angle_deg": float(angles.min(axis=1).mean()),
        "largest_angle_deg": float(angles.max()),
    }
    progress("drawing")
    figure, ax = plt.subplots(figsize=(7, 7), layout="constrained")
    plot.discs(box, particles, ax)
    plot.mesh(mesh, ax)
    ax.set_title(f"{n} discs, porosity 0.6: {len(mesh.triangles)} triangles", fontsize=10)
    report.write(
        out,
        {
            "fig1.png": lambda path: plot.save(figure, path),
            "fig1.csv": lambda path: report.write_csv(path, [numbers], _made("fig1", quick)),
        },
    )


def fig2(out: Path, *, quick: bool = False, progress: Tell = lambda _: None) -> None:
    """Mean velocity against porosity in a square channel with no-slip top and bottom.

    Ordered 10 x 10 with the exact law of the square lattice. Random, as windows of periodic media,
    with Eq. (4) as published and with C fitted to the resolved flow through the periodic medium.
    All with the gaps of the channel itself, compared with the resolved flow around the same discs.

    Parameters
    ----------
    out : Path
        Folder for fig2.png and fig2.csv.
    quick : bool
        Fewer porosities, samples and discs.
    progress : callable, optional
        Is told each stage in a few words.
    """
    rows: list[Row] = []
    for porosity in (0.4, 0.8) if quick else (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95):
        progress(f"ordered, porosity {porosity}")
        box, particles = arrange.square(
            10, 10, porosity=porosity, diameter=_diameter(100, porosity), periodic=False
        )
        exact = SquareLattice()
        runs: list[Run] = [(exact, "hat", 2), (exact, "hat", 4), (exact, "delta", 2)]
        runs.append((exact, "delta", 4))
        rows += _channel({"array": "ordered", "porosity": porosity}, box, particles, runs)
    n, samples = (50, 2) if quick else (200, 5)
    for porosity in (0.5, 0.8) if quick else (0.4, 0.5, 0.6, 0.75, 0.9):
        for seed in range(samples):
            progress(f"random, porosity {porosity}, sample {seed + 1} of {samples}")
            d = _diameter(n, porosity)
            cell = arrange.random(n, porosity=porosity, diameter=d, min_gap=MIN_GAP, seed=seed)
            box, particles = _window(*cell)
            published, fitted = Microstructural(), _fitted(*cell)
            runs = [(published, "hat", 2), (fitted, "hat", 2), (published, "delta", 2)]
            head = {"array": "random", "porosity": porosity, "sample": seed}
            rows += _channel(head, box, particles, runs)
    progress("drawing")
    comments = [
        *_made("fig2", quick),
        f"pressure gradient {GRADIENT:g} Pa/m (paper); height and width {HEIGHT:g} m, viscosity "
        f"{VISCOSITY:g} Pa s, random discs at least {MIN_GAP:g} d apart (ours)",
        "U: mean superficial velocity [m/s]; ratio: over resolved, the same discs; C: Eq. (4); "
        "error: estimated change from the order below, relative",
    ]
    report.write(
        out,
        {
            "fig2.png": lambda path: plot.save(_draw_fig2(rows), path),
            "fig2.csv": lambda path: report.write_csv(path, rows, comments),
        },
    )


def fig3(out: Path, *, quick: bool = False, progress: Tell = lambda _: None) -> None:
    """One disc released at 0.6 H in a square box: no-slip top and bottom, frictionless sides.

    On the mesh of the paper: the disc, the corners and two nodes on each side make 12 triangles.

    Parameters
    ----------
    out : Path
        Folder for fig3.png and fig3.csv.
    quick : bool
        Order 2 and one second, instead of order 4 and six.
    progress : callable, optional
        Is told each stage in a few words.
    """
    order, end = (2, 1.0) if quick else (4, 6.0)
    disc = Particles(np.array([[0.5 * SIDE, 0.6 * SIDE]]), DISC, SOLID)
    sides = {"left": Slip(), "right": Slip()}
    fluid = Fluid(LIQUID, THICK, Channel(), sides, order=order, dt=0.02, scheme="bdf2")
    model = Model(Box(SIDE, SIDE), Contact(stiffness=1e4), fluid=fluid)
    fall = Simulation(model, disc)
    assert fall.flow is not None
    start = {"t": 0.0, "y": fall.x[0, 1], "v": 0.0, "triangles": len(fall.flow.mesh.triangles)}
    rows: list[Row] = [start | {"order": order}]
    figure, axes = plt.subplots(
        *(1, 4), figsize=(13, 3.4), width_ratios=(1.3, 1, 1, 1), layout="constrained"
    )
    shown = iter(axes[1:])

    def observe(now: Simulation) -> None:
        assert now.flow is not None
        progress(f"{now.t:.2f} s of {end:g} s")
        row = {"t": now.t, "y": now.x[0, 1], "v": now.velocity[0, 1]}
        rows.append(row | {"triangles": len(now.flow.mesh.triangles), "order": order})
        if len(rows) in (15, 151, 301):
            ax = plot.motion(now, next(shown), top=0.02, edges=True, colorbar=len(rows) == 301)
            ax.set_title(f"{now.t:.2f} s", fontsize=10)

    fall.run(until=end, every=end / 300, observe=observe)
    ax = axes[0]
    ax.plot([r["t"] for r in rows], [-r["v"] for r in rows], color=plot.METHOD["resolved"])
    ax.axhline(SETTLED, color=plot.METHOD["mesoscale"], ls=":", label="the paper: 0.17 m/s")
    ax.set(xlabel="t [s]", ylabel="settling speed [m/s]", xlim=(0.0, end), ylim=(0.0, 0.18))
    ax.legend(frameon=False, fontsize=9, loc="lower right")
    ax.spines[["top", "right"]].set_visible(False)
    comments = [
        *_made("fig3", quick),
        f"box {SIDE:g} m x {SIDE:g} m, released at 0.6 H, 12 triangles, 0.17 m/s (paper); diameter "
        f"{DISC:g} m, densities {LIQUID:g} and {SOLID:g} kg/m3, viscosity {THICK:g} Pa s, law of "
        "drag: cylinder between walls (ours, chosen to settle at 0.17 m/s)",
        "t [s], y: height of the centre [m], v: velocity [m/s], triangles of the mesh",
    ]
    report.write(
        out,
        {
            "fig3.png": lambda path: plot.save(figure, path),
            "fig3.csv": lambda path: report.write_csv(path, rows, comments),
        },
    )


def _made(figure: str, quick: bool) -> list[str]:
    return [f"made by: grainmesh paper {figure}{' --quick' if quick else ''} ({__version__})"]


def _diameter(n: int, porosity: float) -> float:
    """Diameter [m] of n discs in the square channel."""
    return float(HEIGHT * np.sqrt((1.0 - porosity) * 4.0 / np.pi / n))


def _channel(head: Row, box: Box, particles: Particles, runs: Iterable[Run]) -> list[Row]:
    """Rows of one channel: resolved, then mesoscale for each law, kernel and order."""
    exact = permeability(box, particles, "resolved", walls="no-slip", order=ORDER)
    assert exact.detail is not None
    scale = GRADIENT / VISCOSITY
    truth = float(exact.tensor[0, 0]) * scale

    def row(
        method: str, kernel: str, order: int, law: Law | None, dofs: int, U: float, error: float
    ) -> Row:
        return {
            **{"array": "", "porosity": 0.0, "sample": 0},
            **head,
            "method": method,
            "kernel": kernel,
            "order": order,
            "law": "" if law is None else law.name,
            "C": law.C if isinstance(law, Microstructural) else None,
            "dofs": dofs,
            "error": error,
            "U": U,
            "ratio": U / truth,
        }

    rows = [row("resolved", "", exact.detail.order, None, exact.dofs, truth, exact.error)]
    for law, kernel, order in runs:
        flow = fluid.solve(box, particles, law, order=order, kernel=kernel, walls="no-slip")
        U = float(flow.tensor[0, 0]) * scale
        rows.append(row("mesoscale", kernel, order, law, flow.dofs, U, flow.error))
    return rows


def _window(box: Box, particles: Particles) -> tuple[Box, Particles]:
    """A periodic cell as a box with walls: the medium goes on up to them, and they cut discs."""
    steps = np.stack(np.meshgrid((-1, 0, 1), (-1, 0, 1)), axis=-1).reshape(-1, 2)
    x = (particles.x + (steps * box.size)[:, None]).reshape(-1, 2)
    images = Particles(x, np.tile(particles.diameter, len(steps)))
    cut = Box(box.width, box.height)
    return cut, images.select(touches(cut, images))


def _fitted(box: Box, particles: Particles) -> Microstructural:
    """Eq. (4) with C such that it gives the resolved permeability of this periodic cell along x."""
    found = permeability(box, particles, "resolved", order=ORDER)
    exact = float(found.tensor[0, 0]) / found.diameter**2
    law = Microstructural()
    return Microstructural(C=law.C * exact / float(law(found.porosity, found.gap)))


def _pick(rows: Sequence[Row], **wanted: Any) -> tuple[Any, Any, Any]:
    """Porosity, velocity and ratio of the rows that have all of the wanted values."""
    found = [r for r in rows if all(r[key] == value for key, value in wanted.items())]
    porosity, U, ratio = np.array([(r["porosity"], r["U"], r["ratio"]) for r in found]).T
    return porosity, U, ratio


def _draw_fig2(rows: Sequence[Row]) -> Any:
    figure, axes = plt.subplots(
        *(2, 2),
        figsize=(10, 6.6),
        sharex="col",
        sharey="row",
        height_ratios=(2.2, 1.0),
        layout="constrained",
    )
    published = Microstructural().C
    fitted = [r for r in rows if r["C"] not in (None, published)]
    plain = [r for r in rows if r["C"] in (None, published)]
    red, blue, amber, grey = (
        *(plot.METHOD[k] for k in ("mesoscale", "resolved", "microstructure")),
        "#8a8f98",
    )
    for column, (array, title) in enumerate(
        (("ordered", "(a) ordered 10 x 10"), ("random", "(b) random"))
    ):
        top, low = axes[:, column]
        top.set_title(title, fontsize=11)
        eps, U, _ = _pick(rows, array=array, method="resolved")
        top.semilogy(eps, U, "o", mfc="none", ms=7, color=blue, label="resolved")
        law = "Eq. (4)" if array == "random" else "lattice law"
        lines = [
            (plain, "hat", 2, "-", red, f"mesoscale, {law}"),
            (plain, "delta", 2, ":", grey, "delta kernel, k = 2"),
        ]
        if array == "random":
            lines.insert(1, (fitted, "hat", 2, "--", amber, "mesoscale, C fitted"))
        else:
            lines.insert(1, (plain, "hat", 4, "--", amber, "the same, k = 4"))
            lines.append((plain, "delta", 4, "-.", grey, "delta kernel, k = 4"))
        for some, kernel, order, style, colour, label in lines:
            eps, U, ratio = _pick(some, array=array, method="mesoscale", kernel=kernel, order=order)
            _line(top, eps, U, style, colour, label)
            if kernel == "hat":
                _line(low, eps, ratio, style, colour, label)
                low.plot(eps, ratio, ".", color=colour, ms=4)
        top.legend(frameon=False, fontsize=9)
        low.axhline(1.0, color=blue, lw=0.8)
        low.axhspan(0.9, 1.1, color=blue, alpha=0.08, lw=0)
        low.set_xlabel("porosity")
        for ax in (top, low):
            ax.spines[["top", "right"]].set_visible(False)
    axes[0, 0].set_ylabel("mean velocity U [m/s]")
    axes[1, 0].set_ylabel("U / resolved")
    return figure


def _line(ax: Axes, x: Any, y: Any, style: str, colour: str, label: str) -> None:
    """Geometric mean over the samples at each x."""
    at = np.unique(x)
    mean = [np.exp(np.log(y[x == value]).mean()) for value in at]
    ax.plot(at, mean, style, color=colour, label=label, lw=1.6)


__all__ = ["fig1", "fig2", "fig3"]
