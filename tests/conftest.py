"""Strict settings for every test; the library itself changes no JAX configuration."""

import os
from pathlib import Path

import jax
import pytest
from jaxtyping import install_import_hook

# test_flag_off.py runs the fit, script and message tests again with the flag off, as most users have it
jax.config.update("jax_enable_x64", os.environ.get("DIFFSHADE_TEST_X64", "1") == "1")
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

install_import_hook("diffshade", "beartype.beartype")

MAPS = Path("/proc/self/maps")
MOST_MAPS = 30_000


@pytest.fixture(autouse=True)
def few_programs():
    """Forget compiled programs before they are too many: each holds memory maps, of which Linux allows 65,530."""
    yield
    if MAPS.exists() and MAPS.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()
