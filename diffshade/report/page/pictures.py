"""Pictures: photograph, fit and difference of a view as images embedded in the page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from ...inverse.result import Fit, Prediction
from ...io.encodings import srgb_encode
from ...io.image_formats import encode, encode_indexed
from ...model.rendering import render
from ...model.scenes import Scene
from ..drawn_bands import DrawnBands
from .colours import BELOW_TO_ABOVE, colours_of

LARGEST = 800  # pixels of the longer side; a larger photograph is shown smaller
QUALITY = 88  # JPEG quality
STEPS = 32  # colours of a difference on each side of 0


@dataclass(frozen=True)
class Gallery:
    """The views on the page, and the scale of their colours."""

    pictures: Sequence[dict[str, Any]]
    """What the page's template shows of each view; the images are data URIs."""
    white: float
    """The radiance that is shown as white."""
    limit: float
    """The absolute difference with the full colour."""
    colours: tuple[str, ...]
    """The colours of the differences from -limit to limit."""


def build_gallery(predictions: Sequence[Prediction], names: Sequence[str], drawn: DrawnBands) -> Gallery:
    """Return the pictures of views and their predictions, with one white level and one scale of differences."""
    known = [p for p in predictions if p.counts.any()]
    white = max((drawn.white(p) for p in known), default=1.0) or 1.0
    limit = max((float(np.quantile(np.abs(_differences(p, drawn)), 0.99)) for p in known), default=0.0) or 1e-12
    table = _table()
    pictures = []
    for name, p in zip(names, predictions, strict=True):
        shape = smaller(p.target.shape)
        photograph, image = (displayed(drawn.of(of), shape, white) for of in (p.target, p.image))
        difference = _steps(p, shape, limit)
        files = [encode(".jpg", of, quality=QUALITY) for of in (photograph, image)]
        pictures.append(
            {
                "name": name,
                "photograph": _uri("jpeg", files[0]),
                "fit": _uri("jpeg", files[1]),
                "difference": _uri("png", encode_indexed(difference, table)),
                "rmse": p.rmse if p.counts.any() else 0.0,
                "height": shape[0],
                "width": shape[1],
                "smaller": shape != p.target.shape[:2],
                "inside": p.coverage if np.isfinite(p.coverage) else None,  # of their bands
            }
        )
    colours = tuple("#" + "".join(f"{int(c):02x}" for c in row[:3]) for row in table[:-1])
    return Gallery(pictures, white, limit, colours)


def _differences(p: Prediction, drawn: DrawnBands) -> Float[np.ndarray, " n"]:
    """Return the differences that set the scale: of samples, or their means over many bands, which are smaller."""
    counted = p.counts.sum(-1)
    return (p.difference.sum(-1) / np.maximum(counted, 1))[counted > 0] if drawn.words else p.difference[p.counts]


def ball_picture(fit: Fit, scene: Scene, white: float) -> str:
    """Return a scene under the first view's lights, drawn by `render`, as a data URI."""
    view = fit.views[0]
    camera = view.camera
    image = np.asarray(render(scene, camera, lit=view.lit)) * float(view.exposure) + float(view.black)
    return _uri("png", encode(".png", displayed(image, smaller(camera.shape), white)))


def evenly(number: int, most: int) -> list[int]:
    """Return the indices of a list, or as many of them as are shown, evenly spread."""
    return sorted({int(i) for i in np.rint(np.linspace(0, number - 1, min(number, most)))}) if number else []


def smaller(shape: Sequence[int], most: int = LARGEST) -> tuple[int, int]:
    """Return the height and width of a picture that is shown smaller where its longer side has more pixels."""
    small = min(1.0, most / max(shape[:2]))
    return max(round(shape[0] * small), 1), max(round(shape[1] * small), 1)


def _table() -> UInt8[np.ndarray, "colours 4"]:
    """Return the colours of differences, from blue (fit darker) to red (fit brighter), and a transparent one."""
    colours = np.insert(colours_of(BELOW_TO_ABOVE, 2 * STEPS + 1), 3, 255, axis=1)
    return np.append(colours, np.zeros((1, 4), np.uint8), 0)


def displayed(image: Float[np.ndarray, "h w c"], shape: tuple[int, int], white: float) -> UInt8[np.ndarray, "a b 3"]:
    """Return linear radiance as 8-bit sRGB for display."""
    shown = np.nan_to_num(_resized(image, shape) / white, nan=0.0, posinf=1.0, neginf=0.0)
    return np.rint(255.0 * np.broadcast_to(srgb_encode(np.clip(shown, 0.0, 1.0)), (*shape, 3))).astype(np.uint8)


def _steps(p: Prediction, shape: tuple[int, int], limit: float) -> UInt8[np.ndarray, "a b"]:
    """Return the colour index of fit - photograph, the mean over the channels; the last index if no sample counts."""
    counted = p.counts.sum(-1, keepdims=True).astype(float)
    weight = _resized(counted, shape)[..., 0]
    mean = _resized(p.difference.sum(-1, keepdims=True), shape)[..., 0] / np.maximum(weight, 1e-12)
    index = np.rint((np.clip(mean / limit, -1.0, 1.0) + 1.0) * STEPS).astype(int)
    return np.where(weight > 0.5, index, 2 * STEPS + 1).astype(np.uint8)


def _resized(image: Float[np.ndarray, "h w c"], shape: tuple[int, int]) -> Float[np.ndarray, "a b c"]:
    """Return a smaller image; each pixel is the mean of the pixels that it covers."""
    for axis, to in enumerate(shape):
        size = image.shape[axis]
        if to < size:
            starts = np.arange(to) * size // to
            sums = np.add.reduceat(image, starts, axis)
            counts = np.diff(np.append(starts, size))
            image = sums / np.expand_dims(counts, tuple(k for k in range(3) if k != axis))
    return image


def _uri(kind: str, file: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(file).decode('ascii')}"
