"""Strict settings for every test; the library itself changes no JAX configuration."""

import os

import jax
from jaxtyping import install_import_hook

# test_flag_off.py runs the fit, script and message tests again with the flag off, as most users have it
jax.config.update("jax_enable_x64", os.environ.get("DIFFSHADE_TEST_X64", "1") == "1")
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

install_import_hook("diffshade", "beartype.beartype")
