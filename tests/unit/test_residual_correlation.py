"""Neighbouring residuals: noise of any size is not correlated, model error is."""

from __future__ import annotations

import numpy as np
import pytest

from diffshade.diagnosis.residual_correlation import neighbour_correlation

SHAPE = (40, 60, 3)
COUNTS = [np.ones(SHAPE[:2], bool)] * 3


def white(seed=0):
    random = np.random.default_rng(seed)
    return [random.standard_normal(SHAPE) for _ in range(3)]


def smooth():
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.sin(row / 15)[..., None] * np.cos(column / 12)[..., None] * np.ones(3)


def test_independent_noise_is_not_correlated():
    uneven = np.where(np.arange(60) < 30, 1.0, 20.0)[None, :, None]
    for make in (lambda r: r, lambda r: uneven * r, lambda r: r[..., :1] * np.ones(3)):
        found = [[make(r) for r in white(seed)] for seed in range(20)]
        errors = [neighbour_correlation(r, COUNTS)[1] for r in found]
        assert abs(np.mean(errors)) < 1.0
        assert np.max(np.abs(errors)) < 4.5


def test_of_neighbours_the_share_is_that_of_a_smooth_misfit():
    share, errors = neighbour_correlation([r + smooth() for r in white()], COUNTS)
    power = np.mean(smooth() ** 2)
    assert share == pytest.approx(power / (1 + power), rel=0.1)
    assert errors > 10
    assert neighbour_correlation([0.0 * r for r in white()], COUNTS) == (0.0, 0.0)
