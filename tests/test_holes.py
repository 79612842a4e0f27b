"""Meshes of the pores: areas, boundaries, independence of the origin."""

import numpy as np
import pytest
from ngsolve import TRIG, VOL, CoefficientFunction, Det, Integrate, IntegrationRule, specialcf

from grainmesh import arrange
from grainmesh.cells import cells
from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.holes import pore_mesh
from grainmesh.particles import Particles, settle, touches


def area(pores):
    pores.mesh.Curve(4)
    return Integrate(CoefficientFunction(1.0), pores.mesh, order=10)


def window(seed, n, porosity, grow=1.0, spread=0.0):
    """A window of a random array: discs cut by its edges, centres inside and outside."""
    rng = np.random.default_rng(seed)
    d = np.exp(spread * rng.uniform(-1, 1, n))
    outer, discs = arrange.random(n, porosity=porosity, diameter=d, seed=seed)
    size = outer.size * rng.uniform(0.4, 0.9, 2)
    corner = (outer.size - size) * rng.random(2)
    box = Box(*size)
    particles = Particles(discs.x - corner, grow * discs.diameter)
    return box, settle(box, particles.select(touches(box, particles)))


@pytest.mark.parametrize("n", [1, 2, 3, 10, 60])
@pytest.mark.parametrize("spread", [0.0, 0.7])
def test_area_of_a_periodic_cell(n, spread):
    rng = np.random.default_rng(n)
    d = np.exp(spread * rng.uniform(-1, 1, n))
    box, particles = arrange.random(n, porosity=0.55, diameter=d, min_gap=0.02, seed=n)
    pores = pore_mesh(box, particles, maxh=1.0)
    assert pores.closed == 0
    np.testing.assert_allclose(area(pores), 0.55 * box.area, rtol=1e-4)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("grow", [0.98, 1.04])
def test_area_of_a_window_with_cut_and_overlapping_discs(seed, grow):
    box, particles = window(seed, 40, 0.5, grow, spread=0.5 * (seed % 2))
    pores = pore_mesh(box, particles, maxh=1.0)
    fluid = box.area - cells(box, particles).solid.sum()
    # Filled necks take a little: at most 1e-3 d2 each.
    assert -1e-3 * pores.closed - 1e-5 * fluid < area(pores) - fluid < 1e-4 * fluid


def test_periodic_cell_is_meshed_for_any_origin():
    box, particles = arrange.random(30, porosity=0.5, diameter=1.0, seed=3)
    for shift in np.random.default_rng(0).random((4, 2)):
        moved = settle(box, Particles(particles.x + shift * box.size, 1.0))
        pores = pore_mesh(box, moved, maxh=1.0)
        np.testing.assert_allclose(area(pores), 0.5 * box.area, rtol=1e-4)


def test_disc_vertices_lie_on_their_discs():
    box, particles = arrange.random(25, porosity=0.6, diameter=1.0, min_gap=0.05, seed=1)
    pores = pore_mesh(box, particles, maxh=1.0)
    vertex, disc = pores.disc_vertices()
    points = np.array(pores.mesh.ngmesh.Coordinates())[vertex]
    radius = np.hypot(*box.separation(particles.x[disc], points).T)
    np.testing.assert_allclose(radius, 0.5, rtol=1e-9)
    assert set(disc) == set(range(25))


def test_gaps_are_closed_below_the_threshold_only():
    box = Box(10.0, 10.0)
    for gap, closed in ((1e-3, 0), (4e-4, 1), (0.0, 1), (-0.2, 1)):
        pair = Particles([[5.0, 5.0], [7.0 + gap, 5.0]], 2.0)
        assert pore_mesh(box, pair, maxh=2.0).closed == closed


def test_disc_over_a_corner_and_disc_that_hardly_enters():
    box = Box(6.0, 5.0)
    discs = Particles([[5.8, 4.9], [2.0, -0.9], [3.0, 5.999]], 2.0)
    pores = pore_mesh(box, settle(box, discs), maxh=1.0)
    fluid = box.area - cells(box, discs).solid.sum()
    np.testing.assert_allclose(area(pores), fluid, rtol=1e-4)


def least_jacobian(mesh, order):
    mesh.Curve(order)
    J = Det(specialcf.JacobianMatrix(2))
    return np.asarray(J(mesh.MapToAllElements(IntegrationRule(TRIG, 2 * order), VOL))).min()


@pytest.mark.parametrize("seed", [15, 132, 153, 161, *range(8)])
def test_no_element_is_turned_inside_out(seed):
    # Windows of dense arrays, discs cut at any angle: the first four once had folded elements.
    outer, discs = arrange.random(30, porosity=0.4, diameter=1.0, seed=seed)
    box = Box(0.45 * outer.width, 0.45 * outer.height)
    pores = pore_mesh(box, settle(box, discs.select(touches(box, discs))), maxh=1.0)
    for order in (3, 5):
        assert least_jacobian(pores.mesh, order) > 0.0


@pytest.mark.parametrize("away", [-1e-2, -1e-3, -1e-9, 0.0, 1e-12, 1e-9, 1e-3, 1e-2])
@pytest.mark.parametrize("inside", [True, False])
def test_circles_through_a_corner(away, inside):
    box, c = Box(3.0, 3.0), 0.5 / np.sqrt(2.0)
    corner = c + away if inside else -c - away
    discs = (
        settle(box, Particles([[1.5, 1.7], [corner, c if inside else -c]], 1.0))
        if (inside or away < 0.0)
        else Particles([[1.5, 1.7], [corner, -c]], 1.0)
    )
    pores = pore_mesh(box, discs, maxh=1.0)
    fluid = box.area - cells(box, discs).solid.sum()
    np.testing.assert_allclose(area(pores), fluid, rtol=5e-3)


def test_a_box_without_fluid_is_refused():
    with pytest.raises(InputError, match="no fluid"):
        pore_mesh(Box(1.0, 1.0), Particles([[0.5, 0.5]], 2.0), maxh=1.0)
