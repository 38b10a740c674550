"""Neighbouring residuals: noise of any size is not correlated, model error is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from grams import by_view
from scipy import ndimage

import diffshade as ds
from diffshade.inverse.misfit import residual_correlation
from diffshade.inverse.misfit.residual_correlation import cell_correlation, inflate_errors, neighbour_correlation
from diffshade.inverse.statistics.clusters import Clusters, independent
from diffshade.inverse.statistics.evidence import Evidence

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
        for look in (
            lambda r: neighbour_correlation(r, COUNTS),
            lambda r: cell_correlation(r, 2),
            lambda r: cell_correlation(r, 8),
        ):
            errors = [look(r).errors for r in found]
            assert abs(np.mean(errors)) < 1.0
            assert np.max(np.abs(errors)) < 4.5


def test_of_neighbours_the_share_is_that_of_a_smooth_misfit():
    found = neighbour_correlation([r + smooth() for r in white()], COUNTS)
    power = np.mean(smooth() ** 2)
    assert found.share == pytest.approx(power / (1 + power), rel=0.1)
    assert found.errors > 10
    assert 0.5 * found.share < found.least < found.share
    assert neighbour_correlation([0.0 * r for r in white()], COUNTS).least == 0.0


def test_of_cells_the_share_is_the_variance_that_sums_have_beyond_independent_ones():
    found = [np.repeat(np.repeat(r[:20, :30], 2, 0), 2, 1) for r in white()]
    for side, share in ((2, 3.0), (4, 3.0)):
        assert cell_correlation(found, side).share == pytest.approx(share, rel=0.25)
        assert cell_correlation(found, side).errors > 10
    assert cell_correlation(white()[:1], 16).errors == 0.0  # too few


def test_errors_are_widened_where_residuals_are_correlated_and_the_views_have_not_said_so(monkeypatch):
    none, square = np.zeros(2), np.zeros((2, 2))
    known, units = none == 0.0, np.zeros((0, 3), int)
    evidence = Evidence(by_view(square[None], none[None]), square, none, none, ~known, known, units, 1.0, np.ones(5))
    clusters, fit = independent(evidence, "1 view"), object.__new__(ds.Fit)
    for found, times in ((white(), 1.0), ([ndimage.gaussian_filter(r, (2, 2, 0)) for r in white()], 6.0)):
        monkeypatch.setattr(residual_correlation, "residuals", lambda fit, found=found: (found, COUNTS))
        wide, sentence = inflate_errors(fit, clusters)
        assert np.sqrt(wide.scatter) == pytest.approx(times, rel=0.2)
        assert ("neighbouring residuals are correlated" in sentence) == (times > 1)
    for said in (dataclasses.replace(clusters, disagree=True), of_rounding(clusters)):
        assert inflate_errors(fit, said) == (said, "")


def of_rounding(clusters: Clusters) -> Clusters:
    return dataclasses.replace(clusters, evidence=dataclasses.replace(clusters.evidence, waves=np.ones((1, 2, 4))))
