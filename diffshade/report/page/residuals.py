"""Residuals: the residuals of each view over the angles at which a wrong model shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from ...core.fields import Array
from ...core.progress import ReportProgress
from ...inverse.data.views import View, lights_on
from ...inverse.result import Fit, Prediction
from ...model.cameras import AbstractCamera
from ...model.lights import AbstractEmitter
from ...model.rendering import visible_points
from ...model.vectors import Vec3, dot, reflect

MOST = 400_000  # samples of all views together for the curves
FEWEST = 40  # samples per bin
BINS = 30


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of all views, fit - photograph, and the angles at their points."""

    rmse: Float[np.ndarray, " views"]
    """The RMSE of each view."""
    values: Float[np.ndarray, " n"]
    to_light: Float[np.ndarray, " n"]
    """The angle between n and l in degrees; the smallest of several lights."""
    to_mirror: Float[np.ndarray, " n"]
    """The angle between v and r in degrees; the smallest of several lights; NaN where n.l is not above 0."""
    rmse_of_bands: Float[np.ndarray, " bands"]
    """The RMSE of each band, of all views; empty without bands."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Residuals over an angle: the mean and the central 80 % of each bin with enough samples."""

    angle: Float[np.ndarray, " bins"]
    mean: Float[np.ndarray, " bins"]
    low: Float[np.ndarray, " bins"]
    high: Float[np.ndarray, " bins"]
    count: Int[np.ndarray, " bins"]


def collect_residuals(fit: Fit, report_progress: ReportProgress) -> Residuals:
    """Predict every view, and return the residuals of randomly drawn samples. Runs in float64."""
    random = np.random.default_rng(0)
    rmse, parts = [], []
    squares, samples = np.zeros((2, len(fit.scene.bands)))
    for i, view in enumerate(fit.views):
        report_progress(f"view {i + 1} of {len(fit.views)}", i / len(fit.views))
        p = fit.predict(view)
        rmse.append(p.rmse if p.counts.any() else np.nan)
        if fit.scene.bands:
            squares += np.sum(p.difference**2, (0, 1))
            samples += np.sum(p.counts, (0, 1))
        pixels = np.flatnonzero(p.counts.any(-1))
        few = MOST // (len(fit.views) * p.target.shape[2])
        if len(pixels) > few:
            pixels = random.choice(pixels, few, replace=False)
        parts.append(_of_view(fit, view, p, pixels))
    values, to_light, to_mirror = (np.concatenate(of) for of in zip(*parts, strict=True))
    return Residuals(np.array(rmse), values, to_light, to_mirror, np.sqrt(squares / np.maximum(samples, 1)))


def _of_view(fit: Fit, view: View, p: Prediction, pixels: Int[np.ndarray, " m"]) -> tuple[np.ndarray, ...]:
    channels = p.target.shape[2]
    counts = p.counts.reshape(-1, channels)[pixels]
    angles = _angles(fit, view, pixels)
    return (p.difference.reshape(-1, channels)[pixels][counts], *(np.repeat(a, counts.sum(1)) for a in angles))


def _angles(fit: Fit, view: View, pixels: Int[np.ndarray, " m"]) -> list[Float[np.ndarray, " m"]]:
    """Return the angles between n and l, and between v and r, each for the light with the smallest angle."""
    normals, positions, _ = visible_points(fit.scene.objects, view.camera)
    n, p = (None if of is None else Vec3.of(np.asarray(of).reshape(-1, 3)) for of in (normals, positions))
    n_l, v_r = np.full(len(pixels), -1.0), np.full(len(pixels), -1.0)
    for i in lights_on(fit.scene, view):
        found = _cosines(fit.scene.lights[i].bare(), view.camera, n, p)
        here, mirror = (np.asarray(cosine)[pixels] for cosine in found)
        n_l, v_r = np.maximum(n_l, here), np.maximum(v_r, np.where(here > 0, mirror, -1.0))
    degrees = [np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))) for cosine in (n_l, v_r)]
    return [degrees[0], np.where(n_l > 0, degrees[1], np.nan)]


@jax.jit
def _cosines(light: AbstractEmitter, camera: AbstractCamera, n: Vec3, p: Vec3 | None) -> tuple[Array, Array]:
    """Return n.l and v.r."""
    l, v = light.path(p).l, camera.projection().viewer(p)
    return dot(n, l), dot(v, reflect(l, n))


def curve(residuals: Residuals, angles: Float[np.ndarray, " n"], *, power: float = 1.0) -> Curve | None:
    """Return the residuals over an angle; None if there are too few.

    The bins have equal widths in angle^(1/power). With power 2 they are narrow near 0, where the highlight is.
    """
    known = np.isfinite(angles)
    if known.sum() < 2 * FEWEST:
        return None
    angles, values = angles[known], residuals.values[known]
    top = max(float(np.quantile(angles, 0.995)), 1e-9)
    edges = top * np.linspace(0.0, 1.0, BINS + 1) ** power
    order = np.argsort(angles)
    at = np.searchsorted(angles[order], edges)
    bins = np.split(values[order][: at[-1]], at[1:-1])
    rows: list[Sequence[Any]] = [
        (0.5 * (left + right), of.mean(), *np.quantile(of, (0.1, 0.9)), len(of))
        for left, right, of in zip(edges[:-1], edges[1:], bins, strict=True)
        if len(of) >= FEWEST
    ]
    return Curve(*(np.array(of) for of in zip(*rows, strict=True))) if len(rows) > 1 else None
