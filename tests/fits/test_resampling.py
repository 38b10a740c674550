"""The bootstrap over views."""

import numpy as np
import pytest
from changed_fits import with_problem
from scenarios import noisy_fit, noisy_images
from synthetic import FREE, TIED, forget, one_light_each, standard_scene

import diffshade as ds


def test_a_draw_is_the_fit_of_the_views_drawn():
    """Of one seed the first draw's views are known; a fit of these, each as often as drawn, finds the same."""
    first, second = ds.bootstrap(noisy_fit(), draws=2, seed=3)
    drawn = np.random.default_rng(3).integers(8, size=8)
    # a repeated photograph would be counted once: the weight of a view drawn m times is that of noise / sqrt(m)
    counts = np.bincount(drawn, minlength=8)
    assert counts.min() == 0
    views = [
        ds.View(v.image, v.camera, lit=v.lit, noise=0.01 / np.sqrt(m) if m else 1e9)
        for v, m in zip(one_light_each(noisy_images()), counts, strict=True)
    ]
    again = ds.fit(forget(standard_scene()), views, free=FREE, tied=TIED)
    np.testing.assert_allclose((first - again.values) / noisy_fit().plain_errors, 0.0, atol=1e-2)
    assert np.all(second != first)


def test_a_seed_gives_the_same_draws():
    draws = ds.bootstrap(noisy_fit(), draws=2)
    np.testing.assert_array_equal(draws, ds.bootstrap(noisy_fit(), draws=2, seed=0))
    assert np.all(draws != ds.bootstrap(noisy_fit(), draws=2, seed=1))


def test_too_few_views_and_no_draws_are_refused():
    with pytest.raises(ValueError, match="at least three views with different cameras or lights; got 2"):
        ds.bootstrap(with_problem(noisy_fit(), views=noisy_fit().views[:2]))
    with pytest.raises(ValueError, match="draws must be a whole number of at least 1; got 0"):
        ds.bootstrap(noisy_fit(), draws=0)
    with pytest.raises(ValueError, match="seed must be a whole number of at least 0; got -1"):
        ds.bootstrap(noisy_fit(), seed=-1)
    with pytest.raises(TypeError, match="fit"):
        ds.bootstrap("fit")  # pyright: ignore[reportArgumentType]
