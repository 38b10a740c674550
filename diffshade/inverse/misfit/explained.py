"""Explained: which faults of the table the residuals of a fit contain, and what they do to its numbers.

Every fault is a direction of image space, or several. What the unknowns can imitate of a direction moves them, and the
rest shows in the residuals (Rao 1948): so much of the fault as these contain has moved the unknowns in proportion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..result import Fit
from ..statistics.uncertainty import Matrix, Vector, inverse
from ..unknowns.unknown import coordinate_slopes
from .beside import beside
from .changes import Case, Move
from .faults import FAULTS
from .found import Fault, Found
from .linearised import Linearised, linearise
from .relevance import Evidence, Relevance, relevance
from .set_up import SetUp

PIXELS = 1 << 12  # of all views together, on which a fit's own residuals are explained
ALIKE = 0.5  # of what all faults together explain: a fault that explains more by itself is named
MINOR = 0.1  # ... and one that explains less beside the others is not
NEARLY = 0.9  # of what the best of these explains: those that explain more may be the cause as well


@dataclass(frozen=True, eq=False)
class Explained:
    """What faults do to the numbers of a fit."""

    found: tuple[Found, ...]
    """The faults that the residuals contain, that which explains most first."""
    errors: Vector
    """What they add to the standard errors of the values, in their own units."""
    of_noise: Vector
    """The standard errors by the scatter of the samples' own contributions, whatever their noise (White 1980)."""
    share: float
    """The fraction of the residuals' squares that they explain."""


@dataclass(frozen=True, eq=False)
class _Directions:
    """Directions of image space beside the unknowns of a fit."""

    at: Linearised
    changes: Float[np.ndarray, "k n"]

    @property
    def imitated(self) -> Float[np.ndarray, "k numbers"]:
        """The products with the derivatives by each number of the set-up."""
        return np.asarray((self.at.jacobian @ (self.changes * self.at.weight).T).T)

    def evidence(self) -> tuple[Matrix, Vector]:
        """Return the information on the amounts beyond the unknowns, and the score."""
        at, inside = self.at, self.at.set_up.inside
        J = at.jacobian[inside]
        to_unknowns = self.imitated[:, inside] @ inverse(_hessian(at)[np.ix_(inside, inside)])
        information = (self.changes * at.weight) @ (self.changes - to_unknowns @ J).T
        score = to_unknowns @ (J @ at.slope + at.known_gradient[inside]) - self.changes @ at.slope
        w, V = np.linalg.eigh(0.5 * (information + information.T))
        return (V * np.maximum(w, 0.0)) @ V.T, score  # what the unknowns imitate has none, but for rounding


def _hessian(at: Linearised, priors: float = 1.0) -> Matrix:
    return ((at.jacobian * at.weight[None]) @ at.jacobian.T).toarray() + priors * at.known_hessian


def explain(fit: Fit) -> Explained:
    """Return what faults the residuals of a fit contain, to first order. In float64."""
    set_up = SetUp(fit, (place for fault in FAULTS for place in fault.numbers(fit)), PIXELS)
    return explained(linearise(set_up, set_up.given))


def explained(at: Linearised) -> Explained:
    """Return what faults the residuals contain where a set-up was linearised.

    The errors are those of the unknowns along the posterior of all amounts, and the square of the move by the likeliest
    ones is added: the values themselves stay.
    """
    cases = [(fault, case, change) for fault in FAULTS for case, change in changes_of(at, fault)]
    size = np.array([max(np.sqrt(np.mean(np.sum(x**2 * at.weight, 1))), 1e-300) for *_, x in cases])
    group = np.repeat(np.arange(len(cases)), [len(x) for *_, x in cases])
    directions = _Directions(at, np.concatenate([x / of for (*_, x), of in zip(cases, size, strict=True)]))
    information, score = directions.evidence()
    squares = float(np.sum(at.slope**2 / np.where(at.weight > 0, at.weight, 1.0)))
    freedom = max(at.count - len(at.set_up.inside), 1.0)
    shown, weight = beside(at.fit), float(np.median(at.weight[at.weight > 0]))
    for k in [k for k, (fault, *_) in enumerate(cases) if fault.beside]:
        if shown is None:
            continue
        of_group = np.flatnonzero(group == k)
        information[of_group, of_group] += weight * len(shown) / size[k] ** 2
        score[of_group] += weight * shown.sum() / size[k]
        squares, freedom = squares + weight * float(np.sum(shown**2)), freedom + len(shown)
    of = relevance(Evidence(information, score, group, squares, freedom))
    moves, of_noise = _moves(directions)
    named = _named(of, information, score, group, [(fault, size[k]) for k, (fault, *_) in enumerate(cases)])
    found = []
    for k, amount, gain in named:
        fault, case, _ = cases[k]
        if case.renamed is not None:
            moves[group == k] += case.renamed / size[k]
        views = tuple(range(len(at.fit.views))) if case.views is None else case.views
        by = amount @ moves[group == k]
        found.append(Found(fault, at.set_up.fit, case.which, views, gain / squares, amount / size[k], by))
    errors = np.sqrt(np.einsum("kp,kl,lp->p", moves, of.covariance, moves) + (of.mean @ moves) ** 2)
    share = 1.0 - of.sigma2 * freedom / squares if found else 0.0
    return Explained(tuple(found), errors, of_noise, float(share))


def _named(
    of: Relevance, information: Matrix, score: Vector, group: np.ndarray, faults: Sequence[tuple[Fault, float]]
) -> list[tuple[int, Vector, float]]:
    """Return the groups to be named, with their amounts and what each explains of the squares.

    What shows beside the objects too comes first. Of the rest, a fault that has a name and alone explains most of what
    all explain is next, with the others that do so nearly as well; then what is in the residuals beside it.
    """
    active = np.flatnonzero(of.active)
    plain = [k for k in active if not faults[k][0].beside]
    found = [(int(k), of.mean[group == k], float(of.gain[k] * of.sigma2)) for k in active if faults[k][0].beside]
    seen = np.isin(group, plain)
    apart = ~np.isin(group, [k for k, *_ in found])
    score = score - information[:, ~apart] @ of.mean[~apart]
    whole = 2.0 * of.mean[seen] @ score[seen] - of.mean[seen] @ information[np.ix_(seen, seen)] @ of.mean[seen]
    alone = []
    for k, (fault, size) in enumerate(faults):
        own = group == k
        amount = inverse(information[np.ix_(own, own)]) @ score[own]
        gain = float(amount @ score[own])
        if (
            plain
            and not (fault.unnamed or fault.beside)
            and gain > ALIKE * whole
            and _is_plausible(fault, amount / size)
        ):
            alone.append((k, amount, gain))
    alone = [one for one in alone if one[2] > NEARLY * max(gain for *_, gain in alone)]
    rest = [(int(k), of.mean[group == k], float(of.gain[k] * of.sigma2)) for k in plain]
    rest = [
        one
        for one in rest
        if one[0] not in [k for k, *_ in alone] and _is_plausible(faults[one[0]][0], one[1] / faults[one[0]][1])
    ]
    return found + alone + sorted(rest, key=lambda one: -one[2])


def _is_plausible(fault: Fault, amount: Vector) -> bool:
    return fault.plausible[0] < fault.size(0, amount) < fault.plausible[1]


def _moves(directions: _Directions) -> tuple[Float[np.ndarray, "k p"], Vector]:
    """Return how far each direction moves the values of a fit, and their errors by the samples' own scatter.

    Priors weigh as much beside the samples as they do in the whole fit. An unknown at a bound moves with all others
    that are at none.
    """
    at, own = directions.at, directions.at.set_up.own
    part = at.count / max(float(at.set_up.fit.evidence.spread[0]), 1.0)
    H, imitated = _hessian(at, part), directions.imitated
    scatter = ((at.jacobian[:own] * at.slope[None] ** 2) @ at.jacobian[:own].T).toarray()
    moves, variance = np.zeros((len(imitated), own)), np.zeros(own)
    for j in (None, *np.flatnonzero(at.set_up.fit.at_bound).tolist()):
        which = at.set_up.inside if j is None else np.append(at.set_up.inside, j)
        of_which = np.arange(len(which)) if j is None else np.array([len(which) - 1])
        inverted = inverse(H[np.ix_(which, which)])
        moves[:, which[of_which]] = (imitated[:, which] @ inverted)[:, of_which]
        variance[which[of_which]] = part * np.diag(inverted @ scatter[np.ix_(which, which)] @ inverted)[of_which]
    slope = coordinate_slopes(at.set_up.fit.values, at.set_up.fit.unknowns)
    return moves / slope, np.sqrt(variance) / np.abs(slope)


def changes_of(at: Linearised, fault: Fault) -> list[tuple[Case, np.ndarray]]:
    """Return the cases of a fault with the change of each sample by it, where that is linear and finite."""
    found = []
    for case in fault.cases(at) if fault.cases else ():
        change = case.change.rows @ at.jacobian if isinstance(case.change, Move) else case.change
        change = change if fault.at_rims else np.where(at.at_rims, 0.0, change)
        if np.isfinite(change).all() and change.any():
            found.append((case, np.asarray(change)))
    return found


def amount_alone(at: Linearised, change: Float[np.ndarray, "k n"]) -> tuple[Vector, Vector]:
    """Return the amount of one fault, if there is no other, and by how much it has moved the unknowns inside."""
    directions = _Directions(at, change)
    information, score = directions.evidence()
    amount, inside = inverse(information) @ score, at.set_up.inside
    return amount, (directions.imitated[:, inside] @ inverse(_hessian(at)[np.ix_(inside, inside)])).T @ amount
