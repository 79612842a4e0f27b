"""Fibres found in images: known truth, a real slice, and bad input."""

import json
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

import grainmesh as gm
from grainmesh import cli, fibres

REAL = Path(__file__).parents[2] / "shared/data/fibres"
MARGIN = 12


def picture(x, r, width, height, blur=1.0, noise=0.1, fine=4):
    """Discs of 1 on 0, areas of pixels to 1/16, blurred, with white noise; x (n, 2), y upwards."""
    columns = (np.arange((width + 2 * MARGIN) * fine) + 0.5) / fine - MARGIN
    rows = height + MARGIN - (np.arange((height + 2 * MARGIN) * fine) + 0.5) / fine
    solid = np.zeros((len(rows), len(columns)), bool)
    for (cx, cy), radius in zip(x, r, strict=True):
        i = np.flatnonzero(np.abs(rows - cy) < radius)
        j = np.flatnonzero(np.abs(columns - cx) < radius)
        near = (columns[j] - cx) ** 2 + (rows[i, None] - cy) ** 2 < radius**2
        solid[np.ix_(i, j)] |= near
    grey = solid.reshape(height + 2 * MARGIN, fine, width + 2 * MARGIN, fine).mean(axis=(1, 3))
    grey = gaussian_filter(grey, blur)[MARGIN:-MARGIN, MARGIN:-MARGIN]
    return grey + noise * np.random.default_rng(7).normal(size=grey.shape)


def medium(porosity, diameter, n=120, spread=0.2, seed=3):
    """A window (width, x, r) of a periodic random array; discs at its border are cut."""
    box, discs = gm.arrange.random(n, porosity=porosity, diameter=float(diameter), seed=seed)
    width = int(0.95 * box.width)
    shifts = box.width * np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 2)
    x = (discs.x + shifts[:, None]).reshape(-1, 2)
    r = 0.5 * diameter * np.random.default_rng(seed).uniform(1.0 - spread, 1.0, len(x))
    near = ((x > -r[:, None]) & (x < width + r[:, None])).all(axis=1)
    return width, x[near], r[near]


def matched(found, x, r):
    """Number of the disc found for each true one, -1 if there is none within half a radius."""
    distance, i = cKDTree(found.x).query(x)
    return np.where(distance < 0.5 * r, i, -1)


@pytest.mark.parametrize(
    ("porosity", "diameter", "blur", "noise", "worst"),
    [
        (0.5, 12, 1.0, 0.1, 0.06),
        (0.35, 12, 1.0, 0.1, 0.07),  # nearly all discs touch others
        (0.8, 12, 1.0, 0.1, 0.06),
        (0.5, 8, 0.8, 0.1, 0.06),
        (0.5, 20, 1.5, 0.1, 0.06),
        (0.5, 20, 1.0, 0.3, 0.12),
    ],
)
def test_centres_and_radii_of_known_discs(porosity, diameter, blur, noise, worst):
    width, x, r = medium(porosity, diameter)
    image = picture(x, r, width, width, blur, noise)
    found = fibres.find(image, diameter)
    assert found.bright
    assert found.size == (width, width)
    assert found.blur == pytest.approx(blur, rel=0.1)
    i = matched(found, x, r)
    inside = ((x > 0.0) & (x < width)).all(axis=1)
    whole = ((x > r[:, None]) & (x < width - r[:, None])).all(axis=1)
    assert (i[whole] >= 0).all()
    assert (i[inside] >= 0).mean() > 0.97
    assert len(set(i[i >= 0])) == len(found)  # nothing but true discs, each once
    error = found.x[i[whole]] - x[whole]
    assert np.sqrt((error**2).mean()) < worst  # of a coordinate [pixel]; the bound by noise is 0.8
    assert np.abs(error.mean(axis=0)).max() < 0.03
    wrong = found.radius[i[whole]] - r[whole]
    assert abs(wrong.mean()) < 0.03
    assert wrong.std() < worst + 0.03
    cut = inside & ~whole & (i >= 0)
    assert np.sqrt(((found.x[i[cut]] - x[cut]) ** 2).mean()) < 4.0 * worst


def test_dark_fibres_on_an_uneven_ground():
    width, x, r = medium(0.5, 12)
    grey = 1.0 - picture(x, r, width, width)
    slope = np.linspace(0.0, 1.0, width)
    found = fibres.find(grey + slope, (8, 14))
    assert not found.bright
    i = matched(found, x, r)
    whole = ((x > r[:, None]) & (x < width - r[:, None])).all(axis=1)
    assert (i[whole] >= 0).all()
    error = found.x[i[whole]] - x[whole]
    assert np.sqrt((error**2).mean()) < 0.12
    assert np.abs(error.mean(axis=0)).max() < 0.03  # a slope of the ground draws no disc along
    same = fibres.find(grey + slope, (8, 14), bright=False)
    assert np.array_equal(same.x, found.x)


def test_touching_pair_and_solid_fraction():
    x, r = np.array([[20.3, 20.0], [32.3, 20.0], [20.0, 45.6]]), np.array([6.0, 6.0, 5.0])
    found = fibres.find(picture(x, r, 60, 60, noise=0.02), 12)
    i = matched(found, x, r)
    assert sorted(i) == [0, 1, 2]
    assert np.abs(found.x[i] - x).max() < 0.05
    assert np.abs(found.radius[i] - r).max() < 0.05
    assert found.solid_fraction == pytest.approx((np.pi * r**2).sum() / 3600, rel=0.02)
    assert not found.at_edge.any()


def test_disc_cut_by_the_edge():
    x, r = np.array([[2.0, 30.0], [30.0, 30.0], [31.0, 59.0]]), np.full(3, 6.0)
    found = fibres.find(picture(x, r, 60, 60, noise=0.02), 12)
    i = matched(found, x, r)
    assert np.abs(found.x[i] - x).max() < 0.15
    assert found.at_edge[i].tolist() == [True, False, True]
    box, discs = found.particles(0.5e-6)
    assert box.size == pytest.approx([30e-6, 30e-6])
    assert np.allclose(discs.x, found.x * 0.5e-6)


def test_noise_is_no_fibre():
    for seed, diameter in ((0, 6), (1, 8), (2, 16)):
        noise = np.random.default_rng(seed).normal(size=(150, 150))
        with pytest.raises(gm.InputError, match="no fibre of diameter"):
            fibres.find(noise, diameter)


def test_fibres_tell_what_they_are():
    found = fibres.find(picture(np.array([[20.0, 20.0]]), np.array([6.0]), 40, 40), 12)
    assert "1 bright" in repr(found)
    assert "40 x 40 pixels" in repr(found)
    plain = json.loads(json.dumps(found.to_dict()))
    assert plain["n"] == 1
    assert plain["x"][0] == pytest.approx([20.0, 20.0], abs=0.3)


def test_command_writes_a_list_that_permeability_reads(tmp_path, capsys):
    width, x, r = medium(0.6, 12, n=60)
    grey = picture(x, r, width, width)
    image = tmp_path / "slice.png"
    colour = np.repeat(np.clip(60 + 120 * grey, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)
    Image.fromarray(colour).save(image)
    out = tmp_path / "found"
    arguments = ["fibres", str(image), "--diameter", "9,13", "--out", str(out)]
    assert cli.main([*arguments, "--pixel", "1e-6"]) == 0
    said = capsys.readouterr().out
    assert "bright" in said
    assert sorted(path.name for path in out.iterdir()) == ["fibres.csv", "fibres.png"]
    with Image.open(out / "fibres.png") as overlay:
        assert overlay.size == (1500, 1500)
    following = said.strip().splitlines()[-1].split()
    assert following[:2] == ["grainmesh", "permeability"]
    assert cli.main([*following[1:], "--method", "microstructure", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    true = (np.pi * r**2).sum() / (width + 2 * r.mean()) ** 2  # about: discs at the edge are cut
    assert 1.0 - result["porosity"] == pytest.approx(true, rel=0.1)
    assert cli.main([*arguments, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["n"] == result["n"]


@pytest.mark.parametrize(
    ("image", "options", "says"),
    [
        ("none.png", {}, "none.png: no such file"),
        ("text.png", {}, "no image that can be read"),
        ("cut.png", {}, "no image that can be read"),
        ("two.tif", {}, "holds 2 pictures"),
        ("flat.png", {}, "all pixels have the same value"),
        ("good.png", {"--diameter": "0"}, "positive number of pixels"),
        ("good.png", {"--diameter": "-4"}, "positive number of pixels"),
        ("good.png", {"--diameter": "nan"}, "positive number of pixels"),
        ("good.png", {"--diameter": "12,8"}, "the smaller one comes first"),
        ("good.png", {"--diameter": "a"}, "must be pixels"),
        ("good.png", {"--diameter": "2"}, "too small to be seen"),
        ("good.png", {"--diameter": "500"}, "does not fit into 60 x 40"),
        ("good.png", {"--diameter": "30"}, "no fibre of diameter"),
        ("good.png", {"--score": "2"}, "between 0 and 1"),
        ("good.png", {"--pixel": "0"}, "size in metres"),
        ("good.png", {"--pixel": "3"}, "size in metres"),
    ],
)
def test_bad_input_gives_one_line(image, options, says, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    grey = picture(np.array([[20.0, 20.0]]), np.array([6.0]), 60, 40, noise=0.01)
    good = Image.fromarray(np.clip(60 + 120 * grey, 0, 255).astype(np.uint8))
    good.save("good.png")
    Path("text.png").write_text("hello")
    Path("cut.png").write_bytes(Path("good.png").read_bytes()[:300])
    Image.new("L", (50, 50), 7).save("flat.png")
    good.save("two.tif", save_all=True, append_images=[good])
    given = {"--diameter": "12", "--out": "out"} | options
    status = cli.main(["fibres", image, *(word for pair in given.items() for word in pair)])
    captured = capsys.readouterr()
    assert status == 2
    assert captured.err.count("\n") == 1
    assert says in captured.err
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("array", "says"),
    [
        (np.zeros((0, 4)), "no pixels"),
        (np.zeros(5), "needs shape"),
        (np.zeros((4, 5, 6)), "needs shape"),
        (np.full((50, 50), np.nan), "not finite"),
        ([["a", "b"]], "array of numbers"),
    ],
)
def test_bad_arrays(array, says):
    with pytest.raises(gm.InputError, match=says):
        fibres.find(array, 5)


def test_an_image_too_large_to_open_is_refused(tmp_path):
    header = b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR" + struct.pack(
        ">II5B", 10**6, 10**6, 8, 0, 0, 0, 0
    )
    path = tmp_path / "bomb.png"
    path.write_bytes(header + b"\0" * 50)
    with pytest.raises(gm.InputError, match="no image that can be read"):
        fibres.read(path)


def test_missing_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "skimage.feature", None)
    with pytest.raises(gm.InputError, match=r"pip install -e '\.\[images\]'"):
        fibres.find(picture(np.array([[20.0, 20.0]]), np.array([6.0]), 40, 40), 12)


@pytest.mark.skipif(not REAL.exists(), reason="the slice of carbon fibres is not here")
def test_real_slice_against_its_list():
    left, top, side = 380, 360, 240
    grey = fibres.read(REAL / "carbon0918.png")[top : top + side, left : left + side]
    rows = np.genfromtxt(REAL / "carbon0918_fibres.csv", delimiter=",", names=True)
    x = np.stack([rows["x_px"] + 0.5 - left, top + side - 0.5 - rows["y_px"]], axis=1)
    r = rows["r_px"]
    inside = ((x > r[:, None]) & (x < side - r[:, None])).all(axis=1)
    found = fibres.find(grey, (7, 13))
    assert found.bright
    i = matched(found, x[inside], r[inside])
    assert (i >= 0).mean() > 0.95
    well = i >= 0
    error = np.hypot(*(found.x[i[well]] - x[inside][well]).T)
    assert np.median(error) < 0.35  # the list itself is known to some 0.4
    known = cKDTree(x).query(found.x)[0] < 2.5
    assert known.mean() > 0.93
