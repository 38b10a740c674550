"""Noise tests: whether what a fit leaves of its photographs is noise, for a few additions a pixel.

The residuals of a right description are independent, so that their sums over any cells have a variance that is the sum
of their squares (White 1980). Where the sums over parts of the picture or of the range of brightness, or the products
with neighbours and with the picture's own gradient and curvature, are larger, the description is wrong somewhere. The
numbers that were fitted take a part of each sum away, so that these tests err on the side of noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy import special

from ...core.backend import PLAINLY, jit_quickly
from ...core.fields import Array
from ...parallel.threads import on_all_cores
from ..forward.interface import AbstractForwardModel
from ..laid_out import LaidOut
from ..pixels.blocks import MANY, Block, total
from ..pixels.blocks import chunks as in_chunks

FALSE_ALARM = 1e-4  # the significance level of all these tests together, and of each test of a fault
CELLS, SIZES = 16, 3  # cells along each side of the object, which are joined to 8 and to 4
BINS = CELLS  # of equally many pixels, by brightness


class Footprint:
    """Where the pixels of a view are; views of one camera that show the same share it."""

    def __init__(self, pixels: Int[np.ndarray, " n"], width: int):
        """Find the cell of each pixel, in ascending order, and which pixels have four neighbours."""
        row = pixels // width
        column = pixels - row * width
        row, column = row - row.min() + 1, column - column.min() + 1
        self.shape = int(row.max()) + 2, int(column.max()) + 2
        of_row, of_column = (np.arange(-1, size - 1) * CELLS // (size - 2) for size in self.shape)
        self.cell = (of_row * CELLS)[row] + of_column[column]
        self.at = row * self.shape[1] + column
        self.first = np.searchsorted(row, np.arange(self.shape[0] + 1, dtype=row.dtype))  # pixel of each row
        inside = self.rows_of(np.ones(len(pixels), bool), 0, self.shape[0])
        self.middle = inside[2:, 1:-1] & inside[:-2, 1:-1] & inside[1:-1, 2:] & inside[1:-1, :-2]

    def pixels_of(self, first: int, last: int) -> slice:
        """Return the pixels of the rows from `first` up to, not including, `last`; row 0 is above the first pixel."""
        return slice(self.first[first], self.first[last])

    def rows_of(self, of: Shaped[np.ndarray, " n"], first: int, last: int) -> Shaped[np.ndarray, "h w"]:
        """Return some rows of a picture of the pixels, with a border on each side; 0 or false beside the object."""
        part, width = self.pixels_of(first, last), self.shape[1]
        found = np.zeros((last - first) * width, of.dtype)
        found[self.at[part] - first * width] = of[part]
        return found.reshape(-1, width)


@dataclass(frozen=True, eq=False)
class Leftover:
    """What a fit leaves of one view: the whitened residuals, the channels added up, and the prediction's brightness."""

    view: int
    shown: Footprint
    residual: Float[np.ndarray, " n"]
    light: Float[np.ndarray, " n"]


Sums = tuple[Float[np.ndarray, " cells"], Float[np.ndarray, " cells"]]  # of residuals over cells, and of their squares


def leftovers(laid: LaidOut, theta: Float[np.ndarray, " p"]) -> list[Leftover]:
    """Return what is left of each view, at these numbers; clipped samples count as met."""
    at, views = jnp.asarray(theta), laid.problem.data.views
    done = on_all_cores(lambda chunk: _residuals(at, laid.model, chunk), laid.chunks)
    found: list[list[tuple[np.ndarray, ...]]] = [[] for _ in views]
    for of_chunk, parts in zip(done, in_chunks(laid.parts), strict=True):
        residual, light = (np.asarray(of) for of in of_chunk)
        for b, (view, _, pixels) in enumerate(parts):
            found[view].append((pixels, residual[b, : len(pixels)], light[b, : len(pixels)]))
    shown: dict[tuple[int, ...], Footprint] = {}
    left = []
    for i, (view, parts) in enumerate(zip(views, found, strict=True)):
        pixels, residual, light = ([of[k] for of in parts if len(of[0])] for k in range(3))
        if pixels:
            key = (view.camera.shape[1], *map(id, pixels))
            if key not in shown:
                shown[key] = Footprint(np.concatenate(pixels), key[0])
            left.append(Leftover(i, shown[key], np.concatenate(residual), np.concatenate(light)))
    return left


@partial(jit_quickly, options=PLAINLY)
def _residuals(theta: Array, model: AbstractForwardModel, chunk: Block) -> tuple[Array, Array]:
    """Return sums over the channels of the whitened residuals, 0 where a sample is clipped, and of the predictions."""

    def of_block(block: Block) -> tuple[Array, Array]:
        m, seen, weight = jnp.stack(model.predict(theta, block)), block.observed, model.sample_weights(block)
        terms = model.likelihood.terms(m, seen.target, weight, seen.clipped)
        residual = terms.slope / jnp.sqrt(jnp.where(terms.curvature > 0, terms.curvature, 1.0))
        return residual.sum(0), jnp.where(weight > 0, m, 0.0).sum(0)

    return jax.lax.map(of_block, chunk)


class Whiteness(NamedTuple):
    """Whether residuals are noise."""

    p_value: float
    """The probability of noise to look as little like noise in any of the tests, at most 1."""
    correlation: float
    """The variance of sums over the cells of the size where it is largest, over that of independent residuals."""
    squares: Mapping[int, float]
    """The mean square of the residuals of each view that has some."""


def whiteness(views: Sequence[Leftover]) -> Whiteness:
    """Test whether what is left of the views is noise."""
    views = [view for view in views if len(view.residual) > 1 and view.residual.any()]
    if not views:
        return Whiteness(1.0, 1.0, {})
    *sums, of_variance = zip(*map(_all_sums, views), strict=True)
    found = [p for of in sums for p in _p_values(of)]
    found.append(min(_p_of_variance(of) for of in of_variance) * len(views))
    over_cells = [sum(np.sum(S**2) for S, _ in of) / sum(np.sum(Q) for _, Q in of) for of in sums[:SIZES]]
    squares = {view.view: float(np.mean(view.residual**2)) for view in views}
    return Whiteness(min(1.0, min(found) * len(found)), max(1.0, *map(float, over_cells)), squares)


def _all_sums(view: Leftover) -> list[Sums]:
    """Return the sums of one view over cells of three sizes, by brightness, and with what the picture looks like.

    The last are the sums of the squares by brightness, less their mean, and of the squares of these.
    """
    z, light, at = view.residual, view.light, view.shown
    some = light[:: max(len(light) // 1024, 1)]
    edges = np.quantile(some, np.arange(1, BINS) / BINS)

    def of_band(first: int) -> list[np.ndarray]:
        last = min(first + rows, at.shape[0] - 2)
        part = at.pixels_of(first + 1, last + 1)
        residual, cell, bins = z[part], at.cell[part], np.searchsorted(edges, light[part])
        squares = residual * residual
        over_cells = [np.bincount(cell, of, CELLS**2) for of in (residual, squares)]
        over_bins = [np.bincount(bins, of, BINS) for of in (residual, squares)]
        looks = _looks(at.middle[first:last], at.rows_of(z, first, last + 2), at.rows_of(light, first, last + 2))
        return [*over_cells, *over_bins, np.bincount(bins, minlength=BINS), np.sum(squares**2, keepdims=True), looks]

    rows = max(MANY // at.shape[1], 1)  # what a band needs stays in a core's cache
    *fine, of_bins, squares, count, fourth, looks = total(on_all_cores(of_band, range(0, at.shape[0] - 2, rows)))
    found: list[Sums] = [_joined(fine, CELLS // side) for side in (CELLS >> k for k in range(SIZES))]
    found += [(of_bins, squares), *((of[:1], of[1:]) for of in looks)]
    mean = float(squares.sum()) / len(z)
    found.append((squares - count * mean, count * (fourth / len(z) - mean**2)))
    return found


def _looks(
    middle: Bool[np.ndarray, "h w"], residual: Float[np.ndarray, "h+2 w+2"], light: Float[np.ndarray, "h+2 w+2"]
) -> Float[np.ndarray, "looks 2"]:
    """Return sums of residuals times gradient, curvature and neighbours, and of the squares of these products.

    The pictures have one more pixel on each side.
    """
    own = residual[1:-1, 1:-1]
    inner = own * middle
    down, up, right, left = light[2:, 1:-1], light[:-2, 1:-1], light[1:-1, 2:], light[1:-1, :-2]
    curvature = down + up + right + left - 4.0 * light[1:-1, 1:-1]
    above, beside = own * residual[:-2, 1:-1], own * residual[1:-1, :-2]
    products = inner * (down - up), inner * (right - left), inner * curvature, above, beside
    *looks, (a, b), (c, d) = ((of.sum(), np.einsum("ij,ij", of, of)) for of in products)
    return np.array([*looks, (a + c, b + d)])


def _joined(fine: Sequence[np.ndarray], side: int) -> Sums:
    """Return sums over cells joined to larger ones of so many on a side."""
    a, b = (of.reshape(CELLS // side, side, CELLS // side, side).sum((1, 3)).ravel() for of in fine)
    return a, b


def _p_values(of_views: Sequence[Sums]) -> list[float]:
    """Return p-values of the cells of the view with the least, of all views' together, and of their sums over views."""
    S, Q = (np.array(of) for of in zip(*of_views, strict=True))
    chi2, freedom = np.sum(S**2 / np.where(Q > 0, Q, 1.0), -1), np.sum(Q > 0, -1)
    shared = Q.sum(0)
    of_sums = np.sum(S.sum(0) ** 2 / np.where(shared > 0, shared, 1.0))
    each = special.chdtrc(np.maximum(freedom, 1), chi2)
    return [
        float(each.min()) * len(S),
        float(special.chdtrc(freedom.sum(), chi2.sum())),
        float(special.chdtrc(max(np.sum(shared > 0), 1), of_sums)),
    ]


def _p_of_variance(of: Sums) -> float:
    """Return the p-value of the residuals' variance being the same at every brightness."""
    excess, expected = of
    chi2 = np.sum(excess**2 / np.maximum(expected, 1e-300))
    return float(special.chdtrc(max(int(np.sum(expected > 0)) - 1, 1), chi2))
