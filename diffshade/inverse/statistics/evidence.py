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

from ..forward.gram import ByView, Part
from ..solve.elimination import eliminate
from .uncertainty import Jackknife, Matrix, Vector, inverse, on_unit_vectors, over, scaled, standard_errors

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Evidence:
    """The information in the samples at the end of a fit, in the values' own units."""

    clusters: ByView
    """The Gram of each cluster: of samples whose errors may be correlated, those of a view or of a patch of one."""
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
    def count(self) -> int:
        """The number of clusters."""
        return len(self.clusters.cost)

    @cached_property
    def total(self) -> Matrix:
        """The Hessian of everything."""
        return self.clusters.total(len(self.values)) + self.known_hessian

    @property
    def _waves(self) -> Float[np.ndarray, "clusters p waves"]:
        return np.zeros((self.count, len(self.values), 0)) if self.waves is None else self.waves

    def _parts(self, which: Bool[np.ndarray, " p"]) -> Iterator[Part]:
        """Yield for each cluster which of some unknowns it shows, H for them, and as columns g and the waves."""
        for c, (index, H, g) in enumerate(self.clusters.parts(which)):
            yield index, H, np.concatenate([g[:, None], self._waves[c][index]], 1)

    @property
    def loss_ratio(self) -> float:
        """The ratio of the weights rho' of a robust loss, which H has, to the slopes psi', by which clusters move."""
        count, _, _, slope, weight = self.spread
        return float(weight / max(slope, 1e-3 * count))

    @cached_property
    def single_view(self) -> Int[np.ndarray, " p"]:
        """For each unknown the one cluster that alone sees it; -1 where several do, or there is but one."""
        return np.where(self.regular, self.clusters.single_view(len(self.values)), -1)

    def of(self, which: Bool[np.ndarray, " p"]) -> Evidence:
        """Return the evidence for some of the unknowns, the others held."""
        return dataclasses.replace(
            self,
            clusters=self.clusters.among(which),
            known_hessian=self.known_hessian[np.ix_(which, which)],
            known_gradient=self.known_gradient[which],
            values=self.values[which],
            at_bound=self.at_bound[which],
            regular=self.regular[which],
            units=(np.cumsum(which) - 1)[self.units[which[self.units].all(1)]],
            waves=None if self.waves is None else self.waves[:, which],
        )

    def with_cluster(self, hessian: Matrix, regular: Bool[np.ndarray, " p"]) -> Evidence:
        """Return the evidence with one more cluster, which is expected to show what is fitted, and so without slope."""
        index, p = np.flatnonzero(np.diag(hessian) > 0.0), len(self.values)
        parts = [*self.clusters.parts(np.ones(p, bool)), (index, hessian[np.ix_(index, index)], np.zeros(len(index)))]
        clusters = ByView.of(parts, [*self.clusters.cost, 0.0], p)
        return dataclasses.replace(self, clusters=clusters, regular=regular)

    @cached_property
    def _found(self) -> dict[tuple[str, bytes], Any]:
        """What was found for a subset of the unknowns, by its name and the subset: several errors ask for the same."""
        return {}

    def _once(self, name: str, which: Bool[np.ndarray, " p"], find: Callable[[], T]) -> T:
        key = name, which.tobytes()
        if key not in self._found:
            self._found[key] = find()
        return self._found[key]

    def covariance(self, which: Bool[np.ndarray, " p"]) -> Matrix:
        """Return the plain covariance, for independent noise, of a subset of the unknowns, the others held."""

        def find() -> np.ndarray:
            return self._on_units(self.sigma2 * inverse(self.total[np.ix_(which, which)]), which)

        return self._once("covariance", which, find)

    def clustered_covariance(self, which: Bool[np.ndarray, " p"]) -> Matrix:
        """Return the covariance by deleting one cluster at a time; the plain one for what one cluster alone sees."""
        kept = which & (self.single_view < 0)
        deviations = self._jackknife(which)[1][..., 0]
        clustered = self._on_units(deviations.T @ deviations, kept)
        return np.where(np.outer(kept, kept), clustered, self.covariance(which))

    def _jackknife(self, which: Bool[np.ndarray, " p"]) -> tuple[Jackknife, Float[np.ndarray, "clusters s columns"]]:
        """Return the jackknife of those of a subset that several clusters see, and its deviations by each column.

        What one cluster alone sees is eliminated: a cluster that is deleted takes its own unknowns with it.
        """

        def find() -> tuple[Jackknife, np.ndarray]:
            kept = which & (self.single_view < 0)
            number, s = np.cumsum(kept) - 1, int(kept.sum())
            H, columns = np.zeros((self.count, s, s)), np.zeros((self.count, s, 1 + self._waves.shape[2]))
            for c, (index, H_c, of_c) in enumerate(self._parts(which)):
                own, several = self.single_view[index] == c, self.single_view[index] < 0
                inverses = inverse(H_c[np.ix_(own, own)] + self.known_hessian[np.ix_(index[own], index[own])])
                side, at = H_c[np.ix_(own, several)], number[index[several]]
                _, _, of_H, of_columns = eliminate(inverses[None], side[None], of_c[own][None])
                H[c][np.ix_(at, at)] = H_c[np.ix_(several, several)] - of_H
                columns[c, at] = of_c[several] - of_columns[0]
            jackknife = Jackknife(H, self.known_hessian[np.ix_(kept, kept)])
            known = np.zeros(columns.shape[1:])
            known[:, 0] = self.known_gradient[kept]
            return jackknife, self.loss_ratio * jackknife.deviations(columns, known)

        return self._once("jackknife", which, find)

    def p_of_holding(self, held: Int[np.ndarray, " held"], free: Int[np.ndarray, " free"]) -> float:
        """Return the p-value of unknowns to be where they are held, by the slope of the cost there; others are free."""
        if not len(held) or not self.sigma2 > 0.0:
            return 1.0
        slope = np.asarray(self.clusters.slope(len(self.values))) + self.known_gradient
        both = np.concatenate([held, free])
        beyond_free = inverse(self.total[np.ix_(both, both)])[: len(held), : len(held)]
        square = float(slope[held] @ beyond_free @ slope[held])
        return float(special.chdtrc(len(held), square / self.sigma2))

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

    def _rounding_covariance(self, which: Bool[np.ndarray, " p"]) -> Matrix:
        moves = self._moves_by_rounding(which)
        return on_unit_vectors(moves @ moves.T, self.values, self.units)

    def _moves_by_rounding(self, which: Bool[np.ndarray, " p"]) -> Float[np.ndarray, "p waves"]:
        """Return how the waves move a subset of the unknowns, the others held."""
        moves, waves = np.zeros(self._waves.shape[1:]), self._waves.sum(0)
        moves[which] = inverse(self.total[np.ix_(which, which)]) @ waves[which]
        return moves

    def deciding(self) -> int | None:
        """Return a cluster without which fewer unknowns are determined, so that no jackknife is possible; or None."""
        return self._jackknife(np.ones(len(self.values), bool))[0].deciding()

    def independence_p_values(self) -> tuple[Vector, Vector]:
        """Return for each unknown the p-value of its jackknife variance if the noise were independent, and its freedom.

        No unknown is held at a bound. The degrees of freedom, for Student's t, are the clusters less one, or fewer if a
        few of them decide. What one cluster alone sees has no jackknife: p-value 1, infinitely many degrees.
        """
        p_value, freedom = np.ones(len(self.values)), np.full(len(self.values), np.inf)
        kept = self.regular & (self.single_view < 0)
        if self.count < 3 or not kept.any():
            return p_value, freedom
        jackknife, deviations = self._jackknife(self.regular)
        squares = np.sum(deviations**2, 0)
        variance, waves = squares[:, 0], squares[:, 1:]  # each wave is a normal number
        noise, of_noise = jackknife.of_noise()
        noise = self.sigma2 * noise
        expected = noise + waves.sum(1)
        of_noise = expected**2 / np.maximum(noise**2 / np.maximum(of_noise, 1e-300) + np.sum(waves**2, 1), 1e-300)
        freedom[kept] = np.clip(of_noise, 1.0, self.count - 1.0)
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
        moves, freedom = self._moves_by_rounding(inside), -float(fitted)
        squares = np.zeros([1 + moves.shape[1]] * 2)
        for index, H, columns in self._parts(inside):
            columns[:, 1:] -= H @ moves[index]  # at the optimum, where the gradients add up to 0
            shown = np.diag(H) > 0.0
            A, lengths = scaled(H[np.ix_(shown, shown)])
            w, V = np.linalg.eigh(A)
            seen = w > 1e-9 * w.max(initial=0.0)
            turned = (V.T @ (over(lengths)[:, None] * columns[shown]))[seen]
            squares += turned.T @ (turned / w[seen, None]) * weight / count
            freedom += float(np.sum(seen))
        between, rounding = float(squares[0, 0]), squares[1:, 1:]
        within = count - fitted - freedom
        if freedom <= 0 or within <= 0 or not between < psi2:
            return 1.0, 1.0
        noise = (psi2 - between) / within
        expected = freedom * noise + np.trace(rounding)
        freedom = expected**2 / (freedom * noise**2 + np.sum(rounding**2))
        return float(between / expected), float(special.fdtrc(freedom, within, between / expected))

    def _on_units(self, covariance: np.ndarray, which: Bool[np.ndarray, " p"]) -> Matrix:
        """Return the covariance of some of the unknowns without the lengths of unit vectors, among all; else 0."""
        whole = np.zeros((len(which), len(which)))
        whole[np.ix_(which, which)] = covariance
        return on_unit_vectors(whole, self.values, self.units)
