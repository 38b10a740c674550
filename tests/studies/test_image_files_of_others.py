"""The long tail of image files: every kind that other programs write, and files cut off at any byte."""

import os
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
    floats,
    integers,
    tga,
    tiff,
    to_linear,
)
from PIL import Image

from diffshade.io.images import read_image, write_image


@pytest.mark.parametrize(("suffix", "bits"), INTEGER)
def test_every_grey_level_comes_back_through_the_curve(tmp_path, suffix, bits):
    full = 2**bits - 1
    levels = np.arange(full + 1).reshape(-1, 256)
    write_image(tmp_path / f"a.{suffix}", to_linear(levels / full), bits=bits, srgb=True)
    np.testing.assert_array_equal(np.rint(read_image(tmp_path / f"a.{suffix}", srgb=False)[..., 0] * full), levels)


def test_tga_with_runs(tmp_path):
    numbers = np.repeat(integers(8, H, 2, 3), 5, axis=1)
    Image.fromarray(numbers).save(tmp_path / "a.tga", rle=True)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tga"), numbers / 255)


@pytest.mark.parametrize("compression", ["NO", "RLE", "ZIPS", "ZIP", "PIZ"])
@pytest.mark.parametrize("line_order", ["INCREASING_Y", "DECREASING_Y"])
def test_exr_compressions_and_line_orders(tmp_path, compression, line_order):
    pixels = floats(70, W, 3).astype("f4")
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "lineOrder": getattr(OpenEXR, line_order)}
    with OpenEXR.File(header, {"RGB": pixels}) as made:
        made.write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), pixels)


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
