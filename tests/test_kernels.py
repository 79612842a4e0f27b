"""Compiled kernels are kept: a second start of the program compiles nothing."""

import os
import subprocess
import sys

RUN = """
import grainmesh as gm
for periodic in (False, True):
    box = gm.Box(0.1, 0.1, periodic)
    grains = gm.Particles([[0.03, 0.03], [0.06, 0.03], [0.05, 0.06]], 0.01)
    model = gm.Model(box, gm.Contact(1e5))
    gm.Simulation(model, grains, velocity=(0.1, 0.3)).run(until=0.02)
"""


def _kernels_compiled() -> int:
    watched = {**os.environ, "NUMBA_DEBUG_CACHE": "1"}
    run = subprocess.run(
        [sys.executable, "-c", RUN], env=watched, capture_output=True, text=True, check=True
    )
    assert "[cache]" in run.stdout  # otherwise this test would not notice
    return run.stdout.count("data saved to")


def test_a_second_start_compiles_nothing():
    _kernels_compiled()
    assert _kernels_compiled() == 0
