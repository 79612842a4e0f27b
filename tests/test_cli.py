"""The command line: its contract, and every kind of bad input."""

import csv
import json
import os
import signal
import subprocess
import sys
from functools import partial
from importlib import import_module
from pathlib import Path
from time import sleep

import numpy as np
import pytest

import grainmesh as gm
from grainmesh import cli, report
from grainmesh.closures import LAWS

HEADER = "x,y,d\n"
#: Four discs, 10 wide, well inside a box of 40 x 40.
DISCS = HEADER + "10,10,10\n30,12,10\n11,29,10\n29,31,10\n"
FAST = ("--width", "40", "--height", "40", "--method", "microstructure")


@pytest.fixture
def discs(tmp_path):
    path = tmp_path / "discs.csv"
    path.write_text(DISCS)
    return path


@pytest.fixture
def run(capsys):
    def call(*arguments):
        status = cli.main([str(a) for a in arguments])
        streams = capsys.readouterr()
        return status, streams.out, streams.err

    return call


def files(folder):
    return sorted(p for p in folder.rglob("*"))


BAD_FILES = {
    "empty file": ("", "empty"),
    "only comments": ("# nothing\n\n", "empty"),
    "no rows": (HEADER, "no row"),
    "missing column": ("x,d\n1,1\n", "column y missing"),
    "missing size": ("x,y\n1,1\n", "d or r missing"),
    "not a number": (DISCS + "20,here,10\n", "row 6"),
    "too few fields": (DISCS + "20,20\n", "row 6"),
    "infinite": (DISCS + "20,inf,10\n", "row 6"),
    "nan": ("# comment\n" + DISCS + "nan,20,10\n", "row 7"),
    "zero diameter": (DISCS + "20,20,0\n", "row 6"),
    "negative diameter": (DISCS + "20,20,-3\n", "row 6"),
    "outside the box": (DISCS + "60,20,10\n", "particle 4"),
    "duplicate centres": (DISCS + "10,10,10\n", "particles 0 and 4"),
    "strong overlap": (DISCS + "16,10,10\n", "particles 0 and 4"),
    "two discs": (HEADER + "10,10,10\n30,30,10\n", "at least 3"),
    "hidden disc": (DISCS + "10,13,0.5\n", "particles 0 and 4"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_file(case, run, tmp_path):
    text, expected = BAD_FILES[case]
    path = tmp_path / "bad.csv"
    path.write_text(text)
    before = files(tmp_path)
    status, out, err = run("permeability", path, *FAST, "--out", tmp_path / "out", "--json")
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert str(path) in err
    assert expected in err
    assert files(tmp_path) == before


BAD_OPTIONS = {
    "unknown method": (("--method", "resolved,magic"), "magic"),
    "no method": (("--method", ""), "method"),
    "unknown law": (("--law", "magic"), "magic"),
    "unknown walls": (("--walls", "rough"), "rough"),
    "walls of a periodic box": ((*FAST, "--periodic", "--walls", "no-slip"), "--periodic"),
    "zero diameter": (("--diameter", "0"), "diameter"),
    "negative unit": (("--unit", "-1"), "unit"),
    "width alone": (("--width", "40"), "height"),
    "negative width": (("--width", "-40", "--height", "40"), "width"),
    "periodic without a period": (("--periodic",), "width"),
    "half a window": (("--window", "0,0,40"), "window"),
    "reversed window": (("--window", "40,0,0,40"), "window"),
    "window and width": ((*FAST, "--window", "0,0,40,40"), "window"),
    "empty window": (("--window", "100,100,140,140"), "no disc"),
    "box in the unit of the file": ((*FAST, "--unit", "1e-6"), "metres"),
    "tolerance": ((*FAST, "--tol", "0"), "tol"),
    "text for a number": (("--tol", "small"), "--tol"),
    "order of resolved": (("--order", "2", "--method", "resolved"), "order"),
    "order zero": (("--order", "0"), "--order"),
    "unknown option": (("--magic",), "--magic"),
    "overlap across the edge": (
        ("--periodic", "--width", "36", "--height", "36", "--diameter", "18"),
        "across the periodic edge",
    ),
}


@pytest.mark.parametrize("case", BAD_OPTIONS)
def test_bad_option(case, run, discs):
    options, expected = BAD_OPTIONS[case]
    before = files(discs.parent)
    status, out, err = run("permeability", discs, *options, "--out", discs.parent / "out")
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert expected in err
    assert files(discs.parent) == before


@pytest.mark.parametrize(
    "arguments",
    [
        ["permeability"],
        ["permeability", "no such file.csv"],
        ["permeability", "."],
        ["magic"],
        ["--magic"],
        ["paper", "fig1"],
        ["paper", "fig9", "--out", "somewhere"],
    ],
    ids=" ".join,
)
def test_bad_command(arguments, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, err = run(*arguments)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert files(tmp_path) == []


def test_porosity_out_of_reach_is_one_line():
    with pytest.raises(gm.InputError, match=r"out of reach.*raise porosity") as caught:
        gm.arrange.random(50, porosity=0.15, diameter=1.0)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("below", ["", "deeper/still"])
@pytest.mark.parametrize("verb", ["permeability", "paper"])
def test_unwritable_folder_is_found_before_the_work(verb, below, run, discs, monkeypatch):
    def never(*_, **__):
        raise AssertionError("the work has begun")

    monkeypatch.setattr(import_module("grainmesh.permeability"), "permeability", never)
    monkeypatch.setattr("grainmesh.paper.fig1", never)
    out = discs / below  # below a file there is no folder
    before = files(discs.parent)
    status, _, err = run(
        *((verb, discs) if verb == "permeability" else (verb, "fig1")), "--out", out
    )
    assert status == 2
    assert err.count("\n") == 1
    assert str(out) in err
    assert files(discs.parent) == before


def test_failure_while_writing_leaves_nothing(run, discs, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device", "permeability.png")

    monkeypatch.setattr("grainmesh.plot.save", full)
    before = files(discs.parent)
    status, out, err = run("permeability", discs, *FAST, "--out", discs.parent / "a" / "b")
    assert (status, out) == (2, "")
    assert "No space left" in err
    assert err.count("\n") == 1
    assert files(discs.parent) == before


def test_json_is_what_python_says(run, discs):
    options = ("--width", "40e-6", "--height", "40e-6", "--unit", "1e-6", "--periodic")
    wanted = ["microstructure", "resolved", "mesoscale"]
    status, out, _ = run("permeability", discs, *options, "--json", "--method", ",".join(wanted))
    assert status == 0
    found = json.loads(out)
    box, particles = gm.arrange.from_csv(discs, unit=1e-6, width=4e-5, height=4e-5, periodic=True)
    assert found["n"] == 4
    assert found["porosity"] == pytest.approx(1 - 4 * np.pi * 25 / 1600, rel=1e-12)
    assert [r["method"] for r in found["results"]] == wanted
    for r in found["results"]:
        K = gm.permeability(box, particles, r["method"])
        np.testing.assert_allclose(r["tensor"], K.tensor, rtol=1e-9, atol=1e-9 * K.tensor.max())
        assert r["normalised"] == pytest.approx(np.trace(K.tensor) / 2 / 1e-5**2)
        assert r["dofs"] == K.dofs
        assert r["error"] == pytest.approx(K.error, rel=1e-3)
        assert r["seconds"] > 0.0


def test_unit_scales_the_permeability_only(run, discs):
    def normalised(scale):
        size = ("--width", 40 * scale, "--height", 40 * scale, "--unit", scale)
        status, out, _ = run("permeability", discs, *size, "--method", "microstructure", "--json")
        assert status == 0
        return json.loads(out)["results"][0]

    large, small = normalised(1.0), normalised(1e-6)
    assert large["normalised"] == pytest.approx(small["normalised"], rel=1e-9)
    assert large["tensor"][0][0] == pytest.approx(1e12 * small["tensor"][0][0], rel=1e-9)


def test_methods_are_run_once_in_the_order_asked(run, discs):
    status, out, _ = run(
        "permeability",
        discs,
        *FAST[:4],
        "--json",
        "--method",
        "mesoscale, microstructure,mesoscale",
    )
    assert status == 0
    assert [r["method"] for r in json.loads(out)["results"]] == ["mesoscale", "microstructure"]


def test_nothing_but_json_numbers(run, tmp_path):
    """One disc has no gap: null, not NaN."""
    path = tmp_path / "one.csv"
    path.write_text(HEADER + "20,20,10\n")
    status, out, _ = run(
        "permeability", path, *FAST[:4], "--method", "resolved", "--tol", 0.05, "--json"
    )
    assert status == 0

    def refuse(constant):
        raise AssertionError(constant)

    assert json.loads(out, parse_constant=refuse)["gap"] is None


def test_crop_and_window_take_the_same_discs(run, discs):
    status, _, err = run("permeability", discs, "--width", 35, "--height", 25, *FAST[4:])
    assert status == 2
    assert "--crop" in err
    cropped = run(
        "permeability", discs, "--width", 35, "--height", 35, "--crop", *FAST[4:], "--json"
    )
    window = run("permeability", discs, "--window", "0,0,35,35", *FAST[4:], "--json")
    a, b = (json.loads(out) for _, out, _ in (cropped, window))
    assert a["results"][0]["tensor"] == b["results"][0]["tensor"]
    assert a["porosity"] == b["porosity"]


def test_no_slip_walls_slow_the_flow(run, discs):
    def tensor(walls):
        options = (*FAST[:4], "--method", "resolved", "--tol", 0.05, "--json", "--walls", walls)
        return np.array(json.loads(run("permeability", discs, *options)[1])["results"][0]["tensor"])

    assert (np.diag(tensor("no-slip")) < 0.9 * np.diag(tensor("symmetry"))).all()


@pytest.mark.parametrize("law", ["kuwabara", "square-lattice"])
def test_law_is_used(law, run, discs):
    status, out, _ = run("permeability", discs, *FAST, "--json", "--law", law)
    assert status == 0
    found = json.loads(out)
    expected = float(LAWS[law](found["porosity"], found["gap"]))
    assert found["results"][0]["normalised"] == pytest.approx(expected)


def test_table_and_warning(run, tmp_path):
    """A lattice by the law for random discs: one plain warning, and the table."""
    box, particles = gm.arrange.square(5, 5, porosity=0.6, diameter=1.0)
    path = tmp_path / "square.csv"
    rows = [f"{x},{y},1.0\n" for x, y in particles.x]
    path.write_text(HEADER + "".join(rows))
    size = ("--width", box.width, "--height", box.height, "--periodic")
    status, out, err = run("permeability", path, *size, "--method", "microstructure,mesoscale")
    assert status == 0
    assert err.startswith("warning: ")
    assert err.count("\n") == 1  # once, though both methods gave it
    assert "lattice" in err
    assert "ClosureWarning" not in err
    assert "microstructure" in out
    assert "mesoscale" in out
    assert "K/d²" in out


def test_out_writes_three_files(run, discs):
    out = discs.parent / "new" / "folder"
    status, text, _ = run("permeability", discs, *FAST[:4], "--tol", 0.05, "--json", "--out", out)
    assert status == 0
    assert [p.name for p in files(out)] == sorted(cli.FILES)
    assert json.loads((out / "permeability.json").read_text()) == json.loads(text)
    assert (out / "permeability.png").read_bytes().startswith(b"\x89PNG")
    lines = (out / "permeability.csv").read_text().splitlines()
    table = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    for row, result in zip(table, json.loads(text)["results"], strict=True):
        assert row["method"] == result["method"]
        assert float(row["Kxy"]) == pytest.approx(result["tensor"][0][1], rel=1e-9)


def test_write_replaces_all_or_nothing(tmp_path):
    (tmp_path / "a").write_text("old")

    def broken(path):
        path.write_text("half")
        raise OSError("disk")

    with pytest.raises(OSError, match="disk"):
        report.write(tmp_path, {"a": lambda p: p.write_text("new"), "b": broken})
    assert (tmp_path / "a").read_text() == "old"
    assert [p.name for p in files(tmp_path)] == ["a"]
    report.write(tmp_path, {"a": lambda p: p.write_text("new")})
    assert (tmp_path / "a").read_text() == "new"
    assert [p.name for p in files(tmp_path)] == ["a"]


def test_interrupt(run, discs, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(import_module("grainmesh.permeability"), "permeability", interrupted)
    assert run("permeability", discs, *FAST) == (130, "", "interrupted\n")


def test_help_and_version(run):
    assert run("--version") == (0, f"grainmesh {gm.__version__}\n", "")
    for arguments in ([], ["--help"], ["permeability", "--help"], ["paper", "--help"]):
        status, out, err = run(*arguments)
        assert (status, err) == (0, "")
        assert "Usage: grainmesh" in out
    assert "metres" in run("permeability", "--help")[1]


def process(*arguments, **options):
    return subprocess.run(
        [sys.executable, "-m", "grainmesh.cli", *map(str, arguments)],
        capture_output=True,
        text=True,
        **options,
    )


def test_process(discs, tmp_path):
    """As a program: nothing else reaches stdout, also from compiled libraries, or the folder."""
    here = tmp_path / "here"
    here.mkdir()
    done = process(
        "permeability",
        discs,
        *FAST[:4],
        "--tol",
        0.05,
        "--json",
        cwd=here,
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
    )
    assert done.returncode == 0
    assert len(json.loads(done.stdout)["results"]) == 3
    assert files(here) == []
    bad = process("permeability", Path("none.csv"), cwd=here)
    assert (bad.returncode, bad.stdout) == (2, "")
    assert bad.stderr.count("\n") == 1
    assert "none.csv" in bad.stderr


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_ctrl_c_of_a_process(tmp_path):
    """Interrupted while it reads, which never ends: exit 130, one line."""
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    with (
        subprocess.Popen(
            [sys.executable, "-m", "grainmesh.cli", "permeability", str(pipe)],
            stderr=subprocess.PIPE,
            text=True,
            # what runs in the background of a shell would inherit an ignored SIGINT
            preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
        ) as running,
        pipe.open("w"),
    ):  # returns once the program has opened the other end
        sleep(0.5)  # a signal between its last look and the read would wake nobody
        running.send_signal(signal.SIGINT)
        _, err = running.communicate(timeout=30)
    assert (running.returncode, err) == (130, "interrupted\n")
