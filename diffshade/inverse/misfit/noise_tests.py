"""Noise tests: whether what a fit leaves of its photographs is noise, for a few additions a pixel.

The residuals of a right description are independent, so that their sums over any cells have a variance that is the sum
of their squares (White 1980). Where the sums over parts of the picture or of the range of brightness, or the products
with neighbours and with the picture's own gradient and curvature, are larger, the description is wrong somewhere. The
numbers that were fitted take a part of each sum away, so that these tests err on the side of noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy import special

from ...core.backend import PLAINLY, jit_quickly
from ...core.fields import Array
from ...parallel.threads import on_all_cores
from ..data.views import channels
from ..forward.interface import AbstractForwardModel
from ..laid_out import LaidOut
from ..pixels.blocks import Block
from ..pixels.blocks import chunks as in_chunks

FALSE_ALARM = 1e-4  # the significance level of all these tests together, and of each test of a fault
CERTAIN_ERRORS = 3.9  # standard errors of a normal number at that level
CELLS = 16  # cells along each side of the object; they are joined to 8 and to 4
BINS = 16  # of equally many pixels, by brightness


@dataclass(frozen=True, eq=False)
class Leftover:
    """What a fit leaves of one view: the whitened residuals, the channels added up, and the prediction's brightness."""

    row: Int[np.ndarray, " n"]
    column: Int[np.ndarray, " n"]
    residual: Float[np.ndarray, " n"]
    light: Float[np.ndarray, " n"]


Sums = tuple[Float[np.ndarray, " cells"], Float[np.ndarray, " cells"]]  # of residuals over cells, and of their squares


def leftovers(laid: LaidOut, theta: Float[np.ndarray, " p"]) -> list[Leftover]:
    """Return what is left of each view, at these numbers; clipped samples count as met."""
    at = jnp.asarray(theta)
    done = on_all_cores(lambda chunk: _residuals(at, laid.model, chunk), laid.chunks)
    views = laid.problem.data.views
    found: list[list[list[np.ndarray]]] = [[] for _ in views]
    for of_chunk, parts in zip(done, in_chunks(laid.parts), strict=True):
        residual, light = (np.asarray(of) for of in of_chunk)
        for b, (view, _, pixels) in enumerate(parts):
            c, n = channels(views[view]), len(pixels)
            found[view].append([pixels, residual[b, :c, :n].sum(0), light[b, :c, :n].sum(0)])
    joined = [[np.concatenate(of) for of in zip(*parts, strict=True)] for parts in found if parts]
    widths = [view.camera.shape[1] for view, parts in zip(views, found, strict=True) if parts]
    return [Leftover(p // w, p % w, residual, light) for (p, residual, light), w in zip(joined, widths, strict=True)]


@partial(jit_quickly, options=PLAINLY)
def _residuals(theta: Array, model: AbstractForwardModel, chunk: Block) -> tuple[Array, Array]:
    """Return the whitened residuals of a chunk, 0 where a sample is clipped, and the predictions."""

    def of_block(block: Block) -> tuple[Array, Array]:
        m, seen = jnp.stack(model.predict(theta, block)), block.observed
        terms = model.likelihood.terms(m, seen.target, model.measured_weights(block), seen.clipped)
        return terms.slope / jnp.sqrt(jnp.where(terms.curvature > 0, terms.curvature, 1.0)), m

    return jax.lax.map(of_block, chunk)


def p_value(views: Sequence[Leftover]) -> float:
    """Return the probability of noise to look as little like noise in any of the tests, at most 1."""
    views = [view for view in views if len(view.residual) > 1 and view.residual.any()]
    if not views:
        return 1.0
    found = [p for of in zip(*map(_all_sums, views), strict=True) for p in _p_values(of)]
    found.append(min(_p_of_variance(view) for view in views) * len(views))
    return min(1.0, min(found) * len(found))


def _all_sums(view: Leftover) -> list[Sums]:
    """Return the sums of one view over cells of three sizes, by brightness, and with what the picture looks like."""
    z = view.residual
    cell = _cell(view.row) * CELLS + _cell(view.column)
    fine = [np.bincount(cell, of, CELLS**2) for of in (z, z**2)]
    found: list[Sums] = [_joined(fine, CELLS // side) for side in (CELLS, CELLS // 2, CELLS // 4)]
    bins = _bins(view)
    found.append((np.bincount(bins, z, BINS), np.bincount(bins, z**2, BINS)))
    shape = int(view.row.max()) + 1, int(view.column.max()) + 1
    residual, light, inside = np.zeros(shape), np.zeros(shape), np.zeros(shape, bool)
    residual[view.row, view.column], light[view.row, view.column], inside[view.row, view.column] = z, view.light, True
    inner = inside[1:-1, 1:-1] & inside[2:, 1:-1] & inside[:-2, 1:-1] & inside[1:-1, 2:] & inside[1:-1, :-2]
    down, up, right, left = light[2:, 1:-1], light[:-2, 1:-1], light[1:-1, 2:], light[1:-1, :-2]
    for looks in (down - up, right - left, down + up + right + left - 4.0 * light[1:-1, 1:-1]):
        found.append(_sum(residual[1:-1, 1:-1][inner] * looks[inner]))
    beside = residual[:, 1:] * residual[:, :-1], residual[1:] * residual[:-1]
    found.append(_sum(np.concatenate([of.ravel() for of in beside])))
    return found


def _sum(products: Float[np.ndarray, " n"]) -> Sums:
    return products.sum(keepdims=True), np.sum(products**2, keepdims=True)


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


def _p_of_variance(view: Leftover) -> float:
    """Return the p-value of the residuals' variance being the same at every brightness."""
    squares, bins = view.residual**2, _bins(view)
    n, mean, scatter = np.bincount(bins, minlength=BINS), squares.mean(), squares.var()
    excess = np.bincount(bins, squares, BINS) - n * mean
    chi2 = np.sum(excess**2 / np.maximum(n * scatter, 1e-300))
    return float(special.chdtrc(max(int(np.sum(n > 0)) - 1, 1), chi2))
