"""Beside: samples next to the objects tell of an even level, and of nothing where they show things."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import ndimage
from synthetic import photograph, standard_scene

import diffshade as ds
from diffshade.inverse.misfit.beside import FAR, beside, p_of_level
from diffshade.inverse.misfit.noise_tests import FALSE_ALARM

CAMERA = ds.Camera(eye=(0, 0, 4), fov=60, shape=(32, 32))
SIGMA = 0.01


@cache
def clean() -> np.ndarray:
    return photograph(standard_scene(), CAMERA, (0,))


def fitted(change: Any = 0.0, *, scene: ds.Scene | None = None, seed: int = 0, **view: Any) -> ds.Fit:
    noise = SIGMA * np.random.default_rng(seed).standard_normal((32, 32, 3))
    of = ds.View(clean() + change + noise, CAMERA, lit=(0,), **view)
    return ds.fit(scene or standard_scene(), of, free=("k_a", "k_d"))


def shown(change: Any = 0.0, **options: Any) -> list[np.ndarray] | None:
    return beside(fitted(change, **options))


def test_beside_a_right_description_the_mean_is_noise():
    seen = [found for seed in range(3) if (found := shown(seed=seed)) is not None]
    assert len(seen) == 3
    assert min(map(p_of_level, seen)) > 0.01
    assert np.std(np.concatenate(seen[0])) == pytest.approx(SIGMA, rel=0.1)


@pytest.mark.parametrize("level", [0.003, -0.003, 0.02])
def test_a_level_is_seen_with_its_size(level):
    seen = shown(level)
    assert seen is not None
    for of_channel in seen:
        assert of_channel.mean() == pytest.approx(level, abs=4 * SIGMA / np.sqrt(len(of_channel)))
    assert p_of_level(seen) < FALSE_ALARM


def test_hot_pixels_are_no_level():
    random = np.random.default_rng(5)
    hot = np.where(random.random((32, 32, 1)) < 0.03, random.random((32, 32, 3)), 0.0) * (clean() == 0.0)
    seen = shown(hot)
    assert seen is not None
    assert p_of_level(seen) > FALSE_ALARM
    both = shown(hot + 0.003)
    assert both is not None
    assert p_of_level(both) < FALSE_ALARM


def test_what_the_scene_says_of_its_background_and_of_black_is_no_level():
    lit = ds.Scene(standard_scene().objects, standard_scene().lights, background=0.02)
    for seen in (shown(0.02 * (clean() == 0.0), scene=lit), shown(0.02, black=0.02)):
        assert seen is not None
        assert p_of_level(seen) > FALSE_ALARM


def test_things_a_bright_wall_and_what_is_cut_out_tell_nothing():
    assert shown(0.1 * (np.arange(32) % 8 < 4)[:, None, None] * (clean() == 0.0)) is None
    assert shown(0.5 * (clean() == 0.0)) is None
    inside = clean().sum(-1) > 0
    assert shown(-clean() * ~inside[..., None], mask=inside & (np.arange(32) < 16)) is not None
    cut_out = ds.View(np.where(inside[..., None], clean() + 0.02, 0.0), CAMERA, lit=(0,), mask=inside)
    assert beside(ds.fit(standard_scene(), cut_out, free=("k_a", "k_d"))) is None


def test_pixels_next_to_the_outline_do_not_count():
    """They show a part of the object, and a blurred one shows more of it."""
    inside = clean().sum(-1) > 0
    near = ndimage.binary_dilation(inside, iterations=FAR) & ~inside
    seen = shown(0.3 * near[..., None])
    assert seen is not None
    assert p_of_level(seen) > FALSE_ALARM


def test_samples_that_are_all_alike_show_no_level():
    assert p_of_level([np.zeros(300)]) == 1.0


@pytest.mark.parametrize("part", [slice(None), slice(14)])
def test_a_mask_of_an_object_or_of_a_part_leaves_what_is_beside_to_be_seen(part):
    mask = np.zeros((32, 32), bool)
    mask[:, part] = (clean().sum(-1) > 0)[:, part]
    found, right = fitted(0.02, mask=mask), fitted(mask=mask)
    assert [note.kind for note in right.notes] == []
    assert [note.names for note in found.notes if note.kind == "cause"] == [("black",)]
    np.testing.assert_array_less(np.abs(found.values - right.values), 2.0 * found.errors)


def test_a_level_of_one_channel_is_said_with_its_size():
    found, right = fitted(np.array([0.0, 0.0, 0.02])), fitted()
    (note,) = (note for note in found.notes if note.kind == "cause")
    assert "blue is 0.02 brighter" in note
    assert "Subtract (0, 0, 0.02) from the images" in note
    np.testing.assert_array_less(np.abs(found.values - right.values), 2.0 * found.errors)


def test_what_is_brighter_than_the_dark_of_the_object_is_no_level():
    """A cloth behind it: light only adds to a black level, which the unlit side would show too."""
    inside = clean().sum(-1) > 0
    dark = ds.View(0.3 * clean() + 0.05 * ~inside[..., None], CAMERA, lit=(0,), mask=inside)
    assert beside(ds.fit(standard_scene(), dark, free=("k_a", "k_d"))) is None
