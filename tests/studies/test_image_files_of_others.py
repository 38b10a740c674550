"""The long tail of image files: every kind that other programs write, and files cut off at any byte."""

import os
import struct
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest
from image_files import (
    INTEGER,
    WRITABLE,
    H,
    W,
    assert_unreadable,
    example,
    floats,
    integers,
    png,
    png_chunk,
    tga,
    tiff,
    to_linear,
    turned,
)
from PIL import Image

from diffshade.io.images import read_image, read_mask, write_image


@pytest.fixture
def file(tmp_path):
    """Write bytes under a name and give the path."""

    def write(name, data):
        (tmp_path / name).write_bytes(data)
        return tmp_path / name

    return write


@pytest.mark.parametrize(("suffix", "bits"), INTEGER)
def test_every_grey_level_comes_back_through_the_curve(tmp_path, suffix, bits):
    full = 2**bits - 1
    levels = np.arange(full + 1).reshape(-1, 256)
    write_image(tmp_path / f"a.{suffix}", to_linear(levels / full), bits=bits, srgb=True)
    np.testing.assert_array_equal(np.rint(read_image(tmp_path / f"a.{suffix}", srgb=False)[..., 0] * full), levels)


@pytest.mark.parametrize("bits", [1, 2, 4, 8])
def test_png_of_few_bits_and_with_a_palette(file, bits):
    numbers = np.random.default_rng(0).integers(0, 2**bits, (H, W))
    image = read_image(file("a.png", png(numbers, bits, 0)))
    np.testing.assert_allclose(image[..., 0], to_linear(numbers / (2**bits - 1)), rtol=1e-14)
    palette, alpha = integers(8, 2**bits, 3), integers(8, 2**bits, seed=2)
    chunks = png_chunk(b"PLTE", palette.tobytes()), png_chunk(b"tRNS", alpha.tobytes())
    image = read_image(file("a.png", png(numbers, bits, 3, chunks[0])), srgb=False)
    np.testing.assert_array_equal(image, palette[numbers] / 255)
    image = read_image(file("a.png", png(numbers, bits, 3, *chunks)), srgb=False)
    np.testing.assert_array_equal(image, np.concatenate([palette[numbers], alpha[numbers][..., None]], axis=-1) / 255)


def test_png_chunks_of_transparency_gamma_and_colour(file):
    for bits in (8, 16):
        numbers = integers(bits, H, W, 3)
        chunk = png_chunk(b"tRNS", numbers[1, 2].astype(">u2").tobytes())
        image = read_image(file("a.png", png(numbers, bits, 2, chunk)))
        assert image[..., 3].sum() == H * W - 1
        assert image[1, 2, 3] == 0
    chunks = png_chunk(b"gAMA", struct.pack(">I", 100000)), png_chunk(b"cICP", bytes([9, 16, 0, 1]))
    np.testing.assert_array_equal(read_image(file("a.png", png(numbers, 16, 2, *chunks))), numbers / 65535)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("deflate", [False, True])
@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("bits", [8, 16, 32])
def test_tiff_by_hand(file, bits, channels, deflate, order):
    numbers = floats(H, W, channels).astype("f4") if bits == 32 else integers(bits, H, W, channels)
    image = read_image(file("a.tif", tiff(numbers, order, deflate=deflate)))
    np.testing.assert_array_equal(image, numbers / (1 if bits == 32 else 2**bits - 1))


def test_tga_with_runs(tmp_path):
    numbers = np.repeat(integers(8, H, 2, 3), 5, axis=1)
    Image.fromarray(numbers).save(tmp_path / "a.tga", rle=True)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tga"), numbers / 255)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_picture_is_turned_upright(file, tmp_path, orientation):
    upright = np.kron(np.array([[250, 170, 90], [10, 50, 130]], np.uint8), np.ones((16, 16), np.uint8))
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(turned(upright, orientation)).save(tmp_path / "a.jpg", quality=100, exif=exif)
    np.testing.assert_allclose(read_image(tmp_path / "a.jpg", srgb=False)[..., 0], upright / 255, atol=2 / 255)
    for shape in ((H, W), (H, W, 3)):
        for dtype, full in (("u1", 255), ("u2", 65535), ("f4", 1)):
            upright = np.arange(np.prod(shape)).reshape(shape).astype(dtype)
            image = read_image(file("a.tif", tiff(turned(upright, orientation), orientation=orientation)))
            np.testing.assert_array_equal(image.reshape(upright.shape), upright / full)


@pytest.mark.parametrize("compression", ["NO", "RLE", "ZIPS", "ZIP", "PIZ"])
@pytest.mark.parametrize("line_order", ["INCREASING_Y", "DECREASING_Y"])
def test_exr_compressions_and_line_orders(tmp_path, compression, line_order):
    pixels = floats(70, W, 3).astype("f4")
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "lineOrder": getattr(OpenEXR, line_order)}
    with OpenEXR.File(header, {"RGB": pixels}) as made:
        made.write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), pixels)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_a_mask_is_alpha_or_else_grey_from_half_up(tmp_path, suffix, bits):
    full, path = 2**bits - 1, tmp_path / f"a.{suffix}"
    levels = np.array([[0, full // 2, full // 2 + 1, full]]) / full
    for image in (levels, np.stack([levels] * 3, -1), np.stack([0 * levels, 0 * levels, 0 * levels, levels], -1)):
        write_image(path, image, bits=bits, srgb=False)
        np.testing.assert_array_equal(read_mask(path), [[False, False, True, True]])


@pytest.mark.parametrize(("suffix", "bits"), WRITABLE)
def test_what_is_not_finite_is_not_written(tmp_path, caplog, suffix, bits):
    for value in (np.nan, np.inf, -np.inf):
        image = np.zeros((H, W, 3))
        image[3, 4, 1] = value
        with pytest.raises(ValueError, match=rf"a\.{suffix}: the image is {value} at row 3, column 4, channel 1; 1 of"):
            write_image(tmp_path / f"a.{suffix}", image, bits=bits)
    assert os.listdir(tmp_path) == []
    write_image(tmp_path / f"a.{suffix}", np.full((H, W), 2.0), bits=bits)
    assert len(caplog.records) == ((suffix, bits) in [*INTEGER, ("jpg", 8)])


@pytest.mark.parametrize(("suffix", "bits"), WRITABLE)
def test_a_truncated_file_is_an_error_without_noise(tmp_path, capfd, suffix, bits):
    path = tmp_path / f"a.{suffix}"
    data = example(suffix, bits, path)
    end = len(data) - (26 if suffix == "tga" else 0)  # the footer of a TGA is no part of the picture
    for length in sorted({*np.linspace(0, end - 1, 40).astype(int), *range(16), *range(end - 16, end)}):
        path.write_bytes(data[:length])
        assert_unreadable(path)
    assert capfd.readouterr() == ("", "")


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
    with OpenEXR.File(header, {"RGB": floats(70, W, 3).astype("f4")}) as made:
        made.write(str(path))
    data = path.read_bytes()
    for length in (*range(500), *np.linspace(500, len(data) - 1, 25).astype(int)):  # the header to the byte
        path.write_bytes(data[:length])
        assert_unreadable(path)
    assert capfd.readouterr() == ("", "")


def test_a_damaged_tiff_is_found_without_noise(file, tmp_path, capfd):
    for pixels in (integers(8, 40, 30, 3), integers(16, 40, 30, 3), floats(40, 30, 3).astype("f4")):
        data = bytearray(tiff(pixels, deflate=True))
        data[len(data) // 2] ^= 0x10
        assert_unreadable(file("a.tif", data))
    path = tmp_path / "a.tif"
    cv2.imwrite(str(path), np.full((40, 30, 3), 40000, np.uint16), [cv2.IMWRITE_TIFF_COMPRESSION, 5])  # LZW
    data = bytearray(path.read_bytes())
    data[20:60] = bytes(range(100, 140))
    assert_unreadable(file("a.tif", data))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(("suffix", "bits"), WRITABLE)
def test_files_are_written_whole_or_not_at_all_wherever_they_are(tmp_path, monkeypatch, suffix, bits):
    monkeypatch.chdir(tmp_path)
    for folder in ("a.zip", "~", "with space and ü", "http:"):
        os.mkdir(folder)
        write_image(f"{folder}/a.{suffix}", np.ones((H, W)), bits=bits)
        np.testing.assert_array_equal(read_image(f"{folder}/a.{suffix}"), np.ones((H, W, 1)))
        assert os.listdir(folder) == [f"a.{suffix}"]
    path = tmp_path / "~" / f"a.{suffix}"
    before = path.read_bytes()

    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full_disk)
    with pytest.raises(OSError, match="the disk is full"):
        write_image(path, np.zeros((H, W)), bits=bits)
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == [path.name]


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


@pytest.mark.parametrize("suffix", ["png", "tif", "tga"])
def test_8_bits_and_channel_order_against_pillow(tmp_path, suffix):
    for channels in (1, 2, 3, 4):
        numbers = integers(8, H, W, channels)
        Image.fromarray(numbers.squeeze()).save(tmp_path / f"a.{suffix}")
        np.testing.assert_array_equal(read_image(tmp_path / f"a.{suffix}", srgb=False), numbers / 255)
        write_image(tmp_path / f"b.{suffix}", numbers / 255, bits=8, srgb=False)
        with Image.open(tmp_path / f"b.{suffix}") as image:
            np.testing.assert_array_equal(np.asarray(image), numbers.squeeze())


def test_tiff_of_kinds_that_pillow_reads(file):
    numbers = integers(8, H, W, 3)
    np.testing.assert_array_equal(read_image(file("a.tif", tiff(numbers, planar=2))), numbers / 255)
    grey = numbers[..., :1]
    np.testing.assert_array_equal(read_image(file("a.tif", tiff(grey, photometric=0))), (255 - grey) / 255)
    numbers = np.full((H, W, 4), 200, np.uint8)
    numbers[..., 3] = 10  # alpha is not multiplied in
    np.testing.assert_array_equal(read_image(file("a.tif", tiff(numbers))), numbers / 255)


@pytest.mark.parametrize("channels", [3, 4])
def test_tga_by_hand(file, channels):
    for top_down in (False, True):
        numbers = integers(8, H, W, channels)
        np.testing.assert_array_equal(read_image(file("a.tga", tga(numbers, top_down))), numbers / 255)


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
