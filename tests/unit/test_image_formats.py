"""WebP, BMP, PPM, PGM, PFM, Radiance and HEIC beside other readers and writers, and their specifications."""

import io
import re
import struct
import sys

import cv2
import image_files as by
import numpy as np
import pytest
from PIL import Image

import diffshade as ds

H, W = by.H, by.W
SAMPLES = {
    "bmp": [(8, 3), (8, 1)],
    "webp": [(8, 3), (8, 4)],
    "ppm": [(8, 3), (16, 3), (8, 1)],
    "pgm": [(8, 1), (16, 1)],
    "pfm": [(32, 3), (32, 1)],
    "hdr": [(32, 3)],
}
CASES = [(suffix, bits, channels) for suffix, of in SAMPLES.items() for bits, channels in of]


def pixels(bits, channels):
    return 5 * np.abs(by.floats(H, W, channels)) if bits == 32 else by.integers(bits, H, W, channels) / (2**bits - 1)


@pytest.mark.parametrize(("suffix", "bits", "channels"), CASES)
def test_what_is_written_comes_back(tmp_path, suffix, bits, channels):
    image, path = pixels(bits, channels), tmp_path / f"a.{suffix}"
    ds.write_image(path, image, bits=bits, srgb=False)
    found = ds.read_image(path, srgb=False)
    if suffix == "hdr":  # rounded to 8 bits of the largest colour
        assert (np.abs(found - image) <= image.max(-1, keepdims=True) / 256).all()
    else:
        np.testing.assert_array_equal(found, np.broadcast_to(np.float32(image) if bits == 32 else image, found.shape))
    for srgb in (None, True):
        ds.write_image(path, image, bits=bits, srgb=srgb)
        np.testing.assert_allclose(ds.read_image(path, srgb=srgb), image, atol=0.01 * image.max())


@pytest.mark.parametrize(("suffix", "bits", "channels"), CASES)
def test_others_read_what_is_written(tmp_path, suffix, bits, channels):
    image, path = pixels(bits, channels), tmp_path / f"a.{suffix}"
    ds.write_image(path, image, bits=bits, srgb=False)
    found = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert found is not None
    found = found if found.ndim == 3 else found[..., None]
    found = found[..., [2, 1, 0, 3][: found.shape[2]]] if found.shape[2] > 1 else found
    full = 1 if bits == 32 else 2**bits - 1
    expected = np.broadcast_to(image, found.shape) * full
    np.testing.assert_allclose(found, expected, atol=0.5 / 128 * image.max() if suffix == "hdr" else 1e-5)


@pytest.mark.parametrize("suffix", ["webp", "bmp", "ppm", "pgm"])
def test_8_bits_are_srgb_and_16_bits_linear(tmp_path, suffix):
    ds.write_image(tmp_path / f"a.{suffix}", np.full((4, 4), 0.5))
    assert abs(ds.read_image(tmp_path / f"a.{suffix}", srgb=False).mean() - 188 / 255) < 1e-9
    if suffix in ("ppm", "pgm"):
        ds.write_image(tmp_path / f"a.{suffix}", np.full((4, 4), 0.5), bits=16)
        assert abs(ds.read_image(tmp_path / f"a.{suffix}", srgb=False).mean() - 0.5) < 1e-5


def test_netpbm_by_hand(tmp_path):
    def read(name, data):
        (tmp_path / name).write_bytes(data)
        return ds.read_image(tmp_path / name, srgb=False)[..., 0].tolist()

    assert read("a.pgm", b"P5\n# by hand\n2 1 # two\n1000\n\x00\xfa\x03\xe8") == [
        [pytest.approx(0.25, abs=1e-5), pytest.approx(1.0)]
    ]
    assert read("a.pgm", b"P5 2 2 15 \x00\x0f\x05\x0a") == [[0, 1], [pytest.approx(1 / 3), pytest.approx(2 / 3)]]
    assert read("a.pgm", b"P2 2 1 4000\n1000 4000") == [[pytest.approx(0.25, abs=1e-5), 1]]
    assert read("a.ppm", b"P3\n1 1\n255\n51 102 255") == [[0.2]]
    assert read("a.pgm", b"P1\n2 1\n1 0\n") == [[0, 1]]  # 1 is black
    for data in (
        b"P5 2 1 15 \x00\x10",
        b"P5 2 2 15 \x00\x01\x02",
        b"P5 0 2 15 ",
        b"P5 2 1 0 ab",
        b"P2 2 1 9 1 x",
        b"P2 2 1 9 1    ",
        b"P3\n2 1\n255\n128 128 128 1 2",
        b"P5 2",
    ):
        (tmp_path / "a.pgm").write_bytes(data)
        by.assert_unreadable(tmp_path / "a.pgm")


@pytest.mark.parametrize(("order", "scale"), [("<", "-1.0"), (">", "1.0"), ("<", "-0.25"), (">", "2.5e0")])
def test_pfm_by_hand(tmp_path, order, scale):
    upright = by.floats(H, W, 3).astype("f4")
    (tmp_path / "a.pfm").write_bytes(f"PF\n{W} {H}\n{scale}\n".encode() + upright[::-1].astype(f"{order}f4").tobytes())
    np.testing.assert_allclose(ds.read_image(tmp_path / "a.pfm"), upright * abs(float(scale)), rtol=1e-6)
    (tmp_path / "a.pfm").write_bytes(f"PF\n{W} {H}\n{scale}\n".encode() + bytes(12 * H * W - 1))
    by.assert_unreadable(tmp_path / "a.pfm")


def test_radiance_by_hand(tmp_path):
    def flat(header, *rgbe, size=b"-Y 1 +X 2"):
        (tmp_path / "a.hdr").write_bytes(b"#?RADIANCE\n" + header + b"\n" + size + b"\n" + bytes(rgbe))
        return tmp_path / "a.hdr"

    head = b"# made by hand\nFORMAT=32-bit_rle_rgbe\n"
    image = ds.read_image(flat(head, 128, 64, 0, 129, 200, 100, 50, 140))
    np.testing.assert_array_equal(image, [[[1, 0.5, 0], [3200, 1600, 800]]])  # c 2^(e - 136)
    image = ds.read_image(flat(b"EXPOSURE=4\nEXPOSURE= 0.5\n" + head, 128, 64, 0, 129, 128, 128, 128, 129))
    np.testing.assert_array_equal(image, [[[0.5, 0.25, 0], [0.5, 0.5, 0.5]]])  # what was multiplied is divided
    for header, size, message in (
        (b"FORMAT=32-bit_rle_xyze\n", b"-Y 1 +X 2", "has colours other than RGBE"),
        (head, b"+Y 1 +X 2", "is stored turned or mirrored"),
        (head, b"+X 1 -Y 2", "is stored turned or mirrored"),
    ):
        with pytest.raises(ValueError, match=rf"a\.hdr: it {message}"):
            ds.read_image(flat(header, *bytes(8), size=size))


def test_bmp_and_webp_of_other_kinds(tmp_path):
    grey = by.integers(8, H, W)
    for mode in ("1", "L", "P", "RGB", "RGBA"):
        of = Image.fromarray(grey).convert(mode)
        for suffix in ("bmp", "webp"):
            of.save(tmp_path / f"a.{suffix}", lossless=True, exact=True)
            image = ds.read_image(tmp_path / f"a.{suffix}", srgb=False)
            expected = np.asarray(of.convert("L")) / 255
            np.testing.assert_allclose(image[..., :1], expected[..., None], atol=1e-9)


@pytest.mark.parametrize(
    ("name", "image", "message"),
    [
        ("a.hdr", -np.ones((2, 2)), "HDR holds no value below 0; got -1"),
        ("a.hdr", np.ones((2, 2, 4)), "a HDR has no alpha"),
        ("a.bmp", np.ones((2, 2, 4)), "a BMP has no alpha"),
        ("a.ppm", np.ones((2, 2, 2)), "a PPM has no alpha"),
        ("a.pfm", np.ones((2, 2, 4)), "a PFM has no alpha"),
        ("a.pgm", np.ones((2, 2, 3)), "has shape (2, 2, 3). An image is (H, W) or (H, W, C) with C from 1 to 1"),
        ("a.heic", np.ones((2, 2)), "HEIC is only read. Write .png"),
    ],
)
def test_what_a_format_cannot_hold_is_said(tmp_path, name, image, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        ds.write_image(tmp_path / name, image)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", SAMPLES)
def test_a_truncated_or_other_file_is_an_error_without_noise(tmp_path, capfd, suffix):
    path = tmp_path / f"a.{suffix}"
    data = by.example(suffix, None, path) if suffix != "pgm" else b"P5 40 30 255 " + bytes(1200)
    for length in (0, 1, 9, 30, len(data) // 2, len(data) - 3):  # the last 2 bytes of a BMP are padding
        path.write_bytes(data[:length])
        by.assert_unreadable(path)
    path.write_bytes(b"These are notes.\n" * 40)
    by.assert_unreadable(path)
    assert capfd.readouterr() == ("", "")


def test_more_pixels_than_the_bytes_could_hold_are_refused_before_they_are_decoded(tmp_path, monkeypatch):
    def headed(kind):
        file = io.BytesIO()
        Image.new("RGB", (16, 16)).save(file, kind, **({"lossless": True} if kind == "WEBP" else {}))
        return bytearray(file.getvalue())

    bmp, webp = headed("BMP"), headed("WEBP")
    struct.pack_into("<ii", bmp, 18, 12_000, 12_000)
    struct.pack_into("<I", webp, 21, 11_999 | 11_999 << 14)
    files = {
        "a.bmp": bmp,
        "a.webp": webp,
        "a.hdr": b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 9000 +X 9000\n" + bytes(900),
        "a.ppm": b"P6 90000 90000 255 " + bytes(900),
        "a.pfm": b"PF 90000 90000 1 " + bytes(900),
    }
    monkeypatch.setattr(Image.Image, "load", lambda *_: pytest.fail("decoded"))
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
        by.assert_unreadable(tmp_path / name)


def test_heic(tmp_path, monkeypatch):
    pillow_heif = pytest.importorskip("pillow_heif", reason="HEIC is read with the extra 'heic'.")
    path, levels = tmp_path / "a.heic", np.kron(by.integers(8, 2, 3, 3) // 2 + 60, np.ones((32, 32, 1))).astype("u1")
    pillow_heif.from_pillow(Image.fromarray(levels)).save(path, quality=100, chroma=444)
    image = ds.read_image(path)
    np.testing.assert_allclose(image, by.to_linear(levels / 255), atol=0.03)  # sRGB, row 0 on top
    data = path.read_bytes()
    for length in (0, 30, len(data) // 2):
        path.write_bytes(data[:length])
        by.assert_unreadable(path)
    path.write_bytes(data)
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    with pytest.raises(
        ImportError, match=r"a\.heic without the package pillow-heif\. Install it: pip install 'diffshade\[heic\]'\.$"
    ):
        ds.read_image(path)
