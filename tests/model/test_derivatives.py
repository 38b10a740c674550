"""Derivatives of the whole model: those of finite differences away from the kinks, finite and on the documented side at
them.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import (
    CHANNELS,
    DARK,
    ORDERS,
    PLACES,
    POINT,
    RIGHT,
    SCENES,
    UP,
    ZERO,
    at_corners,
    check_place,
    colour,
    corner,
    derivatives_at,
    errors_in,
    field_of,
    numeric_fields,
    path_of,
    slopes,
)

import diffshade as ds
from diffshade.model.attenuation import angular_attenuation
from diffshade.model.rendering import pixel_rays

# every field of theirs is in a thorough scene too, but for depth cueing, a normal map and what fits of them check
TIERS: dict[str, Any] = dict.fromkeys(
    (
        "a floor, a turned box and a ball",
        "unbent through two balls and past a wall",
        "a ball under two lights of each kind",
    ),
    pytest.mark.slow,
)
AMBIENT = {"0.objects.0.material.k_a", "0.objects.0.material.k_e", "0.ambient"}


@pytest.mark.thorough
def test_a_scene_has_the_derivative_of_finite_differences():
    """Along one direction of all its numbers; one by one they are slow."""
    differences, forward, reverse = slopes("a ball under two lights of each kind")
    tolerance = 1e-8 * np.abs(reverse).sum()
    assert abs(forward - differences) <= tolerance
    assert abs(reverse.sum() - differences) <= tolerance


@pytest.mark.parametrize("name", [pytest.param(n, marks=TIERS.get(n, pytest.mark.thorough)) for n in SCENES])
def test_every_number_has_the_derivative_of_finite_differences(name):
    errors = errors_in(name)
    for path, _ in jax.tree.leaves_with_path(SCENES[name]):
        field, error = field_of(SCENES[name], path), errors.get(path_of(path))
        order = ORDERS.get(field, -9)
        # ten times the order: another machine rounds otherwise
        assert error is None or (order is not None and error <= 10.0 ** (order + 1)), f"{field}: {error}, not 1e{order}"
    if "cut off" in name:  # a hard edge is a jump, which no derivative sees, and has no width
        assert [errors[f"0.lights.1.{field}"] for field in ("cutoff", "softness")] == [None, None]


def test_every_number_of_the_model_is_in_a_scene():
    seen = {field_of(tree, path) for tree in SCENES.values() for path, _ in jax.tree.leaves_with_path(tree)}
    assert set(ORDERS) <= set(numeric_fields()) <= seen


@pytest.mark.thorough
@pytest.mark.parametrize("name", PLACES)
def test_finite_at_the_kink_and_0_on_the_documented_side(name):
    check_place(name)


@pytest.fixture(scope="module")
def found():
    return {lobe: at_corners(lobe) for lobe in ("phong", "blinn")}


def names_of_nonzero(found):
    return {path for path, derivative in found.items() if derivative.any()}


@pytest.mark.parametrize("name", DARK)
def test_zero_where_it_is_dark(found, name):
    lobe, place = DARK[name]
    diffuse = {"0.objects.0.material.k_d"} if place.get("l", UP)[2] > 0 else set()
    assert names_of_nonzero(found[lobe][name]) == AMBIENT | diffuse


@pytest.mark.parametrize("lobe", ["phong", "blinn"])
@pytest.mark.parametrize("name", ZERO)
def test_zero_on_the_documented_side(found, lobe, name):
    nonzero = names_of_nonzero(found[lobe][name])
    assert not nonzero & set(ZERO[name][1])
    assert nonzero >= AMBIENT


@pytest.mark.thorough
@pytest.mark.parametrize("lobe", ["phong", pytest.param("blinn", marks=pytest.mark.slow)])
def test_finite_in_float32(lobe):
    with jax.enable_x64(False):
        at_corners(lobe)


def both_modes(function, tree):
    """The value, its derivative along a direction of ones, and the gradient of its sum."""
    with jax.disable_jit():
        value, slope = jax.jvp(function, (tree,), (jax.tree.map(jnp.ones_like, tree),))
        return value, slope, jax.vjp(function, tree)[1](jax.tree.map(jnp.ones_like, value))[0]


def test_nothing_comes_from_outside_the_mask():
    mask = np.arange(12 * 16).reshape(12, 16) % 3 > 0
    normal = np.where(mask[..., None], (0.0, 0.6, 0.8), np.nan)
    scene, camera, _, _ = corner("phong", (1, 0, 2))
    camera = dataclasses.replace(camera, shape=mask.shape)
    points = {"normal": normal, "position": 0 * normal}
    _, slope, gradient = both_modes(lambda p: ds.shade(scene, ds.GBuffer(**p, mask=mask), camera), points)
    for derivative in (slope, *gradient.values()):
        assert np.asarray(derivative)[mask].any(-1).all()
        assert not np.asarray(derivative)[~mask].any()


def test_finite_at_the_silhouette():
    """Of pixels two units apart one is in the middle of the unit sphere's height, and its ray touches it exactly."""
    camera = ds.OrthographicCamera((0, 1, 4), target=(0, 1, 0), height=24, shape=(12, 16))
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.1, 0.7, 0.4, 4.5)), [POINT])

    def seen(both):
        scene, camera = both
        hit = scene.objects[0].surface.intersect(pixel_rays(camera.projection(), camera.shape))
        return ds.render(scene, camera), hit.p.stack(), hit.n.stack()

    (image, p, n), slope, gradient = both_modes(seen, (scene, camera))
    for path, derivative in jax.tree.leaves_with_path((slope, gradient)):
        assert np.isfinite(derivative).all(), path_of(path)
    np.testing.assert_array_equal([p[6, 8], n[6, 8]], [RIGHT, RIGHT])
    assert not image[6, 8].any()


@pytest.mark.parametrize("exponent", [0.0, 3.5])
@pytest.mark.parametrize("edge", ["outer", "inner"])
def test_the_edge_of_a_spot_is_smooth_where_softness_makes_it_so(exponent, edge):
    cutoff, exponent, softness = jnp.array(40.0), jnp.array(exponent), jnp.array(15.0)
    cos_phi = jnp.cos(jnp.deg2rad(cutoff if edge == "outer" else cutoff - softness))
    slope, *by_edge = jax.grad(lambda x, c, s: angular_attenuation(x, c, exponent, s), (0, 1, 2))(
        cos_phi, cutoff, softness
    )
    expected = 0.0 if edge == "outer" else exponent * cos_phi ** (exponent - 1)
    np.testing.assert_allclose(slope, expected, rtol=1e-12)
    np.testing.assert_allclose(by_edge, 0, atol=1e-15)


def test_the_edge_of_a_hard_spot_is_a_jump_that_no_derivative_sees():
    cutoff, softness = jnp.array(40.0), jnp.array(0.0)
    cos_phi = jnp.cos(jnp.deg2rad(cutoff))
    found = jax.grad(angular_attenuation, (0, 1, 2, 3))(cos_phi, cutoff, jnp.array(2.0), softness)
    x = float(cos_phi)
    np.testing.assert_allclose(np.array(found), (2 * x, 0, x**2 * np.log(x), 0), rtol=1e-12)


@pytest.mark.thorough
def test_a_compiled_derivative_is_that_of_single_operations():
    """The other tests here run operation by operation."""
    tree = corner("phong", (1, 0, 2))
    (of_operations,) = derivatives_at(colour, [tree])
    for path, leaf in jax.tree.leaves_with_path(jax.jit(jax.grad(lambda t: colour(t) @ jnp.array(CHANNELS)))(tree)):
        np.testing.assert_allclose(np.ravel(leaf), of_operations[path_of(path)], rtol=1e-9, atol=1e-12)
