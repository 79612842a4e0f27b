"""A simulation in a file, whole: what goes on from it equals what would have gone on, bit by bit.

The file is HDF5 behind a block with a checksum of it, written under another name and then renamed;
the one before is kept, and taken if the last is damaged. It holds numbers, the text of the model
and the versions it was written with, nothing that could be executed; a force that is a function
must be given again.
"""

from __future__ import annotations

import json
import os
import platform
import re
import warnings
from contextlib import suppress
from dataclasses import asdict
from functools import cache
from hashlib import sha256
from importlib import metadata
from io import BytesIO
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from grainmesh.contact import Contact
from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.medium import Fluid, described, from_description
from grainmesh.model import FUNCTION, Model
from grainmesh.walls import Wall

NAME, OLD = "checkpoint.h5", "checkpoint.old.h5"
FORMAT, BLOCK = "grainmesh checkpoint 3", 512
#: Packages whose versions are kept.
PACKAGES = ("grainmesh", "numpy", "scipy", "numba", "ngsolve", "h5py")
Arrays = dict[str, NDArray[Any]]


def write(folder: str | Path, model: Model, numbers: dict[str, Any], arrays: Arrays) -> Path:
    """Write ``checkpoint.h5`` into a folder, made if need be; the one before is kept beside it.

    Parameters
    ----------
    folder : path
    model : Model
    numbers : dict
        What JSON can hold.
    arrays : dict of arrays
        Names may have slashes.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    path, old = Path(folder) / NAME, Path(folder) / OLD
    new = path.with_suffix(".new")
    force: Any = FUNCTION if callable(model.force) else None
    if model.force is not None and force is None:
        force = np.asarray(model.force, dtype=float).tolist()
    memory = BytesIO()
    with h5py.File(memory, "w", userblock_size=BLOCK) as tree:
        tree["model"] = json.dumps(_fields(model) | {"force": force})
        tree["numbers"] = json.dumps(numbers)
        tree["versions"] = json.dumps(versions())
        for name, array in arrays.items():
            tree[name] = array
    data = memory.getvalue()[BLOCK:]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with new.open("wb") as file:
            file.write(_head(data) + data)
            file.flush()
            os.fsync(file.fileno())
        if _sound(path):  # a damaged one must not take the place of a good one
            os.replace(path, old)
        os.replace(new, path)
    except OSError as fault:
        with suppress(OSError):
            new.unlink()
        raise InputError(f"{path}: cannot be written ({fault}), choose another folder") from None
    return path


def read(folder: str | Path, fluid: Fluid | None = None) -> tuple[Model, dict[str, Any], Arrays]:
    """What `write` wrote: model, numbers and arrays; `fluid` stands in for one with functions.

    Where ``checkpoint.h5`` is damaged or missing, the one before is read, with a warning.

    Raises
    ------
    InputError
        If there is no such file, it is damaged, or of another format.
    """
    path = Path(folder)
    old = path / OLD
    path = path if path.is_file() else path / NAME
    try:
        return _read(path, fluid)
    except Damaged as fault:
        if not old.is_file():
            raise
        try:
            found = _read(old, fluid)
        except Damaged:
            raise fault from None
        warnings.warn(f"{fault}; going on from the one before, {OLD}", stacklevel=2)
        return found


class Damaged(InputError):
    """A checkpoint that is not there or not as it was written."""


class Asked(InputError):
    """A checkpoint that needs a function again; `about` as of the simulation."""

    def __init__(self, message: str, about: dict[str, Any]) -> None:
        super().__init__(message)
        self.about = about


def _read(path: Path, fluid: Fluid | None) -> tuple[Model, dict[str, Any], Arrays]:
    whole, asked = _checked(path), False
    try:
        with h5py.File(BytesIO(whole), "r") as file:
            texts = file["model"].asstr()[()], file["numbers"].asstr()[()]
            fields, numbers = map(json.loads, texts)
            arrays: Arrays = {}
            file.visititems(
                lambda name, item: (
                    arrays.update({name: item[()]})
                    if isinstance(item, h5py.Dataset) and item.dtype != object
                    else None
                )
            )
        fields["box"] = Box(**fields["box"])
        fields["contact"] = Contact(**fields["contact"])
        fields["walls"] = tuple(Wall(**wall) for wall in fields["walls"])
        if isinstance(fields["fluid"], dict):
            fields["fluid"] = from_description(fields["fluid"])
        elif fields["fluid"] == FUNCTION:
            asked = fluid is None
            fields["fluid"] = fluid
        model = Model(**fields)
    except (OSError, KeyError, TypeError, ValueError, RuntimeError) as fault:
        raise Damaged(f"{path}: damaged or not a checkpoint ({fault})") from None
    if fluid is not None and model.fluid is not fluid:
        raise InputError(f"{path}: the fluid of the model is in the file, drop fluid=")
    if asked:
        raise Asked(
            f"{path}: give the fluid of the model again, its drag or an inflow was a function",
            numbers["about"],
        )
    return model, numbers, arrays


def _checked(path: Path) -> bytes:
    """The bytes of a file, if its checksum is right: HDF5 can hang on a damaged one."""
    if not path.is_file():
        raise Damaged(f"{path}: no such file: name the folder that a run was saved in")
    try:
        whole = path.read_bytes()
    except OSError as fault:
        raise Damaged(f"{path}: cannot be read ({fault.strerror})") from None
    other = re.match(rb"grainmesh checkpoint \d+(?=\n)", whole)
    form = other[0].decode() if other else FORMAT
    if whole[:BLOCK] != _head(whole[BLOCK:], form):
        raise Damaged(f"{path}: damaged or not a checkpoint (its checksum differs)")
    if form != FORMAT:
        raise InputError(
            f"{path}: is a {form}, and this version of grainmesh reads {FORMAT.split()[-1]}: go on "
            "with the version that wrote it"
        )
    return whole


def _sound(path: Path) -> bool:
    """Whether a file is a checkpoint, whole."""
    try:
        return bool(_checked(path))
    except InputError:
        return False


@cache
def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results depend on."""
    found = {"python": platform.python_version()}
    return found | {name: metadata.version(name) for name in PACKAGES}


def _head(data: bytes, form: str = FORMAT) -> bytes:
    """The user block in front of the HDF5 data: format and checksum."""
    return f"{form}\nsha256 {sha256(data).hexdigest()}\n".encode().ljust(BLOCK, b"\0")


def _fields(model: Model) -> dict[str, Any]:
    return {
        "box": asdict(model.box),
        "contact": asdict(model.contact),
        "gravity": model.gravity,
        "walls": [asdict(wall) for wall in model.walls],
        "open": model.open,
        "escape": model.escape,
        "dt": model.dt,
        "fluid": model.fluid and (described(model.fluid) or FUNCTION),
    }


__all__ = ["FUNCTION", "NAME", "OLD", "Asked", "Damaged", "read", "versions", "write"]
