"""RAW files of cameras: linear, in the camera's own colours. The only file that knows rawpy."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..core.extras import needing
from .image_headers import check_holds

SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".pef", ".raf", ".rw2", ".srw")
FLIPS = (1, 2, 4, 3, 5, 8, 6, 7)  # EXIF orientations of the turns that LibRaw numbers from 0
EXPANSION = 64  # largest number of pixels that a byte becomes


def decode_raw(path: Path, data: bytes) -> np.ndarray:
    """Return a RAW file's pixels as stored, of 16 bits, 65535 where its sensor is full.

    They are linear and without white balance. The black level is taken off, and colours are interpolated between the
    sensor's pixels. White is the file's, not the brightest pixel, so that exposures can be compared.
    """
    with _opened(path) as raw:
        import rawpy

        check_holds(raw.sizes.raw_height * raw.sizes.raw_width, len(data), EXPANSION)
        raw.unpack()
        return raw.postprocess(
            gamma=(1, 1),
            no_auto_bright=True,
            adjust_maximum_thr=0.0,
            use_camera_wb=False,
            user_wb=[1.0, 1.0, 1.0, 1.0],
            output_color=rawpy.ColorSpace.raw,
            output_bps=16,
            user_flip=0,
        )


def orientation_of_raw(path: Path) -> tuple[int, tuple[int, int]]:
    """Return how a file states that its picture is turned, as EXIF numbers it, and its height and width as stored."""
    with _opened(path) as raw:
        return FLIPS[raw.sizes.flip], (raw.sizes.height, raw.sizes.width)


def exposure_of_raw(path: Path) -> tuple[float, float, float]:
    """Return exposure time in seconds, F-number and ISO, 0 where the file does not say."""
    with _opened(path) as raw:
        return raw.other.shutter_speed, raw.other.aperture, raw.other.iso_speed


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    with needing("raw", f"cannot read {path}"):
        import rawpy
    with rawpy.RawPy() as raw:
        raw.open_file(str(path))
        yield raw
