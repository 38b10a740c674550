"""Fits of the standard problem that many tests look at: each is made once a process, and nobody changes it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any

import equinox as eqx
import numpy as np
from synthetic import (
    CAMERA,
    FREE,
    MATERIAL,
    TIED,
    forget,
    noisy,
    one_light_each,
    photograph,
    photographs,
    point_lights,
    seen_by,
    standard_scene,
)

import diffshade as ds
from diffshade.diagnosis.forecasting import Forecast

SIGMA = 0.005
OF_MATERIAL = ("k_a", "k_d", "k_s", "n_s")
PATCH = np.zeros(CAMERA.shape, bool)
PATCH[9:15, 8:14] = True


def same_but(scene: ds.Scene, where: Any, values: Iterable[Any]) -> ds.Scene:
    return eqx.tree_at(where, scene, [np.asarray(value, np.float64) for value in values])


def turned(vector, degrees):
    """A vector turned about an axis at right angles to it."""
    axis = np.cross(vector, (0, 1, 0))
    axis /= np.linalg.norm(axis)
    angle = np.deg2rad(degrees)
    return vector * np.cos(angle) + np.cross(axis, vector) * np.sin(angle)


def grazing():
    """1 - n.v of every pixel that shows the sphere, else 0."""
    buffer = seen_by(CAMERA)
    to_eye = np.array([0.0, 0.0, 4.0]) - np.asarray(buffer.position)
    n_v = np.sum(np.asarray(buffer.normal) * to_eye, -1) / np.linalg.norm(to_eye, axis=-1)
    return np.where(np.asarray(buffer.mask), 1.0 - n_v, 0.0)


@cache
def clean_images() -> tuple[np.ndarray, ...]:
    """Photographs of the standard scene without noise."""
    return tuple(photographs(standard_scene()))


@cache
def noisy_images(seed: int = 0, sigma: float = SIGMA) -> tuple[np.ndarray, ...]:
    return tuple(noisy(clean_images(), sigma, seed))


def standard_fit(images: Sequence[Any], scene: ds.Scene | None = None, view: Any = None, **options: Any) -> ds.Fit:
    """Fit the standard problem, by default from a scene with a wrong material; `view` are options of every view."""
    told = forget(standard_scene()) if scene is None else scene
    return ds.fit(told, one_light_each(images, **(view or {})), free=FREE, tied=TIED, **options)


@cache
def clean_fit() -> ds.Fit:
    """8 views without noise; told a wrong material."""
    return standard_fit(clean_images())


@cache
def noisy_fit(seed: int = 0, sigma: float = SIGMA) -> ds.Fit:
    """8 views with noise that the fit is not told."""
    return standard_fit(noisy_images(seed, sigma))


@cache
def three_lights() -> ds.Scene:
    """Return the standard sphere under the first three of the lights."""
    return standard_scene(lights=point_lights()[:3])


@cache
def two_objects() -> ds.Scene:
    """Return two spheres, of Phong's lobe and of Blinn's, under one light."""
    other = ds.Material(0.2, (0.2, 0.5, 0.7), 0.3, 20, lobe=ds.Blinn())
    spheres = ds.Sphere((-0.5, 0, 0), 0.6), ds.Sphere((0.5, 0.2, 0.3), 0.5)
    return ds.Scene([ds.Object(spheres[0], MATERIAL), ds.Object(spheres[1], other)], point_lights()[0])


@cache
def fit_of_two_objects() -> ds.Fit:
    """One photograph without noise of two spheres, of which both materials are free."""
    return ds.fit(forget(two_objects()), ds.View(photograph(two_objects()), CAMERA), free="material")


def row(fit: ds.Fit | Forecast, name: str) -> str:
    """Return what the printed table says of an unknown."""
    (line,) = [line for line in str(fit).splitlines() if line.startswith(f"{name} ")]
    return line.removeprefix(name).strip()


def assert_undetermined(fit: ds.Fit, *names: str) -> None:
    """Neither the table nor the error bars give a number for these; they do for all others."""
    for j, name in enumerate(fit.names):
        unknown = name.removesuffix(".r").removesuffix(".g").removesuffix(".b") in names
        assert fit.determined[j] == (not unknown), name
        assert np.isinf(fit.plain_errors[j]) == unknown, name
        assert np.isinf(fit.errors[j]) == unknown, name
        assert (row(fit, name) == "not determined") == unknown, name
        assert not (unknown and fit.covariance[j].any()), name
    assert fit.condition == np.inf
