"""Masks as people have them: one rule for arrays of every type, that of `read_mask` for files."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image, ImageFilter

import diffshade as ds
from diffshade.core.masks import as_mask

INSIDE = np.zeros((6, 8), bool)
INSIDE[2:5, 1:6] = True
SOFT = np.where(INSIDE, 200, 100).astype(np.uint8)  # grey outside, as a soft edge or a JPEG leaves it
ALL = np.full((6, 8, 1), 255, np.uint8)

KINDS = {
    "booleans": INSIDE,
    "0 and 1 in 8 bits": INSIDE.astype(np.uint8),
    "0 and 1": INSIDE.astype(np.int64),
    "8 bits": SOFT,
    "16 bits": SOFT.astype(np.uint16) * 257,
    "32 bits": SOFT.astype(np.uint32) << 24,
    "fractions": SOFT / 255,
    "overshoot of resampling": np.where(INSIDE, 1.1, -0.1),
    "halves": (SOFT / 255).astype(np.float16),
    "of another byte order": (SOFT / 255).astype(">f4"),
    "a channel": SOFT[..., None],
    "colours": np.stack([SOFT, np.minimum(SOFT, 190), SOFT], -1),
    "alpha": np.concatenate([ALL, SOFT[..., None]], -1),
    "opaque": np.concatenate([SOFT[..., None], SOFT[..., None], SOFT[..., None], ALL], -1),
    "Pillow's": Image.fromarray(SOFT),
    "Pillow's of one bit": Image.fromarray(INSIDE),
    "JAX's": jnp.asarray(SOFT),
    "a list": INSIDE.tolist(),
    "no value masked": np.ma.masked_array(SOFT),
    "read backward": np.ascontiguousarray(SOFT[::-1])[::-1],
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_mask_is_read_by_its_type(kind):
    view = ds.View(np.zeros((6, 8)), ds.OrthographicCamera((0, 0, 4), shape=(6, 8)), KINDS[kind])
    assert view.mask is not None
    assert view.mask.dtype == bool
    np.testing.assert_array_equal(view.mask, INSIDE)
    surface = ds.GBuffer(np.broadcast_to((0.0, 0.0, 1.0), (6, 8, 3)), mask=KINDS[kind])
    np.testing.assert_array_equal(surface.mask, INSIDE)


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif"])
def test_an_array_is_what_its_file_is(tmp_path, suffix):
    picture = Image.fromarray((INSIDE * 255).astype(np.uint8)).resize((64, 48)).filter(ImageFilter.GaussianBlur(2))
    picture.save(tmp_path / f"mask.{suffix}")
    stored = np.asarray(Image.open(tmp_path / f"mask.{suffix}"))
    read = ds.read_mask(tmp_path / f"mask.{suffix}")
    for array in (stored, stored / 255):
        np.testing.assert_array_equal(as_mask(array), read)


@pytest.mark.parametrize("suffix", ["png", "tif", "npy"])
def test_a_file_of_0_and_1_is_a_mask_and_one_of_labels_is_refused(tmp_path, suffix):
    path, labels = (tmp_path / f"{name}.{suffix}" for name in ("mask", "labels"))
    for file, stored in ((path, INSIDE.astype(np.uint8)), (labels, INSIDE.astype(np.uint8) * 2)):
        np.save(file, stored) if suffix == "npy" else Image.fromarray(stored).save(file)
    np.testing.assert_array_equal(ds.read_mask(path), INSIDE)
    with pytest.raises(ValueError, match=rf"^mask .*labels\.{suffix} of uint8 must be 0 and 1, or"):
        ds.read_mask(labels)


def test_a_mask_mapped_from_disk(tmp_path):
    np.save(tmp_path / "mask.npy", SOFT)
    np.testing.assert_array_equal(as_mask(np.load(tmp_path / "mask.npy", mmap_mode="r")), INSIDE)


WRONG = {
    "labels": (SOFT // 100, "mask of uint8 must be 0 and 1, or reach half of the range of uint8, 128; got 1 to 2"),
    "bytes as integers": (SOFT.astype(int), "mask of int64 must be 0 and 1; got 100 to 200. Give booleans"),
    "bytes as floats": (SOFT * 1.0, "mask of float64 must be between 0 and 1; got 200. Divide it by its full range"),
    "not a number": (np.where(INSIDE, np.nan, 0), "mask must be finite; got nan at row 2, column 1"),
    "a palette": (Image.fromarray(SOFT).convert("P"), "mode 'P'"),
    "masked values": (np.ma.masked_array(INSIDE, ~INSIDE), "a masked array in which 33 of 48 values are masked"),
    "a file": ("mask.png", r"got the path 'mask.png'. Read it with ds.read_mask\(path\)"),
    "complex numbers": (INSIDE * 1j, "array of real numbers; got ndarray of complex128"),
    "objects": (INSIDE.astype(object), "array of real numbers; got ndarray of object"),
    "rows of different lengths": ([[1], [0, 1]], "rows of different lengths"),
}


@pytest.mark.parametrize("kind", WRONG)
def test_what_is_no_mask_is_refused_in_a_sentence(kind):
    mask, said = WRONG[kind]
    with pytest.raises((TypeError, ValueError), match=said):
        as_mask(mask)


def test_a_traced_mask_is_booleans_or_floats():
    for mask in (INSIDE, INSIDE * 1.0, KINDS["alpha"] / 255.0):
        np.testing.assert_array_equal(jax.jit(as_mask)(mask), INSIDE)
    with pytest.raises(TypeError, match=r"booleans or floats in jax.grad, jit or vmap; got int"):
        jax.jit(as_mask)(INSIDE.astype(int))


def test_a_mask_that_was_put_into_a_view_is_looked_at():
    view = ds.View(np.zeros((6, 8)), ds.OrthographicCamera((0, 0, 4), shape=(6, 8)), INSIDE)
    object.__setattr__(view, "mask", SOFT)
    with pytest.raises(TypeError, match=r"View.mask must be boolean; got uint8"):
        view.__check_init__()


def test_every_function_that_takes_a_mask_takes_it_by_this_rule():
    """An object known by its normals alone, before a grey wall: nothing but its mask says where it is."""
    camera = ds.OrthographicCamera((0, 0, 4), height=2.6, shape=(24, 24), local_viewer=False)
    ball = ds.intersect(ds.Scene(ds.Object(ds.Sphere(), ds.Material())), camera)
    normal = np.where(np.asarray(ball.mask)[..., None], ball.normal, (0.0, 0.0, 1.0))
    soft = np.where(ball.mask, 200, 100).astype(np.uint8)
    np.testing.assert_array_equal(ds.normal_map((normal + 1) / 2, mask=soft).mask, ball.mask)
    np.testing.assert_array_equal(ds.height_map(np.zeros((24, 24)), camera, mask=soft).mask, ball.mask)
    soft_height, height = (ds.heights.integrate_normals(normal, camera, mask=mask).height for mask in (soft, ball.mask))
    np.testing.assert_array_equal(soft_height, height)
