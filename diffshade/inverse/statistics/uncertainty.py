"""Uncertainty: error bars from p x p matrices, in NumPy float64."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from jaxtyping import Bool, Float, Int

from .arrowheads import regular_inverse

SINGULAR = 1e-6  # smallest singular value of J, columns of unit length, below which unknowns are not determined

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


def inverse(H: Matrices) -> Matrices:
    """Return (J^T J)^-1 through the scaled matrix, null directions left out (they do not touch what is determined).

    A matrix of many unknowns that touch few others is inverted block by block; a leading axis is that of many matrices.
    """
    A, lengths = scaled(H)
    C = regular_inverse(A, SINGULAR**2) if A.ndim == 2 else None
    if C is None:
        w, V = np.linalg.eigh(A)
        regular = w > SINGULAR**2 * w.max(-1, initial=0.0, keepdims=True)
        C = (V * over(np.where(regular, w, 0.0))[..., None, :]) @ np.swapaxes(V, -1, -2)
    unit = over(lengths)
    return C * unit[..., :, None] * unit[..., None, :]


def plain_covariance(H: Matrix, sigma2: float) -> Matrix:
    """Return sigma^2 (J^T J)^-1, the covariance for independent noise of equal variance sigma^2."""
    return sigma2 * inverse(H)


def jackknife_covariance(
    H: Float[np.ndarray, "views p p"], g: Float[np.ndarray, "views p"], H_0: Matrix, g_0: Vector
) -> Matrix:
    """Return the covariance by deleting one view at a time, from the Gram of each view; t has views - 1 degrees.

    H_0 and g_0 are those of the priors, which are never deleted.

    Without view v the optimum moves, to first order, by -(H - H_v)^-1 (g - g_v); the covariance is (G-1)/G times the
    sum of squared deviations of these moves from their mean (Tukey 1958; Efron and Tibshirani 1993, ch. 11).
    """
    deviations = jackknife_deviations(H, g, H_0, g.sum(0) + g_0)
    return deviations.T @ deviations


def jackknife_deviations(
    H: Float[np.ndarray, "views p p"], g: Float[np.ndarray, "views p *_"], H_0: Matrix, g_all: Float[np.ndarray, "p *_"]
) -> Float[np.ndarray, "views p *_"]:
    """Return the distances of the optima without each view from their mean, times sqrt((G-1)/G); g may have columns."""
    G = len(H)
    moves = np.einsum("vij,vj...->vi...", inverse(H.sum(0) + H_0 - H), g - g_all)
    return np.sqrt((G - 1) / G) * (moves - moves.mean(0))


def jackknife_of_noise(H: Float[np.ndarray, "views p p"], H_0: Matrix) -> tuple[Vector, Vector]:
    """Return the variances that `jackknife_covariance` expects of independent noise of variance 1, and their freedom.

    With such noise, the gradient of view v has the covariance H_v - H_v H^-1 H_v. The variance a of the move without
    the view follows. The sum over views is about chi^2 with (sum a)^2 / sum a^2 degrees of freedom (Satterthwaite 1946;
    Bell and McCaffrey 2002).
    """
    everything = H.sum(0) + H_0
    without = inverse(everything - H)
    share = np.diagonal(without @ (H - H @ inverse(everything) @ H) @ without, axis1=1, axis2=2)
    a = np.maximum(share, 0.0)
    total = a.sum(0)
    return (len(H) - 1) / len(H) * total, total**2 / np.maximum((a**2).sum(0), 1e-300)


def single_views(seen: Float[np.ndarray, "views p"]) -> Int[np.ndarray, " p"]:
    """Return for each unknown the one view that alone sees it, such as the view's own exposure; -1 where several do.

    `seen` has the diagonal of each view's Gram.
    """
    sees = seen > 1e-12 * seen.max(0, initial=0.0)
    return np.where(sees.sum(0) == 1, sees.argmax(0), -1)


def without_single_views(
    grams: Iterable[tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m m"], Float[np.ndarray, "m *_"]]],
    H_0: Matrix,
    single_view: Int[np.ndarray, " p"],
) -> tuple[Float[np.ndarray, "views s s"], Float[np.ndarray, "views s *_"]]:
    """Return the Gram of each view for the unknowns that several views see, minimised over those that it alone sees.

    `grams` has for each view the indices of the unknowns that it shows, and its H and g for them. The Schur complement:
    a view that is deleted takes its own unknowns with it.
    """
    number, s = np.cumsum(single_view < 0) - 1, int(np.sum(single_view < 0))
    reduced_H, reduced_g = [], []
    for v, (index, H_v, g_v) in enumerate(grams):
        own, several = single_view[index] == v, single_view[index] < 0
        prior = H_0[np.ix_(index[own], index[own])]
        to_own = H_v[np.ix_(several, own)] @ inverse(H_v[np.ix_(own, own)] + prior)
        H, g, at = np.zeros((s, s)), np.zeros((s, *g_v.shape[1:])), number[index[several]]
        H[np.ix_(at, at)] = H_v[np.ix_(several, several)] - to_own @ H_v[np.ix_(own, several)]
        g[at] = g_v[several] - to_own @ g_v[own]
        reduced_H.append(H)
        reduced_g.append(g)
    return np.array(reduced_H), np.array(reduced_g)


def deciding_view(H: Float[np.ndarray, "views p p"], H_0: Matrix) -> int | None:
    """Return a view without which fewer unknowns are determined, so that no jackknife is possible; or None."""

    def rank(H: Matrices) -> Int[np.ndarray, "..."]:
        w = np.linalg.eigvalsh(scaled(H)[0])
        return np.asarray(np.sum(w > SINGULAR**2 * w.max(-1, initial=0.0, keepdims=True), -1))

    everything = H.sum(0) + H_0
    fewer = np.flatnonzero(rank(everything - H) < rank(everything))
    return int(fewer[0]) if len(fewer) else None


def on_unit_vectors(covariance: Matrix, values: Vector, units: Int[np.ndarray, "u 3"]) -> Matrix:
    """Return the covariance without the lengths of unit vectors, which do not vary: P C P with P = 1 - d d^T."""
    turned, d = covariance.copy(), values[units]
    turned[units] -= d[:, :, None] * np.einsum("ui,uij->uj", d, turned[units])[:, None]
    turned[:, units] -= np.einsum("jui,ui->ju", turned[:, units], d)[:, :, None] * d
    return turned


def standard_errors(covariance: Callable[[Bool[np.ndarray, " p"]], Matrix], at_bound: Bool[np.ndarray, " p"]) -> Vector:
    """Return the standard errors, given the covariance of any subset of the unknowns.

    Unknowns at a bound do not move, so the others' errors hold them fixed. The error of an unknown at a bound is that
    which it would have if it alone could pass its bound.
    """
    inside = ~at_bound
    errors = np.zeros(len(at_bound))
    errors[inside] = np.sqrt(np.diag(covariance(inside)))
    for j in np.flatnonzero(at_bound):
        which = inside.copy()
        which[j] = True
        errors[j] = np.sqrt(np.diag(covariance(which))[np.flatnonzero(which) == j][0])
    return errors
