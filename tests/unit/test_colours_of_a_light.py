"""Lights whose ambient, diffuse and specular colours are apart, against OpenGL's equation written from its text."""

import dataclasses

import jax
import numpy as np
import pytest
from directions import unit
from refusals import refuses

import diffshade as ds
from diffshade.extension import AbstractLight, AbstractReflectance, Colour, Vector, colour, dot, vector
from diffshade.inverse.unknowns.parameters import find_unknowns

THOROUGH = pytest.mark.thorough
N = 24
RANDOM = np.random.default_rng(24)
EYE = np.array([0.2, -0.1, 4.0])
CAMERA = ds.OrthographicCamera(EYE, target=EYE - (0, 0, 1), shape=(1, N), height=2)


def surface():
    """Points with normals all around, so that some face no light."""
    return RANDOM.uniform(-1, 1, (N, 3)), unit(RANDOM.normal(size=(N, 3)))


def lighting(material, lights, scene_ambient, p, n, *, local_viewer=True):
    """Return e_cm + a_cm a_cs + sum of att spot (a_cm a_cl + (n.VP) d_cm d_cl + f (n.h)^s s_cm s_cl).

    The OpenGL Graphics System, version 1.1, section 2.13.1.
    """
    c = material["k_e"] + material["k_a"] * scene_ambient * np.ones((len(p), 3))
    to_eye = unit(EYE - p) if local_viewer else np.array([0.0, 0, 1])
    for light in lights:
        if light["position"][3]:
            way = light["position"][:3] - p
            d, VP = np.linalg.norm(way, axis=-1), unit(way)
            k = light["attenuation"]
            att = 1 / (k[0] + k[1] * d + k[2] * d * d)
        else:
            VP, att = np.broadcast_to(unit(light["position"][:3]), p.shape), np.ones(len(p))
        spot = np.ones(len(p))
        if light["cutoff"] != 180:
            cosine = -VP @ unit(light["axis"])
            spot = np.where(cosine >= np.cos(np.deg2rad(light["cutoff"])), np.abs(cosine) ** light["exponent"], 0)
        facing = np.sum(n * VP, -1)
        n_h = np.maximum(np.sum(n * unit(VP + to_eye), -1), 0)
        terms = (
            material["k_a"] * light["ambient"]
            + np.maximum(facing, 0)[:, None] * material["k_d"] * light["diffuse"]
            + np.where(facing > 0, n_h ** material["n_s"], 0)[:, None] * material["k_s"] * light["specular"]
        )
        c = c + (att * spot)[:, None] * terms
    return c


def opengl_light(kind):
    d = RANDOM.normal(size=3)
    return {
        "position": np.array([*RANDOM.uniform(-3, 3, 3), kind != "directional"]),
        "axis": -RANDOM.uniform(0.5, 1.5, 3) * np.sign(d),
        "cutoff": 60.0 if kind == "spot" else 180.0,
        "exponent": 3.0,
        "attenuation": RANDOM.uniform(0.1, 1, 3),
        **{name: RANDOM.uniform(0, 2, 3) for name in ("ambient", "diffuse", "specular")},
    }


def of_library(light):
    at, colours = light["position"], (light["diffuse"], {name: light[name] for name in ("ambient", "specular")})
    if not at[3]:
        return ds.DirectionalLight(-at[:3], colours[0], **colours[1])
    fades = ds.RadialAttenuation(*light["attenuation"])
    if light["cutoff"] == 180:
        return ds.PointLight(at[:3], colours[0], fades, **colours[1])
    return ds.SpotLight(at[:3], light["axis"], colours[0], light["cutoff"], light["exponent"], fades, **colours[1])


def drawn_case(kinds):
    material = {name: RANDOM.uniform(0, 1, 3) for name in ("k_a", "k_d", "k_s", "k_e")} | {"n_s": 7.0}
    return material, [opengl_light(kind) for kind in kinds], RANDOM.uniform(0, 1, 3), *surface()


def rendered(material, lights, ambient, p, n, *, atmosphere=None, camera=CAMERA):
    gbuffer = ds.GBuffer(n[None], p[None], np.ones((1, N), bool))
    lights = [light if isinstance(light, AbstractLight) else of_library(light) for light in lights]
    material = material if isinstance(material, ds.Material) else ds.Material(**material, lobe=ds.Blinn())
    return np.asarray(ds.render(ds.Scene(ds.Object(gbuffer, material), lights, ambient, 0, atmosphere), camera))[0]


def test_opengls_equation():
    case = drawn_case(("spot", "point", "directional", "spot"))
    np.testing.assert_allclose(rendered(*case), lighting(*case), rtol=1e-12)


def test_opengls_equation_with_the_viewer_at_infinity():
    case = drawn_case(("spot", "directional"))
    camera = dataclasses.replace(CAMERA, local_viewer=False)
    np.testing.assert_allclose(rendered(*case, camera=camera), lighting(*case, local_viewer=False), rtol=1e-12)


@pytest.mark.parametrize(
    ("atmosphere", "f"),
    [
        (ds.Fog(0.3, I_dc=(0.5, 0.6, 0.7)), lambda z: np.exp(-0.3 * z)),
        pytest.param(
            ds.Fog(0.3, I_dc=(0.5, 0.6, 0.7), squared=True), lambda z: np.exp(-((0.3 * z) ** 2)), marks=THOROUGH
        ),
        pytest.param(
            ds.DepthCueing(2, 6, I_dc=(0.5, 0.6, 0.7)), lambda z: np.clip((6 - z) / (6 - 2), 0, 1), marks=THOROUGH
        ),
    ],
    ids=["GL_EXP", "GL_EXP2", "GL_LINEAR"],
)
def test_fog_fades_every_term_once(atmosphere, f):
    """C = f C_r + (1 - f) C_f (section 3.10), with the distance along the view axis."""
    case = drawn_case(("point", "spot"))
    f = f(EYE[2] - case[3][:, 2])[:, None]
    expected = f * lighting(*case) + (1 - f) * np.array([0.5, 0.6, 0.7])
    np.testing.assert_allclose(rendered(*case, atmosphere=atmosphere), expected, rtol=1e-12)


@THOROUGH
def test_further_highlights_and_the_emitters_of_an_area_light():
    """The image is linear in each of the three colours."""
    p, n = surface()
    material = ds.Material(0.3, 0.5, 0.2, 9, highlights=[ds.Highlight(0.4, 30)], fresnel=ds.Schlick())
    lamp = ds.AreaLight((-1, 2, -1), (2, 0, 0), (0, 0, 2), 0.8, samples=3)

    def under(material, *lights):
        return rendered(material, lights, 0.0, p, n)

    found = under(material, dataclasses.replace(lamp, ambient=(0.1, 0.2, 0.3), specular=(2, 1, 0)))
    diffuse = under(dataclasses.replace(material, k_s=0, highlights=(), fresnel=ds.NoFresnel()), lamp)
    highlight = under(dataclasses.replace(material, k_d=0), lamp)
    # a matt floor that faces each emitter would be lit as the ambient colour is: the sum of f_rad f_ang over emitters
    reach = under(ds.Material(k_a=1), dataclasses.replace(lamp, ambient=1.0))
    expected = diffuse + highlight / 0.8 * np.array([2, 1, 0]) + 0.3 * reach * np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)
    assert (reach > 0).any()


def test_equal_colours_are_one_colour():
    case = drawn_case(("point", "spot"))
    for light in case[1]:
        light |= {"specular": light["diffuse"], "ambient": np.zeros(3)}
    one = [dataclasses.replace(of_library(light), specular=None, ambient=None) for light in case[1]]
    np.testing.assert_allclose(rendered(*case), rendered(case[0], one, *case[2:]), rtol=1e-13)


class Pair(AbstractLight):
    """Two lamps of one's own that say nothing of the colours apart."""

    at: Vector = vector((0, 2, 2))
    intensity: Colour = colour(1.0)

    @property
    def is_local(self):
        return True

    def emitters(self):
        return jax.vmap(lambda x: ds.PointLight(self.at + x, self.intensity / 2))(np.eye(3)[:2])


def test_a_light_of_ones_own_has_the_colours_too():
    p, n = surface()
    material, own = ds.Material(0.3, 0.5, 0.2, 9), {"ambient": (0.1, 0.2, 0.3), "specular": (2, 1, 0)}
    halves = [
        ds.PointLight(np.array([0, 2, 2]) + x, 0.5, ambient=0.5 * np.array(own["ambient"]), specular=(1, 0.5, 0))
        for x in np.eye(3)[:2]
    ]
    found = rendered(material, [Pair(intensity=1.0, **own)], 0.0, p, n)
    np.testing.assert_allclose(found, rendered(material, halves, 0.0, p, n), rtol=1e-12)


class Whole(AbstractReflectance):
    """A reflectance whose parts nobody knows."""

    def reflected(self, k, fresnel, n, l, v):
        return k.k_d * dot(n, l)


def test_what_cannot_be_told_apart_is_refused():
    item = ds.Object(ds.Sphere(), ds.Material(lobe=Whole()))
    lamp = ds.PointLight((0, 0, 4), specular=0.5)
    refuses(lambda: ds.Scene(item, lamp), "lights[0].specular", "a Whole", "objects[0]", "AbstractLobe")
    ds.Scene(item, dataclasses.replace(lamp, specular=None, ambient=0.5))  # its ambient light can be told
    refuses(lambda: ds.PointLight((0, 0, 4), ambient=-0.5), "PointLight.ambient", "at least 0", "-0.5")
    refuses(lambda: ds.PointLight((0, 0, 4), specular=()), "PointLight.specular", "shape (0,)")


@THOROUGH
def test_a_fit_finds_them_and_switches_all_of_them_off():
    truth = ds.PointLight(
        (2, 2, 3), 0.9, ambient=0.25, specular=(0.9, 0.6, 0.3), attenuation=ds.RadialAttenuation(0.5, 0.2)
    )
    other = ds.PointLight((-2, 1, 3), 0.5, ambient=0.1, specular=0.2)
    ball = ds.Object(ds.Sphere(), ds.Material(0.3, (0.6, 0.5, 0.4), 0.4, 12))
    camera = ds.Camera(eye=(0, 0, 4), fov=32, shape=(24, 24))
    views = [ds.View(ds.render(ds.Scene(ball, (truth, other), 0.5), camera, lit=i), camera, lit=i) for i in range(2)]
    told = ds.Scene(ball, (dataclasses.replace(truth, ambient=0.0, specular=1.0), other), 0.5)
    fit = ds.fit(told, views, free=("lights.0.ambient", "specular", "n_s"))
    first, second = fit.scene.lights
    found = [np.asarray(colour) for colour in (first.ambient, first.specular, second.specular)]
    np.testing.assert_allclose(found, [3 * [0.25], (0.9, 0.6, 0.3), 3 * [0.2]], atol=1e-6)


@THOROUGH
def test_views_need_not_show_such_a_light():
    lamps = ds.PointLight((2, 2, 3)), ds.SpotLight((0, 0, 3), (0, 0, -1), specular=0.5)
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.1, 0.6, fresnel=ds.Schlick())), lamps)
    camera = ds.Camera(eye=(0, 0, 4), fov=32, shape=(12, 12))
    fit = ds.fit(scene, ds.View(ds.render(scene, camera, lit=0), camera, lit=0), free="k_d")
    np.testing.assert_allclose(fit.values, 0.6, atol=1e-6)


def test_they_stand_in_scene_files_and_a_fit_of_texels_refuses_them(tmp_path):
    lamp = ds.PointLight((2, 2, 3), 0.9, ambient=0.25, specular=(0.9, 0.6, 0.3))
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.3, 0.6)), lamp)
    ds.write_scene(tmp_path / "ball.toml", scene)
    jax.tree.map(np.testing.assert_array_equal, ds.read_scene(tmp_path / "ball.toml"), scene)
    views = [ds.View(np.ones((4, 4, 3)), ds.Camera(eye=(0, 0, 4), shape=(4, 4)))] * 3
    refuses(lambda: ds.fit_texels(scene, views, free=("k_d",)), "lights[0]", "one colour each")


def test_ambient_names_the_scenes_own(tmp_path):
    lamp = ds.PointLight((2, 2, 3), ambient=0.25)
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.3, 0.6)), lamp)
    view = ds.View(np.ones((4, 4)), ds.Camera(eye=(0, 0, 4), shape=(4, 4)))
    for name in ("ambient", "lights.0.ambient"):
        assert [unknown.name for unknown in find_unknowns(scene, [view], free=(name,), grey=True)] == [name]
