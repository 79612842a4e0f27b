"""Results as files, written whole or not at all.

Everything is first written into a folder of its own beside the target, then renamed into place.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any

from grainmesh.errors import InputError
from grainmesh.permeability import Permeability

Writer = Callable[[Path], None]
#: What all results of one box have in common.
SHARED = ("porosity", "n", "diameter", "gap")


def as_dict(results: Sequence[Permeability]) -> dict[str, Any]:
    """Results of one box as plain numbers, ready for JSON; what is not finite becomes None.

    Parameters
    ----------
    results : sequence of Permeability
        At least one.
    """

    tables = [result.to_dict() for result in results]
    own = [{key: table[key] for key in table if key not in SHARED} for table in tables]
    return {key: tables[0][key] for key in SHARED} | {"results": own}


def rows(results: Sequence[Permeability]) -> list[dict[str, Any]]:
    """The same as one flat row a method, for a CSV file; K in m2."""
    table = as_dict(results)
    shared = {key: table[key] for key in SHARED}
    flat = []
    for result in table["results"]:
        (xx, xy), (yx, yy) = result.pop("tensor")
        notes = "; ".join(result.pop("notes"))
        method = result.pop("method")
        flat.append(
            {"method": method, **shared, "Kxx": xx, "Kxy": xy, "Kyx": yx, "Kyy": yy}
            | result
            | {"notes": notes}
        )
    return flat


def write_csv(path: Path, table: Sequence[Mapping[str, Any]], comments: Sequence[str] = ()) -> None:
    """Rows with the same keys as a CSV file, after ``#`` comment lines.

    Parameters
    ----------
    path : Path
    table : sequence of mappings
        At least one row; its keys are the header. None becomes an empty field.
    comments : sequence of str
        One line each.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        file.writelines(f"# {line}\n" for line in comments)
        writer = csv.DictWriter(file, fieldnames=list(table[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {k: f"{v:.10g}" if isinstance(v, float) else v for k, v in row.items()} for row in table
        )


def prove_writable(folder: Path, names: Sequence[str]) -> None:
    """Make sure that files `names` can be written to `folder`, before a long computation.

    Nothing is left behind; the folder itself need not exist.

    Raises
    ------
    InputError
        Naming the folder and the reason.
    """
    try:
        Path(mkdtemp(prefix=".grainmesh-", dir=_existing(folder))).rmdir()
    except OSError as error:
        raise InputError(
            f"{folder}: cannot write there ({error.strerror}); choose another folder"
        ) from None
    for name in names:
        if (folder / name).is_dir():
            raise InputError(f"{folder / name}: is a folder; choose another place or remove it")


def write(folder: Path, writers: Mapping[str, Writer]) -> None:
    """Write files into `folder`, all of them or none.

    Parameters
    ----------
    folder : Path
        Made if it does not exist.
    writers : mapping of file name to callable
        Each is called with the path to write to.
    """
    stage = Path(mkdtemp(prefix=".grainmesh-", dir=_existing(folder)))
    try:
        for name, writer in writers.items():
            writer(stage / name)
        folder.mkdir(parents=True, exist_ok=True)
        for name in writers:
            (stage / name).replace(folder / name)
    finally:
        rmtree(stage, ignore_errors=True)


def _existing(folder: Path) -> Path:
    """The folder itself or the nearest one above it that exists."""
    folder = folder.absolute()
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder


__all__ = ["as_dict", "prove_writable", "rows", "write", "write_csv"]
