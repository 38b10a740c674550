"""Encoding: whether photographs are linear or have the sRGB curve, from how well a matte object explains them.

Linear photographs of a matte object under distant lights are three numbers a texel times three a light, and a curve
spoils that. It takes six photographs and an object that is not flat.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...io.images import srgb_decode
from .uncalibrated import MAD, factorize, middle_ranks, texels_under

FEWEST = 6  # photographs
TEXELS = 3000
CLEAR = 1.25  # ratio of the misfits from which one reading is believed


class Encoding(NamedTuple):
    """How photographs are encoded."""

    srgb: bool
    """Whether the sRGB curve explains them better than none."""
    clear: bool
    """Whether it is clear which does."""
    misfits: tuple[float, float]
    """Typical residual relative to a texel's brightness: as linear, and decoded from sRGB."""


def judge_encoding(images: Sequence[Any], mask: Bool[np.ndarray, "h w"]) -> Encoding | None:
    """Return how photographs are encoded; None where there are too few, or some are beyond 0 to 1.

    Args:
        images: Photographs of one object, a light each, as stored: (H, W, C) from 0 to 1.
        mask: True on the object.
    """
    pixels = np.flatnonzero(mask)
    stored = [np.asarray(image[:], np.float64)[..., : 3 if image.shape[2] > 2 else 1] for image in images]
    if len(images) < FEWEST or len(pixels) < TEXELS // 10 or not all(s.min() >= 0 and s.max() <= 1 for s in stored):
        return None
    some = pixels[np.linspace(0, len(pixels) - 1, min(len(pixels), TEXELS)).astype(int)]
    samples = np.array([s.reshape(-1, s.shape[-1])[some] for s in stored])
    counts = samples.max(-1) < 1.0
    linear, decoded = (_misfit(y.mean(-1), counts) for y in (samples, np.asarray(srgb_decode(samples))))
    ratio = max(linear, decoded) / max(min(linear, decoded), 1e-9)
    return Encoding(decoded < linear, ratio > CLEAR, (linear, decoded))


def _misfit(y: Float[np.ndarray, "views texels"], counts: Bool[np.ndarray, "views texels"]) -> float:
    """Return the typical residual of three numbers a texel times three a light, over the level of a texel."""
    used = middle_ranks(y, counts)
    s = factorize(y, counts)
    b = texels_under(y, used.astype(float), s)
    level = (y * used).sum(0) / np.maximum(used.sum(0), 1)
    r = ((b @ s.T).T - y) / np.maximum(level, 1e-12)
    return MAD * float(np.median(np.abs(r[used]))) if used.any() else np.inf
