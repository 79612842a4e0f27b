"""Arrangements: exact lattices, hard discs in equilibrium, and files that are read or refused."""

from math import cos, pi, radians, sqrt, tan

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from grainmesh import arrange
from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.particles import Particles, close_pairs, settle

NAN = "nan"


def porosity_of(box, particles):
    return 1 - (pi / 4 * particles.diameter**2).sum() / box.area


def neighbours(box, particles, k):
    """Vectors to the k nearest neighbours, (n, k, 2), periodic box."""
    x = np.mod(particles.x, box.size)
    _, j = cKDTree(x, boxsize=box.size).query(x, k=k + 1)
    return box.separation(x[:, None], x[j[:, 1:]])


def equal_up_to_order(a, b, box):
    """Whether two sets of points on the torus are the same set."""
    tree = cKDTree(np.mod(a, box.size) % box.size, boxsize=box.size)
    distance, hit = tree.query(np.mod(b, box.size) % box.size)
    return len(a) == len(b) == len(set(hit)) and distance.max() < 1e-9 * box.width


# Lattices ------------------------------------------------------------------------------------


@given(st.integers(1, 9), st.integers(1, 5), st.floats(0.3, 0.99), st.floats(46, 62), st.booleans())
@settings(deadline=None)
def test_lattice_tile_is_exact(nx, half, porosity, angle, periodic):
    d, ny = 1e-3, 2 * half
    kind = {"porosity": porosity, "diameter": d}
    assert arrange.square(nx, ny, periodic=periodic, **kind)[0].periodic is periodic
    assert arrange.hexagonal(nx, ny, periodic=periodic, **kind)[0].periodic is periodic
    for box, particles in (
        arrange.square(nx, ny, periodic=periodic, **kind),
        arrange.hexagonal(nx, ny, **kind),
        arrange.staggered(nx, ny, angle=angle, **kind),
    ):
        assert len(particles) == nx * ny
        assert porosity_of(box, particles) == pytest.approx(porosity, abs=1e-14)
        # Half a pitch or a quarter from the edges, the same on both sides.
        assert (particles.x > 0).all()
        assert (particles.x < box.size).all()
        np.testing.assert_allclose(particles.x.mean(axis=0), 0.5 * box.size, rtol=1e-12)
        np.testing.assert_allclose(particles.x.min(0), box.size - particles.x.max(0), rtol=1e-9)


@pytest.mark.parametrize("porosity", [0.22, 0.5, 0.9])
def test_square_has_four_neighbours_at_the_pitch(porosity):
    distance = np.linalg.norm(
        neighbours(*arrange.square(5, 4, porosity=porosity, diameter=2.0), 5), axis=2
    )
    a = sqrt(pi / (1 - porosity))
    np.testing.assert_allclose(distance[:, :4], a, rtol=1e-12)
    np.testing.assert_allclose(distance[:, 4], sqrt(2) * a, rtol=1e-12)


@pytest.mark.parametrize("porosity", [0.0932, 0.5, 0.9])
def test_hexagonal_has_six_neighbours_60_degrees_apart(porosity):
    r = neighbours(*arrange.hexagonal(4, 6, porosity=porosity, diameter=2.0), 6)
    a = sqrt(pi / (1 - porosity) / (sqrt(3) / 2))
    np.testing.assert_allclose(np.linalg.norm(r, axis=2), a, rtol=1e-12)
    angles = np.sort(np.degrees(np.arctan2(r[..., 1], r[..., 0])) % 360 % 359.999999)
    np.testing.assert_allclose(angles, np.broadcast_to(np.arange(6) * 60, angles.shape), atol=1e-5)


@given(st.floats(15, 75), st.floats(0.7, 0.95))
@settings(deadline=None)
def test_staggered_bonds_have_the_angle(angle, porosity):
    box, particles = arrange.staggered(5, 8, angle=angle, porosity=porosity, diameter=1.0)
    lattice = particles.x.reshape(8, 5, 2)
    bond = lattice[1, 0] - lattice[0, 0]
    assert np.degrees(np.arctan2(bond[1], bond[0])) == pytest.approx(angle, rel=1e-12)
    a = lattice[0, 1, 0] - lattice[0, 0, 0]
    nearest = np.linalg.norm(neighbours(box, particles, 1), axis=2)
    t = radians(angle)
    np.testing.assert_allclose(nearest, min(a, 0.5 * a / cos(t), a * tan(t)), rtol=1e-11)


def test_staggered_by_45_degrees_is_the_turned_square():
    box, particles = arrange.staggered(4, 8, angle=45, porosity=0.5, diameter=1.0)
    _, straight = arrange.square(2, 1, porosity=0.5, diameter=1.0)
    r = neighbours(box, particles, 4)
    pitch = straight.x[1, 0] - straight.x[0, 0]
    np.testing.assert_allclose(np.linalg.norm(r, axis=2), pitch, rtol=1e-12)
    np.testing.assert_allclose(np.abs(r), pitch / sqrt(2), rtol=1e-12)


@pytest.mark.parametrize("make", [arrange.square, arrange.hexagonal])
def test_lattices_are_bravais(make):
    """Moving any disc onto any other maps the lattice onto itself."""
    box, particles = make(3, 4, porosity=0.6, diameter=1.0)
    for x in particles.x[1:]:
        assert equal_up_to_order(particles.x, particles.x + x - particles.x[0], box)
    assert not equal_up_to_order(particles.x, particles.x + np.array([0.1, 0.0]), box)


@pytest.mark.parametrize(
    ("make", "limit"),
    [
        (lambda **k: arrange.square(3, 2, **k), 1 - pi / 4),
        (lambda **k: arrange.hexagonal(3, 2, **k), 1 - pi / (2 * sqrt(3))),
        (lambda **k: arrange.staggered(3, 2, angle=45, **k), 1 - pi / 4),
        # Flat: rows two apart touch at 2h = a tan 20°.
        (lambda **k: arrange.staggered(3, 4, angle=20, **k), 1 - pi / 2 * tan(radians(20))),
        (lambda **k: arrange.staggered(3, 4, angle=75, **k), 1 - pi / 2 / tan(radians(75))),
    ],
)
def test_lattices_reach_contact_and_stop_there(make, limit):
    box, particles = make(porosity=limit, diameter=1.0)
    assert len(close_pairs(box, particles, 1e-9)) >= len(particles) // 2
    assert len(close_pairs(box, particles, -1e-9)) == 0
    with pytest.raises(InputError, match=f"below {limit:.4f}"):
        make(porosity=limit - 1e-6, diameter=1.0)


def test_lattice_arguments_are_checked():
    kind = {"porosity": 0.6, "diameter": 1.0}
    with pytest.raises(InputError, match="even ny"):
        arrange.hexagonal(3, 3, **kind)
    assert len(arrange.hexagonal(3, 3, periodic=False, **kind)[1]) == 3 + 4 + 3
    with pytest.raises(InputError, match="nx 0"):
        arrange.square(0, 3, **kind)
    with pytest.raises(InputError, match=r"ny 1\.5"):
        arrange.square(3, 1.5, **kind)
    with pytest.raises(InputError, match="angle 90"):
        arrange.staggered(3, 4, angle=90, **kind)
    for porosity in (0.0, 1.0, -1, 2, float(NAN)):
        with pytest.raises(InputError, match="between 0 and 1"):
            arrange.square(3, 3, porosity=porosity, diameter=1.0)
        with pytest.raises(InputError, match="between 0 and 1"):
            arrange.random(3, porosity=porosity, diameter=1.0)
    for diameter in (0.0, -1.0, float(NAN)):
        with pytest.raises(InputError, match="diameter"):
            arrange.square(3, 3, porosity=0.5, diameter=diameter)
        with pytest.raises(InputError, match="diameter"):
            arrange.random(3, porosity=0.5, diameter=diameter)


# Random discs --------------------------------------------------------------------------------


@given(
    n=st.integers(1, 60),
    solid=st.floats(0.01, 0.45),
    gap=st.floats(0, 0.15),
    spread=st.floats(0, 0.4),
    periodic=st.booleans(),
    aspect=st.floats(0.8, 1.3),
    seed=st.integers(0, 10**6),
)
@settings(deadline=None, max_examples=60)
def test_random_keeps_its_promises(n, solid, gap, spread, periodic, aspect, seed):
    solid = solid if n > 12 or periodic else 0.4 * solid  # walls leave few discs little room
    d = 1e-5 * (1 + spread * np.linspace(-1, 1, n)) if n > 1 else np.array([1e-5])
    box, particles = arrange.random(
        n, porosity=1 - solid, diameter=d, min_gap=gap, seed=seed, periodic=periodic, aspect=aspect
    )
    assert porosity_of(box, particles) == pytest.approx(1 - solid, abs=1e-13)
    assert box.width / box.height == pytest.approx(aspect, rel=1e-12)
    np.testing.assert_array_equal(particles.diameter, d)  # in the order given
    # Brute force over the images, not the tree that the generator itself uses.
    images = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)] if periodic else [(0, 0)]
    for image in images:
        r = particles.x[:, None] - particles.x - image * box.size
        room = np.hypot(r[..., 0], r[..., 1]) - 0.5 * (d[:, None] + d)
        if image == (0, 0):
            np.fill_diagonal(room, np.inf)
        assert room.min() >= gap * d.mean() * (1 - 1e-12) - 1e-21
    edge = np.minimum(particles.x, box.size - particles.x).min(axis=1)
    assert edge.min() >= 0
    if not periodic:
        assert (edge - 0.5 * d).min() >= 0.5 * gap * d.mean() * (1 - 1e-12) - 1e-21
    assert settle(box, particles).x.shape == (n, 2)


@pytest.mark.parametrize(("n", "periodic"), [(20, True), (500, True), (500, False), (3000, True)])
def test_random_reaches_porosity_a_quarter(n, periodic):
    """Solid fraction 0.75, beyond freezing at 0.70-0.72."""
    for seed in (1, 2):
        box, particles = arrange.random(
            n, porosity=0.25, diameter=1.0, seed=seed, periodic=periodic
        )
        assert porosity_of(box, particles) == pytest.approx(0.25, abs=1e-13)
        assert len(close_pairs(box, particles, 0.0)) == 0


def contact_value(box, particles):
    """Pair distribution at contact, from the pairs closer than 1.2 d, and the pairs' vectors."""
    n, d = len(particles), particles.mean_diameter
    tree = cKDTree(particles.x, boxsize=box.size)
    i, j = tree.query_pairs(1.2 * d, output_type="ndarray").T
    r = box.separation(particles.x[i], particles.x[j]) / d
    edges = np.linspace(1, 1.2, 21)
    count, _ = np.histogram(np.hypot(r[:, 0], r[:, 1]), edges)
    g = count / (0.5 * n * n / box.area * d**2 * pi * np.diff(edges**2))
    middle = 0.5 * (edges[1:] + edges[:-1]) - 1
    return np.exp(np.polyfit(middle, np.log(g), 1, w=np.sqrt(count))[-1]), r


@pytest.mark.parametrize("solid", [0.3, 0.4, 0.5])
def test_random_discs_are_the_hard_disc_fluid(solid):
    """Henderson's contact value g = (1 - 7 φ/16)/(1 - φ)²; isotropy, though chains run along x, y.

    D. Henderson, Mol. Phys. 30 (1975) 971; it is within 0.5 % of simulation here.
    """
    samples = [
        contact_value(*arrange.random(20000, porosity=1 - solid, diameter=1.0, seed=seed))
        for seed in (1, 2)
    ]
    # The spread of one sample is 2 % at φ = 0.3, less above.
    g = np.mean([g for g, _ in samples])
    assert g == pytest.approx((1 - 7 * solid / 16) / (1 - solid) ** 2, rel=0.035)
    r = np.concatenate([r for _, r in samples])
    theta = np.arctan2(r[:, 1], r[:, 0])
    for fold in (2, 4, 6):
        assert abs(np.exp(1j * fold * theta).mean()) < 4 / sqrt(len(r))


def test_min_gap_is_the_fluid_of_larger_discs():
    """Discs with a gap of 0.2 d and porosity 0.75 are hard discs of 1.2 d at 1 - 0.25 * 1.44."""
    box, particles = arrange.random(20000, porosity=0.75, diameter=1.0, min_gap=0.2, seed=3)
    g, _ = contact_value(box, particles.with_diameter(1.2))
    solid = 0.25 * 1.44
    assert g == pytest.approx((1 - 7 * solid / 16) / (1 - solid) ** 2, rel=0.06)


@pytest.mark.parametrize("porosity", [0.4, 0.6, 0.9])
def test_no_order_over_long_distances_remains(porosity):
    box, particles = arrange.random(4000, porosity=porosity, diameter=1.0, seed=5)
    r = neighbours(box, particles, 6)
    psi = np.exp(6j * np.arctan2(r[..., 1], r[..., 0])).mean(axis=1)
    assert abs(psi.mean()) < 0.06  # a crystal: near 1
    # A lattice of any pitch would show as a Bragg peak of S(k) ~ n along x or y.
    k = 2 * pi / box.width * np.arange(1, 200)
    for x in particles.x.T:
        assert (np.abs(np.exp(1j * np.outer(k, x)).sum(axis=1)) ** 2).max() / 4000 < 15


def test_two_discs_are_spread_evenly_over_what_is_allowed():
    """Their separation is uniform on the torus outside |r| < d."""
    apart = []
    for seed in range(500):
        box, particles = arrange.random(2, porosity=0.8, diameter=1.0, seed=seed)
        apart.append(np.linalg.norm(box.separation(*particles.x)))
    share = np.mean(np.array(apart) < 1.25)
    p = pi * (1.25**2 - 1) / (box.area - pi)
    assert share == pytest.approx(p, abs=4 * sqrt(p * (1 - p) / 500))


def test_one_disc_is_spread_evenly_between_walls():
    x = []
    for seed in range(500):
        box, particles = arrange.random(1, porosity=0.9, diameter=1.0, seed=seed, periodic=False)
        x.append(particles.x[0])
    free = (np.array(x) - 0.5) / (box.size - 1)  # uniform on the unit square
    np.testing.assert_allclose(free.mean(axis=0), 1 / 2, atol=4 * sqrt(1 / 12 / 500))
    np.testing.assert_allclose(free.var(axis=0), 1 / 12, atol=4 * sqrt(1 / 180 / 500))


def test_random_depends_on_the_seed_and_on_nothing_else():
    def make(seed, diameter=1.0):
        return arrange.random(50, porosity=0.5, diameter=diameter, seed=seed)[1].x

    np.testing.assert_array_equal(make(1), make(1))
    assert np.abs(make(1) - make(2)).max() > 0.1
    np.testing.assert_allclose(make(1, 3e-6), 3e-6 * make(1), rtol=1e-14)  # unit of length


def test_random_out_of_reach_is_refused():
    for kind in (
        {"n": 100, "porosity": 0.15},
        {"n": 100, "porosity": 0.4, "min_gap": 0.2},
        {"n": 3, "porosity": 0.25},  # jams
        {"n": 1, "porosity": 0.3, "aspect": 2.0},  # wider than the box
    ):
        with pytest.raises(InputError, match="out of reach for the generator"):
            arrange.random(diameter=1.0, **kind)
    with pytest.raises(InputError, match="min_gap"):
        arrange.random(3, porosity=0.5, diameter=1.0, min_gap=-0.1)
    with pytest.raises(InputError, match="aspect"):
        arrange.random(3, porosity=0.5, diameter=1.0, aspect=0)
    with pytest.raises(InputError, match="diameter needs one value or 3"):
        arrange.random(3, porosity=0.5, diameter=[1.0, 2.0])


# Files ---------------------------------------------------------------------------------------


@pytest.fixture
def write(tmp_path):
    def write(text, encoding="utf-8"):
        path = tmp_path / "discs.csv"
        path.write_bytes(text.encode(encoding))
        return path

    return write


EXPECTED = Particles([[1.0, 2.0], [4.0, 1.5], [2.5, -1.0]], [1.0, 2.0, 0.5])


@pytest.mark.parametrize(
    "text",
    [
        "x,y,d\n1,2,1\n4,1.5,2\n2.5,-1,.5\n",
        "X , Y, Diameter\n1,2,1\n4,1.5,2\n2.5,-1,.5",
        "# by hand\n\nid;R;y;x;note\n# more\n7;.5;2;1;a\n\n8;1;1.5;4;b\n9;0.25;-1;2.5;c # last\n",
        "y\tx\tradius\n2\t1\t0.5\n1.5\t4\t1\n   \n-1\t2.5\t2.5e-1\n",
        "  x  y   d\n 1 2 1\n4   1.5 2\n2.5 -1 0.5\n",
        '"x","y","label","r"\n"1",2,"a, b",.5\n4,1.5,"c",1\n2.5,-1,"d",.25\n',
        "x,y,d,r\r\n1,2,1,.5\r\n4,1.5,2,1\r\n2.5,-1,.5,.25\r\n",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_a_file_is_read_in_many_forms(write, text, encoding):
    box, particles = arrange.from_csv(write(text, encoding), width=9, height=9)
    assert (box.width, box.height, box.periodic) == (9, 9, False)
    np.testing.assert_array_equal(particles.x, EXPECTED.x)
    np.testing.assert_array_equal(particles.diameter, EXPECTED.diameter)


@given(
    st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 2, st.floats(1e-3, 1e3)), min_size=1, max_size=30),
    st.floats(1e-9, 1e3),
)
@settings(deadline=None)
def test_what_is_written_is_read_in_any_unit(tmp_path_factory, discs, unit):
    path = tmp_path_factory.mktemp("csv") / "discs.csv"
    path.write_text("x,y,d\n" + "".join(f"{x!r},{y!r},{d!r}\n" for x, y, d in discs))
    _, particles = arrange.from_csv(path, unit=unit, width=1, height=1)
    table = np.array(discs) * unit
    np.testing.assert_array_equal(particles.x, table[:, :2])
    np.testing.assert_array_equal(particles.diameter, table[:, 2])


def test_the_bounding_box_touches_the_discs(write):
    box, particles = arrange.from_csv(write("x,y,d\n1,2,1\n4,1.5,2\n2.5,-1,.5\n"), unit=1e-3)
    low = particles.x - particles.radius[:, None]
    high = particles.x + particles.radius[:, None]
    np.testing.assert_allclose(low.min(axis=0), 0, atol=1e-18)
    np.testing.assert_allclose(high.max(axis=0), box.size, rtol=1e-14)
    shift = particles.x - 1e-3 * EXPECTED.x
    np.testing.assert_allclose(shift, shift[[0, 0, 0]], atol=1e-18)


def test_a_given_diameter_replaces_the_column(write):
    for text in ("x,y\n1,2\n3,4\n", "x,y,d\n1,2,0\n3,4,7\n"):
        _, particles = arrange.from_csv(write(text), unit=1e-6, diameter=1e-6)
        np.testing.assert_array_equal(particles.diameter, 1e-6)  # in metres, not in the unit


def test_crop_keeps_what_counts_in_the_box(write):
    path = write("x,y,d\n5,5,1\n-.4,5,1\n-.6,5,1\n10.4,10.4,1\n10.3,10.3,1\n")
    box = {"width": 10, "height": 10}
    assert len(arrange.from_csv(path, **box)[1]) == 5
    _, cut = arrange.from_csv(path, crop=True, **box)
    np.testing.assert_array_equal(cut.x[:, 0], [5, -0.4, 10.3])  # touching, corner rounded
    settle(Box(**box), cut)
    _, inside = arrange.from_csv(path, crop=True, periodic=True, **box)
    np.testing.assert_array_equal(inside.x, [[5, 5]])


def test_a_window_is_a_crop_with_another_origin(write):
    rng = np.random.default_rng(0)
    x = rng.uniform(0, 10, (300, 2))
    path = write("x,y,d\n" + "".join(f"{a!r},{b!r},0.3\n" for a, b in x.tolist()))
    box, part = arrange.from_csv(path, window=(2, 3, 6, 5))
    assert (box.width, box.height) == (4, 2)
    shifted = write("x,y,d\n" + "".join(f"{a - 2!r},{b - 3!r},0.3\n" for a, b in x.tolist()))
    _, same = arrange.from_csv(shifted, width=4, height=2, crop=True)
    np.testing.assert_array_equal(part.x, same.x)
    assert 0 < len(part) < 300


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty file"),
        ("\n# only a comment\n\n", "empty file"),
        ("x,y,d\n", "no row after the header"),
        ("1,2,1\n4,1.5,2\n", "no header"),
        ("x,y\n1,2\n", "column d or r missing among: x, y; .*give a diameter"),
        ("x_px,y,r\n1,2,3\n", "column x missing among: x_px, y, r; rename"),
        ("a,b\n1,2\n", "column x and y and d or r missing among: a, b"),
        ("x,X,y,d\n1,1,2,3\n", "2 columns named x"),
        ("x,y,d\n1,2,1\n# c\n\n3,abc,1\n4,4,1\n", "row 5: no numbers for x, y, d in '3,abc,1'"),
        ("x,y,d\n1,2,1\n3,,1\n", "row 3: no numbers"),
        ("x,y,d\n1,2,1\n3,4\n", "row 3: no numbers"),
        ("x;y;d\n1,5;2;1\n", "row 2: no numbers"),
        ("x,y,d\n1,2,1\n3,nan,1\n", "row 3: a value is not finite"),
        ("x,y,d\n1,2,1\n3,inf,1\n", "row 3: a value is not finite"),
        ("\n\nx,y,d\n1,2,1\n3,4,0\n", "row 5: d must be positive"),
        ("x,y,r\n1,2,-1\n", "row 2: r must be positive"),
        ("x,y,d,r\n1,2,1,.5\n1,2,1,1\n", "row 3: d and r disagree"),
        ('x,y,d,note\n1,2,1,"a\nb"\n', "quoted text runs over several lines"),
    ],
)
def test_a_bad_file_is_refused_with_its_row(write, text, message):
    path = write(text)
    with pytest.raises(InputError, match=message) as error:
        arrange.from_csv(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


@given(st.integers(0, 999))
@settings(deadline=None, max_examples=20)
def test_the_bad_row_is_found_anywhere(tmp_path_factory, k):
    rows = [f"{i},{i},1" for i in range(1000)]
    rows[k] = "1,2,oops"
    path = tmp_path_factory.mktemp("csv") / "discs.csv"
    path.write_text("# c\nx,y,d\n" + "\n".join(rows))
    with pytest.raises(InputError, match=f"row {k + 3}: .*oops"):
        arrange.from_csv(path)


def test_files_that_are_none_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"none\.csv: No such file"):
        arrange.from_csv(tmp_path / "none.csv")
    with pytest.raises(InputError, match="directory"):
        arrange.from_csv(tmp_path)
    (tmp_path / "picture.csv").write_bytes(b"\x89PNG\xff\xfe\x00")
    with pytest.raises(InputError, match="not a text file"):
        arrange.from_csv(tmp_path / "picture.csv")


def test_arguments_of_from_csv_are_checked(write):
    path = write("x,y,d\n1,2,1\n3,4,1\n")
    for kind, message in (
        ({"unit": 0}, "unit 0"),
        ({"unit": float(NAN)}, "unit nan"),
        ({"diameter": -1}, "diameter -1"),
        ({"width": 1}, "both width and height"),
        ({"width": -1, "height": 1}, "box width"),
        ({"periodic": True}, "not a period"),
        ({"window": (0, 0, 1, 1), "width": 1, "height": 1}, "exclude each other"),
        ({"window": (0, 1, 1, 0)}, "x1 > x0"),
        ({"window": (7, 7, 8, 8)}, "no disc lies in the box"),
        ({"unit": 1e308}, "row 2: a value is not finite"),
    ):
        with pytest.raises(InputError, match=message):
            arrange.from_csv(path, **kind)


@pytest.mark.parametrize("angle", [45, 60])
def test_walls_halve_the_discs_of_every_other_row(angle):
    from grainmesh.cells import cells

    box, particles = arrange.staggered(
        3, 4, angle=angle, porosity=0.7, diameter=1.0, periodic=False
    )
    assert len(particles) == 3 + 4 + 3 + 4
    solid = cells(box, particles).solid
    assert solid.sum() == pytest.approx(0.3 * box.area, rel=1e-13)
    halved = (particles.x[:, 0] == 0.0) | (particles.x[:, 0] == box.width)
    np.testing.assert_allclose(solid, np.where(halved, 0.5, 1.0) * pi / 4, rtol=1e-13)


# Loose discs, to fall ------------------------------------------------------------------------


@given(
    st.integers(1, 200),
    st.floats(0.5, 3.0),
    st.floats(0.01, 1.0),
    st.integers(0, 1000),
    st.sampled_from(["one", "bounds", "each"]),
)
@settings(deadline=None)
def test_loose_discs_touch_neither_each_other_nor_the_walls(n, aspect, gap, seed, kind):
    d = {"one": 0.1, "bounds": (0.05, 0.1), "each": np.linspace(0.05, 0.1, n)}[kind]
    pitch = 0.1 * (1 + gap)
    columns = max(1, round(sqrt(aspect * n)))
    box = Box(columns * pitch * 1.001, -(-n // columns) * pitch * 1.001)
    particles = arrange.loose(box, n, diameter=d, gap=gap, seed=seed, density=1234.0)
    x, r = particles.x, particles.radius
    assert len(particles) == n
    assert (particles.density == 1234.0).all()
    assert len(close_pairs(box, particles, 0.0)) == 0
    assert (x > r[:, None]).all()
    assert (x < box.size - r[:, None]).all()
    if kind == "bounds" and n != 2:
        assert (2 * r >= 0.05).all()
        assert (2 * r <= 0.1).all()
        assert n < 20 or np.ptp(r) > 0.01
    else:
        np.testing.assert_array_equal(particles.diameter, np.broadcast_to(d, (n,)))
    again = arrange.loose(box, n, diameter=d, gap=gap, seed=seed)
    np.testing.assert_array_equal(again.x, x)
    other = arrange.loose(box, n, diameter=d, gap=gap, seed=seed + 1)
    assert (other.x != x).any()


def test_loose_discs_lie_low_row_upon_row():
    particles = arrange.loose(Box(1.0, 100.0), 20, diameter=0.1, gap=0.25)
    rows = particles.x[:, 1] / 0.125
    np.testing.assert_array_equal(np.floor(rows), np.repeat([0, 1, 2], 8)[:20])


def test_loose_discs_that_do_not_fit_are_refused_with_how_many_do():
    box = Box(1.0, 1.0)
    with pytest.raises(InputError, match="has room for 81") as error:
        arrange.loose(box, 82, diameter=0.1, gap=0.1)
    assert "\n" not in str(error.value)
    assert len(arrange.loose(box, 81, diameter=0.1, gap=0.1)) == 81
    with pytest.raises(InputError, match="has room for 0"):
        arrange.loose(box, 1, diameter=1.0, gap=0.1)
    for kind, message in (
        ({"n": 0}, "n 0"),
        ({"gap": 0.0}, "gap 0"),
        ({"diameter": -0.1}, "diameter -0.1"),
        ({"diameter": np.ones(3)}, "diameter needs one value or 5"),
        ({"diameter": (0.1, float(NAN))}, "diameter"),
        ({"diameter": (0.2, 0.1)}, "diameter 0.2 to 0.1 m"),
        ({"density": 0.0}, "density 0"),
    ):
        with pytest.raises(InputError, match=message):
            arrange.loose(box, **{"n": 5, "diameter": 0.1, **kind})
