"""Arrays of other libraries: what carries more than numbers is used or refused, and never dropped in silence."""

import numpy as np
import pytest

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
    "astropy": (POINT.view(OfAstropy), "some in the unit m. Give the numbers alone"),
    "pint": (OfPint(POINT, "meter"), "some in the unit meter"),
    "a list": ([OfPint(x, "meter") for x in POINT], "some in the unit meter"),
    "masked": (np.ma.masked_array(POINT, [False, False, True]), "a masked array in which 1 of 3 values are masked"),
}


@pytest.mark.parametrize("kind", LOADED)
def test_units_and_masked_values_are_refused_by_the_fields_name(kind):
    value, said = LOADED[kind]
    with pytest.raises(TypeError, match=f"PointLight.position must be plain numbers; got {said}"):
        ds.PointLight(value)  # pyright: ignore[reportArgumentType]
    with pytest.raises(TypeError, match=f"Material.k_d must be plain numbers; got {said}"):
        ds.Material(k_d=value)  # pyright: ignore[reportArgumentType]
    with pytest.raises(TypeError, match=f"errors must be plain numbers; got {said}"):
        float64_of("errors", value)


def test_what_carries_nothing_more_is_taken():
    for value in (np.ma.masked_array(POINT), OfPint(POINT, ""), OfPint(POINT, "dimensionless"), list(POINT)):
        position = ds.PointLight(value).position  # pyright: ignore[reportArgumentType]
        np.testing.assert_array_equal(position, POINT)
        assert type(position) is np.ndarray


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
    with pytest.raises(TypeError, match=r"View.image must be plain numbers; got some in the unit m"):
        ds.View(IMAGE.view(OfAstropy), CAMERA)
    for kind in (np.uint8, np.uint16, int, bool, complex, object, [("r", float)]):
        with pytest.raises(ValueError, match=r"View.image must be linear radiance in floats; got .* ds.srgb_decode"):
            ds.View(np.zeros((4, 5), kind), CAMERA)
    with pytest.raises(ValueError, match=r"images\[1\] must be linear radiance in floats; got uint8"):
        ds.merge_exposures([IMAGE, (IMAGE * 255).astype(np.uint8)], [1, 2])


def test_the_bytes_of_a_file_are_no_map():
    for make in (ds.normal_map, lambda map_: ds.Material(k_d=map_)):
        with pytest.raises(TypeError, match=r"whole numbers of uint8. Read the file with read_image, or divide by 255"):
            make((IMAGE * 255).astype(np.uint8))
    check_no_bytes("three numbers", np.array([1, 2, 3], np.uint8))
