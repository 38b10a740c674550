"""Fits of what views cannot tell: it is said by name and with a remedy, and never as a number."""

import numpy as np
import pytest
from scenarios import assert_undetermined
from synthetic import (
    CAMERA,
    FREE,
    MATERIAL,
    TIED,
    forget,
    noisy,
    one_light_each,
    photograph,
    photographs,
    point_lights,
    seen_by,
    standard_scene,
)

import diffshade as ds
from diffshade.diagnosis.forecasting import Forecast
from diffshade.inverse.verdicts.stability import angle_to_highlight

SIGMA = 0.005


def not_told(fit: ds.Fit | Forecast) -> set[str]:
    """The quantities of which the table gives no number in some channel."""
    return {name.rsplit(".", 1)[0] for name, known in zip(fit.names, fit.determined, strict=True) if not known}


def assert_not_told(fit: ds.Fit | Forecast, *names: str) -> None:
    assert not_told(fit) == set(names)
    for name, known in zip(fit.names, fit.determined, strict=True):
        (line,) = [line for line in str(fit).splitlines() if line.startswith(f"{name} ")]
        assert ("not determined" in line) == (not known)
    for name in names:
        assert any(name in note for note in fit.notes), name


def hollow(*radii: float) -> ds.Scene:
    """Half a hollow ball lit from its centre, its columns at these distances in turn."""
    ball = seen_by(CAMERA)
    assert ball.position is not None
    at = np.resize(radii, ball.mask.shape[1])[None, :, None]
    surface = ds.GBuffer(-ball.normal, at * np.asarray(ball.position), ball.mask)
    light = ds.PointLight((0, 0, 0), 1.0, ds.RadialAttenuation(1.0, 0.3, 0.2))
    return ds.Scene(ds.Object(surface, ds.Material(0.1, (0.6, 0.5, 0.4))), light)


def one_view(scene: ds.Scene, **options) -> ds.View:
    return ds.View(noisy([photograph(scene)], SIGMA, 0)[0], CAMERA, **options)


@pytest.mark.parametrize("distances", [(1.0,), (1.0, 2.0)], ids=["one distance", "two distances"])
def test_one_or_two_distances_do_not_tell_linear_from_quadratic(distances):
    scene = hollow(*distances)
    fit = ds.fit(forget(scene, ("k_d",)), one_view(scene), free=("k_d", "attenuation"))
    assert_not_told(fit, "k_d", "linear", "quadratic")
    assert any("cannot separate" in note for note in fit.notes)


def test_three_distances_do():
    scene = hollow(1.0, 2.0, 4.0)
    fit = ds.fit(forget(scene, ("k_d",)), one_view(scene), free=("k_d", "attenuation"))
    assert not not_told(fit)


def test_the_attenuation_of_a_far_lamp():
    far = ds.PointLight((12, 12, 30), 30.0, ds.RadialAttenuation(1.0, 0.09, 0.032))
    scene = standard_scene(lights=[far])
    fit = ds.fit(forget(scene), one_view(scene), free=FREE, bounds={"attenuation": (0, 1)})
    assert_not_told(fit, "k_d", "k_s", "linear", "quadratic")


@pytest.mark.parametrize("seed", range(3))
def test_n_s_of_a_matte_ball(seed):
    matte = standard_scene(ds.Material(MATERIAL.k_a, MATERIAL.k_d, 0.0, 20))
    images = noisy(photographs(matte), SIGMA, seed)
    fit = ds.fit(forget(matte), one_light_each(images), free=FREE, tied=TIED)
    assert "n_s" in not_told(fit)
    assert not_told(fit) <= {"n_s", "k_s"}  # a narrow lobe may take some of the noise for its own
    assert_not_told(fit, *not_told(fit))


def test_n_s_with_no_pixel_near_the_highlight():
    scene = standard_scene()
    views = []
    for i, image in enumerate(noisy(photographs(scene), SIGMA, 0)):
        view = ds.View(image, CAMERA, lit=(i,))
        views.append(ds.View(image, CAMERA, lit=(i,), mask=angle_to_highlight(scene, view) > 37.0))
    fit = ds.fit(forget(scene), views, free=("k_a", "k_d", "k_s", "n_s"))
    assert {"k_s", "n_s"} >= not_told(fit) > set()
    assert "n_s" in not_told(fit)
    assert any("n_s" in note and "highlight" in note for note in fit.notes)


def test_a_view_given_twice_is_counted_once_and_said_to_be():
    scene = standard_scene()
    views = one_light_each(noisy(photographs(scene), SIGMA, 0))
    free = ("k_a", "k_d", "k_s", "n_s")
    once, twice = (ds.fit(forget(scene), v, free=free) for v in (views[:2], [*views[:2], views[1]]))
    np.testing.assert_allclose(twice.values, once.values, rtol=1e-9)
    np.testing.assert_allclose(twice.plain_errors, once.plain_errors, rtol=1e-9)
    np.testing.assert_allclose(twice.errors, once.errors, rtol=1e-9)
    assert twice.counts.views == 2
    assert "views[2] repeats views[1] and is not counted again." in twice.notes


def test_two_photographs_taken_alike_are_one_for_the_jackknife():
    """Their noise differs, so both count; what the set-up has wrong they share."""
    scene = standard_scene()
    clean = photographs(scene)
    views = [*one_light_each(noisy(clean, SIGMA, 0))[:2], *one_light_each(noisy(clean, SIGMA, 1))[:2]]
    fit = ds.fit(forget(scene), views, free=("k_a", "k_d", "k_s", "n_s"))
    assert fit.counts.views == 4
    assert fit.evidence.count == 2
    assert not fit.clusters.by_jackknife.any()
    assert "4 views in 2 setups" in str(fit)


def test_a_small_number_is_no_lost_one():
    """k_s is 0 within the noise where k_d is large: that is known of it."""
    scene = standard_scene(ds.Material(0.1, (0.6, 0.4, 0.25), 0.001, 50))
    views = one_light_each(noisy(photographs(scene), SIGMA, 0))
    fit = ds.fit(scene, views, free=("k_d", "k_s"))
    assert fit.determined.all()
    vague = fit.plain_errors > 0.3 * fit.values
    inside = [name for name, here in zip(fit.names, vague & ~fit.at_bound, strict=True) if here]
    assert inside
    (note,) = [note for note in fit.notes if note.startswith("0 within the noise")]
    assert all(name in note for name in inside)


def test_with_a_number_lost_at_its_bound_the_others_have_the_errors_of_it_free():
    """One view, linear at 0 and lost there: with it held k_d would look ten times as good as it is."""
    scene = standard_scene()
    off = []
    for seed in range(6):
        view = one_light_each(noisy(photographs(scene), 0.01, seed))[:1]
        fit = ds.fit(forget(scene), view, free=FREE, tied=TIED)
        off.append(((fit.values - fit.values_in(scene)) / fit.plain_errors)[fit.names.index("k_d.r")])
    assert np.abs(off).max() < 3


@pytest.mark.parametrize("lit", [None, (1, 0)])
def test_how_a_view_says_which_lights_are_on_does_not_hide_that_it_is_one_again(lit):
    scene = standard_scene(lights=standard_scene().lights[:2])
    image = noisy([photograph(scene)], SIGMA, 0)[0]
    views = [ds.View(image, CAMERA), ds.View(image, CAMERA, lit=lit)]
    fit = ds.fit(scene, views, free=("k_d", "views.1.exposure"))
    assert fit.counts.views == 1
    assert any(note.kind == "repeated views" for note in fit.notes)
    assert any("views.1.exposure" in note or "exposure" in note for note in fit.notes if "do not determine" in note)


# --- gauges

ONE_LIGHT = standard_scene(lights=[standard_scene().lights[0]])


def one_photograph(scene: ds.Scene, **options) -> list[ds.View]:
    return [ds.View(noisy([photograph(scene)], 0.005, 0)[0], CAMERA, **options)]


def the_gauges(fit: ds.Fit) -> list[str]:
    return [note for note in fit.notes if "cannot separate" in note or "do not determine" in note]


def test_brightness_of_light_and_material_are_one_gauge():
    fit = ds.fit(forget(ONE_LIGHT, ("k_d", "k_s")), one_photograph(ONE_LIGHT), free=("k_d", "k_s", "intensity"))
    assert_undetermined(fit, "k_d", "k_s", "intensity")
    (said,) = the_gauges(fit)
    assert "k_d and k_s from intensity" in said
    assert "example intensity" in said


def test_material_and_attenuation_with_its_constant_are_one_gauge():
    free = ("k_d", "k_s", "constant", "linear", "quadratic")
    fit = ds.fit(forget(ONE_LIGHT, ("k_d", "k_s")), one_photograph(ONE_LIGHT), free=free)
    assert_undetermined(fit, *free)
    (gauge,) = fit.notes
    assert "k_d and k_s from constant, linear and quadratic" in gauge
    assert "example constant" in gauge


def test_a_constant_of_zero_is_a_gauge_too_and_nothing_is_said_of_the_size_of_what_it_scales():
    """With f_rad = 1/(a1 d + a2 d^2) the material scales with both; that k_d comes out above 1 then means nothing."""
    scene = standard_scene(lights=point_lights(ds.RadialAttenuation(0.0, 0.1, 0.3)))
    fit = ds.fit(forget(scene), one_light_each(noisy(photographs(scene), 0.005, 0)), free=FREE, tied=TIED)
    assert_undetermined(fit, "k_d", "k_s", "linear", "quadratic")
    (note,) = fit.notes
    assert "k_d and k_s from linear and quadratic" in note
    assert "example quadratic" in note


def test_one_distance_does_not_tell_linear_from_quadratic():
    scene = hollow(1.0)
    fit = ds.fit(scene, one_photograph(scene), free=("attenuation",))
    assert_undetermined(fit, "linear", "quadratic")
    (said,) = the_gauges(fit)
    assert "cannot separate linear and quadratic" in said
    assert "example quadratic" in said


def test_a_light_that_lights_nothing_is_not_determined_either():
    behind = standard_scene(lights=[*ONE_LIGHT.lights, ds.DirectionalLight((0, 0, 1), 0.5)])
    fit = ds.fit(forget(behind, ("k_d",)), one_photograph(behind, lit=(0, 1)), free=("k_d", "lights.1.intensity"))
    assert_undetermined(fit, "lights.1.intensity")


def test_two_views_have_the_errors_of_noise_times_their_scatter():
    images = noisy(photographs(standard_scene()), 0.02, 0)
    fit = ds.fit(standard_scene(), one_light_each(images)[:2], free=("k_d",))
    assert fit.notes == ()
    assert not fit.clusters.by_jackknife.any()
    np.testing.assert_allclose(fit.errors, np.sqrt(max(fit.clusters.scatter, 1.0)) * fit.plain_errors, rtol=1e-3)
    assert "errors: for independent noise" in str(fit)


def test_a_number_that_one_view_alone_shows_has_no_jackknife_and_takes_none_from_the_others():
    images = noisy(photographs(standard_scene()), 0.02, 0)
    """Only photograph 2 shows light 2: without it that light's intensity is unknown, and k_d is what it is."""
    views = one_light_each(images)[:4]
    fit = ds.fit(standard_scene(), views, free=("k_d", "lights.2.intensity"))
    assert fit.determined.all()
    alone = fit.evidence.clustered_errors()
    np.testing.assert_allclose(alone[3:], fit.plain_errors[3:], rtol=1e-9)
