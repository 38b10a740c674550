"""Encodings: how the numbers in a file become linear radiance in the primaries of sRGB."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float64

from ..core.arrays import float64_of
from ..core.fields import Numbers

Curve = Callable[[np.ndarray], np.ndarray]
D50 = (0.9642, 1.0, 0.8249)  # XYZ of the white of ICC profiles
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
PRIMARIES = {  # x y of red, green, blue and white
    "the primaries of sRGB": (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290),
    "Adobe RGB": (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290),
    "Display P3": (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.3290),
    "BT.2020": (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.3290),
}
# Profiles round sRGB's curve to tables of 8 to 16 bits, and its primaries to 4 digits. 2.2 differs from it by .008.
SAME_CURVE, SAME_PRIMARIES = 0.002, 0.005


class Encoding(NamedTuple):
    """A curve for each colour, and the primaries."""

    name: str
    curves: tuple[Curve, ...]
    """From the numbers in the file, 0 to 1, to linear ones: one curve, or one each for red, green and blue."""
    to_srgb: Float[np.ndarray, "3 3"] | None = None
    """From linear colours to those in the primaries of sRGB, of rows that add up to 1; None where they are these."""

    def decode(self, colours: Float[np.ndarray, "h w c"]) -> Float[np.ndarray, "h w c"]:
        """Return linear radiance; white and grey stay white and grey exactly."""
        n = colours.shape[-1]
        if len(self.curves) == 1 or n != 3:
            linear = self.curves[0](colours)
        else:
            linear = np.stack([curve(colours[..., i]) for i, curve in enumerate(self.curves)], -1)
        if self.to_srgb is None or n != 3:
            return linear
        r, m = np.moveaxis(linear, -1, 0), self.to_srgb
        return np.stack([r[i] + sum(m[i, j] * (r[j] - r[i]) for j in range(3) if j != i) for i in range(3)], -1)


def srgb_encode(linear: Numbers) -> Float64[np.ndarray, "..."]:
    r"""Encode linear radiance by the sRGB curve (IEC 61966-2-1:1999).

    $$ 12.92 x \text{ where } x \le 0.0031308, \text{ else } 1.055 x^{1 / 2.4} - 0.055 $$

    The curve maps [0, 1] to [0, 1] and continues outside.

    Args:
        linear: Linear radiance, any shape.

    Returns:
        The sRGB values, of the same shape.

    Raises:
        TypeError: `linear` is no array of real numbers, or carries more than numbers: a unit, masked values.
    """
    x = float64_of("linear", linear)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055)


def srgb_decode(encoded: Numbers) -> Float64[np.ndarray, "..."]:
    r"""Decode sRGB to linear radiance (IEC 61966-2-1:1999): the inverse of `srgb_encode`.

    $$ x / 12.92 \text{ where } x \le 0.04045, \text{ else } ((x + 0.055) / 1.055)^{2.4} $$

    Args:
        encoded: sRGB values, any shape.

    Returns:
        Linear radiance, of the same shape.

    Raises:
        TypeError: `encoded` is no array of real numbers, or carries more than numbers: a unit, masked values.
    """
    x = float64_of("encoded", encoded)
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0.04045) + 0.055) / 1.055) ** 2.4)


def brightened(picture: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Return the root of a picture over its bright parts: what is dark is seen too."""
    picture = np.nan_to_num(picture, posinf=0.0)
    white = float(np.quantile(picture, 0.99))
    return np.sqrt(np.clip(picture / max(white, 1e-12), 0.0, 1.0))


def power(gamma: float) -> Curve:
    """Return the curve x^gamma."""
    return lambda x: np.maximum(x, 0.0) ** gamma


def xyz_of(chromaticities: Sequence[float]) -> Float[np.ndarray, "3 3"]:
    """Return the XYZ of primaries as columns, adapted by Bradford's matrix to the white of ICC profiles.

    Args:
        chromaticities: x and y of red, green, blue and white.
    """
    xy = np.reshape(np.asarray(chromaticities, np.float64), (4, 2))
    columns = np.stack([xy[:, 0] / xy[:, 1], np.ones(4), (1.0 - xy.sum(1)) / xy[:, 1]])
    primaries, white = columns[:, :3], columns[:, 3]
    adapt = np.linalg.solve(BRADFORD, (BRADFORD @ D50 / (BRADFORD @ white))[:, None] * BRADFORD)
    return adapt @ (primaries * np.linalg.solve(primaries, white))


def encoding(name: str, curves: tuple[Curve, ...], xyz: Float[np.ndarray, "3 3"] | None = None) -> Encoding:
    """Return an encoding: `SRGB` or `LINEAR` where it is one of these but for rounding.

    Args:
        name: What to call it otherwise.
        curves: As in `Encoding`.
        xyz: XYZ of the primaries as columns, under the white of ICC profiles; None for those of sRGB.

    Raises:
        ValueError: If the curves or primaries are no numbers.
    """
    to_srgb = None
    if xyz is not None:
        to_srgb = np.linalg.solve(xyz_of(PRIMARIES["the primaries of sRGB"]), xyz)
        with np.errstate(all="ignore"):
            to_srgb = to_srgb / to_srgb.sum(1, keepdims=True)
        if not np.isfinite(to_srgb).all():
            raise ValueError
        to_srgb = None if np.abs(to_srgb - np.eye(3)).max() < SAME_PRIMARIES else to_srgb
    x = np.linspace(0.0, 1.0, 256)
    with np.errstate(all="ignore"):
        values = np.stack([curve(x) for curve in curves])
    if not np.isfinite(values).all() or np.abs(values).max() > 2.0:
        raise ValueError
    for known in (SRGB, LINEAR):
        if np.abs(values - known.curves[0](x)).max() < SAME_CURVE:
            return known if to_srgb is None else Encoding(name, known.curves, to_srgb)
    return Encoding(name, curves, to_srgb)


SRGB = Encoding("sRGB", (srgb_decode,))
LINEAR = Encoding("linear", (np.asarray,))
ADOBE = encoding("Adobe RGB", (power(2.19921875),), xyz_of(PRIMARIES["Adobe RGB"]))
