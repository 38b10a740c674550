"""ICC profiles of one curve a colour: the encoding that they state (ICC.1:2022).

LittleCMS converts pixels of 8 bits, which is too coarse for linear radiance; so the curves and primaries are read here.
"""

from __future__ import annotations

import io
import struct

import numpy as np
from jaxtyping import Float

from ..core.words import MAX_LETTERS
from .encodings import Curve, Encoding, encoding, power

FEWEST = {0: 1, 1: 3, 2: 4, 3: 5, 4: 7}  # numbers of a parametric curve of each type (10.18)


def profile_name(profile: bytes) -> str:
    """Return the name that a profile gives itself; "" for none."""
    from PIL import ImageCms

    try:
        text = ImageCms.getProfileDescription(ImageCms.getOpenProfile(io.BytesIO(profile)))
    except ImageCms.PyCMSError:
        return ""
    return "".join(letter for letter in text if letter.isprintable()).strip()[:MAX_LETTERS]


def encoding_of_profile(profile: bytes) -> Encoding | None:
    """Return the encoding that a profile states; None where it is more than curves and primaries.

    Raises an error of some type for a damaged profile.
    """
    tags, kind = _tags(profile), profile[16:24]
    name = profile_name(profile) or "the file's own colour profile"
    if kind == b"GRAYXYZ " and b"kTRC" in tags:
        return encoding(name, (_curve(tags[b"kTRC"]),))
    if kind != b"RGB XYZ " or not {b"rXYZ", b"rTRC"} <= set(tags):
        return None
    curves = tuple(_curve(tags[colour + b"TRC"]) for colour in (b"r", b"g", b"b"))
    return encoding(name, curves, np.stack([_xyz(tags[colour + b"XYZ"]) for colour in (b"r", b"g", b"b")], -1))


def _tags(profile: bytes) -> dict[bytes, bytes]:
    (count,) = struct.unpack_from(">I", profile, 128)
    entries = struct.iter_unpack(">4sII", profile[132 : 132 + 12 * min(count, 100)])
    return {name: profile[at : at + size] for name, at, size in entries}


def _xyz(tag: bytes) -> Float[np.ndarray, "3"]:
    return np.array(struct.unpack_from(">3i", tag, 8)) / 65536.0


def _curve(tag: bytes) -> Curve:
    """Return a curve of type `curv` or `para` (10.6, 10.18)."""
    if tag[:4] == b"para":
        kind = struct.unpack_from(">H", tag, 8)[0]
        return _parametric(kind, *(n / 65536.0 for n in struct.unpack_from(f">{FEWEST[kind]}i", tag, 12)))
    if tag[:4] != b"curv":
        raise ValueError
    count = struct.unpack_from(">I", tag, 8)[0]
    numbers = np.frombuffer(tag, ">u2", count, 12)
    if count == 0:
        return np.asarray
    if count == 1:
        return power(numbers[0] / 256.0)
    places, values = np.linspace(0.0, 1.0, count), numbers / 65535.0
    return lambda x: np.interp(x, places, values)


def _parametric(
    kind: int, g: float, a: float = 1.0, b: float = 0.0, c: float = 0.0, d: float = 0.0, e: float = 0.0, f: float = 0.0
) -> Curve:
    """Return (a x + b)^g + e from d up, and c x + f below."""
    if kind in (1, 2):  # which have one constant, c, in both parts, and meet where a x + b is 0
        c, d, e, f = 0.0, -b / a, c, c
    return lambda x: np.where(x >= d, np.maximum(a * x + b, 0.0) ** g + e, c * x + f)
