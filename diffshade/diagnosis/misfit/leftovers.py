"""Leftovers: whether neighbouring residuals are alike, as they are where the model lacks something, and how much so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from ...inverse.forward.losses import LOSSES
from ...inverse.result import Fit
from ...inverse.statistics.clusters import Clusters

CERTAIN = 5.0  # standard deviations, from which neighbouring residuals are said to be alike
SIDES = (2, 4, 8, 16)  # pixels: the cells over which residuals are added up
FEWEST = 40  # cells

Residuals = Float[np.ndarray, "h w c"]
Mask = Bool[np.ndarray, "h w"]


@dataclass(frozen=True, eq=False)
class Leftovers:
    """How far the products of residuals are from those of independent noise, whose mean is 0."""

    share: float
    """The sum of the products of different pixels' residuals, over the sum of squares."""
    errors: float
    """Standard errors that this is above 0."""
    width: int = 1
    """Pixels over which they are alike."""

    @property
    def least(self) -> float:
        """What the share is at least, within three errors; 0 where it may be nothing."""
        return self.share * (1.0 - 3.0 / self.errors) if self.errors > 3.0 else 0.0


def neighbours_of(fit: Fit, out: Sequence[Mask | None] | None = None) -> Leftovers:
    """Compare neighbouring residuals of a fit; `out`: for each view the pixels that do not count."""
    return neighbours(*residuals(fit, out))


def residuals(fit: Fit, out: Sequence[Mask | None] | None = None) -> tuple[list[Residuals], list[Mask]]:
    """Return the residuals of each view as they count in the fit, 0 where they do not, and the pixels that count."""
    sigma, rho = float(fit.likelihood.sigma), LOSSES[fit.likelihood.loss]
    found, counted = [], []
    for i, view in enumerate(fit.views):
        seen = fit.predict(view)
        counts = np.all(seen.counts, -1)
        if out is not None and (mask := out[i]) is not None:
            counts = counts & ~mask
        r = seen.difference
        if view.noise is not None:
            r = r / np.sqrt(np.asarray(view.noise.variance(seen.image)))
        found.append(np.where(np.expand_dims(counts, -1), r * np.asarray(rho.slope((r / sigma) ** 2)), 0.0))
        counted.append(counts)
    return found, counted


def neighbours(found: Sequence[Residuals], counted: Sequence[Mask]) -> Leftovers:
    """Compare the products of neighbours' residuals with their own scatter, whatever the noise of each pixel is.

    Where the residuals are noise and a smooth misfit, the share is that of the misfit in their squares.
    """
    products, squares, power = 0.0, 0.0, 0.0
    for r, c in zip(found, counted, strict=True):
        for a, b, both in (
            (r[1:], r[:-1], c[1:] & c[:-1]),
            (r[:, 1:], r[:, :-1], c[:, 1:] & c[:, :-1]),
        ):
            product = np.sum(a * b, -1)[both]
            products += float(product.sum())
            squares += float(np.sum(product**2))
            power += 0.5 * float(np.sum((a**2 + b**2)[both]))
    if not squares > 0:
        return Leftovers(0.0, 0.0)
    return Leftovers(products / power, products / np.sqrt(squares))


def cells(found: Sequence[Residuals], side: int) -> Leftovers:
    """Compare sums of residuals over square cells with what independent ones would add up to.

    Of these the square of a cell's sum has the mean of its sum of squares; the excesses scatter as they do.
    """
    excess, power = [], 0.0
    for r in found:
        h, w, c = r.shape
        whole = np.zeros((-(-h // side) * side, -(-w // side) * side, c))
        whole[:h, :w] = r
        squares = [of.reshape(len(whole) // side, side, -1, side, c).sum((1, 3)) for of in (whole, whole**2)]
        excess.append(np.sum(squares[0] ** 2 - squares[1], -1)[squares[1].sum(-1) > 0])
        power += float(squares[1].sum())
    every = np.concatenate(excess)
    scatter = float(np.sqrt(np.sum(every**2)))
    if len(every) < FEWEST or not scatter > 0:
        return Leftovers(0.0, 0.0, side)
    return Leftovers(float(every.sum()) / power, float(every.sum()) / scatter, side)


def inflated(fit: Fit, clusters: Clusters) -> tuple[Clusters, str]:
    """Return clusters whose errors allow for residuals that are alike over some pixels, and a sentence on that.

    Where views or patches disagree, they have shown it, and where images are rounded to steps larger than their noise,
    rounding makes neighbours alike: the errors hold it already. In float64.
    """
    if clusters.disagree or clusters.evidence.waves is not None:
        return clusters, ""
    of_pixels, _ = residuals(fit)
    alike = [found for side in SIDES if (found := cells(of_pixels, side)).errors > CERTAIN]
    if not alike:
        return clusters, ""
    most = max(alike, key=lambda found: found.share)
    variance = max(1.0 + most.share, clusters.scatter)
    sentence = (
        f"neighbouring residuals are alike, over {most.width} pixels and perhaps more: the model lacks something, or "
        "the noise is not independent, as after JPEG, demosaicing or denoising. Errors are multiplied by "
        f"{np.sqrt(variance):.2g} for that; look at the residuals in a report."
    )
    return replace(clusters, scatter=variance), sentence
