"""Sedimentation
=============

Grains settle through a syrup and become a bed.

.. image:: /_static/gallery/sedimentation.png
   :alt: Grains that settle, and the bed below

Seen are fluid that rises between the sinking grains, faster where grains are few, and the bed that
grows below. In a closed box what sinks is made up for by what rises: the volume flux of fluid and
grains together must vanish, to the tolerance of the solver. With many grains::

    python examples/sedimentation.py --out out/sedimentation --n 10000
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/sedimentation.png"

import argparse
from pathlib import Path

import matplotlib
import numpy as np

import grainmesh as gm
from grainmesh import plot

D = 1e-3  # [m]

# %%
# Grains in loose rows under the lid of a closed box.


def main(out: Path, n: int = 400, quick: bool = False) -> gm.Simulation:
    columns = np.ceil(np.sqrt(n / 2.0))
    box = gm.Box(1.3 * D * columns, 3.2 * D * columns)
    grains = gm.arrange.loose(box, n, diameter=(0.8 * D, D), gap=0.25, seed=1)
    up = box.height - D - grains.x[:, 1].max()
    grains = gm.Particles(grains.x + np.array([0.0, up]), grains.diameter, grains.density)
    fluid = gm.Fluid(1000.0, 0.05, gm.drag.Permeability(), dt=0.02, order=1, spacing=2.0 * D)
    model = gm.Model(box, gm.Contact(stiffness=5e3, restitution=0.6), fluid=fluid)
    fall = gm.Simulation(model, grains)

    film, time = plot.Film(top=0.02), 0.1 if quick else 5.0
    fall.run(until=time, every=time / (2 if quick else 100), observe=film, progress=not quick)
    out.mkdir(parents=True, exist_ok=True)
    print(film.strip(out / "sedimentation.png"), film.save(out / "sedimentation"))

    sunk = (grains.x - fall.x)[:, 1].mean()
    down = 0.25 * np.pi * grains.diameter**2 @ fall.velocity[:, 1]
    rising = fall.flow.mean()[1] * box.area
    print(f"grains sank by {1e3 * sunk:.2f} mm; volume per time sinking and rising:")
    print(f"{-down:.4e} m3/s and {rising:.4e} m3/s, per metre of depth")
    assert sunk > 0.0
    assert abs(down + rising) < 1e-3 * abs(down)
    return fall


# %%
# From the command line:

if __name__ == "__main__":
    matplotlib.use("Agg")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/sedimentation"))
    parser.add_argument("--n", type=int, default=400, help="number of grains")
    main(**vars(parser.parse_args()))
