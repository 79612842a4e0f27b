"""Rayleigh-Taylor overturn
========================

A suspension above the clear fluid that it is heavier than.

.. image:: /_static/gallery/rayleigh_taylor.png
   :alt: Plumes of grains that sink

Seen are plumes of grains that sink together, many times faster than a grain would between its
neighbours, and clear fluid that rises between them. The pressure solves for both at once, so that
the fingers need no seed but the disorder of the grains.

Run it with::

    python examples/rayleigh_taylor.py --out out/rayleigh_taylor
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/rayleigh_taylor.png"

import argparse
from pathlib import Path

import matplotlib
import numpy as np

import grainmesh as gm
from grainmesh import plot

D = 1e-3  # [m]

# %%
# Grains at random in the upper part of a closed box, without slip at its sides.


def main(out: Path, quick: bool = False) -> gm.Simulation:
    n, porosity, mu = 60 if quick else 300, 0.75, 0.05
    top, grains = gm.arrange.random(
        n, porosity=porosity, diameter=D, min_gap=0.1, seed=1, periodic=False, aspect=1.5
    )
    box = gm.Box(top.width, 2.5 * top.height)
    grains = gm.Particles(grains.x + np.array([0.0, box.height - top.height]), D, 2500.0)
    fluid = gm.Fluid(1000.0, mu, gm.drag.Permeability(), dt=0.01, order=1, spacing=1.5 * D)
    model = gm.Model(box, gm.Contact(stiffness=5e3, restitution=0.6), fluid=fluid)
    turn = gm.Simulation(model, grains)

    film, time = plot.Film(top=0.1), 0.3 if quick else 0.8
    turn.run(until=time, every=time / (3 if quick else 60), observe=film, progress=not quick)
    out.mkdir(parents=True, exist_ok=True)
    print(film.strip(out / "rayleigh_taylor.png"), film.save(out / "rayleigh_taylor"))

    K = gm.drag.RandomDiscs()(porosity, np.nan) * D**2
    alone = K * (1.0 - porosity) * 1500.0 * 9.81 / mu  # of a uniform suspension
    fastest = -turn.velocity[:, 1].min()
    print(f"fastest grain {fastest:.3g} m/s, a uniform suspension sinks at {alone:.3g} m/s")
    assert fastest > alone
    return turn


# %%
# From the command line:

if __name__ == "__main__":
    matplotlib.use("Agg")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/rayleigh_taylor"))
    main(**vars(parser.parse_args()))
