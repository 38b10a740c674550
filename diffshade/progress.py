"""Progress: one line on the terminal for work that takes longer than two seconds."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator


@contextlib.contextmanager
def showing(title: str) -> Iterator[Callable[[str], None]]:
    """Show a line with a title and the time while the block runs; yield what sets the words after the title.

    Nothing is shown in the first two seconds, nor where standard error is no terminal.
    """
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
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
        try:
            yield lambda words: bar.update(task, description=f"{title}: {words}")
        finally:
            appear.cancel()


def share_and_time(done: int, of: int, seconds: float) -> str:
    """Return in words how much is done of all, and how long the rest will take."""
    left = f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
    return f"{done / of:.0%}, about {left} left"


def silent(words: str) -> None:
    """Take words and show nothing."""
