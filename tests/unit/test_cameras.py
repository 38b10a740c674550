"""From a pixel to its ray, and from a point to its viewer."""

import dataclasses

import jax
import numpy as np
import pytest
from refusals import refuses

import diffshade as ds
from diffshade.model.rendering import pixel_rays
from diffshade.model.vectors import Vec3


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
    origin, direction = rays(cls((5, 0, 0), up=(3, 0, -1), shape=(3, 3)))
    far = np.asarray(origin + 5 * direction)  # what of `up` lies along the line of sight is left out
    assert far[0, 1, 2] < -0.1
    assert far[1, 2, 1] < -0.1


@pytest.mark.parametrize("cls", [ds.Camera, ds.OrthographicCamera])
def test_the_viewer(cls):
    points = np.array([[(0, 0, 0), (3.0, 0, 0)]])
    camera = cls((0, 0, 4), target=(0, 3, 4), up=(0, 0, 1), shape=(1, 2))
    np.testing.assert_allclose(viewer(camera, points), [[(0, 0, 1), (-0.6, 0, 0.8)]], atol=1e-15)
    camera = dataclasses.replace(camera, local_viewer=False)
    np.testing.assert_allclose(viewer(camera, points), np.broadcast_to([0, -1, 0], (1, 2, 3)), atol=1e-15)


@pytest.mark.parametrize("shape", [(8, 10), [8, 10], np.zeros((8, 10, 3)).shape[:2]])
def test_a_shape_is_two_whole_numbers(shape):
    camera = ds.Camera((0, 0, 4), shape=shape)
    assert camera.shape == (8, 10)
    assert [type(s) for s in camera.shape] == [int, int]


@pytest.mark.parametrize("shape", [(8, 0), (-8, 10), (8,), (8, 10, 3)])
@pytest.mark.parametrize("cls", [ds.Camera, ds.OrthographicCamera])
def test_a_shape_that_is_none(cls, shape):
    refuses(lambda: cls((0, 0, 4), shape=shape), f"{cls.__name__}.shape", "(height, width)", repr(shape), "shape[:2]")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ds.Camera((0, 0, 4), fov=180), ("Camera.fov", "below 180", "got 180")),
        (lambda: ds.Camera((0, 0, 4), fov=0), ("Camera.fov", "above 0", "got 0")),
        (lambda: ds.OrthographicCamera((0, 0, 4), height=0), ("OrthographicCamera.height", "above 0", "got 0")),
        (lambda: ds.Camera((1, 2, 3), target=(1, 2, 3)), ("Camera.eye", "differ from target", "[1. 2. 3.]")),
        (lambda: ds.Camera((0, 4, 0)), ("Camera.up", "along the line of sight", "[0. 1. 0.]", "(0, 0, -1)")),
        (
            lambda: ds.OrthographicCamera((1, 2, 3), up=(-2, -4, -6)),
            ("OrthographicCamera.up", "along the line of sight", "[-2. -4. -6.]"),
        ),
        (lambda: ds.Camera((1, 2, 3), up=(0, 0, 0)), ("Camera.up", "[0. 0. 0.]")),
        (lambda: ds.Camera((0, 0, 4), principal_point=(1, 2, 3)), ("Camera.principal_point", "pair", "(3,)")),
        (lambda: ds.Camera((0, 0, 4), aspect=0), ("Camera.aspect", "above 0", "got 0")),
    ],
)
def test_a_camera_that_sees_nothing(make, words):
    refuses(make, *words)


K = np.array([[310.5, 0, 161.3], [0, 298.2, 117.9], [0, 0, 1]])


def test_a_calibration_matrix_puts_points_where_it_says():
    """Beside a projection by hand, from a pose of its own."""
    eye, target = np.array([1.0, 2, 3]), np.array([0.5, 1.5, -4])
    camera = ds.Camera.from_intrinsics(K, shape=(240, 320), eye=eye, target=target)
    with jax.enable_x64(True):
        origin, direction = (np.asarray(part) for part in rays(camera))
    backward = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross((0, 1, 0), backward)
    right /= np.linalg.norm(right)
    up = np.cross(backward, right)
    p = origin + 7.0 * direction - eye
    X, Y, Z = p @ right, p @ up, -(p @ backward)
    row, column = np.indices((240, 320)) + 0.5
    np.testing.assert_allclose(K[0, 2] + K[0, 0] * X / Z, column, atol=1e-9)
    np.testing.assert_allclose(K[1, 2] - K[1, 1] * Y / Z, row, atol=1e-9)


def test_a_calibration_matrix_of_a_plain_camera_is_that_camera():
    plain = ds.Camera((0, 0, 4), target=(0, 0, 0), fov=40, shape=(24, 32))
    f = 12 / np.tan(np.deg2rad(20))
    same = ds.Camera.from_intrinsics(
        [[f, 0, 16], [0, f, 12], [0, 0, 1]], shape=(24, 32), eye=(0, 0, 4), target=(0, 0, 0)
    )
    np.testing.assert_allclose(same.fov, 40)
    for a, b in zip(rays(plain), rays(same), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)


def test_derivatives_by_a_calibration_matrix():
    small, weight = (
        np.array([[60.0, 0, 16.4], [0, 61.0, 11.8], [0, 0, 1]]),
        np.random.default_rng(1).normal(size=(9, 9, 3)),
    )

    @jax.jit
    def total(K):
        return (weight * rays(ds.Camera.from_intrinsics(K, shape=(9, 9)))[1]).sum()

    gradient = np.asarray(jax.jit(jax.grad(total))(small))
    for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)):
        step = np.zeros((3, 3))
        step[i, j] = 1e-3
        difference = (total(small + step) - total(small - step)) / 2e-3
        assert abs(difference) > 1e-4
        np.testing.assert_allclose(gradient[i, j], difference, rtol=1e-6)


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        (np.eye(2), ("3 x 3", "(2, 2)", "f_x")),
        ([[1, 0.5, 0], [0, 1, 0], [0, 0, 1]], ("skew", "0.5")),
        ([[1, 0, 0], [0, 1, 0], [0, 0, 2]], ("skew", "(0, 0, 2)")),
        ([[-1, 0, 0], [0, 1, 0], [0, 0, 1]], ("focal lengths above 0", "f_x -1")),
        ([[1, 0, 0], [0, 0, 0], [0, 0, 1]], ("focal lengths above 0", "f_y 0")),
    ],
)
def test_what_is_no_calibration_matrix(matrix, words):
    refuses(lambda: ds.Camera.from_intrinsics(matrix, shape=(24, 32)), "K must", *words)


def test_the_shape_beside_a_calibration_matrix():
    refuses(lambda: ds.Camera.from_intrinsics(K, shape=(0, 5)), "Camera.shape", "(0, 5)")
