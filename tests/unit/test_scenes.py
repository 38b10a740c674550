"""Scenes: what goes together, and lights of one kind in one stack."""

from re import escape

import equinox as eqx
import jax
import numpy as np
import pytest

import diffshade as ds
from diffshade.scenes import light_kinds, stack_scene

BALL = ds.Object(ds.Sphere(), ds.Material(k_d=0.7))
NORMAL = np.full((4, 5, 3), (0, 0, 1))
NO_POSITIONS = ds.Object(ds.GBuffer(NORMAL))
FLAT = ds.OrthographicCamera((0, 0, 4), shape=(4, 5), local_viewer=False)


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
    assert clamped.attenuation.clamp
    for leaf in jax.tree.leaves(stacked):
        assert type(leaf) is np.ndarray  # until the jit boundary
        assert leaf.dtype == np.float64


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (
            lambda: ds.Scene(ds.Sphere()),
            TypeError,
            "Scene.objects[0] must be an Object; got Sphere. Give for example Object(Sphere(), Material(k_d=0.7)).",
        ),
        (
            lambda: ds.Scene([BALL, 5]),
            TypeError,
            "Scene.objects[1] must be an Object; got int. Give for example Object(Sphere(), Material(k_d=0.7)).",
        ),
        (
            lambda: ds.Scene(BALL, [ds.PointLight((1, 2, 3)), ds.Material()]),
            TypeError,
            "Scene.lights[1] must be a Light; got Material. Give for example PointLight((2, 3, 4)).",
        ),
        (
            lambda: ds.Scene([]),
            ValueError,
            "Scene.objects must hold at least one Object; got none. Give one: Object(Sphere()).",
        ),
        (
            lambda: ds.Scene([BALL, NO_POSITIONS]),
            ValueError,
            "a scene of several objects needs to know which is in front; got a GBuffer without positions. "
            "Give GBuffer.position, or make it the only object.",
        ),
    ],
)
def test_a_scene_that_is_none(make, error, message):
    with pytest.raises(error, match=f"^{escape(message)}$"):
        make()


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
    message = (
        f"{what} needs to know where the surface is; got a GBuffer without positions. Give GBuffer.position, "
        "or use directional lights and a camera with local_viewer=False."
    )
    with pytest.raises(ValueError, match=f"^{escape(message)}$"):
        ds.render(ds.Scene(NO_POSITIONS, lights), camera)
    with pytest.raises(ValueError, match=f"^{escape(message)}$"):
        ds.shade(ds.Scene(BALL, lights), ds.GBuffer(NORMAL), camera)


def test_normals_alone_do_for_a_light_and_a_viewer_at_infinity():
    image = ds.render(ds.Scene(eqx.tree_at(lambda o: o.material, NO_POSITIONS, BALL.material)), FLAT)
    assert image.shape == (4, 5, 3)


@pytest.mark.parametrize(
    "wrong",
    [
        (lambda s: s.objects[0].material.k_d, np.array([0.1, 0.2]), r"^Material\.k_d must be a colour of 1 or 3 numb"),
        (lambda s: s.objects[0].material.n_s, np.array(-1.0), r"^Material\.n_s must be at least 0; got -1\."),
        (lambda s: s.objects[0].surface.radius, np.array(0.0), r"^Sphere\.radius must be above 0; got 0\.0"),
        (lambda s: s.lights[0].attenuation.constant, np.array(0.0), "^RadialAttenuation needs one of constant, lin"),
        (lambda s: s.lights[0].position, np.array([1, np.nan, 0]), r"^PointLight\.position must be finite"),
        (lambda s: s.ambient, np.array(-1 + np.zeros(3)), r"^Scene\.ambient must be at least 0"),
        (lambda s: s.objects, (), r"^Scene\.objects must hold at least one Object"),
        (lambda s: s.lights[0], ds.Material(), r"^Scene\.lights\[0\] must be a Light; got Material"),
        (
            lambda s: s.objects[0].surface,
            ds.Blinn(),
            r"^Object\.surface must be a Surface; got Blinn\. Give for example Sp",
        ),
        (lambda s: s.objects[0].material.lobe, ds.Schlick(), r"^Material\.lobe must be a Lobe; got Schlick\. Give for"),
        (
            lambda s: s.objects[0].material.fresnel,
            ds.Phong(),
            r"^Material\.fresnel must be a Fresnel; got Phong\. Give",
        ),
        (
            lambda s: s.objects[0].material.k_d,
            ds.Sphere(),
            r"^Material\.k_d must be a Pattern; got Sphere\. Give for ex",
        ),
    ],
)
def test_render_refuses_what_tree_at_put_in(wrong):
    where, value, message = wrong
    scene = eqx.tree_at(where, ds.Scene(BALL, ds.PointLight((1, 2, 3))), value)
    with pytest.raises((TypeError, ValueError), match=message):
        ds.render(scene, FLAT)
    with pytest.raises((TypeError, ValueError), match=message):
        ds.intersect(scene, FLAT)


def test_render_refuses_a_camera_that_tree_at_made():
    camera = eqx.tree_at(lambda c: c.height, FLAT, np.array(-1.0))
    with pytest.raises(ValueError, match=r"^OrthographicCamera\.height must be above 0; got -1\.0"):
        ds.render(ds.Scene(BALL), camera)


def named(name):
    return ds.Object(ds.Sphere(), name=name)


@pytest.mark.parametrize("name", ["two words", "1st", "a.b", "a-b", " "])
def test_a_name_is_one_word(name):
    message = f"Object.name must be one word, of letters, digits and _; got {name!r}. Rename it."
    with pytest.raises(ValueError, match=f"^{escape(message)}$"):
        named(name)


def test_names_differ():
    assert ds.Scene([named("a"), named("b"), BALL, BALL]).objects[1].name == "b"
    message = "objects must have different names; got 'ball' twice. Rename one of them."
    with pytest.raises(ValueError, match=f"^{escape(message)}$"):
        ds.Scene([named("ball"), BALL, named("ball")])


@pytest.mark.parametrize(
    ("material", "atmosphere", "what"),
    [
        (ds.Material(), ds.Fog(0.1), "a Fog"),
        (ds.Material(), ds.DepthCueing(1, 2), "a DepthCueing"),
        (ds.Material(k_d=ds.Chequer(0, 1)), None, "a Chequer"),
    ],
)
def test_air_and_patterns_need_positions(material, atmosphere, what):
    message = (
        f"{what} needs to know where the surface is; got a GBuffer without positions. Give GBuffer.position, "
        "or use directional lights and a camera with local_viewer=False."
    )
    scene = ds.Scene(ds.Object(ds.GBuffer(NORMAL), material), atmosphere=atmosphere)
    with pytest.raises(ValueError, match=f"^{escape(message)}$"):
        ds.render(scene, FLAT)
    image = ds.render(eqx.tree_at(lambda s: s.objects[0].surface, scene, ds.GBuffer(NORMAL, 0.0 * NORMAL)), FLAT)
    assert np.isfinite(image).all()


def test_an_atmosphere_that_is_none():
    scene = eqx.tree_at(lambda s: s.atmosphere, ds.Scene(BALL), ds.Blinn(), is_leaf=lambda leaf: leaf is None)
    message = "Scene.atmosphere must be an Atmosphere; got Blinn. Give for example Fog(density=0.1, I_dc=0.5)."
    with pytest.raises(TypeError, match=f"^{escape(message)}$"):
        ds.render(scene, FLAT)
