"""Filtration
==========

Grains carried by a flow into fibres that are held in place.

.. image:: /_static/gallery/filtration.png
   :alt: Grains that a filter stops, as time goes on

Seen are grains that follow the flow between the fibres, and others stopped by gaps narrower than
themselves. The filter clogs: at a given flow, the pressure drop grows. Fibres and grains are
particles alike, on one mesh with one law of drag; some are fixed.

Run it with::

    python examples/filtration.py --out out/filtration
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/filtration.png"

import argparse
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np

import grainmesh as gm
from grainmesh import plot

D, FIBRE, SPEED = 1e-3, 2.5e-3, 0.01  # diameters [m], superficial velocity [m/s]

# %%
# A layer of fibres that are held (``fixed``), and grains upstream of it: one list of particles, one
# mesh. ``observe`` is called at each mark of the run.


def main(out: Path, quick: bool = False) -> gm.Simulation:
    n, time = (40, 0.4) if quick else (150, 3.0)
    layer, fibres = gm.arrange.random(
        *(12,), porosity=0.6, diameter=FIBRE, min_gap=0.15, seed=4, periodic=False, aspect=0.6
    )
    upstream = gm.Box(1.6 * D * n * D / layer.height + 2.0 * D, layer.height)
    grains = gm.arrange.loose(upstream, n, diameter=(0.8 * D, D), gap=0.25, seed=1)
    x = np.vstack([fibres.x + np.array([upstream.width, 0.0]), grains.x])
    both = gm.Particles(x, np.append(fibres.diameter, grains.diameter))
    box = gm.Box(upstream.width + 2.0 * layer.width, layer.height)
    sides = {
        "left": gm.Inflow((SPEED, 0.0)), "right": gm.Outlet(),
        "bottom": gm.Slip(), "top": gm.Slip(),
    }  # fmt: skip
    fluid = gm.Fluid(1000.0, 0.01, gm.drag.Permeability(), sides, order=1, spacing=1.5 * D)
    model = gm.Model(box, gm.Contact(stiffness=2e5), gravity=(0.0, 0.0), fluid=fluid)
    filtration = gm.Simulation(model, both, fixed=np.arange(len(fibres)))

    film, rows = plot.Film(top=5.0 * SPEED), []

    def observe(now: gm.Simulation) -> None:
        film(now)
        p = now.flow.pressure_at("left") / box.height
        rows.append([now.t, p, (now.x[len(fibres) :, 0] > box.width - layer.width).mean()])

    filtration.run(time, every=time / (5 if quick else 80), observe=observe, progress=not quick)
    out.mkdir(parents=True, exist_ok=True)
    print(film.strip(out / "filtration.png", count=2), film.save(out / "filtration"))
    t, drop, passed = np.array(rows).T
    figure, ax = plt.subplots(layout="constrained")
    ax.plot(t, drop)
    ax.set(xlabel="t [s]", ylabel="pressure drop [Pa]")
    plot.save(figure, out / "pressure.png")
    print(f"pressure drop {drop[0]:.3g} Pa, then {drop[-1]:.3g} Pa; {passed[-1]:.0%} passed")
    assert drop[-1] > drop[0]
    assert (filtration.x[: len(fibres)] == x[: len(fibres)]).all()
    return filtration


# %%
# From the command line:

if __name__ == "__main__":
    matplotlib.use("Agg")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/filtration"))
    main(**vars(parser.parse_args()))
