"""Starts that are refused, in one plain line that says what would do, and that does."""

import re
from math import pi, sqrt

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import grainmesh as gm
from grainmesh.start import MOST_AT_START

BOX = gm.Box(1.0, 1.0)
LAW = gm.Contact(1e5)
X = np.array([[0.2, 0.5], [0.5, 0.5], [0.8, 0.4]])


def refusal(model, x=X, d=0.1, **start):
    """The one line of the error; nothing else is said."""
    with pytest.raises(gm.InputError) as error:
        gm.Simulation(model, gm.Particles(x, d), **start)
    line = str(error.value)
    assert "\n" not in line
    assert "nan" not in line
    return line


def number(line, before):
    return float(re.search(before + r" ([-+.e\d]+)", line).group(1))


# Step --------------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(
    stiffness=st.floats(1e2, 1e9),
    restitution=st.floats(0.25, 1.0),
    d=st.floats(1e-4, 0.1),
    times=st.floats(1.01, 1e6),
)
def test_a_step_too_large_is_refused_with_one_that_does(stiffness, restitution, d, times):
    law = gm.Contact(stiffness, restitution)
    mass = 1000.0 * pi * d**2 / 4
    most = law.contact_time(0.5 * mass) / 20
    line = refusal(gm.Model(BOX, law, dt=times * most), d=d)
    for words in "at most", "better":
        dt = number(line, words)
        assert dt <= most
        assert gm.Simulation(gm.Model(BOX, law, dt=dt), gm.Particles(X, d)).dt == dt
    assert number(line, "at most") == pytest.approx(most, rel=0.02)


def test_the_step_is_that_of_the_lightest_pair():
    d = np.array([0.1, 0.02, 0.05])
    mass = 1000.0 * pi * d**2 / 4
    pair = mass[1] * mass[2] / (mass[1] + mass[2])
    simulation = gm.Simulation(gm.Model(BOX, gm.Contact(1e5, 1.0)), gm.Particles(X, d))
    assert simulation.dt == pytest.approx(pi / sqrt(1e5 / pair) / 50, rel=1e-12)


def test_a_damping_too_strong_is_refused_with_one_that_does():
    line = refusal(gm.Model(BOX, gm.Contact(1e5, damping=1e6)))
    law = gm.Contact(1e5, damping=number(line, "at most"))
    gm.Simulation(gm.Model(BOX, law), gm.Particles(X, 0.1))


def test_a_disc_too_fast_for_its_contacts_is_refused_with_a_stiffness_that_does():
    for speed in 1e3, 1e8, 1e200:
        velocity = [(0.0, 0.0), (0.0, speed), (0.0, 0.0)]
        line = refusal(gm.Model(BOX, LAW), velocity=velocity)
        assert "particle 1 is too fast" in line
        if speed < 1e100:
            model = gm.Model(BOX, gm.Contact(number(line, "stiffness, to")))
            gm.Simulation(model, gm.Particles(X, 0.1), velocity)


@pytest.mark.parametrize(
    "motion", [{"velocity": (500.0, 0.0)}, {"amplitude": (0.0, 1.0), "frequency": 100.0}]
)
def test_a_wall_too_fast_for_the_step_is_refused_with_a_step_that_does(motion):
    walls = (gm.Wall((0.0, 0.1), (1.0, 0.1), **motion),)
    line = refusal(gm.Model(BOX, LAW, walls=walls))
    assert "wall from (0.0, 0.1) to (1.0, 0.1) is too fast" in line
    model = gm.Model(BOX, LAW, walls=walls, dt=number(line, "at most"))
    gm.Simulation(model, gm.Particles(X, 0.1))


# Overlap -----------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(
    share=st.one_of(st.floats(0.0, 0.06), st.floats(0.06, 1.9)),
    angle=st.floats(0.0, 2.0 * pi),
    ratio=st.floats(1.0, 10.0),
    periodic=st.booleans(),
)
def test_discs_that_overlap_are_named_with_how_much(share, angle, ratio, periodic):
    assume(share > 1e-6)
    assume(abs(share - MOST_AT_START) > 1e-6)
    d = np.array([0.02, 0.1, 0.1 / ratio])
    # Near the middle, or across the edge of a periodic box.
    at = np.array([0.99, 0.005]) if periodic else np.array([0.5, 0.5])
    distance = 0.5 * (d[1] + d[2]) - share * 0.5 * d[2]
    x = np.array([[0.5, 0.2], at, at + distance * np.array([np.cos(angle), np.sin(angle)])])
    model = gm.Model(gm.Box(1.0, 1.0, periodic), LAW, gravity=(0.0, 0.0))
    if share <= MOST_AT_START:
        contacts = gm.Simulation(model, gm.Particles(x, d)).contacts
        assert contacts.pair.tolist() == [[1, 2]]
        return
    line = refusal(model, x, d)
    assert "particles 1 and 2 overlap" in line
    assert number(line, "overlap by") == pytest.approx(100.0 * share, rel=0.01)


def test_large_discs_may_overlap_by_no_more_than_small_ones_allow():
    # 4 % of a large radius are 40 % of the smallest, more than near lists are made for.
    x = np.array([[0.3, 0.5], [0.398, 0.5], [0.8, 0.8]])
    model = gm.Model(BOX, LAW)
    assert "particles 0 and 1 overlap" in refusal(model, x, np.array([0.1, 0.1, 0.01]))
    assert len(gm.Simulation(model, gm.Particles(x, [0.1, 0.1, 0.05])).contacts) == 1


@pytest.mark.parametrize("side", ["left", "right", "bottom", "top"])
@pytest.mark.parametrize("share", [0.04, 0.06, 0.5, 1.5, 30.0])
def test_a_disc_in_a_wall_is_named(side, share):
    depth = 0.05 * (1.0 - share)
    at = {"left": (depth, 0.5), "right": (1 - depth, 0.5),
          "bottom": (0.5, depth), "top": (0.5, 1 - depth)}[side]  # fmt: skip
    x = np.array([[0.5, 0.5], at])
    model = gm.Model(BOX, LAW)
    if share < MOST_AT_START:
        assert gm.Simulation(model, gm.Particles(x, 0.1)).wall_contacts.pair[:, 0].tolist() == [1]
        return
    line = refusal(model, x)
    assert "particle 1" in line
    assert (f"{side} wall" if share < 1.0 else "lies outside the box") in line
    if share > 2.0:  # wholly outside: a mistake that is not to be mended in silence
        with pytest.raises(gm.InputError, match="particle 1 lies outside the box"):
            gm.relax(model, gm.Particles(x, 0.1))
        return
    mended = gm.relax(model, gm.Particles(x, 0.1))
    assert len(gm.Simulation(model, mended)) == 2


def test_a_disc_in_a_segment_is_named():
    wall = gm.Wall((0.0, 0.5), (1.0, 0.5))
    assert "particle 2" in refusal(gm.Model(BOX, LAW, walls=(wall,)), X + np.array([0.0, 0.08]))


def test_a_disc_outside_an_open_side_is_refused():
    x = np.vstack([X, [[-0.2, 0.5]]])
    assert "particle 3 lies outside the box" in refusal(gm.Model(BOX, LAW, open=("left",)), x)
    model = gm.Model(BOX, LAW, open=("left",), escape="remove", gravity=(0.0, 0.0))
    assert "particle 3 lies outside the box" in refusal(model, x)
    # Half outside it may be.
    half = np.vstack([X, [[-0.01, 0.5]]])
    assert len(gm.Simulation(model, gm.Particles(half, 0.1))) == 4


def test_a_disc_too_large_for_a_periodic_box_is_refused():
    model = gm.Model(gm.Box(0.0999, 1.0, periodic=True), LAW)
    assert "too small" in refusal(model, np.array([[0.5, 0.5]]))


# Values ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ({"velocity": 1.0}, "velocity needs shape (3, 2) or (2,), got ()"),
        ({"velocity": np.zeros((3, 1))}, "got (3, 1)"),
        ({"velocity": np.zeros((2, 2))}, "got (2, 2)"),
        ({"velocity": np.zeros(3)}, "got (3,)"),
        ({"velocity": [[0, 0], [0, np.nan], [0, 0]]}, "velocity of particle 1 is not finite"),
        ({"velocity": (np.inf, 0.0)}, "velocity of particle 0 is not finite"),
        ({"spin": np.zeros(2)}, "spin needs shape (3,) or (), got (2,)"),
        ({"spin": np.zeros((3, 1))}, "got (3, 1)"),
        ({"spin": [0.0, 0.0, -np.inf]}, "spin of particle 2 is not finite"),
    ],
)
def test_wrong_shapes_and_values_are_refused(start, words):
    with pytest.raises(gm.InputError) as error:
        gm.Simulation(gm.Model(BOX, LAW), gm.Particles(X, 0.1), **start)
    line = str(error.value)
    assert words in line


@pytest.mark.parametrize(
    ("force", "words"),
    [
        (np.zeros((2, 2)), "force from outside needs shape (3, 2) or (2,), got (2, 2)"),
        (1.0, "got ()"),
        ((0.0, np.inf), "force from outside of particle 0 is not finite"),
        (lambda t, x, v: np.zeros(3), "got (3,)"),
        (lambda t, x, v: 0.0 * x / (x[:, :1] - 0.5), "force from outside of particle 1 is not"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value")
def test_a_wrong_force_is_refused(force, words):
    with pytest.raises(gm.InputError) as error:
        gm.Simulation(gm.Model(BOX, LAW, force=force), gm.Particles(X, 0.1))
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("law", "words"),
    [
        ({"stiffness": 0.0}, "stiffness = 0 must be positive"),
        ({"stiffness": -1e5}, "stiffness = -100000 must be positive"),
        ({"stiffness": np.inf}, "stiffness = inf"),
        ({"restitution": 0.0}, "restitution = 0 must be above 0 and at most 1"),
        ({"restitution": 1.01}, "restitution = 1.01"),
        ({"restitution": np.nan}, "restitution = nan"),
        ({"restitution": 0.5, "damping": 1.0}, "give restitution or damping, not both"),
        ({"damping": -1.0}, "damping = -1 must be at least 0"),
        ({"friction": -0.1}, "friction = -0.1 must be at least 0"),
        ({"tangential": 0.0}, "tangential = 0"),
        ({"tangential": 1.5}, "tangential = 1.5"),
        ({"tangential_damping": -1.0}, "tangential_damping = -1"),
        ({"rolling": -1.0}, "rolling = -1 must be at least 0"),
    ],
)
def test_a_contact_law_out_of_range_is_refused(law, words):
    with pytest.raises(gm.InputError, match=re.escape(words)):
        gm.Contact(**{"stiffness": 1e5, **law})


@pytest.mark.parametrize(
    ("model", "words"),
    [
        ({"open": ("north",)}, "open side 'north' must be one of left, right, bottom, top"),
        ({"open": ("top",), "walls": (gm.Wall.of(BOX, "top"),)}, "top side is given twice"),
        ({"walls": 2 * (gm.Wall.of(BOX, "top"),)}, "top side is given twice"),
        ({"box": gm.Box(1.0, 1.0, True), "open": ("top",)}, "a periodic box has no sides"),
        ({"escape": "vanish"}, "escape 'vanish' must be 'error' or 'remove'"),
        ({"gravity": (0.0, np.nan)}, "gravity"),
        ({"gravity": (0.0, 0.0, -9.81)}, "gravity"),
        ({"dt": 0.0}, "dt 0 s must be positive"),
        ({"dt": np.nan}, "dt nan s must be positive"),
    ],
)
def test_a_model_that_makes_no_sense_is_refused(model, words):
    with pytest.raises(gm.InputError, match=re.escape(words)):
        gm.Model(**{"box": BOX, "contact": LAW, **model})


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: gm.Wall((0, 0), (0, 0)), "a wall needs a length"),
        (lambda: gm.Wall((0, 0), (0, np.nan)), "two finite numbers"),
        (lambda: gm.Wall((0, 0, 0), (1, 1, 1)), "two finite numbers"),
        (lambda: gm.Wall((0, 0), (1, 0), frequency=-1.0), "frequency -1"),
        (lambda: gm.Wall((0, 0), (1, 0), friction=-1.0), "friction -1"),
        (lambda: gm.Wall.of(BOX, "north"), "side 'north' must be one of left, right, bottom, top"),
        (lambda: gm.Particles(np.zeros((0, 2)), 0.1), "n > 0"),
        (lambda: gm.Particles(X, 0.0), "diameter 0 must be positive"),
    ],
)
def test_walls_and_discs_that_make_no_sense_are_refused(make, words):
    with pytest.raises(gm.InputError, match=re.escape(words)):
        make()


def test_particles_of_no_mass_are_refused():
    box, speck = gm.Box(1.0, 1.0), gm.Particles([[0.5, 0.5]], 1e-90)
    with pytest.raises(gm.InputError, match="too small to compute with"):
        gm.Simulation(gm.Model(box, gm.Contact(1e3)), speck)
