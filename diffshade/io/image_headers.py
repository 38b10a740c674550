"""Image headers: what a file declares is checked against its bytes before it is decoded.

A decoder allocates memory for the pixels that a header declares; some decoders accept truncated files, or print
warnings of their own. So a file is decoded only if its bytes can become that many pixels: a byte of PNG or of deflated
TIFF becomes at most 1032 bytes. Each check raises an error of some type for a damaged file.
"""

import io
import math
import re
import struct
import zlib
from collections.abc import Collection
from typing import Any, NamedTuple

from PIL.ExifTags import Base

from ..core.fields import MOST_BANDS

DEFLATE = 1032  # largest expansion, in bytes per byte: 258 for 2 bits (RFC 1951, section 3.2.5)
NPY_HEADER = 1000  # bytes; an array of numbers takes 120, and a longer header could exhaust Python's parser
NETPBM_HEADER = 2**12  # bytes, with comments
ANY_EXPANSION = 2**16  # for codecs whose largest expansion is not known
# The same for TIFF's Compression, and OpenEXR's: none, RLE, ZIPS, ZIP, PIZ, PXR24 (which drops a byte of 4), B44, B44A.
TIFF_EXPANSION = {1: 1, 5: 2800, 7: 1536, 8: DEFLATE, 32773: 64, 32946: DEFLATE}
_EXR = {0: 1, 1: 64, 2: DEFLATE, 3: DEFLATE, 4: DEFLATE, 5: 2 * DEFLATE, 6: 16, 7: 16}
# Pixels per byte. JPEG: one bit per block of 64. TGA, BMP: 2 bytes per run of 128 and 255. Radiance: 8 per run of 127.
# WebP and HEIC have no largest; of a white picture WebP needs a byte for 23,000 pixels.
_PIXELS = {"JPEG": 512, "TGA": 64, "BMP": 128, "HDR": 16, "WEBP": 2**15, "HEIC": 2**15}
_KINDS = {1: "B", 2: "B", 3: "H", 4: "I", 7: "B", 13: "I", 16: "Q", 18: "Q"}  # of numbers in a TIFF; 16, 18: BigTIFF
# The TIFF tags that give the position and format of the pixels.
_TAGS = {
    Base.ImageWidth, Base.ImageLength, Base.BitsPerSample, Base.Compression, Base.PhotometricInterpretation,
    Base.StripOffsets, Base.SamplesPerPixel, Base.RowsPerStrip, Base.StripByteCounts, Base.PlanarConfiguration,
    Base.TileWidth, Base.TileLength, Base.TileOffsets, Base.TileByteCounts, Base.SampleFormat,
}  # fmt: skip


class UnsupportedError(ValueError):
    """The file is valid, but its kind is not supported. The message continues after the name of the file."""


def check_holds(declared: int, stored: int, most: int) -> None:
    """Raise if the stored bytes cannot become the declared number; each becomes at most `most`."""
    if declared > most * stored:
        raise ValueError


def check_pixels(name: str, size: tuple[int, int], data: bytes) -> None:
    """Raise if the bytes of a file cannot become the pixels that its header declares."""
    check_holds(size[0] * size[1], len(data), _PIXELS.get(name, 8 * ANY_EXPANSION))


def check_png(data: bytes) -> tuple[int, int]:
    """Return depth and colour type; raise if a chunk is truncated or its checksum is wrong (PNG, section 5)."""
    from PIL.PngImagePlugin import PngImageFile

    PngImageFile(io.BytesIO(data)).verify()  # to the last chunk, whose own checksum is left
    if b"IEND\xae\x42\x60\x82" not in data:
        raise ValueError
    width, height, depth, colour_type = struct.unpack_from(">IIBB", data, 16)
    channels = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[colour_type]
    check_holds(height * -(-width * channels * depth // 8), len(data), DEFLATE)
    return depth, colour_type


def check_tiff(data: bytes) -> list[dict[int, tuple[int, ...]]]:
    """Return each page's tags about its pixels (TIFF 6.0, section 2); raise if pixels are truncated or not inflatable.

    Several pages are the bands of one picture: each is grey, and all are of one size and kind.
    """
    layout, directory = _start_of_tiff(data)
    if layout.big:
        raise UnsupportedError("is a BigTIFF. Open it by rows with ds.open_image, or save it as TIFF.")
    found: dict[int, dict[int, tuple[int, ...]]] = {}
    while directory and directory not in found and len(found) <= MOST_BANDS:
        found[directory], directory = _tags_of_page(data, layout, directory, _TAGS)
    pages = list(found.values())
    kinds = {tuple(tags.get(tag, (1,)) for tag in (256, 257, 258, 339, 277, 262)) for tags in pages}
    grey = all(kind[-2:] == ((1,), (1,)) for kind in kinds)
    if directory or (len(pages) > 1 and not (grey and len(kinds) == 1 and len(pages) <= MOST_BANDS)):
        raise UnsupportedError(
            f"has more than one page. Save each to a file of its own, or up to {MOST_BANDS} bands as grey pages of one "
            "size and kind."
        )
    if sum(sum(tags[325] if 324 in tags else tags[279]) for tags in pages) > len(data):
        raise ValueError
    for tags in pages:
        _check_strips(data, tags)
    return pages


def tags_of_tiff(data: Any, wanted: Collection[int], directory: int | None = None) -> dict[int, tuple[int, ...]]:
    """Return those of some tags that the first page of a TIFF has, or another of its directories."""
    layout, first = _start_of_tiff(data)
    return _tags_of_page(data, layout, first if directory is None else directory, wanted)[0]


class _Layout(NamedTuple):
    """How a TIFF stores its directories: the order of bytes, and their numbers of 64 bits if it is a BigTIFF."""

    order: str
    big: bool


def _start_of_tiff(data: Any) -> tuple[_Layout, int]:
    """Return the layout, and where the first page begins."""
    order, big = {b"II*\0": ("<", False), b"MM\0*": (">", False), b"II+\0": ("<", True), b"MM\0+": (">", True)}[
        data[:4]
    ]
    return _Layout(order, big), struct.unpack_from(f"{order}{'4xQ' if big else 'I'}", data, 4)[0]


def _tags_of_page(
    data: Any, layout: _Layout, directory: int, wanted: Collection[int]
) -> tuple[dict[int, tuple[int, ...]], int]:
    """Return tags of a page, and where the next page begins; 0 for none."""
    order, wide = layout
    counter, word = ("Q", "Q") if wide else ("H", "I")
    inline = struct.calcsize(f"={word}")  # bytes of a value that stands in its entry
    (n_tags,) = struct.unpack_from(f"{order}{counter}", data, directory)
    first, step = directory + struct.calcsize(f"={counter}"), 4 + 2 * inline
    end = first + step * n_tags
    tags: dict[int, tuple[int, ...]] = {}
    for entry in range(first, end, step):
        tag, kind, count, place = struct.unpack_from(f"{order}HH{word}{word}", data, entry)
        if tag in wanted:
            if tag in tags:  # if a tag occurs twice, decoders disagree on which counts
                raise ValueError
            numbers = struct.Struct(f"{order}{count}{_KINDS[kind]}")
            tags[tag] = numbers.unpack_from(data, place if numbers.size > inline else entry + 4 + inline)
    return tags, struct.unpack_from(f"{order}{word}", data, end)[0]


def _check_strips(data: bytes, tags: dict[int, tuple[int, ...]]) -> None:
    """Raise if strips or tiles are truncated, overlap, or are too short for their pixels."""
    tiled = 324 in tags
    offsets, sizes = (tags[324], tags[325]) if tiled else (tags[273], tags[279])
    compression = tags.get(259, (1,))[0]
    for offset, size in zip(offsets, sizes, strict=True):
        if offset + size > len(data):
            raise ValueError
        if compression in (8, 32946):
            _check_inflates(data[offset : offset + size])  # OpenCV ignores the checksum and returns what it can
    bits = max(tags.get(258, (1,))) * tags.get(277, (1,))[0]
    most = TIFF_EXPANSION.get(compression, ANY_EXPANSION)
    check_holds(tags[256][0] * tags[257][0] * bits // 8, sum(sizes), most)
    if tiled:
        check_holds(tags[322][0] * tags[323][0] * bits // 8, max(sizes), most)


def check_exr(data: bytes) -> None:
    """Raise if pixels are truncated or too few (OpenEXR File Layout); the library itself would only print that."""
    magic, flags = struct.unpack_from("<4sI", data)
    if magic != b"v/1\x01":
        raise ValueError
    if flags & 0x1800:
        raise UnsupportedError("has several parts, or deep pixels. Save it as one flat part.")
    table, attributes = 8, {}
    while data[table]:  # an attribute is name, type, size, value; an empty name ends them
        kind = data.index(0, table) + 1
        size = data.index(0, kind) + 1
        start = size + 4
        name, table = data[table : kind - 1], start + struct.unpack_from("<I", data, size)[0]
        attributes[name] = data[start:table]
    table += 1
    at, nearest, furthest = table, len(data), 0
    while at < nearest:  # the table holds the offset of every chunk of pixels, and the nearest chunk follows it
        (offset,) = struct.unpack_from("<Q", data, at)
        at, nearest, furthest = at + 8, min(nearest, offset), max(furthest, offset)
    pixels = furthest + (20 if flags & 0x200 else 8)  # a tile's coordinates or a line's, and last the size in bytes
    if not at <= nearest < len(data) or pixels + struct.unpack_from("<I", data, pixels - 4)[0] > len(data):
        raise ValueError
    _check_window(attributes, len(data))


def _check_window(attributes: dict[bytes, bytes], stored: int) -> None:
    """Raise where a window, or a tile, has more pixels than the bytes of an EXR can become."""
    left, top, right, bottom = struct.unpack("<iiii", attributes[b"dataWindow"])
    wide, high, _ = struct.unpack("<IIB", attributes.get(b"tiles", b"\1\0\0\0\1\0\0\0\0"))
    channels, at, bytes_a_pixel = attributes[b"channels"], 0, 0
    while channels[at]:  # a channel is name, type (half or 4 bytes), and 12 bytes more
        at = channels.index(0, at) + 1
        bytes_a_pixel += 2 if struct.unpack_from("<I", channels, at) == (1,) else 4
        at += 16
    declared = max((right - left + 1) * (bottom - top + 1), wide * high) * bytes_a_pixel
    check_holds(declared, stored, _EXR.get(attributes[b"compression"][0], ANY_EXPANSION))


def _check_inflates(data: bytes) -> None:
    """Raise if deflated bytes are truncated or their checksum is wrong; the inflated bytes are not kept in memory."""
    stream = zlib.decompressobj()
    while not stream.eof:
        if not stream.decompress(data, 2**20) and not stream.eof:
            raise ValueError
        data = stream.unconsumed_tail


class Netpbm(NamedTuple):
    """The header of a PPM, PGM or PFM."""

    kind: bytes
    """P1 to P6, PF or Pf."""
    width: int
    height: int
    maximum: float
    """What stands for 1; of a PFM the factor of its numbers, below 0 where their low byte comes first."""
    end: int


def netpbm_header(data: bytes) -> Netpbm:
    """Return the header of a PPM, PGM or PFM (Netpbm)."""
    gap = rb"(?:\s|#[^\n]*\n)+"
    found = re.match(rb"(P[1-6Ff])%b(\d{1,9})%b(\d{1,9})" % (gap, gap), data)
    if found is None:
        raise ValueError
    kind, end, maximum = found[1], found.end(), 1.0
    if kind not in (b"P1", b"P4"):
        number = re.compile(rb"%b(-?[\d.eE+-]{1,30})" % gap).match(data, end)
        if number is None:
            raise ValueError
        end, maximum = number.end(), float(number[1])
    header = Netpbm(kind, int(found[2]), int(found[3]), maximum, end + 1)  # one space
    if not math.isfinite(maximum) or maximum == 0.0 or (kind[1:] in b"123456" and not 0 < maximum < 2**16):
        raise ValueError
    return header


class Radiance(NamedTuple):
    """The header of a Radiance picture."""

    size: tuple[int, int]
    """Width and height."""
    exposure: float
    """What its numbers were multiplied by."""
    primaries: tuple[float, ...] | None
    """x y of red, green, blue and white."""
    unused: str
    """What it states of its colours that is not used, as the object of a sentence."""


def radiance_header(data: bytes) -> Radiance:
    """Return the header of a Radiance picture (Ward, "Real pixels", 1991)."""
    head, _, rest = data.partition(b"\n\n")
    size = re.match(rb"([+-][XY]) (\d{1,9}) ([+-][XY]) (\d{1,9})\n", rest)
    if not head.startswith(b"#?") or size is None:
        raise ValueError
    lines = [line.partition(b"=") for line in head.split(b"\n")]
    if any(name == b"FORMAT" and value.strip() != b"32-bit_rle_rgbe" for name, _, value in lines):
        raise UnsupportedError("has colours other than RGBE. Save it as RGBE.")
    if (size[1], size[3]) != (b"-Y", b"+X"):
        raise UnsupportedError("is stored turned or mirrored. Save it from the top down and from left to right.")
    exposure = math.prod(float(value) for name, _, value in lines if name == b"EXPOSURE")
    given = [tuple(map(float, value.split())) for name, _, value in lines if name == b"PRIMARIES"]
    if not 0.0 < exposure < math.inf:
        raise ValueError
    unused = {
        name.decode(): value.decode("latin-1").strip()
        for name, _, value in lines
        if name in (b"GAMMA", b"COLORCORR") and any(float(word) != 1.0 for word in value.split())
    }
    said = " and ".join(f"{name}={value}" for name, value in unused.items())
    return Radiance((int(size[4]), int(size[2])), exposure, given[-1] if given else None, said)
