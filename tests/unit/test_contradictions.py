"""Priors beside the images: what is said without each is what a fit without it says."""

from __future__ import annotations

import numpy as np

from diffshade.inverse.verdicts.contradictions import pulls

J = np.random.default_rng(0).standard_normal((200, 3))
J[:, 1] += J[:, 0]
SIGMA = 0.1


def solved(y, mean, width):
    weight = (SIGMA / width) ** 2
    H = J.T @ J + np.diag(weight)
    return np.linalg.solve(H, J.T @ y + weight * mean), H


def test_a_pull_is_what_leaving_the_prior_out_says():
    y = J @ [1.0, 2.0, 3.0] + SIGMA * np.random.default_rng(1).standard_normal(200)
    mean, width = np.array([1.3, 2.0, 0.0]), np.array([0.01, 0.5, np.inf])
    theta, H = solved(y, mean, width)
    given = np.where(np.isfinite(width), width, np.nan)
    of_images, pull = pulls(H, theta, mean, given, SIGMA, np.full(3, SIGMA**2))
    for j in (0, 1):
        without, H_j = solved(y, mean, np.where(np.arange(3) == j, np.inf, width))
        error = SIGMA * np.sqrt(np.linalg.inv(H_j)[j, j])
        np.testing.assert_allclose(of_images[j], without[j], rtol=1e-8)
        np.testing.assert_allclose(pull[j], (without[j] - mean[j]) / np.hypot(width[j], error), rtol=1e-8)
    assert abs(pull[0]) > 10
    assert abs(pull[1]) < 3
    assert np.isnan(pull[2])


def test_a_prior_that_alone_decides_is_not_contradicted():
    H = np.diag([1.0, 4.0])
    _, pull = pulls(H, np.zeros(2), np.ones(2), np.array([SIGMA, np.nan]), SIGMA, np.full(2, SIGMA**2))
    assert np.isnan(pull).all()
