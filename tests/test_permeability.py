"""One call, three methods: they agree where they must, and say where they cannot."""

import numpy as np
import pytest

import grainmesh as gm
from grainmesh.closures import ClosureWarning, HexagonalLattice, SquareLattice
from grainmesh.permeability import percent


@pytest.mark.parametrize("porosity", [0.5, 0.8])
def test_three_methods_agree_on_a_lattice(porosity):
    box, discs = gm.arrange.square(3, 3, porosity=porosity, diameter=2e-5)
    law = SquareLattice()
    found = [
        gm.permeability(box, discs, method, law=law, tol=1e-4)
        for method in ("resolved", "mesoscale", "microstructure")
    ]
    for K in found:
        assert K.normalised == pytest.approx(law(porosity, np.nan), rel=3e-4)
        assert K.porosity == pytest.approx(porosity, abs=1e-12)
        assert K.gap == pytest.approx(np.sqrt(np.pi / 4 / (1 - porosity)) - 1, abs=1e-12)
        assert K.normalised == pytest.approx(np.trace(K.tensor) / 2 / (2e-5) ** 2, rel=1e-14)
        assert K.n == 9
        assert K.error < 1e-3


def test_error_covers_eq_4_on_random_discs():
    box, discs = gm.arrange.random(100, porosity=0.7, diameter=1.0, min_gap=0.1, seed=1)
    exact = gm.permeability(box, discs, tol=1e-2).normalised
    for method in ("mesoscale", "microstructure"):
        K = gm.permeability(box, discs, method)
        assert abs(K.normalised / exact - 1.0) < K.error < 0.5


def test_law_for_another_medium_is_told():
    lattice = gm.arrange.square(4, 4, porosity=0.6, diameter=1.0)
    with pytest.warns(ClosureWarning, match="regular lattice"):
        K = gm.permeability(*lattice, "microstructure")
    assert K.error >= 1.0
    assert "square-lattice" in K.notes[0]
    random = gm.arrange.random(60, porosity=0.6, diameter=1.0, seed=1)
    with pytest.warns(ClosureWarning, match="at random"):
        K = gm.permeability(*random, "mesoscale", law=HexagonalLattice())
    assert K.error >= 1.0
    assert K.notes


def test_law_out_of_its_range_is_told():
    box, discs = gm.arrange.random(50, porosity=0.97, diameter=1.0, seed=1)
    with pytest.warns(ClosureWarning, match="microstructural"):
        K = gm.permeability(box, discs, "microstructure")
    assert K.notes


def test_blocked_pores_are_told():
    K = gm.permeability(gm.Box(1.0, 1.0, True), gm.Particles([[0.5, 0.5]], 1.0))
    assert not K.tensor.any()
    assert any("blocked" in note for note in K.notes)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"method": "guess"}, "method 'guess' unknown"),
        ({"walls": "sticky"}, "walls 'sticky' unknown"),
        ({"tol": 0.0}, "tolerance 0"),
        ({"order": 2.5}, "order 2.5"),
        ({"method": "mesoscale", "order": 0}, "order 0"),
    ],
)
def test_bad_words_are_refused(words, message):
    box, discs = gm.arrange.random(10, porosity=0.6, diameter=1.0, seed=1)
    with pytest.raises(gm.InputError, match=message):
        gm.permeability(box, discs, **words)


def test_the_box_comes_first():
    box, discs = gm.arrange.square(2, 2, porosity=0.7, diameter=1.0)
    with pytest.raises(gm.InputError, match="the box first"):
        gm.permeability(discs, box)


@pytest.mark.parametrize(
    ("error", "text"), [(1.0, "100 %"), (0.0012, "0.12 %"), (0.0, "0 %"), (np.nan, "-")]
)
def test_errors_are_written_without_powers_of_ten(error, text):
    assert percent(error) == text


def test_fewer_than_three_discs_have_no_mean_gap():
    box, discs = gm.Box(5.0, 5.0), gm.Particles([[1.0, 1.0], [3.0, 3.0]], 1.0)
    with pytest.raises(gm.InputError, match="at least 3"):
        gm.permeability(box, discs, "microstructure")
    assert np.isnan(gm.permeability(box, discs, tol=1e-2).gap)
