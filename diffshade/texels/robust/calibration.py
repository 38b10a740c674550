"""Calibration: how many spreads hold the truth 68 % and 95 % of the time, from halves of the lights.

The misfit and the curvature of a texel say where the errors are large, but not how large: what the model leaves out is
shared by many observations. So texels are fitted again to each half of the lights, divided where the lights are spread
the most. Were the errors of the halves independent, the whole would differ from either half as much as from the truth.
Errors that the halves share remain unseen, hence the larger of both differences counts. With few views thirds are left
out in turn, and their differences make a jackknife (Quenouille 1956; Tukey 1958). How much larger the rare errors are
follows from the geometric mean of the differences: what one part alone gets wrong is its own lack of light.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...core.fields import Array
from ..maps import NORMAL_95

LEAST_REACHED = 0.75  # share of the views of each half that must reach a texel, for the half to say something of it
FEWEST = 30  # texels from which quantiles are taken
SHARES = (68.0, 95.0)
TRUST_IN_GAUSSIAN = 0.25  # in the logarithm of its ratio, NORMAL_95: the rarest errors of a sample are rough
LEAST_RATIO = 1e-6  # of a difference to a spread; one of 0 has no logarithm
FEW_VIEWS = 24  # views from which halves are fitted; below, thirds are left out


class Spreads(NamedTuple):
    """How many spreads hold the truth 68 % of the time, and how many of those errors hold it 95 % of the time."""

    errors: float
    times_95: float


def parts_of(l: Float[np.ndarray, "views 3"]) -> Bool[np.ndarray, "parts views"]:
    """Return the parts of the views to be fitted alone: either half along the axis where the lights spread the most.

    With few views each part leaves out a third instead.
    """
    apart = l - l.mean(0)
    axis = np.linalg.svd(apart, full_matrices=False)[2][0]
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
    rank = np.argsort(np.argsort(apart @ axis, kind="stable"), kind="stable")
    groups = 2 if len(l) >= FEW_VIEWS else 3
    group = rank * groups // len(l)
    return np.stack([group != g for g in range(groups)])


def calibrated(
    difference: Float[Array, "parts texels"],
    spread: Float[np.ndarray, " texels"],
    reached: Float[Array, "parts texels"],
) -> Spreads:
    """Return how many spreads hold the truth.

    Args:
        difference: Size of the difference between each part's number and the whole's.
        spread: The spread of each texel.
        reached: Share of each part's views that reach the texel.
    """
    difference, reached, parts = np.asarray(difference), np.asarray(reached), len(difference)
    known = (spread > 0.0) & np.isfinite(spread) & np.isfinite(difference).all(0)
    usable = known & (reached >= LEAST_REACHED).all(0)
    if usable.sum() < FEWEST:
        usable = known
    if usable.sum() < FEWEST:
        return Spreads(np.inf, 1.0)
    # leaving out the share f changes a mean by sqrt(f / (1 - f)) of its own error
    ratio = np.sqrt(parts - 1.0) * difference[:, usable] / spread[usable]
    error = ratio.max(0) if parts == 2 else np.sqrt((ratio**2).mean(0))
    typical = np.exp(np.log(np.maximum(ratio, LEAST_RATIO)).mean(0))
    usual, wide = np.percentile(typical, SHARES)
    times_95 = NORMAL_95**TRUST_IN_GAUSSIAN * (wide / usual) ** (1.0 - TRUST_IN_GAUSSIAN)
    return Spreads(float(np.percentile(error, SHARES[0])), float(times_95))
