"""What arrives at a point from each kind of light: the direction to it, and the intensity that is left."""

from re import escape

import jax
import numpy as np
import pytest

import diffshade as ds
from diffshade.vectors import Vec3


@jax.jit
def arriving(light, p):
    l, intensity = light.arriving(Vec3.of(p))
    return l.stack(), intensity.stack()


POINTS = np.array([(0.0, 0, 0), (3, 0, 0), (0, 0, 3), (3, 4, 0)])


def test_a_point_light():
    light = ds.PointLight((3, 4, 0), (4, 2, 1), ds.RadialAttenuation(0, 0, 1))
    l, intensity = arriving(light, POINTS)
    expected = [(0.6, 0.8, 0), (0, 1, 0), np.array([3, 4, -3]) / np.sqrt(34), (0, 0, 0)]
    np.testing.assert_allclose(l, expected, rtol=1e-14, atol=1e-15)
    for of_channel, i in zip(intensity.T, (4, 2, 1), strict=True):
        np.testing.assert_allclose(of_channel, [i / 25, i / 16, i / 34, i * 1e12], rtol=1e-13)
    assert light.is_local


def test_a_directional_light_travels_along_its_direction():
    light = ds.DirectionalLight((0, -5, 0), (4, 2, 1))
    l, intensity = arriving(light, POINTS)
    np.testing.assert_allclose(l, (0, 1, 0), rtol=1e-15)
    np.testing.assert_array_equal(intensity, (4, 2, 1))
    assert not light.is_local
    l, _ = jax.jit(lambda light: light.arriving(None))(light)  # it need not know where the point is
    np.testing.assert_allclose((l.x, l.y, l.z), (0, 1, 0), rtol=1e-15)


def test_a_spot_light():
    """At the origin, 2 above the plane, shining down: cos phi is 2/d."""
    light = ds.SpotLight((0, 0, 2), (0, 0, -3), (4, 2, 1), 50, 3, ds.RadialAttenuation(0, 1, 0))
    points = np.array([(0.0, 0, 0), (1, 0, 0), (0, 2, 0), (0, 2.5, 0), (0, 0, 4)])
    l, intensity = arriving(light, points)
    np.testing.assert_allclose(l[1], np.array([-1, 0, 2]) / np.sqrt(5), rtol=1e-14)
    d = np.sqrt([4, 5, 8])
    np.testing.assert_allclose(intensity[:3, 0], 4 * (2 / d) ** 3 / d, rtol=1e-13)
    np.testing.assert_array_equal(intensity[3:], 0)  # 51 degrees off the axis, and behind it
    assert light.is_local


def test_defaults():
    point = ds.PointLight((1, 2, 3))
    np.testing.assert_array_equal(point.intensity, [1, 1, 1])
    assert float(point.attenuation.constant) == 1
    spot = ds.SpotLight((1, 2, 3), (0, 0, -1))
    assert (spot.cutoff, spot.exponent, spot.softness) == (45, 0, 0)
    np.testing.assert_array_equal(ds.DirectionalLight((1, 2, 3), 0.3).intensity, [0.3, 0.3, 0.3])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: ds.DirectionalLight((0, 0, 0)),
            "DirectionalLight.direction must not be the zero vector; got [0, 0, 0]. Give the way the light travels.",
        ),
        (
            lambda: ds.SpotLight((1, 2, 3), (0, 0, 0)),
            "SpotLight.direction must not be the zero vector; got [0, 0, 0]. Give the way the light travels.",
        ),
        (
            lambda: ds.SpotLight((1, 2, 3), (0, 0, -1), cutoff=20, softness=21),
            "SpotLight.softness must be at most cutoff; got 21.0 with cutoff 20.0. "
            "Make softness smaller or the cutoff larger.",
        ),
    ],
)
def test_a_light_that_is_none(make, message):
    with pytest.raises(ValueError, match=f"^{escape(message)}$"):
        make()
