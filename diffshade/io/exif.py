"""EXIF: how long, how wide open and how sensitive a camera was for a photograph, as its file says."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL.ExifTags import IFD, Base

from .heic_files import SUFFIXES as HEIC_SUFFIXES
from .heic_files import opened_heic
from .raw_files import SUFFIXES as RAW_SUFFIXES
from .raw_files import exposure_of_raw


def stated_exposures(files: Sequence[Path]) -> Float[np.ndarray, " photographs"]:
    r"""Return the exposure of each photograph, NaN where its file does not state it.

    $$ \frac{t \cdot ISO}{N^2} $$

    with the exposure time t in seconds and the F-number N (ISO 12232). An F-number or ISO that no file states, as with
    a lens without contacts, is taken to be the same in all.
    """
    stated = np.array([_stated(file) for file in files]).reshape(len(files), 3)
    stated[:, 1:] = np.where(np.isnan(stated[:, 1:]).all(0), 1.0, stated[:, 1:])
    time, number, iso = stated.T
    return time * iso / number**2


def _stated(file: Path) -> tuple[float, ...]:
    """Return exposure time, F-number and ISO, NaN where a file does not state them."""
    try:
        with warnings.catch_warnings():  # of Pillow about damaged EXIF
            warnings.simplefilter("ignore", UserWarning)
            stated = exposure_of_raw(file) if file.suffix.lower() in RAW_SUFFIXES else _tagged(file)
    except ImportError:
        raise
    except Exception:  # a file without EXIF, such as .exr, or a damaged one, which its reader will name
        return (np.nan,) * 3
    return tuple(_positive(number) for number in stated)


def _tagged(file: Path) -> tuple[Any, ...]:
    from PIL import Image

    opened = opened_heic if file.suffix.lower() in HEIC_SUFFIXES else Image.open
    with opened(file) as image:
        tags = image.getexif()
        camera = {**tags, **tags.get_ifd(IFD.Exif)}
    iso = camera.get(Base.ISOSpeedRatings)
    if iso == 0xFFFF:  # it does not fit into this tag
        iso = camera.get(Base.RecommendedExposureIndex)
    return camera.get(Base.ExposureTime), camera.get(Base.FNumber), iso


def _positive(number: Any) -> float:
    """Return a number of a tag, or the first of several; NaN where it is no positive number."""
    try:
        found = float(np.ravel(number)[0])
    except (TypeError, ValueError, IndexError, ZeroDivisionError):
        return np.nan
    return found if 0.0 < found < np.inf else np.nan
