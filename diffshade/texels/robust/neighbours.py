"""Neighbours: what the normals around a texel say of its own, on the grid of the image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.fields import Array
from ...core.thresholds import SLIGHT

SOFT = SLIGHT  # distance below which neighbours pull no harder: that of normals half a degree apart

MEDIAN_SIDE = 3  # side of the square whose geometric median replaces a normal: the fewest that outvote an outlier
SCATTER_SIDE = 11  # side of the square over which normals scatter
MISFIT_SIDE = 5  # side of the square over which misfits are averaged
MARGIN = SCATTER_SIDE // 2  # rows of its neighbours that a band needs for results like the whole image's
ITERATIONS = 10  # of reweighted means and squares


class NeighbourGrid(NamedTuple):
    """The rows of the image that some texels lie in."""

    mask: Bool[np.ndarray, "h w"]
    row: Int[np.ndarray, " n"]
    column: Int[np.ndarray, " n"]

    def image(self, values: Float[Array, "n _"]) -> Float[np.ndarray, "h w _"]:
        """Return the values of the texels as an image, 0 elsewhere."""
        found = np.zeros((*self.mask.shape, values.shape[1]))
        found[self.row, self.column] = values
        return found


def grid_of(pixels: Int[np.ndarray, " n"], width: int) -> NeighbourGrid:
    """Return the rows that some pixels lie in."""
    row, column = np.divmod(pixels, width)
    row = row - row.min()
    mask = np.zeros((int(row.max()) + 1, width), bool)
    mask[row, column] = True
    return NeighbourGrid(mask, row, column)


def geometric_median(normal: Float[np.ndarray, "h w 3"], mask: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "h w 3"]:
    """Return the unit vectors nearest to the normals around each texel by the sum of distances (Weiszfeld 1937).

    Unlike a mean it stays at an edge, and one outlier does not move it far.
    """
    around = _shifted(normal * mask[..., None], MEDIAN_SIDE)[:, mask]
    inside = _shifted(mask[..., None].astype(normal.dtype), MEDIAN_SIDE)[:, mask, 0]
    inside = inside * inside[::-1]  # neighbours in pairs: at an outline those of one side would pull normals inwards
    found = normal[mask]
    for _ in range(ITERATIONS):
        weight = inside / np.sqrt(((around - found) ** 2).sum(-1) + SOFT**2)
        total = np.einsum("st,stc->tc", weight, around)
        length = np.linalg.norm(total, axis=-1, keepdims=True)
        found = np.where(length > 0.0, total / np.where(length > 0.0, length, 1.0), found)
    image = normal.copy()
    image[mask] = found
    return image


def corrected(
    normal: Float[np.ndarray, "h w 3"], angle: Float[np.ndarray, "h w 1"], mask: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w 3"]:
    """Return the geometric medians, and a texel's own normal where that is known better than its median is near.

    Args:
        normal: The normals of the texels, each by itself.
        angle: How far each may be off, radians. Relief finer than three texels has medians farther away.
        mask: Where they are known.
    """
    median = geometric_median(normal, mask)
    apart = np.linalg.norm(median - normal, axis=-1, keepdims=True)
    return np.where(apart > 2.0 * np.sin(np.minimum(angle, np.pi) / 2.0), normal, median)


def scatter_of(normal: Float[np.ndarray, "h w 3"], mask: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Return the root mean square sine by which the normals around each texel leave their mean, 0 outside."""
    share = np.maximum(_box(mask.astype(np.float64), SCATTER_SIDE), 1e-9)
    mean = [_box(normal[..., i] * mask, SCATTER_SIDE) / share for i in range(3)]
    return np.where(mask, np.sqrt(np.maximum(1.0 - sum(m * m for m in mean), 1e-8)), 0.0)


def mean_around(values: Float[np.ndarray, "h w"], mask: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Return the mean of values, none of them negative, around each texel, 0 outside."""
    share = np.maximum(_box(mask.astype(np.float64), MISFIT_SIDE), 1e-9)
    return np.where(mask, np.maximum(_box(np.where(mask, values, 0.0), MISFIT_SIDE), 0.0) / share, 0.0)


def _box(values: Float[np.ndarray, "h w"], side: int) -> Float[np.ndarray, "h w"]:
    """Return the mean over a square, with zeros beyond the image; sums are whole, so that bands agree with an image."""
    padded = np.pad(np.asarray(values, np.float64), side // 2)
    windows = np.lib.stride_tricks.sliding_window_view(padded, side, 0).sum(-1)
    return np.lib.stride_tricks.sliding_window_view(windows, side, 1).sum(-1) / side**2


def _shifted(image: Float[np.ndarray, "h w c"], side: int) -> Float[np.ndarray, "n h w c"]:
    """Return the image shifted to every place of a square, zeros coming in."""
    r, (height, width) = side // 2, image.shape[:2]
    padded = np.pad(image, ((r, r), (r, r), (0, 0)))
    return np.stack([padded[i : i + height, j : j + width] for i in range(side) for j in range(side)])
