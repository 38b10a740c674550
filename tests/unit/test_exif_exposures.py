"""Exposures: read from files, and several of one light merged, so that a highlight is not clipped."""

import logging

import numpy as np
import pytest
from PIL import Image

import diffshade as ds
from diffshade.inverse.data.photographs import read_folder
from diffshade.io.exif import stated_exposures

TIMES = (1 / 8, 1 / 64, 1 / 512)


def scene(seed=0):
    """Radiance over four decades, (24, 32, 3)."""
    return 10.0 ** np.random.default_rng(seed).uniform(-2, 2, (24, 32, 3))


def photographs(radiance, *, sigma=0.002, seed=0):
    rng = np.random.default_rng(seed)
    return [np.clip(t * radiance + sigma * rng.normal(size=radiance.shape), 0.0, 1.0) for t in TIMES]


@pytest.mark.thorough
def test_merged_exposures_are_the_radiance_within_their_errors():
    radiance = scene()
    for noise in (0.002, None):
        merged = ds.merge_exposures(photographs(radiance), TIMES, noise=noise)
        off = (merged.image - radiance) / merged.error
        assert 0.9 < np.std(off) < 1.15
        assert abs(np.mean(off)) < 0.1
        assert np.max(np.abs(merged.image / radiance - 1.0)[radiance > 1.0]) < 0.05
        assert merged.saturation is None or merged.saturation == pytest.approx(512)
        assert merged.noise is not None
        stated = np.sqrt(np.asarray(merged.noise.variance(np.asarray(merged.image))))
        assert 0.7 < np.median(stated / merged.error) < 1.4


def test_no_sample_that_is_clipped_or_dark_has_weight():
    radiance = np.array([[0.5, 4.0, 100.0, 900.0, 0.0]])
    images = [np.clip(t * radiance, 0.0, 1.0) for t in TIMES]
    images[1][0, 0] = images[1][0, 4] = 0.0  # the dark end of a file
    merged = ds.merge_exposures(images, TIMES, noise=0.01)
    np.testing.assert_allclose(merged.image[0, :3, 0], radiance[0, :3], rtol=1e-12)
    assert merged.saturation == 512.0
    assert merged.image[0, 3, 0] == 512.0  # clipped in all: as bright as that at least
    assert merged.image[0, 4, 0] == 0.0
    np.testing.assert_array_equal(np.isinf(merged.error[0, :, 0]), [False, False, False, True, False])
    assert merged.error[0, 2, 0] == pytest.approx(0.01 / TIMES[2], rel=0.2)  # clipped in the two longer exposures
    view = ds.View(merged.image, ds.OrthographicCamera((0, 0, 1), shape=(1, 5)), saturation=merged.saturation)
    assert view.saturation == 512.0


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1)])
def test_the_order_and_the_unit_of_exposures_do_not_matter(order):
    images = photographs(scene())
    one = ds.merge_exposures(images, TIMES, noise=0.002)
    other = ds.merge_exposures([images[i] for i in order], [4.0 * TIMES[i] for i in order], noise=0.002)
    np.testing.assert_allclose(4.0 * other.image, one.image, rtol=1e-12)
    np.testing.assert_allclose(4.0 * other.error, one.error, rtol=1e-12)


def test_photographs_that_share_no_level_leave_the_noise_unknown():
    merged = ds.merge_exposures([np.full((2, 2), 1.0), np.full((2, 2), 0.2)], (1.0, 0.01))
    np.testing.assert_allclose(merged.image, 20.0)
    assert merged.noise is None
    assert np.isnan(merged.error).all()


@pytest.mark.parametrize(
    ("images", "exposures", "said"),
    [
        ([np.ones((2, 2))], [1.0], "takes at least 2 images; got 1"),
        ([np.ones((2, 2))] * 2, [1.0], r"for each of the 2 images; got \[1.0\]"),
        ([np.ones((2, 2))] * 2, [1.0, 0.0], "a number above 0"),
        ([np.ones((2, 2)), np.ones((2, 3))], [1.0, 2.0], r"\(2, 3, 1\) of images\[1\]. Crop"),
    ],
)
def test_what_cannot_be_merged_is_refused(images, exposures, said):
    with pytest.raises(ValueError, match=said):
        ds.merge_exposures(images, exposures)


# Files and folders


def save(path, image, *, time=None, number=None, iso=None):
    """Save a photograph of linear values in [0, 1] as an sRGB file that states its exposure."""
    tags = Image.Exif()
    given = {0x829A: time, 0x829D: number, 0x8827: iso}
    tags.get_ifd(0x8769).update({tag: value for tag, value in given.items() if value is not None})
    pixels = np.rint(255.0 * np.asarray(ds.srgb_encode(np.clip(image, 0.0, 1.0)))).astype(np.uint8)
    Image.fromarray(pixels).save(path, exif=tags.tobytes(), quality=98, subsampling=0)


@pytest.mark.parametrize("suffix", [".jpg", ".tif", ".png"])
def test_time_sensitivity_and_aperture_make_the_exposure(tmp_path, suffix):
    settings = [(1 / 60, 4.0, 100), (1 / 15, 8.0, 400), (1 / 60, None, 100), (None, 4.0, 100)]
    files = [tmp_path / f"{i}{suffix}" for i in range(4)]
    for file, (time, number, iso) in zip(files, settings, strict=True):
        save(file, np.zeros((4, 4, 3)), time=time, number=number, iso=iso)
    np.testing.assert_allclose(stated_exposures(files[:2]), [100 / 60 / 16, 400 / 15 / 64], rtol=1e-6)
    np.testing.assert_array_equal(np.isnan(stated_exposures(files)), [False, False, True, True])
    save(files[0], np.zeros((4, 4, 3)), time=1 / 30)
    save(files[1], np.zeros((4, 4, 3)), time=1 / 60)  # a lens without contacts, and no sensitivity
    np.testing.assert_allclose(np.divide(*stated_exposures(files[:2])), 2.0, rtol=1e-6)


@pytest.fixture
def bracketed(tmp_path):
    """A dome of two lights, each photographed with three exposures; a bright spot clips in all but the shortest."""
    radiance = np.stack([np.full((6, 8, 3), 2.0), np.full((6, 8, 3), 4.0)])
    radiance[:, 2, 3] = 200.0
    rows = []
    for light in range(2):
        for k, t in enumerate(TIMES):
            name = f"{light}_{k}.jpg"
            save(tmp_path / name, radiance[light] * t, time=t, iso=200)
            rows.append(f"{name} {0.6 * light:g} 0 {1.0 - 0.2 * light:g}\n")
    (tmp_path / "dome.lp").write_text(f"{len(rows)}\n{''.join(rows)}")
    ds.write_image(tmp_path / "mask.png", np.ones((6, 8)))
    return tmp_path


def test_exposures_of_one_light_become_one_view(bracketed, caplog):
    read = read_folder(bracketed, normals=False, exif=True)
    assert read.names == ("0_0.jpg", "1_0.jpg")
    assert [float(light.direction[0]) for light in read.scene.lights] == pytest.approx([0.0, -0.6])  # pyright: ignore[reportAttributeAccessIssue]
    assert len(read.scene.lights) == len(read.views) == 2
    for view, level in zip(read.views, (2.0, 4.0), strict=True):
        assert float(view.exposure) == 1.0
        np.testing.assert_allclose(view.image[0, 0], level * TIMES[0], rtol=0.03)  # in units of the first exposure
        np.testing.assert_allclose(view.image[2, 3], 200.0 * TIMES[0], rtol=0.05)  # 25 times what clips that


def test_exposures_that_differ_between_lights_are_those_of_the_views(bracketed, caplog):
    (bracketed / "dome.lp").write_text("2\n0_1.jpg 0 0 1\n1_0.jpg 0.6 0 0.8\n")
    _, views = ds.read_photographs(bracketed, normals=False)
    np.testing.assert_allclose([float(view.exposure) for view in views], [1.0, 8.0], rtol=1e-3)
    said = [record.message for record in caplog.records if "EXIF" in record.message]
    assert len(said) == 1
    assert "differ by a factor of up to 8 by the files' EXIF" in said[0]
    assert "--no-exif" in said[0]
    _, views = ds.read_photographs(bracketed, normals=False, exif=False)
    assert [float(view.exposure) for view in views] == [1.0, 1.0]


def test_an_exposure_that_one_file_does_not_state_is_said(bracketed, caplog):
    save(bracketed / "0_1.jpg", np.ones((6, 8, 3)))
    with caplog.at_level(logging.WARNING, "diffshade"):
        _, views = ds.read_photographs(bracketed, normals=False)
    assert "1 of 6 photographs state no exposure (EXIF): all are taken to be equal" in caplog.text
    assert len(views) == 6
    assert {float(view.exposure) for view in views} == {1.0}
