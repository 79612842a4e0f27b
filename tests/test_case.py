"""Case files: every mistake in one line, and what a case becomes."""

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import grainmesh as gm
from grainmesh import case, cli
from grainmesh.errors import InputError
from grainmesh.stream import Stream
from grainmesh.units import EXAMPLES, si

FOLDER = Path(case.__file__).parent / "data" / "starters"
STARTERS = {path.stem: path.read_text() for path in sorted(FOLDER.glob("*.toml"))}
#: Eight grains in water, started in a moment.
SMALL = """
[box]
size = ["8 mm", "8 mm"]
[particles]
arrange = "loose"
number = 8
diameter = "1 mm"
[contact]
stiffness = 1e4
[fluid]
density = 1000
viscosity = "1 cP"
order = 1
[run]
until = "10 ms"
"""


def refused(text, *changes):
    with pytest.raises(InputError) as fault:
        case.parse(text, "c.toml", changes)
    said = str(fault.value)
    assert "\n" not in said
    assert len(said) < 250
    return said


# --- units ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("2 mm", "m", 2e-3),
        ("1e-3 m", "m", 1e-3),
        ("20 um", "m", 20e-6),
        ("20µm", "m", 20e-6),
        ("1.2 g/cm3", "kg/m3", 1200.0),
        ("1 cP", "Pa s", 1e-3),
        ("1 mPa s", "Pa s", 1e-3),
        ("1 mPa*s", "Pa s", 1e-3),
        ("5 cm/s", "m/s", 0.05),
        ("9.81 m s^-2", "m/s2", 9.81),
        ("9.81 m/s/s", "m/s2", 9.81),
        ("9.81 m/s²", "m/s2", 9.81),
        ("20 kPa", "N/m2", 2e4),
        ("1 bar", "Pa", 1e5),
        ("60 rpm", "1/s", 2.0 * np.pi),
        ("5 min", "s", 300.0),
        ("-3 %", "1", -0.03),
        (".5", "1", 0.5),
        (7, "m", 7.0),
        (0.1, "kg/m3", 0.1),
    ],
)
def test_quantities_to_the_last_bit(text, unit, value):
    assert si(text, unit) == value


@given(st.floats(1e-20, 1e20), st.sampled_from(["um", "mm", "cm", "m", "km", "in"]))
def test_lengths_by_prefix(x, name):
    scale = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "km": 1e3, "in": 0.0254}[name]
    assert si(f"{x!r} {name}", "m") == pytest.approx(x * scale, rel=1e-15, abs=1e-300)


@pytest.mark.parametrize("unit", EXAMPLES)
def test_examples_of_messages_are_right(unit):
    example = EXAMPLES[unit].strip('"')
    assert np.isfinite(si(float(example) if unit == "1" else example, unit))
    with pytest.raises(InputError, match=re.escape(EXAMPLES[unit])):
        si("3 kg m9", unit)


@pytest.mark.parametrize(
    "value",
    ["2", "2 foo", "mm", "", "nan m", "inf m", "1e400 m", "1 m^^", True, None, [1], 10**400],
)
def test_what_is_no_length(value):
    with pytest.raises(InputError, match="2 mm"):
        si(value, "m")


# --- mistakes -------------------------------------------------------------------------------------


def keys_of(text):
    """Every key in the text, sections too: where it begins and ends, and its last word."""
    bare = re.sub(r"#.*", lambda m: " " * len(m.group()), text)
    for match in re.finditer(r"(?m)^\[?([\w.]+)(?= *=|\])|[{,] *(\w+)(?= *=)", bare):
        start, end = match.span(1) if match.group(1) else match.span(2)
        start += text[start:end].rfind(".") + 1
        yield start, end, text[start:end]


def misspelt(word):
    """Two letters changed about."""
    swapped = next(i for i in range(len(word) - 1, 0, -1) if word[i] != word[i - 1])
    return word[: swapped - 1] + word[swapped] + word[swapped - 1] + word[swapped + 1 :]


@pytest.mark.parametrize("name", STARTERS)
def test_a_typo_in_every_key_of_every_starter(name, tmp_path, capsys):
    text, path = STARTERS[name], tmp_path / "typo.toml"
    keys = list(keys_of(text))
    data = tomllib.loads(text)
    assert len(keys) >= sum(1 + len(v) if isinstance(v, dict) else 1 for v in data.values())
    for start, end, word in keys:
        wrong = misspelt(word)
        path.write_text(text[:start] + wrong + text[end:])
        status = cli.main(["check", str(path)])
        said = capsys.readouterr().err
        assert status == 2
        assert said.count("\n") == 1
        assert said.startswith(f"error: {path}: ")
        assert f"{wrong}: unknown key, did you mean {word}?" in said


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("particles.density='2 mm'", 'particles.density: \'2 mm\' is of the wrong kind: expected'),
        ("particles.diameter=true", "particles.diameter: True is no quantity"),
        ("particles.diameter=[1e-3,2e-3,3e-3]", "particles.diameter: expected one diameter"),
        ("fluid.spacing=['1 mm','2 mm',3]", "fluid.spacing: expected one distance, or two"),
        ("fluid.spacing=['2 mm','1 mm']", "fluid.spacing: the first must not be above the second"),
        ("particles.diameter=-1e-3", "particles.diameter: -0.001 must be positive"),
        ("particles.number=1.5", "particles.number: 1.5 must be a whole number"),
        ("particles.number=0", "particles.number: 0 must be greater than or equal to 1"),
        ("particles.arrange=lose", "particles.arrange: 'lose' unknown, did you mean 'loose'?"),
        ("particles.region=[1,1,0,0]", "region must be x0, y0, x1, y1"),
        ("box.size=[1]", "box.size: has too few values"),
        ("box.size=3", "box.size: 3 must be a list"),
        ("box.periodic=yes", "box.periodic: 'yes' must be true or false"),
        ("box=3", "box: 3 must be a table of keys"),
        ("contact.restitution=1.5", "contact.restitution: 1.5 must be less than or equal to 1"),
        ("contact.damping=2", "contact: give restitution or damping, not both"),
        ("contact.stiffness='2 N'", "contact.stiffness: '2 N' is of the wrong kind"),
        ("fluid.viscosity=-1", "fluid.viscosity: -1 must be greater than 0"),
        ("fluid.viscosity='1 cB'", "fluid.viscosity: unit 'cB' unknown: expected"),
        ("fluid.viscosity=nan", "fluid.viscosity: nan is not finite"),
        ("fluid.drag=stoke", "fluid.drag: drag law 'stoke' unknown, did you mean 'stokes'?"),
        ("fluid.drag=stokes", "fluid: drag law stokes takes depth"),
        ("fluid.scheme=bdf", "fluid.scheme: 'bdf' unknown, did you mean 'bdf2'?"),
        ("fluid.sides.top=outlett", "fluid.sides.top.kind: 'outlett' unknown, did you mean"),
        ("fluid.sides.top={kind='inflow'}", "fluid.sides.top.velocity: missing"),
        (
            "fluid.sides.top={kind='inflow',velocity=[0,1],ramp=[[1,0],[0,1]]}",
            "the times of the ramp must ascend",
        ),
        ("walls.open=['up']", "did you mean"),
        ("run.until=0", "run.until: 0 must be greater than 0"),
        ("run.every='1 ns'", "every = 1e-09 s makes over"),
        ("start.velocity=[1]", "start.velocity: has too few values"),
        ("permeability.tol=1e-3", "a case needs a section [run] or [permeability]"),
        ("fixed={arrange='file',file='x',unit='1 kg'}", "fixed.unit: '1 kg' is of the wrong kind"),
        ("fixed={arrange='file',file=3}", "fixed.file: 3 must be text"),
        ("fixed={arrange='places',places=[[0,0]],diameter=-1}", "fixed.diameter: -1 must be"),
        ("fluid.viscosity", "must be section.key=value"),
        ("title=\udcff", "must be section.key=value"),
        ("run.until.x=3", "run.until is no section"),
    ],
)  # fmt: skip
def test_wrong_values_are_named(change, said):
    extra = ("contact.restitution=0.5",) if "damping" in change else ()
    assert said in refused(SMALL, *extra, change)


def test_missing_and_superfluous_parts():
    assert "particles: missing" in refused("[run]\nuntil = 1\n")
    assert "particles.arrange: missing" in refused("[particles]\nnumber=1\n")
    assert "contact: missing" in refused(re.sub(r"\[contact\]\n.*\n", "", SMALL))
    assert "particles.number: missing; How many" in refused(SMALL.replace("number = 8", ""))
    text = STARTERS["permeability"] + "\n[fluid]\ndensity=1\nviscosity=1\n"
    assert "fluid: has no meaning with [permeability]" in refused(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = \n", "line 1, column 5"),
        ("[run]\n[run]\n", "line 2"),
        ("a = " + "[" * 5000, "nested too deep"),
        ("a = " + "9" * 5000, "not valid TOML"),
    ],
)
def test_what_is_no_toml(text, said):
    assert said in refused(text)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        case.read(tmp_path / "none.toml")
    with pytest.raises(InputError, match="no such file"):
        case.read(tmp_path)
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="UTF-8"):
        case.read(tmp_path / "b.toml")
    listed = SMALL.replace('"loose"\nnumber = 8', '"file"\nfile = "none.csv"')
    with pytest.raises(InputError, match=r"c.toml: particles: file: there is no file .*none.csv"):
        case.parse(listed, "c.toml").arrangement()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("fluid.spacing=2", "fluid.spacing: 2 m is far more than the box, 0.008 m x 0.008 m"),
        ("contact.stiffness=1e28", "would take years: lower contact.stiffness"),
        (
            "walls.open=['top']",
            'the fluid can, say fluid.sides = { top = "outlet" }',
        ),
    ],
)
def test_what_cannot_be_begun(change, said):
    with pytest.raises(InputError, match=re.escape(said)):
        case.parse(SMALL, "c.toml", [change]).simulation()


# --- text and changes -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", STARTERS)
def test_the_text_of_a_case_is_the_case(name):
    found = case.parse(STARTERS[name])
    assert found.text == STARTERS[name]
    changed = case.parse(STARTERS[name], "c.toml", ["title=again", "particles.density='2 g/cm3'"])
    assert changed.particles.density == 2000.0
    assert case.parse(changed.text).model_dump() == changed.model_dump()
    assert changed.model_dump() != found.model_dump()
    assert changed.text.count("#") == STARTERS[name].count("#")


def test_changes_make_sections_and_take_bare_words():
    changes = ["fluid.sides.top=outlet", "walls.left.friction=0", "run.until=1 s", "gravity=[0,0]"]
    found = case.parse(SMALL, "c.toml", changes)
    assert found.fluid.sides.top.kind == "outlet"
    assert found.walls.left.friction == 0.0
    assert found.run.until == 1.0
    assert found.gravity == (0.0, 0.0)
    assert case.parse(found.text).model_dump() == found.model_dump()


def test_a_change_cannot_bring_in_other_keys():
    assert "run.until" in refused(SMALL, "run.until=1\nevery=2")


# --- what a case becomes --------------------------------------------------------------------------


def test_small_case_is_what_python_says():
    found = case.parse(SMALL).simulation()
    box = gm.Box(8e-3, 8e-3)
    grains = gm.arrange.loose(box, 8, diameter=1e-3, density=2500)
    fluid = gm.Fluid(1000, 1e-3, order=1)
    own = gm.Simulation(gm.Model(box, gm.Contact(stiffness=1e4), fluid=fluid), grains)
    assert found.model == own.model
    found.run(1e-3)
    own.run(1e-3)
    assert (found.x == own.x).all()


@pytest.mark.parametrize(
    ("section", "n"),
    [
        ('arrange="random"\nnumber=9\ndiameter=["0.8 mm","1.1 mm"]', 9),
        ('arrange="random"\nporosity=0.7\ndiameter="1 mm"', 24),
        ('arrange="random"\nnumber=5\ndiameter=1e-3\nregion=[0,0,"4 mm","4 mm"]', 5),
        ('arrange="square"\ncolumns=3\nrows=2\nporosity=0.6\ndiameter=1e-3\ncorner=[1e-3,2e-3]', 6),
        ('arrange="hexagonal"\ncolumns=3\nrows=1\nporosity=0.6\ndiameter=1e-3', 3),
        ('arrange="places"\nplaces=[["1 mm",2e-3],[3e-3,2e-3]]\ndiameter=1e-3', 2),
        ('arrange="file"\nfile="grains.csv"\nunit="1 mm"', 3),
    ],
)
def test_arrangements(section, n, tmp_path):
    (tmp_path / "grains.csv").write_text("x,y,d\n1,1,1\n3,1,1\n2,3,1.5\n")
    text = re.sub(r"(?s)\[particles\].*\[contact\]", f"[particles]\n{section}\n[contact]", SMALL)
    (tmp_path / "c.toml").write_text(text)
    found = case.read(tmp_path / "c.toml")
    box, particles, held = found.arrangement()
    assert (box, held) == (gm.Box(8e-3, 8e-3), 0)
    assert len(particles) == n
    assert (particles.density == 2500.0).all()
    assert (particles.x > 0.0).all()
    assert (particles.x < 8e-3).all()
    if found.files:
        assert found.files == (tmp_path / "grains.csv",)
        assert particles.x[2] == pytest.approx([2e-3, 3e-3])
    if "region" in section:
        assert (particles.x + 0.5e-3 <= 4e-3 * (1 + 1e-9)).all()
    if "porosity=0.7" in section:
        assert n * np.pi / 4.0 * 1e-6 / box.area == pytest.approx(0.3, rel=0.03)
    if "corner" in section:
        pitch = 1e-3 * np.sqrt(np.pi / 4.0 / 0.4)
        assert particles.x[0] == pytest.approx([1e-3 + pitch / 2, 2e-3 + pitch / 2])


@pytest.mark.parametrize("lattice", ["square", "hexagonal"])
def test_a_lattice_brings_its_box(lattice):
    text = f"""
    box.periodic = true
    particles = {{arrange="{lattice}", columns=4, rows=2, porosity=0.5, diameter=1e-3}}
    permeability.method = ["microstructure"]
    """
    box, particles, _ = case.parse(text).arrangement()
    same, other = getattr(gm.arrange, lattice)(4, 2, porosity=0.5, diameter=1e-3)
    assert box == same
    assert (particles.x == other.x).all()


def test_fixed_particles_and_a_start():
    found = case.parse(
        SMALL,
        "c.toml",
        [
            "fixed={arrange='places',places=[['4 mm','6 mm']],diameter='2 mm'}",
            "start.velocity=['1 cm/s',0]",
            "start.spin=2",
        ],
    ).simulation()
    assert found.fixed.tolist() == [False] * 8 + [True]
    assert found.velocity[:-1] == pytest.approx(np.tile([0.01, 0.0], (8, 1)), abs=1e-4)
    assert (found.velocity[-1] == 0.0).all()


def test_grains_in_fixed_ones_are_named_by_their_sections():
    fixed = "fixed={arrange='places',places=[[1e-3,7e-3],[1e-3,1e-3]],diameter='1 mm'}"
    for more in ("title=''", "start.settle='1 ms'"):
        with pytest.raises(
            InputError, match=r"\[particles\] 0 and \[fixed\] 1 overlap.*start.relax"
        ):
            case.parse(SMALL, "c.toml", [fixed, more]).simulation()
    with pytest.raises(InputError, match="reduce number, "):
        case.parse(SMALL, "c.toml", ["particles.number=500"]).simulation()


def test_one_method_needs_no_list():
    text = STARTERS["permeability"]
    one = case.parse(text, "c.toml", ["permeability.method=resolved"])
    assert one.permeability.method == ["resolved"]
    assert "did you mean 'resolved'?" in refused(text, "permeability.method=resolve")
    assert "--until, is for [run]" in refused(text, "run.until=3")


def test_settled_and_relaxed_at_the_start():
    loose = case.parse(SMALL).simulation()
    settled = case.parse(SMALL, "c.toml", ["start.settle='0.3 s'"]).simulation()
    assert len(loose.wall_contacts) == 0
    assert len(settled.wall_contacts) >= 7
    assert settled.t == 0.0
    assert settled.measure()["kinetic"] < 1e-9
    two = "particles={arrange='places',places=[[4e-3,4e-3],[4.5e-3,4e-3]],diameter=1e-3}"
    with pytest.raises(InputError, match=r"c.toml: particles 0 and 1 overlap"):
        case.parse(SMALL, "c.toml", [two]).simulation()
    apart = case.parse(SMALL, "c.toml", [two, "start.relax=true"]).simulation()
    assert np.hypot(*(apart.x[1] - apart.x[0])) > 0.99e-3
    with pytest.raises(InputError, match=r"start.settle: takes .* steps"):
        case.parse(SMALL, "c.toml", ["start.settle=1e9"]).simulation()


def test_walls_of_a_case():
    found = case.parse(
        SMALL.replace('[fluid]\ndensity = 1000\nviscosity = "1 cP"\norder = 1\n', ""),
        "c.toml",
        [
            "walls.bottom={friction=0.1,amplitude=[0,1e-5],frequency='50 Hz'}",
            "walls.segments=[{start=[1e-3,5e-3],end=[2e-3,5e-3]}]",
            "walls.open=['top']",
            "walls.escape='remove'",
        ],
    ).model(gm.Box(8e-3, 8e-3))
    assert found.open == ("top",)
    assert found.escape == "remove"
    floor, segment = found.walls
    assert (floor.side, floor.friction, floor.frequency) == ("bottom", 0.1, 50.0)
    assert segment.end == (2e-3, 5e-3)


def test_a_stream_has_its_mean_and_its_ramp():
    stream = Stream((0.0, 0.2), 0, 0.5, True, ((0.0, 0.0), (2.0, 1.0)))
    x, weight = np.polynomial.legendre.leggauss(4)
    places = np.stack([0.25 + 0.25 * x, np.zeros(4)], axis=1)
    for time, factor in ((0.0, 0.0), (1.0, 0.5), (2.0, 1.0), (9.0, 1.0)):
        assert 0.5 * weight @ stream(places, time) == pytest.approx([0.0, 0.2 * factor])
    assert (stream(np.array([[0.0, 0.0], [0.5, 0.0]]), 5.0) == 0.0).all()


def test_a_ramped_inflow_survives_a_checkpoint(tmp_path):
    inflow = "{kind='inflow',velocity=[0,'1 cm/s'],profile='parabolic',ramp=[[0,0],['5 ms',1]]}"
    changes = [f"fluid.sides.bottom={inflow}", "fluid.sides.top=outlet"]
    found = case.parse(SMALL, "c.toml", changes)
    whole = found.simulation().run(4e-3, every=2e-3)
    found.simulation().run(2e-3, every=2e-3, save=tmp_path)
    again = found.resume(tmp_path).run(4e-3, every=2e-3)
    assert (again.x == whole.x).all()
    assert again.history == whole.history
    assert whole.measure()["pressure bottom"] != 0.0
    steady = case.parse(SMALL)
    steady.simulation().run(2e-3, save=tmp_path / "steady")
    assert steady.resume(tmp_path / "steady").step > 0


# --- starters -------------------------------------------------------------------------------------


def test_starters_of_the_command_line_are_there(tmp_path, capsys):
    assert sorted(cli.STARTERS) == sorted(STARTERS)
    for name in STARTERS:
        path = tmp_path / f"{name}.toml"
        assert cli.main(["new", str(tmp_path / name), "--starter", name]) == 0
        assert path.read_text() == STARTERS[name]
        assert cli.main(["new", str(path), "--starter", name]) == 2
        assert "is there already" in capsys.readouterr().err
    assert cli.main(["new", str(tmp_path / "x"), "--starter", "setling"]) == 2
    assert "did you mean settling?" in capsys.readouterr().err
    for name in ("", ".", ".toml", f"{tmp_path}/"):
        assert cli.main(["new", name]) == 2
        assert "must be that of a file" in capsys.readouterr().err
    assert len(list(tmp_path.iterdir())) == len(STARTERS)


def test_a_fluidised_bed_is_some_thirty_lines():
    lines = [re.sub("#.*", "", line).strip() for line in STARTERS["fluidised-bed"].splitlines()]
    assert len([line for line in lines if line]) <= 35


@pytest.mark.parametrize("name", [name for name in STARTERS if name != "permeability"])
def test_starters_run(name):
    simulation = case.parse(STARTERS[name]).simulation()
    simulation.run(simulation.dt * 300)
    row = simulation.measure()
    assert row["step"] == 300
    assert np.isfinite(list(row.values())).all()


def test_the_starter_of_permeability_is_solved():
    found = case.parse(
        STARTERS["permeability"], "c.toml", ["particles.number=20", "particles.seed=2"]
    )
    with pytest.raises(InputError, match=r"no section \[run\]"):
        found.simulation()
    told = []
    results = found.solve(told.append)
    assert [r.method for r in results] == list(found.permeability.method)
    assert results[1].normalised == pytest.approx(results[0].normalised, rel=0.5)
    assert any(text.startswith("resolved: ") for text in told)


def test_the_schema_tells_every_key(capsys):
    assert cli.main(["schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    parts = [schema, *schema["$defs"].values()]
    for part in parts:
        for key, about in part.get("properties", {}).items():
            assert key in ("arrange", "kind") or {"description", "$ref"} & set(about), key
        assert part.get("additionalProperties", False) is False
    names = schema["$defs"]["FluidSection"]["properties"]["drag"]["enum"]
    assert set(names) == set(gm.drag.DRAGS)


def test_the_page_on_cases_names_every_key_and_its_example_runs():
    page = (Path(__file__).parents[1] / "docs" / "cases.md").read_text()
    told = {word for code in re.findall(r"`([\w.]+)`", page) for word in code.split(".")}
    for part in [case.schema(), *case.schema()["$defs"].values()]:
        assert set(part.get("properties", {})) <= told
    example = re.search(r"```toml\n(.*?)```", page, re.S).group(1)
    assert case.parse(example).fluid.drag == "hexagonal-lattice"
    for unit in re.findall(r'`"([\d.]+ [^"]*)"`', page.split("**Quantities.**")[1].split("**")[0]):
        assert any(_is(unit, kind) for kind in EXAMPLES), unit


def _is(text, unit):
    try:
        return si(text, unit) > 0.0
    except InputError:
        return False
