"""Directions: what the residuals say of changes of the pictures beyond the unknowns, and how these move the unknowns.

What the unknowns can imitate of a direction of image space moves them, and the rest shows in the residuals (Rao 1948).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from ..statistics.uncertainty import Matrix, Vector, inverse
from ..unknowns.unknown import coordinate_slopes
from .changes import Case, Move
from .found import Fault
from .linearised import Linearised


@dataclass(frozen=True, eq=False)
class Directions:
    """Directions of image space where a set-up was linearised."""

    at: Linearised
    changes: Float[np.ndarray, "k n"]
    """The change of each sample by an amount of 1."""

    @cached_property
    def imitated(self) -> Float[np.ndarray, "k numbers"]:
        """The products with the derivatives by each number of the set-up."""
        return np.asarray((self.at.jacobian @ (self.changes * self.at.weight).T).T)

    @cached_property
    def moves_inside(self) -> Float[np.ndarray, "k inside"]:
        """How far each direction moves the unknowns that are at no bound, in the solver's coordinates."""
        inside = self.at.set_up.inside
        return self.imitated[:, inside] @ inverse(hessian(self.at)[np.ix_(inside, inside)])

    def evidence(self) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, " k"]]:
        """Return the information on the amounts beyond the unknowns, for a variance of 1, and the score."""
        at, inside = self.at, self.at.set_up.inside
        J = at.jacobian[inside]
        information = (self.changes * at.weight) @ (self.changes - self.moves_inside @ J).T
        score = self.moves_inside @ (J @ at.slope + at.known_gradient[inside]) - self.changes @ at.slope
        w, V = np.linalg.eigh(0.5 * (information + information.T))
        return (V * np.maximum(w, 0.0)) @ V.T, score  # what the unknowns imitate has none, but for rounding

    def moves(self) -> tuple[Float[np.ndarray, "k p"], Vector]:
        """Return how far each direction moves the values of the fit, and their errors by the samples' own scatter.

        The errors hold whatever the noise of each sample is (White 1980). Priors weigh as much beside the samples as
        they do in the whole fit. An unknown at a bound moves with all others that are at none.
        """
        at, fit, own = self.at, self.at.set_up.fit, self.at.set_up.own
        part = at.count / max(float(fit.evidence.spread[0]), 1.0)
        H = hessian(at, part)
        scatter = ((at.jacobian[:own] * at.slope[None] ** 2) @ at.jacobian[:own].T).toarray()
        moves, variance = np.zeros((len(self.changes), own)), np.zeros(own)
        for j in (None, *np.flatnonzero(fit.at_bound).tolist()):
            which = at.set_up.inside if j is None else np.append(at.set_up.inside, j)
            of_which = np.arange(len(which)) if j is None else np.array([len(which) - 1])
            inverted = inverse(H[np.ix_(which, which)])
            moves[:, which[of_which]] = (self.imitated[:, which] @ inverted)[:, of_which]
            variance[which[of_which]] = part * np.diag(inverted @ scatter[np.ix_(which, which)] @ inverted)[of_which]
        slope = coordinate_slopes(fit.values, fit.unknowns)
        return moves / slope, np.sqrt(variance) / np.abs(slope)


def hessian(at: Linearised, priors: float = 1.0) -> Matrix:
    """Return J W J^T of all numbers of a set-up, with that of the priors times a factor."""
    return ((at.jacobian * at.weight[None]) @ at.jacobian.T).toarray() + priors * at.known_hessian


def changes_of(at: Linearised, fault: Fault) -> list[tuple[Case, Float[np.ndarray, "k n"]]]:
    """Return the cases of a fault with the change of each sample by it, where that is linear and finite."""
    found = []
    for case in fault.cases(at) if fault.cases else ():
        change = case.change.rows @ at.jacobian if isinstance(case.change, Move) else case.change
        change = change if fault.at_rims else np.where(at.at_rims, 0.0, change)
        if np.isfinite(change).all() and change.any():
            found.append((case, np.asarray(change)))
    return found


def amount_alone(at: Linearised, change: Float[np.ndarray, "k n"]) -> tuple[Vector, Vector]:
    """Return the amount of one fault, if there is no other, and how far it has moved the unknowns at no bound."""
    directions = Directions(at, change)
    information, score = directions.evidence()
    amount = inverse(information) @ score
    return amount, amount @ directions.moves_inside
