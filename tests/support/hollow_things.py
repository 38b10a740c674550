"""Photographs of planes, hollows, rings and vases, of which shading alone tells little: masked where the sheet ends."""

from __future__ import annotations

import numpy as np

import diffshade as ds

SIDE, WIDTH = 56, 2.2  # pixels, and the width of the picture
SHAPES = ("bowl", "dish", "saddle", "tilted plane", "plane", "ring", "hollow ring", "vase")


def _height(shape: str, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The height of a shape, and where it is."""
    square = (np.abs(x) < 0.95) & (np.abs(y) < 0.95)
    r = np.hypot(x, y)
    across = (0.55 + 0.25 * np.sin(3.0 * y + 0.5)) ** 2  # the square of a vase's radius
    ring = np.sqrt(np.maximum(0.3**2 - (r - 0.6) ** 2, 1e-3))
    return {
        "bowl": (1.0 - np.sqrt(np.maximum(1.0 - r**2, 1e-2)), r < 0.99),
        "dish": (0.3 * r**2, r < 0.9),
        "saddle": (0.4 * x * y, square),
        "tilted plane": (0.5 * x - 0.3 * y, square),
        "plane": (0.0 * x, square),
        "ring": (ring, np.abs(r - 0.6) < 0.29),
        "hollow ring": (-ring, np.abs(r - 0.6) < 0.29),
        "vase": (np.sqrt(np.maximum(across - x**2, 0.0)), (across - x**2 > 0.06 * across) & (np.abs(y) < 0.95)),
    }[shape]


def _in_shadow(z: np.ndarray, mask: np.ndarray, l: np.ndarray) -> np.ndarray:
    """Where the shape keeps light from direction l off itself."""
    step, row, column = WIDTH / SIDE, *np.indices(z.shape)
    aside = np.hypot(l[0], l[1])
    shadow = np.zeros_like(mask)
    for k in range(2, SIDE):
        r, c = (np.rint(at).astype(int) for at in (row - k * l[1] / aside, column + k * l[0] / aside))
        inside = (r >= 0) & (r < SIDE) & (c >= 0) & (c < SIDE)
        r, c = r.clip(0, SIDE - 1), c.clip(0, SIDE - 1)
        shadow |= inside & mask[r, c] & (z[r, c] > z + k * step * l[2] / aside + step)
    return shadow


def hollow_thing(shape: str, l: np.ndarray, k_s: float, seed: int) -> tuple[ds.Scene, list[ds.View]]:
    """A right set-up: a shape under lights from directions l, with a highlight of k_s, and noise."""
    random = np.random.default_rng(seed)
    across = WIDTH / 2.0 * (2.0 * (np.arange(SIDE) + 0.5) / SIDE - 1.0)
    x, y = np.meshgrid(across, -across)
    z, mask = _height(shape, x, y)
    down, right = np.gradient(z, WIDTH / SIDE)
    n = np.stack([-right, down, np.ones_like(z)], -1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    k_d, n_s = random.uniform(0.2, 0.8), random.uniform(8.0, 80.0)
    camera = ds.OrthographicCamera((0.0, 0.0, 4.0), shape=(SIDE, SIDE), height=WIDTH, local_viewer=False)
    views = []
    for i, at in enumerate(l):
        h = at + np.array([0.0, 0.0, 1.0])
        h /= np.linalg.norm(h)
        shading = np.maximum(n @ at, 0.0)
        seen = (k_d * shading + k_s * (shading > 0.0) * np.maximum(n @ h, 0.0) ** n_s) * (
            mask & ~_in_shadow(z, mask, at)
        )
        image = np.repeat(seen[..., None], 3, -1) + 0.005 * random.standard_normal((SIDE, SIDE, 3))
        views.append(ds.View(np.minimum(image, 1.0), camera, lit=(i,)))
    surface = ds.GBuffer(np.broadcast_to([0.0, 0.0, 1.0], n.shape), mask=mask)
    return ds.Scene(ds.Object(surface), [ds.DirectionalLight(-at) for at in l]), views
