"""A run that is killed again and again, and resumed, ends as if it had never been."""

import os
import signal
import time

import numpy as np
import pytest

import grainmesh as gm
from grainmesh import checkpoint, history, record, vtkhdf

PLAN = {"until": 0.06, "every": 0.004, "frames": 0.006, "probes": [[0.004, 0.002]]}


def a_run():
    """Grains that settle in water, with collisions: some 40 steps of the flow."""
    box = gm.Box(0.008, 0.016)
    grains = gm.arrange.loose(box, 30, diameter=1e-3, density=2500, seed=1)
    fluid = gm.Fluid(1000.0, 1e-3, dt=0.002)
    model = gm.Model(box, gm.Contact(1e4, friction=0.3), fluid=fluid)
    return gm.Simulation(model, grains)


@pytest.fixture(autouse=True, scope="module")
def often():
    """Checkpoints and history at each mark, however long they take."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(record, "SHARE", {"checkpoint": 100.0, "history": 100.0})
        yield


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The folder of the run that nobody disturbs, and how long it takes."""
    folder = tmp_path_factory.mktemp("kill") / "undisturbed"
    record.record(a_run(), folder.parent / "compiled", **PLAN | {"until": 0.004})
    record.resume(folder.parent / "compiled", 0.008)
    began = time.perf_counter()
    record.record(a_run(), folder, **PLAN)
    return folder, time.perf_counter() - began


def go_on(folder):
    """Begin the run in a folder, or resume it."""
    if (folder / checkpoint.NAME).exists() or (folder / checkpoint.OLD).exists():
        record.resume(folder)
    else:
        record.record(a_run(), folder, **PLAN)


def killed(folder, after):
    """Whether a process that goes on with the run was killed before it came to its end."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            go_on(folder)
            status = 0
        finally:
            os._exit(status)
    time.sleep(after)
    os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0, "resume failed"
    return os.WIFSIGNALED(status)


def same_files(one, other):
    """All that runs leave is the same, bit by bit."""
    assert (one / checkpoint.NAME).read_bytes() == (other / checkpoint.NAME).read_bytes()
    assert history.read(one).identical(history.read(other))
    for name in (vtkhdf.FLOW, vtkhdf.DISCS):
        times = vtkhdf.times(one / name)
        assert (times == vtkhdf.times(other / name)).all()
        for k in range(len(times)):
            a, b = (vtkhdf.read(folder / name, k) for folder in (one, other))
            assert a.points.tobytes() == b.points.tobytes()
            assert {k: v.tobytes() for k, v in a.fields.items()} == {
                k: v.tobytes() for k, v in b.fields.items()
            }
            assert (np.array(a.triangles) == np.array(b.triangles)).all()


def kill(undisturbed, tmp_path, times, seed):
    """Kill a run so many times at random moments; each that comes to its end is compared."""
    folder, lasts = undisturbed
    rng, kills, number = np.random.default_rng(seed), 0, 0
    while kills < times:
        number += 1
        while kills < times and killed(
            tmp_path / f"{number}", rng.uniform(0.0, 2.0 * lasts / min(times, 5))
        ):
            kills += 1
        go_on(tmp_path / f"{number}")
        same_files(folder, tmp_path / f"{number}")


def test_a_run_killed_three_times_is_the_same(undisturbed, tmp_path):
    kill(undisturbed, tmp_path, 3, 0)


@pytest.mark.slow
def test_a_run_killed_twenty_times_is_the_same(undisturbed, tmp_path):
    kill(undisturbed, tmp_path, 20, 1)
