"""Photographs, by NumPy and not the library, of a glossy plate in low relief: highlights cover it all at once."""

from __future__ import annotations

import numpy as np
from bumpy import TO_CAMERA, Photographed, under
from scipy import ndimage

NOISE = 0.002
COLOURS = np.array([[0.5, 0.1, 0.1], [0.1, 0.1, 0.4]])


def plate(k_d: np.ndarray, k_s: float, n_s: float, count: int, raised: np.ndarray, lowest: float) -> Photographed:
    """A plate that faces the camera, under lights of intensity 1.

    Args:
        k_d: Of each texel.
        k_s: Of all.
        n_s: Of all.
        count: Number of lights, on a spiral.
        raised: Height of each texel, pixels.
        lowest: Height of the lowest light above the plate, degrees.
    """
    random, turns = np.random.default_rng(0), np.arange(count) + 0.5
    by_y, by_x = np.gradient(raised)
    normal = np.stack([-by_x, by_y, np.ones_like(raised)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    low, high = np.sin(np.deg2rad([lowest, 80.0]))
    z, golden = low + (high - low) * turns / count, np.deg2rad(137.5) * turns
    lights = np.stack([np.sqrt(1 - z * z) * np.cos(golden), np.sqrt(1 - z * z) * np.sin(golden), z], -1)
    images = []
    for l in lights:
        n_l, half = normal @ l, (l + TO_CAMERA) / np.linalg.norm(l + TO_CAMERA)
        gloss = np.where(n_l > 0.0, k_s * np.maximum(normal @ half, 0.0) ** n_s, 0.0)
        image = k_d * np.maximum(n_l, 0.0)[..., None] + gloss[..., None]
        images.append(image + NOISE * random.standard_normal(image.shape))
    return under(list(lights), images, normal, np.ones(raised.shape, bool))


def coloured_plate(count: int) -> Photographed:
    """Of two-coloured plastic, with dents."""
    row, column = np.mgrid[:60, :70]
    raised = ndimage.gaussian_filter(np.random.default_rng(0).standard_normal(row.shape), 6.0)
    k_d = COLOURS[(row // 15 + column // 15) % 2]
    return plate(k_d, 0.3, 60.0, count, 1.5 * raised / raised.std(), 20.0)


def metal_plate(count: int) -> Photographed:
    """Of dark metal, with bars and rings on it."""
    row, column = np.mgrid[:70, :110]
    high = ((abs(column - 20) < 4) | (abs(np.hypot(row - 35, column - 60) - 18) < 4)) & (abs(row - 35) < 24)
    high |= (abs(row - 20 - column % 30) < 4) & (column > 88)
    k_d = np.ones((*row.shape, 3)) * (0.03, 0.025, 0.02)
    return plate(k_d, 0.4, 25.0, count, 8.0 * ndimage.gaussian_filter(high.astype(float), 1.5), 12.0)
