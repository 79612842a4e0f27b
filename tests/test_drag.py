"""Drag laws: limits, identities, ranges, scaling, and a positive number for every bed."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from grainmesh import closures
from grainmesh.closures import LAWS, ClosureWarning, HexagonalLattice
from grainmesh.drag import (
    DRAGS,
    LEAST_POROSITY,
    Bed,
    Channel,
    Cylinder,
    Lamb,
    Permeability,
    RandomDiscs,
    SchillerNaumann,
    Stokes,
    White,
    from_name,
)
from grainmesh.errors import InputError

SPHERES = ("stokes", "schiller-naumann")


def named(name, depth=1e-3):
    return from_name(name, depth=depth) if name in SPHERES else from_name(name)


def bed(porosity=0.6, reynolds=0.01, *, mu=1e-3, rho=1e3, diameter=1e-4, gap=0.3, width=1e-2):
    """A bed whose cells have these porosities, discs that slip at these Reynolds numbers."""
    porosity, reynolds, d = np.broadcast_arrays(*np.atleast_1d(porosity, reynolds, diameter))
    area = np.pi * d**2 / 4.0 / (1.0 - porosity)
    return Bed(mu, rho, d * 1.0, porosity * 1.0, area, reynolds * mu / (rho * d), gap, width)


def quiet(law, where):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClosureWarning)
        return law.coefficient(where)


# One name for each fact


@pytest.mark.parametrize("name", DRAGS)
def test_a_law_has_the_name_it_is_found_by_and_says_what_it_is(name):
    law = named(name)
    low, high = law.valid
    assert law.name == name
    assert law.medium
    assert law.reference
    assert low < high
    assert law.variable in ("porosity", "gap", "Re", "d/W")
    assert law.undisturbed == (name not in (*LAWS, "random-discs"))


def test_the_default_is_the_law_of_discs_at_random():
    assert from_name("random-discs") == Permeability()


# Any bed gets a positive, finite number

wild = st.floats(-2.0, 0.999999)


@pytest.mark.parametrize("name", DRAGS)
@given(
    porosity=st.lists(wild, min_size=1, max_size=4),
    reynolds=st.floats(0.0, 1e6),
    gap=st.floats(-0.5, 1e3),
    ratio=st.floats(1e-9, 10.0),
    mu=st.floats(1e-6, 1e3),
)
def test_drag_is_positive_and_finite(name, porosity, reynolds, gap, ratio, mu):
    b = quiet(named(name), bed(porosity, reynolds, mu=mu, gap=gap, width=1e-4 / ratio))
    assert b.shape == (len(porosity),)
    assert np.isfinite(b).all()
    assert (b > 0.0).all()


@pytest.mark.parametrize("name", DRAGS)
def test_a_pure_fluid_and_a_disc_at_rest_have_a_drag(name):
    where = replace(bed(reynolds=0.0), porosity=np.ones(1), width=np.inf, rho=0.0)
    b = quiet(named(name), where)
    assert np.isfinite(b).all()
    assert (b > 0.0).all()


@pytest.mark.parametrize("name", DRAGS)
def test_a_faster_flow_pulls_harder(name):
    """b |slip| rises with the slip, through every joint of two formulas."""
    where = bed(0.6, np.geomspace(1e-8, 1e6, 4000))
    assert (np.diff(quiet(named(name), where) * where.slip) > 0.0).all()


@pytest.mark.parametrize("name", [n for n in DRAGS if named(n).variable == "porosity"])
def test_a_denser_bed_resists_more(name):
    law = named(name)
    where = bed(np.linspace(0.0, 0.99, 100), 0.0)  # hundredths, as `least` is found in
    beta = quiet(law, where) / where.area
    assert (np.diff(beta / beta[0]) < 1e-12).all()


@pytest.mark.parametrize("name", DRAGS)
@given(length=st.floats(1e-4, 1e4), time=st.floats(1e-3, 1e3), mass=st.floats(1e-3, 1e3))
def test_units(name, length, time, mass):
    """b is a force over a velocity and a depth: mass/(length time)."""
    here = bed([0.4, 0.7, 0.9], [0.05, 3.0, 200.0])
    there = Bed(
        here.mu * mass / (length * time),
        here.rho * mass / length**3,
        here.diameter * length,
        here.porosity,
        here.area * length**2,
        here.slip * length / time,
        here.gap,
        here.width * length,
    )
    b = quiet(named(name, depth=1e-3), here)
    scaled = quiet(named(name, depth=1e-3 * length), there)
    np.testing.assert_allclose(scaled * length * time / mass, b, rtol=1e-10)


@pytest.mark.parametrize("name", DRAGS)
def test_discs_do_not_see_each_other_in_a_law(name):
    """The drag of a disc is the same whoever else is asked for, in any order."""
    eps, re, d = np.array([0.3, 0.95, 0.6]), np.array([1.0, 0.2, 40.0]), np.array([1, 2, 3]) * 1e-4
    b = quiet(named(name), bed(eps, re, diameter=d))
    alone = [quiet(named(name), bed(eps[i], re[i], diameter=d[i])) for i in range(3)]
    np.testing.assert_allclose(b, np.concatenate(alone), rtol=1e-14)


# Beds


@pytest.mark.parametrize("law", LAWS.values(), ids=str)
def test_a_bed_law_is_equation_3_times_the_cell(law):
    low, high = law.valid
    eps = np.linspace(max(low, 0.4), min(high, 0.9), 7) if law.variable == "porosity" else 0.6
    where = bed(eps, 5.0)
    speed = where.porosity * where.slip  # superficial
    beta = closures.drag_coefficient(
        law, where.porosity, where.gap, where.diameter, where.mu, where.rho, speed
    )
    b = quiet(Permeability(law), where)
    held = where.porosity < Permeability(law).least  # where a law is held it is not itself
    assert not (held & (law.variable == "porosity")).all()
    np.testing.assert_allclose(b[~held], (beta * where.area)[~held], rtol=1e-12)


@pytest.mark.parametrize("eps", [0.25, 0.5, 0.9])
def test_a_uniform_bed_obeys_darcy(eps):
    """Drag and pressure on the discs of a periodic cell carry -∇p of all of it: U = -(K/μ) ∇p."""
    where, gradient = bed(eps, 0.0), 7.0
    K = RandomDiscs()(eps, 1.0) * where.diameter**2
    u = K * gradient / (where.mu * eps)  # interstitial
    drag = Permeability().coefficient(where) * u
    np.testing.assert_allclose(drag + (1.0 - eps) * where.area * gradient, where.area * gradient)


def test_random_discs_close_as_the_gap_to_the_power_two_and_a_half():
    phi_max = np.pi / np.sqrt(12.0)
    gap = np.array([1e-3, 1e-4])
    lam = RandomDiscs()._permeability(1.0 - phi_max / (1.0 + gap) ** 2)
    assert np.diff(np.log(lam)) / np.diff(np.log(gap)) == pytest.approx(2.5, abs=0.02)


@pytest.mark.parametrize("phi", [1e-8, 1e-6, 1e-4, 1e-2])
def test_dilute_random_discs_obey_brinkman(phi):
    """A disc in a medium of its own permeability, κ = d/(2√K): F = 4πμU/(ln(2/κ) - γ_E)."""
    root = -np.log(phi)
    for _ in range(100):  # 32 φ λ = L solves L = -ln φ + ln L + 4 ln 2 - 2 γ_E - ln 32
        root = -np.log(phi) + np.log(root) + 4 * np.log(2) - 2 * np.euler_gamma - np.log(32)
    assert RandomDiscs()(1.0 - phi, 1.0) == pytest.approx(root / (32.0 * phi), rel=0.05)


def test_random_discs_and_lattice_part_as_they_should():
    """Dilute, gaps between clusters let more through; dense, the narrow gaps let less."""
    eps = np.array([0.3, 0.5, 0.9, 0.99])
    ratio = RandomDiscs()(eps, 1.0) / HexagonalLattice()(eps, 1.0)
    assert (ratio[:2] < 0.8).all()
    assert (ratio[2:] > 1.2).all()


def test_random_discs_agree_with_the_published_page():
    """Resolved K/d² of 100 hard discs without a minimum gap (docs/random_arrays.md), 5 samples."""
    eps = np.array([0.4, 0.5, 0.6, 0.7, 0.8, 0.9])
    resolved = np.array([5.307e-4, 1.817e-3, 7.196e-3, 2.396e-2, 8.429e-2, 4.168e-1])
    np.testing.assert_allclose(RandomDiscs()(eps, 1.0), resolved, rtol=RandomDiscs.error)


def test_random_discs_agree_with_resolved_flow():
    import grainmesh as gm

    lam = []
    for seed in (11, 12):
        box, discs = gm.arrange.random(50, porosity=0.9, diameter=1.0, seed=seed)
        lam.append(gm.permeability(box, discs, tol=0.02).normalised)
    assert RandomDiscs()(0.9, 1.0) == pytest.approx(np.mean(lam), rel=0.12)


def test_pressed_together_a_bed_is_held_at_its_densest():
    b = [quiet(Permeability(), bed(eps, 0.0)) for eps in (0.05, LEAST_POROSITY)]
    area = [bed(eps).area for eps in (0.05, LEAST_POROSITY)]
    np.testing.assert_allclose(b[0] / area[0], b[1] / area[1])


@pytest.mark.parametrize("law", LAWS.values(), ids=str)
def test_a_law_is_held_just_above_where_it_ends(law):
    """`least` keeps all of the range but a hundredth, and only what is sound."""
    least = Permeability(law).least
    assert least <= law.valid[0] + 0.01
    x = np.arange(least, 0.99, 0.01)
    lam = law._permeability(x)
    assert (lam > 0.0).all()
    assert (np.diff(x**2 / lam) < 0.0).all()


# One particle


def test_lamb_is_the_textbook_number():
    """Re = 0.1: C_D = 8π/(Re S), S = 1/2 - 0.57722 - ln(0.1/8) = 4.3048."""
    where = bed(0.9, 0.1)
    drag_number = Lamb().coefficient(where) * where.slip / (0.5 * where.rho * where.slip**2)
    assert drag_number / where.diameter == pytest.approx(8 * np.pi / 0.1 / 4.3048, rel=1e-4)


@pytest.mark.parametrize(("re", "number"), [(1.0, 11.0), (1e3, 1.1), (1e4, 1.02154)])
def test_white_drag_number(re, number):
    where = bed(0.9, re)
    force = White().coefficient(where) * where.slip
    found = force / (0.5 * where.rho * where.slip**2 * where.diameter)
    assert found == pytest.approx(number, rel=1e-4)


def test_the_cylinder_law_ends_in_lamb_and_white():
    slow, fast = bed(0.9, np.geomspace(1e-6, 1e-3)), bed(0.9, np.geomspace(1.0, 1e5))
    np.testing.assert_allclose(Cylinder().coefficient(slow), quiet(Lamb(), slow), rtol=0.011)
    np.testing.assert_allclose(Cylinder().coefficient(fast), White().coefficient(fast), rtol=1e-14)


def test_the_cylinder_law_has_no_step_and_no_kink():
    re = np.geomspace(0.05, 4.0, 4001)
    slope = np.gradient(np.log(Cylinder().coefficient(bed(0.9, re))), np.log(re))
    assert np.abs(np.diff(slope[2:-2])).max() < 2e-3


def test_cylinder_at_re_20():
    """Dennis & Chang 1970: C_D = 2.045 at Re = 20; White's fit is 15 % above it there."""
    where = bed(0.9, 20.0)
    force = Cylinder().coefficient(where) * where.slip
    found = force / (0.5 * where.rho * where.slip**2 * where.diameter)
    assert found == pytest.approx(2.045, rel=0.2)


def test_channel_settles_as_the_design_says():
    """Fig. 3 with d = 0.1 m, W = 2 m, ρ 1000 and 2000 kg/m3, μ = 75.2 Pa s: 0.17 m/s."""
    where = bed(0.9, 0.0, mu=75.2, diameter=0.1, width=2.0)
    weight = 1000.0 * 9.81 * np.pi * 0.1**2 / 4.0
    assert weight / Channel().coefficient(where) == pytest.approx(0.17, rel=2e-3)


def test_channel_tends_to_the_logarithm_of_faxen():
    ratio = np.array([1e3, 1e6])
    s = [
        4 * np.pi * 1e-3 / Channel().coefficient(bed(0.9, 0.0, diameter=1.0, width=w))[0]
        for w in ratio
    ]
    np.testing.assert_allclose(s, np.log(ratio) - 0.9157, atol=1e-5)


def test_spheres_share_the_depth():
    where = bed(0.9, 0.01)
    b = Stokes(depth=2e-4).coefficient(where)
    np.testing.assert_allclose(b * 2e-4, 3 * np.pi * where.mu * where.diameter, rtol=1e-14)
    np.testing.assert_allclose(Stokes(depth=1e-4).coefficient(where), 2 * b, rtol=1e-14)


def test_schiller_naumann_between_stokes_and_newton():
    rest, fast = bed(0.9, 0.0), bed(0.9, 5e4)
    sphere = SchillerNaumann(depth=1e-4)
    np.testing.assert_allclose(sphere.coefficient(rest), Stokes(1e-4).coefficient(rest))
    force = sphere.coefficient(fast) * fast.slip * 1e-4
    dynamic = 0.5 * fast.rho * fast.slip**2 * np.pi * fast.diameter**2 / 4
    np.testing.assert_allclose(force / dynamic, 0.44, rtol=1e-12)
    joint = sphere.coefficient(bed(0.9, np.geomspace(500, 2000, 2000)))
    assert (np.diff(joint) / joint[1:]).max() < 2e-3


# Warnings and refusals


@pytest.mark.parametrize(
    ("name", "inside", "outside", "span"),
    [
        ("random-discs", bed(0.5), bed(0.12), "0.2 to 1"),
        ("microstructural", bed(gap=0.3), bed(gap=4.0), "0.07 to 1.3"),
        ("lamb", bed(0.9, 0.01), bed(0.9, 2.0), "0 to 0.1"),
        ("channel", bed(width=1e-2), bed(width=2.5e-4), "0 to 0.3"),
    ],
)
def test_a_law_warns_once_and_names_its_range(name, inside, outside, span):
    law = from_name(name)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for where in (inside, outside, inside, outside, outside):
            law.coefficient(where)
        assert len(caught) == 1
        assert caught[0].category is ClosureWarning
        assert f"its range is {span}" in str(caught[0].message)
        from_name(name).coefficient(outside)  # a new law tells it anew
        assert len(caught) == 2
    assert law == from_name(name)


def test_a_few_cells_outside_are_the_scatter_of_a_bed():
    Permeability().coefficient(bed([0.15, 0.4, 0.5]))  # a ClosureWarning would fail the test
    with pytest.warns(ClosureWarning):
        Permeability().coefficient(bed([0.15, 0.15, 0.5]))


@pytest.mark.parametrize(("wrong", "near"), [("lam", "lamb"), ("schiller", "schiller-naumann")])
def test_an_unknown_name_lists_near_ones(wrong, near):
    with pytest.raises(InputError, match=near):
        from_name(wrong)


def test_an_unknown_name_like_no_other_lists_all():
    with pytest.raises(InputError) as caught:
        from_name("???")
    assert all(name in str(caught.value) for name in DRAGS)


def test_depth_is_asked_for_where_it_matters():
    with pytest.raises(InputError, match="depth"):
        from_name("stokes")
    with pytest.raises(InputError, match="no parameter"):
        from_name("lamb", depth=1.0)
    for depth in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="positive"):
            from_name("stokes", depth=depth)


def test_a_law_of_the_gap_refuses_a_bed_without_one():
    with pytest.raises(InputError, match="law of the porosity"):
        from_name("microstructural").coefficient(bed(gap=np.nan))
