"""The figures of the paper: what is in their numbers."""

import csv

import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")

import grainmesh as gm
from grainmesh import paper
from grainmesh.cells import cells


def read(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("# made by: grainmesh paper")
    return list(csv.DictReader(line for line in lines if not line.startswith("#")))


def test_fig1(tmp_path):
    stages = []
    paper.fig1(tmp_path / "new", quick=True, progress=stages.append)
    (row,) = read(tmp_path / "new" / "fig1.csv")
    n, walls = int(row["discs"]), int(row["wall_nodes"])
    # Euler: a triangulation of n points inside and b on the boundary.
    assert int(row["triangles"]) == 2 * n + walls - 2
    assert float(row["porosity"]) == pytest.approx(0.6, abs=1e-9)
    # Close to each other for random discs, and both measures of the gap in units of d.
    assert float(row["gamma"]) == pytest.approx(float(row["gamma_second"]), rel=0.15)
    assert 0.0 < float(row["smallest_angle_deg"]) < float(row["mean_smallest_angle_deg"]) < 60.0
    assert float(row["largest_angle_deg"]) < 180.0 - 2 * float(row["smallest_angle_deg"]) + 1e-9
    assert stages
    assert sorted(p.name for p in (tmp_path / "new").iterdir()) == ["fig1.csv", "fig1.png"]


@pytest.mark.parametrize("porosity", [0.5, 0.9])
def test_window_keeps_the_medium(porosity):
    """Solid inside the walls is that of the cell; every image that a wall cuts is there."""
    cell, discs = gm.arrange.random(30, porosity=porosity, diameter=1.0, min_gap=0.05, seed=2)
    box, cut = paper._window(cell, discs)
    assert not box.periodic
    assert cells(box, cut).solid.sum() == pytest.approx((1 - porosity) * box.area, rel=1e-9)
    wrapped = np.mod(cut.x, cell.size)
    distance = np.linalg.norm(cell.separation(wrapped[:, None], discs.x), axis=-1)
    assert distance.min(axis=1).max() < 1e-9


def test_fitted_law_gives_the_resolved_permeability():
    box, discs = gm.arrange.random(20, porosity=0.7, diameter=2.0, min_gap=0.1, seed=4)
    law = paper._fitted(box, discs)
    exact = gm.permeability(box, discs, "resolved", order=paper.ORDER)
    value = gm.permeability(box, discs, "microstructure", law=law)
    assert value.tensor[0, 0] == pytest.approx(exact.tensor[0, 0], rel=1e-9)


def test_diameter_fills_the_channel():
    for n, porosity in ((100, 0.4), (200, 0.9)):
        d = paper._diameter(n, porosity)
        assert n * np.pi / 4 * d**2 / paper.HEIGHT**2 == pytest.approx(1 - porosity)


@pytest.mark.slow
def test_fig2(tmp_path):
    paper.fig2(tmp_path, quick=True)
    rows = read(tmp_path / "fig2.csv")

    def pick(array, kernel, order="2"):
        return {
            (r["porosity"], r["sample"], r["C"]): (float(r["ratio"]), float(r["U"]))
            for r in rows
            if (r["array"], r["kernel"], r["order"]) == (array, kernel, order)
        }

    # The hat kernel is right and does not depend on the order; the delta kernel is and does not.
    hat, finer = pick("ordered", "hat"), pick("ordered", "hat", "4")
    for key, (ratio, U) in hat.items():
        assert ratio == pytest.approx(1.0, abs=0.08)
        assert finer[key][1] == pytest.approx(U, rel=0.05)
    delta, finer = pick("ordered", "delta"), pick("ordered", "delta", "4")
    for key, (ratio, U) in delta.items():
        assert ratio > 3.0
        assert finer[key][1] > 1.2 * U
    for (_, _, C), (ratio, _) in pick("random", "hat").items():
        assert 0.5 < ratio < 1.5, C
    # U = G K / mu, so the flow grows with porosity in every array.
    for array in ("ordered", "random"):
        truth = [
            (float(r["porosity"]), float(r["U"]))
            for r in rows
            if r["array"] == array and not r["kernel"]
        ]
        levels = sorted({p for p, _ in truth})
        mean = [np.mean([U for p, U in truth if p == level]) for level in levels]
        assert (np.diff(mean) > 0).all()
        assert 1e-7 < mean[0] < mean[-1] < 1e-2


def test_fig3(tmp_path):
    paper.fig3(tmp_path, quick=True)
    rows = read(tmp_path / "fig3.csv")
    t, y, v = (np.array([float(r[name]) for r in rows]) for name in ("t", "y", "v"))
    assert {r["triangles"] for r in rows} == {"12"}
    # The velocity is that of the centre, and starts as free fall of (1 - rho_f/rho_p) g.
    np.testing.assert_allclose(
        np.diff(y), np.diff(t) * 0.5 * (v[1:] + v[:-1]), rtol=0.05, atol=1e-4
    )
    assert 0.6 * paper.SIDE - 0.17 * t[-1] < y[-1] < 0.6 * paper.SIDE
    # It approaches the speed of the law, 0.169 m/s, with its relaxation time, and stays there.
    assert v[0] == 0.0
    assert (np.diff(v[t < 0.2]) < 0.0).all()
    np.testing.assert_allclose(-v[t > 0.3], paper.SETTLED, rtol=0.03)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["fig3.csv", "fig3.png"]
