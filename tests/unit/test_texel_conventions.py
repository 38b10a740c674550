"""Lights in other axes or orders than the photographs, where normals are unknown, are named; right ones are not."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hollow_things import SHAPES, hollow_thing
from measured import measured
from slightly_wrong import EYE, FOV, SIDE, ball
from wrong_photographs import towards

import diffshade as ds
from diffshade.inverse.misfit.conventions import orders
from diffshade.texels.conventions import other_light_convention
from diffshade.texels.tiles import LEARNING_SAMPLE, ViewReader

COUNT = 20
CAMERA = ds.Camera(eye=tuple(EYE), fov=FOV, shape=(SIDE, SIDE))
AXES = {
    "x negated": np.diag([-1.0, 1.0, 1.0]),
    "y negated": np.diag([1.0, -1.0, 1.0]),
    "z negated": np.diag([1.0, 1.0, -1.0]),
    "x and y negated": np.diag([-1.0, -1.0, 1.0]),
    "x and y swapped": np.eye(3)[[1, 0, 2]],
    "y and z swapped": np.eye(3)[[0, 2, 1]],
}


def photographed(seed: int, k_s: float, textured: bool) -> tuple[np.ndarray, list[np.ndarray]]:
    """The directions to the lights, and the photographs of a ball."""
    random = np.random.default_rng(seed)
    l = towards(COUNT, random)
    of: dict[str, Any] = {"k_a": np.full(3, 0.02), "k_d": random.uniform(0.2, 0.6, 3), "k_s": k_s, "n_s": 30.0}
    pattern = random.uniform(0.2, 1.0, (SIDE, SIDE, 1)) if textured else 1.0
    return l, [ball(of, at) * pattern + 0.005 * random.standard_normal((SIDE, SIDE, 3)) for at in l]


def said(l: np.ndarray, images: list[np.ndarray]) -> str | None:
    """What is said of the lights of these photographs."""
    scene = ds.Scene(ds.Object(ds.Sphere()), [ds.DirectionalLight(-at) for at in l])
    return said_of(scene, [ds.View(image, CAMERA, lit=(i,)) for i, image in enumerate(images)])


def said_of(scene: ds.Scene, views: list[ds.View]) -> str | None:
    """What is said of the lights of a scene."""
    reader = ViewReader(scene, views)
    return other_light_convention(scene, views, reader, reader.sample(LEARNING_SAMPLE))


@pytest.mark.parametrize(("k_s", "textured"), [(0.0, False), (0.4, False), (0.0, True)])
def test_right_lights_raise_no_alarm(k_s, textured):
    assert [said(*photographed(seed, k_s, textured)) for seed in range(3)] == [None] * 3


@pytest.mark.parametrize("lights", [3, 4])
def test_lights_that_repeat_raise_no_alarm(lights):
    l, images = photographed(0, 0.0, False)
    random, same = np.random.default_rng(0), np.arange(9) % lights
    again = [images[k] + 0.005 * random.standard_normal(images[k].shape) for k in same]
    assert [said(l[same], again) for _ in range(3)] == [None] * 3


@pytest.mark.parametrize("words", AXES)
def test_other_axes_are_named(words):
    l, images = photographed(0, 0.4, False)
    assert f"with {words}" in (said(l @ AXES[words].T, images) or "")


@pytest.mark.parametrize("which", range(5))
def test_another_order_is_named(which):
    l, images = photographed(1, 0.0, True)
    _, order = list(orders(COUNT))[which]
    back = next(words for words, other in orders(COUNT) if [order[k] for k in other] == [*range(COUNT)])
    assert (said(l[order], images) or "").startswith(back)


@pytest.mark.parametrize(("seed", "count"), [(0, 20), (1, 12), (2, 8)])
def test_a_random_order_is_named(seed, count):
    l, images = photographed(seed, 0.2, True)
    random = np.random.default_rng(seed).permutation(count)
    assert "the photographs do not belong to their lights" in (said(l[:count][random], images[:count]) or "")
    assert said(l[:count], images[:count]) is None


def test_photographs_of_unknown_exposures_raise_no_alarm():
    l, images = photographed(3, 0.2, True)
    brighter = np.exp(0.7 * np.random.default_rng(3).standard_normal(COUNT))
    images = [factor * image for factor, image in zip(brighter, images, strict=True)]
    assert said(l, images) is None
    assert "do not belong" in (said(np.random.default_rng(4).permutation(l), images) or "")


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["diligent_ball", "diligent_cat", "diligent_harvest"])
@pytest.mark.parametrize("count", [12, None])
def test_real_photographs_are_named_in_a_random_order_alone(name, count):
    """What the model leaves out, as cast shadows, is no wrong order."""
    scene, views = ds.read_photographs(measured(name), normals=False)
    views = [views[i] for i in np.linspace(0, len(views) - 1, count or len(views)).astype(int)]
    assert said_of(scene, views) is None
    order = np.random.default_rng(len(views)).permutation(len(views))
    views = [dataclasses.replace(view, lit=views[k].lit) for view, k in zip(views, order, strict=True)]
    assert "do not belong" in (said_of(scene, views) or "")


def test_a_vase_under_mirrored_lights_is_named():
    """Its slopes along one axis hardly change along the other: mirrored, it is nearly that of a surface."""
    scene, views = hollow_thing("vase", towards(12, np.random.default_rng(0)), 0.0, 0)
    assert said_of(scene, views) is None
    lights = [ds.DirectionalLight(np.asarray(of.direction) * (1, -1, 1)) for of in scene.lights]  # pyright: ignore[reportAttributeAccessIssue]
    assert "with y negated" in (said_of(dataclasses.replace(scene, lights=lights), views) or "")


def said_of_right_hollows(shape: str, k_s: float, seeds: range) -> list[str]:
    """What is said of right set-ups of a shape."""
    notes = []
    for seed in seeds:
        notes.append(said_of(*hollow_thing(shape, towards(COUNT, np.random.default_rng(seed)), k_s, seed)))
    return [note for note in notes if note is not None]


@pytest.mark.parametrize(("shape", "k_s"), [("bowl", 0.0), ("dish", 0.4), ("saddle", 0.4)])
def test_a_right_set_up_of_a_hollow_raises_no_alarm(shape, k_s):
    assert said_of_right_hollows(shape, k_s, range(1)) == []


@pytest.mark.thorough
@pytest.mark.parametrize("k_s", [0.0, pytest.param(0.4, marks=pytest.mark.slow)])
@pytest.mark.parametrize("shape", SHAPES)
def test_right_set_ups_of_hollows_and_planes_raise_no_alarm(shape, k_s):
    assert said_of_right_hollows(shape, k_s, range(1, 9)) == []


def test_few_photographs_are_not_judged():
    l, images = photographed(0, 0.0, False)
    assert said(l[:7] @ AXES["y negated"].T, images[:7]) is None


@pytest.mark.thorough
def test_nothing_is_determined_of_texels_and_lights_in_other_axes(tmp_path):
    l, images = photographed(2, 0.3, False)
    scene = ds.Scene(ds.Object(ds.Sphere()), [ds.DirectionalLight(-at * [1, -1, 1]) for at in l])
    views = [ds.View(image, CAMERA, lit=(i,)) for i, image in enumerate(images)]
    maps = ds.fit_texels(scene, views, free=("k_d", "k_s", "n_s", "normal"), out=tmp_path / "maps")
    for of in (maps, ds.read_maps(tmp_path / "maps")):
        assert any("with y negated" in note for note in of.notes)
        assert not of.determined.any()
    found = ds.lights.find_lights(scene, views, light_error=2.0)
    assert found.notes == tuple(note for note in maps.notes if "with y negated" in note)
    assert not found.moved.any()
    assert "misfit" not in f"{found}"
    assert np.isinf(found.errors).all()


def test_lights_in_one_plane_are_not_judged():
    random = np.random.default_rng(0)
    along = np.linspace(-1.0, 1.0, COUNT)
    l = np.stack([np.sin(along), 0.0 * along, np.cos(along)], -1)
    of: dict[str, Any] = {"k_a": np.zeros(3), "k_d": np.full(3, 0.5), "k_s": 0.0, "n_s": 30.0}
    images = [ball(of, at) + 0.005 * random.standard_normal((SIDE, SIDE, 3)) for at in l]
    assert said(l[:, [1, 0, 2]], images) is None
