"""Walls: segments, ends, joints, inclined, moving; and mistakes in walls and models."""

from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import grainmesh as gm

D, RHO, G = 0.01, 2500.0, 9.81
R, MASS = D / 2.0, 2500.0 * np.pi * D**2 / 4.0
BOX = gm.Box(0.4, 0.2)
WEIGHTLESS = (0.0, 0.0)
SOFT, STIFF = 1e6, 1e8  # stiffness [N/m]

close = partial(pytest.approx, abs=0.0)


def one(walls, x, v, contact=None, gravity=WEIGHTLESS, spin=0.0, box=BOX, ledger=False):
    """A disc at x with velocity v."""
    contact = contact or gm.Contact(STIFF, 1.0, friction=0.0)
    model = gm.Model(box, contact, gravity=gravity, walls=walls)
    return gm.Simulation(model, gm.Particles([x], D, RHO), velocity=v, spin=spin, ledger=ledger)


def turned(x, angle, about=(0.2, 0.1)):
    """Points turned about a point."""
    c, s = np.cos(angle), np.sin(angle)
    return (np.asarray(x) - about) @ np.array([[c, s], [-s, c]]) + about


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("angle", [0.0, 0.4, np.pi / 2.0, 3.0])
def test_a_segment_reflects_from_both_sides(side, angle):
    a, b, x = turned([[0.17, 0.1], [0.23, 0.1], [0.2, 0.1 + 2.0 * side * D]], angle)
    v = turned([0.3, -side], angle, (0.0, 0.0))
    run = one(gm.Wall(a, b), x, v).run(until=0.03)
    assert turned(run.velocity[0], -angle, (0.0, 0.0)) == pytest.approx([0.3, side], abs=1e-9)


@pytest.mark.parametrize("offset", [-0.7, -0.2, 0.3, 0.8])
def test_an_end_reflects_along_the_line_of_centres(offset):
    """A disc that flies along a segment meets its end, a point."""
    x, v = np.array([0.1, 0.1 + offset * R]), np.array([1.0, 0.0])
    contact = gm.Contact(1e12, 1.0, friction=0.0)  # so stiff that the line hardly turns
    run = one(gm.Wall((0.12, 0.1), (0.2, 0.1)), x, v, contact).run(until=0.03)
    n = np.array([np.sqrt(1.0 - offset**2), -offset])
    assert run.velocity[0] == pytest.approx(v - 2.0 * (v @ n) * n, abs=5e-4)
    assert np.hypot(*run.velocity[0]) == pytest.approx(1.0, abs=1e-6)


def polyline(points):
    return tuple(gm.Wall(a, b) for a, b in pairwise(points))


def test_joints_of_a_straight_floor_are_not_felt():
    """The force is the weight wherever the disc is, so no joint counts twice or not at all."""
    floor = polyline([(x, 0.05) for x in np.linspace(0.0, 0.4, 38)])
    y = 0.05 + R - MASS * G / SOFT
    run = one(floor, (0.05, y), (1.0, 0.0), gm.Contact(SOFT, 0.8, friction=0.0), (0.0, -G))
    forces = []
    see = lambda run: forces.append(run.wall_contacts.force.sum())  # noqa: E731
    run.run(until=0.25, every=0.25 / 500, observe=see)
    assert run.x[0, 0] == close(0.05 + run.t, rel=1e-9)
    assert run.velocity[0] == pytest.approx([1.0, 0.0], abs=1e-9)
    assert np.array(forces) == close(MASS * G, rel=1e-6)


@pytest.mark.parametrize("bend", [-0.02, 0.02])
def test_a_bent_floor_keeps_the_speed(bend):
    """Frictionless: v² + 2 g y stays to 1e-3, and the disc is not thrown by double contacts."""
    n = 24
    x = np.linspace(0.02, 0.38, n + 1)
    y = 0.08 + bend * 12.5 * (x - 0.2) ** 2
    contact = gm.Contact(STIFF, 1.0, friction=0.0)
    i = 3
    x0 = np.array([0.5 * (x[i] + x[i + 1]), 0.5 * (y[i] + y[i + 1])])
    along = np.array([x[i + 1] - x[i], y[i + 1] - y[i]])
    along /= np.hypot(*along)
    start = x0 + (R - MASS * G / STIFF) * np.array([-along[1], along[0]])
    run = one(polyline(list(zip(x, y, strict=True))), start, 0.8 * along, contact, (0.0, -G))
    energy = lambda: 0.5 * (run.velocity[0] ** 2).sum() + G * run.x[0, 1]  # noqa: E731
    before = energy()
    most = []
    see = lambda run: most.append(len(run.wall_contacts))  # noqa: E731
    run.run(until=0.3, every=0.3 / 3000, observe=see)
    assert run.x[0, 0] > 0.25
    assert energy() == pytest.approx(before, rel=1e-3)
    if bend < 0.0:  # at the top of a hill one wall, or the point where two meet, holds the disc
        assert max(most) == 1


def test_a_disc_in_a_corner_is_held_by_both_walls():
    """A groove of 90 degrees: each flank carries the weight over sqrt 2."""
    groove = polyline([(0.1, 0.15), (0.2, 0.05), (0.3, 0.15)])
    run = one(
        groove, (0.2, 0.05 + R * 2**0.5), WEIGHTLESS, gm.Contact(SOFT, 0.3, friction=0.0), (0.0, -G)
    )
    run.run(until=0.1)
    assert run.wall_contacts.force == close(MASS * G / 2**0.5, rel=1e-6)


@pytest.mark.parametrize("walls", ["one", "many"])
@pytest.mark.parametrize("ratio", [0.5, 0.9, 1.1, 2.0])
def test_inclined_plane_rolls_or_slides(ratio, walls):
    """Rolls with 2/3 g sin θ if tan θ < 3 mu, else slides with g (sin θ - mu cos θ)."""
    mu = 0.2
    θ = np.arctan(3.0 * mu * ratio)
    n = 1 if walls == "one" else 20
    down = np.array([np.cos(θ), -np.sin(θ)])
    normal = np.array([np.sin(θ), np.cos(θ)])
    low = np.array([0.2, 0.1]) - 0.11 * down
    plane = polyline([tuple(low + 0.22 * k / n * down) for k in range(n + 1)])
    start = low + 0.0543 * down + (R - MASS * G * np.cos(θ) / STIFF) * normal
    run = one(plane, start, WEIGHTLESS, gm.Contact(STIFF, 0.3, friction=mu), (0.0, -G))
    run.run(until=0.1)
    a = 2.0 / 3.0 * G * np.sin(θ) if ratio < 1.0 else G * (np.sin(θ) - mu * np.cos(θ))
    assert run.velocity[0] @ down == close(0.1 * a, rel=5e-3)
    assert run.velocity[0] @ normal == pytest.approx(0.0, abs=1e-3 * a)
    slip = run.velocity[0] @ down + R * run.spin[0]
    assert (abs(slip) < 1e-2 * a * 0.1) == (ratio < 1.0)


def belt(rolling):
    contact = gm.Contact(STIFF, 0.3, friction=0.5, rolling=rolling)
    wall = gm.Wall.of(BOX, "bottom", velocity=(0.2, 0.0))
    return one(wall, (0.05, R - MASS * G / STIFF), WEIGHTLESS, contact, (0.0, -G), ledger=True)


def test_a_belt_drags_a_disc_to_a_third_of_its_speed_and_with_resistance_to_all_of_it():
    """Free to turn it rolls backwards on the belt; rolling resistance ends that."""
    run = belt(0.0).run(until=0.2)
    assert run.velocity[0, 0] == close(0.2 / 3.0, rel=1e-3)
    assert run.velocity[0, 0] + R * run.spin[0] == close(0.2, rel=1e-3)
    run = belt(0.3)
    start = sum(run.energies.values())
    run.run(until=0.6)
    assert run.velocity[0, 0] == close(0.2, rel=1e-6)
    assert run.spin[0] == pytest.approx(0.0, abs=1e-6)
    books = run.ledger
    assert books["impulse of walls x"] == close(MASS * 0.2, rel=1e-6)
    # The belt works with its force times its speed, whatever the disc does.
    assert books["work of walls"] == close(MASS * 0.2**2, rel=1e-6)
    gained = sum(run.energies.values()) - start
    lost = books["damped"] + books["slid"] + books["rolled"]
    assert gained + lost == close(books["work of walls"], rel=1e-6)
    assert min(books["damped"], books["slid"], books["rolled"]) >= 0.0


@pytest.mark.parametrize("e", [1.0, 0.5])
@pytest.mark.parametrize("moves", ["side", "segment"])
def test_a_piston_pushes(moves, e):
    """v' = (1 + e) u for a disc at rest; what the wall does is what the disc and its heat get."""
    u = 0.3
    wall = (
        gm.Wall.of(BOX, "left", velocity=(u, 0.0))
        if moves == "side"
        else gm.Wall((0.0, 0.05), (0.0, 0.15), velocity=(u, 0.0))
    )
    contact = gm.Contact(STIFF, e, friction=0.0)
    opened = gm.Model(
        BOX, contact, gravity=WEIGHTLESS, walls=wall, open=() if moves == "side" else ("left",)
    )
    run = gm.Simulation(opened, gm.Particles([[0.02, 0.1]], D, RHO), ledger=True)
    run.run(until=0.1)
    assert run.velocity[0, 0] == close((1.0 + e) * u, rel=1e-3)
    books = run.ledger
    assert books["impulse of walls x"] == close(MASS * run.velocity[0, 0], rel=1e-12)
    assert books["work of walls"] == close(MASS * run.velocity[0, 0] * u, rel=1e-9)
    gained = run.energies["kinetic"] + books["damped"]
    assert gained == close(books["work of walls"], rel=1e-6)


def test_a_disc_on_a_shaken_floor_follows_its_oscillator():
    k, e, size, f = 1e5, 0.5, 2e-4, 30.0  # acceleration below g: the disc stays on the floor
    contact = gm.Contact(k, e, friction=0.0)
    c = float(contact.coefficient(np.array([MASS]))[0])
    wall = gm.Wall.of(BOX, "bottom", amplitude=(0.0, size), frequency=f)
    y = R - MASS * G / k
    ω, found = 2.0 * np.pi * f, []
    run = one(wall, (0.2, y), (0.0, size * ω), contact, (0.0, -G))
    run.run(until=0.1, every=0.005, observe=lambda run: found.append((run.t, run.x[0, 1])))
    t, heights = np.array(found).T

    def rate(t, z):
        overlap = R - z[0] + size * np.sin(ω * t)
        return z[1], (k * overlap + c * (size * ω * np.cos(ω * t) - z[1])) / MASS - G

    exact = solve_ivp(rate, (0.0, t[-1]), [y, size * ω], "DOP853", t_eval=t, rtol=1e-11, atol=1e-15)
    assert heights == pytest.approx(exact.y[0], abs=1e-3 * size)


def test_a_wall_may_have_its_own_friction():
    smooth = gm.Wall.of(BOX, "bottom", friction=0.0)
    contact = gm.Contact(STIFF, 0.3, friction=0.5)
    at = (0.1, R - MASS * G / STIFF)
    assert one(smooth, at, (0.3, 0.0), contact, (0.0, -G)).run(until=0.1).velocity[0, 0] == close(
        0.3, rel=1e-12
    )
    assert one((), at, (0.3, 0.0), contact, (0.0, -G)).run(until=0.1).velocity[0, 0] == close(
        0.2, rel=1e-3
    )


def test_a_segment_in_a_periodic_box_acts_through_the_edge():
    box = gm.Box(0.2, 0.2, periodic=True)
    wall = gm.Wall((0.19, 0.1), (0.21, 0.1))
    for x in (0.195, 0.004):
        run = one(wall, (x, 0.12), (0.0, -1.0), box=box).run(until=0.04)
        assert run.velocity[0] == pytest.approx([0.0, 1.0], abs=1e-9)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"start": (0.0, np.nan)}, "start"),
        ({"end": (np.inf, 0.0)}, "end"),
        ({"end": (0.0, 0.0)}, "length"),
        ({"velocity": (np.nan, 0.0)}, "velocity"),
        ({"velocity": (1.0, 0.0, 0.0)}, "velocity"),
        ({"amplitude": (0.0, np.inf)}, "amplitude"),
        ({"frequency": -1.0}, "frequency"),
        ({"frequency": np.nan}, "frequency"),
        ({"friction": -0.1}, "friction"),
        ({"friction": np.nan}, "friction"),
    ],
)
def test_bad_walls_are_refused(given, words):
    with pytest.raises(gm.InputError, match=words) as fault:
        gm.Wall(**{"start": (0.0, 0.0), "end": (1.0, 0.0)} | given)
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"gravity": (0.0, np.nan)}, "gravity"),
        ({"gravity": (0.0,)}, "gravity"),
        ({"open": ("north",)}, "north"),
        ({"escape": "vanish"}, "escape"),
        ({"dt": 0.0}, "dt"),
        ({"dt": np.nan}, "dt"),
        ({"walls": gm.Wall.of(BOX, "left"), "open": "left"}, "left"),
        ({"walls": (gm.Wall.of(BOX, "top"), gm.Wall.of(BOX, "top"))}, "top"),
        ({"box": gm.Box(1.0, 1.0, periodic=True), "open": ("left",)}, "periodic"),
        ({"box": gm.Box(1.0, 1.0, periodic=True), "walls": gm.Wall.of(BOX, "left")}, "periodic"),
    ],
)
def test_bad_models_are_refused(given, words):
    with pytest.raises(gm.InputError, match=words) as fault:
        gm.Model(**{"box": BOX, "contact": gm.Contact(1e5)} | given)
    assert "\n" not in str(fault.value)


def test_an_unknown_side_is_refused():
    with pytest.raises(gm.InputError, match="north"):
        gm.Wall.of(BOX, "north")


@pytest.mark.parametrize("angle", [0.0, 0.3, 0.8, 1.5])
@pytest.mark.parametrize("post", [False, True])
def test_a_joint_right_below_a_disc_presses_once(angle, post):
    """A floor of two segments, or one on a post: as one wall, also where the joint is the foot."""
    c, s = np.cos(angle), np.sin(angle)
    along, up = np.array([c, s]), np.array([-s, c])
    foot = np.array([0.5, 0.5])
    if post:
        walls = (gm.Wall(foot - 0.3 * along, foot + 0.3 * along), gm.Wall(foot, foot - 0.3 * up))
    else:
        walls = (gm.Wall(foot - 0.3 * along, foot), gm.Wall(foot, foot + 0.3 * along))
    k, d, g = 1e5, 0.05, 9.81
    weight = 1000.0 * np.pi * d**2 / 4 * g
    x = foot + (d / 2 - weight / k) * up
    law = gm.Contact(k, restitution=0.5, friction=0.0)
    model = gm.Model(gm.Box(1.0, 1.0), law, gravity=tuple(-g * up), walls=walls)
    disc = gm.Simulation(model, gm.Particles([x], d))
    for _ in range(20):
        disc.run(until=disc.t + 50 * disc.dt)
        assert len(disc.wall_contacts) == 1
        assert disc.x[0] @ up == pytest.approx(x @ up, abs=1e-6 * weight / k)
