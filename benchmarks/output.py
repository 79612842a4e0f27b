"""What a run writes: sizes of its files, and the share of its time that writing takes.

    python benchmarks/output.py [--out FOLDER]

bed
    The starter fluidised-bed: 150 grains, 2 s, a row of the history each 20 ms, a frame each 50 ms.
settling
    2000 grains fall in water for 0.1 s, a row of the history and a frame each 10 ms.

Writing is the time of frames, history and checkpoints together, over that of the whole run, both by
the clock. Compilation is not counted.
"""

import argparse
import json
from pathlib import Path
from tempfile import mkdtemp

import grainmesh as gm
from grainmesh import case, history, vtkhdf
from grainmesh.checkpoint import NAME
from grainmesh.record import ENVIRONMENT, record


def bed() -> tuple[gm.Simulation, dict[str, float]]:
    starter = case.parse(case.starter("fluidised-bed"))
    return starter.simulation(), {"until": 2.0, "every": 0.02, "frames": 0.05}


def settling() -> tuple[gm.Simulation, dict[str, float]]:
    box = gm.Box(0.045, 0.09)
    grains = gm.arrange.loose(box, 2000, diameter=1e-3, density=2500, seed=1)
    model = gm.Model(box, gm.Contact(2e4, friction=0.3), fluid=gm.Fluid(1000.0, 1e-3))
    return gm.Simulation(model, grains), {"until": 0.1, "every": 0.01}


def main(out: Path) -> None:
    bed()[0].run(0.005)  # compiles
    print("case      grains   run s  writing  kB: flow, discs (a frame), checkpoint, history")
    for make in (bed, settling):
        (run, plan), folder = make(), out / make.__name__
        record(run, folder, **plan)
        about = json.loads((folder / ENVIRONMENT).read_text())
        seconds = about["seconds"]
        writing = sum(seconds[name] for name in seconds if name.startswith("writing"))
        frames = len(vtkhdf.times(folder / vtkhdf.FLOW))
        files = (vtkhdf.FLOW, frames), (vtkhdf.DISCS, frames), (NAME, 1), (history.NAME, 1)
        sizes = [(folder / name).stat().st_size / many / 1e3 for name, many in files]
        print(
            f"{make.__name__:9} {len(run):6} {about['elapsed']:7.1f} "
            f"{100 * writing / about['elapsed']:6.1f} %  "
            + ", ".join(f"{size:.0f}" for size in sizes)
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=None, help="an empty folder, to keep the files")
    out = parser.parse_args().out
    main(out or Path(mkdtemp(prefix="grainmesh-")))
