"""What photographs of bands determine: examinations, plans, choices of models, sensors, by the bands' names."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import diffshade as ds
from diffshade.inverse.data.recording import photograph

CAMERA = ds.Camera(eye=(0, 0, 4), fov=32, shape=(24, 24))
NM = (450.0, 530.0, 610.0, 850.0)
LAMPS = ((2, 3, 4), (-2, 1, 4), (0, -2, 4))
FREE = ("k_a", "k_d", "k_s", "n_s")


def scene(bands: tuple[float, ...], lobe: ds.Phong | ds.Blinn | None = None) -> ds.Scene:
    """A ball whose k_d differs from band to band; of no bands it is grey in RGB."""
    k_d = np.linspace(0.3, 0.6, len(bands)) if bands else 0.3
    material = ds.Material(0.1, k_d, 0.4, 30, lobe=lobe or ds.Phong())
    return ds.Scene(ds.Object(ds.Sphere(), material), [ds.PointLight(at) for at in LAMPS], bands=bands)


def views(of: ds.Scene, sensor: ds.Sensor | None = None) -> list[ds.View]:
    """Its photographs, one under each lamp, with noise; of a scene without bands they are grey."""
    rng, width = np.random.default_rng(2), len(of.bands) or 1
    found = []
    for i in range(len(LAMPS)):
        view = ds.View(np.zeros((*CAMERA.shape, width)), CAMERA, lit=(i,), sensor=sensor, bands=bool(of.bands))
        image = photograph(of, view)
        found.append(dataclasses.replace(view, image=image + rng.normal(0, 0.002, image.shape), sensor=None))
    return found


def fitted(bands: tuple[float, ...], lobe: ds.Phong | ds.Blinn | None = None) -> ds.Fit:
    return ds.fit(scene(bands, lobe), views(scene(bands)), free=FREE)


SHOTS = [ds.Shot(ds.PointLight((0, 3, 4)), name="above"), ds.Shot(ds.PointLight((4, 0, -1)), name="behind")]


@pytest.fixture(scope="module")
def of_four() -> ds.Fit:
    return fitted(NM)


@pytest.fixture(scope="module")
def of_one_channel() -> tuple[ds.Fit, ds.Fit]:
    """Fits of the same numbers: grey photographs in RGB, and photographs of one band."""
    grey, one = fitted(()), fitted((850.0,))
    assert grey.names == ("k_a", "k_d", "k_s", "n_s")
    assert one.names == ("k_a.850nm", "k_d.850nm", "k_s.850nm", "n_s")
    return grey, one


@pytest.mark.slow
def test_one_band_is_examined_as_grey_photographs_are(of_one_channel):
    examined = [ds.examine(fit) for fit in of_one_channel]
    for name in ("errors", "interval_68", "interval_95", "determined"):
        np.testing.assert_allclose(*(getattr(of, name) for of in examined), rtol=1e-5, err_msg=name)


@pytest.mark.slow
def test_one_band_is_planned_and_chosen_as_grey_photographs_are(of_one_channel):
    grey, one = of_one_channel
    planned = [ds.plan(fit, SHOTS) for fit in (grey, one)]
    for name in ("now", "errors", "gain", "clipped"):
        np.testing.assert_allclose(*(getattr(of, name) for of in planned), rtol=1e-6, err_msg=name)
    chosen = [ds.compare({"Phong": a, "Blinn": fitted(b, ds.Blinn())}) for a, b in ((grey, ()), (one, (850.0,)))]
    for name in ("errors", "rmse", "differences", "image_differences", "bic"):
        np.testing.assert_allclose(*(getattr(of, name) for of in chosen), rtol=1e-6, atol=1e-15, err_msg=name)


@pytest.mark.thorough
def test_intervals_are_by_the_names_of_bands(of_four):
    examined = ds.examine(of_four)
    assert examined.determined.all()
    assert not examined.suspicions
    assert all(name in str(examined) for name in ("k_a.450nm", "k_s.850nm"))
    true = of_four.values_in(scene(NM))
    inside = (examined.interval_95[:, 0] <= true) & (true <= examined.interval_95[:, 1])
    assert inside.mean() > 0.75


@pytest.mark.thorough
def test_a_fault_of_the_lens_is_named_with_the_bands_that_it_moves():
    dark = ds.Sensor(vignetting=ds.Vignetting(second=-0.4))
    examined = ds.examine(ds.fit(scene(NM), views(scene(NM), dark), free=FREE))
    (found,) = (one for one in examined.suspicions if one.kind == "vignetting")
    assert any(name.endswith("nm") for name in found.affected)
    j = examined.fit.names.index(found.affected[0])
    assert not examined.determined[j] or examined.errors[j] > 2.0 * examined.fit.plain_errors[j]


@pytest.mark.thorough
def test_a_plan_aims_at_a_band(of_four):
    plan = ds.plan(of_four, SHOTS, aim="k_d.850nm")
    assert "ranked by the error of k_d.850nm:" in str(plan)
    assert [name for name, here in zip(of_four.names, plan.aim, strict=True) if here] == ["k_d.850nm"]


@pytest.mark.thorough
def test_planned_errors_are_those_of_the_fit_with_the_photograph(of_four):
    plan = ds.plan(of_four, SHOTS)
    there = dataclasses.replace(scene(NM), lights=(*scene(NM).lights, SHOTS[0].light))
    view = ds.View(np.zeros((*CAMERA.shape, len(NM))), CAMERA, lit=(len(LAMPS),), bands=True)
    image = photograph(there, view) + np.random.default_rng(9).normal(0, 0.002, view.image.shape)
    fit = ds.fit(there, [*of_four.views, dataclasses.replace(view, image=image)], free=FREE)
    np.testing.assert_allclose(fit.plain_errors, plan.errors[0], rtol=0.05)


@pytest.mark.thorough
def test_a_model_of_bands_is_chosen(of_four):
    choice = ds.compare({"Phong": of_four, "Blinn": fitted(NM, ds.Blinn())})
    assert choice.names == ("Phong", "Blinn")
    assert choice.differences[1] > 2e-6


@pytest.mark.thorough
def test_a_camera_of_bands_is_fitted_with_the_material():
    sensor = ds.Sensor(gamma=1.3, vignetting=ds.Vignetting(second=-0.3))
    true = scene(NM)
    taken = [dataclasses.replace(view, sensor=ds.Sensor()) for view in views(true, sensor)]
    fit = ds.fit(true, taken, free=(*FREE, "sensor.gamma", "sensor.vignetting.second"), tied="sensor")
    found = dict(zip(fit.names, fit.values, strict=True))
    assert (found["gamma"], found["second"]) == (pytest.approx(1.3, rel=0.02), pytest.approx(-0.3, rel=0.1))
    assert found["k_d.850nm"] == pytest.approx(0.6, abs=0.02)
    assert not {"red", "blue"} & {name.split(".")[-1] for name in fit.names}
