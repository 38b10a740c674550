"""Progress: one line on the terminal for work that takes longer than two seconds."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import Protocol, runtime_checkable

LONGEST = 86400.0  # seconds over which the pace is measured: a step may take minutes


@runtime_checkable
class ReportProgress(Protocol):
    """Says what is being done, and how much of it, from 0 to 1, where that is known."""

    def __call__(self, words: str, share: float | None = None) -> None: ...


@contextlib.contextmanager
def showing(title: str, *, show: bool = True) -> Iterator[ReportProgress]:
    """Show a line with a title, the time and the time left while the block runs; yield what sets its words.

    Nothing is shown in the first two seconds, nor where standard error is not a terminal, nor unless `show`.
    """
    if not show:
        yield silent
        return
    from rich import progress
    from rich.console import Console

    console = Console(stderr=True)
    with progress.Progress(
        progress.SpinnerColumn(),
        progress.TextColumn("{task.description}", markup=False),
        progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(),
        progress.TextColumn("{task.fields[left]}"),
        console=console,
        transient=True,
        disable=not console.is_terminal,
        speed_estimate_period=LONGEST,
    ) as bar:
        task = bar.add_task(title, visible=False, total=None, left="")
        appear = threading.Timer(2.0, lambda: bar.update(task, visible=True))  # compiling may come before any step
        appear.daemon = True
        appear.start()

        def report_progress(words: str, share: float | None = None) -> None:
            if share is None or share < bar.tasks[task].completed:  # something new, with a pace of its own
                bar.update(task, total=None, completed=0.0, left="")
            done = "" if share is None else f", {share:.0%}"
            bar.update(task, description=f"{title}: {words}{done}")
            if share is not None:
                bar.update(task, total=1.0, completed=share, left="left")

        try:
            yield report_progress
        finally:
            appear.cancel()


def silent(words: str, share: float | None = None) -> None:
    """Take words and show nothing."""
