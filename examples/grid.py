"""A bed held by a grid
====================

A bed of grains that flow presses against a grid, until the flow is too weak to hold it.

.. image:: /_static/gallery/grid.png
   :alt: A bed pressed against the grid above it

Seen is a bed below a grid that lets the fluid pass, and the rain of grains as the flow dies down.
To the particles the grid is a wall, to the fluid it is not there. While the bed rests, forces on
the grid are those of the flow less the weight of the grains: two ways to the same number, one
from the contacts, one from the pressure drop. Both vanish where the flow just carries the bed.

Run it with::

    python examples/grid.py --out out/grid
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/grid.png"

import argparse
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np

import grainmesh as gm
from grainmesh import plot
from grainmesh.closures import LAWS

D, FLOW = 1e-3, 3e-3  # diameter [m], superficial velocity at first [m/s]

# %%
# Gravity the other way round presses the bed against the grid, without fluid; then the flow does.


def main(out: Path, quick: bool = False) -> gm.Simulation:
    n, time = (40, 0.4) if quick else (120, 2.0)
    box, height = gm.Box(10.0 * D, 25.0 * D), 19.0 * D
    # Smooth sides, or they would hold the bed too.
    grid = gm.Wall((0.0, height), (box.width, height))
    walls = (grid, *(gm.Wall.of(box, side, friction=0.0) for side in ("left", "right")))
    contact = gm.Contact(stiffness=2e5, restitution=0.3)
    grains = gm.arrange.loose(box, n, diameter=(0.9 * D, 1.1 * D), seed=1)
    up = height - D - grains.x[:, 1].max()
    grains = gm.Particles(grains.x + np.array([0.0, up]), grains.diameter, grains.density)
    against = gm.Model(box, contact, gravity=(0.0, 9.81), walls=walls)
    packed = gm.Simulation(against, grains).run(until=0.5).particles
    sides = {
        "bottom": gm.Inflow(lambda x, t: np.tile([0.0, FLOW * (1.0 - t / time)], (len(x), 1))),
        "top": gm.Outlet(), "left": gm.Slip(), "right": gm.Slip(),
    }  # fmt: skip
    law = gm.drag.Permeability(LAWS["hexagonal-lattice"])
    fluid = gm.Fluid(1000.0, 0.01, law, sides, dt=2e-3, order=1, spacing=2.0 * D)
    bed = gm.Simulation(gm.Model(box, contact, walls=walls, fluid=fluid), packed)
    weight = 1500.0 * 9.81 * np.pi / 4.0 * (grains.diameter**2).sum()

    film, rows = plot.Film(top=5.0 * FLOW), []

    def observe(bed: gm.Simulation) -> None:
        film(bed)
        p, touch = bed.flow.pressure_at("bottom"), bed.wall_contacts
        on_grid = touch.force @ touch.normal[:, 1]
        rows.append([FLOW * (1.0 - bed.t / time), on_grid / weight, p / weight - 1.0])

    bed.run(until=time, every=time / (8 if quick else 80), observe=observe, progress=not quick)
    out.mkdir(parents=True, exist_ok=True)
    print(film.strip(out / "grid.png"), film.save(out / "grid"))
    U, contacts, pressure = np.array(rows).T
    figure, ax = plt.subplots(layout="constrained")
    ax.plot(U, contacts, label="force on the grid / weight of the bed")
    ax.plot(U, pressure, "--", label="pressure drop / weight of the bed - 1")
    ax.set(xlabel="U [m/s]")
    ax.legend(frameon=False)
    plot.save(figure, out / "forces.png")
    held = pressure > 1.0  # below, the bed is about to come off the grid
    print(f"largest difference while the bed is held: {abs(contacts - pressure)[held].max():.3f}")
    assert held.any()
    assert abs(contacts - pressure)[held].max() < 0.05
    return bed


# %%
# From the command line:

if __name__ == "__main__":
    matplotlib.use("Agg")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/grid"))
    main(**vars(parser.parse_args()))
