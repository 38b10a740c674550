"""Foresight: the errors to expect are those that fits then have."""

import numpy as np
import pytest
from synthetic import CAMERA, FREE, TIED, noisy, one_light_each, photographs, standard_scene

import diffshade as ds

BLANK = np.zeros((*CAMERA.shape, 3))


def test_the_errors_are_those_that_fits_then_have_whatever_the_images_hold():
    scene, clean = standard_scene(), photographs(standard_scene())
    foresight = ds.foresee(scene, one_light_each([BLANK] * 8), free=FREE, tied=TIED, noise=0.02)
    fits = [ds.fit(scene, one_light_each(noisy(clean, 0.02, s)), free=FREE, tied=TIED) for s in range(40)]
    assert foresight.names == fits[0].names
    assert foresight.determined.all()
    assert not foresight.notes
    values = np.array([fit.values for fit in fits])
    spread = np.sqrt(np.mean((values - foresight.values) ** 2, 0))
    np.testing.assert_allclose(np.mean([fit.plain_errors for fit in fits], 0), foresight.errors, rtol=0.05)
    assert np.all((spread / foresight.errors > 0.7) & (spread / foresight.errors < 1.4))  # 40 draws: +-.11, 3 of them


def test_the_noise_of_a_view_is_its_own():
    scene = standard_scene()
    by_view = ds.foresee(scene, one_light_each([BLANK] * 8, noise=0.02), free=FREE, tied=TIED)
    for_all = ds.foresee(scene, one_light_each([BLANK] * 8), free=FREE, tied=TIED, noise=0.02)
    np.testing.assert_allclose(by_view.errors, for_all.errors, rtol=1e-12)


def test_a_gauge_is_foreseen():
    foresight = ds.foresee(
        standard_scene(), one_light_each([BLANK] * 8), free=("k_d", "k_s", "intensity"), tied="intensity"
    )
    assert not foresight.determined.any()
    assert "not determined" in str(foresight)
    assert any("cannot separate" in note for note in foresight.notes)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (
            {"noise": 0.0},
            ValueError,
            "noise must be above 0; got 0.0. Give the standard deviation of a sample, or a",
        ),
        ({"free": ()}, ValueError, "free must name at least one parameter; got none."),
        ({"views": []}, ValueError, "fit needs at least one view; got none."),
        ({"scene": "x"}, TypeError, "scene"),
    ],
)
def test_what_it_cannot_take_is_refused(change, error, words):
    given = {"scene": standard_scene(), "views": one_light_each([BLANK] * 8), "free": ("k_d",), "noise": 0.01} | change
    scene, views = given.pop("scene"), given.pop("views")
    with pytest.raises(error) as refusal:
        ds.foresee(scene, views, **given)
    assert words in str(refusal.value)


def test_a_noise_may_depend_on_the_level():
    views = one_light_each([BLANK] * 8)
    bright = ds.foresee(standard_scene(), views, free=("k_d",), noise=ds.Noise(read=0.01, shot=0.01))
    assert np.all(bright.errors > ds.foresee(standard_scene(), views, free=("k_d",), noise=0.01).errors)
