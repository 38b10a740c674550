"""Photographs, by NumPy and not the library, of a sphere with a field of bumps: materials, cast shadows, lights off."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

import diffshade as ds

SIDE, WIDTH = 64, 2.1  # pixels, and the width of the picture in radii
PIXEL = WIDTH / SIDE
NOISE, STEPS = 0.003, 4095
TO_CAMERA = np.array([0.0, 0.0, 1.0])
MATERIALS = ("matte", "glossy", "two", "texture", "metal")  # "clay" is matte and rough
CLAY = 0.4  # B / A of Oren and Nayar


class Photographed(NamedTuple):
    """An object whose normals are known, and photographs of it."""

    scene: ds.Scene
    views: list[ds.View]
    to_light: np.ndarray
    normal: np.ndarray
    mask: np.ndarray

    def least_squares(self, trimmed: float = 0.0) -> np.ndarray:
        """Normals by Woodham (1980), without a share of the darkest and of the brightest observations."""
        L = self.to_light
        seen = np.stack([np.asarray(view.image).mean(-1)[self.mask] for view in self.views])
        rank = np.argsort(np.argsort(seen, 0), 0)
        out = int(trimmed * len(L))
        kept = ((rank >= out) & (rank < len(L) - out)).astype(float)
        b = np.linalg.solve(np.einsum("vi,vj,vt->tij", L, L, kept), np.einsum("vi,vt->ti", L, seen * kept)[..., None])
        normal = np.zeros((*self.mask.shape, 3))
        normal[self.mask] = b[..., 0] / np.linalg.norm(b[..., 0], axis=-1, keepdims=True)
        return normal


def degrees_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles between unit vectors."""
    return np.rad2deg(2.0 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2.0, 0.0, 1.0)))


def jumps(found: np.ndarray, normal: np.ndarray, mask: np.ndarray) -> float:
    """The share of neighbours that differ by 5 degrees more than the true normals do."""
    bad, every = 0, 0
    for a, b in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        more = degrees_between(found[a], found[b]) - degrees_between(normal[a], normal[b])
        both = mask[a] & mask[b]
        bad, every = bad + np.sum(more[both] > 5.0), every + both.sum()
    return float(bad / every)


def under(
    lights: Sequence[np.ndarray], images: Sequence[np.ndarray], normal: np.ndarray, mask: np.ndarray
) -> Photographed:
    """Photographs under distant lights, seen from +z."""
    camera = ds.OrthographicCamera((0, 0, 4), shape=mask.shape, local_viewer=False)
    facing = ds.GBuffer(np.broadcast_to([0.0, 0.0, 1.0], (*mask.shape, 3)), None, mask)
    scene = ds.Scene(ds.Object(facing, ds.Material(0.0, 0.5, 0.1)), [ds.DirectionalLight(-l) for l in lights])
    views = [ds.View(image, camera, mask, lit=i) for i, image in enumerate(images)]
    return Photographed(scene, views, np.asarray(lights), normal, mask)


def bumpy(
    material: str, count: int, cone: float, *, off: float = 0.0, cast: bool = False, seed: int = 0
) -> Photographed:
    """Photographs under lights spread evenly in a cone about the camera.

    Args:
        material: One of `MATERIALS`, or "clay".
        count: Number of lights.
        cone: Its half angle, degrees.
        off: Standard deviation of the directions that are told, about each axis, degrees.
        cast: Whether shadows are cast.
        seed: Of bumps, noise and directions.
    """
    random = np.random.default_rng([seed, count, int(cone)])
    height, normal, mask = _surface(np.random.default_rng(seed))
    k_d, k_s, n_s = _material(material)
    turns = np.arange(count) + 0.5
    z = 1.0 - (1.0 - np.cos(np.deg2rad(cone))) * turns / count
    golden = turns * np.pi * (3.0 - np.sqrt(5.0))
    lights = np.stack([np.sqrt(1 - z * z) * np.cos(golden), np.sqrt(1 - z * z) * np.sin(golden), z], -1)
    images = []
    for l in lights:
        n_l, half = normal @ l, (l + TO_CAMERA) / np.linalg.norm(l + TO_CAMERA)
        image = oren_nayar(normal, l, TO_CAMERA, CLAY if material == "clay" else 0.0)[..., None] * k_d
        image += np.where(n_l > 0.0, k_s * np.maximum(normal @ half, 0.0) ** n_s, 0.0)[..., None]
        image[_shadow(height, mask, l) if cast else np.zeros_like(mask)] = 0.0
        image += NOISE * random.standard_normal(image.shape)
        images.append(np.clip(np.rint(image * STEPS) / STEPS, 0.0, 1.0))
    tilt = np.deg2rad(off) * random.standard_normal((count, 3))
    told = lights + tilt - np.sum(tilt * lights, -1, keepdims=True) * lights
    return under(told / np.linalg.norm(told, axis=-1, keepdims=True), images, normal, mask)


def oren_nayar(n: np.ndarray, l: np.ndarray, v: np.ndarray, ratio: float) -> np.ndarray:
    """cos(theta_i) (1 + ratio max(0, cos(phi)) sin(alpha) tan(beta)): Oren and Nayar 1994, eq. 30, by its angles."""
    n_l, n_v = np.sum(n * l, -1), np.sum(n * v, -1)
    across_l, across_v = l - n_l[..., None] * n, v - n_v[..., None] * n
    lengths = np.linalg.norm(across_l, axis=-1) * np.linalg.norm(across_v, axis=-1)
    of_phi = np.sum(across_l * across_v, -1) / np.where(lengths > 0.0, lengths, 1.0)
    of_l, of_v = (np.arccos(np.clip(c, -1.0, 1.0)) for c in (n_l, n_v))
    more = np.maximum(of_phi, 0.0) * np.sin(np.maximum(of_l, of_v)) * np.tan(np.minimum(of_l, of_v))
    return np.where(n_l > 0.0, n_l * (1.0 + ratio * more), 0.0)


def wrapped(n: np.ndarray, l: np.ndarray, w: float) -> np.ndarray:
    """Lambert's law of a surface that light enters, so that it is lit beyond where the light ends (Green 2004)."""
    return np.maximum((np.sum(n * l, -1) + w) / (1.0 + w), 0.0)


def _surface(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Heights, normals and the mask."""
    row, column = np.mgrid[:SIDE, :SIDE] + 0.5
    x, y = column * PIXEL - WIDTH / 2, WIDTH / 2 - row * PIXEL
    z2 = 1.0 - x**2 - y**2
    height = np.sqrt(np.maximum(z2, 0.01))
    for _ in range(12):
        a, b = 7.0 * random.standard_normal(2)
        height = height + 0.015 * np.cos(a * x + b * y + random.uniform(0.0, 2.0 * np.pi))
    by_y, by_x = np.gradient(height, PIXEL)
    normal = np.stack([-by_x, by_y, np.ones_like(height)], -1)
    return height, normal / np.linalg.norm(normal, axis=-1, keepdims=True), z2 > 0.1


def _material(material: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """k_d, k_s and n_s of each pixel."""
    row, column = np.mgrid[:SIDE, :SIDE]
    k_d, one = np.ones((SIDE, SIDE, 3)) * (0.5, 0.4, 0.3), np.ones((SIDE, SIDE))
    right = column >= SIDE // 2
    if material == "two":
        k_d = np.where(right[..., None], (0.15, 0.3, 0.5), k_d)
        return k_d, np.where(right, 0.4, 0.05), np.where(right, 80.0, 15.0)
    if material == "texture":
        return k_d * (0.7 + 0.5 * np.sin(column / 3.0) * np.cos(row / 4.0))[..., None], 0.15 * one, 40.0 * one
    if material == "metal":
        return np.ones((SIDE, SIDE, 3)) * (0.05, 0.04, 0.03), 0.6 * one, 25.0 * one
    return k_d, (0.3 if material == "glossy" else 0.0) * one, 40.0 * one


def _shadow(height: np.ndarray, mask: np.ndarray, l: np.ndarray) -> np.ndarray:
    """Where the heights stand in a light's way."""
    row, column = np.mgrid[:SIDE, :SIDE].astype(float)
    across, high = np.hypot(*l[:2]), np.where(mask, height, -np.inf)
    found = np.zeros_like(mask)
    for step in np.arange(1.5, SIDE):
        x, y = np.rint(column + l[0] / across * step), np.rint(row - l[1] / across * step)
        inside = (x >= 0) & (x < SIDE) & (y >= 0) & (y < SIDE)
        there = high[np.clip(y, 0, SIDE - 1).astype(int), np.clip(x, 0, SIDE - 1).astype(int)]
        found |= inside & (there > height + (l[2] / across * step + 0.3) * PIXEL)
    return found
