"""grainmesh: flow through and around many particles; the grains are the mesh.

>>> import grainmesh as gm
>>> box, particles = gm.arrange.random(100, porosity=0.6, diameter=10e-6, seed=1)
>>> K = gm.permeability(box, particles, method="microstructure")
>>> K.tensor.shape
(2, 2)
"""

from grainmesh import arrange, closures, drag
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
from grainmesh.triangulation import Triangulation, triangulate
from grainmesh.walls import Wall

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
    "closures",
    "drag",
    "permeability",
    "relax",
    "resume",
    "triangulate",
]
