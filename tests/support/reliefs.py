"""Surfaces of known height for the integration of normals: points and exact normals at the texels of a camera."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

import diffshade as ds

AXIS = np.array([0.0, 0.0, 1.0])  # both cameras look along -z
FAR = 4.0  # from the eye to the target
Height = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""From x and y to z and its derivatives by x and y."""


class Relief(NamedTuple):
    camera: ds.Camera | ds.OrthographicCamera
    normal: np.ndarray
    z: np.ndarray
    mask: np.ndarray

    def noisy(self, degrees: float | np.ndarray, seed: int = 0) -> np.ndarray:
        """The normals turned at random, by so many degrees root mean square."""
        sigma = np.deg2rad(np.asarray(degrees, float))[..., None] / np.sqrt(2.0)
        n = self.normal + sigma * np.random.default_rng(seed).standard_normal(self.normal.shape)
        return np.where(self.mask[..., None], n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-9), 0.0)


def camera_of(size: int, perspective: bool = False, height: float = 2.2) -> ds.Camera | ds.OrthographicCamera:
    """A camera that sees a square of the target's plane, of this height."""
    if perspective:
        fov = float(np.rad2deg(2.0 * np.arctan(0.5 * height / FAR)))
        return ds.Camera((0.0, 0.0, FAR), fov=fov, shape=(size, size))
    return ds.OrthographicCamera((0.0, 0.0, FAR), height=height, shape=(size, size))


def grid(size: int, height: float = 2.2) -> tuple[np.ndarray, np.ndarray]:
    """x and y of the texels on the target's plane."""
    along = height * ((np.arange(size) + 0.5) / size - 0.5)
    return np.meshgrid(along, -along)


def relief(size: int, surface: Height, *, perspective: bool = False, mask: np.ndarray | None = None) -> Relief:
    """The relief z = f(x, y); in perspective, where the rays meet it, by repeated substitution."""
    x, y = grid(size)
    z, z_x, z_y = surface(x, y)
    if perspective:
        here = x, y
        for _ in range(200):
            here = x * (FAR - z) / FAR, y * (FAR - z) / FAR
            z, z_x, z_y = surface(*here)
    n = np.stack([-z_x, -z_y, np.ones_like(z)], -1)
    inside = np.ones(z.shape, bool) if mask is None else mask
    return Relief(camera_of(size, perspective), n / np.linalg.norm(n, axis=-1, keepdims=True), z, inside)


def sphere(size: int, *, perspective: bool = False) -> Relief:
    """A ball of radius 1, seen by `ds.intersect`."""
    camera = camera_of(size, perspective, height=2.2 if not perspective else 2.4)
    with jax.enable_x64(True):
        seen = ds.intersect(ds.Scene(ds.Object(ds.Sphere(), ds.Material()), ds.DirectionalLight((0, 0, -1))), camera)
    normal, position, mask = (np.asarray(a) for a in (seen.normal, seen.position, seen.mask))
    return Relief(camera, normal, position[..., 2], mask)


def vase(size: int, *, perspective: bool = False) -> Relief:
    """A surface of revolution about y, whose radius swings; up to its silhouette."""
    camera = camera_of(size, perspective)
    x, y = grid(size)

    def radius(h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 0.55 + 0.25 * np.sin(3.0 * h + 0.5), 0.75 * np.cos(3.0 * h + 0.5)

    def point(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        scale = (FAR - z) / FAR if perspective else 1.0
        return x * scale, y * scale

    def outside(z: np.ndarray) -> np.ndarray:
        across, up = point(z)
        return np.hypot(across, z) - radius(up)[0]

    low, high = np.full(x.shape, np.nan), np.full(x.shape, np.nan)
    steps = np.linspace(1.0, -0.5, 3001)
    for near, far in itertools.pairwise(steps):
        first = np.isnan(low) & (outside(np.full(x.shape, far)) < 0)
        low[first], high[first] = far, near
    mask = ~np.isnan(low) & (np.abs(y) < 0.95)
    low, high = np.where(mask, low, 0.0), np.where(mask, high, 0.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        inside = outside(middle) < 0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    z = 0.5 * (low + high)
    across, up = point(z)
    rho, slope = radius(up)
    n = np.stack([across, -rho * slope, z], -1)
    view = np.stack([across, up, z - FAR], -1) if perspective else -AXIS * np.ones_like(n)
    n /= np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-12)
    mask &= np.sum(n * view, -1) < 0
    return Relief(camera, n, z, mask)


def tilted(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A plane, 50 degrees from the image's."""
    one = np.ones_like(x)
    return 1.1 * x - 0.5 * y, 1.1 * one, -0.5 * one


def coin(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A rim and a star, with steep sides."""

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        star = np.hypot(x, y) - 0.45 - 0.12 * np.cos(5 * np.arctan2(y, x))
        return 0.06 / (1 + np.exp((0.88 - np.hypot(x, y)) / 0.006)) + 0.05 / (1 + np.exp(star / 0.006))

    e = 1e-5
    return (
        height(x, y),
        (height(x + e, y) - height(x - e, y)) / 2 / e,
        (height(x, y + e) - height(x, y - e)) / 2 / e,
    )


def waves(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hills and hollows."""
    s, c = np.sin, np.cos
    return 0.12 * s(5 * x) * c(4 * y), 0.6 * c(5 * x) * c(4 * y), -0.48 * s(5 * x) * s(4 * y)


def stepped(height: float, where: float = 0.0, angle: float = 0.0, end: float = 0.2, whole: bool = False) -> Height:
    """A gentle hill with a step along a line, that is whole at one border and fades out at `end`.

    `angle`: of the line from y, degrees. `whole`: the step does not fade out; it grows along its line instead.
    """
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    border = 1.1 / max(abs(c), abs(s)) + 0.3  # beyond the image

    def surface(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        across, along = c * x + s * y - where, c * y - s * x
        side = across > 0
        if whole:
            J, slope = height * (1.0 + 0.5 * along), np.full_like(x, 0.5 * height)
        else:
            t = np.clip((along - end) / (border - end), 0.0, 1.0)
            J, slope = height * t * t * (3.0 - 2.0 * t), height * 6.0 * t * (1.0 - t) / (border - end)
        z = 0.15 * np.sin(2.0 * x) * np.cos(1.5 * y) + side * J
        z_x = 0.3 * np.cos(2.0 * x) * np.cos(1.5 * y) - side * slope * s
        z_y = -0.225 * np.sin(2.0 * x) * np.sin(1.5 * y) + side * slope * c
        return z, z_x, z_y

    return surface


def off(found: ds.heights.HeightMap, relief: Relief) -> np.ndarray:
    """By how much the heights of the mask are off in the gauge of the map, which is that of each part."""
    part = found.part[found.mask]
    z = relief.z[found.mask]
    if isinstance(relief.camera, ds.OrthographicCamera):
        truth = z - (np.bincount(part, z) / np.bincount(part))[part]
    else:
        log = np.log(FAR - z)
        truth = FAR - FAR * np.exp(log - (np.bincount(part, log) / np.bincount(part))[part])
    return found.height[found.mask] - truth


def relative(found: ds.heights.HeightMap, relief: Relief) -> float:
    """Root mean square error of the heights, in the range of the true ones."""
    return float(np.sqrt(np.mean(off(found, relief) ** 2)) / np.ptp(relief.z[found.mask]))


def covered(found: ds.heights.HeightMap, relief: Relief) -> float:
    """Share of the texels whose true height is within the 95 % interval."""
    return float(np.mean(np.abs(off(found, relief)) < 1.96 * found.errors[found.mask]))
