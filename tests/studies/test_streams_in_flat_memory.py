"""Fits of more pixels than memory in processes of their own: flat memory, and the same bits whatever kills them."""

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic

import diffshade as ds
from diffshade.inverse.verdicts.stability import UNCHECKED

SUPPORT = Path(__file__).parents[1] / "support"
CAMERA = ds.Camera(eye=(0, 0, 4), fov=32, shape=(90, 90))
CASES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "exclude": ({"saturation": 0.5, "floor": 0.08}, {"clipped": "exclude"}),
    "robust, noise that depends on the level": ({"noise": ds.Noise(0.004, shot=1e-4)}, {"loss": "cauchy"}),
}


@pytest.mark.parametrize("case", CASES)
def test_a_fit_by_tiles_is_that_of_all_in_memory(case):
    """Clipped samples under a hinge are in fits/test_streams.py."""
    of_view, of_fit = CASES[case]
    scene = synthetic.standard_scene()
    images = synthetic.noisy(synthetic.photographs(scene, CAMERA), 0.005, 0)
    views = synthetic.one_light_each(images, CAMERA, **of_view)
    one, other = (ds.fit(scene, views, free=("k_a", "k_d", "k_s", "n_s"), memory=m, **of_fit) for m in (4e9, 1.5e6))
    np.testing.assert_allclose(other.values, one.values, rtol=1e-10)
    np.testing.assert_allclose(other.plain_errors, one.plain_errors, rtol=1e-10)
    np.testing.assert_allclose(np.array(other.errors), np.array(one.errors), rtol=1e-8)
    assert other.counts == one.counts
    noted = [note for note in one.notes if note.kind != "depends on data"]
    assert [note for note in other.notes if note != UNCHECKED] == noted
    assert (UNCHECKED in other.notes) == (case == "exclude")


def start(size, folder, memory=1e6, seconds=0.05):
    """Start a fit as a process of its own."""
    command = [sys.executable, "-W", "error", SUPPORT / "generated.py", size, memory]
    command = [*map(str, command), str(folder / "checkpoint"), str(folder / "out.npz"), str(seconds)]
    return subprocess.Popen(command, env={**os.environ}, stderr=subprocess.PIPE, text=True)


def answer(process, folder):
    """Wait for the end of a fit and return what it found."""
    _, said = process.communicate()
    assert process.returncode == 0, said
    with np.load(folder / "out.npz") as file:
        return {name: file[name] for name in file.files}


def kill_once(process, there):
    """Kill a process, without a chance to say good-bye, once something is there."""
    while not there() and process.poll() is None:
        time.sleep(0.005)
    assert process.poll() is None, process.communicate()
    process.kill()
    process.communicate()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is measured by Linux's /proc")
def test_300_megabytes_in_flat_memory_and_three_kills_change_nothing(tmp_path):
    """The views hold 300 MB; without them the fit of views a hundredth of the size grows by 225 MB, most of it XLA."""
    undisturbed, disturbed = (tmp_path / name for name in ("undisturbed", "disturbed"))
    for folder in (undisturbed, disturbed):
        folder.mkdir()
    one = start(1768, undisturbed)
    held = disturbed / "checkpoint"
    kill_once(start(1768, disturbed), (held / "survey.part.npz").exists)
    kill_once(start(1768, disturbed), (held / "pass-0000.part.npz").exists)
    kill_once(start(1768, disturbed), lambda: any(held.glob("pass-000[2-9].part.npz")))
    other = start(1768, disturbed)
    expected, found = answer(one, undisturbed), answer(other, disturbed)
    assert expected["grown"] < 400e6
    assert found["grown"] < 400e6
    for name in ("values", "errors", "pixels"):
        np.testing.assert_array_equal(found[name], expected[name])  # to the bit
    for path in (undisturbed / "checkpoint").glob("pass-*.npz"):  # each pixel is in each sum, and once
        with np.load(path) as a, np.load(held / path.name) as b:
            for key in a.files:
                np.testing.assert_array_equal(b[key], a[key])


GIGABYTES = 10


@pytest.mark.slow
def test_gigabytes_in_flat_memory_and_20_kills_change_nothing(tmp_path):
    """Kills at random moments of runs that go on from one another."""
    size = int(np.sqrt(GIGABYTES * 1e9 / 96))
    undisturbed, disturbed = (tmp_path / name for name in ("undisturbed", "disturbed"))
    for folder in (undisturbed, disturbed):
        folder.mkdir()
    begun = time.monotonic()
    expected = answer(start(size, undisturbed, seconds=1.0), undisturbed)
    took = time.monotonic() - begun
    print(f"{expected['pixels']:,} pixels in {took:.0f} s, memory grew by {expected['grown'] / 1e6:.0f} MB")
    random = np.random.default_rng(0)
    kills = 0
    while kills < 20:
        process = start(size, disturbed, seconds=1.0)
        try:
            process.communicate(timeout=random.uniform(2.0, 2.0 + took / 8.0))
            break  # it came to its end before 20 kills
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            kills += 1
    found = answer(start(size, disturbed, seconds=1.0), disturbed)
    assert kills >= 8
    assert max(expected["grown"], found["grown"]) < 500e6
    for name in ("values", "errors", "pixels"):
        np.testing.assert_array_equal(found[name], expected[name])
