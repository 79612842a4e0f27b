"""The frames of a run in the browser: time, field, mesh and discs by choice.

Triangles are sent to the browser, which draws them (vtk.js): no display or graphics card is needed
where this runs. Only this machine can connect.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from grainmesh import plot, vtkhdf
from grainmesh.errors import InputError

Float = NDArray[np.float64]

#: Packages of the extra `view`.
NEEDED = ("pyvista", "trame", "trame_vtk", "trame_vuetify")
#: Corners of a disc, and how far it lies above the flow, over the size of all.
CORNERS, ABOVE = 32, 1e-3
#: Frames per second while playing; frames looked at for the ends of the scales.
RATE, LOOKED_AT = 10.0, 12
#: Colours of the flow and of the discs: the names in vtk.js and in matplotlib.
FLOW, DISCS = ("Viridis (matplotlib)", "viridis"), ("Inferno (matplotlib)", "inferno")
#: Left button and wheel; there is nothing to turn in a plane.
MOUSE = [
    {"button": 1, "action": "Pan"},
    {"button": 2, "action": "Pan"},
    {"button": 3, "action": "Zoom", "scrollEnabled": True},
]
NARROW = {"density": "compact", "hide_details": True, "style": "max-width:11rem"}
LEGEND = (
    "display:flex;align-items:center;gap:.5rem;font-size:.85rem;font-variant-numeric:tabular-nums"
)
BAR = "width:8rem;height:.5rem;border-radius:.25rem"
SMALL = {
    "density": "compact",
    "hide_details": True,
    "color": "primary",
    "classes": "mx-4 flex-grow-0",
}


@dataclass(frozen=True)
class Frames:
    """The frames of a run, read when they are asked for.

    Parameters
    ----------
    folder : Path

    Raises
    ------
    InputError
        If it holds no frames.
    """

    folder: Path

    def __post_init__(self) -> None:
        if not (self.folder / vtkhdf.DISCS).is_file():
            raise InputError(f"{self.folder}: holds no frames, name the folder of a run")

    @cached_property
    def times(self) -> Float:
        """[s], (f,)"""
        return vtkhdf.times(self.folder / vtkhdf.DISCS)

    @cached_property
    def wet(self) -> bool:
        """Whether there is a flow."""
        return (self.folder / vtkhdf.FLOW).is_file()

    def discs(self, k: int) -> vtkhdf.Frame:
        """The discs of a frame."""
        return vtkhdf.read(self.folder / vtkhdf.DISCS, k)

    def flow(self, k: int) -> vtkhdf.Frame:
        """The flow of a frame."""
        return vtkhdf.read(self.folder / vtkhdf.FLOW, k)

    @cached_property
    def size(self) -> float:
        """A length that all lengths are drawn over [m]."""
        return float(np.ptp((self.flow if self.wet else self.discs)(0).points, axis=0).max()) or 1.0


def serve(
    folder: str | Path, port: int = 0, ready: Callable[[str], None] = lambda address: None
) -> None:
    """Show the frames of a run in the browser, until interrupted.

    Parameters
    ----------
    folder : path
        Of the run.
    port : int
        0 takes a free one.
    ready : callable
        Is told the address.

    Raises
    ------
    InputError
        If there are no frames, a package of the extra `view` is missing, or the port is taken.
    """
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise InputError(
            f"the viewer needs {', '.join(missing)}: in a clone, pip install -e '.[view]' brings it"
        )
    server = _server(Frames(Path(folder)), Path(folder).resolve().name)
    server.controller.on_server_ready.add(
        lambda **_: ready(
            f"http://127.0.0.1:{server.port}/index.html?sessionURL=ws://127.0.0.1:{server.port}/ws"
        )
    )
    try:
        server.start(
            port=port, host="127.0.0.1", open_browser=False, show_connection_info=False, timeout=0
        )
    except OSError as fault:
        raise InputError(f"port {port}: {fault.strerror}; choose another with --port") from None


def surface(frame: vtkhdf.Frame, show: str, size: float) -> Any:
    """The flow as a pyvista surface with one field, `value`; lengths over `size`."""
    import pyvista

    points = np.column_stack([frame.points, np.zeros(len(frame.points))]) / size
    mesh = pyvista.PolyData.from_regular_faces(points.astype(np.float32), frame.triangles)
    mesh["value"] = field(frame, show).astype(np.float32)
    return mesh


def polygons(frame: vtkhdf.Frame, show: str, size: float) -> Any:
    """The discs as a pyvista surface a little above the flow, with one field, `value`."""
    import pyvista

    turn = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)
    ring = frame.fields["radius"][:, None, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    points = np.full((len(frame.points) * CORNERS, 3), ABOVE, dtype=np.float32)
    points[:, :2] = (frame.points[:, None] + ring).reshape(-1, 2) / size
    mesh = pyvista.PolyData.from_regular_faces(points, np.arange(len(points)).reshape(-1, CORNERS))
    mesh["value"] = np.repeat(field(frame, show), CORNERS).astype(np.float32)
    return mesh


def field(frame: vtkhdf.Frame, show: str) -> Float:
    """A field by the name it is shown by: the length of a vector, "speed" that of the velocity."""
    value: Float = frame.fields["velocity" if show == "speed" else show]
    return np.hypot(*value.T) if value.ndim == 2 else value


def ends(frame: Callable[[int], vtkhdf.Frame], count: int, show: str) -> list[float]:
    """Ends of a scale that serves all frames, but for two in a hundred values."""
    looked_at = np.unique(np.linspace(0, count - 1, min(count, LOOKED_AT)).round().astype(int))
    values = np.concatenate([field(frame(int(k)), show) for k in looked_at])
    low, high = (float(q) for q in np.quantile(values, [0.02, 0.98]))
    low = low if show in ("pressure", "porosity") else 0.0
    return [low, max(high, low + 1e-12)]


def _server(frames: Frames, title: str) -> Any:
    """The page, and what its controls do."""
    os.environ["TRAME_ARGS"] = ""  # the words on the command line are ours, not for trame
    from trame.app import get_server
    from trame.ui.vuetify3 import VAppLayout
    from trame.widgets import html, vtk
    from trame.widgets import vuetify3 as v

    count, size = len(frames.times), frames.size
    fields = plot.SHOWN if frames.wet else {}
    grain = {"speed": "m/s", "force": "N/m"}
    limits = {show: ends(frames.flow, count, show) for show in fields}
    limits_of_discs = {show: ends(frames.discs, count, show) for show in grain}
    server: Any = get_server(f"grainmesh {title}", client_type="vue3")
    state = server.state
    state.update(
        {
            "trame__title": title,
            "times": [f"{t:.4g} s" for t in frames.times],
            "limits": limits,
            "limits_of_discs": limits_of_discs,
            "units": {**fields, **grain},
            "k": count - 1,
            "show": "speed",
            "edges": False,
            "colour": "none" if frames.wet else "speed",
            "playing": False,
        }
    )

    def legend(name: str, show: str, limits: str, where: str, colours: str) -> None:
        steps = ",".join(map(to_hex, colormaps[colours](np.linspace(0.0, 1.0, 9))))
        with html.Div(style=LEGEND, v_if=where):
            html.Span(f"{{{{ {show} }}}} {name}")
            html.Span(
                f"{{{{ Number({limits}[{show}][0].toPrecision(3)) }}}}", style="margin-left:1rem"
            )
            html.Span(style=f"{BAR};background:linear-gradient(to right,{steps})")
            html.Span(
                f"{{{{ Number({limits}[{show}][1].toPrecision(3)) }}}} {{{{ units[{show}] }}}}"
            )

    with VAppLayout(server):
        with v.VAppBar(density="compact", flat=True, border=True):
            v.VAppBarTitle(title)
            if frames.wet:
                v.VSelect(v_model=("show",), items=("items", list(fields)), label="fluid", **NARROW)
                v.VSwitch(v_model=("edges",), label="mesh", **SMALL)
            colours = ["none", *grain]
            v.VSelect(v_model=("colour",), items=("colours", colours), label="discs", **NARROW)
        with v.VMain(style="height:100vh;display:flex;flex-direction:column"):
            with html.Div(style="display:flex;justify-content:center;gap:3rem;padding:.6rem"):
                if frames.wet:
                    legend("of the fluid", "show", "limits", "true", FLOW[1])
                legend("of the discs", "colour", "limits_of_discs", "colour != 'none'", DISCS[1])
            with vtk.VtkView(
                ref="view",
                background=("[1, 1, 1]",),
                interactor_settings=("mouse", MOUSE),
                style="flex:1;min-height:0",
            ):
                if frames.wet:
                    with vtk.VtkGeometryRepresentation(
                        color_map_preset=FLOW[0],
                        color_data_range=("limits[show]",),
                        property=(
                            "{lighting: false, edgeVisibility: edges, edgeColor: [1, 1, 1]}",
                        ),
                    ):
                        flow = vtk.VtkMesh("flow", surface(frames.flow(-1), "speed", size), "value")
                with vtk.VtkGeometryRepresentation(
                    color_map_preset=DISCS[0],
                    color_data_range=("limits_of_discs[colour] || [0, 1]",),
                    mapper=("{scalarVisibility: colour != 'none'}",),
                    property=("{lighting: false, color: [0.79, 0.81, 0.84]}",),
                ):
                    grains = vtk.VtkMesh(
                        "grains", polygons(frames.discs(-1), "speed", size), "value"
                    )
        with v.VFooter(app=True, border=True, classes="py-1"):
            v.VBtn(
                icon=("playing ? 'mdi-pause' : 'mdi-play'",),
                click="playing = !playing",
                variant="text",
                density="comfortable",
            )
            v.VSlider(
                v_model=("k",), min=0, max=count - 1, step=1, hide_details=True, classes="mx-3"
            )
            html.Span("{{ times[k] }}", style="min-width:6rem;font-variant-numeric:tabular-nums")

    def on_flow(**_: Any) -> None:
        if frames.wet:
            flow.set_dataset(surface(frames.flow(state.k), state.show, size))

    def on_discs(**_: Any) -> None:
        show = "speed" if state.colour == "none" else state.colour
        grains.set_dataset(polygons(frames.discs(state.k), show, size))

    async def on_play(**_: Any) -> None:
        while state.playing:
            with state:
                state.k = (state.k + 1) % count
            await asyncio.sleep(1.0 / RATE)

    state.change("k", "show")(on_flow)
    state.change("k", "colour")(on_discs)
    state.change("playing")(on_play)
    return server


__all__ = ["Frames", "serve"]
