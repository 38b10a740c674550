"""Colours as in web programs: three bytes on the sRGB curve."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ..io.encodings import srgb_decode, srgb_encode


def to_hex(colour: Float[np.ndarray, "3"]) -> int:
    """Return the nearest 0xRRGGBB of a linear colour, clamped to 0 to 1."""
    r, g, b = (int(x) for x in np.rint(255.0 * np.asarray(srgb_encode(np.clip(colour, 0.0, 1.0)))))
    return (r << 16) + (g << 8) + b


def from_hex(value: int) -> Float[np.ndarray, "3"]:
    """Return the linear colour of 0xRRGGBB."""
    return np.asarray(srgb_decode(np.array([value >> 16, value >> 8 & 255, value & 255]) / 255.0))
