"""What to cite: BibTeX of grainmesh and of the methods and laws that a run has used.

Names are those of methods of `permeability`, of ``contacts`` and ``flow`` of particles in motion,
and of laws (`closures.LAWS`, `drag.DRAGS`). The entries stand in ``data/grainmesh.bib``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import get_close_matches
from importlib.resources import files

from grainmesh.errors import InputError

_LATTICE = ("sangani1982",)

#: Keys of the entries for each method or law, besides grainmesh itself and the paper.
SOURCES: dict[str, tuple[str, ...]] = {
    "contacts": ("cundall1979", "luding2008"),
    "flow": ("srivastava2014", "schoberl2014", "saad1986"),
    "resolved": ("schoberl1997", "schoberl2014"),
    "mesoscale": ("srivastava2014", "schoberl2014"),
    "microstructure": (),
    "random-discs": _LATTICE,
    "microstructural": ("yazdchi2013",),
    "square-lattice": _LATTICE,
    "hexagonal-lattice": _LATTICE,
    "gebart-square": ("gebart1992",),
    "gebart-hexagonal": ("gebart1992",),
    "drummond-tahir-square": ("drummond1984", "sangani1982"),
    "drummond-tahir-hexagonal": ("drummond1984", "sangani1982"),
    "lee-yang": ("lee1997",),
    "kuwabara": ("kuwabara1959",),
    "happel": ("happel1959",),
    "carman-kozeny": ("carman1937",),
    "ergun-2d": ("ergun1952",),
    "forchheimer": ("yazdchi2013", "yazdchi2012"),
    "lamb": ("lamb1911",),
    "white": ("white",),
    "cylinder": ("kaplun1957", "white"),
    "channel": ("happel1965",),
    "stokes": ("stokes1851",),
    "schiller-naumann": ("schiller1933",),
}


def entries() -> dict[str, str]:
    """Every entry of ``data/grainmesh.bib`` by its key, in the order of the file."""
    text = files("grainmesh").joinpath("data/grainmesh.bib").read_text(encoding="utf-8")
    found = re.finditer(r"^@\w+\{(\w+),.*?^\}$", text, re.MULTILINE | re.DOTALL)
    return {entry[1]: entry[0] for entry in found}


def bibtex(used: Iterable[str] = ()) -> str:
    """BibTeX of grainmesh, of the paper it builds on, and of what was used.

    Parameters
    ----------
    used : iterable of str
        Keys of `SOURCES`.

    Returns
    -------
    str
        Entries in the order of the file, a blank line between them.

    Raises
    ------
    InputError
        If a name is unknown.
    """
    keys = {"grainmesh", "yazdchi2013"}
    for name in used:
        if name not in SOURCES:
            near = get_close_matches(name, SOURCES, 1, 0.0)[0]
            raise InputError(f"nothing to cite is known for '{name}': did you mean {near}?")
        keys.update(SOURCES[name])
    return "\n\n".join(text for key, text in entries().items() if key in keys) + "\n"


__all__ = ["SOURCES", "bibtex", "entries"]
