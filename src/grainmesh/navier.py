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
next step, so momentum is conserved to round-off at any tolerance; so is the volume that (2) moves,
whose residual, times Δt, is owed to the next step.

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

from grainmesh import averaged, integrals
from grainmesh.averaged import Averaged
from grainmesh.carry import Keys, Topology, unknowns
from grainmesh.element import (
    at_edges,
    at_rule,
    divergences,
    element,
    hats,
    masses,
    slopes,
    tilts,
)
from grainmesh.fronts import Fronts, both
from grainmesh.lagged import gmres, norm

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Mask = NDArray[np.bool_]

#: Residual of the flow by single forces.
MOBILITY_TOLERANCE, MOST = 1e-9, 40
#: Triangles in half of a mesh from which on both halves are done at once.
MANY = 4000
#: Pivot of `fronts`, Eq. (2), where each patch of triangles has pressures without a level.
CLOSED = 1e-5


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
    corners : (t, 3, 2)
        Where the corners of the triangles are [m].
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
    memory : (any,)
        Where the matrices are; the next operator may have it, since new memory costs as much time.
    free : (N,)
        Unknowns, u_x and u_y in turn and then p, that are solved for.
    floating : bool
        Nothing gives the pressure a level.
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
        # What a loop over the triangles needs at a point lies together.
        self.fields = fields = np.zeros((m, 10))
        self.w, self.f, self.g = fields[:, :2], fields[:, 6:8], fields[:, 8:]
        self.eps, self.inertia, self.E, self.S = fields[:, 2:6].T
        self.averaged: Averaged | None = None
        self.stirred, self.memory = np.zeros(t), np.empty(0)
        outer, inner = 3 * order, own.rows.shape[1] - 3 * order
        self.rows = unknowns(own, other, outer)
        self.outer = self.rows.shape[1] - 2 * inner
        self.floating = level is None or not level.any()
        self.free = np.ones(self.split + other.size, dtype=bool)
        self.free[: 2 * m] = np.repeat(topology.used, 2)
        self.free[self.split : self.split + m] = topology.used
        self.within = np.zeros_like(self.free)  # the inner unknowns
        self.within[self.split - 2 * t * inner : self.split] = True
        for given, at in ((held, slice(None, self.split)), (level, slice(self.split, None))):
            if given is not None:
                self.free[at] &= ~given.ravel()
        self.at(points)

    def at(self, points: Float) -> None:
        """Move the points to (m, 2) [m]."""
        self.corners = self.topology.places(points)
        self.gradient, self.area = integrals.gradients(self.corners)

    def load(self, **fields: Float) -> None:
        """Set linear fields to values (m,) or (m, 2) at the points."""
        for name, values in fields.items():
            getattr(self, name)[:] = values

    # --- load vectors -------------------------------------------------------------------------

    def momentum(self) -> Float:
        """∫ρ ε u·v, (size, 2)."""
        on = self.topology.corners, self.keys.rows, self.area
        eps, M = self.fields[:, 2:3], masses(self.keys.element)
        found: Float = integrals.weighted(*on, eps, self.u, M)
        return self.density * found

    def mass(self) -> Float:
        """∫ρ ε v for each component, (size,)."""
        return self.density * self._spread(self.eps[:, None])[:, 0]

    def _spread(self, f: Float) -> Float:
        """∫f φ of a linear field (m, c), (size, c)."""
        table = hats(self.keys.element)
        found: Float = integrals.spread(*self._on_u, f, table, self.keys.size)
        return found

    def convection(self, e: Float) -> tuple[Float, Float]:
        """C of a velocity e (size, 2), and what of R is not the change of mass (size,)."""
        one = self.keys.element
        found = integrals.convected(
            self.topology.corners, self.keys.rows, self.gradient, self.area, self.fields[:, :3], e,
            *at_rule(one, 3 * one.degree),
        )  # fmt: skip
        C, drained = found[:, :2], found[:, 2]
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
        q = at_edges(self.pressure_keys.element, 2 * self.order)[1]
        found = np.zeros(self.pressure_keys.size)
        through = (flux * normal).sum(axis=2)
        t, k = self.inlets.T
        np.add.at(found, self.pressure_keys.rows[t], np.einsum("bq,bql->bl", through, q[k]))
        return found

    def along(self, edges: Int, values: Float, keys: Keys, eps: Float | None = None) -> Float:
        """∫ds of fields (size, c) along edges, times ε if given, (c,)."""
        places, shape, weight = at_edges(keys.element, 2 * self.order)
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
        places, shape, weight = at_edges(self.keys.element, degree)
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

    def means(self) -> Float:
        """Integrals of u, ∇p and ∇×u times the hats of the points (m, 5)."""
        one, other = self.keys.element, self.pressure_keys.element
        found: Float = integrals.averages(
            self.topology.corners, self.keys.rows, self.pressure_keys.rows, self.gradient,
            self.area, self.u, self.p[:, None], len(self.eps),
            hats(one), tilts(one), tilts(other),
        )  # fmt: skip
        return found

    # --- the matrix ---------------------------------------------------------------------------

    def assemble(self) -> None:
        """The matrices of the triangles for the present fields and places of the points."""
        (t, n), left = self.rows.shape, self.outer
        split, size = t * left**2, t * (left**2 + (n - left) * n)
        if len(self.memory) < size:
            self.memory = np.empty(size + size // 16)
        self.K = self.memory[:split].reshape(t, left, left)
        self.inner = self.memory[split:size].reshape(t, n - left, n)
        self._matrices(slice(None), self.K, self.inner)

    def _matrices(self, which: Mask | slice, K: Float, inner: Float) -> None:
        """Of some triangles, into K and `inner`."""
        one, other = self.keys.element, self.pressure_keys.element
        integrals.matrices(
            self.topology.corners[which], self.gradient[which], self.area[which], 3 * self.order,
            self.fields[:, 2:6], self.viscosity + self.stirred[which],
            masses(one), slopes(one), divergences(one, other), slopes(other), K, inner,
        )  # fmt: skip

    def close(self, volume: Float, around: Mask) -> None:
        """Change u around points (m,) so that it has volume again, Eq. (7).

        Parameters
        ----------
        volume : (size of p,)
            What ∫ε u·∇q is to be.
        around : (m,) bool
        """
        corner, n, left = self.topology.corners.T, self.rows.shape[1], self.outer
        patch: Mask = around[corner[0]] | around[corner[1]] | around[corner[2]]
        near = np.zeros(len(around), bool)
        near[corner[:, patch]] = True
        # All that the pressures of the patch see.
        wide: Mask = near[corner[0]] | near[corner[1]] | near[corner[2]]
        sought, beyond = np.zeros((2, len(self.free)), bool)
        sought[self.rows[patch, :left]] = True
        beyond[self.rows[~patch]] = True
        beyond[self.split :] = False
        sought &= self.free & ~beyond
        K, rows = np.empty((np.count_nonzero(wide), n, n)), self.rows[wide]
        self._matrices(wide, K, K[:, :0])
        u, f = self.x, np.zeros(len(self.free))
        u[self.split :] = 0.0
        f[self.split :] = volume - integrals.product(K, rows, u)[self.split :]
        rows = self.rows[patch]
        K, inner = np.empty((len(rows), left, left)), np.empty((len(rows), n - left, n))
        self._matrices(patch, K, inner)
        corners = self.corners[patch]
        x = Fronts(K, rows[:, :left], sought, self.split, corners, pivot=CLOSED).solve(f)
        integrals.completed(inner, rows, np.zeros_like(f), x)
        self.u += x[: self.split].reshape(-1, 2)

    def apply(self, x: Float) -> Float:
        """Left sides of (1) and (2) for unknowns (N,), those inside of triangles eliminated."""
        discs, slope, force = self.averaged, np.empty(0), np.empty(0)
        if discs is not None:
            slope = discs.kernel.mean(self._slopes(x))
            force = discs.force(slope)

        def part(some: slice) -> tuple[Float, Float]:
            y, u = integrals.product(self.K[some], self.rows[some], x), np.empty(0)
            if discs is not None:
                u = averaged.within(
                    self.inner[some], self.rows[some], self.outer, x, y,
                    self.topology.corners[some], self.area[some], force,
                    hats(self.keys.element), self.order,
                )  # fmt: skip
            return y, u

        half = len(self.K) // 2
        pair = both(part, (slice(0, half),), (slice(half, None),), half > MANY)
        found: Float = pair[0][0] + pair[1][0]
        if discs is not None:
            u = discs.kernel.mean(pair[0][1] + pair[1][1])
            found[self.split :] += self._spilled(discs.flux(u, slope))
        return found

    def condensed(self, f: Float) -> Float:
        """Right sides (N,) for `apply`."""
        found, discs = self._condensed(f), self.averaged
        if discs is not None and self.outer < self.rows.shape[1]:
            x = np.zeros_like(f)
            integrals.completed(self.inner, self.rows, found, x)
            on, u = self._on_u, x[: self.split].reshape(-1, 2)
            u = discs.kernel.mean(averaged.moments(*on, u, hats(self.keys.element), len(self.eps)))
            found[self.split :] -= self._spilled(discs.flux(u, np.zeros_like(u)))
        return found

    def completed(self, f: Float, x: Float) -> None:
        """Put the unknowns inside of triangles into x; f is of `condensed`."""
        discs = self.averaged
        if discs is not None and self.outer < self.rows.shape[1]:
            force = discs.force(discs.kernel.mean(self._slopes(x)))
            f = f - self._condensed(self._loads(force))
        integrals.completed(self.inner, self.rows, f, x)

    def _condensed(self, f: Float) -> Float:
        """Of K alone."""
        found: Float = integrals.condensed(self.inner, self.rows, f)
        return found

    def _slopes(self, x: Float) -> Float:
        """∫φ_v ∇p (m, 2)."""
        found: Float = averaged.slopes(
            *self._on_p, x[self.split :], tilts(self.pressure_keys.element), len(self.eps)
        )
        return found

    def _loads(self, f: Float) -> Float:
        """∫f·v of a linear field (m, 2), (N,)."""
        found = np.zeros(len(self.free))
        found[: self.split] = self._spread(f).ravel()
        return found

    def _spilled(self, g: Float) -> Float:
        """∫g·∇q of a linear field (m, 2), (size of p,)."""
        found: Float = averaged.spilled(
            *self._on_p, g, tilts(self.pressure_keys.element), self.pressure_keys.size
        )
        return found

    @property
    def _on_u(self) -> tuple[Int, Int, Float]:
        return self.topology.corners, self.keys.rows, self.area

    @property
    def _on_p(self) -> tuple[Int, Int, Float, Float]:
        return self.topology.corners, self.pressure_keys.rows, self.gradient, self.area

    @property
    def sought(self) -> Mask:
        """Unknowns that are free and not inside of triangles (N,)."""
        return self.free & ~self.within

    def factor(self, inside: Mask | None = None) -> Fronts:
        """A factor of K for the unknowns sought, or those `inside`.

        Where nothing gives the pressure a level, the first one is taken as 0.
        """
        K, rows, corners, sought = self.K, self.rows, self.corners, self.sought
        if inside is not None:
            some, sought = np.any(inside[rows[:, : self.outer]], axis=1), inside
            K, rows, corners = K[some], rows[some], corners[some]
        pressure = self.split + np.flatnonzero(self.free[self.split :])
        if self.floating and sought[pressure].all():
            sought = sought.copy()
            sought[pressure[0]] = False
        return Fronts(K, rows[:, : self.outer], sought, self.split, corners)

    @property
    def diagonal(self) -> Float:
        """Of K, and for pressures about that of -S - B A⁻¹ Bᵀ (N,)."""
        found: Float = integrals.diagonal(self.K, self.rows, self.split, len(self.free))
        return found

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
        self.averaged = None
        self.load(inertia=self.density * self.eps / lasts, E=self.eps, S=none)
        self.load(g=np.zeros_like(self.g))
        self.assemble()
        sought, found, precondition = self.sought, [], self.factor().solve
        for force in forces:
            self.load(f=force)
            whole = self.source()
            f = self.condensed(whole)
            goal = MOBILITY_TOLERANCE * norm(f[sought])
            x, _, rest = gmres(
                lambda z: self.apply(z) * sought, precondition, f * sought, goal, MOST
            )
            left = norm(rest)
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
