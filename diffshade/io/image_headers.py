"""Image headers: what a file declares is checked against its bytes before it is decoded.

A decoder allocates memory for the pixels that a header declares; some decoders accept truncated files, or print
warnings of their own. So a file is decoded only if its bytes can become that many pixels: a byte of PNG or of deflated
TIFF becomes at most 1032 bytes. Each check raises an error of some type for a damaged file.
"""

import struct
import zlib

from ..core.fields import MOST_BANDS

DEFLATE = 1032  # largest expansion, in bytes per byte: 258 for 2 bits (RFC 1951, section 3.2.5)
NPY_HEADER = 1000  # bytes; an array of numbers takes 120, and a longer header could exhaust Python's parser
ANY_EXPANSION = 2**16  # for codecs whose largest expansion is not known
# The same for TIFF's Compression, and OpenEXR's: none, RLE, ZIPS, ZIP, PIZ, PXR24 (which drops a byte of 4), B44, B44A.
TIFF_EXPANSION = {1: 1, 5: 2800, 7: 1536, 8: DEFLATE, 32773: 64, 32946: DEFLATE}
_EXR = {0: 1, 1: 64, 2: DEFLATE, 3: DEFLATE, 4: DEFLATE, 5: 2 * DEFLATE, 6: 16, 7: 16}
_PIXELS = {"JPEG": 512, "TGA": 64}  # pixels per byte: one bit per block of 64; 2 bytes per run of 128
# The TIFF tags that give the position and format of the pixels.
_TAGS = (256, 257, 258, 259, 262, 273, 277, 278, 279, 284, 322, 323, 324, 325, 339)


class UnsupportedError(ValueError):
    """The file is valid, but its kind is not supported. The message continues after the name of the file."""


def check_holds(declared: int, stored: int, most: int) -> None:
    """Raise if the stored bytes cannot become the declared number; each becomes at most `most`."""
    if declared > most * stored:
        raise ValueError


def check_pixels(name: str, size: tuple[int, int], data: bytes) -> None:
    """Raise if the bytes of a JPEG or TGA cannot become the pixels that its header declares."""
    check_holds(size[0] * size[1], len(data), _PIXELS.get(name, 8 * ANY_EXPANSION))


def check_png(data: bytes) -> tuple[int, int]:
    """Return depth and colour type; raise if a chunk is truncated or its checksum is wrong (PNG, section 5)."""
    if data[:16] != b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR":
        raise ValueError
    at, kind = 8, b""
    while kind != b"IEND":
        length, kind = struct.unpack_from(">I4s", data, at)
        (checksum,) = struct.unpack_from(">I", data, at + 8 + length)
        if zlib.crc32(data[at + 4 : at + 8 + length]) != checksum:
            raise ValueError
        at += 12 + length
    width, height, depth, colour_type = struct.unpack_from(">IIBB", data, 16)
    channels = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[colour_type]
    check_holds(height * -(-width * channels * depth // 8), len(data), DEFLATE)
    return depth, colour_type


def check_tiff(data: bytes) -> list[dict[int, tuple[int, ...]]]:
    """Return each page's tags about its pixels (TIFF 6.0, section 2); raise if pixels are truncated or not inflatable.

    Several pages are the bands of one picture: each is grey, and all are of one size and kind.
    """
    order = {b"II*\0": "<", b"MM\0*": ">"}[data[:4]]
    (directory,) = struct.unpack_from(f"{order}I", data, 4)
    found: dict[int, dict[int, tuple[int, ...]]] = {}
    while directory and directory not in found and len(found) <= MOST_BANDS:
        found[directory], directory = _tags_of_page(data, order, directory)
    pages = list(found.values())
    kinds = {tuple(tags.get(tag, (1,)) for tag in (256, 257, 258, 339, 277, 262)) for tags in pages}
    grey = all(kind[-2:] == ((1,), (1,)) for kind in kinds)
    if directory or (len(pages) > 1 and not (grey and len(kinds) == 1 and len(pages) <= MOST_BANDS)):
        raise UnsupportedError(
            f"has more than one page. Save each to a file of its own, or up to {MOST_BANDS} bands as grey pages of one "
            "size and kind."
        )
    for tags in pages:
        _check_strips(data, tags)
    if sum(sum(tags[325] if 324 in tags else tags[279]) for tags in pages) > len(data):
        raise ValueError
    return pages


def _tags_of_page(data: bytes, order: str, directory: int) -> tuple[dict[int, tuple[int, ...]], int]:
    """Return the tags of a page, and where the next page begins; 0 for none."""
    (n_tags,) = struct.unpack_from(f"{order}H", data, directory)
    end = directory + 2 + 12 * n_tags
    tags: dict[int, tuple[int, ...]] = {}
    for entry in range(directory + 2, end, 12):
        tag, kind, count, place = struct.unpack_from(f"{order}HHII", data, entry)
        if tag in _TAGS:
            if tag in tags:  # if a tag occurs twice, decoders disagree on which counts
                raise ValueError
            numbers = struct.Struct(f"{order}{count}{ {3: 'H', 4: 'I'}[kind] }")
            tags[tag] = numbers.unpack_from(data, place if numbers.size > 4 else entry + 8)
    return tags, struct.unpack_from(f"{order}I", data, end)[0]


def _check_strips(data: bytes, tags: dict[int, tuple[int, ...]]) -> None:
    """Raise if strips or tiles are truncated, overlap, or are too short for their pixels."""
    tiled = 324 in tags
    offsets, sizes = (tags[324], tags[325]) if tiled else (tags[273], tags[279])
    if sum(sizes) > len(data):
        raise ValueError
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
