"""The picture of theory/kernel.md: a block of discs falls, and nodes go along: python docs/nodes.py

The same block twice, nodes two diameters apart everywhere and, far from discs and walls, up to
eight. Printed: nodes of the fluid at the end, flips, steps that were halved, and how far apart the
middles of the two clouds are.
"""

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import EllipseCollection

import grainmesh as gm

D, HERE = 3e-3, Path(__file__).parent


def block(spacing: float | tuple[float, float]) -> gm.Simulation:
    """300 discs in the upper part of a box of water."""
    box = gm.Box(40 * D, 80 * D)
    x, y = np.meshgrid(D * (10.5 + 1.001 * np.arange(20)), D * (66.5 - 1.001 * np.arange(15)))
    grains = gm.Particles(np.column_stack([x.ravel(), y.ravel()]), D, 1500.0)
    water = gm.Fluid(1000.0, 1e-3, "ergun-2d", spacing=spacing)
    contact = gm.Contact(stiffness=1e4, restitution=0.3, friction=0.3)
    return gm.Simulation(gm.Model(box, contact, fluid=water), grains)


if __name__ == "__main__":
    figure, axes = plt.subplots(1, 4, figsize=(12.0, 6.2), layout="constrained")
    middle = []
    for pair, spacing in zip(axes.reshape(2, 2), (2.0 * D, (2.0 * D, 8.0 * D)), strict=True):
        run = block(spacing)
        for ax, until in zip(pair, (0.2, 0.6), strict=True):
            run.run(until=until)
            assert run.flow is not None
            mesh = run.flow.mesh
            ax.triplot(*mesh.points.T, mesh.triangles, lw=0.4)
            size = np.full(len(run), D)
            discs = EllipseCollection(
                size, size, 0.0 * size, units="xy", offsets=run.x, transOffset=ax.transData
            )
            discs.set(color="0.4")
            ax.add_collection(discs)
            ax.set(aspect="equal", title=f"t = {until:g} s")
            ax.set_axis_off()
        middle.append(run.x.mean(axis=0))
        nodes = int(mesh.in_use[mesh.first :].sum())
        print(f"spacing {spacing} m: {nodes} nodes, {mesh.flips} flips, {run.halved} steps halved")
    print(f"middles {np.hypot(*(middle[1] - middle[0])) / D:.3g} d apart")
    figure.savefig(HERE / "nodes.png", dpi=90)
