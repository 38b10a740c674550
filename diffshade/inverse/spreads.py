"""Spreads: what the squares of the residuals at a minimum add up to, and how much of that the rounding of files is."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from .forward.rounding import MOST_NOISE, Rounded, find_rounding, share_of_waves
from .forward.sums import spread, sum_over, variance_of_steps, waves
from .laid_out import LaidOut
from .problem import PART
from .solve.solvers import Minimum

Spread = Float[np.ndarray, "5"]


def spread_at(end: Minimum, laid: LaidOut) -> Spread:
    """Return the sums of `Likelihood.spread` at a minimum."""
    cost, model = float(end.point.views.cost.sum()), laid.model
    if model.projects and cost > 1e-8 * laid.squares:  # a smaller cost has lost its digits by cancellation
        count = float(sum(s.count for s in laid.problem.data.samples))
        return np.array([count, *[2 * cost] * 2, *[count] * 2])
    task = laid.task
    return np.asarray(sum_over(laid.chunks, spread, task.with_padding(end.point.theta), task.padded_model))


def rounded_at(end: Minimum, laid: LaidOut, of: Spread) -> Rounded | None:
    """Return what rounding adds to the errors; None without steps.

    Args:
        end: The minimum.
        laid: The problem that it is of.
        of: The spread there.
    """
    problem, square = laid.problem, float(of[2] / of[0])
    levels = [0.0 if view.noise is None else float(view.noise.levels) for view in problem.data.views]
    steps = find_rounding(problem.values(problem.pieces(PART, problem.size_for(PART))), levels)
    if not steps.exists:
        return None
    count, variance = sum_over(laid.chunks, variance_of_steps, steps, laid.model)
    of_steps = float(variance / max(count, 1.0))  # mean square of the weighted residuals that rounding alone makes
    beyond = max(square - of_steps, 0.0)
    rounding = dataclasses.replace(steps, noise=np.asarray(np.sqrt(beyond)))
    hidden = beyond > 12.0 * MOST_NOISE**2 * of_steps
    held = 0.0 if hidden else of_steps * share_of_waves(beyond / (12.0 * of_steps))
    rows = sum_over(laid.chunks, waves, end.point.theta, problem.with_rounding(rounding).model)
    return Rounded(rounding, np.asarray(rows), min(held / max(square, 1e-300), 1.0))
