"""Exact signs: against rational arithmetic, for ties, near ties, images, and any scale."""

from fractions import Fraction
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from grainmesh.predicates import in_circle, orientation

NO_PERIOD = np.zeros(2)


def sign(value):
    return int(value > 0) - int(value < 0)


def exact_rows(points, weight, period, sites, last):
    """ξ, η, ζ of the sites as fractions."""
    rows = []
    for site in sites:
        xi, eta = (
            Fraction(points[site[0], k])
            - Fraction(points[last[0], k])
            + (site[1 + k] - last[1 + k]) * Fraction(period[k])
            for k in range(2)
        )
        shift = Fraction(weight[last[0]]) - Fraction(weight[site[0]])
        rows.append((xi, eta, xi * xi + eta * eta + shift))
    return rows


def exact_orientation(points, period, a, b, c):
    (ax, ay, _), (bx, by, _) = exact_rows(points, np.zeros(len(points)), period, (a, b), c)
    return sign(ax * by - ay * bx)


def exact_in_circle(points, weight, period, a, b, c, d):
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = exact_rows(points, weight, period, (a, b, c), d)
    return sign(az * (bx * cy - by * cx) + bz * (cx * ay - cy * ax) + cz * (ax * by - ay * bx))


def agree(points, weight, period, sites):
    a, b, c, d = sites
    assert orientation(points, period, a, b, c) == exact_orientation(points, period, a, b, c)
    expected = exact_in_circle(points, weight, period, a, b, c, d)
    assert in_circle(points, weight, period, a, b, c, d) == expected
    return expected


image = st.integers(-3, 3)
images = st.lists(st.tuples(image, image), min_size=4, max_size=4)


def sites_of(shifts):
    return [(k, p, q) for k, (p, q) in enumerate(shifts)]


HERE = sites_of([(0, 0)] * 4)


@settings(max_examples=300, deadline=None)
@given(
    seed=st.integers(0, 10**9),
    shifts=images,
    exponents=st.tuples(*[st.integers(-150, 150)] * 2),
    common=st.booleans(),
)
def test_signs_are_those_of_rational_arithmetic_at_any_scale(seed, shifts, exponents, common):
    # 2^±150 is 1e±45; points of both scales together if `common` is not set.
    rng = np.random.default_rng(seed)
    scale = 2.0 ** np.array([exponents[0] if common else e for e in rng.choice(exponents, 4)])
    points = rng.uniform(-1, 1, (4, 2)) * scale[:, None]
    weight = rng.uniform(0, 1, 4) * scale**2 * rng.choice([0.0, 1e-3, 1.0])
    period = rng.choice([0.0, 1.0]) * rng.uniform(1, 3, 2) * scale.max()
    agree(points, weight, period, sites_of(shifts))


@settings(max_examples=300, deadline=None)
@given(
    coordinates=st.lists(st.tuples(*[st.integers(-4, 4)] * 2), min_size=4, max_size=4),
    radii=st.lists(st.integers(0, 3), min_size=4, max_size=4),
    shifts=images,
    unit=st.sampled_from([1.0, 0.1, 1e-4, 1 / 3, 1e-30, 1e40]),
    origin=st.sampled_from([0.0, 0.7, 12345.678]),
    seed=st.integers(0, 10**6),
)
def test_ties_and_near_ties_are_told_apart(coordinates, radii, shifts, unit, origin, seed):
    # Points of a coarse lattice, moved by no, one or a few units in the last place.
    points = unit * (origin + np.array(coordinates, dtype=float))
    steps = np.random.default_rng(seed).integers(-1, 2, (4, 2)) * (seed % 3)
    points += steps * np.spacing(np.maximum(points, unit))
    weight = unit**2 * np.array(radii, dtype=float)
    agree(points, weight, np.array([8.0, 5.0]) * unit, sites_of(shifts))


def test_points_of_a_line_but_for_their_rounding_lie_on_their_side_of_it():
    rng = np.random.default_rng(0)
    for _ in range(300):
        a, b = rng.uniform(0, 1, 2), rng.uniform(0, 30, 2)
        points = np.stack([a, b, a + rng.uniform(-1, 2) * (b - a)])
        for order in permutations(HERE[:3]):
            expected = exact_orientation(points, NO_PERIOD, *order)
            assert orientation(points, NO_PERIOD, *order) == expected


def test_close_points_on_both_sides_of_the_edge_of_a_large_box():
    # Differences lose three digits and more to the period; squares and lines close to ties.
    rng = np.random.default_rng(0)
    for _ in range(300):
        period = rng.uniform(0.9, 1.1, 2)
        lattice = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 2], [2, 1]])
        points = 1e-4 * (rng.permutation(lattice)[:4] + rng.uniform(-1.5, 0.5, 2))
        points += rng.integers(-2, 3, (4, 2)) * 2.0**-54
        hops = np.floor(points / period).astype(int)
        sites = [(k, *hop) for k, hop in enumerate(hops.tolist())]
        agree(points - hops * period, np.full(4, 1e-9), period, sites)


@pytest.mark.parametrize("unit", [1.0, 2.0**-13, 2.0**180, 2.0**-190])
def test_four_points_of_a_circle_are_a_tie(unit):
    # 65² = 16² + 63² = 33² + 56² = 25² + 60² = 39² + 52²: exact in doubles.
    ring = [(16, 63), (33, 56), (25, 60), (39, 52), (65, 0), (-63, 16), (-33, -56), (60, -25)]
    ring.sort(key=lambda p: np.arctan2(p[1], p[0]))
    rng = np.random.default_rng(0)
    for _ in range(50):
        four = np.sort(rng.choice(len(ring), 4, replace=False))
        points = unit * np.array(ring, dtype=float)[four] + unit * rng.integers(-999, 999, 2)
        for weight in (np.zeros(4), np.full(4, 0.3 * unit**2)):
            assert in_circle(points, weight, NO_PERIOD, *HERE) == 0
            # the smallest change there is decides
            for factor, expected in ((1 + 1e-15, 1), (1 - 1e-15, -1)):
                moved = weight + np.array([0, 0, 0, factor - 1]) * unit**2
                assert in_circle(points, moved, NO_PERIOD, *HERE) == expected


def test_the_corners_of_a_square_are_a_tie_from_every_image():
    # Differences of 0.1, 0.2, ... are not equal in doubles, but x and x + L are a period apart.
    x = np.array([[0.1, 0.3]])
    period = np.array([0.7, 0.7])
    for p, q in permutations(range(-40, 41, 8), 2):
        a, b, c, d = ((0, p + i, q + j) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
        assert orientation(x, period, a, b, c) == 1
        assert orientation(x, period, a, c, (0, p + 3, q + 3)) == 0
        assert in_circle(x, np.ones(1), period, a, b, c, d) == 0


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 10**9), hop=st.tuples(image, image), near_tie=st.booleans())
def test_the_sign_depends_neither_on_order_nor_on_the_image_seen_from(seed, hop, near_tie):
    rng = np.random.default_rng(seed)
    period = rng.uniform(1, 2, 2)
    points = rng.uniform(0, 1, (4, 2)) * period
    sites = [(k, *rng.integers(-1, 2, 2).tolist()) for k in range(4)]
    if near_tie:  # a lattice cut by the edge of the box
        points = np.array([[0.1, 0.1], [0.3, 0.1], [0.3, 0.3], [0.1, 0.3]]) + rng.uniform(0, 2, 2)
        sites = [(k, *(-np.floor(points[k] / period)).astype(int).tolist()) for k in range(4)]
    weight = np.full(4, 0.01)
    turn = orientation(points, period, *sites[:3])
    value = in_circle(points, weight, period, *sites)
    for order in permutations(range(4)):
        parity = round(np.linalg.det(np.eye(4)[list(order)]))
        new = [(i, p + hop[0], q + hop[1]) for i, p, q in (sites[k] for k in order)]
        assert in_circle(points, weight, period, *new) == parity * value
        if order[3] == 3:
            assert orientation(points, period, *new[:3]) == parity * turn


def test_inside_and_outside():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.9, 0.9]])
    weight = np.zeros(4)
    assert orientation(points, NO_PERIOD, *HERE[:3]) == 1
    assert in_circle(points, weight, NO_PERIOD, *HERE) == 1
    # A point on the power circle of radius r has weight r² - distance² to its centre...
    assert in_circle(points, np.array([0, 0, 0, 0.17]), NO_PERIOD, *HERE) == 1
    points[3] = 1.1  # (1.1 - 0.5)²·2 - 0.5 = 0.22 outside, until its own weight makes up for it
    assert in_circle(points, weight, NO_PERIOD, *HERE) == -1
    assert in_circle(points, np.array([0, 0, 0, 0.23]), NO_PERIOD, *HERE) == 1
    assert in_circle(points, np.array([0, 0, 0, 0.21]), NO_PERIOD, *HERE) == -1


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_sites_that_are_not_finite_have_no_sign(bad):
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.9, bad]])
    assert orientation(points, NO_PERIOD, *HERE[1:]) == 0
    for order in permutations(HERE):
        assert in_circle(points, np.zeros(4), NO_PERIOD, *order) == 0
