"""Upkeep of a triangulation by flips: python benchmarks/flips.py [--quick].

Discs of diameter 0.7 on a jittered square lattice of pitch 1, periodic; in the order of small
squares, so that neighbours lie near each other in memory, then in random order. A random step of
0.02 is repaired (medians of several steps), then the unchanged mesh is checked (the best of
several). Beside them stands the time of a new triangulation. Compilation is not counted.
"""

from __future__ import annotations

import sys
from time import perf_counter

import numpy as np

from grainmesh.domain import Box
from grainmesh.flips import repair
from grainmesh.particles import Particles
from grainmesh.triangulation import triangulate


def disordered(n: int, sort: bool) -> tuple[Box, Particles]:
    """About n discs in a periodic box."""
    side = round(n**0.5)
    rng = np.random.default_rng(0)
    x = np.stack(np.meshgrid(*2 * [np.arange(side) + 0.5]), axis=-1).reshape(-1, 2)
    if sort:
        i, j = x.T.astype(int)
        x = x[np.lexsort((i % 8, j % 8, i // 8, j // 8))]
    else:
        x = rng.permutation(x)
    return Box(side, side, periodic=True), Particles(x + rng.uniform(-0.1, 0.1, x.shape), 0.7)


def main(sizes: list[int]) -> None:
    print(
        f"{'discs':>9}{'order':>8}{'check ms':>10}{'ns/edge':>9}{'flips':>8}{'µs/flip':>9}"
        f"{'repair ms':>11}{'anew ms':>9}"
    )
    for size in [100, *sizes]:  # the first compiles
        for sort in (True, False):
            box, particles = disordered(size, sort)
            triangulate(box, particles)
            start = perf_counter()
            mesh = triangulate(box, particles)
            anew = perf_counter() - start
            points, weight = np.array(mesh.points), particles.radius**2
            arrays = [np.array(a) for a in (mesh.triangles, mesh.neighbours, mesh.shifts)]
            rng = np.random.default_rng(1)
            check, moved, flips = [], [], []
            for _ in range(10 if size < 1_000_000 else 3):
                points += 0.02 * rng.normal(size=points.shape)
                start = perf_counter()
                made, _, ok = repair(points, weight, box.size, *arrays)
                moved.append(perf_counter() - start)
                flips.append(made)
                if not ok:
                    raise SystemExit("a repair was not ok: take smaller steps")
                start = perf_counter()
                repair(points, weight, box.size, *arrays)
                check.append(perf_counter() - start)
            best, typical = min(check), float(np.median(moved))
            each = (typical - best) / np.median(flips)
            order = "squares" if sort else "random"
            print(
                f"{len(points):9}{order:>8}{1e3 * best:10.2f}{1e9 * best / (3 * len(points)):9.1f}"
                f"{int(np.median(flips)):8}{1e6 * each:9.2f}{1e3 * typical:11.2f}{1e3 * anew:9.1f}"
            )


if __name__ == "__main__":
    main([1_000, 10_000] if "--quick" in sys.argv else [1_000, 10_000, 100_000, 1_000_000])
