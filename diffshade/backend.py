"""The machine: does this jaxlib add up correctly, and what its compiler should leave alone."""

from __future__ import annotations

import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxlib.version import __version__ as jaxlib_version

# What is seen through transparent objects: XLA's CPU compiler fuses it, and with it repeats it, for minutes.
UNFUSED = {"xla_disable_hlo_passes": "fusion"}
# Programs of a few numbers compile in 0.1 s with these, where it takes 1 s, and run as fast.
QUICKLY = {
    "xla_backend_optimization_level": 0,
    "xla_cpu_parallel_codegen_split_count": 1,
    "xla_cpu_use_fusion_emitters": False,
}
# Programs that run once over all pixels compile in half the time with these; some run as fast, some take twice as long.
SOONER = {"xla_backend_optimization_level": 1, "xla_cpu_use_fusion_emitters": False}


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


def jit_quickly(program: Callable, static_argnums: int | None = None, options: dict = QUICKLY) -> Callable:
    """Return a jitted program of a few numbers, which on the CPU is compiled without optimisation, or with less.

    Like every program that is compiled with options of its own, it cannot be a part of another.
    """

    @functools.cache
    def jitted() -> Callable:
        return jax.jit(program, static_argnums=static_argnums, compiler_options=_if_known(tuple(options.items())))

    @functools.wraps(program)
    def run(*arguments: Any) -> Any:
        return jitted()(*arguments)

    return run


@functools.cache
def _if_known(options: tuple) -> dict | None:
    """Return options on a CPU whose compiler knows them, which are no promise of XLA's; else None."""
    if jax.default_backend() != "cpu":
        return None
    try:
        jax.jit(lambda: 0.0, compiler_options=dict(options)).lower().compile()
    except (RuntimeError, ValueError):
        return None
    return dict(options)


def _sums(n: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.asarray(jax.jit(lambda n, y: jnp.sum(n[None] * y, -2))(n, y))
