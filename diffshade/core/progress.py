"""Progress: one line on the terminal for work that takes longer than two seconds, and a line a stage in a pipe."""

from __future__ import annotations

import contextlib
import math
import sys
import threading
from collections.abc import Iterator
from typing import Protocol, runtime_checkable

BETWEEN = 10.0  # seconds between lines in a pipe: what is done sooner says nothing


@runtime_checkable
class ReportProgress(Protocol):
    """Says what is being done, and how much of it, from 0 to 1, where that is known."""

    def __call__(self, words: str, share: float | None = None) -> None: ...


@contextlib.contextmanager
def showing(title: str, *, show: bool = True) -> Iterator[ReportProgress]:
    """Show a line with a title, the time, and that left of a stage, while the block runs; yield what sets its words.

    Nothing is shown in the first two seconds, nor unless `show`. Where standard error is not a terminal, the words are
    written to it as a line after ten seconds, and again when ten more have passed and they have changed.
    """
    if not show:
        yield silent
        return
    from rich import progress
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        with _writing(title) as write_progress:
            yield write_progress
        return
    with progress.Progress(
        progress.SpinnerColumn(),
        progress.TextColumn("{task.description}", markup=False),
        progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(),
        progress.TextColumn("{task.fields[left]}"),
        console=console,
        transient=True,
        speed_estimate_period=math.inf,  # a step may take minutes
    ) as bar:
        task = bar.add_task(title, visible=False, total=None, left="")
        appear = threading.Timer(2.0, lambda: bar.update(task, visible=True))  # compiling may come before any step
        appear.daemon = True
        appear.start()

        def report_progress(words: str, share: float | None = None) -> None:
            if share is None or share < bar.tasks[task].completed:  # something new, with a pace of its own
                bar.update(task, total=None, completed=0.0, left="")
            bar.update(task, description=_line(title, words, share))
            if share is not None:
                bar.update(task, total=1.0, completed=share, left="left of this stage")

        try:
            yield report_progress
        finally:
            appear.cancel()


def _line(title: str, words: str, share: float | None) -> str:
    return f"{title}: {words}" + ("" if share is None else f", {share:.0%}")


@contextlib.contextmanager
def _writing(title: str) -> Iterator[ReportProgress]:
    """Write what is being done to standard error, a line at a time."""
    now, ended = [title], threading.Event()

    def write() -> None:
        written = ""
        while not ended.wait(BETWEEN):
            if now[0] != written:
                written = now[0]
                print(written, file=sys.stderr, flush=True)

    def report_progress(words: str, share: float | None = None) -> None:
        now[0] = _line(title, words, share)

    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    try:
        yield report_progress
    finally:
        ended.set()
        writer.join()


def silent(words: str, share: float | None = None) -> None:
    """Take words and show nothing."""
