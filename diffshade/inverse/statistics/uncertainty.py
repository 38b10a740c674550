"""Uncertainty: error bars from p x p matrices, in NumPy float64."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.thresholds import SINGLE

SINGULAR = SINGLE  # smallest singular value of J, columns of unit length, below which unknowns are not determined

Vector = Float[np.ndarray, " p"]
Matrix = Float[np.ndarray, "p p"]
Matrices = Float[np.ndarray, "... p p"]


def scaled(H: Matrices) -> tuple[Matrices, Float[np.ndarray, "... p"]]:
    """Return J^T J with the columns of J scaled to unit length, and their lengths; a zero column stays zero."""
    lengths = np.sqrt(np.diagonal(H, axis1=-2, axis2=-1))
    unit = over(lengths)
    return H * unit[..., :, None] * unit[..., None, :], lengths


def over(numbers: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return 1/numbers; 0 where a number is not above 0."""
    return np.where(numbers > 0, 1.0 / np.where(numbers > 0, numbers, 1.0), 0.0)


def regular_inverse(A: Matrix, least: float) -> Matrix | None:
    """Return the inverse of a matrix whose smallest eigenvalue is surely at least `least` of its largest; else None.

    It is where |A| |A^-1| is below 1/least, in the largest sum of a column. This takes a twentieth of the time of the
    eigenvalues.
    """
    try:
        C = np.linalg.inv(A)
    except np.linalg.LinAlgError:  # singular
        return None
    sure = np.abs(A).sum(0).max(initial=0.0) * np.abs(C).sum(0).max(initial=0.0) < 1.0 / least
    return C if sure and (np.diag(C) > 0.0).all() else None


def inverse(H: Matrices) -> Matrices:
    """Return (J^T J)^-1 through the scaled matrix, null directions left out (they do not touch what is determined).

    A leading axis is that of many matrices.
    """
    A, lengths = scaled(H)
    C = regular_inverse(A, SINGULAR**2) if A.ndim == 2 else None
    if C is None:
        w, V = np.linalg.eigh(A)
        regular = w > SINGULAR**2 * w.max(-1, initial=0.0, keepdims=True)
        C = (V * over(np.where(regular, w, 0.0))[..., None, :]) @ np.swapaxes(V, -1, -2)
    unit = over(lengths)
    return C * unit[..., :, None] * unit[..., None, :]


@dataclass(frozen=True, eq=False)
class Jackknife:
    """Optima without one view at a time, to first order, from the Gram of each view.

    Without view v the optimum moves by -(H - H_v)^-1 (g - g_v). The covariance is (G-1)/G times the sum of squared
    deviations of these moves from their mean (Tukey 1958; Efron and Tibshirani 1993, ch. 11); t has G - 1 degrees.
    """

    hessian: Float[np.ndarray, "views p p"]
    known: Matrix
    """The Hessian of the priors, which are never deleted."""

    @cached_property
    def everything(self) -> Matrix:
        """The Hessian of all views and the priors."""
        return self.hessian.sum(0) + self.known

    @cached_property
    def without(self) -> Float[np.ndarray, "views p p"]:
        """The inverse of the Hessian without each view."""
        return inverse(self.everything - self.hessian)

    def deviations(
        self, gradient: Float[np.ndarray, "views p k"], known: Float[np.ndarray, "p k"]
    ) -> Float[np.ndarray, "views p k"]:
        """Return the distances of the optima without each view from their mean, times sqrt((G-1)/G).

        Args:
            gradient: k gradients of each view.
            known: Those of the priors.
        """
        G = len(self.hessian)
        moves = self.without @ (gradient.sum(0) + known - gradient)
        return np.sqrt((G - 1) / G) * (moves - moves.mean(0))

    def of_noise(self) -> tuple[Vector, Vector]:
        """Return the variances that the jackknife expects of independent noise of variance 1, and their freedom.

        With such noise, the gradient of view v has the covariance H_v - H_v H^-1 H_v. The variance a of the move
        without the view follows. The sum over views is about chi^2 with (sum a)^2 / sum a^2 degrees of freedom
        (Satterthwaite 1946; Bell and McCaffrey 2002).
        """
        H, G = self.hessian, len(self.hessian)
        share = np.diagonal(self.without @ (H - H @ inverse(self.everything) @ H) @ self.without, axis1=1, axis2=2)
        a = np.maximum(share, 0.0)
        total = a.sum(0)
        return (G - 1) / G * total, total**2 / np.maximum((a**2).sum(0), 1e-300)

    def deciding(self) -> int | None:
        """Return a view without which fewer unknowns are determined, so that no jackknife is possible; or None."""

        def rank(H: Matrices) -> Int[np.ndarray, "..."]:
            w = np.linalg.eigvalsh(scaled(H)[0])
            return np.asarray(np.sum(w > SINGULAR**2 * w.max(-1, initial=0.0, keepdims=True), -1))

        fewer = np.flatnonzero(rank(self.everything - self.hessian) < rank(self.everything))
        return int(fewer[0]) if len(fewer) else None


def on_unit_vectors(covariance: Matrix, values: Vector, units: Int[np.ndarray, "u 3"]) -> Matrix:
    """Return the covariance without the lengths of unit vectors, which do not vary: P C P with P = 1 - d d^T."""
    turned, d = covariance.copy(), values[units]
    turned[units] -= d[:, :, None] * np.einsum("ui,uij->uj", d, turned[units])[:, None]
    turned[:, units] -= np.einsum("jui,ui->ju", turned[:, units], d)[:, :, None] * d
    return turned


def standard_errors(covariance: Callable[[Bool[np.ndarray, " p"]], Matrix], at_bound: Bool[np.ndarray, " p"]) -> Vector:
    """Return the standard errors, given the covariance with all but a subset of the unknowns held.

    Unknowns at a bound do not move, so the others' errors hold them fixed. The error of an unknown at a bound is that
    which it would have if it alone could pass its bound.
    """
    variance = np.diag(covariance(~at_bound)).copy()
    for j in np.flatnonzero(at_bound):
        variance[j] = covariance(~at_bound | (np.arange(len(at_bound)) == j))[j, j]
    return np.sqrt(variance)
