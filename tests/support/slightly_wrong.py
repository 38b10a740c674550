"""Photographs of a ball, by NumPy and not the library, with small faults of random size that real set-ups have."""

from __future__ import annotations

import numpy as np
from wrong_photographs import FREE, NOISE, SIDE, photon_noise, through_jpeg, towards, turned, vignetted

import diffshade as ds

SLIGHT = ("none", "lights", "bounce", "ellipsoid", "vignetting", "jpeg", "photon noise", "floor at 0", "together")
FOV = 36.0
EYE = np.array([0.0, 0.0, 4.0])
Material = dict[str, np.ndarray | float]


def material(random: np.random.Generator) -> Material:
    k_a, k_d, k_s = (random.uniform(low, high, 3) for low, high in ((0.02, 0.1), (0.2, 0.6), (0.1, 0.4)))
    return {"k_a": k_a, "k_d": k_d, "k_s": k_s, "n_s": float(np.exp(random.uniform(np.log(8), np.log(60))))}


def ball(
    of: Material,
    to_light: np.ndarray,
    power: float = 1.0,
    axes: tuple[float, ...] = (1.0, 1.0, 1.0),
    bounce: float = 0.0,
) -> np.ndarray:
    """A ball, or an ellipsoid, under a distant light (E1, E5), above a floor that gives back a part of its light."""
    row, column = np.mgrid[:SIDE, :SIDE] + 0.5
    x, y = 2 * column / SIDE - 1, 1 - 2 * row / SIDE
    ray = np.stack([x, y, np.full(x.shape, -1 / np.tan(np.deg2rad(FOV / 2)))], -1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    o, d = EYE / axes, ray / axes
    a, b, c = np.sum(d**2, -1), d @ o, o @ o - 1
    hit = b**2 > a * c
    p = EYE + ((-b - np.sqrt(np.where(hit, b**2 - a * c, 1.0))) / a)[..., None] * ray
    n = p / np.square(axes)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    l = to_light / np.linalg.norm(to_light)
    n_l = n @ l
    v_r = np.maximum(np.sum((2 * n_l[..., None] * n - l) * -ray, -1), 0.0)
    lit = np.maximum(n_l, 0.0)[..., None] * of["k_d"] + np.where(n_l > 0, v_r ** of["n_s"], 0.0)[..., None] * of["k_s"]
    from_below = bounce * np.asarray(of["k_d"]) * ((1 - n[..., 1]) / 2)[..., None]
    return np.where(hit[..., None], np.asarray(of["k_a"]) + power * lit + from_below, 0.0)


def slightly_wrong(kind: str, count: int, seed: int) -> tuple[ds.Fit, np.ndarray]:
    """Fit photographs with a fault, or all of them together; return the fit and the true values.

    Lights are 1 degree and 2 % off (standard deviations), a floor gives back 5 %, the axes of the ball are 1 % longer
    and shorter, a corner has 4 % less light, JPEG has quality 90, white has 2,500 photons.
    """
    random = np.random.default_rng([seed, count])

    def has(fault: str) -> bool:
        return kind in (fault, "together")

    of, told, power = material(random), towards(count, random), np.ones(count)
    if has("floor at 0"):
        of["k_a"] = 0.1 * of["k_a"]
    true = told
    if has("lights"):
        off = np.abs(random.standard_normal(count))
        axes = random.standard_normal((count, 3))
        true = np.concatenate([turned(at[None], *by) for at, *by in zip(told, axes, off, strict=True)])
        power = 1.0 + 0.02 * random.standard_normal(count)
    shape, bounce = (1.01, 1.0, 0.99) if has("ellipsoid") else (1.0, 1.0, 1.0), 0.05 if has("bounce") else 0.0
    images = [ball(of, *light, shape, bounce) for light in zip(true, power, strict=True)]
    images = [vignetted(image, 0.04) for image in images] if has("vignetting") else images
    images = [photon_noise(image, random) for image in images] if has("photon noise") else images
    images = [image + NOISE * random.standard_normal(image.shape) for image in images]
    images = [np.maximum(image, 0.0) for image in images] if has("floor at 0") else images
    images = [through_jpeg(image) for image in images] if has("jpeg") else images
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.9, 0.9, 0.9, 3.0)), [ds.DirectionalLight(-l) for l in told])
    camera = ds.Camera(eye=tuple(EYE), fov=FOV, shape=(SIDE, SIDE))
    fit = ds.fit(scene, [ds.View(image, camera, lit=(i,)) for i, image in enumerate(images)], free=FREE)
    return fit, np.concatenate([np.ravel(of[name]) for name in FREE])
