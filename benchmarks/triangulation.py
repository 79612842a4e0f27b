"""Time of cells, triangulation and gaps, against Qhull's Delaunay triangulation of the same points.

Run with ``python benchmarks/triangulation.py [n ...]``; compilation is not counted.
"""

from __future__ import annotations

import sys
from time import perf_counter

import numpy as np
from scipy.spatial import Delaunay

from grainmesh.cells import cells
from grainmesh.domain import Box
from grainmesh.particles import Particles, settle
from grainmesh.triangulation import triangulate


def disordered(n: int, periodic: bool, seed: int = 0) -> tuple[Box, Particles]:
    """About n discs of diameter 0.7 on a jittered square lattice of pitch 1, in random order."""
    side = round(n**0.5)
    rng = np.random.default_rng(seed)
    x = np.stack(np.meshgrid(*2 * [np.arange(side) + 0.5]), axis=-1).reshape(-1, 2)
    x += rng.uniform(-0.1, 0.1, x.shape)
    return Box(side, side, periodic), Particles(rng.permutation(x), 0.7)


def main(sizes: list[int]) -> None:
    head = ("discs", "box", "settle", "cells", "triangles", "gaps", "area-1", "Qhull")
    print(("{:>9}" * 8).format(*head))
    for size in [100, *sizes]:  # the first compiles
        for periodic in (False, True):
            box, particles = disordered(size, periodic)
            mesh = None
            seconds = []
            for _ in range(2 if size == 100 else 1):
                seconds = [perf_counter()]
                particles = settle(box, particles)
                seconds.append(perf_counter())
                cells(box, particles)
                seconds.append(perf_counter())
                mesh = triangulate(box, particles)
                seconds.append(perf_counter())
                _ = mesh.gap_shortest, mesh.gap_second, mesh.gap_scatter
                seconds.append(perf_counter())
            assert mesh is not None
            error = mesh.areas.sum() / box.area - 1.0
            begin = perf_counter()
            Delaunay(mesh.points)
            qhull = perf_counter() - begin
            kind = "periodic" if periodic else "walls"
            times = ("{:9.3f}" * 4).format(*np.diff(seconds))
            print(f"{mesh.n:9}{kind:>9}{times}{error:9.0e}{qhull:9.3f}")


if __name__ == "__main__":
    main([1_000] if "--quick" in sys.argv else [1_000, 10_000, 100_000])
