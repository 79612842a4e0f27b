"""Make the other pictures of the docs again, with their numbers: ``python docs/figures.py``."""

from pathlib import Path
from runpy import run_path

import matplotlib

matplotlib.use("Agg")

from grainmesh import paper

HERE = Path(__file__).parent

if __name__ == "__main__":
    run_path(str(HERE.parent / "examples" / "carbon_fibres.py"))["run"](HERE)
    paper.fig1(HERE, progress=print)
    paper.fig2(HERE, progress=print)
