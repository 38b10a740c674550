"""Encodings: what a gamma stands for, by refits: sRGB read as linear or the other way round, or other lamps."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core.thresholds import CLEARLY, MOST
from ...io.encodings import srgb_decode, srgb_encode
from ...model.scenes import Scene
from ..data.samples import Samples, SensorRange
from ..forward.losses import LOSSES
from ..laid_out import LaidOut
from ..pixels.blocks import MANY
from ..result import Fit
from ..solve.solvers import Minimum
from ..solving import solve_again
from ..spreads import rounded_at, spread_at
from ..statistics.uncertainty import Vector
from ..unknowns.slots import put_back
from ..unknowns.unknown import values_at
from .found import Found
from .noise_tests import FALSE_ALARM, leftovers, whiteness
from .regional import MIN_AGREEMENT

Curve = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Mended:
    """What a gamma stands for, by a fit with it corrected."""

    kind: str
    sentence: str
    values: Vector
    """The fit's numbers with it corrected; other lamps are as strong at the object's middle."""
    refitted: tuple[LaidOut, Minimum]

    @property
    def leaves_noise(self) -> bool:
        """Whether noise alone, or the steps of files, is left with it corrected."""
        laid, end = self.refitted
        steps = rounded_at(end, laid, spread_at(end, laid))
        if steps is not None and steps.shared > MOST:
            return True
        return whiteness(leftovers(laid, end.theta)).p_value > FALSE_ALARM


def better_than_gamma(fit: Fit, by_gamma: float, others: Sequence[Found]) -> Mended | None:
    """Return what a gamma stands for, if a refit believes it. Runs in float64.

    It is the other encoding of the images, if that explains more than half of what a gamma does, or another fault if
    that explains clearly more than the encoding, and more than a gamma; in most views.

    Args:
        fit: The fit.
        by_gamma: The fraction of the residuals' squares that a gamma, or what looks like one, explains to first order.
        others: Faults that can be mistaken for a gamma.
    """
    before = _misfits(fit, _linear)

    def tried(
        kind: str, what: str, remedy: str, scene: Scene, to: Curve = _linear, back: Curve = _linear
    ) -> tuple[np.ndarray, Mended]:
        again, refitted = _refitted(fit, scene, to)
        after = _misfits(again, back)
        rmse = [f"{np.sqrt(of[:, 1].sum() / before[:, 2].sum()):.4g}" for of in (after, before)]
        sentence = f"{what} with RMSE {' instead of '.join(rmse)}. {remedy}"
        return after, Mended(kind, sentence, again.values, refitted)

    encoded = "the images seem to be sRGB-encoded, but were read as linear: decoded, they fit"
    decoded = "the images seem to be linear, but were decoded from sRGB: encoded again, they fit"
    read = "Read them with ds.read_image(path, srgb={})."
    curve = min(
        tried("encoding", encoded, read.format(True), fit.scene, srgb_decode, srgb_encode),
        tried("encoding", decoded, read.format(False), fit.scene, srgb_encode, srgb_decode),
        key=_cost,
    )
    scenes = [(found, found.words, found.fault.mended) for found in others]
    mended = [
        tried(found.fault.kind, f"{what}: so they fit", remedy, mend(found))
        for found, (what, remedy), mend in scenes
        if mend is not None
    ]
    other = sorted(mended, key=_cost)
    is_other = bool(other) and CLEARLY * _cost(other[0]) < _cost(curve)
    best, least = (other[0], by_gamma) if is_other else (curve, MOST * by_gamma)
    share, agreed = 1.0 - _cost(best) / before[:, 0].sum(), np.mean((best[0] < before)[before[:, 0] > 0, 0])
    return best[1] if agreed >= MIN_AGREEMENT and share > least else None


def _cost(tried: tuple[np.ndarray, Mended]) -> float:
    return float(tried[0][:, 0].sum())


def _refitted(fit: Fit, scene: Scene, curve: Curve) -> tuple[Fit, tuple[LaidOut, Minimum]]:
    """Return a fit with the scene and views that are found where the images go through a curve, and its minimum."""
    data = fit.solved.problem.data.part(MANY)
    samples = [_through(curve, s) for s in data.samples]
    views = tuple(dataclasses.replace(view, noise=None) for view in fit.views)
    clipped = "hinge" if fit.clipped == "tobit" else fit.clipped
    data = dataclasses.replace(data.with_samples(samples), views=views, clipped=clipped)
    laid, end = solve_again(fit.solved.problem, scene, data, fit.solved.theta)
    values = values_at(end.theta, fit.unknowns)
    drawn, seen = put_back(scene, fit.views, fit.unknowns, values)
    return dataclasses.replace(fit, solved=fit.solved.drawn_as(drawn, seen), values=values), (laid, end)


def _linear(image: np.ndarray) -> np.ndarray:
    return image


def _through(curve: Curve, s: Samples) -> Samples:
    """Return samples with a curve applied to them and to the sensor's range."""
    of = lambda level: float(curve(np.asarray(level))) if np.isfinite(level) else level  # noqa: E731
    ends = SensorRange(*map(of, s.sensor_range))
    return Samples(s.inside, s.pixels, curve(s.photograph[:]), ends, of(s.brightest))


def _misfits(fit: Fit, curve: Curve) -> Float[np.ndarray, "views 3"]:
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
