"""Companions that the scene has far wrong, one kind after another, and the errors of a direction over many fits."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest
import scipy.stats
from scenarios import OF_MATERIAL, same_but, three_lights
from synthetic import (
    ATTENUATION,
    CAMERA,
    MATERIAL,
    forget,
    light_positions,
    noisy,
    one_light_each,
    photograph,
    photographs,
    point_lights,
    seen_by,
    standard_scene,
)

import diffshade as ds

pytestmark = pytest.mark.slow

THREE = point_lights()[:3]
SIGMA = 0.003


class Case(NamedTuple):
    """A scene, what a fit is told of it, the photographs without noise and how they are read."""

    truth: ds.Scene
    told: ds.Scene
    free: tuple[str, ...]
    options: dict[str, Any]
    forgotten: tuple[str, ...] = OF_MATERIAL
    tied: tuple[str, ...] = ()

    def fit(self, images: Sequence[np.ndarray]) -> ds.Fit:
        views = one_light_each(images, **self.options)
        return ds.fit(forget(self.told, self.forgotten), views, free=self.free, tied=self.tied)


def positions_of_lights() -> Case:
    where = lambda s: [l.position for l in s.lights]  # noqa: E731
    truth = standard_scene(lights=THREE[:2])
    offsets = np.array([(0.9, -0.5, 0.7), (-0.6, 0.8, -0.4)])
    return Case(truth, same_but(truth, where, light_positions()[:2] + offsets), (*OF_MATERIAL, "position"), {})


def intensities_of_lights() -> Case:
    where = lambda s: [l.intensity for l in s.lights]  # noqa: E731
    colours = [(1.4, 1.2, 1.0), (0.5, 0.6, 0.7), (2.0, 2.0, 0.3)]
    truth = standard_scene(
        lights=[ds.PointLight(l.position, c, ATTENUATION) for l, c in zip(THREE, colours, strict=True)]
    )
    return Case(truth, same_but(truth, where, np.ones((3, 3))), ("k_a", "n_s", "intensity"), {}, ("k_a", "n_s"))


def spots_of_unknown_softness() -> Case:
    where = lambda s: [x for l in s.lights for x in (l.exponent, l.cutoff, l.softness)]  # noqa: E731
    lights = [ds.SpotLight(p, -p + 0.1, 3.0, 25.0, 4.0, ATTENUATION, softness=15.0) for p in light_positions()[:3]]
    truth = standard_scene(lights=lights)
    shape = ("exponent", "cutoff", "softness")
    return Case(truth, same_but(truth, where, [1.0, 22.0, 10.0] * 3), (*OF_MATERIAL, *shape), {}, tied=shape)


def centre_and_radius_of_a_sphere() -> Case:
    ball = lambda s: (s.objects[0].surface.center, s.objects[0].surface.radius)  # noqa: E731
    truth = same_but(standard_scene(lights=THREE), ball, ((0.05, -0.1, 0.1), 1.03))
    mask = seen_by(CAMERA, truth.objects[0].surface).mask
    told = same_but(truth, ball, ((0.2, 0.1, -0.1), 0.8))
    return Case(truth, told, (*OF_MATERIAL, "center", "radius"), {"mask": mask})


@pytest.mark.parametrize(
    "build",
    [
        positions_of_lights,
        intensities_of_lights,
        spots_of_unknown_softness,
        centre_and_radius_of_a_sphere,
    ],
)
def test_what_the_scene_has_wrong_is_found_together_with_the_material(build):
    case = build()
    clean = photographs(case.truth)
    exact = case.fit(clean)
    truth = exact.values_in(case.truth)
    assert np.abs(exact.values_in(case.told) - truth).max() > 0.1
    np.testing.assert_allclose(exact.values, truth, rtol=1e-5, atol=1e-5)
    assert exact.converged
    assert exact.determined.all()

    fit = case.fit(noisy(clean, SIGMA, 5))
    assert fit.converged
    assert np.isfinite(fit.plain_errors).all()
    assert (fit.plain_errors > 0).all()
    assert np.abs((fit.values - truth) / fit.plain_errors).max() < 4.5
    assert fit.rmse == pytest.approx(SIGMA, rel=0.06)


def test_lights_that_are_on_together_are_found_from_one_photograph():
    """Judged one light after another, with the others still out of place, these lead astray."""
    where = lambda s: [l.position for l in s.lights]  # noqa: E731
    fade = ds.RadialAttenuation(1.0, 0.0, 0.2)
    places = np.array([(2.0, 3.0, 4.0), (-2.0, 1.0, 3.0), (0.5, -2.0, 4.0)])
    truth = standard_scene(ds.Material(0.1, (0.6, 0.4, 0.25), 0.5, 40), [ds.PointLight(p, 5.0, fade) for p in places])
    told = same_but(truth, where, places + np.array([(-1.0, -2.0, 1.0), (1.0, 0.0, 2.0), (-0.5, 1.0, 1.0)]))
    fit = ds.fit(forget(told), ds.View(photograph(truth), CAMERA), free=(*OF_MATERIAL, "position"))
    found, true = fit.values, fit.values_in(truth)
    np.testing.assert_allclose(found[:-9], true[:-9], rtol=1e-4, atol=1e-4)
    # which of three equal lights is which is not to be told
    by_height = [sorted(values[-9:].reshape(3, 3).tolist(), key=lambda place: place[1]) for values in (found, true)]
    np.testing.assert_allclose(*by_height, rtol=1e-4, atol=1e-4)


def test_a_light_told_to_stand_in_the_middle_of_the_sphere_is_found():
    where = lambda s: [l.position for l in s.lights]  # noqa: E731
    truth = standard_scene(lights=THREE)
    told = same_but(truth, where, [np.zeros(3), *light_positions()[1:3]])
    free = (*OF_MATERIAL, "lights.0.position")
    fit = ds.fit(forget(told), one_light_each(photographs(truth)), free=free)
    np.testing.assert_allclose(fit.values, fit.values_in(truth), rtol=1e-5, atol=1e-5)


def test_the_cutoff_of_a_spot_whose_edge_is_two_pixels_wide_is_found_from_far_off():
    """The sphere is 24 pixels wide, so that one of them is 1.5 degrees of the spot's cone."""
    shape = lambda s: [x for l in s.lights for x in (l.cutoff, l.exponent)]  # noqa: E731
    spot = ds.SpotLight((0.6, 0.8, 3.0), (-0.6, -0.8, -3.0), 3.0, 11.0, 20.0, softness=3.0)
    truth = standard_scene(lights=[spot])
    for cutoff in (7.0, 16.0, 40.0):
        told = same_but(truth, shape, [cutoff, 0.0])
        fit = ds.fit(forget(told), ds.View(photograph(truth), CAMERA), free=(*OF_MATERIAL, "cutoff", "exponent"))
        np.testing.assert_allclose(fit.values[-2:], (11.0, 20.0), rtol=1e-5)


# --- directions, which are unit vectors


def angle(a: Any, b: Any) -> float:
    """Degrees between two directions."""
    a, b = np.asarray(a), np.asarray(b)
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def test_a_direction_is_fitted_as_a_unit_vector_with_honest_errors_across_it():
    eyes = [(0, 0, 4), (2, 1, 3.4), (-2, 1, 3.4), (0, -2.5, 3.1)]
    cameras = [ds.Camera(eye=eye, fov=32, shape=CAMERA.shape) for eye in eyes]
    light = ds.DirectionalLight((-1.2, -0.9, -2.0))
    truth = standard_scene(lights=[light])
    told = same_but(truth, lambda s: [s.lights[0].direction], [(1.0, -4.0, -6.0)])  # and not of unit length
    clean = [photograph(truth, camera) for camera in cameras]
    assert angle(told.lights[0].direction, light.direction) > 30  # pyright: ignore[reportAttributeAccessIssue]

    def fit_to(images: Sequence[np.ndarray]) -> ds.Fit:
        views = [ds.View(image, camera) for image, camera in zip(images, cameras, strict=True)]
        return ds.fit(forget(told), views, free=(*OF_MATERIAL, "direction"))

    exact = fit_to(clean)
    np.testing.assert_allclose(exact.values, exact.values_in(truth), rtol=1e-7, atol=1e-7)
    squares, ratios, seeds = [], [], range(20)
    for seed in seeds:
        fit = fit_to(noisy(clean, 0.01, seed))
        assert fit.names[-3:] == ("direction.x", "direction.y", "direction.z")
        d = fit.values[-3:]
        off, C = d - fit.values_in(truth)[-3:], fit.covariance[-3:, -3:]
        assert np.linalg.norm(d) == pytest.approx(1.0, abs=1e-12)
        np.testing.assert_array_equal(fit.scene.lights[0].direction, d)  # pyright: ignore[reportAttributeAccessIssue]
        assert fit.determined.all()
        assert np.isfinite(fit.plain_errors).all()
        assert np.isfinite(fit.errors).all()
        assert np.abs(C @ d).max() < 1e-12 * np.abs(C).max()  # it does not vary along itself
        expected = np.degrees(np.sqrt(np.trace(C)))
        assert angle(d, light.direction) < 5 * expected  # no seed jumps elsewhere
        assert expected < 1.0
        assert np.abs((fit.values - fit.values_in(truth)) / fit.plain_errors).max() < 4.5
        squares.append(off @ np.linalg.pinv(C, rcond=1e-6) @ off)
        ratios.append(fit.errors / fit.plain_errors)
    low, high = scipy.stats.chi2.interval(1 - 1e-4, 2 * len(seeds))
    assert low < sum(squares) < high
    assert 0.5 < np.median(ratios) < 2.0  # the jackknife of four views is rough


def test_the_black_of_every_view_is_found_where_the_ambient_reflection_is_known():
    truth = three_lights()
    exposures, blacks = (1.0, 0.5, 2.0), (0.01, 0.05, -0.02)
    images = [e * image + b for e, b, image in zip(exposures, blacks, photographs(truth), strict=True)]
    views = [ds.View(image, CAMERA, lit=i, exposure=exposures[i]) for i, image in enumerate(images)]
    fit = ds.fit(forget(truth, ("k_d", "k_s", "n_s")), views, free=("k_d", "k_s", "n_s", "black"))
    assert [float(view.black) for view in fit.views] == pytest.approx(blacks, abs=1e-9)
    np.testing.assert_allclose(fit.material.k_d, MATERIAL.k_d, rtol=1e-9)
