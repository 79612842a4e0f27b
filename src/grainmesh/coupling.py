r"""One step of fluid and particles together: the only place where they meet.

Between two steps Δt of the flow the discs collide on their own, in many steps of contacts, while
the fluid acts on disc i with a force that is linear in its velocity. That gives their places and
the impulse J_i of the contacts. Then flow and particle velocities are found at once: per disc of
mass m and volume V, both per unit depth,

    c (u_i' - u_i - J_i/m) = (c - 1) d_i + Δt/m [b (<u'>_i - u_i') - V <∇p'>_i + (m - rho V) g]  (1)

with d_i the last u_i' - u_i - J_i/m and c as in `grainmesh.navier`, Eq. (4). Averages are over the
kernel ψ_i, in which disc i is spread over the vertices v by the shares S_iv of `grainmesh.spread`,

    ψ_i = sum_v S_iv φ_v / h_v,   h_v = ∫φ_v,   <f>_i = ∫ψ_i f,   ε = 1 - sum_i V_i ψ_i,         (2)

so the pressure gradient acts on fluid and discs together as on one medium, and a pressure that
holds up the weight of the fluid alone, left out everywhere, holds up rho V g of each disc. With

    α = 1/(c + b Δt/m),   u* = c (u_i + J_i/m) + (c - 1) d_i + Δt (1 - rho V/m) g,
    u_i' = α [u* + Δt/m (b <u'>_i - V <∇p'>_i)]                                                (3)

the discs are eliminated from the momentum of the fluid, which gains b ψ_i (u_i - u), and from the
volume of the mixture, ∇·(ε u + sum_i V_i ψ_i u_i) = 0:

    B = sum b c α ψ,   f = sum b α u* ψ,   g = sum V α u* ψ,
    E_i = b α (Δt/m) V,   S_i = V² α Δt/m                                                      (4)

in `navier`, Eqs. (1) to (3), and `averaged`, Eq. (1). What the fluid loses is, to round-off, what
the discs get; what the linear solver leaves of the volume of the mixture is owed to the next steps.
(In B the average of u is taken for u, which differs by what has no mean over a kernel.)

While the discs collide, the force is F_i - b_eff (v - u_i): of the last step, less what the
fluid would resist if it were no more than that of the disc's own cell, of mass m_f = rho ε_i A_i,

    b_eff = b m_f/(m_f + b Δt).                                                                (5)

Were the fluid taken as fixed (b_eff = b), contacts would answer to a drag that the fluid gives up
as soon as the disc stops, and a bed with b Δt > m_f would shake itself apart.

A law for the velocity far away is not to see the flow that the disc itself makes, G_i F_i with the
mobility G_i = ∫ψ_i e·u of slow flow u by the force ψ_i e on the same mesh. From F = b (<u> + G F -
u_i),

    F = b/(1 - b G) (<u>_i - u_i).                                                             (6)
"""

from __future__ import annotations

from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from grainmesh import integrals
from grainmesh.averaged import Averaged
from grainmesh.drag import Bed
from grainmesh.errors import RunError
from grainmesh.fields import LEAST_POROSITY, Discs, Fields
from grainmesh.medium import Inflow

Float = NDArray[np.float64]

#: Longest way in a step of a disc against its neighbours, in diameters, and against other points,
#: in distances; Courant number.
WAY, SHARE, COURANT = 1.0 / 7.0, 0.5, 0.5
#: The part of all passing by, speeds summed up, that these hold for.
MOST_PASS = 0.8
#: Reynolds number of a triangle at most: beyond it, viscosity is added.
ROUGH = 200.0
#: Discs whose own flow is computed, where there are more; below so many points, in each step.
SAMPLE, FINE = 16, 1000


class Coupling(Fields):
    """Fluid and particles of a simulation; see `Fields` for parameters and attributes."""

    def steps(self, dt: float, most: int) -> int:
        """How many steps `dt` of contacts the next step of the flow takes, at most `most`."""
        op, corner = self.operator, self.operator.topology.corners
        longest = self.fluid.dt or np.inf
        speed = self.mesh.carried(self.velocity)
        d = float(self.discs.diameter.min())
        fall = float(np.hypot(*self.gravity) + np.hypot(*self.fluid.push) / self.fluid.density)
        if fall > 0.0:
            longest = min(longest, np.sqrt(2.0 * WAY * d / fall))
        if self.fluid.dt is None and fall > 0.0:
            longest = 0.1 * np.sqrt(d / fall)
        passing = integrals.passing(
            corner, op.gradient, op.area, speed, len(self.velocity), WAY * d, SHARE
        )
        if passing.any():  # a few may be faster: their triangles must not turn over
            longest = min(longest, 1.0 / _most(passing, MOST_PASS))
        # How fast flow crosses the triangles around a point. Where viscosity is faster, u² rho/mu
        # takes the place of u/h: it acts implicitly.
        smooth = 0.5 * self.fluid.density / self.fluid.viscosity
        rate = float(
            integrals.crossing(
                corner, op.gradient, op.area, op.u[: len(speed)] - speed,
                float(self.fluid.order**2), smooth,
            )
        )  # fmt: skip
        if rate * dt > 2.0 * COURANT:
            raise RunError(
                f"the flow crosses a triangle of the mesh in {1.0 / rate:.1e} s at "
                f"t = {self.time:g} s, less than a step of the contacts, {dt:.1e} s: give a "
                "smaller Model(dt=...)"
            )
        if rate > 0.0:
            longest = min(longest, COURANT / rate)
        if not np.isfinite(longest):
            longest = most * dt
        # Powers of two that grow reluctantly: the matrix, and its factor, then change less often.
        count = max(1, int(longest / dt + 1e-9))
        power = 1 << (count.bit_length() - 1)
        if power * dt > 1.5 * self.dt > 0.0 and count < 1.2 * power:
            power = max(1, power // 2)
        if self.dt > 0.0:  # BDF2 is stable for ratios to 2.4
            power = min(power, max(1, 2 * round(self.dt / dt)))
        return -(-most // -(-most // power))  # what is left of `most`, in equal parts

    def push(self, dt: float) -> tuple[Float, Float]:
        """Force (n, 2) [N/m] and drag (n, 3) on the discs in the next `dt` [s], Eq. (5).

        The columns of the latter are as of `motion.advance`.
        """
        V, free, r = self.discs.volume, self.discs.inverse, 0.5 * self.discs.diameter
        own = self.fluid.density * np.maximum(self.kernel.area - V, 0.0)  # m_f
        resist = self.drag * own / np.maximum(own + self.drag * dt, 1e-300)
        force = self.force + resist[:, None] * self.velocity
        force = force - self.fluid.density * V[:, None] * self.gravity
        drag = np.zeros((len(V), 3))
        drag[:, 0] = resist * free
        if self.fluid.torque:
            twist = self.fluid.viscosity * np.pi * self.discs.diameter**2
            drag[:, 1] = twist * free * 2.0 / r**2  # I = m r²/2
            drag[:, 2] = twist * 0.5 * self.curl / r
        return force, drag

    def move(self, way: Float) -> bool:
        """Move the discs by (n, 2) [m], unless that would turn a triangle over; whether it did."""
        if self.mesh.move(self._old[: len(way)] + way):
            return True
        self.mesh.points[:] = self._old
        return False

    def solve(self, dt: float, impulse: Float, outside: Float) -> None:
        """Flow and velocities after a step that has moved the discs.

        Parameters
        ----------
        dt : float
            [s]
        impulse : (n, 2)
            J of the contacts [N s/m].
        outside : (n, 2)
            Forces from elsewhere [N/m].

        Raises
        ------
        RunError
            If discs are too dense for the mesh, or the linear solver does not converge.
        """
        op, fluid, discs = self.operator, self.fluid, self.discs
        clock = _Clock(self.seconds)
        omega = dt / self.dt if fluid.scheme == "bdf2" and self.dt > 0.0 else 0.0
        c, c1 = (1.0 + 2.0 * omega) / (1.0 + omega), omega**2 / (1.0 + omega)
        old, new, before = self._old, self.mesh.points, self.kernel
        self.kernel = k = self._kernel()
        clock("kernel")
        m, mass = len(new), op.mass()
        # Convection half-way, Eq. (4) of navier.
        op.at(0.5 * (old + new))
        op.load(eps=0.5 * (before.porosity + k.porosity), w=(new - old) / dt)
        was = op.u.copy()
        ahead = 0.5 * dt / self.dt * self.du if self.dt > 0.0 else 0.0
        C, drained = op.convection(was + ahead)
        mean = self.Q[:m].sum(axis=0) / mass[:m].sum()
        op.at(new)
        self._load_porosity()
        gained = (op.mass() - mass) / dt
        C += mean * (gained - drained)[:, None]  # Eq. (6) of navier
        # The discs, Eqs. (1), (3), (4).
        self.time += dt
        V, free, b = discs.volume, discs.inverse, self._drag(omega)
        added = fluid.added_mass * fluid.density * V * c / dt
        slip = self.around - self.velocity
        known = -(added / c)[:, None] * (c * slip - c1 * self.slid)
        law, b = b, b + added
        alpha = 1.0 / (c + b * dt * free)
        weight = np.where(discs.free, discs.mass - fluid.density * V, 0.0)[:, None] * self.gravity
        push = np.array(fluid.push)
        if self.box.periodic and discs.free.all():  # held up by a mean pressure gradient
            push = push - weight.sum(axis=0) / self.box.area
        own = weight + outside + known + V[:, None] * push
        jump = self.velocity + impulse * free[:, None]
        ahead = c * jump + c1 * self.last + dt * free[:, None] * own  # u*
        ahead[~discs.free] = 0.0
        share = alpha * dt * free
        eps = k.porosity
        if self.dt > 0.0:
            op.u += dt / self.dt * self.du
        self._set_sides()
        op.load(
            inertia=c * fluid.density * eps / dt + k.field(b * c * alpha),
            E=eps,
            f=k.field((b * alpha)[:, None] * ahead - known) + eps[:, None] * push,
            g=k.field((V * alpha)[:, None] * ahead),
        )
        op.averaged = Averaged(k, b * share * V, V**2 * share)
        op.stirred[:] = self._stirred()
        self.added = float(op.stirred.max())
        f = op.source()
        f[: op.split] += ((c * (self.Q + dt * C) + c1 * self.D) / dt).ravel()
        paid = self.owed * (min(1.0, dt / self.span) if self.span > 0.0 else 1.0)
        f[op.split :] += paid / dt
        if fluid.names(Inflow):
            f[op.split :] += op.inflow(self._through)
        clock("rest")
        op.assemble()
        clock("matrix")
        h = np.sqrt(self.box.area / len(op.area))
        resist = fluid.viscosity / h**2 + float(b.sum()) / self.box.area
        unit = h * (c / dt * fluid.density + resist)
        residual = self.solver.solve(op, new, f, unit, fluid.tolerance)
        clock("solve")
        self.du = op.u - was
        self.extra = residual[: op.split].reshape(-1, 2) * dt / c
        self.owed = self.owed - paid + residual[op.split :] * dt
        self.span = max(self.span - dt, dt)  # volume is paid as slowly as it was left
        Q = op.momentum() + self.extra
        self.D = Q - self.Q - dt * C
        self.Q = Q
        # Eq. (3) and the force of the fluid.
        self.around, slope, curl = np.split(k.mean(op.means()), [2, 4], axis=1)
        self.curl = curl[:, 0]
        pull = b[:, None] * self.around - V[:, None] * slope
        found = alpha[:, None] * (ahead + dt * free[:, None] * pull)
        found[~discs.free] = 0.0
        self.force = pull - b[:, None] * found + known + V[:, None] * push
        self.last = found - jump
        self.last[~discs.free] = 0.0
        self.slid = self.around - found - slip
        self.velocity, self.drag, self.dt = found, law, dt
        clock("rest")
        if self.mesh.mend():
            self._remesh()
        self._old = self.mesh.points.copy()
        clock("mesh")

    def _stirred(self) -> Float:
        """Viscosity that keeps the Reynolds number of each triangle below `ROUGH` [Pa s], (t,)."""
        op = self.operator
        flow = op.u[: len(self.mesh.points)] - op.w
        rough = integrals.roughness(op.topology.corners, op.gradient, op.area, flow)
        wanted: Float = self.fluid.density / ROUGH * rough - self.fluid.viscosity
        return np.maximum(wanted, 0.0)

    def _drag(self, omega: float) -> Float:
        """b of the law, for the undisturbed velocity if it is made for that."""
        fluid, discs = self.fluid, self.discs
        across = self.box.size[0 if abs(self.gravity[1]) >= abs(self.gravity[0]) else 1]
        bed = Bed(
            mu=fluid.viscosity,
            rho=fluid.density,
            diameter=discs.diameter,
            porosity=np.maximum(1.0 - discs.volume / self.kernel.area, LEAST_POROSITY),
            area=self.kernel.area,
            slip=self._own_slip(omega),
            gap=self._gap() if fluid.drag.variable == "gap" else np.nan,
            width=np.inf if self.box.periodic else float(across),
        )
        b = fluid.drag.coefficient(bed)
        if not fluid.drag.undisturbed:
            return b
        # Until then it has grown, or each point has got other neighbours.
        old = self.time > 1.2 * self.stirring_since
        old |= self.mesh.flips > self.stirring_flips + len(self.mesh.points)
        if len(self.mesh.points) < FINE or old:
            self.mobility = self._mobility()
            self.stirring_since, self.stirring_flips = self.time, self.mesh.flips
        share = b * self.mobility
        if share.max() > 0.8:
            raise RunError(
                f"particle {int(np.argmax(share))} stirs the fluid about it so much that its own "
                f"flow cannot be taken out ({share.max():.2g} of its velocity): raise "
                "Fluid(reach=...), or take a drag law of beds"
            )
        return b / (1.0 - share)  # Eq. (6)

    def _own_slip(self, omega: float) -> Float:
        """Speed of the fluid against each disc that its law is to see, foretold for BDF2."""
        slip = np.hypot(*(self.around - self.velocity + omega * self.slid).T)
        if self.fluid.drag.undisturbed:  # F = b (U - u_i), Eq. (6)
            slip = slip * (1.0 + self.drag * self.mobility)
        found: Float = slip
        return found

    def _mobility(self) -> Float:
        """G of each disc, Eq. (6); of many, that of some, and for the others their median."""
        n, g, k = len(self.velocity), self.gravity, self.kernel
        some = np.unique(np.linspace(0, n - 1, min(n, SAMPLE)).astype(int))
        one = np.zeros((len(some), n))
        one[np.arange(len(some)), some] = 1.0
        along = g / np.hypot(*g) if g.any() else np.array([1.0, 0.0])
        psi = np.stack([k.field(row) for row in one])
        # From rest it takes until then; all forces are taken to act since the start.
        lasts = self.fluid.density * float(self.box.size.min()) ** 2 / self.fluid.viscosity
        lasts = min(lasts, self.time)
        found = self.operator.mobility(psi[..., None] * along, lasts)
        G = np.full(n, np.median(found))
        G[some] = found
        return G

    def _gap(self) -> float:
        """Mean of the smallest gap of each triangle of discs, over the mean diameter."""
        n, r = len(self.velocity), 0.5 * self.discs.diameter
        full = (self.mesh.triangles < n).all(axis=1)
        if not full.any():
            return np.nan
        corner, place = self.mesh.triangles[full], self._corners()[full]
        length = np.hypot(*(np.roll(place, -1, axis=1) - place).T).T
        gap = length - r[corner] - r[np.roll(corner, -1, axis=1)]
        return float(gap.min(axis=1).mean() / self.discs.diameter.mean())


def _most(rates: Float, part: float) -> float:
    """The rate at which rates, summed up from the smallest, come to this part of their sum."""
    rest, level = (1.0 - part) * float(rates.sum()), float(rates.mean())
    while (larger := rates[rates > level]).sum() > rest:  # to sort few
        rates, level = larger, 2.0 * level
    rates = np.sort(rates)[::-1]
    beyond = int((rates.cumsum() <= rest).sum())
    return float(rates[min(beyond, len(rates) - 1)])


class _Clock:
    """Adds the time since the last call to an entry."""

    def __init__(self, seconds: dict[str, float]) -> None:
        self.seconds, self.last = seconds, perf_counter()

    def __call__(self, name: str) -> None:
        now = perf_counter()
        self.seconds[name] += now - self.last
        self.last = now


__all__ = ["Coupling", "Discs"]
