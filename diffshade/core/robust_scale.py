"""Robust scale: standard deviations from medians and from groups left out, and quantiles of the usual laws."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

MAD = 1.4826  # standard deviation of a Gaussian in median absolute deviations: 1 / Phi^-1(3/4)
GAUSS_95 = 1.96  # standard errors that hold a number 95 % of the time: Phi^-1(.975)
OUTLIER = 4.0  # standard deviations beyond which a difference is no chance: one of 16,000 is
RARE = 3.0  # the same where few are compared: one of 370 is beyond it by chance
UNIFORM = 12.0**-0.5  # standard deviation of a number that is rounded, or spread evenly, over a unit


def robust_scale(residuals: Float[Any, "..."]) -> float:
    """Return sigma of residuals about 0, which outliers among them, up to a half, hardly change.

    $$ sigma = 1.4826 median |r| $$
    """
    return MAD * float(np.median(np.abs(residuals)))


def jackknife_error(estimates: Float[np.ndarray, "groups ..."]) -> Float[np.ndarray, "..."]:
    """Return the standard error of an estimate, from those without one group each of the observations."""
    groups = len(estimates)
    return np.sqrt((groups - 1) / groups * np.square(estimates - np.mean(estimates, 0)).sum(0))
