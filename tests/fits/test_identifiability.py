"""Identifiability: what views cannot tell is said in three grades, by name and with a remedy, and never as a number."""

import numpy as np
import pytest
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
    seen_by,
    standard_scene,
)

import diffshade as ds
from diffshade.diagnosis.stability import angle_to_highlight

SIGMA = 0.005


def not_told(fit: ds.Fit | ds.Foresight) -> set[str]:
    """The quantities of which the table gives no number in some channel."""
    return {name.rsplit(".", 1)[0] for name, known in zip(fit.names, fit.determined, strict=True) if not known}


def assert_not_told(fit: ds.Fit | ds.Foresight, *names: str) -> None:
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
    assert twice.errors is None  # two views are no three
    assert twice.counts.views == 2
    assert "views[2] is views[1] again, the same numbers, and is counted once." in twice.notes


def test_two_photographs_taken_alike_are_one_for_the_jackknife():
    """Their noise differs, so both count; what the set-up has wrong they share."""
    scene = standard_scene()
    clean = photographs(scene)
    views = [*one_light_each(noisy(clean, SIGMA, 0))[:2], *one_light_each(noisy(clean, SIGMA, 1))[:2]]
    fit = ds.fit(forget(scene), views, free=("k_a", "k_d", "k_s", "n_s"))
    assert fit.counts.views == 4
    assert fit.errors is None
    assert any("4 views, taken in 2 ways: no errors by jackknife" in note for note in fit.notes)


def test_what_is_hardly_separated_is_told_apart_from_what_cannot_be():
    """A known noise of almost nothing: the numbers are good, and hang on the model."""
    scene = standard_scene(lights=[ds.PointLight((6, 6, 14), 10.0, ds.RadialAttenuation(1.0, 0.09, 0.032))])
    view = ds.View(photograph(scene), CAMERA, noise=1e-7)
    foresight = ds.foresee(scene, view, free=FREE)
    assert not not_told(foresight)
    (note,) = foresight.notes
    assert note.startswith("these views hardly separate k_d")
    assert note.endswith(
        "linear and quadratic: changed together they change the pixels a thousandth as much as apart, so that the "
        "errors stand and fall with the model. Fix one, for example quadratic, or add photographs with the lamp at "
        "three distances that differ by half."
    )
    noisy_one = ds.foresee(scene, ds.View(photograph(scene), CAMERA), free=FREE, noise=0.01)
    assert {"linear", "quadratic"} <= not_told(noisy_one)
    assert any("linear is lost in the noise: its error is" in note for note in noisy_one.notes)


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


def test_correlations_have_one_on_their_diagonal_and_a_gauge_has_none():
    scene = standard_scene()
    fit = ds.fit(scene, one_light_each(noisy(photographs(scene), SIGMA, 0)), free=FREE, tied=TIED)
    correlation = fit.correlation
    np.testing.assert_allclose(np.diag(correlation), 1.0)
    assert np.all(np.abs(correlation) <= 1.0 + 1e-12)
    linear, quadratic = fit.names.index("linear"), fit.names.index("quadratic")
    assert correlation[linear, quadratic] < -0.5  # what one fades the other need not
    gauge = ds.fit(scene, views := one_light_each(photographs(scene)), free=("k_a", "ambient"))
    assert views
    assert not gauge.correlation.any()


def test_with_a_number_lost_at_its_bound_the_others_have_the_errors_of_it_free():
    """One view, linear at 0 and lost there: with it held k_d would look ten times as good as it is."""
    scene = standard_scene()
    off = []
    for seed in range(6):
        view = one_light_each(noisy(photographs(scene), 0.01, seed))[:1]
        fit = ds.fit(forget(scene), view, free=FREE, tied=TIED)
        off.append(((fit.values - fit.values_in(scene)) / fit.plain_errors)[fit.names.index("k_d.r")])
    assert np.abs(off).max() < 3


@pytest.mark.parametrize("lit", [None, (0, 1), (1, 0)])
def test_how_a_view_says_which_lights_are_on_does_not_hide_that_it_is_one_again(lit):
    scene = standard_scene(lights=standard_scene().lights[:2])
    image = noisy([photograph(scene)], SIGMA, 0)[0]
    views = [ds.View(image, CAMERA), ds.View(image, CAMERA, lit=lit)]
    fit = ds.fit(scene, views, free=("k_d", "views.1.exposure"))
    assert fit.counts.views == 1
    assert any("views[1] is views[0] again" in note for note in fit.notes)
    assert any("views.1.exposure" in note or "exposure" in note for note in fit.notes if "do not determine" in note)


def test_a_burst_that_is_foreseen_counts_as_often_as_it_will_be_taken():
    scene, blank = standard_scene(), np.zeros((*CAMERA.shape, 3))
    one, four = (ds.foresee(scene, [ds.View(blank, CAMERA)] * n, free=("k_d", "k_s")) for n in (1, 4))
    np.testing.assert_allclose(one.errors / four.errors, 2.0, rtol=1e-9)
    assert not four.notes
