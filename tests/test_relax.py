"""Discs pushed apart: what comes out is accepted, and what was right is left alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import grainmesh as gm
from grainmesh.relax import SMALL

LAW = gm.Contact(1e7)


def worst(model, particles):
    """Largest overlap of discs, or of a disc and a side, in smaller radii, from all pairs."""
    x, r, box = particles.x, particles.radius, model.box
    i, j = np.triu_indices(len(x), 1)
    distance = np.hypot(*box.separation(x[i], x[j]).T)
    shares = [(r[i] + r[j] - distance) / np.minimum(r[i], r[j])]
    if not box.periodic:
        room = np.stack([x[:, 0], box.width - x[:, 0], x[:, 1], box.height - x[:, 1]])
        shut = [side not in model.open for side in ("left", "right", "bottom", "top")]
        shares.append((1.0 - room[shut] / r).ravel())
    return max(share.max(initial=0.0) for share in shares)


@settings(max_examples=40, deadline=None)
@given(
    n=st.integers(1, 60),
    seed=st.integers(0, 10**6),
    ratio=st.sampled_from([1.0, 10.0]),
    periodic=st.booleans(),
)
def test_discs_at_random_places_are_pushed_apart_and_accepted(n, seed, ratio, periodic):
    rng = np.random.default_rng(seed)
    d = ratio ** -rng.uniform(0, 1, n)
    side = max(np.sqrt(np.pi / 4 * (d**2).sum() / 0.4), 2.2 * d.max())
    model = gm.Model(gm.Box(side, side, periodic), LAW)
    given_ = gm.Particles(rng.uniform(0.0, side, (n, 2)), d, rng.uniform(1e3, 2e3, n))
    found = gm.relax(model, given_)
    assert worst(model, found) <= SMALL * (1 + 1e-9)
    assert (found.diameter == given_.diameter).all()
    assert (found.density == given_.density).all()
    assert len(gm.Simulation(model, found)) == n


def test_discs_that_do_not_overlap_stay_where_they_are():
    box, particles = gm.arrange.random(50, porosity=0.4, diameter=0.1, seed=0, periodic=False)
    found = gm.relax(gm.Model(box, LAW), particles)
    assert (found.x == particles.x).all()


def test_a_pair_is_pushed_apart_evenly():
    model = gm.Model(gm.Box(1.0, 1.0), LAW)
    found = gm.relax(model, gm.Particles([[0.46, 0.5], [0.54, 0.5]], 0.1))
    assert found.x == pytest.approx(np.array([[0.45, 0.5], [0.55, 0.5]]), abs=0.05 * SMALL)


@pytest.mark.parametrize("periodic", [False, True])
def test_discs_at_one_place_are_parted(periodic):
    model = gm.Model(gm.Box(1.0, 1.0, periodic), LAW)
    found = gm.relax(model, gm.Particles(np.full((7, 2), 0.5), 0.1))
    assert worst(model, found) <= SMALL * (1 + 1e-9)
    assert len(gm.Simulation(model, found)) == 7


def test_segments_and_open_sides_count():
    wall = gm.Wall((0.2, 0.5), (0.8, 0.5))
    model = gm.Model(gm.Box(1.0, 1.0), LAW, walls=(wall,), open=("left",))
    found = gm.relax(model, gm.Particles([[0.4, 0.53], [0.6, 0.49], [0.01, 0.5]], 0.1))
    assert found.x[0, 1] == pytest.approx(0.55, abs=0.05 * SMALL)
    assert found.x[1, 1] == pytest.approx(0.45, abs=0.05 * SMALL)
    assert found.x[2].tolist() == [0.01, 0.5]  # the left side is open
    assert len(gm.Simulation(model, found)) == 3


def test_a_pile_is_relaxed_too():
    # Where each disc that is pushed pushes another: long chains, up to a free surface.
    box = gm.Box(0.15, 0.6)
    d = np.random.default_rng(0).uniform(0.008, 0.012, 300)
    particles = gm.arrange.loose(box, 300, diameter=d)
    model = gm.Model(box, gm.Contact(2e6, restitution=0.3))
    pile = gm.Simulation(model, particles).run(0.6).particles
    swollen = pile.with_diameter(1.04 * d)
    found = gm.relax(model, swollen)
    assert worst(model, swollen) > 5 * SMALL
    assert worst(model, found) <= SMALL * (1 + 1e-9)
    assert np.abs(found.x - pile.x).max() < 2 * d.max()


def test_discs_that_do_not_fit_are_refused():
    model = gm.Model(gm.Box(0.3, 0.3), LAW)
    x = np.random.default_rng(0).uniform(0, 0.3, (20, 2))
    with pytest.raises(gm.InputError, match="do not fit: enlarge the box") as error:
        gm.relax(model, gm.Particles(x, 0.1))
    assert "\n" not in str(error.value)
