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

Texels = Float[np.ndarray, "n c"]


class ResidualQuantiles(NamedTuple):
    """Quantiles of residuals: each texel has a scale, and each brightness relative to the texel's median a shape."""

    scale: Texels
    median: Texels
    """Of the photographs."""
    tails: Float[np.ndarray, "bins 2"]
    """The lower and the upper quantile of residual / scale in each bin of prediction / median."""
    floor: float
    """The smallest sample of the photographs, below which no band reaches."""

    def band(self, predicted: Texels) -> tuple[Texels, Texels]:
        """Return the lower and the upper end of the band of each sample that is predicted."""
        low, high = np.moveaxis(self.tails[_brightness(predicted, self.median)], -1, 0)
        return tuple(np.maximum(predicted + self.scale * tail, self.floor) for tail in (low, high))


def residual_quantiles(
    seen: Float[np.ndarray, "views n c"], predicted: Float[np.ndarray, "views n c"], level: float | int
) -> ResidualQuantiles:
    """Return the quantiles between which a share of the residuals lies, in every bin of brightness.

    Args:
        seen: Samples of the photographs, NaN where one does not count.
        predicted: What fits that left each photograph out say of them.
        level: The share, from 0 to 1; as many lie below the lower quantile as above the upper one.
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
    ends = ((1.0 - level) / 2.0, (1.0 + level) / 2.0)
    tails = np.array([np.quantile(part if len(part) >= FEWEST else scaled, ends) for part in parts])
    return ResidualQuantiles(scale, median, tails, float(np.nanmin(seen)))


def _brightness(predicted: Float[np.ndarray, "... n c"], median: Texels) -> Int[np.ndarray, "... n c"]:
    """Return the bin of each prediction, by how many medians of its texel it is."""
    return np.digitize(predicted / np.maximum(median, np.finfo(np.float32).tiny), BRIGHTNESS)
