"""Pictures: what is drawn is what was computed."""

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from xarray import Dataset

import grainmesh as gm
from grainmesh import canvas, plot


@pytest.fixture(autouse=True)
def _close():
    yield
    plt.close("all")


@pytest.fixture(scope="module", params=[True, False], ids=["periodic", "walls"])
def case(request):
    box, particles = gm.arrange.random(
        12, porosity=0.7, diameter=1e-5, min_gap=0.1, seed=3, periodic=request.param
    )
    results = [gm.permeability(box, particles, m, tol=2e-2) for m in ("resolved", "mesoscale")]
    return box, particles, results


def areas(corners):
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def test_sample_covers_the_fluid_and_carries_its_flux(case):
    box, _, (exact, coarse) = case
    for result, fluid in ((exact, exact.porosity), (coarse, 1.0)):
        points, triangles, velocity = plot.sample(result.detail)
        area = areas(points[triangles])
        assert (area > 0.0).all()
        assert area.sum() / box.area == pytest.approx(fluid, rel=2e-3)
        if result is exact:
            mean = (area[:, None] * velocity[triangles].mean(axis=1)).sum(axis=0) / box.area
            along = result.tensor[0, 0] / result.detail.scale**2
            assert mean[0] == pytest.approx(along, rel=5e-3)


def test_images_of_triangles_tile_a_periodic_box(case):
    """Of every triangle exactly one image has its middle in the box."""
    box, _, (exact, _) = case
    points, triangles, _ = plot.sample(exact.detail)
    middle = points[triangles].mean(axis=1)
    place, _, which = canvas.tiled(box, middle, np.full(len(middle), 0.3 * box.width))
    inside = ((place >= 0.0) & (place < box.size)).all(axis=1)
    np.testing.assert_array_equal(np.sort(which[inside]), np.arange(len(middle)))


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-3.0, 4.0)] * 2, st.floats(0.01, 1.5)), min_size=1, max_size=6)
)
def test_tiled_finds_every_image(discs):
    box = gm.Box(1.0, 2.0, periodic=True)
    table = np.array(discs)
    centre, reach = table[:, :2], table[:, 2]
    place, size, which = canvas.tiled(box, centre, reach)
    np.testing.assert_array_equal(size, reach[which])
    steps = np.arange(-9, 10)
    for i in range(len(table)):
        x, y = (centre[i, k] + steps * box.size[k] for k in (0, 1))
        near = [(v > -reach[i]) & (v < box.size[k] + reach[i]) for k, v in enumerate((x, y))]
        assert (which == i).sum() == near[0].sum() * near[1].sum()
    np.testing.assert_allclose(
        np.mod((place - centre[which]) / box.size + 0.5, 1.0), 0.5, atol=1e-9
    )


def test_axes_are_returned_and_end_at_the_box(case):
    box, particles, (exact, coarse) = case
    draw = [
        lambda ax: plot.discs(box, particles, ax),
        lambda ax: plot.mesh(gm.triangulate(box, particles), ax),
        lambda ax: plot.speed(box, exact.detail, 1, ax),
        lambda ax: plot.speed(box, coarse.detail, 0, ax, colorbar=False),
    ]
    for function in draw:
        _, mine = plt.subplots()
        assert function(mine) is mine
        new = function(None)
        assert new is not mine
        for ax in (mine, new):
            assert (ax.get_xlim(), ax.get_ylim()) == ((0.0, box.width), (0.0, box.height))
            assert ax.get_aspect() == 1.0


def test_every_edge_and_wall_node_is_drawn():
    box, particles = gm.arrange.random(20, porosity=0.7, diameter=1.0, periodic=False)
    mesh = gm.triangulate(box, particles)
    ax = plot.mesh(mesh)
    lines, dots, squares = ax.collections
    drawn = np.array(lines.get_segments())
    length = np.sort(np.hypot(*(drawn[:, 1] - drawn[:, 0]).T))
    np.testing.assert_allclose(length, np.sort(mesh.edge_lengths))
    np.testing.assert_array_equal(dots.get_offsets(), mesh.points[: mesh.n])
    np.testing.assert_array_equal(squares.get_offsets(), mesh.points[mesh.n :])


def test_speed_is_over_the_mean(case):
    """The colours do not depend on the unit of length or the size of the flow."""
    box, particles, (exact, _) = case
    unit = 2.0**17  # exact in floating point, so the mesh is the same too
    large = gm.Box(unit * box.width, unit * box.height, box.periodic)
    other = gm.Particles(unit * particles.x, unit * particles.diameter)
    again = gm.permeability(large, other, "resolved", tol=2e-2).detail
    top = [
        plot.speed(b, flow).collections[-1].get_clim()[1]
        for b, flow in ((box, exact.detail), (large, again))
    ]
    assert top[0] == pytest.approx(top[1], rel=1e-2)
    assert top[0] > 1.0


def test_bars(case):
    _, _, results = case
    ax = plot.bars(results)
    heights = [bar.get_height() for bar in ax.patches]
    np.testing.assert_allclose(heights, [r.normalised for r in results])
    assert [t.get_text() for t in ax.get_xticklabels()] == ["resolved", "mesoscale"]


def test_overview_is_a_small_file(case, tmp_path):
    box, particles, results = case
    for some in (results, results[:1], results[1:]):
        figure = plot.overview(box, particles, some)
        titles = [ax.get_title() for ax in figure.axes]
        assert any("mesh" in t for t in titles) == ("mesoscale" in [r.method for r in some])
        assert any("speed" in t for t in titles) == ("resolved" in [r.method for r in some])
        plot.save(figure, tmp_path / "x.png")
        assert not plt.fignum_exists(figure.number)
        assert 5_000 < (tmp_path / "x.png").stat().st_size < 300_000


@pytest.fixture(scope="module", params=[True, False], ids=["periodic", "walls"])
def moving(request):
    box, grains = gm.arrange.random(20, porosity=0.7, diameter=1e-3, seed=3, periodic=request.param)
    grains = gm.Particles(grains.x, grains.diameter, 2500.0)  # or all would move as one
    fluid = gm.Fluid(1000.0, 0.1, gm.drag.Permeability(), push=(5.0, 0.0))
    model = gm.Model(box, gm.Contact(stiffness=1e3), fluid=fluid)
    return gm.Simulation(model, grains).run(until=0.01)


@pytest.mark.parametrize("show", ["speed", "pressure", "porosity"])
def test_motion_draws_the_flow_once_all_over_the_box(moving, show):
    box = moving.model.box
    _, mine = plt.subplots()
    assert plot.motion(moving, mine, show=show, edges=True, colorbar=True) is mine
    assert (mine.get_xlim(), mine.get_ylim()) == ((0.0, box.width), (0.0, box.height))
    colours = mine.collections[0]
    corners, value = colours._triangulation, colours.get_array()
    points = np.column_stack([corners.x, corners.y])
    area = areas(points[corners.triangles])
    middle = points[corners.triangles].mean(axis=1)
    own = ((middle >= 0.0) & (middle < box.size)).all(axis=1)
    assert area[own].sum() / box.area == pytest.approx(1.0, rel=0.02 if box.periodic else 1e-9)
    tenth = 0.1 * np.ptp(value)  # linear within each part
    some = np.flatnonzero(own)[::40]
    u, p, eps = moving.flow.at(points[corners.triangles[some]].mean(axis=1))
    exact = {"speed": np.hypot(*u.T), "pressure": p, "porosity": eps}[show]
    mean = np.asarray(value)[corners.triangles[some]].mean(axis=1)
    assert mean == pytest.approx(exact, abs=tenth)
    assert len(some) > 20
    mean = (area[own] * value[corners.triangles[own]].mean(axis=1)).sum() / box.area
    if show == "porosity":  # all of the solid, wherever the discs are spread
        solid = 0.25 * np.pi * (moving.particles.diameter**2).sum() / box.area
        assert mean == pytest.approx(1.0 - solid, rel=0.02)
    flow = moving.flow.sample(2)
    whole = np.hypot(*flow.velocity.T) if show == "speed" else getattr(flow, show)
    assert whole.min() - 0.1 * np.ptp(whole) <= value.min()
    assert value.max() <= whole.max() + 0.1 * np.ptp(whole)


def test_discs_are_coloured_by_values_each_image_by_its_own():
    box = gm.Box(1.0, 1.0, periodic=True)
    discs = gm.Particles([[0.05, 0.5], [0.5, 0.5]], 0.2)
    shown = plot.discs(box, discs, colour=[3.0, 7.0], label="speed [m/s]").collections[0]
    place, value = shown.get_offsets(), shown.get_array()
    assert sorted(value) == [3.0, 3.0, 7.0]
    np.testing.assert_allclose(place[value == 7.0], [[0.5, 0.5]])
    np.testing.assert_allclose(np.sort(place[value == 3.0][:, 0]), [0.05, 1.05])
    assert len(shown.figure.axes) == 2


def test_histories_name_their_unit_and_leave_out_what_is_not_there():
    rows = {"kinetic": ("t", [1.0, 2.0], {"units": "J m-1"}), "height": ("t", [3.0, 4.0])}
    table = Dataset(rows, coords={"t": [0.0, 0.5]})
    ax = plot.histories(table, "kinetic", "rotational")
    assert ax.get_ylabel() == "kinetic [J/m]"
    np.testing.assert_array_equal(ax.lines[0].get_xydata(), [[0.0, 1.0], [0.5, 2.0]])
    assert len(ax.lines) == 1
    both = plot.histories(table, "kinetic", "height", ax=ax)
    assert both is ax
    assert [text.get_text() for text in ax.get_legend().get_texts()][-2:] == ["kinetic", "height"]


def test_motion_needs_a_fluid_and_knows_what_to_show(moving):
    dry = gm.Simulation(
        gm.Model(gm.Box(1.0, 1.0), gm.Contact(1e4)), gm.Particles([[0.5, 0.5]], 0.1)
    )
    with pytest.raises(gm.InputError, match="use plot"):
        plot.motion(dry)
    with pytest.raises(gm.InputError, match="speed, pressure, porosity"):
        plot.motion(moving, show="heat")


def test_film(moving, tmp_path, monkeypatch):
    with pytest.raises(gm.InputError, match="no frames"):
        plot.Film().save(tmp_path / "x")
    with pytest.raises(gm.InputError, match="no frames"):
        plot.Film().strip(tmp_path / "x.png")
    film = plot.Film()
    film(moving)
    shades = film.frames[0].size
    film.frames += [Image.new("RGB", shades, c) for c in ("red", "green", "blue")]
    assert shades[0] % 2 == shades[1] % 2 == 0
    with Image.open(film.strip(str(tmp_path / "x.png"), count=2)) as strip:
        assert strip.size == (2 * shades[0], shades[1])
        # The first and the last.
        right = strip.convert("RGB").getpixel((strip.width - 1, 0))
    assert right[2] > 200 > 50 > right[0]
    monkeypatch.setattr(plot, "installed", lambda name: None)
    written = film.save(str(tmp_path / "x.y"))
    assert written.suffix == ".gif"
    with Image.open(written) as gif:
        assert (gif.n_frames, gif.size) == (4, shades)


def test_film_with_an_encoder(tmp_path, monkeypatch):
    """A program in place of ffmpeg that keeps what it is given; then one that fails."""
    encoder = tmp_path / "ffmpeg"
    encoder.write_text('#!/bin/sh\nfor last; do :; done\ncat > "$last"\n')
    encoder.chmod(0o755)
    monkeypatch.setattr(plot, "installed", lambda name: str(encoder))
    colours = ("red", "blue")
    film = plot.Film(frames=[Image.new("RGB", (4, 2), c) for c in colours])
    written = film.save(tmp_path / "x")
    assert written.name == "x.mp4"
    assert written.read_bytes() == b"\xff\0\0" * 8 + b"\0\0\xff" * 8
    encoder.write_text("#!/bin/sh\ncat > /dev/null\necho 'no room' >&2\nexit 1\n")
    with pytest.raises(gm.InputError, match="no room"):
        film.save(tmp_path / "x")
