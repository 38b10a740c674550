"""Clusters: the printed errors hold the truth, whether the views agree or not; linear problems, without a fit."""

import numpy as np
import pytest
from grams import by_view

from diffshade.inverse.statistics.clusters import Clusters, compared, independent
from diffshade.inverse.statistics.evidence import Evidence

TRUTH = np.array([0.5, -1.0, 2.0, 1.0])
SAMPLES = 60
BESIDE = np.zeros((4, 4)), np.zeros(4)


def evidence(J: np.ndarray, y: np.ndarray, *, at_bound: np.ndarray | None = None) -> Evidence:
    """The evidence of a linear fit, J (clusters, samples, 4) to y (clusters, samples)."""
    theta = np.linalg.lstsq(J.reshape(-1, 4), y.ravel(), rcond=None)[0]
    r = J @ theta - y
    count, squares = float(r.size), float(np.sum(r**2))
    return Evidence(
        clusters=by_view(np.einsum("vni,vnj->vij", J, J), np.einsum("vni,vn->vi", J, r)),
        known_hessian=BESIDE[0],
        known_gradient=BESIDE[1],
        values=theta,
        at_bound=np.zeros(4, bool) if at_bound is None else at_bound,
        regular=np.ones(4, bool),
        units=np.zeros((0, 3), int),
        sigma2=squares / (count - 4),
        spread=np.array([count, squares, squares, count, count]),
    )


def clusters(count: int, seed: int, shared: float) -> Clusters:
    """Clusters whose samples have noise of 1 each, and numbers of their own that scatter by `shared`."""
    random = np.random.default_rng(seed)
    J = random.standard_normal((count, SAMPLES, 4))
    own = TRUTH + shared * random.standard_normal((count, 1, 4))
    y = np.sum(J * own, -1) + random.standard_normal((count, SAMPLES))
    return compared(evidence(J, y), count, f"{count} views")


def inside(found: Clusters) -> np.ndarray:
    return np.abs(found.evidence.values - TRUTH) <= 1.96 * found.wide_errors()


@pytest.mark.thorough
@pytest.mark.parametrize("count", [2, 3, 5, 8])
def test_of_independent_noise_two_errors_hold_the_truth(count):
    """Of 300 times 4 numbers, so that .6 % is the error of the share; a study has more."""
    found = [clusters(count, seed, 0.0) for seed in range(300)]
    assert 0.93 < np.mean([inside(f) for f in found]) < 0.98
    assert np.mean([f.disagree for f in found]) < 0.05


@pytest.mark.thorough
@pytest.mark.parametrize("count", [5, 8])
@pytest.mark.parametrize("shared", [0.1, 0.3, 1.0])
def test_of_views_with_errors_of_their_own_they_do_too(count, shared):
    """From errors too small to be told from noise to errors that noise is nothing beside."""
    found = [clusters(count, seed, shared) for seed in range(100)]
    assert 0.88 < np.mean([inside(f) for f in found]) < 0.985
    if shared == 1.0:
        assert all(f.disagree and f.by_jackknife.all() for f in found)


def test_two_views_that_disagree_scale_the_errors_and_say_so():
    found = clusters(2, 0, 1.0)
    assert found.disagree
    assert not found.by_jackknife.any()
    np.testing.assert_allclose(found.standard_errors(), np.sqrt(found.scatter) * found.evidence.plain_errors())
    sentence = found.sentence(["a", "b", "c", "d"])
    assert all(word in sentence for word in ("2 views", "disagree", f"{np.sqrt(found.scatter):.3g}"))


def test_the_jackknife_is_widened_by_students_t():
    found = clusters(5, 0, 1.0)
    t = {4: 2.776445}  # of the tables, two-sided 95 %
    np.testing.assert_allclose(found.freedom, 4, atol=0.5)
    wide = found.wide_errors() / found.standard_errors()
    assert (wide >= t[4] / 1.96 - 1e-3).all()
    np.testing.assert_allclose(found.standard_errors(), found.evidence.clustered_errors())
    assert "by jackknife over the" in found.sentence(["a", "b", "c", "d"])


def test_one_view_has_the_errors_of_noise_and_says_what_it_cannot_show():
    found = independent(clusters(1, 0, 0.0).evidence, "1 view")
    np.testing.assert_allclose(found.wide_errors(), found.evidence.plain_errors(), rtol=0.03)
    assert "1 view cannot show" in found.sentence(["a"] * 4)


def test_a_jackknife_that_rests_on_one_cluster_is_no_evidence_of_disagreement():
    """One of four clusters alone sees the last number, up to a hundredth: its jackknife has one degree of freedom."""
    alarms = []
    for seed in range(100):
        random = np.random.default_rng(seed)
        J = random.standard_normal((6, SAMPLES, 4))
        J[1:, :, 3] *= 0.01
        y = J @ TRUTH + random.standard_normal((6, SAMPLES))
        alarms.append(compared(evidence(J, y), 6, "6 patches").disagree)
    assert np.mean(alarms) < 0.06
