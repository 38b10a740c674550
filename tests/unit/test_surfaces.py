"""Where rays meet a sphere, a plane and a box, and what a G-buffer keeps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refuses

import diffshade as ds
from diffshade.model.cameras import Rays
from diffshade.model.rendering import pixel_rays
from diffshade.model.vectors import Vec3, dot


@jax.jit
def intersect(surface, origin, direction):
    hit = surface.intersect(Rays(Vec3.of(origin), Vec3.of(direction)))
    return hit.distance, hit.p.stack(), hit.n.stack(), hit.inside


SPHERE = ds.Sphere((0, 0, 1), 2)


def assert_meets(surface, origin, direction, distance, n):
    """A ray meets a surface at a distance and with a normal, or not at all where the distance is None."""
    found, p, normal, met = intersect(surface, np.array([origin], float), np.array([direction], float))
    assert met[0] == (distance is not None)
    assert np.isfinite(np.concatenate([found, *p, *normal])).all()
    if not isinstance(surface, ds.Box):
        np.testing.assert_allclose(np.linalg.norm(normal), 1, rtol=1e-14)
    if distance is not None:
        np.testing.assert_allclose(found, [distance], rtol=1e-13)
        np.testing.assert_allclose(p, [np.add(origin, np.multiply(distance, direction))], rtol=1e-13, atol=1e-14)
        np.testing.assert_allclose(normal, [n], rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize(
    ("origin", "distance", "n"),
    [
        ((0, 0, 5), 2, (0, 0, 1)),
        ((0, 0, 3.5), 0.5, (0, 0, 1)),
        ((0, 1.2, 5), 2.4, (0, 0.6, 0.8)),
        ((0, 0, 2), 3, (0, 0, 1)),  # from inside: the far side, and the normal on the viewer's side
        ((0, 0, 1), 2, (0, 0, 1)),
        ((0, 1.2, 1), 1.6, (0, -0.6, 0.8)),
        ((0, 0, 3), 0, (0, 0, 1)),  # from the surface inwards: it enters there
        ((0, 0, -1), None, None),
        ((0, 0, -4), None, None),  # the sphere is behind
        ((0, 3, 5), None, None),
        ((0, 2, 5), None, None),  # touched, not met
    ],
)
def test_a_ray_meets_a_sphere(origin, distance, n):
    assert_meets(SPHERE, origin, (0, 0, -1), distance, n)


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


@pytest.mark.parametrize(
    ("origin", "direction", "distance", "n"),
    [
        ((0, 3, 0), (0, -1, 0), 4, (0, 1, 0)),
        ((5, -3, 2), (0, 1, 0), 2, (0, -1, 0)),  # from below: the normal on the viewer's side
        ((0, 0, 0), (0.6, -0.8, 0), 1.25, (0, 1, 0)),
        ((0, 3, 0), (0, 1, 0), None, None),  # it is behind
        ((0, 3, 0), (1, 0, 0), None, None),  # along it
        ((0, -1, 0), (1, 0, 0), None, None),  # in it
        ((0, 3, 0), (1, -1e-13, 0), None, None),
    ],
)
def test_a_ray_meets_a_plane(origin, direction, distance, n):
    assert_meets(ds.Plane((7, -1, 8), (0, 2, 0)), origin, direction, distance, n)
    assert_meets(ds.Plane((7, -1, 8), (0, -0.1, 0)), origin, direction, distance, n)  # both sides alike


BOX = ds.Box((1, 0, 0), (2, 4, 6))  # x from 0 to 2, y from -2 to 2, z from -3 to 3


@pytest.mark.parametrize(
    ("origin", "direction", "distance", "n"),
    [
        ((0.5, 1, 5), (0, 0, -1), 2, (0, 0, 1)),
        ((0.5, 1, -5), (0, 0, 1), 2, (0, 0, -1)),
        ((5, 1, 1), (-1, 0, 0), 3, (1, 0, 0)),
        ((1, -7, 1), (0, 1, 0), 5, (0, -1, 0)),
        ((-1, 0, 0), (0.8, 0.6, 0), 1.25, (-1, 0, 0)),
        ((0.5, 1, 1), (0, 0, -1), 4, (0, 0, 1)),  # from inside: the far side, and the normal on the viewer's side
        ((0.5, 1, 1), (0.6, 0.8, 0), 1.25, (0, -1, 0)),
        ((0.5, 1, 5), (0, 0, 1), None, None),  # it is behind
        ((2.1, 1, 5), (0, 0, -1), None, None),  # beside it
        ((-1, -2.1, 0), (0.8, -0.6, 0), None, None),
        ((-1, 1.3, 0), (0.8, 0.6, 0), None, None),  # above its corner
    ],
)
def test_a_ray_meets_a_box(origin, direction, distance, n):
    assert_meets(BOX, origin, direction, distance, n)


@jax.jit
def leave(surface, origin, direction):
    hit = surface.leave(Rays(Vec3.of(origin), Vec3.of(direction)))
    return hit.distance, hit.p.stack(), hit.n.stack(), hit.inside


@pytest.mark.parametrize(
    ("surface", "origin", "direction", "distance", "n"),
    [
        (SPHERE, (0, 1.2, 5), (0, 0, -1), 5.6, (0, 0.6, -0.8)),
        (SPHERE, (0, 1.2, 1), (0, 0, -1), 1.6, (0, 0.6, -0.8)),
        (BOX, (0.5, 1, 5), (0, 0, -1), 8, (0, 0, -1)),
        (BOX, (0.5, 1, 1), (0.6, 0.8, 0), 1.25, (0, 1, 0)),
    ],
)
def test_a_ray_leaves_a_solid_where_its_normal_points_outward(surface, origin, direction, distance, n):
    found, p, normal, met = leave(surface, np.array([origin], float), np.array([direction], float))
    assert met[0]
    np.testing.assert_allclose(found, [distance], rtol=1e-14)
    np.testing.assert_allclose(p, [np.add(origin, np.multiply(distance, direction))], atol=1e-14)
    np.testing.assert_allclose(normal, [n], atol=1e-14)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_box_is_turned_about_x_then_y_then_z_right_handed(axis):
    """A quarter about x takes y to z, about y z to x, about z x to y; then the sizes have changed places."""
    rotation, size = [0.0, 0.0, 0.0], [1.0, 2.0, 3.0]
    rotation[axis] = 90.0
    i, j = (axis + 1) % 3, (axis + 2) % 3
    swapped = list(size)
    swapped[i], swapped[j] = size[j], size[i]
    random = np.random.default_rng(6)
    origin, towards = random.normal(size=(2, 200, 3)) * [[[9]], [[0.7]]]
    direction = towards - origin
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    turned = intersect(ds.Box(size=size, rotation=rotation), origin, direction)
    straight = intersect(ds.Box(size=swapped), origin, direction)
    assert 50 < np.asarray(turned[3]).sum() < 200
    for a, b in zip(turned, straight, strict=True):
        np.testing.assert_allclose(np.asarray(a)[turned[3]], np.asarray(b)[turned[3]], atol=1e-12)
    np.testing.assert_array_equal(turned[3], straight[3])


def test_the_order_of_the_turns():
    """x goes up by the y turn and sideways by the z turn; the face across x is seen from there."""
    box = ds.Box(size=(2, 1, 1), rotation=(0, -90, 90))  # x to z, which the turn about z leaves
    assert_meets(box, (0, 0, 5), (0, 0, -1), 4, (0, 0, 1))
    box = ds.Box(size=(2, 1, 1), rotation=(90, 0, 90))  # x to y
    assert_meets(box, (0, 5, 0), (0, -1, 0), 4, (0, 1, 0))
    box = ds.Box(size=(1, 2, 1), rotation=(90, 90, 0))  # y to z to x
    assert_meets(box, (5, 0, 0), (-1, 0, 0), 4, (1, 0, 0))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ds.Sphere(radius=0), ("Sphere.radius", "above 0", "got 0")),
        (lambda: ds.Sphere(radius=-1), ("Sphere.radius", "0; got -1")),
        (lambda: ds.Box(size=(1, 0, 2)), ("Box.size", "above 0", "(1, 0, 2)")),
        (lambda: ds.Box(size=(1, -1, 2)), ("Box.size", "above 0", "(1, -1, 2)")),
        (lambda: ds.Box(size=2), ("Box.size", "3 numbers", "shape ()")),
    ],
)
def test_a_surface_that_is_none(make, words):
    refuses(make, *words)


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


UNIT = ("a unit normal and a finite position", "Normalise it or mask it out")


@pytest.mark.parametrize(
    ("normal", "position", "mask", "words"),
    [
        (NORMAL[..., :2], None, MASK, ("GBuffer.normal", "(H, W, 3)", "(2, 3, 2)", "(2, 3)")),
        (NORMAL, POSITION[:1], None, ("GBuffer.position", "(H, W, 3)", "(1, 3, 3)", "(2, 3)")),
        (NORMAL, POSITION, MASK[..., None, None], ("GBuffer.normal", "(2, 3, 3)", "(2, 3, 1, 1)")),
        (
            NORMAL * np.where(POSITION[..., :1] == 12, 1.01, 1),
            None,
            None,
            (*UNIT, "row 1, column 1", "[0.    0.606 0.808]", "None"),
        ),
        (NORMAL, np.where(POSITION == 4, np.inf, POSITION), MASK, (*UNIT, "row 0, column 1", "[ 3. inf  5.]")),
        (NORMAL * np.nan, POSITION, MASK, (*UNIT, "row 0, column 0", "[nan nan nan]", "[0. 1. 2.]")),
    ],
)
def test_a_gbuffer_that_is_none(normal, position, mask, words):
    refuses(lambda: ds.GBuffer(normal, position, mask), *words)


def test_normals_need_be_unit_to_a_thousandth_only():
    ds.GBuffer(NORMAL * 1.0005)
    with pytest.raises(ValueError, match="needs a unit normal"):
        ds.GBuffer(NORMAL * 1.002)
