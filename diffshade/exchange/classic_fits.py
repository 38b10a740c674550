"""Classic fits: the diffuse term and the one or two highlights that are nearest to any reflectance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from ..core.thresholds import CLEARLY, GREY_LEVEL
from ..model.lobes import AbstractPowerLobe, Blinn, Phong
from ..model.materials import Highlight, Material
from .lobe_refits import N_S_RANGE, lowest
from .reference import Cosines, Radiance, Reference, differences

EXPONENTS = np.geomspace(*N_S_RANGE, 17)  # exponents of which pairs are tried before the best is refined

Weights = Float[np.ndarray, "terms 3"]


class ClassicFit(NamedTuple):
    """The terms nearest to a reflectance, and the remaining difference under a light of intensity 1."""

    k_d: Float[np.ndarray, "3"]
    highlights: tuple[Highlight, ...]
    rms: float
    largest: float

    def material(self, **more: Any) -> Material:
        """Return the material with these terms; `more` are its other fields."""
        first, *others = self.highlights
        return Material(k_d=self.k_d, k_s=first.k_s, n_s=first.n_s, lobe=first.lobe, highlights=tuple(others), **more)


def nearest(
    target: Radiance, points: Reference, lobes: Sequence[AbstractPowerLobe] = (Blinn(), Phong()), most: int = 2
) -> ClassicFit:
    r"""Return k_d and one highlight that are nearest to a radiance, or two where one does not look the same.

    $$ \min \sum w^2 (k_d (n \cdot l)_+ + \sum_j k_j (cosine)_+^{n_j} - I)^2, \qquad w = 1 / \max(1, I) $$

    All coefficients are at least 0. Beyond 1, what a picture shows as white, relative errors count, so that a peak of
    thousands does not decide about the diffuse term. A second highlight is added where one leaves an rms above 0.005
    and two leave less than two thirds of it.

    Args:
        target: The radiance at the points.
        points: The reference.
        lobes: The lobes to choose from; by default Blinn's and Phong's.
        most: The largest number of highlights, 1 or 2.

    Returns:
        The terms and the error, which is not weighted.
    """
    weight = 1.0 / np.maximum(1.0, target.max(1, keepdims=True))
    tries = [_Terms(lobe, points, weight, target) for lobe in lobes]
    best = min((of.one() for of in tries), key=lambda found: found[0])
    if most > 1 and np.sqrt(best[0] / target.size) > GREY_LEVEL:
        two = best[1].two()
        best = two if two[0] < (1.0 / CLEARLY) ** 2 * best[0] else best
    _, terms, exponents = best
    k = terms.weights(exponents)
    found = terms.columns(exponents) @ k
    highlights = tuple(Highlight(k_s, n, terms.lobe) for k_s, n in zip(k[1:], exponents, strict=True))
    return ClassicFit(k[0], highlights, *differences(target, found))


class _Terms:
    """A diffuse term and the highlights of one lobe, as functions of their exponents."""

    def __init__(self, lobe: AbstractPowerLobe, points: Reference, weight: Float[np.ndarray, "n 1"], target: Radiance):
        self.lobe, self.diffuse, self.weight = lobe, points.n_l, weight
        self.power: Callable[[float], Cosines] = points.highlights(lobe)
        self.target = target * weight

    def columns(self, exponents: Sequence[float]) -> Float[np.ndarray, "n terms"]:
        return np.stack([self.diffuse, *map(self.power, exponents)], 1)

    def weights(self, exponents: Sequence[float]) -> Weights:
        """Return the best coefficients of at least 0 for these exponents."""
        A = self.columns(exponents) * self.weight
        return _least(A.T @ A, A.T @ self.target)

    def cost(self, exponents: Sequence[float]) -> float:
        A = self.columns(exponents) * self.weight
        return float(np.sum((A @ _least(A.T @ A, A.T @ self.target) - self.target) ** 2))

    def one(self) -> tuple[float, _Terms, tuple[float, ...]]:
        """Return the least cost of one highlight, and its exponent."""
        log_n = lowest(lambda x: self.cost((float(np.exp(x)),)), *np.log(N_S_RANGE))
        n = (float(np.exp(log_n)),)
        return self.cost(n), self, n

    def two(self) -> tuple[float, _Terms, tuple[float, ...]]:
        """Return the least cost of two highlights: the best pair of a grid, refined."""
        A = self.columns(EXPONENTS.tolist()) * self.weight
        G, y = A.T @ A, A.T @ self.target

        def gain(pair: tuple[int, int]) -> float:
            terms = [0, pair[0] + 1, pair[1] + 1]
            part, k = G[np.ix_(terms, terms)], _least(G[np.ix_(terms, terms)], y[terms])
            return float(np.sum(k * (2 * y[terms] - part @ k)))

        start = np.log(EXPONENTS[list(max(combinations(range(len(EXPONENTS)), 2), key=gain))])
        low, high = np.log(N_S_RANGE)
        found: Any = scipy.optimize.minimize(
            lambda x: self.cost(np.exp(x).tolist()),
            start,
            method="Nelder-Mead",
            bounds=[(low, high)] * 2,
            options={"xatol": 1e-4, "fatol": 1e-12, "maxfev": 80},
        )
        n = tuple(sorted(float(x) for x in np.exp(found.x)))
        return self.cost(n), self, n


def _least(G: Float[np.ndarray, "terms terms"], y: Weights) -> Weights:
    """Return the coefficients of at least 0 at the minimum of k.Gk - 2 k.y, for each channel."""
    L = np.linalg.cholesky(G + 1e-12 * np.trace(G) * np.eye(len(G)))
    return np.stack([scipy.optimize.nnls(L.T, b)[0] for b in np.linalg.solve(L, y).T], 1)
