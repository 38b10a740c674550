"""Map files: numbers of every pixel, and what is to be known of them, in a folder; each file whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..io.arrays import read_array, write_array
from ..io.files import replacing, write_file
from ..io.image_formats import save
from ..io.images import read_image

SUFFIXES = (".npy", ".exr", ".png")


def map_folder(folder: str | os.PathLike[str], suffix: str) -> Path:
    """Return the folder of maps, made if it does not exist; raise ValueError if maps cannot have this suffix."""
    if suffix not in SUFFIXES:
        raise ValueError(f"suffix must be one of {', '.join(SUFFIXES)}; got {suffix!r}. Give one of them.")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def write_numbers(path: Path, numbers: np.ndarray) -> Path:
    """Write numbers unchanged as .npy, or in float32 as .exr, by the suffix of the path."""
    if path.suffix == ".npy":
        write_array(path, numbers)
    else:
        with replacing(path) as temporary:
            save(temporary, np.asarray(numbers if numbers.ndim == 3 else numbers[..., None], np.float32))
    return path


def read_numbers(path: Path) -> np.ndarray:
    """Return the numbers that `write_numbers` wrote: .npy mapped from disk, .exr as float32.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is damaged.
        OSError: The file is damaged.
    """
    return read_array(path) if path.suffix == ".npy" else read_image(path, srgb=False).astype(np.float32)


def write_about(path: Path, about: Mapping[str, object]) -> Path:
    """Write what is to be known of maps: a TOML file."""
    import tomli_w

    write_file(path, tomli_w.dumps(about))
    return path
