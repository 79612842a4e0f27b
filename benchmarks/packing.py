"""Time to make random arrangements on one core: python benchmarks/packing.py [--quick]."""

import sys
import time

from grainmesh import arrange

LARGEST = 1000 if "--quick" in sys.argv else 100_000

if __name__ == "__main__":
    arrange.random(10, porosity=0.6, diameter=1.0)  # compiles
    print(f"{'n':>8} {'porosity':>9} {'seconds':>8}")
    for n in (100, 1000, 10_000, 100_000):
        for porosity in (0.25, 0.3, 0.4, 0.6, 0.9):
            if n <= LARGEST:
                start = time.perf_counter()
                arrange.random(n, porosity=porosity, diameter=1.0)
                print(f"{n:8d} {porosity:9.2f} {time.perf_counter() - start:8.2f}", flush=True)
