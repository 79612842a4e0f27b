"""Particles held in place: walls that are round."""

import numpy as np
import pytest

import grainmesh as gm

D, RHO = 0.01, 1000.0


def met(mass=None, e=0.8, friction=0.3):
    """A disc after it has met, off centre, another one that is fixed, or of so many masses."""
    box = gm.Box(0.4, 0.4)
    density = [RHO, RHO if mass is None else RHO * mass]
    k = RHO * np.pi * D**2 / 4.0 * 1e9
    model = gm.Model(box, gm.Contact(k, e, friction=friction), gravity=(0.0, 0.0), dt=1e-6)
    particles = gm.Particles([[0.2, 0.2], [0.2 + D + 1e-6, 0.2]], D, density)
    run = gm.Simulation(
        model, particles, velocity=[[0.5, 0.2], [0.0, 0.0]], spin=[20.0, 0.0],
        fixed=[1] if mass is None else None,
    )  # fmt: skip
    return run.run(until=1.5e-4 + 1e-6 / 0.5)


@pytest.mark.parametrize("friction", [0.0, 0.3, 5.0])
def test_a_fixed_disc_is_one_of_infinite_mass(friction):
    held, heavy = met(friction=friction), met(1e9, friction=friction)
    assert held.velocity[0] == pytest.approx(heavy.velocity[0], rel=1e-6)
    assert held.spin[0] == pytest.approx(heavy.spin[0], rel=1e-6)
    assert not held.velocity[1].any()
    assert held.velocity[0, 0] < 0.0


@pytest.mark.parametrize("e", [1.0, 0.5])
def test_a_disc_bounces_off_with_its_restitution(e):
    assert met(e=e, friction=0.0).velocity[0, 0] == pytest.approx(-0.5 * e, rel=2e-3)


def filter_bed(seed=0, ledger=False, gravity=(0.0, -9.81)):
    """Fine grains that fall between thick fibres, some of which overlap each other and a wall."""
    rng = np.random.default_rng(seed)
    box = gm.Box(0.1, 0.12)
    fibres = np.array([[0.02, 0.02], [0.034, 0.023], [0.06, 0.02], [0.074, 0.02], [0.004, 0.05],
                       [0.05, 0.045]])  # fmt: skip
    thick = 0.016
    grains = np.stack(np.meshgrid(np.arange(0.006, 0.095, 0.0055), np.arange(0.062, 0.115, 0.0055)),
                      axis=-1).reshape(-1, 2)  # fmt: skip
    x = np.vstack([grains, fibres])
    d = np.append(rng.uniform(0.003, 0.005, len(grains)), np.full(len(fibres), thick))
    order = rng.permutation(len(x))
    x, d = x[order], d[order]
    density = rng.uniform(500.0, 1500.0, len(x))
    model = gm.Model(box, gm.Contact(1e5, restitution=0.7, friction=0.2), gravity=gravity)
    velocity = rng.normal(0, 0.3, (len(x), 2))
    fixed = d == thick
    run = gm.Simulation(model, gm.Particles(x, d, density), velocity, ledger=ledger, fixed=fixed)
    return run, fixed


def touching(run):
    """Pairs in contact by a search over all, but those of two fixed discs."""
    x, r, fixed = run.x, run.particles.radius, run.fixed
    away = np.hypot(*np.moveaxis(x[None] - x[:, None], 2, 0))
    near = np.triu(away < r + r[:, None], 1) & ~(fixed & fixed[:, None])
    return np.argwhere(near).tolist()


def test_fixed_discs_stay_and_no_contact_with_them_is_missed():
    run, fixed = filter_bed()
    x, density, met = run.x, run.particles.density, set()
    for k in range(40):
        run.run(0.0125 * (k + 1))
        assert run.contacts.pair.tolist() == touching(run)
        met |= {j for pair in run.contacts.pair.tolist() for j in pair if fixed[j]}
    assert met == set(np.flatnonzero(fixed))
    assert run.sorted > 0
    assert np.array_equal(run.fixed, fixed)
    assert np.array_equal(run.x[fixed], x[fixed])
    assert not run.velocity[fixed].any()
    assert not run.spin[fixed].any()
    assert np.array_equal(run.particles.density, density)
    assert np.ptp(run.x[~fixed] - x[~fixed], axis=0).min() > 0.01
    assert fixed[run.wall_contacts.pair[:, 0]].sum() == 0
    assert np.isfinite(list(run.energies.values())).all()


def test_books_close_with_fixed_discs():
    run, fixed = filter_bed(ledger=True)
    m = np.where(fixed, 0.0, run.particles.density * np.pi * run.particles.radius**2)
    total, start = run.measure()["total"], m @ run.velocity
    fall = run.energies["potential"] + run.energies["kinetic"]
    run.run(0.3)
    books = run.ledger
    assert abs(run.measure()["total"] - total) < 1e-4 * fall
    given = [books[f"impulse of walls {c}"] + books[f"impulse outside {c}"] for c in "xy"]
    weight = m.sum() * np.array(run.model.gravity) * run.t
    change = m @ run.velocity - start
    assert np.abs(change - given - weight).max() < 1e-10 * np.abs(weight).max()
    assert abs(books["impulse outside y"]) > 0.1 * np.abs(weight).max()


def test_a_checkpoint_with_fixed_discs_goes_on_bit_by_bit(tmp_path):
    run, fixed = filter_bed()
    run.run(0.15)
    run.save(tmp_path)
    again = gm.resume(tmp_path).run(0.25)
    run.run(0.25)
    assert np.array_equal(again.x, run.x)
    assert np.array_equal(again.velocity, run.velocity)
    assert np.array_equal(again.fixed, fixed)
    assert np.array_equal(again.particles.density, run.particles.density)


def test_a_push_holds_fixed_discs():
    run, fixed = filter_bed()
    n, x = len(run), run.x
    given = np.ones((n, 2))
    way, v, spin, impulse = run._push(300, given, np.ones(n), given, np.ones((n, 3)))
    for value in (way, v, spin, impulse):
        assert not value[fixed].any()
        assert value[~fixed].any()
    assert np.array_equal(run.x[fixed], x[fixed])


def test_all_may_be_fixed():
    model = gm.Model(gm.Box(0.1, 0.1), gm.Contact(1e4))
    run = gm.Simulation(model, gm.Particles([[0.05, 0.05], [0.0587, 0.05]], D), fixed=[0, 1])
    x = run.x
    assert np.array_equal(run.run(0.05).x, x)
    assert sum(run.energies.values()) == 0.0


@pytest.mark.parametrize(
    ("fixed", "says"),
    [
        ([3], "no particle 3, they are numbered 0 to 2"),
        ([-1], "no particle -1"),
        ([True, False], "one bool for each of the 3"),
        ([0.5], "one bool for each of the 3"),
        ("all", "one bool for each of the 3"),
    ],
)
def test_what_is_no_list_of_particles_is_refused(fixed, says):
    particles = gm.Particles([[0.02, 0.02], [0.05, 0.02], [0.08, 0.02]], D)
    with pytest.raises(gm.InputError, match=says):
        gm.Simulation(gm.Model(gm.Box(0.1, 0.1), gm.Contact(1e4)), particles, fixed=fixed)


@pytest.mark.parametrize(("gap", "fixed", "taken"), [
    (-0.1, [0, 1], True), (-0.1, [0], False), (-0.17, [0, 1], False),
])  # fmt: skip
def test_fixed_discs_may_overlap_more(gap, fixed, taken):
    particles = gm.Particles([[0.05, 0.05], [0.05 + D * (1.0 + gap), 0.05]], D)
    model = gm.Model(gm.Box(0.1, 0.1), gm.Contact(1e4))
    if taken:
        assert len(gm.Simulation(model, particles, fixed=fixed).contacts) == 0
    else:
        with pytest.raises(gm.InputError, match=r"30 %|5 %"):
            gm.Simulation(model, particles, fixed=fixed)


def test_relax_pushes_others_off_fixed_discs():
    box = gm.Box(0.1, 0.1)
    model = gm.Model(box, gm.Contact(1e4))
    x = np.array([[0.0, 0.05], [0.0086, 0.05], [0.012, 0.055], [0.02, 0.002]])
    with pytest.raises(gm.InputError, match="overlap"):
        gm.Simulation(model, gm.Particles(x, D), fixed=[0, 1])
    free = gm.relax(model, gm.Particles(x, D), fixed=[0, 1])
    assert np.array_equal(free.x[:2], x[:2])
    gm.Simulation(model, free, fixed=[0, 1])
