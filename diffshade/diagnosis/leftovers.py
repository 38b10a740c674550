"""Leftovers: whether neighbouring residuals are alike, as they are where the model lacks something, and how much so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..inverse.losses import LOSSES
from ..inverse.outcome import Fit

CERTAIN = 5.0  # standard deviations, from which neighbouring residuals are said to be alike
SIDES = (2, 4, 8, 16)  # pixels: the cells over which residuals are added up
FEWEST = 30  # cells

Residuals = Float[np.ndarray, "h w c"]


@dataclass(frozen=True, eq=False)
class Leftovers:
    """How far the products of neighbouring residuals are from those of independent noise, whose mean is 0."""

    share: float
    """The part of the residuals' squares that neighbours share: what the model lacks, or noise that is not independent."""
    errors: float
    """Standard errors that this is above 0."""

    @property
    def least(self) -> float:
        """What the share is at least, within three errors; 0 where it may be nothing."""
        return self.share * (1.0 - 3.0 / self.errors) if self.errors > 3.0 else 0.0

    @staticmethod
    def of(fit: Fit, out: Sequence[Bool[np.ndarray, "h w"] | None] | None = None) -> Leftovers:
        """Look at the residuals of a fit; `out`: for each view the pixels that do not count."""
        return neighbours(*residuals(fit, out))


def residuals(
    fit: Fit, out: Sequence[Bool[np.ndarray, "h w"] | None] | None = None
) -> tuple[list[Residuals], list[Bool[np.ndarray, "h w"]]]:
    """Return the residuals of each view as they count in the fit, 0 where they do not, and the pixels that count."""
    sigma, rho = float(fit.likelihood.sigma), LOSSES[fit.likelihood.loss]
    found, counted = [], []
    for i, view in enumerate(fit.views):
        seen = fit.predict(view)
        counts = seen.counts.all(-1)
        if out is not None and (mask := out[i]) is not None:
            counts &= ~mask
        r = seen.difference
        if view.noise is not None:
            r = r / np.sqrt(np.asarray(view.noise.variance(seen.image)))
        found.append(np.where(counts[..., None], r * np.asarray(rho.slope((r / sigma) ** 2)), 0.0))
        counted.append(counts)
    return found, counted


def neighbours(found: Sequence[Residuals], counted: Sequence[Bool[np.ndarray, "h w"]]) -> Leftovers:
    """Compare the products of neighbours' residuals with their own scatter, whatever the noise of each pixel is."""
    products, squares, power = 0.0, 0.0, 0.0
    for r, c in zip(found, counted, strict=True):
        for a, b, both in (
            (r[1:], r[:-1], c[1:] & c[:-1]),
            (r[:, 1:], r[:, :-1], c[:, 1:] & c[:, :-1]),
        ):
            product = np.sum(a * b, -1)[both]
            products += float(product.sum())
            squares += float(np.sum(product**2))
            power += 0.5 * float(np.sum((a**2 + b**2)[both]))
    if not squares > 0:
        return Leftovers(0.0, 0.0)
    return Leftovers(products / power, products / np.sqrt(squares))
