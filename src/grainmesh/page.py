"""A page that tells a run: what it was, what came of it, where the time went, what to cite.

One HTML file with its pictures inside: it loads nothing, runs nothing, follows the reader's light
or dark setting and prints well.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from platform import machine, python_version
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from xarray import Dataset

from grainmesh import __version__, checkpoint, cite, history, markup, plot, vtkhdf
from grainmesh.case import parse
from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.fields import Sample
from grainmesh.model import Model
from grainmesh.particles import Particles
from grainmesh.simulation import Simulation, resume

NAME = "report.html"
#: Plots of histories: title, and variables of one unit; what a run lacks is left out.
PLOTS = {
    "Energies": ("kinetic", "rotational", "elastic", "fluid_kinetic"),
    "Height of the bed": ("bed_height", "height"),
    "Momentum of the particles": ("momentum_x", "momentum_y"),
    "Pressure drop": ("pressure_drop_x", "pressure_drop_y"),
    "Slip of the fluid against the particles": ("slip",),
    "Contacts": ("contacts",),
    "Residuals": ("energy_residual", "volume_residual"),
    "Step of the flow": ("flow_step",),
    "Iterations of the linear solver": ("iterations",),
}
TITLES = {
    "speed": "Speed of the fluid",
    "pressure": "Dynamic pressure",
    "porosity": "Porosity",
    "discs": "Speed of the discs",
    "chains": "Forces between discs",
}
#: Pictures in pixels of the page: two columns of them, the gap between frames, and most height.
COLUMN, GAP, TALLEST = 470, 8, 420
#: Pieces that each edge of the mesh is cut into, where a flow is drawn as it is now.
CUTS = 2
#: What the page is allowed to load: nothing but what it holds.
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
#: Names of parts of the time in words.
PARTS = {
    "steps": "contacts",
    "upkeep": "search for contacts",
    "mesh": "mesh of the flow",
    "kernel": "porosity and averages",
    "matrix": "matrix of the flow",
    "solve": "linear solver",
    "rest": "other work for the flow",
    "writing": "files",
    "": "all else",
}


@dataclass(frozen=True, eq=False)
class Run:
    """What the page is made of.

    Parameters
    ----------
    title, case : str
        Name of the run, and the text of its case.
    simulation : Simulation
        Its last state.
    frames : sequence of (vtkhdf.Frame, vtkhdf.Frame or None)
        Discs and flow, to be drawn beside each other, first to last.
    table : xarray.Dataset
        The history, see `history.table`.
    seconds : mapping
        Time spent by its use [s].
    environment : mapping
        Versions and machine.
    """

    title: str
    case: str
    simulation: Simulation
    frames: Sequence[tuple[vtkhdf.Frame, vtkhdf.Frame | None]]
    table: Dataset
    seconds: Mapping[str, float]
    environment: Mapping[str, Any]


def write(source: str | Path | Simulation, path: str | Path | None = None) -> Path:
    """Write the page of a run.

    Parameters
    ----------
    source : path or Simulation
        The folder of a run, or a simulation as it is now.
    path : path, optional
        The file to write; ``report.html`` in the folder if not given.

    Returns
    -------
    Path
        What was written.

    Raises
    ------
    InputError
        If the folder holds no run, or nothing can be written.
    """
    if isinstance(source, Simulation):
        run = of_simulation(source)
        path = Path(NAME if path is None else path)
    else:
        run = of_folder(Path(source))
        path = Path(source) / NAME if path is None else Path(path)
    text, new = html(run), path.with_suffix(".new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        new.write_text(text, encoding="utf-8")
        new.replace(path)
    except OSError as fault:
        raise InputError(f"{path}: cannot be written ({fault.strerror})") from None
    return path


def of_simulation(simulation: Simulation, title: str = "A simulation") -> Run:
    """What can be told of a simulation that has left no files."""
    flow = simulation.flow
    frame = vtkhdf.discs(simulation), vtkhdf.flow(simulation, CUTS) if flow else None
    seconds = simulation.seconds | (flow.seconds if flow else {})
    about = {"grainmesh": __version__, "python": python_version(), "machine": machine()}
    return Run(title, "", simulation, [frame], history.table(simulation), seconds, about)


def of_folder(folder: Path) -> Run:
    """What the files of a run tell.

    Raises
    ------
    InputError
        If a file is missing or damaged.
    """
    about = _environment(folder / "environment.json")
    written, case = folder / "case.toml", None
    if written.is_file():
        case = parse(written.read_text(encoding="utf-8"), about.pop("case", None) or written)
    try:
        simulation = resume(folder)
    except checkpoint.Asked:
        if case is None:
            raise
        simulation = case.resume(folder)
    count = len(vtkhdf.times(folder / vtkhdf.DISCS))
    box, wet = simulation.model.box, (folder / vtkhdf.FLOW).is_file()
    tall = box.height / box.width
    many = min(count, 2 if _is_wide(box) or tall < 1.2 else 3 if tall < 2.5 else 4)
    frames = [
        (
            vtkhdf.read(folder / vtkhdf.DISCS, k),
            vtkhdf.read(folder / vtkhdf.FLOW, k) if wet else None,
        )
        for k in np.linspace(0, count - 1, many).round().astype(int)
    ]
    seconds = about.pop("seconds", {})
    seconds[""] = max(about.pop("elapsed", 0.0) - sum(seconds.values()), 0.0)
    title, text = (case.title, case.text) if case else ("", "")
    name = title or folder.resolve().name
    return Run(name, text, simulation, frames, history.read(folder), seconds, about)


def _environment(path: Path) -> dict[str, Any]:
    """What a run was made with; nothing if its file is missing."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as fault:
        raise InputError(f"{path}: cannot be read ({fault})") from None
    if "command" in found:
        found["command"] = shlex.join(found["command"])
    return dict(found)


def html(run: Run) -> str:
    """The page as text."""
    parts = (
        _head(run),
        _section("Pictures", _pictures(run)),
        _section("Histories", _plots(run.table)),
        _section("Ledger", _ledger(run.table)),
        _section("Case", f"<pre>{escape(run.case)}</pre>" if run.case else ""),
        _section("Time spent", _times(run.seconds)),
        _section("Made with", _rows(run.environment.items())),
        _section("To be cited", f"<pre>{escape(cite.bibtex(used(run.simulation.model)))}</pre>"),
    )
    style = files("grainmesh").joinpath("data/report.css").read_text(encoding="utf-8")
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<title>{escape(run.title)}</title>\n<link rel="icon" href="data:,">\n'
        f"<style>\n{style}</style>\n</head>\n<body>\n{''.join(parts)}"
        f"<footer>grainmesh {__version__}. All values are SI; a particle is a disc of unit depth, "
        "forces and energies are per metre of it.</footer>\n</body>\n</html>\n"
    )


def used(model: Model) -> list[str]:
    """Methods and laws of particles in motion that `cite.bibtex` knows."""
    fluid = model.fluid
    names = ["contacts"] + ([] if fluid is None else ["flow", fluid.drag.name])
    return [name for name in names if name in cite.SOURCES]


# --- parts of the page ---------------------------------------------------------------------------


def _section(title: str, body: str) -> str:
    return f"<section>\n<h2>{title}</h2>\n{body}\n</section>\n" if body else ""


def _head(run: Run) -> str:
    now, model = run.simulation, run.simulation.model
    d, box, fluid = now.particles.diameter, model.box, model.fluid
    low, high = (f"{1e3 * float(v):.4g}" for v in (d.min(), d.max()))
    size = f"{low} mm" if low == high else f"{low} to {high} mm"
    lead = (
        f"{len(now):,} discs of {size} in a {'periodic ' if box.periodic else ''}box of "
        f"{markup.metres(box.width)} × {markup.metres(box.height)}"
    )
    lead += (
        ", without a fluid."
        if fluid is None
        else f", in a fluid of {fluid.density:.4g} kg/m³ and {fluid.viscosity:.3g} Pa s; "
        f"drag law {fluid.drag.name}."
    )
    numbers: list[tuple[str, ...]] = [
        ("time reached", f"{now.t:.4g}", "s"),
        ("steps", f"{now.step:,}", ""),
    ]
    measured = now.measure()
    solid = 0.25 * np.pi * float((d**2).sum()) / box.area
    numbers += [
        ("porosity of the box", f"{1.0 - solid:.3f}", ""),
        ("contacts", f"{measured['contacts']:,.0f}", ""),
        ("height", *markup.metres(measured["height"]).split()),
        ("deepest overlap, of a radius", f"{100.0 * measured['overlap']:.2g}", "%"),
    ]
    if now.flow is not None:
        numbers.append(("triangles of the flow", f"{len(now.flow.mesh.triangles):,}", ""))
    if run.seconds:
        numbers.append(("run time", *markup.duration(sum(run.seconds.values())).split()))
    tiles = "".join(
        f"<div><dt>{name}</dt><dd>{value}{f' <small>{unit}</small>' if unit else ''}</dd></div>"
        for name, value, unit in numbers
    )
    return (
        f'<header>\n<p>Report of a run</p>\n<h1>{escape(run.title)}</h1>\n<p class="lead">'
        f'{escape(lead)}</p>\n<dl class="numbers">{tiles}</dl>\n</header>\n'
    )


def _pictures(run: Run) -> str:
    """Each field in every frame, on one scale; the forces between discs at the end."""
    box, found = run.simulation.model.box, []
    beside = 1 if _is_wide(box) else len(run.frames)
    width = min((COLUMN - GAP * (beside - 1)) / beside, TALLEST * box.width / box.height)
    width = max(np.floor(width), 1.0)  # a pixel too many, and two columns do not fit
    grains = [Particles(discs.points, 2.0 * discs.fields["radius"]) for discs, _ in run.frames]
    when = [f"{discs.t:.3g} s" for discs, _ in run.frames]
    flows = [
        Sample(flow.points, flow.triangles, **flow.fields)
        for _, flow in run.frames
        if flow is not None and flow.triangles is not None
    ]
    for show, unit in plot.SHOWN.items() if len(flows) == len(grains) else ():
        values = [np.hypot(*f.velocity.T) if show == "speed" else getattr(f, show) for f in flows]
        low, high = np.quantile(np.concatenate(values), [0.02, 0.98])
        limits = (0.0 if show == "speed" else float(low), float(high))
        images = []
        for flow, particles, time in zip(flows, grains, when, strict=True):
            figure, ax = markup.canvas(box, width)
            plot.field(box, flow, ax, show=show)
            ax.collections[0].set_clim(*limits)
            plot.discs(box, particles, ax)
            images.append(markup.png(figure, time))
        found.append(_field(box, TITLES[show], images, markup.scale(*limits, unit, plot.SPEED)))
    speeds = [np.hypot(*discs.fields["velocity"].T) for discs, _ in run.frames]
    top = max(float(np.quantile(np.concatenate(speeds), 0.98)), 1e-12)
    images = []
    for particles, speed, time in zip(grains, speeds, when, strict=True):
        figure, ax = markup.canvas(box, width)
        plot.discs(box, particles, ax, colour=speed)
        ax.collections[0].set_clim(0.0, top)
        images.append(markup.png(figure, time))
    found.append(_field(box, TITLES["discs"], images, markup.scale(0.0, top, "m/s", plot.SPEED)))
    force = run.simulation.contacts.force
    if len(force):
        figure, ax = markup.canvas(box, width)
        plot.chains(run.simulation, plot.discs(box, run.simulation.particles, ax))
        mean, most = (markup.number(float(v)) for v in (force.mean(), force.max()))
        caption = f"mean {mean} N/m, strongest {most} N/m"
        images = [markup.png(figure, f"{run.simulation.t:.3g} s")]
        found.append(_field(box, TITLES["chains"], images, f"<span>{caption}</span>"))
    return f'<div class="fields">{"".join(found)}</div>'


def _field(box: Box, title: str, images: Sequence[str], scale: str) -> str:
    kind = "frames stacked" if _is_wide(box) else "frames"
    return (
        f'<figure><figcaption>{title}</figcaption><div class="{kind}">{"".join(images)}</div>'
        f'<div class="scale">{scale}</div></figure>'
    )


def _is_wide(box: Box) -> bool:
    """Whether pictures of the box are better one above the other."""
    return box.width > 1.5 * box.height


def _plots(table: Dataset) -> str:
    """Inline SVG in the fonts and colours of the page."""
    if table.sizes.get("t", 0) < 2:
        return ""
    found: list[str] = []
    for title, names in PLOTS.items():
        if not any(name in table for name in names):
            continue
        with rc_context(markup.STYLE):
            figure = Figure(figsize=(4.4, 2.5), layout="constrained")
            plot.histories(table, *names, ax=figure.add_subplot())
            caption = f"<figcaption>{title}</figcaption>"
            found.append(f"<figure>{caption}{markup.svg(figure, title, len(found))}</figure>")
    return f'<div class="plots">{"".join(found)}</div>' if found else ""


def _ledger(table: Dataset) -> str:
    """What every measured number was at first and at last, and how far it went."""
    rows = []
    for name, values in table.data_vars.items():
        if values.dims != ("t",) or values.size == 0 or name in ("step", "particles"):
            continue
        cells = [
            markup.number(float(v)) for v in (values[0], values[-1], values.min(), values.max())
        ]
        rows.append(
            f"<tr><td>{escape(values.attrs.get('long_name', str(name)))}</td>"
            + "".join(f'<td class="n">{cell}</td>' for cell in cells)
            + f'<td class="u">{escape(plot.readable(values.attrs.get("units", "1")))}</td></tr>'
        )
    if not rows:
        return ""
    heads = ("", *(f"at {float(table['t'][k]):.3g} s" for k in (0, -1)), "least", "most", "")
    head = "".join(f"<th{' class=n' if 0 < k < 5 else ''}>{h}</th>" for k, h in enumerate(heads))
    return (
        f'<div class="wide"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _times(seconds: Mapping[str, float]) -> str:
    total = sum(seconds.values())
    if total <= 0.0:
        return ""
    rows = "".join(
        f"<tr><td>{escape(PARTS.get(name, f'flow: {name}'))}</td>"
        f'<td class="n">{markup.duration(value)}</td>'
        f'<td class="n">{100.0 * value / total:.1f} %</td>'
        f'<td class="bar"><i style="width:{100.0 * value / total:.1f}%"></i></td></tr>'
        for name, value in sorted(seconds.items(), key=lambda item: -item[1])
    )
    return f'<div class="wide"><table><tbody>{rows}</tbody></table></div>'


def _rows(pairs: Iterable[tuple[str, Any]]) -> str:
    rows = "".join(
        f"<tr><th>{escape(str(name))}</th><td>{escape(markup.words(value))}</td></tr>"
        for name, value in pairs
    )
    return f'<div class="wide"><table><tbody>{rows}</tbody></table></div>' if rows else ""


__all__ = ["NAME", "Run", "html", "of_folder", "of_simulation", "used", "write"]
