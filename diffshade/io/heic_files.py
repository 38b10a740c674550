"""HEIC, the files of phones. The only file that knows pillow_heif."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from ..core.extras import needing
from .image_headers import check_pixels

SUFFIXES = (".heic", ".heif")


def decode_heic(path: Path, data: bytes) -> np.ndarray:
    """Return the pixels of 8 bits, grey or RGB, with alpha where the file has it, turned upright by the library."""
    with opened_heic(path) as image:
        check_pixels("HEIC", image.size, data)
        return np.asarray(image)


def opened_heic(path: Path) -> Any:
    """Return a file as Pillow has it, of which only the header is decoded."""
    with needing("heic", f"cannot read {path}"):
        import pillow_heif
    return pillow_heif.HeifImageFile(path)


def orientation_of_heic(path: Path) -> int:
    """Return how the library turns the stored picture, as EXIF numbers it; 1 also where that is not plain.

    The file's own turn counts (`irot`, ISO/IEC 23008-12), and not its EXIF, which programs change without it.
    """
    data = path.read_bytes()
    turns = set(re.findall(rb"\0\0\0\x09irot(.)", data, re.DOTALL))
    if len(turns) != 1 or b"\0\0\0\x09imir" in data:
        return 1
    return (1, 8, 3, 6)[turns.pop()[0] & 3]  # quarter turns anticlockwise
