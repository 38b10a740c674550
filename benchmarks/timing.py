"""One way of timing: programs take turns, round after round, so that what slows the machine slows all of them.

Report ratios: of each round by itself, and of these the median. Seconds are medians over the rounds, and mean little on
a machine that others use, whose load is told beside them.
"""

from __future__ import annotations

import ctypes
import datetime
import gc
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

Seconds = dict[str, list[float]]  # of each program, round by round


def take_turns(
    programs: Mapping[str, Callable[[], Any]],
    rounds: int,
    title: str = "",
    clock: Callable[[], float] = time.perf_counter,
) -> Seconds:
    """Run each program once, which compiles it, and then all in turn; return the seconds until each result is there.

    In its turn a program runs twice, and the second time counts: then memory and caches are as they are in a loop of
    its own, not as the program before it left them.

    `title`: shows progress. `clock`: `time.process_time` counts what all threads computed instead, which others' load
    hardly changes, but which does not see whether the cores were used side by side.
    """
    import jax

    for run in programs.values():
        jax.block_until_ready(run())
    found: Seconds = {name: [] for name in programs}
    shown = Console(stderr=True)
    for _ in track(range(rounds), description=title, console=shown, transient=True, disable=not title):
        for name, run in programs.items():
            jax.block_until_ready(run())
            started = clock()
            jax.block_until_ready(run())
            found[name].append(clock() - started)
    return found


def medians(seconds: Seconds) -> dict[str, float]:
    """Return the median time of each program."""
    return {name: float(np.median(of)) for name, of in seconds.items()}


def ratio(seconds: Seconds, slow: str, fast: str) -> float:
    """Return how many times as long one program takes as another: the median of the rounds' ratios."""
    return float(np.median(np.divide(seconds[slow], seconds[fast])))


def in_a_process(script: str | Path, *arguments: str, environment: Mapping[str, str] | None = None) -> dict:
    """Run a script in a process of its own; return its last line, a JSON object, and how many bytes of `stderr`."""
    command = [sys.executable, str(script), *arguments]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, **(environment or {})}
    )
    if done.returncode:
        sys.exit(f"{' '.join(command)}: {done.stderr[-2000:]}")
    return {**json.loads(done.stdout.splitlines()[-1]), "stderr": len(done.stderr.encode())}


def forget_peak() -> None:
    """Give freed memory back to the system and start the process's peak anew (Linux)."""
    gc.collect()
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def memory(key: str) -> float:
    """Return this process's memory now (VmRSS) or at its peak (VmHWM), in MB."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith(key)) / 1024


def conditions() -> str:
    """Say when, on what and under which load this is measured."""
    import jax
    from jaxlib.version import __version__ as jaxlib

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    device = jax.devices()[0]
    load = " ".join(f"{of:.1f}" for of in os.getloadavg())
    return (
        f"{datetime.date.today()}, {cores} cores, {device.device_kind} ({device.platform}), jax {jax.__version__}, "
        f"jaxlib {jaxlib}, NumPy {np.__version__}, load {load}"
    )
