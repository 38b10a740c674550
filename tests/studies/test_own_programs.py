"""Every public function that computes after programs of a user's own, in a process of its own with the flag off."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SUPPORT = Path(__file__).parents[1] / "support"


@pytest.mark.slow
@pytest.mark.parametrize("how", ["grad", "jit", "vmap", "float64"])
def test_every_function_gives_the_same_after_a_program_of_the_users_own(how):
    environment = {name: value for name, value in os.environ.items() if name != "JAX_ENABLE_X64"}
    paths = f"{SUPPORT.parents[1]}{os.pathsep}{environment.get('PYTHONPATH', '')}"
    if (programs := os.environ.get("DIFFSHADE_TEST_PROGRAMS")) is not None:  # what one compiles the next one reads
        kept = {"JAX_COMPILATION_CACHE_DIR": programs, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.1"}
        environment |= kept
    run = subprocess.run(
        [sys.executable, SUPPORT / "own_programs.py", how],
        env={**environment, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=False,
    )
    print(run.stdout)
    assert run.returncode == 0, run.stdout[-5000:] + run.stderr[-2000:]
    assert "WRONG" not in run.stdout
    assert run.stdout.count(": right") > 40
