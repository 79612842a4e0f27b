"""A bar on stderr: time, the time still needed, step, iterations and residuals."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from time import perf_counter
from typing import Any, Protocol

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)

#: Names in rows of the history that end so are residuals.
RESIDUAL = " residual"


class Running(Protocol):
    """What the bar looks at; `flow` has `dt` and `iterations`, or is None."""

    step: int
    dt: float
    history: list[dict[str, float]]
    flow: Any


def told(simulation: Running) -> str:
    """Step of the flow or of contacts, iterations, and the last residuals, in one line."""
    flow = simulation.flow
    parts = [f"dt {(simulation.dt if flow is None else flow.dt):.2g} s"]
    if flow is not None:
        parts.append(f"{flow.iterations} iterations")
    row: Mapping[str, float] = simulation.history[-1] if simulation.history else {}
    residuals = [key for key in row if key.endswith(RESIDUAL)]
    return ", ".join(parts + [f"{key.removesuffix(RESIDUAL)} {row[key]:.0e}" for key in residuals])


@contextmanager
def bar(simulation: Running, last: int, shown: bool = True) -> Iterator[Callable[[int], None]]:
    """A function that takes the step reached; it draws nothing if not `shown`.

    Parameters
    ----------
    simulation : Simulation
    last : int
        Step at which the run ends.
    shown : bool
    """
    if not shown:
        yield lambda step: None
        return
    columns = (
        TextColumn("t = {task.fields[time]:.4g} s"),
        BarColumn(10),
        TaskProgressColumn(),
        TimeRemainingColumn(compact=True),
        TextColumn("[dim]{task.fields[told]}"),  # all of it fits 80 columns
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        first, dt = simulation.step, simulation.dt
        task = progress.add_task("", total=last, completed=first, time=first * dt, told="")
        drawn = perf_counter()

        def tell(step: int) -> None:
            nonlocal drawn
            if step == last or perf_counter() - drawn > 0.2:
                progress.update(task, completed=step, time=step * dt, told=told(simulation))
                drawn = perf_counter()

        yield tell


__all__ = ["RESIDUAL", "bar", "told"]
