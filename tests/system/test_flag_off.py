"""The fit and its messages again as most users have JAX: `jax_enable_x64` off, and every warning an error."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
# All messages, and of the fits those that the flag could touch. The scripts are not here because test_scripts.py runs
# each in a process of its own, which has the flag off and warnings as errors anyway.
FILES = ("test_fitting.py", "test_messages.py")
SELECTED = (
    "test_messages or phong or gbuffer or numpy_float64 or flag or jax_arrays or threads or table or clipped "
    "or prediction or traces_nothing"
)


@pytest.mark.skipif(os.environ.get("DIFFSHADE_TEST_X64") == "0", reason="this is that run")
def test_the_suite_passes_with_the_flag_off():
    options = ["-W", "error", "-n", "0", "-q", "-p", "no:cacheprovider", "-k", SELECTED]
    run = subprocess.run(
        [sys.executable, "-m", "pytest", *options, *(str(TESTS / name) for name in FILES)],
        cwd=TESTS.parent,
        env={**os.environ, "DIFFSHADE_TEST_X64": "0"},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stdout[-5000:] + run.stderr[-2000:]
    assert "passed" in run.stdout
