"""Snell's law, and the way of a ray through a solid (E12), at values that can be worked out by hand."""

import jax
import numpy as np
import pytest

import diffshade as ds
from diffshade.model.cameras import Rays
from diffshade.model.transmission import bend
from diffshade.model.vectors import Vec3, refract


@jax.jit
def refracted(v, n, ratio):
    T, exists = refract(Vec3.of(v), Vec3.of(n), ratio)
    return T.stack(), exists


@jax.jit
def through(solid, origin, direction, eta):
    """The ray inside a solid, how long it is, the ray that comes out, and whether there is one."""
    rays = Rays(Vec3.of(origin), Vec3.of(direction))
    way, exists = bend(solid, rays, solid.intersect(rays), eta)
    inner, outer = way.inner, way.outer
    ends = (inner.origin, inner.direction, outer.origin, outer.direction)
    return [a.stack() for a in ends], way.length, exists


def at(degrees):
    """A unit vector in the x-z plane, so many degrees off z, towards x."""
    return np.array([np.sin(np.deg2rad(degrees)), 0.0, np.cos(np.deg2rad(degrees))])


UP = at(0.0)


@pytest.mark.parametrize(
    ("degrees", "ratio", "expected"),
    [
        (30.0, 1 / 1.61, 18.09292),
        (0.0, 1 / 1.61, 0.0),
        (60.0, 1.0, 60.0),
        (18.09292, 1.61, 30.0),
        (45.0, 1 / np.sqrt(2), 30.0),
        (89.999, 1 / 1.5, 41.8103),
    ],
)
def test_snell(degrees, ratio, expected):
    T, exists = refracted(at(degrees), UP, np.array(ratio))
    assert exists
    np.testing.assert_allclose(np.linalg.norm(T), 1, rtol=1e-14)
    np.testing.assert_allclose(np.rad2deg(np.arctan2(-T[0], -T[2])), expected, atol=1e-4)


def test_the_refracted_ray_lies_in_the_plane_of_v_and_n_and_obeys_snell():
    random = np.random.default_rng(3)
    v, n = (a / np.linalg.norm(a, axis=-1, keepdims=True) for a in random.normal(size=(2, 1000, 3)))
    n = np.where(np.sum(n * v, -1, keepdims=True) > 0, n, -n)
    ratio = random.uniform(0.4, 2.5, 1000)
    T, exists = (np.asarray(a) for a in refracted(v, n, ratio))
    sine = np.linalg.norm(np.cross(n, v), axis=-1)
    np.testing.assert_array_equal(exists, ratio * sine < 1)
    assert 100 < exists.sum() < 900
    np.testing.assert_allclose(np.cross(n, T)[exists], -(ratio[:, None] * np.cross(n, v))[exists], atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(T, axis=-1)[exists], 1, rtol=1e-13)
    assert (np.sum(T * n, -1)[exists] < 0).all()
    assert np.isfinite(T).all()  # where there is none, too


@pytest.mark.parametrize(("degrees", "exists"), [(41.80, True), (41.82, False), (60.0, False), (89.9, False)])
def test_total_internal_reflection_begins_at_the_critical_angle(degrees, exists):
    """41.81 degrees from an index of 1.5 into air."""
    assert refracted(at(degrees), UP, np.array(1.5))[1] == exists


@pytest.mark.parametrize("eta", [0.7, 1.0, 1.33, 1.61])
@pytest.mark.parametrize("degrees", [0.0, 10.0, 30.0, 40.0])
def test_a_slab_shifts_a_ray_by_t_sin_of_i_minus_r_over_cos_r(eta, degrees):
    t, i = 0.7, np.deg2rad(degrees)
    slab = ds.Box((0, 0, -t / 2), (1e3, 1e3, t))
    (_, _, p, d), length, exists = through(slab, 8 * at(degrees)[None], -at(degrees)[None], np.array(eta))
    assert exists[0]
    r = np.arcsin(np.sin(i) / eta)
    np.testing.assert_allclose(d, -at(degrees)[None], atol=1e-13)  # parallel
    shift = (p[0] - np.zeros(3)) @ np.array([np.cos(i), 0, -np.sin(i)])  # across the ray, which went for the origin
    np.testing.assert_allclose(shift, t * np.sin(i - r) / np.cos(r), atol=1e-13)
    np.testing.assert_allclose(length, [t / np.cos(r)], rtol=1e-13)


def test_a_ray_through_the_centre_of_a_sphere_is_not_bent():
    d = np.array([[0.6, 0.0, -0.8]])
    ends, length, exists = through(ds.Sphere(radius=1.5), -4 * d, d, np.array(1.7))
    assert exists[0]
    np.testing.assert_allclose(ends, [-1.5 * d, d, 1.5 * d, d], atol=1e-14)
    np.testing.assert_allclose(length, [3], rtol=1e-14)


@pytest.mark.parametrize("eta", [1.2, 1.5, 2.0])
def test_a_sphere_turns_a_ray_by_twice_i_minus_r(eta):
    i = np.deg2rad(35.0)
    origin, d = np.array([[np.sin(i), 0.0, 3.0]]), np.array([[0.0, 0.0, -1.0]])
    (_, _, _, out), _, _ = through(ds.Sphere(), origin, d, np.array(eta))
    turn = np.arctan2(-out[0, 0], -out[0, 2])
    np.testing.assert_allclose(turn, 2 * (i - np.arcsin(np.sin(i) / eta)), rtol=1e-13)


@pytest.mark.thorough
def test_there_is_no_way_through_where_light_is_totally_reflected():
    """Into a bubble at sin i > eta; and out of the side of a glass box, for which eta^2 > 2 is enough."""
    down = np.array([[0.0, 0.0, -1.0]] * 2)
    _, _, exists = through(ds.Sphere(), np.array([[0.69, 0.0, 3], [0.71, 0, 3]]), down, np.array(0.7))
    np.testing.assert_array_equal(exists, [True, False])
    slanted = np.array([[0.8, 0.0, -0.6]] * 2)
    start = np.array([[-0.5, 0.0, 1.0], [0.9, 0, 1]]) - 2 * slanted  # through the bottom, and through the side
    _, _, exists = through(ds.Box(size=(2, 2, 2)), start, slanted, np.array(1.5))
    np.testing.assert_array_equal(exists, [True, False])
    _, _, exists = through(ds.Box(size=(2, 2, 2)), start, slanted, np.array(1.1))
    np.testing.assert_array_equal(exists, [True, True])


def test_a_ray_from_inside_only_leaves():
    origin, d = np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.0]]), np.array([[0.0, 0.0, -1.0]] * 2)
    (_, _, p, out), length, exists = through(ds.Sphere(), origin, d, np.array(1.5))
    np.testing.assert_allclose(length, [1, 0.8], rtol=1e-15)
    np.testing.assert_allclose(p, [(0, 0, -1), (0.6, 0, -0.8)], atol=1e-15)
    np.testing.assert_array_equal(exists, [True, True])
    np.testing.assert_allclose(out[0], (0, 0, -1), atol=1e-15)
    # from glass into air away from the normal: 36.9 degrees become 64.2
    np.testing.assert_allclose(np.cross(np.array([0.6, 0, -0.8]), out[1])[1], 1.5 * 0.6, rtol=1e-13)
