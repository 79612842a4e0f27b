"""The contact law: closed forms of collisions, order in the step, Coulomb's bound, mistakes."""

import importlib.util
from inspect import signature
from math import exp, log, pi, sqrt
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import grainmesh as gm
from grainmesh.contact import STEPS, bond

D, RHO, V = 0.01, 1000.0, 1.0  # diameter [m], density [kg/m3], speed of approach [m/s]
K = 1e8  # stiffness [N/m]
PHASES = (np.arange(12) + 0.5) / 12.0  # where in a step the contact begins
AT_REST = (0.0, 0.0)
KINDS = {"discs": (1.0, False), "discs 1:3": (3.0, False), "wall": (1.0, True)}


@pytest.fixture(scope="module")
def dem():
    """docs/dem.py, for its solution of the same law by SciPy."""
    path = Path(__file__).parent.parent / "docs" / "dem.py"
    spec = importlib.util.spec_from_file_location("dem", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def collide(contact, phase, steps=STEPS, kind="discs"):
    """Restitution and duration, in contact times, of a head-on collision."""
    ratio, wall = KINDS[kind]
    d = D * np.array([1.0, ratio])
    m1, m2 = RHO * pi * d**2 / 4.0
    time = contact.contact_time(m1 if wall else m1 * m2 / (m1 + m2))
    dt = time / steps
    gap = (3.0 + phase) * V * dt
    box = gm.Box(0.2, 0.2)
    model = gm.Model(box, contact, gravity=AT_REST, dt=dt)
    if wall:
        particles, velocity = gm.Particles([[0.1, D / 2.0 + gap]], D, RHO), [[0.0, -V]]
    else:
        x = np.array([[0.1 - d.sum() / 2.0 - gap, 0.1], [0.1, 0.1]])
        particles, velocity = gm.Particles(x, d, RHO), [[V, 0.0], AT_REST]
    run = gm.Simulation(model, particles, velocity=velocity).run(until=(1.5 * steps + 6.0) * dt)
    if wall:
        out, opened = run.velocity[0, 1], run.x[0, 1] - D / 2.0
    else:
        out = run.velocity[1, 0] - run.velocity[0, 0]
        opened = run.x[1, 0] - run.x[0, 0] - d.sum() / 2.0
    return out / V, (run.t - opened / out - gap / V) / time


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("e", [0.9, 0.5])
def test_restitution_and_contact_time_at_the_recommended_step(e, kind):
    contact = gm.Contact(K, e)
    found = np.array([collide(contact, phase, kind=kind) for phase in PHASES])
    assert np.abs(found - [e, 1.0]).max() < 1e-3


@pytest.mark.parametrize("kind", KINDS)
def test_elastic_collision_keeps_the_energy(kind):
    found = np.array([collide(gm.Contact(K, 1.0), phase, kind=kind) for phase in PHASES])
    assert np.abs(found[:, 0] - 1.0).max() < 1e-10
    assert np.abs(found[:, 1] - 1.0).max() < 1e-3


@pytest.mark.parametrize("e", [1.0, 0.9, 0.5])
@pytest.mark.parametrize("kind", KINDS)
def test_second_order_in_the_step_for_every_phase(e, kind):
    contact = gm.Contact(K, e)
    error = np.array(
        [
            [np.abs(np.array(collide(contact, phase, n, kind)) - [e, 1.0]) for phase in PHASES]
            for n in (STEPS, 4 * STEPS)
        ]
    )
    slope = np.log(error[0] / error[1]) / log(4.0)
    assert slope[:, 1].min() > 1.8
    if e < 1.0:
        assert slope[:, 0].min() > 1.8


def test_contact_that_begins_exactly_on_a_step():
    for phase in (0.0, 1e-13, 1.0 - 1e-13):
        assert collide(gm.Contact(K, 1.0), phase)[0] == pytest.approx(1.0, abs=1e-10)
        assert collide(gm.Contact(K, 0.5), phase)[0] == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("e", [1.0, 0.9, 0.5])
def test_oblique_collisions_converge_to_the_law(dem, e):
    """Slip and stick in turn: from fifty to two hundred steps the error falls to a small part."""
    contact = dem.law(friction=0.3, restitution=e)
    for s in (0.3, 0.7, 1.0, 5.0):
        error = []
        for steps in (50, 200):
            (u, w, _), (found, spin, _) = dem.meet(
                contact, (0.2 * s, -0.2), floor=True, steps=steps
            )
            error.append(max(abs(found[0] - u[0])) / 0.2 + abs(spin[0] - w[0]) * dem.D / 0.4)
        assert error[0] < 2e-3
        assert error[1] < max(0.25 * error[0], 5e-5)


@given(st.floats(0.05, 1.0), st.floats(1e-3, 1e3), st.floats(1e2, 1e9))
def test_restitution_and_damping_are_one_law(e, mass, k):
    by_e = gm.Contact(k, e)
    ratio = by_e.damping_ratio(mass)
    by_c = gm.Contact(k, damping=2.0 * ratio * sqrt(k / mass))
    assert exp(-pi * ratio / sqrt(1.0 - ratio**2)) == pytest.approx(e)
    assert by_c.restitution_of(mass) == pytest.approx(e)
    assert by_c.contact_time(mass) == pytest.approx(by_e.contact_time(mass))
    pair = np.array([mass])
    assert by_c.coefficient(pair) == pytest.approx(by_e.coefficient(pair), rel=1e-12, abs=0.0)


def test_contact_time_of_the_undamped_pair():
    assert gm.Contact(4.0, 1.0).contact_time(1.0) == pytest.approx(pi / 2.0)
    assert gm.Contact(4.0, 0.5).contact_time(1.0) > pi / 2.0


ONE = st.floats(-1.0, 1.0)


def force(**values):
    """`bond` by names, with a unit mass and c_t = c/2."""
    values |= {"pliant": 1.0 / values["kt"], "ct": 0.5 * values["c"], "mass": 1.0}
    return bond(*(values[name] for name in signature(bond.py_func).parameters))


@settings(max_examples=300, deadline=None)
@given(st.floats(0.2, 1.0), *[ONE] * 9, st.floats(0.0, 2.0), st.floats(1e-3, 2.0))
def test_friction_and_rolling_stay_within_their_bounds(
    o, un, vn, ut, vt, ur, vr, q, qr, c, mu, mur
):
    """In contact, |f_t| <= mu f_n; with all tangents reversed, all tangential forces are."""
    k, kt, c, dt = 1.0, 0.3, abs(c), 0.1

    def law(sign):
        speeds = {"un": un, "vn": vn, "ut": sign * ut, "vt": sign * vt}
        rolls = {"ur": sign * ur, "vr": sign * vr, "q": sign * q, "qr": sign * qr}
        return force(o=o, k=k, kt=kt, c=c, mu=mu, mur=mur, dt=dt, **speeds, **rolls)

    fn, ft, _, fr, new, newr = law(1.0)
    most = max(fn, 0.0)
    assert fn == pytest.approx(k * o + c * vn)
    assert abs(ft) <= mu * most * (1.0 + 1e-12)
    assert abs(fr) <= mur * most * (1.0 + 1e-12)
    # The spring either grew by the slip, or gives way so that the force is at its bound.
    for f, bound, was, now, u, v in ((ft, mu, q, new, ut, vt), (fr, mur, qr, newr, ur, vr)):
        assert f == pytest.approx(kt * now + 0.5 * c * v, abs=1e-12)
        if abs(f) < bound * most * (1.0 - 1e-9):
            assert now == pytest.approx(was + u * dt)
    back = law(-1.0)
    assert back[0] == fn
    assert [back[i] for i in (1, 3, 4, 5)] == [-ft, -fr, -new, -newr]


def test_no_contact_no_force_and_no_memory():
    speeds = {"un": 0.3, "vn": 0.3, "ut": 0.2, "vt": 0.2, "ur": 0.1, "vr": 0.1}
    law = {"k": 1.0, "kt": 0.3, "c": 0.1, "mu": 0.5, "mur": 0.1}
    assert force(o=-0.1, q=2.0, qr=3.0, dt=0.1, **speeds, **law) == (0.0,) * 6


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("stiffness", (0.0, -1.0, np.inf, np.nan)),
        ("restitution", (0.0, -0.1, 1.0001, np.nan)),
        ("damping", (-1.0, np.inf, np.nan)),
        ("friction", (-0.1, np.inf, np.nan)),
        ("tangential", (0.0, -0.1, 1.1, np.nan)),
        ("tangential_damping", (-0.1, 1.1, np.nan)),
        ("rolling", (-0.1, np.inf, np.nan)),
    ],
)
def test_bad_parameters_are_named(key, values):
    for value in values:
        with pytest.raises(gm.InputError, match=key) as fault:
            gm.Contact(**{"stiffness": 1e5, key: value})
        assert "\n" not in str(fault.value)


def test_restitution_and_damping_together_are_refused():
    with pytest.raises(gm.InputError, match="restitution or damping"):
        gm.Contact(1e5, restitution=0.5, damping=1.0)


def test_neither_gives_the_stated_restitution():
    assert gm.Contact(1e5).restitution_of(1.0) == pytest.approx(0.9)


def test_overdamped_pairs_are_refused_with_what_would_do():
    contact = gm.Contact(1e5, damping=2.1 * sqrt(1e5))
    with pytest.raises(gm.InputError, match="at most") as fault:
        contact.contact_time(1.0)
    most = float(str(fault.value).split("at most ")[1].split()[0])
    assert gm.Contact(1e5, damping=most).contact_time(1.0) > 0.0


def test_too_large_a_step_is_refused_with_what_would_do():
    contact, particles = gm.Contact(1e5, 0.8), gm.Particles([[0.1, 0.1], [0.12, 0.1]], D, RHO)
    box = gm.Box(0.2, 0.2)
    with pytest.raises(gm.InputError, match="too large") as fault:
        gm.Simulation(gm.Model(box, contact, dt=1.0), particles)
    assert "\n" not in str(fault.value)
    for words in ("at most ", "better "):
        dt = float(str(fault.value).split(words)[1].split()[0])
        assert gm.Simulation(gm.Model(box, contact, dt=dt), particles).dt == dt
