"""Lazy images: what is read by rows is what is read whole, and a fit of it is the fit of the whole."""

import re
from typing import Any

import jax
import numpy as np
import pytest
import synthetic

import diffshade as ds

COLOURS = np.random.default_rng(3).random((150, 70, 3))


def stored(dtype):
    return (
        COLOURS.astype(dtype) if np.dtype(dtype).kind == "f" else np.rint(COLOURS * np.iinfo(dtype).max).astype(dtype)
    )


class Rows:
    """The least that an array of a user's own must be; it refuses to be read whole."""

    def __init__(self, array):
        self.array, self.shape, self.dtype, self.ndim = array, array.shape, array.dtype, array.ndim
        self.most = 0

    def __getitem__(self, rows):
        assert isinstance(rows, slice)
        found = self.array[rows]
        self.most = max(self.most, len(found))
        return found


def write_npy(path, array):
    np.save(path, array)


def write_fortran(path, array):
    np.save(path, np.asfortranarray(array))


def write_tiff(path, array):
    tifffile = pytest.importorskip("tifffile", reason="no package tifffile: pip install 'diffshade[zarr]'")
    tifffile.imwrite(path, array, photometric="rgb" if array.ndim == 3 else "minisblack")


def write_tiled_tiff(path, array):
    tifffile = pytest.importorskip("tifffile", reason="no package tifffile: pip install 'diffshade[zarr]'")
    pytest.importorskip("zarr", reason="no package zarr: pip install 'diffshade[zarr]'")
    photometric = "rgb" if array.ndim == 3 else "minisblack"
    tifffile.imwrite(path, array, photometric=photometric, tile=(32, 32), compression="zlib")


def write_zarr(path, array):
    zarr = pytest.importorskip("zarr", reason="no package zarr: pip install 'diffshade[zarr]'")
    zarr.create_array(path, data=array, chunks=(40, 33, *array.shape[2:]))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize(
    ("write", "suffix"),
    [
        (write_npy, ".npy"),
        (write_fortran, ".npy"),
        (write_tiff, ".tif"),
        (write_tiled_tiff, ".tif"),
        (write_zarr, ".zarr"),
    ],
    ids=["npy", "fortran npy", "tiff", "tiled tiff", "zarr"],
)
def test_rows_of_a_file_are_those_of_the_whole(tmp_path, write, suffix, dtype):
    path = tmp_path / f"image{suffix}"
    write(path, stored(dtype))
    for srgb in (False, True):
        image = ds.open_image(path, srgb=srgb)
        np.save(tmp_path / "whole.npy", stored(dtype))
        whole = ds.read_image(tmp_path / "whole.npy", srgb=srgb)
        assert image.shape == whole.shape
        assert np.issubdtype(image.dtype, np.floating)
        for rows in (slice(0, 150), slice(37, 83), slice(39, 41), slice(149, None), slice(5, 5)):
            np.testing.assert_array_equal(image[rows], whole[rows])
            assert image[rows].dtype == image.dtype


def test_grey_files_have_one_channel(tmp_path):
    for write, suffix in ((write_npy, ".npy"), (write_tiled_tiff, ".tif"), (write_zarr, ".zarr")):
        write(tmp_path / f"grey{suffix}", stored(np.uint16)[..., 0])
        image = ds.open_image(tmp_path / f"grey{suffix}")
        assert image.shape == (150, 70, 1)
        np.testing.assert_array_equal(image[60:70], stored(np.uint16)[60:70, :, :1] / 65535)


@pytest.mark.parametrize(
    ("name", "write", "kind", "message"),
    [
        ("no.npy", None, FileNotFoundError, "there is no such file"),
        ("x.png", b"", ValueError, r"the suffix '.png' is not read by rows. Write it as .npy"),
        ("x.npy", b"\x93NUMPY", OSError, "empty, truncated, damaged or no image"),
        ("x.npy", np.zeros((3, 4, 5, 6)), ValueError, r"shape \(3, 4, 5, 6\)"),
        ("x.npy", np.zeros((3, 4), np.int64), ValueError, "numbers of type int64. Use uint8, uint16 or floats"),
    ],
)
def test_what_is_no_lazy_image_is_one_sentence(tmp_path, name, write, kind, message):
    if isinstance(write, bytes):
        (tmp_path / name).write_bytes(write)
    elif write is not None:
        np.save(tmp_path / name, write)
    with pytest.raises(kind, match=message):
        ds.open_image(tmp_path / name)


def test_a_view_takes_an_array_that_is_read_by_rows_alone():
    camera = ds.Camera(eye=(0, 0, 4), shape=(150, 70))
    view = ds.View(Rows(COLOURS[..., 0]), camera)
    assert view.image.shape == (150, 70, 1)
    assert view.image[3:9].shape == (6, 70, 1)
    with pytest.raises(TypeError, match=r"read by rows; got the index 3. Write image\[r0:r1\]"):
        view.image[3]
    with pytest.raises(ValueError, match="must be linear radiance in floats; got uint8"):
        ds.View(Rows(stored(np.uint8)), camera)
    with pytest.raises(ValueError, match=re.escape("must have the camera's shape (150, 70); got (70, 150)")):
        ds.View(Rows(COLOURS.transpose(1, 0, 2)), camera)
    wrong = Rows(COLOURS)
    wrong.array = COLOURS[:, :-1]
    with pytest.raises(ValueError, match=r"rows 0 to 4 of a lazy image must be floats of shape \(4, 70, 3\)"):
        ds.View(wrong, camera).image[:4]


@pytest.mark.parametrize("how", ["alpha", "clipped"])
def test_a_fit_of_lazy_views_is_that_of_arrays(how):
    scene = synthetic.standard_scene()
    images = synthetic.noisy(synthetic.photographs(scene), 0.005, 0)
    if how == "alpha":
        inside = np.indices(images[0].shape[:2]).sum(0) % 3 > 0
        images = [np.concatenate([image, inside[..., None]], -1) for image in images]
    if how == "clipped":
        images = [np.minimum(image, 0.5) for image in images]
    options: dict[str, Any] = {"saturation": 0.5} if how == "clipped" else {}
    views = [synthetic.one_light_each(of, **options) for of in (images, [Rows(image) for image in images])]
    fits = [ds.fit(scene, of, free=synthetic.FREE, tied=synthetic.TIED) for of in views]
    np.testing.assert_array_equal(fits[0].values, fits[1].values)
    np.testing.assert_array_equal(fits[0].plain_errors, fits[1].plain_errors)
    assert fits[0].notes == fits[1].notes
    with jax.enable_x64(True):
        predictions = [fit.predict(of[2]) for fit, of in zip(fits, views, strict=True)]
    np.testing.assert_array_equal(predictions[0].difference, predictions[1].difference)


def test_a_lazy_view_given_twice_is_counted_once():
    scene = synthetic.standard_scene()
    images = synthetic.photographs(scene)
    views = synthetic.one_light_each([Rows(image) for image in images])
    again = ds.View(Rows(images[2].copy()), synthetic.CAMERA, lit=(2,))
    fit = ds.fit(scene, [*views, again], free=("k_d", "k_s", "n_s"))
    assert fit.counts.views == 8
    assert "views[8] is views[2] again, the same numbers, and is counted once." in fit.notes
