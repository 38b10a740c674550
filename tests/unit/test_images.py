"""Images against independent writers and readers: PNG, TIFF and TGA by hand, and cv2, Pillow and OpenEXR directly."""

import io
import logging
import math
import os
import struct
import subprocess
import sys
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import jax.numpy as jnp
import numpy as np
import OpenEXR
import pytest
from PIL import Image

from diffshade.images import read_image, read_mask, srgb_decode, srgb_encode, write_image

H, W = 5, 7
SHAPES = [(H, W), (H, W, 1), (H, W, 2), (H, W, 3), (H, W, 4)]
INTEGER = [("png", 8), ("png", 16), ("tif", 8), ("tif", 16), ("tga", 8)]
FLOAT = [("tif", 32, np.float32), ("exr", 16, np.float16), ("exr", 32, np.float32), ("npy", 64, np.float64)]
WRITABLE = INTEGER + [("jpg", 8)] + [(suffix, bits) for suffix, bits, _ in FLOAT]


def integers(bits, *shape, seed=0):
    pixels = np.random.default_rng(seed).integers(0, 2**bits, shape)
    return pixels.astype(f"u{bits // 8}")


def floats(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape) * 3


def with_shapes(kinds):
    """Every kind of file with every shape it can hold."""
    return [
        (*kind, shape)
        for kind in kinds
        for shape in SHAPES
        if shape[2:] != (2,) or kind[1] == 8 or kind[0] in ("exr", "npy")
    ]


def to_linear(encoded):
    """The curve of IEC 61966-2-1, one number at a time."""

    def one(v):
        return v / 12.92 if v <= 0.04045 else math.pow((v + 0.055) / 1.055, 2.4)

    return np.vectorize(one, otypes=[float])(encoded)


# Independent writers


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


@pytest.fixture
def file(tmp_path):
    """Write bytes under a name and give the path."""

    def write(name, data):
        path = tmp_path / name
        path.write_bytes(data)
        return path

    return write


# Round trips


@pytest.mark.parametrize(("suffix", "bits", "shape"), with_shapes(INTEGER))
@pytest.mark.parametrize("srgb", [None, False, True])
def test_integers_come_back_exactly(tmp_path, caplog, suffix, bits, shape, srgb):
    full = 2**bits - 1
    numbers = integers(bits, *shape)
    numbers.flat[:2] = 0, full
    encoded = numbers / full
    curve = srgb or (srgb is None and (suffix, bits) == ("png", 8))
    linear = to_linear(encoded) if curve else encoded
    if shape[2:] in ((2,), (4,)):
        linear[..., -1] = encoded[..., -1]
    path = tmp_path / f"image.{suffix}"
    write_image(path, linear, bits=bits, srgb=srgb)
    stored = read_image(path, srgb=False)
    assert stored.shape == (*shape, 1)[: max(3, len(shape))]
    assert stored.dtype == np.float64
    np.testing.assert_array_equal(stored.reshape(shape), encoded)
    np.testing.assert_allclose(read_image(path, srgb=srgb).reshape(shape), linear, rtol=1e-14)
    assert caplog.records == []


@pytest.mark.parametrize(("suffix", "bits", "dtype", "shape"), with_shapes(FLOAT))
def test_floats_come_back_exactly_and_unclipped(tmp_path, caplog, suffix, bits, dtype, shape):
    image = floats(*shape)
    path = tmp_path / f"image.{suffix}"
    write_image(path, image, bits=bits)
    np.testing.assert_array_equal(read_image(path).reshape(shape), image.astype(dtype))
    assert caplog.records == []


@pytest.mark.parametrize(("suffix", "bits"), [("png", 8), ("png", 16), ("tif", 8), ("tif", 16), ("tga", 8)])
def test_every_grey_level_comes_back_through_the_curve(tmp_path, suffix, bits):
    full = 2**bits - 1
    levels = np.arange(full + 1).reshape(-1, 256)
    write_image(tmp_path / f"a.{suffix}", to_linear(levels / full), bits=bits, srgb=True)
    np.testing.assert_array_equal(np.rint(read_image(tmp_path / f"a.{suffix}", srgb=False)[..., 0] * full), levels)


def test_rounding_is_to_the_nearest_level(tmp_path):
    image = np.array([[100.49, 100.51, 254.6]]) / 255
    write_image(tmp_path / "a.tga", image)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tga")[..., 0] * 255, [[100, 101, 255]])


@pytest.mark.parametrize("shape", [(1, 1), (1, 1, 3), (1, 2, 4), (2, 3), (3, 3), (4, 4), (3, 4, 3), (4, 1), (3, 1, 4)])
@pytest.mark.parametrize(("suffix", "bits"), WRITABLE)
def test_small_images_are_not_taken_for_something_else(tmp_path, suffix, bits, shape):
    image = np.full(shape, 1.0)
    if suffix == "jpg" and image.ndim == 3:
        image = image[..., :3]  # a JPEG has no alpha
    write_image(tmp_path / f"a.{suffix}", image, bits=bits)
    np.testing.assert_array_equal(read_image(tmp_path / f"a.{suffix}").reshape(image.shape), image)


@pytest.mark.parametrize("suffix", ["jpg", "jpeg", "JPG"])
@pytest.mark.parametrize("channels", [1, 3])
def test_jpeg_comes_back_nearly(tmp_path, suffix, channels):
    rows, columns = np.mgrid[0:32, 0:40] / 40
    image = np.stack([rows, columns, 0.5 * (rows + columns)], axis=-1)[..., :channels]
    write_image(tmp_path / f"a.{suffix}", image)
    back = read_image(tmp_path / f"a.{suffix}")
    assert back.shape == image.shape
    levels_off = 255 * np.abs(srgb_encode(back) - srgb_encode(image))
    assert np.percentile(levels_off, 99) < 4
    assert levels_off.max() < 10
    np.testing.assert_array_equal(srgb_decode(read_image(tmp_path / f"a.{suffix}", srgb=False)), back)


@pytest.mark.parametrize(("suffix", "bits"), WRITABLE)
def test_defaults_and_upper_case(tmp_path, suffix, bits):
    default = {"png": 8, "jpg": 8, "tga": 8, "tif": 16, "exr": 32, "npy": 64}[suffix]
    image = np.random.default_rng(0).uniform(size=(H, W, 3))
    write_image(tmp_path / f"a.{suffix}", image)
    write_image(tmp_path / f"b.{suffix.upper()}", image, bits=default)
    assert (tmp_path / f"a.{suffix}").read_bytes()[-64:] == (tmp_path / f"b.{suffix.upper()}").read_bytes()[-64:]
    np.testing.assert_array_equal(read_image(tmp_path / f"a.{suffix}"), read_image(tmp_path / f"b.{suffix.upper()}"))


@pytest.mark.parametrize("make", [jnp.asarray, np.float32, np.ndarray.tolist], ids=["jax", "float32", "list"])
def test_what_may_be_written(tmp_path, make):
    image = np.random.default_rng(0).uniform(size=(H, W, 3)).astype(np.float32)
    write_image(tmp_path / "a.npy", make(image))
    np.testing.assert_array_equal(read_image(tmp_path / "a.npy"), image)


def test_booleans_are_written_as_zero_and_one(tmp_path):
    mask = np.eye(4, dtype=bool)
    write_image(str(tmp_path / "a.png"), mask)
    np.testing.assert_array_equal(read_image(str(tmp_path / "a.png"))[..., 0], mask)
    np.testing.assert_array_equal(read_mask(str(tmp_path / "a.png")), mask)


def test_the_callers_array_is_left_as_it_was(tmp_path):
    image = floats(H, W, 4)
    before = image.copy()
    image.flags.writeable = False
    for suffix in ("png", "exr", "npy"):
        write_image(tmp_path / f"a.{suffix}", image)
    np.testing.assert_array_equal(image, before)


# What others wrote


@pytest.mark.parametrize(("colour_type", "channels"), [(0, 1), (4, 2), (2, 3), (6, 4)])
@pytest.mark.parametrize("bits", [8, 16])
def test_png_by_hand(file, colour_type, channels, bits):
    numbers = integers(bits, H, W, channels)
    image = read_image(file("a.png", png(numbers, bits, colour_type)), srgb=False)
    assert bits == 8 or numbers.max() > 255
    np.testing.assert_array_equal(image, numbers / (2**bits - 1))


@pytest.mark.parametrize("bits", [1, 2, 4])
def test_png_of_few_bits(file, bits):
    numbers = np.random.default_rng(0).integers(0, 2**bits, (H, W))
    image = read_image(file("a.png", png(numbers, bits, 0)))
    np.testing.assert_allclose(image[..., 0], to_linear(numbers / (2**bits - 1)), rtol=1e-14)


@pytest.mark.parametrize("bits", [1, 2, 4, 8])
def test_png_with_a_palette(file, bits):
    palette = integers(8, 2**bits, 3)
    numbers = np.random.default_rng(1).integers(0, 2**bits, (H, W))
    chunk = png_chunk(b"PLTE", palette.tobytes())
    image = read_image(file("a.png", png(numbers, bits, 3, chunk)), srgb=False)
    np.testing.assert_array_equal(image, palette[numbers] / 255)
    alpha = integers(8, 2**bits, seed=2)
    data = png(numbers, bits, 3, chunk, png_chunk(b"tRNS", alpha.tobytes()))
    image = read_image(file("a.png", data), srgb=False)
    np.testing.assert_array_equal(image, np.concatenate([palette[numbers], alpha[numbers][..., None]], axis=-1) / 255)


@pytest.mark.parametrize("bits", [8, 16])
def test_png_with_one_transparent_colour(file, bits):
    numbers = integers(bits, H, W, 3)
    image = read_image(file("a.png", png(numbers, bits, 2, png_chunk(b"tRNS", numbers[1, 2].astype(">u2").tobytes()))))
    expected = np.ones((H, W))
    expected[1, 2] = 0
    np.testing.assert_array_equal(image[..., 3], expected)


def test_png_gamma_and_colour_chunks_change_nothing(file):
    numbers = integers(16, H, W, 3)
    chunks = png_chunk(b"gAMA", struct.pack(">I", 100000)), png_chunk(b"cICP", bytes([9, 16, 0, 1]))
    np.testing.assert_array_equal(read_image(file("a.png", png(numbers, 16, 2, *chunks))), numbers / 65535)


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_16_bits_and_channel_order_against_cv2(tmp_path, suffix, channels):
    numbers = integers(16, H, W, channels)
    bgr = numbers[..., [2, 1, 0, 3][:channels]] if channels > 1 else numbers
    cv2.imwrite(str(tmp_path / f"a.{suffix}"), bgr)
    np.testing.assert_array_equal(read_image(tmp_path / f"a.{suffix}"), numbers / 65535)
    write_image(tmp_path / f"b.{suffix}", numbers / 65535, bits=16)
    back = cv2.imread(str(tmp_path / f"b.{suffix}"), -1)
    assert back is not None
    assert back.dtype == np.uint16
    np.testing.assert_array_equal(back.reshape(bgr.shape), bgr)


def test_the_first_bytes_of_a_16_bit_png_say_so(tmp_path):
    for channels, colour_type in ((1, 0), (3, 2), (4, 6)):
        write_image(tmp_path / "a.png", np.zeros((H, W, channels)), bits=16)
        assert tuple((tmp_path / "a.png").read_bytes()[24:26]) == (16, colour_type)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("suffix", ["png", "tif", "tga"])
def test_8_bits_and_channel_order_against_pillow(tmp_path, suffix, channels):
    numbers = integers(8, H, W, channels)
    Image.fromarray(numbers.squeeze()).save(tmp_path / f"a.{suffix}")
    np.testing.assert_array_equal(read_image(tmp_path / f"a.{suffix}", srgb=False), numbers / 255)
    write_image(tmp_path / f"b.{suffix}", numbers / 255, bits=8, srgb=False)
    with Image.open(tmp_path / f"b.{suffix}") as image:
        np.testing.assert_array_equal(np.asarray(image), numbers.squeeze())


def test_jpeg_channel_order(tmp_path):
    red = np.zeros((16, 16, 3))
    red[..., 0] = 1
    write_image(tmp_path / "a.jpg", red)
    with Image.open(tmp_path / "a.jpg") as image:
        np.testing.assert_allclose(np.asarray(image), red * 255, atol=3)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("deflate", [False, True])
@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("bits", [8, 16, 32])
def test_tiff_by_hand(file, bits, channels, deflate, order):
    numbers = floats(H, W, channels).astype("f4") if bits == 32 else integers(bits, H, W, channels)
    image = read_image(file("a.tif", tiff(numbers, order, deflate=deflate)))
    np.testing.assert_array_equal(image, numbers / (1 if bits == 32 else 2**bits - 1))


def test_tiff_by_hand_of_kinds_that_pillow_reads(file):
    numbers = integers(8, H, W, 3)
    np.testing.assert_array_equal(read_image(file("a.tif", tiff(numbers, planar=2))), numbers / 255)
    grey = numbers[..., :1]
    np.testing.assert_array_equal(read_image(file("a.tif", tiff(grey, photometric=0))), (255 - grey) / 255)


@pytest.mark.parametrize(
    ("numbers", "options"),
    [
        (integers(16, H, W, 3), {"planar": 2}),
        (integers(16, H, W), {"photometric": 0}),
        (integers(16, H, W, 4), {"photometric": 5}),
        (integers(16, H, W, 2), {}),
        (floats(H, W, 2).astype("f4"), {}),
        (floats(H, W, 3).astype("f2"), {}),
        (floats(H, W, 3), {}),
        (integers(16, H, W, 3).astype("i2"), {}),
        (integers(32, H, W), {}),
    ],
)
def test_tiff_that_opencv_gets_wrong_is_refused(file, capfd, numbers, options):
    with pytest.raises(
        ValueError, match=r"^cannot read .*a\.tif: it is a TIFF with BitsPerSample .*\. Save it as 16-bit"
    ):
        read_image(file("a.tif", tiff(numbers, **options)))
    assert capfd.readouterr() == ("", "")


def test_tiff_with_pages_is_refused(file):
    with pytest.raises(ValueError, match=r"^cannot read .*a\.tif: it has more than one page\. Save each to a file"):
        read_image(file("a.tif", tiff(integers(16, H, W), next_page=8)))


def test_alpha_of_8_bit_tiff_is_not_multiplied_in(file):
    numbers = np.full((H, W, 4), 200, np.uint8)
    numbers[..., 3] = 10
    np.testing.assert_array_equal(read_image(file("a.tif", tiff(numbers))), numbers / 255)


@pytest.mark.parametrize("top_down", [False, True])
@pytest.mark.parametrize("channels", [3, 4])
def test_tga_by_hand(file, channels, top_down):
    numbers = integers(8, H, W, channels)
    np.testing.assert_array_equal(read_image(file("a.tga", tga(numbers, top_down))), numbers / 255)


def test_tga_with_runs(tmp_path):
    numbers = np.repeat(integers(8, H, 2, 3), 5, axis=1)
    Image.fromarray(numbers).save(tmp_path / "a.tga", rle=True)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tga"), numbers / 255)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_jpeg_is_turned_upright(tmp_path, orientation):
    upright = np.kron(np.array([[250, 170, 90], [10, 50, 130]], np.uint8), np.ones((16, 16), np.uint8))
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(turned(upright, orientation)).save(tmp_path / "a.jpg", quality=100, exif=exif)
    image = read_image(tmp_path / "a.jpg", srgb=False)[..., 0]
    np.testing.assert_allclose(image, upright / 255, atol=2 / 255)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("shape", [(H, W), (H, W, 3)])
@pytest.mark.parametrize(("dtype", "full"), [("u1", 255), ("u2", 65535), ("f4", 1)])
def test_tiff_is_turned_upright(file, dtype, full, shape, orientation):
    upright = np.arange(math.prod(shape)).reshape(shape).astype(dtype)
    image = read_image(file("a.tif", tiff(turned(upright, orientation), orientation=orientation)))
    np.testing.assert_array_equal(image.reshape(upright.shape), upright / full)


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
@pytest.mark.parametrize("names", ["Y", "YA", "RGB", "RGBA"])
def test_exr_channels(tmp_path, names, dtype):
    pixels = floats(40, W, len(names)).astype(dtype)
    planes = {name: np.ascontiguousarray(pixels[..., i]) for i, name in enumerate(names)}
    with OpenEXR.File({}, planes | {"Z": np.ones((40, W), "f4")}) as file:
        file.write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), pixels)
    write_image(tmp_path / "b.exr", pixels, bits=8 * np.dtype(dtype).itemsize)
    with OpenEXR.File(str(tmp_path / "b.exr"), separate_channels=True) as file:
        stored = file.channels()
        assert set(stored) == set(names)
        for i, name in enumerate(names):
            assert stored[name].pixels.dtype == dtype
            np.testing.assert_array_equal(stored[name].pixels, pixels[..., i])


def test_exr_packed_by_the_library(tmp_path):
    pixels = floats(H, W, 3).astype("f4")
    with OpenEXR.File({}, {"RGB": pixels}) as file:
        file.write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), pixels)


@pytest.mark.parametrize("compression", ["NO", "RLE", "ZIPS", "ZIP", "PIZ"])
@pytest.mark.parametrize("line_order", ["INCREASING_Y", "DECREASING_Y"])
def test_exr_compressions_and_line_orders(tmp_path, compression, line_order):
    pixels = floats(70, W, 3).astype("f4")
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "lineOrder": getattr(OpenEXR, line_order)}
    with OpenEXR.File(header, {"RGB": pixels}) as file:
        file.write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), pixels)


def test_exr_in_tiles(tmp_path):
    pixels = floats(70, 50, 3).astype("f4")
    tiles = OpenEXR.TileDescription()
    tiles.xSize = tiles.ySize = 16
    with OpenEXR.File({"type": OpenEXR.tiledimage, "tiles": tiles}, {"RGB": pixels}) as file:
        file.write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), pixels)


def test_exr_of_other_kinds_is_refused(tmp_path):
    plane = np.zeros((H, W), "f4")
    path = tmp_path / "a.exr"

    def refused(parts_or_header, channels, message):
        with OpenEXR.File(*([parts_or_header, channels] if channels else [parts_or_header])) as file:
            file.write(str(path))
        with pytest.raises(ValueError, match=rf"^cannot read .*a\.exr: it {message}"):
            read_image(path)

    refused({}, {"Z": plane}, r"has the channels Z\. Save R, G, B or Y")
    chroma = {"Y": plane, "RY": plane, "BY": plane}
    refused({}, chroma, r"has the channels .*\. Save R, G, B or Y")
    refused({}, {"Y": plane.astype("u4")}, r"has numbers of type uint32\. Use")
    parts = [OpenEXR.Part({}, {"Y": plane}, "a"), OpenEXR.Part({}, {"Y": plane}, "b")]
    refused(parts, None, r"has several parts, or deep pixels\. Save it")
    window = (np.array([0, 0], "i4"), np.array([2 * W, 2 * H], "i4"))
    refused({"displayWindow": window}, {"Y": plane}, r"holds a part of a picture")


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("dtype", ["u1", "u2", "f2", "f4", "f8", ">u2", ">f4", "?"])
def test_npy_by_hand(tmp_path, shape, dtype):
    dtype = np.dtype(dtype)
    array = (floats(*shape) * 50).astype("i8").astype(dtype) if dtype.kind != "f" else floats(*shape).astype(dtype)
    np.save(tmp_path / "a.npy", array)
    full = np.iinfo(dtype).max if dtype.kind == "u" else 1
    np.testing.assert_array_equal(read_image(tmp_path / "a.npy").reshape(shape), array.astype("f8") / full)


def test_npy_in_fortran_order_and_with_nan(tmp_path):
    array = floats(H, W, 3)
    array[1, 2, 0] = np.nan
    np.save(tmp_path / "a.npy", np.asfortranarray(array))
    np.testing.assert_array_equal(read_image(tmp_path / "a.npy"), array)


# The sRGB curve


def test_srgb_is_the_curve_of_the_standard():
    x = np.concatenate([np.linspace(0, 1, 1001), [0.04045, 0.0404500001, 0.5]])
    np.testing.assert_allclose(srgb_decode(x), to_linear(x), rtol=1e-14)
    np.testing.assert_allclose(srgb_encode(to_linear(x)), x, atol=1e-7)  # the published constants meet to 1e-7
    np.testing.assert_allclose(srgb_decode([0.0, 0.02, 0.5, 1.0]), [0, 0.02 / 12.92, 0.21404114048, 1], rtol=1e-10)
    np.testing.assert_allclose(srgb_encode([0.0, 0.002, 0.18, 1.0]), [0, 0.02584, 0.46135612950, 1], rtol=1e-10)
    assert srgb_decode(1.0) == 1  # exactly, so that what was read is not clipped when it is written


def test_srgb_outside_the_range_and_of_any_shape():
    np.testing.assert_allclose(srgb_encode([-0.1, 4.0]), [-1.292, 1.055 * 4 ** (1 / 2.4) - 0.055], rtol=1e-14)
    np.testing.assert_allclose(srgb_decode(srgb_encode([-0.1, 4.0])), [-0.1, 4.0], rtol=1e-14)
    assert srgb_encode(0.5).shape == ()
    assert srgb_decode(np.zeros((2, 3, 4, 5), np.float32)).shape == (2, 3, 4, 5)
    assert srgb_encode(jnp.ones(3)).dtype == np.float64


@pytest.mark.parametrize(("suffix", "bits"), WRITABLE)
def test_which_files_are_srgb(tmp_path, suffix, bits):
    image = np.full((16, 16), 0.5)
    write_image(tmp_path / f"a.{suffix}", image, bits=bits)
    stored = read_image(tmp_path / f"a.{suffix}", srgb=False)
    expected = 0.735357 if bits == 8 and suffix in ("png", "jpg") else 0.5
    np.testing.assert_allclose(stored, expected, atol=0.003)
    np.testing.assert_allclose(read_image(tmp_path / f"a.{suffix}"), 0.5, atol=0.004)


@pytest.mark.parametrize("channels", [2, 4])
def test_alpha_has_no_curve(tmp_path, channels):
    image = np.full((H, W, channels), 51 / 255)
    write_image(tmp_path / "a.png", image)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png")[..., -1], 51 / 255)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png", srgb=False)[..., -1], 51 / 255)
    assert read_image(tmp_path / "a.png", srgb=False)[0, 0, 0] == np.rint(srgb_encode(51 / 255) * 255) / 255


def test_float_files_may_be_srgb_too(tmp_path):
    image = np.abs(floats(H, W, 3))
    write_image(tmp_path / "a.npy", image, srgb=True)
    np.testing.assert_allclose(np.load(tmp_path / "a.npy"), srgb_encode(image), rtol=1e-15)
    np.testing.assert_allclose(read_image(tmp_path / "a.npy", srgb=True), image, rtol=1e-12)


# Masks


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_a_mask_is_alpha_or_else_grey_from_half_up(tmp_path, suffix, bits):
    full = 2**bits - 1
    levels = np.array([[0, full // 2, full // 2 + 1, full]]) / full
    inside = [[False, False, True, True]]
    path = tmp_path / f"a.{suffix}"
    write_image(path, levels, bits=bits, srgb=False)
    np.testing.assert_array_equal(read_mask(path), inside)
    write_image(path, np.stack([0 * levels, 0 * levels, 0 * levels, levels], axis=-1), bits=bits)
    np.testing.assert_array_equal(read_mask(path), inside)
    write_image(path, np.stack([levels, levels, levels], axis=-1), bits=bits, srgb=False)
    np.testing.assert_array_equal(read_mask(path), inside)


def test_a_colour_is_inside_by_its_mean(tmp_path):
    write_image(tmp_path / "a.tga", [[[1, 0.6, 0], [1, 0, 0], [0, 1, 1]]])
    np.testing.assert_array_equal(read_mask(tmp_path / "a.tga"), [[True, False, True]])


@pytest.mark.parametrize("dtype", [bool, np.uint8, np.float32])
def test_masks_of_numpy(tmp_path, dtype):
    np.save(tmp_path / "a.npy", np.eye(4, dtype=dtype) * dtype(255 if dtype is np.uint8 else 1))
    mask = read_mask(tmp_path / "a.npy")
    assert mask.dtype == bool
    np.testing.assert_array_equal(mask, np.eye(4, dtype=bool))


# Clipping and values that cannot be written


@pytest.mark.parametrize(("suffix", "bits"), INTEGER)
def test_clipping_is_said_and_counted_by_pixel(tmp_path, caplog, suffix, bits):
    image = np.full((H, W, 3), 0.5)
    image[0, 0] = 2, 3, 0.5
    image[1, 1] = -1
    image[2, 2] = 1.5, 0.5, -0.5
    image[3, 3] = 0, 1, 1
    with caplog.at_level(logging.WARNING, logger="diffshade"):
        write_image(tmp_path / f"a.{suffix}", image, bits=bits)
    (record,) = caplog.records
    assert (record.name, record.levelname) == ("diffshade", "WARNING")
    message = (
        f"a.{suffix}: 3 of 35 pixels were clipped to [0, 1], 2 above 1 and 2 below 0. Scale the image, or write .exr."
    )
    assert record.getMessage() == f"{tmp_path}{os.sep}{message}"
    back = read_image(tmp_path / f"a.{suffix}")
    np.testing.assert_array_equal(back[[0, 1, 2], [0, 1, 2]] >= 1, np.array([[1, 1, 0], [0, 0, 0], [1, 0, 0]], bool))
    assert back[1, 1].max() == 0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(("suffix", "bits"), WRITABLE)
def test_a_value_that_is_not_finite_is_named(tmp_path, suffix, bits, value):
    image = np.zeros((H, W, 3))
    image[3, 4, 1] = image[4, 0, 0] = value
    message = (
        rf"a\.{suffix}: the image is {value} at row 3, column 4, channel 1; 2 of 105 values are not finite\. Find out"
    )
    with pytest.raises(ValueError, match=message):
        write_image(tmp_path / f"a.{suffix}", image, bits=bits)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(("bits", "value"), [(16, 65505.0), (16, -1e6), (32, 1e39)])
def test_a_value_too_large_for_the_format(tmp_path, bits, value):
    with pytest.raises(ValueError, match=rf"is too large for float{bits}\. Scale the image, or write \.npy\."):
        write_image(tmp_path / "a.exr", [[0, value]], bits=bits)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("shape", [(), (3,), (2, 3, 5), (2, 3, 0), (0, 3, 3), (1, 2, 3, 3)])
def test_a_shape_that_is_no_image(tmp_path, shape):
    with pytest.raises(
        ValueError, match=r"the image has shape \(.*\)\. An image is \(H, W\) or \(H, W, C\) with C from"
    ):
        write_image(tmp_path / "a.png", np.zeros(shape))
    np.save(tmp_path / "a.npy", np.zeros(shape))
    with pytest.raises(ValueError, match=r"^cannot read .*a\.npy: it has shape \(.*\)\. An image is"):
        read_image(tmp_path / "a.npy")


@pytest.mark.parametrize("image", [np.ones((2, 2), complex), np.full((2, 2), None), np.full((2, 2), "1")])
def test_a_type_that_is_no_number(tmp_path, image):
    with pytest.raises(ValueError, match=r"the image has type .*\. Give an array of real numbers\."):
        write_image(tmp_path / "a.npy", image)


@pytest.mark.parametrize(
    ("suffix", "bits", "known"),
    [
        ("png", 32, "PNG takes 8 or 16"),
        ("jpg", 16, "JPEG takes 8"),
        ("tga", 16, "TGA takes 8"),
        ("tif", 64, "TIFF takes 16 or 8 or 32"),
        ("exr", 8, "EXR takes 32 or 16"),
        ("npy", 32, "NPY takes 64"),
    ],
)
def test_bits_that_the_format_does_not_have(tmp_path, suffix, bits, known):
    with pytest.raises(ValueError, match=rf"^cannot write .*a\.{suffix} with bits={bits}\. {known}\.$"):
        write_image(tmp_path / f"a.{suffix}", np.zeros((H, W)), bits=bits)


def test_alpha_where_the_format_has_none(tmp_path):
    for channels in (2, 4):
        with pytest.raises(ValueError, match=r"a JPEG has no alpha\. Leave the last channel out, or write a PNG\."):
            write_image(tmp_path / "a.jpg", np.zeros((H, W, channels)))
    for suffix, bits in (("png", 16), ("tif", 16), ("tif", 32)):
        with pytest.raises(ValueError, match=r"with grey \+ alpha takes bits=8\. Write RGBA, EXR or \.npy\."):
            write_image(tmp_path / f"a.{suffix}", np.zeros((H, W, 2)), bits=bits)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("name", ["a.gif", "a", "a.png.txt"])
def test_a_suffix_that_is_not_known(file, tmp_path, name):
    message = (
        r"has the suffix '.*', which is no known image\. Use \.png, \.jpg, \.jpeg, \.tif, \.tiff, \.tga, \.exr, \.npy\."
    )
    with pytest.raises(ValueError, match=message):
        write_image(tmp_path / name, np.zeros((H, W)))
    with pytest.raises(ValueError, match=message):
        read_image(file(name, b"x"))


# Files that are not there, not whole, or not what they say


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


@pytest.mark.parametrize(("suffix", "bits"), WRITABLE)
def test_a_truncated_file_is_an_error_without_noise(tmp_path, capfd, suffix, bits):
    path = tmp_path / f"a.{suffix}"
    data = example(suffix, bits, path)
    end = len(data) - (26 if suffix == "tga" else 0)  # the footer of a TGA is no part of the picture
    for length in sorted({*np.linspace(0, end - 1, 40).astype(int), *range(16), *range(end - 16, end)}):
        path.write_bytes(data[:length])
        assert_unreadable(path)
    assert capfd.readouterr() == ("", "")
    path.write_bytes(data)
    assert read_image(path).shape == (40, 30, 3)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("deflate", [False, True])
def test_a_truncated_tiff_whose_directory_comes_first(file, capfd, dtype, deflate):
    data = tiff(floats(40, 30, 3).astype(dtype), deflate=deflate, rows_per_strip=7)
    read_image(file("a.tif", data))
    for length in sorted({*np.linspace(0, len(data) - 1, 40).astype(int), len(data) - 2}):
        assert_unreadable(file("a.tif", data[:length]))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("header", [{"lineOrder": OpenEXR.DECREASING_Y}, {"compression": OpenEXR.NO_COMPRESSION}])
def test_a_truncated_exr_of_other_layouts(tmp_path, capfd, header):
    path = tmp_path / "a.exr"
    with OpenEXR.File(header, {"RGB": floats(70, W, 3).astype("f4")}) as file:
        file.write(str(path))
    data = path.read_bytes()
    for length in (*range(500), *np.linspace(500, len(data) - 1, 25).astype(int)):  # the header to the byte
        path.write_bytes(data[:length])
        assert_unreadable(path)
    assert capfd.readouterr() == ("", "")


def test_an_exr_that_its_writer_did_not_finish(tmp_path, capfd):
    path = tmp_path / "a.exr"
    data = bytearray(example("exr", 32, path))
    end_of_header = data.index(b"screenWindowWidth\0")
    end_of_header = data.index(b"type\0string\0", end_of_header) + len(b"type\0string\0") + 4 + len("scanlineimage") + 1
    data[end_of_header : end_of_header + 8] = bytes(8)  # the first block was never written
    path.write_bytes(data)
    assert_unreadable(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_damage_in_the_middle_of_a_deflated_tiff_is_found(file, bits):
    pixels = floats(40, 30, 3).astype("f4") if bits == 32 else integers(bits, 40, 30, 3)
    data = bytearray(tiff(pixels, deflate=True))
    data[len(data) // 2] ^= 0x10
    assert_unreadable(file("a.tif", data))


@pytest.mark.parametrize("bits", [8, 16])
def test_one_wrong_bit_in_a_png_is_found_without_noise(file, capfd, bits):
    """Stored, not deflated, so that nothing but a checksum can tell."""
    whole = png(integers(bits, H, W, 3), bits, 2, level=0)
    data = bytearray(whole)
    data[len(data) // 2] ^= 1
    assert_unreadable(file("a.png", data))
    assert capfd.readouterr() == ("", "")


def test_a_damaged_lzw_tiff_is_found_without_noise(tmp_path, capfd):
    path = tmp_path / "a.tif"
    cv2.imwrite(str(path), np.full((40, 30, 3), 40000, np.uint16), [cv2.IMWRITE_TIFF_COMPRESSION, 5])
    data = bytearray(path.read_bytes())
    data[20:60] = bytes(range(100, 140))
    path.write_bytes(data)
    assert_unreadable(path)
    assert capfd.readouterr() == ("", "")


def test_rgba_tiff_of_opencv_is_read_without_noise(tmp_path, capfd):
    """OpenCV writes RGBA without the tag ExtraSamples, and complains of it when it reads."""
    for bits in (16, 32):
        write_image(tmp_path / "a.tif", np.ones((H, W, 4)), bits=bits)
        np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), np.ones((H, W, 4)))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", ["png", "jpg", "jpeg", "tif", "tiff", "tga", "exr", "npy"])
def test_empty_files_and_other_files(file, tmp_path, capfd, suffix):
    buffer = io.BytesIO()
    Image.fromarray(integers(8, 9, 9, 3)).save(buffer, "BMP")
    for data in (
        b"",
        b"\0",
        b"These are notes, not an image.\n" * 40,
        bytes(500),
        buffer.getvalue(),
        b"PK\3\4" + bytes(99),
    ):
        assert_unreadable(file(f"a.{suffix}", data))
    other = "a.tif" if suffix == "png" else "a.png"
    write_image(tmp_path / other, np.zeros((9, 9, 3)), bits=16)
    assert_unreadable((tmp_path / other).rename(tmp_path / f"a.{suffix}"))
    assert capfd.readouterr() == ("", "")


def test_files_that_are_not_there(tmp_path):
    for read in (read_image, read_mask):
        with pytest.raises(FileNotFoundError, match=r"^cannot read .*a\.png: there is no such file\. Check the name"):
            read(tmp_path / "a.png")
        (tmp_path / "folder.png").mkdir(exist_ok=True)
        with pytest.raises(IsADirectoryError, match=r"^cannot read .*folder\.png: it is a folder\. Give the name of"):
            read(tmp_path / "folder.png")


def test_arrays_that_are_no_images(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, np.array([[{}]]), allow_pickle=True)
    with pytest.raises(
        ValueError, match=r"^cannot read .*a\.npy: it holds Python objects\. Save an array of numbers\.$"
    ):
        read_image(path)
    for array in (
        np.zeros((2, 2), np.int64),
        np.zeros((2, 2), complex),
        np.zeros((2, 2), "U3"),
        np.zeros((2, 2), "i1"),
    ):
        np.save(path, array)
        with pytest.raises(
            ValueError, match=r"^cannot read .*a\.npy: it has numbers of type .*\. Use uint8, uint16 or"
        ):
            read_image(path)


def test_a_picture_too_large_for_pillow(file):
    head = png_chunk(b"IHDR", struct.pack(">IIBBBBB", 20000, 10000, 8, 0, 0, 0, 0))
    data = b"\x89PNG\r\n\x1a\n" + head + png_chunk(b"IDAT", bytes(200_000)) + png_chunk(b"IEND", b"")
    with pytest.raises(
        ValueError, match=r"a\.png: it has more than 178 million pixels\. Save it smaller, or with 16 bits"
    ):
        read_image(file("a.png", data))


def test_inks_are_refused(tmp_path):
    for suffix in ("jpg", "tif"):
        Image.new("CMYK", (9, 9)).save(tmp_path / f"a.{suffix}")
        with pytest.raises(ValueError, match=r"it has pixels of the kind CMYK\. Save it as grey or RGB\.$"):
            read_image(tmp_path / f"a.{suffix}")


# The house


@pytest.mark.parametrize(("suffix", "bits"), WRITABLE)
def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, suffix, bits):
    path = tmp_path / f"a.{suffix}"
    write_image(path, np.zeros((H, W)), bits=bits)
    before = path.read_bytes()

    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full_disk)
    with pytest.raises(OSError, match="No space left"):
        write_image(path, np.ones((H, W)), bits=bits)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == [path.name]


def test_a_missing_folder(tmp_path):
    with pytest.raises(
        FileNotFoundError, match=r"^cannot write .*a\.png: there is no folder .*results\. Create it first"
    ):
        write_image(tmp_path / "results" / "a.png", np.zeros((H, W)))


@pytest.mark.parametrize("folder", ["a.zip", "~", "with space and ü", "http:"])
@pytest.mark.parametrize(("suffix", "bits"), WRITABLE)
def test_folders_with_names_that_imageio_might_take_for_something_else(tmp_path, monkeypatch, folder, suffix, bits):
    monkeypatch.chdir(tmp_path)
    os.mkdir(folder)
    write_image(f"{folder}/a.{suffix}", np.ones((H, W)), bits=bits)
    np.testing.assert_array_equal(read_image(f"{folder}/a.{suffix}"), np.ones((H, W, 1)))
    assert os.listdir(folder) == [f"a.{suffix}"]


def test_threads_read_the_same_and_opencvs_log_level_stays(tmp_path):
    log: Any = getattr(cv2.utils, "logging", cv2)
    level = log.getLogLevel()
    paths = [tmp_path / f"{i}.png" for i in range(8)]
    images = [integers(16, 60, 50, 3, seed=i) / 65535 for i in range(8)]
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda path, image: write_image(path, image, bits=16), paths, images))
        for image, back in zip(images, pool.map(read_image, paths * 4), strict=False):
            np.testing.assert_array_equal(back, image)
    assert log.getLogLevel() == level


def test_importing_the_module_imports_no_decoder():
    code = "import sys, diffshade.images; print({'imageio', 'PIL', 'cv2', 'OpenEXR'} & set(sys.modules))"
    folder = Path(__file__).parents[2]
    result = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "set()"
