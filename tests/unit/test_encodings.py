"""Encodings: ICC profiles beside LittleCMS and their formulas, primaries beside published ones."""

import io
import struct

import colour_profiles as by
import numpy as np
import pytest
from PIL import Image, ImageCms

from diffshade.io.encodings import ADOBE, LINEAR, PRIMARIES, SRGB, encoding, power, srgb_encode, xyz_of
from diffshade.io.icc_profiles import encoding_of_profile, profile_name

COLOURS = np.random.default_rng(0).integers(0, 256, (40, 30, 3), np.uint8)
X = np.linspace(0.0, 1.0, 301)


def decoded(profile: bytes) -> np.ndarray:
    found = encoding_of_profile(profile)
    assert found is not None
    return found.decode(np.stack([X, X, X], -1)[None])[0, :, 1]


def test_primaries_are_the_published_ones():
    np.testing.assert_allclose(xyz_of(PRIMARIES["the primaries of sRGB"]), by.SRGB_XYZ, atol=3e-4)
    np.testing.assert_allclose(xyz_of(PRIMARIES["Adobe RGB"]), by.ADOBE_XYZ, atol=3e-4)


@pytest.mark.parametrize("xyz", [by.SRGB_XYZ, by.ADOBE_XYZ])
@pytest.mark.parametrize(
    "curve",
    [
        by.gamma(1.8),
        by.gamma(by.ADOBE_GAMMA),
        by.table(X**2.4),
        by.parametric(0, 2.2),
        by.parametric(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045),
    ],
)
def test_a_profile_is_what_littlecms_makes_of_it(xyz, curve):
    profile = by.profile("a", curve, xyz)
    to = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB"))
    expected = ImageCms.profileToProfile(Image.fromarray(COLOURS), ImageCms.ImageCmsProfile(io.BytesIO(profile)), to)
    assert expected is not None
    found = encoding_of_profile(profile)
    assert found is not None
    levels = 255 * srgb_encode(found.decode(COLOURS / 255).clip(0, 1))
    assert np.abs(levels - np.asarray(expected)).max() < 1.5  # it computes in 8 bits


def test_curves_are_those_of_their_formulas():
    g, a, b, c, d, e, f = 2.0, 0.9, 0.1, 0.25, 0.25, 0.02, 0.01
    power_of = (a * X + b) ** g
    for kind, numbers, expected in (
        (1, (g, a, -b), np.where(b / a <= X, (a * X - b).clip(0) ** g, 0)),
        (2, (g, a, -b, c), np.where(b / a <= X, (a * X - b).clip(0) ** g + c, c)),
        (3, (g, a, b, c, d), np.where(d <= X, power_of, c * X)),
        (4, (g, a, b, c, d, e, f), np.where(d <= X, power_of + e, c * X + f)),
    ):
        np.testing.assert_allclose(decoded(by.profile("a", by.parametric(kind, *numbers))), expected, atol=1e-4)
    np.testing.assert_allclose(decoded(by.profile("Dot Gain 20%", by.table(X**1.75), None)), X**1.75, atol=1e-4)


def test_profiles_of_srgb_and_linear_are_known_as_such_and_decoded_exactly():
    lcms = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    rounded = by.profile("sRGB", by.table(np.rint(255 * SRGB.curves[0](np.linspace(0, 1, 1024))) / 255))
    for profile, known in ((lcms, SRGB), (rounded, SRGB), (by.profile("a", by.gamma(1.0)), LINEAR)):
        assert encoding_of_profile(profile) is known
    assert encoding_of_profile(by.profile("a", b"curv" + bytes(8))) is LINEAR
    assert encoding_of_profile(by.profile("a", by.gamma(2.2))) not in (SRGB, LINEAR)
    assert profile_name(lcms) == "sRGB built-in"
    assert profile_name(by.profile("Mine\n", by.gamma(1.0))) == "Mine"


def test_white_and_grey_stay_exactly_white_and_grey():
    grey = np.repeat(X[:, None], 3, 1)[None]
    found = encoding("x", LINEAR.curves, by.ADOBE_XYZ).decode(grey)
    np.testing.assert_array_equal(found, grey)
    np.testing.assert_allclose(ADOBE.decode(np.array([[[1.0, 0.0, 0.0]]]))[0, 0], [1.398, 0, 0], atol=2e-3)


def test_a_profile_that_is_more_than_curves_is_not_used_and_a_damaged_one_is_an_error():
    assert encoding_of_profile(by.profile("a", by.gamma(1.0), kind=b"CMYKLab ")) is None
    assert encoding_of_profile(by.profile("a", by.gamma(1.0), kind=b"RGB Lab ")) is None
    good = by.profile("a", by.gamma(2.2))
    for bad in (b"", good[:200], good.replace(b"curv", b"xxxx"), by.profile("a", by.gamma(2.2), np.zeros((3, 3)))):
        with pytest.raises((ValueError, KeyError, struct.error, np.linalg.LinAlgError)), np.errstate(all="ignore"):
            encoding_of_profile(bad)


def test_a_curve_beyond_1_continues_or_ends():
    assert power(2.0)(np.array(1.5)) == 2.25
