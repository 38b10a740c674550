"""Where rays meet a sphere, and what a G-buffer keeps."""

from re import escape

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffshade as ds
from diffshade.cameras import Rays
from diffshade.rendering import pixel_rays
from diffshade.vectors import Vec3, dot


@jax.jit
def intersect(surface, origin, direction):
    hit = surface.intersect(Rays(Vec3.of(origin), Vec3.of(direction)))
    return hit.distance, hit.p.stack(), hit.n.stack(), hit.inside


SPHERE = ds.Sphere((0, 0, 1), 2)
AHEAD = np.array([0.0, 0, -1])


@pytest.mark.parametrize(
    ("origin", "distance", "n", "inside"),
    [
        ((0, 0, 5), 2, (0, 0, 1), True),
        ((0, 0, 3.5), 0.5, (0, 0, 1), True),
        ((0, 1.2, 5), 2.4, (0, 0.6, 0.8), True),
        ((0, 0, 2), 3, (0, 0, 1), True),  # from inside: the far side, and the normal on the viewer's side
        ((0, 0, 1), 2, (0, 0, 1), True),
        ((0, 1.2, 1), 1.6, (0, -0.6, 0.8), True),
        ((0, 0, 3), 4, (0, 0, 1), True),  # from the surface: t = 0 is not in front
        ((0, 0, -1), None, None, False),
        ((0, 0, -4), None, None, False),  # the sphere is behind
        ((0, 3, 5), None, None, False),
        ((0, 2, 5), None, None, False),  # touched, not met
    ],
)
def test_a_ray_meets_a_sphere(origin, distance, n, inside):
    found, p, normal, met = intersect(SPHERE, np.array([origin], float), AHEAD[None])
    assert met[0] == inside
    assert np.isfinite(found).all()
    assert np.isfinite(p).all()
    np.testing.assert_allclose(np.linalg.norm(normal), 1, rtol=1e-14)
    if inside:
        np.testing.assert_allclose(found, [distance], rtol=1e-14)
        np.testing.assert_allclose(p, [np.add(origin, distance * AHEAD)], rtol=1e-14, atol=1e-15)
        np.testing.assert_allclose(normal, [n], rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize(
    "camera",
    [
        ds.Camera((1, 2, 4), fov=50, shape=(24, 25)),
        ds.OrthographicCamera((1, 2, 4), height=4, shape=(24, 25), local_viewer=False),
    ],
    ids=lambda camera: type(camera).__name__,
)
def test_a_ray_that_misses_gets_the_nearest_point_of_the_sphere(camera):
    """A fit of the geometry relies on it: beyond the silhouette p and n go on without a jump, n outward."""
    sphere = ds.Sphere((0.1, 0.2, -0.3), 1.2)

    @jax.jit
    def find(sphere, camera):
        rays = pixel_rays(camera.projection(), camera.shape)
        hit = sphere.intersect(rays)
        center = Vec3.of(sphere.center)
        nearest = rays.origin + rays.direction * dot(center - rays.origin, rays.direction)
        return hit.p.stack(), hit.n.stack(), nearest.stack(), hit.inside

    p, n, nearest, inside = (np.asarray(a) for a in find(sphere, camera))
    out = (nearest - sphere.center)[~inside]
    assert len(out) > 100
    out /= np.linalg.norm(out, axis=-1, keepdims=True)
    np.testing.assert_allclose(p[~inside], sphere.center + 1.2 * out, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(n[~inside], out, rtol=1e-12, atol=1e-12)


def test_a_sphere_without_a_radius():
    message = "Sphere.radius must be above 0; got 0.0. Give the radius in scene units."
    with pytest.raises(ValueError, match=f"^{escape(message)}$"):
        ds.Sphere(radius=0)
    with pytest.raises(ValueError, match=r"^Sphere\.radius must be (above|at least) 0; got -1\."):
        ds.Sphere(radius=-1)


NORMAL = np.full((2, 3, 3), (0, 0.6, 0.8))
POSITION = np.arange(18.0).reshape(2, 3, 3)
MASK = np.array([[True, True, False], [False, True, False]])


def test_a_gbuffer_keeps_what_its_mask_shows():
    normal, position = NORMAL.copy(), POSITION.copy()
    normal[~MASK] = position[~MASK] = np.nan
    gbuffer = ds.GBuffer(normal, position, MASK)
    assert gbuffer.position is not None
    np.testing.assert_array_equal(gbuffer.mask, MASK)
    np.testing.assert_array_equal(gbuffer.normal, np.where(MASK[..., None], NORMAL, 0))
    np.testing.assert_array_equal(gbuffer.position, np.where(MASK[..., None], POSITION, 0))
    assert gbuffer.normal.dtype == gbuffer.position.dtype == np.float64


@pytest.mark.parametrize("mask", [MASK, MASK.astype(np.uint8), MASK.astype(float), 0.5 * MASK, MASK.tolist()])
def test_a_mask_may_be_numbers(mask):
    np.testing.assert_array_equal(ds.GBuffer(NORMAL, POSITION, np.asarray(mask)).mask, MASK)


def test_without_a_mask_it_is_where_the_normal_is_not_zero():
    gbuffer = ds.GBuffer(NORMAL * MASK[..., None])
    np.testing.assert_array_equal(gbuffer.mask, MASK)
    assert gbuffer.position is None


def test_a_gbuffer_of_lists_and_of_jax_arrays():
    np.testing.assert_array_equal(ds.GBuffer(np.array(NORMAL.tolist())).normal, NORMAL)
    np.testing.assert_array_equal(ds.GBuffer(jnp.asarray(NORMAL), jnp.asarray(POSITION)).normal, NORMAL)


def test_a_gbuffer_meets_the_rays_of_its_camera():
    gbuffer = ds.GBuffer(NORMAL, POSITION, MASK)
    origin = np.broadcast_to([0.0, 0, 20], (2, 3, 3))
    distance, p, n, inside = intersect(gbuffer, origin, np.broadcast_to([0.0, 0, -1], (2, 3, 3)))
    np.testing.assert_array_equal(p, gbuffer.position)
    np.testing.assert_array_equal(n, gbuffer.normal)
    np.testing.assert_array_equal(inside, MASK)
    np.testing.assert_allclose(np.asarray(distance)[MASK], (20 - POSITION[..., 2])[MASK])


def test_a_gbuffer_can_be_made_inside_jit():
    @jax.jit
    def make(normal, position, mask):
        gbuffer = ds.GBuffer(normal, position, mask)
        return gbuffer.normal, gbuffer.position, gbuffer.mask

    normal, position, mask = make(NORMAL, POSITION, MASK)
    np.testing.assert_array_equal(mask, MASK)
    np.testing.assert_array_equal(normal, NORMAL * MASK[..., None])
    np.testing.assert_array_equal(position, POSITION * MASK[..., None])


@pytest.mark.parametrize(
    ("normal", "position", "mask", "message"),
    [
        (
            NORMAL[..., :2],
            None,
            MASK,
            "GBuffer.normal must have shape (H, W, 3), with the mask's H and W; got (2, 3, 2) with a mask of shape "
            "(2, 3). Give one vector a pixel.",
        ),
        (
            NORMAL,
            POSITION[:1],
            None,
            "GBuffer.position must have shape (H, W, 3), with the mask's H and W; got (1, 3, 3) with a mask of shape "
            "(2, 3). Give one vector a pixel.",
        ),
        (
            NORMAL,
            POSITION,
            MASK[..., None],
            "GBuffer.normal must have shape (H, W, 3), with the mask's H and W; got (2, 3, 3) with a mask of shape "
            "(2, 3, 1). Give one vector a pixel.",
        ),
        (
            NORMAL * np.where(POSITION[..., :1] == 12, 1.01, 1),
            None,
            None,
            "GBuffer needs a unit normal and a finite position at every pixel of its mask; at row 1, column 1 the "
            "normal is [0.    0.606 0.808] and the position None. Normalise it or mask it out.",
        ),
        (
            NORMAL,
            np.where(POSITION == 4, np.inf, POSITION),
            MASK,
            "GBuffer needs a unit normal and a finite position at every pixel of its mask; at row 0, column 1 the "
            "normal is [0.  0.6 0.8] and the position [ 3. inf  5.]. Normalise it or mask it out.",
        ),
        (
            NORMAL * np.nan,
            POSITION,
            MASK,
            "GBuffer needs a unit normal and a finite position at every pixel of its mask; at row 0, column 0 the "
            "normal is [nan nan nan] and the position [0. 1. 2.]. Normalise it or mask it out.",
        ),
    ],
)
def test_a_gbuffer_that_is_none(normal, position, mask, message):
    with pytest.raises(ValueError, match=f"^{escape(message)}$"):
        ds.GBuffer(normal, position, mask)


def test_normals_need_be_unit_to_a_thousandth_only():
    ds.GBuffer(NORMAL * 1.0005)
    with pytest.raises(ValueError, match="needs a unit normal"):
        ds.GBuffer(NORMAL * 1.002)
