"""Shifts of texels: what photographs say of how far they are moved in the picture, and what is done with it."""

import dataclasses

import made_maps
import numpy as np
import pytest
import scipy.ndimage
from bumpy import bumpy

import diffshade as ds
from diffshade.core.backend import in_float64
from diffshade.io.lazy_images import LazyImage
from diffshade.texels.lighting import Shifts
from diffshade.texels.lights.shift_search import _matte
from diffshade.texels.lights.shifts import _moved_back, _named, undone_shifts
from diffshade.texels.tiles import ViewReader


def moved(of, by, brighter: np.ndarray | float = 1.0):
    """The photographs, moved by pixels to the right and down."""
    images = [
        scipy.ndimage.shift(np.asarray(v.image), (y, x, 0), order=3) * f
        for v, (x, y), f in zip(of.views, by, np.broadcast_to(brighter, len(by)), strict=True)
    ]
    return [dataclasses.replace(v, image=image) for v, image in zip(of.views, images, strict=True)]


def found_in(scene, views):
    with in_float64((scene, views)) as (scene, views):
        return undone_shifts(scene, views, ViewReader(scene, views).sample(2048))


@pytest.mark.thorough
@pytest.mark.parametrize("material", ["matte", "two"])
def test_photographs_that_moved_are_moved_back(material):
    random = np.random.default_rng(3)
    of = bumpy(material, 12, 60.0, off=1.0, cast=True)
    by = random.uniform(-4.0, 4.0, (12, 2))
    views, shifts, (note,) = found_in(of.scene, moved(of, by, random.uniform(0.65, 1.35, 12)))
    assert shifts is not None
    off = shifts.pixels - by
    off = np.abs(off - off.mean(0))
    assert (off <= 2.0 * shifts.error).mean() > 0.9
    assert (off <= shifts.error).mean() > 0.6
    assert shifts.error.max() < 0.6
    assert shifts.undone.sum() > 8
    assert "photographs are shifted: views[" in note
    assert len(views) == 12


@pytest.mark.parametrize("material", ["matte", pytest.param("glossy", marks=pytest.mark.thorough)])
def test_right_photographs_are_left_as_they_are(material):
    of = bumpy(material, 12, 60.0, off=1.0, cast=True)
    assert found_in(of.scene, of.views) == (of.views, None, ())


def test_a_texel_that_shifts_move_out_of_all_pictures_tells_nothing():
    random, ends = np.random.default_rng(0), np.array([0, 3, 6])
    light = np.broadcast_to(bumpy("matte", 8, 50.0).to_light, (2, 8, 3))
    inside = np.ones((8, 6), bool)
    inside[:, 2] = False
    seen = light[0] @ (0.1, 0.2, 1.0) * random.uniform(0.5, 1.0, (6, 1)) + random.normal(0.0, 0.01, (6, 8))
    texels = _matte(seen.T, inside, light, ends, 0.5)
    assert all(np.isfinite(of).all() for of in texels)
    assert not texels.weight[:, 2].any()
    assert texels.weight[:, 3].any()


@pytest.mark.thorough
def test_one_that_moved_leaves_the_others():
    of = bumpy("texture", 12, 60.0, off=1.0, cast=True)
    by = np.zeros((12, 2))
    by[4] = 0.0, -3.0
    views, shifts, (note,) = found_in(of.scene, moved(of, by))
    assert shifts is not None
    assert np.flatnonzero(shifts.undone).tolist() == [4]
    np.testing.assert_allclose(shifts.pixels[4], by[4], atol=2.0 * shifts.error[4].max())
    assert "views[4] by 0." in note
    assert "3.0 up" in note
    given = moved(of, by)
    assert [np.array_equal(a.image, b.image) for a, b in zip(views, given, strict=True)] == (
        np.arange(12) != 4
    ).tolist()


def test_seven_photographs_or_several_lights_say_nothing():
    of = bumpy("texture", 7, 60.0)
    views = moved(of, np.full((7, 2), [3.0, 0.0]) * (np.arange(7) == 2)[:, None])
    assert found_in(of.scene, views)[1] is None
    both = [dataclasses.replace(view, lit=(0, 1)) for view in of.views]
    assert found_in(of.scene, both)[1] is None


@pytest.mark.parametrize("lazily", [False, True])
def test_what_comes_from_outside_or_is_clipped_does_not_count(lazily):
    row, column = np.mgrid[:40, :50]
    image = 0.5 + 0.2 * np.sin(column / 4.0)[..., None] * np.cos(row / 5.0)[..., None] * np.ones(3)
    image[30:32, 30] = 1.0
    camera = ds.OrthographicCamera((0, 0, 4), shape=(40, 50), local_viewer=False)
    given = LazyImage(lambda first, last: image[first:last], image.shape, image.dtype) if lazily else image
    back = _moved_back(ds.View(given, camera, saturation=1.0), np.array([2.5, -3.0]))
    assert back.mask is not None
    expected = 0.5 + 0.2 * np.sin((column + 2.5) / 4.0) * np.cos((row - 3.0) / 5.0)
    np.testing.assert_allclose(
        np.asarray(back.image[:40])[back.mask], expected[back.mask][:, None] * np.ones(3), atol=6e-3
    )
    assert not back.mask[:3].any()
    assert not back.mask[:, 48:].any()
    assert not back.mask[33:35, 27:29].any()
    assert back.mask[3:28, :47].all()


def test_the_farthest_are_named_first():
    found = Shifts(np.array([[1.0, 0.0], [-4.0, 2.0], [0.2, 0.0]]), np.full((3, 2), 0.1), np.array([True, True, False]))
    said = _named(found)
    assert said.startswith("views[1] by 4.0 to the left and 2.0 down, views[0] by 1.0 to the right")
    assert "views[2]" not in said


def test_shifts_are_kept_with_the_maps(tmp_path):
    found = Shifts(np.array([[1.0, 0.0], [-4.0, 2.0], [0.2, 0.0]]), np.full((3, 2), 0.1), np.array([True, True, False]))
    maps, _, _ = made_maps.bumpy()
    dataclasses.replace(maps, shifts=found).write(tmp_path / "maps", suffix=".npy")
    again = ds.read_maps(tmp_path / "maps").shifts
    assert again is not None
    for one, other in zip(again, found, strict=True):
        np.testing.assert_array_equal(one, other)
    maps.write(tmp_path / "still", suffix=".npy")
    assert ds.read_maps(tmp_path / "still").shifts is None


@pytest.mark.thorough
@pytest.mark.parametrize("n_s", [8.0, 20.0, 60.0])
def test_the_highlights_of_eight_photographs_of_a_smooth_ball_are_no_shift(n_s):
    """There is no edge and no texture, and of eight photographs each region's lights take up most of what differs."""
    random, camera = np.random.default_rng(1), ds.OrthographicCamera((0, 0, 4), height=2.2, shape=(64, 64))
    tilt, turn = np.deg2rad(np.linspace(15.0, 50.0, 8)), 2.4 * np.arange(8)
    toward = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], -1)
    lights = [ds.DirectionalLight(-l) for l in toward]
    ball = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_d=(0.6, 0.3, 0.2), k_s=0.3, n_s=n_s)), lights)
    pictures = [np.asarray(ds.render(ball, camera, lit=i)) for i in range(8)]
    views = [ds.View(one + random.normal(0, 0.002, one.shape), camera, lit=i) for i, one in enumerate(pictures)]
    assert found_in(ball, views)[1:] == (None, ())
