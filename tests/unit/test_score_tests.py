"""Score tests on linear problems, where least squares with the fault among the unknowns says the same."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy import sparse, stats

import diffshade as ds
from diffshade.inverse.misfit.changes import with_materials, with_other_lobe
from diffshade.inverse.misfit.score_tests import CERTAIN_ERRORS, FALSE_ALARM, Rows, ScoreTests, gram

SIGMA = 0.1
RANDOM = np.random.default_rng(0)
J = RANDOM.standard_normal((3, 600))
FAULTS = RANDOM.standard_normal((2, 600)) + 0.5 * J[:2]
THETA = np.array([1.0, -2.0, 0.5])


def rows(y, *, jacobian=J, weight=None, known=None, sigma2=SIGMA**2):
    """The problem at its weighted least-squares end; `known`: (weight, mean) of a prior on each unknown."""
    weight = np.ones(len(y)) if weight is None else weight
    loss_ratio, mean = (np.zeros(len(jacobian)), np.zeros(len(jacobian))) if known is None else known
    H = (jacobian * weight) @ jacobian.T + np.diag(loss_ratio)
    theta = np.linalg.solve(H, (jacobian * weight) @ y + loss_ratio * mean)
    slope = weight * (jacobian.T @ theta - y)
    pixel = np.arange(len(y)) // 3
    known = np.diag(loss_ratio), loss_ratio * (theta - mean)
    return theta, Rows(sparse.csr_array(jacobian), slope, weight, pixel, *known, sigma2)


def measured(amounts=(0.0, 0.0), seed=1, scale: Any = 1.0):
    noise = SIGMA * scale * np.random.default_rng(seed).standard_normal(J.shape[1])
    return THETA @ J + np.asarray(amounts) @ FAULTS + noise


@pytest.mark.parametrize("weighted", [False, True])
def test_amounts_gain_and_moves_are_those_of_a_fit_with_the_fault_among_its_unknowns(weighted):
    weight = RANDOM.uniform(0.5, 2.0, J.shape[1]) if weighted else None
    y = measured((0.3, -0.2))
    theta, at_end = rows(y, weight=weight)
    both, with_it = rows(y, jacobian=np.concatenate([J, FAULTS]), weight=weight)
    score = ScoreTests(at_end).test(FAULTS)
    assert score is not None
    np.testing.assert_allclose(score.amount, both[3:], rtol=1e-9)
    np.testing.assert_allclose(score.moves, theta - both[:3], rtol=1e-9)
    cost, less = (np.sum(of.slope**2 / of.weight) for of in (at_end, with_it))
    np.testing.assert_allclose(score.gain, (cost - less) / SIGMA**2, rtol=1e-9)
    weighed = with_it.weight * np.concatenate([J, FAULTS])
    np.testing.assert_allclose(gram(with_it.jacobian, with_it.weight), weighed @ np.concatenate([J, FAULTS]).T)
    assert score.p_value < 1e-9


def test_what_is_known_beside_the_samples_counts():
    known = np.array([500.0, 0.0, 0.0]), np.array([1.05, 0.0, 0.0])
    y = measured((0.3, 0.0))
    theta, at_end = rows(y, known=known)
    more = np.concatenate([known[0], [0.0]]), np.concatenate([known[1], [0.0]])
    both, _ = rows(y, jacobian=np.concatenate([J, FAULTS[:1]]), known=more)
    score = ScoreTests(at_end).test(FAULTS[:1])
    assert score is not None
    np.testing.assert_allclose(score.amount, both[3:], rtol=1e-9)
    np.testing.assert_allclose(score.moves, theta - both[:3], rtol=1e-8)


def test_beside_a_fault_already_named_its_echo_is_gone():
    like = FAULTS[:1] + 0.3 * np.random.default_rng(5).standard_normal((1, J.shape[1]))
    _, at_end = rows(measured((0.3, 0.0)))
    alone, beside = ScoreTests(at_end).test(like), ScoreTests(at_end, [FAULTS[:1]]).test(like)
    assert alone is not None
    assert beside is not None
    assert alone.p_value < 1e-9
    assert beside.p_value > 1e-3
    assert len(beside.moves) == 3


def test_what_the_unknowns_imitate_is_not_tested():
    _, at_end = rows(measured())
    assert ScoreTests(at_end).test((2.0 * J[0] - J[2])[None]) is None
    assert ScoreTests(at_end).test(0.0 * J[:1]) is None


@pytest.mark.parametrize("noise", ["alike", "of each pixel its own", "shared by channels"])
def test_without_a_fault_the_p_values_are_no_smaller_than_chance(noise):
    scale = np.where(np.arange(J.shape[1]) < 120, 4.0, 0.5) if noise == "of each pixel its own" else np.ones(J.shape[1])
    p_values = []
    for seed in range(300):
        y = measured(seed=seed, scale=scale)
        if noise == "shared by channels":
            shared = np.random.default_rng(seed).standard_normal(J.shape[1] // 3)
            y = THETA @ J + SIGMA * np.repeat(shared, 3)
        _, at_end = rows(y, sigma2=float(np.mean(scale**2)) * SIGMA**2)
        score = ScoreTests(at_end).test(np.repeat(FAULTS[:, ::3], 3, 1))
        assert score is not None
        p_values.append(score.p_value)
    assert stats.kstest(p_values, "uniform", alternative="greater").pvalue > 1e-3


def test_the_other_lobe_of_a_patterned_highlight():
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_s=ds.Chequer(0.1, 0.4), n_s=20)))
    other = with_materials(scene, with_other_lobe)
    assert other is not None
    assert isinstance(other.objects[0].material.lobe, ds.Blinn)
    assert float(other.objects[0].material.n_s) == 80.0
    matte = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_s=0.0)))
    assert with_materials(matte, with_other_lobe) is None


def test_rows_that_vary_together_as_a_fault_would_show_none():
    alone = rows(measured((0.05, 0.0)))[1]
    before = ScoreTests(alone).test(FAULTS[:1])
    after = ScoreTests(dataclasses.replace(alone, waves=0.3 * FAULTS[:1])).test(FAULTS[:1])
    assert before is not None
    assert after is not None
    np.testing.assert_allclose(after.amount, before.amount)
    assert before.p_value < 1e-6
    assert after.p_value > 0.5


def test_the_level_of_a_normal_number_is_that_of_all_tests():
    np.testing.assert_allclose(2.0 * stats.norm.sf(CERTAIN_ERRORS), FALSE_ALARM, rtol=0.05)
