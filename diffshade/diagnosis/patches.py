"""Patches: squares of a view, wider than its correlation length, as clusters if there are too few views."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.fields import Array
from ..inverse.data.samples import Samples
from ..inverse.forward.gram import Gram
from ..inverse.forward.interface import AbstractForwardModel
from ..inverse.forward.sums import waves
from ..inverse.pixels.blocks import Block, Piece
from ..inverse.result import Fit
from ..inverse.statistics.clusters import Clusters, compared, independent
from ..inverse.unknowns.unknown import coordinate_slopes
from ..parallel.threads import on_all_cores

FEWEST = 6  # patches that a jackknife needs
MOST = 64


def find_clusters(fit: Fit) -> Clusters:
    """Return the views if there are three or more, else patches wider than the correlation length of the residuals."""
    if len(fit.evidence.hessian) >= 3 and fit.evidence.deciding() is None:
        return fit.clusters
    differences, counts = residual_images(fit)
    width = patch_width(differences, counts)
    laid = fit.solved.laid_out()
    parts, patch = cut_in_patches(fit, laid.problem.data.samples, width)
    count = len(set(patch))
    if count < FEWEST:
        return independent(fit.evidence, f"{count} patches of {width} x {width} pixels")
    size = max(64, 1 << int(np.ceil(np.log2(max(len(part.pixels) for part in parts)))))
    laid_out = laid.lay_out(parts, size)
    theta = jnp.asarray(laid.theta)
    grams = on_all_cores(lambda chunk: _gram_of_each_block(theta, laid.model, chunk), laid_out)

    def by_patch(found: Sequence[Array]) -> Float[np.ndarray, "patches ..."]:
        blocks = np.concatenate([np.asarray(one) for one in found])[: len(parts)]
        return np.array([blocks[patch == k].sum(0) for k in range(count)])

    H, g = (by_patch([getattr(gram, name) for gram in grams]) for name in ("hessian", "gradient"))
    slope = coordinate_slopes(fit.values, fit.unknowns)
    H, g = H * np.outer(slope, slope), g * slope
    evidence = dataclasses.replace(fit.evidence, hessian=H, gradient=g, shown=None)
    if fit.evidence.waves is not None:
        waves = on_all_cores(lambda chunk: _waves_of_each_block(theta, laid.model, chunk), laid_out)
        evidence = dataclasses.replace(evidence, waves=by_patch(waves) * slope[:, None])
    if evidence.deciding() is not None:
        return independent(fit.evidence, f"{count} patches, one of which decides,")
    return compared(evidence, count, f"{count} patches of {width} x {width} pixels")


@jax.jit
def _gram_of_each_block(theta: Array, model: AbstractForwardModel, chunk: Block) -> Gram:
    def of_block(block: Block) -> Gram:
        one = jax.tree.map(lambda leaf: leaf[None], block)
        return model.gram(theta, model.summary(theta, one)).total(len(theta))

    return jax.lax.map(of_block, chunk)


@jax.jit
def _waves_of_each_block(theta: Array, model: AbstractForwardModel, chunk: Block) -> Array:
    def of_block(block: Block) -> Array:
        return waves(theta, model, jax.tree.map(lambda leaf: leaf[None], block)).sum(0)

    return jax.lax.map(of_block, chunk)


def residual_images(fit: Fit) -> tuple[list[Float[np.ndarray, "h w"]], list[Bool[np.ndarray, "h w"]]]:
    """Return for each view the residuals, summed over the channels, and the pixels that count."""
    predictions = [fit.predict(view) for view in fit.views]
    return [p.difference.sum(-1) for p in predictions], [np.all(p.counts, -1) for p in predictions]


def correlation_length(
    differences: Sequence[Float[np.ndarray, "h w"]], counts: Sequence[Bool[np.ndarray, "h w"]]
) -> int:
    """Return the correlation length of the residuals in pixels; 0 if neighbours are not correlated.

    It is the lag along rows and columns at which the correlation has fallen to 1/e of that of neighbours. White noise
    on top of a smooth error lowers both by the same factor.
    """

    def correlation(lag: int) -> tuple[float, int]:
        products, pairs, power = 0.0, 0, 0.0
        for d, c in zip(differences, counts, strict=True):
            for a, b, both in (
                (d[lag:], d[:-lag], c[lag:] & c[:-lag]),
                (d[:, lag:], d[:, :-lag], c[:, lag:] & c[:, :-lag]),
            ):
                products += float(np.sum((a * b)[both]))
                pairs += int(both.sum())
                power += 0.5 * float(np.sum((a**2 + b**2)[both]))
        return products / max(power, 1e-300), pairs

    first, pairs = correlation(1)
    if not pairs or first < max(0.02, 3.0 / np.sqrt(pairs)):
        return 0
    longest = min(min(d.shape) for d in differences) - 1
    return next((lag for lag in range(2, longest) if correlation(lag)[0] < first / np.e), longest)


def patch_width(differences: Sequence[np.ndarray], counts: Sequence[np.ndarray]) -> int:
    """Return the width of patches: at least twice the correlation length, and at most 64 patches."""
    pixels = sum(int(c.sum()) for c in counts)
    return max(2 * correlation_length(differences, counts) + 1, int(np.ceil(np.sqrt(pixels / MOST))))


def cut_in_patches(fit: Fit, samples: Sequence[Samples], width: int) -> tuple[list[Piece], Int[np.ndarray, " n"]]:
    """Cut the pixels into squares of a grid, and return the patch of each square.

    Views with the same camera and lights share their patches, since they share the errors there.
    """
    setup = {view: k for k, group in enumerate(fit.solved.problem.data.setups) for view in group}
    parts, keys = [], []
    for view, of_view in enumerate(samples):
        row, column = np.divmod(of_view.pixels, of_view.inside.shape[1])
        square = (row // width) * of_view.inside.shape[1] + column // width
        for number in np.unique(square):
            parts.append(Piece(view, of_view, of_view.pixels[square == number]))
            keys.append((setup[view], int(number)))
    order = {key: k for k, key in enumerate(dict.fromkeys(keys))}
    return parts, np.array([order[key] for key in keys], int)
