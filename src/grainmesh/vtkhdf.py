"""Frames of a run as transient VTKHDF, which ParaView and VTK open.

A run has two files, both of type UnstructuredGrid: ``flow.vtkhdf``, triangles whose number and
corners change from frame to frame, and ``discs.vtkhdf``, points. One file could hold both as a
collection, but of transient collections VTK 9.7 shows the first frame only.

Frames are written in HDF5's single-writer mode: rows first, then the number of frames, each step of
it such that a reader finds a whole file, which is then closed. A writer that is killed in the
middle leaves a mark on the file, with which VTK refuses it; `read` does not mind, and `cut` mends
it.

Format: VTKHDF 2.3, https://docs.vtk.org/en/latest/vtk_file_formats (read by VTK from 9.3 on).
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from h5py import h5d, h5f, h5p, h5s
from numpy.typing import NDArray

from grainmesh.errors import InputError

if TYPE_CHECKING:
    from grainmesh.simulation import Simulation

FLOW, DISCS = "flow.vtkhdf", "discs.vtkhdf"
Float = NDArray[np.float64]
Int = NDArray[np.int64]

#: Cell types of VTK.
VERTEX, TRIANGLE = 1, 5
#: One number a frame each.
NUMBERS = (
    "NumberOfPoints", "NumberOfCells", "NumberOfConnectivityIds",
    "Steps/PartOffsets", "Steps/NumberOfParts", "Steps/PointOffsets",
)  # fmt: skip
#: Frames whose numbers are kept together in the file.
TOGETHER = 64
#: What h5py raises where a file is not as it should be.
BROKEN = (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError)


@dataclass(frozen=True, eq=False)
class Frame:
    """Points at one time, with fields, and perhaps triangles.

    Parameters
    ----------
    t : float
        [s]
    points : (p, 2)
        [m]
    fields : dict
        Values at the points by name, (p,) or (p, 2).
    triangles : (c, 3), optional
        Corners; without, each point stands for a disc.
    """

    t: float
    points: Float
    fields: dict[str, NDArray[Any]]
    triangles: Int | None = None


def flow(simulation: Simulation, cuts: int = 1) -> Frame:
    """The flow now: velocity [m/s], pressure [Pa] and porosity.

    Parameters
    ----------
    simulation : Simulation
        With a fluid.
    cuts : int
        Pieces that each edge of the mesh is cut into, to show fields of higher order.
    """
    assert simulation.flow is not None
    found = simulation.flow.sample(cuts)
    names = "velocity", "pressure", "porosity"
    fields = {name: getattr(found, name) for name in names}
    return Frame(simulation.t, found.points, fields, found.triangles)


def discs(simulation: Simulation) -> Frame:
    """The discs now: id, radius [m], velocity [m/s], spin [1/s], force, fluid_force [N/m].

    The force is that of the springs of all contacts, the other that of a fluid, without buoyancy.
    """
    fields: dict[str, NDArray[Any]] = {
        "id": simulation.ids,
        "radius": simulation.particles.radius,
        "velocity": simulation.velocity,
        "spin": simulation.spin,
        "force": _contact_force(simulation),
    }
    if simulation.flow is not None:
        fields["fluid_force"] = simulation.flow.force
    return Frame(simulation.t, simulation.x, fields)


def _contact_force(simulation: Simulation) -> Float:
    """Force of the springs of contacts on each disc [N/m], (n, 2)."""
    ids = simulation.ids
    total = np.zeros((len(ids), 2))
    for found, both in ((simulation.contacts, True), (simulation.wall_contacts, False)):
        side = np.stack([-found.normal[:, 1], found.normal[:, 0]], axis=1)
        push = found.force[:, None] * found.normal + found.friction[:, None] * side
        np.subtract.at(total, np.searchsorted(ids, found.pair[:, 0]), push)
        if both:
            np.add.at(total, np.searchsorted(ids, found.pair[:, 1]), push)
    return total


def append(path: Path, *frames: Frame) -> None:
    """Add frames to a file, made if need be; several at once take little longer than one.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    new = path.with_suffix(".new")
    try:
        if path.exists():
            _reserve(path, frames)
            _append(path, frames)
            return
        new.write_bytes(_empty(frames[0]))
        _reserve(new, frames)
        _append(new, frames)
        os.replace(new, path)
    except BROKEN as fault:
        new.unlink(missing_ok=True)
        raise InputError(
            f"{path}: cannot be written ({fault}): make room or choose another folder"
        ) from None


def times(path: str | Path) -> Float:
    """Times of the frames [s], (f,).

    Raises
    ------
    InputError
        If there is no such file or it is damaged.
    """
    with _reading(Path(path)) as root:
        found: Float = root["Steps/Values"][: root["Steps"].attrs["NSteps"]]
        return found


def read(path: str | Path, number: int) -> Frame:
    """A frame by its number, from 0, or from -1 backwards.

    Raises
    ------
    InputError
        If there is no such file or frame, or it is damaged.
    """
    with _reading(Path(path)) as root:
        steps = root["Steps"]
        count = int(steps.attrs["NSteps"])
        if not -count <= number < count:
            raise InputError(f"{path}: there is no frame {number}, it holds {count}")
        k = number % count
        size = int(root["NumberOfPoints"][k])
        first = int(steps["PointOffsets"][k])
        fields = {}
        for name, item in root["PointData"].items():
            value = item[first : first + size]
            fields[name] = value[:, :2] if value.ndim == 2 else value
        start = int(steps["ConnectivityIdOffsets"][k, 0])
        end = start + int(root["NumberOfConnectivityIds"][k])
        cells = root["Connectivity"][start:end]
        triangles = cells.reshape(-1, 3) if root["Types"][0] == TRIANGLE else None
        points = root["Points"][first : first + size, :2]
        return Frame(float(steps["Values"][k]), points, fields, triangles)


def cut(path: Path, t: float) -> None:
    """Drop the frames after a time [s], and mend the file if its writer was killed.

    Raises
    ------
    InputError
        If the file is damaged, or a new one cannot be written.
    """
    if not path.exists():
        return
    keep = int((times(path) <= t).sum())
    if keep == len(times(path)) and _closed(path):
        return
    new = path.with_suffix(".cut")
    new.unlink(missing_ok=True)
    for k in range(keep):
        append(new, read(path, k))
    if keep:
        os.replace(new, path)
    else:
        path.unlink()


@contextmanager
def _reading(path: Path) -> Iterator[h5py.Group]:
    """The root of a file, also of one that is being written or whose writer was killed."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        with h5py.File(path, "r", swmr=True, locking=False) as file:
            yield file["VTKHDF"]
    except InputError:
        raise
    except BROKEN as fault:
        raise InputError(f"{path}: damaged or no frames of a run ({fault})") from None


def _closed(path: Path) -> bool:
    """Whether the writer of a file came to its end."""
    try:
        with h5py.File(path, "r", locking=False):
            return True
    except OSError:
        return False


def _fields(frame: Frame) -> dict[str, NDArray[Any]]:
    """All that is kept a point, as VTK wants it: three components."""
    found = {"Points": frame.points}
    found |= {f"PointData/{name}": value for name, value in sorted(frame.fields.items())}
    pad = ((0, 0), (0, 1))
    return {name: np.pad(v, pad) if v.ndim == 2 else v for name, v in found.items()}


def _cells(frame: Frame) -> Int:
    """Corners of triangles (c, 3), or the points (p, 1)."""
    if frame.triangles is not None:
        return frame.triangles
    return np.arange(len(frame.points))[:, None]


def _empty(frame: Frame) -> bytes:
    """A file for frames like this one, with none in it."""
    memory = BytesIO()
    with h5py.File(memory, "w", libver=("v110", "v110")) as file:
        file.attrs["room"] = 0  # of a chunk of each, for `_reserve`
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = np.array([2, 3])
        root.attrs.create("Type", np.bytes_("UnstructuredGrid"))

        def rows(name: str, dtype: Any, many: int = TOGETHER, width: tuple[int, ...] = ()) -> None:
            chunks = (max(many, TOGETHER), *width)
            data = root.create_dataset(
                name, (0, *width), dtype, maxshape=(None, *width), chunks=chunks
            )
            file.attrs["room"] += int(np.prod(chunks)) * data.dtype.itemsize

        for name, value in _fields(frame).items():
            rows(name, value.dtype, len(value), value.shape[1:])
            if name != "Points":
                rows(f"Steps/PointDataOffsets/{name[10:]}", "i8")
        cells = _cells(frame)
        rows("Connectivity", "i8", cells.size)
        rows("Offsets", "i8", len(cells) + 1)
        rows("Types", "u1", len(cells))
        for name in NUMBERS:
            rows(name, "i8")
        for name in ("CellOffsets", "ConnectivityIdOffsets"):
            rows(f"Steps/{name}", "i8", width=(1,))
        rows("Steps/Values", "f8")
        root["Steps"].attrs["NSteps"] = 0
    return memory.getvalue()


def _reserve(path: Path, frames: Sequence[Frame]) -> None:
    """Take the room that frames may need, as HDF5 does not survive a full disk."""
    with _reading(path) as root:
        need = int(root.file.attrs["room"]) + 2**16
    for frame in frames:
        need += 2 * sum(part.nbytes for part in (*_fields(frame).values(), _cells(frame)))
    size = path.stat().st_size
    try:
        with path.open("r+b") as file:
            file.seek(size)
            file.write(bytes(need))
    except OSError:
        os.truncate(path, size)
        raise


def _append(path: Path, frames: Sequence[Frame]) -> None:
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_libver_bounds(h5f.LIBVER_V110, h5f.LIBVER_V110)
    access.set_file_locking(False, True)  # ParaView may be looking at it
    handle = h5f.open(os.fsencode(path), h5f.ACC_RDWR | h5f.ACC_SWMR_WRITE, access)
    with h5py.File(handle) as file:
        root = file["VTKHDF"]
        number = int(root["Steps"].attrs["NSteps"])

        def put(name: str, values: Any, start: int = number) -> None:
            """Rows from `start`, over what a writer that was killed may have left there."""
            # Of its two faces, h5py's lower one: there are many small arrays.
            data = h5d.open(root.id, name.encode())
            values = np.ascontiguousarray(values, data.dtype)
            data.set_extent((start + len(values), *values.shape[1:]))
            rows = data.get_space()
            rows.select_hyperslab((start, *(0,) * (values.ndim - 1)), values.shape)
            data.write(h5s.create_simple(values.shape), rows, values)

        def starts(counts: str, more: list[int]) -> Int:
            """First row of each frame, as frames have so many."""
            put(counts, more)
            return int(root[counts][:number].sum()) + np.cumsum([0, *more[:-1]])

        points, cells = [_fields(f) for f in frames], [_cells(f) for f in frames]
        first = starts("NumberOfPoints", [len(frame.points) for frame in frames])
        for name in points[0]:
            put(name, np.concatenate([values[name] for values in points]), first[0])
            if name != "Points":
                put(f"Steps/PointDataOffsets/{name[10:]}", first)
        width, many = cells[0].shape[1], [len(corners) for corners in cells]
        cell = starts("NumberOfCells", many)
        put("NumberOfConnectivityIds", width * np.array(many))
        put("Connectivity", np.concatenate(cells).ravel(), width * cell[0])
        ends = [width * np.arange(count + 1) for count in many]  # one more than cells a frame
        put("Offsets", np.concatenate(ends), cell[0] + number)
        put("Types", np.full(sum(many), TRIANGLE if width == 3 else VERTEX), cell[0])
        put("Steps/Values", [frame.t for frame in frames])
        put("Steps/PartOffsets", number + np.arange(len(frames)))
        put("Steps/NumberOfParts", np.ones(len(frames)))
        put("Steps/PointOffsets", first)
        put("Steps/CellOffsets", cell[:, None])
        put("Steps/ConnectivityIdOffsets", width * cell[:, None])
        file.flush()
        root["Steps"].attrs.modify("NSteps", number + len(frames))
        file.flush()


__all__ = ["DISCS", "FLOW", "Frame", "append", "cut", "discs", "flow", "read", "times"]
