"""Residual correlation: whether neighbouring residuals are correlated, as with model error, and how strongly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...core.masks import Mask
from ..forward.losses import LOSSES
from ..result import Fit
from ..statistics.clusters import Clusters
from .noise_tests import CERTAIN_ERRORS

CELL_SIDES = (2, 4, 8, 16)  # pixels: the sides of the cells over which residuals are summed
MIN_CELLS = 40  # cells

Residuals = Float[np.ndarray, "h w c"]


@dataclass(frozen=True, eq=False)
class ResidualCorrelation:
    """The mean product of different pixels' residuals; it is 0 for independent noise."""

    share: float
    """The sum of the products over the sum of squares."""
    errors: float
    """The number of standard errors by which the share exceeds 0."""
    width: int = 1
    """The distance in pixels over which residuals are correlated."""

    @property
    def least(self) -> float:
        """A lower limit of the share; 0 if it is consistent with 0."""
        return self.share * (1.0 - CERTAIN_ERRORS / self.errors) if self.errors > CERTAIN_ERRORS else 0.0


def correlation_of(fit: Fit, excluded: Sequence[Mask | None] | None = None) -> ResidualCorrelation:
    """Return the correlation of neighbouring residuals of a fit; `excluded`: the pixels of each view not to count."""
    return neighbour_correlation(*residuals(fit, excluded))


def residuals(fit: Fit, excluded: Sequence[Mask | None] | None = None) -> tuple[list[Residuals], list[Mask]]:
    """Return the weighted residuals of each view, 0 where a pixel does not count, and the pixels that count."""
    sigma, rho = float(fit.likelihood.sigma), LOSSES[fit.likelihood.loss]
    found, counted = [], []
    for view, mask in zip(fit.views, excluded or [None] * len(fit.views), strict=True):
        seen = fit.predict(view)
        counts = np.all(seen.counts, -1) & (True if mask is None else ~mask)
        noise = 1.0 if view.noise is None else np.sqrt(np.asarray(view.noise.variance(seen.image)))
        r = seen.difference / noise
        found.append(np.where(counts[..., None], r * np.asarray(rho.slope((r / sigma) ** 2)), 0.0))
        counted.append(counts)
    return found, counted


def neighbour_correlation(found: Sequence[Residuals], counted: Sequence[Mask], lag: int = 1) -> ResidualCorrelation:
    """Compare the products of neighbours' residuals with their own scatter, for any noise of each pixel.

    For residuals of noise and a smooth misfit, the share is the fraction of their squares by the misfit.
    """
    products, squares, power = 0.0, 0.0, 0.0
    for r, c in zip(found, counted, strict=True):
        for a, b, both in (
            (r[lag:], r[:-lag], c[lag:] & c[:-lag]),
            (r[:, lag:], r[:, :-lag], c[:, lag:] & c[:, :-lag]),
        ):
            product = np.sum(a * b, -1)[both]
            products += float(product.sum())
            squares += float(np.sum(product**2))
            power += 0.5 * float(np.sum((a**2 + b**2)[both]))
    if not squares > 0:
        return ResidualCorrelation(0.0, 0.0)
    return ResidualCorrelation(products / power, products / np.sqrt(squares))


def cell_correlation(found: Sequence[Residuals], side: int) -> ResidualCorrelation:
    """Compare sums of residuals over square cells with those of independent residuals.

    For independent residuals, the square of a cell's sum has the same mean as the cell's sum of squares. The scatter of
    the excesses gives the standard error.
    """
    excess, power = [], 0.0
    for r in found:
        h, w, c = r.shape
        whole = np.zeros((-(-h // side) * side, -(-w // side) * side, c))
        whole[:h, :w] = r
        squares = [of.reshape(len(whole) // side, side, -1, side, c).sum((1, 3)) for of in (whole, whole**2)]
        excess.append(np.sum(squares[0] ** 2 - squares[1], -1)[squares[1].sum(-1) > 0])
        power += float(squares[1].sum())
    every = np.concatenate(excess)
    scatter = float(np.sqrt(np.sum(every**2)))
    if len(every) < MIN_CELLS or not scatter > 0:
        return ResidualCorrelation(0.0, 0.0, side)
    return ResidualCorrelation(float(every.sum()) / power, float(every.sum()) / scatter, side)


def inflate_errors(fit: Fit, clusters: Clusters) -> tuple[Clusters, str]:
    """Return clusters whose errors allow for correlated residuals, and a note on that. Runs in float64.

    Nothing is added if views or patches disagree, or if images are rounded to steps larger than their noise: then the
    errors include the correlation already.
    """
    if clusters.disagree or clusters.evidence.waves is not None:
        return clusters, ""
    of_pixels, _ = residuals(fit)
    correlated = [found for side in CELL_SIDES if (found := cell_correlation(of_pixels, side)).errors > CERTAIN_ERRORS]
    if not correlated:
        return clusters, ""
    most = max(correlated, key=lambda found: found.share)
    variance = max(1.0 + most.share, clusters.scatter)
    sentence = (
        f"neighbouring residuals are correlated over at least {most.width} pixels: the model is incomplete, or the "
        "noise is not independent, as after JPEG, demosaicing or denoising. Errors are multiplied by "
        f"{np.sqrt(variance):.2g} for this; check the residuals in a report."
    )
    return replace(clusters, scatter=variance), sentence
