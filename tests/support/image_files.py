"""Image files written by hand, as the specifications of PNG, TIFF and TGA have them, and what reading bad ones says."""

import math
import struct
import zlib

import numpy as np
import pytest

from diffshade.io.images import read_image, read_mask, write_image

H, W = 5, 7
SHAPES = [(H, W), (H, W, 1), (H, W, 2), (H, W, 3), (H, W, 4)]
INTEGER = [("png", 8), ("png", 16), ("tif", 8), ("tif", 16), ("tga", 8)]
WRITABLE = [*INTEGER, ("jpg", 8), ("tif", 32), ("exr", 16), ("exr", 32), ("npy", 64)]


def integers(bits, *shape, seed=0):
    pixels = np.random.default_rng(seed).integers(0, 2**bits, shape)
    return pixels.astype(f"u{bits // 8}")


def floats(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape) * 3


def to_linear(encoded):
    """The curve of IEC 61966-2-1, one number at a time."""

    def one(v):
        return v / 12.92 if v <= 0.04045 else math.pow((v + 0.055) / 1.055, 2.4)

    return np.vectorize(one, otypes=[float])(encoded)


def png_chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(pixels, bits, colour_type, *chunks, level=6):
    """A PNG as its specification has it, from (H, W) or (H, W, C) integers."""
    height, width = pixels.shape[:2]
    if bits < 8:
        rows = np.packbits(
            np.unpackbits(pixels.astype("u1")[..., None], axis=-1)[..., -bits:].reshape(height, -1), axis=1
        )
    else:
        rows = pixels.astype(f">u{bits // 8}").reshape(height, -1)
    data = zlib.compress(b"".join(b"\0" + row.tobytes() for row in rows), level)
    head = struct.pack(">IIBBBBB", width, height, bits, colour_type, 0, 0, 0)
    parts = [png_chunk(b"IHDR", head), *chunks, png_chunk(b"IDAT", data), png_chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def tiff(pixels, order="<", photometric=None, planar=1, orientation=1, deflate=False, rows_per_strip=2, next_page=0):
    """A TIFF as TIFF 6.0 has it, from (H, W) or (H, W, C) numbers; the directory first, the strips after it."""
    pixels = pixels.reshape(*pixels.shape[:2], -1)
    height, width, channels = pixels.shape
    planes = [pixels] if planar == 1 else [pixels[..., c] for c in range(channels)]
    blocks = [plane[row : row + rows_per_strip] for plane in planes for row in range(0, height, rows_per_strip)]
    strips = [block.astype(pixels.dtype.newbyteorder(order)).tobytes() for block in blocks]
    strips = [zlib.compress(strip) for strip in strips] if deflate else strips
    tags = {
        256: [width],
        257: [height],
        258: [8 * pixels.dtype.itemsize] * channels,
        259: [8 if deflate else 1],
        262: [photometric if photometric is not None else 2 if channels > 2 else 1],
        273: [0] * len(strips),
        274: [orientation],
        277: [channels],
        278: [rows_per_strip],
        279: [len(strip) for strip in strips],
        284: [planar],
        338: [2] * (channels in (2, 4)),
        339: [{"u": 1, "i": 2, "f": 3}[pixels.dtype.kind]] * channels,
    }
    tags = {tag: values for tag, values in tags.items() if values}
    after = 8 + 2 + 12 * len(tags) + 4
    first_strip = after + sum(4 * len(values) for values in tags.values() if len(values) > 1)
    tags[273] = [first_strip + sum(map(len, strips[:i])) for i in range(len(strips))]
    directory, more = struct.pack(order + "H", len(tags)), b""
    for tag, values in tags.items():  # all as 4-byte LONGs, but SHORT where there is one value, as readers want it
        data = struct.pack(f"{order}{len(values)}I", *values)
        if len(values) > 1:
            data, more = struct.pack(order + "I", after + len(more)), more + data
            kind = 4
        else:
            kind, data = (4, data) if tag == 273 else (3, struct.pack(order + "HH", values[0], 0))
        directory += struct.pack(order + "HHI", tag, kind, len(values)) + data
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8)
    return head + directory + struct.pack(order + "I", next_page) + more + b"".join(strips)


def tga(pixels, top_down=True):
    """An uncompressed 24- or 32-bit TGA, from (H, W, 3 or 4) bytes."""
    height, width, channels = pixels.shape
    alpha_bits = 8 if channels == 4 else 0
    head = struct.pack(
        "<BBB5xHHHHBB", 0, 0, 2, 0, 0, width, height, 8 * channels, alpha_bits | (0x20 if top_down else 0)
    )
    rows = pixels if top_down else pixels[::-1]
    return head + rows[..., [2, 1, 0, 3][:channels]].tobytes()


def turned(upright, orientation):
    """How a file of that orientation stores an upright picture (TIFF 6.0, tag 274)."""
    u = upright
    turn = {
        1: u,
        2: u[:, ::-1],
        3: u[::-1, ::-1],
        4: u[::-1],
        5: np.swapaxes(u, 0, 1),
        6: np.swapaxes(u, 0, 1)[::-1],
        7: np.swapaxes(u[::-1, ::-1], 0, 1),
        8: np.swapaxes(u, 0, 1)[:, ::-1],
    }
    return np.ascontiguousarray(turn[orientation])


def example(suffix, bits, path):
    """A file with several strips, chunks or blocks of lines, as this library writes it."""
    write_image(path, np.random.default_rng(0).uniform(size=(40, 30, 3)), bits=bits)
    return path.read_bytes()


def assert_unreadable(path):
    for read in (read_image, read_mask):
        with pytest.raises(
            OSError, match=rf"^cannot read .*{path.name}: it is no .*Make or copy the file again\.$"
        ) as caught:
            read(path)
        assert caught.value.__cause__ is None
        assert "\n" not in str(caught.value)


def headed(width, height, depth, colour_type, size):
    """A PNG of so many bytes, whose header is sound."""
    head = struct.pack(">IIBBBBB", width, height, depth, colour_type, 0, 0, 0)
    start = b"\x89PNG\r\n\x1a\n" + png_chunk(b"IHDR", head)
    return start + png_chunk(b"IDAT", bytes(size - len(start) - 24)) + png_chunk(b"IEND", b"")


TAGS = {"width": 256, "height": 257, "bits": 258, "compression": 259, "offsets": 273, "orientation": 274}
TAGS |= {"channels": 277, "rows": 278, "counts": 279, "tile width": 322, "tile height": 323}


def declared(data, *, rename=(), **tags):
    """A little-endian TIFF some of whose tags have other values, and then other numbers."""
    out = bytearray(data)
    for at in range(10, 10 + 12 * out[8], 12):
        tag, kind = struct.unpack_from("<HH", out, at)
        name = next((name for name, number in TAGS.items() if number == tag), None)
        if name in tags:
            struct.pack_into("<I" if kind == 4 else "<HH", out, at + 8, tags[name], *([0] * (kind == 3)))
        struct.pack_into("<H", out, at, dict(rename).get(name, tag))
    return bytes(out)
