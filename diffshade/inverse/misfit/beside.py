"""Beside: what photographs show beside the objects, where the scene has its background alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage, special

from ...core.masks import Mask
from ...core.robust_scale import RARE, robust_scale
from ...core.thresholds import BLACK, CLEARLY, MINOR, SLIGHT
from ...io.lazy_images import LazyImage
from ...model.rendering import silhouette
from ..data.mixed_pixels import FAR
from ..data.recording import record
from ..data.samples import kept
from ..data.views import colours, has_mask
from ..result import Fit

MAX_PIXELS = 512  # of a view, so that noise common to neighbours does not count too often


def beside(fit: Fit) -> list[Float[np.ndarray, " m"]] | None:
    """Return some samples of each channel beside the objects, less the background, if they show an even level alone.

    What a mask or an alpha channel keeps counts as object too. Views with a lazy image are not looked at, nor samples
    that are far off, such as hot pixels. None if too little is beside the objects, or if it is bright, brighter than
    the objects' dark parts, or of many levels: then it shows things, of which the scene says nothing.
    """
    found, on_objects = [], []
    far: dict[int, np.ndarray] = {}
    for view, samples in zip(fit.views, fit.solved.problem.data.samples, strict=True):
        if isinstance(view.image, LazyImage) or not len(samples.pixels):
            continue
        if (key := id(samples.pixels)) not in far:
            inside = samples.inside
            if has_mask(view):  # a mask that keeps a part of an object has the rest outside
                inside = inside | kept(view) | np.asarray(silhouette(fit.scene.objects, view.camera))
            far[key] = _far_from(inside)
        row, column = np.divmod(far[key], view.camera.shape[1])
        background = np.asarray(fit.scene.background, np.float64)
        flat = np.broadcast_to(background, (*view.camera.shape, len(background)))
        recorded = record(flat[:1, :1] if view.sensor is None else flat, view)  # without a sensor all pixels are alike
        seen = np.asarray(colours(view))[row, column]
        if not seen.size:
            continue
        if np.mean(seen == 0.0) > MINOR:  # cut out, or too dark for the camera: then no level is in all photographs
            return None
        found.append(seen - np.broadcast_to(recorded, (*view.camera.shape, recorded.shape[-1]))[row, column])
        on_objects.append(samples.values(samples.pixels[:: max(len(samples.pixels) // 256, 1)]))
    if not found:
        return None
    by_channel, of_objects = _by_channel(found), _by_channel(on_objects)
    levels = [float(np.median(shown)) for shown in by_channel]
    if max(map(abs, levels)) > BLACK * np.mean(np.concatenate(of_objects)):
        return None
    noise = (
        fit.rmse if fit.views[0].noise is None else fit.rmse * np.sqrt(float(fit.views[0].noise.variance(np.zeros(()))))
    )
    around = [shown - level for shown, level in zip(by_channel, levels, strict=True)]
    if (spread := robust_scale(np.concatenate(around))) > CLEARLY * noise:
        return None
    darkest = [float(np.quantile(samples, SLIGHT)) for samples in of_objects]  # of what only adds to a black level
    if any(level > dark + RARE * spread for level, dark in zip(levels, darkest, strict=True)):
        return None
    if spread > 0.0:
        by_channel = [shown[np.abs(off) <= RARE * spread] for shown, off in zip(by_channel, around, strict=True)]
    return by_channel


def _by_channel(of_views: Sequence[Float[np.ndarray, "n c"]]) -> list[Float[np.ndarray, " m"]]:
    """Return the samples of all views in each channel; a grey one has the first alone."""
    most = max(of.shape[1] for of in of_views)
    return [np.concatenate([of[:, c] for of in of_views if c < of.shape[1]]) for c in range(most)]


def _far_from(inside: Mask) -> Int[np.ndarray, " n"]:
    """Return some pixels far from the objects, along rows and along columns, evenly spread."""
    far = np.flatnonzero(ndimage.maximum_filter(inside, 2 * FAR + 1, mode="constant") == 0)
    return far[:: max(len(far) // MAX_PIXELS, 1)]


def p_of_level(shown: Sequence[Float[np.ndarray, " m"]]) -> float:
    """Return the p-value of samples beside the objects to have the mean that the scene says, all and each channel."""
    tested = [np.concatenate(shown), *shown]
    return min(1.0, len(tested) * min(map(_p_of_mean, tested)))


def _p_of_mean(shown: Float[np.ndarray, " m"]) -> float:
    spread = float(np.std(shown)) if len(shown) else 0.0
    if spread == 0.0:
        return 1.0
    return float(2.0 * special.stdtr(len(shown) - 1, -abs(shown.mean()) / spread * np.sqrt(len(shown))))
