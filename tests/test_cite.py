"""What is cited is what the laws say they come from."""

import re
from pathlib import Path

import pytest

import grainmesh as gm
from grainmesh import cite
from grainmesh.cli import main
from grainmesh.closures import LAWS
from grainmesh.drag import DRAGS, from_name
from grainmesh.permeability import METHODS

ROOT = Path(__file__).parents[1]
SPHERES = ("stokes", "schiller-naumann")
SURNAMES = (
    "Yazdchi|Luding|Sangani|Acrivos|Gebart|Drummond|Tahir|Lee|Yang|Carman|Ergun|Kuwabara|Happel|"
    "Brenner|Lamb|White|Kaplun|Schiller|Naumann"
)


def law(name):
    return (
        LAWS[name]
        if name in LAWS
        else from_name(name, **({"depth": 1.0} if name in SPHERES else {}))
    )


@pytest.mark.parametrize("name", sorted({*LAWS, *DRAGS}))
def test_the_entries_of_a_law_are_those_of_its_reference(name):
    """Surname, volume, year and first page of every `reference` stand in its BibTeX."""
    text = " ".join(cite.entries()[key] for key in cite.SOURCES[name])
    reference = law(name).reference
    found = re.findall(r"[A-Z][\w .&]*? (\d+) \((\d{4})\) (\d+)", reference)
    for volume, year, page in found:
        assert f"volume = {{{volume}}}" in text
        assert f"year = {{{year}}}" in text
        assert f"pages = {{{page}" in text
    for surname in re.findall(SURNAMES, reference):
        assert f"{surname}, " in text
    assert found or name in ("random-discs", "microstructural", "white", "channel")


def test_every_method_and_law_is_there_and_every_entry_is_used():
    assert set(cite.SOURCES) == {*METHODS, *LAWS, *DRAGS, "contacts", "flow"}
    used = {key for keys in cite.SOURCES.values() for key in keys}
    assert used | {"grainmesh"} == set(cite.entries())


def test_entries_are_balanced_bibtex():
    keys = list(cite.entries())
    assert len(keys) == len(set(keys)) > 20
    for text in cite.entries().values():
        depth = 0
        for mark in re.findall(r"[{}]", text):
            depth += 1 if mark == "{" else -1
            assert depth >= 0
        assert depth == 0
        assert "title = {" in text
        assert "author = {" in text


def test_grainmesh_itself_agrees_with_its_citation_file():
    text = (ROOT / "CITATION.cff").read_text()
    entry = cite.entries()["grainmesh"]
    version = re.search(r"^version: (.*)$", text, re.MULTILINE)[1]
    assert f"version = {{{version}}}" in entry
    assert version == gm.__version__
    title = re.search(r"title: (FEM-DEM.*)$", text, re.MULTILINE)[1]
    assert title in cite.entries()["yazdchi2013"].replace("{FEM-DEM}", "FEM-DEM")


def test_only_what_was_used_is_cited():
    text = cite.bibtex(["contacts", "stokes"])
    assert re.findall(r"@\w+\{(\w+),", text) == [
        "grainmesh", "yazdchi2013", "cundall1979", "luding2008", "stokes1851",
    ]  # fmt: skip
    assert re.findall(r"@\w+\{(\w+),", cite.bibtex()) == ["grainmesh", "yazdchi2013"]


def test_an_unknown_law_is_refused_with_the_nearest_one():
    with pytest.raises(gm.InputError, match="'gebart': did you mean gebart-square"):
        cite.bibtex(["gebart"])


def keys(text):
    return re.findall(r"@\w+\{(\w+),", text)


def test_the_verb_cites_what_a_case_uses(tmp_path, capsys):
    case = tmp_path / "case.toml"
    settling = "particles = { arrange = 'places', places = [[0.5, 0.5]], diameter = 0.1 }\n"
    settling += "box = { size = [1, 1] }\ncontact = { stiffness = 1e4 }\nrun = { until = 1 }\n"
    fluid = "fluid = { density = 1, viscosity = 1, drag = 'kuwabara' }\n"
    for text, wanted in (
        (settling, {"cundall1979", "luding2008"}),
        (
            settling + fluid,
            {"cundall1979", "luding2008", "srivastava2014", "schoberl2014", "saad1986"}
            | {"kuwabara1959"},
        ),
        (
            settling.split("\n")[0] + "\nbox = { size = [1, 1] }\n"
            "permeability = { method = ['microstructure'], law = 'gebart-square' }",
            {"gebart1992"},
        ),
    ):
        case.write_text(text)
        for what in (case, tmp_path):
            assert main(["cite", str(what)]) == 0
            assert set(keys(capsys.readouterr().out)) == {"grainmesh", "yazdchi2013"} | wanted
    assert main(["cite"]) == 0
    assert keys(capsys.readouterr().out) == ["grainmesh", "yazdchi2013"]


def test_the_verb_cites_what_results_used_and_refuses_others_in_one_line(tmp_path, capsys):
    results = tmp_path / "permeability.json"
    results.write_text('{"results": [{"method": "resolved"}]}')
    assert main(["cite", str(tmp_path)]) == 0
    assert "schoberl1997" in keys(capsys.readouterr().out)
    for text in ("{", "[]", '{"results": 3}', '{"results": [{"method": "magic"}]}'):
        results.write_text(text)
        assert main(["cite", str(tmp_path)]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert main(["cite", str(tmp_path / "nowhere.toml")]) == 2
    (tmp_path / "empty").mkdir()
    assert main(["cite", str(tmp_path / "empty")]) == 2
    assert capsys.readouterr().err.count("\n") == 2
