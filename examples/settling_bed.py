"""A settling bed
==============

Grains fall into a box, collide and come to rest.

.. image:: /_static/gallery/settling_bed.png
   :alt: A bed with the forces between its grains, and its energies over time

Draws the bed with the forces between its grains and its energies over time, and writes the energies
as numbers. Run it with::

    python examples/settling_bed.py --out out/bed
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/settling_bed.png"

import argparse
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np

import grainmesh as gm
from grainmesh import plot

# %%
# ``ledger=True`` books where energy goes; ``save`` leaves a folder from which the run can go on.


def main(out: Path, n: int = 2000) -> gm.Simulation:
    box = gm.Box(0.06, 0.06)
    grains = gm.arrange.loose(box, n, diameter=(0.8e-3, 1.2e-3), density=2500.0, seed=1)
    contact = gm.Contact(stiffness=5e5, restitution=0.6, friction=0.5)
    bed = gm.Simulation(gm.Model(box, contact), grains, ledger=True)
    bed.run(until=0.25, every=0.005, save=out, progress=True)

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 5.5), width_ratios=(1.0, 1.3))
    plot.chains(bed, plot.discs(box, bed.particles, left))
    left.set_title(f"{n} grains at rest, {2 * len(bed.contacts) / n:.1f} contacts each")
    t = [row["t"] for row in bed.history]
    for name in ("potential", "kinetic", "elastic", "damped", "slid"):
        right.semilogy(t, [max(row[name], 1e-12) for row in bed.history], label=name)
    right.semilogy(t, [row["total"] for row in bed.history], "k--", label="total")
    right.set(xlabel="t [s]", ylabel="energy [J/m]", title="where the energy goes")
    right.legend()
    out.mkdir(parents=True, exist_ok=True)
    plot.save(figure, out / "bed.png")
    plt.close(figure)
    keys = list(bed.history[0])
    rows = np.array([[row[k] for k in keys] for row in bed.history])
    np.savetxt(out / "bed.csv", rows, delimiter=",", header=",".join(keys), comments="")
    return bed


# %%
# From the command line:

if __name__ == "__main__":
    matplotlib.use("Agg")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/bed"))
    parser.add_argument("--n", type=int, default=2000, help="number of grains")
    main(**vars(parser.parse_args()))
