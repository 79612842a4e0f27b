"""What tests of the flow share: fields in which nothing is 0, and NGSolve beside them."""

import importlib.util
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from ngsolve import L2, GridFunction

from grainmesh.carry import Keys
from grainmesh.coupling import Coupling, Discs
from grainmesh.domain import Box
from grainmesh.drag import Drag
from grainmesh.element import element
from grainmesh.medium import Fluid, Inflow, NoSlip, Outlet, Slip
from grainmesh.mesh import flow_mesh, spaces

# The exact solutions and what drives to them are those of docs/flow.py.
SPEC = importlib.util.spec_from_file_location(
    "flow", Path(__file__).parent.parent / "docs" / "flow.py"
)
flow = importlib.util.module_from_spec(SPEC)
sys.modules["flow"] = flow  # dataclasses look their module up
SPEC.loader.exec_module(flow)


@dataclass(frozen=True)
class Nothing(Drag):
    """A law for discs that are not there."""

    name, reference, medium, variable, valid = "nothing", "-", "-", "porosity", (0.0, 1.0)

    def _argument(self, bed):
        return bed.porosity

    def _coefficient(self, bed):
        return np.zeros(len(bed.diameter))


SIDES = {"left": Inflow((1.0, 0.0)), "right": Outlet(), "bottom": NoSlip(), "top": Slip()}


def some_flow(order, periodic, seed=0, n=14):
    """Fields in which nothing is 0, on a mesh with points that are no vertex."""
    box, rng = Box(1.0, 1.2, periodic), np.random.default_rng(seed)
    fluid = Fluid(
        density=1.5, viscosity=2.0, drag=Nothing(), sides={} if periodic else SIDES, order=order,
        spacing=0.15, torque=False,
    )  # fmt: skip
    grid = (np.stack(np.divmod(np.arange(n), 4), axis=1) + 0.5) / (4, 4)
    at = (grid + rng.uniform(-0.08, 0.08, (n, 2))) * box.size
    discs = Discs(rng.uniform(0.05, 0.12, n), np.ones(n), np.ones(n, bool))
    found = Coupling(box, fluid, (0.0, 0.0), discs, at, np.zeros((n, 2)))
    op, m = found.operator, len(found.mesh.points)
    assert not op.topology.used.all()
    for name in ("eps", "inertia", "E", "S"):
        op.load(**{name: rng.uniform(0.5, 1.0, m)})
    for name in ("f", "g", "w"):
        op.load(**{name: rng.normal(size=(m, 2))})
    op.stirred[:] = rng.uniform(0.0, 1.0, len(op.stirred))
    op.u[:], op.p[:] = rng.normal(size=op.u.shape), rng.normal(size=op.p.shape)
    return found, rng


class Beside:
    """The forms of `navier`, Eqs. (1) to (3), put together by NGSolve from formulas."""

    def __init__(self, of):
        self.op, mesh = of.operator, of.mesh
        arrays = mesh.points, mesh.triangles, mesh.shifts, mesh.neighbours
        self.grid = flow_mesh(mesh.box, *arrays)
        op, self.mesh, linear = self.op, self.grid.mesh, Keys(self.op.topology, element(1))
        self.V, self.Q = spaces(self.mesh, op.order, (), (), ())
        self.rows = [keys.of_mesh(self.grid) for keys in (op.keys, op.pressure_keys, linear)]
        self.P = spaces(self.mesh, 1, (), (), ())[1]
        for name in ("eps", "inertia", "E", "S", "f", "g", "w"):
            setattr(self, name, linear.field(self.grid, getattr(op, name)))
        self.u, self.p = op.keys.field(self.grid, op.u), op.pressure_keys.field(self.grid, op.p)
        self.mu = GridFunction(L2(self.mesh, order=0))
        self.mu.vec.FV().NumPy()[:] = op.viscosity + op.stirred

    def load(self, kind, form):
        """A linear form of velocity, pressure or hats by our unknowns."""
        values, rows = np.array(form.Assemble().vec.FV().NumPy()), self.rows["uph".index(kind)]
        keys = self.op.keys, self.op.pressure_keys, Keys(self.op.topology, element(1))
        found = np.zeros((keys["uph".index(kind)].size, 2 if kind == "u" else 1))
        np.add.at(found, rows, values.reshape(found.shape[1], -1).T)
        return found if kind == "u" else found[:, 0]
