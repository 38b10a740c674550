"""Evidence: what the samples of a fit say about its unknowns, as the Gram of each cluster, and the errors from it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import special

from .uncertainty import (
    Matrix,
    Vector,
    deciding_view,
    inverse,
    jackknife_covariance,
    jackknife_deviations,
    jackknife_of_noise,
    on_unit_vectors,
    over,
    plain_covariance,
    scaled,
    single_views,
    standard_errors,
    without_single_views,
)

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Evidence:
    """The information in the samples at the end of a fit, in the values' own units: the Gram of each cluster.

    A cluster has samples whose errors may be correlated: a view, or a patch of one.
    """

    hessian: Float[np.ndarray, "clusters m m"]
    """Of the unknowns that each cluster shows."""
    gradient: Float[np.ndarray, "clusters m"]
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
    shown: Int[np.ndarray, "clusters m"] | None = None
    """The indices of the unknowns that each cluster shows, padded with their number; None where each shows all."""

    @cached_property
    def total(self) -> Matrix:
        """The Gram of everything."""
        if self.shown is None:
            return self.hessian.sum(0) + self.known_hessian
        total = self.known_hessian.copy()
        for index, H, _ in self._grams(self._all):
            total[np.ix_(index, index)] += H
        return total

    @property
    def _all(self) -> Bool[np.ndarray, " p"]:
        return np.ones(len(self.values), bool)

    def _grams(
        self, which: Bool[np.ndarray, " p"], waves: Float[np.ndarray, "clusters p waves"] | None = None
    ) -> Iterator[tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m m"], Float[np.ndarray, "m *_"]]]:
        """Yield for each cluster the indices of some of the unknowns that it shows, and H and g, or waves, for them.

        The indices are those within `which`.
        """
        p = len(self.values)
        number = np.cumsum(which) - 1
        for c, (H, g) in enumerate(zip(self.hessian, self.gradient, strict=True)):
            shown = np.arange(p) if self.shown is None else self.shown[c]
            here = np.append(which, False)[shown]
            index = shown[here]
            yield number[index], H[np.ix_(here, here)], g[here] if waves is None else waves[c][index]

    @property
    def loss_ratio(self) -> float:
        """The ratio of the weights rho' of a robust loss, which H has, to the slopes psi', by which clusters move."""
        count, _, _, slope, weight = self.spread
        return float(weight / max(slope, 1e-3 * count))

    @cached_property
    def single_view(self) -> Int[np.ndarray, " p"]:
        """For each unknown the one cluster that alone sees it; -1 where several do, or there is but one."""
        none = np.full(len(self.values), -1)
        if len(self.hessian) == 1:
            return none
        seen = np.zeros((len(self.hessian), len(self.values)))
        for row, (index, H, _) in zip(seen, self._grams(self._all), strict=True):
            row[index] = np.diag(H)
        return np.where(self.regular, single_views(seen), none)

    def of(self, which: Bool[np.ndarray, " p"]) -> Evidence:
        """Return the evidence for some of the unknowns, the others held."""
        number = np.cumsum(which) - 1
        if self.shown is None:
            grams = {"hessian": self.hessian[:, which][:, :, which], "gradient": self.gradient[:, which]}
        else:
            grams = {"shown": np.append(np.where(which, number, which.sum()), which.sum())[self.shown]}
        return dataclasses.replace(
            self,
            **grams,
            known_hessian=self.known_hessian[np.ix_(which, which)],
            known_gradient=self.known_gradient[which],
            values=self.values[which],
            at_bound=self.at_bound[which],
            regular=self.regular[which],
            units=number[self.units[which[self.units].all(1)]].reshape(-1, 3),
            waves=None if self.waves is None else self.waves[:, which],
        )

    def with_cluster(self, hessian: Matrix, regular: Bool[np.ndarray, " p"]) -> Evidence:
        """Return the evidence with one more cluster, which is expected to show what is fitted, and so without slope."""
        count, p = len(self.hessian), len(self.values)
        index = np.arange(p) if self.shown is None else np.flatnonzero(np.diag(hessian) > 0.0)
        most = max(self.hessian.shape[1], len(index))
        H, g = np.zeros((count + 1, most, most)), np.zeros((count + 1, most))
        H[:count, : self.hessian.shape[1], : self.hessian.shape[1]] = self.hessian
        g[:count, : self.gradient.shape[1]] = self.gradient
        H[count, : len(index), : len(index)] = hessian[np.ix_(index, index)]
        shown = None
        if self.shown is not None:
            shown = np.full((count + 1, most), p)
            shown[:count, : self.shown.shape[1]] = self.shown
            shown[count, : len(index)] = index
        return dataclasses.replace(self, hessian=H, gradient=g, shown=shown, regular=regular)

    @cached_property
    def _found(self) -> dict[tuple[str, bytes], Any]:
        """What was found for a subset of the unknowns, by its name and the subset: several errors ask for the same."""
        return {}

    def _once(self, name: str, which: Bool[np.ndarray, " p"], find: Callable[[], T]) -> T:
        key = name, which.tobytes()
        if key not in self._found:
            self._found[key] = find()
        return self._found[key]

    def covariance(self, which: Bool[np.ndarray, " p"]) -> Float[np.ndarray, "s s"]:
        """Return the plain covariance of a subset of the unknowns, the others held."""

        def find() -> np.ndarray:
            return self._on_units(plain_covariance(self.total[np.ix_(which, which)], self.sigma2), which)

        return self._once("covariance", which, find)

    def clustered_covariance(self, which: Bool[np.ndarray, " p"]) -> Float[np.ndarray, "s s"]:
        """Return the covariance by deleting one cluster at a time; the plain one for what one cluster alone sees."""
        covariance, several, kept = (
            self.covariance(which).copy(),
            self.single_view[which] < 0,
            which & (self.single_view < 0),
        )
        jackknife = jackknife_covariance(*self._shared(which))
        covariance[np.ix_(several, several)] = self.loss_ratio**2 * self._on_units(jackknife, kept)
        return covariance

    def _shared(self, which: Bool[np.ndarray, " p"]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return H and g of each cluster, and of the priors, for the unknowns of a subset that several clusters see."""
        kept, known = which & (self.single_view < 0), self.known_hessian[np.ix_(which, which)]
        H, g = self._once(
            "shared", which, lambda: without_single_views(self._grams(which), known, self.single_view[which])
        )
        return H, g, self.known_hessian[np.ix_(kept, kept)], self.known_gradient[kept]

    def _shared_waves(self, which: Bool[np.ndarray, " p"]) -> Float[np.ndarray, "clusters s waves"]:
        assert self.waves is not None
        known = self.known_hessian[np.ix_(which, which)]
        return without_single_views(self._grams(which, self.waves), known, self.single_view[which])[1]

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
        H, _, known, _ = self._shared(self._all)
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
        for (index, H, g), A_c in zip(self._grams(inside), waves, strict=True):
            shown = np.diag(H) > 0.0
            A, lengths = scaled(H[np.ix_(shown, shown)])
            g, A_c = g[shown], A_c[index[shown]]
            w, V = np.linalg.eigh(A)
            seen = w > 1e-9 * w.max(initial=0.0)
            unit = over(lengths)
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
        found = self.waves[:, which]
        for of_cluster, (index, H, _) in zip(found, self._grams(which), strict=True):
            of_cluster[index] -= H @ moves[index]
        return found

    def _on_units(self, covariance: np.ndarray, which: Bool[np.ndarray, " p"]) -> np.ndarray:
        if which.all():
            return on_unit_vectors(covariance, self.values, self.units)
        whole = np.zeros((len(which), len(which)))
        whole[np.ix_(which, which)] = covariance
        return on_unit_vectors(whole, self.values, self.units)[np.ix_(which, which)]
