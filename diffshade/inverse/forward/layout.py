"""Layout: the pixels of a chunk with the points they show, and the weight of each sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...core.fields import Array
from ...model.scenes import Object
from ...parallel.threads import cores, on_all_cores
from ..data.view_sets import ViewSet
from ..pixels.blocks import Block, Observed, Piece, padded_length, rows_and_columns, views_of
from .interface import AbstractForwardModel, Pixels


def place(parts: Sequence[Piece], size: int, over_pixels: tuple[Object, ...], length: int | None = None) -> Pixels:
    """Return where the pixels of a chunk are, with what of the objects comes with them (`slots.apart`).

    A padded pixel has zeros: of a G-buffer a zero normal, outside the mask.
    """
    row, column = rows_and_columns(parts, size, length)

    def gather(leaf: Array) -> np.ndarray:
        leaf = np.asarray(leaf)
        flat = leaf.reshape(-1, *leaf.shape[2:])
        out = np.zeros((*row.shape, *leaf.shape[2:]), leaf.dtype)
        for b, part in enumerate(parts):
            out[b, : len(part.pixels)] = flat[part.pixels]
        return out

    return Pixels(row, column, jax.tree.map(gather, over_pixels))


def points_of(
    chunks: Sequence[Sequence[Piece]],
    data: ViewSet,
    model: AbstractForwardModel,
    over_pixels: tuple[Object, ...],
    size: int,
) -> list[Any]:
    """Return the points of each chunk, on the device.

    What a camera shows is found once for all chunks that show it, and what lights do there once for all that have the
    same lights too; these chunks share their arrays.

    Args:
        chunks: The chunks, a piece for each block.
        data: The photographs.
        model: The forward model.
        over_pixels: What of the objects comes with the pixels (`slots.apart`).
        size: Pixels in a block.
    """
    shows = [tuple((data.cameras[v], id(pixels) if len(pixels) else 0) for v, _, pixels in of) for of in chunks]
    alike = [(key, tuple(data.lit[part.view] for part in of)) for key, of in zip(shows, chunks, strict=True)]
    one = dict(zip(alike, chunks, strict=True))  # of the chunks that are alike
    by_camera: dict[tuple, list[tuple]] = {}
    for pair in one:
        by_camera.setdefault(pair[0], []).append(pair)

    def pixels_of(parts: Sequence[Piece], length: int) -> tuple[Any, Any, Any]:
        counts = np.zeros((length, 1))
        counts[: len(parts), 0] = [len(part.pixels) for part in parts]
        return place(parts, size, over_pixels, length), views_of(parts, length), np.arange(size) < counts

    def seen(key: tuple) -> Any:
        """Return what a camera shows; blocks of a chunk that show the same are found once."""
        parts, different = one[by_camera[key][0]], list(dict.fromkeys(key))
        if (length := padded_length(len(different))) >= len(key):  # to find these once would save nothing
            return jax.device_put(model.seen(*pixels_of(parts, len(parts))))
        once = model.seen(*pixels_of([parts[key.index(block)] for block in different], length))
        index = [different.index(block) for block in key]
        return jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf)[index], once))

    def lit(keys: Sequence[tuple]) -> dict[tuple, Any]:
        points = dict(zip(keys, on_all_cores(seen, keys), strict=True))
        pairs = [pair for key in keys for pair in by_camera[key]]
        found = on_all_cores(lambda pair: model.lit(points[pair[0]], views_of(one[pair])), pairs)
        return dict(zip(pairs, found, strict=True))

    keys, found = list(by_camera), {}
    for start in range(0, len(keys), cores()):  # a few at a time: what is seen takes more memory than what is kept
        found |= lit(keys[start : start + cores()])
    return [found[pair] for pair in alike]


def with_weights(model: AbstractForwardModel, chunk: Block, *, noise_known: bool) -> Block:
    """Replace which samples of a chunk count by weights: by the noise at the photograph's level where it is known."""
    weight = None if model.projects else jnp.asarray(chunk.observed.weight, float)
    observed = eqx.tree_at(lambda o: o.weight, chunk.observed, weight)
    chunk = Block(jax.device_put(chunk.view), chunk.points, jax.device_put(observed))
    return weigh(None, model, chunk) if noise_known and not model.projects else chunk


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
