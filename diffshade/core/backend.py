"""Backend: a check that this jaxlib adds up correctly, the precision, and options for its compiler."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxlib.version import __version__ as jaxlib_version

T = TypeVar("T")

# What is seen through transparent objects: XLA's CPU compiler fuses it, and with it repeats it, for minutes.
UNFUSED = {"xla_disable_hlo_passes": "fusion"}
# Programs of a few numbers compile in 0.1 s with these, where it takes 1 s, and run as fast.
QUICKLY = {
    "xla_backend_optimization_level": 0,
    "xla_cpu_parallel_codegen_split_count": 1,
    "xla_cpu_use_fusion_emitters": False,
}
# Programs over the pixels compile in half the time with these, and those of a fit run as fast: in 32 parts, as XLA's
# compiler cuts them for as many cores, they take its cores a third longer.
PLAINLY = {"xla_cpu_parallel_codegen_split_count": 2, "xla_cpu_use_fusion_emitters": False}
# Programs that run once over all pixels compile in half the time with these; some run as fast, some take twice as long.
SOONER = {"xla_backend_optimization_level": 1, **PLAINLY}
AT_ONCE = 2**16  # pixels or texels in one call on a GPU, where each operation takes time to start (SCALING.md)


def at_once(of_cache: int) -> int:
    """Return how many pixels or texels a program takes at once: as a core's cache holds, more on a GPU or TPU."""
    return of_cache if jax.default_backend() == "cpu" else max(of_cache, AT_ONCE)


@functools.cache
def check_backend() -> None:
    """Compare a sum over lights, in float32 on this backend, with NumPy's; once a process, before the first render.

    jaxlib 0.10.2 returns one channel's sum for all channels on the CPU for sums of this project's very shape (jax
    issues 39103, 39257, 40412), and a user may have any version. Raises RuntimeError where the sums are wrong.
    """
    random = np.random.default_rng(0)
    n, y = random.random((8, 16000), np.float32), random.random((3, 8, 16000), np.float32)
    # in a thread of its own: the first render may be inside a caller's jit, where nothing would be computed now
    with ThreadPoolExecutor(1) as thread:
        sums = thread.submit(_sums, n, y).result()
    if not np.allclose(sums, np.sum(n * y, -2), rtol=1e-3):
        raise RuntimeError(
            f"jaxlib {jaxlib_version} returns wrong sums on this machine, so nothing computed with it can be "
            "trusted. Install another version: pip install 'jaxlib!=0.10.2'."
        )


@contextlib.contextmanager
def in_float64(given: T = None) -> Iterator[T]:
    """Compute in float64 whatever the global flag says, on the caller's objects `given`, with arrays of their own.

    The only way into float64: whoever enters it with objects of a caller's takes them from here. The context belongs
    to the thread, and leaves the flag as it was.
    """
    with jax.enable_x64(True):
        yield given if given is None else with_new_arrays(given)


def with_new_arrays(tree: T) -> T:
    """Return a tree whose NumPy arrays are new objects that show the same numbers; nothing is copied.

    Where a NumPy array of float64 was a constant of somebody's compiled program, JAX remembers by the array's identity,
    for as long as that program lives, which precision it was shipped in (`_canonicalize_ndarray_dtype` of jax 0.10 is
    a weak cache whose key leaves out the flag). The same object in the other precision then ends in "expected f64[3]
    but got f32[3]", or is silently rounded to float32. A view is an object that JAX has not met. Frozen dataclasses
    that are no trees, such as a `Fit`, get new arrays in all of their fields. An array that stands at several places
    stays one.
    """
    new: dict[int, np.ndarray] = {}

    def anew(leaf: Any) -> Any:
        if isinstance(leaf, np.ndarray):
            return new.setdefault(id(leaf), leaf.view())
        if dataclasses.is_dataclass(leaf) and not isinstance(leaf, type):
            fields = (field.name for field in dataclasses.fields(leaf) if field.init)
            return dataclasses.replace(leaf, **{name: jax.tree.map(anew, getattr(leaf, name)) for name in fields})
        return leaf

    return jax.tree.map(anew, tree)


def jit_quickly(program: Callable, static_argnames: str | Sequence[str] = (), options: dict = QUICKLY) -> Callable:
    """Return a jitted program that the CPU's compiler is quick with, since it optimises less.

    By default it does not optimise at all, which is for programs of a few numbers; `PLAINLY` and `SOONER` are for those
    over pixels. Like every program that is compiled with options of its own, it cannot be a part of another.
    """

    @functools.cache
    def jitted() -> Callable:
        return jax.jit(program, static_argnames=static_argnames, compiler_options=_known(tuple(options.items())))

    @functools.wraps(program)
    def run(*arguments: Any) -> Any:
        return jitted()(*arguments)

    return run


@functools.cache
def _known(options: tuple) -> dict:
    """Return those of some options that this CPU's compiler knows, which are no promise of XLA's; elsewhere none.

    XLA of jax 0.12, for one, has no `xla_cpu_use_fusion_emitters` any more.
    """
    on_cpu = jax.default_backend() == "cpu"
    return {name: value for name, value in options if on_cpu and _compiles(name, value)}


@functools.cache
def _compiles(option: str, value: int | bool) -> bool:
    try:
        jax.jit(lambda: 0.0, compiler_options={option: value}).lower().compile()
    except (RuntimeError, ValueError):
        return False
    return True


def _sums(n: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.asarray(jax.jit(lambda n, y: jnp.sum(n[None] * y, -2))(n, y))
