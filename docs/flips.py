"""The picture of coupled.md: what discs feel as edges of their mesh flip: ``python docs/flips.py``.

Discs of unequal size and density stir a periodic box, first apart, then colliding. Of the four
discs of the first edge that flips while no discs touch: force of the fluid and velocity against
their means over all discs, porosity at the centre; steps at whose end one of their edges flips are
grey. The same for the four discs of a later flip, while others collide.
"""

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

import grainmesh as gm
from grainmesh.drag import Permeability
from grainmesh.medium import Fluid

D, HERE = 1e-3, Path(__file__).parent
STEPS = 100


def stirred(porosity: float, speed: float, seed: int) -> gm.Simulation:
    """40 discs in a periodic box, at random speeds."""
    rng = np.random.default_rng(seed)
    box, discs = gm.arrange.random(40, porosity=porosity, diameter=D, min_gap=0.02, seed=seed)
    size, density = D * rng.uniform(0.8, 1.0, 40), rng.uniform(500.0, 4000.0, 40)
    water = Fluid(density=1000.0, viscosity=1e-3, drag=Permeability(), dt=2.5e-4)
    law = gm.Contact(2e4, restitution=0.6, friction=0.3)
    model = gm.Model(box, law, gravity=(0.0, -1.0), fluid=water)
    velocity = rng.normal(0.0, speed, (40, 2))
    return gm.Simulation(model, gm.Particles(discs.x, size, density), velocity=velocity)


def follow(run: gm.Simulation) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times, rows of (porosity, velocity, force) of all discs, whether they flip, contacts."""
    flow, t, rows, flips, touch = run.flow, [], [], [], []
    assert flow is not None
    for _ in range(STEPS + 8):
        before = edges(flow.mesh.triangles)
        run.run(until=run.t + 2.5e-4)
        new = np.isin(edges(flow.mesh.triangles), before, invert=True)
        flipped = np.zeros(len(run), bool)
        flipped[flow.mesh.triangles[new.any(axis=1)]] = True
        t.append(run.t)
        rows.append(
            [flow.kernel.porosity[:40], np.hypot(*flow.velocity.T), np.hypot(*flow.force.T)]
        )
        flips.append(flipped)
        touch.append(len(run.contacts))
    return np.array(t)[8:], np.array(rows)[8:], np.array(flips)[8:], np.array(touch)[8:]


def edges(triangles: np.ndarray) -> np.ndarray:
    """A number for each edge (t, 3)."""
    ends = np.sort(np.stack([triangles, np.roll(triangles, 1, axis=1)], axis=-1), axis=-1)
    return ends[..., 0] * 10_000 + ends[..., 1]


if __name__ == "__main__":
    figure, axes = plt.subplots(3, 2, figsize=(8.0, 6.0), sharex="col", layout="constrained")
    for column, (run, title) in enumerate(
        ((stirred(0.75, 0.0, 5), "no contacts"), (stirred(0.55, 0.03, 2), "contacts"))
    ):
        t, rows, flips, touch = follow(run)
        some = np.flatnonzero(flips[np.flatnonzero(flips.any(axis=1))[0]])[:4]
        print(title, f"{touch.mean():.1f} contacts, {flips.any(axis=1).sum()} steps with flips")
        for k, name in enumerate(("porosity", "speed", "force")):
            ax, value = axes[k, column], rows[:, k]
            value = value / (1.0 if k == 0 else value.mean())
            off = np.abs(value[1:-1] - 0.5 * (value[2:] + value[:-2]))
            print(f"  {name}: off the mean of the steps beside, at most {off.max():.2g}")
            ax.plot(1e3 * t, value[:, some], lw=1.0)
            for when in t[flips[:, some].any(axis=1)]:
                ax.axvline(1e3 * when, color="0.85", zorder=0)
            if column == 0:
                ax.set_ylabel(name if k == 0 else f"{name} / mean")
        axes[0, column].set_title(title)
        axes[2, column].set_xlabel("t [ms]")
    figure.savefig(HERE / "flips.png", dpi=110)
