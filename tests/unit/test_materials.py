"""Materials, those with a name among them, and the cosine of each highlight."""

import re
from re import escape

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffshade as ds
from diffshade.model.reflection import reflectance as reflectance_of
from diffshade.model.vectors import Vec3


def degrees(angle):
    """A unit vector in the x-z plane, so many degrees off z, towards x."""
    angle = jnp.asarray(angle, float)
    return Vec3(jnp.sin(jnp.deg2rad(angle)), jnp.zeros_like(angle), jnp.cos(jnp.deg2rad(angle)))


N = degrees(0.0)


@jax.jit
def reflectance(material, l, v):
    """Of a material without patterns, as compiled programs see it, at one point or many."""
    normal = Vec3(*(jnp.broadcast_to(x, jnp.shape(l.x)) for x in (N.x, N.y, N.z)))
    return reflectance_of(material, material.at(None), normal, l, v).stack()


def test_what_is_not_given_is_not_there_and_grey_is_a_colour():
    material = ds.Material()
    for k in (material.k_a, material.k_d, material.k_s, material.k_e):
        np.testing.assert_array_equal(k, [0, 0, 0])
    assert (material.n_s, material.k_t, material.eta) == (10, None, None)
    assert isinstance(material.lobe, ds.Phong)
    assert isinstance(material.fresnel, ds.NoFresnel)
    material = ds.Material(k_d=0.7, k_s=(0.1, 0.2, 0.3), n_s=40, lobe=ds.Blinn())
    np.testing.assert_array_equal(material.k_d, [0.7, 0.7, 0.7])
    np.testing.assert_array_equal(material.k_s, [0.1, 0.2, 0.3])
    assert material.n_s.dtype == np.float64


def test_the_cosines_of_the_highlights():
    l, v = degrees(50.0), degrees(-20.0)
    np.testing.assert_allclose(ds.Phong().cosine(N, l, v), np.cos(np.deg2rad(30)), rtol=1e-14)
    np.testing.assert_allclose(ds.Blinn().cosine(N, l, v), np.cos(np.deg2rad(15)), rtol=1e-14)


@pytest.mark.parametrize("lobe", [ds.Phong(), ds.Blinn()])
def test_the_highlight_is_a_power_of_a_cosine(lobe):
    """cos^n of the angle between v and r, as every lecture's table has it; about h the angle is half as large."""
    table = {27: [(0, 1)], 1: [(60, 0.5)], 2: [(60, 0.25), (30, 0.75)], 10: [(60, 2**-10)], 4: [(45, 0.25)]}
    table |= {8: [(45, 0.0625)], 200: [(30, 0.75**100)], 3: [(100, 0)], 0: [(100, 0), (60, 1)]}
    is_blinn = isinstance(lobe, ds.Blinn)
    for n_s, rows in table.items():
        for angle, value in rows:
            if angle < 90 or not is_blinn:
                v = degrees(-40.0 + angle * (1 + is_blinn))  # r is at -40
                found = reflectance(ds.Material(k_s=(1, 0.5, 0), n_s=n_s, lobe=lobe), degrees(40.0), v)
                np.testing.assert_allclose(found, [value, 0.5 * value, 0], rtol=1e-12, atol=1e-15)
    material = ds.Material(k_d=0.5, k_s=1, n_s=1, lobe=lobe)  # none without light from the front
    found = reflectance(material, degrees(100.0), degrees(-80.0))  # v.r = cos 0 = 1, n.h = cos 80
    np.testing.assert_array_equal(found, [0, 0, 0])
    assert (reflectance(material, degrees(89.0), degrees(-80.0)) > 0.01).all()
    found = reflectance(ds.Material(k_d=(0.8, 0.4, 0.2), lobe=lobe), degrees(60.0), degrees(10.0))
    np.testing.assert_allclose(found, [0.4, 0.2, 0.1], rtol=1e-14)  # the diffuse term is the cosine
    a_channel = ds.Material(k_s=(0.5, 0.4, 0.3), n_s=(3.0, 20.0, 90.0), lobe=lobe)
    found = reflectance(a_channel, degrees(40.0), degrees(-20.0))
    cosine = np.cos(np.deg2rad(10.0 if is_blinn else 20.0))
    np.testing.assert_allclose(found, [0.5 * cosine**3, 0.4 * cosine**20, 0.3 * cosine**90], rtol=1e-12)


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


BESIDE = "Material.k_s must not be given beside fresnel=Dielectric(), whose W follows from eta; got "
NONE = [
    (
        {"k_s": 0.5, "fresnel": ds.Dielectric(), "eta": 1.5},
        f"{BESIDE}(0.5, 0.5, 0.5). Leave k_s out, or use Schlick().",
    ),
    ({"k_s": ds.Chequer(0.1, 0.9), "fresnel": ds.Dielectric()}, f"{BESIDE}a Chequer."),
    ({"k_t": 1.1}, "Material.k_t must be between 0 and 1; got (1.1, 1.1, 1.1). Give a value in that range."),
    ({"k_t": -0.1}, "Material.k_t must be between 0 and 1; got (-0.1, -0.1, -0.1)."),
    ({"fresnel": ds.Dielectric()}, "Material.eta must be given with fresnel=Dielectric(); got None. Give for example"),
    ({"eta": 0}, "Material.eta must be between 0.1 and 10; got 0. Give a value in that range."),
    ({"eta": 10.1}, "Material.eta must be between 0.1 and 10; got 10.1."),
    ({"O_d": ()}, "Material.foley's O_d must be a colour of 1 or 3 numbers; got shape (0,)."),
    ({"O_d": "red"}, "Material.foley's O_d must be a colour of 1 or 3 numbers; got 'red'."),
    ({"O_d": 1, "k_a": -1}, "Material.foley's k_a must be at least 0; got (-1, -1, -1)."),
]


@pytest.mark.parametrize(("options", "message"), NONE)
def test_a_material_that_is_none(options, message):
    with pytest.raises((TypeError, ValueError), match=f"^{escape(message)}"):
        (ds.Material.foley if "O_d" in options else ds.Material)(**options)


# From teapots.c of the OpenGL Programming Guide; n_s is 128 times 0.6, 0.4, 0.25 and 0.078125.
NAMED = {
    "emerald": ((0.0215, 0.1745, 0.0215), (0.07568, 0.61424, 0.07568), (0.633, 0.727811, 0.633), 76.8),
    "gold": ((0.24725, 0.1995, 0.0745), (0.75164, 0.60648, 0.22648), (0.628281, 0.555802, 0.366065), 51.2),
    "red_plastic": ((0, 0, 0), (0.5, 0, 0), (0.7, 0.6, 0.6), 32),
    "black_rubber": ((0.02, 0.02, 0.02), (0.01, 0.01, 0.01), (0.4, 0.4, 0.4), 10),
}


def test_materials_by_name():
    names = ds.material_names()
    assert len(names) == len(set(names)) == 24
    assert {"emerald", "jade", "pearl", "gold", "cyan_plastic", "yellow_rubber"} <= set(names)
    for name in names:
        material = ds.material(name)
        assert isinstance(material.lobe, ds.Blinn)
        assert 10 <= material.n_s <= 76.8
        assert material.k_t is None
    for name, (k_a, k_d, k_s, n_s) in NAMED.items():
        material = ds.material(name)
        np.testing.assert_array_equal([material.k_a, material.k_d, material.k_s], [k_a, k_d, k_s])
        np.testing.assert_allclose(material.n_s, n_s, rtol=1e-12)
    for name, said in (
        ("emrald", r"Did you mean 'emerald'\?"),
        ("Gold", r"Did you mean 'gold'\?"),
        ("black rubber", r"Did you mean 'black_rubber'\?"),
        ("xyz", r"Known names: black_plastic, .*, yellow_rubber\."),
    ):
        with pytest.raises(ValueError, match=rf"^no material is named '{name}'\. {said}$"):
            ds.material(name)


def test_measured_materials_are_near_their_measurements():
    """The stated error is that of the ABC model, over points that the fit did not see."""
    names = ds.measured_material_names()
    assert len(names) == len(set(names)) == 100
    assert not set(names) & set(ds.material_names())
    for name in names[::4]:
        given = [(lobe, number) for lobe in (ds.Phong(), ds.Blinn(), None) for number in (1, 2)]
        found = {
            (of, n): (ds.material(name, lobe=of, highlights=n), ds.exchange.material_error(name, lobe=of, highlights=n))
            for of, n in given
        }
        for (lobe, number), (material, error) in found.items():
            assert type(material.lobe) in ((type(lobe),) if lobe else (ds.Phong, ds.Blinn))
            assert len(material.highlights) < number
            assert 0 < error.rms < error.largest
            assert error.rms <= found[lobe, 1][1].rms
        assert found[None, 1][1].rms == min(found[ds.Phong(), 1][1].rms, found[ds.Blinn(), 1][1].rms)
    assert ds.exchange.material_error("merl_teflon").rms < 0.02
    assert "at most 75 degrees from the normal" in str(ds.exchange.material_error("merl_brass"))


# teflon in the ABC model: diffuse k, A, B, C and the index of refraction (Löw et al. 2012; dj_brdf.h)
K, A = np.array([0.321152, 0.313597, 0.305526]), np.array([1.787717, 1.816174, 1.846979])
B, C, IOR = 41.644257, 2.066234, 1.611215


def test_a_measured_material_is_its_f_times_cosine_times_pi():
    rng, error = np.random.default_rng(0), ds.exchange.material_error("merl_teflon", highlights=2)
    n = rng.normal(size=(4000, 3))
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    l = np.array([np.sin(0.7), 0, np.cos(0.7)])
    v = np.array([0.0, 0, 1])
    h = (l + v) / np.linalg.norm(l + v)
    n_l, n_v, n_h, v_h = n @ l, n @ v, n @ h, float(v @ h)
    seen = (n_l > np.cos(np.deg2rad(75))) & (n_v > np.cos(np.deg2rad(75)))
    n, n_l, n_v, n_h = n[seen], n_l[seen], n_v[seen], n_h[seen]
    g = np.sqrt(IOR**2 - 1 + v_h**2)
    F = 0.5 * ((g - v_h) / (g + v_h)) ** 2 * (1 + ((v_h * (g + v_h) - 1) / (v_h * (g - v_h) + 1)) ** 2)
    G = np.minimum(1, 2 * n_h * np.minimum(n_l, n_v) / v_h)
    f = (K + (F * A * (1 + B * (1 - n_h[:, None])) ** -C * (G / (n_l * n_v))[:, None])) / np.pi
    scene = ds.Scene(
        ds.Object(ds.GBuffer(n[None]), ds.material("merl_teflon", highlights=2)), ds.DirectionalLight(-l), 0
    )
    camera = ds.OrthographicCamera((0, 0, 4), shape=(1, len(n)), height=2, local_viewer=False)
    off = np.asarray(ds.render(scene, camera))[0] - f * n_l[:, None] * np.pi
    assert np.sqrt(np.mean(off**2)) < 2 * error.rms
    assert np.abs(off).max() < 1.3 * error.largest


def test_measured_materials_that_are_none():
    for call, message in (
        (lambda: ds.material("merl_bras"), "no measured material is named 'merl_bras'. Did you mean 'merl_brass'"),
        (lambda: ds.material("merl_brass", highlights=3), "a measured material has 1 or 2 highlights; got 3"),
        (lambda: ds.material("gold", highlights=2), "'gold' has one highlight, Blinn's"),
        (lambda: ds.exchange.material_error("gold"), "no measured material is named 'gold'"),
    ):
        with pytest.raises(ValueError, match=re.escape(message)):
            call()
