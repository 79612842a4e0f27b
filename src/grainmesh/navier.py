r"""Porosity-scaled Navier-Stokes equations on a mesh that moves: one implicit step.

With porosity ε, interstitial velocity u, dynamic pressure p and velocity w of the mesh, velocity
test functions v and pressure test functions q,

    d/dt ∫ρ ε u·v + a(u, v) + ∫E ∇p·v = ∫ρ ε u·((u - w)·∇)v + ∫f·v                             (1)
    ∫E u·∇q - ∫S ∇p·∇q = -∫g·∇q + ∮q ε u·n                                                     (2)
    a(u, v) = ∫B u·v + ∫2 mu ε D(u):D(v) - 2/3 mu ε ∇·u ∇·v                                    (3)

where v moves with the mesh, so that (1) conserves momentum; B, E, S, f and g come from the
particles (`grainmesh.coupling`); without any, B = S = 0 and E = ε. A step Δt is

    c (Q' - Q - Δt C) = (c - 1) D + Δt R',    D' = Q' - Q - Δt C,                              (4)

with Q = ∫ρ ε u·v, C the convection of (1) at the velocity foretold for the middle of the step and
on the mesh half-way (which keeps a uniform flow uniform), and R' all else, taken at its end.
c = 1 is implicit Euler; c = (1 + 2 ω)/(1 + ω), with (c - 1) D times ω for ω = Δt/Δt_old, is BDF2.

Porosity that follows the discs and flow whose volume they share agree only to the order of the
elements, so the mass m = ∫ρ ε v of (1) changes by other than flows in: R = (m' - m)/Δt - ∫ρ ε (u -
w)·∇v, which sums to zero. It is a force u R in C. Convection in the frame of the mean flow,

    C + <u> R,                                                                                (6)

takes out what does not depend on relative motion: the same flow seen from a train.

Equation (4) leaves a residual r' of the linear solver. Q' = ∫ρ ε' u'·v + Δt r'/c counts it in the
next step, so momentum is conserved to round-off at any tolerance.

Particles (`grainmesh.coupling`) act by averages over their kernels, E and S point by point: to keep
the matrix sparse. What is too much is taken from the fields x' of the last step, or those foretold,

    E, S: K x' = ... + (K - K_mean) x,                                                         (5)

so it vanishes in steady flow, and is of the order of the change in a step otherwise.

The elements are Taylor-Hood P_k/P_{k-1}, MINI for k = 1. The matrix of (1) and (2) is symmetric,
an L D Lᵀ of it serves as preconditioner until too much has changed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from ngsolve import (
    H1,
    L2,
    BilinearForm,
    CoefficientFunction,
    Grad,
    GridFunction,
    IfPos,
    InnerProduct,
    LinearForm,
    Sym,
    VectorH1,
    div,
    ds,
    dx,
    grad,
    specialcf,
)
from numpy.typing import NDArray

from grainmesh.lagged import Lagged, csr
from grainmesh.mesh import spaces
from grainmesh.saddle import SaddleFactor, threads

Float = NDArray[np.float64]


class Operator:
    """Equations (1) to (3) on one mesh; its vertices may move.

    Parameters
    ----------
    mesh : ngsolve.Mesh
    order : int
        k >= 1.
    pressure, slip, no_slip : tuple of str
        Boundaries where the pressure is given and the flow at right angles; where flow is
        tangential without friction; where the velocity is given.

    Attributes
    ----------
    u, p : ngsolve.GridFunction
        Velocity [m/s] and pressure [Pa].
    eps, inertia, E, S, f, g : ngsolve.GridFunction
        Linear fields: porosity, c ρ ε/Δt + B, and those of Eqs. (1), (2).
    dE, dS : ngsolve.GridFunction
        The parts of E and S that act by averages, Eq. (5), linear.
    stirred : ngsolve.GridFunction
        Viscosity besides mu, constant on triangles [Pa s].
    given : ngsolve.GridFunction
        Superficial velocity ε u at the boundary [m/s].
    free : ndarray, shape (N,)
        Unknowns of velocity, then of pressure, that are solved for.
    """

    def __init__(
        self,
        mesh: Any,
        order: int,
        viscosity: float,
        density: float,
        pressure: tuple[str, ...] = (),
        slip: tuple[str, ...] = (),
        no_slip: tuple[str, ...] = (),
    ) -> None:
        self.mesh, self.order, self.viscosity, self.density = mesh, order, viscosity, density
        self.V, self.Q = spaces(mesh, order, pressure, slip, no_slip)
        self.P1, self.W = H1(mesh, order=1), VectorH1(mesh, order=1)
        self.u, self.p = GridFunction(self.V), GridFunction(self.Q)
        self.foretold, self.w = GridFunction(self.V), GridFunction(self.W)
        self.eps, self.inertia, self.E, self.S = (GridFunction(self.P1) for _ in range(4))
        self.dE, self.dS = GridFunction(self.P1), GridFunction(self.P1)
        self.stirred, self.given = GridFunction(L2(mesh, order=0)), GridFunction(self.V)
        self.f, self.g = GridFunction(self.W), GridFunction(self.W)
        self.free = np.concatenate([np.asarray(X.FreeDofs()) for X in (self.V, self.Q)])
        self._forms(pressure, no_slip)

    def _forms(self, pressure: tuple[str, ...], no_slip: tuple[str, ...]) -> None:
        u, v = self.V.TnT()
        p, q = self.Q.TnT()
        rho, eps, once = self.density, self.eps, dx(bonus_intorder=1)
        degree = max(self.order, 3 if self.order == 1 else 2)  # of u, a bubble included
        self.a = BilinearForm(self._viscous(u, v) * once)
        self.b = BilinearForm(trialspace=self.V, testspace=self.Q)
        self.b += self.E * InnerProduct(u, grad(q)) * once
        self.s = BilinearForm(self.S * InnerProduct(grad(p), grad(q)) * once)
        self._momentum = LinearForm(
            rho * eps * InnerProduct(self.u, v) * dx(bonus_intorder=degree + 1)
        )
        e, w = self.foretold, self.w
        self._convection = LinearForm(
            rho * eps * InnerProduct(e, Grad(v) * (e - w)) * dx(bonus_intorder=2 * degree)
        )
        one = CoefficientFunction((1.0, 1.0))
        self._mass = LinearForm(rho * eps * InnerProduct(one, v) * dx(bonus_intorder=1))
        self._mass_flux = LinearForm(
            rho * eps * InnerProduct(one, Grad(v) * (e - w)) * dx(bonus_intorder=degree)
        )
        if pressure:  # what flows out takes its momentum with it; what flows in had none
            out = e * specialcf.normal(2)
            out = -rho * eps * IfPos(out, out, 0.0)
            on = ds("|".join(pressure), bonus_intorder=2 * degree)
            self._convection += out * InnerProduct(e, v) * on
            self._mass_flux += out * InnerProduct(one, v) * on
        self._inflow = LinearForm(self.Q)
        if no_slip:
            self._inflow += (self.given * specialcf.normal(2)) * q * ds("|".join(no_slip))
        (v, q), Du = (self.V * self.Q).TestFunction(), Grad(self.u)
        # Eq. (5): E and S act on averages over kernels, which f and g hold for the fields at hand.
        f = self.f + self.dE * grad(self.p)
        g = self.g - self.dE * self.u + self.dS * grad(self.p)
        self._source = LinearForm(
            (InnerProduct(f, v) - InnerProduct(g, grad(q))) * dx(bonus_intorder=degree)
        )
        z, y, c = (self.W * self.W * self.P1).TestFunction()
        self._means = LinearForm(
            (InnerProduct(self.u, z) + InnerProduct(grad(self.p), y) + (Du[1, 0] - Du[0, 1]) * c)
            * dx(bonus_intorder=degree)
        )

    def vector(self, form: str) -> Float:
        """A load vector of Eqs. (1), (2): momentum and convection of V, source of V and Q, inflow
        of Q.
        """  # fmt: skip
        with threads(self.mesh):
            return np.array(getattr(self, "_" + form).Assemble().vec.FV().NumPy())

    def means(self) -> tuple[Float, Float, Float]:
        """Integrals of u (v, 2), ∇p (v, 2) and ∇×u (v,) times the hats of the vertices."""
        v = self.mesh.nv
        u, slope, curl = np.split(self.vector("means"), [2 * v, 4 * v])
        return u.reshape(2, v).T, slope.reshape(2, v).T, curl

    def whole(self) -> tuple[Any, Any]:
        """The matrix of both equations, and which of its unknowns are free."""
        X = self.V * self.Q
        (u, p), (v, q) = X.TnT()
        form = (
            self._viscous(u, v)
            + self.E * (InnerProduct(grad(p), v) + InnerProduct(u, grad(q)))
            - self.S * InnerProduct(grad(p), grad(q))
        )
        with threads(self.mesh):
            return BilinearForm(form * dx(bonus_intorder=1)).Assemble().mat, X.FreeDofs()

    def factor(self, names: NDArray[np.int64]) -> Lagged:
        """A factor of the matrix of both equations, for unknowns of these names."""
        matrix, free = self.whole()
        with threads(self.mesh):
            return Lagged(matrix, self.V.ndof, free, names)

    def mobility(self, forces: Float, lasts: float) -> Float:
        """Mean velocities of slow flow by forces, under themselves [m/s].

        Parameters
        ----------
        forces : (k, v, 2)
            Densities, linear, whose integral is of size 1 [1/m2].
        lasts : float
            Time for which the force has acted [s].

        Returns
        -------
        (k,)
            ∫f·u for each.
        """
        eps = self.eps.vec.FV().NumPy().copy()
        none = np.zeros_like(eps)
        self.stirred.vec[:] = 0.0
        self.load(inertia=self.density * eps / lasts, E=eps, S=none, dE=none, dS=none)
        self.load(g=np.zeros((len(eps), 2)))
        matrix, free = self.whole()
        solver, x = SaddleFactor(matrix, self.V.ndof, free), matrix.CreateColVector()
        f, found = x.CreateVector(), []
        for force in forces:
            self.load(f=force)
            f.FV().NumPy()[:] = self.vector("source")
            solver.solve(f, x)
            found.append(float(f.FV().NumPy() @ x.FV().NumPy()))
        return np.array(found)

    def _viscous(self, u: Any, v: Any) -> Any:
        """Eq. (3), with c ρ ε/Δt + B in `inertia`."""
        mu, eps = self.viscosity + self.stirred, self.eps
        return (
            self.inertia * InnerProduct(u, v)
            + 2.0 * mu * eps * InnerProduct(Sym(Grad(u)), Sym(Grad(v)))
            - 2.0 / 3.0 * mu * eps * div(u) * div(v)
        )

    def load(self, **fields: Float) -> None:
        """Set linear fields to values (v,) or (v, 2) at the vertices."""
        for name, values in fields.items():
            getattr(self, name).vec.FV().NumPy()[:] = values.T.ravel()

    def assemble(self) -> None:
        """The matrices for the present fields and places of the vertices."""
        with threads(self.mesh):
            for form in (self.a, self.b, self.s):
                form.Assemble()
        self.blocks = csr(self.a.mat), csr(self.b.mat), csr(self.s.mat)

    def apply(self, x: Float) -> Float:
        """Left sides of (1) and (2) for unknowns (N,)."""
        a, b, s = self.blocks
        u, p = x[: self.V.ndof], x[self.V.ndof :]
        return np.concatenate([a @ u + b.T @ p, b @ u - s @ p])

    @property
    def x(self) -> Float:
        """Unknowns of velocity, then of pressure (N,)."""
        return np.concatenate([self.u.vec.FV().NumPy(), self.p.vec.FV().NumPy()])

    @x.setter
    def x(self, values: Float) -> None:
        split = self.V.ndof
        self.u.vec.FV().NumPy()[:], self.p.vec.FV().NumPy()[:] = values[:split], values[split:]


__all__ = ["Operator"]
