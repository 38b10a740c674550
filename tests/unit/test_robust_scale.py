"""Robust scale: its numbers are those of the laws they name, and the jackknife that of a mean."""

import numpy as np
import pytest
import scipy.stats

from diffshade.core.robust_scale import GAUSS_95, MAD, OUTLIER, RARE, UNIFORM, jackknife_error, robust_scale


def test_constants_are_quantiles():
    assert pytest.approx(1.0 / scipy.stats.norm.ppf(0.75), rel=1e-4) == MAD
    assert pytest.approx(scipy.stats.norm.ppf(0.975), rel=1e-4) == GAUSS_95
    assert pytest.approx(scipy.stats.uniform.std()) == UNIFORM
    assert 2.0 * scipy.stats.norm.sf(OUTLIER) == pytest.approx(1.0 / 16_000, rel=0.02)
    assert 2.0 * scipy.stats.norm.sf(RARE) == pytest.approx(1.0 / 370, rel=0.02)


def test_the_scale_of_noise_ignores_outliers():
    noise = np.random.default_rng(0).normal(size=10_000)
    noise[:2_000] *= 1e6
    assert robust_scale(0.3 * noise) == pytest.approx(0.3, rel=0.5)


def test_the_jackknife_of_a_mean_is_its_standard_error():
    x = np.random.default_rng(0).normal(size=(12, 2))
    without = np.array([np.delete(x, i, 0).mean(0) for i in range(len(x))])
    np.testing.assert_allclose(jackknife_error(without), x.std(0, ddof=1) / np.sqrt(len(x)))
