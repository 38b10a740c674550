"""Descent: n and n_s of every texel by Levenberg-Marquardt on the reduced problem, with a damping for each texel."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.fields import Array
from ..core.thresholds import NEGLIGIBLE, TINY
from ..inverse.solve.solvers import FAR
from ..model.lobes import EXPONENT_RANGE
from ..model.vectors import Vec3, normalize, tangents_of
from .linear_systems import solve
from .normal_equations import NormalEquations, cost_at, eliminate_coefficients, evaluate
from .prediction import TexelProblem, first_weights

T = TypeVar("T")
LOW, HIGH = (float(end) for end in np.log(EXPONENT_RANGE))
GRID = np.log(0.5 * 4.0 ** np.arange(7))  # values of log n_s to start from; a descent bridges a factor of 4 with ease
MAX_TILT, MAX_LOG_N_S_STEP = 0.3, 1.5  # longest step of the normal, as its tangent, and of log n_s
MAX_DAMPING = 1e8


class Descent(eqx.Module):
    """How far the descent of every texel has come."""

    found: NormalEquations
    weight: Float[Array, "views _ texels"]
    damping: Float[Array, " texels"]
    converged: Bool[Array, " texels"]


def descend(problem: TexelProblem, n: Vec3, x: Array, weight: Array, max_steps: Int[Array, ""]) -> Descent:
    """Return the minimum of every texel, found from n and x = log n_s in at most `max_steps` steps a stage.

    There is one stage for each loss of the problem; each begins where the one before it ended.
    """
    freedom = jnp.maximum(problem.samples - problem.unknowns, 1.0)
    squares = jnp.sum(first_weights(problem) * problem.observed.target.astype(x.dtype) ** 2, (0, 1))

    def step(problem: TexelProblem, state: tuple[Descent, Array]) -> tuple[Descent, Array]:
        now, steps = state
        tried, promised = _damped_step(problem, now.found, now.damping, now.weight)
        fell = now.found.cost - tried.cost
        better = (fell > 0.0) & ~now.converged
        negligible = NEGLIGIBLE * 2.0 * tried.cost / freedom + TINY**2 * squares
        converged = now.converged | ((promised <= negligible) & (fell <= negligible)) | (now.damping > MAX_DAMPING)
        new = now.weight if tried.weight is None else choose(better, tried.weight, now.weight)
        damping = jnp.where(better, 0.2 * now.damping, 5.0 * now.damping + 0.01)
        return Descent(choose(better, tried, now.found), new, damping, converged), steps + 1

    def stage(last: Descent, loss: Array) -> tuple[Descent, None]:
        of_stage = dataclasses.replace(problem, stage=loss)
        start = (_begin(last.found, last.weight), jnp.asarray(0))
        end, _ = jax.lax.while_loop(
            lambda s: (s[1] < max_steps) & ~jnp.all(s[0].converged), lambda s: step(of_stage, s), start
        )
        return end, None

    if not problem.fit_normal and not problem.fit_exponent and not problem.reweights:  # linear: no step is needed
        found = evaluate(problem, n, x, weight)
        return Descent(found, weight, jnp.zeros_like(x), jnp.ones(x.shape, bool))
    shapes = jax.eval_shape(evaluate, problem, n, x, weight)
    empty = dataclasses.replace(jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes), n=n, x=x)
    return jax.lax.scan(stage, _begin(empty, weight), jnp.arange(len(problem.losses)))[0]


def choose(condition: Bool[Array, " texels"], a: T, b: T) -> T:
    """Choose texel by texel between two trees of arrays whose last axis is the texels."""
    return jax.tree.map(lambda x, y: jnp.where(jnp.reshape(condition, (1,) * (x.ndim - 1) + (-1,)), x, y), a, b)


def _begin(found: NormalEquations, weight: Array) -> Descent:
    """Return a descent whose first step is of length 0 and is taken, so that it evaluates the start."""
    nowhere, flat = jnp.full_like(found.x, jnp.inf), [jnp.zeros_like(slope) for slope in found.slope]
    found = dataclasses.replace(found, cost=nowhere, slope=flat)
    return Descent(found, weight, jnp.full_like(found.x, FAR), jnp.zeros(found.x.shape, bool))


def _damped_step(
    problem: TexelProblem, found: NormalEquations, damping: Array, weight: Array
) -> tuple[NormalEquations, Array]:
    """Return every texel after one damped step, and by how much the linear model says that the cost falls."""
    S = eliminate_coefficients(found, hold_zeros=True).S
    count = len(S)
    scale = [jnp.maximum(S[i][i], NEGLIGIBLE * found.P[i][i]) for i in range(count)]
    damped = [[scale[i] * (1.0 + damping) if i == j else S[i][j] for j in range(count)] for i in range(count)]
    step = [-s for s in solve(damped, found.slope)]
    promised = -sum((g * s for g, s in zip(found.slope, step, strict=True)), jnp.zeros(found.x.shape))
    n, x = moved(problem, found.n, found.x, step)
    return evaluate(problem, n, x, weight), promised


def moved(problem: TexelProblem, n: Vec3, x: Array, step: Sequence[Array]) -> tuple[Vec3, Array]:
    """Return n and x = log n_s after a step, shortened to the range of the linear model."""
    if problem.fit_exponent:
        x = jnp.clip(x + jnp.clip(step[-1], -MAX_LOG_N_S_STEP, MAX_LOG_N_S_STEP), LOW, HIGH)
    return (tilted(n, step[0], step[1]) if problem.fit_normal else n), x


def tilted(n: Vec3, a: Array, b: Array, longest: float = MAX_TILT) -> Vec3:
    """Return normals tilted by a and b along their tangents, together by `longest` at most."""
    along, across = tangents_of(n)
    shorter = jnp.minimum(1.0, longest / jnp.maximum(jnp.sqrt(a**2 + b**2), TINY))
    return normalize(n + along * (a * shorter) + across * (b * shorter))


def costs_on_grid(problem: TexelProblem, n: Vec3, weight: Array) -> Float[Array, "grid texels"]:
    """Return the cost of squares at every n_s of the grid."""
    return jax.lax.map(lambda x: cost_at(problem, n, jnp.full(n.x.shape, x), weight), jnp.asarray(GRID))


def best_on_grid(problem: TexelProblem, n: Vec3, weight: Array) -> Float[Array, " texels"]:
    """Return the log n_s of the grid that has the least cost of squares."""
    return jnp.asarray(GRID)[jnp.argmin(costs_on_grid(problem, n, weight), 0)]
