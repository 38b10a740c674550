"""Images in and out: 8- and 16-bit, float, sRGB, masks."""

import logging
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64

from ..core.fields import MOST_BANDS, Numbers
from .files import replacing
from .image_formats import FORMATS, Format, format_of, png_depth, save
from .image_headers import UnsupportedError

_LOGGER = logging.getLogger("diffshade")


def read_image(path: str | os.PathLike[str], *, srgb: bool | None = None) -> Float64[np.ndarray, "h w c"]:
    """Read an image as linear radiance, row 0 on top.

    C is 1 (grey), 2 (grey, alpha), 3 (RGB) or 4 (RGB, alpha), as in the file; or the number of its bands, up to 40: of
    a .npy, or of a TIFF with a grey page for each. Integers are divided by their full range (255, 65535) and are in [0,
    1]; floats are returned unchanged, whatever their range.

    Formats: PNG (up to 16 bits, palette), JPEG (turned upright by its EXIF tag), TIFF (up to 16 bits, 32-bit float),
    TGA, OpenEXR (half, float) and .npy (uint8, uint16, floats). Colour profiles are ignored. RAW files of cameras
    (.dng, .cr2, .cr3, .nef, .arw, .orf, .pef, .raf, .rw2, .srw; `pip install 'diffshade[raw]'`) are linear: black is
    taken off, 1 is where the sensor is full, and the colours are the camera's own, without white balance.

    Args:
        path: The image file.
        srgb: Whether the colours, never alpha, are decoded from the sRGB curve; by default True for JPEG and 8-bit PNG,
            else False.

    Returns:
        The image, of shape (H, W, C).

    Raises:
        FileNotFoundError: There is no such file.
        IsADirectoryError: `path` is a folder.
        ValueError: The suffix, layout or type of number is not supported.
        OSError: The file is empty, truncated, damaged or not of the format of its suffix.
        ImportError: The file is RAW, and rawpy is not installed.
    """
    path = Path(path)
    stored = _read(path)
    return decoded(path, as_fractions(path, stored), stored.dtype, srgb)


def encoding_of(path: Path, *, srgb: bool | None = None) -> tuple[str, bool]:
    """Return the kind of an image file in a word or two, and whether `read_image` decodes it from the sRGB curve.

    Only the header is read.

    Args:
        path: The image file.
        srgb: As for `read_image`.

    Returns:
        The kind, and whether the sRGB curve is decoded.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: As `read_image` raises it.
        OSError: As `read_image` raises it.
    """
    check_exists(path, folder=True)
    suffix = path.suffix.lower()
    kind = FORMATS[suffix].name if suffix in FORMATS else suffix.removeprefix(".")
    dtype = np.dtype(np.uint8)
    if suffix == ".png":
        depth = png_depth(path)
        kind, dtype = f"{depth}-bit PNG", dtype if depth <= 8 else np.dtype(np.uint16)
    return kind, _is_srgb(path, dtype, srgb)


def read_mask(path: str | os.PathLike[str]) -> Bool[np.ndarray, "h w"]:
    """Read a mask: True where alpha or, in a file without alpha or opaque everywhere, the mean colour is at least half.

    Half is half of the full range of integers (128 of 255 is inside and 127 is not) and .5 for floats. No sRGB curve is
    applied.

    Args:
        path: The image file, in one of the formats of `read_image`.

    Returns:
        The mask, of shape (H, W).

    Raises:
        FileNotFoundError: There is no such file.
        IsADirectoryError: `path` is a folder.
        ValueError: As `read_image` raises it.
        OSError: As `read_image` raises it.
    """
    path = Path(path)
    image = as_fractions(path, _read(path))
    if not _has_alpha(image):
        return image.mean(axis=-1) >= 0.5
    colours, alpha = image[..., :-1], image[..., -1]
    return (alpha if (alpha < 0.5).any() else colours.mean(axis=-1)) >= 0.5


def write_image(
    path: str | os.PathLike[str], image: Numbers, *, srgb: bool | None = None, bits: int | None = None
) -> None:
    """Write linear radiance to an image file: the whole file or, on error, nothing.

    Integer formats clip to [0, 1], and the logger "diffshade" warns of the number of clipped pixels; float formats keep
    every value.

    Args:
        path: The image file; its suffix chooses the format, one of those of `read_image`.
        image: Linear radiance of shape (H, W) or (H, W, C), with C as in `read_image`. Of more than 4 bands, each is a
            grey page of a TIFF, as are two channels of more than 8 bits.
        srgb: Whether the colours, never alpha, are encoded by the sRGB curve; by default the rule of `read_image`, so
            that a file reads back as it was written.
        bits: Bits per number: 8 or 16 for PNG; 8 for JPEG and TGA; 16, 8 or 32 (float) for TIFF; 32 (float) or 16
            (half) for EXR; 64 for .npy. The first is the default.

    Raises:
        ValueError: A value is not finite or too large for the format, or the shape, suffix or number of bits is not
            supported.
        FileNotFoundError: The folder does not exist.
        PermissionError: The folder is not writable.
        IsADirectoryError: `path` is a folder.
    """
    path = Path(path)
    dtype = dtype_to_write(path, bits)
    pixels = _as_pixels(path, image)
    _check_can_hold(path, dtype, pixels)
    if dtype.kind == "u":
        pixels = _clip(path, pixels)
    if _is_srgb(path, dtype, srgb):
        pixels = _on_colours(srgb_encode, pixels)
    if dtype.kind == "u":
        pixels = np.rint(pixels * np.iinfo(dtype).max)
    with replacing(path) as temporary:
        save(temporary, pixels.astype(dtype))


def srgb_encode(linear: Numbers) -> Float64[np.ndarray, "..."]:
    r"""Encode linear radiance by the sRGB curve (IEC 61966-2-1:1999).

    $$ 12.92 x \text{ where } x \le 0.0031308, \text{ else } 1.055 x^{1 / 2.4} - 0.055 $$

    The curve maps [0, 1] to [0, 1] and continues outside.

    Args:
        linear: Linear radiance, any shape.

    Returns:
        The sRGB values, of the same shape.

    Raises:
        ValueError: `linear` is not an array of numbers.
    """
    x = np.asarray(linear, np.float64)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055)


def srgb_decode(encoded: Numbers) -> Float64[np.ndarray, "..."]:
    r"""Decode sRGB to linear radiance (IEC 61966-2-1:1999): the inverse of `srgb_encode`.

    $$ x / 12.92 \text{ where } x \le 0.04045, \text{ else } ((x + 0.055) / 1.055)^{2.4} $$

    Args:
        encoded: sRGB values, any shape.

    Returns:
        Linear radiance, of the same shape.

    Raises:
        ValueError: `encoded` is not an array of numbers.
    """
    x = np.asarray(encoded, np.float64)
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0.04045) + 0.055) / 1.055) ** 2.4)


# Valid arrays and files


def _is_srgb(path: Path, dtype: np.dtype, asked: bool | None) -> bool:
    """Whether to decode a file from sRGB: as asked, else if it has 8 bits and is PNG or JPEG; profiles are ignored."""
    return dtype == np.uint8 and path.suffix.lower() in (".png", ".jpg", ".jpeg") if asked is None else asked


def _has_alpha(image: np.ndarray) -> bool:
    return image.shape[-1] in (2, 4)


def without_alpha(image: np.ndarray) -> np.ndarray:
    """Return an image (H, W, C) without alpha, not copied."""
    return image[..., :-1] if _has_alpha(image) else image


def _on_colours(curve: Callable[[np.ndarray], np.ndarray], image: np.ndarray) -> np.ndarray:
    n_colours = image.shape[-1] - _has_alpha(image)
    return np.concatenate([curve(image[..., :n_colours]), image[..., n_colours:]], axis=-1)


def _with_channels(array: np.ndarray, subject: str, known: Format) -> np.ndarray:
    image = array[..., None] if array.ndim == 2 else array
    if image.ndim != 3 or image.size == 0 or image.shape[-1] > known.channels:
        bands = " Write more bands as .npy or .tif." if image.ndim == 3 and 4 < image.shape[-1] <= MOST_BANDS else ""
        raise ValueError(
            f"{subject} has shape {array.shape}. An image is (H, W) or (H, W, C) with C from 1 to {known.channels}."
            f"{bands}"
        )
    return image


# Reading


def check_exists(path: Path, *, folder: bool = False) -> None:
    """Refuse a file that does not exist and, unless `folder` is true, a folder."""
    if path.is_dir() and not folder:
        raise IsADirectoryError(f"cannot read {path}: it is a folder. Give the name of an image file.")
    if not path.exists():
        raise FileNotFoundError(f"cannot read {path}: there is no such file. Check the name and the folder.")


def decoded(path: Path, image: np.ndarray, stored: np.dtype, srgb: bool | None) -> np.ndarray:
    """Return linear radiance: decode the sRGB curve if the file, with numbers of type `stored`, has one."""
    return _on_colours(srgb_decode, image) if _is_srgb(path, stored, srgb) else image


def _read(path: Path) -> np.ndarray:
    """The numbers of a file as they are stored, shape (H, W, C)."""
    check_exists(path)
    known = format_of(path)
    try:
        stored = known.decode(path.absolute(), path.read_bytes())  # imageio reads a leading ~ as a home folder
    except (ImportError, MemoryError, PermissionError):
        raise
    except UnsupportedError as error:
        raise ValueError(f"cannot read {path}: it {error}") from None
    except Exception:  # for a damaged file a decoder raises anything, from SyntaxError to struct.error
        message = f"it is no {known.name}, or is empty, truncated or damaged. Make or copy the file again."
        raise OSError(f"cannot read {path}: {message}") from None
    return _with_channels(stored, f"cannot read {path}: it", known)


def as_fractions(path: Path, stored: np.ndarray) -> np.ndarray:
    """Return stored numbers as floats: integers divided by their full range, floats as they are."""
    if stored.dtype.kind == "u" and stored.dtype.itemsize <= 2:
        return stored / float(np.iinfo(stored.dtype).max)
    if stored.dtype.kind in "bf":
        return stored.astype(np.float64)
    raise ValueError(f"cannot read {path}: it has numbers of type {stored.dtype}. Use uint8, uint16 or floats.")


# Writing


def dtype_to_write(path: Path, bits: int | None) -> np.dtype:
    """Return the number type of a file's format for a number of bits; refuse what it does not support."""
    name, _, types, _ = format_of(path)
    dtypes = {8 * np.dtype(kind).itemsize: np.dtype(kind) for kind in types}
    if not dtypes:
        raise ValueError(f"cannot write {path}: {name} is only read. Write .png, .tif, .exr or .npy.")
    if bits is not None and bits not in dtypes:
        raise ValueError(f"cannot write {path} with bits={bits}. {name} takes {' or '.join(map(str, dtypes))}.")
    return dtypes[bits] if bits is not None else next(iter(dtypes.values()))


def _as_pixels(path: Path, image: Numbers) -> np.ndarray:
    array = np.asarray(image)
    if np.iscomplexobj(array) or array.dtype.kind in "OSUMm":
        raise ValueError(f"cannot write {path}: the image has type {array.dtype}. Give an array of real numbers.")
    return _with_channels(array.astype(np.float64), f"cannot write {path}: the image", format_of(path))


def _check_can_hold(path: Path, dtype: np.dtype, pixels: np.ndarray) -> None:
    bad = np.argwhere(~np.isfinite(pixels))
    if len(bad):
        row, column, channel = bad[0]
        raise ValueError(
            f"cannot write {path}: the image is {pixels[row, column, channel]} at row {row}, column {column}, channel "
            f"{channel}; {len(bad)} of {pixels.size} values are not finite. Find out where they come from."
        )
    name, channels = format_of(path).name, pixels.shape[-1]
    if name == "JPEG" and _has_alpha(pixels):
        raise ValueError(f"cannot write {path}: a JPEG has no alpha. Leave the last channel out, or write a PNG.")
    if name == "PNG" and dtype != np.uint8 and channels == 2:
        raise ValueError(f"cannot write {path}: {name} with grey + alpha takes bits=8. Write RGBA, EXR or .npy.")
    if dtype.kind == "f" and (largest := np.abs(pixels).max()) > np.finfo(dtype).max:
        raise ValueError(f"cannot write {path}: {largest:g} is too large for {dtype}. Scale the image, or write .npy.")


def _clip(path: Path, pixels: np.ndarray) -> np.ndarray:
    above, below = (pixels > 1).any(axis=-1), (pixels < 0).any(axis=-1)
    if n_clipped := np.count_nonzero(above | below):
        _LOGGER.warning(
            "%s: %d of %d pixels were clipped to [0, 1], %d above 1 and %d below 0. Scale the image, or write .exr.",
            *(path, n_clipped, above.size, np.count_nonzero(above), np.count_nonzero(below)),
        )
    return pixels.clip(0, 1)
