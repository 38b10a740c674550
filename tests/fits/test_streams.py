"""Fits of more pixels than memory: the same answer, in flat memory, whatever kills the process."""

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
from diffshade.inverse.fitting import check_scale
from diffshade.inverse.tiles import Tiles
from diffshade.inverse.views import find_samples

SUPPORT = Path(__file__).parents[1] / "support"

CAMERA = ds.Camera(eye=(0, 0, 4), fov=32, shape=(90, 90))


def masked(images):
    inside = (np.indices(images[0].shape[:2]).sum(0) % 7 > 0)[..., None]
    return [np.concatenate([image, inside], -1) for image in images]


CASES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "hinge": ({"saturation": 0.5}, {}),
    "leave out": ({"saturation": 0.5, "floor": 0.08}, {"clipped": "leave out"}),
    "robust, noise that depends on the level": ({"noise": ds.Noise(0.004, shot=1e-4)}, {"loss": "cauchy"}),
}


@pytest.mark.parametrize("case", CASES)
def test_a_fit_by_tiles_is_that_of_all_in_memory(case):
    of_view, of_fit = CASES[case]
    scene = synthetic.standard_scene()
    images = synthetic.noisy(synthetic.photographs(scene, CAMERA), 0.005, 0)
    views = synthetic.one_light_each(masked(images) if case == "hinge" else images, CAMERA, **of_view)
    fits = [
        ds.fit(scene, views, free=("k_a", "k_d", "k_s", "n_s"), memory=memory, **of_fit)
        for memory in (4e9, 1.5e6)  # the second keeps some chunks and lays out the others anew
    ]
    np.testing.assert_allclose(fits[1].values, fits[0].values, rtol=1e-10)
    np.testing.assert_allclose(fits[1].plain_errors, fits[0].plain_errors, rtol=1e-10)
    np.testing.assert_allclose(
        np.array(fits[1].errors), np.array(fits[0].errors), rtol=1e-8
    )  # small differences of large gradients
    assert fits[1].counts == fits[0].counts
    assert fits[1].notes == fits[0].notes
    with pytest.raises(ValueError, match=r"holds all of its pixels at once, .* and this fit's memory is 1.5e\+06"):
        ds.examine(fits[1])


@pytest.mark.parametrize("moving", [False, True])
def test_tiles_hold_the_pixels_of_the_whole(monkeypatch, moving):
    monkeypatch.setattr("diffshade.lazy_images.TILE", 90 * 7)
    scene = synthetic.standard_scene()
    images = [image.clip(0.07, 0.5) for image in synthetic.photographs(scene, CAMERA)[:2]]
    alpha = np.random.default_rng(0).random(CAMERA.shape) > 0.1
    views = [
        ds.View(np.concatenate([images[0], alpha[..., None]], -1), CAMERA, saturation=0.5),
        ds.View(images[1], CAMERA, alpha, floor=0.07),
    ]
    for leave_out in (False, True):
        tiles = Tiles(scene, views, [], moving=moving, leave_out=leave_out)
        found = tiles.nothing()
        for tile in tiles.all:
            found = tiles.add(found, tiles.look(tile, tiles.read(tile)))
        at_ends = sum(tiles.settle(found))
        wholes = [find_samples(scene, view, moving=moving) for view in views]
        assert at_ends == sum(int(np.abs(whole.ends()).sum()) for whole in wholes)
        for v, whole in enumerate(wholes):
            expected = whole.pixels[~whole.ends().any(-1)] if leave_out else whole.pixels
            of_view = [tiles.samples(tile, tiles.read(tile)) for tile in tiles.all if tile.view == v]
            np.testing.assert_array_equal(np.concatenate([s.pixels for s in of_view]), expected)
            values = np.concatenate([s.values(s.pixels) for s in of_view])
            np.testing.assert_array_equal(values, whole.values(expected))
            assert (whole.floor, whole.level, whole.brightest) == (*tiles.ranges[v], tiles.brightest[v])
            count = max(len(expected) * 700 // sum(tiles.pixels), 256)
            part = tiles.part(700)[v]
            np.testing.assert_array_equal(part.pixels, expected[np.arange(count) * len(expected) // count])


def test_what_is_wrong_is_said_as_of_a_fit_in_memory():
    scene = synthetic.standard_scene()
    images = [image.copy() for image in synthetic.photographs(scene, CAMERA)]
    images[3][40, 50, 1] = np.nan
    black = [0.0 * image for image in images[:2]]
    for of, message in (
        (images, r"^views\[3\]: the image must be finite inside the mask; got .*nan.* at row 40, column 50"),
        (black, "^the images are black: no pixel that shows an object is above 0"),
    ):
        views = synthetic.one_light_each(of, CAMERA)
        for memory in (4e9, 1e5):
            with pytest.raises(ValueError, match=message):
                ds.fit(scene, views, free=("k_d",), memory=memory)


def test_arguments_are_checked(tmp_path):
    scene = synthetic.standard_scene()
    views = synthetic.one_light_each(synthetic.photographs(scene))
    for values, kind, message in (
        ((0, None, None), ValueError, "memory must be a number of bytes above 0; got 0. Give for example 4e9"),
        ((1e9, 3, None), TypeError, "checkpoint must be the name of a folder; got 3"),
        ((1e9, None, 8), TypeError, "mesh must be a Mesh; got int"),
    ):
        with pytest.raises(kind, match=message):
            check_scale(*values)
    with pytest.raises(ValueError, match=r"tests is no checkpoint\. Give checkpoint the name"):
        ds.fit(scene, views, free=("k_d",), checkpoint=SUPPORT)
    folder = tmp_path / "run"
    fit = ds.fit(scene, views, free=("k_d",), checkpoint=folder)
    again = ds.fit(scene, views, free=("k_d",), checkpoint=folder)
    np.testing.assert_array_equal(again.values, fit.values)
    np.testing.assert_array_equal(again.errors, fit.errors)
    other = [ds.View(1.01 * view.image, view.camera, lit=view.lit) for view in views]
    for problem, free in ((views, ("k_s",)), (other, ("k_d",)), (views[1:], ("k_d",))):
        with pytest.raises(ValueError, match="run is of another problem: its scene, views or options are not these"):
            ds.fit(scene, problem, free=free, checkpoint=folder)


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
