"""Intervals: where the cost, the others at their best, has risen as they say; and what clusters errors are of."""

import dataclasses
import itertools
from typing import Any

import jax
import numpy as np
import pytest
from scenarios import clean_images, noisy_fit, noisy_images, standard_fit
from scipy import ndimage, stats
from synthetic import forget, noisy, one_light_each, standard_scene

import diffshade as ds
from diffshade.core.fields import Parameter
from diffshade.diagnosis.intervals import FAR, LikelihoodProfile, intervals
from diffshade.diagnosis.patches import (
    MAX_PATCHES,
    correlation_length,
    cut_in_patches,
    find_clusters,
    patch_width,
    residual_images,
)
from diffshade.inverse.data.view_sets import ViewSet
from diffshade.inverse.statistics.clusters import Clusters

LEVELS = (0.68, 0.95)


# --- the search for an end


class Curve(LikelihoodProfile):
    """A profile of one unknown, the best at 2, whose cost is said to be a power of the distance away."""

    def __init__(self, power: float = 1.0, bounds: tuple[float, float] = (-np.inf, np.inf), error: float = 0.1):
        unknowns = find("k_d")[:1] if np.isfinite(bounds[0]) else find("n_s")
        self.power, self.calls = power, 0
        self.fit: Any = type("", (), {})()
        self.fit.unknowns = [dataclasses.replace(unknowns[0], lower=bounds[0], upper=bounds[1], parameter=Parameter())]
        self.fit.values, self.fit.evidence = np.array([2.0]), type("", (), {"regular": np.array([True])})()
        self.laid: Any = type("", (), {"theta": np.array([2.0])})()
        self.errors, self.visible = np.array([error]), np.array([True])
        self.bounds = [np.array([bound]) for bound in bounds]

    def errors_away(self, j: int, t: float) -> float:
        self.calls += 1
        return float((abs(t - 2.0) / 0.1) ** self.power)


def find(name: str) -> list:
    return [u for u in noisy_fit().unknowns if u.kind == name]


@pytest.mark.parametrize("power", [0.3, 0.6, 1.0, 1.5, 3.0])
def test_an_end_is_where_the_cost_says_so_many_errors(power):
    for side, error in itertools.product((-1, 1), (0.1, 0.01, 1.0)):
        curve = Curve(power, error=error)
        end = curve.end(0, side, 1.96)
        assert np.sign(end - 2.0) == side
        assert curve.errors_away(0, end) == pytest.approx(1.96, rel=0.011)
        assert curve.calls < 17


def test_an_end_beyond_a_bound_is_the_bound():
    assert Curve(bounds=(1.9, 2.1)).end(0, 1, 1.96) == 2.1
    assert Curve(bounds=(1.9, 2.1)).end(0, -1, 1.96) == 1.9
    assert Curve(bounds=(1.7, 2.3)).end(0, 1, 1.96) == pytest.approx(2.196, abs=2e-3)
    assert Curve(bounds=(2.0, 2.3)).end(0, -1, 1.96) == 2.0
    lost = Curve(bounds=(0.0, 5.0))
    lost.fit.evidence.regular[:] = False
    assert [lost.end(0, side, 1.0) for side in (-1, 1)] == [0.0, 5.0]
    unseen = Curve(bounds=(0.0, 5.0), error=0.2)  # below the roundings of the cost: as the errors say
    unseen.visible[:] = False
    assert unseen.end(0, 1, 2.0) == pytest.approx(2.4)
    assert unseen.calls == 0
    flat = Curve(power=1e-9, bounds=(-1e9, 1e9))
    flat.errors_away = lambda j, t: 1e-9  # the cost never says 1.96
    assert flat.end(0, 1, 1.96) == 1e9 > FAR * 0.1


# --- those of a fit


def test_of_a_linear_problem_they_are_the_textbooks():
    """k_a and k_d alone: the cost is a parabola, so that the ends are t errors away."""
    images = noisy(clean_images(), 0.02, 0)
    fit = ds.fit(standard_scene(), one_light_each(images), free=("k_a", "k_d"))
    with jax.enable_x64(True):
        clusters = find_clusters(fit)
        profile = LikelihoodProfile(fit, clusters)
        interval_68, interval_95 = intervals(profile, LEVELS)
    errors = clusters.standard_errors()
    reach = np.abs(interval_95 - fit.values[:, None]) / errors[:, None]
    np.testing.assert_allclose(reach, 1.96, rtol=0.02)
    assert np.all((interval_68 > interval_95)[:, 0] & (interval_68 < interval_95)[:, 1])
    for j in range(len(errors)):
        points = profile.curve(j)
        assert len(points) == 5  # the best, and the ends of both intervals
        away = np.abs(points[:, 0] - fit.values[j]) / errors[j]
        np.testing.assert_allclose(points[:, 1], away, rtol=0.02, atol=1e-6)


def test_an_end_is_where_a_fit_that_is_bounded_there_costs_so_much_more():
    fit = noisy_fit()
    with jax.enable_x64(True):
        clusters = find_clusters(fit)
        interval_95 = intervals(LikelihoodProfile(fit, clusters), (0.95,))[0]
    assert np.all((interval_95[:, 0] < fit.values) & (interval_95[:, 1] > fit.values))
    for name, side in (("n_s", 1), ("quadratic", -1)):
        j = fit.names.index(name)
        bounds = {name: (interval_95[j, 1], 1e3) if side > 0 else (0.0, interval_95[j, 0])}
        held = standard_fit(noisy_images(), bounds=bounds)
        assert held.at_bound[j]
        away = np.sqrt(2.0 * (held.costs[-1] - fit.costs[-1]) / clusters.rises()[j])
        np.testing.assert_allclose(away, stats.t.ppf(0.975, clusters.evidence.spread[0] - 12), rtol=0.02)


def test_they_end_at_bounds_and_are_one_sided_there():
    fit = standard_fit(noisy_images(), bounds={"n_s": (55, 1e3)})
    n_s = fit.names.index("n_s")
    assert fit.at_lower[n_s]
    with jax.enable_x64(True):
        low, high = intervals(LikelihoodProfile(fit, find_clusters(fit)), (0.95,))[0][n_s]
    assert low == 55.0
    assert 55.0 < high < 60.0


# --- clusters


def of_clusters(by_jackknife: list[bool], scatter: float = 3.0, count: int = 8, what: str = "8 views") -> Clusters:
    freedom = np.full(len(by_jackknife), 7.0)
    return Clusters(noisy_fit().evidence, count, what, scatter, any(by_jackknife), np.array(by_jackknife), freedom)


def test_a_jackknife_has_students_t_of_its_freedom():
    every, none = of_clusters([True] * 12), of_clusters([False] * 12)
    many = noisy_fit().evidence.spread[0] - 12
    for level in LEVELS:
        np.testing.assert_allclose(every.quantiles(level), stats.t.ppf(0.5 + level / 2, 7.0))
        np.testing.assert_allclose(none.quantiles(level), stats.t.ppf(0.5 + level / 2, many))
    evidence = noisy_fit().evidence
    half = of_clusters([True] * 6 + [False] * 6)
    plain, clustered = evidence.plain_errors(), evidence.clustered_errors()
    np.testing.assert_allclose(half.standard_errors()[:6], np.maximum(clustered, plain)[:6])
    np.testing.assert_allclose(half.standard_errors()[6:], np.sqrt(3.0) * plain[6:])
    ratio = np.maximum(clustered / plain, 1.0) ** 2
    np.testing.assert_allclose(half.inflation(), np.where(half.by_jackknife, ratio, 3.0))
    np.testing.assert_allclose(half.rises(), evidence.sigma2 * half.inflation())
    np.testing.assert_allclose(
        half.wide_errors(), half.standard_errors() * half.quantiles(0.95) / stats.norm.ppf(0.975)
    )
    np.testing.assert_array_equal(of_clusters([False] * 12, 0.7).inflation(), np.ones(12))


def test_what_errors_are_made_of_is_said():
    names = [u.quantity for u in noisy_fit().unknowns]
    assert "the 8 views agree" in of_clusters([False] * 12).sentence(names)
    assert "times 1.73" in of_clusters([False] * 12).sentence(names)
    assert "times" not in of_clusters([False] * 12, 0.9).sentence(names)
    some = of_clusters([True] * 2 + [False] * 8 + [True] * 2).sentence(names)
    assert "the 8 views, which disagree about k_a, linear and quadratic" in some
    assert "3 times the expected variance" in some
    assert "expected variance" not in of_clusters([True] * 12, 0.9).sentence(names)
    assert "7 are few for a jackknife" in of_clusters([True] * 12, count=7, what="7 patches").sentence(names)
    assert "few for that" not in of_clusters([True] * 12, count=12, what="12 patches").sentence(names)
    assert "few for that" not in of_clusters([True] * 12, count=7, what="7 views").sentence(names)
    few = of_clusters([False] * 12, count=0, what="4 patches").sentence(names)
    assert "4 patches cannot show" in few
    assert "independent noise" in few


def test_the_correlation_length_is_that_of_the_error_under_white_noise():
    random = np.random.default_rng(0)
    white = [random.standard_normal((96, 96)) for _ in range(4)]
    smooth = [ndimage.gaussian_filter(random.standard_normal((96, 96)), 4, mode="wrap") for _ in range(4)]
    everywhere = [np.ones((96, 96), bool)] * 4
    assert correlation_length(white, everywhere) == 0
    alone = correlation_length(smooth, everywhere)
    assert 6 <= alone <= 10  # exp(-lag^2 / (4 4^2)) is 1/e at 8
    mixed = [w + s / s.std() for w, s in zip(white, smooth, strict=True)]
    assert abs(correlation_length(mixed, everywhere) - alone) <= 2
    assert correlation_length([np.ones((5, 9))], [np.ones((5, 9), bool)]) == 4  # no lag is long enough
    assert correlation_length([np.ones((5, 9))], [np.zeros((5, 9), bool)]) == 0
    assert patch_width(smooth, everywhere) == max(2 * alone + 1, int(np.ceil(np.sqrt(4 * 96**2 / MAX_PATCHES))))
    assert patch_width(white[:1], everywhere[:1]) == 12  # 64 of them


def test_patches_are_squares_and_those_of_views_taken_alike_are_one():
    fit = noisy_fit()
    samples = fit.solved.problem.data.samples
    again = ViewSet.of(fit.scene, (*fit.views[:2], fit.views[0]))
    patches = cut_in_patches(again.with_samples((*samples[:2], samples[0])), 8)
    kept = [[len(part[view].pixels) for part in patches.samples] for view in range(3)]
    np.testing.assert_array_equal(np.sum(kept, 1), [len(of.pixels) for of in (*samples[:2], samples[0])])
    seen = set()
    for part in patches.samples:
        assert sum(len(of.pixels) > 0 for of in part) == (1 if len(part[1].pixels) else 2)
        for view, of in enumerate(part):
            for row, column in {(p // 24 // 8, p % 24 // 8) for p in of.pixels.tolist()}:
                seen.add((view % 2, row, column))
    assert len(seen) == len(patches)
    assert patches.words == f"{len(patches)} patches of 8 x 8 pixels"


def test_residual_images_are_those_of_the_channels_together():
    fit = noisy_fit()
    images, counts = residual_images(fit)
    assert len(images) == 8
    inside = fit.predict(fit.views[3])
    np.testing.assert_allclose(images[3], inside.difference.sum(-1))
    np.testing.assert_array_equal(counts[3], inside.counts[..., 0])


@pytest.mark.thorough
def test_one_view_has_patches_for_clusters():
    clean = clean_images()[0]
    field = ndimage.gaussian_filter(np.random.default_rng(0).standard_normal(clean.shape[:2]), 1.5)
    off = noisy([clean], 0.002, 0)[0] + (0.02 * field / field.std())[..., None]
    free = ("k_a", "k_d", "k_s", "n_s")
    with jax.enable_x64(True):
        good, bad = (
            find_clusters(ds.fit(forget(standard_scene()), one_light_each([image]), free=free))
            for image in (noisy([clean], 0.01, 1)[0], off)
        )
    assert "patches" in good.what
    assert good.count == good.evidence.count > 30
    slope = np.asarray(good.evidence.clusters.gradient).sum(0)
    np.testing.assert_allclose(slope / np.sqrt(np.diag(good.evidence.total)), 0.0, atol=1e-4)
    assert not good.by_jackknife.any()
    assert bad.by_jackknife.any()
    assert bad.count < good.count
    assert np.all((bad.standard_errors() > bad.evidence.plain_errors())[bad.by_jackknife])
    assert "by jackknife over the" in bad.sentence(["k_a"] * len(bad.by_jackknife))
