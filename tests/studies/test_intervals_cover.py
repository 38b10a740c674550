"""Intervals: they hold the truth as often as they say, of independent noise and of errors that a view shares."""

from collections.abc import Callable

import jax
import numpy as np
import pytest
from scenarios import clean_images
from scipy import ndimage
from synthetic import FREE, TIED, forget, noisy, one_light_each, photographs, point_lights, standard_scene

import diffshade as ds
from diffshade.diagnosis.intervals import LikelihoodProfile, intervals
from diffshade.diagnosis.patches import find_clusters
from diffshade.inverse.unknowns.unknown import coordinates

pytestmark = pytest.mark.slow

LEVELS = (0.68, 0.95)


def covered(
    scene: ds.Scene, images: Callable[[int], list[np.ndarray]], seeds: range, views: int | None = None
) -> np.ndarray:
    """For each fit, level and unknown whether the interval holds the truth: whether one refit there costs too much."""
    inside = []
    with jax.enable_x64(True):
        for seed in seeds:
            fit = ds.fit(forget(scene), one_light_each(images(seed))[:views], free=FREE, tied=TIED)
            clusters = find_clusters(fit)
            profile = LikelihoodProfile(fit, clusters)
            truth = coordinates(fit.values_in(scene), fit.unknowns)
            away = np.array([profile.errors_away(j, t) for j, t in enumerate(truth)])
            inside.append([away < clusters.quantiles(level) for level in LEVELS])
    return np.array(inside)


def independent(seed: int) -> list[np.ndarray]:
    return noisy(clean_images(), 0.02, seed)


def test_they_cover_of_independent_noise():
    share = covered(standard_scene(), independent, range(1000)).mean(0)
    for level, tolerance, of_level in zip(LEVELS, (0.045, 0.021), share, strict=True):
        np.testing.assert_allclose(of_level, level, atol=tolerance)


def shared(scene: ds.Scene, kind: str, size: float) -> Callable[[int], list[np.ndarray]]:
    """Photographs with noise and an error that is smooth over each view: added, a factor of each pixel, or of all."""
    clean = photographs(scene)

    def of_seed(seed: int) -> list[np.ndarray]:
        random = np.random.default_rng(10_000 + seed)
        found = []
        for image in noisy(clean, 0.01, seed):
            field = ndimage.gaussian_filter(random.standard_normal(image.shape[:2]), 5, mode="wrap")
            field *= size / field.std()
            factor = 1.0 + size * random.standard_normal() if kind == "exposure" else 1.0 + field[..., None]
            found.append(image + field[..., None] if kind == "added" else image * factor)
        return found

    return of_seed


@pytest.mark.parametrize("count", [8, 20], ids="{} views".format)
@pytest.mark.parametrize(
    ("kind", "size", "fits"),
    [
        ("added", 0.01, 40),
        ("added", 0.02, 400),
        ("added", 0.002, 400),
        ("factor", 0.01, 400),
        ("factor", 0.03, 400),
        ("exposure", 0.02, 400),
    ],
)
def test_they_cover_of_an_error_that_each_view_shares(count, kind, size, fits):
    scene = standard_scene(lights=point_lights(count=count))
    share = covered(scene, shared(scene, kind, size), range(fits))[:, 1].mean(0)
    assert share.min() >= 0.9 - 2.0 * np.sqrt(0.9 * 0.1 / fits)  # 90 % but for two standard errors of so many fits


@pytest.mark.parametrize("bound", ["one view", "a truth at 0"])
def test_where_a_bound_binds_they_cover_at_least_as_much(bound):
    scene = standard_scene()
    if bound == "a truth at 0":
        scene = standard_scene(ds.Material((0.1, 0.08, 0.06), (0.6, 0.4, 0.25), (0.5, 0.5, 0.0), 50))
    clean = photographs(scene)
    views = 1 if bound == "one view" else None
    inside = covered(scene, lambda seed: noisy(clean, 0.01, seed), range(40), views).mean(0)
    error = np.sqrt(np.array(LEVELS) * (1 - np.array(LEVELS)) / 40)
    assert np.all(inside.min(1) >= np.array([0.65, 0.93]) - 2.5 * error)
    assert np.all(inside.mean(1) >= [0.62, 0.91])


@pytest.mark.parametrize("fits", [3, 50])
def test_an_interval_holds_the_truth_exactly_where_one_refit_says_so(fits):
    """The search for the ends, beside the test that the coverage above is made of."""
    with jax.enable_x64(True):
        for seed in range(fits):
            views = one_light_each(independent(seed))[: 1 + seed % 8]
            fit = ds.fit(forget(standard_scene()), views, free=FREE, tied=TIED)
            clusters = find_clusters(fit)
            profile = LikelihoodProfile(fit, clusters)
            reach = clusters.quantiles(0.95)
            truth = fit.values_in(standard_scene())
            inner = coordinates(truth, fit.unknowns)
            for j, (low, high) in enumerate(intervals(profile, (0.95,))[0]):
                assert low <= fit.values[j] <= high
                away = profile.errors_away(j, inner[j])
                if abs(away / reach[j] - 1.0) > 0.03:  # nearer than the search ends
                    assert (low <= truth[j] <= high) == (away < reach[j]), (seed, fit.names[j])
