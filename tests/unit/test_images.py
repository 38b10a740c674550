"""Images against independent writers and readers: PNG, TIFF and TGA by hand, and cv2, Pillow and OpenEXR directly."""

import io
import itertools
import logging
import math
import os
import re
import struct
from typing import Any

import image_files as by
import jax.numpy as jnp
import numpy as np
import OpenEXR
import pytest
from PIL import Image

from diffshade.io.encodings import srgb_decode, srgb_encode
from diffshade.io.image_headers import check_exr, check_pixels, check_png, check_tiff
from diffshade.io.images import read_image, read_mask, write_image

H, W = by.H, by.W
FLOAT = [("tif", 32, np.float32), ("exr", 16, np.float16), ("exr", 32, np.float32), ("npy", 64, np.float64)]


def holds(suffix, bits, shape):
    return shape[2:] != (2,) or bits == 8 or suffix in ("exr", "npy")


# Round trips


@pytest.mark.parametrize(("suffix", "bits"), by.INTEGER)
@pytest.mark.parametrize("srgb", [None, False, True])
def test_integers_come_back_exactly(tmp_path, caplog, capfd, suffix, bits, srgb):
    full, path = 2**bits - 1, tmp_path / f"image.{suffix}"
    for shape in (shape for shape in by.SHAPES if holds(suffix, bits, shape)):
        numbers = by.integers(bits, *shape)
        numbers.flat[:2] = 0, full
        encoded = numbers / full
        curve = srgb or (srgb is None and (suffix, bits) == ("png", 8))
        linear = by.to_linear(encoded) if curve else encoded
        if shape[2:] in ((2,), (4,)):
            linear[..., -1] = encoded[..., -1]  # alpha has no curve
        write_image(path, linear, bits=bits, srgb=srgb)
        stored = read_image(path, srgb=False)
        assert stored.shape == (*shape, 1)[: max(3, len(shape))]
        assert stored.dtype == np.float64
        np.testing.assert_array_equal(stored.reshape(shape), encoded)
        np.testing.assert_allclose(read_image(path, srgb=srgb).reshape(shape), linear, rtol=1e-14)
    assert caplog.records == []
    assert capfd.readouterr() == ("", "")  # OpenCV complains of its own RGBA


@pytest.mark.parametrize(("suffix", "bits", "dtype"), FLOAT)
def test_floats_come_back_exactly_and_unclipped(tmp_path, caplog, suffix, bits, dtype):
    for shape in (shape for shape in by.SHAPES if holds(suffix, bits, shape)):
        image = by.floats(*shape)
        write_image(tmp_path / f"image.{suffix}", image, bits=bits)
        np.testing.assert_array_equal(read_image(tmp_path / f"image.{suffix}").reshape(shape), image.astype(dtype))
    assert caplog.records == []


def test_rounding_is_to_the_nearest_level(tmp_path):
    write_image(tmp_path / "a.tga", np.array([[100.49, 100.51, 254.6]]) / 255)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tga")[..., 0] * 255, [[100, 101, 255]])


@pytest.mark.parametrize(("suffix", "bits"), by.WRITABLE)
def test_small_images_are_not_taken_for_something_else(tmp_path, suffix, bits):
    for shape in [(1, 1), (1, 1, 3), (1, 2, 4), (2, 3), (3, 3), (4, 4), (3, 4, 3), (4, 1), (3, 1, 4)]:
        image = np.full(shape, 1.0)
        if suffix == "jpg" and image.ndim == 3:
            image = image[..., :3]  # a JPEG has no alpha
        write_image(tmp_path / f"a.{suffix}", image, bits=bits)
        np.testing.assert_array_equal(read_image(tmp_path / f"a.{suffix}").reshape(image.shape), image)


@pytest.mark.parametrize(("name", "channels"), [("a.jpg", 1), ("a.jpeg", 3), ("A.JPG", 3)])
def test_jpeg_comes_back_nearly(tmp_path, name, channels):
    rows, columns = np.mgrid[0:32, 0:40] / 40
    image = np.stack([rows, columns, 0.5 * (rows + columns)], axis=-1)[..., :channels]
    write_image(tmp_path / name, image)
    back = read_image(tmp_path / name)
    assert back.shape == image.shape
    levels_off = 255 * np.abs(srgb_encode(back) - srgb_encode(image))
    assert np.percentile(levels_off, 99) < 4
    assert levels_off.max() < 10
    np.testing.assert_array_equal(srgb_decode(read_image(tmp_path / name, srgb=False)), back)
    with Image.open(tmp_path / name) as found:
        np.testing.assert_allclose(np.asarray(found).reshape(image.shape), srgb_encode(image) * 255, atol=10)


@pytest.mark.parametrize(("suffix", "bits"), by.WRITABLE)
def test_what_is_written_where_nothing_is_said(tmp_path, suffix, bits):
    default = {"png": 8, "jpg": 8, "tga": 8, "tif": 16, "exr": 32, "npy": 64}[suffix]
    image = np.random.default_rng(0).uniform(size=(H, W, 3))
    write_image(tmp_path / f"a.{suffix}", image)
    write_image(tmp_path / f"b.{suffix.upper()}", image, bits=default)
    assert (tmp_path / f"a.{suffix}").read_bytes()[-64:] == (tmp_path / f"b.{suffix.upper()}").read_bytes()[-64:]
    write_image(tmp_path / f"a.{suffix}", np.full((16, 16), 0.5), bits=bits)  # and which files are sRGB
    stored = read_image(tmp_path / f"a.{suffix}", srgb=False)
    expected = 0.735357 if bits == 8 and suffix in ("png", "jpg") else 0.5
    np.testing.assert_allclose(stored, expected, atol=0.003)
    np.testing.assert_allclose(read_image(tmp_path / f"a.{suffix}"), 0.5, atol=0.004)


def test_what_may_be_written_and_is_left_as_it_was(tmp_path):
    image = np.random.default_rng(0).uniform(size=(H, W, 4)).astype(np.float32)
    image.flags.writeable = False
    before = image.copy()
    for make in (jnp.asarray, np.asarray, np.ndarray.tolist):
        write_image(tmp_path / "a.npy", make(image))
        np.testing.assert_array_equal(read_image(tmp_path / "a.npy"), image)
    for suffix in ("png", "exr"):
        write_image(f"{tmp_path / f'a.{suffix}'}", image)
    np.testing.assert_array_equal(image, before)
    write_image(tmp_path / "a.png", np.eye(4, dtype=bool))
    np.testing.assert_array_equal(read_image(f"{tmp_path / 'a.png'}")[..., 0], np.eye(4))
    np.testing.assert_array_equal(read_mask(f"{tmp_path / 'a.png'}"), np.eye(4, dtype=bool))


# What others wrote


@pytest.mark.parametrize(("colour_type", "channels"), [(0, 1), (4, 2), (2, 3), (6, 4)])
@pytest.mark.parametrize("bits", [8, 16])
def test_png_by_hand(file, colour_type, channels, bits):
    numbers = by.integers(bits, H, W, channels)
    image = read_image(file("a.png", by.png(numbers, bits, colour_type)), srgb=False)
    assert bits == 8 or numbers.max() > 255
    np.testing.assert_array_equal(image, numbers / (2**bits - 1))


@pytest.mark.parametrize("bits", [1, 2, 4, 8])
def test_png_of_few_bits_and_with_a_palette(file, bits):
    numbers = np.random.default_rng(0).integers(0, 2**bits, (H, W))
    image = read_image(file("a.png", by.png(numbers, bits, 0)))
    np.testing.assert_allclose(image[..., 0], by.to_linear(numbers / (2**bits - 1)), rtol=1e-14)
    palette, alpha = by.integers(8, 2**bits, 3), by.integers(8, 2**bits, seed=2)
    chunks = by.png_chunk(b"PLTE", palette.tobytes()), by.png_chunk(b"tRNS", alpha.tobytes())
    image = read_image(file("a.png", by.png(numbers, bits, 3, chunks[0])), srgb=False)
    np.testing.assert_array_equal(image, palette[numbers] / 255)
    image = read_image(file("a.png", by.png(numbers, bits, 3, *chunks)), srgb=False)
    np.testing.assert_array_equal(image, np.concatenate([palette[numbers], alpha[numbers][..., None]], axis=-1) / 255)


def test_png_chunks_of_transparency_gamma_and_colour(file):
    for bits in (8, 16):
        numbers = by.integers(bits, H, W, 3)
        clear = by.png_chunk(b"tRNS", numbers[1, 2].astype(">u2").tobytes())
        image = read_image(file("a.png", by.png(numbers, bits, 2, clear)))
        assert image[..., 3].sum() == H * W - 1
        assert image[1, 2, 3] == 0
    chunks = by.png_chunk(b"gAMA", struct.pack(">I", 100000)), by.png_chunk(b"cICP", bytes([9, 16, 0, 1]))
    np.testing.assert_array_equal(read_image(file("a.png", by.png(numbers, 16, 2, *chunks))), numbers / 65535)


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("bits", [8, 16, 32])
def test_tiff_by_hand(file, bits, channels):
    numbers = by.floats(H, W, channels).astype("f4") if bits == 32 else by.integers(bits, H, W, channels)
    for order, deflate in itertools.product("<>", (False, True)):
        image = read_image(file("a.tif", by.tiff(numbers, order, deflate=deflate)))
        np.testing.assert_array_equal(image, numbers / (1 if bits == 32 else 2**bits - 1))


def test_tiff_that_opencv_gets_wrong_is_refused(file, capfd):
    refused: list[tuple[np.ndarray, dict[str, Any]]] = [
        (by.integers(16, H, W, 2), {}),
        (by.integers(16, H, W, 3), {"planar": 2}),
        (by.integers(16, H, W), {"photometric": 0}),
        (by.integers(16, H, W, 4), {"photometric": 5}),
        *((by.floats(H, W, channels).astype(kind), {}) for channels, kind in ((2, "f4"), (3, "f2"), (3, "f8"))),
        (by.integers(16, H, W, 3).astype("i2"), {}),
        (by.integers(32, H, W), {}),
    ]
    for numbers, options in refused:
        with pytest.raises(ValueError, match=r"a\.tif: it is a TIFF with BitsPerSample .*\. Save it as 16-bit"):
            read_image(file("a.tif", by.tiff(numbers, **options)))
    assert capfd.readouterr() == ("", "")


def test_exr_in_tiles_and_from_the_bottom_up(tmp_path):
    pixels, tiles = by.floats(70, 50, 3).astype("f4"), OpenEXR.TileDescription()
    tiles.xSize = tiles.ySize = 16
    upwards = {"compression": OpenEXR.NO_COMPRESSION, "lineOrder": OpenEXR.DECREASING_Y}
    for header in ({"type": OpenEXR.tiledimage, "tiles": tiles}, upwards):
        with OpenEXR.File(header, {"RGB": pixels}) as file:
            file.write(str(tmp_path / "a.exr"))
        np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), pixels)


def test_exr_of_other_kinds_is_refused(tmp_path):
    plane, path = np.zeros((H, W), "f4"), tmp_path / "a.exr"
    window = (np.array([0, 0], "i4"), np.array([2 * W, 2 * H], "i4"))
    parts = [OpenEXR.Part({}, {"Y": plane}, "a"), OpenEXR.Part({}, {"Y": plane}, "b")]
    for made, message in (
        (({}, {"Z": plane}), r"has the channels Z\. Save R, G, B or Y"),
        (({}, {"Y": plane, "RY": plane, "BY": plane}), r"has the channels .*\. Save R, G, B or Y"),
        (({}, {"Y": plane.astype("u4")}), r"has numbers of type uint32\. Use"),
        ((parts,), r"has several parts, or deep pixels\. Save it"),
        (({"displayWindow": window}, {"Y": plane}), "holds a part of a picture"),
    ):
        with OpenEXR.File(*made) as file:
            file.write(str(path))
        with pytest.raises(ValueError, match=rf"^cannot read .*a\.exr: it {message}"):
            read_image(path)


@pytest.mark.parametrize("dtype", ["u1", "u2", "f2", "f4", "f8", ">u2", ">f4", "?"])
def test_npy_by_hand(tmp_path, dtype):
    dtype = np.dtype(dtype)
    for shape in by.SHAPES:
        array = (by.floats(*shape) * 50).astype(dtype if dtype.kind == "f" else "i8").astype(dtype)
        array.flat[3] = np.nan if dtype.kind == "f" else 1
        np.save(tmp_path / "a.npy", np.asfortranarray(array))
        full = np.iinfo(dtype).max if dtype.kind == "u" else 1
        np.testing.assert_array_equal(read_image(tmp_path / "a.npy").reshape(shape), array.astype("f8") / full)


# The sRGB curve and masks


def test_srgb_is_the_curve_of_the_standard(tmp_path):
    x = np.concatenate([np.linspace(0, 1, 1001), [0.04045, 0.0404500001, 0.5]])
    np.testing.assert_allclose(srgb_decode(x), by.to_linear(x), rtol=1e-14)
    np.testing.assert_allclose(srgb_encode(by.to_linear(x)), x, atol=1e-7)  # the published constants meet to 1e-7
    np.testing.assert_allclose(srgb_decode([0.0, 0.02, 0.5, 1.0]), [0, 0.02 / 12.92, 0.21404114048, 1], rtol=1e-10)
    np.testing.assert_allclose(srgb_encode([0.0, 0.002, 0.18, 1.0]), [0, 0.02584, 0.46135612950, 1], rtol=1e-10)
    assert srgb_decode(1.0) == 1  # exactly, so that what was read is not clipped when it is written
    np.testing.assert_allclose(srgb_encode([-0.1, 4.0]), [-1.292, 1.055 * 4 ** (1 / 2.4) - 0.055], rtol=1e-14)
    np.testing.assert_allclose(srgb_decode(srgb_encode([-0.1, 4.0])), [-0.1, 4.0], rtol=1e-14)
    assert srgb_encode(0.5).shape == ()
    assert srgb_decode(np.zeros((2, 3, 4, 5), np.float32)).shape == (2, 3, 4, 5)
    image = np.abs(by.floats(H, W, 3))
    write_image(tmp_path / "a.npy", image, srgb=True)  # float files may be sRGB too
    np.testing.assert_allclose(np.load(tmp_path / "a.npy"), srgb_encode(image), rtol=1e-15)
    np.testing.assert_allclose(read_image(tmp_path / "a.npy", srgb=True), image, rtol=1e-12)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_a_mask_is_alpha_or_else_grey_from_half_up(tmp_path, suffix, bits):
    full, path = 2**bits - 1, tmp_path / f"a.{suffix}"
    levels, inside = np.array([[0, full // 2, full // 2 + 1, full]]) / full, [[False, False, True, True]]
    none, whole = 0 * levels, 0 * levels + 1
    for image in (
        levels,
        np.stack([levels] * 3, -1),
        np.stack([none, none, none, levels], -1),
        np.stack([levels, levels, levels, whole], -1),  # opaque everywhere: the colours are the mask
    ):
        write_image(path, image, bits=bits, srgb=False)
        np.testing.assert_array_equal(read_mask(path), inside)
    write_image(tmp_path / "a.tga", [[[1, 0.6, 0], [1, 0, 0], [0, 1, 1]]])  # a colour by its mean
    np.testing.assert_array_equal(read_mask(tmp_path / "a.tga"), [[True, False, True]])
    for dtype in (bool, np.uint8, np.float32):
        np.save(tmp_path / "a.npy", np.eye(4, dtype=dtype) * dtype(255 if dtype is np.uint8 else 1))
        assert read_mask(tmp_path / "a.npy").dtype == bool
        np.testing.assert_array_equal(read_mask(tmp_path / "a.npy"), np.eye(4, dtype=bool))


# Clipping and values that cannot be written


@pytest.mark.parametrize(("suffix", "bits"), by.INTEGER)
def test_clipping_is_said_and_counted_by_pixel(tmp_path, caplog, suffix, bits):
    image = np.full((H, W, 3), 0.5)
    image[0, 0] = 2, 3, 0.5
    image[1, 1] = -1
    image[2, 2] = 1.5, 0.5, -0.5
    image[3, 3] = 0, 1, 1
    with caplog.at_level(logging.WARNING, logger="diffshade"):
        write_image(tmp_path / f"a.{suffix}", image, bits=bits)
    (record,) = caplog.records
    assert record.levelname == "WARNING"
    said = record.getMessage()
    for part in (f"a.{suffix}", "3 of 35 pixels", "2 above 1 and 2 below 0", "Scale the image"):
        assert part in said
    back = read_image(tmp_path / f"a.{suffix}")
    np.testing.assert_array_equal(back[[0, 1, 2], [0, 1, 2]] >= 1, np.array([[1, 1, 0], [0, 0, 0], [1, 0, 0]], bool))
    assert back[1, 1].max() == 0


def broken(value):
    image = np.zeros((H, W, 3))
    image[3, 4, 1] = image[4, 0, 0] = value
    return image


LAYER, ALPHA = np.zeros((H, W)), np.zeros((H, W, 2))
UNWRITABLE = [
    *(
        (f"a.{suffix}", broken(value), bits, f"the image is {value} at row 3, column 4, channel 1; 2 of 105 values")
        for suffix, bits in by.WRITABLE
        for value in (np.nan, np.inf, -np.inf)
    ),
    ("a.exr", [[0, 65505.0]], 16, "too large for float16. Scale the image"),
    ("a.exr", [[0, -1e6]], 16, "too large for float16"),
    ("a.exr", [[0, 1e39]], 32, "too large for float32"),
    ("a.npy", np.ones((2, 2), complex), None, "the image must be an array of real numbers; got ndarray of complex128"),
    ("a.npy", np.full((2, 2), None), None, "must be an array of real numbers; got ndarray of object"),
    ("a.npy", np.full((2, 2), "1"), None, "must be an array of real numbers; got ndarray of <U1"),
    ("a.png", LAYER, 32, "bits=32. PNG takes 8 or 16."),
    ("a.jpg", LAYER, 16, "JPEG takes 8."),
    ("a.tga", LAYER, 16, "TGA takes 8."),
    ("a.tif", LAYER, 64, "TIFF takes 16 or 8 or 32."),
    ("a.exr", LAYER, 8, "EXR takes 32 or 16."),
    ("a.npy", LAYER, 32, "NPY takes 64."),
    ("a.jpg", ALPHA, None, "a JPEG has no alpha. Leave the last channel out"),
    ("a.jpg", np.zeros((H, W, 4)), None, "a JPEG has no alpha"),
    ("a.png", ALPHA, 16, "grey + alpha takes bits=8."),
    *((name, LAYER, None, "which is not a known image. Use .png, .jpg") for name in ("a.gif", "a", "a.png.txt")),
]


@pytest.mark.parametrize(("name", "image", "bits", "message"), UNWRITABLE)
def test_what_cannot_be_written_is_said_and_nothing_is(tmp_path, name, image, bits, message):
    with pytest.raises((ValueError, TypeError), match=re.escape(message)):
        write_image(tmp_path / name, image, bits=bits)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("shape", [(), (3,), (2, 3, 41), (2, 3, 0), (0, 3, 3), (1, 2, 3, 3)])
def test_a_shape_that_is_no_image(tmp_path, shape):
    message = rf"has shape {re.escape(str(shape))}\. An image is \(H, W\) or \(H, W, C\) with C from"
    with pytest.raises(ValueError, match=message):
        write_image(tmp_path / "a.png", np.zeros(shape))
    np.save(tmp_path / "a.npy", np.zeros(shape))
    with pytest.raises(ValueError, match=message):
        read_image(tmp_path / "a.npy")


# Files that are not there, not whole, or not what they say


@pytest.mark.parametrize(("suffix", "bits"), by.WRITABLE)
def test_a_truncated_file_is_an_error_without_noise(tmp_path, capfd, suffix, bits):
    path = tmp_path / f"a.{suffix}"
    data = by.example(suffix, bits, path)
    end = len(data) - (26 if suffix == "tga" else 0)  # the footer of a TGA is no part of the picture
    for length in sorted({*np.linspace(0, end - 1, 40).astype(int), *range(16), *range(end - 16, end)}):
        path.write_bytes(data[:length])
        by.assert_unreadable(path)
    assert capfd.readouterr() == ("", "")
    path.write_bytes(data)
    assert read_image(path).shape == (40, 30, 3)


def test_a_truncated_tiff_whose_directory_comes_first(file, capfd):
    for dtype, deflate in itertools.product((np.uint8, np.uint16, np.float32), (False, True)):
        data = by.tiff(by.floats(40, 30, 3).astype(dtype), deflate=deflate, rows_per_strip=7)
        assert read_image(file("a.tif", data)).shape[2] == 3
        for length in sorted({*np.linspace(0, len(data) - 1, 40).astype(int), len(data) - 2}):
            by.assert_unreadable(file("a.tif", data[:length]))
    assert capfd.readouterr() == ("", "")


def test_an_exr_that_its_writer_did_not_finish(tmp_path, capfd):
    path = tmp_path / "a.exr"
    data = bytearray(by.example("exr", 32, path))
    end_of_header = data.index(b"screenWindowWidth\0")
    end_of_header = data.index(b"type\0string\0", end_of_header) + len(b"type\0string\0") + 4 + len("scanlineimage") + 1
    data[end_of_header : end_of_header + 8] = bytes(8)  # the first block was never written
    path.write_bytes(data)
    by.assert_unreadable(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("bits", [8, 16])
def test_a_wrong_bit_is_found_by_a_checksum(file, capfd, bits):
    """Stored, not deflated, so that nothing but a checksum can tell; and of OpenCV, which ignores that of deflate."""
    for name, whole in (
        ("a.png", by.png(by.integers(bits, H, W, 3), bits, 2, level=0)),
        ("a.tif", by.tiff(by.integers(bits, 40, 30, 3), deflate=True)),
    ):
        data = bytearray(whole)
        data[len(data) // 2] ^= 1
        by.assert_unreadable(file(name, data))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", ["png", "jpg", "jpeg", "tif", "tiff", "tga", "exr", "npy"])
def test_empty_files_and_other_files(file, tmp_path, capfd, suffix):
    buffer = io.BytesIO()
    Image.fromarray(by.integers(8, 9, 9, 3)).save(buffer, "BMP")
    for data in (b"", b"\0", b"These are notes.\n" * 40, bytes(500), buffer.getvalue(), b"PK\3\4" + bytes(99)):
        by.assert_unreadable(file(f"a.{suffix}", data))
    other = "a.tif" if suffix == "png" else "a.png"
    write_image(tmp_path / other, np.zeros((9, 9, 3)), bits=16)
    by.assert_unreadable((tmp_path / other).rename(tmp_path / f"a.{suffix}"))
    assert capfd.readouterr() == ("", "")


def test_files_that_are_not_there_or_of_a_kind_that_is_not_read(file, tmp_path, capfd):
    (tmp_path / "folder.png").mkdir()
    for read in (read_image, read_mask):
        with pytest.raises(FileNotFoundError, match=r"^cannot read .*a\.png: there is no such file\. Check the name"):
            read(tmp_path / "a.png")
        with pytest.raises(IsADirectoryError, match=r"^cannot read .*folder\.png: it is a folder\. Give the name of"):
            read(tmp_path / "folder.png")
    arrays = [np.zeros((2, 2), dtype) for dtype in (np.int64, complex, "U3", "i1")]
    for array in (np.array([[{}]]), *arrays):
        np.save(tmp_path / "a.npy", array, allow_pickle=True)
        kind = "Python objects. Save an array" if array.dtype == object else f"{array.dtype}. Use uint8, uint16 or"
        with pytest.raises(ValueError, match=rf"a\.npy: it h.* {re.escape(kind)}"):
            read_image(tmp_path / "a.npy")
    with pytest.raises(ValueError, match=r"a\.tif: it has more than one page\. Save each to a file"):
        read_image(file("a.tif", by.tiff(by.integers(16, H, W), next_page=8)))
    for suffix in ("jpg", "tif"):
        Image.new("CMYK", (9, 9)).save(tmp_path / f"a.{suffix}")
        with pytest.raises(ValueError, match=r"it has pixels of the kind CMYK\. Save it as grey or RGB\.$"):
            read_image(tmp_path / f"a.{suffix}")
    with pytest.raises(ValueError, match="which is not a known image"):
        read_image(file("a.gif", b"x"))
    assert capfd.readouterr() == ("", "")


# What a header declares, before a decoder believes it

RAW = (1032, 8, 0, 1032), (344, 8, 2, 1032), (129, 16, 6, 1032), (7, 1, 3, 1)  # width, depth, colours, bytes a row
PACKED = {"NO": 1, "RLE": 64, "ZIPS": 1032, "ZIP": 1032, "PIZ": 1032, "PXR24": 2064, "B44": 16, "B44A": 16}


def without_a_word():
    return pytest.raises(ValueError, match=r"^$")


def test_a_png_is_refused_where_it_declares_more_than_deflate_could_hold(file):
    for width, depth, colour_type, bytes_a_row in RAW:
        rows = 1032 * 200 // bytes_a_row
        assert check_png(by.headed(width, rows, depth, colour_type, 200)) == (depth, colour_type)
        with without_a_word():
            check_png(by.headed(width, rows + 1, depth, colour_type, 200))
    with pytest.raises(ValueError, match=r"a\.png: it has more than 178 million pixels\. Save it smaller"):
        read_image(file("a.png", by.headed(20000, 10000, 8, 0, 200_000)))


def test_a_jpeg_or_tga_is_refused_where_it_declares_more_pixels_than_its_bytes_could_hold():
    for name, most in (("JPEG", 512), ("TGA", 64), ("TIFF", 2**19)):
        check_pixels(name, (most, 10), bytes(10))
        with without_a_word():
            check_pixels(name, (most, 11), bytes(10))


def test_a_tiff_is_refused_where_it_declares_more_than_its_strips_could_hold():
    plain = by.tiff(by.integers(8, 2, 8))  # one strip of 16 bytes
    assert check_tiff(plain)[0][256] == (8,)
    for tags in ({"height": 3}, {"bits": 16}, {"channels": 2}, {"counts": 17}, {"offsets": len(plain) - 15}):
        with without_a_word():
            check_tiff(by.declared(plain, **tags))
    packed = by.tiff(by.integers(8, 2, 8), deflate=True)
    stored = check_tiff(packed)[0][279][0] / 16  # of 16 bytes
    for data, compression, most in ((plain, 5, 2800), (plain, 7, 1536), (plain, 32773, 64), (packed, 8, 1032 * stored)):
        check_tiff(by.declared(data, compression=compression, width=int(8 * most)))
        with without_a_word():
            check_tiff(by.declared(data, compression=compression, width=int(8 * most) + 1))
    assert check_tiff(by.tiff(by.integers(8, 2, 8), ">", deflate=True))[0][259] == (8,)
    with without_a_word():
        check_tiff(by.declared(plain, bits=8, rename={"bits": 277}))  # twice the same tag
    to_tiles = {"offsets": 324, "counts": 325, "rows": 322, "orientation": 323}
    tiles = by.declared(plain, rows=4, orientation=4, rename=to_tiles)
    assert check_tiff(tiles)[0][323] == (4,)
    with without_a_word():
        check_tiff(by.declared(tiles, **{"tile height": 5}))


def test_an_exr_is_refused_where_its_window_is_larger_than_its_bytes_could_hold(tmp_path):
    for name, most in PACKED.items():
        channels = {"Y": np.zeros((8, 8), "f4"), "A": np.zeros((8, 8), "f2")}
        with OpenEXR.File({"compression": getattr(OpenEXR, f"{name}_COMPRESSION")}, channels) as file:
            file.write(str(tmp_path / "a.exr"))
        data = (tmp_path / "a.exr").read_bytes()
        at = data.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
        width = math.floor(most * len(data) / 6)  # 6 bytes a pixel
        check_exr(data[:at] + struct.pack("<iiii", 3, -2, width + 2, -2) + data[at + 16 :])
        with without_a_word():
            check_exr(data[:at] + struct.pack("<iiii", 3, -2, width + 3, -2) + data[at + 16 :])
    tiles = OpenEXR.TileDescription()
    tiles.xSize = tiles.ySize = 8
    header = {"type": OpenEXR.tiledimage, "tiles": tiles, "compression": OpenEXR.NO_COMPRESSION}
    with OpenEXR.File(header, {"Y": np.zeros((8, 8), "f4"), "A": np.zeros((8, 8), "f2")}) as file:
        file.write(str(tmp_path / "a.exr"))
    data = (tmp_path / "a.exr").read_bytes()
    at, wide = data.index(b"tiles\0tiledesc\0") + len(b"tiles\0tiledesc\0") + 4, len(data) // 12
    check_exr(data[:at] + struct.pack("<II", wide, 2) + data[at + 8 :])
    with without_a_word():
        check_exr(data[:at] + struct.pack("<II", wide + 1, 2) + data[at + 8 :])


# Bands


@pytest.mark.parametrize(
    ("name", "bits", "step"), [("a.npy", None, 0), ("a.tif", 32, 1e-7), ("a.tif", 16, 1e-5), ("a.tif", 8, 2e-3)]
)
@pytest.mark.parametrize("bands", [2, 31])
def test_bands_come_back_from_the_pages_of_a_tiff_and_from_npy(tmp_path, name, bits, step, bands):
    image = np.random.default_rng(0).uniform(0, 1, (5, 7, bands))
    write_image(tmp_path / name, image, bits=bits)
    np.testing.assert_allclose(read_image(tmp_path / name), image, rtol=0, atol=step)
    if name == "a.tif" and (bands > 2 or bits != 8):
        pages = check_tiff((tmp_path / name).read_bytes())
        assert [page[259] for page in pages] == [(8,)] * bands  # deflate


def test_pages_that_are_no_bands_are_refused(tmp_path):
    page = Image.new("L", (9, 9))
    for number, others in ((2, Image.new("L", (9, 8))), (2, Image.new("RGB", (9, 9))), (41, page)):
        page.save(tmp_path / "a.tif", save_all=True, append_images=[others] * (number - 1))
        with pytest.raises(ValueError, match=r"a\.tif: it has more than one page\. .* up to 40 bands as grey pages"):
            read_image(tmp_path / "a.tif")


def test_a_picture_of_bands_needs_a_format_that_has_them(tmp_path):
    with pytest.raises(
        ValueError, match=r"a\.png: the image has shape \(2, 3, 31\).*Write more bands as \.npy or \.tif"
    ):
        write_image(tmp_path / "a.png", np.zeros((2, 3, 31)))
