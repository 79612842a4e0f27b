"""What is asked of the flow, beside NGSolve's own fields and integrals."""

import numpy as np
import pytest
from ngsolve import BND, CF, Integrate

import grainmesh as gm
from flows import some_flow
from grainmesh.domain import SIDES

EACH = pytest.mark.parametrize(
    ("order", "periodic"), [(k, periodic) for k in (1, 2, 3, 4) for periodic in (False, True)]
)


def made(order, periodic):
    """A flow at random, with the porosity of its discs, and the same as fields of NGSolve."""
    flow, rng = some_flow(order, periodic)
    flow.operator.load(eps=flow.kernel.porosity)
    assert np.ptp(flow.kernel.porosity) > 0.01
    return flow, *flow.ngsolve(), rng


def spots(mesh, rng, each=3):
    """Places in all triangles of a mesh of NGSolve (q, 2), and its points there."""
    at = np.asarray(mesh.ngmesh.Coordinates())[:, :2]
    corners = at[[[v.nr for v in t.vertices] for t in mesh.Elements()]]
    weight = 0.97 * rng.dirichlet([1.0, 1.0, 1.0], (len(corners), each)) + 0.01
    places = np.einsum("tqk,tkc->tqc", weight, corners).reshape(-1, 2)
    return places, mesh(*places.T)


@EACH
def test_at_is_the_field_of_ngsolve(order, periodic):
    flow, u, p, eps, rng = made(order, periodic)
    places, at = spots(u.space.mesh, rng)
    if periodic:  # any image
        places = places + rng.integers(-3, 4, places.shape) * flow.box.size
    velocity, pressure, porosity = flow.at(places)
    assert np.allclose(velocity, u(at), rtol=0.0, atol=1e-11)
    assert np.allclose(pressure, p(at)[:, 0], rtol=0.0, atol=1e-11)
    assert np.allclose(porosity, eps(at)[:, 0], rtol=0.0, atol=1e-11)
    # One place alone.
    alone = flow.at(places[7])
    assert [part.shape for part in alone] == [(1, 2), (1,), (1,)]
    assert alone[0][0] == pytest.approx(velocity[7], rel=1e-12)


def test_at_says_what_is_wrong():
    walls, torus = some_flow(1, False)[0], some_flow(1, True)[0]
    size = walls.box.size
    with pytest.raises(gm.InputError, match="outside the box"):
        walls.at([[0.5, 0.5], size * [1.0, 1.01]])
    torus.at(3.0 * size)
    walls.at([[0.0, 0.0], size])
    for bad in ([[np.nan, 0.0]], [[0.1, 0.2, 0.3]], 0.5, np.zeros((2, 2, 2))):
        with pytest.raises(gm.InputError, match="places"):
            walls.at(bad)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("side", SIDES)
def test_integrals_over_sides(order, side):
    flow, u, p, eps, _ = made(order, False)
    mesh, number = u.space.mesh, SIDES.index(side)
    there = {"definedon": mesh.Boundaries(side), "order": 2 * order + 2}
    out = (1.0 if number % 2 else -1.0) * eps * u[number // 2]
    assert flow.flux(side) == pytest.approx(Integrate(out, mesh, BND, **there), rel=1e-12)
    assert flow.pressure_at(side) == pytest.approx(Integrate(p, mesh, BND, **there), rel=1e-12)
    found = flow.measure()[f"pressure {side}"]
    assert found == pytest.approx(flow.pressure_at(side) / flow.box.size[1 - number // 2])


def test_sides_that_are_not_there():
    with pytest.raises(gm.InputError, match=r"'lid' must be one of left, right, bottom, top"):
        some_flow(1, False)[0].pressure_at("lid")
    for ask in ("flux", "pressure_at"):
        with pytest.raises(gm.InputError, match="side"):
            getattr(some_flow(1, True)[0], ask)("top")


@EACH
def test_mean_and_energy(order, periodic):
    flow, u, _, eps, _ = made(order, periodic)
    mesh = u.space.mesh
    exact = np.array(Integrate(eps * u, mesh, order=2 * order + 3)) / flow.box.area
    assert flow.mean() == pytest.approx(exact, rel=1e-11)
    energy = Integrate(0.5 * flow.fluid.density * eps * u * u, mesh, order=2 * max(order, 3) + 1)
    assert flow.measure()["fluid kinetic"] == pytest.approx(energy, rel=1e-11)
    assert Integrate(CF(1.0), mesh) == pytest.approx(flow.box.area, rel=1e-12)


@EACH
@pytest.mark.parametrize("cuts", [1, 2, 5])
def test_sample_tiles_the_box_with_values_of_the_flow(order, periodic, cuts):
    flow, *_ = made(order, periodic)
    found = flow.sample(cuts)
    t = len(flow.mesh.triangles)
    assert len(found.triangles) == t * cuts**2
    corner = found.points[found.triangles]
    a, b = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    assert (area > 0.0).all()
    assert area.sum() == pytest.approx(flow.box.area, rel=1e-12)
    middle = corner.mean(axis=1)
    if cuts == 1:
        assert ((middle > -1e-12) & (middle < flow.box.size + 1e-12)).all()
    velocity, pressure, porosity = flow.at(found.points)
    size = np.abs(velocity).max()
    assert np.abs(found.porosity - porosity).max() < 1e-11
    assert np.abs(found.velocity - velocity).max() < 1e-10 * size
    assert np.abs(found.pressure - pressure).max() < 1e-10 * size
    if not periodic:  # each point once
        count = flow.mesh.in_use.sum() + len(flow.operator.topology.edges) * (cuts - 1)
        assert len(found.points) == count + t * (cuts - 1) * (cuts - 2) // 2
        assert len(np.unique(found.points.round(9), axis=0)) == len(found.points)


def test_a_flow_says_what_it_is():
    flow = made(1, False)[0]
    assert repr(flow).startswith(f"Coupling: MINI on {len(flow.operator.area)} triangles, ")
    assert f"{flow.operator.free.sum()} unknowns" in repr(flow)
