"""A simulation in a file, whole: what goes on from it equals what would have gone on, bit by bit.

The file is HDF5 behind a block with a checksum of it, written under another name and then renamed.
It holds numbers and the text of the model, nothing that could be executed; a force that is a
function must be given again.
"""

from __future__ import annotations

import json
import os
from contextlib import suppress
from dataclasses import asdict
from hashlib import sha256
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

NAME, FORMAT, BLOCK = "checkpoint.h5", "grainmesh checkpoint 1", 512
Arrays = dict[str, NDArray[Any]]


def write(folder: str | Path, model: Model, numbers: dict[str, Any], arrays: Arrays) -> Path:
    """Write ``checkpoint.h5`` into a folder, made if need be; an old one is replaced at the end.

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
    path = Path(folder) / NAME
    new = path.with_suffix(".new")
    force: Any = FUNCTION if callable(model.force) else None
    if model.force is not None and force is None:
        force = np.asarray(model.force, dtype=float).tolist()
    memory = BytesIO()
    with h5py.File(memory, "w", userblock_size=BLOCK) as tree:
        tree["model"] = json.dumps(_fields(model) | {"force": force})
        tree["numbers"] = json.dumps(numbers)
        for name, array in arrays.items():
            tree[name] = array
    data = memory.getvalue()[BLOCK:]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with new.open("wb") as file:
            file.write(_head(data) + data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(new, path)
    except OSError as fault:
        with suppress(OSError):
            new.unlink()
        raise InputError(f"{path}: cannot be written ({fault}), choose another folder") from None
    return path


def read(folder: str | Path, fluid: Fluid | None = None) -> tuple[Model, dict[str, Any], Arrays]:
    """What `write` wrote: model, numbers and arrays; `fluid` stands in for one with functions.

    Raises
    ------
    InputError
        If there is no such file, or it is damaged.
    """
    path = Path(folder)
    path = path if path.is_file() else path / NAME
    if not path.is_file():
        raise InputError(f"{path}: no such file: name the folder given as save=")
    asked = False
    try:
        whole = path.read_bytes()
        # HDF5 itself can hang on a damaged file: it only sees one whose checksum is right.
        if whole[:BLOCK] != _head(whole[BLOCK:]):
            raise ValueError("its checksum differs")
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
        raise InputError(f"{path}: damaged or not a checkpoint ({fault})") from None
    if fluid is not None and model.fluid is not fluid:
        raise InputError(f"{path}: the fluid of the model is in the file, drop fluid=")
    if asked:
        raise InputError(
            f"{path}: give the fluid of the model again, its drag or an inflow was a function"
        )
    return model, numbers, arrays


def _head(data: bytes) -> bytes:
    """The user block in front of the HDF5 data: format and checksum."""
    return f"{FORMAT}\nsha256 {sha256(data).hexdigest()}\n".encode().ljust(BLOCK, b"\0")


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


__all__ = ["FUNCTION", "read", "write"]
