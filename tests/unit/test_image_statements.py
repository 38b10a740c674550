"""What image files state of their curve, their primaries and their orientation, and that it is used or said."""

import io
import struct
import zlib

import colour_profiles as by
import image_files
import numpy as np
import pytest
from PIL import Image, ImageCms

import diffshade as ds
from diffshade.io.image_statements import statement_of

TRUTH = np.random.default_rng(0).uniform(0.05, 0.85, (8, 6, 3)).repeat(8, 0).repeat(8, 1)  # blocks: JPEG is lossy
TO_ADOBE = np.linalg.inv(by.ADOBE_XYZ) @ by.SRGB_XYZ
SRGB, LINEAR = ds.srgb_encode(TRUTH), TRUTH
ADOBE = np.clip(TRUTH @ TO_ADOBE.T, 0, 1) ** (1 / by.ADOBE_GAMMA)
GAMMA = TRUTH ** (1 / 2.2)
LCMS_SRGB = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
OF_LINEAR = by.profile("mine", by.gamma(1.0))
OF_ADOBE = by.profile("Adobe RGB (1998)", by.gamma(by.ADOBE_GAMMA), by.ADOBE_XYZ)
LONG = by.profile("long", by.table(np.linspace(0, 1, 50_000)))  # longer than a segment of JPEG


def iccp(profile):
    return b"iCCP", b"x\0\0" + zlib.compress(profile)


def gama(gamma):
    return b"gAMA", struct.pack(">I", round(1e5 / gamma))


STATED = {
    "jpg sRGB profile": (".jpg", by.saved(SRGB, "JPEG", icc_profile=LCMS_SRGB), "sRGB"),
    "jpg Adobe RGB": (".jpg", by.saved(ADOBE, "JPEG", icc_profile=OF_ADOBE), "Adobe RGB (1998)"),
    "jpg linear, in several segments": (".jpg", by.saved(LINEAR, "JPEG", icc_profile=LONG), "linear"),
    "jpg EXIF R03": (".jpg", by.saved(ADOBE, "JPEG", exif=by.exif(space=0xFFFF, interoperability="R03")), "Adobe RGB"),
    "jpg EXIF sRGB": (".jpg", by.saved(SRGB, "JPEG", exif=by.exif(space=1)), "sRGB"),
    "png8 linear profile": (".png", by.saved(LINEAR, "PNG", icc_profile=OF_LINEAR), "linear"),
    "png8 gAMA 1": (".png", by.png(LINEAR, 8, gama(1.0)), "linear"),
    "png8 gAMA 1/2.2": (".png", by.png(GAMMA, 8, gama(2.2)), "gamma 2.2"),
    "png16 gAMA 1/2.2": (".png", by.png(GAMMA, 16, gama(2.2)), "gamma 2.2"),
    "png16 sRGB": (".png", by.png(SRGB, 16, (b"sRGB", b"\0"), gama(2.2)), "sRGB"),
    "png16 gAMA and cHRM of sRGB": (".png", by.png(SRGB, 16, gama(2.2), (b"cHRM", by.CHRM_SRGB)), "sRGB"),
    "png16 gAMA and cHRM of Adobe RGB": (
        ".png",
        by.png(
            ADOBE,
            16,
            gama(by.ADOBE_GAMMA),
            (b"cHRM", by.chromaticities(0.3127, 0.329, 0.64, 0.33, 0.21, 0.71, 0.15, 0.06)),
        ),
        "gamma 2.2",
    ),
    "png16 cICP linear": (".png", by.png(LINEAR, 16, (b"cICP", bytes([1, 8, 0, 1])), (b"sRGB", b"\0")), "linear"),
    "png16 iCCP before gAMA": (".png", by.png(SRGB, 16, gama(1.0), iccp(LCMS_SRGB)), "sRGB"),
    "png16 eXIf sRGB": (".png", by.png(SRGB, 16, (b"eXIf", by.exif(space=1)[6:])), "sRGB"),
    "webp linear": (".webp", by.saved(LINEAR, "WEBP", icc_profile=OF_LINEAR), "linear"),
    "webp Adobe RGB": (".webp", by.saved(ADOBE, "WEBP", icc_profile=OF_ADOBE), "Adobe RGB (1998)"),
    "tif8 sRGB": (".tif", by.saved(SRGB, "TIFF", icc_profile=LCMS_SRGB), "sRGB"),
    "tif8 Adobe RGB": (".tif", by.saved(ADOBE, "TIFF", icc_profile=OF_ADOBE), "Adobe RGB (1998)"),
}


@pytest.mark.parametrize("case", STATED)
def test_a_file_is_decoded_as_it_states(tmp_path, case, caplog):
    suffix, data, name = STATED[case]
    path = tmp_path / f"a{suffix}"
    path.write_bytes(data)
    stated = statement_of(path).encoding
    assert stated is not None
    assert stated.name == name
    sixteen = "16" in case
    np.testing.assert_allclose(ds.read_image(path), TRUTH, atol=4e-4 if sixteen else 0.02)
    raw = ds.read_image(path, srgb=False)
    np.testing.assert_array_equal(ds.read_image(path, srgb=True), ds.srgb_decode(raw))  # which wins
    assert caplog.text == ""


def test_16_bit_and_float_tiffs_with_profiles(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    for numbers, tolerance in ((np.rint(65535 * ADOBE).astype(np.uint16), 4e-4), (ADOBE.astype(np.float32), 4e-4)):
        for order in "<>":
            tifffile.imwrite(tmp_path / "a.tif", numbers, photometric="rgb", byteorder=order, iccprofile=OF_ADOBE)
            np.testing.assert_allclose(ds.read_image(tmp_path / "a.tif"), TRUTH, atol=tolerance)
            np.testing.assert_allclose(ds.open_image(tmp_path / "a.tif")[:], TRUTH, atol=tolerance)
    tifffile.imwrite(tmp_path / "a.tif", numbers, photometric="rgb", iccprofile=OF_LINEAR)
    np.testing.assert_array_equal(ds.read_image(tmp_path / "a.tif"), numbers)


def test_grey_files_take_the_curve_alone(tmp_path):
    grey = np.rint(255 * TRUTH[..., 0] ** (1 / 1.8)).astype(np.uint8)
    for profile in (by.profile("Gray", by.gamma(1.8), None), by.profile("RGB", by.gamma(1.8), by.ADOBE_XYZ)):
        Image.fromarray(grey).save(tmp_path / "a.png", icc_profile=profile)
        np.testing.assert_allclose(ds.read_image(tmp_path / "a.png")[..., 0], TRUTH[..., 0], atol=0.01)


def test_alpha_and_masks_have_no_curve(tmp_path):
    image = np.dstack([np.full((4, 4, 3), 0.5), np.full((4, 4), 0.5)])
    Image.fromarray(np.rint(255 * image).astype(np.uint8)).save(tmp_path / "a.png", icc_profile=OF_ADOBE)
    assert abs(ds.read_image(tmp_path / "a.png")[0, 0, 3] - 128 / 255) < 1e-9
    assert ds.read_mask(tmp_path / "a.png").all()


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (by.saved(SRGB, "JPEG", icc_profile=by.profile("Proof", by.gamma(1), kind=b"RGB Lab ")), "profile 'Proof'"),
        (by.saved(SRGB, "JPEG", icc_profile=b"nonsense"), "a colour profile that is damaged"),
        (by.saved(SRGB, "JPEG", exif=by.exif(space=0xFFFF)), "a colour space other than sRGB"),
    ],
)
def test_what_is_not_used_is_said(tmp_path, caplog, data, what):
    (tmp_path / "a.jpg").write_bytes(data)
    np.testing.assert_allclose(ds.read_image(tmp_path / "a.jpg"), TRUTH, atol=0.02)
    (record,) = caplog.records
    assert f"a.jpg states {what}" in record.getMessage() or what in record.getMessage()
    assert record.getMessage().endswith("which is not used: it is read as sRGB.")


@pytest.mark.parametrize(
    ("kind", "body", "what"),
    [
        (b"iCCP", b"x\0\0notzlib", "an iCCP chunk"),
        (b"gAMA", bytes(4), "a gAMA or cHRM chunk"),
        (b"cICP", b"\1\1\0", "a cICP chunk"),
    ],
)
def test_a_damaged_part_of_a_png_is_said_and_hides_no_other(tmp_path, kind, body, what):
    (tmp_path / "a.png").write_bytes(by.png(SRGB, 8, (kind, body), (b"eXIf", by.exif(orientation=6)[6:])))
    assert statement_of(tmp_path / "a.png") == (None, f"{what} that is damaged", 6, TRUTH.shape[:2])
    assert ds.read_image(tmp_path / "a.png").shape[:2] == TRUTH.shape[1::-1]


def retyped(data, tag, kind, value=None):
    """Return a TIFF one of whose tags has another type, and value."""
    out, (at,) = bytearray(data), struct.unpack_from("<I", data, 4)
    for entry in range(at + 2, at + 2 + 12 * struct.unpack_from("<H", data, at)[0], 12):
        if struct.unpack_from("<H", out, entry)[0] == tag:
            struct.pack_into("<H", out, entry + 2, kind)
            if value is not None:
                struct.pack_into("<I", out, entry + 8, value)
    return bytes(out)


def test_a_damaged_part_of_a_tiff_is_said_and_hides_no_other(tmp_path, recwarn):
    tags = Image.Exif()
    tags[0x0112], tags.get_ifd(0x8769)[0xA001] = 6, 1
    whole = by.saved(SRGB, "TIFF", icc_profile=LCMS_SRGB, exif=tags)
    for data in (retyped(whole, 0x8769, 13), retyped(whole, 0x8769, 4, 2**30)):
        (tmp_path / "a.tif").write_bytes(data)
        stated = statement_of(tmp_path / "a.tif")
        assert stated.encoding is not None
        assert (stated.encoding.name, *stated[1:]) == ("sRGB", "", 6, TRUTH.shape[:2])
        ds.read_image(tmp_path / "a.tif")
    (tmp_path / "a.tif").write_bytes(retyped(whole, 0x8773, 6))
    assert statement_of(tmp_path / "a.tif") == (None, "a colour profile that is damaged", 6, TRUTH.shape[:2])
    assert not recwarn.list  # of Pillow


def test_a_bigtiff_is_opened_as_it_states_and_not_read_whole(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    for order in "<>":
        numbers = np.rint(65535 * ADOBE).astype(np.uint16)
        options = {"photometric": "rgb", "byteorder": order, "iccprofile": OF_ADOBE}
        tifffile.imwrite(tmp_path / "a.tif", numbers, bigtiff=True, **options)
        np.testing.assert_allclose(ds.open_image(tmp_path / "a.tif")[:], TRUTH, atol=4e-4)
        with pytest.raises(ValueError, match=r"it is a BigTIFF\. Open it by rows with ds\.open_image"):
            ds.read_image(tmp_path / "a.tif")


def test_curves_of_bmp_tga_and_radiance_are_said(tmp_path):
    plain = by.saved(SRGB, "BMP")
    for more, what in (
        (bytes(36) + struct.pack("<3I", *[65536] * 3), "curves and primaries of its own"),
        (bytes(48), ""),
    ):
        head = struct.pack("<I", 108) + plain[18:54] + bytes(16) + bytes(4) + more
        start = struct.pack("<IHHI", len(plain) + 68, 0, 0, 122)
        (tmp_path / "a.bmp").write_bytes(b"BM" + start + head + plain[54:])
        assert statement_of(tmp_path / "a.bmp").unused == what
        np.testing.assert_allclose(ds.read_image(tmp_path / "a.bmp"), TRUTH, atol=0.01)
    data = image_files.tga(np.rint(255 * SRGB).astype(np.uint8))
    for ratio, what in (((22, 10), "a gamma of 2.2"), ((1, 1), ""), ((0, 0), "")):
        area = bytes(478) + struct.pack("<HH", *ratio) + bytes(13)
        (tmp_path / "a.tga").write_bytes(data + area + struct.pack("<II", len(data), 0) + b"TRUEVISION-XFILE.\0")
        assert statement_of(tmp_path / "a.tga").unused == what
        ds.read_image(tmp_path / "a.tga")
    ds.write_image(tmp_path / "a.hdr", TRUTH)
    data = (tmp_path / "a.hdr").read_bytes()
    (tmp_path / "a.hdr").write_bytes(data.replace(b"\n\n", b"\nGAMMA=2.2\nCOLORCORR= 2 1 1\n\n", 1))
    assert statement_of(tmp_path / "a.hdr").unused == "GAMMA=2.2 and COLORCORR=2 1 1"
    (tmp_path / "a.hdr").write_bytes(data.replace(b"\n\n", b"\nGAMMA=1\n\n", 1))
    assert statement_of(tmp_path / "a.hdr").unused == ""


def test_primaries_of_openexr_and_radiance(tmp_path):
    import OpenEXR

    xy = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.329)
    adobe = 3 * (TRUTH @ TO_ADOBE.T).astype(np.float32)
    with OpenEXR.File({"chromaticities": xy}, {"RGB": adobe}) as file:
        file.write(str(tmp_path / "a.exr"))
    np.testing.assert_allclose(ds.read_image(tmp_path / "a.exr"), 3 * TRUTH, atol=2e-3)
    ds.write_image(tmp_path / "a.hdr", adobe)
    data = (tmp_path / "a.hdr").read_bytes()
    primaries = " ".join(map(str, xy)).encode()
    (tmp_path / "a.hdr").write_bytes(data.replace(b"\n\n", b"\nPRIMARIES=%b\n\n" % primaries, 1))
    np.testing.assert_allclose(ds.read_image(tmp_path / "a.hdr"), 3 * TRUTH, atol=0.02)


# Orientation

UPRIGHT = np.kron(np.arange(6).reshape(2, 3) * 40, np.ones((16, 16))).astype(np.uint8)[..., None].repeat(3, -1)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_every_format_is_turned_alike(tmp_path, orientation):
    stored = image_files.turned(UPRIGHT, orientation)
    tags = by.exif(orientation=orientation)
    files = {
        "a.jpg": by.saved(stored / 255, "JPEG", exif=tags),
        "8.png": by.png(stored / 255, 8, (b"eXIf", tags[6:])),
        "16.png": by.png(stored / 255, 16, (b"eXIf", tags[6:])),
        "a.webp": by.saved(stored / 255, "WEBP", exif=tags),
        "8.tif": image_files.tiff(stored, orientation=orientation),
        "16.tif": image_files.tiff(stored.astype(np.uint16) * 257, orientation=orientation),
        "32.tif": image_files.tiff(stored.astype(np.float32) / 255, orientation=orientation),
        "grey.tif": image_files.tiff(stored[..., 0], orientation=orientation),
    }
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
        image = ds.read_image(tmp_path / name, srgb=False)
        np.testing.assert_allclose(image, UPRIGHT[..., : image.shape[2]] / 255, atol=0.012)
        stated = statement_of(tmp_path / name)
        assert (stated.orientation, stated.size) == (orientation, stored.shape[:2])
    inside = ds.read_mask(tmp_path / "16.png")
    np.testing.assert_array_equal(inside, UPRIGHT.mean(-1) >= 127.5)


def test_a_lazy_image_that_is_turned_is_refused(tmp_path):
    pytest.importorskip("tifffile")
    (tmp_path / "a.tif").write_bytes(image_files.tiff(UPRIGHT, orientation=3))
    with pytest.raises(ValueError, match=r"a\.tif: it states the orientation 3.* Save it upright, or read it whole"):
        ds.open_image(tmp_path / "a.tif")


def test_heic_states_profile_and_orientation(tmp_path):
    pillow_heif = pytest.importorskip("pillow_heif", reason="HEIC is read with the extra 'heic'.")
    path, blocks = tmp_path / "a.heic", np.kron(TRUTH[::8, ::8], np.ones((16, 16, 1)))
    adobe = np.clip(blocks @ TO_ADOBE.T, 0, 1) ** (1 / by.ADOBE_GAMMA)
    for encoded, options, name in (
        (adobe, {"icc_profile": OF_ADOBE}, "Adobe RGB (1998)"),
        (ds.srgb_encode(blocks), {}, "sRGB"),
        (ds.srgb_encode(blocks), {"exif": by.exif(orientation=6)}, "sRGB"),
    ):
        stored = np.rint(255 * encoded).astype(np.uint8)
        pillow_heif.from_pillow(Image.fromarray(stored)).save(path, quality=100, chroma=444, **options)
        upright = np.swapaxes(blocks[::-1], 0, 1) if "exif" in options else blocks
        np.testing.assert_allclose(ds.read_image(path), upright, atol=0.03)
        stated = statement_of(path)
        assert stated.encoding is not None
        assert stated.encoding.name == name
        assert (stated.orientation, stated.size) == (6 if "exif" in options else 1, blocks.shape[:2])
    data = path.read_bytes().replace(b"\x01\x12\0\x03\0\0\0\x01\0\x06", b"\x01\x12\0\x03\0\0\0\x01\0\x01")
    path.write_bytes(data.replace(b"\x12\x01\x03\0\x01\0\0\0\x06", b"\x12\x01\x03\0\x01\0\0\0\x01"))
    assert statement_of(path).orientation == 6  # what the decoder does, whatever EXIF says
    turn = path.read_bytes().index(b"irot") + 4
    path.write_bytes(path.read_bytes()[:turn] + b"\0" + path.read_bytes()[turn + 1 :])
    assert (statement_of(path).orientation, ds.read_image(path).shape) == (1, blocks.shape)


def test_a_damaged_file_states_nothing_here(tmp_path):
    for suffix in (".png", ".jpg", ".tif", ".webp", ".exr", ".hdr", ".bmp"):
        (tmp_path / f"a{suffix}").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(90))
        assert statement_of(tmp_path / f"a{suffix}") == (None, "", 1, None)
    file = io.BytesIO()
    Image.new("RGB", (4, 4)).save(file, "PNG")
    (tmp_path / "a.png").write_bytes(by.chunk(file.getvalue(), b"iCCP", b"x\0\0" + bytes(9)))
    assert statement_of(tmp_path / "a.png").encoding is None
    ds.read_image(tmp_path / "a.png")
