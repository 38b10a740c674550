"""Foresight: the errors it promises are those that a fit then has."""

import numpy as np
import pytest
from scenarios import SIGMA, noisy_fit
from synthetic import CAMERA, FREE, TIED, one_light_each, standard_scene

import diffshade as ds
from diffshade.diagnosis.forecasting import Forecast

BLANK = np.zeros((*CAMERA.shape, 3))


@pytest.mark.thorough
def test_the_errors_are_those_that_a_fit_then_has_whatever_the_images_hold():
    scene = standard_scene()
    foresight = ds.forecast(scene, one_light_each([BLANK] * 8), free=FREE, tied=TIED, noise=SIGMA)
    fit = noisy_fit()
    assert foresight.names == fit.names
    assert foresight.determined.all()
    assert not foresight.notes
    np.testing.assert_allclose(foresight.values, fit.values_in(scene), rtol=1e-9)
    np.testing.assert_allclose(fit.plain_errors, foresight.errors, rtol=0.05)
    by_view = ds.forecast(scene, one_light_each([BLANK] * 8, noise=SIGMA), free=FREE, tied=TIED)
    np.testing.assert_allclose(by_view.errors, foresight.errors, rtol=1e-12)


def test_a_photograph_counts_as_often_as_it_will_be_taken():
    """Twice the first light is once with a noise smaller by sqrt 2; the last light then says nothing."""
    lit, noises = [*range(7), 0], [SIGMA / np.sqrt(2.0), *[SIGMA] * 6, 1e9]
    twice = [ds.View(BLANK, CAMERA, lit=i, noise=SIGMA) for i in lit]
    once = [ds.View(BLANK, CAMERA, lit=i, noise=noise) for i, noise in enumerate(noises)]
    of_twice, of_once = (ds.forecast(standard_scene(), views, free=FREE, tied=TIED) for views in (twice, once))
    np.testing.assert_allclose(of_twice.errors, of_once.errors, rtol=1e-6)
    assert not of_twice.notes


def test_what_is_not_determined_has_no_number():
    said = Forecast(("k_d", "n_s"), np.array([0.5, 20.0]), np.array([0.01, np.inf]), np.array([True, False]), ("Fix.",))
    title, head, k_d, n_s, note = str(said).splitlines()
    assert title.startswith("forecast")
    assert head.split() == ["parameter", "value", "error"]
    assert k_d.split() == ["k_d", "0.500", "0.010"]
    assert n_s.split() == ["n_s", "not", "determined"]
    assert note == "- Fix."


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"noise": 0.0}, ValueError, "noise must be above 0; got 0.0"),
        ({"noise": np.inf}, ValueError, "noise must be above 0; got inf"),
        ({"free": ()}, ValueError, "free must name at least one"),
        ({"views": []}, ValueError, "at least one view"),
        ({"scene": "x"}, TypeError, "scene"),
    ],
)
def test_what_it_cannot_take_is_refused(change, error, words):
    given = {"scene": standard_scene(), "views": one_light_each([BLANK] * 8), "free": ("k_d",), "noise": 0.01} | change
    scene, views = given.pop("scene"), given.pop("views")
    with pytest.raises(error) as refusal:
        ds.forecast(scene, views, **given)
    assert words in str(refusal.value)
