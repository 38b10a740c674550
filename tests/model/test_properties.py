"""What must hold for every scene: linearity, invariances, and images without a NaN."""

import dataclasses
from functools import partial

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from strategies import (
    attenuations,
    colours,
    directions,
    extreme_eyes,
    extreme_lights,
    extreme_materials,
    eyes,
    factors,
    lengths,
    lights,
    materials,
    points,
)

import diffshade as ds

quick = settings(derandomize=True, deadline=None, max_examples=15, database=None)

CAMERA = ds.Camera((0.4, 0.5, 4), fov=36, shape=(8, 9))  # one shape for all, so that little is compiled


def scene_of(material, lights, ambient=(0.9, 1.0, 0.8), background=(0.0, 0.0, 0.0)):
    return ds.Scene(ds.Object(ds.Sphere((0.1, -0.1, 0.2), 1.1), material), lights, ambient, background)


# the time goes into compiling, not into running
QUICK = {"xla_backend_optimization_level": 0, "xla_disable_hlo_passes": "fusion"}
compiled = jax.jit(ds.render, compiler_options=QUICK)


def render(scene, camera=CAMERA):
    return np.asarray(compiled(scene, camera))


def assert_close(a, b, tolerance=1e-12):
    np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance * max(1.0, np.abs(b).max()))


@quick
@given(materials, lights, factors)
def test_linear_in_each_coefficient(material, lights, factor):
    nothing = dataclasses.replace(material, k_a=0, k_d=0, k_s=0)
    terms = {k: dataclasses.replace(nothing, **{k: getattr(material, k)}) for k in ("k_a", "k_d", "k_s")}
    images = {k: render(scene_of(term, lights)) for k, term in terms.items()}
    assert_close(render(scene_of(material, lights)), sum(images.values()))
    for k, term in terms.items():
        scaled = dataclasses.replace(term, **{k: factor * getattr(term, k)})
        assert_close(render(scene_of(scaled, lights)), factor * images[k])


@quick
@given(materials, lights, factors)
def test_linear_in_intensity_and_ambient(material, lights, factor):
    brighter = [dataclasses.replace(light, intensity=factor * light.intensity) for light in lights]
    image = render(scene_of(material, lights))
    assert_close(render(scene_of(material, brighter, ambient=factor * np.array([0.9, 1, 0.8]))), factor * image)


@pytest.mark.thorough
@quick
@given(materials, lights)
def test_additive_over_lights_in_any_order(material, lights):
    def of(*on):
        switched = [dataclasses.replace(light, intensity=light.intensity * (i in on)) for i, light in enumerate(lights)]
        return render(scene_of(material, switched))

    image, dark = of(0, 1, 2), of()
    assert_close(image, dark + sum(of(i) - dark for i in range(3)))
    assert_close(render(scene_of(material, lights[::-1])), image)


@quick
@given(materials, lights, factors.filter(lambda s: s > 0.1))
def test_k_and_intensity_are_one_scale(material, lights, scale):
    dimmer = [dataclasses.replace(light, intensity=light.intensity / scale) for light in lights]
    stronger = dataclasses.replace(material, k_d=scale * material.k_d, k_s=scale * material.k_s)
    assert_close(render(scene_of(stronger, dimmer)), render(scene_of(material, lights)))


def rotation(axis, angle):
    """Rodrigues' formula."""
    x, y, z = np.divide(axis, np.linalg.norm(axis))
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def moved(tree, turn, shift):
    """Every point of a scene or camera turned and shifted, every direction turned."""

    def move(path, leaf):
        name = path[-1].name
        if name in ("position", "center", "eye", "target"):
            return turn @ leaf + shift
        return turn @ leaf if name in ("direction", "up") else leaf

    return jax.tree.map_with_path(move, tree)


@quick
@given(materials, lights, directions, st.floats(-np.pi, np.pi), points, eyes)
def test_moving_everything_leaves_the_image(material, lights, axis, angle, shift, eye):
    scene, camera = scene_of(material, lights), dataclasses.replace(CAMERA, eye=eye)
    turn = rotation(axis, angle)
    # n_s up to 200 and, near the silhouette, the square root of what is left magnify the rounding
    assert_close(render(moved(scene, turn, shift), moved(camera, turn, shift)), render(scene, camera), 1e-9)


@quick
@given(materials, lights, lengths)
def test_the_unit_of_length_does_not_matter(material, lights, unit):
    scene = scene_of(material, lights)

    def in_units(path, leaf):
        name = path[-1].name
        power = {"position": 1, "center": 1, "radius": 1, "eye": 1, "target": 1, "linear": -1, "quadratic": -2}
        return np.asarray(leaf * unit ** power.get(name, 0))

    scaled, camera = jax.tree.map_with_path(in_units, (scene, CAMERA))
    assert_close(render(scaled, camera), render(scene), 1e-9)


@quick
@given(attenuations, lengths, st.floats(1.001, 10), st.booleans())
def test_attenuation_falls_with_distance(attenuation, d, factor, clamp):
    f = dataclasses.replace(attenuation, clamp=clamp)
    near, far = float(f(np.array(d))), float(f(np.array(factor * d)))
    assert 0 < far <= near
    if attenuation.linear + attenuation.quadratic > 0.01 and near < 1:
        assert far < near
    assert not clamp or near <= 1


@pytest.mark.thorough
@quick
@given(materials, lights, eyes)
def test_what_intersect_finds_shade_renders(material, lights, eye):
    scene = scene_of(material, lights, background=(0.1, 0.2, 0.3))
    camera = dataclasses.replace(CAMERA, eye=eye)
    gbuffer = ds.intersect(scene, camera)
    image = render(scene, camera)
    assert_close(np.asarray(ds.shade(scene, gbuffer, camera)), image)
    np.testing.assert_array_equal(image[~np.asarray(gbuffer.mask)] - [0.1, 0.2, 0.3], 0)


@pytest.mark.thorough
@quick
@given(materials, colours, directions)
def test_a_light_far_away_is_directional(material, intensity, towards):
    material = dataclasses.replace(material, lobe=ds.Phong())  # one lobe will do
    far = ds.PointLight(1e9 * np.array(towards), intensity)
    infinitely_far = ds.DirectionalLight(-np.array(towards), intensity)
    assert_close(render(scene_of(material, [far])), render(scene_of(material, [infinitely_far])), 1e-5)


def extreme(material, lights, eye):
    camera = dataclasses.replace(CAMERA, eye=eye, target=(0.1, 0.2, -0.3))
    return ds.Scene(ds.Object(ds.Sphere(), material), lights), camera


@settings(quick, max_examples=60)
@given(extreme_materials, extreme_lights, extreme_eyes)
def test_extreme_scenes_are_finite(material, lights, eye):
    assert np.isfinite(render(*extreme(material, lights, eye))).all()


@partial(jax.jit, compiler_options=QUICK)
def gradient(both):
    return jax.grad(lambda both: jnp.sum(ds.render(*both)))(both)


@pytest.mark.thorough
@settings(quick, max_examples=40)
@given(extreme_materials, extreme_lights, extreme_eyes)
def test_extreme_scenes_have_finite_gradients(material, lights, eye):
    both = extreme(dataclasses.replace(material, lobe=ds.Blinn()), lights, eye)
    for path, leaf in jax.tree.leaves_with_path(gradient(both)):
        assert np.isfinite(leaf).all(), jax.tree_util.keystr(path)
