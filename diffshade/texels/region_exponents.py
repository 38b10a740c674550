"""Region exponents: one n_s for all texels of a region, found before the other numbers of each texel.

The cost of a region is the sum of its texels' reduced costs. Passes over all tiles add up for each region what the next
value of log n_s needs: first the costs on a grid, then slopes and curvatures for Gauss-Newton steps.
"""

from __future__ import annotations

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..core.fields import Array
from ..core.thresholds import NEGLIGIBLE
from .blocks import first_normals, problem_of
from .descent import HIGH, LOW, MAX_LOG_N_S_STEP, costs_on_grid, descend
from .lighting import LightingSetup
from .linear_systems import solve
from .normal_equations import NormalEquations, eliminate_coefficients, evaluate
from .prediction import FitOptions, KnownCoefficients, TexelBlock, TexelProblem, first_weights
from .status import HIGHLIGHT_F

MAX_PASSES = 12


@partial(jax.jit, static_argnames="options")
def grid_costs(
    setup: LightingSetup, known: KnownCoefficients, block: TexelBlock, options: FitOptions
) -> Float[Array, "grid texels"]:
    """Return the cost of every texel at every n_s of the grid."""
    problem = problem_of(setup, known, block, 1.0, options)
    return costs_on_grid(problem, first_normals(problem), first_weights(problem))


@partial(jax.jit, static_argnames="options")
def slopes(
    setup: LightingSetup,
    known: KnownCoefficients,
    block: TexelBlock,
    sigma: Float[Array, ""],
    max_steps: Int[Array, ""],
    options: FitOptions,
) -> Float[Array, "4 texels"]:
    """Return each texel's slope and curvature of the reduced cost by log n_s, its squares and degrees of freedom."""
    problem = problem_of(setup, known, block, sigma, options)
    held = dataclasses.replace(problem, options=options.without("n_s"))
    weight = first_weights(problem)
    descent = descend(held, first_normals(problem), block.log_n_s, weight, max_steps)
    found = evaluate(problem, descent.found.n, block.log_n_s, descent.weight)
    samples = found.share * block.observed.channels
    freedom = jnp.where(samples > problem.unknowns, samples - problem.unknowns + 1.0, 0.0)
    counts = (freedom > 0.0) & descent.converged
    if known.k_s is None:
        counts = counts & _shows_highlight(problem, weight, found, freedom)
    terms = [found.slope[-1], _curvature(found, fit_normal=problem.fit_normal), found.squares, freedom]
    return jnp.where(counts[None], jnp.stack(terms), 0.0)


def _curvature(found: NormalEquations, *, fit_normal: bool) -> Float[Array, " texels"]:
    """Return the curvature of the cost by log n_s, the normal eliminated."""
    S = eliminate_coefficients(found, hold_zeros=True).S
    curvature = S[-1][-1]
    if fit_normal:
        column = [row[-1] for row in S[:2]]
        z = solve([row[:2] for row in S[:2]], column)
        curvature = curvature - sum(a * b for a, b in zip(z, column, strict=True))
    return jnp.maximum(curvature, NEGLIGIBLE * found.P[-1][-1])


def _shows_highlight(problem: TexelProblem, weight: Array, found: NormalEquations, freedom: Array) -> Array:
    """Return where a highlight is significant; without one a texel's n_s would be fitted to noise."""
    weight = weight if found.weight is None else found.weight
    plain = evaluate(problem.without_highlight(), found.n, found.x, weight)
    explained = (plain.cost - found.cost) * 2.0 / problem.observed.channels
    return explained > HIGHLIGHT_F * found.squares / jnp.maximum(freedom, 1.0)


def next_exponents(
    x: Float[np.ndarray, " regions"], sums: Float[np.ndarray, "4 regions"]
) -> tuple[Float[np.ndarray, " regions"], Float[np.ndarray, " regions"]]:
    """Return log n_s of each region after one Gauss-Newton step, and its standard error."""
    slope, curvature, squares, freedom = sums
    curved = curvature > 0.0
    safe = np.where(curved, curvature, 1.0)
    step = np.where(curved, np.clip(-slope / safe, -MAX_LOG_N_S_STEP, MAX_LOG_N_S_STEP), 0.0)
    error = np.where(curved & (freedom > 0), np.sqrt(squares / np.maximum(freedom, 1.0) / safe), np.inf)
    return np.clip(x + step, LOW, HIGH), error


def by_region(
    values: Float[np.ndarray, "rows texels"], region: Int[np.ndarray, " texels"], regions: int
) -> Float[np.ndarray, "rows regions"]:
    """Add up the values of the texels of each region."""
    return np.stack([np.bincount(region, row, regions) for row in values])
