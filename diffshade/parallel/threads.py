"""Threads: run compiled programs on all cores of this process, in float64, and return results in order."""

from __future__ import annotations

import contextlib
import functools
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

import jax
from threadpoolctl import ThreadpoolController

from ..core.backend import in_float64

S = TypeVar("S")
T = TypeVar("T")


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@functools.cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(cores(), thread_name_prefix="diffshade")


def on_all_cores(work: Callable[[S], T], items: Iterable[S]) -> list[T]:
    """Return work(item) for each item, in order, in float64, on one thread a core.

    A scan runs on one core; a compiled program that is called from several threads runs on several cores.
    """

    def worked(item: S) -> T:
        with in_float64():  # the context belongs to the thread
            return jax.block_until_ready(work(item))

    items = list(items)
    if len(items) > 1:
        return list(_threads().map(worked, items))
    with in_float64():
        return [work(item) for item in items]  # nobody else waits for the core: what follows is prepared meanwhile


def one_ahead(work: Callable[[S], T], items: Iterable[S]) -> Iterator[T]:
    """Yield work(item) for each item, in order, in float64, on another thread while the caller uses the last result."""

    def worked(item: S) -> T:
        with in_float64():
            return work(item)

    waiting: Future[T] | None = None
    with ThreadPoolExecutor(1, thread_name_prefix="diffshade") as pool:
        for item in items:
            following = pool.submit(worked, item)
            if waiting is not None:
                yield waiting.result()
            waiting = following
        if waiting is not None:
            yield waiting.result()


class _OneBlasThread:
    """Limits NumPy's linear algebra to one thread while anyone is inside; the last one to leave restores the number."""

    def __init__(self) -> None:
        self.lock, self.inside, self.limit = threading.Lock(), 0, contextlib.ExitStack()

    def __enter__(self) -> None:
        with self.lock:
            if self.inside == 0:
                self.limit.enter_context(_blas().limit(limits=1, user_api="blas"))
            self.inside += 1

    def __exit__(self, *_: Any) -> None:
        with self.lock:
            self.inside -= 1
            if self.inside == 0:
                self.limit.close()


@functools.cache
def _blas() -> ThreadpoolController:
    return ThreadpoolController()


ONE_BLAS_THREAD = _OneBlasThread()
"""For matrices of a few hundred rows. More threads gain little there, and wait for each other where other programs run:
on two such cores the eigenvectors of 583 rows took 4.7 s in place of 0.06 s."""
