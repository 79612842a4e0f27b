"""What `check` foretells, against exact numbers and against runs; what it finds off."""

import json
import warnings
from math import pi, sqrt

import numpy as np
import pytest

import grainmesh as gm
from grainmesh import case, cli
from grainmesh.preview import preview
from test_case import SMALL, STARTERS

#: A sphere's law in a sheet 1 m deep: b = 3 pi mu d, whatever the porosity.
SLOW = ("fluid.viscosity=100", "fluid.drag=stokes", "fluid.depth='1 m'", "fluid.spacing=1e-3")


def told(text, *changes):
    found = preview(case.parse(text, "c.toml", changes))
    return {n.name: n.value for n in found.numbers}, found.reasons


@pytest.mark.parametrize("name", STARTERS)
def test_starters_check_clean(name, tmp_path, capsys):
    path = tmp_path / "c.toml"
    path.write_text(STARTERS[name])
    assert cli.main(["check", str(path), "--json"]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert err == ""
    assert found["reasons"] == []
    assert set(found["units"]) == set(found["numbers"])
    assert 0.1 < found["numbers"]["porosity"] < 1.0
    assert 0.5 < found["numbers"]["run time"] < 300.0
    assert 100.0 < found["numbers"]["memory"] < 2000.0


def test_regime_of_slow_discs_is_exact():
    numbers, reasons = told(SMALL, *SLOW)
    d, mu, rho, excess, g = 1e-3, 100.0, 1000.0, 1500.0, 9.81
    V, eps, b = pi / 4 * d**2, numbers["bed porosity"], 3.0 * pi * mu * d
    U = eps**2 * V * excess * g / b
    assert numbers["settling velocity"] == pytest.approx(U, rel=1e-3)
    assert numbers["Re_p"] == pytest.approx(rho * U * d / mu, rel=1e-3)
    assert numbers["Ar"] == pytest.approx(rho * excess * g * d**3 / mu**2)
    assert numbers["St"] == pytest.approx(2500.0 * V * U / eps / (b * d), rel=1e-3)
    assert numbers["b dt/m"] == pytest.approx(b * numbers["flow dt"] / (2500.0 * V))
    assert numbers["porosity"] == pytest.approx(1.0 - 8 * V / 64e-6)
    m = 2500.0 * V / 2.0
    contact = gm.Contact(stiffness=1e4)
    assert numbers["contact time"] == pytest.approx(contact.contact_time(m))
    assert numbers["overlap under weight"] == pytest.approx(2 * 8 * V * excess * g / 8e-3 / 1e4)
    assert reasons == ()


def test_settling_velocity_is_that_of_a_run():
    # A suspension as even as a lattice in a periodic box falls as Eq. (1) says.
    text = """
    box.periodic = true
    particles = {arrange="hexagonal", columns=4, rows=4, porosity=0.6, diameter="1 mm"}
    contact.stiffness = 1e4
    fluid = {density=1000, viscosity="0.1 Pa s", drag="hexagonal-lattice", dt="2 ms"}
    run.until = "0.1 s"
    """
    numbers, _ = told(text)
    run = case.parse(text).simulation().run(0.05)
    slip = np.abs(run.flow.around - run.velocity)[:, 1].mean()
    eps = numbers["bed porosity"]
    assert eps == pytest.approx(0.6, abs=1e-6)
    # All weight rests on a mean pressure gradient there, the fluid's share too: b w = eps V drho g.
    assert eps * slip == pytest.approx(numbers["settling velocity"], rel=0.02)


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("periodic", [False, True])
def test_unknowns_are_those_of_the_elements(order, periodic):
    text = SMALL.replace('"loose"\nnumber = 8', '"random"\nnumber = 30')
    changes = [f"fluid.order={order}", f"box.periodic={str(periodic).lower()}"]
    numbers, _ = told(text, *changes)
    t = case.parse(text, "c.toml", changes).simulation().flow.mesh.triangles
    sides = np.sort(t[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    corners, edges, faces = len(np.unique(t)), len(np.unique(sides, axis=0)), len(t)
    velocity = {1: corners + faces, 2: corners + edges, 3: corners + 2 * edges + faces}[order]
    pressure = {1: corners, 2: corners, 3: corners + edges}[order]
    assert numbers["unknowns"] == 2 * velocity + pressure


def test_foretold_steps_are_near_those_of_a_run():
    text = SMALL.replace("10 ms", "60 ms")
    numbers, _ = told(text)
    simulation = case.parse(text).simulation()
    count, step = 0, simulation._flow_step

    def counted(most):
        nonlocal count
        count += 1
        step(most)

    simulation._flow_step = counted
    simulation.run(0.06)
    assert simulation.step == pytest.approx(numbers["steps"], abs=1.0)
    assert 1 / 3 < numbers["flow steps"] / count < 3


OFF = {
    "law out of range": (("fluid.drag=lamb",), "drag law lamb used at Re"),
    "fast for a slow law": ((), "is for slow flow"),
    "soft": (("contact.stiffness=50", *SLOW), "contact.stiffness: 50 N/m2 is too low"),
    "long steps": (("fluid.dt='1 s'", *SLOW), "fluid.dt: 1 s is far above"),
    "blown away": (
        (*SLOW, "fluid.sides={bottom={kind='inflow',velocity=[0,'20 m/s']},top='outlet'}"),
        "carries all particles away",
    ),
    "wide kernel": (
        (*SLOW, "particles.number=1", "particles.diameter='4 mm'", "fluid.spacing='1 cm'"),
        "wider than the box",
    ),
    "nowhere to go": (
        (*SLOW, "fluid.sides.bottom={kind='inflow',velocity=[0,1e-6],ramp=[[0,0],[1,1]]}"),
        "flow into the box at t = 0.01 s and nothing the other way",
    ),
    "inflow along its side": (
        (*SLOW, "fluid.sides={bottom={kind='inflow',velocity=[1e-6,0]},top='outlet'}"),
        "fluid.sides.bottom: nothing flows through the side, at most along it at 1e-06 m/s",
    ),
    "inflow of nothing": (
        (*SLOW, "fluid.sides={top={kind='inflow',velocity=[0,1],ramp=[[0,0]]},left='outlet'}"),
        "fluid.sides.top: nothing flows through the side",
    ),
    "inflow that draws": (
        (*SLOW, "fluid.sides={bottom={kind='inflow',velocity=[0,-1e-6]},top='outlet'}"),
        "all inflows draw fluid out",
    ),
    "still fluid at a moving wall": (
        (*SLOW, "walls.top.velocity=[1e-3,0]", "fluid.sides.top={kind='no-slip',speed=2e-3}"),
        "walls.top.velocity: the fluid does not move with the wall",
    ),
    "probe outside": ((*SLOW, "run.probes=[[1,0]]"), "run.probes: (1, 0) m is outside"),
    "no gaps": (
        (
            "particles={arrange='places',places=[[4e-3,4e-3]],diameter=1e-3}",
            "fluid.drag=microstructural",
        ),
        "fluid.drag: ",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", OFF)
def test_what_is_off_is_said(name, tmp_path, capsys):
    changes, reason = OFF[name]
    path = tmp_path / "c.toml"
    path.write_text(SMALL)
    settings = [part for change in changes for part in ("--set", change)]
    assert cli.main(["check", str(path), *settings]) == 1
    out, err = capsys.readouterr()
    assert reason in err
    assert all(line.startswith("off: ") for line in err.splitlines())
    assert "porosity" in out


def test_inflows_that_add_up_to_zero_and_walls_told_twice_are_not_off():
    numbers, reasons = told(
        SMALL,
        *SLOW,
        "gravity=[0,0]",
        "fluid.sides.left={kind='inflow',velocity=[1e-6,0]}",
        "fluid.sides.right={kind='inflow',velocity=[1e-6,0]}",
        "fluid.sides.top={kind='no-slip',speed=1e-3}",
        "walls.top.velocity=[1e-3,0]",
    )
    assert reasons == ()
    assert "settling velocity" not in numbers


def test_a_flow_that_only_lifts_the_bed_is_not_off():
    lifted = "fluid.sides={bottom={kind='inflow',velocity=[0,'5 mm/s']},top='outlet'}"
    assert told(SMALL, *SLOW, lifted)[1] == ()
    down = "fluid.sides={top={kind='inflow',velocity=[0,'-20 m/s']},bottom='outlet'}"
    assert not any("carries" in reason for reason in told(SMALL, *SLOW, down)[1])


def test_dry_grains_that_fall_far_need_a_stiffness():
    dry = SMALL[: SMALL.index("[fluid]")] + SMALL[SMALL.index("[run]") :]
    high = ("particles.region=[0,'5 mm','8 mm','8 mm']",)
    numbers, reasons = told(dry, *high, "contact.stiffness=1e5")
    d, width, row = 1e-3, 8e-3, 1.1e-3  # seven in a row, the eighth above
    drop = 5e-3 + 1.5 * row - 8 * pi / 4 * d**2 / 0.82 / width
    depth = sqrt(2 * 9.81 * drop * 2500 * pi / 4 * d**2 / 1e5) / (d / 2)
    assert numbers["overlap as they meet"] == pytest.approx(depth, rel=0.02)
    assert reasons == ()
    assert "contact.stiffness" in told(dry, *high, "contact.stiffness=1e3")[1][0]
    assert "flow steps" not in numbers


def test_cases_of_permeability():
    text = STARTERS["permeability"]
    numbers, reasons = told(text)
    box, particles, _ = case.parse(text).arrangement()
    assert numbers["porosity"] == pytest.approx(0.6)
    assert numbers["gap"] == pytest.approx(gm.triangulate(box, particles).gap_shortest)
    assert reasons == ()
    thin = told(text, "particles.porosity=0.97", "particles.number=30")[1]
    assert any("microstructural" in reason for reason in thin)


def test_checking_warns_of_nothing_else():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        told(SMALL)
        told(STARTERS["settling"])


def test_a_case_that_cannot_start_is_bad_input(tmp_path, capsys):
    path = tmp_path / "c.toml"
    path.write_text(SMALL)
    assert cli.main(["check", str(path), "--set", "particles.number=500"]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"error: {path}: particles: 500 discs")
    assert err.count("\n") == 1
