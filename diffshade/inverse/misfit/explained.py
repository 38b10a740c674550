"""Explained: which faults of the table the residuals of a fit contain, and what they do to its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..result import Fit
from ..statistics.uncertainty import Vector, inverse
from .beside import beside
from .changes import Case
from .directions import Directions, changes_of
from .faults import FAULTS
from .found import Fault, Found
from .linearised import Linearised, linearise
from .relevance import Evidence, Relevance, relevance
from .set_up import SetUp

PIXELS = 1 << 12  # of all views together, on which a fit's own residuals are explained
MOST = 0.5  # of what all faults together explain: one with a name that alone explains more is named
NEARLY = 0.9  # of what the best of these explains: another that explains more may be the cause as well
MINOR = 0.1  # of what all explain: what explains less beside the others is not named
MOVED_ERRORS = 1.0  # of independent noise: a fault that moves no value so far is not named, unless it is gross
GROSS_SHARE = 0.2  # of the residuals' squares


@dataclass(frozen=True, eq=False)
class Explained:
    """What faults do to the numbers of a fit."""

    found: tuple[Found, ...]
    """The faults to be named, that which explains most first."""
    errors: Vector
    """What all that the residuals contain adds to the standard errors of the values, in their own units."""
    of_noise: Vector
    """The standard errors by the scatter of the samples, whatever their noise."""


@dataclass(frozen=True, eq=False)
class _Candidate:
    fault: Fault
    case: Case
    size: float
    """The root mean square weighted length of its changes, by which they are divided."""
    of: Bool[np.ndarray, " k"]
    """Which of all directions are its own."""

    def is_plausible(self, amount: Vector) -> bool:
        low, high = self.fault.plausible
        return low < self.fault.size(self.case.which, amount / self.size) < high


def explain(fit: Fit) -> Explained:
    """Return what faults the residuals of a fit contain, to first order. In float64."""
    set_up = SetUp(fit, (place for fault in FAULTS for place in fault.numbers(fit)), PIXELS)
    return explained(linearise(set_up, set_up.given))


def explained(at: Linearised, faults: Sequence[Fault] = FAULTS) -> Explained:
    """Return what faults the residuals contain where a set-up was linearised.

    The errors are those of the unknowns along the posterior of all amounts, and the square of the move by the likeliest
    ones is added: the values themselves stay.
    """
    cases = [(fault, *case) for fault in faults for case in changes_of(at, fault)]
    size = [max(float(np.sqrt(np.mean(np.sum(x**2 * at.weight, 1)))), 1e-300) for *_, x in cases]
    group = np.repeat(np.arange(len(cases)), [len(x) for *_, x in cases])
    candidates = [_Candidate(*case[:2], size[k], group == k) for k, case in enumerate(cases)]
    directions = Directions(at, np.concatenate([x / of for (*_, x), of in zip(cases, size, strict=True)]))
    evidence = _with_samples_beside(at, candidates, group, directions)
    of = relevance(evidence)
    moves, of_noise = directions.moves()
    certain = [(k, np.array([one.size]), 0.0) for k, one in enumerate(candidates) if one.case.known]
    named = [*certain, *_named(of, evidence, candidates)]
    for k, *_ in named:
        if (renamed := candidates[k].case.renamed) is not None:
            moves[candidates[k].of] += renamed / candidates[k].size
    for one in (one for one in candidates if one.fault.kind == "bound"):
        moves[one.of, one.case.which] = 0.0  # which stays at its bound
    variance = np.einsum("kp,kl,lp->p", moves, of.covariance, moves) + (of.mean @ moves) ** 2
    variance += sum((amount @ moves[candidates[k].of]) ** 2 for k, amount, _ in certain)
    found = [_found(at, candidates[k], amount, moves, gain / evidence.squares) for k, amount, gain in named]
    return Explained(tuple([f for f in found if _matters(f)] or found[len(certain) :][:1]), np.sqrt(variance), of_noise)


def _with_samples_beside(
    at: Linearised, candidates: Sequence[_Candidate], group: np.ndarray, directions: Directions
) -> Evidence:
    """Return what the residuals say of the directions, and the samples beside the objects of those that show there."""
    information, score = directions.evidence()
    squares = float(np.sum(at.slope**2 / np.where(at.weight > 0, at.weight, 1.0)))
    freedom = max(float(at.count - len(at.set_up.inside)), 1.0)
    if (shown := beside(at.fit)) is not None:
        weight = float(np.median(at.weight[at.weight > 0]))
        for of in (of for of in candidates if of.fault.beside):
            information[np.ix_(of.of, of.of)] += weight * len(shown) / of.size**2
            score[of.of] += weight * shown.sum() / of.size
        squares, freedom = squares + weight * float(np.sum(shown**2)), freedom + len(shown)
    for of in (of.of for of in candidates if of.case.known):
        information[of], information[:, of], score[of] = 0.0, 0.0, 0.0
    return Evidence(information, score, group, squares, freedom)


def _named(
    of: Relevance, evidence: Evidence, candidates: Sequence[_Candidate]
) -> list[tuple[int, Float[np.ndarray, " _"], float]]:
    """Return the candidates to be named, with their amounts and what each explains of the squares.

    What shows beside the objects too comes first. Of the rest, a fault that has a name and alone explains most of what
    all explain is next, with the others that do so nearly as well; then what is in the residuals beside it.
    """
    active = [(k, of.mean[candidates[k].of], float(of.gain[k] * of.sigma2)) for k in np.flatnonzero(of.active).tolist()]
    first = [one for one in active if candidates[one[0]].fault.beside]
    rest = [one for one in active if not candidates[one[0]].fault.beside]
    if not rest:
        return first
    seen = np.any([candidates[k].of for k, *_ in rest], 0)
    information, mean = evidence.information, np.where(seen, 0.0, of.mean)
    score = evidence.score - information @ mean
    whole = float((of.mean * seen) @ (2.0 * score - information @ (of.mean * seen)))
    alone = []
    for k, one in enumerate(candidates):
        amount = inverse(information[np.ix_(one.of, one.of)]) @ score[one.of]
        gain = float(amount @ score[one.of])
        unfit = (
            one.case.known
            or one.fault.unnamed
            or one.fault.beside
            or gain <= MOST * whole
            or not one.is_plausible(amount)
        )
        alone += [] if unfit else [(k, amount, gain)]
    best = max((gain for *_, gain in alone), default=0.0)
    alone = [one for one in alone if one[2] > NEARLY * best]
    also = [
        (k, amount, gain)
        for k, amount, gain in rest
        if k not in [k for k, *_ in alone] and gain > MINOR * whole and candidates[k].is_plausible(amount)
    ]
    found = [*first, *alone, *sorted(also, key=lambda one: -one[2])]
    return found or [max(rest, key=lambda one: one[2])]


def _found(at: Linearised, of: _Candidate, amount: Vector, moves: Float[np.ndarray, "k p"], share: float) -> Found:
    fit = at.set_up.fit
    views = tuple(range(len(fit.views))) if of.case.views is None else of.case.views
    return Found(of.fault, fit, of.case.which, views, share, amount / of.size, amount @ moves[of.of])


def _matters(found: Found) -> bool:
    """Whether a fault moves a value that the fit determines, or is gross."""
    fit = found.given
    return found.share > GROSS_SHARE or bool(
        np.any(fit.determined & (np.abs(found.moves) > MOVED_ERRORS * fit.plain_errors))
    )
