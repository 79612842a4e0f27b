"""The report: what is in it, nothing from elsewhere, and a real browser that shows it."""

import json
import re
from html.parser import HTMLParser

import matplotlib
import numpy as np
import pytest

import browser
import grainmesh as gm
from grainmesh import case, history, page, record, vtkhdf
from grainmesh.cli import main

matplotlib.use("Agg")

NASTY = "<script>alert('1')</script> & \"$x_1$\""
WET = """
title = {title}
[box]
size = ["8 mm", "16 mm"]
[particles]
arrange = "loose"
number = 30
diameter = ["0.9 mm", "1.1 mm"]
density = 2500
seed = 1
[contact]
stiffness = 2e4
[fluid]
density = 1000
viscosity = 0.01
drag = "hexagonal-lattice"
order = 1
sides = {{ bottom = {{ kind = "inflow", velocity = [0, 1e-3], ramp = [[0, 0], [1, 1]] }}, \
top = "outlet" }}
[run]
until = 0.02
every = 0.005
"""


class Reader(HTMLParser):
    """Elements that are open at the end, ids, addresses, and whether there are scripts."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.loads, self.tags, self.words = [], [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        about = dict(attributes)
        self.tags.append(tag)
        self.ids += [about["id"]] if "id" in about else []
        self.loads += [about[name] for name in ("src", "href", "xlink:href") if name in about]
        if tag not in ("meta", "link", "img"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in ("meta", "link", "img"):
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run in a folder, with a fluid whose inflow is not in the checkpoint."""
    folder = tmp_path_factory.mktemp("page") / "bed"
    given = case.parse(WET.format(title=json.dumps(NASTY)))
    record.record(given.simulation(), folder, given.run.until, given.run.every)
    page.write(folder)
    return folder


@pytest.fixture(scope="module")
def dry():
    box = gm.Box(0.02, 0.008)
    grains = gm.arrange.loose(box, 40, diameter=1e-3, density=2500, seed=1)
    model = gm.Model(box, gm.Contact(stiffness=1e4), gravity=(0.0, -9.81))
    return gm.Simulation(model, grains, ledger=True).run(until=0.02, every=0.005)


def test_the_page_holds_all_it_shows_and_asks_for_nothing(folder):
    text = (folder / "report.html").read_text(encoding="utf-8")
    read = Reader(text)
    assert read.open == []
    assert "script" not in read.tags
    assert len(read.ids) == len(set(read.ids))
    for address in read.loads:
        assert address.startswith(("data:", "#"))
        assert not address.startswith("#") or address[1:] in read.ids
    assert "http-equiv" in text
    assert "default-src 'none'" in text
    assert re.search(r"url\((?!#)", text) is None


def test_the_page_says_what_was_run_and_what_to_cite(folder):
    text = (folder / "report.html").read_text(encoding="utf-8")
    words = " ".join(Reader(text).words)
    assert NASTY in words
    assert "<script>" not in text
    for part in ("30 discs", "8 mm × 16 mm", "hexagonal-lattice", "2e4", "Time spent", "numpy"):
        assert part in words
    for key in ("grainmesh", "yazdchi2013", "luding2008", "srivastava2014", "sangani1982"):
        assert f"{{{key}," in words
    table = history.read(folder)
    assert f"{float(table.pressure_drop_y[-1]):.4g}" in words.replace("−", "-")
    shown = Reader(text).tags.count("img")
    frames = min(len(vtkhdf.times(folder / vtkhdf.DISCS)), 3)
    assert shown in (4 * frames, 4 * frames + 1)  # and the forces, if discs touch


def test_a_report_is_written_anew_whole_or_not_at_all(folder, capsys):
    target = folder / "report.html"
    before = target.read_text(encoding="utf-8")
    target.write_text("old")
    assert main(["report", str(folder)]) == 0
    assert capsys.readouterr().out.strip() == str(target)
    assert target.read_text(encoding="utf-8") == before
    assert not list(folder.glob("*.new"))
    assert main(["report", str(folder / "nowhere")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_damaged_files_are_refused_in_one_line(folder, tmp_path, capsys):
    for name in ("environment.json", "history.nc", "discs.vtkhdf"):
        copy = tmp_path / name.replace(".", "-")
        copy.mkdir()
        for file in folder.iterdir():
            (copy / file.name).write_bytes(file.read_bytes())
        (copy / name).write_bytes(b"\x00nonsense")
        assert main(["report", str(copy)]) == 2
        error = capsys.readouterr().err
        assert name in error
        assert error.count("\n") == 1


def test_a_simulation_without_files_has_a_page_too(dry, tmp_path):
    written = page.write(dry, tmp_path / "new" / "dry.html")
    text = written.read_text(encoding="utf-8")
    read = Reader(text)
    words = " ".join(read.words)
    assert "without a fluid" in words
    assert "Speed of the fluid" not in words
    assert "energy and work of the ledger" in words
    assert "srivastava2014" not in words
    assert read.tags.count("svg") >= 3
    with pytest.raises(gm.InputError, match="cannot be written"):
        page.write(dry, written / "x.html")


def test_numbers_are_written_as_people_write_them():
    from grainmesh import markup

    assert markup.number(-1.5e-7) == "−1.5·10<sup>−7</sup>"
    assert [markup.number(v) for v in (0.0, 12.3456, 1234.0)] == ["0", "12.35", "1234"]
    assert markup.scale(-4.6e-22, 3.0, "Pa", "viridis").startswith("0<i")
    assert [markup.metres(v) for v in (2.0, 0.0125, 7e-6, 3e-9)] == [
        "2 m", "12.5 mm", "7 µm", "3 nm",
    ]  # fmt: skip
    assert [markup.duration(v) for v in (0.5, 90.0, 600.0, 9000.0)] == [
        "500 ms", "90.0 s", "10.0 min", "2.5 h",
    ]  # fmt: skip
    assert markup.words({"a": [1, 2], "b": "c"}) == "a 1, 2, b c"


@browser.needed
@pytest.mark.parametrize(("dark", "size"), [(False, (1100, 900)), (True, (390, 800))])
def test_a_browser_shows_the_page_without_network_and_without_errors(folder, tmp_path, dark, size):
    address = (folder / "report.html").as_uri()
    seen = browser.visit(
        address,
        "[...document.images].every(image => image.naturalWidth > 0)",
        "document.documentElement.scrollWidth <= innerWidth",
        "getComputedStyle(document.body).color.match(/\\d+/g).map(Number)[0]",
        "getComputedStyle(document.querySelector('svg text')).fill.match(/\\d+/g).map(Number)[0]",
        "[...document.querySelectorAll('.plots svg')].every(p => p.getBoundingClientRect().height)",
        picture=tmp_path / "page.png",
        size=size,
        dark=dark,
    )
    assert seen.errors == []
    assert seen.requests == [address]
    loaded, fits, ink, axes, drawn = seen.values
    assert loaded
    assert fits
    assert drawn
    assert (ink > 128) == (axes > 128) == dark
    shot = matplotlib.image.imread(tmp_path / "page.png")[..., :3]
    assert (np.median(shot) < 0.3) == dark
