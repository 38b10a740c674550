"""Errors of heights: draws of the normals' noise, sent through the linear system that gave the heights."""

from __future__ import annotations

import numpy as np
import scipy.ndimage
import scipy.stats
from jaxtyping import Float, Int

from ...core.progress import ReportProgress
from .differences import Differences
from .system import HeightSystem
from .unknown import FilledNormals

DRAWS = 24
SMOOTHING = 1.0  # texels: deviation of the window over which the draws' variance is averaged


def standard_errors(
    system: HeightSystem,
    across: Differences,
    down: Differences,
    normals: FilledNormals,
    part: Int[np.ndarray, " texels"],
    report_progress: ReportProgress,
) -> Float[np.ndarray, " texels"]:
    """Return standard errors of u less its mean over each part.

    The variance of 24 draws is averaged over neighbouring texels, as a geometric mean, and widened by Student's t of 24
    degrees of freedom, so that 1.96 errors hold 95 %.
    """
    grid, random = system.grid, np.random.default_rng(0)
    share, crease = grid.edges(across.share, down.share)[:, None], grid.edges(across.crease, down.crease)
    lever = np.concatenate([across.lever[grid.across], down.lever[grid.down]])
    total = np.zeros(grid.size)
    for draw in range(DRAWS):
        report_progress("errors", draw / DRAWS)
        noise = normals.noise(grid, random)
        mean = share * noise[grid.start] + (1.0 - share) * noise[grid.end]
        change = np.einsum("ei,ei->e", lever, mean) + crease * random.standard_normal(crease.size)
        total += less_mean(system.solve(change), part) ** 2
    logarithm = np.log(np.maximum(total / DRAWS, 1e-300))
    weight = scipy.ndimage.gaussian_filter(grid.inside.astype(float), SMOOTHING)[grid.inside]
    smooth = scipy.ndimage.gaussian_filter(grid.image(logarithm), SMOOTHING)[grid.inside] / weight
    student = scipy.stats.t.ppf(0.975, DRAWS) / scipy.stats.norm.ppf(0.975)
    return student * np.exp(0.5 * (smooth + 1.0 / DRAWS))  # the mean logarithm of chi^2 is 1 / 24 low


def less_mean(u: Float[np.ndarray, " texels"], part: Int[np.ndarray, " texels"]) -> Float[np.ndarray, " texels"]:
    """Return heights less the mean of their part."""
    return u - (np.bincount(part, u) / np.bincount(part))[part]
