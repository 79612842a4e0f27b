"""Newton's equations for discs in contact: velocity-Verlet, many steps without leaving the loop.

With half steps written out, h the velocity over a step and a the acceleration,

    h_{n+1/2} = h_{n-1/2} + Δt a_n,    x_{n+1} = x_n + Δt h_{n+1/2},                           (1)
    v_n = h_{n-1/2} + Δt a_n / 2                                                              (2)

for places and angles alike. Springs see x, and the h that stretched them; dashpots see the velocity
foretold, h_{n-1/2} + Δt a_{n-1}/2, which keeps second order. From (1) and (2)

    KE_N - KE_0 = sum_n (F_{n-1} + F_n)/2 . (x_n - x_{n-1}) + Δt²/8 sum_i m (a_N² - a_0²)       (3)

holds exactly, so the ledger adds the work of each force by this trapezoid. Damped is what contacts
took and their springs do not hold, which for elastic ones is the error of the step; slid what was
taken along the surface by friction. The books close but for the last term.

A linear drag of rate D [1/s] is implicit, so any D is stable; it is of first order in Δt D,

    h_{n+1/2} = (h_{n-1/2} + Δt a_n)/(1 + Δt D),                                              (4)

and takes m D from the momentum for each unit of way, exactly. It is not in the books.

A disc with 1/m = r²/I = 0 is fixed: it does not move, whatever acts on it.
"""

from __future__ import annotations

from math import cos, sin, sqrt

import numpy as np
from numba import njit

from grainmesh.contact import bond
from grainmesh.walls import AX, AY, FRICTION, LENGTH, OMEGA, SX, SY, TX, TY, UX, UY

#: Columns of the state of a disc: place, velocity over the last step, velocity foretold for now
#: (spins as speeds of the surface, r w), radius, force, torque over r.
X, Y, HX, HY, VX, VY, HS, VS, R, FX, FY, T = range(12)
#: Columns of constants of a disc: 1/m, r²/I, force from outside, what came from there a step ago.
IM, IJ, EX, EY, OX, OY = range(6)
#: Columns of the history of a contact: springs q and q_r; for the ledger, all a step ago: overlap,
#: normal force, damping force (tangential), spring force (sliding, rolling), force of a wall.
Q, QR, GAP, FN, DT, FS, FR, PX, PY = range(9)
#: Entries of the ledger: work lost to damping, sliding, rolling; done by walls and by forces from
#: outside [J/m]; impulse by walls and from outside [N s/m].
DAMPED, SLID, ROLLED, WALLS, OUTSIDE, WX, WY, GX, GY = range(9)
LEDGER = (
    "damped", "slid", "rolled", "work of walls", "work outside",
    "impulse of walls x", "impulse of walls y", "impulse outside x", "impulse outside y",
)  # fmt: skip
#: Why `advance` returned.
DONE, STALE, BROKEN = range(3)


@njit(cache=True, error_model="numpy")
def advance(  # type: ignore[no-untyped-def]
    s, p, law, pairs, touch, walls, moved, offset, rolling, ledger, drag, dt, seen, first, steps,
    pause,
):  # fmt: skip
    """Advance from step `first`, where forces are known, until a list is stale or numbers break.

    Parameters
    ----------
    s, p : (n, 12), (n, 6)
        State and constants of the discs; `s` is changed in place.
    law : (6,)
        k, k_t, c_t/c, mu and gravity [m/s2].
    pairs, touch : Near
        Near discs and near walls; their histories are changed in place.
    walls, moved : (w, 11), (w, 6)
        Table of walls; how far each has moved now and a step ago [m], and its velocity [m/s];
        changed in place.
    offset : (l, 2) or None
        That of `pairs` in a periodic box.
    rolling : float or None
        mu_r. What is None here and below is left out of the compiled loop.
    ledger : (9,) or None
        Sums that are added to.
    drag : (n, 3) or None
        Rate of a linear drag D, that of the spin [1/s], torque from outside over r [N/m].
    dt : float
        Step [s].
    seen : (n + w, 3)
        Places of discs, and ways of walls, when the lists were made [m], and one over the square
        of how far each may move from there before they are stale [1/m2].
    first, steps : int
        Number of the first step, and how many.
    pause : bool
        Return after each step as if lists were stale, for a force from outside that changes.

    Returns
    -------
    done, why : int
        Steps done, and `DONE`; `STALE`: places are those after the last step, but forces wait for
        new lists (then call `forces`); `BROKEN`: a force was not finite, the state is lost.
    """
    n = len(s)
    fastest, pace, longest, room = 0.0, 0.0, 1.0 / sqrt(seen[:, 2].min()), -1.0
    for w, speed in enumerate(speeds(walls)):
        fastest, pace = max(fastest, speed), max(pace, speed * sqrt(seen[n + w, 2]))
    for step in range(first, first + steps):
        top, probe = 0.0, 0.0
        for i in range(n):
            falls = 1.0 if p[i, IM] > 0.0 else 0.0
            ax = s[i, FX] * p[i, IM] + falls * law[4]
            ay = s[i, FY] * p[i, IM] + falls * law[5]
            at = s[i, T] * p[i, IJ]
            hx, hy, hs = s[i, HX] + dt * ax, s[i, HY] + dt * ay, s[i, HS] + dt * at
            if drag is not None:
                slow, lag = 1.0 / (1.0 + dt * drag[i, 0]), 1.0 / (1.0 + dt * drag[i, 1])
                hx, hy, hs = hx * slow, hy * slow, hs * lag  # Eq. (4)
                ax, ay, at = ax - drag[i, 0] * hx, ay - drag[i, 0] * hy, at - drag[i, 1] * hs
            s[i, HX], s[i, HY], s[i, HS] = hx, hy, hs
            s[i, VX], s[i, VY], s[i, VS] = (
                hx + 0.5 * dt * ax,
                hy + 0.5 * dt * ay,
                hs + 0.5 * dt * at,
            )
            s[i, X] += dt * hx  # Eq. (1)
            s[i, Y] += dt * hy
            s[i, FX], s[i, FY], s[i, T] = p[i, EX], p[i, EY], 0.0
            if drag is not None:
                s[i, T] = drag[i, 2]
            top = max(top, (hx * hx + hy * hy) * seen[i, 2])
            probe += 0.0 * (hx + hy + hs)  # nan if one is nan or infinite
        if probe != 0.0:
            return step - first, BROKEN
        if fastest > 0.0:
            move_walls(walls, moved, (step + 1) * dt)
        # What is left, of the share of its way that some disc or wall may move, shrinks by as much.
        room -= max(sqrt(top), pace) * dt
        if room < 0.0:
            room = 1.0 - farthest(s, moved, seen)
        if room < 0.0 or pause:
            return step + 1 - first, STALE
        lead = (2.0 * sqrt(top) * longest + fastest) * dt  # two cannot part faster
        _pair_forces(s, law, pairs, offset, rolling, ledger, dt, lead)
        _wall_forces(s, law, touch, walls, moved, rolling, ledger, dt, lead)
        if ledger is not None:
            _work_outside(s, p, ledger, dt)
    return steps, DONE


@njit(cache=True, error_model="numpy")
def forces(s, p, law, pairs, touch, walls, moved, offset, rolling, ledger, drag, dt):  # type: ignore[no-untyped-def]
    """Forces at the present places, with the work since the last step; arguments as `advance`."""
    top = 0.0
    for i in range(len(s)):
        s[i, FX], s[i, FY], s[i, T] = p[i, EX], p[i, EY], 0.0
        if drag is not None:
            s[i, T] = drag[i, 2]
        top = max(top, s[i, HX] ** 2 + s[i, HY] ** 2)
    lead = 2.0 * sqrt(top) * dt
    for speed in speeds(walls):
        lead = max(lead, (sqrt(top) + speed) * dt)
    _pair_forces(s, law, pairs, offset, rolling, ledger, dt, lead)
    _wall_forces(s, law, touch, walls, moved, rolling, ledger, dt, lead)
    if ledger is not None:
        _work_outside(s, p, ledger, dt)


@njit(cache=True, error_model="numpy")
def farthest(s, moved, seen):  # type: ignore[no-untyped-def]
    """Largest way of a disc or wall since `seen`, in what it may move."""
    n, far = len(s), 0.0
    for i in range(n):
        way = (s[i, X] - seen[i, 0]) ** 2 + (s[i, Y] - seen[i, 1]) ** 2
        far = max(far, way * seen[i, 2])
    for w in range(len(moved)):
        way = (moved[w, 0] - seen[n + w, 0]) ** 2 + (moved[w, 1] - seen[n + w, 1]) ** 2
        far = max(far, way * seen[n + w, 2])
    return sqrt(far)


@njit(cache=True, error_model="numpy")
def speeds(walls):  # type: ignore[no-untyped-def]
    """Greatest speed of each wall [m/s], (w,)."""
    swing = walls[:, OMEGA] * np.hypot(walls[:, SX], walls[:, SY])
    return np.hypot(walls[:, UX], walls[:, UY]) + swing


@njit(cache=True, error_model="numpy")
def outside(s, low, high):  # type: ignore[no-untyped-def]
    """First disc wholly outside [low, high] (2,) [m], or -1."""
    for i in range(len(s)):
        for c in range(2):
            if s[i, X + c] + s[i, R] < low[c] or s[i, X + c] - s[i, R] > high[c]:
                return i
    return -1


@njit(cache=True, error_model="numpy")
def beyond(s, walls, moved):  # type: ignore[no-untyped-def]
    """First disc with its centre behind a side of the box, and which wall it is, or -1, -1."""
    for w in range(len(walls)):
        if walls[w, LENGTH] < np.inf:
            continue
        ax, ay = walls[w, AX] + moved[w, 0], walls[w, AY] + moved[w, 1]
        for i in range(len(s)):
            if (s[i, Y] - ay) * walls[w, TX] - (s[i, X] - ax) * walls[w, TY] < 0.0:
                return i, w
    return -1, -1


@njit(cache=True, error_model="numpy")
def move_walls(walls, moved, time):  # type: ignore[no-untyped-def]
    """How far the walls have moved by a time [s], and their velocity, `walls` Eq. (1)."""
    for w in range(len(walls)):
        moved[w, 2], moved[w, 3] = moved[w, 0], moved[w, 1]
        for c in range(2):
            u, size, omega = walls[w, UX + c], walls[w, SX + c], walls[w, OMEGA]
            moved[w, c] = u * time + size * sin(omega * time)
            moved[w, 4 + c] = u + omega * size * cos(omega * time)


@njit(cache=True, error_model="numpy")
def _pair_forces(s, law, near, offset, rolling, ledger, dt, lead):  # type: ignore[no-untyped-def]
    owner, other, damping, mass, old = near.owner, near.other, near.damping, near.mass, near.history
    k, kt, ratio, mu = law[0], law[1], law[2], law[3]
    pliant = 1.0 / kt
    for e in range(len(other)):  # one loop over all pairs: rows are too short to be loops
        i, j = owner[e], other[e]
        dx, dy = s[j, X] - s[i, X], s[j, Y] - s[i, Y]
        if offset is not None:
            dx, dy = dx + offset[e, 0], dy + offset[e, 1]
        reach = s[i, R] + s[j, R]
        dd = dx * dx + dy * dy
        if ledger is None and dd >= (reach + lead) ** 2:
            old[e, Q] = 0.0
            if rolling is not None:
                old[e, QR] = 0.0
            continue
        distance = sqrt(dd)
        inverse = 1.0 / distance
        nx, ny, o = dx * inverse, dy * inverse, reach - distance
        hx, hy = s[i, HX] - s[j, HX], s[i, HY] - s[j, HY]
        un = hx * nx + hy * ny
        if ledger is None and o <= 0.0 and o <= un * dt:  # apart, now and a step ago
            old[e, Q] = 0.0
            if rolling is not None:
                old[e, QR] = 0.0
            continue
        vx, vy = s[i, VX] - s[j, VX], s[i, VY] - s[j, VY]
        vn, ht = vx * nx + vy * ny, hy * nx - hx * ny
        lever, spins = distance / reach, s[i, HS] + s[j, HS]
        turn = 0.5 * un * dt * (ht * inverse - spins / reach)  # half of what n and lever turn
        ut = ht + lever * spins - turn
        vt = vy * nx - vx * ny + lever * (s[i, VS] + s[j, VS])
        a = ur = vr = qr = mur = 0.0
        if rolling is not None:
            mur, qr = rolling, old[e, QR]
            a = s[i, R] * s[j, R] / reach
            ur = a * (s[i, HS] / s[i, R] - s[j, HS] / s[j, R])
            vr = a * (s[i, VS] / s[i, R] - s[j, VS] / s[j, R])
        c = damping[e]
        fn, ft, fs, fr, q, qr = bond(
            o, un, vn, ut, vt, ur, vr, k, kt, pliant, c, ratio * c, mass[e], mu, mur,
            old[e, Q], qr, dt,
        )  # fmt: skip
        if ledger is not None:
            px, py = dx + hx * dt, dy + hy * dt  # from i to j a step ago
            us = (hx * px + hy * py) / sqrt(px * px + py * py)
            _book(
                old[e], o, fn, ft - fs, fs, fr, q, qr, us * dt, un * dt, ut * dt, turn * dt,
                ur * dt, k, kt, ledger,
            )  # fmt: skip
        old[e, Q] = q
        if rolling is not None:
            old[e, QR] = qr
            s[i, T] -= fr * a / s[i, R]
            s[j, T] += fr * a / s[j, R]
        px, py = fn * nx - ft * ny, fn * ny + ft * nx
        s[i, FX] -= px
        s[i, FY] -= py
        s[i, T] -= lever * ft
        s[j, FX] += px
        s[j, FY] += py
        s[j, T] -= lever * ft


@njit(cache=True, error_model="numpy")
def _wall_forces(s, law, near, walls, moved, rolling, ledger, dt, lead):  # type: ignore[no-untyped-def]
    damping, mass, old = near.damping, near.mass, near.history
    k, kt, ratio = law[0], law[1], law[2]
    for e in range(len(near.other)):
        i = near.owner[e]
        w = near.other[e]
        o, nx, ny, at_end = to_wall(s, i, near, e, walls, moved)
        covered = at_end and o > -lead and held(s, i, near, e, o, walls, moved)
        if covered:
            o = 0.0
        if ledger is None and o <= -lead:
            old[e, Q] = 0.0
            if rolling is not None:
                old[e, QR] = 0.0
            continue
        wx, wy = (moved[w, 0] - moved[w, 2]) / dt, (moved[w, 1] - moved[w, 3]) / dt
        hx, hy = s[i, HX] - wx, s[i, HY] - wy
        vx, vy = s[i, VX] - moved[w, 4], s[i, VY] - moved[w, 5]
        un, vn = hx * nx + hy * ny, vx * nx + vy * ny
        if covered:  # another wall has the disc: nothing begins or ends here
            un = 0.0
        ht = hy * nx - hx * ny
        turn = 0.5 * ht * un * dt / (s[i, R] - o) if at_end else 0.0
        ut, vt = ht - turn + s[i, HS], vy * nx - vx * ny + s[i, VS]
        qr = mur = 0.0
        if rolling is not None:
            mur, qr = rolling, old[e, QR]
        c, mu = damping[e], walls[w, FRICTION]
        fn, ft, fs, fr, q, qr = bond(
            o, un, vn, ut, vt, s[i, HS], s[i, VS], k, kt, 1.0 / kt, c, ratio * c, mass[e],
            mu, mur,
            old[e, Q], qr, dt,
        )  # fmt: skip
        px, py = ft * ny - fn * nx, -fn * ny - ft * nx
        if ledger is not None:
            _book(
                old[e], o, fn, ft - fs, fs, fr, q, qr, un * dt, un * dt, ut * dt, turn * dt,
                s[i, HS] * dt, k, kt, ledger,
            )  # fmt: skip
            jx, jy = 0.5 * dt * (px + old[e, PX]), 0.5 * dt * (py + old[e, PY])
            ledger[WX] += jx
            ledger[WY] += jy
            ledger[WALLS] += jx * wx + jy * wy
            old[e, PX], old[e, PY] = px, py
        old[e, Q] = q
        if rolling is not None:
            old[e, QR] = qr
        s[i, FX] += px
        s[i, FY] += py
        s[i, T] -= ft + fr


@njit(cache=True, error_model="numpy")
def _book(row, o, fn, fdt, fs, fr, q, qr, us, un, slid, turn, rolled, k, kt, ledger):  # type: ignore[no-untyped-def]
    """Work of a contact since the last step, Eq. (3), written into the ledger."""
    before, now = 0.5 * (slid - turn), 0.5 * (slid + turn)  # along the tangents of then and now
    stored = 0.5 * k * (max(o, 0.0) ** 2 - max(row[GAP], 0.0) ** 2)
    ledger[DAMPED] += 0.5 * (row[FN] * us + fn * un) - stored + row[DT] * before + fdt * now
    ledger[SLID] += row[FS] * before + fs * now - 0.5 * kt * (q * q - row[Q] ** 2)
    ledger[ROLLED] += 0.5 * (row[FR] + fr) * rolled - 0.5 * kt * (qr * qr - row[QR] ** 2)
    row[GAP], row[FN], row[DT], row[FS], row[FR] = o, fn, fdt, fs, fr


@njit(cache=True, forceinline=True)
def to_wall(s, i, near, e, walls, moved):  # type: ignore[no-untyped-def]
    """Overlap of disc i with the wall of entry e, direction to the wall, whether at its end."""
    w = near.other[e]
    tx, ty, length = walls[w, TX], walls[w, TY], walls[w, LENGTH]
    dx = s[i, X] - walls[w, AX] - moved[w, 0] - near.offset[e, 0]
    dy = s[i, Y] - walls[w, AY] - moved[w, 1] - near.offset[e, 1]
    if length == np.inf:  # a side: the disc is on the left of it, or through it
        return s[i, R] - (dy * tx - dx * ty), ty, -tx, False
    along = dx * tx + dy * ty
    at_end = along <= 0.0 or along >= length
    along = min(max(along, 0.0), length)
    dx, dy = dx - along * tx, dy - along * ty
    distance = sqrt(dx * dx + dy * dy)
    if distance == 0.0:
        return s[i, R], ty, -tx, at_end
    return s[i, R] - distance, -dx / distance, -dy / distance, at_end


@njit(cache=True, error_model="numpy")
def held(s, i, near, e, o, walls, moved):  # type: ignore[no-untyped-def]
    """Whether the wall end that entry e touches lies on another wall that holds disc i as much."""
    _, nx, ny, _ = to_wall(s, i, near, e, walls, moved)
    px, py = s[i, X] + (s[i, R] - o) * nx, s[i, Y] + (s[i, R] - o) * ny
    for f in range(near.start[i], near.start[i + 1]):
        other, _, _, also = to_wall(s, i, near, f, walls, moved)
        near_enough = 1e-9 * s[i, R]
        if f == e or other < o - near_enough or (also and other < o + near_enough and f > e):
            continue
        w = near.other[f]
        dx = px - walls[w, AX] - moved[w, 0] - near.offset[f, 0]
        dy = py - walls[w, AY] - moved[w, 1] - near.offset[f, 1]
        along = dx * walls[w, TX] + dy * walls[w, TY]
        along = min(max(along, 0.0), walls[w, LENGTH])
        off = abs(dx - along * walls[w, TX]) + abs(dy - along * walls[w, TY])
        if off < near_enough:
            return True
    return False


@njit(cache=True, error_model="numpy")
def _work_outside(s, p, ledger, dt):  # type: ignore[no-untyped-def]
    for i in range(len(s)):
        ex, ey = p[i, EX], p[i, EY]
        if p[i, IM] == 0.0:  # what holds a fixed disc comes from outside, too
            ex, ey = ex - s[i, FX], ey - s[i, FY]
        jx, jy = 0.5 * dt * (ex + p[i, OX]), 0.5 * dt * (ey + p[i, OY])
        ledger[OUTSIDE] += jx * s[i, HX] + jy * s[i, HY]
        ledger[GX] += jx
        ledger[GY] += jy
        p[i, OX], p[i, OY] = ex, ey


__all__ = [
    "BROKEN",
    "DONE",
    "STALE",
    "advance",
    "farthest",
    "forces",
    "held",
    "move_walls",
    "to_wall",
]
