"""Layout: the pixels of a chunk with the points they show, and the weight of each sample."""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...core.fields import Array
from ...model.scenes import Object
from ..data.views import View
from ..pixels.blocks import Block, Observed, Piece, rows_and_columns
from .interface import AbstractForwardModel, Pixels


def place(
    parts: Sequence[Piece], views: Sequence[View], size: int, over_pixels: tuple[Object, ...], length: int | None = None
) -> Pixels:
    """Return where the pixels of a chunk are, with what of the objects comes with them (`slots.apart`).

    A padded pixel has zeros: of a G-buffer a zero normal, outside the mask.
    """
    row, column = rows_and_columns(parts, views, size, length)

    def gather(leaf: Array) -> np.ndarray:
        leaf = np.asarray(leaf)
        flat = leaf.reshape(-1, *leaf.shape[2:])
        out = np.zeros((*row.shape, *leaf.shape[2:]), leaf.dtype)
        for b, part in enumerate(parts):
            out[b, : len(part.pixels)] = flat[part.pixels]
        return out

    return Pixels(row, column, jax.tree.map(gather, over_pixels))


def lay_out(theta: Array | None, model: AbstractForwardModel, gathered: Block, *, noise_known: bool) -> Block:
    """Return a chunk laid out: the points its pixels show, and weights by the noise at the level that theta predicts.

    Without theta the level is the photograph's.
    """
    seen = gathered.observed
    points = model.fields(gathered.points, gathered.view, seen.weight[:, 0])
    return with_weights(theta, model, Block(gathered.view, jax.device_put(points), seen), noise_known=noise_known)


def with_weights(theta: Array | None, model: AbstractForwardModel, chunk: Block, *, noise_known: bool) -> Block:
    """Replace which samples of a chunk count by weights, as `lay_out` does."""
    weight = None if model.projects else jnp.asarray(chunk.observed.weight, float)
    observed = eqx.tree_at(lambda o: o.weight, chunk.observed, weight)
    chunk = Block(jax.device_put(chunk.view), chunk.points, jax.device_put(observed))
    return weigh(theta, model, chunk) if noise_known and not model.projects else chunk


def lay_plain(theta: Array | None, model: AbstractForwardModel, gathered: Block) -> Block:
    """Return a chunk laid out, with equal weights for all samples."""
    return lay_out(theta, model, gathered, noise_known=False)


def lay_weighed(theta: Array | None, model: AbstractForwardModel, gathered: Block) -> Block:
    """Return a chunk laid out, with weights by the noise."""
    return lay_out(theta, model, gathered, noise_known=True)


def weigh(theta: Array | None, model: AbstractForwardModel, chunk: Block) -> Block:
    """Return a chunk with weights by the noise at the level of the prediction; without theta, of the photograph."""
    return eqx.tree_at(lambda c: c.observed.weight, chunk, _weights(theta, model, chunk))


def without_clipped(chunk: Block) -> Block:
    """Return a chunk in which no clipped sample counts."""
    return eqx.tree_at(lambda c: c.observed.weight, chunk, _measured(chunk.observed))


# Compiled programs return the weights alone: they would copy the points, which chunks share.


@jax.jit
def _weights(theta: Array | None, model: AbstractForwardModel, chunk: Block) -> Array:
    def weight(block: Block) -> Array:
        seen = block.observed
        level = seen.target if theta is None else jnp.stack(model.predict(theta, block))
        noise = jax.tree.map(lambda leaf: leaf[block.view], model.setting.noise)
        return jnp.where(seen.weight > 0, 1.0 / noise.variance(level), 0.0)

    return jax.lax.map(weight, chunk)


@jax.jit
def _measured(seen: Observed) -> Array:
    return jnp.where(seen.clipped == 0, seen.weight, 0.0)
