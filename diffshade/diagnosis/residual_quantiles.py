"""Residual quantiles: how far photographs lie from the predictions of fits that left them out, and where how far."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

BRIGHTNESS = (0.3, 0.8, 1.5, 2.2, 3.0, 5.0)  # of a prediction, in medians of its texel: the bounds between bins
SPREAD = 0.8  # which quantile of a texel's absolute residuals scales them
SHARED = 0.25  # share of the median texel's that is added to it, since a texel has few photographs
FEWEST = 100  # residuals of a bin that has quantiles of its own

QUANTILES = 64  # of the residuals in a bin
AT_ONCE = 1 << 24  # sums in memory

Texels = Float[np.ndarray, "n c"]


class ResidualQuantiles(NamedTuple):
    """Quantiles of residuals: each texel has a scale, and each brightness relative to the texel's median a shape."""

    scale: Texels
    median: Texels
    """Of the photographs."""
    table: Float[np.ndarray, "bins quantiles"]
    """Quantiles of residual / scale in each bin of prediction / median."""
    floor: float
    """The smallest sample of the photographs, below which no band reaches."""

    def band(self, predicted: Float[np.ndarray, "groups n c"], level: float | int) -> tuple[Texels, Texels]:
        """Return the lower and the upper end of the band of each sample.

        As many of the sums of a prediction and a quantile lie below the band as above it.

        Args:
            predicted: What each fit that left a group out says of the samples.
            level: Share of the sums in the band, from 0 to 1.
        """
        bins = _brightness(predicted.mean(0), self.median).reshape(-1)
        scale, flat = self.scale.reshape(-1), predicted.reshape(len(predicted), -1)
        count = len(predicted) * QUANTILES
        ranks = [rank := int((1.0 - level) / 2.0 * count), count - 1 - rank]
        ends = np.empty((len(scale), 2))
        for at in range(0, len(scale), step := max(1, AT_ONCE // count)):
            some = slice(at, at + step)
            sums = flat[:, some].T[..., None] + (scale[some, None] * self.table[bins[some]])[:, None]
            ends[some] = np.partition(sums.reshape(-1, count), ranks, axis=1)[:, ranks]
        lower, upper = np.maximum(ends, self.floor).T
        return lower.reshape(self.scale.shape), upper.reshape(self.scale.shape)


def residual_quantiles(
    seen: Float[np.ndarray, "views n c"], predicted: Float[np.ndarray, "views n c"]
) -> ResidualQuantiles:
    """Return the quantiles of the residuals in every bin of brightness.

    Args:
        seen: Samples of the photographs, NaN where one does not count.
        predicted: What fits that left each photograph out say of them.
    """
    residual = seen - predicted
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a sample that no photograph shows is NaN
        median = np.nanmedian(seen, 0)
        spread = np.nanquantile(np.abs(residual), SPREAD, axis=0)
    spread = np.where(np.isfinite(spread), spread, np.nanmedian(spread))
    scale = spread + SHARED * np.median(spread)
    counts = np.isfinite(residual)
    scaled = (residual / np.where(scale > 0.0, scale, 1.0))[counts]
    bins = _brightness(predicted, median)[counts]
    parts = [scaled[bins == b] for b in range(len(BRIGHTNESS) + 1)]
    levels = (np.arange(QUANTILES) + 0.5) / QUANTILES
    table = np.array([np.quantile(part if len(part) >= FEWEST else scaled, levels) for part in parts])
    return ResidualQuantiles(scale, median, table, float(np.nanmin(seen)))


def _brightness(predicted: Float[np.ndarray, "... n c"], median: Texels) -> Int[np.ndarray, "... n c"]:
    """Return the bin of each prediction, by how many medians of its texel it is."""
    return np.digitize(predicted / np.maximum(median, np.finfo(np.float32).tiny), BRIGHTNESS)
