"""grainmesh: flow through and around many particles; the grains are the mesh.

>>> import grainmesh as gm
>>> box, particles = gm.arrange.random(100, porosity=0.6, diameter=10e-6, seed=1)
>>> K = gm.permeability(box, particles, method="microstructure")
>>> K.tensor.shape
(2, 2)

Discs in a box
    `Box`, `Particles`; `arrange` makes them or reads a list, `fibres` finds them in an image,
    `triangulate` joins them, `relax` pushes overlaps apart.
Permeability
    `permeability` by three methods, with the laws in `closures`; `sweep` makes a table of many.
Particles in motion
    `Contact`, `Wall` and `Model` say what acts; `Simulation` runs, `resume` goes on.
With a fluid
    `Fluid` with the laws in `drag`; sides of the box: `Inflow`, `Outlet`, `NoSlip`, `Slip`.
Files and pictures
    `case` reads case files, `record` keeps a run in a folder, `history` makes tables of it, `page`
    a report, `cite` what to cite; `plot` draws.
Mistakes
    `InputError` says in one line what is wrong and what to do, `RunError` why a run stopped.

All values are SI; a disc has unit depth. Parts are loaded when they are first used.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

__version__ = "0.1.0"

__all__ = [
    "Box",
    "Contact",
    "Contacts",
    "Fluid",
    "Inflow",
    "InputError",
    "Model",
    "NoSlip",
    "Outlet",
    "Particles",
    "Permeability",
    "RunError",
    "Simulation",
    "Slip",
    "Triangulation",
    "Wall",
    "arrange",
    "case",
    "cite",
    "closures",
    "drag",
    "fibres",
    "history",
    "page",
    "permeability",
    "plot",
    "record",
    "relax",
    "resume",
    "sweep",
    "triangulate",
]

if TYPE_CHECKING:
    from grainmesh import (
        arrange,
        case,
        cite,
        closures,
        drag,
        fibres,
        history,
        page,
        plot,
        record,
    )
    from grainmesh.contact import Contact
    from grainmesh.domain import Box
    from grainmesh.errors import InputError, RunError
    from grainmesh.measure import Contacts
    from grainmesh.medium import Fluid, Inflow, NoSlip, Outlet, Slip
    from grainmesh.model import Model
    from grainmesh.particles import Particles
    from grainmesh.permeability import Permeability, permeability
    from grainmesh.relax import relax
    from grainmesh.simulation import Simulation, resume
    from grainmesh.study import sweep
    from grainmesh.triangulation import Triangulation, triangulate
    from grainmesh.walls import Wall

#: The module that each name comes from; the other names are modules themselves.
_HOME = {
    "Box": "domain",
    "Contact": "contact",
    "Contacts": "measure",
    "Fluid": "medium",
    "Inflow": "medium",
    "InputError": "errors",
    "Model": "model",
    "NoSlip": "medium",
    "Outlet": "medium",
    "Particles": "particles",
    "Permeability": "permeability",
    "RunError": "errors",
    "Simulation": "simulation",
    "Slip": "medium",
    "Triangulation": "triangulation",
    "Wall": "walls",
    "permeability": "permeability",
    "relax": "relax",
    "resume": "simulation",
    "sweep": "study",
    "triangulate": "triangulation",
}


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module 'grainmesh' has no attribute {name!r}")
    module = import_module(f"grainmesh.{_HOME.get(name, name)}")
    value = getattr(module, name) if name in _HOME else module
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Face(ModuleType):
    """Keeps `permeability` and `relax` the functions when the modules of these names are loaded."""

    def __setattr__(self, name: str, value: object) -> None:
        if isinstance(value, ModuleType) and name in _HOME:
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Face
