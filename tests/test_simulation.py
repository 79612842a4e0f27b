"""Runs: no contact is ever missed, same bits again, faults stop with the last good state."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import grainmesh as gm

close = partial(pytest.approx, abs=0.0)


# A search over all pairs, which knows nothing of triangles ----------------------------------------


def all_overlaps(simulation):
    """Overlaps [m] above `-slack` of all pairs and images: {(i, j): sorted overlaps}."""
    particles, box = simulation.particles, simulation.model.box
    x, r, name = particles.x, particles.radius, simulation.ids
    hops = np.zeros((1, 2))
    if box.periodic:
        hops = np.stack(np.meshgrid(*2 * [np.arange(-1, 2)]), axis=-1).reshape(-1, 2) * box.size
    found = {}
    for hop in hops:
        away = x[None] + hop - x[:, None]
        overlap = r[None] + r[:, None] - np.hypot(away[..., 0], away[..., 1])
        for i, j in np.argwhere(np.triu(overlap > -1e-12 * r.min(), 1)).tolist():
            found.setdefault((int(name[i]), int(name[j])), []).append(overlap[i, j])
    return found


def wall_overlaps(simulation):
    """The same of discs with walls that are sides, or lie across a periodic box: {(i, w): ...}."""
    particles, model, t = simulation.particles, simulation.model, simulation.t
    found = {}
    for w, wall in enumerate(model.all_walls):
        swing = np.sin(2.0 * np.pi * wall.frequency * t)
        at = np.array(wall.start) + np.array(wall.velocity) * t + np.array(wall.amplitude) * swing
        x, y = (particles.x - at).T
        if wall.side is None:
            assert wall.start[1] == wall.end[1]
            assert abs(wall.end[0] - wall.start[0]) == model.box.width
            distance = abs(y - model.box.height * np.round(y / model.box.height))
        else:
            distance = {"left": x, "right": -x, "bottom": y, "top": -y}[wall.side]
        overlap = particles.radius - distance
        for i in np.flatnonzero(overlap > -1e-12 * particles.radius.min()).tolist():
            found[int(simulation.ids[i]), w] = [overlap[i]]
    return found


def same(contacts, wanted, slack):
    """Contacts are those wanted, but for overlaps of less than `slack` [m]; returns how many."""
    found = {}
    for pair, overlap in zip(contacts.pair.tolist(), contacts.overlap.tolist(), strict=True):
        found.setdefault(tuple(pair), []).append(overlap)
    for pair in found.keys() | wanted.keys():
        a, b = (sorted(o for o in side.get(pair, []) if o > slack) for side in (found, wanted))
        if len(a) != len(b):  # an overlap next to the slack
            a, b = (
                sorted(o for o in side.get(pair, []) if o > 2 * slack) for side in (found, wanted)
            )
        assert a == pytest.approx(b, abs=slack), (pair, a, b)
    return len(found)


class Search:
    """Compares contacts with those of a search over all pairs whenever it is called."""

    def __init__(self):
        self.calls = self.discs = self.walls = 0
        self.met, self.touched = set(), set()

    def __call__(self, simulation):
        slack = 1e-11 * float(simulation.particles.radius.max())
        slack = max(slack, 1e-12 * float(simulation.model.box.size.max()))
        discs, walls = simulation.contacts, simulation.wall_contacts
        self.discs += same(discs, all_overlaps(simulation), slack)
        self.walls += same(walls, wall_overlaps(simulation), slack)
        self.met |= set(map(tuple, discs.pair.tolist()))
        self.touched |= set(map(tuple, walls.pair.tolist()))
        self.calls += 1
        self.last = simulation


def checked(simulation, time, looks):
    """Run for a time, and compare with the search at so many instants."""
    search, first = Search(), simulation.t
    search(simulation)
    for k in range(looks):
        simulation.run(first + time * (k + 1) / looks)
        search(simulation)
    return search


def law_for(particles, speed, **kind):
    """A law so stiff that discs of this speed overlap by a fifth of the smallest radius."""
    mass = (particles.density * np.pi * particles.radius**2).max()
    stiffness = mass * (speed / (0.2 * particles.radius.min())) ** 2
    return gm.Contact(stiffness, **{"restitution": 0.5, "friction": 0.5, **kind})


def a_bed(n=60, ratio=1.0, seed=0, speed=0.5, law=None, ledger=False, **kind):
    """Loose discs in a box with walls, thrown about."""
    rng = np.random.default_rng(seed)
    d = 0.1 * ratio ** -rng.uniform(0, 1, n)
    columns = int(np.ceil(np.sqrt(n)))
    box = gm.Box(0.13 * columns, 0.19 * columns)
    particles = gm.arrange.loose(box, n, diameter=d, gap=0.2, seed=seed)
    fastest = np.sqrt(2 * 9.81 * box.height) + 2.0 * speed
    model = gm.Model(box, law_for(particles, fastest, **(law or {})), **kind)
    velocity, spin = rng.normal(0, speed, (n, 2)), rng.normal(0, 5.0, n)
    return gm.Simulation(model, particles, velocity, spin, ledger=ledger)


def a_torus(n=60, porosity=0.3, ratio=1.0, seed=0, speed=0.5, law=None, ledger=False, **kind):
    """Discs in a periodic box."""
    rng = np.random.default_rng(seed)
    d = 0.1 * ratio ** -rng.uniform(0, 1, n)
    box, particles = gm.arrange.random(n, porosity=porosity, diameter=d, seed=seed)
    law = law_for(particles, 3.0 * speed + 1.0, **(law or {}))
    model = gm.Model(box, law, **{"gravity": (0.0, 0.0), **kind})
    velocity, spin = rng.normal(0, speed, (n, 2)), rng.normal(0, 5.0, n)
    return gm.Simulation(model, particles, velocity, spin, ledger=ledger)


RATIOS = pytest.mark.parametrize("ratio", [1.0, 10.0])


@RATIOS
def test_no_contact_is_missed_in_a_bed_that_settles(ratio):
    simulation = a_bed(ratio=ratio)
    search = checked(simulation, 0.8, 200)
    assert len(simulation.contacts) > 10
    assert search.walls > search.calls
    assert len(search.met) > 60
    assert len({w for _, w in search.touched}) == 3
    assert simulation.upkeeps > 50
    assert simulation.measure()["flips"] > 60
    assert simulation.sorted > 0


@RATIOS
def test_no_contact_is_missed_in_a_box_that_shakes(ratio):
    simulation = a_bed(ratio=ratio, seed=1)
    box = simulation.model.box
    shaken = (
        gm.Wall.of(box, "bottom", amplitude=(0.0, 0.01), frequency=15.0),
        gm.Wall.of(box, "left", amplitude=(0.01, 0.0), frequency=10.0, friction=1.0),
        gm.Wall.of(box, "right", amplitude=(-0.01, 0.0), frequency=10.0),
    )
    model = replace(simulation.model, walls=shaken)
    simulation = gm.Simulation(model, simulation.particles, simulation.velocity)
    search = checked(simulation, 0.8, 400)
    assert {w for _, w in search.touched} >= {0, 1, 2}
    assert len(search.met) > 20
    assert simulation.upkeeps > 100
    assert simulation.measure()["flips"] > 100


def shear(simulation, speed=1.0):
    """A force that drags discs along a sinusoidal flow."""
    height, particles = simulation.model.box.height, simulation.particles
    drag = 20.0 * particles.density * np.pi * particles.radius**2

    def force(t, x, v):
        flow = speed * np.stack([np.sin(2.0 * np.pi * x[:, 1] / height), np.zeros(len(x))], axis=1)
        return drag[:, None] * (flow - v)

    return force


@pytest.mark.parametrize("ratio", [1.0, 3.0])
def test_no_contact_is_missed_in_periodic_shear(ratio):
    simulation = a_torus(n=40, ratio=ratio, seed=2)
    model = replace(simulation.model, force=shear(simulation))
    simulation = gm.Simulation(model, simulation.particles, simulation.velocity)
    search = checked(simulation, 1.2 if ratio == 1.0 else 0.5, 100)
    assert len(search.met) > 60
    assert search.discs > 3 * search.calls
    assert simulation.upkeeps > 50
    assert simulation.measure()["flips"] > 60
    assert np.abs(simulation._s[:, :2] / model.box.size - 0.5).max() > 0.6  # over the edge


@RATIOS
def test_no_contact_is_missed_between_walls_that_slide_across_a_periodic_box(ratio):
    simulation = a_torus(porosity=0.45, ratio=ratio, seed=3)
    box = simulation.model.box
    edge = 0.5 * box.height
    walls = (
        gm.Wall((0.0, 0.0), (box.width, 0.0), velocity=(1.0, 0.0), friction=1.0),
        gm.Wall((box.width, edge), (0.0, edge), velocity=(-1.0, 0.0), amplitude=(0.0, 0.005),
                frequency=20.0, friction=1.0),
    )  # fmt: skip
    model = replace(simulation.model, walls=walls)
    start = gm.relax(model, simulation.particles)
    search = checked(gm.Simulation(model, start), 1.2 * box.width, 150)
    simulation = search.last
    assert {w for _, w in search.touched} == {0, 1}
    assert len(search.met) > 40
    assert simulation.upkeeps > 50
    assert simulation.measure()["flips"] > 40


@pytest.mark.parametrize("periodic", [False, True])
def test_no_contact_is_missed_in_a_gas_of_fast_discs(periodic):
    law = {"restitution": 1.0, "friction": 0.0}
    kind = {"ratio": 3.0, "speed": 4.0, "law": law, "gravity": (0.0, 0.0)}
    simulation = a_torus(porosity=0.7, **kind) if periodic else a_bed(**kind)
    energy = sum(simulation.energies.values())
    search = checked(simulation, 0.3, 250)
    assert len(search.met) > 50
    assert len(search.touched) > 20 or periodic
    assert simulation.upkeeps > 100
    assert simulation.measure()["flips"] > 100
    # And what has met has met elastically.
    assert sum(simulation.energies.values()) == close(energy, rel=1e-4)


def test_no_contact_is_missed_at_any_single_step():
    simulation = a_torus(n=25, porosity=0.35, ratio=4.0, seed=5, speed=4.0)
    search = checked(simulation, 1200 * simulation.dt, 1200)
    assert simulation.step == 1200
    assert search.calls == 1201
    assert len(search.met) > 10


def test_a_mesh_made_anew_misses_none():
    # Two groups fly apart, beyond the nodes around them, and back from the walls.
    rng = np.random.default_rng(0)
    near = 0.11 * np.stack(np.meshgrid(np.arange(3), np.arange(4)), axis=-1).reshape(-1, 2)
    x = np.vstack([near + 4.0, near + 5.0]) + rng.uniform(-0.004, 0.004, (24, 2))
    velocity = np.repeat([[-4.0, 1.0], [4.0, -1.0]], 12, axis=0) + rng.normal(0, 0.5, (24, 2))
    model = gm.Model(gm.Box(10.0, 10.0), gm.Contact(1e6, 0.95, friction=0.1), gravity=(0.0, 0.0))
    simulation = gm.Simulation(model, gm.Particles(x, 0.1), velocity)
    search = checked(simulation, 4.0, 400)
    assert simulation._mesh.made > 2
    assert len(search.met) > 8
    assert len(search.touched) > 5


# Small systems ------------------------------------------------------------------------------------


def scattered(rng, box, d, wall):
    """As many discs as find a place, the largest first; `wall`: none lies across y = 0."""
    x, kept = np.empty((0, 2)), np.empty(0)
    for size in np.sort(d)[::-1]:
        edge = 0.5 * size * np.array([not box.periodic, wall or not box.periodic])
        for _ in range(30):
            y = rng.uniform(edge, box.size - edge)
            if (np.hypot(*box.separation(x, y).T) > (kept + size) / 2).all():
                x, kept = np.vstack([x, y]), np.append(kept, size)
                break
    return gm.Particles(x, kept)


@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(1, 8),
    seed=st.integers(0, 10**6),
    ratio=st.sampled_from([1.0, 10.0]),
    fill=st.floats(0.1, 0.5),
    periodic=st.booleans(),
    friction=st.sampled_from([0.0, 0.6]),
)
def test_a_few_discs_in_a_narrow_box_miss_none(n, seed, ratio, fill, periodic, friction):
    rng = np.random.default_rng(seed)
    d = ratio ** -rng.uniform(0, 1, n)
    aspect = rng.uniform(1.0, 2.0)
    size = max(np.sqrt(np.pi / 4 * (d**2).sum() / fill / aspect), 1.01 * d.max())
    box = gm.Box(aspect * size, size, periodic)
    wall = periodic and rng.random() < 0.5
    particles = scattered(rng, box, d, wall)
    n = len(particles)
    walls = (gm.Wall((0, 0), (box.width, 0), velocity=(0.5, 0)),) if wall else ()
    kind = {"restitution": rng.uniform(0.3, 1.0), "friction": friction, "rolling": 0.1 * friction}
    model = gm.Model(box, law_for(particles, 6.0, **kind), tuple(rng.normal(0, 1, 2)), walls)
    simulation = gm.Simulation(
        model, particles, rng.normal(0, 2.0, (n, 2)), rng.normal(0, 5.0, n), ledger=seed % 2 == 0
    )
    checked(simulation, 600 * simulation.dt, 40)
    state = simulation.x, simulation.velocity, simulation.spin
    assert all(np.isfinite(values).all() for values in state)


@pytest.mark.parametrize("size", [1.0001, 1.5])
def test_one_disc_in_a_periodic_box_hardly_larger(size):
    box = gm.Box(size, 1.0001, periodic=True)
    model = gm.Model(box, gm.Contact(1e5), gravity=(0.0, 0.0))
    simulation = gm.Simulation(model, gm.Particles([[0.2, 0.3]], 1.0), velocity=(1.0, 0.3))
    checked(simulation, 3000 * simulation.dt, 30)
    way = simulation.t * np.array([1.0, 0.3])
    away = simulation.x[0] - [0.2, 0.3] - way
    assert away == pytest.approx(box.size * np.round(away / box.size), abs=1e-9)
    assert len(simulation.contacts) == 0


def test_two_discs_that_touch_on_two_sides_of_a_periodic_box():
    box = gm.Box(2.0 - 1e-3, 3.0, periodic=True)  # each is squeezed between images of the other
    model = gm.Model(box, gm.Contact(1e5, friction=0.0), gravity=(0.0, 0.0))
    x = np.array([[0.1, 1.0], [0.1 + 0.5 * box.width, 1.0]])
    simulation = gm.Simulation(model, gm.Particles(x, 1.0))
    assert simulation.contacts.pair.tolist() == [[0, 1], [0, 1]]
    assert simulation.contacts.overlap == pytest.approx([5e-4, 5e-4], rel=1e-9)
    assert simulation.contacts.normal.sum(axis=0) == pytest.approx([0.0, 0.0], abs=1e-12)
    checked(simulation, 500 * simulation.dt, 50)
    assert simulation.velocity == pytest.approx(np.zeros((2, 2)), abs=1e-9)  # in balance


# Same bits ----------------------------------------------------------------------------------------


def bits(simulation):
    """All that a user can see, as bytes."""
    parts = [simulation.x, simulation.velocity, simulation.spin, simulation.ids]
    for contacts in (simulation.contacts, simulation.wall_contacts):
        parts += [
            contacts.pair,
            contacts.overlap,
            contacts.normal,
            contacts.force,
            contacts.friction,
        ]
    numbers = {**simulation.ledger, **simulation.energies, "t": simulation.t}
    return [part.tobytes() for part in parts] + [np.array(list(numbers.values())).tobytes()]


def a_flow(kind):
    """Discs that slide, stick, roll, are sorted, and exchange neighbours."""
    law = {"friction": 0.5, "rolling": 0.1}
    if kind == "bed":
        simulation = a_bed(n=40, ratio=2.0, seed=4, law=law)
        box = simulation.model.box
        walls = (
            gm.Wall.of(box, "bottom", velocity=(1.0, 0.0), amplitude=(0.0, 0.002), frequency=20.0),
            gm.Wall((0.3, 0.2), (0.5, 0.35), friction=0.9),
        )
        model = replace(simulation.model, walls=walls)
    else:
        simulation = a_torus(n=40, ratio=2.0, seed=4, law=law)
        model = replace(simulation.model, force=shear(simulation))
    particles = gm.relax(model, simulation.particles)
    return gm.Simulation(model, particles, simulation.velocity, 1.0, ledger=True)


KINDS = ["bed", "torus"]


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_run_gives_the_same_bits(kind):
    first, second = a_flow(kind), a_flow(kind)
    assert bits(first) == bits(second)
    first.run(0.4)
    second.run(0.4)
    assert bits(first) == bits(second)
    assert len(first.contacts) > 0
    assert np.count_nonzero(first.contacts.friction) > 0


@pytest.mark.parametrize("kind", KINDS)
def test_pieces_of_a_run_give_the_bits_of_the_whole(kind):
    whole, pieces = a_flow(kind), a_flow(kind)
    end = 2500 * whole.dt
    whole.run(end)
    for part in (0.0004, 0.1, 0.1012, 0.5, 0.8, 1.0):
        pieces.run(part * end)
        pieces.measure()
    assert pieces.step == whole.step == 2500
    assert bits(pieces) == bits(whole)
    seen = []
    looked = a_flow(kind).run(end, every=77 * whole.dt, observe=lambda s: seen.append(s.step))
    assert bits(looked) == bits(whole)
    assert seen == [*range(77, 2500, 77), 2500]
    assert [row["step"] for row in looked.history] == seen


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_that_was_stopped_goes_on_with_the_same_bits(tmp_path, kind):
    whole, half = a_flow(kind), a_flow(kind)
    steps = round(0.5 / whole.dt)
    middle, end = steps * whole.dt, 2 * steps * whole.dt
    whole.run(end)
    half.run(middle, save=tmp_path)
    flips, upkeeps, ordered = half.measure()["flips"], half.upkeeps, half.sorted
    assert np.count_nonzero(half.contacts.friction) > 5
    force = half.model.force
    again = gm.resume(tmp_path, **({"force": force} if callable(force) else {}))
    assert bits(again) == bits(half)
    assert again.history == half.history
    again.run(end)
    assert again.step == whole.step == 2 * steps
    assert bits(again) == bits(whole)
    # Much has happened in between.
    assert again.measure()["flips"] == whole.measure()["flips"] > flips + 50
    assert again.sorted == whole.sorted > ordered
    assert again.upkeeps == whole.upkeeps > upkeeps + 20
    met, others = (set(map(tuple, one.contacts.pair.tolist())) for one in (whole, half))
    assert len(met ^ others) > 10
    # And on from there, from a second stop in another folder.
    half.save(tmp_path / "other")
    third = gm.resume(tmp_path / "other", **({"force": force} if callable(force) else {}))
    assert bits(third.run(end)) == bits(whole)


def springs(contacts):
    return dict(zip(map(tuple, contacts.pair.tolist()), contacts.friction.tolist(), strict=True))


def test_springs_of_friction_live_through_upkeep_and_sorting():
    simulation = a_bed(n=40, seed=6, law={"restitution": 0.2, "rolling": 0.3}).run(1.5)
    before, walls = springs(simulation.contacts), springs(simulation.wall_contacts)
    assert min(len(before), len(walls)) > 5
    assert all(before.values())
    order = simulation._slot.copy()
    simulation._s[:, 1] *= -1.0  # only to sort otherwise
    simulation.sorted = -(10**9)
    simulation._sort(gm.pairs.memory(simulation._pairs), gm.pairs.memory(simulation._touch))
    simulation._s[:, 1] *= -1.0
    simulation._upkeep()
    assert (simulation._slot != order).any()
    assert springs(simulation.contacts) == before
    assert springs(simulation.wall_contacts) == walls


# Invariances --------------------------------------------------------------------------------------


def thrown(model, x, d, velocity, spin, steps=400):
    simulation = gm.Simulation(model, gm.Particles(x, d), velocity, spin)
    simulation.run(steps * simulation.dt)
    free = velocity + np.array(model.gravity) * simulation.t
    pushed = np.abs(simulation.velocity - free).max(axis=1) > 1e-3
    assert pushed.sum() > 10
    return simulation


@pytest.fixture(params=[False, True], ids=["walls", "torus"])
def throw(request):
    """Model, places, diameters, velocities, spins, with discs about to collide."""
    if request.param:
        made = a_torus(n=40, porosity=0.22, ratio=2.0, seed=7, speed=1.0).run(0.02)
    else:
        made = a_bed(n=40, ratio=3.0).run(0.7)
    p, rng = made.particles, np.random.default_rng(0)
    return made.model, p.x, p.diameter, made.velocity, rng.normal(0, 5.0, 40)


def test_names_of_particles_do_not_matter(throw):
    model, x, d, velocity, spin = throw
    one = thrown(model, x, d, velocity, spin)
    new = np.random.default_rng(1).permutation(len(x))
    other = thrown(model, x[new], d[new], velocity[new], spin[new])
    assert other.x == pytest.approx(one.x[new], abs=1e-10)
    assert other.velocity == pytest.approx(one.velocity[new], abs=1e-7)
    assert other.spin == pytest.approx(one.spin[new], abs=1e-5)
    renamed = {
        tuple(sorted((np.argsort(new)[i], np.argsort(new)[j]))) for i, j in one.contacts.pair
    }
    assert set(map(tuple, other.contacts.pair.tolist())) == renamed


def test_a_mirror_image_moves_as_a_mirror_image(throw):
    model, x, d, velocity, spin = throw
    one = thrown(model, x, d, velocity, spin)
    flip, width = np.array([-1.0, 1.0]), np.array([model.box.width, 0.0])
    other = thrown(model, x * flip + width, d, velocity * flip, -spin)
    assert other.x * flip + width == pytest.approx(one.x, abs=1e-10)
    assert other.velocity * flip == pytest.approx(one.velocity, abs=1e-7)
    assert -other.spin == pytest.approx(one.spin, abs=1e-5)


def test_where_a_periodic_box_is_cut_does_not_matter():
    made = a_torus(n=40, porosity=0.22, ratio=2.0, seed=7, speed=1.0).run(0.02)
    p, box = made.particles, made.model.box
    one = thrown(made.model, p.x, p.diameter, made.velocity, made.spin)
    by = np.array([0.37 * box.width, 7.61 * box.height])
    other = thrown(made.model, p.x + by, p.diameter, made.velocity, made.spin)
    away = other.x - one.x - by
    assert away == pytest.approx(box.size * np.round(away / box.size), abs=1e-10)
    assert other.velocity == pytest.approx(one.velocity, abs=1e-7)


def test_units_do_not_matter(throw):
    # Lengths in another unit (a), times too (b), masses (c): powers of two, so the same bits.
    model, x, d, velocity, spin = throw
    a, b, c = 2.0**-10, 2.0**-3, 2.0**5
    one = thrown(model, x, d, velocity, spin)
    box = gm.Box(model.box.width * a, model.box.height * a, model.box.periodic)
    law = replace(model.contact, stiffness=model.contact.stiffness * c / a / b**2)
    gravity = tuple(g * a / b**2 for g in model.gravity)
    # The mass per depth goes with c/a: density times a² is c/a.
    particles = gm.Particles(x * a, d * a, 1000.0 * c / a**3)
    other = gm.Simulation(
        replace(model, box=box, contact=law, gravity=gravity), particles, velocity * a / b, spin / b
    )
    other.run(400 * other.dt)
    assert other.dt == close(one.dt * b, rel=1e-12)
    assert other.x / a == pytest.approx(one.x, abs=1e-10)
    assert other.velocity * b / a == pytest.approx(one.velocity, abs=1e-7)
    assert other.contacts.pair.tolist() == one.contacts.pair.tolist()


# Upkeep -------------------------------------------------------------------------------------------


def areas(mesh):
    a, b, c = np.moveaxis(mesh.points[mesh.triangles] + mesh.shifts * mesh.period, 1, 0)
    (x, y), (z, w) = (b - a).T, (c - a).T
    return 0.5 * (x * w - y * z)


@pytest.mark.parametrize("kind", KINDS)
def test_the_triangulation_stays_valid_while_discs_flow(kind):
    simulation = a_flow(kind)
    mesh = simulation._mesh
    seen = []

    def look(simulation):
        # It belongs to the places of the last upkeep.
        found = areas(mesh)
        assert (found > 0.0).all()
        if simulation.model.box.periodic:
            assert found.sum() == close(simulation.model.box.area, rel=1e-10)
        assert mesh.points[: len(simulation)] == pytest.approx(
            simulation._seen[: len(simulation), :2]
        )
        seen.append(simulation.measure()["flips"])

    simulation.run(0.5, every=0.005, observe=look)
    assert (np.diff(seen) >= 0).all()
    assert seen[-1] > seen[0] + 60
    assert simulation.seconds["steps"] > 0.0
    assert simulation.seconds["upkeep"] > 0.0


def test_what_a_user_sees_is_in_the_order_of_the_user():
    # Discs of all different sizes keep their size and, far apart, their velocity.
    rng = np.random.default_rng(0)
    n = 40
    box, particles = gm.arrange.random(n, porosity=0.9, diameter=rng.uniform(0.5, 1, n), seed=1)
    model = gm.Model(box, gm.Contact(1e6, 1.0, friction=0.0), gravity=(0.0, 0.0))
    simulation = gm.Simulation(model, particles, rng.normal(0, 1.0, (n, 2)), rng.normal(0, 1, n))
    spin = simulation.spin.copy()
    ordered = simulation.sorted
    simulation.run(20.0)
    assert simulation.sorted > ordered
    assert not (np.diff(simulation._slot) == 1).all()
    assert (simulation.particles.diameter == particles.diameter).all()
    assert simulation.particles.density == close(particles.density, rel=1e-14)
    assert simulation.ids.tolist() == list(range(n))
    assert simulation.spin == close(spin, rel=1e-9)  # without friction nothing turns them


# A heap ------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_column_that_collapses_runs_out_less_far_the_rougher_its_discs(seed):
    n, d = 300, np.random.default_rng(seed).uniform(0.008, 0.012, 300)
    rough = ((0.05, 0.0), (0.1, 0.0), (0.5, 0.0), (0.5, 0.1), (0.5, 0.3))
    narrow, wide = gm.Box(0.15, 0.6), gm.Box(3.0, 0.6)
    particles = gm.arrange.loose(narrow, n, diameter=d, seed=seed, density=1000.0)
    law = gm.Contact(1e6, restitution=0.3, friction=0.5)
    column = gm.Simulation(gm.Model(narrow, law), particles).run(0.6)
    height, reach, mound = column.measure()["height"], [], []
    for friction, rolling in rough:
        law = gm.Contact(1e6, restitution=0.3, friction=friction, rolling=rolling)
        heap = gm.Simulation(gm.Model(wide, law), column.particles).run(1.2)
        reach.append(np.quantile(heap.x[:, 0], 0.95))
        mound.append(np.quantile(heap.x[:, 1], 0.95))
        assert heap.measure()["flips"] > 1000
        same(heap.contacts, all_overlaps(heap), 1e-12)
    assert (np.diff(reach) < 0.0).all()
    assert (np.diff(mound) > 0.0).all()
    assert reach[0] > 2.0 * reach[-1]
    assert reach[-1] > 1.2 * narrow.width  # and yet it has collapsed
    assert mound[-1] < 0.8 * height


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, "1 s", True])
def test_times_that_cannot_be_reached_are_refused(value):
    run = gm.Simulation(
        gm.Model(gm.Box(1.0, 1.0), gm.Contact(1.0)), gm.Particles([[0.5, 0.5]], 0.1)
    )
    for times in ({"until": value}, {"until": 1.0, "every": value}):
        with pytest.raises(gm.InputError, match=r"run: (until|every) = .* must be"):
            run.run(**times)
    assert run.step == 0
