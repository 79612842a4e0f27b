"""Runs that cannot go on stop with one plain line, in the last good state, which is saved."""

import re
from dataclasses import replace

import numpy as np
import pytest

import grainmesh as gm
from grainmesh import simulation

BOX = gm.Box(1.0, 1.0)
LAW = gm.Contact(1e6, restitution=0.8)


def state(simulation):
    return [simulation.x, simulation.velocity, simulation.spin, simulation.contacts.friction]


def stopped(simulation, until, folder, error=gm.RunError):
    """The message of a run that stops, after checks of what it leaves behind."""
    with pytest.raises(error) as stop:
        simulation.run(until, save=folder)
    line = str(stop.value)
    assert "\n" not in line
    assert simulation.t < until
    assert all(np.isfinite(values).all() for values in state(simulation))
    assert all(np.isfinite(value) for value in simulation.measure().values())
    assert np.isfinite(list(simulation.ledger.values())).all()
    if error is gm.RunError:
        force = simulation.model.force
        again = gm.resume(folder, **({"force": force} if callable(force) else {}))
        for one, other in zip(state(again), state(simulation), strict=True):
            assert (one == other).all()
    return line


def pile(seed=0, n=30, **kind):
    """Discs in a loose pile, with their sizes all different."""
    box = gm.Box(1.0, 1.5)
    d = np.random.default_rng(seed).uniform(0.06, 0.12, n)
    particles = gm.arrange.loose(box, n, diameter=d, gap=0.2, seed=seed, density=1000.0)
    model = gm.Model(box, LAW, **kind)
    return gm.Simulation(model, particles, ledger=True)


# Forces ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_force_that_is_not_finite_names_the_particle_and_the_time(tmp_path, bad):
    def force(t, x, v):
        value = np.zeros_like(x)
        value[7, 1] = bad if t > 0.2 else 0.0
        return value

    simulation = pile(force=force)
    line = stopped(simulation, 1.0, tmp_path)
    assert "force from outside of particle 7 is not finite" in line
    when = float(re.search(r"t = ([-.e\d]+) s", line).group(1))
    assert when == pytest.approx(0.2, abs=2 * simulation.dt)
    assert simulation.t == pytest.approx(0.2, abs=2 * simulation.dt)  # not long before
    # Until then it is the run without that force.
    same = pile(force=lambda t, x, v: np.zeros_like(x)).run(simulation.t)
    assert same.step == simulation.step
    assert (same.x == simulation.x).all()


def test_a_force_of_a_wrong_shape_or_that_fails_itself_leaves_a_good_state(tmp_path):
    def wrong(t, x, v):
        return np.zeros(2 if t < 0.1 else 3)

    def failing(t, x, v):
        return np.zeros(2) if t < 0.1 else 1 / 0

    def stopping(t, x, v):
        if t > 0.1:
            raise KeyboardInterrupt
        return np.zeros(2)

    quiet = pile(force=lambda t, x, v: np.zeros(2))
    faults = {wrong: gm.RunError, failing: ZeroDivisionError, stopping: KeyboardInterrupt}
    for force, error in faults.items():
        simulation = pile(force=force)
        stopped(simulation, 1.0, tmp_path, error)
        quiet.run(simulation.t)
        assert quiet.step == simulation.step
        for one, other in zip(state(quiet), state(simulation), strict=True):
            assert (one == other).all()


def test_it_goes_on_from_the_last_good_state_once_the_force_is_mended(tmp_path):
    def force(t, x, v):
        return np.full_like(x, np.nan if broken and t > 0.3 else 0.0)

    broken = True
    simulation, whole = pile(force=force), pile(force=lambda t, x, v: np.zeros_like(x))
    flips = pile(force=lambda t, x, v: np.zeros_like(x)).run(0.3).measure()["flips"]
    stopped(simulation, 1.0, tmp_path)
    assert simulation.measure()["flips"] >= flips > 0  # still counted
    broken = False
    again = gm.resume(tmp_path, force=force)
    for one in simulation, again:
        one.run(0.8)
    whole.run(0.8)
    # A mesh made anew may be sorted at another time, so forces are added up in another order.
    assert simulation.x == pytest.approx(whole.x, abs=1e-9)
    assert again.x == pytest.approx(whole.x, abs=1e-9)


@pytest.mark.parametrize("size", [1e8, 1e150, 1e300])
@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.filterwarnings("ignore:overflow")
def test_a_particle_that_is_blown_away_stops_the_run(tmp_path, size, periodic):
    force = np.zeros((3, 2))
    force[1] = size, 0.0
    model = gm.Model(gm.Box(1.0, 1.0, periodic), LAW, gravity=(0.0, 0.0), force=force)
    x = np.array([[0.2, 0.5], [0.5, 0.5], [0.8, 0.4]])
    simulation = gm.Simulation(model, gm.Particles(x, 0.1), ledger=True)
    line = stopped(simulation, 1.0, tmp_path)
    assert "particle 1" in line
    assert "t = " in line
    assert simulation.x == pytest.approx(x, abs=0.1)


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid")
def test_numbers_that_overflow_name_the_particle(tmp_path):
    simulation = pile()
    simulation.run(0.1)
    i = int(np.flatnonzero(simulation._slot == 4)[0])
    good = simulation.x
    simulation._p[i, gm.motion.EX] = np.inf  # as if a force had overflowed
    with pytest.raises(gm.RunError, match=r"particle 4 is not finite at t = 0\.1"):
        simulation.run(1.0)
    assert simulation.t == pytest.approx(0.1, abs=0.1)
    assert (simulation.x == good).all()


# Soft contacts -----------------------------------------------------------------------------------


@pytest.mark.parametrize("stiffness", [10.0, 1e3, 3e4])
def test_contacts_too_soft_stop_the_run_with_advice_that_helps(tmp_path, stiffness):
    def falling(stiffness):
        box = gm.Box(0.5, 3.0)
        d = np.random.default_rng(0).uniform(0.06, 0.12, 20)
        particles = gm.arrange.loose(box, 20, diameter=d, gap=0.2)
        return gm.Simulation(gm.Model(box, gm.Contact(stiffness)), particles)

    simulation = falling(stiffness)
    line = stopped(simulation, 1.0, tmp_path)
    for _ in range(5):
        simulation = falling(float(re.search(r"to ([.e+\d]+) N/m", line).group(1)))
        try:
            simulation.run(1.0)
        except gm.RunError as stop:
            line = str(stop)
        else:
            break
    assert simulation.t >= 1.0
    inside = np.minimum(simulation.x, simulation.model.box.size - simulation.x).min(axis=1)
    assert (inside > 0.5 * simulation.particles.radius).all()


def test_a_disc_pressed_through_a_wall_is_no_nonsense(tmp_path):
    # A piston presses discs against the floor, slowly, until they would go through.
    piston = gm.Wall.of(BOX, "top", velocity=(0.0, -0.5))
    model = gm.Model(BOX, gm.Contact(1e4, 0.5), walls=(piston,))
    x = np.array([[0.2, 0.2], [0.5, 0.2], [0.8, 0.2]])
    simulation = gm.Simulation(model, gm.Particles(x, 0.3))
    line = stopped(simulation, 2.0, tmp_path)
    assert "particle" in line
    assert "wall" in line
    assert 1.0 - 0.5 * simulation.t > 0.15  # soon enough


# Open sides --------------------------------------------------------------------------------------


def launched(escape, **kind):
    x = 0.1 + 0.2 * np.stack(np.meshgrid(np.arange(5), np.arange(5)), axis=-1).reshape(-1, 2)
    rng = np.random.default_rng(0)
    velocity = rng.normal(0, 0.4, x.shape)
    model = gm.Model(BOX, gm.Contact(1e5), open=("left", "top"), escape=escape, **kind)
    d = rng.uniform(0.01, 0.02, len(x))
    return gm.Simulation(model, gm.Particles(x, d), velocity), x, velocity, d


def test_a_particle_that_leaves_is_named_and_the_run_stops(tmp_path):
    simulation, *_ = launched("error", gravity=(0.0, 0.0))
    line = stopped(simulation, 1.0, tmp_path)
    i = int(re.search(r"particle (\d+) left the box through an open side", line).group(1))
    x, y = simulation.x[i]
    r = simulation.particles.radius[i]
    assert x < 2 * r or y > 1 - 2 * r
    assert len(simulation) == 25


def test_those_that_leave_are_removed_and_the_others_keep_their_names(tmp_path):
    # Those that never touch fly on parabolas, known exactly.
    g = np.array([-2.0, 1.0])
    simulation, x, velocity, d = launched("remove", gravity=tuple(g))
    met, left = set(), set()

    def look(simulation):
        for contacts, both in (simulation.contacts, True), (simulation.wall_contacts, False):
            met.update(contacts.pair.ravel().tolist() if both else contacts.pair[:, 0].tolist())
        t, ids = simulation.t, simulation.ids
        assert (np.diff(ids) > 0).all()
        assert not left & set(ids.tolist())
        left.update(set(range(25)) - set(ids.tolist()))
        free = np.flatnonzero(~np.isin(ids, sorted(met)))
        i = ids[free]
        way = x[i] + velocity[i] * t + 0.5 * g * t**2
        assert simulation.x[free] == pytest.approx(way, abs=1e-9)
        assert simulation.velocity[free] == pytest.approx(velocity[i] + g * t, abs=1e-9)
        assert (simulation.particles.diameter == d[ids]).all()
        # None stays far outside, and none that is inside is taken away.
        for k in sorted(left - met):
            place = x[k] + velocity[k] * t + 0.5 * g * t**2
            assert place[0] < 0.0 or place[1] > 1.0
        gone = (simulation.x[:, 0] < -0.03) | (simulation.x[:, 1] > 1.03)
        assert not gone.any()

    simulation.run(0.6, every=0.001, observe=look)
    assert 3 < len(simulation) < 22
    assert len(set(range(25)) - left - met) > 3
    # It can be stopped in between.
    simulation.save(tmp_path)
    again = gm.resume(tmp_path)
    assert again.ids.tolist() == simulation.ids.tolist()
    assert (again.run(0.7).x == simulation.run(0.7).x).all()


def test_forces_given_once_stay_with_their_particles():
    force = np.arange(50.0).reshape(25, 2) * 1e-3
    simulation, x, velocity, _ = launched("remove", gravity=(0.0, 0.0), force=force)
    mass = 1000.0 * np.pi * simulation.particles.radius**2
    simulation.run(0.05)
    met = set(simulation.contacts.pair.ravel().tolist())
    simulation.run(0.3)
    ids = simulation.ids
    assert len(ids) < 25
    way = velocity[ids] * simulation.t + 0.5 * (force / mass[:, None])[ids] * simulation.t**2
    on_way = np.abs(simulation.x - x[ids] - way).max(axis=1) < 1e-9
    assert on_way.sum() > 8
    assert not met & set(ids[on_way].tolist())


def test_a_force_function_is_given_those_that_are_left():
    seen = []

    def force(t, x, v):
        assert x.shape == v.shape
        seen.append(len(x))
        bad = np.zeros_like(x)
        if t > 0.45:
            bad[-1] = np.nan
        return bad

    simulation, *_ = launched("remove", gravity=(0.0, 0.0), force=force)
    with pytest.raises(gm.RunError) as stop:
        simulation.run(0.6)
    assert f"particle {simulation.ids[-1]} " in str(stop.value)  # by its first name
    assert simulation.ids[-1] >= len(simulation)
    assert seen[0] == 25 > seen[-1]


def test_the_last_one_leaves(tmp_path):
    model = gm.Model(BOX, LAW, open=("bottom",), escape="remove")
    x = np.array([[0.2, 0.5], [0.5, 0.6]])
    simulation = gm.Simulation(model, gm.Particles(x, 0.1))
    line = stopped(simulation, 2.0, tmp_path)
    assert "the last particle left the box at t = " in line
    assert simulation.ids.tolist() == [1]


@pytest.mark.parametrize("until", [0.0, -1.0, np.nan, np.inf])
def test_a_time_that_makes_no_sense_is_refused(until):
    for times in {"until": until}, {"until": 1.0, "every": until}:
        with pytest.raises(gm.InputError, match="must be positive"):
            pile().run(**times)


def test_a_time_that_is_past_already_changes_nothing():
    simulation = pile().run(0.1)
    before = state(simulation)
    simulation.run(0.05)
    for one, other in zip(before, state(simulation), strict=True):
        assert (one == other).all()


def test_a_bed_goes_on_with_another_model():
    box = gm.Box(0.02, 0.04)
    grains = gm.arrange.loose(box, 100, diameter=(0.8e-3, 1.2e-3), seed=1)
    closed = gm.Model(box, gm.Contact(1e6, restitution=0.5))
    bed = gm.Simulation(closed, grains).run(until=0.08)
    springs, before = bed.contacts.friction, bed.x
    # The same model again changes nothing, to the bit.
    same = gm.Simulation(closed, grains).run(until=0.08).change(closed).run(until=0.085)
    bed.run(until=0.085)
    assert np.array_equal(same.x, bed.x)
    assert np.array_equal(same.contacts.friction, bed.contacts.friction)
    assert len(springs) > 50
    assert not np.array_equal(before, bed.x)
    # A floor with a hole lets some out; a wall amidst the discs is refused and changes nothing.
    floor = (gm.Wall((0, 0), (0.007, 0)), gm.Wall((0.013, 0), (0.02, 0)))
    hole = replace(closed, walls=floor, open=("bottom",), escape="remove")
    bed.change(hole)
    with pytest.raises(gm.InputError, match="sticks in wall 0"):
        bed.change(replace(closed, walls=(gm.Wall((0, 0.003), (0.02, 0.003)),)))
    assert bed.model.walls == floor
    bed.run(until=0.14)
    assert 10 < len(bed) < 100
    assert set(bed.ids) <= set(range(100))


def test_an_interrupt_leaves_the_last_good_state(monkeypatch):
    """One that comes just as the compiled loop returns."""
    box = gm.Box(0.02, 0.04)
    bed = gm.Simulation(
        gm.Model(box, gm.Contact(1e6)), gm.arrange.loose(box, 50, diameter=1e-3, seed=1)
    ).run(until=0.001)
    step, x = bed.step, bed.x
    advance = simulation.motion.advance

    def interrupted(*arguments):
        advance(*arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(simulation.motion, "advance", interrupted)
    with pytest.raises(KeyboardInterrupt):
        bed.run(until=0.01)
    assert bed.step == step
    assert np.array_equal(bed.x, x)


@pytest.mark.parametrize("restitution", [0.5, 0.05, 0.01])
@pytest.mark.parametrize("tangential_damping", [0.5, 1.0])
@pytest.mark.parametrize("coarse", [False, True])
def test_strong_damping_is_stable(restitution, tangential_damping, coarse):
    """A bed comes to rest, spins too, with the step advised and the largest taken."""
    box = gm.Box(0.01, 0.03)
    grains = gm.arrange.loose(box, 40, diameter=(0.8e-3, 1.2e-3), seed=1)
    law = gm.Contact(
        2e5, restitution=restitution, friction=0.5, tangential_damping=tangential_damping
    )
    model = gm.Model(box, law)
    if coarse:
        with pytest.raises(gm.InputError, match="at most") as refused:
            gm.Simulation(replace(model, dt=1.0), grains)
        most = float(re.search(r"at most ([-+.e\d]+)", str(refused.value)).group(1))
        model = replace(model, dt=most)
    bed = gm.Simulation(model, grains)
    fall = bed.energies["potential"]
    bed.run(until=0.25)
    assert bed.energies["rotational"] < 1e-6 * fall
    assert bed.energies["kinetic"] < 1e-6 * fall
