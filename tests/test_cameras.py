"""From a pixel to its ray, and from a point to its viewer."""

import dataclasses
from re import escape

import jax
import numpy as np
import pytest

import diffshade as ds
from diffshade.rendering import pixel_rays
from diffshade.vectors import Vec3


@jax.jit
def rays(camera):
    found = pixel_rays(camera.projection(), camera.shape)
    return found.origin.stack(), found.direction.stack()


@jax.jit
def viewer(camera, p):
    return camera.projection().viewer(Vec3.of(p)).stack()


def test_perspective():
    """90 degrees from top to bottom and twice as wide: the corners of the picture lie at (+-2, +-1, -1)."""
    origin, direction = rays(ds.Camera((0, 0, 4), fov=90, shape=(2, 4)))
    np.testing.assert_array_equal(origin, np.broadcast_to([0, 0, 4], (2, 4, 3)))
    x, y = np.meshgrid([-1.5, -0.5, 0.5, 1.5], [0.5, -0.5])  # row 0 on top
    expected = np.stack([x, y, -np.ones_like(x)], -1)
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    np.testing.assert_allclose(direction, expected, rtol=1e-14, atol=1e-15)


def test_orthographic():
    """3 units from top to bottom in 2 pixels: pixels of 1.5 units."""
    origin, direction = rays(ds.OrthographicCamera((1, 2, 4), target=(1, 2, 0), height=3, shape=(2, 4)))
    np.testing.assert_allclose(direction, np.broadcast_to([0, 0, -1], (2, 4, 3)), atol=1e-15)
    x, y = np.meshgrid([-2.25, -0.75, 0.75, 2.25], [0.75, -0.75])
    np.testing.assert_allclose(origin, np.stack([1 + x, 2 + y, 4 + 0 * x], -1), rtol=1e-14)


@pytest.mark.parametrize("cls", [ds.Camera, ds.OrthographicCamera])
def test_a_camera_is_right_handed_and_upright(cls):
    """From +x towards the origin: -z is on the right, +y on top."""
    camera = cls((5, 0, 0), up=(0, 2, 0), shape=(3, 3))
    origin, direction = rays(camera)
    far = np.asarray(origin + 5 * direction)
    np.testing.assert_allclose(far[1, 1], 0, atol=1e-14)
    assert far[1, 2, 2] < -0.1
    assert far[0, 1, 1] > 0.1
    np.testing.assert_allclose(far[1, :, 1], 0, atol=1e-14)
    turned, _ = rays(
        cls((5, 0, 0), up=(3, 0, -1), shape=(3, 3))
    )  # what of `up` lies along the line of sight is left out
    np.testing.assert_allclose(turned.shape, origin.shape)
    _, direction = rays(cls((5, 0, 0), up=(3, 0, -1), shape=(3, 3)))
    far = np.asarray(turned + 5 * direction)
    assert far[0, 1, 2] < -0.1
    assert far[1, 2, 1] < -0.1


@pytest.mark.parametrize("cls", [ds.Camera, ds.OrthographicCamera])
def test_the_viewer(cls):
    points = np.array([[(0, 0, 0), (3.0, 0, 0)]])
    camera = cls((0, 0, 4), target=(0, 3, 4), up=(0, 0, 1), shape=(1, 2))
    np.testing.assert_allclose(viewer(camera, points), [[(0, 0, 1), (-0.6, 0, 0.8)]], atol=1e-15)
    camera = dataclasses.replace(camera, local_viewer=False)
    np.testing.assert_allclose(viewer(camera, points), np.broadcast_to([0, -1, 0], (1, 2, 3)), atol=1e-15)


def test_defaults():
    camera = ds.Camera((0, 0, 4))
    np.testing.assert_array_equal(camera.target, [0, 0, 0])
    np.testing.assert_array_equal(camera.up, [0, 1, 0])
    assert camera.shape == (256, 256)
    assert camera.local_viewer is True
    assert ds.OrthographicCamera((0, 0, 4)).local_viewer is True


@pytest.mark.parametrize("shape", [(8, 10), [8, 10], np.zeros((8, 10, 3)).shape[:2]])
def test_a_shape_is_two_whole_numbers(shape):
    camera = ds.Camera((0, 0, 4), shape=shape)
    assert camera.shape == (8, 10)
    assert [type(s) for s in camera.shape] == [int, int]


@pytest.mark.parametrize("shape", [(8, 0), (-8, 10), (8,), (8, 10, 3)])
@pytest.mark.parametrize("cls", [ds.Camera, ds.OrthographicCamera])
def test_a_shape_that_is_none(cls, shape):
    message = (
        f"{cls.__name__}.shape must be (height, width) in pixels, two whole numbers above 0; got {shape!r}. "
        "Give the image's shape[:2]."
    )
    with pytest.raises(ValueError, match=f"^{escape(message)}$"):
        cls((0, 0, 4), shape=shape)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: ds.Camera((0, 0, 4), fov=180),
            "Camera.fov must be above 0 and below 180 degrees; got 180.0. Give the full angle.",
        ),
        (
            lambda: ds.Camera((0, 0, 4), fov=0),
            "Camera.fov must be above 0 and below 180 degrees; got 0.0. Give the full angle.",
        ),
        (
            lambda: ds.OrthographicCamera((0, 0, 4), height=0),
            "OrthographicCamera.height must be above 0; got 0.0. Give it in scene units.",
        ),
        (
            lambda: ds.Camera((1, 2, 3), target=(1, 2, 3)),
            "Camera.eye must differ from target; got [1. 2. 3.] for both. Move one of them.",
        ),
        (
            lambda: ds.Camera((0, 4, 0)),
            "Camera.up must not be along the line of sight; got up [0. 1. 0.] for an eye at [0. 4. 0.] that looks at "
            "[0. 0. 0.]. Give another up, for example (0, 0, -1).",
        ),
        (
            lambda: ds.OrthographicCamera((1, 2, 3), up=(-2, -4, -6)),
            "OrthographicCamera.up must not be along the line of sight; got up [-2. -4. -6.] for an eye at "
            "[1. 2. 3.] that looks at [0. 0. 0.]. Give another up, for example (0, 0, -1).",
        ),
        (
            lambda: ds.Camera((1, 2, 3), up=(0, 0, 0)),
            "Camera.up must not be along the line of sight; got up [0. 0. 0.] for an eye at [1. 2. 3.] that looks at "
            "[0. 0. 0.]. Give another up, for example (0, 0, -1).",
        ),
    ],
)
def test_a_camera_that_sees_nothing(make, message):
    with pytest.raises(ValueError, match=f"^{escape(message)}$"):
        make()
