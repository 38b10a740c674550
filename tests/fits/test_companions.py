"""Companions: lights, spots, spheres, exposures and blacks that are found together with the material."""

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
from scenarios import OF_MATERIAL, same_but, three_lights
from synthetic import (
    ATTENUATION,
    CAMERA,
    forget,
    noisy,
    one_light_each,
    photographs,
    seen_by,
    standard_scene,
)

import diffshade as ds

SIGMA = 0.003

# --- what the scene has wrong of a sphere, a spot and a point light, all at once


@cache
def truth() -> ds.Scene:
    spot = ds.SpotLight((0.6, 0.8, 3.0), (-0.5, -0.9, -3.0), 3.0, 18.0, 8.0, ATTENUATION, softness=8.0)
    scene = standard_scene(lights=[spot, ds.PointLight((-1.5, 0.5, 2.5), 1.0, ATTENUATION)])
    return same_but(
        scene, lambda s: (s.objects[0].surface.center, s.objects[0].surface.radius), [(0.02, -0.03, 0.04), 1.02]
    )


@cache
def told() -> ds.Scene:
    where = lambda s: (  # noqa: E731
        s.objects[0].surface.center,
        s.objects[0].surface.radius,
        s.lights[0].direction,
        s.lights[0].cutoff,
        s.lights[0].exponent,
        s.lights[1].position,
    )
    # the direction is not of unit length
    return same_but(forget(truth()), where, [(0.08, 0.02, 0.0), 0.95, (-1.5, -1.0, -4.0), 25.0, 1.0, (-1.0, 1.2, 3.2)])


@cache
def found(sigma: float, start: str) -> ds.Fit:
    views = []
    for camera in (CAMERA, ds.Camera(eye=(1.5, 1.0, 3.5), fov=32, shape=CAMERA.shape)):
        mask = seen_by(camera, truth().objects[0].surface).mask
        views += one_light_each(noisy(photographs(truth(), camera), sigma, 5), camera, mask=mask)
    free = (*OF_MATERIAL, "center", "radius", "lights.0.direction", "cutoff", "exponent", "lights.1.position")
    return ds.fit(told() if start == "search" else truth(), views, free=free, start=start)


def with_noise() -> ds.Fit:
    return found(SIGMA, "scene")


@pytest.mark.thorough
def test_what_the_scene_has_wrong_is_found_together_with_the_material():
    fit = found(0.0, "search")
    assert np.abs(fit.values_in(told()) - fit.values_in(truth())).max() > 0.1
    np.testing.assert_allclose(fit.values, fit.values_in(truth()), rtol=1e-5, atol=1e-5)
    assert fit.converged
    assert fit.determined.all()


@pytest.mark.thorough
def test_its_errors_are_honest():
    fit = with_noise()
    assert fit.converged
    assert np.isfinite(fit.plain_errors).all()
    assert (fit.plain_errors > 0).all()
    assert np.abs((fit.values - fit.values_in(truth())) / fit.plain_errors).max() < 4.5
    assert fit.rmse == pytest.approx(SIGMA, rel=0.06)


# --- exposure and black of each view


EXPOSURES, BLACKS = (1.0, 0.5, 2.0), (0.01, 0.05, -0.02)


def taken() -> list[np.ndarray]:
    """Return photographs, each with another exposure and black."""
    return [e * image + b for e, b, image in zip(EXPOSURES, BLACKS, photographs(three_lights()), strict=True)]


@pytest.mark.thorough
def test_exposure_and_black_of_two_views_are_found_where_the_third_is_known():
    images = taken()
    freed = tuple(f"views.{i}.{name}" for i in (1, 2) for name in ("exposure", "black"))

    def fit(images: Sequence[np.ndarray]) -> ds.Fit:
        first = ds.View(images[0], CAMERA, lit=0, black=BLACKS[0])
        views = [first, *one_light_each(images)[1:]]
        return ds.fit(forget(three_lights()), views, free=(*OF_MATERIAL, *freed))

    def wanted(fit: ds.Fit) -> np.ndarray:
        sent = {f"views.{i}.{n}": v[i] for i in (1, 2) for n, v in (("exposure", EXPOSURES), ("black", BLACKS))}
        of_scene = fit.values_in(three_lights())
        return np.array([sent.get(name, value) for name, value in zip(fit.names, of_scene, strict=True)])

    exact = fit(images)
    assert set(freed) <= set(exact.names)
    np.testing.assert_allclose(exact.values, wanted(exact), rtol=1e-6, atol=1e-6)
    for view, exposure, black in zip(exact.views, EXPOSURES, BLACKS, strict=True):
        assert float(view.exposure) == pytest.approx(exposure, rel=1e-6)
        assert float(view.black) == pytest.approx(black, abs=1e-6)
        prediction = exact.predict(view)
        assert prediction.rmse < 1e-6
        np.testing.assert_array_equal(prediction.target, view.image)
    as_given = ds.View(images[2], CAMERA, lit=2)
    assert exact.predict(as_given).rmse > 0.05  # exposure 1

    off = fit(noisy(images, SIGMA, 2))
    assert np.abs((off.values - wanted(off)) / off.plain_errors).max() < 4.5


@pytest.mark.thorough
def test_exposures_of_all_views_with_the_whole_material_are_a_gauge_named_in_words():
    views = [ds.View(image, CAMERA, lit=i, black=BLACKS[i]) for i, image in enumerate(taken())]
    fit = ds.fit(forget(three_lights()), views, free=(*OF_MATERIAL, "exposure"))
    unsure = {name for name, known in zip(fit.names, fit.determined, strict=True) if not known}
    exposures = {f"views.{i}.exposure" for i in range(3)}
    assert unsure == {f"{k}.{c}" for k in ("k_a", "k_d", "k_s") for c in "rgb"} | exposures
    assert np.isinf(fit.plain_errors[~fit.determined]).all()
    (note,) = [note for note in fit.notes if "cannot separate" in note]
    for part in ("k_a, k_d and k_s from", "views.0.exposure", "one factor", "Fix one, for example"):
        assert part in note
    assert str(fit).count("not determined") == len(unsure)
    assert fit.values[fit.names.index("n_s")] == pytest.approx(50, rel=1e-6)
    assert fit.rmse < 1e-6
