"""Photographs: as the page shows them."""

from __future__ import annotations

import base64
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ....inverse.data.views import View, is_grey
from ....io.image_formats import encode
from ....texels.maps import TexelMaps
from ....texels.status import OUTSIDE
from ..pictures import QUALITY, displayed, smaller

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
    return _encoded(_seen(view), white)


def still_of(maps: TexelMaps, lit: tuple[int, ...] | None, exposure: float, white: float) -> str:
    """Return the object under some of its lights as a JPEG in base64."""
    return _encoded(exposure * maps.shade(lit=lit), white)


def _encoded(image: Float[np.ndarray, "h w c"], white: float) -> str:
    shown = displayed(image, smaller(image.shape, LARGEST), white)
    return base64.b64encode(encode(".jpg", shown, quality=QUALITY)).decode("ascii")


def _seen(view: View) -> Float[np.ndarray, "h w c"]:
    """Return a photograph without its alpha channel."""
    return np.asarray(view.image, np.float64)[..., : 1 if is_grey(view) else 3]
