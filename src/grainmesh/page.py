"""A page that tells a run: what it was, what came of it, where the time went, what to cite.

One HTML file with its pictures inside: it loads nothing, runs nothing, follows the reader's light
or dark setting and prints well.
"""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from io import BytesIO, StringIO

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from numpy.typing import NDArray
from xarray import Dataset

from grainmesh import __version__, cite, plot
from grainmesh.domain import Box
from grainmesh.frames import Frame
from grainmesh.simulation import Simulation

Float = NDArray[np.float64]

NAME = "report.html"
#: Pictures: longest side [CSS pixels], and how many pixels of theirs make one.
LONGEST, SHARP = 420, 2
#: Plots of histories: title, and variables of one unit; what a run lacks is left out.
PLOTS = {
    "Energies": ("kinetic", "rotational", "elastic", "fluid kinetic"),
    "Height of the bed": ("height",),
    "Pressure drop": ("pressure drop",),
    "Slip of the fluid against the particles": ("slip",),
    "Contacts": ("contacts",),
    "Residuals": ("momentum residual", "volume residual"),
    "Step of the flow": ("flow step",),
    "Iterations of the linear solver": ("iterations",),
}
#: What the page is allowed to load: nothing but what it holds.
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
#: Colours of a plot that stand for those of the page, and what they become there.
INK = "#010203"
LINES = {f"#0a0b{i:02x}": f"var(--c{i})" for i in range(6)}


@dataclass(frozen=True, eq=False)
class Run:
    """What the page is made of.

    Parameters
    ----------
    title, case : str
        Name of the run, and the text of its case.
    simulation : Simulation
        Its last state.
    frames : sequence of Frame
        To be drawn beside each other, first to last.
    table : xarray.Dataset
        The history, see `history.table`.
    seconds : mapping
        Processor time by its use.
    environment : mapping
        Versions and machine.
    """

    title: str
    case: str
    simulation: Simulation
    frames: Sequence[Frame]
    table: Dataset
    seconds: Mapping[str, float]
    environment: Mapping[str, str]


def html(run: Run) -> str:
    """The page as text."""
    parts = (
        _head(run),
        _section("Pictures", _pictures(run)),
        _section("Histories", _plots(run.table)),
        _section("Balance", _balance(run.table)),
        _section("Case", f"<pre>{escape(run.case)}</pre>" if run.case else ""),
        _section("Time spent", _times(run.seconds)),
        _section("Made with", _rows(run.environment.items())),
        _section("To be cited", f"<pre>{escape(cite.bibtex(used(run.simulation)))}</pre>"),
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


def used(simulation: Simulation) -> list[str]:
    """Methods and laws of a simulation that `cite.bibtex` knows."""
    fluid = simulation.model.fluid
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
        f"{_metres(box.width)} × {_metres(box.height)}"
    )
    lead += (
        ", without a fluid."
        if fluid is None
        else f", in a fluid of {fluid.density:.4g} kg/m³ and {fluid.viscosity:.3g} Pa s; "
        f"drag law {fluid.drag.name}."
    )
    numbers = [("time reached", f"{now.t:.4g}", "s"), ("steps", f"{now.step:,}", "")]
    measured = now.measure()
    solid = 0.25 * np.pi * float((d**2).sum()) / box.area
    numbers += [
        ("porosity of the box", f"{1.0 - solid:.3f}", ""),
        ("contacts", f"{measured['contacts']:,.0f}", ""),
        ("height", *_metres(measured["height"]).split()),
        ("deepest overlap", f"{100.0 * measured['overlap']:.2g}", "% of a radius"),
    ]
    if now.flow is not None:
        numbers.append(("triangles of the flow", f"{len(now.flow.mesh.triangles):,}", ""))
    if run.seconds:
        numbers.append(("run time", *_duration(sum(run.seconds.values())).split()))
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
    box, frames = run.simulation.model.box, run.frames
    found = []
    flows = [frame.flow for frame in frames if frame.flow is not None]
    for show, unit in plot.SHOWN.items() if flows else ():
        values = [np.hypot(*f.velocity.T) if show == "speed" else getattr(f, show) for f in flows]
        low, high = np.quantile(np.concatenate(values), [0.02, 0.98])
        limits = (0.0 if show == "speed" else float(low), float(high))
        images = []
        for frame in frames:
            if frame.flow is None:
                continue
            figure, ax = _canvas(box)
            plot.field(box, frame.flow, ax, show=show)
            ax.collections[0].set_clim(*limits)
            plot.discs(box, frame.particles, ax)
            images.append(_png(figure, box, f"{frame.t:.3g} s"))
        title = {"speed": "Speed of the fluid", "pressure": "Dynamic pressure"}.get(
            show, "Porosity"
        )
        found.append(_field(title, images, _scale(*limits, unit)))
    speeds = [np.hypot(*frame.velocity.T) for frame in frames]
    top = max(float(np.quantile(np.concatenate(speeds), 0.98)), 1e-12)
    images = []
    for frame, speed in zip(frames, speeds, strict=True):
        figure, ax = _canvas(box)
        plot.discs(box, frame.particles, ax, colour=speed)
        ax.collections[0].set_clim(0.0, top)
        images.append(_png(figure, box, f"{frame.t:.3g} s"))
    found.append(_field("Speed of the discs", images, _scale(0.0, top, "m/s")))
    strong = run.simulation.contacts.force
    if len(strong):
        figure, ax = _canvas(box)
        plot.chains(run.simulation, plot.discs(box, run.simulation.particles, ax))
        caption = f"strongest {_number(float(strong.max()))} N/m, mean {_number(strong.mean())} N/m"
        images = [_png(figure, box, f"{run.simulation.t:.3g} s")]
        found.append(_field("Forces between discs", images, f"<span>{caption}</span>"))
    return f'<div class="fields">{"".join(found)}</div>'


def _plots(table: Dataset) -> str:
    """Inline SVG in the fonts and colours of the page."""
    if table.sizes.get("t", 0) < 2:
        return ""
    found = []
    for title, names in PLOTS.items():
        if not any(name in table for name in names):
            continue
        with rc_context({
            "svg.fonttype": "none", "text.parse_math": False, "text.color": INK,
            "axes.edgecolor": INK, "axes.labelcolor": INK, "xtick.color": INK, "ytick.color": INK,
            "axes.prop_cycle": "cycler('color', [" + ", ".join(map(repr, LINES)) + "])",
            "font.size": 9.0, "axes.linewidth": 0.6, "axes.formatter.limits": (-3, 4),
        }):  # fmt: skip
            figure = Figure(figsize=(4.4, 2.5), layout="constrained")
            plot.histories(table, *names, ax=figure.add_subplot())
            caption = f"<figcaption>{title}</figcaption>"
            found.append(f"<figure>{caption}{_svg(figure, title, len(found))}</figure>")
    return f'<div class="plots">{"".join(found)}</div>' if found else ""


def _balance(table: Dataset) -> str:
    """What every measured number was at first and at last, and how far it went."""
    names = [str(n) for n in table.data_vars if table[n].dims == ("t",) and n not in ("step",)]
    if table.sizes.get("t", 0) == 0 or not names:
        return ""
    rows = []
    for name in names:
        values = np.asarray(table[name], dtype=float)
        cells = (values[0], values[-1], np.nanmin(values), np.nanmax(values))
        unit = table[name].attrs.get("units", "1")
        rows.append(
            f"<tr><td>{escape(name)}</td>"
            + "".join(f'<td class="n">{_number(v)}</td>' for v in cells)
            + f"<td>{'' if unit == '1' else escape(unit)}</td></tr>"
        )
    t = np.asarray(table["t"], dtype=float)
    heads = ("", f"at {t[0]:.3g} s", f"at {t[-1]:.3g} s", "least", "greatest", "unit")
    head = "".join(f"<th{' class=n' if 0 < i < 5 else ''}>{h}</th>" for i, h in enumerate(heads))
    return (
        f'<div class="wide"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _times(seconds: Mapping[str, float]) -> str:
    total = sum(seconds.values())
    if total <= 0.0:
        return ""
    rows = "".join(
        f'<tr><td>{escape(name)}</td><td class="n">{_duration(value)}</td>'
        f'<td class="n">{100.0 * value / total:.1f} %</td>'
        f'<td class="bar"><i style="width:{100.0 * value / total:.1f}%"></i></td></tr>'
        for name, value in sorted(seconds.items(), key=lambda item: -item[1])
    )
    return f'<div class="wide"><table><tbody>{rows}</tbody></table></div>'


def _rows(pairs: Iterable[tuple[str, str]]) -> str:
    rows = "".join(
        f"<tr><th>{escape(str(name))}</th><td>{escape(str(value))}</td></tr>"
        for name, value in pairs
    )
    return f'<div class="wide"><table><tbody>{rows}</tbody></table></div>' if rows else ""


# --- pictures ------------------------------------------------------------------------------------


def _canvas(box: Box) -> tuple[Figure, Axes]:
    """A figure that is all box, without axes."""
    size = np.asarray(box.size) / np.max(box.size) * LONGEST / 100.0
    figure = Figure(figsize=tuple(size), dpi=100 * SHARP)
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    ax.set_axis_off()
    return figure, ax


def _png(figure: Figure, box: Box, when: str) -> str:
    """An image with its caption, all in the text of the page."""
    for ax in figure.axes:
        ax.set_axis_off()
    data = BytesIO()
    figure.savefig(data, format="png", transparent=True)
    width, height = (np.asarray(box.size) / np.max(box.size) * LONGEST).round().astype(int)
    source = f"data:image/png;base64,{b64encode(data.getvalue()).decode()}"
    return (
        f'<div><img src="{source}" width="{width}" height="{height}" alt="the box at {when}">'
        f"<span>{when}</span></div>"
    )


def _field(title: str, images: Sequence[str], scale: str) -> str:
    return (
        f'<figure><figcaption>{title}</figcaption><div class="frames">{"".join(images)}</div>'
        f'<div class="scale">{scale}</div></figure>'
    )


def _scale(low: float, high: float, unit: str) -> str:
    """A bar of the colours from low to high."""
    steps = ",".join(to_hex(colormaps[plot.SPEED](v)) for v in np.linspace(0.0, 1.0, 9))
    bar = f'<i style="background:linear-gradient(to right,{steps})"></i>'
    return f"{_number(low)}{bar}{_number(high)} {unit}"


def _svg(figure: Figure, title: str, number: int) -> str:
    text = StringIO()
    figure.savefig(text, format="svg", transparent=True, metadata={"Date": None})
    found = text.getvalue()
    found = found[found.index("<svg") :]
    found = re.sub(r"<metadata>.*?</metadata>", "", found, flags=re.DOTALL)
    found = re.sub(r'<svg ([^>]*?)width="[^"]*" height="[^"]*"', r"<svg \1", found, count=1)
    found = re.sub(r"""font: ([\d.]+)px [^;"]*""", r"font-size: \1px", found)
    found = re.sub(r'id="', f'id="p{number}-', found)
    found = re.sub(r'(url\(|href=")#', rf"\1#p{number}-", found)
    for colour, here in {INK: "currentColor", **LINES}.items():
        found = found.replace(colour, here)
    return found.replace("<svg ", f'<svg role="img" aria-label="{escape(title)}" ', 1)


# --- numbers -------------------------------------------------------------------------------------


def _number(value: float) -> str:
    """Four digits, with a power of ten where that is shorter, and true signs."""
    text = f"{float(value):.4g}"
    if "e" in text:
        digits, power = text.split("e")
        text = f"{digits}·10<sup>{int(power)}</sup>"
    return text.replace("-", "−")


def _metres(value: float) -> str:
    for unit, size in (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6)):
        if value >= size:
            return f"{value / size:.4g} {unit}"
    return f"{value * 1e9:.4g} nm"


def _duration(seconds: float) -> str:
    for unit, size in (("h", 3600.0), ("min", 60.0), ("s", 1.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{1e3 * seconds:.0f} ms"
