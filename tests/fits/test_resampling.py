"""The bootstrap over views."""

import numpy as np
import pytest
from synthetic import FREE, TIED, noisy, one_light_each, photographs, standard_scene

import diffshade as ds


@pytest.fixture(scope="module")
def off():
    """Photographs whose exposures are off by a few per cent: an error that a whole view shares."""
    random = np.random.default_rng(1)
    images = noisy(photographs(standard_scene()), 0.005, 0)
    return [random.uniform(0.95, 1.05) * image for image in images]


def test_its_spread_is_the_jackknifes_size(off):
    fit = ds.fit(standard_scene(), one_light_each(off), free=("k_a", "k_d", "k_s", "n_s"))
    assert fit.errors is not None
    spread = ds.bootstrap(fit, draws=200).std(0)
    assert np.all((spread > 0.5 * fit.errors) & (spread < 1.6 * fit.errors))
    k_d = [name.startswith("k_d") for name in fit.names]
    assert np.all(spread[k_d] > 3 * fit.plain_errors[k_d])


def test_a_draw_is_the_fit_of_the_views_drawn(off):
    """Of one seed the first draw's views are known; a fit of these, each as often as drawn, finds the same."""
    fit = ds.fit(standard_scene(), one_light_each(off), free=FREE, tied=TIED)
    (first,) = ds.bootstrap(fit, draws=1, seed=3)
    drawn = np.random.default_rng(3).integers(8, size=8)
    views = one_light_each(off)
    # a repeated photograph would be counted once: the weight of a view drawn m times is that of noise / sqrt(m)
    counts = np.bincount(drawn, minlength=8)
    weighted = [
        ds.View(v.image, v.camera, lit=v.lit, noise=0.01 / np.sqrt(m)) for v, m in zip(views, counts, strict=True) if m
    ]
    again = ds.fit(standard_scene(), weighted, free=FREE, tied=TIED)
    np.testing.assert_allclose(first, again.values, rtol=1e-5)


def test_a_seed_gives_the_same_draws(off):
    fit = ds.fit(standard_scene(), one_light_each(off), free=("k_d",))
    np.testing.assert_array_equal(ds.bootstrap(fit, draws=3), ds.bootstrap(fit, draws=3))
    assert (ds.bootstrap(fit, draws=3, seed=1) != ds.bootstrap(fit, draws=3)).any()


def test_two_views_and_no_draws_are_refused(off):
    fit = ds.fit(standard_scene(), one_light_each(off)[:2], free=("k_d",))
    with pytest.raises(ValueError, match=r"bootstrap needs three or more views taken in different ways; got 2\."):
        ds.bootstrap(fit)
    fit = ds.fit(standard_scene(), one_light_each(off), free=("k_d",))
    with pytest.raises(ValueError, match="draws must be a whole number of at least 1; got 0"):
        ds.bootstrap(fit, draws=0)
