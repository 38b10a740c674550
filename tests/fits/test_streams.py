"""Fits of more pixels than memory: the same answer as of all in memory, and the same bits after any stop."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import synthetic

import diffshade as ds
from diffshade.inverse.data.samples import find_samples
from diffshade.inverse.fitting import check_scale
from diffshade.inverse.pixels.tiles import Tiles
from diffshade.inverse.verdicts.stability import UNCHECKED
from diffshade.parallel import checkpoints

CAMERA = ds.Camera(eye=(0, 0, 4), fov=32, shape=(90, 90))
FREE = ("k_a", "k_d", "k_s", "n_s")


@pytest.fixture(scope="module")
def views():
    """Noisy photographs that clip and have an alpha channel."""
    images = synthetic.noisy(synthetic.photographs(synthetic.standard_scene(), CAMERA), 0.005, 0)
    inside = (np.indices(CAMERA.shape).sum(0) % 7 > 0)[..., None]
    return synthetic.one_light_each([np.concatenate([i, inside], -1) for i in images], CAMERA, saturation=0.5)


@pytest.fixture(scope="module")
def by_tiles(views):
    return ds.fit(synthetic.standard_scene(), views, free=FREE, memory=1.5e6)  # keeps some chunks, lays out the others


def test_a_fit_by_tiles_is_that_of_all_in_memory(views, by_tiles):
    whole = ds.fit(synthetic.standard_scene(), views, free=FREE)
    np.testing.assert_allclose(by_tiles.values, whole.values, rtol=1e-10)
    np.testing.assert_allclose(by_tiles.plain_errors, whole.plain_errors, rtol=1e-10)
    # small differences of large gradients
    np.testing.assert_allclose(np.array(by_tiles.errors), np.array(whole.errors), rtol=1e-8)
    assert by_tiles.counts == whole.counts
    assert by_tiles.notes == (*whole.notes, UNCHECKED)
    with pytest.raises(ValueError, match=r"all of its pixels in memory, .* memory is 1.5e\+06"):
        ds.examine(by_tiles)


def test_a_fit_that_is_stopped_again_and_again_ends_in_the_same_bits(views, by_tiles, tmp_path, monkeypatch):
    scene, read, reads = synthetic.standard_scene(), Tiles.read, []
    folder = tmp_path / "run"
    monkeypatch.setattr(checkpoints, "SECONDS", 0.0)

    def fit(most: float) -> ds.Fit:
        def counted(*arguments):
            reads.append(len(list(folder.glob("pass-*.npz"))))
            if sum(1 for _ in reads) > most:
                raise KeyboardInterrupt
            return read(*arguments)

        reads.clear()
        monkeypatch.setattr(Tiles, "read", counted)
        return ds.fit(scene, views, free=FREE, memory=1.5e6, checkpoint=folder)

    for most in (4, 11, 13, 29):
        with pytest.raises(KeyboardInterrupt):
            fit(most)
    assert (folder / "survey.npz").exists()
    assert list(folder.glob("pass-*.npz"))
    found = fit(np.inf)
    assert reads[0] > 0  # it began where it was stopped
    for name in ("values", "errors", "plain_errors"):
        np.testing.assert_array_equal(np.array(getattr(found, name)), np.array(getattr(by_tiles, name)))
    again = ds.fit(scene, views, free=FREE, memory=1.5e6, checkpoint=folder)
    np.testing.assert_array_equal(again.values, found.values)
    brighter = [dataclasses.replace(view, image=1.01 * view.image) for view in views]
    for problem, free in ((views, ("k_s",)), (brighter, FREE), (views[1:], FREE)):
        with pytest.raises(ValueError, match=r"run holds the checkpoint of another run.*another folder"):
            ds.fit(scene, problem, free=free, checkpoint=folder)


@pytest.mark.parametrize("moving", [False, True])
def test_tiles_hold_the_pixels_of_the_whole(monkeypatch, moving):
    monkeypatch.setattr("diffshade.io.lazy_images.TILE", 90 * 7)
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


def test_arguments_are_checked(views):
    for values, kind, message in (
        ((0, None, None), ValueError, "memory must be a number of bytes above 0; got 0"),
        ((1e9, 3, None), TypeError, "checkpoint must be the name of a folder; got 3"),
        ((1e9, None, 8), TypeError, "mesh must be a Mesh; got int"),
    ):
        with pytest.raises(kind, match=message):
            check_scale(*values)
    with pytest.raises(ValueError, match=r"checkpoint.*Give checkpoint the name of a new folder"):
        ds.fit(synthetic.standard_scene(), views, free=FREE, checkpoint=Path(__file__).parent)
