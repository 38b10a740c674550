r"""Matte texels: b = k_d n of an object under lights, by what photographs show in neither shadow nor highlight.

A matte texel has y = b.s under a light s = I l (Woodham 1980). The slopes of b over the image say whether it is that of
a surface:

$$ \partial_y (b_1 / b_3) = \partial_x (b_2 / b_3) $$
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter

from ...core.robust_scale import robust_scale
from ...core.thresholds import MINOR, MOST, SMALL, TINY
from ...inverse.data.views import View
from ...inverse.forward.losses import CAUCHY
from ..tiles import TexelTile, ViewReader

MIN_RANK, MAX_RANK = 0.3, 0.9  # ranks of a texel's observations between which lie neither shadows nor highlights
SIGMA = 2.0  # cells: standard deviation of what takes the noise off slopes
REWEIGHTINGS = 5
ROUNDS = 60  # of texels and lights in turn


class Cells(NamedTuple):
    """What the views show of an object, on a grid of so many cells along its longer side at most."""

    seen: Float[np.ndarray, "views h w"]
    """Brightness, of exposure 1."""
    counts: Bool[np.ndarray, "views h w"]
    inside: Bool[np.ndarray, "h w"]


class Surface(NamedTuple):
    """What cells show under lights, as a matte surface, in the axes of the lights."""

    inside: Bool[np.ndarray, "h w"]
    """Where the object is."""
    s: Float[np.ndarray, "views 3"]
    """The lights, of power 1."""
    y: Float[np.ndarray, "views n"]
    """What the cells show, by the power of the lights."""
    counts: Bool[np.ndarray, "views n"]
    misfit: float
    """Typical residual of a cell, relative to its brightness."""
    b: Float[np.ndarray, "h w 3"]
    """0 outside the object."""
    smooth: Float[np.ndarray, "m 3"]
    """b without its noise, of cells with neighbours to the right and below."""
    by_x: Float[np.ndarray, "m 3"]
    by_y: Float[np.ndarray, "m 3"]
    """Upwards."""
    whole: Bool[np.ndarray, "g v"]
    """Which cells these are."""

    @property
    def tells(self) -> bool:
        """Whether there are such cells, and lights that reach them."""
        return bool(self.whole.any() and np.isfinite(self.misfit))


def cells_of(
    views: Sequence[View], reader: ViewReader, sample: TexelTile, across: int, colour: Float[np.ndarray, "views _"]
) -> Cells:
    """Return what the views show of a grid of cells: of each the mean of its upper row of pixels.

    Args:
        views: The photographs.
        reader: What reads them.
        sample: Texels from all over the object.
        across: Most cells along the longer side.
        colour: Of the light of each view, by which its channels are divided.
    """
    height, width = reader.shape
    row, column = np.divmod(sample.pixels, width)
    size = int(max(np.ptp(row), np.ptp(column)) // across + 1)
    first, left = (max(int(of.min()) - 2 * size, 0) for of in (row, column))
    last, right = (min(int(of.max()) + 2 * size, end - 1) for of, end in ((row, height), (column, width)))
    h, w = (last - first) // size + 1, (right - left) // size + 1
    black = np.array([float(view.black) for view in views])[:, None, None]
    one = np.array([float(view.exposure) for view in views])[:, None, None] * colour[..., None]
    sums = np.zeros((3, len(views), h, w))  # of brightness, of observations that count, and of pixels inside
    for r in range(h):
        tile = reader.read(first + r * size, first + r * size + 1, 1)
        column = tile.pixels % width - left
        kept = np.flatnonzero((column >= 0) & (column < w * size))
        tile = tile.part(kept)
        y = ((np.asarray(tile.target, np.float64) - black) / one).mean(1)
        row = np.zeros((3, len(views), w * size))
        row[..., column[kept]] = y * tile.counts, tile.counts, np.ones_like(y)
        sums[:, :, r] = row.reshape(3, len(views), w, size).sum(-1)
    seen, counts, (inside, *_) = sums
    most = inside > MOST * size
    return Cells(seen / np.maximum(counts, 1.0), (counts == inside) & most, most)


def surface_under(cells: Cells, s: Float[np.ndarray, "views 3"], power: Float[np.ndarray, " views"]) -> Surface:
    """Return what cells show under lights s, up to the power of each."""
    lit = power[:, None] > 0.0
    y = cells.seen[:, cells.inside] / np.where(lit, power[:, None], 1.0)
    counts = cells.counts[:, cells.inside] & lit
    b = np.zeros((*cells.inside.shape, 3))
    b[cells.inside], misfit = pseudo_normals(y, counts, s)
    share = np.maximum(gaussian_filter(cells.inside.astype(float), SIGMA), 1e-9)
    smooth = np.stack([gaussian_filter(b[..., k], SIGMA) for k in range(3)], -1) / share[..., None]
    whole = with_neighbours(cells.inside)
    here, right, below = smooth[:-1, :-1][whole], smooth[:-1, 1:][whole], smooth[1:, :-1][whole]
    middle = (here + right + below) / 3.0
    return Surface(cells.inside, s, y, counts, misfit, b, middle, right - here, here - below, whole)


def with_neighbours(inside: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "g v"]:
    """Return which cells have neighbours to the right and below."""
    return inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:]


def pseudo_normals(
    y: Float[np.ndarray, "views texels"], counts: Bool[np.ndarray, "views texels"], s: Float[np.ndarray, "views 3"]
) -> tuple[Float[np.ndarray, "texels 3"], float]:
    """Return b of texels whose lights are known, under Cauchy's loss, and the typical residual by their brightness."""
    used, level = middle_levels(y, counts)
    b, misfit, weight = np.zeros((y.shape[1], 3)), 0.0, used.astype(float)
    for _ in range(REWEIGHTINGS + 1):
        b = texels_under(y, weight, s)
        r = (s @ b.T - y) / level
        misfit = robust_scale(r[used]) if used.any() else np.inf
        weight = used / (1.0 + (r / (CAUCHY * max(misfit, 1e-9))) ** 2)
    return b, misfit


def under_unequal(
    y: Float[np.ndarray, "views texels"],
    counts: Bool[np.ndarray, "views texels"],
    towards: Float[np.ndarray, "views 3"],
) -> tuple[Float[np.ndarray, "texels 3"], Float[np.ndarray, "views 3"]]:
    """Return b of texels, by least squares, and the lights, whose directions are known and whose strengths are not.

    Neither shadows nor highlights count; those that are left in the middle ranks do not move a median.
    """
    used, level = middle_levels(y, counts)
    y, b, s = y / level, np.zeros((y.shape[1], 3)), towards
    for _ in range(ROUNDS):
        b = texels_under(y, used.astype(float), s)
        shaded = towards @ b.T
        lit = used & (shaded > SMALL)
        ratio = np.ma.masked_array(y / np.where(lit, shaded, 1.0), ~lit)
        s = towards * np.ma.median(ratio, 1).filled(1.0)[:, None]
    return level[:, None] * b, s


def texels_under(
    y: Float[np.ndarray, "views texels"], weight: Float[np.ndarray, "views texels"], s: Float[np.ndarray, "views 3"]
) -> Float[np.ndarray, "texels 3"]:
    """Return b of each texel under lights s, by weighted least squares."""
    A = np.einsum("vt,vi,vj->tij", weight, s, s, optimize=True)
    A += 1e-9 * (np.trace(A, axis1=1, axis2=2)[:, None, None] + TINY) * np.eye(3)
    return np.linalg.solve(A, np.einsum("vt,vt,vi->ti", weight, y, s, optimize=True)[..., None])[..., 0]


def middle_levels(
    y: Float[np.ndarray, "views texels"], counts: Bool[np.ndarray, "views texels"]
) -> tuple[Bool[np.ndarray, "views texels"], Float[np.ndarray, " texels"]]:
    """Return which observations lie in neither shadow nor highlight, by their rank in their texel, and their mean."""
    rank = np.argsort(np.argsort(np.where(counts, y, np.inf), 0), 0)
    number = counts.sum(0)
    used = counts & (rank >= MIN_RANK * number) & (rank < MAX_RANK * number)
    return used, np.maximum((y * used).sum(0) / np.maximum(used.sum(0), 1), TINY)


def bright_texels(
    y: Float[np.ndarray, "views texels"], counts: Bool[np.ndarray, "views texels"]
) -> tuple[Float[np.ndarray, "views _"], Bool[np.ndarray, "views _"]]:
    """Return the texels that show something: of a black one only the noise would be left."""
    level = np.where(counts, y, 0.0).sum(0) / np.maximum(counts.sum(0), 1)
    bright = level > MINOR * np.median(level)
    return y[:, bright], counts[:, bright]
