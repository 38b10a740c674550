"""Lazy images: what is read by rows is what is read whole, and a fit of it is the fit of the whole."""

import dataclasses
import os
import re
from typing import Any

import jax
import numpy as np
import pytest
import synthetic

import diffshade as ds
from diffshade.io import lazy_images

COLOURS = np.random.default_rng(3).random((150, 70, 3))


def stored(dtype):
    return (
        COLOURS.astype(dtype) if np.dtype(dtype).kind == "f" else np.rint(COLOURS * np.iinfo(dtype).max).astype(dtype)
    )


class Rows:
    """The least that an array of a user's own must be; it refuses to be read whole."""

    def __init__(self, array):
        self.array, self.shape, self.dtype, self.ndim = array, array.shape, array.dtype, array.ndim

    def __getitem__(self, rows):
        assert isinstance(rows, slice)
        return self.array[rows]


def imported(name):
    return pytest.importorskip(name, reason=f"no package {name}: pip install 'diffshade[zarr]'")


def tiff_options(array):
    return {"photometric": "rgb" if array.ndim == 3 else "minisblack"}


def write_tiled_tiff(path, array):
    imported("zarr")
    imported("tifffile").imwrite(path, array, tile=(32, 32), compression="zlib", **tiff_options(array))


WRITE = {
    "a.npy": np.save,
    "fortran.npy": lambda path, array: np.save(path, np.asfortranarray(array)),
    "a.tif": lambda path, array: imported("tifffile").imwrite(path, array, **tiff_options(array)),
    "tiled.tif": write_tiled_tiff,
    "a.zarr": lambda path, array: imported("zarr").create_array(path, data=array, chunks=(40, 33, *array.shape[2:])),
}


@pytest.mark.parametrize("name", WRITE)
def test_rows_of_a_file_are_those_of_the_whole(tmp_path, name):
    for dtype in (np.uint8, np.uint16, np.float32):
        path, whole = tmp_path / f"{np.dtype(dtype)}{name}", tmp_path / "whole.npy"
        WRITE[name](path, stored(dtype))
        np.save(whole, stored(dtype))
        for srgb in (False, True):
            image, expected = ds.open_image(path, srgb=srgb), ds.read_image(whole, srgb=srgb)
            assert image.shape == expected.shape
            assert np.issubdtype(image.dtype, np.floating)
            for rows in (slice(0, 150), slice(37, 83), slice(39, 41), slice(149, None), slice(5, 5), slice(9, 3)):
                np.testing.assert_array_equal(image[rows], expected[rows])
                assert image[rows].dtype == image.dtype
    WRITE[name](tmp_path / f"grey{name}", stored(np.uint16)[..., 0])
    image = ds.open_image(tmp_path / f"grey{name}")
    assert image.shape == (150, 70, 1)
    np.testing.assert_array_equal(image[60:70], stored(np.uint16)[60:70, :, :1] / 65535)


def test_tiles_and_pixels_are_read_few_rows_at_once(monkeypatch):
    monkeypatch.setattr(lazy_images, "TILE", 70 * 40 + 5)
    read = []

    def rows(first, last):
        read.append((first, last))
        return COLOURS[first:last]

    image = lazy_images.LazyImage(rows, COLOURS.shape, COLOURS.dtype)
    assert [(first, len(tile)) for first, tile in image.tiles()] == [(0, 40), (40, 40), (80, 40), (120, 30)]
    np.testing.assert_array_equal(image.colours()[3:9], COLOURS[3:9, :, :2])
    read.clear()
    pixels = np.array([70 * 149 + 3, 5, 70 * 39 + 69, 70 * 40, 7, 70 * 149 + 3])
    np.testing.assert_array_equal(image.at(pixels), COLOURS.reshape(-1, 3)[pixels])
    assert read == [(0, 40), (40, 41), (149, 150)]


@pytest.mark.parametrize(
    ("name", "content", "kind", "message"),
    [
        ("no.npy", None, FileNotFoundError, "there is no such file"),
        ("x.png", b"", ValueError, r"the suffix '.png' is not read by rows. Write it as .npy"),
        ("x.npy", b"\x93NUMPY", OSError, "it is no NPY, or is empty, truncated or damaged"),
        ("x.npy", np.zeros((3, 4, 5, 6)), ValueError, r"shape \(3, 4, 5, 6\)"),
        ("x.npy", np.zeros((3, 4, 5)), ValueError, r"shape \(3, 4, 5\)"),
        ("x.npy", np.zeros((3, 0)), ValueError, r"shape \(3, 0\)"),
        ("x.npy", np.zeros((3, 4), np.int64), ValueError, "numbers of type int64. Use uint8, uint16 or floats"),
    ],
)
def test_what_is_no_lazy_image_is_one_sentence(tmp_path, name, content, kind, message):
    if isinstance(content, bytes):
        (tmp_path / name).write_bytes(content)
    elif content is not None:
        np.save(tmp_path / name, content)
    with pytest.raises(kind, match=message):
        ds.open_image(tmp_path / name)


def test_rows_that_were_lost_since_the_image_was_opened_are_said_to_be(tmp_path):
    np.save(tmp_path / "a.npy", COLOURS)
    image = ds.open_image(tmp_path / "a.npy")
    os.truncate(tmp_path / "a.npy", COLOURS.nbytes // 2)
    np.testing.assert_array_equal(image[0:3], COLOURS[:3])
    with pytest.raises(OSError, match=r"cannot read .*a\.npy: .* Make it again"):
        image[140:150]


def test_pieces_that_are_too_large_to_be_read_at_once_and_other_pictures_are_refused(tmp_path, monkeypatch):
    WRITE["a.zarr"](tmp_path / "a.zarr", stored(np.uint8))
    monkeypatch.setattr(lazy_images, "BAND", 40 * 70 * 3)
    assert ds.open_image(tmp_path / "a.zarr").shape == (150, 70, 3)
    monkeypatch.setattr(lazy_images, "BAND", 40 * 70 * 3 - 1)
    with pytest.raises(ValueError, match=r"in pieces of 40 rows, 8400 bytes.*Save it in pieces of fewer rows"):
        ds.open_image(tmp_path / "a.zarr")
    imported("tifffile").imwrite(tmp_path / "two.tif", np.zeros((2, 30, 40), np.uint8), photometric="minisblack")
    with pytest.raises(ValueError, match=r"is a TIFF with axes .* Save one picture"):
        ds.open_image(tmp_path / "two.tif")


def test_a_view_takes_an_array_that_is_read_by_rows_alone():
    camera = ds.Camera(eye=(0, 0, 4), shape=(150, 70))
    view = ds.View(Rows(COLOURS[..., 0]), camera)
    assert view.image.shape == (150, 70, 1)
    assert view.image[3:9].shape == (6, 70, 1)
    with pytest.raises(TypeError, match=r"got the index 3. Write image\[r0:r1\]"):
        view.image[3]
    with pytest.raises(ValueError, match="must be linear radiance in floats; got uint8"):
        ds.View(Rows(stored(np.uint8)), camera)
    with pytest.raises(ValueError, match=re.escape("shape (150, 70); got (70, 150)")):
        ds.View(Rows(COLOURS.transpose(1, 0, 2)), camera)
    wrong = Rows(COLOURS)
    wrong.array = COLOURS[:, :-1]
    with pytest.raises(ValueError, match=r"rows 0 to 4 of a lazy image must be floats of shape \(4, 70, 3\)"):
        ds.View(wrong, camera).image[:4]


@pytest.mark.thorough
@pytest.mark.parametrize("how", ["alpha", pytest.param("clipped", marks=pytest.mark.slow)])
def test_a_fit_of_lazy_views_is_that_of_arrays_and_one_given_twice_counts_once(how):
    scene = synthetic.standard_scene()
    images = synthetic.noisy(synthetic.photographs(scene), 0.005, 0)
    if how == "alpha":
        inside = np.indices(images[0].shape[:2]).sum(0) % 3 > 0
        images = [np.concatenate([image, inside[..., None]], -1) for image in images]
    options: dict[str, Any] = {"saturation": 0.5} if how == "clipped" else {}
    images = [np.minimum(image, options.get("saturation", np.inf)) for image in images]
    views = [synthetic.one_light_each(of, **options) for of in (images, [Rows(image) for image in images])]
    again = ds.View(Rows(images[2].copy()), synthetic.CAMERA, lit=(2,), **options)
    fits = [ds.fit(scene, of, free=synthetic.FREE, tied=synthetic.TIED) for of in (views[0], [*views[1], again])]
    np.testing.assert_array_equal(fits[0].values, fits[1].values)
    np.testing.assert_array_equal(fits[0].plain_errors, fits[1].plain_errors)
    assert dataclasses.replace(fits[1].counts, repeats=()) == fits[0].counts
    assert fits[1].counts.repeats == ((8, 2),)
    said = "views[8] repeats views[2] and is not counted again."
    assert set(fits[1].notes) == {*fits[0].notes, said}
    with jax.enable_x64(True):
        predictions = [fit.predict(of[2]) for fit, of in zip(fits, views, strict=True)]
    np.testing.assert_array_equal(predictions[0].difference, predictions[1].difference)
