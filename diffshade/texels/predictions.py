"""Predictions: a photograph beside what maps say it should be."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from ..inverse.data.recording import developed
from ..inverse.data.samples import kept
from ..inverse.data.views import View, is_grey
from ..inverse.result import Prediction
from ..io.images import without_alpha


def prediction_of(
    view: View, radiance: Float[np.ndarray, "h w 3"], inside: Bool[np.ndarray, "h w"], black: float
) -> Prediction:
    """Return a photograph without its sensor and, inside its mask and alpha channel and the maps, what it should be.

    `black` is what it shows beside the radiance and its own black.
    """
    view = developed(view)
    image = np.asarray(view.image, np.float64)
    counts = inside & kept(view, image)
    target = without_alpha(image)
    radiance = radiance.mean(-1, keepdims=True) if is_grey(view) else radiance
    expected = np.where(counts[..., None], float(view.exposure) * radiance + float(view.black) + black, target)
    return Prediction(target, expected, np.broadcast_to(counts[..., None], target.shape))


def relative_error(prediction: Prediction, black: float) -> float:
    """Return the size of the difference relative to that of the light; NaN where the photograph shows none."""
    light = np.sum(np.where(prediction.counts, prediction.target - black, 0.0) ** 2)
    return float(np.sqrt(np.sum(prediction.difference**2) / light)) if light > 0.0 else np.nan
