"""Encoding: whether photographs are linear or have the sRGB curve, from how well a matte object explains them.

Under lights of known directions, three numbers a texel and one a light explain linear photographs of a matte object,
and a curve spoils that. A curve also squeezes all differences, so both readings are judged by what they leave
unexplained of the values that the files store. It takes six photographs and an object that is not flat.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...core.robust_scale import robust_scale
from ...core.thresholds import CLEARLY
from ...io.encodings import srgb_decode, srgb_encode
from ...io.images import without_alpha
from ..tiles import LEARNING_SAMPLE
from .matte import bright_texels, middle_levels, under_unequal

MIN_PHOTOGRAPHS = 6  # as many as the numbers by which lengths say a map
MIN_TEXELS = 300


class FileEncoding(NamedTuple):
    """How photographs are encoded."""

    misfits: tuple[float, float]
    """Typical residual relative to a texel's brightness, both of stored values: as linear, and decoded from sRGB."""
    facing: tuple[Float[np.ndarray, "texels 3"], Float[np.ndarray, "texels 3"]]
    """b = k_d n of some texels, by either."""

    @property
    def srgb(self) -> bool:
        """Whether the sRGB curve explains the photographs better than none."""
        return self.misfits[1] < self.misfits[0]

    @property
    def clear(self) -> bool:
        """Whether it is clear which does."""
        return max(self.misfits) > CLEARLY * min(self.misfits)

    @property
    def turned(self) -> float:
        """By how much the other reading turns normals in the median, degrees."""
        one, other = self.facing
        across = np.linalg.norm(np.cross(one, other), axis=-1)
        return float(np.rad2deg(np.median(np.arctan2(across, (one * other).sum(-1)))))


def judge_encoding(
    images: Iterable[Any], mask: Bool[np.ndarray, "h w"], towards: Float[np.ndarray, "views 3"]
) -> FileEncoding | None:
    """Return how photographs are encoded; None where there are too few, or some are beyond 0 to 1.

    Args:
        images: Photographs of one object, a light each, as stored: (H, W, C) from 0 to 1.
        mask: True on the object.
        towards: Unit vectors towards the lights.
    """
    pixels = np.flatnonzero(mask)
    some = pixels[np.linspace(0, len(pixels) - 1, min(len(pixels), LEARNING_SAMPLE // 2)).astype(int)]
    taken = [without_alpha(np.asarray(image[:], np.float64)).reshape(mask.size, -1)[some] for image in images]
    if len({one.shape for one in taken}) != 1:  # grey ones and others
        return None
    samples = np.array(taken)
    if len(samples) < MIN_PHOTOGRAPHS or len(some) < MIN_TEXELS or not 0.0 <= samples.min() <= samples.max() <= 1.0:
        return None
    stored, counts = bright_texels(samples.mean(-1), samples.max(-1) < 1.0)
    used, level = middle_levels(stored, counts)
    (b, linear), (b_decoded, decoded) = (
        under_unequal(y, counts, towards) for y in (stored, np.asarray(srgb_decode(stored)))
    )
    encoded = np.asarray(srgb_encode(np.maximum(decoded @ b_decoded.T, 0.0)))
    misfit, of_srgb = (robust_scale(((of - stored) / level)[used]) for of in (linear @ b.T, encoded))
    return FileEncoding((misfit, of_srgb), (b, b_decoded))
