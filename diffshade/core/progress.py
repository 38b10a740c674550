"""Progress: one line on the terminal for work that takes longer than two seconds."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from typing import Protocol, runtime_checkable


@runtime_checkable
class ReportProgress(Protocol):
    """Says what is being done, and how much of it, from 0 to 1, where that is known."""

    def __call__(self, words: str, share: float | None = None) -> None: ...


@contextlib.contextmanager
def showing(title: str, *, show: bool = True) -> Iterator[ReportProgress]:
    """Show a line with a title and the time while the block runs, and the time left; yield what sets its words.

    Nothing is shown in the first two seconds, nor where standard error is not a terminal, nor unless `show`.
    """
    if not show:
        yield silent
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    with Progress(
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ) as bar:
        task = bar.add_task(title, visible=False, total=None)
        appear = threading.Timer(2.0, lambda: bar.update(task, visible=True))  # compiling may come before any step
        appear.daemon = True
        appear.start()
        pace = _Pace()

        def report_progress(words: str, share: float | None = None) -> None:
            bar.update(task, description=", ".join([f"{title}: {words}", *pace.words(share)]))

        try:
            yield report_progress
        finally:
            appear.cancel()


class _Pace:
    """How fast a share grows. One that is smaller than the last one begins something new."""

    def __init__(self) -> None:
        self.begun, self.first, self.last = 0.0, 1.0, 1.0

    def words(self, share: float | None) -> list[str]:
        """Return the share and the time left, in words."""
        if share is None:
            return []
        now = time.monotonic()
        if share < self.last:
            self.begun, self.first = now, share
        self.last = share
        done = [f"{share:.0%}"]
        if share > self.first:
            done.append(f"about {_duration((now - self.begun) * (1.0 - share) / (share - self.first))} left")
        return done


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def silent(words: str, share: float | None = None) -> None:
    """Take words and show nothing."""
