"""Check discrete elements against theory, rewrite the table of dem.md: ``python docs/dem.py``.

Every case runs `grainmesh.Simulation` and is set against a closed form, or against `Reference`: the
same law solved by SciPy's DOP853 to 1e-10, its changes between sticking and sliding as events.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import grainmesh as gm

BEGIN, END = "<!-- table: python docs/dem.py -->", "<!-- end of table -->"
G, D, RHO = 9.81, 0.01, 2500.0  # gravity [m/s2], diameter [m], density [kg/m3]
MASS = RHO * np.pi * D**2 / 4.0  # [kg/m]
BOX = gm.Box(0.4, 0.4)


@dataclass(frozen=True)
class Row:
    """One line of the table; `found` differs from `expected` by at most `within`."""

    case: str
    what: str
    expected: float
    found: float
    within: float

    @property
    def off(self) -> float:
        """Difference: all quantities are of order 1."""
        return abs(self.found - self.expected)


Rows = Iterator[Row]


class Reference:
    """Two discs, or a disc (the first) on a floor at y = 0, by the law of `grainmesh.contact`.

    State: centres, velocities, spins of both and the sliding spring q. Start just as they touch.
    """

    def __init__(self, law, mass, radius, floor=False, gravity=0.0):
        self.law, self.m, self.r, self.floor, self.g = law, np.array(mass), radius, floor, gravity
        m = mass[0] if floor else mass[0] * mass[1] / (mass[0] + mass[1])
        self.k, self.kt = law.stiffness, law.tangential * law.stiffness
        self.c = float(law.coefficient(np.array([m]))[0])
        self.ct, self.time = law.tangential_damping * self.c, law.contact_time(m)

    def kinematics(self, z):
        """Overlap, normal from the first to the second, speeds of approach and sliding, lever."""
        x, v, w = z[:4].reshape(2, 2), z[4:8].reshape(2, 2), z[8:10]
        n, overlap, lever = np.array([0.0, -1.0]), self.r[0] - x[0, 1], 1.0
        if not self.floor:
            n = x[1] - x[0]
            distance, reach = np.hypot(*n), self.r[0] + self.r[1]
            n, overlap, lever = n / distance, reach - distance, distance / reach
        u = v[0] - v[1]
        slide = n[0] * u[1] - n[1] * u[0] + lever * (self.r[0] * w[0] + self.r[1] * w[1])
        return overlap, n, u @ n, slide, lever

    def rate(self, z, sign):
        """Time derivative, and forces; sign 0: sticks, else slides, its spring slaved."""
        overlap, n, vn, vt, lever = self.kinematics(z)
        fn = self.k * overlap + self.c * vn
        most = self.law.friction * max(fn, 0.0)
        ft = sign * most if sign else self.kt * z[10] + self.ct * vt
        push = fn * n + ft * np.array([-n[1], n[0]])
        a = np.array([-push / self.m[0], push / self.m[1]])
        if self.floor:
            a[1] = 0.0
        a[0, 1] -= self.g
        spin = -2.0 * lever * ft / (self.m * np.array(self.r))  # I = m r²/2
        if self.floor:
            spin[1] = 0.0
        return np.concatenate([z[4:8], a.ravel(), spin, [0.0 if sign else vt]]), fn, ft, vt

    def excess(self, z, sign):
        """Sticking: force over its bound. Sliding: rate at which the bound is being exceeded."""
        dz, fn, ft, vt = self.rate(z, sign)
        if not sign:
            return abs(ft) - self.law.friction * max(fn, 0.0)
        if fn <= 0.0 or self.law.friction == 0.0:
            return 1.0
        step = 1e-7 * self.time

        def margin(at):
            _, fn, _, vt = self.rate(at, sign)
            return sign * self.ct * vt - self.law.friction * fn

        change = (margin(z + step * dz) - margin(z - step * dz)) / (2.0 * step)
        return sign * self.kt * vt + change

    def collide(self, x, v, w):
        """Velocities (2, 2), spins (2,), and duration of a collision."""
        z = np.concatenate([np.ravel(x), np.ravel(v), w, [0.0]]).astype(float)
        _, fn, ft, vt = self.rate(z, 0.0)
        t, sign = 0.0, np.sign(vt) if abs(ft) >= self.law.friction * fn else 0.0
        if self.law.friction == 0.0:
            sign = 1.0
        elif sign and self.excess(z, sign) < 0.0:
            sign, z[10] = 0.0, (sign * self.law.friction * fn - self.ct * vt) / self.kt
        while True:

            def gap(t, z, s):
                return self.kinematics(z)[0] if t > 0.1 * self.time else 1.0

            def change(t, z, s):
                return self.excess(z, s) * (-1.0 if s else 1.0)

            gap.terminal = change.terminal = True
            gap.direction, change.direction = -1.0, 1.0
            path = solve_ivp(
                lambda t, z, s: self.rate(z, s)[0], (t, 20.0 * self.time), z, "DOP853",
                events=(gap, change), args=(sign,), rtol=1e-10, atol=1e-14,
                max_step=0.02 * self.time,
            )  # fmt: skip
            t, z = path.t[-1], path.y[:, -1]
            if len(path.t_events[0]) or path.status == 0:
                return z[4:8].reshape(2, 2), z[8:10], t
            _, fn, ft, vt = self.rate(z, sign)
            if sign:
                z[10] = (ft - self.ct * vt) / self.kt
                sign = 0.0
            else:
                sign = np.sign(ft)


def law(**given) -> gm.Contact:
    """A stiff contact law: overlaps of the speeds below stay under a thousandth of a radius."""
    return gm.Contact(**{"stiffness": 1e8, "friction": 0.0, "restitution": 1.0} | given)


def meet(contact, v, w=(0.0, 0.0), diameter=(D, D), floor=False, offset=0.0, steps=50):
    """A collision of discs, or with the floor: expected and found (velocities, spins, duration).

    Disc 1 has the velocity `v` (towards -y on a floor, else +x) and stands `offset` radii aside.
    """
    r = np.array(diameter) / 2.0
    mass = RHO * np.pi * r**2
    reference = Reference(contact, mass, r, floor)
    u, w = np.array([v, (0.0, 0.0)]), np.array(w)
    if floor:
        x = np.array([[0.2, r[0]], [0.3, 0.2]])
    else:
        aside = offset * r.sum()
        x = np.array([[0.2 - np.sqrt(r.sum() ** 2 - aside**2), 0.2 + aside], [0.2, 0.2]])
    expected = reference.collide(x, u, w)
    dt = reference.time / steps
    lead = 3.37 * dt
    x[0] -= lead * u[0]
    used = slice(0, 1) if floor else slice(0, 2)
    model = gm.Model(BOX, contact, gravity=(0.0, 0.0), dt=dt)
    particles = gm.Particles(x[used], np.array(diameter)[used], RHO)
    run = gm.Simulation(model, particles, velocity=u[used], spin=w[used])
    run.run(until=lead + 1.6 * reference.time)
    return expected, (run.velocity, run.spin, duration(run, r, lead, floor))


def duration(run, r, lead, floor):
    """Time in contact, from the gap that has opened since."""
    x, v = run.x, run.velocity
    if floor:
        return run.t - lead - (x[0, 1] - r[0]) / v[0, 1]
    n = (x[1] - x[0]) / np.hypot(*(x[1] - x[0]))
    return run.t - lead - (np.hypot(*(x[1] - x[0])) - r.sum()) / ((v[1] - v[0]) @ n)


def dem01_free_fall() -> Rows:
    """A disc falls, touches the floor and rebounds: its path, in parts of the height of fall."""
    contact, h = law(stiffness=1e6, restitution=0.9), 0.05
    run = drop(contact, h)
    found, times = [], []

    def see(run):
        times.append(run.t)
        found.append(run.x[0, 1] - D / 2.0)

    run.run(until=0.16, every=run.dt, observe=see)
    t, y = np.array(times), np.array(found)
    exact = bounce(contact, h, t)
    yield Row(
        "DEM01 free fall", "largest error of the path / h", 0.0, np.abs(y - exact).max() / h, 1e-3
    )
    yield Row("", "deepest overlap / d", -exact.min() / D, -y.min() / D, 1e-3)


def drop(contact, h):
    """A disc released at the height h of its lowest point."""
    return gm.Simulation(gm.Model(BOX, contact), gm.Particles([[0.2, h + D / 2.0]], D, RHO))


def oscillator(contact):
    """γ, ω and rest position of a disc held by the floor's spring and dashpot against gravity."""
    γ = contact.damping_ratio(MASS) * np.sqrt(contact.stiffness / MASS)
    return γ, np.sqrt(contact.stiffness / MASS - γ**2), -MASS * G / contact.stiffness


def impact(contact, v):
    """Time in contact and speed after it of a disc that touches the floor with speed v."""
    γ, ω, rest = oscillator(contact)

    def y(t):
        b = (-v + γ * -rest) / ω
        return rest + np.exp(-γ * t) * (-rest * np.cos(ω * t) + b * np.sin(ω * t))

    t = brentq(y, 0.5 * np.pi / ω, 1.5 * np.pi / ω, xtol=1e-16)
    step = 1e-5 / ω
    return t, (y(t + step) - y(t - step)) / (2.0 * step), y


def bounce(contact, h, t):
    """Height of a disc dropped from h at times t, through its first bounce."""
    fall, v = np.sqrt(2.0 * h / G), np.sqrt(2.0 * G * h)
    last, after, path = impact(contact, v)
    up = t - fall - last
    return np.where(
        t < fall,
        h - G * t**2 / 2.0,
        np.where(up < 0.0, path(t - fall), after * up - G * up**2 / 2.0),
    )


def dem02_bounces() -> Rows:
    """Heights of bounces: e^2n h, with what gravity does while the disc touches."""
    contact, h = law(stiffness=1e6, restitution=0.8), 0.05
    run, tops = drop(contact, h), []

    def see(run):
        y, v = run.x[0, 1] - D / 2.0, run.velocity[0, 1]
        if y > 0.0:
            tops.append(y + v * v / (2.0 * G))

    run.run(until=0.9, every=0.002, observe=see)
    top = np.array(tops)
    found = top[np.flatnonzero(np.diff(top) < -1e-4 * h) + 1]
    exact = h
    for n in range(1, 6):
        exact = impact(contact, np.sqrt(2.0 * G * exact))[1] ** 2 / (2.0 * G)
        name = "DEM02 bouncing, e = 0.8" if n == 1 else ""
        yield Row(
            name,
            f"height {n} / h  (e^{2 * n} = {0.8 ** (2 * n):.4f})",
            exact / h,
            found[n - 1] / h,
            3e-3,
        )


def dem03_stacked() -> Rows:
    """Two discs of unequal density pressed between floor and ceiling."""
    k, e = 2e6, 0.5
    contact, density, height = gm.Contact(k, e, friction=0.0), np.array([RHO, RHO / 2.0]), 1.97 * D
    mass = density * np.pi * D**2 / 4.0
    x0 = np.array([0.5 * D - 0.02 * D, 1.5 * D - 0.025 * D])
    model = gm.Model(gm.Box(4.0 * D, height), contact)
    run = gm.Simulation(model, gm.Particles(np.stack([[2.0 * D] * 2, x0], axis=1), D, density))
    found, times = [], []

    def see(run):
        times.append(run.t)
        found.append(run.x[:, 1])

    run.run(until=run.dt * 400, every=run.dt, observe=see)
    pair = mass.prod() / mass.sum()
    c1, c2, c3 = (float(contact.coefficient(np.array([m]))[0]) for m in (mass[0], pair, mass[1]))

    def rate(t, z):
        y1, y2, v1, v2 = z
        low = k * (D / 2.0 - y1) - c1 * v1
        mid = k * (D - y2 + y1) + c2 * (v1 - v2)
        top = k * (y2 + D / 2.0 - height) + c3 * v2
        return v1, v2, (low - mid) / mass[0] - G, (mid - top) / mass[1] - G

    exact = solve_ivp(
        rate, (0.0, times[-1]), [*x0, 0, 0], "DOP853", t_eval=times, rtol=1e-11, atol=1e-15
    )
    off = np.abs(np.array(found) - exact.y[:2].T).max()
    yield Row(
        "DEM03 two discs pressed",
        "largest error of the path / overlap",
        0.0,
        off / (0.03 * D),
        2e-3,
    )
    run.run(until=0.1)
    # Springs in a row: the overlaps sum to what is missing, and differ by the weights.
    total, w1, w2 = 2.0 * D - height, mass[0] * G / k, mass[1] * G / k
    middle = (total - w1 + w2) / 3.0
    for what, value, y in (
        ("rest of the lower / overlap", middle + w1, D / 2.0 - run.x[0, 1]),
        ("rest of the upper / overlap", middle - w2, run.x[1, 1] + D / 2.0 - height),
    ):
        yield Row("", what, value / total, y / total, 1e-9)


def dem04_slip_to_roll() -> Rows:
    """A disc set down with speed and no spin slips until it rolls."""
    for mu in (0.1, 0.3):
        u, contact = 0.5, law(friction=mu, restitution=0.3)
        run, end = resting(contact, u), u / (3.0 * mu * G)
        seen = []

        def see(run, seen=seen):
            seen.append((run.t, run.velocity[0, 0] + run.spin[0] * D / 2.0))

        run.run(until=1.2 * end, every=end / 200.0, observe=see)
        t, slip = np.array(seen).T
        sliding = slip > 0.1 * u
        a, b = np.polyfit(t[sliding], slip[sliding], 1)
        yield Row(
            f"DEM04 slipping, mu = {mu}", "time of slipping 3 mu g t / u", 1.0, -b / a / end, 2e-3
        )
        yield Row("", "speed of rolling / u", 2.0 / 3.0, run.velocity[0, 0] / u, 2e-3)
        yield Row("", "spin r / u", -2.0 / 3.0, run.spin[0] * D / 2.0 / u, 2e-3)


def resting(contact, u, spin=0.0, box=BOX, gravity=(0.0, -G), walls=()):
    """A disc that rests on the floor but for its speed along it."""
    y = D / 2.0 + MASS * gravity[1] / contact.stiffness
    particles = gm.Particles([[0.1, y]], D, RHO)
    model = gm.Model(box, contact, gravity=gravity, walls=walls)
    return gm.Simulation(model, particles, velocity=(u, 0.0), spin=spin)


def dem05_oblique() -> Rows:
    """Oblique impact on the floor; where it slides throughout, v_t' = v_t - (1 + e') mu v_n.

    In rigid impacts e' = e. Here the dashpot pulls at the end of a contact, where friction has
    gone: e' v_n = e^(1 - 2 asin(β)/π) v_n is the speed when the normal force changes its sign.
    """
    contact, speed = law(friction=0.3, restitution=0.8), 0.2
    pushed = 0.8 ** (1.0 - 2.0 * np.arcsin(contact.damping_ratio(MASS)) / np.pi)
    for degrees in (75.0, 62.0, 20.0, 5.0):
        angle = np.radians(degrees)  # to the normal
        v = speed * np.array([np.sin(angle), -np.cos(angle)])
        (u, w, _), (found, spin, _) = meet(contact, v, floor=True)
        name = f"DEM05 oblique, {degrees:g}°"
        if degrees >= 60.0:
            lost = (1.0 + pushed) * 0.3 * speed * np.cos(angle)
            yield Row(name, "v_t' / v_t, slides", 1.0 - lost / v[0], found[0, 0] / v[0], 1e-3)
            yield Row("", "r w' / v_t", -2.0 * lost / v[0], spin[0] * D / 2.0 / v[0], 1e-3)
        else:
            yield Row(name, "v_t' / v_t, sticks", u[0, 0] / v[0], found[0, 0] / v[0], 1e-3)
            yield Row("", "r w' / v_t", w[0] * D / 2.0 / v[0], spin[0] * D / 2.0 / v[0], 1e-3)


def rolling_to_rest() -> Rows:
    """Rolling resistance brakes a rolling disc with 2/3 mu_r g."""
    for mu in (0.05, 0.2):
        u, contact = 0.15, law(friction=0.5, restitution=0.3, rolling=mu)
        run, rate = resting(contact, u, spin=-u / (D / 2.0)), 2.0 * mu * G / 3.0
        time = 0.8 * u / rate
        run.run(until=time)
        yield Row(
            f"Rolling, mu_r = {mu}",
            "3 a / (2 mu_r g)",
            1.0,
            (u - run.velocity[0, 0]) / time / rate,
            3e-3,
        )
        run.run(until=1.5 * u / rate)
        yield Row(
            "",
            "way to rest 4 mu_r g s / (3 u²)",
            1.0,
            (run.x[0, 0] - 0.1) * 2.0 * rate / u**2,
            3e-3,
        )
        yield Row("", "speed at the end / u", 0.0, abs(run.velocity[0, 0]) / u, 1e-6)


def incline() -> Rows:
    """A disc on a plane, gravity tilted: rolls if tan θ < 3 mu, else slides."""
    mu = 0.2
    contact = law(friction=mu, restitution=0.3)
    for ratio in (0.5, 0.95, 1.05, 2.0):
        θ = np.arctan(3.0 * mu * ratio)
        run = resting(contact, 0.0, gravity=(G * np.sin(θ), -G * np.cos(θ)))
        run.run(until=0.2)
        exact = 2.0 / 3.0 * G * np.sin(θ) if ratio < 1.0 else G * (np.sin(θ) - mu * np.cos(θ))
        how = "rolls" if ratio < 1.0 else "slides"
        yield Row(
            f"Incline, tan θ = {ratio:g} x 3 mu",
            f"a / g, {how}",
            exact / G,
            run.velocity[0, 0] / 0.2 / G,
            2e-3,
        )


def chung_ooi_1_to_3() -> Rows:
    """Normal impacts: greatest force, contact time, restitution."""
    v = 0.2
    for name, floor in (("Chung-Ooi 1, two discs", False), ("Chung-Ooi 2, disc and plane", True)):
        contact = law()
        m = MASS if floor else MASS / 2.0
        (_, _, time), (u, _, lasted) = meet(contact, (0.0, -v) if floor else (v, 0.0), floor=floor)
        yield Row(
            name,
            "contact time sqrt(k/m) / π",
            1.0,
            lasted * np.sqrt(contact.stiffness / m) / np.pi,
            1e-3,
        )
        yield Row("", "restitution", 1.0, u[0, 1] / v if floor else (u[1, 0] - u[0, 0]) / v, 1e-10)
        yield Row(
            "",
            "greatest force / (v sqrt(k m))",
            1.0,
            peak(contact, v, floor) / v / np.sqrt(contact.stiffness * m),
            1e-3,
        )
    for e in (0.9, 0.7, 0.5, 0.3):
        (_, _, time), (u, _, lasted) = meet(law(restitution=e), (0.0, -v), floor=True)
        yield Row(
            f"Chung-Ooi 3, e = {e}", "restitution", e, u[0, 1] / v, 1e-3 if e >= 0.5 else 2e-3
        )
        yield Row("", "contact time / t_c", 1.0, lasted / time, 1e-3)


def peak(contact, v, floor):
    """Greatest force of the spring in a normal impact."""
    x = [[0.2, D / 2.0 + 1e-5]] if floor else [[0.2 - D - 1e-5, 0.2], [0.2, 0.2]]
    u = [[0.0, -v]] if floor else [[v, 0.0], [0.0, 0.0]]
    run = gm.Simulation(
        gm.Model(BOX, contact, gravity=(0.0, 0.0)), gm.Particles(x, D, RHO), velocity=u
    )
    forces = [0.0]
    run.run(
        until=1e-5 / v + contact.contact_time(MASS), every=run.dt,
        observe=lambda run: forces.extend((run.wall_contacts if floor else run.contacts).force),
    )  # fmt: skip
    return max(forces)


def chung_ooi_4_to_8() -> Rows:
    """Oblique impacts and impacts with spin, against `Reference`."""
    contact, v = law(friction=0.3, restitution=0.9), 0.2
    angles, ratios = np.radians(range(5, 90, 10)), (0.1, 0.3, 0.7, 1.0, 2.0, 5.0)
    tilted = [{"v": (v * np.sin(a), -v * np.cos(a)), "floor": True} for a in angles]
    across = [{"v": (s * v, -v), "floor": True} for s in ratios]
    spinning = [{"v": (0.0, -v), "w": (2.0 * s * v / D, 0.0), "floor": True} for s in ratios]
    equal = [{"v": (v, 0.0), "w": (2.0 * s * v / D,) * 2} for s in ratios]
    unequal = [
        {"v": (v, 0.0), "w": (2.0 * s * v / D, 0.0), "diameter": (D, 5.0 * D)} for s in ratios
    ]
    aside = [
        {"v": (v, 0.0), "w": (30.0, -20.0), "diameter": (D, 3.0 * D), "offset": b}
        for b in (0.0, 0.3, 0.6, 0.9)
    ]
    sweeps = (
        ("Chung-Ooi 4, plane, angle 5 to 85°", tilted),
        ("Chung-Ooi 5, plane, v_t / v_n 0.1 to 5", across),
        ("Chung-Ooi 6, plane, r w / v_n 0.1 to 5", spinning),
        ("Chung-Ooi 7, equal discs, r w / v_n 0.1 to 5", equal),
        ("Chung-Ooi 8, discs 1:5, r w / v_n 0.1 to 5", unequal),
        ("Oblique, discs 1:3 with spin, offset 0 to 0.9", aside),
    )
    for name, sweep in sweeps:
        worst = np.zeros(2)
        for case in sweep:
            (u, w, _), (found, spin, _) = meet(contact, **case)
            scale = max(np.hypot(*case["v"]), abs(case.get("w", (0.0, 0.0))[0]) * D / 2.0)
            n = len(found)
            worst = np.maximum(
                worst,
                [
                    np.abs(found - u[:n]).max() / scale,
                    np.abs((spin - w[:n]) * D / 2.0).max() / scale,
                ],
            )
        yield Row(name, "largest error of v' / v", 0.0, worst[0], 1e-3)
        yield Row("", "largest error of r w' / v", 0.0, worst[1], 1e-3)


def elastic_energy() -> Rows:
    """Energy over 10 000 contact times; it swings while springs are loaded: means are compared."""
    for name, run, within in (
        ("Two discs between walls, e = 1", rattle(), 1e-6),
        ("Chain of six, always in contact, e = 1", chain(), 1e-6),
        ("Gas of 25 discs, solid fraction 0.5, e = 1", gas(), 1e-4),
    ):
        time = run.model.contact.contact_time(MASS / 2.0)
        energy = []

        def see(run, energy=energy):
            energy.append(sum(run.energies.values()))

        # The median of two discs is that of free flight; many discs are never all free.
        run.run(until=1e4 * time, every=2e4 * time / 997, observe=see)
        half, middle = len(energy) // 2, np.median if len(run) == 2 else np.mean
        early, late = middle(energy[:half]), middle(energy[half:])
        yield Row(name, "drift of energy", 0.0, abs(late / early - 1.0), within)


def rattle():
    """Two discs in a row between walls."""
    box = gm.Box(4.0 * D, 4.0 * D)
    particles = gm.Particles([[D, 2.0 * D], [2.9 * D, 2.0 * D]], D, RHO)
    model = gm.Model(box, law(), gravity=(0.0, 0.0))
    return gm.Simulation(model, particles, velocity=[[1.0, 0.0], [-1.0, 0.0]])


def chain(n=6):
    """Discs pressed in a row between walls, shaken so little that no contact opens."""
    box = gm.Box(0.98 * n * D, 4.0 * D)
    x = np.stack([(np.arange(n) + 0.5) * 0.98 * D, np.full(n, 2.0 * D)], axis=1)
    v = np.zeros((n, 2))
    v[:, 0] = 0.5 * np.random.default_rng(1).standard_normal(n)
    model = gm.Model(box, law(), gravity=(0.0, 0.0))
    return gm.Simulation(model, gm.Particles(x, D, RHO), velocity=v)


def gas(n=5, pitch=1.25 * D):
    """n x n discs in a box, in all directions."""
    random = np.random.default_rng(0)
    x = (np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2) + 0.5) * pitch
    v = 0.5 * random.standard_normal(x.shape)
    model = gm.Model(gm.Box(n * pitch, n * pitch), law(), gravity=(0.0, 0.0))
    return gm.Simulation(model, gm.Particles(x, D, RHO), velocity=v)


CASES: tuple[Callable[[], Rows], ...] = (
    dem01_free_fall,
    dem02_bounces,
    dem03_stacked,
    dem04_slip_to_roll,
    dem05_oblique,
    chung_ooi_1_to_3,
    chung_ooi_4_to_8,
    rolling_to_rest,
    incline,
    elastic_energy,
)


def table(rows: list[Row]) -> str:
    """The rows as Markdown."""
    lines = ["| case | quantity | expected | found | difference |", "|---|---|---|---|---|"]
    for row in rows:
        found = f"{row.found:.2g}" if row.expected == 0.0 else f"{row.found:.5f}"
        expected = "0" if row.expected == 0.0 else f"{row.expected:.5f}"
        lines.append(f"| {row.case} | {row.what} | {expected} | {found} | {row.off:.1g} |")
    return "\n".join(lines)


def main() -> None:
    """Rewrite the table of dem.md."""
    rows = [row for case in CASES for row in case()]
    text = table(rows)
    print(text)
    page = Path(__file__).with_suffix(".md")
    before, rest = page.read_text(encoding="utf-8").split(BEGIN)
    after = rest.split(END)[1]
    page.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
