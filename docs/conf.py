"""The site: `make site` builds it into out/site, without network and without running an example."""

import pkgutil
import re
from importlib import import_module
from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

import grainmesh

HERE = Path(__file__).parent
#: Modules that are part of the face of the package; the others are its inside.
PUBLIC = (
    *("arrange", "case", "cite", "closures", "drag", "fibres", "history", "page", "plot"),
    *("preview", "record", "viewer", "vtkhdf"),
)

project = "grainmesh"
author = "grainmesh developers"
project_copyright = "grainmesh developers, BSD-3-Clause"
release = version = grainmesh.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["README.md"]
default_role = "py:obj"
highlight_language = "none"
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # stand in the docstrings, with shapes and units
autodoc_default_options = {"members": True}
napoleon_google_docstring = False
napoleon_use_param = False  # types are prose, "ndarray, shape (n, 2)", and no links
napoleon_use_rtype = False
napoleon_custom_sections = [("Attributes", "params_style")]

sphinx_gallery_conf = {
    "examples_dirs": ["../examples"],
    "gallery_dirs": ["gallery"],
    "plot_gallery": False,  # pictures are made by docs/gallery.py
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "show_signature": False,
    "remove_config_comments": True,
    "write_computation_times": False,  # that page loads scripts from the network
}

html_theme = "pydata_sphinx_theme"
html_title = "grainmesh"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_math_renderer = "mathml"
html_sidebars = {page: [] for page in ("index", "start", "built")}
html_theme_options = {
    "navbar_align": "left",
    "navbar_end": ["theme-switcher"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
    "show_nav_level": 1,
    "navigation_with_keys": False,
}


def formulas(app, what, name, obj, options, lines):
    """Formulas in docstrings, indented after a blank line, as they stand."""
    text, literal = [], False
    for before, line in zip(["", *lines], lines, strict=False):
        flat = line[:1].strip() != ""
        if literal and flat:
            literal = False
        if not literal and line.startswith("    ") and not before.strip():
            last = next((t for t in reversed(text) if t.strip()), " ")
            if last[0] != " " and not last.endswith("::"):
                text += ["::", ""]
                literal = True
        if literal:  # the number of a formula comes nearer
            text.append(re.sub(r" {3,}(\(\d+\))$", r"   \1", line))
        else:
            text.append(line.replace("|", "\\|"))
    lines[:] = text


def mathml(text, block):
    """A formula in the TeX of the pages as MathML, which browsers draw by themselves."""
    return tex2mathml(text, as_block=block)


def visit_inline(self, node):
    self.body.append(mathml(node.astext(), False))
    raise nodes.SkipNode


def visit_block(self, node):
    number = f'<span class="eqno">({node["number"]})</span>' if node["number"] else ""
    start = self.starttag(node, "div", CLASS="math")
    self.body.append(f"{start}{mathml(node.astext(), True)}{number}</div>")
    raise nodes.SkipNode


def pages():
    """Write a page for the face of the package, and one for each module, into docs/api."""
    folder = HERE / "api"
    folder.mkdir(exist_ok=True)
    names = [m.name for m in pkgutil.iter_modules(grainmesh.__path__) if m.name != "__main__"]
    face = [n for n in grainmesh.__all__ if n in grainmesh._HOME]
    wanted = {
        "names": title("Names of the package") + "\n.. automodule:: grainmesh\n   :no-members:\n"
    }
    for name in face:
        kind = "autoclass" if name[0].isupper() else "autofunction"
        wanted["names"] += f"\n.. {kind}:: grainmesh.{name}\n"
    for name in names:
        elsewhere = ", ".join(n for n in face if grainmesh._HOME[n] == name)
        wanted[name] = f"{title(f'grainmesh.{name}')}\n.. automodule:: grainmesh.{name}\n"
        if name in face:  # a function has the name of its module
            wanted[name] += "   :no-index:\n"
        if elsewhere:
            wanted[name] += f"   :exclude-members: {elsewhere}\n"
    wanted["modules"] = table("Modules", PUBLIC)
    wanted["inside"] = table("Inside", [n for n in names if n not in PUBLIC])
    for stale in {p.stem for p in folder.glob("*.rst")} - set(wanted):
        (folder / f"{stale}.rst").unlink()
    for name, text in wanted.items():
        page = folder / f"{name}.rst"
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")


def table(heading, names):
    """A page with a line for each module."""
    lines = [title(heading), ".. list-table::", "   :widths: 20 80", ""]
    for name in names:
        first = import_module(f"grainmesh.{name}").__doc__.splitlines()[0]
        lines += [f"   * - :doc:`{name} <{name}>`", f"     - {first}"]
    return "\n".join(
        [*lines, "", ".. toctree::", "   :hidden:", "", *(f"   {n}" for n in names), ""]
    )


def title(text):
    return f"{text}\n{'=' * len(text)}\n"


def setup(app):
    pages()
    app.connect("autodoc-process-docstring", formulas, priority=400)
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
