"""Long fits of texels: more photographs than memory, kills, several devices and processes."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest
from texel_run import problem

import diffshade as ds

SCRIPT = Path(__file__).parents[1] / "support" / "texel_run.py"


def start(folder: Path, height: int, width: int, count: int, share: float, *more: str, **env: str) -> subprocess.Popen:
    given = [str(x) for x in (folder, height, width, count, share)]
    paths = [str(Path(ds.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    around = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), **env}
    return subprocess.Popen(
        [sys.executable, str(SCRIPT), *given, *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=around,
    )


def finish(run: subprocess.Popen, seconds: float = 600.0) -> str:
    out, error = run.communicate(timeout=seconds)
    assert run.returncode == 0, error
    return out


def done(folder: Path) -> int:
    path = folder / "done.npy"
    return int(np.load(path).sum()) if path.is_file() else 0


def maps_of(folder: Path) -> dict[str, np.ndarray]:
    return {path.stem: np.load(path) for path in sorted(folder.glob("*.npy"))}


def kill_at_random(folder: Path, kills: int, given: tuple, *more: str) -> list[int]:
    """Start a run, kill it after another tile or two are done, again and again; the numbers of tiles done then."""
    rng = np.random.default_rng(kills)
    were: list[int] = []
    for _ in range(kills):
        run = start(folder, *given, *more)
        enough = done(folder) + int(rng.integers(1, 4))
        deadline = time.monotonic() + 300
        while run.poll() is None and done(folder) < enough:
            assert time.monotonic() < deadline
            time.sleep(0.002)
        time.sleep(rng.uniform(0.0, 0.05))
        run.send_signal(signal.SIGKILL)
        run.communicate()
        were.append(done(folder))
    return were


def grown(out: str) -> tuple[int, int]:
    found = re.search(r"grown (\d+) of (\d+)", out)
    assert found
    return int(found[1]), int(found[2])


@pytest.mark.slow
def test_300_mb_of_photographs_take_little_memory_and_survive_three_kills(tmp_path):
    given = (1250, 1000, 20, 0.02)
    whole = finish(start(tmp_path / "whole", *given))
    most, size = grown(whole)
    assert size == 300_000_000
    assert most < 100_000_000
    were = kill_at_random(tmp_path / "killed", 3, given)
    assert 0 < were[0] < were[-1] < len(np.load(tmp_path / "whole" / "done.npy"))
    finish(start(tmp_path / "killed", *given))
    expected, found = maps_of(tmp_path / "whole"), maps_of(tmp_path / "killed")
    assert expected.keys() == found.keys()
    for name, value in expected.items():
        np.testing.assert_array_equal(found[name], value, err_msg=name)
    assert (expected["status"] == 1).sum() > 20_000


@pytest.mark.slow
def test_50_gb_of_photographs_take_under_2_gb_and_survive_20_kills(tmp_path):
    """About an hour on 2 cores. 50.4 GB as one reads them; 35 million texels."""
    given = (35_000, 1000, 120, 1.0)
    more = ("--memory", str(1 << 28))
    were = kill_at_random(tmp_path / "killed", 20, given, *more)
    assert were == sorted(were)
    last = start(tmp_path / "killed", *given, *more)
    most, size = grown(finish(last, 7200.0))
    assert size > 50e9
    assert most < 1_500_000_000  # beside some 300 MB of Python, JAX and its programs
    status, k_d = (np.load(tmp_path / "killed" / f"{name}.npy", mmap_mode="r") for name in ("status", "k_d"))
    # texels are alone: a band of them fitted by itself must be the same
    scene, views = problem(35_000, 1000, 120, 1.0)
    for row in (0, 17_321, 34_990):
        band = np.zeros((35_000, 1000), bool)
        band[row : row + 2] = True
        some = [eqx.tree_at(lambda v: v.mask, view, band) for view in views]
        alone = ds.fit_texels(scene, some)
        np.testing.assert_allclose(k_d[row : row + 2], alone.values["k_d"][row : row + 2], rtol=1e-5)
    assert all((np.asarray(status[row]) == 1).mean() > 0.9 for row in range(0, 35_000, 500))


@pytest.mark.slow
def test_eight_devices_give_what_one_gives(tmp_path):
    """Virtual devices of the CPU, through a mesh."""
    program = """
import sys; sys.path.insert(0, sys.argv[1])
import jax, numpy as np, diffshade as ds
from texel_run import problem
scene, views = problem(64, 640, 8, 1.0)
mesh = jax.sharding.Mesh(np.array(jax.devices()), ("lane",))
assert mesh.size == 8
one, all_ = ds.fit_texels(scene, views), ds.fit_texels(scene, views, devices=mesh)
regions = np.zeros((64, 640), int)
shared = [ds.fit_texels(scene, views, regions=regions, devices=m).values["n_s"][0, 0, 0] for m in (None, mesh)]
assert abs(shared[0] / shared[1] - 1) < 1e-6, shared
off = [np.abs(all_.values[name] - one.values[name]) / (1 + np.abs(one.values[name])) for name in one.values]
print(max(o.max() for o in off))
"""
    paths = os.pathsep.join([str(Path(ds.__file__).parents[1]), str(SCRIPT.parent)])
    around = {**os.environ, "PYTHONPATH": paths, "JAX_NUM_CPU_DEVICES": "8"}
    run = subprocess.run(
        [sys.executable, "-c", program, str(SCRIPT.parent)], capture_output=True, text=True, env=around, check=False
    )
    assert run.returncode == 0, run.stderr
    assert float(run.stdout) < 1e-6  # the maps are float32


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def test_two_processes_share_the_work(tmp_path):
    given = (512, 1000, 12, 0.05)
    finish(start(tmp_path / "alone", *given))

    def both(folder: Path) -> list[subprocess.Popen]:
        port = free_port()
        names = [("--processes", "2", "--process", str(i), "--port", str(port)) for i in range(2)]
        return [start(folder, *given, *name) for name in names]

    for run in both(tmp_path / "two"):
        finish(run)
    expected, found = maps_of(tmp_path / "alone"), maps_of(tmp_path / "two")
    for name in ("status", "k_d", "k_s", "n_s", "k_d_error"):
        np.testing.assert_array_equal(found[name], expected[name], err_msg=name)
