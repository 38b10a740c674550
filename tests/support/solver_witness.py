"""A fit of three photographs as numbers, its residuals in one vector for other solvers, and what an optimum must be."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from grams import whole
from synthetic import (
    ATTENUATION,
    FREE,
    MATERIAL,
    TIED,
    noisy,
    one_light_each,
    photographs,
    point_lights,
    standard_scene,
)

from diffshade.inverse.data.view_sets import ViewSet
from diffshade.inverse.fitting import new_problem
from diffshade.inverse.forward.gram import Gram, Point
from diffshade.inverse.forward.interface import AbstractForwardModel
from diffshade.inverse.pixels.blocks import Block
from diffshade.inverse.problem import FitProblem, fit_problem
from diffshade.inverse.solve.solvers import Minimum, minimise
from diffshade.inverse.unknowns.parameters import find_unknowns
from diffshade.inverse.unknowns.unknown import Unknown, coordinates


class Solver(NamedTuple):
    """A fit's unknowns and residuals as numbers, in the solver's coordinates (log n_s)."""

    unknowns: list[Unknown]
    problem: FitProblem
    chunks: list[Block]
    squares: float
    witness: tuple[AbstractForwardModel, Block]
    """The same residuals by rendering, in one chunk of blocks, whatever form the solver uses."""
    start: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    def run(self, max_steps: int = 200) -> Minimum:
        return minimise(self.start, self.problem.task(self.squares), self.chunks, max_steps=max_steps)


def three_views(
    material=MATERIAL, attenuation=ATTENUATION, bounds=None, sigma=0.005, seed=0, free=FREE, rendered=False
) -> Solver:
    scene = standard_scene(material, point_lights(attenuation))
    views = one_light_each(noisy(photographs(scene), sigma, seed))[:3]
    unknowns = find_unknowns(scene, views, free, TIED, bounds)
    data = new_problem(scene, ViewSet.of(scene, views), unknowns, "squares", "hinge").data
    fast, generic = (fit_problem(scene, data, unknowns, "squares", rendered=form) for form in (rendered, True))
    chunks, (chunk,) = fast.chunks(), generic.chunks()
    squares = fast.sum_of_squares(chunks)
    ends = (
        coordinates(np.array([getattr(u, name) for u in unknowns]), unknowns) for name in ("start", "lower", "upper")
    )
    return Solver(unknowns, fast, chunks, squares, (generic.model, chunk), *ends)


def all_residuals(theta, witness):
    """Every residual of every block in one vector."""
    form, chunk = witness
    weight = jnp.sqrt(chunk.observed.weight)
    predicted = jax.vmap(lambda block: jnp.stack(form.predict(theta, block)))(chunk)
    return jnp.ravel(weight * (predicted - chunk.observed.target))


dense_residuals = jax.jit(all_residuals)
dense_jacobian = jax.jit(jax.jacfwd(all_residuals))


def cost(theta, witness) -> float:
    r = np.asarray(dense_residuals(theta, witness))
    return 0.5 * float(r @ r)


def scipy_optimum(solver: Solver) -> scipy.optimize.OptimizeResult:
    options: dict[str, Any] = {"x_scale": "jac", "xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15, "max_nfev": 200}
    options["jac"] = lambda theta: np.asarray(dense_jacobian(theta, solver.witness))
    return scipy.optimize.least_squares(
        lambda theta: np.asarray(dense_residuals(theta, solver.witness)),
        np.clip(solver.start, solver.lower + 1e-9, solver.upper - 1e-9),
        bounds=(solver.lower, solver.upper),
        **options,
    )


def at_ends(theta, solver: Solver) -> tuple[np.ndarray, np.ndarray]:
    """Which unknowns stand at their lower and at their upper bound, but for rounding."""
    room = 1e-12 * np.abs(theta)
    return theta <= solver.lower + room, theta >= solver.upper - room


def assert_is_a_minimum_within_bounds(theta, gram: Gram, solver: Solver) -> None:
    """Karush-Kuhn-Tucker: no slope along what is free, a slope out of the box along what stands at a bound.

    The slope is measured in the lengths of the Jacobian's columns and of the residual: it is their cosine.
    """
    g, H = np.asarray(gram.gradient), np.asarray(gram.hessian.as_matrix())
    lengths = np.sqrt(np.diag(H) * 2.0 * float(gram.cost))
    slope = np.where(lengths > 0, g / np.where(lengths > 0, lengths, 1.0), 0.0)
    low, high = at_ends(theta, solver)
    room = 1e-12 * np.abs(theta)
    assert np.all((solver.lower - room <= theta) & (theta <= solver.upper + room))
    np.testing.assert_allclose(slope[~low & ~high], 0.0, atol=1e-6)
    assert np.all(slope[low] >= -1e-12)
    assert np.all(slope[high] <= 1e-12)


def assert_gram_is_that_of_a_dense_jacobian(point: Point, solver: Solver) -> None:
    theta = np.asarray(point.theta)
    r, J = (np.asarray(f(theta, solver.witness)) for f in (dense_residuals, dense_jacobian))
    np.testing.assert_allclose(float(point.total.cost), cost(theta, solver.witness), rtol=1e-10)
    H = point.total.hessian.as_matrix()
    np.testing.assert_allclose(whole(point.views, len(theta)).hessian.sum(0), H, rtol=1e-12)
    np.testing.assert_allclose(H, J.T @ J, rtol=1e-8, atol=1e-8 * np.abs(J.T @ J).max())
    np.testing.assert_allclose(point.total.gradient, J.T @ r, atol=1e-8 * np.abs(J).sum() * np.abs(r).max())
