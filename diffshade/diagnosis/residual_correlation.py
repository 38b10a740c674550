"""Residual correlation: whether neighbouring residuals are correlated, as with model error, and how strongly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core.masks import Mask
from ..core.robust_scale import OUTLIER

Residuals = Float[np.ndarray, "h w c"]


@dataclass(frozen=True, eq=False)
class ResidualCorrelation:
    """The mean product of different pixels' residuals; it is 0 for independent noise."""

    share: float
    """The sum of the products over the sum of squares."""
    errors: float
    """The number of standard errors by which the share exceeds 0."""

    @property
    def least(self) -> float:
        """A lower limit of the share; 0 if it is consistent with 0."""
        return self.share * (1.0 - OUTLIER / self.errors) if self.errors > OUTLIER else 0.0


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
