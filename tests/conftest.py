"""Strict settings for every test; the library itself changes no JAX configuration."""

import os
import shutil
import tempfile
from pathlib import Path

import jax
import pytest
from jaxtyping import install_import_hook

# test_flag_off.py runs the fit, script and message tests again with the flag off, as most users have it
jax.config.update("jax_enable_x64", os.environ.get("DIFFSHADE_TEST_X64", "1") == "1")
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

install_import_hook("diffshade", "beartype.beartype")

PROGRAMS = "DIFFSHADE_TEST_PROGRAMS"


def pytest_configure(config):
    """Let the processes of one run share what they compile: most of the time of the tests is the compiler's."""
    if PROGRAMS not in os.environ:
        os.environ[PROGRAMS] = config.programs = tempfile.mkdtemp(prefix="diffshade-programs-")
    jax.config.update("jax_compilation_cache_dir", os.environ[PROGRAMS])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


def pytest_unconfigure(config):
    if hasattr(config, "programs"):  # the process that made the folder; the others read its name
        shutil.rmtree(config.programs, ignore_errors=True)
        del os.environ[PROGRAMS]


MAPS = Path("/proc/self/maps")
MOST_MAPS = 30_000


@pytest.fixture(autouse=True)
def few_programs():
    """Forget compiled programs before they are too many: each holds memory maps, of which Linux allows 65,530."""
    yield
    if MAPS.exists() and MAPS.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()
