"""Residual correlation: whether neighbouring residuals are correlated, as with model error, and how strongly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..core.masks import Mask

Residuals = Float[np.ndarray, "h w c"]


def neighbour_correlation(found: Sequence[Residuals], counted: Sequence[Mask], lag: int = 1) -> tuple[float, float]:
    """Compare the products of neighbours' residuals with their own scatter, for any noise of each pixel.

    For residuals of noise and a smooth misfit, the share is the fraction of their squares by the misfit.

    Returns:
        The share: the sum of the products over the sum of squares, 0 for independent noise; and the number of standard
        errors by which it exceeds 0.
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
        return 0.0, 0.0
    return products / power, products / np.sqrt(squares)
