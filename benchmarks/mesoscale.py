"""Mesoscale against resolved flow in no-slip channels: python benchmarks/mesoscale.py [--quick].

Ordered rows between no-slip walls with the exact law of their lattice, Fig. 2 of Yazdchi,
Srivastava and Luding (2013): ratio of the mean velocities, for two orders and for the bare delta.
"""

import sys
from time import perf_counter

from grainmesh import arrange, fluid, resolved
from grainmesh.closures import HexagonalLattice, SquareLattice

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


if __name__ == "__main__":
    main("--quick" in sys.argv)
