"""The site and the README: links lead somewhere, nothing is left out, and what is shown runs."""

import re
import shlex
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import matplotlib
import pytest
from typer.main import get_command

matplotlib.use("Agg")

import grainmesh as gm
from grainmesh import cli

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "ARCHITECTURE.md", *sorted(DOCS.glob("**/*.md"))]
MADE = ("docs/api/", "docs/gallery/")  # by the build
EXAMPLES = sorted(path.stem for path in (ROOT / "examples").glob("*.py"))
VERBS = sorted(get_command(cli.app).commands)


def fenced(page, language):
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    text = re.sub(
        r"```.*?```|`[^`\n]*`|\$\$.*?\$\$|\$[^$\n]*\$", "", page.read_text(), flags=re.DOTALL
    )
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in link or link.startswith("#"):
            continue
        target = (page.parent / unquote(link.split("#")[0])).resolve()
        inside = f"{target.relative_to(ROOT)}"
        assert target.exists() or inside.startswith(MADE), f"{page}: {link}"


def test_readme_is_short_and_has_two_pictures():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) < 120
    assert len(re.findall(r"^!\[", text, re.MULTILINE)) == 2


def test_every_verb_has_its_line():
    table = (DOCS / "commands.md").read_text(encoding="utf-8")
    assert [v for v in VERBS if f"`grainmesh {v}" not in table] == []


def test_the_gallery_is_complete():
    assert len(EXAMPLES) >= 8
    for name in EXAMPLES:
        text = (ROOT / "examples" / f"{name}.py").read_text(encoding="utf-8")
        title, line = text.splitlines()[:2]
        assert line == "=" * len(title.removeprefix('"""')), name
        assert text.count(f"_static/gallery/{name}.png") == 2  # on the page, and small
        assert (DOCS / "_static" / "gallery" / f"{name}.png").stat().st_size < 200_000


def test_every_module_is_in_the_table_of_rooms():
    rooms = set(re.findall(r"`(\w+)`", (ROOT / "ARCHITECTURE.md").read_text().split("## Conv")[0]))
    modules = {path.stem for path in (ROOT / "src" / "grainmesh").glob("[!_]*.py")} | {"closures"}
    assert modules - rooms == set()


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built as `make site` does: any warning is an error."""
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"]
    done = subprocess.run(
        [*command, "-d", out / "trees", DOCS, out / "html"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return out / "html"


@pytest.mark.slow
def test_the_site_has_every_verb_name_and_example(site):
    from sphinx.util.inventory import InventoryFile

    text = (site / "commands.html").read_text(encoding="utf-8")
    assert [v for v in VERBS if f"grainmesh {v}" not in re.sub(r"<[^>]+>", "", text)] == []
    with (site / "objects.inv").open("rb") as file:
        objects = InventoryFile.load(file, "", lambda base, path: path)
    known = {name for kind, names in objects.items() if kind.startswith("py:") for name in names}
    assert [name for name in gm.__all__ if f"grainmesh.{name}" not in known] == []
    for name in EXAMPLES:
        assert f"{name}.png" in (site / "gallery" / f"{name}.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_site_loads_nothing_from_the_network(site):
    """Links to click are fine; scripts, styles, pictures and fonts are its own."""
    loads = re.compile(
        r"<(?!a\b)\w+[^>]*\s(?:src|href|data)\s*=\s*[\"']?(?:https?:)?//[^>]*>", re.I
    )
    for page in site.glob("**/*.html"):
        assert loads.findall(page.read_text(encoding="utf-8")) == [], page
    for style in site.glob("**/*.css"):
        text = style.read_text(encoding="utf-8")
        assert not re.search(r"(url\(|@import)\s*[\"']?(https?:)?//", text), style


@pytest.mark.slow
@pytest.mark.parametrize("code", fenced(DOCS / "start.md", "python"))
def test_first_commands_in_python(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "start.md", "exec"), {})


@pytest.mark.slow
def test_the_case_of_the_readme(tmp_path, monkeypatch, capsys):
    """new, check and run, one after the other; show would serve until Ctrl-C."""
    monkeypatch.chdir(tmp_path)
    lines = fenced(ROOT / "README.md", "console")[0].splitlines()
    assert [line.split()[1] for line in lines] == ["new", "check", "run", "show"]
    for line in lines[:3]:
        assert cli.main(shlex.split(line)[1:]) == 0
    assert {"history.nc", "flow.vtkhdf", "report.html"} <= {p.name for p in Path("bed").iterdir()}
