"""Areas and solid of power cells: identities, closed forms, invariances."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Voronoi

from grainmesh.cells import cells
from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.particles import Particles

close = partial(pytest.approx, abs=0.0)


def scattered(box, n, seed, radius=None):
    """Random centres on a jittered grid: apart from each other, otherwise irregular."""
    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(n)))
    pitch = box.size / side
    grid = np.stack(np.meshgrid(*2 * [np.arange(side) + 0.5]), axis=-1).reshape(-1, 2)[:n] * pitch
    x = grid + rng.uniform(-0.2, 0.2, grid.shape) * pitch
    if radius is None:
        radius = rng.uniform(0.05, 0.3, n) * pitch.min()
    return Particles(x, 2.0 * np.asarray(radius))


def lens(r, s, distance):
    """Area common to two discs."""
    a = np.arccos((distance**2 + r**2 - s**2) / (2 * distance * r))
    b = np.arccos((distance**2 + s**2 - r**2) / (2 * distance * s))
    return r * r * (a - np.sin(2 * a) / 2) + s * s * (b - np.sin(2 * b) / 2)


def segment(r, h):
    """Area of a disc beyond a line at the signed distance h from its centre."""
    a = np.arccos(h / r)
    return r * r * (a - np.sin(2 * a) / 2)


@settings(max_examples=60, deadline=None)
@given(
    n=st.sampled_from([1, 2, 3, 4, 7, 60]),
    seed=st.integers(0, 10**6),
    aspect=st.floats(0.2, 5.0),
    scale=st.sampled_from([1e-6, 1.0, 1e3]),
    periodic=st.booleans(),
)
def test_areas_sum_to_the_box_and_solids_to_the_discs(n, seed, aspect, scale, periodic):
    box = Box(scale * aspect, scale, periodic)
    particles = scattered(box, n, seed)
    if not periodic:  # only discs inside
        r = 0.999 * np.minimum(particles.x, box.size - particles.x).min(axis=1)
        particles = particles.with_diameter(2.0 * np.minimum(particles.radius, r))
    found = cells(box, particles)
    assert found.area.sum() == close(box.area, rel=1e-12)
    assert found.solid == close(np.pi * particles.radius**2, rel=1e-12)
    assert (found.area > found.solid).all()


@pytest.mark.parametrize("periodic", [False, True])
def test_square_cells_are_exact(periodic):
    x = np.stack(np.meshgrid(*2 * [np.arange(6) + 0.5]), axis=-1).reshape(-1, 2)
    found = cells(Box(6.0, 6.0, periodic), Particles(x, 0.8))
    assert found.area == close(1.0, rel=1e-13)
    assert found.porosity == close(1.0 - 0.16 * np.pi, rel=1e-12)


def test_hexagonal_cells_are_exact():
    columns, rows = np.meshgrid(np.arange(5), np.arange(6))
    x = np.stack([columns + 0.5 * (rows % 2), rows * np.sqrt(0.75)], axis=-1).reshape(-1, 2)
    found = cells(Box(5.0, 6 * np.sqrt(0.75), periodic=True), Particles(x, 1.0))
    assert found.area == close(np.sqrt(0.75), rel=1e-13)
    assert found.porosity == close(1.0 - np.pi / 2 / np.sqrt(3), rel=1e-12)  # the bound 0.093


@pytest.mark.parametrize("n", [1, 2, 4])
def test_few_discs_are_cut_by_their_own_images(n):
    # n discs in a row of period 1 by 3: cells 1/n wide, whatever the origin.
    x = np.stack([0.37 + np.arange(n) / n, np.full(n, 2.9)], axis=-1)
    found = cells(Box(1.0, 3.0, periodic=True), Particles(x, 0.2 / n))
    assert found.area == close(3.0 / n, rel=1e-13)


def test_equal_discs_have_voronoi_cells():
    box = Box(3.0, 2.0, periodic=True)
    particles = scattered(box, 80, 3, radius=np.full(80, 0.01))
    shifts = np.stack(np.meshgrid(*2 * [[0, 1, -1]]), axis=-1).reshape(-1, 2)
    voronoi = Voronoi((particles.x + (shifts * box.size)[:, None]).reshape(-1, 2))
    for i, area in enumerate(cells(box, particles).area):
        v = voronoi.vertices[voronoi.regions[voronoi.point_region[i]]]
        x, y = (v - particles.x[i]).T
        assert area == close(abs(x @ np.roll(y, 1) - y @ np.roll(x, 1)) / 2, rel=1e-11)


@settings(max_examples=40, deadline=None)
@given(r=st.floats(0.5, 2.0), share=st.floats(0.01, 1.5), angle=st.floats(0.0, 6.3))
def test_overlapping_unequal_discs_give_their_union(r, share, angle):
    s = 1.0
    distance = r + s - share * min(r, s)
    offset = distance * np.array([np.cos(angle), np.sin(angle)])
    for periodic in (False, True):
        found = cells(
            Box(20.0, 20.0, periodic), Particles([[10.0, 10.0], 10.0 + offset], [2 * r, 2 * s])
        )
        union = np.pi * (r * r + s * s) - lens(r, s, distance)
        assert found.solid.sum() == close(union, rel=1e-12)
        h = (distance**2 + r**2 - s**2) / (2 * distance)  # Eq. (2)
        assert found.solid[0] == close(np.pi * r * r - segment(r, h), rel=1e-11)


@pytest.mark.parametrize("y", [-0.9, -0.3, 0.0, 0.2, 0.999, 1.0, 1.5])
def test_a_wall_cuts_a_disc_by_the_segment_formula(y):
    found = cells(Box(10.0, 8.0), Particles([[5.0, y], [5.0, 5.0]], 2.0))
    outside = segment(1.0, min(y, 1.0))
    assert found.solid == close([np.pi - outside, np.pi], rel=1e-12, abs=1e-14)
    assert found.area == close([10.0 * (y + 5.0) / 2, 80.0 - 5.0 * (y + 5.0)], rel=1e-12)


def test_a_corner_cuts_a_disc_to_a_quarter():
    for corner in ([0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]):
        assert cells(Box(4.0, 3.0), Particles([corner], 2.0)).solid == close(np.pi / 4, rel=1e-12)


def test_a_disc_larger_than_the_box_fills_it():
    found = cells(Box(1.0, 1.0), Particles([[0.5, 0.5]], 2.0))
    assert found.solid == close(1.0, rel=1e-14)
    assert found.porosity == close(0.0, abs=1e-14)


def test_a_particle_without_a_cell_has_no_solid():
    # The small disc reaches into the box only where the large one is nearer.
    found = cells(Box(10.0, 10.0), Particles([[5.0, 0.5], [5.0, -0.6]], [2.0, 1.3]))
    assert found.area[1] == 0.0
    assert found.solid[1] == 0.0
    assert found.porosity[1] == 1.0
    assert found.area[0] == close(100.0)


def test_one_large_disc_among_many_small_ones():
    # More neighbours than the first buffers hold.
    angle = 2 * np.pi * np.arange(300) / 300
    x = 5.0 + 2.2 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    particles = Particles(np.vstack([[[5.0, 5.0]], x]), np.r_[4.0, np.full(300, 0.03)])
    for periodic in (False, True):
        found = cells(Box(10.0, 10.0, periodic), particles)
        assert found.area.sum() == close(100.0, rel=1e-12)
        assert found.solid == close(np.pi * particles.radius**2, rel=1e-12)
        h = (2.2**2 + 2.0**2 - 0.015**2) / 4.4  # Eq. (2): a regular polygon of 300 sides
        assert found.area[0] == close(300 * h * h * np.tan(np.pi / 300), rel=1e-12)


@pytest.mark.parametrize("periodic", [False, True])
def test_large_discs_among_dust_are_found_from_afar(periodic):
    # Eq. (3): a large disc cuts cells from much farther than the dust between does.
    rng = np.random.default_rng(7)
    large = np.stack(np.meshgrid(*2 * [1.25 + 2.5 * np.arange(4)]), axis=-1).reshape(-1, 2)
    dust = rng.uniform(0, 10, (4000, 2))
    dust = dust[np.hypot(*(dust[:, None] - large).T).min(axis=0) > 1.01]
    particles = Particles(
        np.vstack([large, dust]), np.r_[np.full(16, 2.0), np.full(len(dust), 1e-4)]
    )
    found = cells(Box(10.0, 10.0, periodic), particles)
    assert found.area.sum() == close(100.0, rel=1e-12)
    assert found.solid[:16] == close(np.pi, rel=1e-12)


@pytest.mark.parametrize("periodic", [False, True])
def test_invariance_under_relabelling_rotation_scaling(periodic):
    box = Box(3.0, 2.0, periodic)
    particles = scattered(box, 50, 11)
    if not periodic:
        particles = Particles(1.1 * particles.x - 0.1, particles.diameter)  # some are cut
    found = cells(box, particles)

    order = np.random.default_rng(0).permutation(50)
    other = cells(box, Particles(particles.x[order], particles.diameter[order]))
    assert other.area == close(found.area[order], rel=1e-12)
    assert other.solid == close(found.solid[order], rel=1e-12)

    turned = np.stack([box.height - particles.x[:, 1], particles.x[:, 0]], axis=-1)
    other = cells(Box(2.0, 3.0, periodic), Particles(turned, particles.diameter))
    assert other.area == close(found.area, rel=1e-12)
    assert other.solid == close(found.solid, rel=1e-12)

    small = Particles(1e-6 * particles.x, 1e-6 * particles.diameter)
    other = cells(Box(3e-6, 2e-6, periodic), small)
    assert other.area == close(1e-12 * found.area, rel=1e-12)
    assert other.solid == close(1e-12 * found.solid, rel=1e-12)


def test_invariance_under_a_shift_of_the_periodic_origin():
    box = Box(3.0, 2.0, periodic=True)
    particles = scattered(box, 30, 5)
    moved = cells(box, Particles(particles.x + np.array([17.3, -0.77]), particles.diameter))
    assert moved.area == close(cells(box, particles).area, rel=1e-12)


def test_points_on_one_line_and_far_from_square_boxes():
    for box in (Box(1e3, 1.0, True), Box(1e3, 1.0), Box(1.0, 1e3, True)):
        x = np.stack([np.linspace(0.5, box.width - 0.5, 20), np.full(20, box.height / 3)], axis=-1)
        if box.height > box.width:
            x = np.stack([np.full(20, 0.3), np.linspace(1.0, 990.0, 20)], axis=-1)
        assert cells(box, Particles(x, 0.1)).area.sum() == close(1e3, rel=1e-12)


def test_wrapping_never_leaves_the_box():
    box = Box(0.1, 0.3, periodic=True)
    x = box.wrapped(np.array([[-1e-20, 0.3], [0.1, -0.1], [0.05, 7.0]]))
    assert (x >= 0).all()
    assert (x < box.size).all()


def test_a_shared_centre_is_refused():
    with pytest.raises(InputError, match="share a centre"):
        cells(Box(4.0, 4.0), Particles([[1.0, 1.0], [3.0, 2.0], [3.0, 2.0]], 1.0))


def test_results_are_read_only():
    found = cells(Box(1.0, 1.0), Particles([[0.5, 0.5]], 0.2))
    with pytest.raises(ValueError, match="read-only"):
        found.area[0] = 0.0
