"""G-buffers of normal maps and height maps."""

import gc
import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refuses

import diffshade as ds
from diffshade.model import gbuffers

DIRECTIONS = np.array([[(0, 0, 1), (0.6, 0, 0.8), (0, -0.8, 0.6)], [(1, 0, 0), (-0.6, 0, 0.8), (0, 0.6, 0.8)]])


def test_a_normal_map_is_decoded():
    buffer = ds.normal_map((DIRECTIONS + 1) / 2)
    np.testing.assert_allclose(buffer.normal, DIRECTIONS, atol=1e-15)
    assert buffer.position is None
    assert np.asarray(buffer.mask).all()


def test_a_normal_map_of_8_bits_is_made_unit():
    image = np.round((DIRECTIONS + 1) / 2 * 255) / 255
    buffer = ds.normal_map(image)
    np.testing.assert_allclose(np.linalg.norm(buffer.normal, axis=-1), 1, rtol=1e-14)
    np.testing.assert_allclose(buffer.normal, DIRECTIONS, atol=2 / 255)


def test_where_a_normal_map_is_black_there_is_nothing():
    image = (DIRECTIONS + 1) / 2
    image[0, 1] = 0
    np.testing.assert_array_equal(ds.normal_map(image).mask, [[True, False, True], [True, True, True]])
    mask = np.array([[1, 0, 0], [0, 1, 1]])
    buffer = ds.normal_map(image, mask=mask)
    np.testing.assert_array_equal(buffer.mask, mask == 1)
    np.testing.assert_array_equal(np.asarray(buffer.normal)[mask == 0], 0)


def test_a_normal_map_lights_as_its_normals_do():
    camera = ds.OrthographicCamera((0, 0, 4), shape=(2, 3), local_viewer=False)
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_d=0.5)), ds.DirectionalLight((0, 0, -1)))
    image = ds.shade(scene, ds.normal_map((DIRECTIONS + 1) / 2), camera)
    np.testing.assert_allclose(np.asarray(image)[..., 0], 0.5 * DIRECTIONS[..., 2], atol=1e-15)


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.zeros((4, 5)), ("(H, W, 3)", "(4, 5)")),
        (np.zeros((4, 5, 4)), ("(H, W, 3)", "(4, 5, 4)")),
        (np.full((4, 5, 3), 0.5), ("row 0, column 0", "length is 0", "sRGB", "mask")),
        (np.where(np.arange(20).reshape(4, 5, 1) == 13, 1.0, (0.5, 0.5, 1)), ("row 2, column 3", "length is 1.73")),
    ],
)
def test_a_normal_map_that_is_none(image, words):
    plain = inspect.unwrap(ds.normal_map)  # past a type checker, which refuses a shape itself
    refuses(lambda: plain(image), "a normal map must", *words)


CAMERA = ds.OrthographicCamera((0, 0, 5), height=3, shape=(30, 20))


def grid(camera=CAMERA):
    """x to the right and y up at the centre of each pixel."""
    pixel = float(camera.height) / camera.shape[0]
    row, column = np.indices(camera.shape) + 0.5
    return (column - camera.shape[1] / 2) * pixel, (camera.shape[0] / 2 - row) * pixel


def test_a_plane_as_a_height_map_has_one_normal():
    x, y = grid()
    buffer = ds.height_map(0.3 * x - 0.5 * y + 0.1, CAMERA)
    n = np.array([-0.3, 0.5, 1]) / np.linalg.norm([0.3, 0.5, 1])
    np.testing.assert_allclose(buffer.normal, np.broadcast_to(n, (30, 20, 3)), atol=1e-13)
    assert buffer.position is not None
    np.testing.assert_allclose(buffer.position, np.stack([x, y, 0.3 * x - 0.5 * y + 0.1], -1), atol=1e-14)


def test_a_wave_as_a_height_map():
    """Central differences are right to the second order of a pixel."""
    errors = []
    for pixels in (40, 80):
        camera = ds.OrthographicCamera((0, 0, 5), height=3, shape=(pixels, pixels))
        x, y = grid(camera)
        buffer = ds.height_map(0.2 * np.sin(2 * x) * np.cos(y), camera)
        n = np.stack([-0.4 * np.cos(2 * x) * np.cos(y), 0.2 * np.sin(2 * x) * np.sin(y), np.ones_like(x)], -1)
        n /= np.linalg.norm(n, axis=-1, keepdims=True)
        errors.append(np.abs(buffer.normal - n)[1:-1, 1:-1].max())
    assert errors[0] < 2e-3
    assert errors[1] < 0.3 * errors[0]


def test_a_height_map_lies_before_the_target_of_its_camera():
    """Seen from the side, heights go along x; the points are those that the camera's rays meet."""
    camera = ds.OrthographicCamera((4, 1, 0), target=(0, 1, 0), height=3, shape=(30, 20))
    x, y = grid(camera)
    height = 0.3 + 0.1 * y
    buffer = ds.height_map(height, camera)
    assert buffer.position is not None
    np.testing.assert_allclose(buffer.position, np.stack([height, 1 + y, -x], -1), atol=1e-14)
    plane = ds.Plane((0.3, 1, 0), (1, -0.1, 0))
    seen = ds.intersect(ds.Scene(ds.Object(plane)), camera)
    assert seen.position is not None
    assert buffer.position is not None
    np.testing.assert_allclose(buffer.position, seen.position, atol=1e-13)
    np.testing.assert_allclose(buffer.normal, seen.normal, atol=1e-13)


def test_beside_masked_pixels_a_slope_is_one_sided():
    x, y = grid()
    mask = (np.abs(x) > 0.2) & (np.abs(y) > 0.3)
    height = np.where(mask, 0.3 * x - 0.5 * y, 1e6)  # what is masked out is not looked at
    buffer = ds.height_map(height, CAMERA, mask=mask)
    n = np.array([-0.3, 0.5, 1]) / np.linalg.norm([0.3, 0.5, 1])
    np.testing.assert_allclose(np.asarray(buffer.normal)[mask], np.broadcast_to(n, (mask.sum(), 3)), atol=1e-13)
    np.testing.assert_array_equal(buffer.mask, mask)


def test_a_height_map_of_another_shape():
    refuses(lambda: ds.height_map(np.zeros((20, 30)), CAMERA), "a height map", "(30, 20)", "(20, 30)")


# --- kept as they are


def test_float32_of_jax_stays_on_its_device_and_the_rest_is_a_copy_that_cannot_change():
    normal, mask = np.zeros((2, 3, 3)), np.ones((2, 3), bool)
    normal[..., 2] = 1.0
    there = ds.GBuffer(jnp.asarray(normal, np.float32), None, mask)
    assert isinstance(there.normal, jax.Array)
    for given in (normal, jnp.asarray(normal)):  # float64 of JAX would not survive where x64 is off
        here = ds.GBuffer(given, None, mask)
        assert isinstance(here.normal, np.ndarray)
        assert here.normal.dtype == np.float64
        with pytest.raises(ValueError, match="read-only"):
            here.normal[0, 0, 0] = 7.0
    mask[0, 0] = False
    assert np.asarray(here.mask).all()


def test_what_was_looked_at_is_not_looked_at_again_but_what_takes_its_place_is():
    camera = ds.OrthographicCamera((0, 0, 4), shape=(2, 3), local_viewer=False)
    normal = np.tile([0.0, 0.0, 1.0], (2, 3, 1))
    good = ds.GBuffer(normal, None, np.ones((2, 3), bool))
    scene = ds.Scene(ds.Object(good), ds.DirectionalLight((0, 0, -1)))
    known = len(gbuffers._sound)
    image = np.asarray(ds.render(scene, camera))
    assert len(gbuffers._sound) == known
    bad = eqx.tree_at(lambda s: s.objects[0].surface.normal, scene, 2.0 * normal)
    with pytest.raises(ValueError, match="unit normal"):
        ds.render(bad, camera)
    changing = normal.copy()
    written = eqx.tree_at(lambda s: s.objects[0].surface.normal, scene, changing)
    np.testing.assert_array_equal(ds.render(written, camera), image)
    changing[:] = 3.0  # an array that somebody else may write to is looked at each time
    with pytest.raises(ValueError, match="unit normal"):
        ds.render(written, camera)
    del good, scene, bad, written
    gc.collect()
    assert len(gbuffers._sound) < known
