"""Histories as tables: rows of `Simulation.measure` as an xarray.Dataset with units, and netCDF.

>>> table = grainmesh.history.table(simulation)
>>> table.kinetic.plot()
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from grainmesh.domain import SIDES, Box
from grainmesh.errors import InputError

if TYPE_CHECKING:
    import xarray

    from grainmesh.simulation import Simulation

Float = NDArray[np.float64]
Row = Mapping[str, float]

NAME = "history.nc"
#: Unit and meaning of each number that is no energy.
MEANING = {
    "step": ("1", "steps done"),
    "particles": ("1", "particles in the box"),
    "kinetic": ("J m-1", "kinetic energy of the particles"),
    "rotational": ("J m-1", "energy of their spin"),
    "elastic": ("J m-1", "energy of the springs of contacts"),
    "potential": ("J m-1", "potential energy of the particles, from y = 0"),
    "contacts": ("1", "contacts of particles with particles"),
    "overlap": ("1", "deepest overlap over smallest radius"),
    "height": ("m", "top of the highest particle"),
    "flips": ("1", "edges flipped so far, of the triangulation for contacts"),
    "damped": ("J m-1", "energy taken by dashpots"),
    "slid": ("J m-1", "energy taken by sliding friction"),
    "rolled": ("J m-1", "energy taken by rolling friction"),
    "work_of_walls": ("J m-1", "work done on the particles by walls"),
    "work_outside": ("J m-1", "work done on the particles by forces from outside"),
    "impulse_of_walls_x": ("N s m-1", "impulse given by walls, x"),
    "impulse_of_walls_y": ("N s m-1", "impulse given by walls, y"),
    "impulse_outside_x": ("N s m-1", "impulse given by forces from outside, x"),
    "impulse_outside_y": ("N s m-1", "impulse given by forces from outside, y"),
    "total": ("J m-1", "energy and work of the ledger, constant but for errors"),
    "momentum_x": ("N s m-1", "momentum of the particles, x"),
    "momentum_y": ("N s m-1", "momentum of the particles, y"),
    "bed_height": ("m", "twice the height of the centre of mass of the particles"),
    "energy_residual": ("1", "change of the total of the ledger over the largest energy so far"),
    "volume_residual": ("1", "solid on the mesh less that of the particles, over the latter"),
    "fluid_momentum_x": ("N s m-1", "momentum of the fluid, x"),
    "fluid_momentum_y": ("N s m-1", "momentum of the fluid, y"),
    "fluid_kinetic": ("J m-1", "kinetic energy of the fluid"),
    "slip": ("m s-1", "mean speed of the fluid against the particles"),
    "flow_step": ("s", "step of the flow"),
    "added_viscosity": ("1", "largest viscosity added for stability, over that of the fluid"),
    "iterations": ("1", "iterations of the linear solver in the last step"),
    **{
        f"pressure_{side}": ("Pa", f"mean dynamic pressure at the {side} side") for side in SIDES
    },
    "pressure_drop_x": ("Pa", "mean dynamic pressure at the left less that at the right"),
    "pressure_drop_y": ("Pa", "mean dynamic pressure at the bottom less that at the top"),
}  # fmt: skip
PROBED = {
    "velocity_x": ("m s-1", "velocity of the fluid, x"),
    "velocity_y": ("m s-1", "velocity of the fluid, y"),
    "pressure": ("Pa", "dynamic pressure"),
}


def more(simulation: Simulation, probes: ArrayLike = ()) -> dict[str, float]:
    """What `Simulation.measure` leaves out: momentum, bed height, residuals, values at probes.

    Parameters
    ----------
    simulation : Simulation
    probes : (k, 2), optional
        Places at which the flow is sampled [m]; undefined outside of the box.

    Returns
    -------
    dict
        "momentum x", "momentum y" [N s/m], "bed height" [m]; with a ledger "energy residual"; with
        a fluid "volume residual" and "probe 0 velocity x", ...
    """
    discs = simulation.particles
    mass = discs.density * np.pi / 4.0 * discs.diameter**2
    px, py = (mass[:, None] * simulation.velocity).sum(axis=0)
    middle = float((mass * simulation.x[:, 1]).sum() / mass.sum())
    found = {"momentum x": float(px), "momentum y": float(py), "bed height": 2.0 * middle}
    row = simulation.history[-1] if simulation.history else {}
    if "total" in row:
        parts = ("kinetic", "rotational", "elastic", "damped", "slid", "rolled")
        scale = max(sum(abs(r[part]) for part in parts) for r in simulation.history)
        change = abs(row["total"] - simulation.history[0]["total"])
        found["energy residual"] = change / scale if scale > 0.0 else 0.0
    if simulation.flow is not None:
        flow = simulation.flow.sample()
        solid = float((np.pi / 4.0 * discs.diameter**2).sum())
        area = _area(flow.points[flow.triangles])
        meshed = float((area * (1.0 - flow.porosity[flow.triangles]).mean(axis=1)).sum())
        found["volume residual"] = abs(meshed - solid) / solid
        values = np.column_stack([flow.velocity, flow.pressure])
        for k, at in enumerate(_probed(flow.points, flow.triangles, values, places(probes))):
            found |= {
                f"probe {k} {name.replace('_', ' ')}": float(value)
                for name, value in zip(PROBED, at, strict=True)
            }
    return found


def places(probes: ArrayLike, box: Box | None = None) -> Float:
    """Places of probes as (k, 2) [m].

    Raises
    ------
    InputError
        If they are not, or lie outside of a box that is given.
    """
    try:
        found = np.asarray(probes, dtype=float)
    except (TypeError, ValueError):
        found = np.full(1, np.nan)
    found = found.reshape(-1, 2) if found.size == 0 else found
    if found.ndim != 2 or found.shape[1] != 2 or not np.isfinite(found).all():
        raise InputError("probes must be places [[x, y], ...] in metres")
    for x, y in found:
        if box is not None and not (0.0 <= x <= box.width and 0.0 <= y <= box.height):
            raise InputError(
                f"run.probes: ({x:g}, {y:g}) m is outside of the box, {box.width:g} x "
                f"{box.height:g} m: move it in, or drop it"
            )
    return found


def table(simulation: Simulation | Sequence[Row], probes: ArrayLike = ()) -> xarray.Dataset:
    """The history of a simulation, or rows of it, as a table over the time.

    Parameters
    ----------
    simulation : Simulation, or sequence of dict
    probes : (k, 2), optional
        Places of the probes [m].

    Returns
    -------
    xarray.Dataset
        Coordinate ``t`` [s]; spaces in names are underscores; attributes ``units``, ``long_name``.
        Numbers that a row lacks are NaN. Pressure drops where the sides have pressures.
    """
    import xarray

    rows = simulation if isinstance(simulation, Sequence) else simulation.history
    names = list(dict.fromkeys(name for row in rows for name in row if name != "t"))
    columns = {
        name.replace(" ", "_"): np.array([row.get(name, np.nan) for row in rows]) for name in names
    }
    probed = {name: columns.pop(name) for name in list(columns) if name.startswith("probe_")}
    if "pressure_left" in columns:
        columns["pressure_drop_x"] = columns["pressure_left"] - columns["pressure_right"]
        columns["pressure_drop_y"] = columns["pressure_bottom"] - columns["pressure_top"]
    t = ("t", np.array([row["t"] for row in rows], float), _about("s", "time"))
    data: dict[str, Any] = {
        name: ("t", values, _about(*MEANING.get(name, ("", name))))
        for name, values in columns.items()
    }
    coordinates: dict[str, Any] = {"t": t}
    if probed:
        where = places(probes)
        for name, meaning in PROBED.items():
            several = [probed[f"probe_{k}_{name}"] for k in range(len(where))]
            about = _about(meaning[0], f"{meaning[1]}, at probes")
            data[f"probe_{name}"] = (("t", "probe"), np.stack(several, axis=1), about)
        for axis, name in enumerate("xy"):
            about = _about("m", f"place of a probe, {name}")
            coordinates[f"probe_{name}"] = ("probe", where[:, axis], about)
    return xarray.Dataset(data, coordinates, {"title": "history of a grainmesh simulation"})


def write(path: Path, found: xarray.Dataset) -> None:
    """Write a table as netCDF; an old file is replaced at the end.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    new = path.with_suffix(".new")
    try:
        found.to_netcdf(new, engine="h5netcdf")
        os.replace(new, path)
    except (OSError, RuntimeError) as fault:
        new.unlink(missing_ok=True)
        raise InputError(
            f"{path}: cannot be written ({fault}): make room or choose another folder"
        ) from None


def read(path: str | Path) -> xarray.Dataset:
    """A table that `write` wrote; `path` may be the folder of a run.

    Raises
    ------
    InputError
        If there is no such file or it is damaged.
    """
    import xarray

    path = Path(path)
    path = path / NAME if path.is_dir() else path
    if not path.is_file():
        raise InputError(f"{path}: no such file: name the folder of a run")
    try:
        return xarray.load_dataset(path, engine="h5netcdf")
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError) as fault:
        raise InputError(f"{path}: damaged or no history of a run ({fault})") from None


def _about(units: str, long_name: str) -> dict[str, str]:
    return {"units": units, "long_name": long_name}


def _area(corners: Float) -> Float:
    """Areas of triangles (c, 3, 2)."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    found: Float = 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    return found


def _probed(points: Float, triangles: NDArray[np.int64], values: Float, at: Float) -> Float:
    """Values at places (k, v), linear on triangles; NaN where there is none."""
    found = np.full((len(at), values.shape[1]), np.nan)
    corners = points[triangles]
    for k, place in enumerate(at):
        sides = corners - place
        # Twice the areas of place and two corners: barycentric coordinates.
        a, b = np.roll(sides, -1, axis=1), np.roll(sides, -2, axis=1)
        share = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
        total = share.sum(axis=1)
        share /= np.where(total > 0.0, total, 1.0)[:, None]
        best = int(np.argmax(np.where(total > 0.0, share.min(axis=1), -np.inf)))
        if share[best].min() > -1e-9:
            found[k] = share[best] @ values[triangles[best]]
    return found


__all__ = ["NAME", "more", "places", "read", "table", "write"]
