"""What people type becomes NumPy float64 of one shape; what cannot is refused in one sentence."""

from re import escape

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from public_names import PUBLIC
from refusals import untyped

import diffshade as ds
from diffshade.core.fields import (
    Checked,
    Scalar,
    Vector,
    as_array,
    as_colour,
    as_scalar,
    as_vector,
    check,
    is_concrete,
    parameter,
    quantities,
)
from diffshade.core.words import did_you_mean


@pytest.mark.parametrize("value", [0.1, 40, True, (0.1, 2, 3), [1, 2], np.float32(0.5), np.arange(3), np.ones((2, 3))])
def test_numbers_become_float64(value):
    array = as_array(value)
    assert type(array) is np.ndarray
    assert array.dtype == np.float64
    np.testing.assert_array_equal(array, value)


def test_a_jax_array_stays_one_and_an_array_of_numpy_is_copied():
    value = jnp.array([0.1, 0.2, 0.3])
    assert as_array(value) is value
    assert as_colour(value) is value
    assert ds.Material(k_d=value).k_d is value
    assert jnp.issubdtype(as_array(jnp.arange(3)).dtype, jnp.floating)
    k_d = np.array([0.1, 0.2, 0.3])
    material = ds.Material(k_d=k_d)
    k_d[:] = 9  # a later edit does not reach a frozen scene
    np.testing.assert_array_equal(material.k_d, [0.1, 0.2, 0.3])


@pytest.mark.parametrize("grey", [0.7, (0.7,), [0.7], np.array(0.7), np.array([0.7]), jnp.array(0.7), jnp.array([0.7])])
def test_one_number_is_grey(grey):
    colour = as_colour(grey)
    assert isinstance(colour, jax.Array) == isinstance(grey, jax.Array)
    assert colour.dtype == np.float64
    np.testing.assert_array_equal(colour, [0.7, 0.7, 0.7])


COLOUR = "Material.k_d must be a colour of 1 or 3 numbers; got {}. Give one number (grey), three (R, G, B)"
EXPONENT = "Material.n_s must be 1 or 3 numbers; got {}. Give one number, three (R, G, B)"
PLACE = "PointLight.position must be a vector of 3 numbers; got {}. Give three numbers (x, y, z)."
SPOT = "SpotLight((0, 0, 1), (0, 0, -1), "
BAD = {
    "Material(k_d=())": (ValueError, COLOUR.format("shape (0,)")),
    "Material(k_d='red')": (TypeError, COLOUR.format("'red'")),
    "Material(k_d=1j)": (TypeError, COLOUR.format("1j")),
    "Material(n_s=())": (ValueError, EXPONENT.format("shape (0,)")),
    "Material(k_d=np.ones((4, 5, 2, 1)))": (ValueError, COLOUR.format("shape (4, 5, 2, 1)")),
    "Material(k_d=np.full((4, 5), -0.5))": (
        ValueError,
        "Material.k_d must be at least 0; got -0.5 at row 0, column 0.",
    ),
    "Material(n_s=np.full((4, 5), np.nan))": (ValueError, "Material.n_s must be finite; got nan at row 0, column 0."),
    "Material(normal=np.ones((4, 5, 3)))": (ValueError, "Material.normal must hold unit vectors; at row 0, column 0"),
    "Material(normal=(0, 0, 1))": (ValueError, "Material.normal must be an array (H, W, 3); got shape (3,)."),
    "Texture((1, 2, 3))": (ValueError, "Texture.values must be an image (H, W) or (H, W, 3); got shape (3,)."),
    "PointLight((1, 2))": (ValueError, PLACE.format("shape (2,)")),
    "PointLight(((1, 2), (3,)))": (TypeError, PLACE.format("((1, 2), (3,))")),
    "PointLight(5)": (ValueError, PLACE.format("shape ()")),
    "Sphere((0, nan, 0))": (ValueError, "Sphere.center must be finite; got (0, nan, 0). Give three numbers (x, y, z)."),
    "Material(n_s=inf)": (ValueError, "Material.n_s must be finite; got inf. Give one number, three"),
    "Material(n_s=-1)": (ValueError, "Material.n_s must be at least 0; got -1. Give a value in that range."),
    "Material(n_s=(1, -2, 3))": (ValueError, "Material.n_s must be at least 0; got (1, -2, 3)."),
    "Material(k_s=(0.5, -0.1, 0))": (ValueError, "Material.k_s must be at least 0; got (0.5, -0.1, 0)."),
    "Material(k_d=jax([0.1, -0.2, 0.3]))": (ValueError, "Material.k_d must be at least 0; got (0.1, -0.2, 0.3)."),
    f"{SPOT}cutoff=91)": (ValueError, "SpotLight.cutoff must be between 0 and 90; got 91. Give a value in that range."),
    "Camera('here')": (TypeError, "Camera.eye must be a vector of 3 numbers; got 'here'"),
    "Camera((1, 2))": (ValueError, "Camera.eye must be a vector of 3 numbers; got shape (2,)"),
}
NONE_BELOW_0 = {
    "Material(": ("k_a", "k_d", "k_s", "k_e", "n_s"),
    "RadialAttenuation(": ("constant", "linear", "quadratic"),
    SPOT: ("intensity", "cutoff", "exponent", "softness"),
    "Scene(Object(Sphere()), ": ("ambient", "background"),
}
ONE_NUMBER = {
    "Sphere(": "radius",
    "RadialAttenuation(": "linear",
    SPOT: "cutoff",
    "Camera((0, 0, 4), ": "fov",
    "OrthographicCamera((0, 0, 4), ": "height",
}
UNTYPED = {  # what type checks around every call would catch first
    "Material(k_d=None)": COLOUR.format("None"),
    "Material(n_s={'r': 1})": EXPONENT.format("{'r': 1}"),
    "Material(lobe=Blinn)": "Material.lobe must be a Reflectance; got the class Blinn. Give for example Phong().",
    "Object(Material())": "Object.surface must be a Surface; got Material. Give for example Sphere(radius=1).",
    "Object(Sphere(), 0.7)": "Object.material must be a Material; got float. Give for example Material(k_d=0.7).",
    "PointLight((1, 2, 3), attenuation=(1, 0, 1))": "PointLight.attenuation must be an Attenuation; got tuple.",
    f"{SPOT}attenuation=1)": "SpotLight.attenuation must be an Attenuation; got int.",
    f"{SPOT}flaps=(0, 1))": "SpotLight.flaps must be a Flaps; got tuple. Give for example Flaps(x_min=-1, x_max=1).",
    "material('merl_brass', lobe=Brushed())": "the lobe must be Phong() or Blinn(); got a Brushed. Use with_lobe for",
    "Scene(Object(Sphere()), shadows=1)": "Scene.shadows must be True or False; got 1. Give one of the two.",
    **{
        f"Camera((0, 0, 4), shape={shape})": "Camera.shape must be (height, width) in pixels, two whole numbers above "
        f"0; got {shape}. Give the image's shape[:2]."
        for shape in ("8", "'8x10'", "(8, 1.5)", "(8, nan)", "(8, inf)")
    },
}


def made(call):
    return eval(call, PUBLIC | {"nan": np.nan, "inf": np.inf, "jax": jnp.array, "np": np})


@pytest.mark.parametrize("call", BAD)
def test_a_bad_value_is_one_sentence(call):
    error, message = BAD[call]
    with pytest.raises(error, match=f"^{escape(message)}"):
        made(call)


@pytest.mark.parametrize("cls", NONE_BELOW_0)
def test_no_number_of_these_is_negative(cls):
    for name in NONE_BELOW_0[cls]:
        message = rf"^{cls.partition('(')[0]}\.{name} must be (at least|between) 0.*; got .*-0\.1"
        with pytest.raises(ValueError, match=message):
            made(f"{cls}{name}=-0.1)")
        np.testing.assert_array_equal(getattr(made(f"{cls}{name}=0.25)"), name), 0.25)


@pytest.mark.parametrize("cls", ONE_NUMBER)
def test_a_class_with_checks_of_its_own_says_the_same(cls):
    name = ONE_NUMBER[cls]
    for value, error, shown in (("'wide'", TypeError, "'wide'"), ("(1, 2)", ValueError, "shape (2,)")):
        message = f"{cls.partition('(')[0]}.{name} must be a number; got {shown}. Give one number."
        with pytest.raises(error, match=f"^{escape(message)}$"):
            made(f"{cls}{name}={value})")


@untyped
@pytest.mark.parametrize("call", UNTYPED)
def test_what_is_of_the_wrong_type_is_one_sentence(call):
    with pytest.raises((TypeError, ValueError), match=f"^{escape(UNTYPED[call])}"):
        made(call)


@untyped
def test_the_shape_of_a_camera_may_be_of_whole_floats():
    for shape in ("(8.0, jax([10])[0])", "jax([8, 10])"):
        assert made(f"Camera((0, 0, 4), shape={shape})").shape == (8, 10)


def material_of(scene):
    return scene.objects[0].material


def test_check_finds_what_tree_at_put_in():
    scene = ds.Scene(ds.Object(ds.Sphere()), ds.PointLight((1, 2, 3)))
    check((scene,))
    bad = eqx.tree_at(lambda s: material_of(s).k_d, scene, np.array([0.1, 0.2]))
    with pytest.raises(
        ValueError, match=r"^objects\.0\.material\.k_d has 2 numbers, but a scene without bands has red"
    ):
        check((bad,))
    bad = jax.tree.map(lambda leaf: np.asarray(-leaf), scene)
    with pytest.raises(ValueError, match="must be at least 0"):
        check(bad)
    bad = eqx.tree_at(lambda s: s.lights[0].attenuation, scene, ds.RadialAttenuation())
    bad = eqx.tree_at(lambda s: s.lights[0].attenuation.constant, bad, np.array(0.0))
    with pytest.raises(ValueError, match=r"^RadialAttenuation needs one of"):
        check(bad)
    for number in (50.0, np.float64(50)):  # what arithmetic on the leaves and tree_at leave
        check(eqx.tree_at(lambda s: material_of(s).n_s, scene, number))


def test_tracers_pass():
    @jax.jit
    def negative(k):
        assert not is_concrete(1.0, k)
        return ds.Material(k_d=-k, n_s=-k).k_d

    assert is_concrete(1.0, np.ones(3), jnp.ones(3))
    np.testing.assert_array_equal(negative(0.5), [-0.5, -0.5, -0.5])
    assert np.isfinite(jax.grad(lambda r: ds.Sphere(radius=r).radius ** 2)(1.0))


def test_quantities_come_with_the_keys_that_lead_to_them():
    scene = ds.Scene(
        [ds.Object(ds.Sphere()), ds.Object(ds.GBuffer(np.ones((1, 1, 3)) / np.sqrt(3), np.zeros((1, 1, 3))))],
        [ds.DirectionalLight((1, 0, 0)), ds.SpotLight((0, 0, 1), (0, 0, -1))],
    )
    names = [".".join(map(str, keys)) for keys, _, _ in quantities(scene)]
    material = ["k_a", "k_d", "k_s", "n_s", "k_e"]
    of_spot = ["position", "direction", "intensity", "cutoff", "exponent"]
    attenuation = ["constant", "linear", "quadratic"]
    assert names == [
        *(f"objects.0.surface.{name}" for name in ("center", "radius")),
        *(f"objects.0.material.{name}" for name in material),
        *(f"objects.1.material.{name}" for name in material),
        *(f"lights.0.{name}" for name in ("direction", "intensity")),
        *(f"lights.1.{name}" for name in (*of_spot, *(f"attenuation.{a}" for a in attenuation), "softness")),
        "ambient",
        "background",
    ]
    _, value, field = next(q for q in quantities(scene) if q[0] == ("lights", 1, "cutoff"))
    assert value == 45
    assert (field.metadata["lower"], field.metadata["upper"]) == (0, 90)


def test_did_you_mean():
    names = ["k_s", "k_d", "intensity", "k_d"]
    assert did_you_mean("kd", names) == "Did you mean 'k_d'?"
    assert did_you_mean("intensty", names) == "Did you mean 'intensity'?"
    assert did_you_mean("xyzzy", [*names, "a.path", "*"]) == "Known names: intensity, k_d, k_s."


def test_open_ends_and_directions_are_said_by_the_field():
    class Part(Checked):
        size: Scalar = eqx.field(converter=as_scalar, default=1.0, metadata={"above": 0, "below": 2})
        along: Vector = eqx.field(converter=as_vector, default=(1.0, 0.0, 0.0), metadata=parameter("direction"))

    Part(size=1e-9, along=(0, 0, 1e-9))
    for size in (0, -1, 2, np.nan, np.inf):
        with pytest.raises(ValueError, match=r"Part\.size must be (above 0 and below 2|finite); got"):
            Part(size=size)
    with pytest.raises(
        ValueError, match=r"Part\.along must not be the zero vector; got \[0, 0, 0\]\. Give a direction"
    ):
        Part(along=(0, 0, 0))
    jax.jit(lambda size: Part(size=size).size)(0.0)  # tracers pass


def test_it_prints_its_numbers_as_they_are_typed():
    lamp = ds.PointLight((1, 2, 3), 2.0, ds.RadialAttenuation(1.0, 0.1, 0.5))
    assert "position=(1.0, 2.0, 3.0)" in str(lamp)
    assert "RadialAttenuation(constant=1.0, linear=0.1, quadratic=0.5)" in str(lamp)
    single = jax.tree.map(lambda number: jnp.asarray(number, jnp.float32), lamp.attenuation)
    assert repr(single) == repr(lamp.attenuation)
    assert "k_d=f64[4,4,3](numpy)" in str(ds.Material(k_d=np.ones((4, 4, 3))))
    said = []
    jax.jit(lambda law: (said.append(str(law)), law.linear)[1])(lamp.attenuation)
    assert "linear=f" in said[0]
