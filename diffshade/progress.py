"""Progress: one line on the terminal for work that takes longer than two seconds."""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections.abc import Callable, Iterator

import numpy as np

from .fields import Array

_listeners: dict[int, Callable[[int, float], None]] = {}
_numbers = itertools.count()


def report_step(listener: Array, step: Array, cost: Array) -> None:
    """Tell a listener of a step. Compiled programs call this one function, so that a new listener compiles nothing."""
    with contextlib.suppress(KeyError):
        _listeners[int(listener)](int(step), float(cost))


@contextlib.contextmanager
def showing(title: str) -> Iterator[np.ndarray]:
    """Show a line with a title, the step and the cost while the block runs; yield the number of its listener.

    Nothing is shown in the first two seconds, nor where standard error is no terminal.
    """
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    number = next(_numbers)
    with Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ) as bar:
        task = bar.add_task(title, visible=False, total=None)
        appear = threading.Timer(2.0, lambda: bar.update(task, visible=True))  # compiling may come before any step
        appear.start()
        _listeners[number] = lambda step, cost: bar.update(task, description=f"{title}: step {step}, cost {cost:.6g}")
        try:
            yield np.asarray(number)
        finally:
            appear.cancel()
            del _listeners[number]
