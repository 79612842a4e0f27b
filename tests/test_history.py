"""Histories as tables: every number has a unit, and a file holds what was written."""

import numpy as np
import pytest

import grainmesh as gm
from grainmesh import history

WATER = gm.Fluid(1000.0, 1e-3, dt=0.002)
CONTACT = gm.Contact(1e4, friction=0.3, rolling=0.1)


def falling(ledger=False, fluid=None, **box):
    box = gm.Box(0.008, 0.016)
    grains = gm.arrange.loose(box, 30, diameter=(0.8e-3, 1.2e-3), density=2500, seed=1)
    return gm.Simulation(gm.Model(box, CONTACT, fluid=fluid), grains, ledger=ledger)


PROBES = [[0.004, 0.008], [0.004, 0.0], [0.5, 0.5]]


@pytest.fixture(scope="module")
def dry():
    run = falling(ledger=True)
    run.run(0.1, every=0.01, observe=lambda run: run.history[-1].update(history.more(run)))
    return run


@pytest.fixture(scope="module")
def wet():
    run = falling(fluid=WATER)

    def observe(run):
        run.history[-1] |= history.more(run, PROBES)

    return run.run(0.02, every=0.005, observe=observe)


@pytest.mark.parametrize("kind", ["dry", "wet"])
def test_every_number_is_in_the_table_with_unit_and_meaning(kind, request):
    run = request.getfixturevalue(kind)
    table = history.table(run, PROBES if kind == "wet" else ())
    assert (table.t == [row["t"] for row in run.history]).all()
    for name in run.history[0]:
        if not name.startswith("probe") and name != "t":
            values = table[name.replace(" ", "_")]
            assert (values == [row[name] for row in run.history]).all()
    for name, variable in table.variables.items():
        assert variable.attrs["units"], name
        assert variable.attrs["long_name"] != name
    known = {name for name in table.variables if not name.startswith("probe")} - {"t"}
    assert known <= history.MEANING.keys()


def test_a_table_of_a_plain_simulation_needs_nothing_else():
    run = falling().run(0.01, every=0.005)
    assert list(history.table(run).t) == [row["t"] for row in run.history]
    assert history.table(run.history).identical(history.table(run))


def test_momentum_is_that_of_free_fall():
    x = [[0.002, 0.01], [0.004, 0.012], [0.006, 0.011]]
    grains = gm.Particles(x, [1e-3, 0.8e-3, 1.2e-3], 2500.0)
    run = gm.Simulation(gm.Model(gm.Box(0.008, 0.016), CONTACT), grains).run(0.01)
    m = 2500.0 * np.pi / 4.0 * run.particles.diameter**2
    found = history.more(run)
    assert found["momentum y"] == pytest.approx(-9.81 * run.t * m.sum(), rel=1e-9)
    assert found["momentum x"] == pytest.approx(0.0, abs=1e-12)
    assert found["bed height"] == pytest.approx(2.0 * (m * run.x[:, 1]).sum() / m.sum(), rel=1e-12)


def test_residuals_are_small_and_not_nothing(dry, wet):
    energy = history.table(dry).energy_residual
    assert energy[0] == 0.0
    assert 0.0 < energy.max() < 1e-4
    assert history.table(wet, PROBES).volume_residual.max() < 1e-12


def test_pressure_drop_is_the_difference_of_the_sides(wet):
    table = history.table(wet, PROBES)
    assert (table.pressure_drop_y == table.pressure_bottom - table.pressure_top).all()
    assert table.pressure_drop_y.units == "Pa"
    # Grains that fall steadily hang on the fluid: their weight, less buoyancy, over the width.
    weight = 1500.0 * 9.81 * np.pi / 4.0 * (wet.particles.diameter**2).sum() / 0.008
    assert 0.2 * weight < table.pressure_drop_y[-1] < 1.2 * weight


def test_probes_see_the_flow_at_their_place(wet):
    table = history.table(wet, PROBES)
    assert table.probe_velocity_y.dims == ("t", "probe")
    assert (table.probe_x == [0.004, 0.004, 0.5]).all()
    assert np.isnan(table.probe_pressure[:, 2]).all()
    assert np.isfinite(table.probe_pressure[:, :2]).all()
    assert abs(table.probe_velocity_y[:, 1]).max() == pytest.approx(0.0, abs=1e-12)  # wall
    sample = wet.flow.sample()
    k = int(np.argmin(np.hypot(*(sample.points - [0.004, 0.008]).T)))
    at = history.more(wet, [sample.points[k]])
    assert at["probe 0 velocity x"] == pytest.approx(sample.velocity[k, 0], rel=1e-9)
    assert at["probe 0 velocity y"] == pytest.approx(sample.velocity[k, 1], rel=1e-9)
    assert at["probe 0 pressure"] == pytest.approx(sample.pressure[k], rel=1e-9)


@pytest.mark.parametrize("bad", [[1.0, 2.0], [[1.0]], [[np.nan, 0.0]], "here", [[1.0, 2.0], [1.0]]])
def test_probes_that_are_no_places_are_refused(bad):
    with pytest.raises(gm.InputError, match="probes must be places"):
        history.places(bad)


def test_a_file_holds_the_table(wet, tmp_path):
    table = history.table(wet, PROBES)
    history.write(tmp_path / history.NAME, table)
    assert history.read(tmp_path).identical(table)
    assert history.read(tmp_path / history.NAME).identical(table)
    assert [path.name for path in tmp_path.iterdir()] == [history.NAME]


def test_files_that_are_none_are_refused(tmp_path):
    with pytest.raises(gm.InputError, match="no such file"):
        history.read(tmp_path)
    for content in (b"", b"\x89HDF\r\n\x1a\n", bytes(3000)):
        (tmp_path / history.NAME).write_bytes(content)
        with pytest.raises(gm.InputError, match="damaged or no history"):
            history.read(tmp_path)
    with pytest.raises(gm.InputError, match="cannot be written"):
        history.write(tmp_path / "nowhere" / history.NAME, history.table(falling().run(1e-4)))
