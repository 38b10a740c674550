"""Residual quantiles: how far photographs lie from the predictions of fits that left them out, and where how far."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import stats

BRIGHTNESS = (0.3, 0.8, 1.5, 2.2, 3.0, 5.0)  # of a prediction, in medians of its texel: the bounds between bins
SCALE_QUANTILE = 0.8  # which quantile of a texel's absolute residuals scales them
SHARED_SCALE = 0.25  # share of the median texel's that is added to it, since a texel has few photographs
MIN_SAMPLES = 100  # residuals of a bin that has quantiles of its own, and of a photograph that tells how its own grow
DISAGREEMENT = 0.4  # how much of the fits' differences from their median counts: residuals of such fits hold them once

QUANTILES = 64  # of the residuals in a bin
LEVELS = (2 * np.arange(QUANTILES) + 1) / (2 * QUANTILES)
MAX_SUMS = 1 << 24  # sums in memory

Texels = Float[np.ndarray, "n c"]
Numbers = Float[np.ndarray, " residuals"]


class ResidualQuantiles(NamedTuple):
    """Quantiles of residuals.

    Each texel has a scale, and each brightness relative to the texel's median has a shape, and a power of the distance
    from a light to those that were fitted with which it grows: that of highlights may be another than that of shadows.
    """

    scale: Texels
    median: Texels
    """Of the photographs."""
    tables: Float[np.ndarray, "residuals bins quantiles"]
    """Quantiles of residual / scale in each bin of prediction / median, for each photograph left out of each fit."""
    counts: Float[np.ndarray, "residuals bins"]
    """Samples of each."""
    photograph: Int[np.ndarray, " residuals"]
    """Which photograph each is of: one may be left out of several fits."""
    distance: Numbers
    """From the light of each to those of the fit, degrees."""
    growth: Float[np.ndarray, " bins"]
    """The power in each bin."""
    floor: float
    """The smallest sample of the photographs, below which no band reaches."""
    ceiling: float
    """The largest one."""

    def band(
        self, predicted: Float[np.ndarray, "groups n c"], level: float | int, distance: float
    ) -> tuple[Texels, Texels]:
        """Return the lower and the upper end of the band of each sample.

        As many of the sums of a prediction and a quantile lie below the band as above it, where the predictions are
        drawn towards their median. A fit that leaves the photographs' range without most others, since a few
        photographs mislead it, counts as if it said the end of that range.

        Args:
            predicted: What each fit that left a group out says of the samples.
            level: Share of the sums in the band, from 0 to 1.
            distance: From the light of the samples to those of the fits, degrees.
        """
        ordered = np.sort(predicted, axis=0)
        below, above = ordered[(len(ordered) - 1) // 2], ordered[len(ordered) // 2]  # of two, one may run away
        predicted = np.clip(predicted, np.minimum(self.floor, above), np.maximum(self.ceiling, below))
        middle = np.median(predicted, axis=0)
        predicted = middle + DISAGREEMENT * (predicted - middle)
        table = self._at(distance, level)
        bins = _brightness(middle, self.median).reshape(-1)
        scale, flat = self.scale.reshape(-1), predicted.reshape(len(predicted), -1)
        count = len(predicted) * QUANTILES
        ranks = [rank := int((1.0 - level) / 2.0 * count), count - 1 - rank]
        ends = np.empty((len(scale), 2))
        for at in range(0, len(scale), step := max(1, MAX_SUMS // count)):
            some = slice(at, at + step)
            sums = flat[:, some].T[..., None] + (scale[some, None] * table[bins[some]])[:, None]
            ends[some] = np.partition(sums.reshape(-1, count), ranks, axis=1)[:, ranks]
        lower, upper = np.maximum(ends, self.floor).T
        return lower.reshape(self.scale.shape), upper.reshape(self.scale.shape)

    def _at(self, distance: float, level: float | int) -> Float[np.ndarray, "bins quantiles"]:
        """Return the quantiles of each bin at a distance.

        They are as much wider about their median as Student's t is than the normal distribution, for as many
        photographs as the bin has: the samples of one photograph share an error.
        """
        grown = self.tables * ((distance / self.distance)[:, None] ** self.growth)[..., None]
        found = []
        for b in range(self.counts.shape[1]):
            of = slice(b, b + 1) if self.counts[:, b].sum() >= MIN_SAMPLES else slice(None)
            values, weights = np.broadcast_arrays(grown[:, of], self.counts[:, of, None])
            quantiles = np.quantile(values.ravel(), LEVELS, weights=weights.ravel(), method="inverted_cdf")
            of_photograph = np.bincount(self.photograph, self.counts[:, of].sum(1))
            alike = of_photograph.sum() ** 2 / (of_photograph**2).sum()
            end = (1.0 + level) / 2.0
            wider = stats.t.ppf(end, max(alike - 1.0, 1.0)) / stats.norm.ppf(end)
            middle = np.median(quantiles)
            found.append(middle + wider * (quantiles - middle))
        return np.array(found)


def residual_quantiles(
    seen: Float[np.ndarray, "residuals n c"],
    predicted: Float[np.ndarray, "residuals n c"],
    photograph: Int[np.ndarray, " residuals"],
    distance: Numbers,
) -> ResidualQuantiles:
    """Return the quantiles of the residuals in every bin of brightness.

    Args:
        seen: Samples of the photographs, NaN where one does not count.
        predicted: What fits that left each photograph out say of them.
        photograph: Which photograph each is, one that several fits left out more than once.
        distance: From its light to those of the fit, degrees.
    """
    floor, ceiling = float(np.nanmin(seen)), float(np.nanmax(seen))
    predicted = np.clip(predicted, floor, ceiling)
    residual = seen - predicted
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a sample that no photograph shows is NaN
        median = np.nanmedian(seen, 0)
        spread = np.nanquantile(np.abs(residual), SCALE_QUANTILE, axis=0)
    spread = np.where(np.isfinite(spread), spread, np.nanmedian(spread))
    scale = spread + SHARED_SCALE * np.median(spread)
    scaled = residual / np.where(scale > 0.0, scale, 1.0)
    bins = _brightness(predicted, median)
    tables = np.zeros((len(seen), len(BRIGHTNESS) + 1, QUANTILES))
    counts, sizes = np.zeros((2, *tables.shape[:2]))
    for k, (of, where) in enumerate(zip(scaled, bins, strict=True)):
        for b in range(counts.shape[1]):
            part = of[np.isfinite(of) & (where == b)]
            counts[k, b] = len(part)
            if len(part):
                tables[k, b] = np.quantile(part, LEVELS)
                sizes[k, b] = np.abs(part).mean()
    every = counts.sum(1)
    shared = _growth((sizes * counts).sum(1) / np.maximum(every, 1.0), every, photograph, distance, least=1)
    own = [_growth(sizes[:, b], counts[:, b], photograph, distance, least=MIN_SAMPLES) for b in range(counts.shape[1])]
    growth = np.array([power if power is not None else shared or 0.0 for power in own])
    return ResidualQuantiles(scale, median, tables, counts, photograph, distance, growth, floor, ceiling)


def _growth(
    size: Numbers, counts: Numbers, photograph: Int[np.ndarray, " residuals"], distance: Numbers, *, least: int
) -> float | None:
    """Return the power of the distance with which residuals of one photograph grow, by least squares; None if unknown.

    It is from 0 to 1: a shadow's edge moves in proportion to the light. Photographs with fewer samples than `least`
    do not count.
    """
    number = np.bincount(photograph)
    fewest = np.full(len(number), np.inf)
    np.minimum.at(fewest, photograph, np.where(size > 0.0, counts, 0.0))
    weight = np.where(fewest >= least, fewest, 0.0)[photograph]
    x, y = np.log(distance), np.log(np.where(size > 0.0, size, 1.0))
    x, y = (z - (np.bincount(photograph, z) / np.maximum(number, 1))[photograph] for z in (x, y))  # from their mean
    spread = (weight * x) @ x
    return float(np.clip((weight * x) @ y / spread, 0.0, 1.0)) if spread > 1e-9 else None


def _brightness(predicted: Float[np.ndarray, "... n c"], median: Texels) -> Int[np.ndarray, "... n c"]:
    """Return the bin of each prediction, by how many medians of its texel it is."""
    return np.digitize(predicted / np.maximum(median, np.finfo(np.float32).tiny), BRIGHTNESS)
