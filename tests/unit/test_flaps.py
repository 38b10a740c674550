"""Flaps: what reaches a point between planes across the axes of the world, and how a fit finds them."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refuses

import diffshade as ds
from diffshade.model.flaps import LIMITS
from diffshade.model.vectors import Vec3


def passing(flaps, points):
    """The factor at each of several points."""
    return np.asarray(jax.jit(lambda flaps, p: flaps(Vec3.of(p)))(flaps, np.asarray(points, np.float64)))


def test_without_limits_all_light_passes():
    np.testing.assert_array_equal(passing(ds.Flaps(), np.eye(3) * 1e6), 1)


@pytest.mark.parametrize("axis", range(3))
def test_a_hard_limit_lets_pass_what_is_on_its_side_and_on_itself(axis):
    points = np.full((5, 3), 7.0)
    points[:, axis] = (-1.001, -1, 0, 2, 2.001)
    flaps = ds.Flaps(**{f"{'xyz'[axis]}_min": -1, f"{'xyz'[axis]}_max": 2})
    np.testing.assert_array_equal(passing(flaps, points), [0, 1, 1, 1, 0])


def test_a_soft_limit_is_the_smooth_step_within_it():
    x = np.array([-0.1, 0, 0.25, 0.5, 0.75, 1, 5])
    points = np.stack([x, 0 * x, 0 * x], -1)
    t = np.clip(x / 1.0, 0, 1)
    np.testing.assert_allclose(passing(ds.Flaps(x_min=0, softness=1), points), t**2 * (3 - 2 * t), rtol=1e-14)
    both = passing(ds.Flaps(x_min=0, x_max=1, softness=0.5), points)
    np.testing.assert_allclose(both, [0, 0, 0.5, 1, 0.5, 0, 0], atol=1e-15)


def test_flaps_of_several_axes_multiply():
    soft = {"x_min": 0, "z_max": 1, "softness": 1}
    np.testing.assert_allclose(passing(ds.Flaps(**soft), [(0.5, 9, 0.75)]), 0.5 * (0.0625 * 2.5), rtol=1e-14)


@pytest.mark.thorough
@pytest.mark.parametrize("softness", [0.0, 0.5])
def test_derivatives_are_finite_at_the_limits_and_0_there(softness):
    """At a limit, at the end of its soft edge, and where the edge is hard."""
    flaps = ds.Flaps(-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, softness)
    points = jnp.asarray(np.array(np.meshgrid(*[[-1.0, -0.5, 0.5, 1.0]] * 3)).reshape(3, -1).T)
    value, slopes = jax.jvp(lambda f, p: f(Vec3.of(p)), (flaps, points), jax.tree.map(jnp.ones_like, (flaps, points)))
    back = jax.grad(lambda f, p: f(Vec3.of(p)).sum(), (0, 1))(flaps, points)
    assert np.isfinite(value).all()
    np.testing.assert_array_equal(slopes, 0)
    assert all((np.asarray(leaf) == 0).all() for leaf in jax.tree.leaves(back))


@pytest.mark.thorough
def test_every_kind_of_lamp_has_them():
    points = np.array([(-0.5, 0, 0), (0.5, 0, 0)])
    spot = ds.SpotLight((0, 0, 2), (0, 0, -1), cutoff=80, exponent=2)
    area = ds.AreaLight((-1, -1, 3), (0, 2, 0), (2, 0, 0), samples=2)
    assert all(light.is_local for light in (spot, area))
    for light in (ds.PointLight((0, 0, 2)), spot, area):
        bare, flapped = (
            sum(np.asarray(emitter.arriving(Vec3.of(points))[1].stack()) for emitter in each(of))
            for of in (light, dataclasses.replace(light, flaps=ds.Flaps(x_min=0)))
        )
        assert np.all(bare > 0)
        np.testing.assert_allclose(flapped, bare * [[0], [1]], rtol=1e-14)


def each(light):
    """The emitters of a light, one by one."""
    stack = light.emitters()
    return [jax.tree.map(lambda leaf, i=i: leaf[i], stack) for i in range(len(jax.tree.leaves(stack)[0]))]


def test_its_own_ambient_light_stays_within_them():
    light = ds.PointLight((0, 0, 4), 0, ambient=1, flaps=ds.Flaps(x_min=0))
    scene = ds.Scene(ds.Object(ds.Plane((0, 0, 0), (0, 0, 1)), ds.Material(k_a=0.5)), light, ambient=0)
    image = np.asarray(ds.render(scene, ds.OrthographicCamera((0, 0, 5), height=2, shape=(2, 2))))
    np.testing.assert_allclose(image[..., 0], [[0, 0.5]] * 2, rtol=1e-6)


@pytest.mark.slow
def test_limits_are_found_with_the_material():
    """From a start at which neither edge is where it was."""
    flaps = ds.Flaps(x_min=-0.4, x_max=0.5, y_max=0.6, softness=0.15)
    light = ds.SpotLight((1, 2, 4), (-1, -2, -4), 2, cutoff=40, exponent=3, flaps=flaps)
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.05, 0.7, 0.3, 20)), light)
    camera = ds.Camera((0, 0, 5), fov=30, shape=(48, 48))
    view = ds.View(np.asarray(ds.render(scene, camera), np.float64), camera)
    moved = dataclasses.replace(flaps, x_min=0.1, x_max=0.9)
    start = dataclasses.replace(scene, lights=(dataclasses.replace(light, flaps=moved),))
    fit = ds.fit(start, [view], free=("k_d", "x_min", "x_max"))
    lamp: Any = fit.scene.lights[0]
    found = lamp.flaps
    np.testing.assert_allclose([found.x_min, found.x_max], [-0.4, 0.5], atol=1e-5)
    np.testing.assert_allclose(fit.scene.objects[0].material.k_d, 0.7, atol=1e-5)


@pytest.mark.parametrize("axis", "xyz")
def test_limits_the_wrong_way_round_are_refused(axis):
    words = f"Flaps.{axis}_min must be less than {axis}_max; got 1.0 and 1.0.", f"Give the smaller one as {axis}_min"
    refuses(lambda: ds.Flaps(**{f"{axis}_min": 1.0, f"{axis}_max": 1.0}), *words)


@pytest.mark.parametrize("name", LIMITS)
def test_a_limit_that_is_not_finite_is_refused(name):
    refuses(lambda: ds.Flaps(**{name: float("inf")}), f"Flaps.{name} must be finite; got inf. Give one number.")
