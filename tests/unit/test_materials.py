"""Materials and the cosine of each highlight."""

from re import escape

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffshade as ds
from diffshade.reflection import reflectance as reflectance_of
from diffshade.vectors import Vec3


def degrees(angle):
    """A unit vector in the x-z plane, so many degrees off z, towards x."""
    return Vec3(jnp.sin(jnp.deg2rad(angle)), jnp.array(0.0), jnp.cos(jnp.deg2rad(angle)))


N = degrees(0.0)


def reflectance(material, n, l, v):
    """Of a material without patterns, as compiled programs see it."""
    compiled = jax.jit(lambda m: reflectance_of(m.at(None), m.lobe, m.fresnel, n, l, v).stack())
    return compiled(material)


def test_what_is_not_given_is_not_there():
    material = ds.Material()
    for k in (material.k_a, material.k_d, material.k_s):
        np.testing.assert_array_equal(k, [0, 0, 0])
    assert material.n_s == 10
    assert isinstance(material.lobe, ds.Phong)


def test_grey_and_coloured():
    material = ds.Material(k_d=0.7, k_s=(0.1, 0.2, 0.3), n_s=40, lobe=ds.Blinn())
    np.testing.assert_array_equal(material.k_d, [0.7, 0.7, 0.7])
    np.testing.assert_array_equal(material.k_s, [0.1, 0.2, 0.3])
    assert material.n_s.dtype == np.float64


def test_the_cosines_of_the_highlights():
    l, v = degrees(50.0), degrees(-20.0)
    np.testing.assert_allclose(ds.Phong().cosine(N, l, v), np.cos(np.deg2rad(30)), rtol=1e-14)
    np.testing.assert_allclose(ds.Blinn().cosine(N, l, v), np.cos(np.deg2rad(15)), rtol=1e-14)


# cos^n of the angle between v and r, as every lecture's table has it
@pytest.mark.parametrize(
    ("angle", "n_s", "value"),
    [
        (0, 27, 1),
        (60, 1, 0.5),
        (60, 2, 0.25),
        (60, 10, 2**-10),
        (45, 4, 0.25),
        (45, 8, 0.0625),
        (30, 2, 0.75),
        (30, 200, 0.75**100),
        (100, 3, 0),
        (100, 0, 0),
        (60, 0, 1),
    ],
)
def test_the_highlight_is_a_power_of_a_cosine(angle, n_s, value):
    l = degrees(40.0)
    v = degrees(-40.0 + angle)  # r is at -40
    found = reflectance(ds.Material(k_s=(1, 0.5, 0), n_s=n_s), N, l, v)
    np.testing.assert_allclose(found, [value, 0.5 * value, 0], rtol=1e-12, atol=1e-15)
    # about the halfway vector the angle is half as large
    v = degrees(-40.0 + 2 * angle)
    found = reflectance(ds.Material(k_s=(1, 0.5, 0), n_s=n_s, lobe=ds.Blinn()), N, l, v)
    if angle < 90:
        np.testing.assert_allclose(found, [value, 0.5 * value, 0], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("lobe", [ds.Phong(), ds.Blinn()])
def test_no_highlight_without_light_from_the_front(lobe):
    material = ds.Material(k_d=0.5, k_s=1, n_s=1, lobe=lobe)
    found = reflectance(material, N, degrees(100.0), degrees(-80.0))  # v.r = cos 0 = 1, n.h = cos 80
    np.testing.assert_array_equal(found, [0, 0, 0])
    assert (reflectance(material, N, degrees(89.0), degrees(-80.0)) > 0.01).all()


def test_the_diffuse_term_is_the_cosine():
    found = reflectance(ds.Material(k_d=(0.8, 0.4, 0.2)), N, degrees(60.0), degrees(10.0))
    np.testing.assert_allclose(found, [0.4, 0.2, 0.1], rtol=1e-14)


SEEN = ds.Camera(eye=(0, 0, 4), fov=32, shape=(12, 12))


@pytest.mark.parametrize("lobe", [ds.Phong(), ds.Blinn()])
def test_one_exponent_a_channel_renders_each_channel_as_that_exponent_alone_does(lobe):
    def image(n_s):
        material = ds.Material(0.1, (0.6, 0.4, 0.2), (0.5, 0.4, 0.3), n_s, lobe=lobe)
        return np.asarray(ds.render(ds.Scene(ds.Object(ds.Sphere(), material), ds.PointLight((1, 2, 4))), SEEN))

    exponents = (3.0, 20.0, 90.0)
    alone = [image(n_s) for n_s in exponents]
    np.testing.assert_allclose(image((20.0, 20.0, 20.0)), alone[1], rtol=1e-13)
    np.testing.assert_allclose(image(exponents), np.stack([alone[c][..., c] for c in range(3)], -1), rtol=1e-13)
    assert np.abs(alone[0] - alone[2]).max() > 0.1  # they could be told apart


def test_foleys_form_is_a_product_in_each_channel():
    material = ds.Material.foley(
        O_d=(0.9, 0.5, 0.1), O_s=(1, 0.8, 0.6), k_a=0.2, k_d=(0.5, 0.6, 0.7), k_s=0.5, n_s=7, lobe=ds.Blinn(), k_t=0.3
    )
    np.testing.assert_allclose(material.k_a, [0.18, 0.1, 0.02], rtol=1e-14)
    np.testing.assert_allclose(material.k_d, [0.45, 0.3, 0.07], rtol=1e-14)
    np.testing.assert_allclose(material.k_s, [0.5, 0.4, 0.3], rtol=1e-14)
    np.testing.assert_array_equal(material.k_t, [0.3, 0.3, 0.3])
    assert (float(material.n_s), material.lobe) == (7, ds.Blinn())
    grey = ds.Material.foley(O_d=0.5, k_d=0.4, k_s=0.3)  # white highlights
    np.testing.assert_allclose([grey.k_d, grey.k_s], [[0.2] * 3, [0.3] * 3], rtol=1e-14)


def test_no_transmission_emission_or_fresnel_unless_given():
    material = ds.Material()
    assert material.k_t is None
    assert isinstance(material.fresnel, ds.NoFresnel)
    assert material.eta is None
    np.testing.assert_array_equal(material.k_e, [0, 0, 0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"k_s": 0.5, "fresnel": ds.Dielectric(), "eta": 1.5},
            "Material.k_s must not be given beside fresnel=Dielectric(), whose W follows from eta; got (0.5, 0.5, "
            "0.5). Leave k_s out, or use Schlick().",
        ),
        ({"k_t": 1.1}, "Material.k_t must be between 0 and 1; got (1.1, 1.1, 1.1). Give a value in that range."),
        ({"k_t": -0.1}, "Material.k_t must be between 0 and 1; got (-0.1, -0.1, -0.1). Give a value in that range."),
        (
            {"fresnel": ds.Dielectric()},
            "Material.eta must be given with fresnel=Dielectric(); got None. Give for example eta=1.5.",
        ),
        ({"eta": 0}, "Material.eta must be between 0.1 and 10; got 0. Give a value in that range."),
        ({"k_e": -1}, "Material.k_e must be at least 0; got (-1, -1, -1). Give a value in that range."),
    ],
)
def test_a_material_that_is_none(options, message):
    with pytest.raises(ValueError, match=f"^{escape(message)}$"):
        ds.Material(**options)


def test_a_pattern_beside_a_dielectric():
    with pytest.raises(ValueError, match=r"^Material\.k_s must not be given beside fresnel=Dielectric\(\), whose W"):
        ds.Material(k_s=ds.Chequer(0.1, 0.9), fresnel=ds.Dielectric())


@pytest.mark.parametrize(
    ("colours", "message"),
    [
        ({"O_d": (1, 2)}, "Material.foley's O_d must be a colour of 1 or 3 numbers; got shape (2,)."),
        ({"O_d": "red"}, "Material.foley's O_d must be a colour of 1 or 3 numbers; got 'red'."),
        ({"O_d": 1, "k_a": -1}, "Material.foley's k_a must be at least 0; got (-1, -1, -1)."),
    ],
)
def test_a_colour_of_foleys_that_is_none(colours, message):
    with pytest.raises((TypeError, ValueError), match=f"^{escape(message)}"):
        ds.Material.foley(**colours, k_d=0.5)
