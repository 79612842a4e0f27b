"""A simulation in a file, whole: what goes on from it equals what would have gone on, bit by bit.

The file is HDF5, written under another name and then renamed, with a checksum over all of it. It
holds numbers and the text of the model, nothing that could be executed; a force that is a function
must be given again.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from grainmesh.contact import Contact
from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.model import Model
from grainmesh.walls import Wall

NAME, FORMAT = "checkpoint.h5", "grainmesh checkpoint 1"
FUNCTION = "function"

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
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with h5py.File(new, "w") as file:
            texts = json.dumps(_fields(model) | {"force": force}), json.dumps(numbers)
            file.attrs["format"], file.attrs["sha256"] = FORMAT, _digest(texts, arrays)
            file["model"], file["numbers"] = texts
            for name, array in arrays.items():
                file[name] = array
        os.replace(new, path)
    except OSError as fault:
        new.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written ({fault}), choose another folder") from None
    return path


def read(folder: str | Path) -> tuple[Model, dict[str, Any], Arrays]:
    """What `write` wrote: model, numbers and arrays.

    Raises
    ------
    InputError
        If there is no such file, or it is damaged.
    """
    path = Path(folder) / NAME
    if not path.is_file():
        raise InputError(f"{path}: no such file: name the folder given as save=")
    try:
        with h5py.File(path, "r") as file:
            if file.attrs["format"] != FORMAT:
                raise ValueError("unknown format")
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
            if file.attrs["sha256"] != _digest(texts, arrays):
                raise ValueError("its checksum differs")
        fields["box"] = Box(**fields["box"])
        fields["contact"] = Contact(**fields["contact"])
        fields["walls"] = tuple(Wall(**wall) for wall in fields["walls"])
        return Model(**fields), numbers, arrays
    except (OSError, KeyError, TypeError, ValueError, RuntimeError) as fault:
        raise InputError(f"{path}: damaged or not a checkpoint ({fault})") from None


def _digest(texts: tuple[str, str], arrays: Arrays) -> str:
    """SHA-256 over all that is kept."""
    digest = sha256("".join(texts).encode())
    for name in sorted(arrays):
        digest.update(f"{name} {arrays[name].dtype} {arrays[name].shape}".encode())
        digest.update(np.ascontiguousarray(arrays[name]).tobytes())
    return digest.hexdigest()


def _fields(model: Model) -> dict[str, Any]:
    return {
        "box": asdict(model.box),
        "contact": asdict(model.contact),
        "gravity": model.gravity,
        "walls": [asdict(wall) for wall in model.walls],
        "open": model.open,
        "escape": model.escape,
        "dt": model.dt,
    }


__all__ = ["FUNCTION", "read", "write"]
