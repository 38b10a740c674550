"""Arrays: numbers of any shape in NumPy's .npy, mapped from disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .files import replacing
from .image_headers import NPY_HEADER


def read_array(path: Path) -> np.ndarray:
    """Return the array of numbers in a .npy file, read-only, mapped from disk.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It holds no array of numbers, or fewer than it declares.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}. Copy the whole folder that it belongs to.")
    try:
        array = np.lib.format.open_memmap(path, mode="r", max_header_size=NPY_HEADER)
    except Exception as error:  # NumPy's parser raises many kinds; mapping fails before memory is allocated
        said = " ".join(f"{error}".split())[:200] or type(error).__name__
        raise ValueError(f"{path} is damaged: {said}. Write it again.") from None
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{path} holds {array.dtype}, which are no numbers. Write it again.")
    return array


def write_array(path: Path, array: np.ndarray) -> None:
    """Write an array as .npy, whole or not at all."""
    with replacing(path) as temporary:
        np.save(temporary, array)
