"""Lazy images: larger than memory, opened without being read, and read by rows. The only file that knows zarr."""

from __future__ import annotations

import itertools
import math
import os
import threading
import weakref
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.extras import needing
from .encodings import Encoding
from .image_headers import ANY_EXPANSION, NPY_HEADER, TIFF_EXPANSION, UnsupportedError, check_holds
from .images import as_fractions, as_radiance, check_exists, decoded, decoding, load_stored, numbers_read_as

TILE = 1 << 16  # pixels read at a time
BAND = np.iinfo(np.int32).max  # largest size in bytes of the pieces of a file across the image
Rows = Callable[[int, int], Any]


class LazyImage:
    """An image that is read by rows: `image[r0:r1]` is a NumPy array (r1 - r0, W, C) of floats, read anew each time.

    `open_image` opens files. `View` makes a lazy image of any array that has `shape`, `dtype` and `array[r0:r1]` (h5py,
    zarr, a generator of numbers). Only slices of rows are read. Indexing raises TypeError for anything else, and
    ValueError if the rows that were read are not floats of the expected shape.

    Args:
        rows: Function of the first row and the one after the last that returns these rows as floats.
        shape: (H, W) or (H, W, C).
        dtype: Type of the numbers.
    """

    def __init__(self, rows: Rows, shape: tuple[int, ...], dtype: Any):
        self.rows = rows
        self.shape = tuple(int(length) for length in shape) + ((1,) if len(shape) == 2 else ())
        self.dtype = np.dtype(dtype)
        self.ndim = len(self.shape)

    def __repr__(self) -> str:
        return f"LazyImage(shape={self.shape}, dtype={self.dtype})"

    def __getitem__(self, rows: Any) -> Float[np.ndarray, "r w c"]:
        if not isinstance(rows, slice) or rows.step not in (None, 1):
            raise TypeError(f"a lazy image is read by rows; got the index {rows!r}. Write image[r0:r1].")
        first, last, _ = rows.indices(self.shape[0])
        shape = (max(last - first, 0), *self.shape[1:])
        found = np.asarray(self.rows(first, first + shape[0]))
        if found.dtype.kind != "f" or found.size != np.prod(shape) or len(found) != shape[0]:
            raise ValueError(
                f"rows {first} to {last} of a lazy image must be floats of shape {shape}; got {found.dtype} of shape "
                f"{found.shape}. Correct what its array[r0:r1] returns."
            )
        return found.reshape(shape)

    def colours(self) -> LazyImage:
        """Return the image without its last channel, which is alpha.

        Returns:
            The colours, also read by rows.
        """
        return type(self)(partial(_colours, self), (*self.shape[:2], self.shape[2] - 1), self.dtype)

    def tiles(self) -> Iterator[tuple[int, Float[np.ndarray, "r w c"]]]:
        """Read the image from top to bottom, tile by tile.

        Returns:
            An iterator over the first row of each tile and the tile.
        """
        return ((first, self[first:last]) for first, last in row_tiles(self.shape[0], self.shape[1]))

    def at(self, pixels: np.ndarray) -> Float[np.ndarray, "m c"]:
        """Return the image at some of its pixels, reading few rows at a time.

        Args:
            pixels: Indices into the flattened image.

        Returns:
            One row of channels per pixel, in the order of `pixels`.
        """
        out = np.empty((len(pixels), self.shape[2]), self.dtype)
        row, column = np.divmod(pixels, self.shape[1])
        step = rows_of_a_tile(self.shape[1])
        order = np.argsort(row, kind="stable")
        ends = np.searchsorted(row[order], np.arange(0, self.shape[0] + step, step))
        for start, end in itertools.pairwise(ends):
            if start < end:
                these = order[start:end]
                first, last = int(row[these[0]]), int(row[these[-1]]) + 1
                out[these] = self[first:last][row[these] - first, column[these]]
        return out


class HeldImage(LazyImage):
    """An image that is in memory as its file stores it, and whose rows are decoded when they are asked for."""


def sliced(array: Any, first: int, last: int) -> Any:
    """Return rows of an array."""
    return array[first:last]


def _colours(image: LazyImage, first: int, last: int) -> np.ndarray:
    return image[first:last][..., :-1]


def rows_of_a_tile(width: int) -> int:
    """Return how many rows are read at a time."""
    return max(TILE // width, 1)


def row_tiles(height: int, width: int) -> list[tuple[int, int]]:
    """Return the first row of each tile and the one after its last."""
    step = rows_of_a_tile(width)
    return [(first, min(first + step, height)) for first in range(0, height, step)]


def open_image(path: str | os.PathLike[str], *, srgb: bool | None = None) -> LazyImage:
    """Open an image as linear radiance without reading it; `View` accepts it as its image.

    Its rows, `image[r0:r1]`, are those that `read_image` returns, with the same rules for integers and `srgb`; floats
    keep their precision.

    Formats: .npy and uncompressed .tif are mapped from disk. Other .tif files and .zarr (an array (H, W) or (H, W, C))
    are read by their own tiles; one row of tiles across the image may take at most 2 GiB. The latter, and every .tif,
    need `pip install 'diffshade[zarr]'`.

    Args:
        path: The image file, or the folder of a .zarr.
        srgb: Whether the colours, never alpha, are decoded from the sRGB curve, whatever the file states; by default as
            a .tif states, else False.

    Returns:
        The image, of shape (H, W, C).

    Raises:
        FileNotFoundError: There is no such file.
        IsADirectoryError: `path` is a folder that is not a .zarr.
        ValueError: The suffix, layout or type of number is not supported.
        OSError: The file is damaged; raised when it is opened or when its rows are read.
        ImportError: A package is not installed.
    """
    path = Path(path)
    check_exists(path, folder=path.suffix.lower() == ".zarr")
    opened = {".npy": _open_npy, ".tif": _open_tiff, ".tiff": _open_tiff, ".zarr": _open_zarr}.get(path.suffix.lower())
    if opened is None:
        raise ValueError(
            f"cannot open {path}: a file with the suffix '{path.suffix}' is not read by rows. Write it as .npy, .tif "
            "or .zarr, or read it whole with ds.read_image."
        )
    with decoding(path, f"cannot open {path}"), needing("zarr", f"cannot open {path}"):
        rows, shape, dtype = opened(path.absolute())  # rows are read later, perhaps from another folder
    if len(shape) not in (2, 3) or 0 in shape or (len(shape) == 3 and shape[2] > 4):
        raise ValueError(f"cannot open {path}: it has shape {shape}. An image is (H, W) or (H, W, C), C from 1 to 4.")
    read = FileRows(path, srgb, rows, shape, dtype)
    return LazyImage(read, shape, read(0, 0).dtype)


def hold_image(path: Path, *, srgb: bool | None, orientation: int | None = None) -> HeldImage:
    """Read an image, and hold it as it is stored.

    Integers then take an eighth or a quarter of the memory of `read_image`, whose numbers these are, but that a pixel
    with a colour at the end of its range is 1 in all colours where the primaries change.

    Args:
        path: The image file.
        srgb: As for `read_image`.
        orientation: As for `load_stored`.
    """
    stored = np.ascontiguousarray(load_stored(path, orientation=orientation))
    encoding = numbers_read_as(path, stored.dtype, srgb).encoding
    return HeldImage(partial(_held, path, stored, encoding), stored.shape, np.float64)


def _held(path: Path, stored: np.ndarray, encoding: Encoding, first: int, last: int) -> np.ndarray:
    return as_radiance(path, stored[first:last], encoding, clipped=True)


class FileRows:
    """The decoded rows of an image file. Pickled, it is the file's whole path, and the file is opened again."""

    def __init__(self, path: Path, srgb: bool | None, rows: Rows, shape: tuple[int, ...], dtype: np.dtype):
        self.path, self.srgb, self.rows, self.shape, self.dtype = path, srgb, rows, shape, dtype
        self.whole_path = path.absolute()
        self.encoding = numbers_read_as(path, dtype, srgb).encoding

    def __call__(self, first: int, last: int) -> np.ndarray:
        shape = (last - first, *self.shape[1:], *((1,) if len(self.shape) == 2 else ()))
        try:
            stored = self.rows(first, last).reshape(shape)
        except MemoryError:
            raise
        except Exception as error:  # a reader raises anything: pixels are damaged, or compressed by another package
            said = " ".join(f"{error}".split())
            raise OSError(f"cannot read {self.path}: {said}. Make it again without compression or predictor.") from None
        fractions = stored if self.dtype.kind == "f" else as_fractions(self.path, stored)
        return decoded(fractions, self.dtype, self.encoding)

    def __reduce__(self) -> tuple[Any, ...]:
        return _opened_again, (self.whole_path, self.srgb)


def _opened_again(path: Path, srgb: bool | None) -> Rows:
    return open_image(path, srgb=srgb).rows


Opened = tuple[Rows, tuple[int, ...], np.dtype]


def _open_npy(path: Path) -> Opened:
    return _mapped(path, np.lib.format.open_memmap(path, "r", max_header_size=NPY_HEADER))


def _mapped(path: Path, whole: np.memmap) -> Opened:
    """Map rows alone, and let go of them: pages of a map of the whole stay in memory once they are touched."""
    shape, dtype, offset = whole.shape, whole.dtype, whole.offset  # offset is where the numbers begin in the file
    if not whole.flags.c_contiguous:
        return (lambda first, last: np.array(whole[first:last])), shape, dtype
    width = int(np.prod(shape[1:])) * dtype.itemsize

    def rows(first: int, last: int) -> np.ndarray:
        if first == last:
            return np.zeros((0, *shape[1:]), dtype)
        of = np.memmap(path, dtype, "r", offset + first * width, (last - first, *shape[1:]))
        return np.array(of)

    return rows, shape, dtype


def _open_tiff(path: Path) -> Opened:
    import tifffile

    with tifffile.TiffFile(path) as file:
        page, series = file.pages.first, file.series[0]
        if series.axes not in ("YX", "YXS") or page.photometric not in (1, 2):
            raise UnsupportedError(
                f"is a TIFF with axes {series.axes} and Photometric {page.photometric:d}. Save one picture, grey, RGB "
                "or RGBA, the channels of a pixel side by side."
            )
        if (orientation := page.tags.valueof(274, default=1)) != 1:
            raise UnsupportedError(
                f"states the orientation {orientation}, and is not turned by rows. Save it upright, or read it whole "
                "with ds.read_image."
            )
        shape, dtype, plain = series.shape, series.dtype, page.is_memmappable
        if not plain:  # in an empty strip or tile every pixel is 0
            piece = math.prod(page.chunks) * dtype.itemsize
            check_holds(piece, max(page.databytecounts), TIFF_EXPANSION.get(page.compression, ANY_EXPANSION))
    if plain:
        return _mapped(path, tifffile.memmap(path, mode="r"))
    import zarr

    store = tifffile.imread(path, aszarr=True)
    array: Any = zarr.open(store, mode="r")
    rows = _by_bands(array if isinstance(array, zarr.Array) else array["0"])  # for a pyramid, the finest image
    weakref.finalize(rows, store.close)
    return rows, shape, dtype


def _open_zarr(path: Path) -> Opened:
    import zarr

    array = zarr.open_array(path, mode="r")
    return _by_bands(array), array.shape, array.dtype


def _by_bands(array: Any) -> Rows:
    """Read whole rows of chunks and keep the last: a chunk is decoded once while the rows go by, not once a slice."""
    step, height = int(array.chunks[0]), int(array.shape[0])
    if (size := min(step, height) * math.prod(array.shape[1:]) * array.dtype.itemsize) > BAND:
        raise UnsupportedError(
            f"is stored in pieces of {step} rows, {size} bytes, which are read at once. Save it in pieces of fewer "
            "rows."
        )
    kept: dict[int, np.ndarray] = {}
    lock = threading.Lock()

    def band(k: int) -> np.ndarray:
        if k not in kept:
            kept.clear()
            kept[k] = np.asarray(array[k * step : min((k + 1) * step, height)])
        return kept[k]

    def rows(first: int, last: int) -> np.ndarray:
        with lock:
            of = [band(k)[max(first - k * step, 0) : last - k * step] for k in range(first // step, -(-last // step))]
        return np.concatenate(of) if of else np.zeros((0, *array.shape[1:]), array.dtype)

    return rows
