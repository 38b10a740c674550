"""Relevance: which groups of directions the residuals of a fit contain, and how much of each.

Each group has a variance of its own, which the residuals' own likelihood sets: that of a group that they do not need
goes to 0 (Tipping 2001, "Sparse Bayesian Learning and the Relevance Vector Machine"; the updates are MacKay's, 1992).
What is left is a posterior of the groups' amounts, that holds what the residuals cannot tell of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import special

from ...core.thresholds import MAX_STEPS, NEGLIGIBLE, ROUNDING, SINGLE, SLIGHT
from ..statistics.uncertainty import Matrix, Vector
from .noise_tests import FALSE_ALARM

MAX_DIRECTIONS = 200  # at a time: the work grows with their cube
ROUNDS = 3  # in which groups that show only beside others come back


@dataclass(frozen=True, eq=False)
class FaultEvidence:
    """What the residuals say of k directions, in groups, beyond what the fitted numbers can imitate."""

    information: Float[np.ndarray, "k k"]
    """For residuals of variance 1."""
    score: Float[np.ndarray, " k"]
    """The derivative of half the squares by each amount, negated."""
    group: Int[np.ndarray, " k"]
    squares: float
    """The sum of squares of the whitened residuals."""
    freedom: float
    """Samples less fitted numbers."""
    most: float
    """The largest variance of an amount: that of a change as large as the pictures and the residuals."""


@dataclass(frozen=True, eq=False)
class Relevance:
    """The groups that the residuals contain, and the posterior of their amounts; 0 for all others."""

    active: Bool[np.ndarray, " groups"]
    gain: Float[np.ndarray, " groups"]
    """By how much each active group raises twice the logarithm of the likelihood, beside the others."""
    variance: Float[np.ndarray, " groups"]
    """Of each active group's amounts."""
    mean: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]
    sigma2: float
    """The variance of the residuals that are left."""


def relevance(of: FaultEvidence) -> Relevance:
    """Return which groups are in the residuals: those that show alone, less what others explain as well."""
    groups = int(of.group.max(initial=-1)) + 1
    found, size = _posterior(of, np.zeros(groups, bool), None), np.bincount(of.group, minlength=groups)
    for _ in range(ROUNDS):
        p_values = _p_values(of, found)
        surest = [k for k in np.argsort(p_values, kind="stable") if not found.active[k] and p_values[k] < FALSE_ALARM]
        room = MAX_DIRECTIONS - size[found.active].sum() - np.cumsum(size[surest])
        if not (room >= 0).any():
            break
        before, found = found, _pruned(of, found, np.array(surest)[room >= 0])
        if np.array_equal(before.active, found.active):  # from which every round ends where it began
            break
    return found


def _pruned(of: FaultEvidence, found: Relevance, more: Int[np.ndarray, " more"]) -> Relevance:
    """Return the posterior with more groups, less those that the others explain as well: half of these at a time."""
    active = found.active | np.isin(np.arange(len(found.active)), more)
    while True:
        found = _posterior(of, active, found)
        spare = np.flatnonzero(active & (_p_values(of, found) > FALSE_ALARM))
        if not len(spare):
            return found
        active = active.copy()
        active[spare[np.argsort(found.gain[spare])][: max(1, len(spare) // 2)]] = False


def _posterior(of: FaultEvidence, active: Bool[np.ndarray, " groups"], near: Relevance | None) -> Relevance:
    """Return the posterior of the amounts of some groups, each of the variance that is likeliest.

    The search begins at a posterior of nearly the same groups. No variance exceeds `most`: amounts of which the
    residuals tell nothing but rounding would grow without end.
    """
    use = np.flatnonzero(active[of.group])
    A, s, own = of.information[np.ix_(use, use)], of.score[use], np.searchsorted(np.flatnonzero(active), of.group[use])
    sizes = np.bincount(own, minlength=int(active.sum()))
    sigma2, usual = of.squares / of.freedom, min(0.01 * of.squares, of.most)
    least, variance = ROUNDING * sigma2, np.full(len(sizes), usual)
    if near is not None and len(use):
        sigma2 = near.sigma2
        variance = np.where(near.active, np.maximum(near.variance, SINGLE * usual), usual)[active]
    mean, covariance = np.zeros(len(use)), np.zeros((len(use), len(use)))
    for _ in range(MAX_STEPS if len(use) else 0):
        root = np.sqrt(variance[own])
        C = np.linalg.inv(np.eye(len(use)) + root[:, None] * A / sigma2 * root)
        covariance = root[:, None] * C * root
        mean = covariance @ s / sigma2
        told = np.maximum(sizes - np.bincount(own, np.diag(C), len(sizes)), 1e-12)  # of the numbers of each group
        before, variance = variance, np.clip(np.bincount(own, mean**2, len(sizes)) / told, 1e-14 * of.squares, of.most)
        sigma2 = max((of.squares - 2.0 * mean @ s + mean @ A @ mean) / max(of.freedom - told.sum(), 1.0), least)
        change = np.log(variance / before)
        if np.all((np.abs(change) < SLIGHT) | ((change < 0.0) & (told < NEGLIGIBLE))):  # what fades to 0 fades slowly
            break
    whole, spread, gain = np.zeros(len(of.score)), np.zeros(of.information.shape), np.zeros(len(active))
    variances = np.zeros(len(active))
    variances[active], whole[use], spread[np.ix_(use, use)] = variance, mean, covariance
    for k, group in enumerate(np.flatnonzero(active)):
        of_group = own == k
        gain[group] = mean[of_group] @ np.linalg.solve(covariance[np.ix_(of_group, of_group)], mean[of_group])
    return Relevance(active, gain, variances, whole, spread, sigma2)


def _p_values(of: FaultEvidence, found: Relevance) -> Float[np.ndarray, " groups"]:
    """Return the p-value of each group's score beside the active groups, itself left out: chi^2 if it is not there."""
    return np.array([_p_value(of, found, group) for group in range(len(found.active))])


def _p_value(of: FaultEvidence, found: Relevance, group: int) -> float:
    own, active = of.group == group, found.active[of.group]
    others = active & ~own
    C = found.covariance[np.ix_(others, others)]
    if found.active[group]:  # the posterior of the others without it
        beside = found.covariance[np.ix_(others, own)]
        C = C - beside @ np.linalg.solve(found.covariance[np.ix_(own, own)], beside.T)
    explained: Matrix = of.information[np.ix_(own, others)] @ C / found.sigma2
    score: Vector = of.score[own] - explained @ of.score[others]
    w, V = np.linalg.eigh(of.information[np.ix_(own, own)] - explained @ of.information[np.ix_(others, own)])
    told = w > SINGLE * max(float(np.diag(of.information)[own].max()), 1e-300)
    if not told.any():
        return 1.0
    chi2 = np.sum((V.T @ score)[told] ** 2 / w[told]) / found.sigma2
    return float(special.chdtrc(int(told.sum()), chi2))
