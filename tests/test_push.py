"""Steps under a drag and forces of a fluid: limits that are exact, and momentum that closes."""

import numpy as np
import pytest

import grainmesh as gm

D, RHO, G = 0.01, 1000.0, 9.81
MASS = RHO * np.pi * D**2 / 4.0


def alone(gravity=(0.0, 0.0), dt=1e-4, stiffness=1e4):
    """One disc in empty space."""
    model = gm.Model(gm.Box(1.0, 1.0, periodic=True), gm.Contact(stiffness), gravity=gravity, dt=dt)
    return gm.Simulation(model, gm.Particles([[0.99, 0.5]], D, RHO))


def gas(n=80, seed=0):
    """Discs of unequal size and density that collide in a periodic box."""
    rng = np.random.default_rng(seed)
    d = 0.05 * 2.0 ** -rng.uniform(0, 1, n)
    box, particles = gm.arrange.random(n, porosity=0.5, diameter=d, seed=seed)
    particles = gm.Particles(particles.x, particles.diameter, rng.uniform(500.0, 3000.0, n))
    law = gm.Contact(1e6, restitution=0.9, friction=0.4)
    model = gm.Model(box, law, gravity=(0.3, -0.5))
    return gm.Simulation(model, particles, rng.normal(0, 0.5, (n, 2)), rng.normal(0, 20.0, n)), rng


def masses(run):
    return run.particles.density * np.pi * run.particles.diameter**2 / 4.0


def bits(run):
    contacts = run.contacts
    return [
        run.x, run.velocity, run.spin, contacts.pair, contacts.overlap, contacts.friction,
        np.array([run.step]),
    ]  # fmt: skip


def same(a, b):
    return all(np.array_equal(one, other) for one, other in zip(a, b, strict=True))


@pytest.mark.parametrize("rate", [30.0, 1e3])
def test_a_disc_relaxes_to_its_speed_with_first_order(rate):
    """v = u + (v_0 - u) exp(-D t), u = E/b; and w likewise, with u = q r/c."""
    steps, time = 100, 1.0 / rate
    start, u = np.array([0.5, 1.0]), np.array([0.3, -0.4])
    torque = 0.5 * MASS * rate * 0.02  # over r; speeds of the surface go to 0.02 m/s
    errors = []
    for n in (steps, 2 * steps):
        run = alone(dt=time / n, stiffness=1e3)
        way, v, spin, _ = run._push(
            n, start[None], np.array([3.0]), MASS * rate * u[None], np.array([[rate, rate, torque]])
        )
        left = np.exp(-1.0)
        reached = 0.02 / (D / 2.0)
        errors.append([
            *(v[0] - (u + (start - u) * left)),
            *(way[0] - (u * time + (start - u) * (1.0 - left) / rate)) * rate,
            spin[0] - (reached + (3.0 - reached) * left),
        ])  # fmt: skip
    ratio = np.array(errors[0]) / np.array(errors[1])
    assert np.abs(errors[0]).max() < 0.02
    assert ratio == pytest.approx(2.0 * np.ones(5), abs=0.05)


@pytest.mark.parametrize("rate", [1e-3, 1.0, 1e4, 1e8])
def test_terminal_speed_is_exact_for_any_drag(rate):
    run = alone(gravity=(0.0, -G))
    u = np.array([[0.02, -0.01]])
    force = MASS * (rate * u + [0.0, G])
    v, spin = u, np.zeros(1)
    for _ in range(5):
        way, v, spin, impulse = run._push(7, v, spin, force, np.array([[rate, rate, 0.0]]))
        assert np.abs(v - u).max() < 1e-12
        assert np.abs(way - 7 * run.dt * u).max() < 1e-14
        assert np.abs(impulse).max() < 1e-14 * MASS * (1.0 + rate)
    assert np.array_equal(run.velocity, v)


@pytest.mark.parametrize("rate", [1e4, 1e6, 1e9])
def test_strong_drag_takes_a_disc_along_without_overshoot(rate):
    run = alone()
    start, u = np.array([[1.0, 0.0]]), np.array([[0.1, 0.2]])
    _, v, _, _ = run._push(50, start, np.zeros(1), MASS * rate * u, np.array([[rate, rate, 0.0]]))
    assert np.abs(v - u).max() < 0.3 * np.abs(start - u).max() * min(1.0, 2.0 / (rate * run.dt))


def test_free_fall_is_exact():
    run = alone(gravity=(0.0, -G))
    v, push = np.array([[0.3, 0.1]]), np.array([[0.02, 0.0]])
    time, a = 40 * run.dt, push / MASS + [0.0, -G]
    way, end, _, impulse = run._push(40, v, np.zeros(1), push, np.zeros((1, 3)))
    assert np.abs(way - (v + 0.5 * time * a) * time).max() < 1e-14
    assert np.abs(end - v - time * a).max() < 1e-14
    assert np.abs(impulse).max() < 1e-14 * MASS


def test_way_is_not_wrapped():
    run = alone()
    way, *_ = run._push(
        300, np.array([[1.0, 0.0]]), np.zeros(1), np.zeros((1, 2)), np.zeros((1, 3))
    )
    assert way[0, 0] == pytest.approx(0.03)
    assert run.x[0, 0] == pytest.approx(0.02)


def test_no_drag_equals_zero_drag_bit_by_bit():
    plain, zero = gas()[0], gas()[0]
    zero._drag = np.zeros((len(zero), 3))
    end = 400 * plain.dt
    assert same(bits(plain.run(end)), bits(zero.run(end)))
    assert len(plain.contacts) > 3


def test_pushes_without_drag_are_a_run():
    plain, pushed = gas()[0], gas()[0]
    n, time = len(plain), 300 * plain.dt
    plain.run(time)
    for _ in range(10):
        _, v, spin, _ = pushed._push(
            30, pushed.velocity, pushed.spin, np.zeros((n, 2)), np.zeros((n, 3))
        )
        assert np.abs(pushed.velocity - v).max() < 1e-13
        assert np.abs(pushed.spin - spin).max() < 1e-10
    assert pushed.step == plain.step
    assert pushed.x == pytest.approx(plain.x, abs=1e-11)
    assert pushed.velocity == pytest.approx(plain.velocity, abs=1e-8)


@pytest.mark.parametrize("rate", [0.0, 1.0, 1e3])
def test_momentum_closes_and_contacts_give_none(rate):
    run, rng = gas()
    n, m, g = len(run), masses(run), np.array(run.model.gravity)
    v, spin, hit, order = run.velocity, run.spin, 0.0, run._slot
    for k in range(12):
        # A fluid that keeps the discs in motion.
        drag = np.column_stack([rate * rng.uniform(0.5, 1, (n, 2)), rng.normal(0, 0.1, n)])
        force = m[:, None] * (drag[:, :1] * rng.normal(0, 0.5, (n, 2)) + rng.normal(0, 1, (n, 2)))
        steps = 200 + k
        run.sorted -= 10**6  # the next upkeep sorts the discs
        way, end, spin, impulse = run._push(steps, v, spin, force, drag)
        scale = m @ np.abs(v).max(axis=1) + steps * run.dt * np.abs(force).sum()
        time = steps * run.dt
        pull = time * (force + m[:, None] * g) - (m * drag[:, 0])[:, None] * way
        assert np.abs(m[:, None] * (end - v) - impulse - pull).max() < 1e-13 * scale
        assert np.abs(impulse.sum(axis=0)).max() < 1e-13 * scale
        hit = max(hit, np.abs(impulse).sum() / scale)
        v = end
    assert hit > 0.1
    assert not np.array_equal(order, run._slot)


def test_discs_rest_under_drag():
    """The floor gives back the weight, and what a fluid presses down."""
    box = gm.Box(0.1, 0.1)
    model = gm.Model(box, gm.Contact(1e5, restitution=0.5), gravity=(0.0, -G))
    run = gm.Simulation(model, gm.Particles([[0.05, D / 2]], D, RHO))
    force, v, spin = np.array([[0.0, -0.3 * MASS * G]]), np.zeros((1, 2)), np.zeros(1)
    for _ in range(60):
        way, v, spin, impulse = run._push(50, v, spin, force, np.array([[2.0, 2.0, 0.0]]))
    assert np.abs(v).max() < 1e-6
    assert np.abs(way).max() < 1e-9
    assert impulse[0, 1] == pytest.approx(1.3 * MASS * G * 50 * run.dt, rel=1e-3)


def test_a_push_that_fails_changes_nothing():
    run, _ = gas()
    n = len(run)
    v, spin, drag = run.velocity, run.spin, np.full((n, 3), 2.0)
    run._push(150, v, spin, np.zeros((n, 2)), drag)
    v, spin, before = run.velocity, run.spin, bits(run)
    force = np.zeros((n, 2))
    force[3] = 1e9
    with pytest.raises(gm.RunError, match="particle 3 "):
        run._push(1500, v, spin, force, drag)
    assert same(before, bits(run))
    again, _ = gas()
    again._push(150, again.velocity, again.spin, np.zeros((n, 2)), drag)
    a, b = (one._push(100, v, spin, 0.0 * force, drag) for one in (run, again))
    assert same(a, b)


def test_discs_that_leave_take_their_rows_with_them():
    box = gm.Box(0.1, 0.1)
    model = gm.Model(box, gm.Contact(1e5), gravity=(0.0, 0.0), open=("right",), escape="remove")
    x = np.array([[0.02, 0.02], [0.09, 0.05], [0.02, 0.08]])
    run = gm.Simulation(model, gm.Particles(x, D, RHO))
    v = np.array([[0.1, 0.0], [1.0, 0.0], [0.2, 0.0]])
    rate = np.array([1.0, 0.0, 3.0])
    drag = np.column_stack([rate, rate, 0.0 * rate])
    way, end, _, impulse = run._push(round(0.05 / run.dt), v, np.zeros(3), np.zeros((3, 2)), drag)
    assert run.ids.tolist() == [0, 2]
    assert end[:, 0] == pytest.approx((v[:, 0] * np.exp(-rate * 0.05))[[0, 2]], rel=1e-3)
    assert way == pytest.approx(v[[0, 2]] * 0.05, rel=0.1)
    assert np.abs(impulse).max() < 1e-12 * MASS


def test_a_checkpoint_between_pushes_goes_on_bit_by_bit(tmp_path):
    run, _ = gas()
    n = len(run)
    drag, force = np.full((n, 3), 2.0), np.full((n, 2), 0.1)
    run._push(150, run.velocity, run.spin, force, drag)
    run.save(tmp_path)
    again = gm.resume(tmp_path)
    a, b = (one._push(150, one.velocity, one.spin, force, drag) for one in (run, again))
    assert same(a, b)
    assert same(bits(run), bits(again))
