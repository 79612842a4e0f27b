"""A bed of discs on a grid, flow from below: its law at rest, its weight once it is lifted."""

from dataclasses import replace

import numpy as np
import pytest

import grainmesh as gm
from grainmesh.closures import CarmanKozeny
from grainmesh.drag import Permeability
from grainmesh.medium import Fluid, Inflow, Outlet, Slip

# Discs in contact close the plane, and the permeability of discs at random goes with a high power
# of the porosity there; a law that stays open makes a bed in which flow is even.
LAW = CarmanKozeny()
D, HEAVY, RHO, MU, G = 2e-3, 2500.0, 1000.0, 1e-3, 9.81
CONTACT = gm.Contact(stiffness=1e6, restitution=0.5, friction=0.1)

pytestmark = pytest.mark.filterwarnings("ignore::grainmesh.closures.ClosureWarning")


def fluid(inflow, **options):
    sides = {"bottom": Inflow(inflow), "top": Outlet(), "left": Slip(), "right": Slip()}
    return Fluid(RHO, MU, Permeability(LAW), sides, spacing=2.0 * D, **options)


def model(box, flow=None, contact=CONTACT):
    smooth = tuple(gm.Wall.of(box, side, friction=0.0) for side in ("left", "right"))
    return gm.Model(box, contact, walls=smooth, fluid=flow)


def settled(columns, n, contact=CONTACT):
    """Box and discs that have come to rest in it, dry."""
    box = gm.Box(columns * D, 3.0 * n / columns * D)
    grains = gm.arrange.loose(box, n, diameter=D, density=HEAVY, seed=1)
    dry = gm.Simulation(model(box, contact=contact), grains).run(until=0.6)
    assert dry.energies["kinetic"] < 1e-6 * dry.energies["potential"]
    assert dry.measure()["overlap"] < 0.01
    return box, dry.particles


def weight(box, grains):
    """Of the discs in the fluid, over the area of the bed [Pa]."""
    return (HEAVY - RHO) * G * np.pi / 4.0 * (grains.diameter**2).sum() / box.width


def borne(simulation):
    """By the floor, over the weight in the fluid."""
    touch, box = simulation.wall_contacts, simulation.model.box
    force = abs(touch.force @ touch.normal[:, 1])
    return force / box.width / weight(box, simulation.particles)


def drop(simulation):
    """Mean pressure at the bottom [Pa]; it is 0 at the top."""
    return simulation.flow.pressure_at("bottom") / simulation.model.box.width


def held(box, grains, speed, until=0.2, **options):
    """The same discs, held where they are, in flow that has become steady."""
    flow = fluid((0.0, speed), dt=1.0, **options)
    fixed = np.ones(len(grains), bool)
    return gm.Simulation(model(box, flow), grains, fixed=fixed).run(until=until)


@pytest.fixture(scope="module")
def bed():
    return settled(12, 120)


def test_pressure_drop_of_an_even_bed_is_that_of_its_law():
    columns, rows, porosity, speed = 8, 24, 0.4, 1e-3
    pitch = D * (np.pi / 4.0 / (1.0 - porosity)) ** 0.5
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    box = gm.Box(columns * pitch, rows * pitch)
    grains = gm.Particles(pitch * np.column_stack([x.ravel(), y.ravel()]), D, HEAVY)
    k = LAW(porosity, 1.0) * D**2
    found = drop(held(box, grains, speed, until=3.0))
    assert found == pytest.approx(MU * speed / k * box.height, rel=0.01)


@pytest.mark.parametrize("order", [1, 2])
def test_what_the_pressure_loses_the_discs_bear(bed, order):
    box, grains = bed
    run = held(box, grains, 1e-3, order=order)
    # In steady flow momentum that goes in and out, of rho U² H, is nothing beside it.
    force = run.flow.force[:, 1].sum() / box.width
    assert drop(run) == pytest.approx(force, rel=0.03)


def test_drop_of_a_resting_bed_does_not_depend_on_the_step(bed):
    """Discs that lie still resist as if they were held, however long the step."""
    box, grains = bed
    speed = 0.5 * fluidising(box, grains)
    fixed = drop(held(box, grains, speed))
    run = gm.Simulation(model(box, fluid((0.0, speed), dt=2e-3)), grains)
    run.run(until=0.1)
    fastest = float(np.abs(run.flow.velocity).max())
    assert fastest < 0.05 * speed
    assert drop(run) == pytest.approx(fixed, rel=0.02)


def fluidising(box, grains):
    """U_mf [m/s]: the flow that bears the bed as it is packed, from discs that are held."""
    speed = 1e-3
    return speed * weight(box, grains) / drop(held(box, grains, speed))


@pytest.mark.slow
def test_fluidised_bed(bed):
    box, grains = bed
    least, load = fluidising(box, grains), weight(box, grains)

    def ramp(x, t):  # in steps that last, to 2 U_mf
        level = 0.25 * min(int(t / 0.1) + 1, 8)
        return np.column_stack([np.zeros(len(x)), np.full(len(x), level * least)])

    run = gm.Simulation(model(box, fluid(ramp, dt=1e-3)), grains)
    rows, area = [], np.pi / 4.0 * (grains.diameter**2).sum()

    def observe(now):
        kernel = now.flow.kernel
        solid = ((1.0 - kernel.porosity) * kernel.hats).sum()
        rows.append([now.t, drop(now) / load, now.x[:, 1].mean(), solid / area, borne(now)])

    run.run(until=1.2, every=0.01, observe=observe)
    t, pressure, height, solid, floor = np.array(rows).T
    level = 0.25 * np.minimum(np.floor((t - 1e-6) / 0.1) + 1, 8)
    late = np.abs(t % 0.1 - 0.07) < 0.025  # not where the flow has just been raised

    def mean(which):
        return pressure[which & late].mean()

    # At rest in proportion to the flow; where this line meets the weight is U_mf.
    slope = np.mean([mean(level == q) / q for q in (0.25, 0.5, 0.75)])
    assert 1.0 / slope == pytest.approx(1.0, rel=0.05)
    # A few discs stay on the floor and bear on it; fluid and floor carry the bed.
    flowing = (level >= 1.5) & late
    assert (pressure + floor)[flowing].mean() == pytest.approx(1.0, rel=0.01)
    assert mean(level >= 1.5) == pytest.approx(1.0, rel=0.06)
    assert height[level == 0.5] == pytest.approx(grains.x[:, 1].mean(), rel=2e-3)
    assert height[t > 1.0].min() > 1.02 * grains.x[:, 1].mean()
    assert solid == pytest.approx(1.0, abs=1e-12)  # no drift of mass
    assert run.measure()["particles"] == len(grains)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.1])
def test_pressure_bears_a_deep_bed(friction):
    """27 rows: from 1.5 U_mf; with friction, which holds discs on the floor, from 1.75."""
    contact = replace(CONTACT, friction=friction)
    box, grains = settled(12, 324, contact)
    least, load, each = fluidising(box, grains), weight(box, grains), 0.3
    levels = 0.75, 1.25, 1.5, 1.75, 2.0, 3.0

    def ramp(x, t):
        level = levels[min(int(t / each), len(levels) - 1)]
        return np.column_stack([np.zeros(len(x)), np.full(len(x), level * least)])

    run, rows = gm.Simulation(model(box, fluid(ramp, dt=1e-3), contact), grains), []

    def observe(now):
        rows.append([now.t, drop(now) / load, borne(now)])

    run.run(until=len(levels) * each, every=0.01, observe=observe)
    t, pressure, floor = np.array(rows).T
    late = np.abs(t / each % 1.0 - 0.7) < 0.27  # not where the flow has just been raised
    found = {q: pressure[late & (t // each == k)].mean() for k, q in enumerate(levels)}
    assert 0.75 / found[0.75] == pytest.approx(1.0, rel=0.05)
    assert (pressure + floor)[late & (t > each)].mean() == pytest.approx(1.0, rel=0.005)
    for q in levels[2 if friction == 0.0 else 3 :]:
        assert found[q] == pytest.approx(1.0, rel=0.03)
