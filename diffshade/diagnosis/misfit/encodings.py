"""Encodings: whether photographs that were read as linear fit much better as sRGB, or the other way round."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...inverse.data.recording import photograph
from ...inverse.data.samples import Samples
from ...inverse.data.views import View
from ...inverse.forward.losses import LOSSES
from ...inverse.problem import fit_problem
from ...inverse.result import Fit
from ...inverse.solving import solve
from ...inverse.unknowns.slots import put_back
from ...inverse.unknowns.unknown import values_at
from ...io.encodings import srgb_decode, srgb_encode

PIXELS = 1 << 13  # number of pixels, in all views together, on which encodings are judged

Curve = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Encoding:
    """A fit with the images in the other encoding, compared in the images' own values."""

    decoded: bool
    """Whether the images were decoded from sRGB for it (they were read as linear); else they were encoded."""
    before: Float[np.ndarray, " views"]
    after: Float[np.ndarray, " views"]
    """The cost of each view, on the same samples, in the images' own values."""
    noise: float
    """The cost of noise alone, by differences of neighbouring pixels: no curve explains it."""
    count: int
    """The number of samples."""
    rmse: tuple[float, float]
    """Before and after, in the images' units."""

    @property
    def share(self) -> float:
        """The fraction of the cost that is explained."""
        return 1.0 - float(self.after.sum() / self.before.sum()) if self.before.sum() > 0 else 0.0

    @property
    def explained(self) -> float:
        """The fraction of the cost beyond noise that is explained."""
        beyond = float(self.before.sum()) - self.noise
        return float(self.before.sum() - self.after.sum()) / beyond if beyond > 0 else 0.0

    @property
    def errors(self) -> float:
        """The significance in standard errors, for independent noise: the root of n (C_before - C_after) / C_after."""
        after = float(self.after.sum())
        return float(np.sqrt(max(self.before.sum() - after, 0.0) / max(after, 1e-300) * self.count))

    @property
    def agreed(self) -> float:
        """The fraction of the views that fit better."""
        seen = self.before > 0
        return float(np.mean(self.after[seen] < self.before[seen])) if seen.any() else 0.0


def other_encoding(fit: Fit, noise: float, *, decoded: bool) -> Encoding:
    """Fit the images in the other encoding, and compare in the images' own values. Runs in float64.

    Args:
        fit: The fit.
        noise: The mean cost of a sample by noise alone (`cost_and_noise`).
        decoded: Whether to decode the images from sRGB; else to encode them.
    """
    to, back = (srgb_decode, srgb_encode) if decoded else (srgb_encode, srgb_decode)
    samples, counts = _thinned(fit.solved.problem.samples), fit.counts
    changed = [_through(to, s) for s in samples]
    views = tuple(eqx.tree_at(lambda v: v.noise, v, None, is_leaf=lambda node: node is None) for v in fit.views)
    unknowns = [dataclasses.replace(u, start=float(v)) for u, v in zip(fit.unknowns, fit.values, strict=True)]
    problem = fit_problem(
        fit.scene,
        views,
        unknowns,
        changed,
        counts.of(samples),
        fit.likelihood.loss,
        "hinge" if fit.clipped == "tobit" else fit.clipped,
    )
    _, end, _ = solve(problem)
    theta = end.theta
    scene, seen = put_back(fit.scene, fit.views, unknowns, values_at(theta, unknowns))
    other = dataclasses.replace(fit, solved=fit.solved.drawn_as(scene, seen))
    before, after = _misfit(fit, samples, lambda image: image), _misfit(other, samples, back)
    number = max(before[:, 2].sum(), 1.0)
    rmse = tuple(float(np.sqrt(of[:, 1].sum() / number)) for of in (before, after))
    return Encoding(decoded, before[:, 0], after[:, 0], number * noise, int(number), (rmse[0], rmse[1]))


def cost_and_noise(fit: Fit) -> tuple[float, float]:
    """Return the mean cost of a sample, and the part by noise, from the differences d of neighbours' residuals.

    Noise contributes 2 sigma^2 to d^2. Model error contributes little, since it is correlated over pixels.
    """
    cost, noise, count = 0.0, 0.0, 0
    for view in fit.views:
        seen = fit.predict(view)
        r = seen.difference
        both = seen.counts[:, 1:] & seen.counts[:, :-1]
        weight = 1.0 if view.noise is None else 1.0 / np.asarray(view.noise.variance(seen.image))[:, 1:]
        cost += float(_cost(fit, weight * r[:, 1:] ** 2)[both].sum())
        noise += float(_cost(fit, weight * 0.5 * (r[:, 1:] - r[:, :-1]) ** 2)[both].sum())
        count += int(both.sum())
    return cost / max(count, 1), noise / max(count, 1)


def _cost(fit: Fit, squares: np.ndarray) -> np.ndarray:
    """Return twice the cost of weighted squares: sigma^2 rho."""
    sigma = float(fit.likelihood.sigma)
    return sigma**2 * np.asarray(LOSSES[fit.likelihood.loss].value(squares / sigma**2))


def _thinned(samples: Sequence[Samples]) -> list[Samples]:
    """Return the samples of about PIXELS pixels at most, evenly spread."""
    total = sum(len(s.pixels) for s in samples)

    def thin(s: Samples) -> Samples:
        count = min(max(len(s.pixels) * PIXELS // total, 64), len(s.pixels))
        return dataclasses.replace(s, pixels=s.pixels[np.arange(count) * len(s.pixels) // max(count, 1)])

    return [thin(s) for s in samples]


def _through(curve: Curve, s: Samples) -> Samples:
    """Return samples with a curve applied to them and to the sensor's range."""
    of = lambda level: float(curve(np.asarray(level))) if np.isfinite(level) else level  # noqa: E731
    return Samples(s.inside, s.pixels, curve(s.whole()), of(s.floor), of(s.level), of(s.brightest))


def _misfit(fit: Fit, samples: Sequence[Samples], curve: Curve) -> Float[np.ndarray, "views 3"]:
    """Return the cost, the sum of squares and the number of measured samples of each view, with a curve applied."""
    return np.array([_of_view(fit, view, s, curve) for view, s in zip(fit.views, samples, strict=True)])


def _of_view(fit: Fit, view: View, s: Samples, curve: Curve) -> tuple[float, float, int]:
    image = photograph(fit.scene, view)
    image = curve(image.reshape(-1, image.shape[2])[s.pixels])
    measured = s.ends() == 0
    r = np.where(measured, image - s.values(s.pixels), 0.0)
    weight = 1.0 if view.noise is None else 1.0 / np.asarray(view.noise.variance(np.where(measured, image, 0.0)))
    cost = np.where(measured, _cost(fit, weight * r**2), 0.0)
    return float(cost.sum()), float((r**2).sum()), int(measured.sum())
