"""Encodings: whether photographs that were read as linear fit much better as sRGB, or the other way round."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from ...io.encodings import srgb_decode, srgb_encode
from ..data.samples import MIN_PIXELS, Samples, SensorRange, share_of
from ..forward.losses import LOSSES
from ..problem import fit_problem
from ..result import Fit
from ..solving import solve
from ..unknowns.slots import put_back
from ..unknowns.unknown import values_at
from .regional import MIN_AGREEMENT
from .set_up import PIXELS

MIN_EXPLAINED = 0.5  # of what a gamma explains: the curve of files is by far the commoner cause

Curve = Callable[[np.ndarray], np.ndarray]


def better_encoding(fit: Fit, by_gamma: float) -> str | None:
    """Return a sentence if the images fit so much better in the other encoding that it is believed. Runs in float64.

    It explains more than half of what a gamma does, in most views.

    Args:
        fit: The fit.
        by_gamma: The fraction of the residuals' squares that a gamma explains, to first order.
    """
    before = _misfits(fit, lambda image: image)
    for to, back, what, remedy in (
        (srgb_decode, srgb_encode, "sRGB-encoded, but were read as linear: decoded", "srgb=True"),
        (srgb_encode, srgb_decode, "linear, but were decoded from sRGB: encoded again", "srgb=False"),
    ):
        after = _misfits(_refitted(fit, to), back)
        share = 1.0 - after[:, 0].sum() / before[:, 0].sum()
        agreed = np.mean((after < before)[before[:, 0] > 0, 0])
        if agreed >= MIN_AGREEMENT and share > MIN_EXPLAINED * by_gamma:
            rmse = [np.sqrt(of[:, 1].sum() / before[:, 2].sum()) for of in (before, after)]
            return (
                f"the images seem to be {what}, they fit with RMSE {rmse[1]:.3g} instead of {rmse[0]:.3g}. Read them "
                f"with ds.read_image(path, {remedy})."
            )
    return None


def _refitted(fit: Fit, curve: Curve) -> Fit:
    """Return a fit with the scene and views that are found where the images go through a curve."""
    data, loss = fit.solved.problem.data, fit.likelihood.loss
    part = PIXELS / data.counts.pixels
    samples = [_through(curve, share_of(s, max(int(len(s.pixels) * part), MIN_PIXELS))) for s in data.samples]
    start = [dataclasses.replace(u, start=float(v)) for u, v in zip(fit.unknowns, fit.values, strict=True)]
    views = tuple(dataclasses.replace(view, noise=None) for view in fit.views)
    clipped = "hinge" if fit.clipped == "tobit" else fit.clipped
    data = dataclasses.replace(data.with_samples(samples), views=views, clipped=clipped)
    _, end = solve(fit_problem(fit.scene, data, start, loss))
    scene, seen = put_back(fit.scene, fit.views, start, values_at(end.theta, start))
    return dataclasses.replace(fit, solved=fit.solved.drawn_as(scene, seen))


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
