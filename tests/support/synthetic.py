"""The standard problem: a sphere in 8 photographs, each lit by one of 8 point lights at distances 2 to 5.

All lights share one attenuation, with `constant` known. Every function computes in float64 whatever the global flag, as
a fit does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np

import diffshade as ds
from diffshade.model.cameras import AbstractCamera
from diffshade.model.lights import AbstractLight
from diffshade.model.surfaces import AbstractSurface

COUNT = 8
MATERIAL = ds.Material(k_a=(0.1, 0.08, 0.06), k_d=(0.6, 0.4, 0.25), k_s=(0.5, 0.5, 0.45), n_s=50)
ATTENUATION = ds.RadialAttenuation(1.0, 0.09, 0.032)
CAMERA = ds.Camera(eye=(0, 0, 4), fov=32, shape=(24, 24))
FREE = ("k_a", "k_d", "k_s", "n_s", "attenuation")
TIED = ("attenuation",)


def light_positions(count: int = COUNT) -> np.ndarray:
    """Directions spread over the half of the sphere that the camera sees, distances 2 to 5 in no order with them."""
    i = np.arange(count)
    distance = np.linspace(2.0, 5.0, count)[(3 * i) % count]
    azimuth, polar = 2.0 * np.pi * i / count, np.deg2rad(20.0 + 5.0 * (5 * i % 8))
    direction = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)
    return distance[:, None] * direction


def point_lights(attenuation: ds.RadialAttenuation = ATTENUATION, count: int = COUNT) -> tuple[ds.PointLight, ...]:
    return tuple(ds.PointLight(position, 1.0, attenuation) for position in light_positions(count))


def standard_scene(material: ds.Material = MATERIAL, lights: Sequence[AbstractLight] | None = None) -> ds.Scene:
    return ds.Scene(ds.Object(ds.Sphere(), material), point_lights() if lights is None else lights)


def photograph(scene: ds.Scene, camera: AbstractCamera = CAMERA, lit: Sequence[int] | None = None) -> np.ndarray:
    """Render in float64."""
    with jax.enable_x64(True):
        return np.asarray(ds.render(scene, camera, lit=lit))


def seen_by(camera: AbstractCamera, surface: AbstractSurface | None = None) -> ds.GBuffer:
    """Return a surface, by default the unit sphere, as a camera sees it, in float64."""
    with jax.enable_x64(True):
        buffer = ds.intersect(ds.Scene(ds.Object(surface or ds.Sphere())), camera)
    assert buffer.position is not None
    return ds.GBuffer(*map(np.asarray, (buffer.normal, buffer.position, buffer.mask)))


def photographs(scene: ds.Scene, camera: AbstractCamera = CAMERA) -> list[np.ndarray]:
    """One photograph for each light, which alone is on."""
    return [photograph(scene, camera, (i,)) for i in range(len(scene.lights))]


def noisy(images: Sequence[np.ndarray], sigma: float, seed: int) -> list[np.ndarray]:
    random = np.random.default_rng(seed)
    return [image + sigma * random.standard_normal(image.shape) for image in images]


def one_light_each(images: Sequence[Any], camera: AbstractCamera = CAMERA, **options: Any) -> list[ds.View]:
    """Photograph i was taken under light i alone."""
    return [ds.View(image, camera, lit=(i,), **options) for i, image in enumerate(images)]


def forget(scene: ds.Scene, names: Sequence[str] = ("k_a", "k_d", "k_s", "n_s")) -> ds.Scene:
    """Return the scene with a wrong material, so that no fit can have its answer from the scene."""
    wrong = {"k_a": np.full(3, 0.9), "k_d": np.full(3, 0.9), "k_s": np.full(3, 0.9), "n_s": np.array(3.0)}
    where = lambda s: [getattr(item.material, name) for item in s.objects for name in names]  # noqa: E731
    return eqx.tree_at(where, scene, [wrong[name] for _ in scene.objects for name in names])
