"""Pictures. Every function draws into ``ax``, by default new axes, and returns it.

Axes are in metres, of equal scale, and end at the box; of a periodic box the images that reach into
it are drawn. Nothing here chooses a backend or shows a window.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field as attribute
from io import BytesIO
from pathlib import Path
from shutil import which as installed
from subprocess import run

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from ngsolve import VOL, IntegrationRule, x, y
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from xarray import Dataset

from grainmesh.canvas import frame, save, tiled, tiled_triangles
from grainmesh.domain import Box
from grainmesh.element import lattice
from grainmesh.errors import InputError
from grainmesh.fields import Sample
from grainmesh.fluid import Mesoscale
from grainmesh.particles import Particles, settle
from grainmesh.permeability import Permeability
from grainmesh.resolved import Resolved
from grainmesh.simulation import Simulation
from grainmesh.triangulation import Triangulation, triangulate

Float = NDArray[np.float64]

FIBRE, EDGE, MESH, NODE = "#c9ced6", "#5d6673", "#1f5a93", "#d1495b"
METHOD = {"resolved": "#1f5a93", "mesoscale": "#d1495b", "microstructure": "#edae49"}
SPEED = "viridis"
#: Fields of a flow that can be drawn, and their units.
SHOWN = {"speed": "m/s", "pressure": "Pa", "porosity": ""}

#: Triangles that a picture of a flow is made of, at most about so many.
FINEST = 400_000
#: The same for a picture of moving discs, of which there are many.
FINEST_FRAME = 40_000


def discs(
    box: Box,
    particles: Particles,
    ax: Axes | None = None,
    *,
    colour: ArrayLike | None = None,
    label: str = "",
) -> Axes:
    """The discs, with their periodic images.

    Parameters
    ----------
    box : Box
    particles : Particles
    ax : matplotlib.axes.Axes, optional
    colour : array_like, optional
        (n,) values to colour them by; all are grey if not given.
    label : str
        What `colour` is, with its unit; a scale is drawn beside the axes if given.
    """
    ax = frame(box, ax)
    centre, reach, which = tiled(box, particles.x, 0.5 * particles.diameter)
    shown = EllipseCollection(
        *(2.0 * reach, 2.0 * reach, np.zeros(len(reach))),
        units="xy",
        offsets=centre,
        offset_transform=ax.transData,
        facecolors=FIBRE,
        edgecolors=EDGE,
        linewidths=0.4,
        cmap=SPEED,
    )
    if colour is not None:
        shown.set_array(np.asarray(colour, dtype=float)[which])
    ax.add_collection(shown)
    if label:
        ax.figure.colorbar(shown, ax=ax, label=label, shrink=0.8)
    return ax


def mesh(triangulation: Triangulation, ax: Axes | None = None) -> Axes:
    """The triangulation, its particles as dots and the nodes on walls as squares (Fig. 1).

    Parameters
    ----------
    triangulation : Triangulation
    ax : matplotlib.axes.Axes, optional
    """
    box = triangulation.box
    ax = frame(box, ax)
    i, j = triangulation.edges.T
    start = triangulation.points[i]
    end = triangulation.points[j] + triangulation.edge_shifts * box.size
    half = 0.5 * np.abs(end - start).max(axis=1)
    middle, _, which = tiled(box, 0.5 * (start + end), half)
    along = 0.5 * (end - start)[which]
    lines = np.stack([middle - along, middle + along], axis=1)
    width = min(0.8, 12.0 / np.sqrt(len(i)))
    ax.add_collection(LineCollection(list(lines), colors=MESH, linewidths=width))
    n, points = triangulation.n, triangulation.points
    size = 600.0 / len(points) + 0.5
    grain, node = points[:n].T, points[n:].T
    ax.scatter(grain[0], grain[1], s=size, color=EDGE, lw=0, zorder=3)
    ax.scatter(
        node[0], node[1], s=3 * size + 3, color=NODE, marker="s", lw=0, zorder=3, clip_on=False
    )
    return ax


def chains(simulation: Simulation, ax: Axes | None = None) -> Axes:
    """Normal forces as lines through the contacts, as thick as the force is strong.

    The strongest are half as thick as a mean disc.

    Parameters
    ----------
    simulation : Simulation
    ax : matplotlib.axes.Axes, optional
    """
    box, particles, contacts = simulation.model.box, simulation.particles, simulation.contacts
    ax = frame(box, ax)
    if len(contacts) == 0:
        return ax
    i, j = np.searchsorted(simulation.ids, contacts.pair).T
    r, x, out = particles.radius, particles.x, contacts.normal
    # One line from each centre to the contact, so that none crosses a periodic box.
    ends = np.vstack([x[i] + r[i, None] * out, x[j] - r[j, None] * out])
    lines = np.stack([np.vstack([x[i], x[j]]), ends], axis=1)
    strong = np.quantile(contacts.force, 0.99)
    extent = ax.get_window_extent()
    points = 72.0 / ax.figure.dpi * min(extent.width / box.width, extent.height / box.height)
    width = 0.5 * particles.mean_diameter * points * np.clip(contacts.force / strong, 0.02, 1.2)
    ax.add_collection(
        LineCollection(list(lines), colors=MESH, linewidths=np.tile(width, 2), capstyle="round")
    )
    return ax


def speed(
    box: Box,
    flow: Resolved | Mesoscale,
    axis: int = 0,
    ax: Axes | None = None,
    *,
    colorbar: bool = True,
) -> Axes:
    """Speed of a flow, over the mean superficial speed along the pressure gradient.

    Parameters
    ----------
    box : Box
        The box that the flow was solved in.
    flow : Resolved or Mesoscale
        The `detail` of a `Permeability`.
    axis : int
        Direction of the pressure gradient: 0 for x, 1 for y.
    ax : matplotlib.axes.Axes, optional
    colorbar : bool
        Draw the scale beside the axes.
    """
    ax = frame(box, ax)
    points, triangles, velocity = sample(flow, axis)
    mean = flow.tensor[axis, axis] / flow.scale**2
    corners = points[triangles]
    drawn, which = tiled_triangles(box, corners)
    value = (np.hypot(*velocity.T) / mean)[triangles[which]].ravel()
    colours = ax.tripcolor(
        drawn,
        value,
        shading="gouraud",
        cmap=SPEED,
        # A few narrow gaps must not make the rest dark.
        norm=PowerNorm(0.5, vmin=0.0, vmax=float(np.quantile(value, 0.995))),
        rasterized=True,
    )
    if colorbar:
        ax.figure.colorbar(colours, ax=ax, label="speed / mean speed U", shrink=0.8, extend="max")
    return ax


def sample(flow: Resolved | Mesoscale, axis: int = 0) -> tuple[Float, NDArray[np.int64], Float]:
    """A flow on straight triangles: each curved element cut into equal parts.

    Parameters
    ----------
    flow : Resolved or Mesoscale
    axis : int
        Direction of the pressure gradient.

    Returns
    -------
    points : (p, 2)
        Coordinates [m].
    triangles : (t, 3)
        Corners, as indices of `points`.
    velocity : (p, 2)
        mu u / (G scale^2), as `flow.velocity`.
    """
    mesh = flow.mesh
    parts = int(np.clip(np.sqrt(FINEST / mesh.ne), 1, 8))
    nodes, pattern = lattice(parts)
    rule = IntegrationRule(points=nodes[:, 1:].tolist(), weights=[1.0] * len(nodes))
    at = mesh.MapToAllElements(rule, VOL)
    points = np.column_stack([np.ravel(c(at)) for c in (x, y)])
    triangles = np.arange(mesh.ne)[:, None, None] * len(nodes) + pattern
    velocity = np.asarray(flow.velocity[axis](at)).reshape(-1, 2)
    return points * flow.scale, triangles.reshape(-1, 3), velocity


def field(
    box: Box,
    flow: Sample,
    ax: Axes | None = None,
    *,
    show: str = "speed",
    top: float | None = None,
    colorbar: bool = False,
) -> Axes:
    """One field of a flow between moving discs.

    Parameters
    ----------
    box : Box
    flow : Sample
        ``simulation.flow.sample(cuts)``, or a frame read from a file.
    ax : matplotlib.axes.Axes, optional
    show : str
        "speed" of the fluid between the discs [m/s], dynamic "pressure" [Pa], or "porosity".
    top : float, optional
        End of the scale; the largest value but for two in a hundred if not given.
    colorbar : bool
        Draw the scale beside the axes.

    Raises
    ------
    InputError
        If `show` is unknown.
    """
    if show not in SHOWN:
        raise InputError(f"plot: show '{show}' must be one of {', '.join(SHOWN)}")
    ax = frame(box, ax)
    value = np.hypot(*flow.velocity.T) if show == "speed" else getattr(flow, show)
    drawn, which = tiled_triangles(box, flow.points[flow.triangles])
    least = 0.0 if show == "speed" else float(np.quantile(value, 0.02))
    most = float(np.quantile(value, 0.98)) if top is None else top
    colours = ax.tripcolor(
        drawn,
        value[flow.triangles[which]].ravel(),
        shading="gouraud",
        cmap=SPEED,
        vmin=least,
        vmax=max(most, least + 1e-12),
        rasterized=True,
    )
    if colorbar:
        label = f"{show} [{SHOWN[show]}]" if SHOWN[show] else show
        ax.figure.colorbar(colours, ax=ax, label=label, shrink=0.8)
    return ax


def motion(
    simulation: Simulation,
    ax: Axes | None = None,
    *,
    show: str = "speed",
    top: float | None = None,
    edges: bool = False,
    colorbar: bool = False,
) -> Axes:
    """Flow between moving discs, on its mesh as it is now.

    Parameters
    ----------
    simulation : Simulation
        With fluid.
    ax : matplotlib.axes.Axes, optional
    show, top, colorbar
        As of `field`.
    edges : bool
        Draw the edges of the triangles.

    Raises
    ------
    InputError
        If there is no fluid, or `show` is unknown.
    """
    flow, box = simulation.flow, simulation.model.box
    if flow is None:
        raise InputError("plot.motion draws a simulation with fluid: use plot.discs without")
    mesh = flow.mesh
    cuts = int(np.clip(np.sqrt(FINEST_FRAME / len(mesh.triangles)), 1, 8))
    ax = field(box, flow.sample(cuts), ax, show=show, top=top, colorbar=colorbar)
    if edges:
        corners = mesh.points[mesh.triangles] + mesh.shifts * box.size
        rings, _ = tiled_triangles(box, corners)
        ax.triplot(rings, color="white", lw=min(0.6, 8.0 / np.sqrt(len(corners))))
    return discs(box, simulation.particles, ax)


@dataclass
class Film:
    """Pictures of a simulation while it runs: ``run(..., every=0.1, observe=film)``.

    Parameters
    ----------
    show, top, edges
        As of `motion`.

    Attributes
    ----------
    frames : list of PIL.Image.Image
        One for each call.
    """

    show: str = "speed"
    top: float | None = None
    edges: bool = False
    frames: list[Image.Image] = attribute(default_factory=list)

    def __call__(self, simulation: Simulation) -> None:
        """Add a frame, of an even number of pixels each way, as encoders want."""
        tall = simulation.model.box.height / simulation.model.box.width
        size = (2.5, 2.5 * tall + 0.4) if tall > 1.0 else (4.0 / tall, 4.4)
        figure, ax = plt.subplots(figsize=size, layout="constrained")
        motion(simulation, ax, show=self.show, top=self.top, edges=self.edges)
        ax.set_title(f"{simulation.t:.3g} s", fontsize=10)
        ax.set_axis_off()
        full = BytesIO()
        figure.savefig(full, dpi=100, format="png")
        plt.close(figure)
        image = Image.open(full).convert("RGB")
        self.frames.append(image.crop((0, 0, image.width // 2 * 2, image.height // 2 * 2)))

    def strip(self, path: str | Path, count: int = 5) -> Path:
        """Write some of the frames side by side as a PNG file; returns its path."""
        path = Path(path)
        if not self.frames:
            raise InputError("film: there are no frames, pass it to run(observe=...)")
        chosen = np.linspace(0, len(self.frames) - 1, min(count, len(self.frames)))
        images = [self.frames[int(i)] for i in chosen]
        width, height = images[0].size
        wide = Image.new("RGB", (width * len(images), height))
        for i, image in enumerate(images):
            wide.paste(image, (i * width, 0))
        wide.quantize(256, Image.Quantize.MAXCOVERAGE).save(path, optimize=True)
        return path

    def save(self, path: str | Path, rate: int = 15) -> Path:
        """Write the frames as a film: MP4 where ffmpeg is installed, else GIF.

        Parameters
        ----------
        path : str or Path
            Its suffix is replaced by the one that fits: read what was written from the result.
        rate : int
            Frames per second.

        Returns
        -------
        Path
            What was written.

        Raises
        ------
        InputError
            If there are no frames, or ffmpeg fails.
        """
        if not self.frames:
            raise InputError("film: there are no frames, pass it to run(observe=...)")
        path, program = Path(path), installed("ffmpeg")
        if program is None:
            path = path.with_suffix(".gif")
            first, *rest = [image.quantize(64) for image in self.frames]
            first.save(path, save_all=True, append_images=rest, duration=1000 // rate, loop=0)
            return path
        path = path.with_suffix(".mp4")
        size = "x".join(map(str, self.frames[0].size))
        source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(rate), "-i", "-"]
        target = ["-pix_fmt", "yuv420p", str(path)]
        pixels = b"".join(image.tobytes() for image in self.frames)
        done = run([program, "-y", *source, *target], input=pixels, capture_output=True)
        if done.returncode:
            last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
            raise InputError(f"film: ffmpeg cannot write {path}: {' '.join(last)}")
        return path


def histories(table: Dataset, *names: str, ax: Axes | None = None) -> Axes:
    """Variables of one unit over time.

    Parameters
    ----------
    table : xarray.Dataset
        Of `history.table`.
    *names : str
        Of variables of the table; those that it lacks are left out.
    ax : matplotlib.axes.Axes, optional
    """
    ax = plt.subplots()[1] if ax is None else ax
    shown = [table[name] for name in names if name in table]
    for values in shown:
        ax.plot(table["t"], values, label=str(values.name).replace("_", " "), lw=1.4)
    unit = readable(shown[0].attrs.get("units", "1")) if shown else ""
    ax.set(xlabel="time [s]", xmargin=0.0)
    if len(shown) > 1:
        ax.legend(frameon=False)
        ax.set_ylabel(unit and f"[{unit}]")
    elif shown:
        ax.set_ylabel(str(shown[0].name).replace("_", " ") + (unit and f" [{unit}]"))
    ax.spines[["top", "right"]].set_visible(False)
    return ax


def readable(unit: str) -> str:
    """A unit of a table as people write it: J/m for "J m-1", nothing for "1"."""
    return "" if unit == "1" else re.sub(r" (\w+)-1", r"/\1", unit)


def bars(results: Sequence[Permeability], ax: Axes | None = None) -> Axes:
    """K/d2 by every method, with its estimated error.

    Parameters
    ----------
    results : sequence of Permeability
    ax : matplotlib.axes.Axes, optional
    """
    ax = plt.subplots()[1] if ax is None else ax
    names = [r.method for r in results]
    value = np.array([r.normalised for r in results])
    error = np.nan_to_num([r.error for r in results], posinf=0.0)
    ax.bar(
        names,
        value,
        yerr=error * np.abs(value),
        capsize=4,
        color=[METHOD[name] for name in names],
        width=0.6,
    )
    ax.set_ylabel("K/d²")
    ax.spines[["top", "right"]].set_visible(False)
    return ax


def overview(box: Box, particles: Particles, results: Sequence[Permeability]) -> Figure:
    """One row of pictures: fibres, and the mesh and the speed of the flows among the results.

    Parameters
    ----------
    box : Box
    particles : Particles
    results : sequence of Permeability
        Of this box, by any of the methods.
    """
    by = {r.method: r for r in results}
    flow = by["resolved"].detail if "resolved" in by else None
    titles = [f"{len(particles)} fibres, porosity {results[0].porosity:.3f}"]
    if "mesoscale" in by:
        titles.append(f"mesoscale mesh, {by['mesoscale'].dofs} unknowns")
    if flow is not None:
        titles.append(f"resolved speed, {flow.dofs} unknowns")
    tall = 4.2 * min(max(box.height / box.width, 0.3), 2.0)
    figure: Figure
    figure, axes = plt.subplots(
        1, len(titles), figsize=(4.4 * len(titles), tall + 0.5), layout="constrained", squeeze=False
    )
    for ax, title in zip(axes[0], titles, strict=True):
        discs(box, particles, ax)
        ax.set_title(title, fontsize=10)
    if "mesoscale" in by:
        mesh(triangulate(box, settle(box, particles)), axes[0, 1])
    if flow is not None:
        speed(box, flow, ax=axes[0, -1])
    return figure


__all__ = [
    "Film",
    "bars",
    "chains",
    "discs",
    "field",
    "histories",
    "mesh",
    "motion",
    "overview",
    "readable",
    "sample",
    "save",
    "speed",
]
