r"""Porosity-scaled Navier-Stokes equations on a mesh that moves: one implicit step.

With porosity ε, interstitial velocity u, dynamic pressure p and velocity w of the mesh, velocity
test functions v and pressure test functions q,

    d/dt ∫ρ ε u·v + a(u, v) + ∫E ∇p·v = ∫ρ ε u·((u - w)·∇)v + ∫f·v                             (1)
    ∫E u·∇q - ∫S ∇p·∇q = -∫g·∇q + ∮q ε u·n                                                     (2)
    a(u, v) = ∫B u·v + ∫2 mu ε D(u):D(v) - 2/3 mu ε ∇·u ∇·v                                    (3)

where v moves with the mesh, so that (1) conserves momentum; B, f and g come from the particles
(`grainmesh.coupling`), as do products of averages (`grainmesh.averaged`) on the left; but for those
E = ε and S = 0. A step Δt is

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

With the averages, L, the matrix is K + L; K alone is stored, and factored. Unknowns β inside of
triangles are eliminated from both: L joins them to pressures only, so with x the others

    K_ββ β = f_β - (K + L)_βx x                                                                (5)

is solved triangle by triangle.

After a flip, u interpolated to the new triangles has not the volume that it had. The pressure that
would mend it, a push that discs feel for one step, is taken out before: on the triangles around
what has changed, with discs as they are and nothing changed beyond, nor at outlets,

    ∫ρ ε/Δt δ·v + a(δ, v) + ∫ε ∇π·v = 0,   ∫ε (u + δ)·∇q = what (2) says.                      (7)

The elements are Taylor-Hood P_k/P_{k-1}, MINI for k = 1, on straight triangles, where all integrals
are exact. Matrices are kept triangle by triangle, which costs nothing anew when edges flip, and the
unknowns inside of triangles are eliminated there. What is left is symmetric, an L D Lᵀ of K serves
as preconditioner until too much has changed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from grainmesh import averaged, integrals
from grainmesh.averaged import Averaged, hats
from grainmesh.carry import Keys, Topology
from grainmesh.element import (
    Element,
    divergences,
    edge_rule,
    element,
    masses,
    rule,
    slopes,
)
from grainmesh.lagged import Lagged, gmres, norm

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Mask = NDArray[np.bool_]

HATS = Element(1)
#: Residual of the flow by single forces.
MOBILITY_TOLERANCE, MOST = 1e-9, 40


class Operator:
    """Equations (1) to (3) on one triangulation; its points may move.

    Parameters
    ----------
    topology : Topology
    points : (m, 2)
        [m]
    order : int
        k >= 1.
    viscosity, density : float
        [Pa s], [kg/m3].
    held : (size, 2) bool, optional
        Unknowns of the velocity that are given.
    level : (size,) bool, optional
        Unknowns of the pressure that are given.
    outlets, inlets : (b, 2) int, optional
        Edges through which momentum leaves, and through which a given flow comes in: numbers of a
        triangle, and 0, 1 or 2 for its edge 01, 02 or 12, corners rising.

    Attributes
    ----------
    keys, pressure_keys : Keys
        Where the unknowns live.
    u, p : (size, 2), (size,)
        Unknowns of velocity [m/s] and pressure [Pa].
    eps, inertia, E, S : (m,)
        Linear fields: porosity, c ρ ε/Δt + B, and those of Eqs. (1), (2).
    f, g, w : (m, 2)
        Linear fields: those of Eqs. (1), (2), and the velocity of the mesh.
    averaged : Averaged, optional
        The discs.
    stirred : (t,)
        Viscosity besides mu [Pa s].
    free : (N,)
        Unknowns, u_x and u_y in turn and then p, that are solved for.
    """

    def __init__(
        self,
        topology: Topology,
        points: Float,
        order: int,
        viscosity: float,
        density: float,
        held: Mask | None = None,
        level: Mask | None = None,
        outlets: Int | None = None,
        inlets: Int | None = None,
    ) -> None:
        self.topology, self.order = topology, order
        self.viscosity, self.density = viscosity, density
        self.keys = Keys(topology, element(order, order == 1))
        self.pressure_keys = Keys(topology, element(max(order - 1, 1)))
        none = np.empty((0, 2), np.int64)
        self.outlets = none if outlets is None else outlets
        self.inlets = none if inlets is None else inlets
        m, t = topology.count, len(topology.triangles)
        own, other = self.keys, self.pressure_keys
        self.split = 2 * own.size
        self.u, self.p = np.zeros((own.size, 2)), np.zeros(other.size)
        self.eps, self.inertia, self.E, self.S = np.zeros((4, m))
        self.averaged = Averaged(csr_array((0, m)), np.empty(0), np.empty(0))
        self.f, self.g, self.w = np.zeros((3, m, 2))
        self.stirred = np.zeros(t)
        # u of the outer unknowns of a triangle, p, and the rest of u
        outer, rows = 3 * order, own.rows
        both = 2 * rows[..., None] + np.arange(2)
        self.outer = 2 * outer + other.rows.shape[1]
        self.rows = np.concatenate(
            [
                both[:, :outer].reshape(t, -1),
                self.split + other.rows,
                both[:, outer:].reshape(t, -1),
            ],
            axis=1,
        )
        self.free = np.zeros(self.split + other.size, dtype=bool)
        self.free[self.rows] = True
        self.within = np.zeros_like(self.free)  # the inner unknowns
        self.within[self.rows[:, self.outer :]] = True
        for given, at in ((held, slice(None, self.split)), (level, slice(self.split, None))):
            if given is not None:
                self.free[at] &= ~given.ravel()
        self.at(points)

    def at(self, points: Float) -> None:
        """Move the points to (m, 2) [m]."""
        self.gradient, self.area = integrals.gradients(self.topology.places(points))

    def load(self, **fields: Float) -> None:
        """Set linear fields to values (m,) or (m, 2) at the points."""
        for name, values in fields.items():
            getattr(self, name)[:] = values

    # --- load vectors -------------------------------------------------------------------------

    def momentum(self) -> Float:
        """∫ρ ε u·v, (size, 2)."""
        return self.density * self._weighted(self.u)

    def mass(self) -> Float:
        """∫ρ ε v for each component, (size,)."""
        one = np.zeros((self.keys.size, 1))
        one[: len(self.eps)] = 1.0
        return self.density * self._weighted(one)[:, 0]

    def _weighted(self, u: Float) -> Float:
        on = self.topology.corners, self.keys.rows, self.area
        found: Float = integrals.weighted(*on, self.eps, u, masses(self.keys.element))
        return found

    def convection(self, e: Float) -> tuple[Float, Float]:
        """C of a velocity e (size, 2), and what of R is not the change of mass (size,)."""
        one = self.keys.element
        places, weight = rule(3 * one.degree)
        C, drained = integrals.convected(
            self.topology.corners, self.keys.rows, self.gradient, self.area, self.eps, e, self.w,
            places, one.shape(places), one.slope(places), weight,
        )  # fmt: skip
        if len(self.outlets):  # what flows in has the mean velocity, by Eq. (6)
            velocity, eps, normal, shape = self._at_sides(self.outlets, e, 3 * self.order + 1)
            out = eps * np.maximum((velocity * normal).sum(axis=2), 0.0)
            rows = self.keys.rows[self.outlets[:, 0]]
            np.subtract.at(drained, rows, np.einsum("bq,bql->bl", out, shape))
            np.subtract.at(C, rows, np.einsum("bq,bqc,bql->blc", out, velocity, shape))
        return self.density * C, self.density * drained

    def inflow(self, given: Float) -> Float:
        """∮q ε u·n of a given superficial velocity ε u (size, 2), (size of p,)."""
        flux, _, normal, _ = self._at_sides(self.inlets, given, 2 * self.order)
        places = edge_rule(2 * self.order)[0]
        q = self.pressure_keys.element.shape(places.reshape(-1, 3)).reshape(*places.shape[:2], -1)
        found = np.zeros(self.pressure_keys.size)
        through = (flux * normal).sum(axis=2)
        t, k = self.inlets.T
        np.add.at(found, self.pressure_keys.rows[t], np.einsum("bq,bql->bl", through, q[k]))
        return found

    def along(self, edges: Int, values: Float, keys: Keys, eps: Float | None = None) -> Float:
        """∫ds of fields (size, c) along edges, times ε if given, (c,)."""
        places, weight = edge_rule(2 * self.order)
        shape = keys.element.shape(places.reshape(-1, 3)).reshape(*places.shape[:2], -1)
        one = np.ones(len(self.eps)) if eps is None else eps
        found, e, normal = integrals.at_sides(
            edges, self.topology.corners, keys.rows, self.gradient, self.area, one, values,
            places, shape, weight,
        )  # fmt: skip
        ds = np.hypot(normal[..., 0], normal[..., 1])
        total: Float = (e[..., None] * ds[..., None] * found).sum(axis=(0, 1))
        return total

    def _at_sides(self, edges: Int, u: Float, degree: int) -> tuple[Float, Float, Float, Float]:
        """Velocity, ε, n ds and shape functions on edges (b, q, ...)."""
        places, weight = edge_rule(degree)
        shape = self.keys.element.shape(places.reshape(-1, 3)).reshape(*places.shape[:2], -1)
        velocity, eps, normal = integrals.at_sides(
            edges, self.topology.corners, self.keys.rows, self.gradient, self.area, self.eps, u,
            places, shape, weight,
        )  # fmt: skip
        return velocity, eps, normal, shape[edges[:, 1]]

    def source(self) -> Float:
        """Right sides of (1) and (2) by f and g, (N,)."""
        found = self._loads(self.f)
        found[self.split :] = -self._spilled(self.g)
        return found

    def means(self) -> tuple[Float, Float, Float]:
        """Integrals of u (m, 2), ∇p (m, 2) and ∇×u (m,) times the hats of the points."""
        one, other = self.keys.element, self.pressure_keys.element
        places, weight = rule(one.degree + 1)
        found = integrals.averages(
            self.topology.corners, self.keys.rows, self.pressure_keys.rows, self.gradient,
            self.area, self.u, self.p, len(self.eps),
            places, one.shape(places), one.slope(places), other.slope(places), weight,
        )  # fmt: skip
        return found[:, :2], found[:, 2:4], found[:, 4]

    # --- the matrix ---------------------------------------------------------------------------

    def assemble(self) -> None:
        """The matrices of the triangles for the present fields and places of the points."""
        self.K = self._matrices(slice(None))
        integrals.condense(self.K, self.outer)

    def _matrices(self, which: Mask | slice) -> Float:
        """Of some triangles, nothing eliminated."""
        one, other = self.keys.element, self.pressure_keys.element
        found: Float = integrals.matrices(
            self.topology.corners[which], self.gradient[which], self.area[which], 3 * self.order,
            self.inertia, self.eps, self.viscosity + self.stirred[which], self.E, self.S,
            masses(one), slopes(one), divergences(one, other), slopes(other),
        )  # fmt: skip
        return found

    def close(self, volume: Float, around: Mask) -> None:
        """Change u around points (m,) so that it has volume again, Eq. (7).

        Parameters
        ----------
        volume : (size of p,)
            What ∫ε u·∇q is to be.
        around : (m,) bool
        """
        corner = self.topology.corners
        patch: Mask = np.any(around[corner], axis=1)
        near = np.zeros(len(around), bool)
        near[corner[patch]] = True
        wide: Mask = np.any(near[corner], axis=1)  # all that the pressures of the patch see
        inside = np.zeros_like(self.free)
        inside[self.rows[patch]] = True
        beyond = np.zeros_like(self.free)
        beyond[self.rows[~patch]] = True
        beyond[self.split :] = False
        inside &= self.free & ~beyond
        K, rows, f = self._matrices(wide), self.rows[wide], np.zeros(len(self.free))
        u = self.x
        u[self.split :] = 0.0
        np.subtract.at(f, rows, np.einsum("tij,tj->ti", K, u[rows]))
        f[self.split :] += volume
        f[: self.split] = 0.0
        K, rows = K[patch[wide]], self.rows[patch]
        integrals.condense(K, self.outer)
        sought, names = inside & ~self.within, np.arange(len(inside))
        factor = Lagged(K, rows[:, : self.outer], sought, self.split, names)
        x = factor.preconditioner(np.where(sought, names, -1))(f)
        integrals.completed(K, rows, np.zeros_like(f), x, self.outer)
        self.u += x[: self.split].reshape(-1, 2)

    def apply(self, x: Float) -> Float:
        """Left sides of (1) and (2) for unknowns (N,), those inside of triangles eliminated."""
        slope = self._slopes(x)
        found, u = self._product(x, self.averaged.force(slope))
        found[self.split :] += self._spilled(self.averaged.flux(u, slope))
        return found

    def stored(self, x: Float) -> Float:
        """The same without averages: what a factor is of."""
        return self._product(x, np.zeros_like(self.f))[0]

    def _product(self, x: Float, f: Float) -> tuple[Float, Float]:
        """K x with ∫f·v besides (N,), f linear (m, 2), and ∫φ_v u of it (m, 2)."""
        on, between = (self.topology.corners, self.area), self.pressure_keys.rows.shape[1]
        about = *on, f, self._hats[0], self.order, between
        found: tuple[Float, Float] = averaged.product(self.K, self.rows, x, self.outer, *about)
        return found

    def condensed(self, f: Float) -> Float:
        """Right sides (N,) for `apply`."""
        found: Float = integrals.condensed(self.K, self.rows, f, self.outer)
        x = np.zeros_like(f)
        integrals.completed(self.K, self.rows, found, x, self.outer)
        on, u = self._on_u, x[: self.split].reshape(-1, 2)
        u = averaged.moments(*on, u, self._hats[0], len(self.eps))
        found[self.split :] -= self._spilled(self.averaged.flux(u, np.zeros_like(u)))
        return found

    def completed(self, f: Float, x: Float) -> None:
        """Put the unknowns inside of triangles into x; f is of `condensed`."""
        force = self._loads(self.averaged.force(self._slopes(x)))
        f = f - integrals.condensed(self.K, self.rows, force, self.outer)
        integrals.completed(self.K, self.rows, f, x, self.outer)

    def _slopes(self, x: Float) -> Float:
        """∫φ_v ∇p (m, 2)."""
        found: Float = averaged.slopes(*self._on_p, x[self.split :], self._hats[1], len(self.eps))
        return found

    def _loads(self, f: Float) -> Float:
        """∫f·v of a linear field (m, 2), (N,)."""
        found = np.zeros(len(self.free))
        on = *self._on_u, f, self._hats[0], self.keys.size
        found[: self.split] = averaged.loads(*on).ravel()
        return found

    def _spilled(self, g: Float) -> Float:
        """∫g·∇q of a linear field (m, 2), (size of p,)."""
        found: Float = averaged.spilled(*self._on_p, g, self._hats[1], self.pressure_keys.size)
        return found

    @property
    def _on_u(self) -> tuple[Int, Int, Float]:
        return self.topology.corners, self.keys.rows, self.area

    @property
    def _on_p(self) -> tuple[Int, Int, Float, Float]:
        return self.topology.corners, self.pressure_keys.rows, self.gradient, self.area

    @property
    def _hats(self) -> tuple[Float, Float]:
        return hats(self.keys.element, self.pressure_keys.element)

    @property
    def sought(self) -> Mask:
        """Unknowns that are free and not inside of triangles (N,)."""
        return self.free & ~self.within

    def factor(self, names: Int, inside: Mask | None = None) -> Lagged:
        """A factor of the matrix for the unknowns sought, or those `inside`, by their names."""
        rows = self.rows[:, : self.outer]
        if inside is None:
            return Lagged(self.K, rows, self.sought, self.split, names)
        there = inside[rows].any(axis=1)
        return Lagged(self.K[there], rows[there], inside, self.split, names)

    @property
    def names(self) -> Int:
        """Names of the unknowns of u and p (N,), the same on any triangulation of the points."""
        u, p = 3 * self.keys.names, 3 * self.pressure_keys.names
        return np.concatenate([np.stack([u, u + 1], axis=1).ravel(), p + 2])

    def mobility(self, forces: Float, lasts: float) -> Float:
        """Mean velocities of slow flow by forces, under themselves [m/s].

        Parameters
        ----------
        forces : (k, m, 2)
            Densities, linear, whose integral is of size 1 [1/m2].
        lasts : float
            Time for which the force has acted [s].

        Returns
        -------
        (k,)
            ∫f·u for each.
        """
        none = np.zeros_like(self.eps)
        self.stirred[:] = 0.0
        self.averaged = Averaged(csr_array((0, len(none))), np.empty(0), np.empty(0))
        self.load(inertia=self.density * self.eps / lasts, E=self.eps, S=none)
        self.load(g=np.zeros_like(self.g))
        self.assemble()
        names, sought, found = np.arange(len(self.free)), self.sought, []
        precondition = self.factor(names).preconditioner(np.where(sought, names, -1))
        for force in forces:
            self.load(f=force)
            whole = self.source()
            f = self.condensed(whole)
            goal = MOBILITY_TOLERANCE * norm(f[sought])
            x, _, left = gmres(
                lambda z: self.apply(z) * sought, precondition, f * sought, goal, MOST
            )
            if left > goal:
                raise RuntimeError(
                    f"linear solver: residual {left / goal * MOBILITY_TOLERANCE:.1e}"
                )
            self.completed(f, x)
            found.append(float(whole @ x))
        return np.array(found)

    @property
    def x(self) -> Float:
        """Unknowns of velocity, u_x and u_y in turn, then of pressure (N,)."""
        return np.concatenate([self.u.ravel(), self.p])

    @x.setter
    def x(self, values: Float) -> None:
        self.u[:], self.p[:] = values[: self.split].reshape(-1, 2), values[self.split :]


__all__ = ["Operator"]
