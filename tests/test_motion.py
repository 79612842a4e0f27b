"""Newton's equations: what is conserved, books that close, invariances, the table of the docs."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import grainmesh as gm

D, RHO, G = 0.01, 1000.0, 9.81
WEIGHTLESS = (0.0, 0.0)
BOX = gm.Box(0.4, 0.4)

path = Path(__file__).parent.parent / "docs" / "dem.py"
spec = importlib.util.spec_from_file_location("dem", path)
dem = importlib.util.module_from_spec(spec)
spec.loader.exec_module(dem)


@pytest.mark.parametrize("case", dem.CASES, ids=lambda case: case.__name__)
def test_table_of_the_docs(case):
    for row in case():
        assert row.off <= row.within, row


def mass_of(run):
    return run.particles.density * np.pi * run.particles.diameter**2 / 4.0


def momentum(run):
    return mass_of(run) @ run.velocity


def angular_momentum(run):
    m, (x, y), (u, v) = mass_of(run), run.x.T, run.velocity.T
    return m @ (x * v - y * u + run.particles.radius**2 / 2.0 * run.spin)


def balance(run):
    """Energy that is there, or booked as lost, less what was put in [J/m]."""
    books = run.ledger
    lost = books["damped"] + books["slid"] + books["rolled"]
    return sum(run.energies.values()) + lost - books["work of walls"] - books["work outside"]


def oblique(offset, e=0.8, friction=0.3, rolling=0.0, k=1e7, ratio=3.0, ledger=True):
    """Two discs 1:ratio that spin, about to meet off centre in empty space."""
    d = D * np.array([1.0, ratio])
    reach = d.sum() / 2.0
    contact = gm.Contact(k, e, friction=friction, rolling=rolling)
    m = RHO * np.pi * d**2 / 4.0
    time = contact.contact_time(m.prod() / m.sum())
    x2 = np.array([0.2, 0.2])
    x1 = x2 + reach * np.array([-np.sqrt(1.0 - offset**2), offset]) - [0.2 * time, 0.0]
    model = gm.Model(BOX, contact, gravity=WEIGHTLESS, dt=time / 50.0)
    run = gm.Simulation(
        model, gm.Particles([x1, x2], d, RHO), velocity=[[1.0, 0.0], [-0.1, 0.05]],
        spin=[10.0, -40.0], ledger=ledger,
    )  # fmt: skip
    return run, 2.0 * time


@pytest.mark.parametrize("rolling", [0.0, 0.2])
@pytest.mark.parametrize("friction", [0.0, 0.3, 5.0])
def test_collisions_conserve_momentum_and_angular_momentum(friction, rolling):
    for offset in (0.0, 0.4, 0.9, -0.9):
        run, end = oblique(offset, friction=friction, rolling=rolling, k=1e6)
        p, spin = momentum(run), angular_momentum(run)
        scale = mass_of(run)[0] * 1.0
        run.run(until=end)
        assert abs(run.velocity[0, 0] - 1.0) > 1e-3
        assert np.abs(momentum(run) - p).max() < 1e-13 * scale
        assert abs(angular_momentum(run) - spin) < 1e-13 * scale * 0.2


@pytest.mark.parametrize("rolling", [0.0, 0.2])
@pytest.mark.parametrize("e", [1.0, 0.8, 0.3])
@pytest.mark.parametrize("friction", [0.0, 0.3, 5.0])
def test_books_of_a_collision_close(friction, e, rolling):
    for offset in (0.0, 0.4, 0.9):
        run, end = oblique(offset, e, friction, rolling)
        before, energy = balance(run), sum(run.energies.values())
        run.run(until=end)
        books = run.ledger
        assert abs(balance(run) - before) < 1e-6 * energy
        # Friction and dashpots take energy, they give none.
        assert min(books["damped"], books["slid"], books["rolled"]) > -1e-5 * energy
        if friction == 0.0:
            assert abs(books["slid"]) < 1e-6 * energy
        if e == 1.0:
            assert abs(books["damped"]) < 1e-6 * energy
        if friction == 0.0 and e < 1.0 and offset == 0.0:
            lost = energy - sum(run.energies.values())
            assert books["damped"] + books["rolled"] == pytest.approx(lost, rel=1e-5)


def crowd(
    n=200,
    e=0.8,
    friction=0.3,
    rolling=0.0,
    k=1e6,
    gravity=(0.0, -G),
    walls=(),
    force=None,
    speed=0.2,
):
    """Loose unequal discs in a box that will settle."""
    rng = np.random.default_rng(1)
    width = 20
    i = np.arange(n)
    x = np.stack([(i % width + 0.5) * 1.15 * D, (i // width + 0.7) * 1.2 * D], axis=1)
    x += rng.uniform(-0.05, 0.05, x.shape) * D
    d = D * rng.uniform(0.8, 1.0, n)
    box = gm.Box(1.15 * width * D, (n // width + 4) * 1.2 * D)
    contact = gm.Contact(k, e, friction=friction, rolling=rolling)
    model = gm.Model(box, contact, gravity=gravity, walls=walls, force=force)
    velocity = speed * rng.standard_normal((n, 2))
    return gm.Simulation(model, gm.Particles(x, d, RHO), velocity=velocity, ledger=True)


def test_books_of_a_settling_bed_close():
    for rolling in (0.0, 0.1):
        run = crowd(rolling=rolling)
        before, energy = balance(run), sum(run.energies.values())
        weight = mass_of(run).sum() * G
        p = momentum(run)
        run.run(until=0.25)
        books = run.ledger
        assert abs(balance(run) - before) < 1e-6 * energy
        assert min(books["damped"], books["slid"], books["rolled"]) >= 0.0
        assert (books["rolled"] > 0.0) == (rolling > 0.0)
        # Momentum: what the walls and gravity gave.
        given = [books["impulse of walls x"], books["impulse of walls y"] - weight * run.t]
        assert momentum(run) - p == pytest.approx(given, abs=1e-11 * weight * run.t)


def squeezed(kind):
    """A gas of discs with something that works on it."""
    box = gm.Box(1.15 * 20 * D, 7 * 1.2 * D)
    left = gm.Wall.of(box, "left", **{
        "piston": {"velocity": (0.1, 0.0)},
        "shaken": {"amplitude": (0.3 * D, 0.1 * D), "frequency": 40.0},
    }.get(kind, {}))  # fmt: skip
    force = {"steady": (0.3, 0.1), "changing": swing}.get(kind)
    return crowd(60, gravity=WEIGHTLESS, walls=left, force=force)


def swing(t, x, v):
    return np.stack([0.5 * np.cos(300.0 * t) - 0.1 * v[:, 0], 3.0 * (0.04 - x[:, 1])], axis=1)


@pytest.mark.parametrize("kind", ["piston", "shaken", "steady", "changing"])
def test_books_close_where_walls_and_forces_work(kind):
    run = squeezed(kind)
    before, energy, p = balance(run), sum(run.energies.values()), momentum(run)
    seen = []

    def see(run):
        if (
            len(run.contacts) + len(run.wall_contacts) == 0
        ):  # no spring loaded, see `motion` Eq. (3)
            seen.append(balance(run) - before)

    run.run(until=0.05, every=2e-4, observe=see)
    books = run.ledger
    assert len(seen) > 3
    assert np.median(np.abs(seen)) < 1e-6 * energy
    assert abs(books["work of walls"] + books["work outside"]) > 0.01 * energy
    given = [books[f"impulse of walls {c}"] + books[f"impulse outside {c}"] for c in "xy"]
    assert momentum(run) - p == pytest.approx(given, abs=1e-11 * mass_of(run).sum())


def test_free_flight_is_exact():
    """A parabola, and a spin that stays: velocity-Verlet makes no error under gravity."""
    model = gm.Model(gm.Box(4.0, 4.0), gm.Contact(1e5), gravity=(0.3, -G))
    run = gm.Simulation(model, gm.Particles([[1.0, 3.0]], D, RHO), velocity=(0.5, 1.0), spin=7.0)
    run.run(until=0.4)
    t, g = run.t, np.array([0.3, -G])
    assert run.x[0] == pytest.approx(
        [1.0, 3.0] + np.array([0.5, 1.0]) * t + g * t**2 / 2.0, abs=1e-9
    )
    assert run.velocity[0] == pytest.approx(np.array([0.5, 1.0]) + g * t, abs=1e-9)
    assert run.spin[0] == pytest.approx(7.0, abs=1e-12)


def small(transform=lambda x: x, turn=1.0, scale=(1.0, 1.0, 1.0), order=None, size=(0.08, 0.09)):
    """Thirty discs and two inclined walls, seen in another frame or other units (m, s, kg)."""
    length, time, mass = scale
    rng = np.random.default_rng(3)
    i = np.arange(30)
    x = np.stack([(i % 6 + 0.8) * 1.1 * D, (i // 6 + 2.2) * 0.9 * D], axis=1)
    x += rng.uniform(-0.02, 0.02, x.shape) * D
    d, v, w = D * rng.uniform(0.5, 0.8, 30), rng.standard_normal((30, 2)), rng.standard_normal(30)
    v, w = 0.5 * v, 50.0 * w
    order = np.arange(30) if order is None else order
    x, d, v, w = x[order], d[order], v[order], w[order]
    unit = mass / length / time**2  # of stiffness, and of m g: both per length of depth
    contact = gm.Contact(1e6 * unit, 0.7, friction=0.4, rolling=0.05)
    place, way = lambda p: tuple(length * transform(np.array(p))), speedy(transform)
    walls = tuple(
        gm.Wall(place(a), place(b), velocity=tuple(length / time * way(u)))
        for a, b, u in (
            ((0.0, 0.02), (0.02, 0.001), WEIGHTLESS),
            ((0.079, 0.001), (0.079, 0.04), (-0.05, 0.02)),
        )
    )
    box = gm.Box(*(length * np.abs(way(np.array(size)))))
    model = gm.Model(box, contact, gravity=tuple(length / time**2 * way((0.0, -G))), walls=walls)
    run = gm.Simulation(
        model, gm.Particles(length * transform(x), length * d, RHO * mass / length**3),
        velocity=length / time * way(v), spin=turn * w / time,
    )  # fmt: skip
    start = run.spin
    run.run(until=0.03 * time)
    assert (np.abs(run.spin / start - 1.0) > 0.01).sum() > 15  # most discs have been hit
    return run


def speedy(transform):
    """What a change of frame does to vectors."""
    return lambda v: transform(np.asarray(v, dtype=float)) - transform(np.zeros(2))


FRAMES = {  # of a box 0.08 x 0.09: places there, and the sense of rotation
    "mirror": (lambda x: np.array([0.08, 0.0]) + np.asarray(x) * [-1.0, 1.0], -1.0),
    "quarter turn": (lambda x: np.array([0.09, 0.0]) + np.asarray(x)[..., ::-1] * [-1.0, 1.0], 1.0),
}


@pytest.mark.parametrize("frame", FRAMES)
def test_motion_is_the_same_in_another_frame(frame):
    transform, turn = FRAMES[frame]
    here, there = small(), small(transform, turn)
    assert there.x == pytest.approx(transform(here.x), abs=1e-8 * D)
    assert there.velocity == pytest.approx(speedy(transform)(here.velocity), abs=1e-8)
    assert there.spin == pytest.approx(turn * here.spin, abs=1e-5)


def test_motion_is_the_same_in_other_units():
    length, time, mass = 1e3, 60.0, 1e-4
    here, there = small(), small(scale=(length, time, mass))
    assert there.x / length == pytest.approx(here.x, abs=1e-8 * D)
    assert there.velocity * time / length == pytest.approx(here.velocity, abs=1e-8)
    energy = mass * length**2 / time**2 / length
    for name, value in here.energies.items():
        assert there.energies[name] / energy == pytest.approx(value, rel=1e-6)


def test_numbers_of_discs_do_not_matter():
    order = np.random.default_rng(5).permutation(30)
    here, there = small(), small(order=order)
    assert there.x == pytest.approx(here.x[order], abs=1e-8 * D)


def test_keeping_books_changes_no_bit():
    run, end = oblique(0.4)
    bare, _ = oblique(0.4, ledger=False)
    run.run(until=end)
    bare.run(until=end)
    assert bare.ledger == {}
    assert (run.x == bare.x).all()
    assert (run.spin == bare.spin).all()


def test_a_moving_frame_is_not_felt():
    """A collision in a periodic box that drifts as a whole."""
    box = gm.Box(0.1, 0.1, periodic=True)
    contact = gm.Contact(1e7, 0.7, friction=0.4)
    u = np.array([0.37, -0.21])
    runs = []
    for drift in (0.0 * u, u):
        model = gm.Model(box, contact, gravity=WEIGHTLESS)
        particles = gm.Particles([[0.03, 0.05], [0.05, 0.053]], D, RHO)
        run = gm.Simulation(model, particles, velocity=np.array([[1.0, 0.0], WEIGHTLESS]) + drift)
        runs.append(run.run(until=0.05))
    assert runs[1].velocity - u == pytest.approx(runs[0].velocity, abs=1e-8)
    assert runs[1].spin == pytest.approx(runs[0].spin, abs=1e-5)
    assert abs(runs[0].spin).min() > 1.0
