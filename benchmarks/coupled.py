"""What a coupled step of fluid and particles costs: python benchmarks/coupled.py [--quick].

sedimentation
    n discs of 1 mm, 2500 kg/m3, fall in water in a closed box of 24 x 48 mm for 400, larger in
    proportion for more. Steps of the flow of at most 1 ms. Medians over the steps of a run, wall
    time: of a step, of its parts, of contacts and their upkeep; iterations of the linear solver;
    factors made and steps tried again, per 100; flips of the mesh of the flow per step.
block
    The falling block that can be repeated with MigFlow 1.4: d 3 mm, 1500 kg/m3 in water, nx by ny
    discs with nx/ny about 8/3 on a square lattice of pitch 1.001 d that hangs from the lid of a box
    four blocks high, all sides free slip, steps of at most 5 ms. Wall time per physical second,
    nodes of the flow per grain. The drag law has inertia, as MigFlow's, but is one of discs.
    Stiffness: the settled block would overlap by 1.3 % of the diameter at its foot; steps of the
    contacts are a twentieth of their time or less, 5 ms a power of two of them.

Compilation is not counted. Where other work shares the cores, compare CPU times, which are given
beside; a process of its own for each row, so that memory is that of the row alone.
"""

from __future__ import annotations

import argparse
import os
import resource
import warnings
from multiprocessing import get_context
from time import perf_counter, process_time

import numpy as np

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")

import grainmesh as gm
from grainmesh.closures import ClosureWarning
from grainmesh.drag import Permeability
from grainmesh.medium import Fluid, Slip

SPAN = 1e-3  # longest step of the flow while discs settle [s]
PARTS = ("mesh", "kernel", "matrix", "solve", "rest", "steps", "upkeep")


def sedimentation(n: int, order: int) -> gm.Simulation:
    size = (n / 400.0) ** 0.5
    box = gm.Box(0.024 * size, 0.048 * size)
    grains = gm.arrange.loose(box, n, diameter=1e-3, density=2500.0, seed=1)
    fluid = Fluid(1000.0, 1e-3, Permeability(), order=order, dt=SPAN, spacing=3e-3)
    contact = gm.Contact(stiffness=1.5e4 * size, restitution=0.6, friction=0.3)
    return gm.Simulation(gm.Model(box, contact, fluid=fluid), grains)


def block(n: int, order: int) -> gm.Simulation:
    d, excess = 3e-3, 500.0
    ny = max(1, round((n * 3 / 8) ** 0.5))
    nx = -(-n // ny)
    pitch = 1.001 * d
    box = gm.Box(nx * pitch, 4 * ny * pitch)
    x, y = np.meshgrid((np.arange(nx) + 0.5) * pitch, box.height - (np.arange(ny) + 0.5) * pitch)
    grains = gm.Particles(np.column_stack([x.ravel(), y.ravel()]), d, 1500.0)
    sides = dict.fromkeys(("left", "right", "bottom", "top"), Slip())
    fluid = Fluid(
        1000.0, 1e-3, "ergun-2d", sides, order=order, dt=5e-3, spacing=(6.6 * d, 30.0 * d)
    )
    stiffness = excess * 9.81 * ny * np.pi / 4.0 * d / 0.013
    contact = gm.Contact(stiffness=stiffness, restitution=0.3, friction=0.3)
    lasts = contact.contact_time(1500.0 * np.pi * d**2 / 8.0)
    dt = 5e-3 / 2.0 ** np.ceil(np.log2(5e-3 / (lasts / 20.0)))
    return gm.Simulation(gm.Model(box, contact, fluid=fluid, dt=dt), grains)


def follow(simulation: gm.Simulation, until: float, longest: float) -> dict[str, np.ndarray]:
    """Numbers of each step of the flow up to a time [s], or until so many seconds have passed."""
    flow, rows = simulation.flow, []
    assert flow is not None
    once, began = simulation._flow_step, perf_counter()

    def spent() -> dict[str, float]:
        return flow.seconds | simulation.seconds

    def timed(most: int) -> None:
        before, flips, factors = spent(), flow.mesh.flips, flow.factors
        wall, cpu, t = perf_counter(), process_time(), simulation.t
        once(most)
        row = {key: value - before[key] for key, value in spent().items()}
        row |= {"wall": perf_counter() - wall, "cpu": process_time() - cpu}
        row |= {"dt": simulation.t - t, "iterations": flow.iterations}
        row |= {"flips": flow.mesh.flips - flips, "factors": flow.factors - factors}
        rows.append(row)

    simulation._flow_step = timed  # type: ignore[method-assign]
    while simulation.t < until - 1e-9 and perf_counter() - began < longest:
        simulation.run(until=simulation.t + flow.fluid.dt)
    return {key: np.array([row[key] for row in rows]) for key in rows[0]}


def row(case: str, n: int, order: int, until: float, longest: float) -> None:
    warnings.simplefilter("ignore", ClosureWarning)
    make = {"sedimentation": sedimentation, "block": block}[case]
    make(60, order).run(until=1e-2)  # compiles
    began = perf_counter()
    simulation = make(n, order)
    made = perf_counter() - began
    found = follow(simulation, until, longest)
    flow, steps = simulation.flow, len(found["wall"])
    assert flow is not None
    ms = {key: 1e3 * np.median(values) for key, values in found.items()}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10  # kB on Linux
    nodes = flow.operator.topology.used.sum() / len(simulation)
    print(
        f"{case:>13} {len(simulation):6d} {'MINI' if order == 1 else f'P{order}/P{order - 1}':>5} "
        f"{flow.operator.free.sum():7d} {nodes:5.2f} {simulation.t:7.3f} "
        f"{ms['dt']:6.3f} {ms['wall']:7.1f} {ms['cpu']:7.1f} "
        + " ".join(f"{ms[key]:6.1f}" for key in PARTS)
        + f" {np.median(found['iterations']):4.0f} {100 * found['factors'].sum() / steps:5.1f} "
        f"{100 * simulation.halved / steps:4.1f} {found['flips'].mean():5.1f} "
        f"{found['wall'].sum() / simulation.t:7.1f} {found['cpu'].sum() / simulation.t:7.1f} "
        f"{peak:5.0f} {made:5.1f}",
        flush=True,
    )


def main(quick: bool) -> None:
    print(
        "         case grains            dofs nodes       t     dt   (ms a step, medians)"
        + " " * 49
        + "per 100 steps       s per phys. s    MB  made"
    )
    print(
        f"{'':43} {'[s]':>5} {'[ms]':>6} {'wall':>7} {'cpu':>7} "
        + " ".join(f"{key:>6}" for key in PARTS)
        + f" {'iter':>4} {'fact.':>5} {'half':>4} {'flips':>5} {'wall':>7} {'cpu':>7} {'':>5} [s]"
    )
    jobs = [("sedimentation", n, k, 0.1, 60.0) for n in (400, 2000, 10_000) for k in (1, 2)]
    jobs += [("block", n, k, 0.5, 120.0) for n in (2000, 20_000) for k in (1, 2)]
    if quick:
        jobs = [("sedimentation", 400, 2, 0.05, 20.0), ("block", 400, 1, 0.1, 20.0)]
    for job in jobs:
        process = get_context("spawn").Process(target=row, args=job)
        process.start()
        process.join()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="400 discs, less than a minute")
    main(parser.parse_args().quick)
