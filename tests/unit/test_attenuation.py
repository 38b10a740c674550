"""E2, E3 and E14 at values that can be worked out by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import own_parts
import pytest
from refusals import refuses

import diffshade as ds
from diffshade.model.attenuation import NEAREST, angular_attenuation
from diffshade.model.vectors import Vec3


@pytest.mark.parametrize(
    ("coefficients", "values"),
    [
        ((1, 0, 0), (1, 1, 1)),
        ((0, 1, 0), (2, 1, 0.25)),
        ((0, 0, 1), (4, 1, 0.0625)),
        ((0.5, 0, 0.125), (1 / 0.53125, 1.6, 0.4)),
        ((1, 0.5, 0.25), (1 / 1.3125, 1 / 1.75, 1 / 7)),
    ],
)
def test_radial(coefficients, values):
    """f_rad at d = 1/2, 1 and 4, and never above 1 when clamped."""
    d = jnp.array([0.5, 1, 4])
    np.testing.assert_allclose(ds.RadialAttenuation(*coefficients)(d), values, rtol=1e-14)
    clamped = ds.RadialAttenuation(*coefficients, clamp=True)(d)
    np.testing.assert_allclose(clamped, np.minimum(values, 1), rtol=1e-14)


def test_nearer_than_the_nearest():
    f = ds.RadialAttenuation(0, 0, 1)
    for d in (0.0, 1e-9, NEAREST):
        np.testing.assert_allclose(jax.value_and_grad(f)(d), (1e12, 0), rtol=1e-12)
    value, slope = jax.value_and_grad(f)(2 * NEAREST)
    np.testing.assert_allclose((value, slope), (0.25e12, -0.25e18), rtol=1e-12)


def test_no_derivative_where_it_is_clamped():
    f = ds.RadialAttenuation(0, 0, 1, clamp=True)
    assert jax.grad(f)(0.5) == 0
    assert jax.grad(f)(1.0) == 0
    np.testing.assert_allclose(jax.grad(f)(2.0), -0.25, rtol=1e-14)


@pytest.mark.parametrize(
    "law",
    [
        ds.RadialAttenuation(0.5, 0.2, 0.1),
        ds.RadialAttenuation(0.1, 0, 0.1, clamp=True),
        own_parts.HazyAttenuation(0.3),
        own_parts.PowerAttenuation(0.5, 1.5),
    ],
)
def test_every_law_has_finite_derivatives_at_every_distance(law):
    def f(law, d):
        return law(d)

    for d in (0.0, NEAREST, 0.3, 2.0, 1e6):
        value, slopes = jax.value_and_grad(f, argnums=(0, 1))(jax.tree.map(jnp.asarray, law), jnp.asarray(d))
        assert np.isfinite([value, *jax.tree.leaves(slopes)]).all()
        assert d > NEAREST or slopes[1] == 0


def test_a_law_declares_its_numbers():
    assert ds.RadialAttenuation.numbers() == ("constant", "linear", "quadratic")
    assert own_parts.PowerAttenuation.numbers() == ("a", "p")
    assert own_parts.PowerAttenuation().glsl() is None


@pytest.mark.parametrize("clamp", [False, True])
@pytest.mark.parametrize("d", [0.3, 2.0])
def test_what_a_live_picture_computes_is_f_rad(d, clamp):
    """GLSL's expression is also Python's."""
    for law in (ds.RadialAttenuation(0.1, 0.2, 0.3, clamp=clamp), own_parts.HazyAttenuation(0.3)):
        expression = law.glsl().strip().removeprefix("return ").removesuffix(";")
        np.testing.assert_allclose(eval(expression, {"d": d, "min": min, "exp": np.exp}), law(d), rtol=1e-6)


def spot(cos_phi, cutoff, exponent, softness=0.0):
    cos_phi, cutoff, exponent, softness = (jnp.array(float(x)) for x in (cos_phi, cutoff, exponent, softness))
    return float(angular_attenuation(cos_phi, cutoff, exponent, softness))


@pytest.mark.parametrize(
    ("phi", "cutoff", "exponent", "value"),
    [
        (0, 30, 5, 1),
        (20, 30, 0, 1),
        (29.999, 30, 0, 1),
        (30.001, 30, 0, 0),
        (60, 90, 1, 0.5),
        (60, 90, 3, 0.125),
        (45, 50, 2, 0.5),
        (89, 90, 0, 1),
        (91, 90, 0, 0),
        (120, 90, 2, 0),  # not (-1/2)^2
        (180, 90, 0, 0),
    ],
)
def test_angular(phi, cutoff, exponent, value):
    np.testing.assert_allclose(spot(np.cos(np.deg2rad(phi)), cutoff, exponent), value, rtol=1e-14)


@pytest.mark.parametrize(
    ("cos_phi", "cutoff", "exponent", "value"),
    [(1, 0, 3, 1), (1 - 1e-12, 0, 0, 0), (0, 90, 0, 1), (0, 90, 1, 0), (-1e-12, 90, 0, 0)],
)
def test_angular_at_the_ends_of_the_range(cos_phi, cutoff, exponent, value):
    """cos phi >= max(cos cutoff, 0) is the lit side, where 0^0 = 1."""
    assert spot(cos_phi, cutoff, exponent) == value


def test_softness_is_smoothstep_in_the_cosine():
    """0 at the cutoff, 1 from cutoff - softness on, and 1/2 with slope 3/2 over the width half way in the cosine."""
    outer, inner = np.cos(np.deg2rad([40, 25]))
    assert spot(outer - 1e-12, 40, 0, 15) == 0
    np.testing.assert_allclose(spot(inner, 40, 0, 15), 1, rtol=1e-14)
    np.testing.assert_allclose(spot((inner + 1) / 2, 40, 0, 15), 1, rtol=1e-14)
    middle = (outer + inner) / 2
    np.testing.assert_allclose(spot(middle, 40, 0, 15), 0.5, rtol=1e-13)
    np.testing.assert_allclose(spot(middle, 40, 3, 15), 0.5 * middle**3, rtol=1e-13)


@pytest.mark.parametrize("softness", [1e-300, 1e-16, 1e-12, 1e-6])
def test_hardly_any_softness_is_a_hard_edge(softness):
    for cos_phi, value in ((1, 1), (0.9, 0.9**2), (np.cos(np.deg2rad(41)), 0)):
        np.testing.assert_allclose(spot(cos_phi, 40, 2, softness), value, rtol=1e-14)


def test_the_cutoff_has_a_derivative_where_the_edge_is_soft():
    def f(cutoff):
        return angular_attenuation(jnp.array(0.85), cutoff, jnp.array(2.0), jnp.array(15.0))

    slope = (f(jnp.array(40.0001)) - f(jnp.array(39.9999))) / 2e-4
    assert slope > 0.01
    np.testing.assert_allclose(jax.grad(f)(40.0), slope, rtol=1e-6)


@jax.jit
def visibility(air, z):
    return air.visibility(z)


def test_depth_cueing_is_linear_between_its_ends():
    air = ds.DepthCueing(2, 6, s_f=0.9, s_b=0.1)
    z = np.array([-1.0, 0, 2, 3, 4, 6, 100])
    np.testing.assert_allclose(visibility(air, z), [0.9, 0.9, 0.9, 0.7, 0.5, 0.1, 0.1], rtol=1e-14)
    plain = ds.DepthCueing(2, 6)
    np.testing.assert_allclose(visibility(plain, np.array([2.0, 5, 6])), [1, 0.25, 0], rtol=1e-14)
    np.testing.assert_array_equal(plain.I_dc, [0, 0, 0])
    assert not plain.radial


def test_fog_is_exponential():
    z = np.array([-1.0, 0, 1, 4])
    np.testing.assert_allclose(visibility(ds.Fog(0.5), z), [1, 1, np.exp(-0.5), np.exp(-2)], rtol=1e-14)
    np.testing.assert_allclose(visibility(ds.Fog(0.5, squared=True), z), [1, 1, np.exp(-0.25), np.exp(-4)], rtol=1e-14)
    np.testing.assert_array_equal(visibility(ds.Fog(0.0), z), 1)


def test_the_slope_of_depth_cueing_is_that_of_the_constant_side_at_its_ends():
    def slope(z):
        return jax.grad(lambda z: visibility(ds.DepthCueing(2, 6, s_f=0.9, s_b=0.1), z))(z)

    assert [float(slope(z)) for z in (1.0, 2.0, 6.0, 7.0)] == [0, 0, 0, 0]
    np.testing.assert_allclose(slope(4.0), -0.2, rtol=1e-14)


def test_what_is_left_of_a_colour():
    air = ds.Fog(0.5, I_dc=(0.2, 0.4, 0.6))
    found = jax.jit(lambda air, z: air(Vec3.of(jnp.array([[1.0, 0.5, 0.0]])), z).stack())(air, np.array([2.0]))
    s = np.exp(-1)
    np.testing.assert_allclose(found, [[s + 0.2 * (1 - s), 0.5 * s + 0.4 * (1 - s), 0.6 * (1 - s)]], rtol=1e-14)


@pytest.mark.thorough
@pytest.mark.parametrize("radial", [False, True])
@pytest.mark.parametrize("eta", [None, 1.5])
def test_parallel_rays_are_fogged_by_their_own_length(radial, eta):
    """A wall 4 before the camera, behind glass and beside it: (1 - s) I_dc alone, s = exp(-4/2) everywhere."""
    camera = ds.OrthographicCamera((0.4, 0.3, 4), target=(0.4, 0.3, 0), height=5, shape=(6, 6))
    glass = ds.Object(ds.Box((0, 0, 1), (2, 2, 0.5)), ds.Material(0, 0, k_t=1, eta=eta))
    wall = ds.Object(ds.Plane((0, 0, 0), (0, 0, 1)), ds.Material(0, 0))
    air = ds.Fog(0.5, I_dc=1, radial=radial)
    for objects in (wall, (glass, wall)):
        image = ds.render(ds.Scene(objects, (), atmosphere=air), camera)
        np.testing.assert_allclose(image, 1 - np.exp(-2), rtol=1e-12)
    buffer = ds.intersect(ds.Scene(wall), camera)
    np.testing.assert_allclose(ds.shade(ds.Scene(wall, (), atmosphere=air), buffer, camera), 1 - np.exp(-2), rtol=1e-12)


def test_rays_from_the_eye_are_fogged_by_their_own_length():
    camera = ds.Camera((0, 0, 4), fov=60, shape=(1, 1), principal_point=(-2, 0.5))
    wall = ds.Object(ds.Plane((0, 0, 0), (0, 0, 1)), ds.Material(0, 0))
    z = 4 * np.hypot(1, 2.5 * 2 * np.tan(np.deg2rad(30)))
    image = ds.render(ds.Scene(wall, (), atmosphere=ds.Fog(0.1, I_dc=1, radial=True)), camera)
    np.testing.assert_allclose(image, np.full((1, 1, 3), 1 - np.exp(-0.1 * z)), rtol=1e-12)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ds.RadialAttenuation(0, 0, 0), ("RadialAttenuation", "above 0", "0, 0 and 0", "constant=1")),
        (lambda: ds.DepthCueing(5, 3), ("DepthCueing.z_f", "less than z_b", "5.0 and 3.0")),
        (lambda: ds.DepthCueing(3, 3), ("DepthCueing.z_f", "less than z_b", "3.0 and 3.0")),
        (lambda: ds.DepthCueing(2, 3, s_f=1.5), ("DepthCueing.s_f", "between 0 and 1", "1.5")),
        (lambda: ds.Fog(-0.1), ("Fog.density", "at least 0", "-0.1")),
    ],
)
def test_air_that_is_none(make, words):
    refuses(make, *words)
