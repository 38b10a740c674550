"""Tests again as most users have JAX, with `jax_enable_x64` off and every warning an error, and with all types checked.

The scripts are not here: test_scripts.py runs each in a process of its own, which has the flag off.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
# what compiles little
QUICK = (
    "arrays bands cameras clusters contradictions exif_exposures fields files gbuffers image_formats images lights "
    "masks materials meshes parameters photographs places residual_quantiles run_store scene_files scenes surfaces "
    "tables"
)
RUNS = {
    "the flag off": ({"DIFFSHADE_TEST_X64": "0"}, ["fits/test_fitting.py", "system/test_messages.py"]),
    "types checked": ({"DIFFSHADE_TEST_TYPES": "1"}, [f"unit/test_{name}.py" for name in QUICK.split()]),
    "all types checked": ({"DIFFSHADE_TEST_TYPES": "1"}, ["unit", "model"]),
}


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * ("all" in name)) for name in RUNS])
def test_it_passes_with(name):
    settings, places = RUNS[name]
    outer = ("PYTEST_", "XLA_FLAGS")  # what this run compiled serves: its programs are looked up by their settings too
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-W", "error", "-n", "0", "-q", "-p", "no:cacheprovider", *places],
        cwd=TESTS,
        env={key: value for key, value in os.environ.items() if not key.startswith(outer)} | settings,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout[-5000:] + run.stderr[-2000:]
    assert "passed" in run.stdout
