"""Pictures: rendered images for a lecture's figures, and the values for their curves."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from contextvars import ContextVar
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from ...core.fields import Numbers
from ...io.encodings import srgb_encode
from ...model.cameras import AbstractCamera, Camera
from ...model.lights import AbstractLight, PointLight
from ...model.materials import Material
from ...model.rendering import intersect, render
from ...model.scenes import Object, Scene
from ...model.surfaces import Sphere
from ...model.vectors import Vec3

Picture = Float[np.ndarray, "h w 3"]

RAYS = 3  # per pixel, horizontally and vertically
DARK = (0.055, 0.06, 0.075)  # a background against which a black ball is still visible
PALE = (0.62, 0.66, 0.72)
SCALE: ContextVar[int] = ContextVar("SCALE", default=1)  # pixels drawn for each pixel of a page, across


def picture(scene: Scene, camera: AbstractCamera) -> Picture:
    """Render 3 x 3 rays a pixel, average their radiance, clip it to [0, 1] and apply the sRGB curve."""
    return displayed(np.asarray(render(scene, finer(camera)), np.float64))


def line_drawing(scene: Scene, camera: AbstractCamera) -> Picture:
    """Draw the edges: pixels whose neighbours do not see the same smooth surface."""
    seen = intersect(scene, finer(camera))
    n, inside = np.asarray(seen.normal, np.float64), np.asarray(seen.mask)
    p = np.asarray(seen.position, np.float64)
    lines = np.zeros(inside.shape, bool)
    for here, there in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        off_plane = np.abs(np.sum((p[there] - p[here]) * n[here], -1)) > 0.08
        creased = np.sum(n[there] * n[here], -1) < 0.8
        lines[here] |= np.where(inside[here] & inside[there], off_plane | creased, inside[here] != inside[there])
    for _ in range(2 * SCALE.get()):  # to about two pixels
        lines[1:] |= lines[:-1]
        lines[:, 1:] |= lines[:, :-1]
    return displayed(np.where(lines[..., None], 0.02, 1.0) * np.ones(3))


def displayed(image: Float[np.ndarray, "H W 3"]) -> Picture:
    """Return linear radiance of 3 x 3 values per pixel as sRGB for display."""
    height, width = image.shape[0] // RAYS, image.shape[1] // RAYS
    mean = image.reshape(height, RAYS, width, RAYS, 3).mean((1, 3))
    return srgb_encode(np.clip(mean, 0.0, 1.0))


def ball(material: Material, light: AbstractLight | None = None, ambient: float = 1.0) -> Picture:
    """Return a ball under one light, by default a white lamp in front of it, up to the right."""
    scene = Scene(Object(Sphere(), material), light or PointLight((3, 4, 6)), ambient=ambient, background=DARK)
    return picture(scene, Camera((0, 0, 5), fov=26, shape=(168, 168)))


def evaluate(function: Callable[..., Any], *arguments: Any) -> Any:
    """Evaluate a function of the library on NumPy arrays, and return NumPy arrays."""
    traced = jax.jit(lambda *given: function(*given))  # a module with arrays in it cannot be a key of jit's cache
    return jax.tree.map(np.asarray, traced(*arguments))


def toward(degrees: Numbers) -> Vec3:
    """Return the unit direction at an angle from the upward normal, clockwise, in the plane of the page."""
    angle = np.deg2rad(np.asarray(degrees, np.float64))
    return Vec3(*(np.asarray(part) for part in (np.sin(angle), np.cos(angle), 0.0 * angle)))


def finer(camera: AbstractCamera) -> AbstractCamera:
    """Return the camera with 3 x 3 pixels for each of a picture, as `displayed` takes them."""
    height, width = camera.shape
    return dataclasses.replace(camera, shape=(fine(height), fine(width)))


def fine(pixels: int) -> int:
    """Return how many rays there are in so many pixels of a page, across."""
    return RAYS * SCALE.get() * pixels
