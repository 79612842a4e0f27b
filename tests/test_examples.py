"""Every example and every snippet of the README runs."""

import csv
import importlib.util
import re
import shlex
from pathlib import Path

import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")

from grainmesh import cli

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
PYTHON = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
SHELL = [
    line
    for block in re.findall(r"```sh\n(.*?)```", README, re.DOTALL)
    for line in block.splitlines()
    if line.startswith("grainmesh ")
]


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder that looks like the repository, to write into."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_carbon_fibres(tmp_path):
    example = load(ROOT / "examples" / "carbon_fibres.py")
    results = example.run(tmp_path, side=50.0, tol=2e-2)
    assert len(results) == 9
    for method in example.METHODS:
        small, given, large = (results[method, s] for s in (0.95, 1.0, 1.05))
        # Thinner fibres leave more room, and the flow less resistance.
        assert small.porosity > given.porosity > large.porosity
        assert small.tensor[0, 0] > given.tensor[0, 0] > large.tensor[0, 0] > 0.0
    assert len({results[m, 1.0].porosity for m in example.METHODS}) == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["carbon.csv", "carbon.png"]
    lines = (tmp_path / "carbon.csv").read_text().splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    assert {(r["method"], float(r["radii"])) for r in rows} == set(results)
    text = example.table(results).columns
    assert [c.header for c in text][:3] == ["method", "K/d²", "radii ± 5 %"]


#: What each moving case leaves behind, beside its film.
MOVING = {
    "sedimentation": {"sedimentation.png"},
    "rayleigh_taylor": {"rayleigh_taylor.png"},
    "two_particles": {"two_particles.png", "speeds.png"},
    "fluidised_bed": {"fluidised_bed.png", "pressure.png"},
    "grid": {"grid.png", "forces.png"},
    "filtration": {"filtration.png", "pressure.png"},
}


@pytest.mark.parametrize(
    "name",
    [
        name if name in ("sedimentation", "fluidised_bed")
        else pytest.param(name, marks=pytest.mark.slow)
        for name in MOVING
    ],
)  # fmt: skip
def test_moving_case(name, tmp_path):
    """Each asserts the physics it shows; here, that no grain is lost and files are written."""
    end = load(ROOT / "examples" / f"{name}.py").main(tmp_path, quick=True)
    assert ((end.x > 0.0) & (end.x < end.model.box.size)).all()
    assert np.isfinite(end.flow.operator.x).all()
    solid = 0.25 * np.pi * (end.particles.diameter**2).sum()
    kernel = end.flow.kernel
    assert (1.0 - kernel.porosity) @ kernel.hats == pytest.approx(solid, rel=1e-9)
    names = {path.name for path in tmp_path.iterdir()}
    film = {f"{name}.mp4", f"{name}.gif"}
    assert names - film == MOVING[name]
    assert len(names & film) == 1


def test_the_data_come_with_their_licence():
    data = ROOT / "examples" / "data"
    head = (data / "carbon_fibres.csv").read_text().splitlines()[:9]
    text = " ".join(line for line in head if line.startswith("#"))
    assert "MIT" in text
    assert "Vedrana Andersen Dahl" in text
    assert "Permission is hereby granted" in (data / "LICENSE_InSegt_MIT.txt").read_text()


def test_there_are_snippets():
    assert len(PYTHON) >= 3
    assert len(SHELL) >= 3


@pytest.mark.parametrize("code", PYTHON, ids=range(len(PYTHON)))
def test_readme_python(code, here):
    exec(compile(code, "README.md", "exec"), {})


@pytest.mark.parametrize("line", SHELL)
def test_readme_shell(line, here, capsys):
    if "paper fig2" in line:
        pytest.skip("minutes: see test_paper")
    assert cli.main(shlex.split(line, comments=True)[1:]) == 0
    assert capsys.readouterr().out
