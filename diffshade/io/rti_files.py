r"""RTI files: relightable photographs, `.ptm` and `.rti`, as coefficients of a basis of light directions.

A PTM (Malzbender, Gelb and Wolters 2001; file format 1.2) is a polynomial in the direction (x, y, z) to the light,

$$ a_0 x^2 + a_1 y^2 + a_2 x y + a_3 x + a_4 y + a_5 $$

of each channel (RGB) or of the brightness of one colour (LRGB). An `.rti` of the kind HSH has 4, 9 or 16 hemispherical
harmonics (Gautron et al. 2004) for each channel, as the RTIViewer of Cultural Heritage Imaging and ISTI-CNR reads them.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy
from jaxtyping import Float

from ..core.arrays import float64_of
from ..core.fields import Numbers
from ..core.thresholds import NEGLIGIBLE

MOST_SAMPLES = np.iinfo(np.int32).max  # bytes of coefficients, beyond any file that a person has
PTM_TERMS = 6
HSH_TERMS = (4, 9, 16)
LARGEST = 1e6  # of a coefficient, or of its scale
# version, format, width, height, and a scale and a bias for each term; some programs write a number a line
HEAD = re.compile(rb"(\S{1,40})\s+(\S{1,40})" + rb"\s+(\S{1,40})" * (2 + 2 * PTM_TERMS) + rb"[ \t\r]*\n")
UNIVERSAL = re.compile(rb"(\d{1,2})\s*\n(\d{1,9}) (\d{1,9}) (\d{1,9})\s*\n(\d{1,9}) (\d{1,9}) (\d{1,9})[ \r]*\n")


@dataclass(frozen=True, eq=False)
class RelightableImage:
    """A photograph under any distant light, from `read_rti`: coefficients of a basis of light directions.

    It has no highlight sharper than its basis, no normals that were measured, and no errors: what it was made from is
    lost. Its numbers are those of the photographs' files, 1 the brightest.

    Attributes:
        basis: "ptm" or "hsh".
        coefficients: A number for each term and channel of each pixel, in the order of `terms`.
    """

    basis: str
    coefficients: Float[np.ndarray, "h w c terms"]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.coefficients.shape[0], self.coefficients.shape[1]

    def shade(self, toward: Numbers) -> Float[np.ndarray, "h w 3"]:
        """Return the photograph under a distant light.

        Args:
            toward: Direction to the light, of any length: x right, y up, z to the camera, above the image (z > 0).

        Returns:
            The picture, at least 0, as linear as the photographs from which the file was made were.

        Raises:
            ValueError: The direction is not three finite numbers with z above 0.
        """
        return np.maximum(self.coefficients @ terms(self.basis, self.coefficients.shape[-1], toward), 0.0)

    def __str__(self) -> str:
        """Return size and basis, and what they cannot show."""
        rows, columns = self.shape
        return (
            f"relightable image of {columns} x {rows} pixels, {self.basis.upper()} of {self.coefficients.shape[-1]} "
            "terms: it has no highlight sharper than its basis, and no errors"
        )


def terms(basis: str, count: int, toward: Numbers) -> Float[np.ndarray, " terms"]:
    """Return the terms of a basis for the direction to a light.

    Those of HSH are the associated Legendre functions of 2 z - 1, from degree 0 on and from cosines to sines.

    Args:
        basis: "ptm" or "hsh".
        count: Number of terms: 6 of a PTM; 4, 9 or 16 of HSH.
        toward: Direction to the light.

    Raises:
        ValueError: The direction is not three finite numbers with z above 0.
    """
    l = float64_of("toward", toward)
    if l.shape != (3,) or not np.isfinite(l).all() or l[2] <= 0.0:
        raise ValueError(
            f"toward must be three finite numbers with z above 0, to a light before the image; got {toward}. Give for "
            "example (1, 1, 2)."
        )
    x, y, z = l / np.linalg.norm(l)
    if basis == "ptm":
        return np.array([x * x, y * y, x * y, x, y, 1.0])
    phi = np.arctan2(y, x)
    degree, m = np.array([(n, m) for n in range(4) for m in range(n, -n - 1, -1)])[:count].T
    order = np.abs(m)
    size = np.sqrt((2 * degree + 1) / (2 * np.pi * scipy.special.poch(degree - order + 1, 2 * order)))
    around = np.select([m > 0, m < 0], [np.cos(order * phi), np.sin(order * phi)], -np.sqrt(0.5))
    return -np.sqrt(2) * size * scipy.special.lpmv(order, degree, 2 * z - 1) * around


def read_rti(path: str | Path) -> RelightableImage:
    """Read a relightable photograph.

    Args:
        path: A `.ptm` file (PTM_FORMAT_RGB or PTM_FORMAT_LRGB, versions 1.1 and 1.2), or an `.rti` or `.hsh` file of
            hemispherical harmonics. Those compressed by JPEG are refused.

    Returns:
        The photograph under any light.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is damaged, holds less than it declares, or is of another kind.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}. Give the path of a .ptm or .rti file.")
    readers: dict[str, Callable[[bytes, Path], RelightableImage]] = {".ptm": _ptm, ".rti": _hsh, ".hsh": _hsh}
    if (suffix := path.suffix.lower()) not in readers:
        raise ValueError(f"'{path.suffix}' is not the suffix of a relightable image. Use one of {', '.join(readers)}.")
    return readers[suffix](path.read_bytes(), path)


def _size(path: Path, width: int | float, height: int | float, bytes_a_pixel: int, left: int) -> tuple[int, int]:
    """Return rows and columns; refuse a size that the rest of the file does not hold."""
    if width != int(width) or height != int(height) or width < 1 or height < 1:
        raise ValueError(f"{path} is damaged: its size is {width:g} x {height:g}. Copy it again.")
    needed = int(width) * int(height) * bytes_a_pixel
    if needed > min(left, MOST_SAMPLES):
        size = f"{int(width)} x {int(height)}"
        raise ValueError(f"{path} is damaged: {size} pixels need {needed} bytes, and it has {left}. Copy it again.")
    return int(height), int(width)


def _ptm(data: bytes, path: Path) -> RelightableImage:
    """Read a PTM: a header, then bytes whose coefficients are scale (byte - bias), the bottom row first."""
    head = HEAD.match(data)
    if head is None:
        raise ValueError(f"{path} is damaged: its header ends early. Copy it again.")
    version, kind, *words = (word.decode("ascii", "replace") for word in head.groups())
    if version not in ("PTM_1.1", "PTM_1.2"):
        raise ValueError(f"{path} is no PTM of version 1.1 or 1.2: it begins with {version!r}. Export it again.")
    if kind not in ("PTM_FORMAT_RGB", "PTM_FORMAT_LRGB"):
        raise ValueError(f"{path} has the format {kind!r}. Export it as PTM_FORMAT_LRGB or PTM_FORMAT_RGB.")
    try:
        numbers = np.array(words, np.float64)
    except ValueError:
        numbers = np.full(len(words), np.nan)
    if not (np.abs(numbers) < LARGEST).all():
        raise ValueError(f"{path} is damaged: its size, scale and bias must be {len(words)} numbers. Copy it again.")
    size, scale, bias = np.split(numbers, [2, 2 + PTM_TERMS])
    colour = kind == "PTM_FORMAT_RGB"
    rows, columns = _size(path, size[0], size[1], 18 if colour else 9, len(data) - head.end())
    count, pixels = rows * columns, np.frombuffer(data, np.uint8, offset=head.end())
    if colour:
        stored = np.moveaxis(pixels[: 18 * count].reshape(3, rows, columns, PTM_TERMS), 0, 2)
        found = scale * (stored - bias) / 255.0
    else:
        if version == "PTM_1.1":  # six coefficients, then the colour, at each pixel
            both = pixels[: 9 * count].reshape(rows, columns, 9)
            stored, rgb = both[..., :6], both[..., 6:]
        else:
            stored = pixels[: 6 * count].reshape(rows, columns, 6)
            rgb = pixels[6 * count : 9 * count].reshape(rows, columns, 3)
        found = (rgb / 255.0)[..., None] * (scale * (stored - bias) / 255.0)[..., None, :]
    return RelightableImage("ptm", np.ascontiguousarray(found[::-1], np.float32))


def ptm_file(
    coefficients: Float[np.ndarray, "h w c terms"], low: Float[np.ndarray, " terms"], high: Float[np.ndarray, " terms"]
) -> bytes:
    """Return a PTM of version 1.2 with a polynomial for each channel, whose pictures are from 0 to 1.

    Biases are whole numbers from 0 to 255, as readers take them, so 0 is always held exactly.

    Args:
        coefficients: In the order of `terms`.
        low: The least that each term holds; what is below is clipped.
        high: The largest.
    """
    low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
    scale = np.maximum(high - low, NEGLIGIBLE)  # readers may take six digits
    bias = np.rint(-255.0 * low / scale)
    stored = np.rint(np.clip(255.0 * coefficients / scale + bias, 0.0, 255.0)).astype(np.uint8)
    rows, columns = stored.shape[:2]
    lines = (
        "PTM_1.2",
        "PTM_FORMAT_RGB",
        f"{columns}",
        f"{rows}",
        " ".join(f"{x:.6f}" for x in scale),
        " ".join(f"{x:.0f}" for x in bias),
    )
    return "".join(f"{line}\n" for line in lines).encode() + np.moveaxis(stored[::-1], 2, 0).tobytes()


def _hsh(data: bytes, path: Path) -> RelightableImage:
    """Read HSH: comments, the size, two numbers for each term, then a byte for each pixel, channel and term.

    There are two forms. The universal one has its size as text, and coefficients byte / 255 * first + second; the older
    one has binary whole numbers, and the least and the largest of each coefficient.
    """
    at = 0
    while data[at : at + 1] == b"#":
        end = data.find(b"\n", at)
        at = len(data) if end < 0 else end + 1
    if universal := UNIVERSAL.match(data, at):
        kind, width, height, bands, count, colours, size = map(int, universal.groups())
        if kind != 3 or colours != 2 or size != 1:
            raise ValueError(f"{path} holds no HSH of RGB in single bytes. Export it again as HSH, not compressed.")
        at = universal.end()
    else:
        if len(data) < at + 16:
            raise ValueError(f"{path} is damaged: its header ends early. Copy it again.")
        width, height, bands, order = struct.unpack_from("<4i", data, at)
        count, at = order * order if 0 < order < 10 else 0, at + 16
    if count not in HSH_TERMS or bands != 3:
        raise ValueError(
            f"{path} has {bands} channels of {count} terms; 3 channels of 4, 9 or 16 are read. Export it again as HSH, "
            "not compressed."
        )
    start = at + 8 * count
    if len(data) < start:
        raise ValueError(f"{path} is damaged: its header ends early. Copy it again.")
    first, second = np.frombuffer(data, "<f4", 2 * count, at).reshape(2, count).astype(np.float64)
    if not ((np.abs(first) < LARGEST) & (np.abs(second) < LARGEST)).all():
        raise ValueError(f"{path} is damaged: the ranges of its coefficients are not finite. Copy it again.")
    rows, columns = _size(path, width, height, 3 * count, len(data) - start)
    stored = np.frombuffer(data, np.uint8, 3 * count * rows * columns, start).reshape(rows, columns, 3, count) / 255.0
    found = stored * first + second if universal else first + (second - first) * stored
    return RelightableImage("hsh", np.asarray(found, np.float32))
