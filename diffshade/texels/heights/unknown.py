"""Normals that are not known: interpolated from those around them, with errors that grow with the distance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.ndimage
from jaxtyping import Bool, Float, Int

from .regions import connected
from .system import HeightGrid

MAX_SIGMA = 1.0  # radians: the error of a normal of which nothing is known


class FilledNormals(NamedTuple):
    """Normals at every texel, and their errors."""

    normal: Float[np.ndarray, "h w 3"]
    sigma: Float[np.ndarray, "h w"]
    """Standard deviation about each of two axes, radians."""
    region: Int[np.ndarray, "h w"]
    """Region of neighbouring texels whose normals were not known, from 1; 0 where it was known."""

    def noise(self, grid: HeightGrid, random: np.random.Generator) -> Float[np.ndarray, "texels 3"]:
        """Draw errors of the texels' normals. Those of a region of unknown ones are correlated."""
        region = self.region[grid.inside]
        own = random.standard_normal((grid.size, 3))
        common = random.standard_normal((int(region.max(initial=0)) + 1, 3))[region]
        mixed = np.sqrt(0.5) * (own + common)  # half of the variance of a region is in common
        return self.sigma[grid.inside][:, None] * np.where((region > 0)[:, None], mixed, own)


def fill(
    normals: Float[np.ndarray, "h w 3"],
    sigma: Float[np.ndarray, "h w"],
    inside: Bool[np.ndarray, "h w"],
    known: Bool[np.ndarray, "h w"],
) -> FilledNormals:
    """Return normals at every texel, harmonic where they were not known (each is the mean of its neighbours).

    The error of an interpolated normal is its distance to the nearest known one, in texels, times the root mean square
    change of the known ones from texel to texel.

    Args:
        normals: Unit normals.
        sigma: Their standard deviation about each of two axes, radians.
        inside: Where there are texels, each connected to a known one.
        known: Where the normal is known.
    """
    region = connected(inside & ~known)
    if not region.any():
        return FilledNormals(normals, sigma, region)
    import pyamg

    grid = HeightGrid.of(inside)
    free = ~known[inside]
    matrix = grid.laplacian(np.ones(grid.start.size))[free]
    rest = -matrix[:, ~free] @ normals[inside][~free]
    hierarchy = pyamg.ruge_stuben_solver(matrix[:, free].tocsr(), max_coarse=200, coarse_solver="splu")
    found = np.stack([np.asarray(hierarchy.solve(b, tol=1e-6, accel="cg")) for b in rest.T], -1)
    normals, sigma = normals.copy(), sigma.copy()
    normals[inside & ~known] = found / np.maximum(np.linalg.norm(found, axis=-1, keepdims=True), 1e-9)
    away = np.asarray(scipy.ndimage.distance_transform_edt(~known))[inside & ~known]
    least = float(np.median(sigma[known]))
    sigma[inside & ~known] = np.clip(_turning(normals, sigma, known) * away, least, MAX_SIGMA)
    return FilledNormals(normals, sigma, region)


def _turning(
    normals: Float[np.ndarray, "h w 3"], sigma: Float[np.ndarray, "h w"], known: Bool[np.ndarray, "h w"]
) -> float:
    """Return the root mean square change of the known normals from texel to texel, radians, without their noise."""
    grid, variance = HeightGrid.of(known), sigma[known] ** 2
    change = np.sum(grid.step(normals[known]) ** 2, -1) - 2.0 * (variance[grid.start] + variance[grid.end])
    return float(np.sqrt(max(change.sum(), 0.0) / max(change.size, 1)))
