"""Errors of heights: draws of the normals' noise, and what all normals share, sent through the linear system.

What normals share is a linear map of all of them, n' = n + M n. That is what wrong directions of lights do to a matte
surface that all of them reach: with k_d n = L^+ I (Woodham 1980) an error E of the rows of L makes M = -L^+ E. The nine
entries of M have one standard deviation, which turns all normals by as much about any axis.
"""

from __future__ import annotations

import numpy as np
import scipy.ndimage
import scipy.stats
from jaxtyping import Float, Int

from ...core.progress import ReportProgress
from .differences import Differences
from .regions import image_of
from .system import HeightGrid, HeightSystem
from .unknown import FilledNormals

DRAWS = 24
SMOOTHING = 1.0  # texels: deviation of the window over which the draws' variance is averaged


def standard_errors(
    system: HeightSystem,
    pairs: Differences,
    normals: FilledNormals,
    part: Int[np.ndarray, " texels"],
    shared: Float[np.ndarray, "modes edges"],
    report_progress: ReportProgress,
) -> Float[np.ndarray, " texels"]:
    """Return standard errors of u less its mean over each part.

    The variance of 24 draws is averaged over neighbouring texels, as a geometric mean, and widened by Student's t of 24
    degrees of freedom, so that 1.96 errors hold 95 %. That of what normals share is exact, as heights are linear in it.
    """
    grid, random = system.grid, np.random.default_rng(0)
    total = np.zeros(grid.size)
    for draw in range(DRAWS):
        report_progress("errors", draw / (DRAWS + len(shared)))
        mean = grid.mean(normals.noise(grid, random), pairs.share)
        change = np.einsum("ei,ei->e", pairs.lever, mean) + pairs.crease * random.standard_normal(len(mean))
        total += less_mean(system.solve(change), part) ** 2
    logarithm = np.log(np.maximum(total / DRAWS, 1e-300))
    weight = scipy.ndimage.gaussian_filter(grid.inside.astype(float), SMOOTHING)[grid.inside]
    smooth = scipy.ndimage.gaussian_filter(image_of(grid.inside, logarithm), SMOOTHING)[grid.inside] / weight
    student = scipy.stats.t.ppf(0.975, DRAWS) / scipy.stats.norm.ppf(0.975)
    own = student**2 * np.exp(smooth + 1.0 / DRAWS)  # the mean logarithm of chi^2 is 1 / 24 low
    for i, mode in enumerate(shared):
        report_progress("errors", (DRAWS + i) / (DRAWS + len(shared)))
        own += less_mean(system.solve(mode), part) ** 2
    return np.sqrt(own)


def shared_modes(
    grid: HeightGrid, pairs: Differences, normals: FilledNormals, sigma: float
) -> Float[np.ndarray, "modes edges"]:
    """Return how each entry of M, of the deviation `sigma` (radians), changes the differences; no modes for 0."""
    if sigma == 0.0:
        return np.zeros((0, grid.start.size))
    mean = grid.mean(normals.normal[grid.inside], pairs.share)
    return sigma * np.einsum("ei,ej->ije", pairs.lever, mean).reshape(9, -1)


def unintegrable(system: HeightSystem, modes: Float[np.ndarray, "modes edges"]) -> Float[np.ndarray, " edges"]:
    """Return the variance of the residuals that modes leave: what no heights explain, and no jump need explain."""
    return sum((np.square(system.grid.step(system.solve(m)) - m) for m in modes), np.zeros(system.grid.start.size))


def less_mean(u: Float[np.ndarray, " texels"], part: Int[np.ndarray, " texels"]) -> Float[np.ndarray, " texels"]:
    """Return heights less the mean of their part."""
    return u - (np.bincount(part, u) / np.bincount(part))[part]
