"""What arrives at a point from each kind of light: the direction to it, and the intensity that is left."""

import equinox as eqx
import jax
import numpy as np
import pytest
from refusals import refuses

import diffshade as ds
from diffshade.model.vectors import Vec3


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
    assert eqx.tree_equal(point.attenuation, ds.RadialAttenuation(1.0))
    spot = ds.SpotLight((1, 2, 3), (0, 0, -1))
    assert (spot.cutoff, spot.exponent, spot.softness) == (45, 0, 0)
    np.testing.assert_array_equal(ds.DirectionalLight((1, 2, 3), 0.3).intensity, [0.3, 0.3, 0.3])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ds.DirectionalLight((0, 0, 0)), ("DirectionalLight.direction", "zero vector", "[0, 0, 0]")),
        (lambda: ds.SpotLight((1, 2, 3), (0, 0, 0)), ("SpotLight.direction", "zero vector", "[0, 0, 0]")),
        (
            lambda: ds.SpotLight((1, 2, 3), (0, 0, -1), cutoff=20, softness=21),
            ("SpotLight.softness", "at most cutoff", "21.0", "20.0"),
        ),
    ],
)
def test_a_light_that_is_none(make, words):
    refuses(make, *words)


def on_the_floor(light, p=(0.0, 0.0, 0.0), n=(0.0, 0.0, 1.0)):
    """The diffuse light at a point, by the shading of one pixel."""
    buffer = ds.GBuffer(np.array([[n]], float), np.array([[p]], float))
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_d=1)), light)
    return float(np.asarray(ds.shade(scene, buffer, ds.OrthographicCamera((0, 0, 4), shape=(1, 1))))[0, 0, 0])


def ceiling(samples, **options):
    """The unit square 1 above the floor, one corner above the origin, which shines down."""
    return ds.AreaLight((0, 0, 1), (0, 1, 0), (1, 0, 0), samples=samples, **options)


def test_an_area_light_is_a_grid_of_spots():
    f = ds.RadialAttenuation(0.5, 0.2, 0.1)
    lamp = ds.AreaLight((1, -1, 2), (0, 2, 0), (3, 0, 0), (6, 12, 18), 70, 2.5, f, samples=(2, 3))
    grid = jax.jit(ds.AreaLight.emitters)(lamp)
    assert isinstance(grid, ds.SpotLight)
    expected = [(1 + x, -1 + y, 2) for y in (0.5, 1.5) for x in (0.5, 1.5, 2.5)]
    np.testing.assert_allclose(sorted(grid.position.tolist()), sorted(expected), rtol=1e-15)
    np.testing.assert_allclose(grid.intensity, [(1, 2, 3)] * 6, rtol=1e-15)
    axis = grid.direction / np.linalg.norm(grid.direction, axis=-1, keepdims=True)
    np.testing.assert_allclose(axis, [(0, 0, -1)] * 6, atol=1e-15)
    np.testing.assert_array_equal([grid.cutoff, grid.exponent, grid.softness], [[70] * 6, [2.5] * 6, [0] * 6])
    assert isinstance(grid.attenuation, ds.RadialAttenuation)
    np.testing.assert_array_equal(grid.attenuation.quadratic, [0.1] * 6)
    assert lamp.is_local


@pytest.mark.thorough
def test_an_area_light_converges_to_the_rectangle():
    """Pi times the form factor of a parallel rectangle with a corner above the point; errors fall by 4."""
    right = np.sqrt(0.5) * np.arctan(np.sqrt(0.5))
    one_over_d2 = ds.RadialAttenuation(0, 0, 1)
    errors = [on_the_floor(ceiling(n, attenuation=one_over_d2)) - right for n in (2, 4, 8)]
    assert abs(errors[-1]) < 1e-3
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 4, rtol=0.1)


def test_an_area_light_of_one_sample_is_a_spot_at_its_middle():
    spot = ds.SpotLight((0.5, 0.5, 1), (0, 0, -3), 1, 90, 1)
    assert on_the_floor(ceiling(1)) == pytest.approx(on_the_floor(spot), rel=1e-14)


def test_an_area_light_is_dark_behind_and_its_samples_share_its_intensity():
    far = {"p": (0.5, 0.5, -1e4)}
    for samples in (1, (2, 5)):
        assert on_the_floor(ceiling(samples), (0.5, 0.5, 1.5), (0, 0, -1)) == 0
        assert on_the_floor(ceiling(samples), **far) == pytest.approx(1, rel=1e-7)


@pytest.mark.thorough
def test_256_emitters_compile_as_four_do():
    """They are scanned: the program does not grow with their number."""

    def size(samples):
        scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_d=1, k_s=1)), ceiling(samples))
        camera = ds.Camera((0, 0, 4), shape=(8, 9))
        return len(jax.jit(lambda scene: ds.render(scene, camera)).lower(scene).as_text().splitlines())

    assert size((16, 16)) == size((2, 2))


def test_area_light_defaults():
    lamp = ds.AreaLight((0, 0, 1), (0, 1, 0), (1, 0, 0))
    assert (lamp.samples, lamp.cutoff, lamp.exponent) == ((8, 8), 90, 1)
    assert ds.AreaLight((0, 0, 1), (0, 1, 0), (1, 0, 0), samples=3).samples == (3, 3)


@pytest.mark.parametrize("samples", [0, -1, 2.5, (2,), (2, 0), (1, 2, 3), "ab", None, np.inf])
def test_an_area_light_without_samples(samples):
    got = (samples, samples) if samples in (0, -1) else samples  # one number is both
    refuses(lambda: ceiling(samples), "AreaLight.samples", "whole numbers above 0", repr(got), "(8, 8)")


@pytest.mark.parametrize("edge_v", [(0, 0, 0), (0, 2, 0), (0, -1, 0)])
def test_an_area_light_whose_edges_span_nothing(edge_v):
    words = ("AreaLight.edge_u and edge_v", "[0. 1. 0.]", str(np.array(edge_v, float)))
    refuses(lambda: ds.AreaLight((0, 0, 1), (0, 1, 0), edge_v), *words)
