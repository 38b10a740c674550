"""Arrays of other libraries: what carries more than numbers is used or refused, and never dropped in silence."""

from typing import Any

import numpy as np
import pytest
from PIL import Image
from refusals import untyped

import diffshade as ds
from diffshade.core.arrays import check_no_bytes, float64_of


class OfAstropy(np.ndarray):
    """Numbers with a unit, as astropy has them: a NumPy array of its own class."""

    unit = "m"


class OfPint:
    """Numbers with a unit, as pint has them: no array, but it can become one."""

    def __init__(self, magnitude, units):
        self.magnitude, self.units = magnitude, units

    def __array__(self, dtype=None, copy=None):
        raise AssertionError("pint warns that the unit is stripped")


POINT = np.array([1.0, 2.0, 3.0])
LOADED = {
    "astropy": (POINT.view(OfAstropy), "numbers in the unit m. Give the numbers alone"),
    "pint": (OfPint(POINT, "meter"), "numbers in the unit meter"),
    "a list": ([OfPint(x, "meter") for x in POINT], "numbers in the unit meter"),
    "masked": (np.ma.masked_array(POINT, [False, False, True]), "a masked array in which 1 of 3 values are masked"),
}


@untyped
@pytest.mark.parametrize("kind", LOADED)
def test_units_and_masked_values_are_refused_by_the_fields_name(kind):
    value, said = LOADED[kind]
    with pytest.raises(TypeError, match=f"PointLight.position must be plain numbers; got {said}"):
        ds.PointLight(value)  # pyright: ignore[reportArgumentType]
    with pytest.raises(TypeError, match=f"Material.k_d must be plain numbers; got {said}"):
        ds.Material(k_d=value)  # pyright: ignore[reportArgumentType]
    with pytest.raises(TypeError, match=f"errors must be plain numbers; got {said}"):
        float64_of("errors", value)


@untyped
def test_what_carries_nothing_more_is_taken():
    for value in (np.ma.masked_array(POINT), OfPint(POINT, ""), OfPint(POINT, "dimensionless"), list(POINT)):
        position = ds.PointLight(value).position  # pyright: ignore[reportArgumentType]
        np.testing.assert_array_equal(position, POINT)
        assert type(position) is np.ndarray


PICTURE: Any = Image.fromarray(np.zeros((4, 5, 3), np.uint8))
CAMERA = ds.OrthographicCamera((0, 0, 4), shape=(4, 5))
IMAGE = np.linspace(0, 1, 60).reshape(4, 5, 3)
HIDDEN = np.zeros(IMAGE.shape, bool)
HIDDEN[1, 2] = True


class OfPyTorch:
    """Numbers in memory whose type is not NumPy's."""

    shape, dtype = IMAGE.shape, "torch.float32"

    def __dlpack__(self):
        raise AssertionError("not needed")

    def __getitem__(self, rows):
        raise AssertionError("it is no image that is read by rows")

    def __array__(self, dtype=None, copy=None):
        return IMAGE


def test_an_image_is_taken_whatever_its_layout():
    for image in (
        OfPyTorch(),
        np.ma.masked_array(IMAGE),
        IMAGE.astype(">f8"),
        IMAGE.astype(np.longdouble),
        np.asfortranarray(IMAGE),
        np.ascontiguousarray(IMAGE[::-1])[::-1],
    ):
        taken = ds.View(image, CAMERA).image
        assert type(taken) is np.ndarray
        assert taken.dtype.itemsize == 8
        np.testing.assert_array_equal(taken, IMAGE)


def test_an_image_that_is_more_or_other_than_linear_floats_is_refused():
    with pytest.raises(TypeError, match=r"View.image must be plain numbers; got a masked array in which 3 of 60"):
        ds.View(np.ma.masked_array(IMAGE, HIDDEN), CAMERA)
    with pytest.raises(TypeError, match=r"View.image must be plain numbers; got numbers in the unit m"):
        ds.View(IMAGE.view(OfAstropy), CAMERA)
    for kind in (np.uint8, np.uint16, int, bool, complex, object, [("r", float)]):
        with pytest.raises(ValueError, match=r"View.image must be linear radiance in floats; got .* ds.srgb_decode"):
            ds.View(np.zeros((4, 5), kind), CAMERA)
    with pytest.raises(ValueError, match=r"images\[1\] must be linear radiance in floats; got uint8"):
        ds.merge_exposures([IMAGE, (IMAGE * 255).astype(np.uint8)], [1, 2])


@untyped
def test_the_bytes_of_a_file_are_no_map():
    stored = (IMAGE * 255).astype(np.uint8)
    for name, make in (
        ("a normal map", lambda: ds.normal_map(stored)),
        ("Material.k_d", lambda: ds.Material(k_d=stored)),
        ("Material.k_d", lambda: ds.Material(k_d=stored[2, 3])),
        ("Material.k_s", lambda: ds.Material(k_s=list(stored[2, 3]))),
        ("Material.k_d", lambda: ds.Material(k_d=PICTURE)),
        ("Material.n_s", lambda: ds.Material(n_s=stored)),
        ("PointLight.intensity", lambda: ds.PointLight((0, 0, 4), intensity=stored[2, 3])),
    ):
        with pytest.raises(TypeError, match=rf"^{name} must .* whole numbers of uint8. Read .*, or divide by 255"):
            make()
    assert ds.Material(n_s=np.uint8(40)).n_s == 40
    check_no_bytes("three numbers", np.array([1, 2, 3], np.uint8))


def test_functions_of_arrays_refuse_what_they_would_drop(tmp_path):
    masked = np.ma.masked_array(IMAGE, HIDDEN)
    points, faces = np.ma.masked_array(np.eye(3), np.eye(3, dtype=bool)), np.array([[0, 1, 2]])
    for call in (
        lambda: ds.Mesh(points, faces),
        lambda: ds.Mesh(np.eye(3), np.ma.masked_array(faces, faces == 0)),
        lambda: ds.Mesh(np.eye(3), faces, normals=points),
        lambda: ds.write_image(tmp_path / "a.png", masked),
        lambda: ds.srgb_encode(masked),
        lambda: ds.srgb_decode(masked),
    ):
        with pytest.raises(TypeError, match=r"must be plain numbers; got a masked array in which"):
            call()
    with pytest.raises(TypeError, match=r"^View.image must be an array of numbers; got rows of different lengths"):
        ds.View([[1.0, 2.0], [3.0]], CAMERA)
    assert not list(tmp_path.iterdir())
