"""Fits of more pixels than memory holds: an even part of them, which is said, with what it costs."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import synthetic

import diffshade as ds
from diffshade.inverse.data.samples import find_samples, share_of
from diffshade.inverse.fitting import check_scale

SUPPORT = Path(__file__).parents[1] / "support"
CAMERA = ds.Camera(eye=(0, 0, 4), fov=32, shape=(90, 90))
FREE = ("k_d",)


@pytest.fixture(scope="module")
def views():
    """Noisy photographs with an alpha channel."""
    images = synthetic.noisy(synthetic.photographs(synthetic.standard_scene(), CAMERA), 0.005, 0)
    inside = (np.indices(CAMERA.shape).sum(0) % 7 > 0)[..., None]
    return synthetic.one_light_each([np.concatenate([i, inside], -1) for i in images], CAMERA)


@pytest.mark.thorough
def test_a_fit_of_a_part_holds_the_truth_within_errors_that_grow_as_it_says(views):
    scene = synthetic.standard_scene()
    whole, part = ds.fit(scene, views, free=FREE), ds.fit(scene, views, free=FREE, memory=1e6)
    truth, every = whole.values_in(scene), whole.counts.pixels
    assert part.counts.pixels < 0.4 * every
    assert part.counts.beyond_memory == every - part.counts.pixels
    assert np.all(np.abs(part.values - truth) < 4 * part.errors)
    grows = np.median(part.plain_errors / whole.plain_errors)
    assert grows == pytest.approx(np.sqrt(every / part.counts.pixels), rel=0.15)
    (note,) = [note for note in part.notes if note.kind == "memory"]
    assert f"uses {part.counts.pixels:,} of {every:,} pixels" in note
    assert not any(note.kind == "memory" for note in whole.notes)


@pytest.mark.thorough
def test_a_part_can_be_examined(views):
    part = ds.fit(synthetic.standard_scene(), views[:3], free=FREE, memory=2e5)
    found = ds.examine(part)
    assert found.determined.all()
    assert any("memory" in note for note in found.notes)


@pytest.mark.parametrize("count", [300, 1000, 5000])
def test_a_part_has_its_share_of_every_highlight_and_every_row(count):
    """An image whose width is a multiple of every step: one that only counts pixels would keep a few columns."""
    camera = ds.OrthographicCamera((0, 0, 1), shape=(256, 256), local_viewer=False)
    random = np.random.default_rng(0)
    image = 0.5 + 0.01 * random.standard_normal((256, 256, 3))
    image[100:108, 101:109] = 0.9  # 64 pixels
    scene = ds.Scene(ds.Object(ds.Plane((0, 0, 0), (0, 0, 1))), ds.DirectionalLight((0, 0, -1)))
    samples = find_samples(scene, ds.View(image, camera))
    kept = share_of(samples, count).pixels
    assert len(kept) == len(set(kept.tolist())) == count
    shining = (image[..., 0] > 0.8).reshape(-1)[kept].sum()
    assert abs(shining - 64 * count / 256**2) <= 1
    for axis in np.divmod(kept, 256):
        assert np.bincount(axis // 64, minlength=4).min() > 0.15 * count
    assert share_of(samples, 256**2) is samples


@pytest.mark.thorough
def test_every_view_has_its_share_whatever_memory_there_is(views):
    part = ds.fit(synthetic.standard_scene(), views, free=FREE, memory=1.0)
    pixels = [len(s.pixels) for s in part.solved.problem.data.samples]
    assert pixels == [256] * len(views)


@pytest.mark.thorough
def test_views_that_are_made_as_they_are_read_take_little_memory(tmp_path):
    """The views hold 100 MB; what grows is mostly XLA, what the residuals show, and the pixels' places."""
    if not Path("/proc/self/status").exists():
        pytest.skip("memory is measured by Linux's /proc")
    command = [sys.executable, "-W", "error", SUPPORT / "generated.py", 1024, 2e6, tmp_path / "out.npz"]
    done = subprocess.run([*map(str, command)], env={**os.environ}, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with np.load(tmp_path / "out.npz") as found:
        assert found["grown"] < 600e6
        assert found["pixels"] < 4e4


def test_what_is_wrong_is_said_whatever_memory_there_is():
    scene = synthetic.standard_scene()
    images = [image.copy() for image in synthetic.photographs(scene, CAMERA)]
    images[3][40, 50, 1] = np.nan
    black = [0.0 * image for image in images[:2]]
    for of, message in (
        (images, r"^views\[3\]: the image must be finite inside the mask; got .*nan.* at row 40, column 50"),
        (black, "^the images are black: no pixel that shows an object is above 0"),
    ):
        for memory in (4e9, 1e5):
            with pytest.raises(ValueError, match=message):
                ds.fit(scene, synthetic.one_light_each(of, CAMERA), free=FREE, memory=memory)


def test_arguments_are_checked():
    for values, kind, message in (
        ((0, None), ValueError, "memory must be a number of bytes above 0; got 0"),
        ((1e9, 8), TypeError, "devices must be a Mesh; got int"),
    ):
        with pytest.raises(kind, match=message):
            check_scale(*values)
