"""Contradictions: priors that disagree with what the images say without them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from ...core.progress import ReportProgress, silent
from ...core.robust_scale import GAUSS_95, OUTLIER
from ...core.thresholds import ROUNDING
from ...core.words import Note, listing
from ..result import Fit
from ..statistics.identifiability import null_directions
from ..statistics.uncertainty import Matrix, Vector, inverse
from ..unknowns.unknown import by_quantity, coordinate_slopes, coordinates, logarithms


def pulls(
    total: Matrix, theta: Vector, mean: Vector, width: Vector, sigma: float, variance: Vector
) -> tuple[Vector, Vector]:
    """Return the values that the images give without each prior, to first order, and how far each prior pulls them.

    They are in the solver's coordinates. A pull is the distance of a value from its prior's mean, over the standard
    deviation of the difference. Both are NaN without a prior, or if the images say nothing.

    `total` is the Gram of images and priors at the optimum theta. A prior has a `mean` and a `width` (NaN: none), and
    the weight (sigma / width)^2 in `total`. `variance` holds for each unknown the factor of total^-1.
    """
    C = inverse(total)
    weight = np.where(np.isnan(width), 0.0, (sigma / np.where(np.isnan(width), 1.0, width)) ** 2)
    left = 1.0 - weight * np.diag(C)  # the images' share of the information (Sherman and Morrison 1950)
    tells = ~np.isnan(width) & (left > ROUNDING)
    safe = np.where(tells, left, 1.0)
    without = np.where(tells, mean + (theta - mean) / safe, np.nan)
    errors = np.where(tells, np.sqrt(variance * np.diag(C) / safe), np.nan)
    return without, (without - mean) / np.sqrt(width**2 + errors**2)


def check_priors(fit: Fit, _: ReportProgress = silent) -> Fit:
    """Return a fit with notes on the priors that the images contradict; the values that these move are undetermined."""
    if not any(u.prior for u in fit.unknowns):
        return fit
    evidence, free = fit.evidence, np.flatnonzero(~fit.at_bound)
    slope = coordinate_slopes(fit.values, fit.unknowns)[free]
    theta = coordinates(fit.values, fit.unknowns)[free]
    priors = np.array([fit.unknowns[j].prior or (np.nan, np.nan) for j in free], float).reshape(-1, 2)
    total = evidence.total[np.ix_(free, free)] / np.outer(slope, slope)
    variance = evidence.sigma2 * fit.clusters.inflation()[free]
    sigma = float(fit.likelihood.sigma)
    without, pull = pulls(total, theta, priors[:, 0], priors[:, 1], sigma, variance)
    against = np.nan_to_num(np.abs(pull)) > OUTLIER
    if not against.any():
        return fit
    weight = np.where(against, (sigma / np.where(against, priors[:, 1], 1.0)) ** 2, 0.0)
    offset = np.where(against, theta - priors[:, 0], 0.0)
    moved = np.zeros(len(fit.values))
    moved[free] = inverse(total - np.diag(weight)) @ (weight * offset) / slope
    zero, directions = null_directions(total - np.diag(weight))
    moved[free[zero | directions.any(0)]] = np.inf  # without these priors nothing is known of it
    corrupted = fit.determined & (np.abs(moved) > GAUSS_95 * fit.errors)
    of_quantities = by_quantity([fit.unknowns[j] for j in free]).values()
    contradicted = [here for of in of_quantities if (here := [k for k in of if against[k]])]
    notes = [_said(fit, free[here], without[here], pull[here], corrupted) for here in contradicted]
    return replace(fit, determined=fit.determined & ~corrupted, notes=(*notes, *fit.notes))


def _said(fit: Fit, which: np.ndarray, without: Vector, pull: Vector, corrupted: Bool[np.ndarray, " p"]) -> Note:
    """Return a note on the channel where a prior and the images differ most: both values, and the remedy."""
    k = int(np.argmax(np.abs(pull)))
    unknown = fit.unknowns[int(which[k])]
    assert unknown.prior is not None
    mean, other = (np.exp(x) if logarithms([unknown])[0] else x for x in (unknown.prior[0], without[k]))
    names = [name for name, it in zip(fit.names, corrupted, strict=True) if it]
    instead = f" Until then {listing(names)} {'is' if len(names) == 1 else 'are'} not determined." if names else ""
    others = any(u.prior is not None and u.quantity != unknown.quantity for u in fit.unknowns)
    rest, by = ("the images and the other priors",) * 2 if others else ("the images", "the images alone")
    text = (
        f"the prior of {unknown.quantity} contradicts {rest}: {unknown.name} is {mean:.4g} by the prior and "
        f"{other:.4g} by {by}, {abs(pull[k]):.2g} standard deviations apart. Correct or widen the prior, "
        f"or check what the scene takes as known.{instead}"
    )
    return Note(text, "prior", (unknown.quantity,))
