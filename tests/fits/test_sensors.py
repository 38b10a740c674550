"""Sensors: response, white balance, vignetting and blur, rendered, undone, and fitted from photographs."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage
from small_blocks import small_blocks  # noqa: F401

import diffshade as ds
from diffshade.inverse.data.recording import developed, photograph
from diffshade.inverse.data.sensors import TOE, linear_level
from tests.support.textured import facing_us, textured_ball

SIZE = 64
TRUE = ds.Sensor(gamma=1.8, red=1.2, blue=0.8, vignetting=ds.Vignetting(second=-0.3), blur=1.0)
SENSOR = ("sensor.gamma", "sensor.red", "sensor.blue", "sensor.vignetting.second", "sensor.blur")
MATERIAL = ("k_a", "k_d", "k_s", "n_s")


def ball(shape: tuple[int, int] = (SIZE, SIZE)) -> tuple[ds.Scene, ds.Camera]:
    around = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    towards = np.stack([np.sin(0.7) * np.cos(around), np.sin(0.7) * np.sin(around), np.full(8, np.cos(0.7))], -1)
    material = ds.Material(k_a=0.03, k_d=(0.6, 0.4, 0.25), k_s=0.35, n_s=40)
    scene = ds.Scene(ds.Object(ds.Sphere(), material), [ds.DirectionalLight(-l) for l in towards])
    return scene, ds.Camera(eye=(0, 0, 4), fov=35, shape=shape)


def taken(sensor: ds.Sensor, *, levels: int = 255, noise: float = 0.002) -> tuple[ds.Scene, list[ds.View]]:
    """Photographs of a ball by a camera that says nothing of itself, in files of so many levels."""
    random = np.random.default_rng(0)
    scene, camera = ball()
    mask = ndimage.binary_erosion(np.asarray(ds.intersect(scene, camera).mask), iterations=4)  # by four times the blur
    views = []
    for i in range(8):
        view = ds.View(np.zeros((SIZE, SIZE, 3)), camera, mask, lit=(i,), exposure=(0.5, 0.8)[i % 2], sensor=sensor)
        image = photograph(scene, view)
        image = np.clip(image + noise * random.standard_normal(image.shape), 0.0, 1.0)
        image = np.round(image * levels) / levels
        views.append(dataclasses.replace(view, image=image, sensor=ds.Sensor()))
    return ds.Scene(ds.Object(ds.Sphere()), scene.lights), views


@pytest.mark.thorough
def test_a_camera_is_fitted_with_the_material():
    scene, views = taken(TRUE)
    fit = ds.fit(scene, views, free=(*MATERIAL, *SENSOR), tied=("sensor",), constraints=ds.Grey("k_s"))
    found = dict(zip(fit.names, fit.values, strict=True))
    true = {"k_d.r": 0.6, "k_d.g": 0.4, "k_d.b": 0.25, "k_s": 0.35}
    for name, value in true.items():
        assert abs(found[name] / value - 1.0) < 0.02, name
    assert abs(found["n_s"] / 40.0 - 1.0) < 0.1
    values = true | {"n_s": 40.0, "gamma": 1.8, "red": 1.2, "blue": 0.8, "second": -0.3, "blur": 1.0}
    values |= {"k_a.r": 0.03, "k_a.g": 0.03, "k_a.b": 0.03}
    off = np.array([(found[name] - values[name]) for name in fit.names]) / fit.errors
    assert np.abs(off).max() < 3.5
    assert fit.determined.all()
    assert fit.views[0].sensor is not None
    assert float(fit.views[0].sensor.gamma) == found["gamma"]
    prediction = fit.predict(fit.views[3])
    assert prediction.rmse < 0.003


@pytest.mark.thorough
def test_what_photographs_cannot_tell_is_said():
    scene, views = taken(ds.Sensor(), levels=65535)
    fit = ds.fit(scene, views, free=(*MATERIAL, "sensor.red", "sensor.blue"), tied=("sensor",))
    undetermined = {name for name, known in zip(fit.names, fit.determined, strict=True) if not known}
    assert undetermined == {"red", "blue", *(f"{k}.{c}" for k in ("k_a", "k_d", "k_s") for c in "rb")}
    assert "cannot separate k_a, k_d, k_s and red" in str(fit)


@pytest.mark.thorough
def test_a_known_response_costs_nothing():
    linear = taken(ds.Sensor(), levels=65535, noise=0.0)
    coded = taken(ds.Sensor(gamma=2.0, bend=0.2), levels=65535, noise=0.0)
    known = [dataclasses.replace(view, sensor=ds.Sensor(gamma=2.0, bend=0.2)) for view in coded[1]]
    fits = [ds.fit(scene, views, free=MATERIAL) for scene, views in (linear, (coded[0], known))]
    np.testing.assert_allclose(fits[1].values, fits[0].values, rtol=2e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("camera", "channels"),
    [(ds.Camera((0.5, 0, 4), shape=(20, 30)), 1), (ds.OrthographicCamera((0, 0, 4), shape=(20, 30)), 4)],
)
def test_a_photograph_is_developed(camera, channels):
    scene, _ = ball()
    scene = ds.Scene(scene.objects[0], scene.lights[0])
    sensor = ds.Sensor(gamma=1.7, bend=0.15, red=1.3, blue=0.7, vignetting=ds.Vignetting(-0.2, -0.1, 4.0))
    view = ds.View(np.zeros((20, 30, channels)), camera, exposure=0.8, black=0.01, saturation=0.6, sensor=sensor)
    image = photograph(scene, view)
    clipped = np.minimum(image, 0.6)
    shown = np.concatenate([clipped, np.ones((20, 30, 1))], -1) if channels == 4 else clipped
    linear = developed(dataclasses.replace(view, image=shown))
    plain = photograph(scene, dataclasses.replace(view, sensor=None))
    seen = np.asarray(linear.image)[..., : plain.shape[2]]
    assert linear.sensor is None
    np.testing.assert_allclose(seen[image < 0.6], plain[image < 0.6], atol=2e-6)
    assert linear.saturation is not None
    assert (seen[image >= 0.6] >= linear.saturation).all()
    assert seen[image < 0.6].max() < linear.saturation


@pytest.mark.parametrize(("dtype", "saturation"), [(np.float32, 0.45), (np.float64, None)])
def test_what_the_sensor_clipped_stays_clipped(dtype, saturation):
    scene, camera = ball((20, 30))
    sensor = ds.Sensor(red=1.2, vignetting=ds.Vignetting(-0.3))
    view = ds.View(np.zeros((20, 30, 3)), camera, lit=0, exposure=3.0, sensor=sensor)
    bright = photograph(scene, view)
    top = 1.0 if saturation is None else saturation
    image = np.minimum(bright, top).astype(dtype)
    linear = developed(dataclasses.replace(view, image=image, saturation=saturation))
    assert linear.saturation is not None
    np.testing.assert_array_equal(np.asarray(linear.image) >= linear.saturation, bright >= np.asarray(top, dtype))
    assert (bright >= top).any()


@pytest.mark.slow
def test_maps_remember_the_sensor(tmp_path):
    ball = textured_ball(16, 12)
    linear = [dataclasses.replace(view, image=np.maximum(view.image, 0)) for view in ball.views]
    views = [dataclasses.replace(view, image=view.image**0.5, sensor=ds.Sensor(gamma=2.0)) for view in linear]
    free = ("k_d", "k_s", "n_s", "normal")
    maps = ds.fit_texels(facing_us(ball), views, free=free, out=tmp_path / "maps")
    plain = ds.fit_texels(facing_us(ball), linear, free=free)
    np.testing.assert_allclose(maps.values["k_d"], plain.values["k_d"], atol=0.02)
    for one in (maps, ds.read_maps(tmp_path / "maps")):
        assert one.sensor is not None
        assert float(one.sensor.gamma) == 2.0
        assert float(one.sensor.vignetting.second) == 0.0
    assert plain.sensor is None
    np.testing.assert_allclose(maps.relative_errors(views), plain.relative_errors(linear), atol=0.02)


def test_vignetting_is_the_fraction_at_the_corner():
    scene = ds.Scene(ds.Object(ds.Plane((0, 0, 0), (0, 0, 1)), ds.Material(k_e=1.0)), ds.DirectionalLight((0, 0, -1)))
    camera = ds.Camera(eye=(0, 0, 4), fov=60, shape=(101, 101))
    view = ds.View(np.zeros((101, 101, 3)), camera, sensor=ds.Sensor(vignetting=ds.Vignetting(-0.2, -0.1)))
    image = photograph(scene, view)[..., 0]
    assert image[50, 50] == pytest.approx(1.0)
    assert image[0, 0] == pytest.approx(0.7, abs=0.01)  # the corner pixel's centre is half a pixel inside
    natural = dataclasses.replace(view, sensor=ds.Sensor(vignetting=ds.Vignetting(cosine=4.0)))
    middle_of_a_side = photograph(scene, natural)[50, 0, 0]
    assert middle_of_a_side == pytest.approx(np.cos(np.arctan(np.tan(np.deg2rad(30)) * 100 / 101)) ** 4)


@pytest.mark.parametrize("sensor", [ds.Sensor(gamma=2.2), ds.Sensor(gamma=0.5, bend=-0.2), ds.Sensor(bend=0.8)])
def test_the_response_rises_and_has_an_inverse_and_a_finite_slope(sensor):
    x = np.concatenate([np.linspace(-0.1, 1.2, 500), [0.0, TOE, 1.0]])
    with jax.enable_x64(True):
        x = np.sort(x)
        y = np.asarray(sensor.respond(jnp.asarray(x)))
        slope = jax.vmap(jax.grad(lambda at: sensor.respond(at)))(jnp.asarray(x))
        back = linear_level(sensor, y)
    assert (np.diff(y) > 0.0).all()
    assert np.isfinite(slope).all()
    np.testing.assert_allclose(back, x, atol=2e-6)
    assert float(sensor.respond(jnp.asarray(1.0))) == pytest.approx(1.0)


@pytest.mark.slow
def test_texels_tell_an_undeclared_gamma():
    strengths = np.linspace(0.6, 1.4, 12)
    ball = textured_ball(20, 12, noise=0.0, intensity=strengths[:, None] * np.ones(3), gloss=0.5, lobe="blinn")
    white = max(float(view.image.max()) for view in ball.views)
    coded = [
        dataclasses.replace(view, image=np.round(255 * np.maximum(view.image / white, 0) ** (1 / 1.6)) / 255)
        for view in ball.views
    ]
    found = ds.lights.find_response(facing_us(ball), coded)
    assert abs(found.gamma - 1.6) < 2.0 * found.error < 0.3
    assert found.misfit < 0.5 * found.misfit_linear
    assert found.views[3].sensor is not None
    assert float(found.views[3].sensor.gamma) == found.gamma


def test_a_response_is_found_from_plain_views_alone():
    ball = textured_ball(16, 12)
    with pytest.raises(ValueError, match="find_response needs at least 12 views; got 11"):
        ds.lights.find_response(facing_us(ball), ball.views[:11])
    known = [dataclasses.replace(view, sensor=ds.Sensor()) for view in ball.views]
    with pytest.raises(ValueError, match=r"views\[0\] has a sensor"):
        ds.lights.find_response(facing_us(ball), known)


def test_wrong_sensors_are_refused():
    with pytest.raises(ValueError, match=r"Sensor\.gamma must be above 0; got 0"):
        ds.Sensor(gamma=0)
    with pytest.raises(TypeError, match=r"Sensor\.vignetting must be a Vignetting; got float"):
        ds.Sensor(vignetting=0.0)  # pyright: ignore[reportArgumentType]
    _, views = taken(ds.Sensor())
    with pytest.raises(TypeError, match=r"View\.sensor must be a Sensor; got float"):
        dataclasses.replace(views[0], sensor=1.8)
    scene, camera = ball()
    seen = ds.intersect(scene, camera)
    flat = ds.Scene(ds.Object(ds.GBuffer(seen.normal, seen.position, seen.mask)), scene.lights)
    with pytest.raises(ValueError, match=r"Sensor\.blur needs the surface between the pixels"):
        ds.fit(flat, views[:2], free=("k_d", "sensor.blur"))
