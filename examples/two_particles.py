"""Drafting
========

Two particles settle one above the other, and the one behind catches up.

.. image:: /_static/gallery/two_particles.png
   :alt: Two discs, one in the wake of the other

Seen are two discs, and how the follower falls faster in the wake of its leader, until they kiss.
The mesh has nodes a diameter and a half apart, so the wake is that of two kernels, not of resolved
surfaces: the tendency is right, the time it takes is not to be relied upon.

Run it with::

    python examples/two_particles.py --out out/two_particles
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/two_particles.png"

import argparse
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np

import grainmesh as gm
from grainmesh import plot

D = 2e-3  # [m]

# %%
# Two discs far apart in a channel, with the law of one cylinder. It takes the velocity far away,
# so what a disc itself adds to the flow is taken out.


def main(out: Path, quick: bool = False) -> gm.Simulation:
    box = gm.Box(8.0 * D, 40.0 * D)
    pair = gm.Particles(np.array([[4.0 * D, 34.0 * D], [4.05 * D, 37.0 * D]]), D, 1200.0)
    sides = {"left": gm.Slip(), "right": gm.Slip()}
    law = gm.drag.Cylinder()
    fluid = gm.Fluid(1000.0, 5e-3, law, sides, dt=0.01, reach=1.5, spacing=1.5 * D)
    fall = gm.Simulation(gm.Model(box, gm.Contact(stiffness=2e3), fluid=fluid), pair)

    film, time, rows = plot.Film(edges=True), 0.3 if quick else 1.2, []

    def observe(fall: gm.Simulation) -> None:
        film(fall)
        rows.append([fall.t, fall.x[1, 1] - fall.x[0, 1], *fall.velocity[:, 1]])

    fall.run(until=time, every=time / (4 if quick else 60), observe=observe, progress=not quick)
    out.mkdir(parents=True, exist_ok=True)
    print(film.strip(out / "two_particles.png"), film.save(out / "two_particles"))
    t, distance, leader, follower = np.array(rows).T
    figure, ax = plt.subplots(layout="constrained")
    ax.plot(t, -leader, label="leader")
    ax.plot(t, -follower, label="follower")
    ax.set(xlabel="t [s]", ylabel="settling speed [m/s]")
    ax.legend(frameon=False)
    plot.save(figure, out / "speeds.png")

    print(f"distance {3.0 * D:.3g} m at first, {distance[-1]:.3g} m at {t[-1]:.2g} s")
    assert distance[-1] < 3.0 * D
    return fall


# %%
# From the command line:

if __name__ == "__main__":
    matplotlib.use("Agg")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/two_particles"))
    main(**vars(parser.parse_args()))
