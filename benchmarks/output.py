"""What a run writes: sizes of its files, and the share of its time that writing takes.

    python benchmarks/output.py [--out FOLDER]

Grains that settle in water, a row of the history, a checkpoint and a frame every 10 ms of 0.1 s.
Writing is the time of frames, history and checkpoints together, over that of the whole run.
"""

import argparse
import json
from pathlib import Path
from tempfile import mkdtemp

import grainmesh as gm
from grainmesh import history, record, vtkhdf
from grainmesh.checkpoint import NAME

CASES = {"small": (150, 0.012, 0.03), "large": (2000, 0.045, 0.09)}
UNTIL, EVERY = 0.1, 0.01


def settling(n: int, width: float, height: float) -> gm.Simulation:
    box = gm.Box(width, height)
    grains = gm.arrange.loose(box, n, diameter=1e-3, density=2500, seed=1)
    model = gm.Model(box, gm.Contact(2e4, friction=0.3), fluid=gm.Fluid(1000.0, 1e-3))
    return gm.Simulation(model, grains)


def main(out: Path) -> None:
    print(
        "case    grains   run s  writing  ms a mark   kB: flow, discs (frame), checkpoint, history"
    )
    settling(*CASES["small"]).run(0.01)  # compiles
    for name, (n, *size) in CASES.items():
        run, folder = settling(n, *size), out / name
        record.record(run, folder, UNTIL, EVERY)
        about = json.loads((folder / record.ENVIRONMENT).read_text())
        share = about["seconds"]["writing"] / about["elapsed"]
        count = len(vtkhdf.times(folder / vtkhdf.FLOW))
        sizes = [
            (folder / file).stat().st_size / many / 1e3
            for file, many in (
                (vtkhdf.FLOW, count), (vtkhdf.DISCS, count), (NAME, 1), (history.NAME, 1)
            )
        ]  # fmt: skip
        elapsed, mark = about["elapsed"], 1e3 * about["seconds"]["writing"] / count
        print(
            f"{name:6} {n:7} {elapsed:7.1f} {100 * share:6.1f} % {mark:10.0f}   "
            + ", ".join(f"{kB:.0f}" for kB in sizes)
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=None, help="an empty folder, to keep the files")
    out = parser.parse_args().out
    main(out or Path(mkdtemp(prefix="grainmesh-")))
