"""Images in and out: 8- and 16-bit, float, sRGB, masks."""

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Shaped

from ..core.arrays import float64_of
from ..core.fields import MOST_BANDS, Numbers
from ..core.masks import as_mask
from ..core.words import with_article
from .encodings import LINEAR, SRGB, Encoding, srgb_encode
from .files import replacing
from .image_formats import FORMATS, Format, bits_of, check_can_save, format_of, save
from .image_headers import UnsupportedError
from .image_statements import Statement, statement_of

_LOGGER = logging.getLogger("diffshade")


def read_image(path: str | os.PathLike[str], *, srgb: bool | None = None) -> Float64[np.ndarray, "h w c"]:
    """Read an image as linear radiance, row 0 on top.

    C is 1 (grey), 2 (grey, alpha), 3 (RGB) or 4 (RGB, alpha), as in the file; or the number of its bands, up to 40: of
    a .npy, or of a TIFF with a grey page for each. Integers are divided by their full range (255, 65535) and are in [0,
    1]; floats are returned unchanged, whatever their range.

    | format | numbers | where the file states no curve |
    |---|---|---|
    | .png | up to 8 bits, palette; 16 bits | sRGB; linear |
    | .jpg, .jpeg, .webp, .bmp, .heic, .heif | 8 bits | sRGB |
    | .ppm, .pgm | up to 8 bits; up to 16 bits | sRGB; linear |
    | .tif, .tiff | up to 16 bits, 32-bit float | linear |
    | .tga | 8 bits | linear |
    | .exr, .hdr, .pfm | half, float; 8 bits and an exponent; float | linear |
    | .npy | uint8, uint16, floats | linear |
    | .dng, .cr2, .cr3, .nef, .arw, .orf, .pef, .raf, .rw2, .srw | RAW | linear |

    A curve and primaries that the file states are used: chunks of PNG (cICP, iCCP, sRGB, gAMA, cHRM), ICC profiles of
    one curve a colour, EXIF ColorSpace, the primaries of OpenEXR and Radiance. Colours of other primaries, such as
    Adobe RGB's, become those of sRGB, and may be below 0 there. Other profiles are not used, and the logger "diffshade"
    warns of them. Radiance is divided by its EXPOSURE, and PFM multiplied by its factor. The picture is turned upright
    as EXIF or TIFF states. RAW files (`pip install 'diffshade[raw]'`): black is taken off, 1 is where the sensor is
    full, and the colours are the camera's own, without white balance. HEIC needs `pip install 'diffshade[heic]'`,
    EXR `'diffshade[exr]'`, and PNG and TIFF of more than 8 bits and HDR `'diffshade[photographs]'`.

    Args:
        path: The image file.
        srgb: Whether the colours, never alpha, are decoded from the sRGB curve, whatever the file states; by default as
            above.

    Returns:
        The image, of shape (H, W, C).

    Raises:
        FileNotFoundError: There is no such file.
        IsADirectoryError: `path` is a folder.
        ValueError: The suffix, layout or type of number is not supported.
        OSError: The file is empty, truncated, damaged or not of the format of its suffix.
        ImportError: The package that reads such a file is not installed.
    """
    path = Path(path)
    stored = load_stored(path)
    taken = numbers_read_as(path, stored.dtype, srgb)
    if srgb is None and (unused := taken.statement.unused):
        _LOGGER.warning("%s states %s, which is not used: it is read as %s.", path, unused, taken.encoding.name)
    return as_radiance(path, stored, taken.encoding)


class ReadAs(NamedTuple):
    """What a file is taken for."""

    kind: str
    """Its format, with the bits of a PNG."""
    encoding: Encoding
    usual: Encoding
    """The encoding of such files that state none."""
    statement: Statement


def read_as(path: Path, *, srgb: bool | None = None) -> ReadAs:
    """Return what `read_image` takes a file for; only its header is read.

    Args:
        path: The image file.
        srgb: As for `read_image`.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: As `read_image` raises it.
        OSError: As `read_image` raises it.
        ImportError: As `read_image` raises it.
    """
    check_exists(path, folder=True)
    with decoding(path, f"cannot read {path}"):
        bits = bits_of(path)
    kind = f"{bits}-bit PNG" if _kind(path) == "PNG" else _kind(path)
    return numbers_read_as(path, np.dtype(f"u{bits // 8}"), srgb, kind)


def numbers_read_as(path: Path, dtype: np.dtype, srgb: bool | None, kind: str = "") -> ReadAs:
    """Return what a file with numbers of a type is taken for: as asked, else as it states, else as usual."""
    statement = statement_of(path)
    usual = SRGB if _is_srgb(path, dtype, None) else LINEAR
    given = (statement.encoding or usual) if srgb is None else SRGB if srgb else LINEAR
    return ReadAs(kind, given, usual, statement)


def load_stored(path: Path, *, orientation: int | None = None) -> Shaped[np.ndarray, "h w c"]:
    """Read the numbers of an image as they are stored, without a warning.

    Args:
        path: The image file.
        orientation: How the stored picture is turned, as EXIF numbers it; None: as the file states.
    """
    stored = _read(path)  # before what it states, for a file that is damaged is said to be so
    return _upright(path, stored, statement_of(path).orientation, orientation)


def as_radiance(
    path: Path, stored: Shaped[np.ndarray, "h w c"], encoding: Encoding, *, clipped: bool = False
) -> Float64[np.ndarray, "h w c"]:
    """Return stored numbers, all or some rows of them, as linear radiance.

    Args:
        path: The image file.
        stored: The numbers.
        encoding: What they are taken for.
        clipped: Whether a pixel with a colour at the end of its range becomes 1 in all colours where the primaries
            change: each then depends on the one that is not known.
    """
    if stored.dtype == np.uint8 and len(encoding.curves) == 1 and encoding.to_srgb is None and not _has_alpha(stored):
        levels = np.arange(256, dtype=np.uint8)[:, None, None]
        return decoded(as_fractions(path, levels), stored.dtype, encoding)[:, 0, 0][stored]
    image = decoded(as_fractions(path, stored), stored.dtype, encoding)
    if clipped and stored.dtype.kind == "u" and encoding.to_srgb is not None:
        full = (without_alpha(stored) == np.iinfo(stored.dtype).max).any(-1)
        without_alpha(image)[full] = 1.0
    return image


def _upright(path: Path, stored: np.ndarray, own: int, orientation: int | None = None) -> np.ndarray:
    """Return a file's picture upright, by its own orientation or another one."""
    wanted = own if orientation is None else orientation
    if format_of(path).upright:
        if wanted == own:
            return stored
        stored = turned(stored, {6: 8, 8: 6}.get(own, own))  # back to how it is stored
    return turned(stored, wanted)


def turned(stored: np.ndarray, orientation: int) -> np.ndarray:
    """Return a stored picture (H, W, C) upright: orientation 1 to 8 as in EXIF and TIFF 6.0."""
    picture = stored[::-1] if orientation in (3, 4, 6, 7) else stored
    picture = picture[:, ::-1] if orientation in (2, 3, 7, 8) else picture
    return np.swapaxes(picture, 0, 1) if orientation > 4 else picture


def read_mask(path: str | os.PathLike[str]) -> Bool[np.ndarray, "h w"]:
    """Read a mask: True where alpha or, in a file without alpha or opaque everywhere, the mean colour is at least half.

    Half is half of the full range of integers (128 of 255 is inside and 127 is not) and .5 for floats. Integers that
    are all 0 or 1 are False and True. No sRGB curve is applied.

    Args:
        path: The image file, in one of the formats of `read_image`, which turns it as the file states.

    Returns:
        The mask, of shape (H, W).

    Raises:
        FileNotFoundError: There is no such file.
        IsADirectoryError: `path` is a folder.
        ValueError: As `read_image` raises it, or the values are not those of a mask.
        TypeError: The numbers of a .npy are not real.
        OSError: As `read_image` raises it.
    """
    path = Path(path)
    upright = load_stored(path)
    if (bands := upright.shape[-1]) > 4:
        raise ValueError(f"cannot read {path}: it has {bands} bands, and a mask 1 to 4. Write one of them.")
    return np.asarray(as_mask(upright, f"mask {path}"))


def write_image(
    path: str | os.PathLike[str], image: Numbers, *, srgb: bool | None = None, bits: int | None = None
) -> None:
    """Write linear radiance to an image file: the whole file or, on error, nothing.

    Integer formats clip to [0, 1], and the logger "diffshade" warns of the number of clipped pixels; float formats keep
    every value.

    Args:
        path: The image file; its suffix chooses the format, one of those of `read_image` but RAW and HEIC. WebP is
            written without loss. Grey becomes three equal colours in WebP and Radiance.
        image: Linear radiance of shape (H, W) or (H, W, C), with C as in `read_image`. Of more than 4 bands, each is a
            grey page of a TIFF, as are two channels of more than 8 bits.
        srgb: Whether the colours, never alpha, are encoded by the sRGB curve; by default the rule of `read_image`
            for files that state no curve, so that a file reads back as it was written.
        bits: Bits per number: 8 or 16 for PNG, PPM and PGM; 8 for JPEG, WebP, BMP and TGA; 16, 8 or 32 (float) for
            TIFF; 32 (float) or 16 (half) for EXR; 32 (float) for PFM, and for HDR, which keeps 8 and an exponent; 64
            for .npy. The first is the default.

    Raises:
        ValueError: A value is not finite or too large for the format, or the shape, suffix or number of bits is not
            supported.
        TypeError: The image is no array of real numbers, or carries more than numbers: a unit, masked values.
        FileNotFoundError: The folder does not exist.
        PermissionError: The folder is not writable.
        IsADirectoryError: `path` is a folder.
        ImportError: The package that writes such a file is not installed.
    """
    path = Path(path)
    dtype = dtype_to_write(path, bits)
    subject = f"cannot write {path}: the image"
    pixels = _with_channels(float64_of(subject, image), subject, format_of(path))
    _check_can_hold(path, dtype, pixels)
    if dtype.kind == "u":
        pixels = _clip(path, pixels)
    if _is_srgb(path, dtype, srgb):
        pixels = _on_colours(srgb_encode, pixels)
    if dtype.kind == "u":
        pixels *= np.iinfo(dtype).max  # in place: `_clip` made them
        np.rint(pixels, out=pixels)
    with replacing(path) as temporary:
        save(temporary, pixels.astype(dtype))


# Valid arrays and files


def _is_srgb(path: Path, dtype: np.dtype, asked: bool | None) -> bool:
    """Whether a file that states no curve has that of sRGB: as asked, else by its format if it has 8 bits."""
    known = FORMATS.get(path.suffix.lower())  # none for .zarr
    return dtype == np.uint8 and known is not None and known.srgb if asked is None else asked


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


def decoded(image: np.ndarray, stored: np.dtype, encoding: Encoding) -> np.ndarray:
    """Return linear radiance. What is outside the primaries of sRGB may be below 0, but of integers not above 1."""
    if encoding is LINEAR:
        return image
    if stored == np.uint8:
        encoding = encoding._replace(curves=tuple(_table(curve, 255) for curve in encoding.curves))
    linear = _on_colours(encoding.decode, image)
    return np.minimum(linear, 1.0) if stored.kind == "u" else linear


def _table(curve: Callable[[np.ndarray], np.ndarray], most: int) -> Callable[[np.ndarray], np.ndarray]:
    """Return a curve that is looked up for each of a file's few levels, from 0 to most, in a tenth of the time."""
    values = np.asarray(curve(np.arange(most + 1) / most))
    return lambda levels: values[np.rint(levels * most).astype(np.uint8)]


def _read(path: Path) -> np.ndarray:
    """The numbers of a file as they are stored, shape (H, W, C)."""
    check_exists(path)
    known = format_of(path)
    with decoding(path, f"cannot read {path}"):
        stored = known.decode(path.absolute(), path.read_bytes())
    return _with_channels(stored, f"cannot read {path}: it", known)


@contextmanager
def decoding(path: Path, task: str) -> Iterator[None]:
    """Turn what a decoder raises, for a damaged file anything from SyntaxError to struct.error, into one sentence."""
    try:
        yield
    except (ImportError, MemoryError, PermissionError):
        raise
    except UnsupportedError as error:
        raise ValueError(f"{task}: it {error}") from None
    except Exception:
        raise OSError(
            f"{task}: it is no {_kind(path)}, or is empty, truncated or damaged. Make or copy the file again."
        ) from None


def _kind(path: Path) -> str:
    suffix = path.suffix.lower()
    return FORMATS[suffix].name if suffix in FORMATS else suffix.removeprefix(".")


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
    name = format_of(path).name
    dtypes = {8 * np.dtype(kind).itemsize: np.dtype(kind) for kind in format_of(path).dtypes}
    if not dtypes:
        raise ValueError(f"cannot write {path}: {name} is only read. Write .png, .tif, .exr or .npy.")
    if bits is not None and bits not in dtypes:
        raise ValueError(f"cannot write {path} with bits={bits}. {name} takes {' or '.join(map(str, dtypes))}.")
    dtype = dtypes[bits] if bits is not None else next(iter(dtypes.values()))
    check_can_save(path, dtype)
    return dtype


def _check_can_hold(path: Path, dtype: np.dtype, pixels: np.ndarray) -> None:
    bad = np.argwhere(~np.isfinite(pixels))
    if len(bad):
        row, column, channel = bad[0]
        raise ValueError(
            f"cannot write {path}: the image is {pixels[row, column, channel]} at row {row}, column {column}, channel "
            f"{channel}; {len(bad)} of {pixels.size} values are not finite. Find out where they come from."
        )
    name, channels = format_of(path).name, pixels.shape[-1]
    if not format_of(path).alpha and _has_alpha(pixels):
        raise ValueError(
            f"cannot write {path}: {with_article(name)} has no alpha. Leave the last channel out, or write a PNG."
        )
    if name == "HDR" and pixels.min() < 0:
        raise ValueError(
            f"cannot write {path}: HDR holds no value below 0; got {pixels.min():g}. Clip it, or write .exr."
        )
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
