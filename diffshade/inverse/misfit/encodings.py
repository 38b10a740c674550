"""Encodings: whether photographs that were read as linear fit much better as sRGB, or the other way round."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from ...core.thresholds import CLEARLY, MOST
from ...io.encodings import srgb_decode, srgb_encode
from ...model.scenes import Scene
from ..data.samples import Samples, SensorRange
from ..forward.losses import LOSSES
from ..pixels.blocks import MANY
from ..problem import fit_problem
from ..result import Fit
from ..solving import solve
from ..unknowns.slots import put_back
from ..unknowns.unknown import values_at
from .found import Found
from .regional import MIN_AGREEMENT

Curve = Callable[[np.ndarray], np.ndarray]


def better_than_gamma(fit: Fit, by_gamma: float, others: Sequence[Found]) -> tuple[str, str] | None:
    """Return the kind and a sentence of what a gamma stands for, if a refit believes it. Runs in float64.

    It is the other encoding of the images, or another fault, whichever explains more: more than half of what a gamma
    does, in most views.

    Args:
        fit: The fit.
        by_gamma: The fraction of the residuals' squares that a gamma explains, to first order.
        others: Faults that can be mistaken for a gamma.
    """
    before = _misfits(fit, _linear)
    after = [
        (
            _misfits(_refitted(fit, fit.scene, to), back),
            "encoding",
            f"the images seem to be {what}, they fit with RMSE {{rmse}}. Read them with "
            f"ds.read_image(path, srgb={to is srgb_decode}).",
        )
        for to, back, what in (
            (srgb_decode, srgb_encode, "sRGB-encoded, but were read as linear: decoded"),
            (srgb_encode, srgb_decode, "linear, but were decoded from sRGB: encoded again"),
        )
    ]
    for found in others:
        assert found.fault.mended is not None
        what, remedy = found.words
        again = _misfits(_refitted(fit, found.fault.mended(found), _linear), _linear)
        after.append((again, found.fault.kind, f"{what}: so they fit with RMSE {{rmse}}. {remedy}"))
    after = sorted(after, key=lambda one: one[0][:, 0].sum())
    if after[0][1] != "encoding":  # which is by far the commoner cause
        curve = next(one for one in after if one[1] == "encoding")
        after = [curve] if CLEARLY * after[0][0][:, 0].sum() > curve[0][:, 0].sum() else after
    best, kind, sentence = after[0]
    share = 1.0 - best[:, 0].sum() / before[:, 0].sum()
    agreed = np.mean((best < before)[before[:, 0] > 0, 0])
    if agreed < MIN_AGREEMENT or share <= MOST * by_gamma:
        return None
    rmse = [f"{np.sqrt(of[:, 1].sum() / before[:, 2].sum()):.3g}" for of in (best, before)]
    return kind, sentence.format(rmse=" instead of ".join(rmse))


def _refitted(fit: Fit, scene: Scene, curve: Curve) -> Fit:
    """Return a fit with the scene and views that are found where the images go through a curve."""
    data, loss = fit.solved.problem.data.part(MANY), fit.likelihood.loss
    samples = [_through(curve, s) for s in data.samples]
    start = [dataclasses.replace(u, start=float(v)) for u, v in zip(fit.unknowns, fit.values, strict=True)]
    views = tuple(dataclasses.replace(view, noise=None) for view in fit.views)
    clipped = "hinge" if fit.clipped == "tobit" else fit.clipped
    data = dataclasses.replace(data.with_samples(samples), views=views, clipped=clipped)
    _, end = solve(fit_problem(scene, data, start, loss))
    drawn, seen = put_back(scene, fit.views, start, values_at(end.theta, start))
    return dataclasses.replace(fit, solved=fit.solved.drawn_as(drawn, seen))


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
