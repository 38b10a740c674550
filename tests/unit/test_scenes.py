"""Scenes: what goes together, and lights of one kind in one stack."""

import equinox as eqx
import jax
import numpy as np
import pytest
from refusals import refuses

import diffshade as ds
from diffshade.model.scenes import light_kinds, stack_scene

BALL = ds.Object(ds.Sphere(), ds.Material(k_d=0.7))
NORMAL = np.full((4, 5, 3), (0, 0, 1))
NO_POSITIONS = ds.Object(ds.GBuffer(NORMAL))
FLAT = ds.OrthographicCamera((0, 0, 4), shape=(4, 5), local_viewer=False)


BAD_NAMES = ["two words", "1st", "a.b", "a-b", " "]


def named(name):
    return ds.Object(ds.Sphere(), name=name)


def test_one_or_several():
    light = ds.PointLight((1, 2, 3))
    scene = ds.Scene(BALL, light)
    assert scene.objects == (BALL,)
    assert scene.lights == (light,)
    assert ds.Scene([BALL, BALL], [light]).objects == (BALL, BALL)
    assert ds.Scene(BALL).lights == ()


def test_defaults():
    scene = ds.Scene(BALL)
    np.testing.assert_array_equal(scene.ambient, [1, 1, 1])
    np.testing.assert_array_equal(scene.background, [0, 0, 0])
    np.testing.assert_array_equal(ds.Scene(BALL, ambient=0.3, background=(1, 2, 3)).background, [1, 2, 3])
    assert isinstance(ds.Object(ds.Sphere()).material, ds.Material)


def lights():
    return [
        ds.PointLight((1, 0, 0)),
        ds.DirectionalLight((2, 0, 0)),
        ds.PointLight((3, 0, 0)),
        ds.PointLight((4, 0, 0), attenuation=ds.RadialAttenuation(clamp=True)),
        ds.DirectionalLight((5, 0, 0)),
    ]


def test_lights_of_one_kind_are_stacked():
    """One kind is one class with the same static fields; the kinds come in the order of their first lights."""
    assert light_kinds(lights()) == [[0, 2], [1, 4], [3]]
    stacked = stack_scene(ds.Scene(BALL, lights()))
    points, directional, clamped = stacked.lights
    assert isinstance(points, ds.PointLight)
    assert isinstance(directional, ds.DirectionalLight)
    assert isinstance(clamped, ds.PointLight)
    np.testing.assert_array_equal(points.position, [(1, 0, 0), (3, 0, 0)])
    np.testing.assert_array_equal(directional.direction, [(2, 0, 0), (5, 0, 0)])
    np.testing.assert_array_equal(clamped.position, [(4, 0, 0)])
    assert isinstance(clamped.attenuation, ds.RadialAttenuation)
    assert clamped.attenuation.clamp
    for leaf in jax.tree.leaves(stacked):
        assert type(leaf) is np.ndarray  # until the jit boundary
        assert leaf.dtype == np.float64


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: ds.Scene([BALL, 5]), TypeError, ("Scene.objects[1]", "an Object", "int")),
        (lambda: ds.Scene([BALL, NO_POSITIONS]), ValueError, ("without positions", "GBuffer.position", "only object")),
        *((lambda name=name: named(name), ValueError, ("Object.name", "one word", repr(name))) for name in BAD_NAMES),
    ],
)
def test_a_scene_that_is_none(make, error, words):
    refuses(make, *words, error=error)


def test_objects_may_have_names():
    assert ds.Scene([named("a"), named("b"), BALL, BALL]).objects[1].name == "b"


def refuses_normals_alone(scene, camera, what):
    words = (what, "without positions", "GBuffer.position", "directional lights", "local_viewer=False")
    refuses(lambda: ds.render(scene, camera), *words)
    refuses(lambda: ds.shade(ds.Scene(BALL, scene.lights), ds.GBuffer(NORMAL), camera), *words)


@pytest.mark.parametrize(
    ("lights", "local_viewer", "what"),
    [
        ([], True, "a camera with local_viewer=True"),
        ([ds.PointLight((1, 2, 3))], False, "a PointLight"),
        ([ds.DirectionalLight((1, 2, 3)), ds.SpotLight((1, 2, 3), (0, 0, -1))], False, "a SpotLight"),
    ],
)
def test_what_needs_positions_says_so(lights, local_viewer, what):
    camera = ds.OrthographicCamera((0, 0, 4), shape=(4, 5), local_viewer=local_viewer)
    refuses_normals_alone(ds.Scene(NO_POSITIONS, lights), camera, what)


@pytest.mark.parametrize(
    ("material", "atmosphere", "what"),
    [
        (ds.Material(), ds.Fog(0.1), "a Fog"),
        (ds.Material(), ds.DepthCueing(1, 2), "a DepthCueing"),
        (ds.Material(k_d=ds.Chequer(0, 1)), None, "a Chequer"),
    ],
)
def test_air_and_patterns_need_positions(material, atmosphere, what):
    scene = ds.Scene(ds.Object(ds.GBuffer(NORMAL), material), atmosphere=atmosphere)
    refuses(lambda: ds.render(scene, FLAT), what, "without positions", "GBuffer.position")
    with jax.disable_jit():
        image = ds.render(eqx.tree_at(lambda s: s.objects[0].surface, scene, ds.GBuffer(NORMAL, 0.0 * NORMAL)), FLAT)
    assert np.isfinite(image).all()


def test_normals_alone_do_for_a_light_and_a_viewer_at_infinity():
    image = ds.render(ds.Scene(eqx.tree_at(lambda o: o.material, NO_POSITIONS, BALL.material)), FLAT)
    assert image.shape == (4, 5, 3)


@pytest.mark.parametrize(
    ("where", "value", "words"),
    [
        (
            lambda s: s.objects[0].material.k_d,
            np.array([0.1, 0.2]),
            ("objects.0.material.k_d", "2 numbers", "three (R, G, B)"),
        ),
        (lambda s: s.objects[0].material.n_s, np.array(-1.0), ("Material.n_s", "at least 0", "-1.")),
        (lambda s: s.objects[0].surface.radius, np.array(0.0), ("Sphere.radius", "above 0", "got 0")),
        (lambda s: s.lights[0].attenuation.constant, np.array(0.0), ("RadialAttenuation", "constant")),
        (lambda s: s.lights[0].position, np.array([1, np.nan, 0]), ("PointLight.position", "finite")),
        (lambda s: s.ambient, np.array(-1 + np.zeros(3)), ("Scene.ambient", "at least 0")),
        (lambda s: s.objects, (), ("Scene.objects", "at least one Object")),
        (lambda s: s.lights[0], ds.Material(), ("Scene.lights[0]", "a Light", "Material")),
        (lambda s: s.objects[0].surface, ds.Blinn(), ("Object.surface", "a Surface", "Blinn")),
        (lambda s: s.objects[0].material.lobe, ds.Schlick(), ("Material.lobe", "a Reflectance", "Schlick")),
        (lambda s: s.objects[0].material.fresnel, ds.Phong(), ("Material.fresnel", "a Fresnel", "Phong")),
        (lambda s: s.objects[0].material.k_d, ds.Sphere(), ("Material.k_d", "a Pattern", "Sphere")),
        (lambda s: s.atmosphere, ds.Blinn(), ("Scene.atmosphere", "an Atmosphere", "Blinn", "Fog(")),
    ],
)
def test_render_refuses_what_tree_at_put_in(where, value, words):
    scene = eqx.tree_at(where, ds.Scene(BALL, ds.PointLight((1, 2, 3))), value, is_leaf=lambda leaf: leaf is None)
    for use in (ds.render, ds.intersect):
        refuses(lambda use=use: use(scene, FLAT), *words, error=(TypeError, ValueError))


def test_render_refuses_a_camera_that_tree_at_made():
    camera = eqx.tree_at(lambda c: c.height, FLAT, np.array(-1.0))
    refuses(lambda: ds.render(ds.Scene(BALL), camera), "OrthographicCamera.height", "above 0", "got -1")
