"""The viewer: what is sent to the browser is what is in the frames, and a browser shows it."""

import os
import signal
import subprocess
import sys
from shutil import copyfile

import matplotlib
import numpy as np
import pytest

import browser
import grainmesh as gm
from grainmesh import viewer, vtkhdf
from grainmesh.cli import main

pytest.importorskip("pyvista", reason="needs the extra view")
pytest.importorskip("trame_vuetify", reason="needs the extra view")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("view") / "bed"
    folder.mkdir()
    box = gm.Box(0.006, 0.01)
    grains = gm.arrange.loose(box, 20, diameter=1e-3, density=2500, seed=1)
    model = gm.Model(
        box, gm.Contact(stiffness=1e4), gravity=(0.0, -9.81), fluid=gm.Fluid(1000.0, 0.01, order=1)
    )

    def observe(run):
        vtkhdf.append(folder / vtkhdf.FLOW, vtkhdf.flow(run))
        vtkhdf.append(folder / vtkhdf.DISCS, vtkhdf.discs(run))

    gm.Simulation(model, grains).run(until=0.02, every=0.004, observe=observe)
    return folder


@pytest.fixture
def served(folder):
    """The address that `grainmesh show` prints, and its process."""
    command = [sys.executable, "-m", "grainmesh", "show", str(folder)]
    environment = {k: v for k, v in os.environ.items() if k != "DISPLAY"}
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    )
    try:
        yield process.stdout.readline().strip(), process
    finally:
        process.kill()
        process.wait()


def test_surfaces_are_the_frames(folder):
    frames = viewer.Frames(folder)
    assert len(frames.times) == 5
    assert frames.size == pytest.approx(0.01)
    flow, discs = frames.flow(-1), frames.discs(-1)
    for show in ("speed", "pressure", "porosity"):
        mesh = viewer.surface(flow, show, frames.size)
        np.testing.assert_allclose(mesh.points[:, :2] * frames.size, flow.points, atol=1e-9)
        np.testing.assert_array_equal(mesh.regular_faces, flow.triangles)
        value = np.hypot(*flow.fields["velocity"].T) if show == "speed" else flow.fields[show]
        np.testing.assert_allclose(mesh["value"], value, rtol=1e-6)
    mesh = viewer.polygons(discs, "force", frames.size)
    assert mesh.n_cells == len(discs.points) == 20
    middle = mesh.points.reshape(20, -1, 3).mean(axis=1)[:, :2] * frames.size
    np.testing.assert_allclose(middle, discs.points, atol=1e-8)
    radius = np.sqrt(mesh.compute_cell_sizes()["Area"] / np.pi) * frames.size
    np.testing.assert_allclose(radius, discs.fields["radius"], rtol=0.01)
    force = np.hypot(*discs.fields["force"].T)
    np.testing.assert_allclose(mesh["value"].reshape(20, -1)[:, 0], force, rtol=1e-6)


def test_one_scale_serves_all_frames(folder):
    frames = viewer.Frames(folder)
    low, high = viewer.ends(frames.flow, 5, "speed")
    most = max(viewer.field(frames.flow(k), "speed").max() for k in range(5))
    assert low == 0.0
    assert 0.3 * most < high <= most
    low, high = viewer.ends(frames.flow, 5, "porosity")
    assert 0.0 < low < high <= 1.0


def test_what_cannot_be_shown_is_refused_in_one_line(folder, tmp_path, capsys, monkeypatch):
    assert main(["show", str(tmp_path)]) == 2
    assert "name the folder of a run" in capsys.readouterr().err
    (tmp_path / vtkhdf.DISCS).write_bytes(b"nonsense")
    assert main(["show", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    monkeypatch.setattr(viewer, "NEEDED", ("no_such_package",))
    assert main(["show", str(folder)]) == 2
    error = capsys.readouterr().err
    assert "no_such_package" in error
    assert "pip install -e '.[view]'" in error


def test_of_a_permeability_the_picture_is_named(tmp_path, capsys):
    (tmp_path / "permeability.png").write_bytes(b"")
    assert main(["show", str(tmp_path)]) == 0
    assert capsys.readouterr().out.strip() == (tmp_path / "permeability.png").as_uri()


def test_a_taken_port_is_told(folder, served, capsys):
    port = served[0].split(":")[2].split("/")[0]
    command = [sys.executable, "-m", "grainmesh", "show", str(folder), "--port", port]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert done.returncode == 2
    assert f"port {port}" in done.stderr
    assert done.stderr.count("\n") == 1


@browser.needed
def test_a_browser_shows_the_frames_without_network_and_without_errors(folder, served, tmp_path):
    address, process = served
    assert address.startswith("http://127.0.0.1:")
    pause = "new Promise(done => setTimeout(() => done({}), 1500))"
    seen = browser.visit(
        address,
        "document.querySelector('.v-slider') !== null",
        "trame.state.set('show', 'pressure')",
        "trame.state.set('colour', 'force')",
        "trame.state.set('edges', true)",
        "trame.state.set('k', 1)",
        pause.format("document.querySelector('.v-application').innerText"),
        "trame.state.set('playing', true)",
        pause.format("trame.state.get('k')"),
        "trame.state.set('playing', false)",
        wait="document.querySelector('canvas') && window.trame",
        picture=tmp_path / "view.png",
    )
    assert seen.errors == []
    assert all(url.startswith(address.split("/index")[0]) for url in seen.requests)
    assert seen.values[0]
    text, now = seen.values[5], f"{vtkhdf.times(folder / vtkhdf.DISCS)[1]:.4g} s"
    for word in ("pressure of the fluid", "Pa", "force of the discs", "N/m", now):
        assert word in text
    shot = matplotlib.image.imread(tmp_path / "view.png")[..., :3]
    coloured = np.ptp(shot, axis=2) > 0.15  # the flow and the discs, on white
    assert coloured.mean() > 0.1
    process.send_signal(signal.SIGINT)
    assert process.wait(20) in (0, 130)
    assert "Traceback" not in process.stderr.read()


def test_frames_are_read_as_they_come(folder, tmp_path):
    """A run without fluid has discs only."""
    copyfile(folder / vtkhdf.DISCS, tmp_path / vtkhdf.DISCS)
    frames = viewer.Frames(tmp_path)
    assert not frames.wet
    assert 0.0 < frames.size < 0.01
