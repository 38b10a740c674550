"""The optimum of a fit is that of other solvers, whatever the bounds, the units and the highlight."""

import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from float64 import float64  # noqa: F401
from solver_witness import (
    all_residuals,
    assert_gram_is_that_of_a_dense_jacobian,
    assert_is_a_minimum_within_bounds,
    at_ends,
    cost,
    scipy_optimum,
    three_views,
)
from synthetic import FREE, MATERIAL, TIED, noisy, one_light_each, photographs, standard_scene

import diffshade as ds
from diffshade.inverse.data.samples import find_samples


@pytest.mark.parametrize("rendered", [False, True], ids=["features", "rendered"])
def test_the_optimum_is_that_of_optimistix_levenberg_marquardt(rendered):
    """The witness keeps the whole Jacobian and knows no bounds; here none is reached."""
    solver = three_views(rendered=rendered)
    assert solver.problem.model.projects is not rendered
    end = solver.run()
    assert end.message == ""
    witness = optx.least_squares(
        all_residuals,
        optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10, norm=optx.rms_norm),
        jnp.asarray(solver.start),
        solver.witness,
        max_steps=300,
    )
    np.testing.assert_allclose(end.point.theta, witness.value, rtol=1e-8)
    assert_gram_is_that_of_a_dense_jacobian(end.point, solver)


K_S_BELOW_TRUTH, N_S_BELOW_TRUTH, N_S_ABOVE_TRUTH = {"k_s": (0.0, 0.3)}, {"n_s": (0.1, 30.0)}, {"n_s": (80.0, 1e3)}
K_A = ds.Material(k_a=0.0, k_d=MATERIAL.k_d, k_s=MATERIAL.k_s, n_s=50)
K_S_GREEN = ds.Material(k_a=MATERIAL.k_a, k_d=MATERIAL.k_d, k_s=(0.5, 0.0, 0.45), n_s=50)

QUICK = "bounds on k_d and k_a"
ENDS = {
    QUICK: ({"bounds": {"k_d": (0.3, 0.5), "k_a": (0.07, 0.09)}}, {"k_d.r", "k_d.b"}),
    "interior": ({}, set()),
    "k_a = 0": ({"material": K_A, "seed": 1}, {"k_a.b"}),
    "one channel of k_s = 0": ({"material": K_S_GREEN, "seed": 1}, {"k_s.g"}),
    "upper bound on k_s": ({"bounds": K_S_BELOW_TRUTH}, {"k_s.r", "k_s.g", "k_s.b"}),
    "upper bound on n_s": ({"bounds": N_S_BELOW_TRUTH}, {"n_s"}),
    "lower bound on n_s": ({"bounds": N_S_ABOVE_TRUTH}, {"n_s"}),
    "no attenuation": ({"attenuation": ds.RadialAttenuation(), "seed": 1}, {"linear", "quadratic"}),
}


@pytest.mark.parametrize("case", [QUICK, *(pytest.param(of, marks=pytest.mark.slow) for of in ENDS if of != QUICK)])
def test_within_bounds_the_optimum_is_that_of_scipy(case):
    options, at_a_bound = ENDS[case]
    solver = three_views(**options)
    end = solver.run()
    theta, gram = np.asarray(end.point.theta), end.point.total
    assert end.message == ""
    assert_is_a_minimum_within_bounds(theta, gram, solver)
    bound = np.logical_or(*at_ends(theta, solver))
    assert at_a_bound <= {u.name for u, there in zip(solver.unknowns, bound, strict=True) if there}
    witness = scipy_optimum(solver)
    np.testing.assert_allclose(theta, witness.x, atol=1e-6)
    np.testing.assert_allclose(float(gram.cost), witness.cost, rtol=1e-9)
    assert_gram_is_that_of_a_dense_jacobian(end.point, solver)


@pytest.mark.parametrize("seed", range(3))
def test_a_matte_ball_ends_at_a_minimum_no_worse_than_the_truth(seed):
    """With k_s at 0 the cost does not know n_s: the optimum is not one point, so SciPy is no witness."""
    matte = ds.Material(k_a=MATERIAL.k_a, k_d=MATERIAL.k_d, k_s=0.0, n_s=10)
    solver = three_views(matte, seed=seed)
    end = solver.run()
    theta, gram = np.asarray(end.point.theta), end.point.total
    assert_is_a_minimum_within_bounds(theta, gram, solver)
    truth = np.concatenate([*(np.asarray(k) for k in (matte.k_a, matte.k_d, matte.k_s)), [np.log(10), 0.09, 0.032]])
    assert float(gram.cost) <= cost(truth, solver.witness)


@pytest.mark.parametrize("n_s", [2.0, 1000.0])
@pytest.mark.parametrize("sigma", [0.0, 0.005])
def test_a_broad_and_a_sharp_highlight_are_found_from_the_default_start(n_s, sigma):
    """The search begins at n_s = 10, whose lobe barely overlaps with that of n_s = 1000."""
    camera = ds.Camera(eye=(0, 0, 4), fov=32, shape=(64, 64))
    scene = standard_scene(ds.Material(MATERIAL.k_a, MATERIAL.k_d, MATERIAL.k_s, n_s))
    clean = photographs(scene, camera)[:3]
    views = one_light_each(noisy(clean, sigma, 0), camera)
    fit = ds.fit(scene, views, free=FREE, tied=TIED)
    noise = [(v.image - c)[find_samples(scene, v).inside] for v, c in zip(views, clean, strict=True)]
    rmse_of_truth = np.sqrt(np.mean(np.concatenate(noise) ** 2))
    assert fit.converged
    assert (
        fit.rmse <= rmse_of_truth * (1 + 1e-9) + 3e-13
    )  # a fit stops where a step promises 1e-25 of the sum of squares


@pytest.mark.parametrize("scale", [1e-4, 1e2, 1e4])
def test_the_unit_of_the_residuals_changes_neither_steps_nor_values(scale):
    """optimistix's own damping is absolute: it takes 8 steps at scale 1 and 34 at 1e-4."""
    scene = standard_scene()
    images = noisy(photographs(scene), 0.005, 0)[:3]
    one = ds.fit(scene, one_light_each(images), free=FREE, tied=TIED)
    exposed = one_light_each([scale * image for image in images], exposure=scale)
    other = ds.fit(scene, exposed, free=FREE, tied=TIED)
    assert abs(one.steps - other.steps) <= 1
    np.testing.assert_allclose(other.values, one.values, rtol=1e-9)
    np.testing.assert_allclose(other.plain_errors, one.plain_errors, rtol=1e-6)
    np.testing.assert_allclose(other.rmse, scale * one.rmse, rtol=1e-9)
