"""Recording: what a view's camera would make of a scene, and back: a photograph with its sensor undone."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np
import scipy
from jaxtyping import Float

from ...core.backend import in_float64
from ...io.lazy_images import LazyImage
from ...model.rendering import render_once, select
from ...model.scenes import Scene
from .samples import SensorRange, top_of_view
from .sensors import Sensor, falloff, linear_level
from .views import Image, View, channels, is_grey


def photograph(scene: Scene, view: View, samples: int = 1) -> Float[np.ndarray, "h w c"]:
    """Return what a view's photograph of a scene would be, unclipped, in its channels, by n x n samples a pixel."""
    if view.lit is not None:  # first: of hundreds of lights a view has one
        scene = dataclasses.replace(scene, lights=select(scene, view.lit))
    return record(np.asarray(render_once(scene, view.camera, samples=samples)), view)


def record(radiance: Float[np.ndarray, "h w 3"], view: View) -> Float[np.ndarray, "h w c"]:
    """Return what a view's camera makes of radiance, unclipped: exposure * radiance + black, through its sensor."""
    image = radiance.mean(-1, keepdims=True) if is_grey(view) else radiance
    sensor = view.sensor
    if sensor is None:
        return float(view.exposure) * image + float(view.black)
    if float(sensor.blur) > 0.0:
        image = scipy.ndimage.gaussian_filter(image, float(sensor.blur), axes=(0, 1), mode="nearest")
    level = float(view.exposure) * _gains(view, sensor, 0, len(image)) * image + float(view.black)
    return np.asarray(sensor.respond(level))


def linear(image: Float[np.ndarray, "h w c"], view: View) -> Float[np.ndarray, "h w c"]:
    """Return what a view's camera recorded, unclipped, as linear light: response, gains and vignetting are undone."""
    if view.sensor is None:
        return image
    with in_float64(view) as view:
        assert view.sensor is not None
        return _linear_rows(image, view, view.sensor, 0)


def developed(view: View) -> View:
    """Return a view with a linear image, and no sensor: response, gains and vignetting are undone, blur is not.

    Noise that is known is left out: it now differs from pixel to pixel, which a `Noise` cannot say.
    """
    if view.sensor is None:
        return view
    with in_float64(view) as view:
        assert view.sensor is not None
        return _developed(view, view.sensor)


def _developed(view: View, sensor: Sensor) -> View:
    ends = SensorRange.of(view, top_of_view(view))
    pairs = zip(ends, (np.min, np.max), strict=True)
    shown = SensorRange(*(end if np.isinf(end) else _level_at(view, sensor, end, farthest) for end, farthest in pairs))

    def rows(image: Float[np.ndarray, "r w c"], first: int) -> np.ndarray:
        seen, alpha = np.split(image, [channels(view)], -1)
        linear = _linear_rows(seen, view, sensor, first)
        linear = np.where(seen >= ends.level, shown.level, np.where(seen <= ends.floor, shown.floor, linear))
        return np.concatenate([linear, alpha], -1)

    image: Image = view.image
    if isinstance(image, LazyImage):
        image = LazyImage(
            lambda first, last: rows(np.asarray(view.image[first:last], np.float64), first), image.shape, np.float64
        )
    else:
        image = rows(np.asarray(image, np.float64), 0)
    return View(
        image,
        view.camera,
        view.mask,
        view.lit,
        view.exposure,
        view.black,
        saturation=view.saturation if np.isinf(ends.level) else shown.level,
        floor=view.floor if np.isinf(ends.floor) else shown.floor,
        bands=view.bands,
    )


def _linear_rows(
    image: Float[np.ndarray, "r w c"], view: View, sensor: Sensor, first: int
) -> Float[np.ndarray, "r w c"]:
    light = linear_level(sensor, image) - float(view.black)
    return light / _gains(view, sensor, first, first + len(image)) + float(view.black)


def _level_at(view: View, sensor: Sensor, level: float, farthest: Any) -> float:
    """Return one level for all samples that the sensor clipped at a level, no nearer than any that it did not."""
    light = linear_level(sensor, np.asarray(level)) - float(view.black)
    return float(farthest(light / _gains(view, sensor, 0, view.camera.shape[0]))) + float(view.black)


def _gains(view: View, sensor: Sensor, first: int, last: int) -> Float[np.ndarray, "r w c"]:
    """Return what each sample of some rows of a view is multiplied by: gain and falloff."""
    height, width = view.camera.shape
    row, column = np.mgrid[first:last, :width].astype(np.float64)
    projection = jax.tree.map(np.asarray, view.camera.projection())
    v = np.asarray(falloff(sensor.vignetting, projection, 0.5 * np.hypot(height, width), row, column))
    gains = np.ones(1) if view.bands else np.array([float(of) for of in sensor.gains(is_grey(view))[: channels(view)]])
    return v[..., None] * gains
