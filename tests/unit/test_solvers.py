"""The engine: it finds what SciPy's own least squares find, within bounds, in any units."""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
import scipy.optimize
from float64 import float64  # noqa: F401
from refusals import refuses
from solver_witness import three_views
from synthetic import CAMERA, FREE, TIED, noisy, one_light_each, photographs, standard_scene

import diffshade as ds
from diffshade.inverse.forward.gram import ByView, Gram, Point
from diffshade.inverse.solve.descent import GramLevenbergMarquardt, at_bound
from diffshade.inverse.solve.elimination import Dense
from diffshade.inverse.solve.solvers import PriorResiduals

# --- a fit; beside other solvers in studies/test_optima.py


@pytest.mark.parametrize("scale", [*(pytest.param(of, marks=pytest.mark.thorough) for of in (1e-4, 1e2)), 1e4])
def test_photographs_in_other_units_give_the_same_material_times_that_unit(scale):
    """The start, k = 0.3, is then far from the answer: n_s and the attenuation must not run away from it."""
    scene = standard_scene()
    images = noisy(photographs(scene), 0.005, 0)[:3]
    one = ds.fit(scene, one_light_each(images), free=FREE, tied=TIED)
    other = ds.fit(scene, one_light_each([scale * image for image in images]), free=FREE, tied=TIED)
    factor = np.array([scale if "k_" in name else 1.0 for name in one.names])
    np.testing.assert_allclose(other.values, factor * one.values, rtol=1e-6)
    np.testing.assert_allclose(other.rmse, scale * one.rmse, rtol=1e-9)


# --- the step


@jax.jit
def step(y, g, H, lower, upper, step_size, projected=None):
    solver = within(lower, upper, projected)
    of_view = ByView(jnp.zeros(1), g[None], H[None], None)
    here = Point(jnp.asarray(y), Gram(jnp.asarray(0.0), jnp.asarray(g), Dense(jnp.asarray(H))), of_view)
    return solver.newton(here, step_size, jnp.diagonal(H))[0]


def random_problem(random: np.random.Generator, p: int = 6):
    """A correlated quadratic at 0 inside a box, at whose edge about a third of the unknowns stand."""
    A = random.standard_normal((p + 2, p)) @ (np.eye(p) + random.standard_normal((p, p)))
    lower = np.where(random.random(p) < 0.3, 0.0, -random.exponential(1.0, p))
    return np.zeros(p), A.T @ A @ random.standard_normal(p), A.T @ A, lower, random.exponential(1.0, p)


def test_a_step_stays_in_the_box_exactly():
    random = np.random.default_rng(0)
    for _ in range(200):
        y, g, H, lower, upper = random_problem(random)
        dy = np.asarray(step(y, g, H, lower, upper, 10.0 ** random.uniform(-3, 6)))
        assert np.all((lower <= y + dy) & (y + dy <= upper))


def test_without_a_bound_in_the_way_it_is_newtons_step():
    random = np.random.default_rng(1)
    far = np.full(6, 1e6)
    y, g, H, _, _ = random_problem(random)
    np.testing.assert_allclose(step(y, g, H, -far, far, 1e14), -np.linalg.solve(H, g), rtol=1e-8)


def test_damping_shortens_it_towards_the_scaled_gradient():
    y, g, H, _, _ = random_problem(np.random.default_rng(2))
    far = np.full(6, 1e6)
    np.testing.assert_allclose(step(y, g, H, -far, far, 1e-8), -1e-8 * g / np.diag(H), rtol=1e-6)


def test_damping_does_not_hold_what_is_projected():
    """It is at its best for whatever the others are: strongly damped, the others stay and it makes Newton's step."""
    y, g, H, _, _ = random_problem(np.random.default_rng(2))
    far = np.full(6, 1e6)
    projected = np.arange(6) < 2
    expected = np.concatenate([-np.linalg.solve(H[:2, :2], g[:2]), np.zeros(4)])
    np.testing.assert_allclose(step(y, g, H, -far, far, 1e-12, projected), expected, rtol=1e-6, atol=1e-9)


def test_it_does_not_depend_on_the_unit_of_an_unknown():
    y, g, H, lower, upper = random_problem(np.random.default_rng(3))
    unit = 10.0 ** np.arange(-3.0, 3.0)
    dy = step(y, g, H, lower, upper, 10.0)
    scaled = step(y, g / unit, H / np.outer(unit, unit), lower * unit, upper * unit, 10.0)
    np.testing.assert_allclose(scaled, dy * unit, rtol=1e-9, atol=1e-12)


def test_an_unknown_at_a_bound_stays_while_its_slope_points_out_and_leaves_when_it_points_in():
    H = np.array([[2.0, 0.5], [0.5, 1.0]])
    lower, upper = np.zeros(2), np.ones(2)
    y = np.array([0.0, 0.5])
    out = np.asarray(step(y, np.array([1.0, 0.2]), H, lower, upper, 1e14))
    np.testing.assert_allclose(out, [0.0, -0.2], atol=1e-12)  # the other solves its own equation alone
    assert step(y, np.array([-1.0, 0.2]), H, lower, upper, 1e14)[0] > 0
    for slope, there in ((1.0, True), (-1.0, False)):
        pinned = at_bound(*map(jnp.asarray, (y, np.array([slope, 0.2]), lower, upper)))
        assert np.asarray(pinned).tolist() == [there, False]


def test_a_step_is_the_minimum_of_the_damped_model_within_the_box():
    """g.dy + dy.(H + D/step_size) dy/2 with D = diag(H); which bounds hold must come out, whatever crosses first."""
    random = np.random.default_rng(4)
    for _ in range(300):
        y, g, H, lower, upper = random_problem(random)
        damped = H + np.diag(np.diag(H)) / 1e3
        L = np.linalg.cholesky(damped)
        best = scipy.optimize.lsq_linear(L.T, -np.linalg.solve(L, g), (lower, upper), method="bvls", tol=1e-14).x
        np.testing.assert_allclose(step(y, g, H, lower, upper, 1e3), best, atol=1e-7)


@pytest.mark.parametrize("H", [np.zeros((2, 2)), np.array([[1.0, 1.0], [1.0, 1.0]]), np.diag([1.0, 0.0])])
def test_a_singular_hessian_gives_a_finite_step(H):
    g = H @ np.array([1.0, -3.0])
    for damping in (1e-3, 1.0):
        assert np.isfinite(step(np.zeros(2), g, H, np.full(2, -9.0), np.full(2, 9.0), 1.0 / damping)).all()


# --- the whole solver on functions whose answer is known


def one_view(y, cost, gradient, hessian):
    """What the solver wants of a function: its cost, and the point with its Gram in total and by view, here one."""
    of_view = ByView(cost[None], gradient[None], hessian[None], None)
    return cost, Point(y, Gram(cost, gradient, Dense(hessian)), of_view)


def linear_least_squares(y, args):
    A, b = args
    r = A @ y - b
    return one_view(y, 0.5 * r @ r, A.T @ r, A.T @ A)


def within(lower, upper, projected=None, **options) -> GramLevenbergMarquardt:
    projected = jnp.zeros(len(lower), bool) if projected is None else projected
    return GramLevenbergMarquardt(lower=lower, upper=upper, projected=projected, **options)


@jax.jit
def box_constrained(y, args, lower, upper):
    solver = within(lower, upper)
    return optx.minimise(linear_least_squares, solver, y, args, has_aux=True, max_steps=200, throw=False).value


@pytest.mark.thorough
def test_bounded_linear_problems_are_solved_whatever_their_correlations():
    """Correlated columns send the first active sets astray: a step may not lower the model, and is no convergence."""
    random = np.random.default_rng(0)
    for _ in range(200):
        p = 8
        A = random.standard_normal((p + 8, p)) @ (np.eye(p) + random.standard_normal((p, p)))
        b = A @ random.standard_normal(p) + 0.5 * random.standard_normal(p + 8)
        lower = np.where(random.random(p) < 0.5, 0.0, -np.inf)
        upper = np.where(random.random(p) < 0.3, 0.5, np.inf)
        y = np.asarray(box_constrained(np.full(p, 0.3), (A, b), lower, upper))
        best = scipy.optimize.lsq_linear(A, b, (lower, upper), method="bvls", tol=1e-14)
        assert 0.5 * np.sum((A @ y - b) ** 2) <= best.cost * (1 + 1e-8)


def quartic(y, args):
    """((y0 + y1)^2 - 1)^2 / 2; from far away each step halves the way, and y0 - y1 is never seen."""
    s = jnp.sum(y)
    r, slope = s**2 - 1.0, 2.0 * s * jnp.ones(2)
    return one_view(y, 0.5 * r**2, r * slope, jnp.outer(slope, slope))


FAR = np.full(2, 1e300)


def test_a_singular_problem_that_takes_dozens_of_steps_is_solved_all_the_same():
    """Damping shrinks with every step that succeeds, and with it what keeps the matrix regular."""
    solver = within(jnp.asarray(-FAR), jnp.asarray(FAR))
    solution = optx.minimise(quartic, solver, jnp.array([1e6, 1e6]), has_aux=True, max_steps=200, throw=False)
    assert solution.result == optx.RESULTS.successful
    np.testing.assert_allclose(jnp.sum(solution.value), 1.0, rtol=1e-9)


@pytest.mark.thorough
@pytest.mark.parametrize("wall", [jnp.nan, jnp.inf])
def test_a_step_onto_something_that_is_not_finite_is_taken_back(wall):
    def walled(y, args):
        """A parabola about 0.9 that says it is flatter than it is, and a wall at 1."""
        inside = y[0] <= 1.0
        terms = 0.5 * (y[0] - 0.9) ** 2, y - 0.9, 0.1 * jnp.eye(1)
        return one_view(y, *(jnp.where(inside, term, wall) for term in terms))

    far = jnp.full(1, 1e6)
    solver = within(-far, far)
    solution = optx.minimise(walled, solver, jnp.zeros(1), has_aux=True, max_steps=200, throw=False)
    assert solution.result == optx.RESULTS.successful
    np.testing.assert_allclose(solution.value, 0.9, rtol=1e-4)


def test_a_start_that_is_not_finite_is_an_error_in_one_sentence():
    scene = standard_scene(lights=[ds.PointLight((2, 3, 4), 1e200)] * 8)
    views = one_light_each([np.full((*CAMERA.shape, 3), 0.5)] * 3)
    refuses(lambda: ds.fit(scene, views, free=FREE, tied=TIED), "not finite", error=FloatingPointError)


X = np.linspace(0.0, 2.0, 40)
DECAY = 2.0 * np.exp(-1.3 * X) + 0.05 * np.random.default_rng(0).standard_normal(40)


def decay(y, args):
    def left(y):
        return y[0] * jnp.exp(-y[1] * X) - DECAY

    r, J = left(y), jax.jacfwd(left)(y)
    return one_view(y, 0.5 * r @ r, J.T @ r, J.T @ J)


def test_the_last_step_ends_at_the_minimum_though_no_pass_confirms_it():
    solver = within(jnp.asarray(-FAR), jnp.asarray(FAR))
    solution = optx.minimise(decay, solver, jnp.array([1.0, 1.0]), has_aux=True, max_steps=50)
    best = scipy.optimize.least_squares(lambda y: y[0] * np.exp(-y[1] * X) - DECAY, [1.0, 1.0], xtol=1e-15, ftol=1e-15)
    error = np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)) * 2 * best.cost / 38)
    np.testing.assert_allclose(solution.value, best.x, rtol=0, atol=3e-6 * error.min())
    np.testing.assert_allclose(solution.stats["cost"], best.cost, rtol=1e-12)
    _, at = decay(solution.value, None)
    np.testing.assert_allclose(solution.aux.total.hessian.whole, at.total.hessian.whole, rtol=1e-4)
    assert not np.array_equal(solution.aux.total.hessian.whole, at.total.hessian.whole)  # that of the pass before


def test_a_step_from_far_away_says_nothing_of_how_later_ones_shrink():
    """One unknown comes from far at once, another converges slowly: what the first gained is not believed."""
    seen = 5.0 + 2.0 * np.exp(-1.3 * X) + 0.05 * np.random.default_rng(2).standard_normal(40)

    def left(y, of=jnp):
        return (y[2] + y[0] * of.exp(-y[1] * X) - seen) / 0.05

    def shifted(y, args):
        r, J = left(y), jax.jacfwd(left)(y)
        return one_view(y, 0.5 * r @ r, J.T @ r, J.T @ J)

    far = jnp.full(3, 1e9)
    solver = within(-far, far, damping=1e-8)
    solution = optx.minimise(shifted, solver, jnp.array([2.0, 1.29, 1e5]), has_aux=True, max_steps=50)
    best = scipy.optimize.least_squares(lambda y: left(y, np), [2.0, 1.29, 5.0], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    error = np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))
    np.testing.assert_allclose(solution.value, best.x, rtol=0, atol=1e-4 * error.min())
    np.testing.assert_allclose(solution.stats["cost"], best.cost, rtol=1e-10)


@pytest.mark.parametrize("shown", [None, np.array([[0, 1], [1, 2], [2, 3]])], ids=["all", "some"])
def test_what_each_view_says_moves_with_the_last_step(shown):
    """Of a quadratic cost exactly; the second of two unknowns of the last view is padding. No cost falls below 0."""
    random, m = np.random.default_rng(5), 3 if shown is None else 2
    A, b = random.standard_normal((3, 6, m)), random.standard_normal((3, 6))
    index = np.tile(np.arange(3), (3, 1)) if shown is None else shown
    A[np.broadcast_to((index == 3)[:, None], A.shape)] = 0.0

    def at(y, b=b):
        r = np.einsum("vrm,vm->vr", A, np.append(y, 0.0)[index]) - b
        gradient, hessian = np.einsum("vrm,vr->vm", A, r), np.einsum("vrm,vrn->vmn", A, A)
        whole = np.zeros((4, 4))
        for i, H in zip(index, hessian, strict=True):
            whole[np.ix_(i, i)] += H
        cost, gradient, hessian = map(jnp.asarray, (0.5 * np.sum(r**2, 1), gradient, hessian))
        views = ByView(cost, gradient, hessian, None if shown is None else jnp.asarray(shown))
        return Point(jnp.asarray(y), Gram(views.cost.sum(), views.slope(3), Dense(jnp.asarray(whole[:3, :3]))), views)

    y, step = random.standard_normal(3), random.standard_normal(3)
    moved, there = at(y).moved(jnp.asarray(step)), at(y + step)
    for found, right in zip(jax.tree.leaves(moved), jax.tree.leaves(there), strict=True):
        np.testing.assert_allclose(found, right, rtol=1e-10, atol=1e-12)
    exact = np.einsum("vrm,vm->vr", A, np.append(y + step, 0.0)[index])
    moved = at(y, exact).moved(jnp.asarray(step))
    assert moved.total.cost >= 0.0
    assert np.all(np.asarray(moved.views.cost) >= 0.0)


def test_a_solver_that_runs_out_of_steps_says_so():
    solver = within(jnp.asarray(-FAR), jnp.asarray(FAR))
    solution = optx.minimise(quartic, solver, jnp.array([1e15, 1e15]), has_aux=True, max_steps=3, throw=False)
    assert solution.result == optx.RESULTS.nonlinear_max_steps_reached


def test_a_fit_that_runs_out_of_steps_says_so_and_counts_them():
    solver = three_views()
    end, early = solver.run(), solver.run(max_steps=3)
    assert end.message == ""
    assert early.steps == 3 < end.steps
    assert "the cost still falls" in early.message
    assert early.point.total.cost > end.point.total.cost


# --- what is known beside the views


@pytest.mark.thorough
def test_priors_and_unit_vectors_are_residuals_beside_those_of_the_views():
    random = np.random.default_rng(0)
    theta, mean, weight = random.standard_normal(7), random.standard_normal(2), random.uniform(0.5, 2.0, 2)
    index, units, unit_weight = np.array([5, 0]), np.array([[1, 2, 3], [4, 5, 6]]), 3.0
    soft = PriorResiduals(*map(jnp.asarray, (index, mean, weight, units, np.full(2, unit_weight))))

    def cost(q):
        prior = jnp.sum((weight * (q[index] - mean)) ** 2)
        return 0.5 * prior + 0.5 * sum((unit_weight * 0.5 * (q[unit] @ q[unit] - 1.0)) ** 2 for unit in units)

    gram = soft.gram(jnp.asarray(theta))
    np.testing.assert_allclose(gram.cost, cost(theta), rtol=1e-12)
    np.testing.assert_allclose(gram.gradient, jax.grad(cost)(jnp.asarray(theta)), rtol=1e-12, atol=1e-12)
    J = np.zeros((4, 7))
    J[[0, 1], index] = weight
    for k, unit in enumerate(units):
        J[2 + k, unit] = unit_weight * theta[unit]
    np.testing.assert_allclose(gram.hessian.as_matrix(), J.T @ J, rtol=1e-12, atol=1e-12)


def test_nothing_known_beside_the_views_adds_nothing():
    none = jnp.zeros(0)
    soft = PriorResiduals(jnp.zeros(0, int), none, none, jnp.zeros((0, 3), int), none)
    for leaf in jax.tree.leaves(soft.gram(jnp.ones(4))):
        assert not np.asarray(leaf).any()
