"""grainmesh: flow through and around many particles; the grains are the mesh."""
