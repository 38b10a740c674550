"""Uncertainty: error bars from p x p matrices, in NumPy float64."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import special

SINGULAR = 1e-6  # smallest singular value of J, columns of unit length, below which unknowns are not determined

Vector = Float[np.ndarray, " p"]
Matrix = Float[np.ndarray, "p p"]


def scaled(H: Matrix) -> tuple[Matrix, Vector]:
    """Return J^T J with the columns of J scaled to unit length, and their lengths; a zero column stays zero."""
    lengths = np.sqrt(np.diag(H))
    inverse = np.where(lengths > 0, 1.0 / np.where(lengths > 0, lengths, 1.0), 0.0)
    return H * np.outer(inverse, inverse), lengths


def inverse(H: Matrix) -> Matrix:
    """Return (J^T J)^-1 through the scaled matrix, null directions left out (they do not touch what is determined)."""
    A, lengths = scaled(H)
    w, V = np.linalg.eigh(A)
    regular = w > SINGULAR**2 * w.max(initial=0.0)
    unit = np.where(lengths > 0, 1.0 / np.where(lengths > 0, lengths, 1.0), 0.0)
    return (V[:, regular] / w[regular]) @ V[:, regular].T * np.outer(unit, unit)


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
    G, H_all = len(H), H.sum(0) + H_0
    moves = np.array([-inverse(H_all - H_v) @ (g_all - g_v) for H_v, g_v in zip(H, g, strict=True)])
    return np.sqrt((G - 1) / G) * (moves - moves.mean(0))


def jackknife_of_noise(H: Float[np.ndarray, "views p p"], H_0: Matrix) -> tuple[Vector, Vector]:
    """Return the variances that `jackknife_covariance` expects of independent noise of variance 1, and their freedom.

    With such noise, the gradient of view v has the covariance H_v - H_v H^-1 H_v. The variance a of the move without
    the view follows. The sum over views is about chi^2 with (sum a)^2 / sum a^2 degrees of freedom (Satterthwaite 1946;
    Bell and McCaffrey 2002).
    """
    whole = inverse(H.sum(0) + H_0)
    share = []
    for H_v in H:
        without = inverse(H.sum(0) + H_0 - H_v)
        share.append(np.diag(without @ (H_v - H_v @ whole @ H_v) @ without))
    a = np.maximum(np.array(share), 0.0)
    total = a.sum(0)
    return (len(H) - 1) / len(H) * total, total**2 / np.maximum((a**2).sum(0), 1e-300)


def single_views(H: Float[np.ndarray, "views p p"]) -> Int[np.ndarray, " p"]:
    """Return for each unknown the one view that alone sees it, such as the view's own exposure; -1 where several do."""
    seen = np.diagonal(H, axis1=1, axis2=2)
    sees = seen > 1e-12 * seen.max(0, initial=0.0)
    return np.where(sees.sum(0) == 1, sees.argmax(0), -1)


def without_single_views(
    H: Float[np.ndarray, "views p p"],
    g: Float[np.ndarray, "views p *_"],
    H_0: Matrix,
    single_view: Int[np.ndarray, " p"],
) -> tuple[Float[np.ndarray, "views s s"], Float[np.ndarray, "views s *_"]]:
    """Return the Gram of each view for the unknowns that several views see, minimised over those that it alone sees.

    The Schur complement: a view that is deleted takes its own unknowns with it.
    """
    shared = single_view < 0
    reduced_H, reduced_g = [], []
    for v, (H_v, g_v) in enumerate(zip(H, g, strict=True)):
        own = single_view == v
        to_own = H_v[np.ix_(shared, own)] @ inverse((H_v + H_0)[np.ix_(own, own)])
        reduced_H.append(H_v[np.ix_(shared, shared)] - to_own @ H_v[np.ix_(own, shared)])
        reduced_g.append(g_v[shared] - to_own @ g_v[own])
    return np.array(reduced_H), np.array(reduced_g)


def deciding_view(H: Float[np.ndarray, "views p p"], H_0: Matrix) -> int | None:
    """Return a view without which fewer unknowns are determined, so that no jackknife is possible; or None."""

    def rank(H: Matrix) -> int:
        w = np.linalg.eigvalsh(scaled(H)[0])
        return int(np.sum(w > SINGULAR**2 * w.max(initial=0.0)))

    everything = H.sum(0) + H_0
    return next((v for v in range(len(H)) if rank(everything - H[v]) < rank(everything)), None)


def on_unit_vectors(covariance: Matrix, values: Vector, units: Int[np.ndarray, "u 3"]) -> Matrix:
    """Return the covariance without the lengths of unit vectors, which do not vary: P C P with P = 1 - d d^T."""
    P = np.eye(len(values))
    for unit in units:
        P[np.ix_(unit, unit)] -= np.outer(values[unit], values[unit])
    return P @ covariance @ P


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


@dataclass(frozen=True, eq=False)
class Evidence:
    """The information in the samples at the end of a fit, in the values' own units: the Gram of each cluster.

    A cluster has samples whose errors may be correlated: a view, or a patch of one.
    """

    hessian: Float[np.ndarray, "clusters p p"]
    gradient: Float[np.ndarray, "clusters p"]
    known_hessian: Matrix
    """The Gram of the priors and unit vectors."""
    known_gradient: Vector
    values: Vector
    at_bound: Bool[np.ndarray, " p"]
    regular: Bool[np.ndarray, " p"]
    """Whether the clusters together say anything about the value: it is not singular."""
    units: Int[np.ndarray, "u 3"]
    """The unknowns that are a unit vector together."""
    sigma2: float
    """The factor of H^-1 in the covariance for independent noise."""
    spread: Float[np.ndarray, "5"]
    """Sums over the samples that were measured (`Likelihood.spread`): their number, r^2, psi^2, psi', rho'."""
    waves: Float[np.ndarray, "clusters p waves"] | None = None
    """A^T of each cluster, where A^T A is the gradients' covariance by rounding (`rounding`); None without rounding."""
    shared: float = 0.0
    """The fraction of sigma2 that comes from the rounding in the waves: from 0, if noise hides it, to 1."""
    steps: str = ""
    """The steps of the files in words."""

    @property
    def total(self) -> Matrix:
        """The Gram of everything."""
        return self.hessian.sum(0) + self.known_hessian

    @property
    def loss_ratio(self) -> float:
        """The ratio of the weights rho' of a robust loss, which H has, to the slopes psi', by which clusters move."""
        count, _, _, slope, weight = self.spread
        return float(weight / max(slope, 1e-3 * count))

    @property
    def single_view(self) -> Int[np.ndarray, " p"]:
        """For each unknown the one cluster that alone sees it; -1 where several do, or there is but one."""
        none = np.full(len(self.values), -1)
        return np.where(self.regular, single_views(self.hessian), none) if len(self.hessian) > 1 else none

    def covariance(self, which: Bool[np.ndarray, " p"]) -> Float[np.ndarray, "s s"]:
        """Return the plain covariance of a subset of the unknowns, the others held."""
        inner = np.ix_(which, which)
        return self._on_units(plain_covariance(self.total[inner], self.sigma2), which)

    def clustered_covariance(self, which: Bool[np.ndarray, " p"]) -> Float[np.ndarray, "s s"]:
        """Return the covariance by deleting one cluster at a time; the plain one for what one cluster alone sees."""
        covariance, several, kept = self.covariance(which), self.single_view[which] < 0, which & (self.single_view < 0)
        jackknife = jackknife_covariance(*self._shared(which))
        covariance[np.ix_(several, several)] = self.loss_ratio**2 * self._on_units(jackknife, kept)
        return covariance

    def _shared(self, which: Bool[np.ndarray, " p"]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return H and g of each cluster, and of the priors, for the unknowns of a subset that several clusters see."""
        kept = which & (self.single_view < 0)
        H, g = self.hessian[:, which][:, :, which], self.gradient[:, which]
        H, g = without_single_views(H, g, self.known_hessian[np.ix_(which, which)], self.single_view[which])
        return H, g, self.known_hessian[np.ix_(kept, kept)], self.known_gradient[kept]

    def _shared_waves(self, which: Bool[np.ndarray, " p"]) -> Float[np.ndarray, "clusters s waves"]:
        assert self.waves is not None
        H, known = self.hessian[:, which][:, :, which], self.known_hessian[np.ix_(which, which)]
        return without_single_views(H, self.waves[:, which], known, self.single_view[which])[1]

    def plain_errors(self) -> Vector:
        """Return the standard errors for independent noise; infinite where nothing is determined."""
        return np.where(self.regular, standard_errors(self.covariance, self.at_bound), np.inf)

    def clustered_errors(self) -> Vector:
        """Return the standard errors by deleting one cluster at a time; infinite where nothing is determined."""
        return np.where(self.regular, standard_errors(self.clustered_covariance, self.at_bound), np.inf)

    def rounding_errors(self) -> Vector:
        """Return what rounding adds to the standard errors, by the sum of squares; 0 without rounding.

        The residuals contain rounding too, as if it were independent; that part is not counted twice.
        """
        if self.waves is None:
            return np.zeros(len(self.values))
        whole = standard_errors(self._rounding_covariance, self.at_bound)
        counted = self.shared * standard_errors(self.covariance, self.at_bound) ** 2
        return np.where(self.regular, np.sqrt(np.maximum(whole**2 - counted, 0.0)), 0.0)

    def _rounding_covariance(self, which: Bool[np.ndarray, " p"]) -> Float[np.ndarray, "s s"]:
        assert self.waves is not None
        moves = inverse(self.total[np.ix_(which, which)]) @ self.waves.sum(0)[which]
        return self._on_units(moves @ moves.T, which)

    def deciding(self) -> int | None:
        """Return a cluster without which fewer unknowns are determined, so that no jackknife is possible; or None."""
        H, _, known, _ = self._shared(np.ones(len(self.values), bool))
        return deciding_view(H, known)

    def independence_p_values(self) -> tuple[Vector, Vector]:
        """Return for each unknown the p-value of its jackknife variance if the noise were independent, and its freedom.

        No unknown is held at a bound. The degrees of freedom, for Student's t, are the clusters less one, or fewer if a
        few of them decide. What one cluster alone sees has no jackknife: p-value 1, infinitely many degrees.
        """
        p_value, freedom = np.ones(len(self.values)), np.full(len(self.values), np.inf)
        kept = self.regular & (self.single_view < 0)
        if len(self.hessian) < 3 or not kept.any():
            return p_value, freedom
        H, g, known, slope = self._shared(self.regular)
        variance = self.loss_ratio**2 * np.diag(jackknife_covariance(H, g, known, slope))
        expected, of_noise = jackknife_of_noise(H, known)
        expected = self.sigma2 * expected
        if self.waves is not None:  # each a normal number
            waves = self._shared_waves(self.regular)
            each = self.loss_ratio**2 * np.sum(jackknife_deviations(H, waves, known, waves.sum(0)) ** 2, 0)
            both = expected + each.sum(-1)
            of_noise = both**2 / np.maximum(expected**2 / of_noise + np.sum(each**2, -1), 1e-300)
            expected = both
        freedom[kept] = np.clip(of_noise, 1.0, len(H) - 1.0)
        ratio = np.where(expected > 0, variance / np.where(expected > 0, expected, 1.0), 0.0)
        p_value[kept] = special.chdtrc(freedom[kept], freedom[kept] * ratio)
        return p_value, freedom

    def scatter(self) -> tuple[float, float]:
        """Return the variance of the clusters' own optima, over that expected from independent noise, and its p-value.

        At the optimum the gradients g_c of the clusters add up to 0. With independent noise each has the covariance
        sigma^2 H_c, so that sum g_c H_c^+ g_c / sigma^2 is chi^2 with as many degrees of freedom as the clusters have
        unknowns of their own, less those fitted (White 1982, the information matrix test). The residuals within the
        clusters give sigma^2. The gradients' variance by rounding is added to the expected one, and the degrees of
        freedom are those of the sum (Satterthwaite 1946).
        """
        count, _, psi2, _, weight = self.spread
        inside = self.regular & ~self.at_bound
        fitted = np.sum(inside) - len(self.units)
        between, freedom = 0.0, -float(fitted)
        waves = self._own_waves(inside)
        rounding = np.zeros((waves.shape[-1], waves.shape[-1]))
        for H, g, A_c in zip(self.hessian[:, inside][:, :, inside], self.gradient[:, inside], waves, strict=True):
            A, lengths = scaled(H)
            w, V = np.linalg.eigh(A)
            seen = w > 1e-9 * w.max(initial=0.0)
            unit = np.where(lengths > 0, 1.0 / np.where(lengths > 0, lengths, 1.0), 0.0)
            turned, of_waves = (V.T @ (unit * g))[seen], (V.T @ (unit[:, None] * A_c))[seen]
            between += float(np.sum(turned**2 / w[seen]) * weight / count)
            rounding += of_waves.T @ (of_waves / w[seen, None]) * weight / count
            freedom += float(np.sum(seen))
        within = count - fitted - freedom
        if freedom <= 0 or within <= 0 or not between < psi2:
            return 1.0, 1.0
        noise = (psi2 - between) / within
        expected = freedom * noise + np.trace(rounding)
        freedom = expected**2 / (freedom * noise**2 + np.sum(rounding**2))
        return float(between / expected), float(special.fdtrc(freedom, within, between / expected))

    def _own_waves(self, which: Bool[np.ndarray, " p"]) -> Float[np.ndarray, "clusters s waves"]:
        """Return the waves of the clusters' gradients by rounding at the optimum, where the gradients add up to 0."""
        if self.waves is None:
            return np.zeros((len(self.hessian), int(which.sum()), 0))
        moves = inverse(self.total[np.ix_(which, which)]) @ self.waves.sum(0)[which]
        return self.waves[:, which] - self.hessian[:, which][:, :, which] @ moves

    def _on_units(self, covariance: np.ndarray, which: Bool[np.ndarray, " p"]) -> np.ndarray:
        whole = np.zeros((len(which), len(which)))
        whole[np.ix_(which, which)] = covariance
        return on_unit_vectors(whole, self.values, self.units)[np.ix_(which, which)]
