"""Closures: limits, identities, stated errors against exact lattices, and refusals."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from grainmesh import closures
from grainmesh.closures import LAWS, ClosureWarning, drag_coefficient, lattice_gap
from grainmesh.errors import InputError

LATTICES = ("square", "hexagonal")
PHI_MAX = {"square": np.pi / 4.0, "hexagonal": np.pi / np.sqrt(12.0)}


def inside(law, n=400, margin=1e-4):
    """Values over the range of a law, and a partner for the argument that it ignores."""
    low, high = law.valid
    x = np.linspace(low + margin, high - margin, n)
    return {"porosity": 0.5, "gap": 0.5, law.variable: x}


def resolved(lattice, phi, order):
    """λ of a lattice by finite elements: a quarter of a rectangular cell, discs of diameter 1.

    Flow along x with unit force: on every straight side the velocity across the flow vanishes.
    """
    import ngsolve as ng
    from netgen.occ import OCCGeometry, WorkPlane

    pitch = np.sqrt(PHI_MAX[lattice] / phi)
    width, height = pitch / 2.0, pitch / 2.0 * (1.0 if lattice == "square" else np.sqrt(3.0))
    face = WorkPlane().Rectangle(width, height).Face() - WorkPlane().Circle(0, 0, 0.5).Face()
    if lattice == "hexagonal":
        face = face - WorkPlane().Circle(width, height, 0.5).Face()
    for edge in face.edges:
        a, b = edge.bounding_box
        thin = min(b.x - a.x, b.y - a.y) < 1e-5
        edge.name = "side" if thin else "disc"
    size = min(0.15, max((pitch - 1.0) / 2.0, 0.03))
    mesh = ng.Mesh(OCCGeometry(face, dim=2).GenerateMesh(maxh=size, grading=0.5))
    mesh.Curve(order + 1)
    velocity = ng.VectorH1(mesh, order=order, dirichletx="disc", dirichlety="disc|side")
    # u_x is free on the sides; on those along the flow that means no shear.
    space = velocity * ng.H1(mesh, order=order - 1)
    (u, p), (v, q) = space.TnT()
    stokes = ng.InnerProduct(ng.Grad(u), ng.Grad(v)) - ng.div(u) * q - ng.div(v) * p
    form = ng.BilinearForm((stokes - 1e-12 * p * q) * ng.dx, condense=True).Assemble()
    flow, load = ng.GridFunction(space), ng.LinearForm(v[0] * ng.dx).Assemble().vec
    load.data += form.harmonic_extension_trans * load
    flow.vec.data = form.mat.Inverse(space.FreeDofs(True), "sparsecholesky") * load
    flow.vec.data += form.harmonic_extension * flow.vec
    flow.vec.data += form.inner_solve * load
    return ng.Integrate(flow.components[0][0], mesh) / (width * height)


def exact(lattice, eps):
    return LAWS[f"{lattice}-lattice"](eps, 1.0)


# Lattices


@pytest.mark.parametrize("lattice", LATTICES)
@pytest.mark.parametrize("phi", [0.1, 0.3, 0.5, 0.6])
def test_table_is_stokes_flow(lattice, phi):
    assert exact(lattice, 1.0 - phi) == pytest.approx(resolved(lattice, phi, 6), rel=1e-6)


@pytest.mark.parametrize("lattice", LATTICES)
@pytest.mark.parametrize("phi", [0.06, 0.25, 0.45, 0.67, 0.77])
def test_between_the_rows_within_the_stated_error(lattice, phi):
    law = LAWS[f"{lattice}-lattice"]
    assert law(1.0 - phi, 1.0) == pytest.approx(resolved(lattice, phi, 6), rel=law.error)


@pytest.mark.parametrize("lattice", LATTICES)
def test_lattice_is_dilute_at_first_order(lattice):
    # λ -> [ln(1/φ) - k + 2 φ]/(32 φ); what is left of 32 φ λ falls as φ².
    k = {"square": 1.476336, "hexagonal": 1.497504}[lattice]
    phi = np.array([1e-2, 1e-3])
    rest = 32.0 * phi * exact(lattice, 1.0 - phi) - (np.log(1.0 / phi) - k + 2.0 * phi)
    assert np.log10(rest[0] / rest[1]) == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("lattice", LATTICES)
def test_lattice_closes_by_lubrication(lattice):
    # Gaps alone, flux q = (2/(9 π)) h^2.5/√r through each, in a square or honeycomb network.
    gap = np.array([1e-2, 1e-3, 1e-4])
    phi = PHI_MAX[lattice] / (1.0 + gap) ** 2
    network = {"square": 1.0, "hexagonal": 1.0 / np.sqrt(3.0)}[lattice]
    ratio = exact(lattice, 1.0 - phi) / (network * 2.0 / (9.0 * np.pi) * gap**2.5 * np.sqrt(2.0))
    assert np.log10(abs(ratio[:-1] - 1.0) / abs(ratio[1:] - 1.0)) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("lattice", LATTICES)
def test_lattice_is_monotone_and_continuous(lattice):
    law = LAWS[f"{lattice}-lattice"]
    eps = np.linspace(law.valid[0] + 1e-6, 1.0 - 1e-6, 20_000)
    assert (np.diff(law(eps, 1.0)) > 0.0).all()
    joint = law(0.95 + np.array([1e-9, -1e-9]), 1.0)  # dilute series | table
    assert joint[0] == pytest.approx(joint[1], rel=3e-6)


@pytest.mark.parametrize("lattice", LATTICES)
@given(eps=st.floats(0.25, 0.99))
def test_lattice_gap_is_pitch(lattice, eps):
    # φ = area of a disc over area of a cell of this pitch, d = 1.
    pitch = 1.0 + lattice_gap(lattice, eps)
    cell = pitch**2 * (1.0 if lattice == "square" else np.sqrt(0.75))
    assert np.pi / 4.0 / cell == pytest.approx(1.0 - eps, rel=1e-12)


# Stated errors

REFERENCE = {  # law: lattices against which its error is stated
    "gebart-square": "square",
    "gebart-hexagonal": "hexagonal",
    "drummond-tahir-square": "square",
    "drummond-tahir-hexagonal": "hexagonal",
    "lee-yang": "square",
    "kuwabara": "hexagonal",
    "happel": "hexagonal",
    "carman-kozeny": "hexagonal",
    "ergun-2d": "hexagonal",
}


@pytest.mark.parametrize("name", REFERENCE)
def test_stated_error_holds_and_is_not_idle(name):
    law = LAWS[name]
    at = inside(law)
    worst = np.abs(law(**at) / exact(REFERENCE[name], at["porosity"]) - 1.0).max()
    assert 0.5 * law.error < worst <= law.error


@pytest.mark.parametrize("lattice", LATTICES)
def test_microstructural_is_too_high_for_lattices(lattice):
    eps = np.linspace(0.25, 0.9, 50)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClosureWarning)
        ratio = LAWS["microstructural"](eps, lattice_gap(lattice, eps)) / exact(lattice, eps)
    assert 1.0 < ratio.min() < ratio.max() < 3.8


# Identities


def test_microstructural_parameters():
    gap = np.linspace(0.1, 1.2, 20)
    law = closures.Microstructural(C=0.3, a=0.0)
    assert law(0.5, gap) == pytest.approx(0.3 * gap**2.5, rel=1e-14)
    slope = closures.Microstructural(a=1.0, b=1e-6)(0.5, gap) / gap**3.5
    assert slope == pytest.approx(np.full(20, 0.2e-6), rel=1e-5)


def test_kuwabara_is_the_leading_series_of_the_hexagonal_lattice():
    phi = np.array([0.02, 0.1, 0.3])
    difference = 32.0 * phi * (LAWS["kuwabara"](1 - phi, 1) - LAWS["hexagonal-lattice"](1 - phi, 1))
    assert difference == pytest.approx(np.full(3, 1.497504 - 1.5), abs=3e-3)


def test_happel_and_kuwabara_differ_by_a_half():
    # The two cell models differ only in the constant of the dilute limit: -1 and -3/2.
    phi = 1e-6
    difference = 32.0 * phi * (LAWS["happel"](1 - phi, 1) - LAWS["kuwabara"](1 - phi, 1))
    assert difference == pytest.approx(0.5, abs=1e-5)


def test_forchheimer_with_p_1_is_ergun():
    ergun = LAWS["ergun-2d"]
    eps, re = np.linspace(0.3, 0.7, 9), 7.0
    lam = ergun(eps, 1.0)
    linear = closures.Forchheimer(closures.Kuwabara(), p=1.0)
    assert linear.inertia(re, eps, lam) == pytest.approx(ergun.inertia(re, eps, lam), rel=1e-4)


def test_ergun_is_carman_kozeny_of_its_own_constant():
    eps = np.linspace(0.3, 0.7, 9)
    kozeny = closures.CarmanKozeny(k=66.7 / 16.0)(eps, 1.0)
    assert LAWS["ergun-2d"](eps, 1.0) == pytest.approx(kozeny, rel=1e-14)


@pytest.mark.parametrize("name", LAWS)
def test_inertia_is_one_at_rest_and_never_helps(name):
    law = LAWS[name]
    re = np.array([0.0, 1.0, 10.0])
    factor = law.inertia(re, 0.6, 0.01)
    assert factor[0] == 1.0
    carries = name in ("ergun-2d", "forchheimer")
    assert (np.diff(factor) > 0.0).all() if carries else (factor == 1.0).all()


def test_forchheimer_power():
    law = closures.Forchheimer(closures.SquareLattice(), p=1.6)
    excess = law.inertia(np.array([1.0, 10.0]), 0.6, 0.01) - 1.0
    assert np.log10(excess[1] / excess[0]) == pytest.approx(1.6, rel=1e-12)


@given(
    length=st.floats(1e-6, 1e3),
    mass=st.floats(1e-3, 1e3),
    time=st.floats(1e-3, 1e3),
)
def test_drag_does_not_depend_on_units(length, mass, time):
    law = LAWS["forchheimer"]
    beta = drag_coefficient(law, 0.6, 0.3, 2.0, 3.0, 5.0, 7.0)
    scaled = drag_coefficient(
        law,
        0.6,
        0.3,
        2.0 * length,
        3.0 * mass / (length * time),
        5.0 * mass / length**3,
        7.0 * length / time,
    )
    assert scaled == pytest.approx(beta * mass / (length**3 * time), rel=1e-9)


@pytest.mark.parametrize("name", LAWS)
def test_drag_balances_the_pressure_gradient(name):
    # ε ∇p balances β <u> in a uniform bed: -∇p = μ U/K times the inertia, with U = ε <u>.
    law, eps, gap, d, mu, rho, speed = LAWS[name], 0.7, 0.5, 1e-3, 2e-3, 900.0, 0.02
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClosureWarning)
        lam = law(eps, gap)
        beta = drag_coefficient(law, eps, gap, d, mu, rho, speed)
    darcy = mu * speed / (lam * d**2) * law.inertia(rho * speed * d / mu, eps, lam)
    assert beta * (speed / eps) / eps == pytest.approx(darcy, rel=1e-13)


# Interface


@pytest.mark.parametrize("name", LAWS)
def test_every_law_takes_both_arguments_and_uses_one(name):
    law = LAWS[name]
    assert law.name == name
    assert law.reference
    assert law.medium
    at = inside(law, 7)
    lam = law(**at)
    assert lam.shape == (7,)
    assert (np.diff(lam) > 0.0).all()
    other = "gap" if law.variable == "porosity" else "porosity"
    assert (law(**{**at, other: np.nan}) == lam).all()
    assert law(**{**at, other: np.full((3, 1), 0.4)}).shape == (3, 7)
    assert f"{law(**{**at, law.variable: at[law.variable][3]}):.3g}" == f"{lam[3]:.3g}"


# The exact lattice laws are left out: where the lattice exists, they are valid.
@pytest.mark.parametrize("name", [n for n in LAWS if not n.endswith("-lattice")])
def test_warns_once_outside_the_range(name):
    law = LAWS[name]
    low, high = law.valid
    x = low - 0.01 if high == 1.0 else high + 0.01
    with pytest.warns(ClosureWarning, match=f"law {name} used at {law.variable}") as caught:
        law(**{"porosity": 0.5, "gap": 0.5, law.variable: [x, x]})
    assert len(caught) == 1
    assert caught[0].filename == __file__


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("bad", [0.0, -0.1, np.nan, np.inf])
def test_refuses_what_is_not_physical(name, bad):
    law = LAWS[name]
    with pytest.raises(InputError, match=law.variable):
        law(**{"porosity": 0.5, "gap": 0.5, law.variable: [0.5, bad]})


@pytest.mark.parametrize("name", [n for n in LAWS if LAWS[n].variable == "porosity"])
def test_refuses_porosity_of_one(name):
    with pytest.raises(InputError, match="between 0 and 1"):
        LAWS[name](1.0, 0.5)


@pytest.mark.parametrize(
    "name", ["square-lattice", "hexagonal-lattice", "gebart-square", "lee-yang"]
)
def test_refuses_a_medium_that_has_closed(name):
    with pytest.raises(InputError, match=f"law {name} has no positive permeability at porosity"):
        LAWS[name](0.05, 0.5)


@pytest.mark.parametrize(
    "make",
    [
        lambda: closures.Microstructural(C=0.0),
        lambda: closures.Microstructural(a=1.5),
        lambda: closures.Microstructural(b=np.nan),
        lambda: closures.CarmanKozeny(k=-5.0),
        lambda: closures.Forchheimer(p=0.0),
        lambda: closures.Forchheimer(closures.Ergun2D()),
        lambda: closures.Gebart("triangular"),
        lambda: closures.DrummondTahir("cubic"),
        lambda: LAWS["kuwabara"]([0.7, 0.8], [0.5, 0.5, 0.5]),
        lambda: lattice_gap("cubic", 0.5),
        lambda: lattice_gap("square", 1.5),
        lambda: drag_coefficient(LAWS["kuwabara"], 0.7, 0.5, -1.0, 1.0),
        lambda: drag_coefficient(LAWS["kuwabara"], 0.7, 0.5, 1.0, 0.0),
        lambda: drag_coefficient(LAWS["kuwabara"], 0.7, 0.5, 1.0, 1.0, -1.0),
        lambda: drag_coefficient(LAWS["kuwabara"], 0.7, 0.5, 1.0, 1.0, 1.0, np.nan),
        lambda: drag_coefficient(LAWS["microstructural"], 1.2, 0.5, 1.0, 1.0),
    ],
)
def test_refuses_bad_parameters(make):
    with pytest.raises(InputError):
        make()
