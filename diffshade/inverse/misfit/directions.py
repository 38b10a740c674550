"""Directions: what the residuals say of changes of the pictures beyond the unknowns, and how these move the unknowns.

What the unknowns can imitate of a direction of image space moves them, and the rest shows in the residuals (Rao 1948).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from ..statistics.uncertainty import Matrix, Vector, inverse
from .changes import Case, Move
from .found import Fault
from .linearised import Linearised


@dataclass(frozen=True, eq=False)
class Directions:
    """Directions of image space where a set-up was linearised."""

    at: Linearised
    changes: Float[np.ndarray, "k n"]
    """The change of each sample by an amount of 1."""
    inside: Int[np.ndarray, " inside"]
    """The unknowns that are at no bound."""

    @cached_property
    def imitated(self) -> Float[np.ndarray, "k numbers"]:
        """The products with the derivatives by each number of the set-up."""
        return np.asarray((self.at.jacobian @ (self.changes * self.at.weight).T).T)

    @cached_property
    def inverse_inside(self) -> Float[np.ndarray, "inside inside"]:
        """The inverse of the Hessian of the unknowns that are at no bound."""
        return inverse(hessian(self.at)[np.ix_(self.inside, self.inside)])

    @cached_property
    def moves_inside(self) -> Float[np.ndarray, "k inside"]:
        """How far each direction moves the unknowns that are at no bound, in the solver's coordinates."""
        return self.imitated[:, self.inside] @ self.inverse_inside

    @cached_property
    def gradient(self) -> Float[np.ndarray, " inside"]:
        """The derivative of half the cost by these unknowns: 0 at a minimum."""
        return np.asarray(self.at.jacobian[self.inside] @ self.at.slope + self.at.known_gradient[self.inside])

    @cached_property
    def step(self) -> Float[np.ndarray, " inside"]:
        """The step to the minimum without any fault."""
        return -self.inverse_inside @ self.gradient

    @property
    def squares(self) -> float:
        """The sum of squares of the whitened residuals at that minimum."""
        at = self.at
        return float(np.sum(at.slope**2 / np.where(at.weight > 0, at.weight, 1.0)) + self.gradient @ self.step)

    def evidence(self) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, " k"]]:
        """Return the information on the amounts beyond the unknowns, for a variance of 1, and the score."""
        at = self.at
        information = (self.changes * at.weight) @ (self.changes - self.moves_inside @ at.jacobian[self.inside]).T
        score = self.moves_inside @ self.gradient - self.changes @ at.slope
        w, V = np.linalg.eigh(0.5 * (information + information.T))
        return (V * np.maximum(w, 0.0)) @ V.T, score  # what the unknowns imitate has none, but for rounding

    def moves(self) -> Float[np.ndarray, "k numbers"]:
        """Return how far each direction moves the fit's unknowns, in the solver's coordinates.

        An unknown that is at a bound moves with all others that are at none.
        """
        moves = np.zeros((len(self.changes), self.at.set_up.own))
        for which, of_which, inverted in self._inverses():
            moves[:, which[of_which]] = (self.imitated[:, which] @ inverted)[:, of_which]
        return moves

    def errors(self) -> Vector:
        """Return the unknowns' errors by the samples' own scatter, whatever the noise of each sample (White 1980)."""
        at, own = self.at, self.at.set_up.own
        scatter = ((at.jacobian[:own] * at.slope[None] ** 2) @ at.jacobian[:own].T).toarray()
        variance = np.zeros(own)
        for which, of_which, inverted in self._inverses():
            variance[which[of_which]] = np.diag(inverted @ scatter[np.ix_(which, which)] @ inverted)[of_which]
        return np.sqrt(self._part * variance)

    @property
    def _part(self) -> float:
        """The part of the samples of the whole fit that is looked at: its priors weigh as much beside these."""
        return self.at.count / max(float(self.at.fit.evidence.spread[0]), 1.0)

    def _inverses(self) -> Iterator[tuple[Int[np.ndarray, " m"], Int[np.ndarray, " of"], Matrix]]:
        """Yield the inverse of the Hessian of the unknowns inside, and with each at a bound; which it is to tell of."""
        H, inside = hessian(self.at, self._part), self.inside
        yield inside, np.arange(len(inside)), inverse(H[np.ix_(inside, inside)])
        for j in np.setdiff1d(np.arange(self.at.set_up.own), inside):
            which = np.append(inside, j)
            yield which, np.array([len(inside)]), inverse(H[np.ix_(which, which)])


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


def amount_alone(
    at: Linearised, change: Float[np.ndarray, "k n"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " inside"]]:
    """Return the amount of one fault, if there is no other, and how far it has moved the unknowns at no bound."""
    directions = Directions(at, change, np.flatnonzero(~at.set_up.fit.at_bound))
    information, score = directions.evidence()
    amount = inverse(information) @ score
    return amount, amount @ directions.moves_inside
