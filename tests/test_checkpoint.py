"""Checkpoints: what is read is what was written, or is refused in one line."""

import json
import os
import warnings
from contextlib import suppress
from dataclasses import replace
from hashlib import sha256

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import grainmesh as gm
from grainmesh import checkpoint

BOX = gm.Box(1.0, 1.0)
LAW = gm.Contact(1e6, friction=0.4, rolling=0.1)


def a_run(folder, **kind):
    """A few discs, with a history, contacts and a moving wall, in a file."""
    rng = np.random.default_rng(0)
    walls = (
        gm.Wall.of(BOX, "bottom", amplitude=(0.0, 0.01), frequency=10.0, friction=0.9),
        gm.Wall((0.2, 0.3), (0.7, 0.4), velocity=(0.01, 0.0)),
    )
    model = gm.Model(BOX, LAW, walls=walls, **{"open": ("top",), "escape": "remove", **kind})
    particles = gm.relax(model, gm.Particles(rng.uniform(0, 1, (12, 2)), 0.12))
    simulation = gm.Simulation(model, particles, rng.normal(0, 1, (12, 2)), ledger=True)
    return simulation.run(0.2, every=0.05, save=folder)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    a_run(folder)
    return folder


def all_of(simulation):
    """The whole state, private parts too, as bytes and text."""
    mesh = simulation._mesh
    arrays = [
        *(getattr(simulation, "_" + name) for name in ("s", "p", "slot", "rank", "moved", "seen")),
        simulation._books, simulation._law, simulation._walls,
        *simulation._pairs, *simulation._touch,
        mesh.points, mesh.weight, mesh.triangles, mesh.neighbours, mesh.shifts,
    ]  # fmt: skip
    numbers = simulation.model, simulation.step, simulation.dt, simulation.history
    counts = simulation.upkeeps, simulation.sorted, mesh.flips, mesh.inverted, mesh.made
    return [(a.dtype, a.shape, a.tobytes()) for a in arrays], numbers, counts, simulation.about


def test_all_is_read_as_it_was_written(tmp_path):
    simulation = a_run(tmp_path / "some" / "new folder")
    again = gm.resume(tmp_path / "some" / "new folder")
    assert all_of(again) == all_of(simulation)
    assert again.history[-1] == again.measure()
    again.save(tmp_path)
    assert all_of(gm.resume(tmp_path)) == all_of(simulation)
    left = sorted(path.name for path in (tmp_path / "some" / "new folder").iterdir())
    assert left == [checkpoint.NAME, checkpoint.OLD]


def test_what_the_user_adds_is_kept(tmp_path):
    simulation = a_run(tmp_path)
    simulation.about["until"] = 0.1 + 0.2
    simulation.save(tmp_path)
    assert gm.resume(tmp_path).about == {"until": 0.1 + 0.2}


def test_versions_are_in_the_file(folder):
    with h5py.File(folder / checkpoint.NAME) as file:
        found = json.loads(file["versions"][()])
    assert found == checkpoint.versions()
    assert found["numpy"] == np.__version__


def test_numbers_of_the_model_keep_all_their_digits(tmp_path):
    gravity = (0.1 + 0.2, -np.pi)
    force = np.random.default_rng(0).normal(size=(12, 2)) * 1e-3
    simulation = a_run(tmp_path, gravity=gravity, force=force, open=("left", "top"), dt=1e-5 / 3)
    again = gm.resume(tmp_path)
    assert again.model.gravity == gravity
    assert (np.asarray(again.model.force) == force).all()
    assert again.model == replace(simulation.model, force=again.model.force)


def test_a_file_is_replaced_only_once_the_new_one_is_whole(tmp_path, monkeypatch):
    simulation = a_run(tmp_path)
    before, files = (tmp_path / checkpoint.NAME).read_bytes(), len(list(tmp_path.iterdir()))

    def full(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr(checkpoint.os, "replace", full)
    with pytest.raises(gm.InputError, match=r"cannot be written \(no space left"):
        simulation.run(0.25).save(tmp_path)
    assert (tmp_path / checkpoint.NAME).read_bytes() == before
    assert len(list(tmp_path.iterdir())) == files
    monkeypatch.undo()
    assert gm.resume(tmp_path).step < simulation.step


def test_a_folder_that_cannot_be_is_refused(tmp_path):
    (tmp_path / "file").write_text("here is a file")
    with pytest.raises(gm.InputError, match="cannot be written"):
        a_run(tmp_path / "file" / "folder")


# The one before ----------------------------------------------------------------------------------


def test_the_one_before_is_kept_and_taken_if_the_last_is_damaged(tmp_path):
    simulation = a_run(tmp_path)
    first = all_of(simulation)
    simulation.run(0.25, save=tmp_path)
    simulation.save(tmp_path)
    (tmp_path / checkpoint.OLD).unlink()
    again = gm.resume(tmp_path).run(0.3)
    again.save(tmp_path)
    last, before = (tmp_path / name for name in (checkpoint.NAME, checkpoint.OLD))
    assert all_of(gm.resume(tmp_path)) == all_of(again)
    assert all_of(gm.resume(before)) == all_of(simulation) != first
    last.write_bytes(last.read_bytes()[:-1])
    with pytest.warns(UserWarning, match="checkpoint.h5: damaged .* the one before") as told:
        other = gm.resume(tmp_path)
    assert "\n" not in str(told[0].message)
    assert all_of(other) == all_of(simulation)
    # A damaged one does not push out the good one.
    good = before.read_bytes()
    other.run(0.3).save(tmp_path)
    assert before.read_bytes() == good
    assert all_of(gm.resume(tmp_path)) == all_of(again)


def test_a_kill_between_the_two_renames_loses_nothing(tmp_path, monkeypatch):
    simulation = a_run(tmp_path)
    rename, calls = os.replace, []

    def once(*names):
        if calls:
            raise SystemExit
        calls.append(names)
        rename(*names)

    monkeypatch.setattr(checkpoint.os, "replace", once)
    with pytest.raises(SystemExit):
        simulation.save(tmp_path)
    assert not (tmp_path / checkpoint.NAME).exists()
    with pytest.warns(UserWarning, match="no such file"):
        again = gm.resume(tmp_path)
    assert all_of(again) == all_of(simulation)


def test_two_damaged_ones_are_refused(folder, tmp_path):
    content = (folder / checkpoint.NAME).read_bytes()
    for name in (checkpoint.NAME, checkpoint.OLD):
        (tmp_path / name).write_bytes(content[:-1])
    assert "checkpoint.h5: damaged" in refusal(tmp_path)


def test_another_format_is_refused_even_beside_an_older_file(folder, tmp_path):
    content = (folder / checkpoint.NAME).read_bytes()
    data = content[checkpoint.BLOCK :]
    (tmp_path / checkpoint.OLD).write_bytes(content)
    (tmp_path / checkpoint.NAME).write_bytes(
        checkpoint._head(data, "grainmesh checkpoint 9") + data
    )
    assert "is a grainmesh checkpoint 9, and this version of grainmesh reads 3" in refusal(tmp_path)


# Damage ------------------------------------------------------------------------------------------


def refusal(folder, **kind):
    with pytest.raises(gm.InputError) as error:
        gm.resume(folder, **kind)
    line = str(error.value)
    assert "\n" not in line
    assert str(folder) in line
    return line


def damaged(folder, tmp_path, change):
    """A copy of a checkpoint, of changed bytes."""
    content = bytearray((folder / checkpoint.NAME).read_bytes())
    (tmp_path / checkpoint.NAME).write_bytes(change(content))
    return tmp_path


def test_a_folder_without_a_checkpoint_is_refused(tmp_path):
    assert "no such file" in refusal(tmp_path)
    assert "no such file" in refusal(tmp_path / "nowhere")
    (tmp_path / checkpoint.NAME).mkdir()
    assert "no such file" in refusal(tmp_path)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.7, 0.99, 0.9999])
def test_a_file_cut_short_is_refused(folder, tmp_path, share):
    damaged(folder, tmp_path, lambda content: content[: int(share * len(content))])
    assert "damaged or not a checkpoint" in refusal(tmp_path)


def test_a_file_of_something_else_is_refused(tmp_path):
    (tmp_path / checkpoint.NAME).write_bytes(b"\x89PNG and so on")
    assert "damaged or not a checkpoint" in refusal(tmp_path)
    with h5py.File(tmp_path / checkpoint.NAME, "w") as file:
        file["model"] = 1.0
    assert "damaged or not a checkpoint" in refusal(tmp_path)


def test_any_flipped_bit_is_refused(folder, tmp_path):
    size = (folder / checkpoint.NAME).stat().st_size
    rng = np.random.default_rng(0)
    for place in [0, size - 1, *rng.integers(size, size=200).tolist()]:

        def flip(content, place=place):
            content[place] ^= 1 << int(rng.integers(8))
            return content

        damaged(folder, tmp_path, flip)
        assert "damaged or not a checkpoint" in refusal(tmp_path)


def test_a_part_that_is_missing_is_refused(folder, tmp_path):
    model, numbers, arrays = checkpoint.read(folder)
    for name in "state/s", "pairs/history", "mesh/triangles":
        less = {key: value for key, value in arrays.items() if key != name}
        checkpoint.write(tmp_path, model, numbers, less)
        assert "incomplete" in refusal(tmp_path)
    fewer = {key: value for key, value in numbers.items() if key != "dt"}
    checkpoint.write(tmp_path, model, fewer, arrays)
    assert "incomplete" in refusal(tmp_path)


def test_a_model_that_makes_no_sense_is_refused(folder, tmp_path):
    model, numbers, arrays = checkpoint.read(folder)
    object.__setattr__(model.contact, "stiffness", -1.0)
    checkpoint.write(tmp_path, model, numbers, arrays)
    assert "stiffness = -1 must be positive" in refusal(tmp_path)


def test_a_force_that_is_a_function_must_be_given_again(tmp_path):
    def force(t, x, v):
        return -0.1 * v

    simulation = a_run(tmp_path, force=force)
    assert "give the force" in refusal(tmp_path)
    again = gm.resume(tmp_path, force=force)
    assert all_of(again) == all_of(simulation)
    assert (again.run(0.3).x == simulation.run(0.3).x).all()


def test_a_force_that_was_no_function_cannot_become_one(folder):
    assert "drop force" in refusal(folder, force=lambda t, x, v: 0.0 * x)


def test_nothing_in_the_file_is_executed(folder):
    # Numbers and text: no pickled objects.
    with h5py.File(folder / checkpoint.NAME) as file:
        kinds = []
        file.visititems(lambda name, item: kinds.append(getattr(item, "dtype", None)))
        texts = json.loads(file["model"][()]), json.loads(file["numbers"][()])
    assert all(isinstance(text, dict) for text in texts)
    kinds = [kind.kind for kind in kinds if kind is not None]
    assert set(kinds) <= {"f", "i", "u", "O"}
    assert kinds.count("O") == 3  # the texts


# Fuzz --------------------------------------------------------------------------------------------


@st.composite
def damage(draw):
    """What is done to the bytes of a checkpoint."""
    kind = draw(st.sampled_from(["cut", "flip", "fill", "insert", "other"]))
    share, bits = draw(st.floats(0.0, 1.0, exclude_max=True)), draw(st.binary(min_size=1))

    def apply(content):
        at = int(share * len(content))
        if kind == "cut":
            return content[:at]
        if kind == "flip":
            return content[:at] + bytes([content[at] ^ (bits[0] or 1)]) + content[at + 1 :]
        if kind == "fill":
            return content[:at] + bits + content[at + len(bits) :]
        return content[:at] + bits + content[at:] if kind == "insert" else bits

    return apply


def refused_or_the_same(folder, tmp, change):
    content = (folder / checkpoint.NAME).read_bytes()
    changed = change(content)
    (tmp / checkpoint.NAME).write_bytes(changed)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if changed == content:
            gm.resume(tmp)
        else:
            refusal(tmp)


@given(change=damage())
@settings(max_examples=200, deadline=None)
def test_fuzzed_files_are_refused(folder, tmp_path_factory, change):
    refused_or_the_same(folder, tmp_path_factory.getbasetemp(), change)


@pytest.mark.slow
@given(change=damage())
@settings(max_examples=600, deadline=None)
def test_many_fuzzed_files_are_refused(folder, tmp_path_factory, change):
    refused_or_the_same(folder, tmp_path_factory.getbasetemp(), change)


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=5,
)


@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_sound_files_with_other_texts_are_read_or_refused(folder, tmp_path_factory, data):
    """A file that someone has made: its checksum is right, its content anything."""
    tmp = tmp_path_factory.getbasetemp()
    part = data.draw(st.sampled_from(["model", "numbers"]))
    memory = tmp / "memory.h5"
    memory.write_bytes((folder / checkpoint.NAME).read_bytes())
    with h5py.File(memory, "a") as file:
        text = json.loads(file[part][()])
        key = data.draw(st.sampled_from(sorted(text)))
        text[key] = data.draw(values)
        del file[part]
        file[part] = json.dumps(text)
    content = memory.read_bytes()[checkpoint.BLOCK :]
    head = f"{checkpoint.FORMAT}\nsha256 {sha256(content).hexdigest()}\n".encode()
    (tmp / checkpoint.NAME).write_bytes(head.ljust(checkpoint.BLOCK, b"\0") + content)
    with suppress(gm.InputError):
        gm.resume(tmp)
