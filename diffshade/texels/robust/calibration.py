"""Calibration: how many spreads hold the truth 68 % and 95 % of the time, from parts of the lights.

The misfit and the curvature of a texel say where the errors are large, but not how large: what the model leaves out is
shared by many observations. So texels are fitted again to each half of the lights, divided where the lights are spread
the most, and to the half around their middle and the rest, which cast shadows and bounce differently. Were the errors
of the halves independent, the whole would differ from either half as much as from the truth. Errors that the halves
share remain unseen, hence the largest of the differences counts. With few views one of three to six groups is left out
in turn, and the differences make a jackknife (Quenouille 1956; Tukey 1958). How much larger the rare errors are follows
from the geometric mean of the differences of the first division: what one part alone gets wrong is its own lack of
light.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...core.fields import Array
from ...core.thresholds import FEW, INTERVALS, MOST, SINGLE
from ..maps import NORMAL_95
from .learning import MIN_SAMPLES

TRUST_IN_GAUSSIAN = 0.15  # in the logarithm of its ratio, NORMAL_95: the rarest errors of a sample are rough
GROUPS = 6  # of the fewest views, one of which is left out: with six photographs, one at a time
FEW_VIEWS = 24  # views from which halves are fitted; below, one group is left out in turn


class Spreads(NamedTuple):
    """How many spreads hold the truth 68 % of the time, and how many of those errors hold it 95 % of the time."""

    errors: float
    times_95: float


class Division(NamedTuple):
    """The parts of the views to be fitted alone."""

    parts: Bool[np.ndarray, "parts views"]
    first: int
    """Number of the parts that the first division makes; each leaves out one of so many groups."""


def division_of(l: Float[np.ndarray, "views 3"]) -> Division:
    """Return halves along the axis where the lights spread the most, then those around their middle and the others.

    With few views there is one division, and each part leaves out one group.
    """
    middle = l.mean(0)
    apart = l - middle
    axis = np.linalg.svd(apart, full_matrices=False)[2][0]
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
    if len(l) < FEW_VIEWS:
        # groups as large as leave FEW views: lights that stand together share errors, which small groups hide
        groups = max(3, math.ceil(len(l) / (len(l) - FEW))) if len(l) > FEW else GROUPS
        groups = min(groups, GROUPS, len(l))
        return Division(_without_each(apart @ axis, groups), groups)
    return Division(np.concatenate([_without_each(apart @ axis, 2), _without_each(l @ middle, 2)]), 2)


def _without_each(along: Float[np.ndarray, " views"], groups: int) -> Bool[np.ndarray, "groups views"]:
    """Return the views without each of some groups of equal size, by their place along an axis."""
    rank = np.argsort(np.argsort(along, kind="stable"), kind="stable")
    group = rank * groups // len(along)
    return np.stack([group != g for g in range(groups)])


def calibrated(
    difference: Float[Array, "parts texels"],
    spread: Float[np.ndarray, " texels"],
    reached: Float[Array, "parts texels"],
    division: Division,
) -> Spreads:
    """Return how many spreads hold the truth.

    Args:
        difference: Size of the difference between each part's number and the whole's.
        spread: The spread of each texel.
        reached: Share of each part's views that reach the texel.
        division: The parts.
    """
    difference, reached, first = np.asarray(difference), np.asarray(reached), division.first
    known = (spread > 0.0) & np.isfinite(spread) & np.isfinite(difference).all(0)
    usable = known & (reached >= MOST).all(0)
    if usable.sum() < MIN_SAMPLES:
        usable = known
    if usable.sum() < MIN_SAMPLES:
        return Spreads(np.inf, 1.0)
    # leaving out the share f changes a mean by sqrt(f / (1 - f)) of its own error
    ratio = np.sqrt(first - 1.0) * difference[:, usable] / spread[usable]
    error = ratio.max(0) if first == 2 else np.sqrt((ratio**2).mean(0))
    typical = np.exp(np.log(np.maximum(ratio[:first], SINGLE)).mean(0))
    usual, wide = np.quantile(typical, INTERVALS)
    times_95 = NORMAL_95**TRUST_IN_GAUSSIAN * (wide / usual) ** (1.0 - TRUST_IN_GAUSSIAN)
    return Spreads(float(np.quantile(error, INTERVALS[0])), float(times_95))
