"""Fluid and particles together: what is conserved, what rests, what settles as it must."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
from ngsolve import Integrate, LinearForm, dx, grad

import grainmesh as gm
from flows import Beside
from grainmesh import coupling
from grainmesh.carry import Keys
from grainmesh.closures import HexagonalLattice, SquareLattice
from grainmesh.drag import Bed, Drag, Permeability
from grainmesh.element import element
from grainmesh.medium import Fluid, Inflow, NoSlip, Outlet, Slip
from grainmesh.nodes import Bounded

D, G = 1e-3, 9.81
SLOW, BOX = pytest.mark.slow, gm.Box(0.006, 0.008)
LAW = gm.Contact(2e4, restitution=0.6, friction=0.3)
WATER = Fluid(density=1000.0, viscosity=1e-3, drag=Permeability())


@dataclass(frozen=True)
class Linear(Drag):
    """b of each disc, the same always."""

    b: float
    name = reference = medium = "linear"
    variable, valid = "porosity", (0.0, 1.0)

    def _argument(self, bed: Bed):
        return bed.porosity

    def _coefficient(self, bed: Bed):
        return np.full_like(bed.area, self.b)


def soup(n=40, porosity=0.55, seed=2, gravity=(1.0, -G), **of_fluid):
    """Discs of unequal size and density that stir a periodic box and collide."""
    rng = np.random.default_rng(seed)
    box, grains = gm.arrange.random(n, porosity=porosity, diameter=D, min_gap=0.02, seed=seed)
    grains = gm.Particles(grains.x, D * rng.uniform(0.8, 1.0, n), rng.uniform(500.0, 4000.0, n))
    model = gm.Model(box, LAW, gravity=gravity, fluid=replace(WATER, **of_fluid))
    return gm.Simulation(model, grains, velocity=rng.normal(0.0, 0.03, (n, 2)))


def closed(n=60, density=2500.0, seed=1, size=(0.012, 0.018), gravity=(0.0, -G), **of_fluid):
    """Discs of unequal size in a box with walls."""
    box = gm.Box(*size)
    grains = gm.arrange.loose(box, n, diameter=(0.7 * D, D), density=density, seed=seed)
    model = gm.Model(box, LAW, gravity=gravity, fluid=replace(WATER, **of_fluid))
    return gm.Simulation(model, grains)


def step(run, times=1):
    """Steps of the flow, as long as it likes."""
    for _ in range(times):
        run._flow_step(10**9)
    return run


def momentum(flow):
    """Of fluid and particles [kg/s], (2,)."""
    return flow.Q[: len(flow.mesh.points)].sum(axis=0) + flow.discs.mass @ flow.velocity


# Conservation -------------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["euler", "bdf2"])
@pytest.mark.parametrize(
    ("order", "spacing", "push"),
    [
        (1, None, (3.0, 2.0)),
        (2, None, (3.0, 2.0)),
        pytest.param(3, None, (0.0, 0.0), marks=SLOW),
        (2, 0.7e-3, (3.0, 2.0)),
    ],
)
def test_momentum(order, spacing, push, scheme):
    """Fluid and particles together gain what pushes them, and nothing else, to round-off.

    For BDF2 as well: if each D of the last step was Δt F, Eq. (4) of navier gives Δt' F again.
    """
    porosity = 0.55 if spacing is None else 0.8
    run = soup(porosity=porosity, order=order, spacing=spacing, push=push, scheme=scheme)
    flow, start, exchanged, met, nodes = run.flow, momentum(run.flow), 0.0, 0, set()
    for _ in range(60):
        step(run)
        exchanged += np.abs(flow.force).sum() * flow.dt
        gained = momentum(flow) - start
        assert (
            np.abs(gained - np.array(push) * run.model.box.area * run.t).max() < 1e-11 * exchanged
        )
        met += len(run.contacts)
        nodes.add(int(flow.mesh.in_use.sum()))
    assert flow.mesh.flips > 20
    assert met > 20
    assert (len(nodes) > 3) == (spacing is not None)


def test_solid_volume_is_that_of_the_discs():
    """∫(1 - ε) = sum V, always; shares of a disc sum to 1."""
    for run in (soup(spacing=0.7e-3, porosity=0.8), closed(spacing=0.7e-3)):
        for _ in range(20):
            step(run)
            k, V = run.flow.kernel, run.flow.discs.volume
            assert (1.0 - k.porosity) @ k.hats == pytest.approx(V.sum(), rel=1e-12)
            assert k.spread.share.sum(axis=1) == pytest.approx(1.0, rel=1e-12)
            used = run.flow.mesh.in_use
            assert k.hats[used].sum() == pytest.approx(run.model.box.area, rel=1e-12)


def fluxes(flow):
    """∫(ε u + sum V ψ u_i)·∇q for all q, and that of the discs alone."""
    op, it = flow.operator, Beside(flow)
    values = flow.kernel.field(flow.discs.volume[:, None] * flow.velocity)
    solid = Keys(op.topology, element(1)).field(it.grid, values)
    slope, free = grad(it.Q.TestFunction()), op.free[op.split :]

    def against(field):
        form = LinearForm(field * slope * dx(bonus_intorder=op.order + 2))
        return it.load("p", form)[free]

    return against(it.eps * it.u + solid), against(solid)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("make", [soup, closed])
def test_volume_of_the_mixture(make, order, monkeypatch):
    """∇·(ε u + sum V ψ u_i) = 0 against all pressures, to the tolerance of the solver."""
    run, found = make(order=order, dt=5e-4, tolerance=1e-6), []
    flow, mend = run.flow, Bounded.mend

    def looking(mesh):  # before the fields are carried to another triangulation
        if mesh is flow.mesh:
            found.append(np.divide(*(np.linalg.norm(part) for part in fluxes(flow))))
        return mend(mesh)

    monkeypatch.setattr(Bounded, "mend", looking)
    step(run, 20)
    assert flow.mesh.flips > 0
    assert len(found) == 20
    assert max(found) < 10.0 * flow.fluid.tolerance


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("make", [soup, closed])
def test_volume_that_a_step_leaves_is_made_up_for_by_the_next(make, order):
    """Through whatever tolerance: all volume that has come in so far is what the flow owes."""
    run = make(order=order, dt=2e-5, tolerance=0.1)
    flow, came, gross, flips = run.flow, 0.0, 0.0, run.flow.mesh.flips
    for _ in range(6):
        step(run)
        both, discs = fluxes(flow)
        came, gross = came + flow.dt * both, gross + flow.dt * np.linalg.norm(discs)
    assert flow.mesh.flips == flips  # fields as they were solved for
    owed = flow.owed[flow.operator.free[flow.operator.split :]]
    assert 1e-6 * gross < np.linalg.norm(owed) < 0.1 * gross
    assert np.linalg.norm(came + owed) < 1e-9 * gross


@pytest.mark.parametrize("order", [1, 2])
def test_volume_owed_makes_no_spike_when_steps_become_short(order):
    """What a long step leaves is paid over as long a time."""
    found = []
    for tolerance in (0.02, 1e-8):
        run = step(soup(order=order, dt=5e-4, tolerance=tolerance), 4)
        assert run.flow.dt > 30.0 * run.dt
        for _ in range(4):
            run._flow_step(2)
            found.append(np.ptp(run.flow.operator.p))
    assert np.max(found[:4]) < 2.5 * np.max(found[4:])


def test_an_outlet_that_closes_leaves_a_flow_that_is_solved_for():
    """The volume owed through it is forgiven; residuals told are true."""
    sides = {"top": Outlet()}
    run = closed(n=40, seed=2, order=2, sides=sides)
    step(run, 15)
    model = replace(run.model, fluid=replace(run.model.fluid, sides={}))
    run.change(model)
    step(run)
    flow = run.flow
    used = flow.operator.topology.used
    assert abs(flow.owed[: len(used)].sum()) < 1e-12 * np.abs(flow.owed).sum()
    both, discs = (np.linalg.norm(part) for part in fluxes(flow))
    assert both < 0.3 * discs


# Rest ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("order", "steps"), [(1, 60), (2, 60), pytest.param(2, 1000, marks=SLOW)])
def test_grains_as_heavy_as_the_fluid_stay_at_rest(order, steps):
    """To 1e-10 of the speed at which they would fall without buoyancy; some touch walls."""
    rng = np.random.default_rng(0)
    d = D * rng.uniform(0.6, 1.0, 16)
    x = gm.arrange.loose(BOX, 16, diameter=d, seed=3).x.copy()
    x = np.where(x < D, 0.5 * d[:, None], x)
    model = gm.Model(BOX, LAW, gravity=(0.7, -G), fluid=replace(WATER, order=order))
    run = gm.Simulation(model, gm.Particles(x, d, WATER.density))
    flow, most = run.flow, 0.0
    for _ in range(steps):
        step(run)
        most = max(most, np.abs(flow.velocity).max())
    fall = (flow.discs.mass * G / flow.drag).max()
    assert most < 1e-10 * fall
    assert np.abs(flow.operator.u).max() < 1e-10 * fall


# Settling -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("porosity", [0.5, 0.7, 0.95])
@pytest.mark.parametrize("lattice", ["hexagonal", "square"])
@pytest.mark.parametrize("order", [1, 2])
def test_a_lattice_settles_as_darcy_says(lattice, porosity, order):
    """At K (1 - ε) Δρ g/mu relative to the mixture; the slip is that over ε."""
    law = {"hexagonal": HexagonalLattice(), "square": SquareLattice()}[lattice]
    box, grains = getattr(gm.arrange, lattice)(4, 4, porosity=porosity, diameter=D)
    grains = replace(grains, density=2500.0)
    mu = 0.2
    fluid = replace(WATER, viscosity=mu, drag=Permeability(law), order=order, dt=2e-3)
    run = gm.Simulation(gm.Model(box, LAW, gravity=(0.0, -G), fluid=fluid), grains)
    while run.t < 0.1:
        step(run)
    flow = run.flow
    V = flow.discs.volume
    mixture = flow.mean() + V @ flow.velocity / box.area
    speed = flow.velocity - mixture
    K = D**2 * law._permeability(np.array([porosity]))[0]
    expected = np.array([0.0, -K * (1.0 - porosity) * 1500.0 * G / mu])
    assert np.abs(speed - expected).max() < 1e-3 * np.abs(expected).max()
    # No disc settles otherwise than the rest.
    assert np.ptp(flow.velocity, axis=0).max() < 1e-5 * np.abs(expected).max()


@pytest.mark.parametrize("scheme", ["euler", "bdf2"])
def test_one_disc_in_a_fluid_that_it_hardly_moves(scheme):
    """v = v_T (1 - exp(-b t/m)), v_T = (m - rho V) g/b, to the order of the scheme in b Δt/m."""
    box, mass = gm.Box(2.0, 2.0), 1e5 * np.pi * D**2 / 4.0
    b = 0.5 * mass / 1e-2
    errors = []
    for dt in (4e-4, 2e-4):
        fluid = Fluid(density=1.0, viscosity=1e7 * b, drag=Linear(b), scheme=scheme, dt=dt)
        fluid, law = replace(fluid, tolerance=1e-12), gm.Contact(5e4)
        model = gm.Model(box, law, gravity=(0.0, -G), fluid=fluid, dt=dt / 8.0)
        run = gm.Simulation(model, gm.Particles([[1.0, 1.0]], D, 1e5))
        run.run(until=2e-2)
        terminal = (mass - 1.0 * np.pi * D**2 / 4.0) * G / b
        exact = -terminal * (1.0 - np.exp(-b * run.t / mass))
        errors.append(abs(run.flow.velocity[0, 1] - exact) / terminal)
    assert errors[0] < {"euler": 2e-2, "bdf2": 1e-3}[scheme]
    assert errors[0] / errors[1] > {"euler": 1.8, "bdf2": 3.0}[scheme]


def test_the_slip_of_one_disc():
    """b (<u> - u_i) - V <∇p> holds up the weight, all three taken from the fields."""
    b = 0.05
    fluid = replace(WATER, viscosity=0.1, drag=Linear(b), dt=2e-3, tolerance=1e-10)
    model = gm.Model(gm.Box(0.02, 0.03), LAW, gravity=(0.0, -G), fluid=fluid)
    run = gm.Simulation(model, gm.Particles([[0.011, 0.02]], D, 2500.0))
    while run.t < 0.1:
        step(run)
    flow = run.flow
    mesh = flow.operator
    while True:  # a step after which the fields are those it has solved for
        v = flow.velocity.copy()
        step(run)
        if flow.operator is mesh:
            break
        mesh = flow.operator
    it, V = Beside(flow), flow.discs.volume[0]
    psi = Keys(mesh.topology, element(1)).field(it.grid, flow.kernel.field(np.ones(1)))
    assert Integrate(psi, it.mesh) == pytest.approx(1.0, rel=1e-12)
    mean = np.array(Integrate(psi * it.u, it.mesh, order=6))
    slope = np.array(Integrate(psi * grad(it.p), it.mesh, order=6))
    force = b * (mean - flow.velocity[0]) - V * slope
    weight = 1500.0 * V * np.array([0.0, -G])
    inertia = flow.discs.mass[0] * (flow.velocity - v)[0] / flow.dt
    assert np.abs(force + weight - inertia).max() < 1e-6 * np.abs(weight).max()
    assert np.abs(inertia).max() < 0.1 * np.abs(weight).max()


def bed(density, steps, dt=1e-3, n=24, drag=WATER.drag, gravity=(0.0, -G), **of_fluid):
    """Grains that fall or rise in a small box, in steps of one length; the largest speed of all."""
    box = gm.Box(0.006, 0.008)
    stiffness = 20.0 * max(density, WATER.density)
    law = gm.Contact(stiffness, restitution=0.5, friction=0.3)
    grains = gm.arrange.loose(box, n, diameter=(0.8 * D, D), density=density, seed=4)
    fluid = replace(WATER, drag=drag, dt=dt, **of_fluid)
    run = gm.Simulation(gm.Model(box, law, gravity=gravity, fluid=fluid), grains)
    fastest = 0.0
    for _ in range(steps):
        step(run)
        fastest = max(fastest, float(np.abs(run.flow.velocity).max()))
    return run, fastest


@pytest.mark.parametrize(
    ("ratio", "steps"),
    [
        (0.01, 40), (0.1, 40), (1.0, 40), (2.5, 40), (1000.0, 40),
        *(pytest.param(ratio, 600, marks=SLOW) for ratio in (0.01, 0.1, 2.5, 1000.0)),
    ],
)  # fmt: skip
def test_any_density_at_the_same_step(ratio, steps):
    """No blow-up: nothing gets faster than it would falling freely; a bed forms and rests."""
    run, fastest = bed(ratio * WATER.density, steps)
    flow, height = run.flow, run.model.box.height
    rise = abs(ratio - 1.0) / ratio * G
    assert fastest <= min(np.sqrt(2.0 * rise * height), rise * run.t) + 1e-12
    assert run.halved == 0
    top, floor = run.x[:, 1] + run.particles.radius, run.x[:, 1] - run.particles.radius
    assert floor.min() > -0.01 * D
    assert top.max() < height + 0.01 * D
    if steps > 100:
        assert fastest > 1e-3
        speed = np.hypot(*flow.velocity.T)
        assert np.median(speed) < 0.01 * fastest  # some rattle in their cages
        assert speed.max() < (0.1 if ratio > 0.05 else 0.2) * fastest
        at_rest = floor.min() if ratio > 1.0 else height - top.max()
        assert abs(at_rest) < 0.01 * D
        V, m = flow.discs.volume, flow.discs.mass
        weight = (m - WATER.density * V).sum() * G
        held = run.wall_contacts.force
        assert np.abs(held).sum() > 0.5 * abs(weight)


@pytest.mark.parametrize("number", [1e-3, 1.0, 1e3, 1e6])
def test_any_drag_at_the_same_step(number):
    """b Δt/m from nothing to all: grains in contact on the floor never get fast."""
    mass, dt = 2500.0 * np.pi * D**2 / 4.0, 1e-3
    run, fastest = bed(2500.0, 60, dt, drag=Linear(number * mass / dt))
    free = 0.6 * G
    assert fastest <= free * run.t
    assert run.halved == 0
    # Alone in fluid at rest a disc falls at (m - rho V) g/b at most; the fluid can carry it on.
    if number >= 1e3:
        slip = np.hypot(*(run.flow.around - run.flow.velocity).T)
        assert slip.max() < 2.0 * free * dt / number


# Continuity ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1, 2])
def test_flips_leave_no_spikes(order):
    """What is off from the mean of the steps before and after, near flips and elsewhere."""
    run = soup(gravity=(0.0, -1.0), dt=2.5e-4, seed=5, porosity=0.75, order=order)
    run._set_velocity(0.0 * run.velocity, 0.0 * run.spin)
    run.flow.velocity[:] = 0.0
    n, flow, kept, flips = len(run), run.flow, [], run.flow.mesh.flips
    step(run, 8)  # the start is a jump of its own
    for _ in range(100):
        if len(run.contacts):
            break
        kept.append(np.column_stack([flow.kernel.porosity[:n], flow.velocity, flow.force]))
        step(run)
    assert flow.mesh.flips > flips + 4
    kept = np.array(kept)
    off = np.abs(kept[1:-1] - 0.5 * (kept[2:] + kept[:-2])).max(axis=(0, 1))
    speed, force = (np.hypot(*kept[..., k : k + 2].T).mean() for k in (1, 3))
    assert off[0] < 0.01  # hats change
    assert off[1:3].max() < 1e-3 * speed
    assert off[3:].max() < 0.02 * force  # 0.3 without Eq. (7) of navier


def test_a_step_that_is_undone_leaves_its_factor_behind():
    """Else the same step, done again, would not give the same bits."""
    run = step(closed(n=30), 3)
    flow, kept = run.flow, run.flow.keep()
    before, force = flow.solver.numbers(), flow.force.copy()
    flow.solver.forget()
    flow.solve(run.dt, np.zeros((30, 2)), np.zeros((30, 2)))
    assert flow.solver.numbers() != before
    flow.back(kept)
    assert flow.solver.numbers() == before
    assert flow.solver._factor is kept[3]._factor
    assert np.array_equal(flow.force, force)


# Restart ------------------------------------------------------------------------------------------


def bits(run):
    flow = run.flow
    return [
        run.x, run.velocity, run.spin, run.contacts.friction, flow.velocity, flow.force,
        flow.operator.x, flow.extra, flow.D, flow.Q, flow.kernel.porosity, flow.mesh.triangles,
        np.array([run.step, flow.time, flow.iterations, flow.factors]),
        np.array([list(row.values()) for row in run.history]),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("make", "times"),
    [
        (lambda: closed(n=30, size=(0.008, 0.010)), 2048),
        (lambda: soup(n=24, scheme="bdf2", order=1), 2048),
        (lambda: soup(n=24, porosity=0.8, spacing=(0.7e-3, 2e-3)), 1024),
        pytest.param(lambda: closed(n=60, spacing=1e-3), 16384, marks=SLOW),
        pytest.param(lambda: soup(n=40, order=3), 16384, marks=SLOW),
    ],
)
def test_a_run_goes_on_bit_for_bit(make, times, tmp_path):
    """run(2T) = run(T), resume, run(T), with an old factor in use."""
    one = make()
    time = times * one.dt
    one.run(until=time, every=time)
    assert one.flow.factors > 0
    one.save(tmp_path)
    two = gm.resume(tmp_path)
    assert two.flow.iterations == one.flow.iterations
    for run in (one, two):
        run.run(until=2.0 * time, every=time)
    assert one.flow.mesh.flips > 0
    for a, b in zip(bits(one), bits(two), strict=True):
        assert np.array_equal(a, b)


# Faults -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [closed, lambda: soup(porosity=0.8, spacing=0.6e-3)])
@pytest.mark.parametrize("fault", [gm.RunError("made up"), KeyboardInterrupt()])
def test_a_step_that_fails_late_is_undone_whole(make, fault, monkeypatch):
    """After edges have been flipped, and nodes put in and taken out."""
    run = step(make(), 3)
    whole, flow = type(run.flow)._kernel, run.flow

    def fails(self, changed=None):
        if changed is not None:
            raise fault
        return whole(self, changed)

    while True:  # to a step in which the mesh changes
        before = [np.array(part) for part in bits(run)]
        with monkeypatch.context() as patch:
            patch.setattr(type(flow), "_kernel", fails)
            try:
                run._flow_step(1)
            except (gm.RunError, KeyboardInterrupt):
                break
    assert np.array_equal(flow.mesh.triangles, flow.operator.topology.triangles)
    for a, b in zip(bits(run), before, strict=True):
        assert np.array_equal(a, b)
    step(run, 3)  # and goes on
    assert np.isfinite(run.x).all()


def test_a_change_that_is_refused_changes_nothing():
    sides = {"bottom": Inflow((0.0, 0.005)), "top": Outlet()}
    run = step(closed(sides=sides), 3)
    model, before = run.model, [np.array(part) for part in bits(run)]
    with pytest.raises(gm.InputError, match="nothing the other way"):
        run.change(replace(model, fluid=replace(model.fluid, sides={"bottom": sides["bottom"]})))
    assert run.model is model
    assert run.flow.fluid is model.fluid
    for a, b in zip(bits(run), before, strict=True):
        assert np.array_equal(a, b)
    step(run, 2)


@pytest.mark.parametrize("n", [1, 2, 5, 100, 1000])
@pytest.mark.parametrize("power", [0.0, 1.0, 8.0])
def test_rate_that_most_of_the_sum_stays_below(n, power):
    rates = np.random.default_rng(n).uniform(size=n) ** power
    found = coupling._most(rates, 0.8)
    assert found in rates
    assert rates[rates < found].sum() < 0.8 * rates.sum() * (1.0 + 1e-12)
    assert rates[rates <= found].sum() > 0.8 * rates.sum() * (1.0 - 1e-12)


def test_few_fast_discs_among_many_at_rest_decide_the_step():
    n = 100
    box, grains = gm.arrange.square(10, 10, porosity=0.8, diameter=D)
    grains = gm.Particles(grains.x, D, 1000.0)
    velocity = np.zeros((n, 2))
    velocity[44] = 1.0, 0.0
    run = gm.Simulation(gm.Model(box, LAW, fluid=WATER), grains, velocity=velocity)
    assert run.flow.steps(run.dt, 10**6) * run.dt * 1.0 < 0.15 * D


def test_a_flow_faster_than_the_contacts_is_refused():
    jet = {"bottom": Inflow((0.0, 50.0)), "top": Outlet()}
    run = closed(sides=jet)
    with pytest.raises(gm.RunError, match=r"smaller Model\(dt="):
        step(run, 20)


@SLOW
def test_a_jet_does_not_blow_up():
    """Convection is explicit: at a cell Reynolds number of 140, forward Euler grows to NaN."""

    def jet(x, t):
        return np.stack(
            [0.0 * x[:, 0], 0.3 * np.maximum(0.0, 1.0 - ((x[:, 0] - 0.01) / 0.004) ** 2)], 1
        )

    sides = {"bottom": Inflow(jet), "top": Outlet()}
    fluid = replace(WATER, viscosity=5e-3, drag=Linear(1e-9), sides=sides, spacing=1e-3, dt=1e-3)
    box, grain = gm.Box(0.02, 0.02), gm.Particles([[0.004, 0.01]], 1e-4, 1000.0)
    run = gm.Simulation(gm.Model(box, LAW, gravity=(0.0, 0.0), fluid=fluid), grain, fixed=[0])
    run.run(until=0.15)
    assert np.abs(run.flow.sample().velocity).max() < 1.2 * 0.3


# Invariance ---------------------------------------------------------------------------------------

EXACT = replace(WATER, tolerance=1e-12, dt=1e-3)


def fallen(turn=None, scale=(1.0, 1.0, 1.0), order=None, steps=20, **of_fluid):
    """Grains after some steps, started from an image of one and the same arrangement.

    Lengths, masses and times are multiplied by `scale`; grains are taken in another `order`.
    """
    length, mass, time = scale
    size, gravity = np.array([0.008, 0.010]), np.array([2.0, -G])
    grains = gm.arrange.loose(gm.Box(*size), 30, diameter=(0.7 * D, D), gap=0.4, seed=2)
    x = grains.x
    if turn is not None:
        x, gravity, size = turn(x - size / 2.0), turn(gravity), np.abs(turn(size))
        x = x + size / 2.0
    order = np.arange(30) if order is None else order
    particles = gm.Particles(
        length * x[order], length * grains.diameter[order],
        mass / length**3 * grains.density[order],
    )  # fmt: skip
    fluid = replace(
        EXACT, density=mass / length**3 * 1000.0, viscosity=mass / length / time * 1e-3,
        dt=time * EXACT.dt, **of_fluid,
    )  # fmt: skip
    law = gm.Contact(mass / length / time**2 * 2e4, friction=0.3)
    model = gm.Model(
        gm.Box(*(length * size)), law, gravity=tuple(length / time**2 * gravity), fluid=fluid,
        dt=time * 1e-5,
    )  # fmt: skip
    run = step(gm.Simulation(model, particles), steps)
    back = np.argsort(order)
    return run.flow.velocity[back] * time / length, run.flow.force[back] * time**2 / mass


def test_mirror_and_turn():
    """A mirror image falls as a mirror image, a box turned by 90 degrees turned by 90 degrees."""
    v, force = fallen()
    for turn in (lambda x: x * [-1.0, 1.0], lambda x: x[..., ::-1] * [-1.0, 1.0]):
        u, pull = fallen(turn=turn)
        assert np.abs(u - turn(v)).max() < 1e-7 * np.abs(v).max()
        assert np.abs(pull - turn(force)).max() < 1e-7 * np.abs(force).max()


def test_units():
    """Other units of length, mass and time change nothing."""
    v, force = fallen()
    for scale in ((1e3, 1.0, 1.0), (1.0, 1e-3, 1.0), (1.0, 1.0, 60.0), (1e6, 1e9, 1e3)):
        u, pull = fallen(scale=scale)
        assert np.abs(u - v).max() < 1e-7 * np.abs(v).max(), scale
        assert np.abs(pull - force).max() < 1e-7 * np.abs(force).max(), scale


def test_numbers_of_grains():
    """Grains may be given in any order."""
    v, force = fallen()
    u, pull = fallen(order=np.random.default_rng(0).permutation(30))
    assert np.abs(u - v).max() < 1e-7 * np.abs(v).max()
    assert np.abs(pull - force).max() < 1e-7 * np.abs(force).max()


# Bad input ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"density": 0.0}, "density = 0 must be positive"),
        ({"viscosity": -1.0}, "viscosity = -1 must be positive"),
        ({"dt": np.nan}, "dt = nan must be a finite number"),
        ({"reach": 0.0}, "reach = 0 must be positive"),
        ({"spacing": np.inf}, "spacing = inf must be a finite number"),
        ({"spacing": (2e-3, 1e-3)}, "spacing = (0.002, 0.001), beside particles and far from"),
        ({"spacing": (0.0, 1e-3)}, "spacing = 0 must be positive"),
        ({"spacing": [1e-3]}, "spacing [0.001] must be two numbers"),
        ({"spacing": np.array(1e-3)}, "spacing = array(0.001) must be a finite number"),
        ({"push": np.array(1.0)}, "push 1.0 must be two numbers"),
        ({"tolerance": -1e-6}, "tolerance = -1e-06 must be positive"),
        ({"added_mass": -0.5}, "added_mass = -0.5 must not be negative"),
        ({"drag": "stokes"}, "drag law stokes takes depth"),
        ({"order": 0}, "order 0 must be a whole number from 1"),
        ({"order": 1.5}, "order 1.5 must be a whole number from 1"),
        ({"scheme": "bdf3"}, "scheme 'bdf3' must be 'euler' or 'bdf2'"),
        ({"sides": {"lid": Slip()}}, "side 'lid' must be one of left, right, bottom, top"),
        ({"sides": {"top": "open"}}, "the top side must be NoSlip"),
    ],
)
def test_fluids_that_cannot_be(given, message):
    with pytest.raises(gm.InputError, match=re.escape(message)):
        replace(WATER, **given)


def test_models_that_cannot_be():
    box, torus = gm.Box(0.01, 0.01), gm.Box(0.01, 0.01, periodic=True)
    with pytest.raises(gm.InputError, match=r"fluid must be a grainmesh\.Fluid"):
        gm.Model(box, LAW, fluid="water")
    with pytest.raises(gm.InputError, match="drop open="):
        gm.Model(box, LAW, fluid=WATER, open="top")
    with pytest.raises(gm.InputError, match="a periodic box has no sides"):
        gm.Model(torus, LAW, fluid=replace(WATER, sides={"top": Slip()}))
    with pytest.raises(gm.InputError, match="drop ledger=True"):
        gm.Simulation(
            gm.Model(box, LAW, fluid=WATER), gm.Particles([[0.005, 0.005]], D), ledger=True
        )


def test_flow_that_has_nowhere_to_go():
    """What flows in must flow out; the number is said."""
    box, grain = gm.Box(0.01, 0.02), gm.Particles([[0.005, 0.005]], D)
    up = Inflow((0.0, 0.02))

    def run(**sides):
        model = gm.Model(box, LAW, fluid=replace(WATER, sides=sides))
        return step(gm.Simulation(model, grain), 2)

    with pytest.raises(gm.InputError, match=r"0\.000\d* m2/s flow into the box"):
        run(bottom=up)
    with pytest.raises(gm.InputError, match="must return"):
        run(bottom=Inflow(lambda x, t: np.full_like(x, np.nan)), top=Outlet())
    run(bottom=up, top=up)
    flow = run(bottom=up, top=Outlet(), left=Slip(), right=NoSlip(0.01)).flow
    assert np.isfinite(flow.operator.x).all()


def test_too_few_discs_in_a_periodic_box():
    model = gm.Model(gm.Box(0.01, 0.01, periodic=True), LAW, fluid=WATER)
    with pytest.raises(gm.InputError, match="too few particles"):
        gm.Simulation(model, gm.Particles([[0.005, 0.005]], D))


def test_discs_that_leave_no_room():
    """A porosity that no mesh can hold is refused with place and number."""
    x = [[i * 0.87 * D, j * 0.87 * D] for j in range(6) for i in range(6)]
    model = gm.Model(gm.Box(0.0054, 0.0054), gm.Contact(1e5), fluid=WATER)
    grains = gm.Particles(np.array(x) + 0.5 * D, D)
    with pytest.raises(gm.RunError, match="leave a porosity of"):
        gm.Simulation(model, grains, fixed=np.arange(36))


# One disc alone -----------------------------------------------------------------------------------


class Disturbed(gm.drag.Channel):
    """The law of a cylinder between walls, taken for the velocity at the disc itself."""

    undisturbed = False


def falling(law, order, spacing):
    """Speed of the disc of Fig. 3 after 0.8 s, 0.17 m/s by its law."""
    sides = {"left": gm.Slip(), "right": gm.Slip()}
    fluid = gm.Fluid(1000.0, 75.2, law, sides, order=order, dt=0.01, spacing=spacing)
    model = gm.Model(gm.Box(2.0, 2.0), gm.Contact(stiffness=1e5), fluid=fluid)
    run = gm.Simulation(model, gm.Particles(np.array([[1.0, 1.2]]), 0.1, 2000.0)).run(until=0.8)
    return -run.flow.velocity[0, 1]


@pytest.mark.parametrize(
    ("order", "spacing"),
    [(1, None), (2, None), (4, None), *(pytest.param(2, h, marks=SLOW) for h in (0.25, 0.12))],
)
def test_speed_of_one_disc_depends_neither_on_order_nor_on_mesh(order, spacing):
    assert falling(gm.drag.Channel(), order, spacing) == pytest.approx(0.17, rel=0.02)


@SLOW
def test_a_disc_that_feels_its_own_flow_falls_too_fast_the_more_so_the_finer_the_mesh():
    coarse, fine = (falling(Disturbed(), 2, spacing) for spacing in (None, 0.12))
    assert 0.17 * 1.005 < coarse < fine


# Other sides, numbers -----------------------------------------------------------------------------


def test_a_run_goes_on_with_other_sides():
    run = closed(n=30, size=(0.008, 0.012), spacing=1e-3)
    step(run, 4)
    solid = run.flow.velocity.copy()
    sides = {"bottom": gm.Inflow((0.0, 0.004)), "top": gm.Outlet(5.0)}
    sides |= {"left": gm.Slip(), "right": gm.Slip()}
    run.change(replace(run.model, fluid=replace(run.model.fluid, sides=sides)))
    assert np.array_equal(run.flow.velocity, solid)
    step(run, 40)
    found = run.measure()
    assert found["pressure top"] == pytest.approx(5.0, rel=1e-9)
    assert found["pressure bottom"] > 5.0
    # What comes in goes out.
    assert run.flow.flux("top") == pytest.approx(0.004 * 0.008, rel=0.02)
    with pytest.raises(gm.InputError, match="order"):
        run.change(replace(run.model, fluid=replace(run.model.fluid, order=3)))
    with pytest.raises(gm.InputError, match="box with fluid"):
        run.change(replace(run.model, fluid=None))


# The same from a train ----------------------------------------------------------------------------


def seen_from(train, order, nodes):
    """Velocities of discs and of the fluid there, in a periodic box, relative to a train [m/s]."""
    about = {"porosity": 0.9, "spacing": 7e-4} if nodes else {"porosity": 0.7}
    run = soup(n=30, gravity=(0.0, -G), order=order, dt=2e-4, tolerance=1e-10, **about)
    run = gm.Simulation(run.model, run.particles, velocity=run.velocity + train)
    flow = run.flow
    flow.operator.u[flow.mesh.in_use.nonzero()] = train
    flow.Q = flow.operator.momentum()
    run.run(until=0.004)
    return np.array([flow.velocity, flow.operator.u[: len(run)]]) - train


@pytest.mark.parametrize("nodes", [False, True])
@pytest.mark.parametrize("order", [1, 2])
def test_motion_is_the_same_from_a_train(order, nodes):
    """At thirty times their own speed: nodes of the fluid go along (`navier`, Eq. 6, `nodes`)."""
    at_rest, passing = (seen_from(np.array([u, 0.0]), order, nodes) for u in (0.0, 1.0))
    for rest, moving in zip(at_rest, passing, strict=True):
        assert np.abs(moving - rest).max() < 1e-6 * np.abs(rest).max()
