"""A fluidised bed
===============

Syrup flows up through grains, faster and faster.

.. image:: /_static/gallery/fluidised_bed.png
   :alt: A bed of grains that grows as the flow does

Seen is the bed at rest until the flow carries its weight, then grains that part and a bed that
grows. The pressure drop rises with the flow (at first the bed, which has settled dry, takes up
fluid), then stays at the weight of the grains less their buoyancy, over the width of the bed.
Where the freeboard is, the mesh has nodes of its own. The law of drag is one whose range reaches
down to packed discs.

Run it with::

    python examples/fluidised_bed.py --out out/fluidised_bed
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/fluidised_bed.png"

import argparse
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np

import grainmesh as gm
from grainmesh import plot
from grainmesh.closures import LAWS

D, RAMP = 1e-3, 3e-3  # diameter [m], growth of the superficial velocity [m/s2]

# %%
# The grains fall without fluid first. Then the settled bed meets a flow that grows with time, given
# as a function of place and time at the bottom of the box.


def main(out: Path, quick: bool = False) -> gm.Simulation:
    n, time = (60, 1.5) if quick else (150, 2.0)
    box = gm.Box(10.0 * D, 32.0 * D)
    contact = gm.Contact(stiffness=5e4, restitution=0.3)
    grains = gm.arrange.loose(box, n, diameter=(0.9 * D, 1.1 * D), seed=1)
    dry = gm.Simulation(gm.Model(box, contact), grains).run(until=0.5)
    sides = {
        "bottom": gm.Inflow(lambda x, t: np.tile([0.0, RAMP * t], (len(x), 1))),
        "top": gm.Outlet(), "left": gm.Slip(), "right": gm.Slip(),
    }  # fmt: skip
    law = gm.drag.Permeability(LAWS["hexagonal-lattice"])
    fluid = gm.Fluid(1000.0, 0.01, law, sides, dt=0.02, order=1, spacing=2.0 * D)
    # Smooth sides, or they would hold the bed back as it rises.
    walls = [gm.Wall.of(box, side, friction=0.0) for side in ("left", "right")]
    bed = gm.Simulation(gm.Model(box, contact, walls=walls, fluid=fluid), dry.particles)

    film, rows = plot.Film(), []

    def observe(bed: gm.Simulation) -> None:
        film(bed)
        p = bed.flow.pressure_at("bottom") / box.width
        rows.append([RAMP * bed.t, p, bed.x[:, 1].mean()])

    bed.run(until=time, every=time / (10 if quick else 80), observe=observe, progress=not quick)
    out.mkdir(parents=True, exist_ok=True)
    print(film.strip(out / "fluidised_bed.png"), film.save(out / "fluidised_bed"))
    U, drop, height = np.array(rows).T
    weight = 1500.0 * 9.81 * np.pi / 4.0 * (grains.diameter**2).sum() / box.width
    figure, ax = plt.subplots(layout="constrained")
    ax.plot(U, drop / weight, label="pressure drop / weight of the bed")
    ax.plot(U, height / height[0], label="height of the bed / at first")
    ax.set(xlabel="U [m/s]")
    ax.legend(frameon=False)
    plot.save(figure, out / "pressure.png")
    print(out / "pressure.png")
    carried = drop[0.75 * U[-1] < U].mean() / weight
    print(
        f"pressure drop over weight {carried:.3f}, height over first {height[-1] / height[0]:.2f}"
    )
    assert abs(carried - 1.0) < 0.05
    return bed


# %%
# From the command line:

if __name__ == "__main__":
    matplotlib.use("Agg")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/fluidised_bed"))
    main(**vars(parser.parse_args()))
