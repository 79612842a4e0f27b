"""Discs and flow at one time, of a simulation or read from the frames of a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from grainmesh.fields import Sample
from grainmesh.particles import Particles
from grainmesh.simulation import Simulation

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Frame:
    """Discs and flow at one time.

    Parameters
    ----------
    t : float
        [s]
    particles : Particles
    velocity : (n, 2)
        Of the particles [m/s].
    flow : Sample or None
        The fluid, if there is one.
    """

    t: float
    particles: Particles
    velocity: Float
    flow: Sample | None


def frame_of(simulation: Simulation, cuts: int = 2) -> Frame:
    """The present state of a simulation; each edge of the flow is cut into `cuts` pieces."""
    flow = simulation.flow
    return Frame(
        simulation.t,
        simulation.particles,
        simulation.velocity,
        None if flow is None else flow.sample(cuts),
    )


__all__ = ["Frame", "frame_of"]
