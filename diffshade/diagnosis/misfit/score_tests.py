"""Score tests: whether the residuals contain the change of the images by a small fault of the setup.

A fault such as vignetting changes the prediction along a direction d of image space. The fitted unknowns, with the
Jacobian J, can imitate a part of d. The rest, d_perp = d - J (J^T J)^-1 J^T d, is orthogonal to the residuals r if the
setup is right: t = d_perp r / (sigma |d_perp|) is N(0, 1) (Rao 1948). Otherwise the amount of the fault is
d_perp r / |d_perp|^2, and it moves the unknowns by -(J^T J)^-1 J^T d times that amount.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse, special

from ...inverse.statistics.uncertainty import Matrix, Vector, inverse

FALSE_ALARM = 1e-4  # the significance level of every test of misfit: hundreds of them are made of one fit
CERTAIN_ERRORS = 3.9  # standard errors of a normal number at that level
MIN_INDEPENDENT_SHARE = 1e-6  # |d_perp|^2 / |d|^2; below it the unknowns imitate the fault, which is then undetectable


@dataclass(frozen=True, eq=False)
class Rows:
    """The samples of a fit as a linear problem at its minimum, a row each; a clipped sample may have weight 0."""

    jacobian: sparse.csr_array
    """The derivatives of n samples by p unknowns, (p, n): each view shows some of these alone."""
    slope: Float[np.ndarray, " n"]
    """The derivative of the cost by the prediction: weight times (prediction - photograph)."""
    weight: Float[np.ndarray, " n"]
    pixel: Int[np.ndarray, " n"]
    """The pixel of each row; the channels of a pixel may have correlated noise."""
    known_hessian: Matrix
    known_gradient: Vector
    """The gradient of the priors; `known_hessian` is their Hessian."""
    sigma2: float
    """The variance of a row with weight 1."""
    waves: Float[np.ndarray, "waves n"] | None = None
    """The correlated variation of the rows by rounding (`rounding.sawtooth`); None without rounding."""


@dataclass(frozen=True, eq=False)
class Score:
    """The result of the test of one fault, with one amount or several."""

    amount: Float[np.ndarray, " k"]
    gain: float
    """The decrease of twice the cost over sigma^2 with the fault corrected: chi^2 of k degrees if there is no fault."""
    p_value: float
    moves: Vector
    """How far the fault has moved each unknown: the fitted value minus the value without the fault."""


class ScoreTests:
    """Score tests of faults at the minimum of a fit, for the part of each fault that the unknowns cannot imitate."""

    def __init__(self, rows: Rows, named: Sequence[Float[np.ndarray, "k n"]] = ()):
        """Prepare tests; `named` are directions of faults already found, which count as unknowns."""
        self.rows, self.count = rows, len(rows.known_gradient)
        self.jacobian: Any = sparse.vstack([rows.jacobian, *map(np.atleast_2d, named)], format="csr")
        hessian, self.gradient = gram(self.jacobian, rows.weight), self.jacobian @ rows.slope
        hessian[: self.count, : self.count] += rows.known_hessian
        self.gradient[: self.count] += rows.known_gradient
        self.inverse = inverse(hessian)

    def test(self, direction: Float[np.ndarray, "k n"]) -> Score | None:
        """Test a fault along one direction or several; None if the unknowns can imitate it."""
        rows = self.rows
        weighed = direction * rows.weight
        to_unknowns = (self.jacobian @ weighed.T).T @ self.inverse
        beyond = direction - to_unknowns @ self.jacobian
        information = weighed @ beyond.T
        information = 0.5 * (information + information.T)
        whole = np.sum(weighed * direction, 1)
        if not (np.diag(information) > MIN_INDEPENDENT_SHARE * np.maximum(whole, 1e-300)).all():
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
        # The channels of a pixel may have correlated noise, and the noise may differ from pixel to pixel.
        left = rows.slope + rows.weight * (amount @ beyond)
        p_value = max(float(special.chdtrc(len(direction), chi2)), _p_value_by_pixels(beyond * left, rows.pixel, score))
        return Score(amount, gain, p_value, (to_unknowns.T @ amount)[: self.count])


def gram(jacobian: sparse.csr_array, weight: Float[np.ndarray, " n"]) -> Matrix:
    """Return J W J^T."""
    return ((jacobian * weight[None]) @ jacobian.T).toarray()


def _p_value_by_pixels(each: Float[np.ndarray, "k n"], pixel: Int[np.ndarray, " n"], score: Vector) -> float:
    """Return the p-value of a score by the scatter of its contributions over the pixels (White 1980)."""
    parts = np.array([np.bincount(pixel, row) for row in each])
    return float(special.chdtrc(len(each), score @ inverse(parts @ parts.T) @ score))
