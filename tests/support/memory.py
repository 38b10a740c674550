"""How much memory a call takes: this process's own (RssAnon), and the most of all (VmHWM). Linux only."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")
STATUS, CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def _status(name: str) -> int:
    lines = STATUS.read_text(encoding="ascii").splitlines()
    return 1024 * int(next(line.split()[1] for line in lines if line.startswith(name)))


def own_memory() -> int:
    """Return the bytes of this process that are no pages of files."""
    return _status("RssAnon")


def watched(run: Callable[[], T]) -> tuple[int, T]:
    """Return by how many bytes this process's own memory grew at most during a run, and what the run returned."""
    before, most, over = own_memory(), 0, threading.Event()

    def watch() -> None:
        nonlocal most
        while not over.wait(0.005):
            most = max(most, own_memory())

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        found = run()
    finally:
        over.set()
        thread.join()
    return most - before, found


def forget_the_peak() -> int:
    """Let the kernel count the peak of this process's memory, pages of files too, from here on; return what it is."""
    CLEAR.write_text("5", encoding="ascii")
    return _status("VmRSS")


def peak() -> int:
    """Return the most that this process's memory was since `forget_the_peak`."""
    return _status("VmHWM")
