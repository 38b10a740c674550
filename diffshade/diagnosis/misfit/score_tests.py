"""Score tests: what a small amount of a fault would change in the images, beside what the fit left over.

A fault such as vignetting changes the prediction along a direction d of image space. Of d the fitted unknowns, with the
Jacobian J, can imitate a part; what they cannot, d_perp = d - J (J^T J)^-1 J^T d, is at right angles to the residuals r
where the set-up is right: t = d_perp r / (sigma |d_perp|) is N(0, 1) (Rao 1948). Where it is not, the amount of the
fault is d_perp r / |d_perp|^2, and it moves the unknowns by -(J^T J)^-1 J^T d times that amount.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import special

from ...inverse.statistics.uncertainty import Matrix, Vector, inverse

LEAST_LEFT = 1e-6  # |d_perp|^2 / |d|^2, below which the unknowns imitate a fault, and nothing shows it


@dataclass(frozen=True, eq=False)
class Rows:
    """The samples of a fit as a linear problem at its end. A row is a sample; clipped ones may have no weight."""

    jacobian: Float[np.ndarray, "p n"]
    slope: Float[np.ndarray, " n"]
    """Of the cost in the prediction: weight times (prediction - photograph)."""
    weight: Float[np.ndarray, " n"]
    pixel: Int[np.ndarray, " n"]
    """The pixel of each row; the channels of a pixel may share their noise."""
    known_hessian: Matrix
    known_gradient: Vector
    """What is known of the unknowns beside the samples."""
    sigma2: float
    """The variance of a row of weight 1."""
    waves: Float[np.ndarray, "waves n"] | None = None
    """What rounding makes the rows vary by together (`rounding.sawtooth`); None without."""


@dataclass(frozen=True, eq=False)
class Score:
    """What the residuals say of one fault, which has one amount or a few."""

    amount: Float[np.ndarray, " k"]
    errors: Float[np.ndarray, " k"]
    """Standard errors of the amounts, for independent noise and rounding."""
    gain: float
    """By how much twice the cost would fall with the fault put right, over sigma^2: chi^2 of k degrees without it."""
    p_value: float
    moves: Vector
    """By how much the fault has moved each unknown: fitted less what it would be without the fault."""


class ScoreTests:
    """Score tests of faults at the end of a fit: each asks for what the unknowns cannot imitate."""

    def __init__(self, rows: Rows, with_it: Sequence[Float[np.ndarray, "k n"]] = ()):
        """Prepare tests; `with_it` are directions of faults already named, which count as unknowns."""
        self.rows, self.count = rows, len(rows.jacobian)
        self.jacobian = np.concatenate([rows.jacobian, *with_it]) if with_it else rows.jacobian
        p, more = len(self.jacobian), len(self.jacobian) - self.count
        known = np.zeros((p, p))
        known[: self.count, : self.count] = rows.known_hessian
        hessian = (self.jacobian * rows.weight) @ self.jacobian.T + known
        self.gradient = self.jacobian @ rows.slope + np.concatenate([rows.known_gradient, np.zeros(more)])
        self.inverse = inverse(hessian)

    def test(self, direction: Float[np.ndarray, "k n"]) -> Score | None:
        """Return what the residuals say of a fault along one direction or several; None where nothing can show it."""
        rows = self.rows
        weighed = direction * rows.weight
        to_unknowns = weighed @ self.jacobian.T @ self.inverse
        beyond = direction - to_unknowns @ self.jacobian
        information = weighed @ beyond.T
        information = 0.5 * (information + information.T)
        whole = np.sum(weighed * direction, 1)
        if not (np.diag(information) > LEAST_LEFT * np.maximum(whole, 1e-300)).all():
            return None
        score = direction @ rows.slope - to_unknowns @ self.gradient
        from_information = inverse(information)
        amount = -from_information @ score
        gain = float(score @ from_information @ score) / rows.sigma2
        covariance = rows.sigma2 * information
        if rows.waves is not None:
            of_rounding = (beyond * rows.weight) @ rows.waves.T
            covariance = covariance + of_rounding @ of_rounding.T
        chi2 = float(score @ inverse(covariance) @ score)
        # the channels of a pixel may share their noise, and the noise may differ from pixel to pixel
        left = rows.slope + rows.weight * (amount @ beyond)
        p_value = max(float(special.chdtrc(len(direction), chi2)), _p_value_by_pixels(beyond * left, rows.pixel, score))
        errors = np.sqrt(np.diag(from_information @ covariance @ from_information))
        return Score(amount, errors, gain, p_value, (to_unknowns.T @ amount)[: self.count])


def _p_value_by_pixels(each: Float[np.ndarray, "k n"], pixel: Int[np.ndarray, " n"], score: Vector) -> float:
    """Return the p-value of a score by the scatter of its parts over the pixels (White 1980)."""
    parts = np.array([np.bincount(pixel, row) for row in each])
    return float(special.chdtrc(len(each), score @ inverse(parts @ parts.T) @ score))
