"""Explained: which faults of the table the residuals of a fit contain, and what they do to its numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.thresholds import FAR_MORE, MOST, SLIGHT, SMALL
from ..forward.rounding import sawtooth
from ..pixels.blocks import BLOCK
from ..result import Fit
from ..statistics.uncertainty import Vector, inverse
from ..unknowns.unknown import coordinate_slopes, values_at
from .changes import Case, Move, bounded, of_each_channel
from .directions import Directions, changes_of
from .faults import FAULTS
from .found import Fault, Found
from .linearised import Linearised, linearise
from .relevance import FaultEvidence, Relevance, relevance
from .set_up import SetUp

MAX_VIEWS = 64  # that are looked at, so that memory holds what each of them may have
PIXELS = 2 * BLOCK  # of all views together, on which a fit's own residuals are explained


@dataclass(frozen=True, eq=False)
class Explained:
    """What faults do to the numbers of a fit."""

    found: tuple[Found, ...]
    """The faults to be named, that which explains most first."""
    errors: Vector
    """What all that the residuals contain adds to the standard errors of the values, in their own units."""
    of_noise: Vector
    """The standard errors by the scatter of the samples, whatever their noise."""
    like_gamma: tuple[Found, ...] = ()
    """The faults that can be mistaken for a gamma, each as if it were the only one."""


@dataclass(frozen=True, eq=False)
class _Candidate:
    fault: Fault
    case: Case
    size: float
    """The root mean square weighted length of its changes, by which they are divided."""
    of: Bool[np.ndarray, " k"]
    """Which of all directions are its own."""

    def is_plausible(self, amount: Float[np.ndarray, " of"]) -> bool:
        low, high = self.fault.plausible
        return low < self.fault.size(self.case.which, amount / self.size) < high


@dataclass(frozen=True, eq=False)
class _Look:
    """What the residuals say of the faults of the table where a set-up was linearised."""

    candidates: list[_Candidate]
    directions: Directions
    evidence: FaultEvidence
    of: Relevance

    @property
    def minimum(self) -> Vector:
        """The numbers of the set-up at the minimum without any fault, on the pixels that are laid out."""
        theta = self.directions.at.state.theta.copy()
        theta[self.directions.inside] += self.directions.step
        return theta

    @cached_property
    def corrected(self) -> Vector:
        """The numbers of the set-up with the likeliest amounts of all faults; bounds do not hold."""
        theta, inside = self.minimum, self.directions.inside
        theta[inside] -= self.of.mean @ self.directions.moves_inside
        for one in self.candidates:
            amount = self.of.mean[one.of] / one.size
            if isinstance(one.case.change, Move) and amount.any():
                theta = one.case.change.along(theta, amount)
        return theta

    @cached_property
    def moves(self) -> Float[np.ndarray, "k p"]:
        """How far each direction moves the fit's values."""
        fit = self.directions.at.set_up.fit
        return self.directions.moves() / coordinate_slopes(fit.values, fit.unknowns)

    def is_instead(self, found: Found) -> bool:
        """Whether a fault is none of those that explain the residuals best together, but alone explains them nearly."""
        own = [(one.fault, one.case.which) == (found.fault, found.which) for one in self.candidates]
        return not any(self.of.active[k] or self.candidates[k].case.known for k in np.flatnonzero(own))

    def found(self, one: _Candidate, amount: Float[np.ndarray, " of"], gain: float) -> Found:
        """Return a candidate as a fault of an amount that explains so much of the squares."""
        fit, moves, case = self.directions.at.set_up.fit, self.moves[one.of], one.case
        views = tuple(range(len(fit.views))) if case.views is None else case.views
        moved = amount @ (moves if case.renamed is None else moves + case.renamed / one.size)
        return Found(one.fault, fit, case.which, views, gain / self.evidence.squares, amount / one.size, moved)


def explain(fit: Fit, squares: Mapping[int, float], shared: float = 1.0) -> Explained:
    """Return what faults the residuals of a fit contain. In float64.

    Args:
        fit: The fit.
        squares: The mean square of the residuals of each view. Of many views the worst are looked at, and some others.
        shared: By how much sums of the residuals over neighbours vary more than of independent ones, if they are noise.
    """
    if len(squares) > MAX_VIEWS:
        worst, every = sorted(squares, key=lambda i: -squares[i]), sorted(squares)
        kept = {*worst[: MAX_VIEWS // 2], *every[:: 2 * len(every) // MAX_VIEWS]}
        masks = [None if i in kept else np.zeros(view.camera.shape, bool) for i, view in enumerate(fit.views)]
        fit = replace(fit, solved=fit.solved.keeping(masks))
    set_up = SetUp(fit, (place for fault in FAULTS for place in fault.numbers(fit)), PIXELS)
    return explained(linearise(set_up, set_up.given), shared=shared)


def explained(at: Linearised, faults: Sequence[Fault] = FAULTS, *, shared: float = 1.0) -> Explained:
    """Return what faults the residuals contain where a set-up was linearised.

    The errors are those of the unknowns along the posterior of all amounts, and the square of the move by the likeliest
    ones is added: the values themselves stay. Faults are looked at where the fit is, and where this leads; the larger
    errors count, so that they contain how far a change to first order can be trusted. They contain the moves of all
    faults that are named without being among the likeliest, too.
    """
    set_up, fit = at.set_up, at.set_up.fit
    if set_up.shown_beside is None:  # then nothing is known of there
        faults = [replace(fault, beside=False) if fault.beside else fault for fault in faults]
    # an unknown at a physical bound, 0, is free beyond it here; one at another bound is a fault of its own
    first = _look(at, faults, np.flatnonzero(~(fit.at_bound & (fit.values != 0.0))), shared)
    at_minimum = Directions(at, first.directions.changes[:0], np.flatnonzero(~fit.at_bound))
    of_noise = at_minimum.errors() / coordinate_slopes(fit.values, fit.unknowns)
    if not first.of.active.any() and not any(one.case.known for one in first.candidates):
        return Explained((), np.zeros(set_up.own), of_noise)
    found = _found(first)
    theta, (lower, upper) = np.clip(first.corrected, *set_up.bounds), set_up.bounds
    within = (lower < theta) & (theta < upper)
    inside = np.flatnonzero(within[: set_up.own])
    theta[set_up.own :] = np.where(within, theta, at.state.theta)[set_up.own :]  # no radius is 0
    there = linearise(set_up, replace(at.state, theta=theta, fit=set_up.drawn(theta)))
    with np.errstate(over="ignore"):
        before = values_at(first.minimum[: set_up.own], fit.unknowns)
    errors = [_errors(look, found, before) for look in (first, _look(there, faults, inside, shared))]
    named = [f for f in found if not f.fault.unnamed]
    instead = [np.abs(f.moves) for f in named if first.is_instead(f)]
    return Explained(found, np.max([*errors, *instead], 0), of_noise, _like_gamma(first))


def _errors(look: _Look, found: Sequence[Found], before: Vector) -> Vector:
    """Return what the faults add to the errors of a fit; those that are named mean other values.

    They have moved it from the values of the same pixels (`before`), whose scatter is none of theirs.
    """
    set_up = look.directions.at.set_up
    moves, fit = look.moves.copy(), set_up.fit
    for one in (one for one in look.candidates if one.fault.kind == "bound"):
        moves[np.ix_(one.of, bounded(fit))] = 0.0  # which stay at their bounds
    with np.errstate(over="ignore", invalid="ignore"):
        away = before - values_at(look.corrected[: set_up.own], fit.unknowns)
    away[np.isnan(away)] = np.inf  # an n_s of which nothing is known may be beyond all numbers
    held = np.setdiff1d(np.arange(set_up.own), look.directions.inside)
    away[held] += look.of.mean @ moves[:, held]
    for one in look.candidates:
        if one.case.renamed is not None and any(f.fault is one.fault for f in found):
            moves[one.of] += one.case.renamed / one.size
            away = away + look.of.mean[one.of] @ (one.case.renamed[None] / one.size)
    more = sum((one.size * moves[one.of].sum(0)) ** 2 for one in look.candidates if one.case.known)
    apart = [look.of.mean[one.of] @ moves[one.of] for one in look.candidates]
    inexact = [np.abs(of) for one, of in zip(look.candidates, apart, strict=True) if one.fault.inexact]
    if inexact:  # what their form does not hold is taken for other faults, which may move the values back
        without_signs = np.minimum(np.sum(np.abs(apart), 0), np.abs(away) + FAR_MORE * np.sum(inexact, 0))
        away = np.maximum(np.abs(away), without_signs)
        more += np.sum(np.square(inexact), 0)
    return np.sqrt(np.einsum("kp,kl,lp->p", moves, look.of.covariance, moves) + away**2 + more)


def _look(at: Linearised, faults: Sequence[Fault], inside: Int[np.ndarray, " inside"], shared: float) -> _Look:
    cases = [(fault, *case) for fault in faults for case in changes_of(at, fault)]
    squares = np.bincount(at.set_up.view, at.slope**2 / np.where(at.weight > 0, at.weight, 1.0), len(at.fit.views))
    worst = {*np.argsort(-squares / np.maximum(np.diff(at.set_up.first), 1))[:MAX_VIEWS].tolist()}
    cases = [case for case in cases if case[1].views is None or worst & {*case[1].views}]
    size = [max(float(np.sqrt(np.mean(np.sum(x**2 * at.weight, 1)))), 1e-300) for *_, x in cases]
    group = np.repeat(np.arange(len(cases)), [len(x) for *_, x in cases])
    candidates = [_Candidate(*case[:2], size[k], group == k) for k, case in enumerate(cases)]
    changes = np.concatenate([x / of for (*_, x), of in zip(cases, size, strict=True)])
    directions = Directions(at, changes, inside)
    evidence = _with_samples_beside(candidates, group, directions)
    evidence = replace(evidence, freedom=max(evidence.freedom / shared, 1.0))  # so many samples are independent
    return _Look(candidates, directions, evidence, relevance(evidence))


def _with_samples_beside(candidates: Sequence[_Candidate], group: np.ndarray, directions: Directions) -> FaultEvidence:
    """Return what the residuals say of the directions, and the samples beside the objects of those that show there."""
    at, squares, (information, score) = directions.at, directions.squares, _beyond_rounding(directions)
    freedom = max(float(at.count - len(directions.inside)), 1.0)
    if (shown := at.set_up.shown_beside) is not None:
        weight = float(np.median(at.weight[at.weight > 0]))
        number, total = (np.array(list(map(of, shown)), float) for of in (len, np.sum))
        levels = [of for of in candidates if of.fault.beside and of.of.sum() == len(shown)]
        for of in levels:  # one for each channel
            information[np.ix_(of.of, of.of)] += weight * np.diag(number) / of.size**2
            score[of.of] += weight * total / of.size
        squares += weight * float(sum(samples @ samples for samples in shown))
        freedom += number.sum()
    for of in (of.of for of in candidates if of.case.known):  # which the residuals need not show
        information[of], information[:, of], score[of] = 0.0, 0.0, 0.0
    # a change is what is predicted less what is shown: at most about as large as the photographs and the residuals
    most = max(squares, float(at.weight @ at.photographed**2))
    rounding = np.finfo(float).eps * most  # without noise, exactly 0 may be left
    return FaultEvidence(information, score, group, max(squares, rounding), freedom, most)


def _beyond_rounding(directions: Directions) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, " k"]]:
    """Return what the residuals say of the directions beside the sawtooth of the files' steps.

    Its phase in each channel is where the fit is off by a part of a step. All samples may be off by up to half a step.
    """
    at, k = directions.at, len(directions.changes)
    if at.fit.evidence.waves is None:
        return directions.evidence()
    steps = of_each_channel(at, sawtooth(at.fit.rounding, at.set_up.view, at.predicted, at.weight))
    information, score = Directions(at, np.concatenate([directions.changes, steps]), directions.inside).evidence()
    noise = directions.squares / max(at.count - len(directions.inside), 1)
    known = information[:k, k:] @ inverse(information[k:, k:] + noise * np.eye(len(steps)))
    return information[:k, :k] - known @ information[k:, :k], score[:k] - known @ score[k:]


def _named(
    of: Relevance, evidence: FaultEvidence, candidates: Sequence[_Candidate]
) -> list[tuple[int, Float[np.ndarray, " _"], float]]:
    """Return the candidates to be named, with their amounts and what each explains of the squares.

    What shows beside the objects too comes first. Of the rest, a fault that has a name and alone explains most of what
    all explain is next, with the others that do so nearly as well, a bound before these; then what is in the residuals
    beside it. If what all explain needs none of these, the largest of what it needs follows the first: light from
    elsewhere looks like a lamp a little to the side.
    """
    active = [(k, of.mean[candidates[k].of], float(of.gain[k] * of.sigma2)) for k in np.flatnonzero(of.active).tolist()]
    first = [one for one in active if candidates[one[0]].fault.beside and candidates[one[0]].is_plausible(one[1])]
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
        small = gain <= MOST * whole or not one.is_plausible(amount)
        unfit = small or one.fault.unnamed or one.fault.beside or one.case.known
        alone += [] if unfit else [(k, amount, gain)]
    best = max((gain for *_, gain in alone), default=0.0)
    alone = [one for one in alone if one[2] > (1.0 - SMALL) * best]
    also = [
        (k, amount, gain)
        for k, amount, gain in rest
        if k not in [k for k, *_ in alone] and gain > SMALL * whole and candidates[k].is_plausible(amount)
    ]
    largest = max(rest, key=lambda one: one[2])
    if alone and not any(of.active[k] for k, *_ in alone):
        alone, also = [alone[0], largest, *alone[1:]], [one for one in also if one[0] != largest[0]]
    alone.sort(key=lambda one: (candidates[one[0]].fault.kind != "bound", -one[2]))
    return [*first, *alone, *sorted(also, key=lambda one: -one[2])] or [largest]


def _found(look: _Look) -> tuple[Found, ...]:
    """Return the faults to be named that matter; if none does, the first."""
    certain = [look.found(one, np.array([one.size]), 0.0) for one in look.candidates if one.case.known]
    of_rest = _named(look.of, look.evidence, look.candidates)
    named = [look.found(look.candidates[k], amount, gain) for k, amount, gain in of_rest]
    found = [f for f in (*certain, *named) if _matters(f)] or named[:1]
    most = max(map(_errors_moved, named), default=0.0)
    # what is there for sure comes last where it moves less than what the residuals show
    return tuple(sorted(found, key=lambda f: f in certain and _errors_moved(f) < most))


def _like_gamma(look: _Look) -> tuple[Found, ...]:
    """Return the faults that a refit has to tell from a gamma, each with the amount that it has alone."""
    found = []
    for one in (one for one in look.candidates if one.fault.mended is not None):
        amount = inverse(look.evidence.information[np.ix_(one.of, one.of)]) @ look.evidence.score[one.of]
        same = one.fault.kind == "distance" and abs(one.fault.size(one.case.which, amount / one.size) - 1.0) < SLIGHT
        if one.is_plausible(amount) and not same:
            found.append(look.found(one, amount, float(amount @ look.evidence.score[one.of])))
    return tuple(found)


def _matters(found: Found) -> bool:
    """Whether a fault moves a value that the fit determines, or is gross."""
    return found.share > 2.0 * SMALL or _errors_moved(found) > 1.0


def _errors_moved(found: Found) -> float:
    """Return by how many errors a fault moves the value that it moves most."""
    of = found.given.determined
    return float(np.max(np.abs(found.moves[of]) / found.given.plain_errors[of], initial=0.0))
