"""Time and error of the permeability of random discs, with other open codes where installed.

    python benchmarks/permeability.py [--quick]

1. One array, 100 equal discs, porosity 0.6, periodic, by every method on one thread. The error is
   that of K/d2 = tr K/2/d2 against the resolved flow to 1e-5. "estimate" is what a method says of
   itself: of a law, the scatter of its medium, in which one sample may lie anywhere.
2. Limits that must hold, on one thread and on two, with peak memory: resolved flow around 100 discs
   to 1e-3 and 800 to 1e-2; 100 000 discs by the mesoscale model (P2/P1) and the microstructure.

Processes are fresh, so that threads and memory are known. Ours and the network of gaps are timed
after a call that compiles, and medians of three are given; the slowest are timed once. Where other
work shares the cores, compare CPU times of one thread: threads that wait for each other burn CPU
time too. ``--quick`` leaves out the other codes, the second thread, and 800 and 100 000 discs.

The other codes are no dependencies; ``pip install lbmpy openpnm porespy`` adds their rows:

lbmpy
    Lattice Boltzmann D2Q9, two relaxation times with magic parameter 3/16, walls half-way between
    nodes (bounce back), body force, periodic. Along x, then along y, each from rest until K changes
    by less than 1e-4 in 200 steps. Generating and compiling the kernels (seconds) is not counted.
    A staircase of pixels holds the fluid a little more than the circle does: K comes out too small
    by some share of a pixel.
OpenPNM, gaps of the discs
    OpenPNM makes no network from centres. Ours, of the triangulation: a pore in each triangle, a
    throat through each edge, with the conductance of plane lubrication between the two arcs,
    g⁻¹ = 12 mu ∫dx/h³. Pores have no resistance. Periodic: the mean gradient enters as a source.
OpenPNM, PoreSpy's network
    The usual way: `snow2` extracts pores and throats from an image, the size factors are OpenPNM's
    for two dimensions (trapezoids and rectangles). Not periodic: pressure drop across the cell,
    the sides closed.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from importlib.util import find_spec
from multiprocessing import get_context
from resource import RUSAGE_SELF, getrusage
from statistics import median
from time import perf_counter, process_time
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

import grainmesh as gm

#: Points of the quadrature along a throat, where the gap varies.
POINTS = 64
#: Lattice Boltzmann: relaxation time and force, in lattice units; steps between two looks at K.
TAU, FORCE, STEPS, STEADY = 1.0, 1e-6, 200, 1e-4


class Row(NamedTuple):
    """One measurement; times are medians [s], memory is the peak of its process so far [GB]."""

    name: str
    value: float
    estimate: float
    dofs: int
    seconds: float
    cpu: float
    memory: float


def discs(n: int) -> tuple[gm.Box, gm.Particles]:
    return gm.arrange.random(n, porosity=0.6, diameter=1.0, min_gap=0.05, seed=1)


def timed(name: str, call: Callable[[], Any], repeats: int) -> Row:
    """Call `repeats` times; it returns a `Permeability` or K/d2."""
    wall, cpu = [], []
    for _ in range(repeats):
        start = perf_counter(), process_time()
        result = call()
        wall.append(perf_counter() - start[0])
        cpu.append(process_time() - start[1])
    memory = getrusage(RUSAGE_SELF).ru_maxrss / 1e6  # Linux counts in kB
    ours = isinstance(result, gm.Permeability)
    value = result.normalised if ours else result
    estimate, dofs = (result.error, result.dofs) if ours else (np.nan, 0)
    return Row(name, value, estimate, dofs, median(wall), median(cpu), memory)


def alone(threads: int, job: Callable[..., list[Row]], *args: Any) -> list[Row]:
    """Run `job` in a fresh process with so many threads."""
    # Threads of BLAS under those of NGSolve would only compete with them.
    blas = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    os.environ.update(dict.fromkeys(blas, "1"), NGS_NUM_THREADS=str(threads))
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(job, *args).result()


# --- what is measured ---------------------------------------------------------------------------


def methods(n: int, repeats: int, tols: list[float], reference: float) -> list[Row]:
    """All methods on the same discs; the first row is the reference."""
    K = partial(gm.permeability, *discs(n))
    for method in ("resolved", "mesoscale", "microstructure"):
        gm.permeability(*discs(10), method)  # compiles
    rows = [timed(f"resolved, tol {reference:.0e} (reference)", partial(K, tol=reference), 1)]
    for tol in tols:
        rows.append(timed(f"resolved, tol {tol:.0e}", partial(K, tol=tol), repeats))
    for method in ("mesoscale", "microstructure"):
        rows.append(timed(method, partial(K, method), repeats))
    return rows


def one(n: int, method: str, tol: float, repeats: int) -> list[Row]:
    """One method on n discs."""
    box, particles = discs(n)
    gm.permeability(*discs(10), method)  # compiles
    name = f"{method}, {n} discs" + (f", tol {tol:.0e}" if method == "resolved" else "")
    return [timed(name, lambda: gm.permeability(box, particles, method, tol=tol), repeats)]


# --- other codes --------------------------------------------------------------------------------


def image(box: gm.Box, particles: gm.Particles, pixels: int) -> tuple[np.ndarray, float]:
    """True in discs, shape (width, height) in pixels, and the size of a pixel [m]."""
    shape = [round(pixels * side / particles.mean_diameter) for side in box.size]
    h = box.width / shape[0]
    centre = h * (np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1) + 0.5)
    solid = np.zeros(shape, dtype=bool)
    for x, r in zip(particles.x, particles.radius, strict=True):
        solid |= (box.separation(x, centre) ** 2).sum(axis=-1) < r**2
    return solid, h


def lattice_boltzmann(n: int, pixels: int) -> list[Row]:
    import sympy
    from lbmpy import LBMConfig, LBStencil, Method, Stencil
    from lbmpy.boundaries import NoSlip
    from lbmpy.lbstep import LatticeBoltzmannStep
    from lbmpy.relaxationrates import relaxation_rate_from_magic_number

    solid, h = image(*discs(n), pixels)
    even = 1.0 / TAU
    config = LBMConfig(
        stencil=LBStencil(Stencil.D2Q9),
        method=Method.TRT,
        relaxation_rates=[even, float(relaxation_rate_from_magic_number(even))],  # 3/16
        compressible=False,
        zero_centered=True,
        force=sympy.symbols("force_x force_y"),
    )
    still = {"force_x": 0.0, "force_y": 0.0}
    step = LatticeBoltzmannStep(
        domain_size=solid.shape, periodicity=True, lbm_config=config, kernel_params=still
    )
    wrapped = np.pad(solid, 1, mode="wrap")  # lbmpy has a layer of ghosts
    step.boundary_handling.set_boundary(NoSlip(), mask_callback=lambda *_: wrapped)
    step.run(1)

    def along(axis: int) -> float:
        """K of a flow from rest to steady state."""
        step.kernel_params.update(still, **{f"force_{'xy'[axis]}": FORCE})
        step.data_handling.fill(step.velocity_data_name, 0.0)
        step.set_pdf_fields_from_macroscopic_values()
        last, K = np.inf, 0.0
        while abs(K - last) > STEADY * abs(K):
            step.run(STEPS)
            # Populations are kept after collision, when the force has been added once too often:
            # with this, plane Poiseuille flow is exact at any resolution.
            u = np.asarray(step.velocity[:, :, axis]) - FORCE
            last, K = K, (TAU - 0.5) / 3.0 * np.where(solid, 0.0, u).mean() / FORCE * h**2
        return K

    return [timed(f"lbmpy, {pixels} pixels a disc", lambda: (along(0) + along(1)) / 2, 1)]


def stokes_network(network: Any, conductance: np.ndarray, **conditions: Any) -> Any:
    """Solve OpenPNM's StokesFlow; conditions: ``value`` and ``rate`` as (pores, values)."""
    import openpnm

    phase = openpnm.phase.Phase(network=network)
    phase["throat.hydraulic_conductance"] = conductance
    flow = openpnm.algorithms.StokesFlow(network=network, phase=phase)
    for kind, (pores, values) in conditions.items():
        flow.set_BC(pores=pores, bctype=kind, bcvalues=values)
    flow.run()
    return flow


def network_of_gaps(n: int, repeats: int) -> list[Row]:
    import openpnm

    box, particles = discs(n)
    r = particles.mean_diameter / 2.0

    def solve() -> float:
        mesh = gm.triangulate(box, particles)
        # Each edge is seen from the two triangles at its sides, which are the pores it joins.
        edge = mesh.triangle_edges.ravel()
        a, b = np.argsort(edge, kind="stable").reshape(-1, 2).T
        conns = np.stack([a // 3, b // 3], axis=1)
        centre = mesh.corners.mean(axis=1)
        middle = (np.roll(mesh.corners, -1, axis=1) + np.roll(mesh.corners, -2, axis=1)) / 2
        arm = (middle - centre[:, None]).reshape(-1, 2)
        step = arm[a] - arm[b]  # from pore to pore, through the edge

        # 1/g = 12 ∫dx/h³ with h = s + 2 (r - sqrt(r² - x²)), x = r sin(t)
        t, weight = np.polynomial.legendre.leggauss(POINTS)
        t, weight = np.pi / 2 * t, np.pi / 2 * weight
        s = mesh.edge_lengths[edge[a]] - 2 * r
        h = s[:, None] + 2 * r * (1 - np.cos(t))
        g = 1 / (12 * (weight * r * np.cos(t) / h**3).sum(axis=1))

        coords = np.pad(centre, [(0, 0), (0, 1)])
        network = openpnm.network.Network(conns=conns, coords=coords)
        K = 0.0
        for axis in range(2):
            drive = g * step[:, axis]  # flow from a to b if pores had no pressure of their own
            pores = len(centre)
            source = np.bincount(conns[:, 1], drive, pores) - np.bincount(conns[:, 0], drive, pores)
            flow = stokes_network(
                network, g, value=([0], [0.0]), rate=(np.arange(1, pores), source[1:])
            )
            p = flow["pore.pressure"][conns]
            K += ((drive + g * (p[:, 0] - p[:, 1])) * step[:, axis]).sum() / box.area / 2
        return K / (2 * r) ** 2

    solve()
    return [timed("OpenPNM, gaps of the discs", solve, repeats)]


def network_of_image(n: int, pixels: int) -> list[Row]:
    import openpnm
    import porespy

    box, particles = discs(n)
    solid, h = image(box, particles, pixels)
    porespy.settings.tqdm["disable"] = True

    def solve() -> float:
        snow = porespy.networks.snow2(~solid, voxel_size=h, boundary_width=3)
        network = openpnm.io.network_from_porespy(snow.network)
        for part in ("pore", "throat"):
            network[f"{part}.diameter"] = network[f"{part}.inscribed_diameter"]
        size_factors = openpnm.models.geometry.hydraulic_size_factors
        factors = size_factors.trapezoids_and_rectangles(network)
        conductance = 1 / (1 / factors).sum(axis=1)  # viscosity 1
        K = 0.0
        for axis, name in enumerate("xy"):
            entry, leave = (network.pores(f"{name}{end}") for end in ("min", "max"))
            pores = np.r_[entry, leave]
            flow = stokes_network(network, conductance, value=(pores, np.isin(pores, entry) * 1.0))
            K += float(flow.rate(pores=entry)[0]) * box.size[axis] / box.size[1 - axis] / 2
        return K / particles.mean_diameter**2

    solve()
    return [timed(f"OpenPNM, PoreSpy's network, {pixels} pixels a disc", solve, 1)]


def others(n: int, repeats: int) -> list[Row]:
    """Rows of the codes that are installed."""
    rows = []
    if find_spec("lbmpy"):
        rows += [row for pixels in (16, 32) for row in alone(1, lattice_boltzmann, n, pixels)]
    if find_spec("openpnm"):
        rows += alone(1, network_of_gaps, n, repeats)
        if find_spec("porespy"):
            rows += [row for pixels in (16, 32) for row in alone(1, network_of_image, n, pixels)]
    return rows


# --- tables -------------------------------------------------------------------------------------


def table(title: str, *columns: str) -> Table:
    made = Table(title=title, title_justify="left")
    for i, column in enumerate(columns):
        made.add_column(column, justify="right" if i else "left")
    return made


def compare(rows: list[Row], n: int) -> Table:
    reference = rows[0].value
    made = table(f"{n} discs, one thread", "method", "K/d2", "error", "estimate", "s", "CPU s")
    for row in rows:
        error = "" if row is rows[0] else f"{row.value / reference - 1:+.1e}"
        estimate = "" if np.isnan(row.estimate) else f"{row.estimate:.0e}"
        made.add_row(
            row.name, f"{row.value:.6f}", error, estimate, f"{row.seconds:.3f}", f"{row.cpu:.3f}"
        )
    return made


def limits(cases: list[tuple[int, Row, str]]) -> Table:
    columns = ("case", "threads", "s", "CPU s", "dofs", "estimate", "peak GB", "required")
    made = table("Limits, required of two threads", *columns)
    for threads, row, required in cases:
        made.add_row(
            row.name,
            str(threads),
            f"{row.seconds:.2f}",
            f"{row.cpu:.2f}",
            str(row.dofs),
            f"{row.estimate:.0e}",
            f"{row.memory:.2f}",
            required,
        )
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="under 20 s: ours only, small only")
    quick = parser.parse_args().quick
    console = Console(width=None if Console().is_terminal else 110)
    repeats = 1 if quick else 3
    load = os.getloadavg()[0]
    console.print(f"{os.cpu_count()} cores, load {load:.1f} of other work at the start")

    tols, reference = ([1e-2], 1e-4) if quick else ([1e-2, 1e-3, 1e-4], 1e-5)
    rows = alone(1, methods, 100, repeats, tols, reference)
    console.print(compare(rows + ([] if quick else others(100, repeats)), 100))

    for_all = [(100, "resolved", 1e-3, repeats, "2 s")]
    if not quick:
        for_all += [
            (800, "resolved", 1e-2, repeats, "10 s, 3 GB"),
            (100_000, "mesoscale", 1e-3, 1, "60 s, 8 GB"),
            (100_000, "microstructure", 1e-3, repeats, "3 s"),
        ]
    cases = [
        (threads, *alone(threads, one, *case), required)
        for *case, required in for_all
        for threads in ((1,) if quick else (1, 2))
    ]
    console.print(limits(cases))


if __name__ == "__main__":
    main()
