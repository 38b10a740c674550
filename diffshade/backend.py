"""The machine: does this jaxlib add up correctly, and what its compiler should leave alone."""

from __future__ import annotations

import functools
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
from jaxlib.version import __version__ as jaxlib_version

# What is seen through transparent objects: XLA's CPU compiler fuses it, and with it repeats it, for minutes.
UNFUSED = {"xla_disable_hlo_passes": "fusion"}


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


def _sums(n: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.asarray(jax.jit(lambda n, y: jnp.sum(n[None] * y, -2))(n, y))
