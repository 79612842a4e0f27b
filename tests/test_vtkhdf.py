"""Frames: VTK reads what was written; a writer that is killed leaves whole frames."""

import os
import shutil
import signal
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest

import grainmesh as gm
from grainmesh import vtkhdf


def a_frame(k, triangles=True):
    """A frame whose number of points and triangles depends on k."""
    rng = np.random.default_rng(k)
    n, m = 5 + 3 * (k % 4), 4 + 5 * (k % 3)
    fields = {"velocity": rng.normal(size=(n, 2)), "pressure": rng.normal(size=n)}
    corners = rng.integers(0, n, (m, 3)) if triangles else None
    if not triangles:
        fields |= {"id": np.arange(n)}
    return vtkhdf.Frame(0.1 * k, rng.normal(size=(n, 2)), fields, corners)


def same(a, b):
    assert a.t == b.t
    assert (a.points == b.points).all()
    assert a.fields.keys() == b.fields.keys()
    for name in a.fields:
        assert a.fields[name].dtype == b.fields[name].dtype
        assert (a.fields[name] == b.fields[name]).all()
    if a.triangles is None:
        assert b.triangles is None
    else:
        assert (a.triangles == b.triangles).all()


@pytest.mark.parametrize("triangles", [True, False])
def test_frames_are_read_as_they_were_written(tmp_path, triangles):
    path = tmp_path / "some.vtkhdf"
    frames = [a_frame(k, triangles) for k in range(70)]
    vtkhdf.append(path, *frames[:3])
    for frame in frames[3:60]:
        vtkhdf.append(path, frame)
    vtkhdf.append(path, *frames[60:])
    seen_by_vtk(path)
    assert (vtkhdf.times(path) == [frame.t for frame in frames]).all()
    for k in (0, 69, 3, -1):
        same(vtkhdf.read(path, k), frames[k])
    for k in (70, -71):
        with pytest.raises(gm.InputError, match="there is no frame"):
            vtkhdf.read(path, k)
    assert [file.name for file in tmp_path.iterdir()] == ["some.vtkhdf"]


def by_vtk(path, times):
    """Each frame as VTK reads it: (points, corners, fields)."""
    vtk = pytest.importorskip("vtkmodules.vtkIOHDF")
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as Pipeline

    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    assert reader.CanReadFile(str(path))
    reader.UpdateInformation()
    info, key = reader.GetOutputInformation(0), Pipeline.TIME_STEPS()
    assert [info.Get(key, i) for i in range(info.Length(key))] == list(vtkhdf.times(path))
    for t in times:
        reader.UpdateTimeStep(t)
        grid = reader.GetOutputDataObject(0)
        types = {grid.GetCellType(i) for i in range(grid.GetNumberOfCells())}
        width = {(vtkhdf.TRIANGLE,): 3, (vtkhdf.VERTEX,): 1}[tuple(types)]
        data = grid.GetPointData()
        arrays = [data.GetArray(i) for i in range(data.GetNumberOfArrays())]
        yield (
            vtk_to_numpy(grid.GetPoints().GetData()),
            vtk_to_numpy(grid.GetCells().GetConnectivityArray()).reshape(-1, width),
            {a.GetName(): vtk_to_numpy(a) for a in arrays},
        )


def seen_by_vtk(path):
    """VTK finds all frames, in any order, with the corners and fields that `read` finds."""
    times = vtkhdf.times(path)
    order = [0, len(times) - 1, *range(len(times))]
    for k, (points, corners, fields) in zip(order, by_vtk(path, times[order]), strict=True):
        frame = vtkhdf.read(path, k)
        assert (points[:, :2] == frame.points).all()
        assert (points[:, 2] == 0.0).all()
        each = np.arange(len(points))[:, None]
        assert (corners == (each if frame.triangles is None else frame.triangles)).all()
        assert fields.keys() == frame.fields.keys()
        for name, value in frame.fields.items():
            found = fields[name][:, :2] if value.ndim == 2 else fields[name]
            assert (found == value).all()


@pytest.fixture(scope="module")
def run():
    """Frames of grains that settle in water, as recorded, and as they were."""
    box = gm.Box(0.008, 0.016)
    grains = gm.arrange.loose(box, 30, diameter=1e-3, density=2500, seed=1)
    model = gm.Model(box, gm.Contact(1e4, friction=0.3), fluid=gm.Fluid(1000.0, 1e-3))
    return gm.Simulation(model, grains)


def test_vtk_reads_every_frame_of_a_run(run, tmp_path):
    flow, discs, frames = tmp_path / vtkhdf.FLOW, tmp_path / vtkhdf.DISCS, []

    def observe(run):
        frames.append((vtkhdf.flow(run), vtkhdf.discs(run)))
        vtkhdf.append(flow, frames[-1][0])
        vtkhdf.append(discs, frames[-1][1])

    observe(run)
    run.run(0.1, every=0.025, observe=observe)
    for path in (flow, discs):
        seen_by_vtk(path)
    for k, (fluid, solid) in enumerate(frames):
        same(vtkhdf.read(flow, k), fluid)
        same(vtkhdf.read(discs, k), solid)
    topologies = {vtkhdf.read(flow, k).triangles.tobytes() for k in range(len(frames))}
    assert len(topologies) > 1
    sample = run.flow.sample()
    last = vtkhdf.read(flow, -1)
    assert (last.fields["velocity"] == sample.velocity).all()
    assert (last.triangles == sample.triangles).all()
    last = vtkhdf.read(discs, -1)
    assert (last.points == run.x).all()
    assert (last.fields["radius"] == run.particles.radius).all()
    assert (last.fields["spin"] == run.spin).all()
    assert (last.fields["fluid_force"] == run.flow.force).all()


def test_finer_triangles_lie_in_the_coarse_ones(run):
    coarse, fine = vtkhdf.flow(run), vtkhdf.flow(run, 3)
    assert len(fine.triangles) == 9 * len(coarse.triangles)

    def area(frame):
        a, b, c = frame.points[frame.triangles.T]
        (ax, ay), (bx, by) = (b - a).T, (c - a).T
        return (0.5 * (ax * by - ay * bx)).sum()

    assert area(fine) == pytest.approx(run.model.box.area, rel=1e-12)
    assert area(coarse) == pytest.approx(run.model.box.area, rel=1e-12)


def test_force_of_contacts_holds_up_a_pile():
    box = gm.Box(0.02, 0.02)
    grains = gm.arrange.loose(box, 60, diameter=1e-3, density=2500, seed=2)
    model = gm.Model(box, gm.Contact(1e4, restitution=0.2, friction=0.5))
    pile = gm.Simulation(model, grains).run(1.0)
    frame = vtkhdf.discs(pile)
    weight = 2500.0 * np.pi / 4.0 * 1e-6 * 9.81
    assert frame.fields["force"] == pytest.approx(
        np.tile([0.0, weight], (60, 1)), abs=0.02 * weight
    )


# Frames that are cut off -------------------------------------------------------------------------


def test_later_frames_are_dropped_as_if_they_had_never_been(tmp_path):
    path, other = tmp_path / "some.vtkhdf", tmp_path / "other.vtkhdf"
    for k in range(9):
        vtkhdf.append(path, a_frame(k))
        if k < 5:
            vtkhdf.append(other, a_frame(k))
    vtkhdf.cut(path, 0.4)
    assert path.read_bytes() == other.read_bytes()
    vtkhdf.cut(path, 0.4)
    assert path.read_bytes() == other.read_bytes()
    vtkhdf.cut(path, -1.0)
    assert not path.exists()
    vtkhdf.cut(path, 0.0)  # nothing there, nothing done


def test_rows_without_a_count_do_no_harm(tmp_path):
    """A writer that was killed after the rows, before their count."""
    path = tmp_path / "some.vtkhdf"
    for k in range(4):
        vtkhdf.append(path, a_frame(k))
    with h5py.File(path, "a") as file:
        file["VTKHDF/Steps"].attrs.modify("NSteps", 3)
    assert len(vtkhdf.times(path)) == 3
    vtkhdf.append(path, a_frame(5))
    same(vtkhdf.read(path, 3), a_frame(5))
    same(vtkhdf.read(path, 2), a_frame(2))
    seen_by_vtk(path)


APPENDS = """
import sys
sys.path[:0] = [sys.argv[2]]
from pathlib import Path
from test_vtkhdf import a_frame
from grainmesh import vtkhdf
for k in range(10_000):
    vtkhdf.append(Path(sys.argv[1]), a_frame(k))
    print(k, flush=True)
"""


def test_a_writer_killed_at_any_moment_leaves_whole_frames(tmp_path):
    rng = np.random.default_rng(3)
    for number in range(3):
        path = tmp_path / f"{number}.vtkhdf"
        command = [sys.executable, "-c", APPENDS, str(path), os.path.dirname(__file__)]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as writer:
            writer.stdout.readline()
            time.sleep(rng.uniform(0.0, 0.2))
            writer.send_signal(signal.SIGKILL)
            told = writer.stdout.read().split()
        done = int(told[-1]) + 1 if told else 1
        count = len(vtkhdf.times(path))
        assert done <= count <= done + 1
        for k in range(count):
            same(vtkhdf.read(path, k), a_frame(k))
        vtkhdf.cut(path, np.inf)
        assert len(vtkhdf.times(path)) == count
        vtkhdf.append(path, a_frame(count))
        same(vtkhdf.read(path, -1), a_frame(count))
        seen_by_vtk(path)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("strace") is None, reason="strace kills at each system call")
def test_a_writer_killed_at_each_write_leaves_whole_frames(tmp_path):
    path, copy = tmp_path / "some.vtkhdf", tmp_path / "copy.vtkhdf"
    for k in range(2):
        vtkhdf.append(path, a_frame(k))
    code = APPENDS.replace("range(10_000)", "[2]")
    for number in range(1, 200):
        shutil.copy(path, copy)
        command = [
            "strace", "-f", "-qq", "-o", os.devnull, "-P", str(copy), "-e", "trace=pwrite64",
            "-e", f"inject=pwrite64:signal=SIGKILL:when={number}",
            sys.executable, "-c", code, str(copy), os.path.dirname(__file__),
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True).returncode == 0
        count = len(vtkhdf.times(copy))
        assert count in ((3,) if done else (2, 3))
        for k in range(count):
            same(vtkhdf.read(copy, k), a_frame(k))
        vtkhdf.cut(copy, 0.1)
        assert copy.read_bytes().rstrip(b"\0") == path.read_bytes().rstrip(b"\0")
        if done:
            break
    assert number > 5


@pytest.mark.parametrize("content", [b"", b"nothing", bytes(5000)])
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "some.vtkhdf"
    with pytest.raises(gm.InputError, match="no such file"):
        vtkhdf.read(path, 0)
    path.write_bytes(content)
    for act in (lambda: vtkhdf.read(path, 0), lambda: vtkhdf.append(path, a_frame(0))):
        with pytest.raises(gm.InputError, match=r"some\.vtkhdf"):
            act()
    with h5py.File(path, "w") as file:
        file["VTKHDF"] = 1
    with pytest.raises(gm.InputError, match="damaged"):
        vtkhdf.times(path)


def test_a_disk_that_is_full_is_told_in_one_line(tmp_path):
    path = tmp_path / "some.vtkhdf"
    code = """
import resource, sys
sys.path[:0] = [sys.argv[2]]
from pathlib import Path
from test_vtkhdf import a_frame
from grainmesh import vtkhdf
from grainmesh.errors import InputError
vtkhdf.append(Path(sys.argv[1]), a_frame(0))
size = Path(sys.argv[1]).stat().st_size + 150_000
resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
try:
    for k in range(1, 100):
        vtkhdf.append(Path(sys.argv[1]), a_frame(k))
except InputError as fault:
    print(k, fault)
"""
    command = [sys.executable, "-c", code, str(path), os.path.dirname(__file__)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "cannot be written" in done.stdout
    assert done.stdout.count("\n") == 1
    whole = int(done.stdout.split()[0])
    assert len(vtkhdf.times(path)) == whole
    for k in range(whole):
        same(vtkhdf.read(path, k), a_frame(k))
