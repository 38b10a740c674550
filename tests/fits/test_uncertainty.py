"""Uncertainty: error bars that can be had another way too."""

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from grams import by_view
from scenarios import noisy_fit, noisy_images, standard_fit
from scipy import stats
from synthetic import photographs, standard_scene
from unexplained import unexplained  # noqa: F401

from diffshade.inverse.data.samples import find_samples
from diffshade.inverse.data.view_sets import Counts
from diffshade.inverse.statistics.clusters import compared
from diffshade.inverse.statistics.evidence import Evidence
from diffshade.inverse.statistics.identifiability import condition_number, null_directions
from diffshade.inverse.statistics.uncertainty import (
    SINGULAR,
    Jackknife,
    inverse,
    on_unit_vectors,
    regular_inverse,
    scaled,
    standard_errors,
)
from diffshade.inverse.summary import _clusters_in_words
from diffshade.inverse.unknowns.slots import put_back

UNITS = 10.0 ** np.array([-4.0, 3.0, 0.0, -2.0, 5.0, 1.0])


def jacobian(*null_space: list[float], rows: int = 40) -> np.ndarray:
    """A random Jacobian of 6 unknowns in units of very different sizes, blind along the given directions."""
    J = np.random.default_rng(0).standard_normal((rows, 6))
    for direction in null_space:
        unit = np.array(direction) / np.linalg.norm(direction)
        J -= np.outer(J @ unit, unit)
    return J / UNITS


# --- the algebra


def jackknifed(H: np.ndarray, g: np.ndarray) -> np.ndarray:
    """The covariance without priors."""
    deviations = Jackknife(H, np.zeros(H.shape[1:])).deviations(g[..., None], np.zeros((H.shape[1], 1)))[..., 0]
    return deviations.T @ deviations


def test_a_matrix_that_is_surely_regular_has_the_inverse_of_its_eigenvalues_and_no_other_has():
    A, _ = scaled(jacobian().T @ jacobian())
    found = regular_inverse(A, SINGULAR**2)
    assert found is not None
    np.testing.assert_allclose(found, np.linalg.inv(A), rtol=1e-12)
    assert regular_inverse(A, 0.5) is None  # no smallest eigenvalue is half of the largest
    singular = A.copy()
    singular[3], singular[:, 3] = 0.0, 0.0
    blind = jacobian([1, 1, 0, 0, 0, 0])
    for none in (singular, scaled(blind.T @ blind)[0]):
        assert regular_inverse(none, SINGULAR**2) is None


def test_many_inverses_are_those_of_each_and_leave_null_directions_out():
    random = np.random.default_rng(0)
    J = random.standard_normal((5, 9, 4))
    J[3, :, 1] = 2.0 * J[3, :, 0]
    H = np.swapaxes(J, 1, 2) @ J
    for found, each in zip(inverse(H), H, strict=True):
        np.testing.assert_allclose(found, inverse(each), rtol=1e-10)
    for k in (0, 1, 2, 4):
        np.testing.assert_allclose(inverse(H)[k] @ H[k], np.eye(4), atol=1e-10)
    assert np.abs(inverse(H)[3]).max() < 1e3


def test_the_plain_covariance_is_sigma2_times_the_inverse_in_any_units():
    J = jacobian()
    expected = np.linalg.inv((J * UNITS).T @ (J * UNITS)) * np.outer(UNITS, UNITS)
    np.testing.assert_allclose(0.25 * inverse(J.T @ J), 0.25 * expected, rtol=1e-9)


def test_the_condition_number_is_that_of_columns_of_unit_length():
    J = jacobian()
    w = np.linalg.svd(J / np.linalg.norm(J, axis=0), compute_uv=False)
    np.testing.assert_allclose(condition_number(J.T @ J), w[0] / w[-1], rtol=1e-9)
    blind = jacobian([1, 1, 0, 0, 0, 0])
    assert condition_number(blind.T @ blind) == np.inf


def test_null_directions_of_independent_gauges_name_only_their_own_unknowns():
    J = jacobian([1, 2, -3, 0, 0, 0], [0, 0, 0, 1, 1, 0])
    zero, directions = null_directions(J.T @ J)
    assert not zero.any()
    assert sorted(np.flatnonzero(d).tolist() for d in directions) == [[0, 1, 2], [3, 4]]
    for d, parts in ((d, J * d) for d in directions):
        assert np.linalg.norm(J @ d) < 1e-6 * np.linalg.norm(parts)


def test_a_column_of_zeros_is_told_apart_from_a_direction():
    J = jacobian([1, 1, 0, 0, 0, 0])
    J[:, 5] = 0.0
    zero, directions = null_directions(J.T @ J)
    assert zero.tolist() == [False] * 5 + [True]
    assert [np.flatnonzero(d).tolist() for d in directions] == [[0, 1]]
    zero, directions = null_directions(np.zeros((2, 2)))
    assert zero.all()
    assert len(directions) == 0


def test_what_is_determined_has_the_errors_it_has_with_the_gauge_fixed():
    J = jacobian([1, 1, 1, 0, 0, 0])
    fixed = np.delete(J, 0, axis=1)  # one unknown of the gauge is known
    expected = np.diag(inverse(fixed.T @ fixed))[2:]
    np.testing.assert_allclose(np.diag(inverse(J.T @ J))[3:], expected, rtol=1e-6)


def test_a_view_that_alone_determines_something_is_found():
    H = np.array([np.diag([1.0, 0.0]), np.diag([1.0, 0.0]), np.diag([1.0, 1.0])])
    assert Jackknife(H, np.zeros((2, 2))).deciding() == 2
    assert Jackknife(H, np.eye(2)).deciding() is None
    nearly = np.ones((3, 2, 2))
    nearly[2] += 1e-10 * np.array([[1.0, -1.0], [-1.0, 1.0]])  # what it shows of the two apart is little, but enough
    assert Jackknife(nearly, np.zeros((2, 2))).deciding() == 2


def test_an_unknown_at_a_bound_adds_nothing_to_the_errors_of_the_others():
    J = jacobian()

    def covariance(which: np.ndarray) -> np.ndarray:
        found = np.zeros((6, 6))
        found[np.ix_(which, which)] = inverse(J[:, which].T @ J[:, which])
        return found

    at_bound = np.array([False, True, False, False, True, False])
    errors = standard_errors(covariance, at_bound)
    np.testing.assert_allclose(errors[~at_bound] ** 2, np.diag(covariance(~at_bound))[~at_bound], rtol=1e-12)
    released = ~at_bound | (np.arange(6) == 4)
    variance_of_4 = covariance(released)[4, 4]
    np.testing.assert_allclose(errors[4] ** 2, variance_of_4, rtol=1e-12)


@pytest.mark.parametrize("own", [0, 1])
def test_the_jackknife_of_a_linear_model_is_that_of_fits_without_each_view(own):
    """Two unknowns that all views share, one of each view where it has its own, and what is known of one beforehand."""
    random = np.random.default_rng(1)
    A, B, b = (random.standard_normal((5, 30, n)) for n in (2, 1, 1))
    known, p = np.diag([4.0, 0, 0, 0, 0, 0, 0])[: 2 + 5 * own, : 2 + 5 * own], 2 + 5 * own

    def design(v: int) -> np.ndarray:
        J = np.zeros((30, p))
        J[:, :2] = A[v]
        J[:, 2 + v : 3 + v] = B[v]
        return J

    def solve(views: list[int]) -> np.ndarray:
        J, y = np.concatenate([design(v) for v in views]), np.concatenate([b[v, :, 0] for v in views])
        return np.linalg.lstsq(np.concatenate([J, np.sqrt(known)]), np.concatenate([y, np.zeros(p)]), rcond=None)[0]

    best = solve([*range(5)])
    J = np.array([design(v) for v in range(5)])
    H, g = np.einsum("vni,vnj->vij", J, J), np.einsum("vni,vn->vi", J, J @ best - b[..., 0])
    yes = np.ones(p, bool)
    evidence = Evidence(
        by_view(H, g), known, known @ best, best, ~yes, yes, np.zeros((0, 3), int), 1.0, np.array([150, 1, 1, 150, 150])
    )
    assert evidence.single_view.tolist() == [-1, -1, 0, 1, 2, 3, 4][:p]
    covariance = evidence.clustered_covariance(yes)[:2, :2]
    without = np.array([solve([w for w in range(5) if w != v])[:2] for v in range(5)])
    deviations = without - without.mean(0)
    np.testing.assert_allclose(covariance, 4 / 5 * deviations.T @ deviations, rtol=1e-9)


def test_what_the_jackknife_expects_of_noise_is_what_it_then_has():
    """Of a linear model the move without a view is linear in the noise, so that its variance is a sum of squares."""
    random = np.random.default_rng(0)
    J = [random.standard_normal((n, 3)) for n in (12, 30, 7, 18)]
    H, G = np.array([j.T @ j for j in J]), len(J)
    whole, share = np.linalg.inv(H.sum(0)), np.zeros((G, 3))
    for v in range(G):
        by_noise = np.concatenate([H[v] @ whole @ j.T - (j.T if w == v else 0.0) for w, j in enumerate(J)], 1)
        share[v] = np.sum((np.linalg.inv(H.sum(0) - H[v]) @ by_noise) ** 2, 1)
    variances, freedom = Jackknife(H, np.zeros((3, 3))).of_noise()
    np.testing.assert_allclose(variances, (G - 1) / G * share.sum(0), rtol=1e-9)
    np.testing.assert_allclose(freedom, share.sum(0) ** 2 / (share**2).sum(0), rtol=1e-9)
    known = Jackknife(H[:, :1, :1], np.array([[1e6]])).of_noise()[0]
    np.testing.assert_allclose(known, (G - 1) / G * H[:, :1, :1].sum(0)[0] / 1e12, rtol=1e-3)


def test_the_length_of_a_unit_vector_does_not_vary():
    values = np.array([5.0, 0.6, 0.0, 0.8])
    covariance = on_unit_vectors(np.eye(4), values, np.array([[1, 2, 3]]))
    direction = values * [0, 1, 1, 1]
    np.testing.assert_allclose(covariance @ direction, 0.0, atol=1e-15)
    np.testing.assert_allclose(np.diag(covariance), [1.0, 0.64, 1.0, 0.36])


# --- the evidence of a linear problem


def linear(shared: float = 0.0, rows: int = 30, clusters: int = 6) -> tuple[Evidence, np.ndarray, np.ndarray]:
    """The evidence of a straight line through clusters of noisy points, with an offset that a cluster shares."""
    random = np.random.default_rng(3)
    J = np.stack([np.ones((clusters, rows)), random.uniform(-1, 1, (clusters, rows))], -1)
    b = J @ [1.0, 2.0] + 0.1 * random.standard_normal((clusters, rows)) + shared * random.standard_normal((clusters, 1))
    best = np.linalg.lstsq(J.reshape(-1, 2), b.ravel(), rcond=None)[0]
    r = J @ best - b
    H, g = np.einsum("cni,cnj->cij", J, J), np.einsum("cni,cn->ci", J, r)
    n, yes, none = r.size, np.ones(2, bool), np.zeros((2, 2))
    units = np.zeros((0, 3), int)
    squares = float(np.sum(r**2))
    spread = np.array([n, squares, squares, n, n])
    return Evidence(by_view(H, g), none, np.zeros(2), best, ~yes, yes, units, squares / (n - 2), spread), J, b


def test_the_errors_of_a_line_are_the_textbooks():
    evidence, J, b = linear()
    found: Any = stats.linregress(J[..., 1].ravel(), b.ravel())
    np.testing.assert_allclose(evidence.plain_errors(), [found.intercept_stderr, found.stderr], rtol=1e-9)
    assert evidence.loss_ratio == 1.0
    unknown = dataclasses.replace(evidence, regular=np.array([True, False]))
    assert np.isinf(unknown.plain_errors()[1])
    assert np.isinf(unknown.clustered_errors()[1])
    held = dataclasses.replace(evidence, at_bound=np.array([True, False]))
    np.testing.assert_allclose(held.plain_errors()[1] ** 2, evidence.sigma2 / evidence.total[1, 1], rtol=1e-12)


@pytest.mark.parametrize("shared", [0.0, 0.05])
def test_whether_clusters_agree_is_chows_test(shared):
    """The residuals of one line for all, beside those of a line for each cluster."""
    evidence, J, b = linear(shared)
    each = sum(float(np.linalg.lstsq(j, y, rcond=None)[1][0]) for j, y in zip(J, b, strict=True))
    freedom, within = 2 * len(J) - 2, b.size - 2 * len(J)
    ratio = (evidence.spread[1] - each) / freedom / (each / within)
    np.testing.assert_allclose(evidence.scatter(), (ratio, stats.f.sf(ratio, freedom, within)), rtol=1e-6)
    assert (evidence.scatter()[1] < 0.05) == (shared > 0)
    assert linear(shared, clusters=1)[0].scatter() == (1.0, 1.0)


def test_what_shakes_is_found_by_its_jackknife():
    evidence, _, _ = linear(0.05)
    p_value, freedom = evidence.independence_p_values()
    H, g = np.asarray(evidence.clusters.hessian), np.asarray(evidence.clusters.gradient)
    expected, of_noise = Jackknife(H, np.zeros((2, 2))).of_noise()
    jackknife = jackknifed(H, g)
    np.testing.assert_allclose(evidence.clustered_errors(), np.sqrt(np.diag(jackknife)), rtol=1e-12)
    np.testing.assert_allclose(freedom, np.minimum(of_noise, 5.0), rtol=1e-12)
    ratio = np.diag(jackknife) / evidence.sigma2 / expected
    np.testing.assert_allclose(p_value, stats.chi2.sf(freedom * ratio, freedom), rtol=1e-9)
    assert p_value[0] < 0.05 < p_value[1]  # they share an offset, no slope
    two = dataclasses.replace(evidence, clusters=by_view(H[:2], g[:2]))
    assert [of.tolist() for of in two.independence_p_values()] == [[1.0, 1.0], [np.inf, np.inf]]
    robust = dataclasses.replace(evidence, spread=evidence.spread * [1, 1, 1, 0.4, 0.8])
    assert robust.loss_ratio == pytest.approx(2.0)  # of a robust loss the jackknife takes the slopes
    np.testing.assert_allclose(robust.clustered_errors(), 2.0 * evidence.clustered_errors(), rtol=1e-12)
    np.testing.assert_allclose(
        robust.independence_p_values()[0], stats.chi2.sf(4 * freedom * ratio, freedom), rtol=1e-9
    )
    np.testing.assert_allclose(robust.plain_errors(), evidence.plain_errors(), rtol=1e-12)


def test_what_one_cluster_alone_sees_has_its_plain_error():
    evidence, _, _ = linear()
    H, g = np.zeros((6, 3, 3)), np.zeros((6, 3))
    H[:, :2, :2], g[:, :2] = evidence.clusters.hessian, evidence.clusters.gradient
    H[4, 2, 2], H[4, 0, 2], H[4, 2, 0] = 3.0, 1.0, 1.0
    no = np.zeros(3, bool)
    of_three = dataclasses.replace(
        evidence, clusters=by_view(H, g), known_hessian=np.zeros((3, 3)), known_gradient=np.zeros(3),
        values=np.ones(3), at_bound=no, regular=~no,
    )  # fmt: skip
    assert of_three.single_view.tolist() == [-1, -1, 4]
    np.testing.assert_allclose(of_three.clustered_errors()[2], of_three.plain_errors()[2], rtol=1e-12)
    assert np.all(of_three.clustered_errors()[:2] != of_three.plain_errors()[:2])
    assert of_three.independence_p_values()[1][2] == np.inf
    assert not compared(of_three, 6, "6 views").by_jackknife[2]
    one_decides = np.ones((6, 2, 2))
    one_decides[1] = 2.0 * np.eye(2)  # all others see the sum alone
    by_one = dataclasses.replace(evidence, clusters=by_view(one_decides, np.zeros((6, 2))))
    assert by_one.deciding() == 1
    assert not compared(by_one, 6, "6 views").by_jackknife.any()
    assert _clusters_in_words([[0], [1, 2]], Counts(3, 9, 9, 0, 0)) == "3 views in 2 setups"
    assert _clusters_in_words([[0], [1], [2]], Counts(3, 9, 9, 0, 0)) == "3 views"


# --- the errors of a fit


@cache
def jacobians() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Of each view of the noisy fit the derivatives of its samples, by differences of photographs, and residuals."""
    fit = noisy_fit()
    inside = [find_samples(fit.scene, view).inside for view in fit.views]

    def predictions(values):
        scene, _ = put_back(fit.scene, fit.views, fit.unknowns, values)
        return [image[i].ravel() for image, i in zip(photographs(scene), inside, strict=True)]

    steps = 1e-5 * fit.values
    ends = [[predictions(fit.values + s * step) for step in np.diag(steps)] for s in (1, -1)]
    J = [
        np.stack([(up[v] - down[v]) / (2 * h) for h, up, down in zip(steps, *ends, strict=True)], -1)
        for v in range(len(inside))
    ]
    best = predictions(fit.values)
    return J, [m - view.image[i].ravel() for m, view, i in zip(best, fit.views, inside, strict=True)]


def test_the_covariance_is_that_of_a_jacobian_by_finite_differences():
    fit = noisy_fit()
    J, r = (np.concatenate(of) for of in jacobians())
    expected = np.sum(r**2) / (len(r) - len(fit.values)) * np.linalg.inv(J.T @ J)
    errors = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(fit.covariance, expected, atol=1e-5 * np.outer(errors, errors).max(), rtol=1e-4)
    np.testing.assert_allclose(fit.plain_errors, errors, rtol=1e-5)
    np.testing.assert_allclose(fit.plain_errors**2, np.diag(fit.covariance), rtol=1e-12)
    np.testing.assert_allclose(fit.correlation, expected / np.outer(errors, errors), atol=1e-4)
    linear, quadratic = fit.names.index("linear"), fit.names.index("quadratic")
    assert fit.correlation[linear, quadratic] < -0.5  # what one fades the other need not
    lengths = np.linalg.svd(J / np.linalg.norm(J, axis=0), compute_uv=False)
    np.testing.assert_allclose(fit.condition, lengths[0] / lengths[-1], rtol=1e-4)
    assert fit.determined.all()
    assert not any("determine" in note or "separate" in note for note in fit.notes)


def test_the_jackknife_is_that_of_the_jacobians_of_the_views():
    J, r = jacobians()
    H, g = (np.array([j.T @ of for j, of in zip(J, ofs, strict=True)]) for ofs in (J, r))
    expected = np.sqrt(np.diag(jackknifed(H, g)))
    np.testing.assert_allclose(noisy_fit().evidence.clustered_errors(), expected, rtol=1e-3)


@pytest.mark.usefixtures("unexplained")
def test_the_jackknife_sees_what_the_plain_errors_cannot():
    """An error that a whole view shares, here an exposure that is off, is no independent noise."""
    off = np.random.default_rng(0).uniform(0.9, 1.1, 8)
    fit = standard_fit([e * image for e, image in zip(off, noisy_images(), strict=True)])
    k_d = [name.startswith("k_d") for name in fit.names]
    truth = fit.values_in(standard_scene())
    assert np.all(fit.errors[k_d] > 5 * fit.plain_errors[k_d])
    assert np.all(np.abs(fit.values - truth)[k_d] < 4 * fit.errors[k_d])
