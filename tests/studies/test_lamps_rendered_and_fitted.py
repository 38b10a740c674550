"""Measured lamps in pictures and fits: renders of several, a lamp found from its light, derivatives both ways."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_jvp, check_vjp
from lamp_files import LAMP, TABLE, towards
from measured import measured

import diffshade as ds
from diffshade.model.vectors import Vec3

# the time goes into compiling, not into running
QUICK = {"xla_backend_optimization_level": 0, "xla_disable_hlo_passes": "fusion"}


def test_derivatives_are_those_of_finite_differences():
    points = np.array([[0.5, 0.1, 0.9], [-0.4, 0.3, 0.2], [1.4, 1.2, -0.5]])

    def total(position, direction, side, intensity):
        light = dataclasses.replace(LAMP, position=position, direction=direction, side=side, intensity=intensity)
        _, arriving = light.arriving(Vec3.of(points))
        return arriving.stack()

    at = tuple(jnp.asarray(x) for x in (LAMP.position, LAMP.direction, LAMP.side, LAMP.intensity))
    program = jax.jit(total)
    forward = jax.jit(lambda p, t: jax.jvp(total, p, t), compiler_options=QUICK)
    check_jvp(program, forward, at, atol=1e-6, rtol=1e-6)
    check_vjp(program, lambda *p: jax.vjp(program, *p), at, atol=1e-6, rtol=1e-6)


@pytest.mark.parametrize("single", [False, True])
def test_derivatives_are_finite_at_the_poles_the_kinks_and_the_lamp(single):
    table = ds.lamps.Profile([0, 20, 90, 180], [0], [[1, 0.9, 0.2, 0.3]]) if single else TABLE
    special = [towards(g, C) for g in (0.0, 1e-9, 20.0, 90.0, 130.0, 180.0) for C in (0.0, 45.0, 180.0)]
    points = np.array([*special, (0.0, 0, 0)])

    def arriving(position, direction, side, p):
        light = ds.lamps.MeasuredLight(position, direction, table, side=side)
        return light.arriving(Vec3.of(p))[1].x

    at = (np.zeros(3), np.array([0.0, -1, 0]), np.array([1.0, 0, 0]))
    for jacobian in (jax.jacfwd, jax.jacrev):
        slope_at = jax.vmap(jacobian(arriving, (0, 1, 2, 3)), (None, None, None, 0))
        slopes = jax.jit(slope_at, compiler_options=QUICK)(*at, points)
        assert all(np.isfinite(slope).all() for slope in slopes)
        assert all(np.abs(slope).max() < 1e3 for slope in slopes[:3])


def test_a_picture_under_several_lamps_is_the_sum_of_those_under_each():
    narrow = dataclasses.replace(LAMP, profile=ds.lamps.Profile([0, 40], [0], [[1, 0]]))
    lamps = [LAMP, dataclasses.replace(LAMP, position=(1, 2, 0)), narrow]
    item = ds.Object(ds.Sphere(), ds.Material(k_d=0.7))
    camera = ds.Camera((0, 0, 4), fov=35, shape=(12, 12))
    together = np.asarray(ds.render(ds.Scene(item, lamps), camera))
    alone = sum(np.asarray(ds.render(ds.Scene(item, lamp), camera)) for lamp in lamps)
    np.testing.assert_allclose(together, alone, rtol=1e-12, atol=1e-12)
    assert together.max() > 0


def test_a_lamp_is_fitted():
    """Its place, axis and intensity, from a photograph of a slope that it lights."""
    surface = ds.Object(ds.Plane((0, 0, 0), (0, 1, 0.4)), ds.Material(k_d=0.8))
    true = dataclasses.replace(LAMP, attenuation=ds.RadialAttenuation(0, 0, 1))
    camera = ds.Camera((0, 3, 4), fov=60, shape=(24, 24))
    views = [ds.View(np.asarray(ds.render(ds.Scene(surface, true), camera)), camera)]
    told = ds.Scene(surface, dataclasses.replace(true, position=(0.1, 1.8, 0.5), direction=(0, -1, 0.1), intensity=1))
    fit = ds.fit(told, views, free=("position", "direction", "intensity"), start="scene")
    (lamp,) = fit.scene.lights
    assert isinstance(lamp, ds.lamps.MeasuredLight)
    np.testing.assert_allclose(lamp.position, true.position, atol=1e-6)
    np.testing.assert_allclose(lamp.direction, true.direction / np.linalg.norm(true.direction), atol=1e-6)
    np.testing.assert_allclose(lamp.intensity, true.intensity, rtol=1e-6)


@pytest.mark.parametrize(("name", "exponent"), [("rab_5.ies", 1.3), ("rab_7.ies", 2.2), ("ledvance_sym_30.ldt", 14.4)])
def test_real_lamps_are_like_a_spot(name, exponent):
    found = ds.lamps.as_spot(ds.lamps.read_lamp(measured("lamps") / name))
    assert found.fits
    assert abs(float(found.light.exponent) / exponent - 1) < 0.02
    assert f"cos^{float(found.light.exponent):.3g} with a cutoff of 90 degrees" in str(found)
