"""Image formats: bytes to numbers and back. The only module that knows imageio, Pillow's pixels and OpenEXR.

Pillow reads and writes files of 8 bits, and OpenCV the others: Pillow silently drops the low byte of 16-bit RGB, and
OpenCV premultiplies the alpha of 8-bit TIFF and returns grey + alpha as RGBA. Neither scales PPM of more than 8 bits by
its largest value, and OpenCV divides PFM by the factor that multiplies it: they are read here. A file is checked before
it is decoded (`image_headers`). OpenCV and OpenEXR are of extras: who has neither reads and writes the other formats.
"""

import io
import math
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..core.extras import check_extra, needing
from ..core.fields import MOST_BANDS
from .heic_files import SUFFIXES as HEIC_SUFFIXES
from .heic_files import decode_heic
from .image_headers import (
    NETPBM_HEADER,
    NPY_HEADER,
    UnsupportedError,
    check_exr,
    check_pixels,
    check_png,
    check_tiff,
    netpbm_header,
    radiance_header,
)
from .raw_files import SUFFIXES as RAW_SUFFIXES
from .raw_files import decode_raw

_OPENCV_LOG = threading.Lock()


class Format(NamedTuple):
    """How files of a suffix are read and written."""

    name: str
    decode: Callable[[Path, bytes], np.ndarray]
    dtypes: tuple[type, ...]  # types that can be written, the default first; none if it is read alone
    channels: int = 4  # at most; more than 4 are bands
    srgb: bool = False  # whether its 8-bit files have the sRGB curve where they do not state another
    alpha: bool = True  # whether it is written with alpha
    upright: bool = False  # whether `decode` turns it as the file states; the others return what is stored


def format_of(path: Path) -> Format:
    """Return the format of a path by its suffix; ValueError for an unknown one."""
    try:
        return FORMATS[path.suffix.lower()]
    except KeyError:
        known = ", ".join(FORMATS)
        raise ValueError(f"{path} has the suffix '{path.suffix}', which is not a known image. Use {known}.") from None


def bits_of(path: Path) -> int:
    """Return the bits per number that a PNG, PPM or PGM is read with, from its header, 8 for fewer; 8 for others."""
    suffix = path.suffix.lower()
    if suffix not in (".png", ".ppm", ".pgm"):
        return 8
    with path.open("rb") as file:
        header = file.read(NETPBM_HEADER)
    deep = header[24:25] == b"\x10" if suffix == ".png" else netpbm_header(header).maximum > 255
    return 16 if deep else 8


def _decode_png(path: Path, data: bytes) -> np.ndarray:
    depth, colour_type = check_png(data)
    if depth < 16:
        return _decode_with_pillow("PNG", path, data)
    pixels = _decode_with_opencv(path)
    return pixels[..., [0, 3]] if colour_type == 4 else pixels  # grey + alpha, which OpenCV returns as RGBA


def _decode_tiff(path: Path, data: bytes) -> np.ndarray:
    tags, *more = check_tiff(data)
    bits, number, channels, photometric, planar = (tags.get(tag, (1,))[0] for tag in (258, 339, 277, 262, 284))
    if more and (bits, number) in ((8, 1), (16, 1), (32, 3)):
        return np.moveaxis(_decode_with_opencv(path, page=...), 0, -1)
    if bits <= 8 and not more:
        return _decode_with_pillow("TIFF", path, data)
    # OpenCV silently returns wrong pixels for other layouts.
    if (bits, number) in ((16, 1), (32, 3)) and channels in (1, 3, 4) and photometric in (1, 2) and planar == 1:
        return _decode_with_opencv(path)
    raise UnsupportedError(
        f"is a TIFF with BitsPerSample {bits}, SampleFormat {number}, SamplesPerPixel {channels}, Photometric "
        f"{photometric}, PlanarConfiguration {planar}. Save it as 16-bit unsigned or 32-bit float, grey, RGB or RGBA."
    )


def _decode_exr(path: Path, data: bytes) -> np.ndarray:
    with needing("exr", f"cannot read {path}"):
        import OpenEXR
    check_exr(data)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        header, channels = file.header(), file.channels()
        if not np.array_equal(header["dataWindow"], header["displayWindow"]):
            raise UnsupportedError("holds a part of a picture (dataWindow is not displayWindow). Save the whole.")
        for names in ("RGBA", "RGB", "YA", "Y"):
            if set(names) <= set(channels) and "RY" not in channels:  # beside RY and BY, Y is the luminance of a colour
                return np.stack([channels[name].pixels for name in names], axis=-1)
        raise UnsupportedError(f"has the channels {', '.join(channels)}. Save R, G, B or Y, with or without A.")


def _decode_npy(path: Path, data: bytes) -> np.ndarray:
    if data.startswith(b"\x93NUMPY") and b"'descr': '|O'" in data[:128]:
        raise UnsupportedError("holds Python objects. Save an array of numbers.")
    # If the file is too short for its declared shape, mapping fails before memory is allocated.
    return np.lib.format.open_memmap(path, "r", max_header_size=NPY_HEADER)


def _decode_netpbm(path: Path, data: bytes) -> np.ndarray:
    kind, width, height, maximum, start = netpbm_header(data[:NETPBM_HEADER])
    if kind in (b"P1", b"P4"):  # a bit a pixel
        return _decode_with_pillow("PPM", path, data)
    shape = (height, width, 3 if kind in (b"P3", b"P6") else 1)
    dtype, full = (np.uint8, 255) if maximum < 256 else (np.uint16, 65535)
    if kind in (b"P2", b"P3"):  # text
        words = data[start - 1 :].decode("ascii").split(maxsplit=math.prod(shape))
        stored = np.array(words[: math.prod(shape)], np.int64)
    else:
        stored = np.frombuffer(data, np.dtype(dtype).newbyteorder(">"), math.prod(shape), start)
    if not 0 <= stored.min() <= stored.max() <= maximum:
        raise ValueError
    return np.rint(stored.reshape(shape) * (full / maximum)).astype(dtype)


def _decode_pfm(path: Path, data: bytes) -> np.ndarray:
    kind, width, height, factor, start = netpbm_header(data[:NETPBM_HEADER])
    shape = (height, width, {b"PF": 3, b"Pf": 1}[kind])
    stored = np.frombuffer(data, "<f4" if factor < 0 else ">f4", math.prod(shape), start).reshape(shape)
    return stored[::-1].astype(np.float32) * np.float32(abs(factor))  # the last row is stored first


def _decode_radiance(path: Path, data: bytes) -> np.ndarray:
    header = radiance_header(data)
    check_pixels("HDR", header.size, data)
    return _decode_with_opencv(path) / np.float32(header.exposure)


def _decode_with_pillow(name: str, path: Path, data: bytes) -> np.ndarray:
    import imageio.v3 as iio
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data), formats=(name,)) as image:
            check_pixels(name, image.size, data)
            mode, alpha = image.mode, "A" if image.has_transparency_data else ""
    except Image.DecompressionBombError:
        raise UnsupportedError("has more than 178 million pixels. Save it smaller, or with 16 bits.") from None
    if mode not in ("1", "L", "LA", "P", "PA", "RGB", "RGBA"):
        raise UnsupportedError(f"has pixels of the kind {mode}. Save it as grey or RGB.")
    mode = ("L" if mode in ("1", "L", "LA") else "RGB") + alpha
    with warnings.catch_warnings():  # about damaged EXIF
        warnings.simplefilter("ignore", UserWarning)
        return iio.imread(path, plugin="pillow", index=0, mode=mode)


def _decode_with_opencv(path: Path, page: Any = 0) -> np.ndarray:
    """Decode one page of a file or, with `...`, all."""
    import imageio.v3 as iio

    check_extra("photographs", f"cannot read {path}", "cv2")
    with _quiet_opencv():
        return iio.imread(path, plugin="opencv", index=page, flags=-1)  # without the flag it returns 8 bits


@contextmanager
def _quiet_opencv() -> Iterator[None]:
    """Keep OpenCV from printing warnings about TIFF tags. Its log level is that of the process, hence the lock."""
    import cv2

    log: Any = getattr(cv2.utils, "logging", cv2)  # OpenCV 5 has it there, OpenCV 4 at top level
    with _OPENCV_LOG:
        level = log.getLogLevel()
        log.setLogLevel(0)
        try:
            yield
        finally:
            log.setLogLevel(level)


def save(path: Path, pixels: np.ndarray) -> None:
    """Write pixels of shape (H, W, C), with their values unchanged, where `check_can_save` raises nothing."""
    suffix = path.suffix.lower()
    if suffix == ".exr":
        _save_exr(path, pixels)
        return
    if suffix == ".npy":
        with path.open("wb") as file:
            np.save(file, pixels[..., 0] if pixels.shape[-1] == 1 else pixels)
    else:
        path.write_bytes(encode(suffix, pixels))


def check_can_save(path: Path, dtype: np.dtype) -> None:
    """Raise ImportError where the package that writes a file of numbers of a type is not installed."""
    suffix = path.suffix.lower()
    if suffix == ".exr":
        check_extra("exr", f"cannot write {path}", "OpenEXR")
    elif dtype != np.uint8 and suffix != ".npy":
        check_extra("photographs", f"cannot write {path} of more than 8 bits", "cv2")


def _save_exr(path: Path, pixels: np.ndarray) -> None:
    import OpenEXR

    names = {1: "Y", 2: "YA", 3: "RGB", 4: "RGBA"}[pixels.shape[-1]]
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {name: np.ascontiguousarray(pixels[..., i]) for i, name in enumerate(names)}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))


def encode(suffix: str, pixels: np.ndarray, *, quality: int = 95) -> bytes:
    """Return pixels encoded as a file, of bands a page for each; `quality` is for JPEG."""
    import imageio.v3 as iio

    name = FORMATS[suffix].name
    if pixels.dtype != np.uint8 or pixels.shape[-1] > 4:
        check_extra("photographs", f"cannot write {suffix} of {pixels.dtype}, channels {pixels.shape[-1]},", "cv2")
    if name == "HDR":
        pixels = _rounded_to_rgbe(np.broadcast_to(pixels, (*pixels.shape[:2], 3)))
    if pixels.shape[-1] > 4 or (name == "TIFF" and pixels.shape[-1] == 2 and pixels.dtype != np.uint8):
        pages = np.ascontiguousarray(np.moveaxis(pixels, -1, 0))
        return iio.imwrite("<bytes>", pages, extension=suffix, plugin="opencv", is_batch=True, params=[259, 8])
    if pixels.shape[-1] == 1:
        pixels, suffix = pixels[..., 0], ".pgm" if suffix == ".ppm" else suffix
    if pixels.dtype == np.uint8:
        options = {"plugin": "pillow", "is_batch": False} | {
            "JPEG": {"quality": quality, "subsampling": 0},
            "TIFF": {"compression": "tiff_adobe_deflate"},
            "WEBP": {"lossless": True, "exact": True},  # exact: colours under alpha 0 are kept
        }.get(name, {})
    else:
        options = {"plugin": "opencv", "params": [259, 8] if name == "TIFF" else None}  # Compression: deflate
    return iio.imwrite("<bytes>", pixels, extension=suffix, **options)


def _rounded_to_rgbe(pixels: np.ndarray) -> np.ndarray:
    """Return pixels whose values OpenCV, which truncates to the 8 bits of each colour, stores rounded."""
    exponent = np.frexp(pixels.max(-1, keepdims=True))[1] - 8
    rounded = np.ldexp(np.rint(np.ldexp(pixels.astype(np.float64), -exponent)), exponent)
    return rounded.astype(np.float32)


def encode_indexed(index: np.ndarray, colours: np.ndarray) -> bytes:
    """Return a PNG with one byte per pixel: an index of shape (H, W) into up to 256 RGBA colours."""
    from PIL import Image

    image = Image.fromarray(index.astype(np.uint8))
    image.putpalette(colours.astype(np.uint8).tobytes(), "RGBA")
    file = io.BytesIO()
    image.save(file, "PNG", optimize=True)
    return file.getvalue()


_TIFF = Format("TIFF", _decode_tiff, (np.uint16, np.uint8, np.float32), MOST_BANDS, upright=True)
_JPEG = Format("JPEG", partial(_decode_with_pillow, "JPEG"), (np.uint8,), srgb=True, alpha=False)
FORMATS = {
    ".png": Format("PNG", _decode_png, (np.uint8, np.uint16), srgb=True),
    ".jpg": _JPEG,
    ".jpeg": _JPEG,
    ".tif": _TIFF,
    ".tiff": _TIFF,
    ".tga": Format("TGA", partial(_decode_with_pillow, "TGA"), (np.uint8,)),
    ".exr": Format("EXR", _decode_exr, (np.float32, np.float16)),
    ".npy": Format("NPY", _decode_npy, (np.float64,), MOST_BANDS),
    ".webp": Format("WEBP", partial(_decode_with_pillow, "WEBP"), (np.uint8,), srgb=True),
    ".bmp": Format("BMP", partial(_decode_with_pillow, "BMP"), (np.uint8,), srgb=True, alpha=False),
    ".ppm": Format("PPM", _decode_netpbm, (np.uint8, np.uint16), srgb=True, alpha=False),
    ".pgm": Format("PGM", _decode_netpbm, (np.uint8, np.uint16), 1, srgb=True, alpha=False),
    ".pfm": Format("PFM", _decode_pfm, (np.float32,), alpha=False),
    ".hdr": Format("HDR", _decode_radiance, (np.float32,), alpha=False),
    **dict.fromkeys(HEIC_SUFFIXES, Format("HEIC", decode_heic, (), srgb=True, upright=True)),
    **dict.fromkeys(RAW_SUFFIXES, Format("RAW", decode_raw, ())),
}
