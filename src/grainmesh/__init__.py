"""grainmesh: flow through and around many particles; the grains are the mesh.

>>> import grainmesh as gm
>>> box, particles = gm.arrange.random(100, porosity=0.6, diameter=10e-6, seed=1)
>>> K = gm.permeability(box, particles, method="microstructure")
>>> K.tensor.shape
(2, 2)
"""

from grainmesh import arrange, closures
from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.particles import Particles
from grainmesh.permeability import Permeability, permeability
from grainmesh.triangulation import Triangulation, triangulate

__version__ = "0.1.0"

__all__ = [
    "Box",
    "InputError",
    "Particles",
    "Permeability",
    "Triangulation",
    "arrange",
    "closures",
    "permeability",
    "triangulate",
]
