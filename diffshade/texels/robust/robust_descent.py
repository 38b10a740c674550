r"""Robust descent: the normal, k_d and k_s of each texel from a start, by Levenberg-Marquardt under a robust loss.

$$ \min \sum \rho((k_d D + k_s S - y) / s) + \lambda k_s^2, \quad k_d, k_s \ge 0 $$
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Float

from ...core.barriers import stored
from ...core.fields import Array
from ...inverse.forward.losses import LOSSES
from ...model.vectors import Vec3, tangents_of
from ..descent import FAR, tilted
from ..linear_systems import solve
from .candidates import weighted_coefficients
from .observations import BlockObservations
from .reflection_shape import ReflectionShape

MAX_TILT = 0.2  # of the normal, as its tangent
LESS_DAMPING, MORE_DAMPING = 0.3, 6.0  # factors after a step that lowers the cost, and one that does not


class Weighing(eqx.Module):
    """What the residuals and k_s of each texel are measured by."""

    scale: Float[Array, " texels"]
    """s: a residual of this size begins to be doubted."""
    ridge: Float[Array, " texels"]
    """lambda: a large k_s is as unlikely as that for this object."""
    loss: str = eqx.field(static=True)


class DescentState(eqx.Module):
    """Where the descent of each texel is; every array may have an axis of starts before that of the texels."""

    n: Vec3
    k_d: Float[Array, "*starts texels"]
    k_s: Float[Array, "*starts texels"]
    cost: Float[Array, "*starts texels"]


class Local(NamedTuple):
    """The model around a state, in every view."""

    residual: Float[Array, "views texels"]
    J: tuple[Array, Array, Array, Array]
    """Derivatives of the model by both tilts, k_d and k_s."""
    weight: Float[Array, "views texels"]
    """Of the loss; 0 where an observation does not count."""


class System(NamedTuple):
    """The cost of a state, and the normal equations of its next step."""

    cost: Array
    A: list[list[Array]]
    g: list[Array]


def begin(observed: BlockObservations, shape: ReflectionShape, weighing: Weighing, n: Vec3) -> DescentState:
    """Return the state at these normals with the best k_d and k_s for squares."""
    D, S = observed.lights.shading(shape, n)
    ridge = weighing.ridge * weighing.scale**2
    k_d, k_s = weighted_coefficients(observed.believed.astype(D.dtype), D, S, observed.y, ridge)
    return DescentState(n, k_d, k_s, jnp.full(k_d.shape, jnp.inf, k_d.dtype))


def descend(
    observed: BlockObservations, shape: ReflectionShape, weighing: Weighing, start: DescentState, steps: int
) -> DescentState:
    """Return the states after some steps, of which each texel takes those that lower its cost."""

    def step(_: Array, carry: tuple[DescentState, list[list[Array]], list[Array], Array]) -> tuple:
        state, A, g, damping = carry
        tried = _stepped(state, A, g, damping)
        there = system(observed, shape, weighing, tried)
        better = there.cost < state.cost
        tried = dataclasses.replace(tried, cost=there.cost)
        state, A, g = jax.tree.map(
            lambda new, old: jnp.where(better, new, old), (tried, there.A, there.g), (state, A, g)
        )
        return state, A, g, jnp.where(better, LESS_DAMPING * damping, MORE_DAMPING * damping + 0.01)

    # by equations of zeros the first step is of length 0, and it is taken: it evaluates the start
    zero = jnp.zeros_like(start.k_d)
    begun = dataclasses.replace(start, cost=jnp.full_like(zero, jnp.inf))
    damping = jnp.full_like(zero, FAR / LESS_DAMPING)
    return jax.lax.fori_loop(0, steps + 1, step, (begun, [[zero] * 4] * 4, [zero] * 4, damping))[0]


def around(observed: BlockObservations, shape: ReflectionShape, weighing: Weighing, state: DescentState) -> Local:
    """Return the residuals of a state, their derivatives and their weights, which many sums share."""
    tangents = tangents_of(state.n)
    D, S, *by_tilt = observed.lights.slopes(shape, state.n, tangents)
    k_d, k_s = state.k_d[None], state.k_s[None]
    by_a, by_b = (k_d * by_tilt[i] + k_s * by_tilt[i + 1] for i in (0, 2))
    residual = k_d * D + k_s * S - observed.y
    weight = observed.trust * LOSSES[weighing.loss].slope((residual / weighing.scale[None]) ** 2)
    return stored(Local(residual, (by_a, by_b, D, S), weight))


def system(observed: BlockObservations, shape: ReflectionShape, weighing: Weighing, state: DescentState) -> System:
    """Return the cost of a state and its normal equations, one view after another: only sums leave a core's cache."""
    pairs = [(i, j) for i in range(4) for j in range(i + 1)]
    rho = LOSSES[weighing.loss]

    def add(total: tuple[Array, ...], view: BlockObservations) -> tuple[tuple[Array, ...], None]:
        here = around(view, shape, weighing, state)
        squared = (here.residual / weighing.scale[None]) ** 2
        terms = [view.trust * rho.value(squared)]
        terms += [here.weight * here.J[i] * here.J[j] for i, j in pairs]
        terms += [here.weight * here.residual * column for column in here.J]
        return tuple(t + term[0] for t, term in zip(total, terms, strict=True)), None

    zero = jnp.zeros_like(state.k_d)
    (cost, *sums), _ = jax.lax.scan(add, (zero,) * (1 + len(pairs) + 4), observed.each_view())
    lower, g = sums[: len(pairs)], sums[len(pairs) :]
    A = [[lower[pairs.index((max(i, j), min(i, j)))] for j in range(4)] for i in range(4)]
    ridge = weighing.ridge * weighing.scale**2
    A[3][3], g[3] = A[3][3] + ridge, g[3] + ridge * state.k_s
    return System(cost + weighing.ridge * state.k_s**2, A, g)


def _stepped(state: DescentState, A: list[list[Array]], g: list[Array], damping: Array) -> DescentState:
    """Return the state after one damped step; a coefficient that is 0 and would fall stays."""
    never = jnp.zeros(state.k_d.shape, bool)
    held = [never, never, (state.k_d <= 0.0) & (g[2] > 0.0), (state.k_s <= 0.0) & (g[3] > 0.0)]

    def element(i: int, j: int) -> Array:
        return A[i][i] * (1.0 + damping) + 1e-7 if i == j else jnp.where(held[i] | held[j], 0.0, A[i][j])

    downhill = [jnp.where(h, 0.0, -slope) for h, slope in zip(held, g, strict=True)]
    a, b, k_d, k_s = solve([[element(i, j) for j in range(4)] for i in range(4)], downhill)
    n = tilted(state.n, a, b, MAX_TILT)
    return stored(DescentState(n, jnp.maximum(state.k_d + k_d, 0.0), jnp.maximum(state.k_s + k_s, 0.0), state.cost))


def lowest(state: DescentState, few: int) -> DescentState:
    """Return the `few` lowest of the starts of each texel, the lowest first."""
    order = jnp.argsort(state.cost, 0)[:few]
    return jax.tree.map(lambda leaf: jnp.take_along_axis(leaf, order, 0), state)
