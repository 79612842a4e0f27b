"""The contact law: linear spring-dashpot, Coulomb friction with history, rolling resistance.

Two discs in contact overlap by δ = r_i + r_j - |x_j - x_i|. With n from i to j, the approach speed
v_n = δ', the sliding speed v_t of the surfaces and the rolling speed v_r (Luding, Granular Matter
10 (2008) 235), forces per unit depth are

    f_n = k δ + c v_n                                                                         (1)
    f_t = k_t q + c_t v_t,    q' = v_t,      |f_t| <= mu max(f_n, 0)                            (2)
    f_r = k_t q_r + c_t v_r,  q_r' = v_r,    |f_r| <= mu_r max(f_n, 0)                          (3)

where q and q_r stop growing when the bound is reached. The discs touch where the line of centres
is divided as their radii: the levers of f_t, and of spins in v_t, are r_i |x_j - x_i|/(r_i + r_j),
which conserves angular momentum. f_r makes no force but a torque f_r a with
a = r_i r_j/(r_i + r_j) and v_r = a (w_i - w_j). For a pair of effective mass m the approach is a
damped oscillation, hence (e: restitution, t_c: contact time)

    β = -ln e / sqrt(π² + ln² e),   c = 2 β sqrt(k m),   t_c = π / sqrt((1 - β²) k/m).        (4)

A contact begins and ends inside a step, and leapfrog (`motion`, Eq. 1) sees it at the ends of the
step only. The work of a force is its mean over a step times the way (`motion`, Eq. 3), which for a
spring between two instants in contact is the change of k δ²/2, but not if one of them is outside.
So at the first instant in contact, and at the first out of it, the spring is given that force f
with which it is: with u and u' the approach speeds over the steps before and after, f_d the force
of the dashpot and δ₋, δ, δ₊ the overlaps a step before, now, and a step after,

    f (u + u') Δt = k δ δ₊  as it begins,    -k δ₋ δ  as it ends,     u' = u - (f + f_d) Δt/m.   (5)

Then elastic collisions keep the energy to round-off where n does not turn, else to third order,
and of damped ones all work is accounted for.
With θ the share of that step spent in contact, the dashpot acts for 1/2 + θ steps at the first
instant in contact, and for θ - 1/2 at the first out of it. The law is of second order for all θ.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isfinite, log, pi, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from grainmesh.errors import InputError

Float = NDArray[np.float64]

#: Steps in the shortest contact: recommended, and the fewest that are taken.
STEPS, FEWEST_STEPS = 50, 20


def below(value: float) -> str:
    """A number of three digits that is not above a value, for advice that may be followed."""
    return f"{0.995 * value:.3g}"


@dataclass(frozen=True)
class Contact:
    """Parameters of the contact law, the same for all contacts.

    Parameters
    ----------
    stiffness : float
        k, normal force per unit depth over overlap [N/m2]. Results no longer depend on it if
        overlaps stay below 0.01 r, for which discs of mass m [kg/m] that meet at speed v need some
        m v²/(0.01 r)², and a bed its weight per length of floor, times 2, over 0.01. The run stops
        where overlaps pass 0.3 of the smallest radius: discs of very different size need more.
    restitution : float, optional
        e, 0 < e <= 1; 0.9 if neither this nor `damping` is given.
    damping : float, optional
        Instead of `restitution`: c / m_eff [1/s], the same for all pairs.
    friction : float
        mu >= 0.
    tangential : float
        k_t / k, above 0 and at most 1.
    tangential_damping : float
        c_t / c, 0 to 1.
    rolling : float
        mu_r >= 0, rolling resistance; 0 for none.

    Raises
    ------
    InputError
        If a value is out of its range.
    """

    stiffness: float
    restitution: float | None = None
    damping: float | None = None
    friction: float = 0.3
    tangential: float = 2.0 / 7.0
    tangential_damping: float = 0.5
    rolling: float = 0.0

    def __post_init__(self) -> None:
        if self.restitution is not None and self.damping is not None:
            raise InputError("contact: give restitution or damping, not both")
        if self.restitution is None and self.damping is None:
            object.__setattr__(self, "restitution", 0.9)
        for name, low, high, words in (
            ("stiffness", 0.0, float("inf"), "positive [N/m2]"),
            ("restitution", 0.0, 1.0, "above 0 and at most 1"),
            ("damping", -1e-300, float("inf"), "at least 0 [1/s]"),
            ("friction", -1e-300, float("inf"), "at least 0"),
            ("tangential", 0.0, 1.0, "above 0 and at most 1 (k_t/k)"),
            ("tangential_damping", -1e-300, 1.0, "from 0 to 1 (c_t/c)"),
            ("rolling", -1e-300, float("inf"), "at least 0"),
        ):
            value = getattr(self, name)
            if value is None and name in ("restitution", "damping"):
                continue
            if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
                raise InputError(f"contact: {name} = {value!r} must be a number, {words}")
            if not (isfinite(value) and low < value <= high):
                raise InputError(f"contact: {name} = {value:g} must be {words}")
            object.__setattr__(self, name, float(value))

    def damping_ratio(self, mass: float) -> float:
        """β of Eq. (4) for the effective mass [kg/m]."""
        if self.restitution is not None:
            return -log(self.restitution) / sqrt(pi**2 + log(self.restitution) ** 2)
        assert self.damping is not None
        return 0.5 * self.damping * sqrt(mass / self.stiffness)

    def contact_time(self, mass: float) -> float:
        """t_c [s] of a pair of effective mass m_i m_j/(m_i + m_j) [kg/m], Eq. (4).

        Raises
        ------
        InputError
            If the damping is so strong that the pair would not separate.
        """
        ratio = self.damping_ratio(mass)
        if ratio >= 1.0:
            most = 2.0 * sqrt(self.stiffness / mass)
            raise InputError(
                f"contact: damping {self.damping:g} 1/s is too strong, the heaviest pair would not "
                f"separate: at most {below(most)} 1/s"
            )
        return pi / sqrt((1.0 - ratio**2) * self.stiffness / mass)

    def coefficient(self, mass: Float) -> Float:
        """c [kg/s per m] of pairs of effective masses (l,) [kg/m], Eq. (4)."""
        if self.damping is not None:
            return self.damping * mass
        return 2.0 * self.damping_ratio(1.0) * np.sqrt(self.stiffness * mass)

    def restitution_of(self, mass: float) -> float:
        """Restitution of a pair of effective mass m [kg/m], Eq. (4)."""
        ratio = self.damping_ratio(mass)
        return exp(-pi * ratio / sqrt(1.0 - ratio**2))


@njit(cache=True, forceinline=True)
def bond(o, un, vn, ut, vt, ur, vr, k, kt, pliant, c, ct, mass, mu, mur, q, qr, dt):  # type: ignore[no-untyped-def]
    """Forces of a contact with overlap `o`, Eqs. (1) to (3), (5).

    Speeds of approach (n), sliding (t) and rolling (r) are `u` over the step that ends now and `v`
    now; `q` and `qr` are the springs a step ago, `pliant` is 1/k_t.

    Returns
    -------
    fn, ft, fs, fr, q, qr
        Normal force; sliding force, and what of it is no dashpot's;
        rolling force; springs now.
    """
    if o <= 0.0 or o < un * dt:
        return _begin_or_end(o, un, vn, ut, vt, ur, vr, k, kt, c, ct, mass, mu, mur, q, qr, dt)
    fn = k * o + c * vn
    most = max(fn, 0.0)
    ft, fs, q = slide(q, vt, ut, kt, pliant, ct, mu * most, dt)
    fr = 0.0
    if mur > 0.0:
        fr, _, qr = slide(qr, vr, ur, kt, pliant, ct, mur * most, dt)
    return fn, ft, fs, fr, q, qr


@njit(cache=True)
def _begin_or_end(o, un, vn, ut, vt, ur, vr, k, kt, c, ct, mass, mu, mur, q, qr, dt):  # type: ignore[no-untyped-def]
    """`bond` in the step in which a contact begins or ends, Eq. (5); zeros if there is none."""
    if o <= 0.0:
        before = o - un * dt
        if before <= 0.0:
            return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        fd = (-before / (un * dt) - 0.5) * c * un
        b, d = 2.0 * un - fd * dt / mass, -k / mass * before * o
        fe = mass / dt * 2.0 * d / (b - sqrt(max(b * b - 4.0 * d, 0.0)))  # u < 0
        return fe + fd, 0.0, 0.0, 0.0, 0.0, 0.0
    share = o / (un * dt)
    fd, stiff = (0.5 + share) * c * vn, k * dt / mass * o
    slow = un - fd * dt / mass
    b, d = un + slow + stiff, stiff * (slow + o / dt)
    fe = mass / dt * 2.0 * d / (b + sqrt(max(b * b - 4.0 * d, 0.0)))
    first, now = c * un, max(k * o + c * vn, 0.0)  # normal forces of the law, unweighted
    ft, fs, q = _begin_slide(vt, ut, kt, ct, mu * first, mu * now, share, dt)
    fr = 0.0
    if mur > 0.0:
        fr, _, qr = _begin_slide(vr, ur, kt, ct, mur * first, mur * now, share, dt)
    return fe + fd, ft, fs, fr, q, qr


@njit(cache=True)
def _begin_slide(v, u, k, c, first, most, share, dt):  # type: ignore[no-untyped-def]
    """`slide` in the step in which a contact begins.

    The spring may give way as the discs meet (bound `first`) and again by the end of the step
    (`most`); the force acts as if it went from the one value to the other in a straight line.
    """
    before, spring, q = slide(0.0, u, 0.0, k, 1.0 / k, c, first, dt)
    now, fs, q = slide(q, v, share * u, k, 1.0 / k, c, most, dt)
    old, new = 0.5 * share, 0.5 + 0.5 * share
    return old * before + new * now, old * spring + new * fs, q


@njit(cache=True, forceinline=True)
def slide(q, vt, ut, k, pliant, c, most, dt):  # type: ignore[no-untyped-def]
    """Force, its part that is not the dashpot's, and spring after a step, Eqs. (2), (3).

    `ut` is the speed over the step, `pliant` 1/k. Where the bound is reached all of the force is
    friction: a dashpot that slides with the spring damps nothing.
    """
    held = k * (q + ut * dt) + c * vt
    f = min(max(held, -most), most)  # no branch: the loop over contacts cannot foretell it
    return f, f - c * vt if f == held else f, (f - c * vt) * pliant


__all__ = ["FEWEST_STEPS", "STEPS", "Contact", "below", "bond"]
