"""Particles, box and the checks they pass: every error, wrapping, and the rule at the edge."""

import re
from time import perf_counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.particles import (
    MAX_OVERLAP,
    MAX_OVERLAP_ACROSS,
    Particles,
    close_pairs,
    settle,
    touches,
)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
@pytest.mark.parametrize("side", ["width", "height"])
def test_a_box_side_must_be_positive_and_finite(side, value):
    with pytest.raises(InputError, match=f"box {side}"):
        Box(**{"width": 1.0, "height": 1.0, side: value})


def test_box_size_area_and_separation():
    box = Box(4.0, 2.0)
    np.testing.assert_array_equal(box.size, [4.0, 2.0])
    assert box.area == 8.0
    a, b = np.array([0.5, 0.5]), np.array([3.5, 1.75])
    np.testing.assert_allclose(box.separation(a, b), [3.0, 1.25])
    np.testing.assert_allclose(Box(4.0, 2.0, True).separation(a, b), [-1.0, -0.75])


@pytest.mark.parametrize("x", [[], [1.0, 2.0], [[1.0, 2.0, 3.0]], np.empty((0, 2))])
def test_centres_of_a_wrong_shape_are_refused(x):
    with pytest.raises(InputError, match=r"shape \(n, 2\)"):
        Particles(x, 1.0)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_centres_that_are_not_finite_are_named(value):
    with pytest.raises(InputError, match=r"particle 1: centre .* not finite"):
        Particles([[0.0, 0.0], [0.0, value]], 1.0)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
@pytest.mark.parametrize("name", ["diameter", "density"])
def test_diameter_and_density_must_be_positive(name, value):
    given = {"diameter": [1.0, 1.0], "density": [1.0, 1.0]}
    given[name][1] = value
    with pytest.raises(InputError, match=f"particle 1: {name}"):
        Particles([[0.0, 0.0], [3.0, 0.0]], **given)


@pytest.mark.parametrize("name", ["diameter", "density"])
def test_one_value_or_one_for_each_particle(name):
    given = {"diameter": 1.0, "density": 1.0, name: [1.0, 1.0, 1.0]}
    with pytest.raises(InputError, match=f"{name} needs one value or 2"):
        Particles([[0.0, 0.0], [3.0, 0.0]], **given)


def test_text_is_no_number():
    with pytest.raises(InputError, match="diameter: '2 mm' is no number"):
        Particles([[0, 0]], "2 mm")
    with pytest.raises(InputError, match=r"particle centres: .* is no number"):
        Particles([["a", 0]], 1.0)


def test_particles_copy_and_freeze_what_they_get():
    x = np.array([[1.0, 1.0], [2.0, 2.0]])
    particles = Particles(x, [0.5, 1.5], density=7.0)
    x[0] = 9.0
    assert particles.x[0, 0] == 1.0
    for array in (particles.x, particles.diameter, particles.density):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
    np.testing.assert_array_equal(particles.radius, [0.25, 0.75])
    assert particles.mean_diameter == 1.0
    assert len(particles) == 2
    np.testing.assert_array_equal(particles.with_diameter(3.0).diameter, [3.0, 3.0])
    one = particles.select(np.array([False, True]))
    assert (one.x.tolist(), one.diameter.tolist()) == ([[2.0, 2.0]], [1.5])
    assert one.density.tolist() == [7.0]


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 12), periodic=st.booleans())
def test_close_pairs_are_all_pairs_closer_than_the_gap(seed, n, periodic):
    rng = np.random.default_rng(seed)
    box = Box(1.0, 0.7, periodic)
    particles = Particles(rng.uniform(0, 1, (n, 2)) * box.size, rng.uniform(0.02, 0.3, n))
    gap = 0.1
    expected = set()
    images = [(0, 0)] if not periodic else [(a, b) for a in (-2, -1, 0, 1, 2) for b in range(-2, 3)]
    for i in range(n):
        for j in range(i, n):
            for image in images:
                if i == j and image == (0, 0):
                    continue
                away = particles.x[j] + image * box.size - particles.x[i]
                if np.hypot(*away) < particles.radius[i] + particles.radius[j] + gap:
                    expected.add((i, j))
    assert {tuple(pair) for pair in close_pairs(box, particles, gap).tolist()} == expected


def test_a_disc_touches_the_box_where_a_part_of_it_is_inside():
    box = Box(10.0, 10.0)
    # At a corner the distance counts, not the coordinates.
    x = [[5.0, 5.0], [-0.9, 5.0], [-1.1, 5.0], [-0.8, -0.8], [-0.7, -0.7], [10.0, 10.99]]
    np.testing.assert_array_equal(
        touches(box, Particles(x, 2.0)), [True, True, False, False, True, True]
    )


def test_a_disc_wholly_outside_is_named():
    with pytest.raises(InputError, match=r"particle 1 at \(12, 5\) m lies outside the box"):
        settle(Box(10.0, 10.0), Particles([[5.0, 5.0], [12.0, 5.0]], 2.0))
    cut = Particles([[5.0, 5.0], [10.9, 5.0]], 2.0)
    assert settle(Box(10.0, 10.0), cut) is cut


def test_a_periodic_box_takes_centres_in_any_image():
    box = Box(3.0, 2.0, periodic=True)
    x = np.array([[0.0, 0.0], [1.5, 1.0], [2.9, 1.9], [-1e-20, 1.0]])
    found = settle(box, Particles(x + np.array([[3.0, -2.0], [0, 0], [-9.0, 2.0], [0, 0]]), 0.01))
    assert (found.x >= 0).all()
    assert (found.x < box.size).all()
    np.testing.assert_allclose(box.separation(found.x, x), 0.0, atol=1e-14)


@pytest.mark.parametrize("periodic", [False, True])
def test_the_same_centre_is_refused(periodic):
    x = [[1.0, 1.0], [5.0, 5.0], [3.0, 3.0], [5.0, 5.0]]
    with pytest.raises(InputError, match=r"particles 1 and 3 have the same centre \(5, 5\) m"):
        settle(Box(10.0, 10.0, periodic), Particles(x, 0.5))
    if periodic:
        x[3] = [5.0, 15.0]
        with pytest.raises(InputError, match="1 and 3 have the same centre"):
            settle(Box(10.0, 10.0, periodic), Particles(x, 0.5))


def pair(box, x, offset, share, r, s):
    """Two discs that overlap by `share` of the smaller radius along `offset`."""
    distance = r + s - share * min(r, s)
    return Particles([x, np.asarray(x) + distance * np.asarray(offset)], [2 * r, 2 * s])


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize(("r", "s"), [(1.0, 1.0), (1.0, 0.2), (0.3, 2.0)])
def test_overlap_inside_is_taken_up_to_the_bound(periodic, r, s):
    box = Box(20.0, 20.0, periodic)
    offset = (0.6, 0.8)
    settle(box, pair(box, [10.0, 10.0], offset, MAX_OVERLAP - 1e-9, r, s))
    with pytest.raises(InputError, match=r"particles 0 and 1 overlap by 30 % .* at most 30 %") as e:
        settle(box, pair(box, [10.0, 10.0], offset, MAX_OVERLAP + 1e-9, r, s))
    assert "across" not in str(e.value)


@pytest.mark.parametrize("offset", [(1, 0), (0, 1), (-1, 0), (0, -1), (0.8, 0.6), (0.6, -0.8)])
@pytest.mark.parametrize(("r", "s"), [(1.0, 1.0), (1.0, 0.2), (0.3, 2.0)])
def test_overlap_across_the_periodic_edge_says_that_the_data_are_not_periodic(offset, r, s):
    box = Box(20.0, 20.0, periodic=True)
    # Near the corner where the way along `offset` leaves the box.
    x = np.where(np.asarray(offset) > 0, 19.99, 0.01)
    settle(box, pair(box, x, offset, MAX_OVERLAP_ACROSS - 1e-9, r, s))
    with pytest.raises(InputError, match=r"across the periodic edge.* or drop --periodic"):
        settle(box, pair(box, x, offset, MAX_OVERLAP_ACROSS + 1e-9, r, s))


def test_overlap_across_is_seen_beside_a_deeper_one_inside():
    # Both ways round overlap; the deeper is inside and would be taken.
    particles = Particles([[0.1, 0.5], [0.573, 0.5]], 0.5405)
    settle(Box(1.0, 1.0), particles)
    with pytest.raises(InputError, match="across the periodic edge"):
        settle(Box(1.0, 1.0, periodic=True), particles)


def test_a_disc_that_overlaps_its_own_image_is_refused():
    for box in (Box(1.0, 5.0, True), Box(5.0, 1.0, True)):
        settle(box, Particles([[0.3, 0.9]], 1.0))
        with pytest.raises(InputError, match="particle 0 overlaps its own image"):
            settle(box, Particles([[0.3, 0.9]], 1.01))


def test_errors_are_one_line():
    with pytest.raises(InputError) as e:
        settle(Box(1.0, 1.0, periodic=True), Particles([[0.5, 0.5]], 3.0))
    assert not re.search(r"\n", str(e.value))


@pytest.mark.parametrize("periodic", [False, True])
def test_a_hundred_thousand_discs_settle_fast(periodic):
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(*2 * [np.arange(316) + 0.5]), axis=-1).reshape(-1, 2)
    particles = Particles(grid + rng.uniform(-0.05, 0.05, grid.shape), 0.9)
    begin = perf_counter()
    settle(Box(316.0, 316.0, periodic), particles)
    assert perf_counter() - begin < 2.0  # 0.1 s on an idle machine
