"""The driver: particles that move, collide and rest, on a triangulation that lives with them.

    model = gm.Model(box, gm.Contact(stiffness=1e4, restitution=0.8))
    simulation = gm.Simulation(model, particles)
    simulation.run(until=1.0)

The discs are kept in an order that puts neighbours near each other in memory; whatever leaves this
module is in the order of the user.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from math import ceil, isfinite
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from grainmesh import checkpoint, motion, pairs
from grainmesh.coupling import Coupling, Discs
from grainmesh.domain import SIDES
from grainmesh.errors import InputError, RunError
from grainmesh.living import Living, living
from grainmesh.measure import (
    Contacts,
    contacts_of_discs,
    contacts_of_walls,
    energies,
    overlaps,
    wall_overlaps,
)
from grainmesh.medium import Fluid
from grainmesh.model import Force, Model, fixed_of
from grainmesh.motion import (
    EX,
    EY,
    FR,
    FX,
    FY,
    HS,
    HX,
    HY,
    IJ,
    IM,
    OX,
    OY,
    QR,
    VS,
    VX,
    VY,
    R,
    T,
    X,
    Y,
)  # fmt: skip
from grainmesh.pairs import Memory, Near
from grainmesh.particles import Particles
from grainmesh.plain import plain
from grainmesh.progress import bar
from grainmesh.start import (
    FARTHEST,
    MOST_AT_START,
    law_of,
    refuse_fast_walls,
    refuse_overlap,
    rows,
    state_of,
    step_of,
    stiffness_for,
)
from grainmesh.walls import table

Float = NDArray[np.float64]
Int = NDArray[np.int64]

#: Ways are for so many steps at the present speed, but not below this share of the least radius.
LASTS, THINNEST = 150, 0.01
#: Steps after which a copy of the state is kept, for the case that the next ones fail.
CHUNK = 1000
#: What a checkpoint holds besides lists and mesh.
NUMBERS = ("step", "dt", "history", "upkeeps", "sorted", "halved", "about")
STATE = ("s", "p", "slot", "rank", "moved", "seen", "books", "density")


class Simulation:
    """Particles in motion.

    Parameters
    ----------
    model : Model
    particles : Particles
        At time 0.
    velocity, spin : array_like, optional
        (n, 2) or (2,) [m/s]; (n,) or scalar [1/s], counter-clockwise. At rest if not given.
    ledger : bool
        Keep books of energy and momentum (see `ledger`), at about twice the cost.
    fixed : array_like, optional
        Particles held in place for ever, (n,) bool, or their numbers: others bounce off them as if
        their mass were infinite, walls and fixed ones pass through them. They have no velocity.

    Attributes
    ----------
    model : Model
    step, dt, t : int, float, float
        Steps done, step [s] and time [s].
    history : list of dict
        Rows of `measure`, added by `run`.
    about : dict
        What else a checkpoint is to keep, as JSON can hold it.
    flow : Coupling or None
        The fluid: fields, forces on particles, and mesh.
    halved : int
        Steps of the flow that were tried again with half the length.
    seconds, upkeeps : dict, int
        Time spent on steps and on upkeep of triangulation and lists; number of upkeeps.

    Raises
    ------
    InputError
        Step too large for the contacts; discs that overlap, or stick in walls, by more than 5 % of
        the smaller radius (`relax` pushes them apart), fixed ones by more than 30 %; values that
        are not finite.
    """

    def __init__(
        self,
        model: Model,
        particles: Particles,
        velocity: ArrayLike = (0.0, 0.0),
        spin: ArrayLike = 0.0,
        ledger: bool = False,
        fixed: ArrayLike | None = None,
    ) -> None:
        if not isinstance(model, Model) or not isinstance(particles, Particles):
            raise InputError("a simulation takes a grainmesh.Model, then grainmesh.Particles")
        n, held = len(particles), fixed_of(fixed, len(particles))
        self.model = model
        self.step = 0
        self.dt = step_of(model, particles, held)
        self.history: list[dict[str, float]] = []
        self.about: dict[str, Any] = {}
        self.seconds = {"steps": 0.0, "upkeep": 0.0}
        self.upkeeps = self.sorted = 0
        refuse_overlap(model, particles, held)
        self._s, self._p = state_of(particles, velocity, spin, self.dt, held)
        self._drag: Float | None = None
        self._density = particles.density  # by the user's number, of all that were there
        self.halved = 0
        self.flow: Coupling | None = None
        self._slot = np.arange(n)  # the user's number of each disc
        self._law = law_of(model)
        self._walls = table(model.all_walls, model.contact.friction)
        self._moved = np.zeros((len(self._walls), 6))
        refuse_fast_walls(
            model.all_walls, motion.speeds(self._walls), self.dt, particles.radius.min()
        )
        motion.move_walls(self._walls, self._moved, 0.0)
        self._books = np.zeros(9 if ledger else 0)
        self._mesh = living(model.box, particles.x, particles.radius)
        self._seen: Float
        self._pairs: Near
        self._touch: Near
        empty = pairs.nothing(9 if ledger else 2 if model.contact.rolling > 0.0 else 1)
        self._sort(empty, empty)
        through, _ = motion.beyond(self._s, self._walls, self._moved)
        stay = self._stay("remove") if through < 0 else np.arange(n) != through
        if stay is not None:
            i = int(self._slot[~stay].min())
            x = particles.x[i]
            raise InputError(
                f"particle {i} lies outside the box, at ({x[0]:g}, {x[1]:g}) m: check the unit, "
                "move it or drop it"
            )
        self._refuse_stuck()
        depth, who = self._deepest()
        if depth > pairs.DEEPEST:
            raise InputError(
                f"{who} overlap by {100 * depth:.3g} % of the smallest radius, at most "
                f"{100 * pairs.DEEPEST:g} % can be followed: move them apart "
                "(grainmesh.relax(model, particles) does)"
            )
        self._force_outside()
        self._p[:, [OX, OY]] = self._p[:, [EX, EY]]
        # Springs of contacts at the start are not stretched: nothing has moved before.
        self._s[:, [HX, HY, HS]] = 0.0
        motion.forces(*self._state())
        self._books[:] = 0.0
        # The first step then starts with half a push, `motion` Eq. (2).
        self._s[:, [HX, HY, HS]] = self._s[:, [VX, VY, VS]] - 0.5 * self.dt * self._acceleration()
        if model.fluid is not None:
            if ledger:
                raise InputError("a simulation with fluid keeps no ledger, drop ledger=True")
            v = np.array(self._users(self._s[:, [VX, VY]]))
            self.flow = Coupling(
                model.box, model.fluid, model.gravity, self._discs(), particles.x, v
            )

    def _discs(self) -> Discs:
        d = self._users(2.0 * self._s[:, R])
        return Discs(d, self._density[self.ids] * np.pi * d**2 / 4.0, ~self.fixed)

    @property
    def t(self) -> float:
        """Time [s]."""
        return self.step * self.dt

    def __len__(self) -> int:
        return len(self._s)

    def __repr__(self) -> str:
        with_fluid = "" if self.flow is None else " in a fluid"
        top = float((self._s[:, Y] + self._s[:, R]).max())
        return (
            f"Simulation: t = {self.t:.6g} s, step {self.step} of {self.dt:.3g} s, {len(self)} "
            f"particles{with_fluid}, {len(self.contacts)} contacts, height {top:.4g} m, kinetic "
            f"energy {self.energies['kinetic']:.4g} J/m"
        )

    def to_dict(self) -> dict[str, Any]:
        """`measure` as plain numbers, ready for JSON; None for what is not finite."""
        found: dict[str, Any] = plain(self.measure())
        return found

    @property
    def ids(self) -> Int:
        """Numbers, at the start, of the particles that are still there, ascending (n,)."""
        return np.sort(self._slot)

    def _users(self, values: Float) -> Float:
        """Values of discs in the user's order."""
        ordered: Float = values[self._rank]
        return ordered

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """Which particles are held in place, (n,)."""
        held: NDArray[np.bool_] = self._p[self._rank, IM] == 0.0
        return held

    @property
    def x(self) -> Float:
        """Centres [m], (n, 2), inside the box if it is periodic."""
        return self.model.box.wrapped(self._users(self._s[:, :2]))

    @property
    def velocity(self) -> Float:
        """Velocities [m/s], (n, 2)."""
        return self._users(self._s[:, [HX, HY]] + 0.5 * self.dt * self._acceleration()[:, :2])

    @property
    def spin(self) -> Float:
        """Angular velocities [1/s], counter-clockwise, (n,)."""
        speed = self._s[:, HS] + 0.5 * self.dt * self._acceleration()[:, 2]
        spin: Float = speed / self._s[:, R]
        return self._users(spin)

    @property
    def particles(self) -> Particles:
        """The particles where they are now."""
        return Particles(self.x, self._users(2.0 * self._s[:, R]), self._density[self.ids])

    @property
    def contacts(self) -> Contacts:
        """Contacts of discs with discs: pair, overlap, normal, force, friction (`Contacts`).

        Fixed ones that touch each other are not among them.
        """
        return contacts_of_discs(self._s, self._pairs, self._law, self._slot)

    @property
    def wall_contacts(self) -> Contacts:
        """Contacts of discs with walls."""
        about = self._touch, self._walls, self._moved
        return contacts_of_walls(self._s, *about, self._law, self._slot)

    @property
    def energies(self) -> dict[str, float]:
        """Energies per unit depth [J/m]: kinetic, rotational, elastic, potential (from y = 0).

        Fixed particles have none.
        """
        v = self._s[:, [HX, HY, HS]] + 0.5 * self.dt * self._acceleration()
        about = self._pairs, self._touch, self._walls, self._moved
        return energies(self._s, self._p, v, self._law, *about)

    @property
    def ledger(self) -> dict[str, float]:
        """Work since the start and impulses, per unit depth; empty unless asked for at the start.

        damped, slid, rolled
            Taken by dashpots, by sliding and by rolling friction [J/m].
        work of walls, work outside
            Done on the particles by walls that move, and by forces from outside, among them what
            holds fixed particles [J/m].
        impulse of walls x, ... y, impulse outside x, ... y
            Given to the particles [N s/m].

        kinetic + rotational + elastic + potential + damped + slid + rolled - work of walls - work
        outside stays as it was: `measure` gives this sum as total. Particles that leave take their
        energy with them.
        """
        return dict(zip(motion.LEDGER, map(float, self._books), strict=False))

    def measure(self) -> dict[str, float]:
        """Numbers of the present state.

        t [s], step, particles, the `energies` [J/m], contacts (of discs with discs), overlap (the
        deepest, in smallest radii), height (of the highest disc, [m]), flips (of edges, so far);
        with a ledger, its entries and their total; with a fluid, `Fields.measure`.
        """
        top = self._s[:, Y] + self._s[:, R]
        held, books = self.energies, self.ledger
        if books:
            books["total"] = sum(held.values()) + sum(
                books[name] for name in ("damped", "slid", "rolled")
            )
            books["total"] -= books["work of walls"] + books["work outside"]
        found = {
            "t": self.t,
            "step": self.step,
            "particles": len(self),
            **held,
            "contacts": len(self.contacts),
            "overlap": self._deepest()[0],
            "height": float(top.max()),
            "flips": self._mesh.flips,
            **books,
            **(self.flow.measure() if self.flow is not None else {}),
        }
        return {key: v if isinstance(v, int) else float(v) for key, v in found.items()}

    def change(self, model: Model) -> Simulation:
        """Go on with another model: open a side, take walls away or add some, change a law.

        Contacts keep their history, those with walls if the wall is in both models. Steps stay as
        long as they are, and walls that move are where they would be had they moved from time 0.

        Parameters
        ----------
        model : Model

        Returns
        -------
        Simulation
            Itself.

        Raises
        ------
        InputError
            If particles stick in new walls, the step is too large for the new law, or a periodic
            box is to get sides or the reverse. Nothing is changed then.
        """
        if model.box.periodic != self.model.box.periodic or (
            model.box.periodic and model.box != self.model.box
        ):
            raise InputError("change: a periodic box must stay as it is, and others not become one")
        if (model.fluid is None) != (self.flow is None) or (
            model.fluid is not None and model.box != self.model.box
        ):
            raise InputError("change: a box with fluid must stay as it is, and others without")
        if self.flow is not None and model.fluid is not None:
            self.flow.refuse_other(model.fluid)
        law = replace(model, dt=self.dt)
        step_of(law, self.particles, self.fixed)
        new, old = model.all_walls, self.model.all_walls
        number = np.array([new.index(wall) if wall in new else -1 for wall in old], np.int32)
        before = (
            self.model,
            self._law,
            self._walls,
            self._moved,
            self._pairs,
            self._touch,
            self._seen,
        )
        width = 9 if len(self._books) else 2 if model.contact.rolling > 0.0 else 1
        discs, touch = (
            pairs.widened(pairs.memory(near), width) for near in (self._pairs, self._touch)
        )
        touch = touch._replace(other=number[touch.other]) if len(touch.other) else touch
        self.model, self._law = law, law_of(law)
        self._walls = table(new, law.contact.friction)
        self._moved = np.zeros((len(new), 6))
        for _ in range(2):
            motion.move_walls(self._walls, self._moved, self.t)
        kept = self.flow.keep() if self.flow is not None else None
        try:
            refuse_fast_walls(new, motion.speeds(self._walls), self.dt, self._s[:, R].min())
            self._renew_lists(
                discs, pairs.renumbered(touch, np.arange(len(self), dtype=np.int32), False, ())
            )
            self._refuse_stuck()
            if self.flow is not None and model.fluid is not None:
                self.flow.change(model.fluid, model.gravity)
        except InputError:
            if self.flow is not None and kept is not None:
                self.flow.back(kept)
            (
                self.model, self._law, self._walls, self._moved, self._pairs, self._touch,
                self._seen,
            ) = before  # fmt: skip
            raise
        return self

    def run(
        self,
        until: float,
        every: float | None = None,
        save: str | Path | None = None,
        progress: bool | Callable[[int], None] = False,
        observe: Callable[[Simulation], None] | None = None,
    ) -> Simulation:
        """Advance to a time.

        Parameters
        ----------
        until : float
            Time to reach [s]; the last step may pass it by less than a step. Nothing is done if it
            is past.
        every : float, optional
            Interval [s] at which `measure` is added to `history`,
            `observe` is called and, if `save` is given, the state is written; else only at the end.
        save : path, optional
            Folder for ``checkpoint.h5``, from which `resume` goes on.
        progress : bool or callable
            Show time, step and the time still needed on stderr; or call this with the step whenever
            the state is whole: what it raises ends the run there.
        observe : callable, optional
            Called with this simulation.

        Returns
        -------
        Simulation
            Itself.

        Raises
        ------
        InputError
            If a time is not finite or not positive, or nothing can be written.
        RunError
            If a number becomes infinite or undefined, discs overlap too much to be found, or a
            particle leaves where it must not. The state is then the last good one, which is saved.
        """
        prove_times(until=until, **({} if every is None else {"every": every}))
        last = ceil(until / self.dt - 1e-6)
        if save and self.step < last:  # a folder that cannot be written is not found out too late
            self.save(save)
        mark = self._mark(every, last)
        shown = nullcontext(progress) if callable(progress) else bar(self, last, progress)
        with shown as tell:
            try:
                while self.step < last:
                    self._advance(mark - self.step, tell)
                    if self.step == mark:
                        mark = self._mark(every, last)
                        self.history.append(self.measure())
                        if observe:
                            observe(self)
                        if save:
                            self.save(save)
            except RunError:
                if save:
                    self.save(save)
                raise
        return self

    def _mark(self, every: float | None, last: int) -> int:
        """The step at which to look next: at a multiple of `every`, or the last."""
        if every is None:
            return last
        number = int(self.step * self.dt / every)
        while (mark := ceil(number * every / self.dt - 1e-6)) <= self.step:
            number += 1
        return min(mark, last)

    def save(self, folder: str | Path) -> Path:
        """Write the state to ``checkpoint.h5`` in a folder, see `checkpoint.write`."""
        numbers = {name: getattr(self, name) for name in NUMBERS}
        arrays = {f"state/{name}": getattr(self, "_" + name) for name in STATE}
        for name, near in (("pairs", self._pairs), ("touch", self._touch)):
            arrays |= {f"{name}/{key}": value for key, value in near._asdict().items()}
        mesh = vars(self._mesh)
        arrays |= {f"mesh/{key}": mesh[key] for key in mesh if isinstance(mesh[key], np.ndarray)}
        numbers["mesh"] = {key: mesh[key] for key in mesh if isinstance(mesh[key], int)}
        if self.flow is not None:
            arrays |= {f"flow/{key}": value for key, value in self.flow.arrays().items()}
            numbers["flow"] = self.flow.numbers()
        return checkpoint.write(folder, self.model, numbers, arrays)

    def _advance(self, steps: int, tell: Callable[[int], None]) -> None:
        if self.flow is None:
            self._collide(steps, tell)
            return
        end = self.step + steps
        while self.step < end:
            self._flow_step(end - self.step)
            tell(self.step)

    def _flow_step(self, most: int) -> None:
        """One step of fluid and particles, of at most so many steps of contacts (`coupling`).

        It is halved where triangles would turn over or the solver does not converge.
        """
        flow = self.flow
        assert flow is not None
        good, kept, spin = self._copy(), flow.keep(), self.spin
        steps = flow.steps(self.dt, most)
        while True:
            span = steps * self.dt
            force, drag = flow.push(span)
            outside = self._outside()
            try:
                way, _, spins, impulse = self._push(
                    steps, flow.velocity, spin, force + outside, drag
                )
                if flow.move(way):
                    flow.solve(span, impulse, outside)
                    break
                fault = None
            except (RunError, InputError) as why:
                fault = RunError(f"{why} (at t = {self.t:g} s)") if steps == 1 else None
            except BaseException:
                self._restore(good)
                flow.back(kept)
                raise
            self._restore(good)
            flow.back(kept)
            if steps == 1:
                raise fault or RunError(
                    f"the particles turn triangles of the mesh over in a single step at "
                    f"t = {self.t:g} s: raise the stiffness, or give a smaller Model(dt=...)"
                )
            steps //= 2
            self.halved += 1
        self._set_velocity(flow.velocity, spins)

    def _outside(self) -> Float:
        """Force from outside at the present places, in the user's order (n, 2)."""
        force = self.model.force
        given = force(self.t, self.x, self.velocity) if callable(force) else force
        if given is None:
            return np.zeros((len(self), 2))
        return np.array(rows("force from outside", given, len(self), ids=self.ids))

    def _set_velocity(self, velocity: Float, spin: Float) -> None:
        rank, s = self._rank, self._s
        s[rank[:, None], [VX, VY]] = velocity
        s[rank, VS] = spin * s[rank, R]
        s[:, [HX, HY, HS]] = s[:, [VX, VY, VS]] - 0.5 * self.dt * self._acceleration()

    def _collide(self, steps: int, tell: Callable[[int], None]) -> None:
        end = self.step + steps
        pushed = callable(self.model.force) and self._drag is None
        while self.step < end:
            good = self._copy()
            began = perf_counter()
            try:
                done, why = motion.advance(
                    *self._state(), self._seen, self.step, min(end - self.step, CHUNK), pushed
                )
                self.step += done
                self.seconds["steps"] += perf_counter() - began
                if why == motion.BROKEN:
                    self._blame()
                if why == motion.STALE:
                    if motion.farthest(self._s, self._moved, self._seen) > 1.0:
                        self._upkeep()
                    if pushed:
                        self._force_outside()
                    motion.forces(*self._state())
            except BaseException as fault:
                when = self.t
                self._restore(good)
                if isinstance(fault, InputError):
                    raise RunError(f"{fault} (at t = {when:g} s)") from None
                raise
            tell(self.step)

    def _push(
        self, steps: int, velocity: Float, spin: Float, force: Float, drag: Float
    ) -> tuple[Float, Float, Float, Float]:
        """Advance, from given velocities, under a linear drag and constant forces from outside.

        The first step starts from h = v - Δt (f/m + c)/2, and the last ends with v = h + Δt (f/m +
        c)/2: f is the force of contacts then and there, and c, for which any constant would keep
        momentum, the acceleration without contacts as it starts, E/m + g - D v, which makes free
        fall and terminal speeds exact, but no more of it than a drag of high rate leaves of it
        after a step, 1/(1 + (Δt D)²). With J the impulse of contacts,

            m (v_N - v_0) = J + N Δt (E + m g) - m D (x_N - x_0)                              (1)

        holds exactly, and the J of all discs are zero together if they touch no walls.

        Parameters
        ----------
        steps : int
        velocity, spin : (n, 2), (n,)
            Now [m/s, 1/s], in place of those that the discs have; those of fixed ones do not count.
        force : (n, 2)
            E, all the force from outside [N/m], in place of that of the model.
        drag : (n, 3)
            D [1/s], the same of the spin [1/s], and torque from outside over r [N/m].

        Returns
        -------
        way, velocity, spin, impulse : (n, 2), (n, 2), (n,), (n, 2)
            Of the particles still there: x_N - x_0 [m]; now [m/s, 1/s]; J [N s/m], zero for
            fixed ones.

        Raises
        ------
        RunError
            As `run`; nothing is changed then.
        """
        good, before, start = self._copy(), self.ids, self._users(self._s[:, :2])
        dt, rank = self.dt, self._rank
        try:
            contact = self._s[:, [FX, FY, T]]
            contact[:, :2] -= self._p[:, [EX, EY]]
            self._p[np.ix_(rank, [EX, EY])] = force
            self._drag = np.empty((len(self), 3))
            self._drag[rank] = drag
            v = np.empty((len(self), 3))
            v[rank] = np.column_stack([velocity, spin])
            v[:, 2] *= self._s[:, R]
            inverse, rate = self._p[:, [IM, IM, IJ]], self._drag[:, [0, 0, 1]]
            v[inverse == 0.0] = 0.0
            outside = np.column_stack([self._p[:, [EX, EY]], self._drag[:, 2]])
            c = (outside * inverse + self._fall() - rate * v) / (1.0 + (dt * rate) ** 2)
            self._s[:, [HX, HY, HS]] = v - 0.5 * dt * (contact * inverse + c)
            self._s[:, [FX, FY, T]] = contact + outside
            v, c = v[rank], c[rank]
            self._collide(steps, lambda step: None)
        except BaseException:
            self._restore(good)
            raise
        rank = self._rank
        stay = slice(None) if len(rank) == len(before) else np.isin(before, self.ids)
        contact = self._s[:, [FX, FY, T]]
        contact[:, :2] -= self._p[:, [EX, EY]]
        contact[:, 2] -= self._drag[:, 2]
        end = self._s[rank][:, [HX, HY, HS]]
        end += 0.5 * dt * ((contact * self._p[:, [IM, IM, IJ]])[rank] + c[stay])
        way = self._users(self._s[:, :2]) - start[stay]
        impulse = end[:, :2] - v[stay, :2] + drag[stay, :1] * way
        impulse -= steps * dt * self._fall()[rank, :2]
        impulse *= (self._density[self.ids] * np.pi * self._users(self._s[:, R]) ** 2)[:, None]
        impulse -= steps * dt * force[stay]
        impulse[self.fixed] = 0.0
        # Between pushes the discs are as if there were neither drag nor those forces.
        self._drag = None
        self._p[:, [EX, EY]] = 0.0
        self._force_outside()
        self._s[:, [FX, FY, T]] = contact
        self._s[:, [FX, FY]] += self._p[:, [EX, EY]]
        self._s[rank[:, None], [HX, HY, HS]] = end
        self._s[:, [VX, VY, VS]] = self._s[:, [HX, HY, HS]]
        self._s[:, [HX, HY, HS]] -= 0.5 * dt * self._acceleration()
        return way, end[:, :2], end[:, 2] / self._users(self._s[:, R]), impulse

    def _state(self) -> tuple[Any, ...]:
        """What `motion.forces` works on."""
        return (
            self._s, self._p, self._law, self._pairs, self._touch, self._walls, self._moved,
            self._pairs.offset if self.model.box.periodic else None,
            self.model.contact.rolling or None,
            self._books if len(self._books) else None,
            self._drag,
            self.dt,
        )  # fmt: skip

    def _acceleration(self) -> Float:
        """Accelerations [m/s2], (n, 3), the third that of the surface by spin."""
        return self._s[:, [FX, FY, T]] * self._p[:, [IM, IM, IJ]] + self._fall()

    def _fall(self) -> Float:
        """Accelerations by gravity, in the same columns."""
        fall: Float = (self._p[:, IM] > 0.0)[:, None] * np.array([*self.model.gravity, 0.0])
        return fall

    def _force_outside(self) -> None:
        """Force from outside at the present places."""
        force = self.model.force
        if force is None:
            return
        given = (
            force(self.t, self.x, self._users(self._s[:, [VX, VY]])) if callable(force) else force
        )
        value = rows("force from outside", given, len(self), ids=self.ids)
        self._p[np.ix_(self._rank, [EX, EY])] = value

    def _copy(self) -> tuple[Any, ...]:
        return (
            self.step, self._s.copy(), self._p.copy(), self._moved.copy(), self._books.copy(),
            self._pairs, self._pairs.history.copy(), self._touch, self._touch.history.copy(),
            self._slot, self._rank, self._seen, self._drag,
        )  # fmt: skip

    def _restore(self, good: tuple[Any, ...]) -> None:
        (
            self.step, self._s, self._p, self._moved, self._books,
            links, springs, touch, more, self._slot, self._rank, self._seen, self._drag,
        ) = good  # fmt: skip
        self._pairs, self._touch = links._replace(history=springs), touch._replace(history=more)
        old = self._mesh
        self._mesh = living(self.model.box, self._s[:, :2].copy(), self._s[:, R].copy())
        self._mesh.flips += old.flips
        self._mesh.inverted, self._mesh.made = old.inverted, old.made + 1

    def _blame(self) -> None:
        """Say which particle broke."""
        i = int(np.flatnonzero(~np.isfinite(self._s).all(axis=1))[0])
        raise RunError(
            f"the motion of particle {self._slot[i]} is not finite at t = {self.t:g} s: the forces "
            "on it have blown up"
        )

    def _upkeep(self) -> None:
        """Triangulation and lists for the present places."""
        began = perf_counter()
        speed = np.hypot(self._s[:, HX], self._s[:, HY])
        i, farthest = int(np.argmax(speed)), FARTHEST * self._s[:, R].min()
        if speed[i] * self.dt > farthest:
            stiffness = stiffness_for(speed[i], 1.0 / self._p[i, IM], self._s[:, R].min())
            raise RunError(
                f"particle {self._slot[i]} has become too fast, {speed[i]:.3g} m/s, for its "
                f"contacts at t = {self.t:g} s: raise the stiffness, to "
                f"{stiffness} N/m2 perhaps, or check the forces on it"
            )
        discs, walls = pairs.memory(self._pairs), pairs.memory(self._touch)
        stay = self._stay(self.model.escape)
        if stay is not None:
            new = (np.cumsum(stay) - 1).astype(np.int32)
            new[~stay] = -1
            discs, walls = (
                pairs.renumbered(discs, new, True, (QR, FR)),
                pairs.renumbered(walls, new, False, ()),
            )
            self._take(stay)
            self._rank = np.argsort(self._slot)
            if len(self) == 0:
                raise RunError(f"the last particle left the box at t = {self.t:g} s")
            self._mesh.drop(stay)
        self._mesh.follow(self._s[:, :2])
        if self._mesh.flips - self.sorted > len(self):
            self._sort(discs, walls)
        else:
            self._renew_lists(discs, walls)
        depth, who = self._deepest()
        if depth > pairs.DEEPEST:
            raise RunError(
                f"{who} overlap by {100 * depth:.3g} % of the smallest radius at t = {self.t:g} s, "
                f"at most {100 * pairs.DEEPEST:g} % can be followed: raise the stiffness, to "
                f"{self._law[0] * (10.0 * depth) ** 2:.1g} N/m2 perhaps, or check whether walls or "
                "forces leave them no room"
            )
        self.upkeeps += 1
        self.seconds["upkeep"] += perf_counter() - began

    def _refuse_stuck(self) -> None:
        """Raise if a disc sticks in a wall by more than `MOST_AT_START`."""
        stuck = wall_overlaps(self._s, self._touch, self._walls, self._moved)[0]
        share = stuck / self._s[self._touch.owner, R]
        if len(share) and share.max() > MOST_AT_START:
            e = int(np.argmax(share))
            raise InputError(
                f"particle {self._slot[self._touch.owner[e]]} sticks in "
                f"{self._wall_name(self._touch.other[e])} by {100.0 * share[e]:.3g} % of its "
                f"radius, {100 * MOST_AT_START:g} % is taken at the start: move it inside "
                "(grainmesh.relax(model, particles) does)"
            )

    def _stay(self, escape: str) -> NDArray[np.bool_] | None:
        """Which discs stay, (n,), None for all: one may leave through an open side, no other."""
        box, opened = self.model.box, self.model.open
        if box.periodic:
            return None
        limits = np.array([[-np.inf, -np.inf], [np.inf, np.inf]])
        for side in opened:
            number = SIDES.index(side)
            limits[number % 2, number // 2] = box.size[number // 2] if number % 2 else 0.0
        stay = None
        left = motion.outside(self._s, *limits)
        if left >= 0:
            if escape == "error":
                raise RunError(
                    f"particle {self._slot[left]} left the box through an open side "
                    f"({', '.join(opened)}) at t = {self.t:g} s: enlarge the box, or say "
                    "escape='remove'"
                )
            x, r = self._s[:, :2], self._s[:, R, None]
            stay = ((x + r >= limits[0]) & (x - r <= limits[1])).all(axis=1)
        through, wall = motion.beyond(self._s, self._walls, self._moved)
        if through >= 0:
            raise RunError(
                f"particle {self._slot[through]} was pushed through the "
                f"{self.model.all_walls[wall].side} wall at t = {self.t:g} s: raise the stiffness"
            )
        return stay

    def _sort(self, discs: Memory, walls: Memory) -> None:
        """Number the discs in strips, so that neighbours lie near each other in memory."""
        strip = np.floor(self._s[:, Y] / (4.0 * self._s[:, R].mean()))
        order = np.lexsort((self._s[:, X], strip))
        new = np.empty(len(order), np.int32)
        new[order] = np.arange(len(order))
        self._take(order)
        self._rank = np.argsort(self._slot)
        self._mesh.renumber(new)
        self.sorted = self._mesh.flips
        self._renew_lists(
            pairs.renumbered(discs, new, True, (QR, FR)), pairs.renumbered(walls, new, False, ())
        )

    def _take(self, rows: NDArray[Any]) -> None:
        """Keep only these rows of what belongs to discs, in this order."""
        self._s, self._p, self._slot = self._s[rows], self._p[rows], self._slot[rows]
        if self._drag is not None:
            self._drag = self._drag[rows]

    def _renew_lists(self, discs: Memory, walls: Memory) -> None:
        """Near discs and walls, with the history of those that were near before."""
        radius = np.ascontiguousarray(self._s[:, R])
        with np.errstate(divide="ignore"):
            mass = 1.0 / self._p[:, IM]  # infinite if fixed
        speed = np.hypot(self._s[:, HX], self._s[:, HY])
        usual = 2.0 * np.sqrt((speed**2).mean())  # those at rest now are about to be as fast
        speed = np.append(speed + usual, motion.speeds(self._walls))
        ways = np.clip(LASTS * self.dt * speed, *(np.array([THINNEST, pairs.WAY]) * radius.min()))
        about = self._mesh, radius, mass, self.model.contact, ways
        self._pairs = pairs.near_discs(*about, discs)
        self._touch = pairs.near_walls(*about, walls, self._walls, self._moved)
        places = np.vstack([self._s[:, :2], self._moved[:, :2]])
        self._seen = np.column_stack([places, ways**-2.0])

    def _deepest(self) -> tuple[float, str]:
        """Largest overlap in smallest radii, and whose it is."""
        least = float(self._s[:, R].min())
        o = overlaps(self._s, self._pairs)[0]
        depth = wall_overlaps(self._s, self._touch, self._walls, self._moved)[0]
        worst, who = 0.0, ""
        if len(o) and o.max() > worst:
            e = int(np.argmax(o))
            i, j = self._slot[self._pairs.owner[e]], self._slot[self._pairs.other[e]]
            worst, who = float(o[e]), f"particles {min(i, j)} and {max(i, j)}"
        if len(depth) and depth.max() > worst:
            e = int(np.argmax(depth))
            i, wall = self._slot[self._touch.owner[e]], self._touch.other[e]
            worst, who = float(depth[e]), f"particle {i} and {self._wall_name(wall)}"
        return worst / least, who

    def _wall_name(self, number: int) -> str:
        side = self.model.all_walls[number].side
        return f"the {side} wall" if side else f"wall {number}"


def prove_times(**times: float) -> None:
    """Raise InputError if a time of a run [s], given by its name, is no positive number."""
    for name, value in times.items():
        if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
            raise InputError(f"run: {name} = {value!r} must be a number [s]")
        if not (isfinite(value) and value > 0.0):
            raise InputError(f"run: {name} = {value:g} s must be positive")


def resume(
    folder: str | Path, force: Force | None = None, fluid: Fluid | None = None
) -> Simulation:
    """The simulation saved in a folder; it goes on as if it had not been stopped, bit by bit.

    Parameters
    ----------
    folder : path
        That was given as ``save`` to `Simulation.run`.
    force : callable, optional
        The force of the model again, if it was a function.
    fluid : Fluid, optional
        The fluid of the model again, if its drag law or an inflow is a function of your own.

    Raises
    ------
    InputError
        If there is no checkpoint, it is damaged, or the function is missing.
    """
    model, numbers, arrays = checkpoint.read(folder, fluid)
    if (model.force == checkpoint.FUNCTION) != (force is not None):
        what = (
            "give the force of the model again, it was a function"
            if force is None
            else ("the force of the model is no function, drop force=")
        )
        raise InputError(f"{folder}: {what}")
    simulation = Simulation.__new__(Simulation)
    try:
        simulation.model = model if force is None else replace(model, force=force)
        simulation.seconds = {"steps": 0.0, "upkeep": 0.0}
        simulation._drag = None
        for name in NUMBERS:
            setattr(simulation, name, numbers[name])
        for name in STATE:
            setattr(simulation, "_" + name, arrays[f"state/{name}"])
        for name in ("pairs", "touch"):
            fields = {key: arrays[f"{name}/{key}"] for key in Near._fields}
            setattr(simulation, "_" + name, Near(**fields))
        parts: dict[str, Any] = {
            key[5:]: array for key, array in arrays.items() if key.startswith("mesh/")
        }
        simulation._mesh = Living(box=model.box, **parts, **numbers["mesh"])
        simulation._walls = table(model.all_walls, model.contact.friction)
        simulation._law = law_of(model)
        simulation.flow = None
        if model.fluid is not None:
            held = {key[5:]: array for key, array in arrays.items() if key.startswith("flow/")}
            about = model.box, model.fluid, model.gravity, simulation._discs()
            simulation.flow = Coupling.resumed(*about, numbers["flow"], held)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as fault:
        raise InputError(f"{folder}: the checkpoint is incomplete ({fault})") from None
    return simulation


__all__ = ["Simulation", "prove_times", "resume"]
