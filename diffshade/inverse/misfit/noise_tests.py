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
from jaxtyping import Float, Int
from scipy import special

from ...core.backend import PLAINLY, jit_quickly
from ...core.fields import Array
from ...parallel.threads import on_all_cores
from ..forward.interface import AbstractForwardModel
from ..laid_out import LaidOut
from ..pixels.blocks import Block
from ..pixels.blocks import chunks as in_chunks

FALSE_ALARM = 1e-4  # the significance level of all these tests together, and of each test of a fault
CELLS, SIZES = 16, 3  # cells along each side of the object, which are joined to 8 and to 4
BINS = CELLS  # of equally many pixels, by brightness


class Footprint:
    """Where the pixels of a view are; views of one camera that show the same share it."""

    def __init__(self, pixels: Int[np.ndarray, " n"], width: int):
        """Find the cell of each pixel, and which pixels have four neighbours."""
        row, column = pixels // width, pixels % width
        self.cell = _cell(row) * CELLS + _cell(column)
        row, column = row - row.min(), column - column.min()
        self.shape = int(row.max()) + 1, int(column.max()) + 1
        self.at = row * self.shape[1] + column
        inside = np.zeros(self.shape, bool)
        inside.flat[self.at] = True
        middle = inside[1:-1, 1:-1] & inside[2:, 1:-1] & inside[:-2, 1:-1] & inside[1:-1, 2:] & inside[1:-1, :-2]
        self.inner = np.flatnonzero(np.pad(middle, 1)) if middle.size else np.zeros(0, int)

    def image(self, of: Float[np.ndarray, " n"]) -> Float[np.ndarray, " _"]:
        """Return a picture of the pixels, 0 elsewhere, flattened."""
        found = np.zeros(self.shape[0] * self.shape[1])
        found[self.at] = of
        return found


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
    (at, model), views = laid.problem.filled(theta), laid.problem.data.views
    done = on_all_cores(lambda chunk: _residuals(jnp.asarray(at), model, chunk), laid.chunks)
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
    z, at = view.residual, view.shown
    squares, bins = z**2, _bins(view)
    fine = [np.bincount(at.cell, of, CELLS**2) for of in (z, squares)]
    found: list[Sums] = [_joined(fine, CELLS // side) for side in (CELLS >> k for k in range(SIZES))]
    of_bins = [np.bincount(bins, of, BINS) for of in (z, squares)]
    found.append((of_bins[0], of_bins[1]))
    residual, light, width, inner = at.image(z), at.image(view.light), at.shape[1], at.inner
    here, down, up, right, left = (light[inner + step] for step in (0, width, -width, 1, -1))
    own, vertical, horizontal = residual[inner], down + up, right + left
    for looks in (down - up, right - left, vertical + horizontal - 4.0 * here):
        found.append(_sum(own * looks))
    beside = residual[1:] * residual[:-1], residual[width:] * residual[:-width]  # 0 beside the object
    (a, b), (c, d) = map(_sum, beside)
    found.append((a + c, b + d))
    count, mean = np.bincount(bins, minlength=BINS), float(squares.mean())
    found.append((of_bins[1] - count * mean, count * (float(squares @ squares) / len(z) - mean**2)))
    return found


def _sum(products: Float[np.ndarray, " n"]) -> Sums:
    return products.sum(keepdims=True), np.array([products @ products])


def _cell(index: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Return which of `CELLS` equal parts of its range each index is in."""
    first = int(index.min())
    return (index - first) * CELLS // (int(index.max()) + 1 - first)


def _joined(fine: Sequence[np.ndarray], side: int) -> Sums:
    """Return sums over cells joined to larger ones of so many on a side."""
    a, b = (of.reshape(CELLS // side, side, CELLS // side, side).sum((1, 3)).ravel() for of in fine)
    return a, b


def _bins(view: Leftover) -> Int[np.ndarray, " n"]:
    """Return the bin of each pixel by its brightness."""
    some = view.light[:: max(len(view.light) // 1024, 1)]
    return np.searchsorted(np.quantile(some, np.arange(1, BINS) / BINS), view.light)


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
