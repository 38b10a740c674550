"""Many fits: what forecast, the jackknife and the bootstrap say of their spread."""

import numpy as np
import pytest
from scenarios import noisy_images, standard_fit
from synthetic import CAMERA, FREE, TIED, noisy, one_light_each, photographs, standard_scene

import diffshade as ds

pytestmark = pytest.mark.slow

BLANK = np.zeros((*CAMERA.shape, 3))


def test_the_errors_are_those_that_fits_then_have_whatever_the_images_hold():
    scene, clean = standard_scene(), photographs(standard_scene())
    forecast = ds.forecast(scene, one_light_each([BLANK] * 8), free=FREE, tied=TIED, noise=0.02)
    fits = [ds.fit(scene, one_light_each(noisy(clean, 0.02, s)), free=FREE, tied=TIED) for s in range(40)]
    assert forecast.names == fits[0].names
    assert forecast.determined.all()
    assert not forecast.notes
    values = np.array([fit.values for fit in fits])
    spread = np.sqrt(np.mean((values - forecast.values) ** 2, 0))
    np.testing.assert_allclose(np.mean([fit.plain_errors for fit in fits], 0), forecast.errors, rtol=0.05)
    assert np.all((spread / forecast.errors > 0.7) & (spread / forecast.errors < 1.4))  # 40 draws: +-.11, 3 of them


def test_a_gauge_is_forecast():
    forecast = ds.forecast(
        standard_scene(), one_light_each([BLANK] * 8), free=("k_d", "k_s", "intensity"), tied="intensity"
    )
    assert not forecast.determined.any()
    assert "not determined" in str(forecast)
    assert any("cannot separate" in note for note in forecast.notes)


def test_a_noise_may_depend_on_the_level():
    views = one_light_each([BLANK] * 8)
    bright = ds.forecast(standard_scene(), views, free=("k_d",), noise=ds.Noise(read=0.01, shot=0.01))
    assert np.all(bright.errors > ds.forecast(standard_scene(), views, free=("k_d",), noise=0.01).errors)


def test_the_jackknife_is_that_of_eight_fits_without_one_view_each():
    """The jackknife of the Gram matrices is the first order of these refits."""
    images = noisy_images(0, 0.02)
    views, scene = one_light_each(images), standard_scene()
    without = np.array(
        [ds.fit(scene, [*views[:v], *views[v + 1 :]], free=FREE, tied=TIED).values for v in range(len(views))]
    )
    G = len(views)
    expected = np.sqrt((G - 1) / G * np.sum((without - without.mean(0)) ** 2, 0))
    np.testing.assert_allclose(standard_fit(images).evidence.clustered_errors(), expected, rtol=0.05)


@pytest.fixture(scope="module")
def off():
    """Photographs whose exposures are off by a few per cent: an error that a whole view shares."""
    random = np.random.default_rng(1)
    images = noisy(photographs(standard_scene()), 0.005, 0)
    return [random.uniform(0.95, 1.05) * image for image in images]


def test_its_spread_is_the_jackknifes_size(off):
    fit = ds.fit(standard_scene(), one_light_each(off), free=("k_a", "k_d", "k_s", "n_s"))
    spread = ds.bootstrap(fit, draws=200).std(0)
    errors = fit.evidence.clustered_errors()
    assert np.all((spread > 0.5 * errors) & (spread < 1.6 * errors))
    k_d = [name.startswith("k_d") for name in fit.names]
    assert np.all(spread[k_d] > 3 * fit.plain_errors[k_d])
