"""Encodings: whether photographs that were read as linear fit much better as sRGB, or the other way round."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...inverse.data.samples import Samples, SensorRange
from ...inverse.forward.losses import LOSSES
from ...inverse.problem import fit_problem
from ...inverse.result import Fit
from ...inverse.solving import solve
from ...inverse.unknowns.slots import put_back
from ...inverse.unknowns.unknown import values_at
from ...io.encodings import srgb_decode, srgb_encode
from .explanations import EXPLAINED
from .regional import AGREED
from .residual_correlation import CERTAIN, correlation_of

PIXELS = 1 << 13  # number of pixels, in all views together, on which encodings are judged
STRUCTURE = 0.05  # the structure in the residuals, over their squares, below which encodings are not tried
MOST = 0.7  # fraction of that structure by the other encoding, where another fault explains half as much

Curve = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Encoding:
    """A fit with the images in the other encoding, compared in the images' own values."""

    decoded: bool
    """Whether the images were decoded from sRGB for it (they were read as linear); else they were encoded."""
    before: Float[np.ndarray, "views 3"]
    """Of each view the cost, the sum of squares and the number of samples, in the images' own values."""
    after: Float[np.ndarray, "views 3"]

    @property
    def share(self) -> float:
        """The fraction of the cost that is explained."""
        before, after = self.before[:, 0].sum(), self.after[:, 0].sum()
        return float(1.0 - after / before) if before > 0 else 0.0

    @property
    def agreed(self) -> float:
        """The fraction of the views that fit better."""
        seen = self.before[:, 0] > 0
        return float(np.mean((self.after < self.before)[seen, 0])) if seen.any() else 0.0

    def believed(self, structure: float, rival: float) -> bool:
        """Whether it explains most of the structure in the residuals, in most views, and nothing else does.

        Args:
            structure: Its fraction of the cost.
            rival: The largest fraction of the cost that another fault explains.
        """
        least = MOST if self.share < 2.0 * rival else EXPLAINED
        return self.agreed >= AGREED and self.share > max(rival, least * structure)

    def __str__(self) -> str:
        """Return what it is, what it explains and the remedy."""
        what, remedy = (
            ("sRGB-encoded, but were read as linear: decoded", "srgb=True")
            if self.decoded
            else ("linear, but were decoded from sRGB: encoded again", "srgb=False")
        )
        before, after = (
            np.sqrt(of[:, 1].sum() / max(self.before[:, 2].sum(), 1.0)) for of in (self.before, self.after)
        )
        return (
            f"the images seem to be {what}, they fit with RMSE {after:.3g} instead of {before:.3g}. Read them with "
            f"ds.read_image(path, {remedy})."
        )


def better_encoding(fit: Fit, rival: float) -> Encoding | None:
    """Return the other encoding if the images fit so much better in it that it is believed. Runs in float64.

    Args:
        fit: The fit.
        rival: The largest fraction of the cost that another fault explains.
    """
    structure = correlation_of(fit)
    if structure.share < STRUCTURE or structure.errors < CERTAIN:
        return None
    both = (_other_encoding(fit, decoded=decoded) for decoded in (True, False))
    return next((encoding for encoding in both if encoding.believed(structure.share, rival)), None)


def _other_encoding(fit: Fit, *, decoded: bool) -> Encoding:
    """Fit the images in the other encoding, and compare in the images' own values."""
    to, back = (srgb_decode, srgb_encode) if decoded else (srgb_encode, srgb_decode)
    data = fit.solved.problem.data
    start = [dataclasses.replace(u, start=float(v)) for u, v in zip(fit.unknowns, fit.values, strict=True)]
    views = tuple(eqx.tree_at(lambda v: v.noise, v, None, is_leaf=lambda node: node is None) for v in fit.views)
    clipped = "hinge" if fit.clipped == "tobit" else fit.clipped
    data = dataclasses.replace(data.with_samples(_thinned(data.samples)), views=views, clipped=clipped)
    data = dataclasses.replace(data, samples=tuple(_through(to, s) for s in data.samples))
    _, end, _ = solve(fit_problem(fit.scene, data, start, fit.likelihood.loss))
    scene, seen = put_back(fit.scene, fit.views, start, values_at(end.theta, start))
    again = dataclasses.replace(fit, solved=fit.solved.drawn_as(scene, seen))
    return Encoding(decoded, _misfit(fit, lambda image: image), _misfit(again, back))


def _thinned(samples: Sequence[Samples]) -> list[Samples]:
    """Return the samples of about PIXELS pixels at most, evenly spread."""
    total = sum(len(s.pixels) for s in samples)

    def thin(s: Samples) -> Samples:
        count = min(max(len(s.pixels) * PIXELS // total, 64), len(s.pixels))
        return s.at(s.pixels[np.arange(count) * len(s.pixels) // max(count, 1)])

    return [thin(s) for s in samples]


def _through(curve: Curve, s: Samples) -> Samples:
    """Return samples with a curve applied to them and to the sensor's range."""
    of = lambda level: float(curve(np.asarray(level))) if np.isfinite(level) else level  # noqa: E731
    ends = SensorRange(*map(of, s.sensor_range))
    return Samples(s.inside, s.pixels, curve(s.photograph[:]), ends, of(s.brightest))


def _misfit(fit: Fit, curve: Curve) -> Float[np.ndarray, "views 3"]:
    """Return the cost, the sum of squares and the number of measured samples of each view, with a curve applied."""
    sigma, rho, found = float(fit.likelihood.sigma), LOSSES[fit.likelihood.loss], []
    for view in fit.views:
        seen = fit.predict(view)
        image = curve(seen.image)
        r = np.where(seen.counts, image - seen.target, 0.0)
        weight = 1.0 if view.noise is None else 1.0 / np.asarray(view.noise.variance(image))
        cost = sigma**2 * np.asarray(rho.value(weight * r**2 / sigma**2))
        found.append((cost[seen.counts].sum(), (r**2).sum(), seen.counts.sum()))
    return np.array(found, float)
