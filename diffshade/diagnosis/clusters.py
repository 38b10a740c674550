"""Clusters: samples whose errors hang together, views or patches of them, and whether they hang together at all."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import special

from ..fields import Array
from ..inverse.blocks import Block, Piece, on_all_cores
from ..inverse.identifiability import listing
from ..inverse.outcome import Fit
from ..inverse.parameters import coordinate_slopes
from ..inverse.refits import Laid
from ..inverse.uncertainty import Evidence, Vector
from ..inverse.views import Samples, setups

INDEPENDENT = 0.05  # p-value of the scatter of the clusters' optima, from which noise is taken as independent
FEWEST = 6  # patches for a jackknife
MOST = 64


@dataclass(frozen=True, eq=False)
class Clusters:
    """What the errors of a fit are made of: independent samples, or clusters of them."""

    evidence: Evidence
    count: int
    """Clusters; 0 where there are too few for a jackknife."""
    what: str
    scatter: float
    """Variance of the clusters' own optima over what independent noise would give them: 1 where it is independent."""
    shaken: Bool[np.ndarray, " p"]
    """Unknowns whose error is by clusters: independent noise does not explain how the clusters disagree."""
    freedom: Vector
    """Of the jackknife: clusters - 1, or fewer where few of them decide (Bell and McCaffrey 2002)."""

    def errors(self) -> Vector:
        """Return the standard errors: plain where the noise is as good as independent, else by jackknife."""
        plain = self.evidence.plain_errors()
        return np.where(self.shaken, self.evidence.clustered_errors(), plain) if self.shaken.any() else plain

    def inflation(self) -> Vector:
        """Return the variances over those of independent noise, with nothing held at a bound."""
        if not self.shaken.any():
            return np.ones(len(self.shaken))
        free = dataclasses.replace(self.evidence, at_bound=np.zeros_like(self.evidence.at_bound))
        plain, clustered = free.plain_errors(), free.clustered_errors()
        usable = self.shaken & np.isfinite(plain) & (plain > 0) & (clustered > 0)
        return np.where(usable, clustered / np.where(usable, plain, 1.0), 1.0) ** 2

    def rises(self) -> Vector:
        """Return for each unknown by how much the cost, twice, rises where it is held one error away.

        sigma^2 times the inflation; of a robust loss the cost bends with the slopes psi', where H has its weights rho'.
        """
        return self.evidence.sigma2 * self.inflation() / self.evidence.stiffness

    def quantiles(self, level: float) -> Vector:
        """Return how many errors a two-sided interval reaches: Student's t, of `freedom` by jackknife."""
        many = max(float(self.evidence.spread[0]) - len(self.shaken), 1.0)
        freedom = np.where(self.shaken, np.minimum(self.freedom, many), many)
        return special.stdtrit(freedom, 0.5 + 0.5 * level)

    def sentence(self, quantities: Sequence[str]) -> str:
        """Say what the errors are made of, and what is not in them; given the unknowns' quantities."""
        if not self.count:
            return (
                f"the residuals hang together over {self.what}, too few for a jackknife: the errors are for "
                "independent noise and too small. Add views under other lights."
            )
        if not self.shaken.any():
            return (
                f"the {self.what} agree as far as independent noise lets them (their optima scatter by "
                f"{self.scatter:.2g} times the variance), so the errors are for independent noise."
            )
        names = list(dict.fromkeys(q for q, here in zip(quantities, self.shaken, strict=True) if here))
        # of what shakes alone the scatter of all together tells nothing
        much = f" (their optima scatter by {self.scatter:.3g} times the variance)" if self.scatter > 1.0 else ""
        what = (
            f"the {self.what} disagree about {listing(names)} more than independent noise lets them{much}, so these "
            "errors are by leaving out one at a time"
        )
        few = f"; {self.count} are few for that" if self.count < 2 * FEWEST and "patches" in self.what else ""
        return f"{what}{few}; what they all share, such as texture or wrong normals, is not in them."


def find_clusters(fit: Fit) -> Clusters:
    """Return the views where there are three or more, else patches wider than the correlation of the residuals."""
    count = len(fit.evidence.hessian)
    if count >= 3 and fit.evidence.deciding() is None:
        return _judged(fit.evidence, count, f"{count} views")
    differences, counts = residual_images(fit)
    width = patch_width(differences, counts)
    laid = Laid(fit)
    parts, patch = cut_in_patches(fit, laid.study.samples, width)
    count = len(set(patch))
    if count < FEWEST:
        return _too_few(fit, f"{count} patches of {width} x {width} pixels")
    size = max(64, 1 << int(np.ceil(np.log2(max(len(part.pixels) for part in parts)))))
    laid_out = laid.study.reweigh(laid.theta, laid.study.lay(parts, size))
    theta = jnp.asarray(laid.theta)
    grams = on_all_cores(lambda chunk: _gram_of_each_block(theta, laid.study.form, chunk), laid_out)
    H, g = (
        np.concatenate([np.asarray(getattr(gram, name)) for gram in grams])[: len(parts)]
        for name in ("hessian", "gradient")
    )
    H, g = (np.array([of[patch == k].sum(0) for k in range(count)]) for of in (H, g))
    slope = coordinate_slopes(fit.values, fit.unknowns)
    evidence = dataclasses.replace(fit.evidence, hessian=H * np.outer(slope, slope), gradient=g * slope)
    if evidence.deciding() is not None:
        return _too_few(fit, f"{count} patches, one of which decides")
    return _judged(evidence, count, f"{count} patches of {width} x {width} pixels")


def _judged(evidence: Evidence, count: int, what: str) -> Clusters:
    scatter, p_value = evidence.scatter()
    each, freedom = evidence.shaken()
    shaken = ((p_value < INDEPENDENT) | (each < INDEPENDENT)) & (evidence.lone < 0)
    return Clusters(evidence, count, what, scatter, shaken, freedom)


def _too_few(fit: Fit, what: str) -> Clusters:
    return Clusters(fit.evidence, 0, what, np.inf, np.zeros(len(fit.values), bool), np.full(len(fit.values), np.inf))


@jax.jit
def _gram_of_each_block(theta: Array, form: object, chunk: Block) -> object:
    def of_block(block: Block) -> object:
        one = jax.tree.map(lambda leaf: leaf[None], block)
        return jax.tree.map(lambda leaf: leaf.sum(0), form.gram(theta, form.summary(theta, one)))  # pyright: ignore

    return jax.lax.map(of_block, chunk)


def residual_images(fit: Fit) -> tuple[list[Float[np.ndarray, "h w"]], list[Bool[np.ndarray, "h w"]]]:
    """Return of each view what is left over, the sum of the channels, and the pixels that count."""
    predictions = [fit.predict(view) for view in fit.views]
    return [p.difference.sum(-1) for p in predictions], [np.all(p.counts, -1) for p in predictions]


def correlation_length(
    differences: Sequence[Float[np.ndarray, "h w"]], counts: Sequence[Bool[np.ndarray, "h w"]]
) -> int:
    """Return over how many pixels residuals hang together: 0 where neighbours do not.

    The lag along rows and columns at which their correlation has fallen to 1/e of that of neighbours; white noise on
    top of a smooth error lowers both alike.
    """

    def correlation(lag: int) -> tuple[float, int]:
        products, pairs, power = 0.0, 0, 0.0
        for d, c in zip(differences, counts, strict=True):
            for a, b, both in (
                (d[lag:], d[:-lag], c[lag:] & c[:-lag]),
                (d[:, lag:], d[:, :-lag], c[:, lag:] & c[:, :-lag]),
            ):
                products += float(np.sum((a * b)[both]))
                pairs += int(both.sum())
                power += 0.5 * float(np.sum((a**2 + b**2)[both]))
        return products / max(power, 1e-300), pairs

    first, pairs = correlation(1)
    if not pairs or first < max(0.02, 3.0 / np.sqrt(pairs)):
        return 0
    longest = min(min(d.shape) for d in differences) - 1
    return next((lag for lag in range(2, longest) if correlation(lag)[0] < first / np.e), longest)


def patch_width(differences: Sequence[np.ndarray], counts: Sequence[np.ndarray]) -> int:
    """Return the width of patches: twice the correlation length at least, and so that there are not too many."""
    pixels = sum(int(c.sum()) for c in counts)
    return max(2 * correlation_length(differences, counts) + 1, int(np.ceil(np.sqrt(pixels / MOST))))


def cut_in_patches(fit: Fit, samples: Sequence[Samples], width: int) -> tuple[list[Piece], Int[np.ndarray, " n"]]:
    """Cut the pixels into squares of a grid, and say which patch each is of.

    The same square of views that were taken alike is one patch: what it has wrong it has wrong in all of them.
    """
    alike = {view: k for k, group in enumerate(setups(fit.scene, fit.views)) for view in group}
    parts, keys = [], []
    for view, of_view in enumerate(samples):
        row, column = np.divmod(of_view.pixels, of_view.inside.shape[1])
        square = (row // width) * of_view.inside.shape[1] + column // width
        for number in np.unique(square):
            parts.append(Piece(view, of_view, of_view.pixels[square == number]))
            keys.append((alike[view], int(number)))
    order = {key: k for k, key in enumerate(dict.fromkeys(keys))}
    return parts, np.array([order[key] for key in keys], int)
