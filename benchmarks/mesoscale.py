"""Mesoscale against resolved flow in no-slip channels: python benchmarks/mesoscale.py [--quick].

Ordered rows between no-slip walls with the exact law of their lattice, Fig. 2 of Yazdchi,
Srivastava and Luding (2013): ratio of the mean velocities, for three orders and for the bare delta.
Then time and memory of one large periodic cell, P2/P1, both directions and the error estimate.
"""

import resource
import sys
from time import perf_counter

from grainmesh import arrange, fluid, resolved
from grainmesh.closures import HexagonalLattice, Microstructural, SquareLattice

CHANNELS = {
    "square 10x10": (arrange.square, 10, 10, SquareLattice()),
    "square 8x14": (arrange.square, 8, 14, SquareLattice()),
    "hexagonal 10x10": (arrange.hexagonal, 10, 10, HexagonalLattice()),
}


def main(quick: bool) -> None:
    print(f"{'channel':>16} {'porosity':>8} {'k=1':>6} {'k=2':>6} {'k=4':>6} {'delta':>7} {'s':>6}")
    for name, (make, nx, ny, law) in list(CHANNELS.items())[: 1 if quick else 3]:
        for porosity in (0.4, 0.8) if quick else (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95):
            box, discs = make(nx, ny, porosity=porosity, diameter=1.0, periodic=False)
            exact = resolved.solve(box, discs, walls="no-slip").tensor[0, 0]
            start = perf_counter()
            ratios = [
                fluid.solve(box, discs, law, order=k, walls="no-slip").tensor[0, 0] / exact
                for k in (1, 2, 4)
            ]
            seconds = perf_counter() - start
            delta = fluid.solve(box, discs, law, kernel="delta", walls="no-slip").tensor[0, 0]
            row = (*ratios, delta / exact, seconds)
            print(
                f"{name:>16} {porosity:8.2f}"
                + " {:6.3f} {:6.3f} {:6.3f} {:7.1f} {:6.2f}".format(*row)
            )
    n = 10_000 if quick else 100_000
    box, discs = arrange.random(n, porosity=0.6, diameter=1.0, min_gap=0.05, seed=1)
    start = perf_counter()
    flow = fluid.solve(box, discs, Microstructural())
    seconds = perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20  # kB on Linux
    print(f"{n} discs, periodic: {flow.dofs} unknowns, {seconds:.1f} s, at most {peak:.1f} GB")


if __name__ == "__main__":
    main("--quick" in sys.argv)
