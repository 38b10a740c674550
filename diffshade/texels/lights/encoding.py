"""Encoding: whether photographs are linear or have the sRGB curve, from how well a matte object explains them.

Linear photographs of a matte object under distant lights are three numbers a texel times three a light, and a curve
spoils that. It takes six photographs and an object that is not flat.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...core.robust_scale import robust_scale
from ...io.encodings import srgb_decode
from ...io.images import without_alpha
from ..tiles import LEARNING_SAMPLE
from .uncalibrated import bright_texels, factorize, middle_ranks, texels_under

MIN_PHOTOGRAPHS = 6  # as many as the numbers by which lengths say a map
MIN_TEXELS = 300
CLEAR_RATIO = 1.25  # ratio of the misfits from which one reading is believed


class FileEncoding(NamedTuple):
    """How photographs are encoded."""

    srgb: bool
    """Whether the sRGB curve explains them better than none."""
    clear: bool
    """Whether it is clear which does."""
    misfits: tuple[float, float]
    """Typical residual relative to a texel's brightness: as linear, and decoded from sRGB."""


def judge_encoding(images: Iterable[Any], mask: Bool[np.ndarray, "h w"]) -> FileEncoding | None:
    """Return how photographs are encoded; None where there are too few, or some are beyond 0 to 1.

    Args:
        images: Photographs of one object, a light each, as stored: (H, W, C) from 0 to 1.
        mask: True on the object.
    """
    pixels = np.flatnonzero(mask)
    some = pixels[np.linspace(0, len(pixels) - 1, min(len(pixels), LEARNING_SAMPLE)).astype(int)]
    taken = [without_alpha(np.asarray(image[:], np.float64)).reshape(mask.size, -1)[some] for image in images]
    if len({one.shape for one in taken}) != 1:  # grey ones and others
        return None
    samples = np.array(taken)
    if len(samples) < MIN_PHOTOGRAPHS or len(some) < MIN_TEXELS or not 0.0 <= samples.min() <= samples.max() <= 1.0:
        return None
    counts = samples.max(-1) < 1.0
    linear, decoded = (_misfit(y.mean(-1), counts) for y in (samples, np.asarray(srgb_decode(samples))))
    ratio = max(linear, decoded) / max(min(linear, decoded), 1e-9)
    return FileEncoding(decoded < linear, ratio > CLEAR_RATIO, (linear, decoded))


def _misfit(y: Float[np.ndarray, "views texels"], counts: Bool[np.ndarray, "views texels"]) -> float:
    """Return the typical residual of three numbers a texel times three a light, over the level of a texel."""
    y, counts = bright_texels(y, counts)
    used = middle_ranks(y, counts)
    s = factorize(y, counts)
    b = texels_under(y, used.astype(float), s)
    level = (y * used).sum(0) / np.maximum(used.sum(0), 1)
    r = ((b @ s.T).T - y) / np.maximum(level, 1e-12)
    return robust_scale(r[used]) if used.any() else np.inf
