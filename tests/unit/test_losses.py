"""Losses: slopes and curvatures, how robust they are, and what clipped samples say."""

import itertools
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.stats
from float64 import float64  # noqa: F401

from diffshade.inverse.forward.losses import CAUCHY, GEMAN_MCCLURE, HUBER, LOSSES, Likelihood, variance

ROBUST = {"huber": HUBER, "cauchy": CAUCHY, "geman-mcclure": GEMAN_MCCLURE}
RESIDUALS = np.array([-30.0, -4.0, -1.4, -1.3, -0.2, 0.0, 1e-9, 0.7, 1.34, 1.35, 3.0, 1e3, 1e8])
SIGMA, WEIGHT, TARGET = 0.3, 2.5, 0.8


def likelihood(loss="squares", sigma=SIGMA, *, tobit=False):
    return Likelihood(jnp.asarray(sigma), loss, tobit)


@partial(jax.jit, static_argnames=("loss", "side", "tobit"))
def terms(m, loss="squares", side=0, *, weight=WEIGHT, tobit=False):
    """The cost, slope and curvature of predictions beside one observed number."""
    m = jnp.asarray(m, float)
    clipped = jnp.full(m.shape, side, jnp.int8)
    return likelihood(loss, tobit=tobit).terms(m, jnp.full_like(m, TARGET), jnp.full_like(m, weight), clipped)


def predictions():
    """Numbers whose residuals, in units of the scale, are `RESIDUALS`."""
    return TARGET + RESIDUALS * SIGMA / np.sqrt(WEIGHT)


@pytest.mark.parametrize("loss", LOSSES)
def test_the_slope_is_the_derivative_of_the_cost(loss):
    slope = jax.vmap(jax.grad(lambda m: terms(m, loss).cost))(jnp.asarray(predictions()))
    np.testing.assert_allclose(terms(predictions(), loss).slope, slope, rtol=1e-9, atol=1e-15)
    assert np.abs(slope).max() > 0.1


@pytest.mark.parametrize("loss", LOSSES)
def test_the_curvature_is_that_of_the_parabola_that_touches_the_cost_from_above(loss):
    """The weight of iterated reweighting: slope/(m - y), never negative; no loss lies above its parabola."""
    m = predictions()
    found = terms(m, loss)
    off = RESIDUALS != 0
    np.testing.assert_allclose(found.curvature[off], (found.slope / (m - TARGET))[off], rtol=1e-6)
    assert np.all(np.asarray(found.curvature) > 0)
    np.testing.assert_allclose(found.curvature[~off], WEIGHT, rtol=1e-12)
    step = np.linspace(-3.0, 3.0, 61)
    there = np.asarray(terms(m[:-2, None] + step, loss).cost)
    cost, slope, curvature = (np.asarray(term)[:-2, None] for term in found)
    parabola = cost + slope * step + 0.5 * curvature * step**2
    assert np.all(there <= parabola * (1 + 1e-9) + 1e-12)


def test_squares_are_squares():
    found = terms(predictions())
    r = predictions() - TARGET
    np.testing.assert_allclose(found.cost, 0.5 * WEIGHT * r**2, rtol=1e-12)
    np.testing.assert_allclose(found.slope, WEIGHT * r, rtol=1e-12)
    np.testing.assert_allclose(found.curvature, WEIGHT, rtol=1e-12)


@pytest.mark.thorough
@pytest.mark.parametrize("loss", LOSSES)
def test_rho_is_s_where_residuals_are_small_and_its_derivative_is_that_of_its_value(loss):
    rho = LOSSES[loss]
    s = jnp.asarray([1e-6, 0.3, 1.5, 1.9, 10.0, 1e4])
    np.testing.assert_allclose(rho.slope(s), jax.vmap(jax.grad(rho.value))(s), rtol=1e-10)
    np.testing.assert_allclose(rho.value(s[:1]), s[:1], rtol=1e-6)
    r, h = jnp.sqrt(s), 1e-6
    psi, slope = rho.influence(r)
    np.testing.assert_allclose(psi, r * rho.slope(s), rtol=1e-12)
    there, back = (rho.influence(r + step)[0] for step in (h, -h))
    np.testing.assert_allclose(slope, (there - back) / (2 * h), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("loss", "tuning"), ROBUST.items())
def test_on_gaussian_noise_95_percent_of_the_data_are_worth_as_much_with_squares(loss, tuning):
    """The asymptotic efficiency (E psi')^2 / E psi^2 of an M-estimate of location (Huber 1981)."""

    def mean(which, power):
        density = lambda r: LOSSES[loss].influence(jnp.asarray(r))[which] ** power * scipy.stats.norm.pdf(r)  # noqa: E731
        ends = np.array([-12.0, -tuning, tuning, 12.0])  # Huber's slope jumps there
        return sum(scipy.integrate.fixed_quad(density, a, b, n=100)[0] for a, b in itertools.pairwise(ends))

    assert mean(1, 1) ** 2 / mean(0, 2) == pytest.approx(0.95, abs=5e-4)


def test_an_outlier_pulls_with_a_limited_force_or_with_none():
    r = jnp.asarray([1e2, 1e4])
    np.testing.assert_allclose(LOSSES["huber"].influence(r)[0], HUBER, rtol=1e-12)
    np.testing.assert_allclose(LOSSES["cauchy"].influence(r)[0], CAUCHY**2 / np.asarray(r), rtol=1e-3)
    assert np.all(LOSSES["geman-mcclure"].influence(r)[0] < 1e-3)
    np.testing.assert_array_equal(LOSSES["squares"].influence(r)[0], r)


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("side", [1, -1])
def test_a_clipped_sample_costs_nothing_where_the_prediction_is_beyond_it(loss, side):
    """At the top it says that the truth is at least so much, at the bottom that it is at most that."""
    m = predictions()
    plain, hinge = terms(m, loss), terms(m, loss, side)
    beyond = side * (m - TARGET) >= 0
    assert 0 < beyond.sum() < len(m)
    for of_hinge, of_plain in zip(hinge, plain, strict=True):
        np.testing.assert_array_equal(np.asarray(of_hinge)[beyond], 0.0)
        np.testing.assert_allclose(np.asarray(of_hinge)[~beyond], np.asarray(of_plain)[~beyond], rtol=1e-14)


def exact(z):
    """-log Phi(z), its slope and its curvature in z, by SciPy."""
    mills = np.exp(scipy.stats.norm.logpdf(z) - scipy.stats.norm.logcdf(z))
    return -scipy.stats.norm.logcdf(z), -mills, mills * (mills + z)


@pytest.mark.parametrize("side", [1, -1])
def test_tobit_is_the_probability_of_a_gaussian_sample_beyond_the_end(side):
    z = np.linspace(-30.0, 8.0, 77)
    m = TARGET + side * z * SIGMA / np.sqrt(WEIGHT)
    found = terms(m, side=side, tobit=True)
    cost, slope, curvature = exact(z)
    np.testing.assert_allclose(found.cost, SIGMA**2 * cost, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(found.slope, side * SIGMA * np.sqrt(WEIGHT) * slope, rtol=1e-7)
    np.testing.assert_allclose(found.curvature, WEIGHT * curvature, rtol=1e-5, atol=1e-15)


def test_tobit_leaves_a_sample_that_was_measured_as_it_is():
    for a, b in zip(terms(predictions(), tobit=True), terms(predictions()), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14)


@pytest.mark.parametrize("side", [1, -1])
def test_tobit_far_inside_the_range_is_the_parabola_of_a_measured_sample_and_far_beyond_it_nothing(side):
    """Noise of a 16-bit file is 4e-6: a prediction that is 0.4 too dark is 1e5 standard deviations off."""
    size = np.array([40.0, 1e3, 1e4, 1e5, 1e6, 1e8])
    m = TARGET + side * size[:, None] * np.array([-1.0, 1.0]) * SIGMA / np.sqrt(WEIGHT)
    found = [np.asarray(term) for term in terms(m, side=side, tobit=True)]
    assert all(np.isfinite(term).all() for term in found)
    r, room = np.sqrt(WEIGHT) * (m[:, 0] - TARGET), 2.0 / size**2
    for term, right, tolerance in zip(
        found, (0.5 * r**2, np.sqrt(WEIGHT) * r, np.full(6, WEIGHT)), (0.01, room + 1e-6, room + 1e-3), strict=True
    ):
        assert np.all(np.abs(term[:, 0] / right - 1.0) <= tolerance)
        np.testing.assert_array_equal(term[:, 1], 0.0)


@pytest.mark.parametrize("side", [1, 0, -1])
@pytest.mark.parametrize("tobit", [False, True])
def test_a_sample_of_weight_zero_costs_nothing(side, tobit):
    for term in terms(predictions(), side=side, weight=0.0, tobit=tobit):
        np.testing.assert_array_equal(term, 0.0)


def spread(r, loss="squares", weight=WEIGHT, clipped=None, sigma=SIGMA):
    r = jnp.asarray(r)
    return likelihood(loss, sigma).spread(r / jnp.sqrt(weight), jnp.zeros_like(r), jnp.full_like(r, weight), clipped)


@pytest.mark.thorough
def test_for_squares_the_variance_is_that_of_the_residuals():
    r = np.random.default_rng(0).standard_normal(50)
    np.testing.assert_allclose(spread(r), [50, float(r @ r), float(r @ r), 50, 50], rtol=1e-12)
    assert variance(spread(r), 7) == pytest.approx(r @ r / 43, rel=1e-12)


@pytest.mark.thorough
@pytest.mark.parametrize("loss", ROBUST)
def test_the_variance_of_a_robust_estimate_is_hubers_formula(loss):
    """psi^2 / (N - p) / (mean psi')^2, times mean rho' since H is weighted by that."""
    r = np.random.default_rng(1).standard_t(2, 400)
    psi, slope = map(np.asarray, LOSSES[loss].influence(jnp.asarray(r / SIGMA)))
    weight = np.asarray(LOSSES[loss].slope((r / SIGMA) ** 2))
    expected = np.sum((SIGMA * psi) ** 2) / 395 / slope.mean() ** 2 * weight.mean()
    assert variance(spread(r, loss), 5) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("loss", ROBUST)
def test_a_robust_estimate_of_gaussian_noise_has_little_more_variance_than_one_of_squares(loss):
    """By 1/0.95: H^-1 is that of the weighted Hessian."""
    r = np.random.default_rng(2).standard_normal(200_000)
    found = spread(r, loss, sigma=1.0)
    in_plain_units = variance(found, 0) / (float(found[4]) / float(found[0]))
    assert in_plain_units == pytest.approx(1 / 0.95, rel=0.01)


def test_only_samples_that_were_measured_count():
    r = np.array([1.0, 2.0, 3.0, 4.0])
    clipped = jnp.asarray([0, 1, -1, 0], jnp.int8)
    np.testing.assert_allclose(spread(r, clipped=clipped), [2, 17, 17, 2, 2], rtol=1e-12)
    weightless = likelihood().spread(jnp.asarray(r), jnp.zeros(4), jnp.asarray([1.0, 0.0, 0.0, 0.0]), None)
    np.testing.assert_allclose(weightless, [1, 1, 1, 1, 1], rtol=1e-12)
