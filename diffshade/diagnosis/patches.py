"""Patches: squares of a view, wider than its correlation length, as clusters if there are too few views."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ..core.masks import Mask
from ..core.robust_scale import OUTLIER
from ..core.thresholds import FEW, SLIGHT
from ..inverse.data.samples import Samples
from ..inverse.data.view_sets import ViewSet
from ..inverse.forward.gram import ByView
from ..inverse.forward.sums import sum_over, waves
from ..inverse.laid_out import LaidOut
from ..inverse.pixels.blocks import Block, block_size, pieces
from ..inverse.problem import FitProblem
from ..inverse.result import Fit
from ..inverse.statistics.clusters import Clusters, compared, independent
from ..inverse.unknowns.unknown import coordinate_slopes
from .grams import gram_of
from .residual_correlation import neighbour_correlation

MAX_PATCHES = 64


@dataclass(frozen=True, eq=False)
class Parts:
    """The pixels that count, in parts (views or patches) that are held out or compared with each other."""

    samples: list[list[Samples]]
    """The samples of each view in each part."""
    words: str
    by_view: bool = False
    """Whether the parts are views."""

    def __len__(self) -> int:
        return len(self.samples)

    def lay_out(self, problem: FitProblem) -> list[list[Block]]:
        """Return the chunks of each part, weighed by the photographs."""
        of_views = [len(s.pixels) for part in self.samples for s in part if len(s.pixels)]
        size = min(problem.block_size, block_size(of_views))
        return [problem.lay_out(pieces(part, size), size) for part in self.samples]

    def weighed(self, laid: LaidOut) -> list[list[Block]]:
        """Return the chunks of each part, weighed where the problem was laid out."""
        return [laid.problem.reweigh(laid.theta, of) for of in self.lay_out(laid.problem)]


def find_clusters(fit: Fit) -> Clusters:
    """Return the views if there are three or more, else patches wider than the correlation length of the residuals."""
    if fit.evidence.count >= 3 and fit.evidence.deciding() is None:
        return fit.clusters
    patches = cut_in_patches(fit.solved.problem.data, patch_width(*residual_images(fit)))
    if len(patches) < FEW:
        return independent(fit.evidence, patches.words)
    laid = fit.solved.laid_out()
    chunks = patches.weighed(laid)
    slope = coordinate_slopes(fit.values, fit.unknowns)
    grams = [gram_of(laid.theta, laid.model, of) for of in chunks]
    every = np.ones(len(slope), bool)
    clusters = ByView.of([next(of.parts(every)) for of in grams], np.zeros(len(grams)), len(slope))
    evidence = dataclasses.replace(fit.evidence, clusters=clusters.scaled(slope))
    if fit.evidence.waves is not None:
        theta = jnp.asarray(laid.theta)
        of_patches = np.array([sum_over(of, waves, theta, laid.model).sum(0) for of in chunks])
        evidence = dataclasses.replace(evidence, waves=of_patches * slope[:, None])
    if evidence.deciding() is not None:
        return independent(fit.evidence, f"{len(patches)} patches, one of which decides,")
    return compared(evidence, len(patches), patches.words)


def residual_images(fit: Fit) -> tuple[list[Float[np.ndarray, "h w"]], list[Bool[np.ndarray, "h w"]]]:
    """Return for each view the residuals, summed over the channels, and the pixels that count.

    A residual that rounding to float32 alone could make is 0: a render without noise leaves such, which are alike over
    wide areas and say nothing of the model.
    """
    predictions = [fit.predict(view) for view in fit.views]
    rounding = float(np.finfo(np.float32).eps)
    differences = [np.where(np.abs(p.difference) > rounding * np.abs(p.image), p.difference, 0.0) for p in predictions]
    return [d.sum(-1) for d in differences], [np.all(p.counts, -1) for p in predictions]


def correlation_length(
    differences: Sequence[Float[np.ndarray, "h w"]], counts: Sequence[Bool[np.ndarray, "h w"]]
) -> int:
    """Return the correlation length of the residuals in pixels; 0 if neighbours are not correlated.

    It is the lag along rows and columns at which the correlation has fallen to 1/e of that of neighbours. White noise
    on top of a smooth error lowers both by the same factor.
    """
    residuals = [d[..., None] for d in differences]
    first, errors = neighbour_correlation(residuals, counts)
    if first < SLIGHT or not errors > OUTLIER:
        return 0
    longest = min(min(d.shape) for d in differences) - 1
    lags = range(2, longest)
    shares = (neighbour_correlation(residuals, counts, lag)[0] for lag in lags)
    return next((lag for lag, share in zip(lags, shares, strict=True) if share < first / np.e), longest)


def patch_width(differences: Sequence[np.ndarray], counts: Sequence[np.ndarray]) -> int:
    """Return the width of patches: at least twice the correlation length, and at most 64 patches."""
    pixels = sum(int(c.sum()) for c in counts)
    return max(2 * correlation_length(differences, counts) + 1, int(np.ceil(np.sqrt(pixels / MAX_PATCHES))))


def cut_in_patches(data: ViewSet, width: int) -> Parts:
    """Cut the pixels into squares of a grid.

    Views with the same camera and lights share their patches, since they share the errors there.
    """
    parts = []
    for group in data.setups:
        row, column = np.indices(data.views[group[0]].camera.shape)
        square = row // width * column.shape[1] + column // width
        shown = np.concatenate([square.flat[data.samples[view].pixels] for view in group])
        parts += [keep_only(data, group, square == number) for number in np.unique(shown)]
    return Parts(parts, f"{len(parts)} patches of {width} x {width} pixels")


def keep_only(data: ViewSet, group: Sequence[int], mask: Mask | None = None) -> list[Samples]:
    """Return the samples of some views that a mask keeps, and none of other views."""

    def part(view: int, s: Samples) -> Samples:
        if view not in group:
            return s.at(s.pixels[:0])
        return s if mask is None else s.at(s.pixels[mask.reshape(-1)[s.pixels]])

    return [part(view, s) for view, s in enumerate(data.samples)]
