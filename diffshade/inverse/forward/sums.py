"""Sums: what a pass over the pixels can add up beside the Gram: squares, spread, and what rounding does."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...core.backend import PLAINLY, UNFUSED, jit_quickly
from ...core.fields import Array
from ...parallel.threads import on_all_cores
from ..pixels.blocks import Block, total
from .gram import directions_of
from .interface import AbstractForwardModel
from .rounding import HARMONICS, Rounding, damping, harmonics

T = TypeVar("T")
Theta = Float[Array, " p"]


def sum_over(
    chunks: Sequence[Block],
    program: Callable[[Any, AbstractForwardModel, Block], T],
    theta: Any,
    model: AbstractForwardModel,
) -> T:
    """Return the sum of `program(theta, model, chunk)` over all chunks: one pass, on all cores."""
    run = compiled(program, model.transparent)
    return total(on_all_cores(lambda chunk: run(theta, model, chunk), chunks))


@functools.lru_cache
def compiled(program: Callable[..., Any], unfused: bool = False) -> Callable[..., Any]:
    """Return a compiled program; `unfused` turns off fusion, with which XLA's CPU compiler can be slow."""
    return jax.jit(program, compiler_options=UNFUSED if unfused and jax.default_backend() == "cpu" else None)


def sum_of_squares(of_view: Float[np.ndarray, " views"], chunk: Block) -> float:
    """Return the weighted sum of squares of a chunk's samples; in NumPy, since a program would run but once.

    `of_view`: the weight of each view's samples, for chunks that hold none.
    """
    target, weight = np.asarray(chunk.observed.target), chunk.observed.weight
    if weight is None:
        return float(np.einsum("bcp,bcp->b", target, target) @ of_view[np.asarray(chunk.view)])
    return float(np.einsum("bcp,bcp,bcp->", target, target, np.asarray(weight)))


weights_of_views = jit_quickly(lambda model: model.view_weights())


@functools.partial(jit_quickly, options=PLAINLY)
def residuals(
    theta: Theta, model: AbstractForwardModel, chunk: Block
) -> tuple[Float[Array, "blocks channels pixels"], ...]:
    """Return the weighted residuals of a chunk, which samples were measured, and what is predicted."""

    def of_block(block: Block) -> tuple[Array, Array, Array]:
        m = jnp.stack(model.predict(theta, block))
        r = jnp.sqrt(model.sample_weights(block)) * (m - block.observed.target)
        return r, model.measured_weights(block) > 0, m

    return jax.lax.map(of_block, chunk)


def spread(theta: Theta, model: AbstractForwardModel, chunk: Block) -> Float[Array, "5"]:
    """Return the sums of `Likelihood.spread` over a chunk."""

    def of_block(block: Block) -> Array:
        m, seen = jnp.stack(model.predict(theta, block)), block.observed
        return model.likelihood.spread(m, seen.target, model.sample_weights(block), seen.clipped)

    return jax.lax.map(of_block, chunk).sum(0)


def waves(theta: Theta, model: AbstractForwardModel, chunk: Block) -> Float[Array, "views p waves"]:
    """Return the rows of A of each view, as columns, over a chunk: A^T A is the gradients' covariance by rounding.

    The last is that of all samples a step too high, over the square root of 12. Samples have the weights of the Gram;
    those at an end of the sensor's range are left out.
    """
    rounding, shown, p = model.setting.rounding, model.setting.shown, theta.shape[0]

    def add(total: Any, block: Block) -> tuple[Any, None]:
        m, derivative = jax.linearize(lambda q: jnp.stack(model.predict(q, block)), theta)
        index, along = directions_of(shown, block.view, p)
        J = jax.vmap(derivative)(along)  # (most, channels, pixels)
        weight = model.measured_weights(block)
        where, size = rounding.steps(block.view, m)
        bend = model.likelihood.terms(m, block.observed.target, weight, None).curvature
        rows = harmonics(2.0 * jnp.pi * where, bend * size, damping(rounding, weight, size))
        of_block = jnp.matmul(J.reshape(len(J), -1), rows.reshape(len(rows), -1).T, precision="highest")
        return total.at[block.view, index].add(of_block, mode="drop"), None

    zero = jnp.zeros((model.setting.grey.shape[0], p, 2 * HARMONICS + 1))
    return jax.lax.scan(add, zero, chunk)[0]


def variance_of_steps(rounding: Rounding, model: AbstractForwardModel, chunk: Block) -> Float[Array, "2"]:
    """Return the sums over a chunk's samples of 1 and of the weighted variance of a step, w q^2/12."""

    def of_block(block: Block) -> Array:
        weight = model.measured_weights(block)
        _, size = rounding.steps(block.view, block.observed.target)
        return jnp.stack([jnp.sum(jnp.where(weight > 0, 1.0, 0.0)), jnp.sum(weight * size**2) / 12.0])

    return jax.lax.map(of_block, chunk).sum(0)
