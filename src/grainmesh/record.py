"""A run in a folder: its case, log, checkpoints, history and frames, so that it can go on.

    record(case.simulation(), "out/bed", until=1.0, every=0.01)
    resume("out/bed")

Rows of the history, frames and checkpoints belong to marks in time, the multiples of `every` and
`frames`, at which steps end. So a run that is stopped or killed and resumed makes the same steps,
and the same files, as one that never was. What was written after the checkpoint that a run goes on
from is dropped first.
"""

from __future__ import annotations

import json
import os
import platform
import signal
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from importlib import import_module
from math import ceil
from pathlib import Path
from time import perf_counter
from typing import Any, TextIO

from numpy.typing import ArrayLike

from grainmesh import case, checkpoint, history, simulation, vtkhdf
from grainmesh.errors import InputError, RunError
from grainmesh.progress import bar, told
from grainmesh.report import prove_writable
from grainmesh.simulation import Simulation

CASE, LOG, ENVIRONMENT = "case.toml", "run.log", "environment.json"
FILES = (CASE, LOG, ENVIRONMENT, checkpoint.NAME, history.NAME, vtkhdf.FLOW, vtkhdf.DISCS)
#: Most of the time of a run that checkpoints and the history file may take before its end.
SHARE = {"checkpoint": 0.01, "history": 0.005}
#: What they take at first, perhaps [s].
AT_FIRST = {"checkpoint": 0.05, "history": 0.3}
#: Most frames kept in memory.
MANY = 16


@dataclass(frozen=True)
class Plan:
    """When a run ends and what it writes.

    Parameters
    ----------
    until : float
        Time to reach [s].
    every : float
        Interval of rows of the history, and of checkpoints unless those take too long [s].
    frames : float
        Interval of frames [s]; there is one more at the end.
    cuts : int
        Pieces that each edge of the mesh is cut into in a frame, to show fields of higher order.
    probes : (k, 2)
        Places at which the history has velocity and pressure of the fluid [m].

    Raises
    ------
    InputError
        If a value is out of its range.
    """

    until: float
    every: float
    frames: float
    cuts: int = 1
    probes: ArrayLike = ()

    def __post_init__(self) -> None:
        simulation.prove_times(until=self.until, every=self.every, frames=self.frames)
        if self.cuts < 1:
            raise InputError(f"run: cuts = {self.cuts} must be at least 1")
        object.__setattr__(self, "probes", history.places(self.probes).tolist())


class Stopped(KeyboardInterrupt):
    """A run that was asked to stop, and did after a whole step.

    Attributes
    ----------
    signal : int
        SIGINT or SIGTERM.
    """

    def __init__(self, message: str, number: int) -> None:
        super().__init__(message)
        self.signal = number


def record(
    begun: Simulation,
    folder: str | Path,
    until: float,
    every: float | None = None,
    frames: float | None = None,
    cuts: int = 1,
    probes: ArrayLike = (),
    shown: bool = False,
    log: str | Path | None = None,
) -> Simulation:
    """Run a simulation and write all that it leaves into a folder.

    Parameters
    ----------
    begun : Simulation
        At time 0; that of a case (`Case.simulation`) brings the text for ``case.toml``.
    folder : path
        Made if need be: ``case.toml``, ``run.log``, ``environment.json`` (versions, machine, plan,
        seconds), ``checkpoint.h5`` and the one before, ``history.nc``, ``discs.vtkhdf`` and, with a
        fluid, ``flow.vtkhdf``.
    until, every, frames, cuts, probes
        See `Plan`; every is a hundredth of until if not given, frames is every.
    shown : bool
        Show how far it is on stderr.
    log : path, optional
        In place of ``run.log``.

    Returns
    -------
    Simulation
        The same, at the end.

    Raises
    ------
    InputError
        If the folder holds a run or cannot be written, a value is out of its range, a probe is
        outside of the box, or the disk is full; the last checkpoint is whole.
    RunError
        If the run cannot go on; the last good state is saved, if it is later than the start.
    Stopped
        After Ctrl-C or SIGTERM, when the step is done and saved. A second one ends it at once.
    """
    every = until / 100.0 if every is None else every
    plan = Plan(until, every, every if frames is None else frames, cuts, probes)
    folder = Path(folder)
    if begun.step > 0:
        raise InputError("record: the simulation has begun already, give one at time 0")
    prove_vacant(folder)
    history.places(plan.probes, begun.model.box)
    if log:
        _opened(Path(log)).close()
    text, source = (begun.about.get(name, "") for name in ("case", "source"))
    begun.about = {"plan": asdict(plan), "case": text}
    begun.history = [begun.measure()]
    begun.history[0] |= history.more(begun, plan.probes)
    with _written(folder):
        folder.mkdir(parents=True, exist_ok=True)
    with _only_writer(folder):
        with _written(folder):
            if text:
                _write(folder / CASE, text)
            _write(folder / ENVIRONMENT, _json(_environment(plan, source)))
        begun.save(folder)
        try:
            return _go(begun, folder, shown, log)
        except RunError:
            if begun.step == 0:  # nothing to go on from, and in the way of the next run
                for name in (*FILES, checkpoint.OLD):
                    (folder / name).unlink(missing_ok=True)
                with suppress(OSError):  # other files are in it
                    folder.rmdir()
            raise


def prove_vacant(folder: str | Path) -> None:
    """Make sure that a folder can take a run, before the particles are arranged.

    Raises
    ------
    InputError
        If it holds a run, or cannot be written.
    """
    folder = Path(folder)
    for name in (checkpoint.NAME, checkpoint.OLD):
        if (folder / name).exists():
            raise InputError(
                f"{folder}: holds a run already: go on with it (grainmesh resume {folder}), or "
                "choose another folder"
            )
    prove_writable(folder, FILES)


def resume(
    folder: str | Path,
    until: float | None = None,
    shown: bool = False,
    log: str | Path | None = None,
) -> Simulation:
    """Go on with the run in a folder, as if it had not been interrupted, bit by bit.

    Parameters
    ----------
    folder : path
    until : float, optional
        Another time to reach [s]. A run that is done already is left as it is, with a warning.
    shown, log
        As of `record`.

    Raises
    ------
    InputError
        If there is no run, another process is writing it, its files are damaged, ``case.toml`` was
        edited, or it has passed `until`; then as `record`.
    """
    folder = Path(folder)
    with _only_writer(folder):
        return _resume(folder, until, shown, log)


def _resume(folder: Path, until: float | None, shown: bool, log: str | Path | None) -> Simulation:
    begun = _resumed(folder)
    if "plan" not in begun.about:
        raise InputError(
            f"{folder}: holds a checkpoint, but no run of a case: grainmesh.resume(folder) in "
            "Python goes on from it"
        )
    if begun.about.get("case"):
        _refuse_edited(folder, begun.about["case"])
    plan = Plan(**begun.about["plan"])
    plan = replace(plan, until=plan.until if until is None else until)
    last = _last(begun, plan)
    if last < begun.step:
        raise InputError(f"{folder}: the run has reached t = {begun.t:.6g} s: give a later --until")
    begun.about["plan"] = asdict(plan)
    if last == begun.step and _complete(begun, folder, plan):
        warnings.warn(
            f"{folder}: done already at t = {begun.t:.6g} s, --until goes on", stacklevel=2
        )
        return begun
    return _go(begun, folder, shown, log)


def _resumed(folder: Path) -> Simulation:
    if not any((folder / name).exists() for name in (checkpoint.NAME, checkpoint.OLD)):
        raise InputError(
            f"{folder}: holds no run that could go on; name the folder of one, or begin one "
            "(grainmesh run CASE --out DIR)"
        )
    try:
        return simulation.resume(folder)
    except checkpoint.Asked as asked:
        if not asked.about.get("case"):
            raise
        source = _environment_of(folder).get("case") or folder / CASE
        return case.parse(asked.about["case"], source).resume(folder)


def _refuse_edited(folder: Path, text: str) -> None:
    """Refuse a ``case.toml`` that is no longer the case of the run; write it if it is gone."""
    path = folder / CASE
    if not path.exists():
        with _written(folder):
            _write(path, text)
    if path.read_bytes().split() != text.encode().split():
        raise InputError(
            f"{path}: is not the case that the run was begun with, which its checkpoint holds: "
            "remove it or undo the changes, or begin another run with it (grainmesh run)"
        )


@contextmanager
def _only_writer(folder: Path) -> Iterator[None]:
    """Keep other processes from writing the same run."""
    if os.name != "posix" or not folder.is_dir():
        yield
        return
    import fcntl

    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(
                    f"{folder}: another process is writing this run: wait for its end, or choose "
                    "another folder"
                ) from None
        yield
    finally:
        os.close(handle)


def _complete(run: Simulation, folder: Path, plan: Plan) -> bool:
    """Whether all files of a run were written to its end."""
    with suppress(InputError):
        ended = float(history.read(folder).t[-1]) == run.t
        return ended and _environment_of(folder).get("plan") == asdict(plan)
    return False


def _last(run: Simulation, plan: Plan) -> int:
    """The step at which a plan ends."""
    return ceil(plan.until / run.dt - 1e-6)


def _go(run: Simulation, folder: Path, shown: bool, log: str | Path | None) -> Simulation:
    """From the present state to the end of the plan."""
    plan = Plan(**run.about["plan"])
    last = _last(run, plan)
    output = _Output(run, folder, plan, Path(log) if log else folder / LOG)
    with _signals() as caught, output:
        output.begin(last)
        try:
            with bar(run, last, shown) as draw:

                def tell(step: int) -> None:
                    draw(step)
                    if caught and step < due:  # at a mark, what is due is written first
                        raise Stopped("", caught[0])

                while run.step < last:
                    due = _next(run, plan, last)
                    run.run(due * run.dt, progress=tell)
                    output.mark(last)
                    if caught and run.step < last:
                        raise Stopped("", caught[0])
        except (Stopped, RunError) as why:
            output.end()
            if isinstance(why, RunError):
                output.log(f"failed: {why}")
                kept = f"the last good state is in {folder}" if run.step else "nothing is kept"
                raise RunError(f"{why}; {kept}") from None
            output.log(f"stopped by signal {why.signal} at t = {run.t:.6g} s")
            raise Stopped(
                f"stopped at t = {run.t:.6g} s; go on with: grainmesh resume {folder}", why.signal
            ) from None
        output.end()
        output.log(f"done at t = {run.t:.6g} s")
    return run


def _step(after: int, dt: float, interval: float) -> int:
    """The first step after another that ends at or past a multiple of an interval."""
    number = int(after * dt / interval)
    while (mark := ceil(number * interval / dt - 1e-6)) <= after:
        number += 1
    return mark


def _next(run: Simulation, plan: Plan, last: int) -> int:
    """The step of the next mark."""
    return min(last, *(_step(run.step, run.dt, each) for each in (plan.every, plan.frames)))


class _Output:
    """The files of a run that grow, and the time they take."""

    def __init__(self, run: Simulation, folder: Path, plan: Plan, log: Path) -> None:
        self.run, self.folder, self.plan = run, folder, plan
        self.began = perf_counter()
        self.frames: dict[str, list[vtkhdf.Frame]] = {vtkhdf.FLOW: [], vtkhdf.DISCS: []}
        self.spent = {"frames": 0.0, "checkpoint": 0.0, "history": 0.0}
        self.before: dict[str, float] = _environment_of(folder).get("seconds", {})
        self.file = _opened(log)

    def __enter__(self) -> _Output:
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()

    def log(self, text: str) -> None:
        """A line in the log, with the date."""
        with suppress(OSError):  # a full disk has been told already
            self.file.write(f"{datetime.now().isoformat(timespec='seconds')} {text}\n")

    def begin(self, last: int) -> None:
        """Drop what is later than the state; the first frame and the first line of the log."""
        run, versions = self.run, checkpoint.versions()
        for name in (vtkhdf.DISCS,) if run.flow is None else (vtkhdf.DISCS, vtkhdf.FLOW):
            if run.step and not (self.folder / name).exists():
                raise InputError(
                    f"{self.folder / name}: is missing, the frames of the run so far: put it back, "
                    "or begin another run"
                )
            vtkhdf.cut(self.folder / name, run.t if run.step else -1.0)
        self.log(
            f"{'resumed' if run.step else 'started'} at t = {run.t:.6g} s, {len(run)} particles, "
            f"step {run.step} of {last}; " + ", ".join(f"{k} {v}" for k, v in versions.items())
        )
        import_module("xarray")  # takes a second, which is not that of writing
        if run.step == 0:
            self._frame()
            self._write_frames()

    def mark(self, last: int) -> None:
        """What is due at the present step."""
        run, plan = self.run, self.plan
        row = run.history.pop()
        every, frames = (
            run.step in (_step(run.step - 1, run.dt, each), last)
            for each in (plan.every, plan.frames)
        )
        if frames:
            self._frame()
        if every:
            run.history.append(row)
            row |= history.more(run, plan.probes)
            # What is not written now is dropped if the run is killed, and then made again.
            if self._affords("checkpoint"):
                self._save()
            if self._affords("history"):
                self._table()
            self.log(f"t = {run.t:.6g} s, step {run.step}, {told(run)}")

    def end(self) -> None:
        """The state, the history, and the time that all took."""
        self._save()
        self._table()
        flow = self.run.flow
        now = self.run.seconds | (flow.seconds if flow is not None else {})
        now |= {f"writing {name}": value for name, value in self.spent.items()}
        total = {name: value + self.before.get(name, 0.0) for name, value in now.items()}
        with _written(self.folder):
            found = _environment_of(self.folder) or _environment(self.plan, "")
            elapsed = perf_counter() - self.began + found.get("elapsed", 0.0)
            found |= {"plan": asdict(self.plan), "seconds": total, "elapsed": elapsed}
            _write(self.folder / ENVIRONMENT, _json(found))

    def _affords(self, what: str) -> bool:
        """Whether the time spent on something leaves room for more of it."""
        elapsed = perf_counter() - self.began
        return max(self.spent[what], AT_FIRST[what]) < SHARE[what] * elapsed

    def _frame(self) -> None:
        """A frame, written with the next checkpoint: it would be dropped without it."""
        with self._timed("frames"):
            if self.run.flow is not None:
                self.frames[vtkhdf.FLOW].append(vtkhdf.flow(self.run, self.plan.cuts))
            self.frames[vtkhdf.DISCS].append(vtkhdf.discs(self.run))
        if len(self.frames[vtkhdf.DISCS]) >= MANY:
            self._write_frames()

    def _write_frames(self) -> None:
        with self._timed("frames"):
            for name, frames in self.frames.items():
                if frames:
                    vtkhdf.append(self.folder / name, *frames)
                    frames.clear()

    def _save(self) -> None:
        self._write_frames()
        with self._timed("checkpoint"):
            self.run.save(self.folder)

    def _table(self) -> None:
        with self._timed("history"):
            history.write(self.folder / history.NAME, history.table(self.run, self.plan.probes))

    @contextmanager
    def _timed(self, what: str) -> Iterator[None]:
        began = perf_counter()
        try:
            yield
        finally:
            self.spent[what] += perf_counter() - began


@contextmanager
def _signals() -> Iterator[list[int]]:
    """A list that gets the number of SIGINT or SIGTERM; a second one interrupts at once."""
    caught: list[int] = []

    def note(number: int, _: object) -> None:
        if caught:
            raise KeyboardInterrupt
        caught.append(number)

    if threading.current_thread() is not threading.main_thread():
        yield caught
        return
    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield caught
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _environment(plan: Plan, source: str | Path) -> dict[str, Any]:
    """What a run was made with."""
    return {
        "versions": checkpoint.versions(),
        "system": platform.platform(),
        "machine": platform.machine(),
        "processors": os.cpu_count(),
        "started": datetime.now().isoformat(timespec="seconds"),
        "command": sys.argv,
        "case": str(Path(source).absolute()) if source else "",
        "plan": asdict(plan),
    }


def _environment_of(folder: Path) -> dict[str, Any]:
    """The same from its file; nothing if there is none, or it is damaged."""
    with suppress(OSError, ValueError):
        found = json.loads((folder / ENVIRONMENT).read_text("utf-8"))
        if isinstance(found, dict):
            return found
    return {}


def _opened(log: Path) -> TextIO:
    """A log, to be added to."""
    try:
        return log.open("a", encoding="utf-8", buffering=1)
    except OSError as fault:
        raise InputError(f"{log}: cannot be written ({fault.strerror})") from None


def _json(found: dict[str, Any]) -> str:
    return json.dumps(found, indent=2) + "\n"


def _write(path: Path, text: str) -> None:
    """Write a file; an old one is replaced at the end."""
    new = path.with_name(path.name + ".new")
    new.write_text(text, encoding="utf-8")
    os.replace(new, path)


@contextmanager
def _written(folder: Path) -> Iterator[None]:
    """Say in one line that files cannot be written."""
    try:
        yield
    except OSError as fault:
        raise InputError(
            f"{folder}: cannot be written ({fault.strerror}): make room or choose another folder"
        ) from None


__all__ = ["CASE", "ENVIRONMENT", "LOG", "Plan", "Stopped", "prove_vacant", "record", "resume"]
