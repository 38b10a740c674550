"""Predictions: photographs as the page shows them, and beside them what the maps say they should be."""

from __future__ import annotations

import base64
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from ....inverse.data.views import View, is_grey
from ....inverse.result import Prediction
from ....io.image_formats import encode
from ....model.gbuffers import as_mask
from ....texels.maps import TexelMaps
from ....texels.status import OUTSIDE
from ..pictures import QUALITY, displayed

LARGEST = 1024  # pixels of the longer side of a photograph beside the live picture
WHITE = 0.995  # quantile of a photograph that is shown as white, in the median over photographs
ENOUGH = 12  # photographs for that median


def white_of(maps: TexelMaps, views: Sequence[View]) -> float:
    """Return the radiance that is shown as white."""
    inside = maps.status != OUTSIDE
    images = [
        (_seen(view) - float(view.black)) / float(view.exposure) for view in views[:: -(-len(views) // ENOUGH) or 1]
    ]
    images = images or [maps.shade(lit=i) for i in range(min(len(maps.scene.lights), 3))]
    return float(np.median([np.quantile(image[inside], WHITE) for image in images])) or 1.0


def as_jpeg(view: View, white: float) -> str:
    """Return a photograph as a JPEG in base64."""
    image = _seen(view)
    small = min(1.0, LARGEST / max(image.shape))
    shape = (max(round(image.shape[0] * small), 1), max(round(image.shape[1] * small), 1))
    return base64.b64encode(encode(".jpg", displayed(image, shape, white), quality=QUALITY)).decode("ascii")


def prediction_of(maps: TexelMaps, view: View) -> Prediction:
    """Return a photograph and what the maps say it should be."""
    target, counts = _seen(view), _inside(maps, view)
    image = float(view.exposure) * maps.shade(lit=view.lit) + float(view.black)
    if target.shape[2] == 1:
        image = image.mean(-1, keepdims=True)
    image = np.where(counts[..., None], image, target)
    return Prediction(target, image, np.broadcast_to(counts[..., None], target.shape))


def relative_error(p: Prediction) -> float:
    """Return the relative error of a prediction."""
    light = np.sum(np.where(p.counts, p.target, 0.0) ** 2)
    return float(np.sqrt(np.sum(p.difference**2) / light)) if light > 0.0 else float("nan")


def _seen(view: View) -> Float[np.ndarray, "h w c"]:
    """Return a photograph without its alpha channel."""
    return np.asarray(view.image, np.float64)[..., : 1 if is_grey(view) else 3]


def _inside(maps: TexelMaps, view: View) -> Bool[np.ndarray, "h w"]:
    inside = maps.status != OUTSIDE
    return inside if view.mask is None else inside & np.asarray(as_mask(np.asarray(view.mask)))
