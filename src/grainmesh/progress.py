"""A bar on stderr: time, step, and the time still needed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn


@contextmanager
def bar(shown: bool, first: int, last: int, dt: float) -> Iterator[Callable[[int], None]]:
    """A function that takes the step reached; it draws nothing if not `shown`."""
    if not shown:
        yield lambda step: None
        return
    columns = (
        TextColumn("t = {task.fields[time]:.4g} s"),
        BarColumn(),
        TextColumn("step {task.completed:,.0f} of {task.total:,.0f}, left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("", total=last, completed=first, time=first * dt)
        drawn = perf_counter()

        def tell(step: int) -> None:
            nonlocal drawn
            if step == last or perf_counter() - drawn > 0.2:
                progress.update(task, completed=step, time=step * dt)
                drawn = perf_counter()

        yield tell


__all__ = ["bar"]
