"""What people type becomes NumPy float64 of one shape; what cannot is refused in one sentence."""

import dataclasses
import json
import subprocess
import sys
from re import escape

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffshade as ds
from diffshade.fields import as_array, as_colour, check, did_you_mean, is_concrete, quantities


@pytest.mark.parametrize("value", [0.1, 40, True, (0.1, 2, 3), [1, 2], np.float32(0.5), np.arange(3), np.ones((2, 3))])
def test_numbers_become_float64(value):
    array = as_array(value)
    assert type(array) is np.ndarray
    assert array.dtype == np.float64
    np.testing.assert_array_equal(array, value)


def test_a_jax_array_stays_one():
    value = jnp.array([0.1, 0.2, 0.3])
    assert as_array(value) is value
    assert as_colour(value) is value
    assert ds.Material(k_d=value).k_d is value


def test_a_later_edit_does_not_reach_a_frozen_scene():
    k_d = np.array([0.1, 0.2, 0.3])
    material = ds.Material(k_d=k_d)
    k_d[:] = 9
    np.testing.assert_array_equal(material.k_d, [0.1, 0.2, 0.3])


@pytest.mark.parametrize("grey", [0.7, (0.7,), [0.7], np.array(0.7), np.array([0.7]), jnp.array(0.7), jnp.array([0.7])])
def test_one_number_is_grey(grey):
    colour = as_colour(grey)
    assert isinstance(colour, jax.Array) == isinstance(grey, jax.Array)
    assert colour.dtype == np.float64
    np.testing.assert_array_equal(colour, [0.7, 0.7, 0.7])


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (
            lambda: ds.Material(k_d=(0.1, 0.2)),
            ValueError,
            "Material.k_d must be a colour of 1 or 3 numbers; got shape (2,). Give one number (grey) or three (R, G, "
            "B).",
        ),
        (
            lambda: ds.Material(k_d="red"),
            TypeError,
            "Material.k_d must be a colour of 1 or 3 numbers; got 'red'. Give one number (grey) or three (R, G, B).",
        ),
        (
            lambda: ds.Material(k_d=1j),
            TypeError,
            "Material.k_d must be a colour of 1 or 3 numbers; got 1j. Give one number (grey) or three (R, G, B).",
        ),
        (
            lambda: ds.Material(n_s=(1, 2)),
            ValueError,
            "Material.n_s must be 1 or 3 numbers; got shape (2,). Give one number, or one a channel (R, G, B).",
        ),
        (
            lambda: ds.PointLight((1, 2)),
            ValueError,
            "PointLight.position must be a vector of 3 numbers; got shape (2,). Give three numbers (x, y, z).",
        ),
        (
            lambda: ds.PointLight(((1, 2), (3,))),
            TypeError,
            "PointLight.position must be a vector of 3 numbers; got ((1, 2), (3,)). Give three numbers (x, y, z).",
        ),
        (
            lambda: ds.PointLight(5),
            ValueError,
            "PointLight.position must be a vector of 3 numbers; got shape (). Give three numbers (x, y, z).",
        ),
        (
            lambda: ds.Sphere((0, np.nan, 0)),
            ValueError,
            "Sphere.center must be finite; got (0, nan, 0). Give three numbers (x, y, z).",
        ),
        (
            lambda: ds.Material(n_s=np.inf),
            ValueError,
            "Material.n_s must be finite; got inf. Give one number, or one a channel (R, G, B).",
        ),
        (
            lambda: ds.Material(n_s=-1),
            ValueError,
            "Material.n_s must be at least 0; got -1. Give a value in that range.",
        ),
        (
            lambda: ds.Material(n_s=(1, -2, 3)),
            ValueError,
            "Material.n_s must be at least 0; got (1, -2, 3). Give a value in that range.",
        ),
        (
            lambda: ds.Material(n_s=((1, 2, 3),)),
            ValueError,
            "Material.n_s must be 1 or 3 numbers; got shape (1, 3). Give one number, or one a channel (R, G, B).",
        ),
        (
            lambda: ds.Material(k_s=(0.5, -0.1, 0)),
            ValueError,
            "Material.k_s must be at least 0; got (0.5, -0.1, 0). Give a value in that range.",
        ),
        (
            lambda: ds.SpotLight((0, 0, 1), (0, 0, -1), cutoff=91),
            ValueError,
            "SpotLight.cutoff must be between 0 and 90; got 91. Give a value in that range.",
        ),
        (
            lambda: ds.Material(k_d=jnp.array([0.1, -0.2, 0.3])),
            ValueError,
            "Material.k_d must be at least 0; got (0.1, -0.2, 0.3). Give a value in that range.",
        ),
    ],
)
def test_a_bad_value_is_one_sentence(make, error, message):
    with pytest.raises(error, match=f"^{escape(message)}$"):
        make()


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda value: ds.Sphere(radius=value), "Sphere.radius"),
        (lambda value: ds.RadialAttenuation(linear=value), "RadialAttenuation.linear"),
        (lambda value: ds.SpotLight((0, 0, 1), (0, 0, -1), cutoff=value), "SpotLight.cutoff"),
        (lambda value: ds.Camera((0, 0, 4), fov=value), "Camera.fov"),
        (lambda value: ds.OrthographicCamera((0, 0, 4), height=value), "OrthographicCamera.height"),
    ],
)
def test_a_class_with_checks_of_its_own_says_the_same(make, name):
    for value, error, shown in (("wide", TypeError, "'wide'"), ((1, 2), ValueError, "shape (2,)")):
        message = f"{name} must be a number; got {shown}. Give one number."
        with pytest.raises(error, match=f"^{escape(message)}$"):
            make(value)


@pytest.mark.parametrize("value", ["here", (1, 2), ((1, 2, 3),)])
def test_the_eye_of_a_camera_is_a_vector(value):
    with pytest.raises((TypeError, ValueError), match=r"^Camera\.eye must be a vector of 3 numbers; got"):
        ds.Camera(value)


# What the type checks of these tests would catch first, in a session like a user's, which has none.
UNTYPED = {
    "ds.Material(k_d=None)": (
        "Material.k_d must be a colour of 1 or 3 numbers; got None. Give one number (grey) or three (R, G, B)."
    ),
    "ds.Material(n_s={'r': 1})": (
        "Material.n_s must be 1 or 3 numbers; got {'r': 1}. Give one number, or one a channel (R, G, B)."
    ),
    "ds.Material(lobe=ds.Blinn)": "Material.lobe must be a Lobe; got the class Blinn. Give for example Phong().",
    "ds.Object(ds.Material())": "Object.surface must be a Surface; got Material. Give for example Sphere(radius=1).",
    "ds.Object(ds.Sphere(), 0.7)": "Object.material must be a Material; got float. Give for example Material(k_d=0.7).",
    "ds.PointLight((1, 2, 3), attenuation=(1, 0, 1))": (
        "PointLight.attenuation must be a RadialAttenuation; got tuple. Give for example RadialAttenuation(1, 0, 0)."
    ),
    "ds.SpotLight((1, 2, 3), (0, 0, -1), attenuation=1)": (
        "SpotLight.attenuation must be a RadialAttenuation; got int. Give for example RadialAttenuation(1, 0, 0)."
    ),
    **{
        f"ds.Camera((0, 0, 4), shape={shape})": (
            f"Camera.shape must be (height, width) in pixels, two whole numbers above 0; got {shape}. "
            "Give the image's shape[:2]."
        )
        for shape in ("8", "'8x10'", "(8, 1.5)", "(8, nan)", "(8, inf)")
    },
    "ds.Camera((0, 0, 4), shape=(8.0, array([10])[0])).shape": "(8, 10)",
    "ds.Camera((0, 0, 4), shape=array([8, 10])).shape": "(8, 10)",
}
SESSION = """
import json, sys
from numpy import array, inf, nan
import diffshade as ds
found = []
for line in json.load(sys.stdin):
    try:
        found.append(repr(eval(line)))
    except Exception as error:
        found.append(str(error))
json.dump(found, sys.stdout)
"""


def test_the_sentences_without_type_checks():
    lines = json.dumps(list(UNTYPED))
    session = subprocess.run([sys.executable, "-c", SESSION], input=lines, capture_output=True, text=True, check=True)
    assert dict(zip(UNTYPED, json.loads(session.stdout), strict=True)) == UNTYPED


RANGES = {
    "k_a": ds.Material,
    "k_d": ds.Material,
    "k_s": ds.Material,
    "n_s": ds.Material,
    "constant": ds.RadialAttenuation,
    "linear": ds.RadialAttenuation,
    "quadratic": ds.RadialAttenuation,
}


@pytest.mark.parametrize(("name", "cls"), RANGES.items(), ids=RANGES)
def test_no_number_of_these_is_negative(name, cls):
    with pytest.raises(ValueError, match=rf"^{cls.__name__}\.{name} must be at least 0; got .*-0\.1"):
        cls(**{name: -0.1})


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("intensity", lambda x: ds.SpotLight((0, 0, 1), (0, 0, -1), intensity=x)),
        ("cutoff", lambda x: ds.SpotLight((0, 0, 1), (0, 0, -1), cutoff=x)),
        ("exponent", lambda x: ds.SpotLight((0, 0, 1), (0, 0, -1), exponent=x)),
        ("softness", lambda x: ds.SpotLight((0, 0, 1), (0, 0, -1), softness=x)),
    ],
)
def test_no_number_of_a_spot_is_negative(name, make):
    with pytest.raises(ValueError, match=rf"^SpotLight\.{name} must be (at least|between) 0.*; got .*-0\.1"):
        make(-0.1)


@pytest.mark.parametrize("name", ["ambient", "background"])
def test_no_number_of_a_scene_is_negative(name):
    with pytest.raises(ValueError, match=rf"^Scene\.{name} must be at least 0; got .*-0\.1"):
        dataclasses.replace(ds.Scene(ds.Object(ds.Sphere())), **{name: -0.1})


def material_of(scene):
    return scene.objects[0].material


def test_check_finds_what_tree_at_put_in():
    scene = ds.Scene(ds.Object(ds.Sphere()), ds.PointLight((1, 2, 3)))
    check((scene,))
    bad = eqx.tree_at(lambda s: material_of(s).k_d, scene, np.array([0.1, 0.2]))
    with pytest.raises(ValueError, match=r"^Material\.k_d must be a colour of 1 or 3 numbers; got shape \(2,\)\."):
        check((bad,))
    bad = jax.tree.map(lambda leaf: np.asarray(-leaf), scene)
    with pytest.raises(ValueError, match="must be at least 0"):
        check(bad)
    bad = eqx.tree_at(lambda s: s.lights[0].attenuation, scene, ds.RadialAttenuation())
    bad = eqx.tree_at(lambda s: s.lights[0].attenuation.constant, bad, np.array(0.0))
    with pytest.raises(ValueError, match=r"^RadialAttenuation needs one of"):
        check(bad)


@pytest.mark.parametrize("number", [50.0, np.float64(50)])
def test_check_takes_the_numbers_that_tree_map_and_tree_at_leave(number):
    """Arithmetic on a 0-dimensional array gives np.float64, and tree_at keeps a Python number."""
    scene = ds.Scene(ds.Object(ds.Sphere()))
    check(eqx.tree_at(lambda s: material_of(s).n_s, scene, number))


def test_tracers_pass():
    @jax.jit
    def negative(k):
        assert not is_concrete(1.0, k)
        return ds.Material(k_d=-k, n_s=-k).k_d

    assert is_concrete(1.0, np.ones(3), jnp.ones(3))
    np.testing.assert_array_equal(negative(0.5), [-0.5, -0.5, -0.5])
    assert np.isfinite(jax.grad(lambda r: ds.Sphere(radius=r).radius ** 2)(1.0))


def test_quantities_are_named_by_their_paths():
    scene = ds.Scene(
        [ds.Object(ds.Sphere()), ds.Object(ds.GBuffer(np.ones((1, 1, 3)) / np.sqrt(3), np.zeros((1, 1, 3))))],
        [ds.DirectionalLight((1, 0, 0)), ds.SpotLight((0, 0, 1), (0, 0, -1))],
    )
    names = [name for name, _, _ in quantities(scene)]
    material = ["k_a", "k_d", "k_s", "n_s", "k_e"]
    spot = ["position", "direction", "intensity", "cutoff", "exponent"]
    attenuation = ["constant", "linear", "quadratic"]
    assert names == [
        *(f"objects.0.surface.{name}" for name in ("center", "radius")),
        *(f"objects.0.material.{name}" for name in material),
        *(f"objects.1.material.{name}" for name in material),
        *(f"lights.0.{name}" for name in ("direction", "intensity")),
        *(f"lights.1.{name}" for name in (*spot, *(f"attenuation.{a}" for a in attenuation), "softness")),
        "ambient",
        "background",
    ]
    _, value, field = next(q for q in quantities(scene) if q[0] == "lights.1.cutoff")
    assert value == 45
    assert (field.metadata["lower"], field.metadata["upper"]) == (0, 90)


@pytest.mark.parametrize(
    ("word", "sentence"),
    [
        ("kd", "Did you mean 'k_d'?"),
        ("intensty", "Did you mean 'intensity'?"),
        ("xyzzy", "Known names: intensity, k_d, k_s."),
    ],
)
def test_did_you_mean(word, sentence):
    assert did_you_mean(word, ["k_s", "k_d", "intensity", "k_d"]) == sentence
