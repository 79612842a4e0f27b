"""What a user of Python meets: quick import, names, help, results as text, numbers and tables."""

import ast
import json
import pydoc
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import grainmesh as gm

HEAVY = ("numpy", "scipy", "numba", "ngsolve", "netgen", "matplotlib", "h5py", "rich", "typer",
         "xarray", "pydantic", "skimage", "pyvista", "vtk", "trame", "PIL")  # fmt: skip


def fresh(code):
    """What a new interpreter prints."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.split()


def loaded(code):
    """Heavy packages and modules of grainmesh that a new interpreter has loaded after `code`."""
    names = set(fresh(f"import sys\n{code}\nprint(*sys.modules)"))
    ours = {name for name in names if name.startswith("grainmesh.")}
    return {name for name in HEAVY if name in names} | ours


def test_import_loads_nothing_before_it_is_used():
    assert loaded("import grainmesh") == set()
    assert loaded("import grainmesh; dir(grainmesh); grainmesh.InputError") == {"grainmesh.errors"}
    assert "ngsolve" not in loaded(
        "import grainmesh as gm; gm.Box(1, 1); gm.Particles([[0, 0]], 1)"
    )


def test_help_of_the_command_line_is_quick():
    code = """
import contextlib, io
from grainmesh.cli import main
with contextlib.redirect_stdout(io.StringIO()):
    main(["--help"])
"""
    heavy = {"scipy", "numba", "ngsolve", "netgen", "matplotlib", "h5py", "xarray", "vtk", "PIL"}
    assert not heavy & loaded(code)


def test_every_name_is_there_and_typed():
    tree = ast.parse(Path(gm.__file__).read_text())
    typed = next(node for node in tree.body if isinstance(node, ast.If))
    imported = {alias.name for node in typed.body for alias in node.names}
    assert imported == set(gm.__all__)
    assert set(gm.__all__) <= set(dir(gm))
    for name in gm.__all__:
        value = getattr(gm, name)
        assert value.__doc__, name
        if name in gm._HOME:
            assert value.__module__ == f"grainmesh.{gm._HOME[name]}"
        else:
            assert isinstance(value, ModuleType)
    assert (Path(gm.__file__).parent / "py.typed").exists()
    with pytest.raises(AttributeError, match="no attribute 'permeabilty'"):
        _ = gm.permeabilty


def test_functions_are_not_hidden_by_their_modules():
    code = """
import grainmesh.plot, grainmesh.relax, grainmesh.permeability
from grainmesh import permeability, relax
import grainmesh as gm
print(callable(gm.permeability), callable(gm.relax), gm.permeability is permeability)
"""
    assert fresh(code) == ["True"] * 3


def test_help_is_readable():
    text = pydoc.plain(pydoc.render_doc(gm))
    head = text[: text.index("PACKAGE CONTENTS")]
    for name in gm.__all__:
        if name not in ("Contacts", "Permeability", "Triangulation"):  # what others return
            assert f"`{name}`" in head, name
    assert max(map(len, head.splitlines())) < 110


BOX, DISCS = gm.arrange.hexagonal(3, 4, porosity=0.6, diameter=1e-5)


@pytest.mark.parametrize("method", ["resolved", "mesoscale", "microstructure"])
@pytest.mark.filterwarnings("ignore::grainmesh.closures.ClosureWarning")
def test_a_permeability_tells_what_it_is(method):
    K = gm.permeability(BOX, DISCS, method, tol=0.1)
    assert f"({method})" in repr(K)
    assert f"{K.normalised:.4g}" in repr(K)
    assert "array" not in repr(K)
    plain = json.loads(json.dumps(K.to_dict(), allow_nan=False))
    assert plain["n"] == len(DISCS)
    assert np.array_equal(plain["tensor"], K.tensor)
    if K.detail is not None:
        assert repr(K.detail).startswith(type(K.detail).__name__)
        plain = json.loads(json.dumps(K.detail.to_dict(), allow_nan=False))
        assert np.array_equal(plain["force"], K.detail.force)


def test_what_is_not_finite_becomes_none():
    K = gm.permeability(gm.Box(1, 1, periodic=True), gm.Particles([[0.5, 0.5]], 0.5), tol=0.1)
    assert np.isfinite(K.normalised)
    assert replace(K, gap=np.nan).to_dict()["gap"] is None


def test_particles_and_triangulation_tell_what_they_are():
    assert repr(DISCS) == f"Particles: {len(DISCS)}, d = 1e-05 m, density 1000 kg/m³"
    assert "(1 to 3)" in repr(gm.Particles([[0, 0], [9, 9]], [1, 3]))
    assert json.loads(json.dumps(DISCS.to_dict()))["x"] == DISCS.x.tolist()
    mesh = gm.triangulate(BOX, DISCS)
    assert f"{len(mesh.triangles)} triangles of {len(DISCS)} particles" in repr(mesh)


def test_a_simulation_tells_what_it_is():
    model = gm.Model(gm.Box(1, 1), gm.Contact(stiffness=1e5), gravity=(0, -9.81))
    grains = gm.Particles([[0.3, 0.0499], [0.3999, 0.0499], [0.7, 0.5]], 0.1)
    simulation = gm.Simulation(model, grains)
    assert "3 particles" in repr(simulation)
    assert "1 contacts" in repr(simulation)
    plain = json.loads(json.dumps(simulation.to_dict(), allow_nan=False))
    assert plain["particles"] == 3
    contacts = simulation.contacts
    assert f"{contacts.force.max():.4g} N/m" in repr(contacts)
    assert contacts.to_dict()["pair"] == [[0, 1]]
    far = gm.Simulation(model, gm.Particles([[0.5, 0.5]], 0.1))
    assert repr(far.contacts) == "Contacts: none"
    assert far.contacts.to_dict()["force"] == []


def sample(porosity, seed):
    box, discs = gm.arrange.random(30, porosity=porosity, diameter=7e-6, seed=seed)
    return gm.permeability(box, discs, "microstructure")


def test_a_sweep_is_a_table_with_units():
    table = gm.sweep(sample, porosity=[0.6, 0.7], seed=range(3))
    assert dict(table.sizes) == {"porosity": 2, "seed": 3}
    assert table.diameter.attrs == {"units": "m", "long_name": "mean diameter d"}
    one = sample(0.7, 2)
    at = table.sel(porosity=0.7, seed=2)
    assert float(at.normalised) == one.normalised
    assert float(at.Kyx) == one.tensor[1, 0]
    assert "method" not in table
    assert "porosity" not in table.data_vars  # the axis
    assert list(gm.sweep(lambda a: {"b": 2 * a}, a=[1, 2]).b.values) == [2, 4]


@pytest.mark.parametrize(
    ("axes", "says"),
    [
        ({}, "name at least one parameter"),
        ({"porosity": [], "seed": [1]}, "no values of porosity"),
        ({"porosity": [0.6, 2.0], "seed": [1]}, "sweep at porosity=2.0, seed=1: .*porosity"),
    ],
)
def test_bad_sweeps(axes, says):
    with pytest.raises(gm.InputError, match=says):
        gm.sweep(sample, **axes)
