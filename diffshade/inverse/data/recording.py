"""Recording: what a view's camera would make of a scene, and back: a photograph with its sensor undone."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from scipy import ndimage

from ...io.lazy_images import LazyImage
from ...model.rendering import render
from ...model.scenes import Scene
from .sensors import Sensor, falloff, linear_level
from .views import Image, View, has_alpha, is_grey


def photograph(scene: Scene, view: View) -> Float[np.ndarray, "h w c"]:
    """Return what a view's photograph of a scene would be, unclipped, in its channels."""
    return record(np.asarray(render(scene, view.camera, lit=view.lit)), view)


def record(radiance: Float[np.ndarray, "h w 3"], view: View) -> Float[np.ndarray, "h w c"]:
    """Return what a view's camera makes of radiance, unclipped: exposure * radiance + black, through its sensor."""
    image = radiance.mean(-1, keepdims=True) if is_grey(view) else radiance
    sensor = view.sensor
    if sensor is None:
        return float(view.exposure) * image + float(view.black)
    if float(sensor.blur) > 0.0:
        image = ndimage.gaussian_filter(image, float(sensor.blur), axes=(0, 1), mode="nearest")
    level = float(view.exposure) * _gains(view, sensor, 0, len(image)) * image + float(view.black)
    return np.asarray(sensor.respond(level))


def developed(view: View) -> View:
    """Return a view with a linear image, and no sensor: response, gains and vignetting are undone, blur is not.

    Noise that is known is left out where the response is not linear, since it is then not of a `Noise`.
    """
    sensor = view.sensor
    if sensor is None:
        return view
    shown, grown = _level_at(view, view.saturation, np.max), _level_at(view, view.floor, np.min)

    def rows(image: Float[np.ndarray, "r w c"], first: int) -> np.ndarray:
        seen = image[..., :-1] if has_alpha(view) else image
        level = (linear_level(sensor, seen) - float(view.black)) / _gains(view, sensor, first, first + len(seen))
        level = level + float(view.black)
        if shown is not None:
            level = np.where(seen >= view.saturation, shown, level)
        if grown is not None:
            level = np.where(seen <= view.floor, grown, level)
        return np.concatenate([level, image[..., -1:]], -1) if has_alpha(view) else level

    image = view.image
    if isinstance(image, LazyImage):
        developed_image: Image = LazyImage(
            lambda first, last: rows(np.asarray(view.image[first:last], np.float64), first), image.shape, np.float64
        )
    else:
        developed_image = rows(np.asarray(image, np.float64), 0)
    noise = view.noise if sensor.is_linear else None
    return View(developed_image, view.camera, view.mask, view.lit, view.exposure, view.black, noise, shown, grown)


def _level_at(view: View, level: float | None, farthest: Any) -> float | None:
    """Return one level for all samples that the sensor clipped at a level, no nearer than any that it did not."""
    if level is None or view.sensor is None:
        return None
    gains = _gains(view, view.sensor, 0, view.camera.shape[0])
    return float(farthest((linear_level(view.sensor, np.asarray(level)) - float(view.black)) / gains)) + float(
        view.black
    )


def _gains(view: View, sensor: Sensor, first: int, last: int) -> Float[np.ndarray, "r w c"]:
    """Return what each sample of some rows of a view is multiplied by: gain and falloff."""
    height, width = view.camera.shape
    row, column = np.mgrid[first:last, :width].astype(np.float64)
    projection = jax.tree.map(np.asarray, view.camera.projection())
    v = np.asarray(falloff(sensor.vignetting, projection, 0.5 * np.hypot(height, width), row, column))
    gains = np.array([float(gain) for gain in sensor.gains(is_grey(view))[: 1 if is_grey(view) else 3]])
    return v[..., None] * gains
