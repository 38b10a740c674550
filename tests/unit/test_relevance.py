"""Relevance: groups of directions that are in the residuals are found, others are not, and the posterior is right."""

from __future__ import annotations

import numpy as np
import pytest

from diffshade.inverse.misfit.noise_tests import FALSE_ALARM
from diffshade.inverse.misfit.relevance import FaultEvidence, relevance
from diffshade.parallel.threads import ONE_BLAS_THREAD

RANDOM = np.random.default_rng(0)
N, SIGMA = 600, 0.1
J = RANDOM.standard_normal((3, N))
GROUP = np.array([0, 1, 1, 1, 2, 3, 3])
DIRECTIONS = RANDOM.standard_normal((len(GROUP), N)) + 0.5 * J[0]
LEFT = np.eye(N) - J.T @ np.linalg.solve(J @ J.T, J)
"""What the unknowns do not imitate of the samples."""


INFORMATION = DIRECTIONS @ LEFT @ DIRECTIONS.T


def evidence(samples: np.ndarray, directions: np.ndarray = DIRECTIONS, group: np.ndarray = GROUP) -> FaultEvidence:
    r, seen = LEFT @ samples, INFORMATION if directions is DIRECTIONS else directions @ LEFT @ directions.T
    return FaultEvidence(seen, directions @ r, group, float(r @ r), float(N - len(J)), float(samples @ samples))


def noise(seed: int) -> np.ndarray:
    return SIGMA * np.random.default_rng(seed).standard_normal(N)


def test_planted_groups_are_active_with_their_amounts_and_no_others():
    planted = np.array([0.0, 0.05, -0.03, 0.0, 0.02, 0.0, 0.0])
    found = relevance(evidence(J[1] + planted @ DIRECTIONS + noise(11)))
    assert found.active.tolist() == [False, True, True, False]
    assert found.sigma2 == pytest.approx(SIGMA**2, rel=0.15)
    assert not found.mean[[0, 5, 6]].any()
    assert not found.covariance[[0, 5, 6]].any()
    error = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(found.mean - planted) <= 3.0 * error)
    assert np.all(found.gain[found.active] > 15.0)
    assert not found.gain[~found.active].any()


def test_the_posterior_is_that_of_generalised_least_squares_and_its_variances_are_the_likeliest():
    samples = np.array([0.0, 0.05, -0.03, 0.01, 0.02, 0.0, 0.0]) @ DIRECTIONS + noise(12)
    found = relevance(evidence(samples))
    use = found.active[GROUP]
    D = DIRECTIONS[use] @ LEFT
    r = LEFT @ samples
    prior = np.linalg.inv(found.covariance[np.ix_(use, use)]) - D @ D.T / found.sigma2
    variance = 1.0 / np.diag(prior)
    np.testing.assert_allclose(prior, np.diag(1.0 / variance), atol=1e-4 / variance.min())
    np.testing.assert_allclose(variance[:3], variance[0], rtol=1e-4)  # one of the whole group

    def whole(factors: np.ndarray) -> np.ndarray:
        return found.sigma2 * np.eye(N) + (D.T * (factors * variance)) @ D

    dense = variance * (D @ np.linalg.solve(whole(np.ones(4)), r))
    np.testing.assert_allclose(found.mean[use], dense, rtol=1e-3)

    def twice_log_likelihood(factors: np.ndarray) -> float:
        return float(-np.linalg.slogdet(whole(factors))[1] - r @ np.linalg.solve(whole(factors), r))

    with ONE_BLAS_THREAD:
        for own in (np.array([1, 1, 1, 0.0]), np.array([0, 0, 0, 1.0])):
            for factor in (0.7, 1.4):
                assert twice_log_likelihood(factor**own) < twice_log_likelihood(np.ones(4))


def test_noise_alone_raises_no_group_more_often_than_the_level_allows():
    with ONE_BLAS_THREAD:
        active = [relevance(evidence(noise(seed))).active for seed in range(10, 1010)]
    assert np.sum(active) <= 2, FALSE_ALARM  # of 4 groups in 1,000 draws .4 are expected


def test_of_two_groups_that_explain_the_same_one_is_left_and_an_echo_is_dropped():
    alike = np.concatenate([DIRECTIONS[:1], DIRECTIONS[:1] + 1.2 * RANDOM.standard_normal((1, N))])
    found = relevance(evidence(0.1 * alike[0] + noise(13), alike, np.array([0, 1])))
    assert found.active.tolist() == [True, False]
    alone = relevance(evidence(0.1 * alike[0] + noise(13), alike[1:], np.array([0])))
    assert alone.active.tolist() == [True]  # where its cause is not in the table, the echo is


def test_a_group_that_shows_only_beside_a_stronger_one_is_active_too():
    strong, weak = np.array([2.0, 0, 0, 0, 0, 0, 0]), np.array([0, 0, 0, 0, 0.03, 0, 0])
    alone = evidence((strong + weak) @ DIRECTIONS + noise(14))
    score = alone.score[4] ** 2 / alone.information[4, 4] / (alone.squares / alone.freedom)
    assert score < 4.0  # it is lost in what the other leaves
    assert relevance(alone).active.tolist() == [True, False, True, False]


def test_what_the_unknowns_imitate_is_not_active():
    alike = np.stack([2.0 * J[0] - J[2], DIRECTIONS[0]])
    found = relevance(evidence(0.5 * alike.sum(0) + noise(15), alike, np.array([0, 1])))
    assert found.active.tolist() == [False, True]


def test_without_a_direction_nothing_is_found():
    found = relevance(evidence(noise(16), np.zeros((0, N)), np.zeros(0, int)))
    assert found.active.size == 0
    assert found.sigma2 == pytest.approx(SIGMA**2, rel=0.15)


def test_no_amount_changes_more_than_the_pictures_hold():
    """A direction that is an unknown's but for a millionth: what is left of it would need amounts of a million."""
    other = RANDOM.standard_normal(N)
    nearly = (J[0] + 1e-6 * other)[None]
    samples = J[1] + 0.5 * other + noise(17)
    found = relevance(evidence(samples, nearly, np.array([0])))
    assert found.active.tolist() == [True]
    assert abs(found.mean[0]) < 2.0 * np.linalg.norm(samples)
    assert found.covariance[0, 0] <= samples @ samples


def test_what_fades_to_nothing_is_not_waited_for(monkeypatch):
    """Six echoes of a direction: 21 steps, and 106 where each search begins anew and ends with the last echo."""
    steps, inv = [], np.linalg.inv
    monkeypatch.setattr(np.linalg, "inv", lambda A: steps.append(len(A)) or inv(A))
    echoes = DIRECTIONS[:1] + 0.6 * np.random.default_rng(18).standard_normal((6, N))
    found = relevance(evidence(0.1 * DIRECTIONS[0] + noise(13), np.concatenate([DIRECTIONS[:1], echoes]), np.arange(7)))
    assert found.active.tolist() == [True] + 6 * [False]
    assert len(steps) < 50
