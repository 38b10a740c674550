"""Shared exponents: one n_s for all texels of a region, found before the rest of each texel is.

The cost of a region is the sum of its texels' reduced costs. Passes over all tiles add up, region by region, what the
next value of log n_s takes: first the costs on a grid, then slopes and curvatures for Gauss-Newton steps.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..core.fields import Array
from .coefficients import solve
from .descent import FARTHEST, FIRM, HIGH, LOW, costs_on_grid, descend
from .estimates import SEEN, Block, Choices, begin
from .lighting import LightingSetup
from .normal_equations import Found, Known, evaluate, reduced

MOST_PASSES = 12
STILL = 1e-3  # a step of log n_s below which it has arrived: weights and the texels that count change by less no more


@partial(jax.jit, static_argnames="choices")
def grid_costs(setup: LightingSetup, known: Known, block: Block, choices: Choices) -> Float[Array, "grid texels"]:
    """Return the cost of every texel at every n_s of the grid."""
    task, n, weight = begin(setup, known, block, choices)
    return costs_on_grid(task, n, weight)


@partial(jax.jit, static_argnames="choices")
def slopes(
    setup: LightingSetup, known: Known, block: Block, sigma: Array, patience: Array, choices: Choices
) -> Float[Array, "4 texels"]:
    """Return, at each texel's n_s, the slope and the curvature of its reduced cost, its squares and its freedom."""
    held = choices._replace(free=tuple(name for name in choices.free if name != "n_s"))
    task, n, weight = begin(setup, known, block, held, sigma)
    descent = descend(task, n, block.log_n_s, weight, patience)
    sharp, *_ = begin(setup, known, block, choices, sigma)
    found = evaluate(sharp, descent.found.n, block.log_n_s, descent.weight)
    A = reduced(found, held=True).rest
    curvature = A[-1][-1]
    if sharp.fit_normal:  # what n takes up of it
        z = solve([row[:2] for row in A[:2]], [row[-1] for row in A[:2]])
        curvature = curvature - sum(a * b for a, b in zip(z, [row[-1] for row in A[:2]], strict=True))
    curvature = jnp.maximum(curvature, FIRM * found.rest[-1][-1])
    samples = found.share * block.seen.target.shape[1]
    freedom = jnp.where(samples > sharp.unknowns, samples - sharp.unknowns + 1.0, 0.0)
    counts = (freedom > 0.0) & descent.done & _shines(held, known, setup, block, sigma, n, found, freedom)
    return jnp.where(counts[None], jnp.stack([found.slope[-1], curvature, found.squares, freedom]), 0.0)


def _shines(
    choices: Choices,
    known: Known,
    setup: LightingSetup,
    block: Block,
    sigma: Array,
    n: Any,
    found: Found,
    freedom: Array,
) -> Array:
    """Return where a highlight explains enough to have a say in what n_s is: where one may be missing, noise would."""
    if known.k_s is not None:
        return jnp.ones(freedom.shape, bool)
    task, _, weight = begin(setup, known.without_highlight(), block, choices, sigma)
    without = evaluate(task, found.n, found.x, weight if found.weight is None else found.weight)
    explained = (without.cost - found.cost) * 2.0 / len(block.seen.target[0])
    return explained > SEEN * found.squares / jnp.maximum(freedom, 1.0)


def stepped(x: Float[np.ndarray, " regions"], sums: Float[np.ndarray, "4 regions"]) -> tuple[np.ndarray, np.ndarray]:
    """Return log n_s of each region after one step, and its standard error."""
    slope, curvature, squares, freedom = sums
    known = curvature > 0.0
    safe = np.where(known, curvature, 1.0)
    step = np.where(known, np.clip(-slope / safe, -FARTHEST[1], FARTHEST[1]), 0.0)
    error = np.where(known & (freedom > 0), np.sqrt(squares / np.maximum(freedom, 1.0) / safe), np.inf)
    return np.clip(x + step, LOW, HIGH), error


def by_region(values: Float[np.ndarray, "rows texels"], region: np.ndarray, regions: int) -> Any:
    """Add up the texels of each region."""
    return np.stack([np.bincount(region, row, regions) for row in values])
