"""Robust scale: the standard deviation of noise, as the median of residuals' absolute values tells it."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

MAD = 1.4826  # standard deviation of a Gaussian in median absolute deviations: 1 / Phi^-1(3/4)


def robust_scale(residuals: Float[Any, "..."]) -> float:
    """Return sigma of residuals about 0, which outliers among them, up to a half, hardly change.

    $$ sigma = 1.4826 median |r| $$
    """
    return MAD * float(np.median(np.abs(residuals)))
