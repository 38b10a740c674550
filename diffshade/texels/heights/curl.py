"""The curl of the differences: what they add up to around four neighbouring texels, at several resolutions.

Around a closed path the differences of any height field add up to 0. What they do add up to is noise, or tells of a
discontinuity between the texels. A texel of the next coarser level is the mean of 2 x 2 texels, and the differences of
such means are sums of differences, without a further approximation: of a discontinuity that many texels share, coarser
levels show more.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import scipy.ndimage
from jaxtyping import Float, Num

from ...core.robust_scale import robust_scale
from .differences import Differences
from .regions import image_of
from .system import HeightGrid


def curls(
    grid: HeightGrid,
    differences: Float[np.ndarray, " edges"],
    variances: Float[np.ndarray, " edges"],
    modes: Iterable[Float[np.ndarray, " edges"]] = (),
    smallest: int = 6,
) -> list[Float[np.ndarray, "g v"]]:
    """Return the curl in its standard deviations, the finest level first; 0 where a difference is missing.

    Args:
        grid: The texels.
        differences: Of each pair.
        variances: Of each pair; infinite where the difference is not to be looked at.
        modes: Differences, of one deviation each, by what all normals have in common.
        smallest: Texels along the shorter side of the coarsest level, at least.
    """
    values = [image_of(grid.pair, of) for of in (differences, *modes)]
    variance = image_of(grid.pair, variances, np.inf)
    found: list[Float[np.ndarray, "g v"]] = []
    while not found or min(grid.inside.shape) >> len(found) >= smallest:
        if found:
            values = [_coarser(of, 2.0) / 4.0 for of in values]
            variance = _coarser(variance, 4.0) / 12.0  # as neighbours in a row have half of their noise in common
        growth = (4.0 - 4.0 ** -len(found)) / 3.0  # where the slopes of single texels have independent noise
        curl, *shared = (around(of, -1) for of in values)
        total = growth * around(variance, 1) + sum(of**2 for of in shared)
        found.append(np.where(np.isfinite(total), curl / np.sqrt(total), 0.0))
    return found


def around(pairs: Num[np.ndarray, "2 h w"], back: int) -> Num[np.ndarray, "g v"]:
    """Return what pairs, across and down, add up to around each four texels, on the way back times `back`."""
    across, down = pairs
    return across[:-1, :-1] + down[:-1, 1:] + back * (across[1:, :-1] + down[:-1, :-1])


def _coarser(pairs: Float[np.ndarray, "2 h w"], middle: float) -> Float[np.ndarray, "2 g v"]:
    """Return sums for pairs of texels of twice the size: of three in a row, the middle one weighted, in both rows."""
    weights, (across, down) = np.array([[1.0, middle, 1.0]] * 2), pairs
    sums = scipy.ndimage.correlate(across, weights), scipy.ndimage.correlate(down, weights.T)
    return np.stack(sums)[:, 1::2, 1::2]


def noise_scale(grid: HeightGrid, pairs: Differences) -> float:
    """Return how much larger the curl is than noise alone makes it: its median size over that of noise; 0 if unknown.

    Creases and jumps, which few texels have, do not count.
    """
    variances = pairs.shown() - pairs.crease**2
    (curl,) = curls(grid, pairs.value, variances, smallest=max(grid.inside.shape))  # the finest level alone
    known = curl[curl != 0]
    return robust_scale(known) if known.size else 0.0
