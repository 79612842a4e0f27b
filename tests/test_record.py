"""A run in a folder: what it leaves, how it is stopped, how it goes on."""

import json
import os
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager
from shutil import copytree

import numpy as np
import pytest

import grainmesh as gm
from grainmesh import case, checkpoint, history, record, vtkhdf
from grainmesh.cli import main

CASE = """
[box]
size = ["8 mm", "16 mm"]

[particles]
arrange = "loose"
number = 30
diameter = "1 mm"
density = 2500
seed = 1

[contact]
stiffness = 1e4

[fluid]
density = 1000
viscosity = 2e-3
dt = "2 ms"
drag = "hexagonal-lattice"

[fluid.sides]
top = "outlet"
bottom = { kind = "inflow", velocity = [0, "5 mm/s"], ramp = [[0, 0], ["20 ms", 1]] }

[run]
until = "30 ms"
every = "4 ms"
frames = "6 ms"
"""
FILES = sorted([*record.FILES, checkpoint.OLD, "report.html"])


def same(one, other):
    """What runs leave is the same, bit by bit."""
    assert (one / checkpoint.NAME).read_bytes() == (other / checkpoint.NAME).read_bytes()
    assert history.read(one).identical(history.read(other))
    for name in (vtkhdf.FLOW, vtkhdf.DISCS):
        if (one / name).exists():
            same_frames(one / name, other / name)


def same_frames(one, other):
    assert (vtkhdf.times(one) == vtkhdf.times(other)).all()
    for k in range(len(vtkhdf.times(one))):
        a, b = vtkhdf.read(one, k), vtkhdf.read(other, k)
        assert a.points.tobytes() == b.points.tobytes()
        assert np.array_equal(a.triangles, b.triangles)
        assert a.fields.keys() == b.fields.keys()
        for name in a.fields:
            assert a.fields[name].tobytes() == b.fields[name].tobytes()


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("case") / "bed.toml"
    path.write_text(CASE)
    return path


@pytest.fixture(scope="module")
def undisturbed(file):
    out = file.parent / "undisturbed"
    assert main(["run", str(file), "--out", str(out), "--quiet"]) == 0
    return out


@pytest.fixture(autouse=True)
def no_report(monkeypatch):
    """Reports take long; that of `undisturbed` is enough."""
    monkeypatch.setattr("grainmesh.cli._report", lambda folder: None)


def test_a_run_leaves_its_files(undisturbed, file):
    assert sorted(path.name for path in undisturbed.iterdir()) == FILES
    assert (undisturbed / "case.toml").read_text() == CASE
    again = gm.resume(undisturbed, fluid=case.read(file).simulation().model.fluid)
    assert again.t == pytest.approx(0.03, abs=again.dt)
    assert again.about["case"] == CASE
    table = history.read(undisturbed)
    marks = [0.0, 0.004, 0.008, 0.012, 0.016, 0.02, 0.024, 0.028, 0.03]
    assert table.t.values == pytest.approx(marks, abs=again.dt)
    assert {"momentum_y", "volume_residual", "pressure_drop_y"} <= set(table)
    for name in (vtkhdf.FLOW, vtkhdf.DISCS):
        times = vtkhdf.times(undisturbed / name)
        assert times == pytest.approx([0.0, 0.006, 0.012, 0.018, 0.024, 0.03], abs=again.dt)
    assert (vtkhdf.read(undisturbed / vtkhdf.DISCS, -1).points == again.x).all()
    about = json.loads((undisturbed / "environment.json").read_text())
    assert about["versions"] == checkpoint.versions()
    assert about["plan"]["until"] == 0.03
    assert about["case"] == str(file)
    assert (
        0.0 < about["seconds"]["writing frames"] < sum(about["seconds"].values()) < about["elapsed"]
    )
    log = (undisturbed / "run.log").read_text().splitlines()
    assert "started at t = 0 s, 30 particles" in log[0]
    assert "iterations, volume" in log[1]
    assert "done" in log[-1]


def stopped(arguments, number, wait):
    """Exit status of a command that gets a signal once `wait` says so."""

    def send():
        while not wait():
            pass
        os.kill(os.getpid(), number)

    thread = threading.Thread(target=send)
    thread.start()
    status = main(arguments)
    thread.join()
    return status


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_finishes_the_step_and_saves(undisturbed, file, tmp_path, capsys, number):
    out, before = tmp_path / "out", signal.getsignal(number)
    arguments = ["run", str(file), "--out", str(out), "--quiet"]
    status = stopped(arguments, number, lambda: (out / vtkhdf.DISCS).exists())
    assert status == 128 + number
    assert signal.getsignal(number) == before
    said = capsys.readouterr().err
    assert said.startswith("stopped at t = ")
    assert said.endswith(f"s; go on with: grainmesh resume {out}\n")
    assert said.count("\n") == 1
    assert checkpoint.read(out, case.read(file).simulation().model.fluid)[1]["step"] > 0
    assert len(history.read(out).t) < len(history.read(undisturbed).t)
    record.resume(out)
    same(out, undisturbed)


@pytest.mark.parametrize("calls", [1, 2, 3, 7])
def test_a_stop_at_a_mark_loses_nothing(tmp_path, monkeypatch, calls):
    dry(tmp_path / "undisturbed")
    counted = []

    @contextmanager
    def bar(*_):
        yield (
            lambda step: (
                counted.append(step)
                or (os.kill(os.getpid(), signal.SIGTERM) if len(counted) == calls else None)
            )
        )

    monkeypatch.setattr(record, "bar", bar)
    with pytest.raises(record.Stopped, match="go on with: grainmesh resume"):
        dry(tmp_path / "stopped")
    record.resume(tmp_path / "stopped")
    same(tmp_path / "undisturbed", tmp_path / "stopped")


def test_a_run_goes_on_for_longer(undisturbed, file, tmp_path):
    out = tmp_path / "out"
    assert main(["run", str(file), "--out", str(out), "--quiet", "--until", "0.016"]) == 0
    assert "until = 0.016" in (out / "case.toml").read_text()
    assert main(["resume", str(out), "--quiet", "--until", "0.024"]) == 0
    before = {path: path.read_bytes() for path in out.iterdir()}
    with pytest.warns(UserWarning, match=r"done already at t = 0\.024"):
        record.resume(out)
    with pytest.raises(gm.InputError, match=r"the run has reached t = 0\.024.* later --until"):
        record.resume(out, 0.016)
    assert {path: path.read_bytes() for path in out.iterdir()} == before
    table = history.read(out)
    whole = history.read(undisturbed).sel(t=slice(0.0, table.t[-1]))
    assert (table.t == whole.t).all()
    assert (table.kinetic == whole.kinetic).all()
    assert json.loads((out / "environment.json").read_text())["plan"]["until"] == 0.024


def test_the_checkpoint_before_is_used_where_the_last_is_damaged(undisturbed, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    for path in undisturbed.iterdir():
        (out / path.name).write_bytes(path.read_bytes())
    last = bytearray((out / checkpoint.NAME).read_bytes())
    last[len(last) // 2] ^= 4
    (out / checkpoint.NAME).write_bytes(last)
    assert main(["resume", str(out), "--quiet"]) == 0
    said = capsys.readouterr().err.splitlines()
    assert any("damaged" in line and "going on from the one before" in line for line in said)
    assert all(line.startswith("warning: ") for line in said)
    same(out, undisturbed)


def refused(arguments, capsys):
    """The one line with which a command is refused."""
    capsys.readouterr()
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    return said


def test_a_folder_with_a_run_is_refused(undisturbed, file, capsys):
    before = (undisturbed / "run.log").read_text()
    said = refused(["run", str(file), "--out", str(undisturbed)], capsys)
    assert "holds a run already" in said
    assert f"grainmesh resume {undisturbed}" in said
    assert (undisturbed / "run.log").read_text() == before


def test_folders_without_a_run_are_refused(file, tmp_path, capsys):
    assert "holds no run" in refused(["resume", str(tmp_path)], capsys)
    assert "holds no run" in refused(["resume", str(tmp_path / "nowhere")], capsys)
    (tmp_path / "file").write_text("here is a file")
    arguments = ["run", str(file), "--out", str(tmp_path / "file" / "out"), "--quiet"]
    assert "cannot write there" in refused(arguments, capsys)
    begun = case.read(file).simulation()
    begun.save(tmp_path / "plain")
    with pytest.raises(gm.InputError, match="no run of a case"):
        record.resume(tmp_path / "plain")
    dry(tmp_path / "dry").save(tmp_path / "other")
    (tmp_path / "other" / "x").touch()
    plain = gm.resume(tmp_path / "other")
    plain.about = {}
    plain.save(tmp_path / "other")
    with pytest.raises(gm.InputError, match="no run of a case"):
        record.resume(tmp_path / "other")


def test_only_one_process_writes_a_run(file, tmp_path, monkeypatch, capsys):
    out, said = tmp_path / "out", []

    def begin(self, last):
        said.append(refused(["resume", str(out), "--quiet"], capsys))

    begun = case.read(file).simulation()
    monkeypatch.setattr(record._Output, "begin", begin)
    record.record(begun, out, 0.002)
    assert f"{out}: another process is writing this run" in said[0]


def test_what_is_no_longer_as_the_run_left_it(undisturbed, tmp_path, capsys):
    out = tmp_path / "out"
    copytree(undisturbed, out)
    go_on = ["resume", str(out), "--quiet", "--until", "0.032"]
    (out / "case.toml").write_text(CASE.replace("5 mm/s", "6 mm/s"))
    assert "case.toml: is not the case that the run was begun with" in refused(go_on, capsys)
    (out / "case.toml").write_bytes(b"\xff")
    assert "case.toml: is not the case that the run was begun with" in refused(go_on, capsys)
    (out / "case.toml").unlink()
    for name in (vtkhdf.FLOW, vtkhdf.DISCS):
        frames = (out / name).rename(tmp_path / name)
        assert f"{name}: is missing" in refused(go_on, capsys)
        frames.rename(out / name)
    assert main(go_on) == 0
    assert (out / "case.toml").read_text() == CASE


def test_a_log_that_cannot_be_leaves_nothing(file, tmp_path, capsys):
    out, log = tmp_path / "out", tmp_path / "none" / "x.log"
    said = refused(["run", str(file), "--out", str(out), "--quiet", "--log", str(log)], capsys)
    assert "x.log: cannot be written" in said
    assert not out.exists()


def test_until_may_have_a_unit(file, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["run", str(file), "--out", str(out), "--quiet", "--until", "2 ms"]) == 0
    assert main(["resume", str(out), "--quiet", "--until", "3ms"]) == 0
    assert record.resume(out, 0.004).t == pytest.approx(0.004, abs=1e-4)
    for bad in ("-1", "nan", "2 mm", "long"):
        said = refused(["resume", str(out), "--quiet", "--until", bad], capsys)
        assert said.startswith("error: --until: ")


def test_what_is_off_is_said_by_a_run_too(file, tmp_path, capsys):
    thin = ["--set", "fluid.viscosity=1e-4", "--until", "1e-4", "--quiet"]
    assert main(["run", str(file), "--out", str(tmp_path / "out"), *thin]) == 0
    assert "warning: fluid.drag: Re_p is" in capsys.readouterr().err


def dry(folder, **plan):
    box = gm.Box(0.008, 0.016)
    grains = gm.arrange.loose(box, 10, diameter=1e-3, density=2500, seed=1)
    run = gm.Simulation(gm.Model(box, gm.Contact(1e4)), grains, ledger=True)
    return record.record(run, folder, **{"until": 0.05, "every": 0.01, **plan})


def test_a_dry_run_has_no_flow(tmp_path):
    dry(tmp_path)
    names = set(FILES) - {vtkhdf.FLOW, record.CASE, "report.html"}
    assert {path.name for path in tmp_path.iterdir()} == names
    assert len(vtkhdf.times(tmp_path / vtkhdf.DISCS)) == 6
    assert 0.0 < history.read(tmp_path).energy_residual.max() < 1e-3
    assert "energy" in (tmp_path / record.LOG).read_text()


def test_the_log_may_be_elsewhere(tmp_path):
    dry(tmp_path / "run", log=tmp_path / "some.log")
    assert "done" in (tmp_path / "some.log").read_text()
    assert not (tmp_path / "run" / record.LOG).exists()
    with pytest.raises(gm.InputError, match=r"nowhere/x\.log: cannot be written"):
        dry(tmp_path / "other", log=tmp_path / "nowhere" / "x.log")


@pytest.mark.parametrize(
    ("plan", "said"),
    [
        ({"until": -1.0}, "until = -1 s must be positive"),
        ({"until": np.nan}, "until = nan s must be positive"),
        ({"every": 0.0}, "every = 0 s must be positive"),
        ({"frames": np.inf}, "frames = inf s must be positive"),
        ({"cuts": 0}, "cuts = 0 must be at least 1"),
        ({"probes": [1.0]}, "probes must be places"),
        ({"probes": [[0.001, 0.001], [1.0, 0.0]]}, r"\(1, 0\) m is outside of the box"),
    ],
)
def test_plans_that_make_no_sense_are_refused(tmp_path, plan, said):
    with pytest.raises(gm.InputError, match=said):
        dry(tmp_path / "out", **plan)
    assert not (tmp_path / "out").exists()


def test_a_simulation_that_has_begun_is_refused(tmp_path):
    with pytest.raises(gm.InputError, match="has begun already"):
        record.record(dry(tmp_path / "a"), tmp_path / "b", 0.1)


def test_a_run_that_fails_keeps_its_last_good_state(tmp_path, capsys):
    box = gm.Box(0.01, 0.01)
    grains = gm.Particles([[0.005, 0.005]], 1e-3)
    model = gm.Model(box, gm.Contact(1e3), force=lambda t, x, v: [[0.0, 1e9 if t > 0.01 else 0.0]])
    with pytest.raises(gm.RunError, match=f"the last good state is in {tmp_path}"):
        record.record(gm.Simulation(model, grains), tmp_path, 0.1, 0.001)
    assert "failed: " in (tmp_path / record.LOG).read_text()
    assert gm.resume(tmp_path, force=model.force).t >= 0.01


def test_a_run_that_fails_at_once_is_not_in_the_way(file, tmp_path):
    begun = case.read(file, ["fluid.sides.top=no-slip"])
    (tmp_path / "notes").touch()
    with pytest.raises(gm.RunError, match="nothing is kept"):
        record.record(begun.simulation(), tmp_path, 0.01)
    assert [path.name for path in tmp_path.iterdir()] == ["notes"]


def test_a_case_goes_on_from_python_as_the_page_says(file, tmp_path):
    record.record(case.read(file).simulation(), tmp_path, until=0.002)
    assert (tmp_path / record.CASE).read_text() == CASE
    assert record.resume(tmp_path, 0.004).t == pytest.approx(0.004, abs=1e-4)
    times = vtkhdf.times(str(tmp_path / vtkhdf.FLOW))
    assert vtkhdf.read(str(tmp_path / vtkhdf.FLOW), -1).t == times[-1]


FULL = """
import resource, sys
from grainmesh.cli import main
limit = int(sys.argv[3])
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
sys.exit(main(["run", sys.argv[1], "--out", sys.argv[2], "--quiet"]))
"""


def test_a_full_disk_is_told_and_the_run_goes_on_later(undisturbed, file, tmp_path):
    # Files that may not grow: a stand-in for a disk that is full.
    limit = (undisturbed / vtkhdf.DISCS).stat().st_size + 70_000  # HDF5 gets that much ahead
    assert limit > (undisturbed / checkpoint.NAME).stat().st_size
    command = [sys.executable, "-c", FULL, str(file), str(tmp_path / "out"), str(limit)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert ".vtkhdf: cannot be written" in done.stderr
    assert "make room" in done.stderr
    assert done.stderr.count("\n") == 1
    assert 1 <= len(vtkhdf.times(tmp_path / "out" / vtkhdf.DISCS)) < 6
    record.resume(tmp_path / "out")
    same(tmp_path / "out", undisturbed)


def test_a_case_of_permeability_runs_too(tmp_path, capsys):
    path = tmp_path / "fibres.toml"
    assert main(["new", str(path), "--starter", "permeability"]) == 0
    arguments = [
        "run",
        str(path),
        "--out",
        str(tmp_path / "out"),
        "--set",
        "permeability.method=['microstructure']",
    ]
    assert main(arguments) == 0
    assert "microstructure" in capsys.readouterr().out
    assert (tmp_path / "out" / "permeability.json").exists()
