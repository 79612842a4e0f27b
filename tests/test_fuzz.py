"""Case files and lists of particles full of mistakes: refused in one line, or checked, never more.

Nothing that stands in them is executed, and nothing takes long.
"""

import time
from copy import deepcopy
from math import inf, nan
from pathlib import Path

import pytest
import tomlkit
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from grainmesh import cli
from test_case import SMALL, STARTERS

#: Longest that a check may take [s].
LONGEST = 30.0
GRAINS = "x,y,d\n" + "".join(f"{i % 3 * 2 + 1},{i // 3 * 2 + 1},1.5\n" for i in range(9))
LISTED = SMALL.replace(
    '"loose"\nnumber = 8\ndiameter = "1 mm"', '"file"\nfile = "g.csv"\nunit=1e-3'
)
CANARY = "canary"
NASTY = st.sampled_from(
    [
        0, -1, 1, 2, 7, 1e-300, 1e300, -1e300, 1e-6, 1e6, 10**30, nan, inf, True, False, "", " ",
        "1 m", "1 mm", "1 um", "1e300 m", "-2 mm", "3 kg/m3", "1 Pa s", "1 s", "1 ms", "nan m", "é",
        "1 m/s", "x" * 3000, "\x00", "../../etc/passwd", "/dev/zero", ".", "g.csv", [], [[]], {},
        [0, 0], [1, 1], ["1 mm", "2 mm"], [2, 1], [0, 0, 1, 1], [0] * 2000, {"kind": "inflow"},
        {"kind": "outlet", "pressure": 1e300}, "slip", "inflow", "outlet", "loose", "random",
        "square", "hexagonal", "file", "places", "stokes", "microstructural", "bdf2", ["top"],
        f"__import__('os').system('touch {CANARY}')", f"$(touch {CANARY})",
        f"!!python/object/apply:os.system [touch {CANARY}]", "${HOME}", "{0.__class__}", "%s%n",
    ]
)  # fmt: skip
WORDS = st.sampled_from(
    """size periodic arrange number diameter density seed gap region file unit window crop porosity
    columns rows corner places min_gap settle relax velocity spin stiffness restitution damping
    friction dt rolling open escape segments viscosity drag depth order scheme reach spacing sides
    left top kind ramp until every frames method law tol __class__ box particles fixed fluid
    run""".split()  # noqa: SIM905
)


def checked(folder, text, name="c.toml"):
    """Check a case through the command line: status and stderr, whatever it is."""
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass"))
    began = time.perf_counter()
    status = cli.main(["check", str(path), "--json"])
    assert time.perf_counter() - began < LONGEST
    assert status in (0, 1, 2)
    assert not list(Path().glob(CANARY))
    assert not list(folder.glob(CANARY))
    return status


@pytest.fixture
def told(capfd):
    """A check that also looks at what was printed."""

    def check(folder, text):
        status = checked(folder, text)
        out, err = capfd.readouterr()
        assert "Traceback" not in out + err
        if status == 2:
            assert err.startswith("error: ")
            assert err.count("\n") == 1
            assert out == ""
        return status

    return check


def many(share, slow):
    """Settings for a share of all examples, in the default run or in the slow one."""
    return settings(
        max_examples=round(share * (2000 if slow else 200)),
        deadline=None,
        suppress_health_check=list(HealthCheck),
        derandomize=not slow,
    )


@st.composite
def mutated_cases(draw):
    """A case with some values, keys or sections changed, added or removed."""
    text = draw(st.sampled_from([SMALL, SMALL, LISTED, STARTERS["permeability"]]))
    data = tomlkit.parse(text).unwrap()
    for _ in range(draw(st.integers(1, 3))):
        here = data
        while True:
            inner = [key for key, value in here.items() if isinstance(value, dict)]
            if not inner or draw(st.integers(0, 5)) == 0:
                break
            here = here[draw(st.sampled_from(inner))]
        kind = draw(st.integers(0, 5))
        if kind == 0 and here:
            del here[draw(st.sampled_from(list(here)))]
        elif kind == 1 or not here:
            here[draw(WORDS)] = deepcopy(draw(NASTY))
        else:
            here[draw(st.sampled_from(list(here)))] = deepcopy(draw(NASTY))
    return tomlkit.dumps(data)


@st.composite
def broken_texts(draw):
    """Text of a case with pieces cut out, doubled, or overwritten by anything."""
    text = draw(st.sampled_from([SMALL, *STARTERS.values()])).encode()
    for _ in range(draw(st.integers(1, 4))):
        a = draw(st.integers(0, len(text)))
        b = min(len(text), a + draw(st.integers(0, 40)))
        new = draw(st.one_of(st.binary(max_size=8), st.just(text[a:b] * 2), st.just(b"")))
        text = text[:a] + new + text[b:]
    return text


@st.composite
def broken_lists(draw):
    """A list of particles with fields, rows and bytes changed."""
    rows = [line.split(",") for line in GRAINS.splitlines()]
    field = st.sampled_from(
        [
            "",
            "0",
            "-1",
            "nan",
            "inf",
            "1e300",
            "1e-300",
            "x",
            '"',
            "1;2",
            "1 2",
            "#",
            "\t",
            "²",
            "1e9",
        ]
    )
    for _ in range(draw(st.integers(0, 4))):
        row = draw(st.integers(0, len(rows) - 1))
        if draw(st.booleans()):
            rows[row][draw(st.integers(0, len(rows[row]) - 1))] = draw(field)
        elif draw(st.booleans()) and len(rows) > 1:
            del rows[row]
        else:
            rows.insert(row, list(rows[row]))
    data = "\n".join(",".join(row) for row in rows).encode()
    if draw(st.booleans()):
        a = draw(st.integers(0, len(data)))
        data = data[:a] + draw(st.binary(max_size=6)) + data[a + draw(st.integers(0, 6)) :]
    return data


def fuzzed(slow):
    """The tests, with few or with many examples."""

    class Fuzz:
        @many(0.5, slow)
        @given(text=mutated_cases())
        def test_cases_with_other_values(self, text, tmp_path, told):
            (tmp_path / "g.csv").write_text(GRAINS)
            told(tmp_path, text)

        @many(0.2, slow)
        @given(text=broken_texts())
        def test_cases_with_broken_text(self, text, tmp_path, told):
            told(tmp_path, text)

        @many(0.1, slow)
        @given(text=st.one_of(st.binary(max_size=300), st.text(max_size=100)))
        def test_cases_of_anything(self, text, tmp_path, told):
            assert told(tmp_path, text) == 2

        @many(0.2, slow)
        @given(data=broken_lists())
        def test_lists_of_particles(self, data, tmp_path, told):
            (tmp_path / "g.csv").write_bytes(data)
            told(tmp_path, LISTED)

    return Fuzz


TestSome = fuzzed(slow=False)
TestMany = pytest.mark.slow(fuzzed(slow=True))
