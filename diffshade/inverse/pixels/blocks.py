"""Blocks: the pixels that count, cut into equal pieces, and a sum over them on every core."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from ...core.backend import at_once
from ...core.fields import Array
from ..data.samples import MIN_PIXELS, Samples

T = TypeVar("T")
BLOCK = 2048  # places, of a blurred pixel several; what a block needs stays in a core's cache
MANY = 8 * BLOCK  # pixels of all views; passes over twice as many are worth compiling for their own size of block
CACHE_LINE = 64  # bytes
CHUNK = 32  # blocks at most in one call of a compiled program, which takes as long as half a block
LENGTHS = ((1, 1), (2, 2), (4, 4), (6, 6), (15, 4), (128, 8), (np.inf, CHUNK))
"""Up to how many blocks in all a chunk has how many: cores share more than a few, and few are empty."""


class Observed(eqx.Module):
    """The samples of a block. A block of blocks, a chunk, has a leading axis."""

    target: Float[Array, "... channels pixels"]
    weight: Float[Array, "... channels pixels"] | Bool[Array, "... channels pixels"]
    """1 or 1/variance, 0 where a sample does not count; None where the model projects. Before a chunk is laid out,
    whether a sample counts."""
    clipped: Int8[Array, "... channels pixels"] | None
    """See `SensorRange.clipped`; None where no sample of the fit is."""


class Block(eqx.Module):
    """Pixels of one view, padded with pixels of weight 0 to a fixed number, and the points they show."""

    view: Int[Array, "..."]
    points: Any
    observed: Observed


class Piece(NamedTuple):
    """The pixels of a view that a block holds, before it is laid out."""

    view: int
    samples: Samples
    pixels: Int[np.ndarray, " n"]


def pieces(samples: Sequence[Samples], size: int, at_most: int | None = None) -> list[Piece]:
    """Cut the pixels of each view into blocks of `size`; with `at_most`, of so many pixels, evenly spread over all."""
    found: list[Piece] = []
    cut: dict[tuple[int, int], list[Int[np.ndarray, " n"]]] = {}  # views that share their pixels share the pieces
    for view, (s, count) in enumerate(zip(samples, shares([len(s.pixels) for s in samples], at_most), strict=True)):
        if (key := (id(s.pixels), count)) not in cut:
            pixels = s.pixels
            if count < len(pixels):
                pixels = pixels[np.arange(count) * len(pixels) // count]
            cut[key] = [pixels[start : start + size] for start in range(0, len(pixels), size)]
        found += [Piece(view, s, pixels) for pixels in cut[key]]
    return found


def shares(pixels: Sequence[int], at_most: int | None) -> list[int]:
    """Return how many pixels of each view are among `at_most`, evenly spread, with some of every view; None: all.

    A view has as many as if there were one of a few numbers of views, so that blocks have few sizes.
    """
    total = sum(pixels)
    if at_most is None or at_most >= total:
        return list(pixels)
    at_most = at_most * len(pixels) // few_sizes(len(pixels))
    return [max(n * at_most // total, min(n, MIN_PIXELS)) for n in pixels]


def block_size(pixels: Sequence[int], places: int = 1) -> int:
    """Return how many pixels a block holds, given those of each view; `places` is at how many each is rendered.

    It is `BLOCK` where views are large, more on a GPU, and one of a few sizes where all of them together are small, so
    that another mask or number of views seldom needs another program. Between these, where `BLOCK` would leave an
    eighth of the pixels padded, it is chosen by the size of a view, up to half as large again.
    """
    mean, most = max(sum(pixels) / len(pixels), 1.0), at_once(BLOCK) // places
    blocks = max(round(mean / most), 1)
    if sum(pixels) <= 2 * MANY:
        sizes = [max(few_sizes(int(np.ceil(mean / n))), 64) for n in (blocks, blocks + 1)]
        return min(sizes, key=lambda size: -(-mean // size) * size)  # the one that leaves less of a view padded
    if -(-mean // most) * most <= 1.125 * mean:
        return most
    step = 1 << max(int(np.log2(mean / blocks)) - 3, 0)
    return max(step * int(np.ceil(mean / blocks / step)), 64)


def few_sizes(count: int) -> int:
    """Return the least of 0, 1, 2, 3, 4, 6, 8, 12, 16, 24, ... that is at least `count`."""
    half = 1 << max((count - 1).bit_length() - 1, 0)
    return next(size for size in (0, half, half + half // 2, 2 * half) if size >= count)


def chunks(parts: Sequence[Piece]) -> list[list[Piece]]:
    """Gather blocks into chunks of one length, the last filled up with empty blocks.

    Where all views have the same pieces, chunks have the same pieces too. The length hardly depends on the number of
    views, so that one program serves many.
    """
    if not parts:
        return []
    runs = [list(of) for _, of in itertools.groupby(parts, key=lambda part: part.view)]
    length, of_view = next(length for most, length in LENGTHS if len(parts) <= most), len(runs[0])
    if len({tuple(id(part.pixels) for part in run) for run in runs}) == 1 < len(runs):
        if of_view > CHUNK:
            share = -(-of_view // -(-of_view // CHUNK))
            return [cut for run in runs for cut in _cut(run, share)]
        length = of_view * max((length if len(parts) < 64 else 16) // of_view, 1)  # 16: shared points stay in the cache
    return _cut(parts, length)


def _cut(parts: Sequence[Piece], length: int) -> list[list[Piece]]:
    """Cut blocks into chunks of a length; the last is filled up with empty blocks of its view."""
    last = parts[-1]
    filled = [*parts, *[last._replace(pixels=last.pixels[:0])] * (-len(parts) % length)]
    return [filled[start : start + length] for start in range(0, len(filled), length)]


def padded_length(count: int) -> int:
    """Return of how many blocks the points are found together: few different numbers, so that few programs compile."""
    return next((length for length in (4, 8, 16, CHUNK) if length >= count), -(-count // CHUNK) * CHUNK)


def views_of(parts: Sequence[Piece], length: int | None = None) -> Int[np.ndarray, " blocks"]:
    """Return the view of each block of a chunk, of so many blocks if `length` is given; 0 where it is padded."""
    view = np.zeros(length or len(parts), np.int64)
    view[: len(parts)] = [part.view for part in parts]
    return view


def observed(parts: Sequence[Piece], size: int, channels: int, *, clipping: bool) -> Observed:
    """Lay a chunk's samples out in blocks."""
    shape = (len(parts), channels, size)
    target, counts = aligned_zeros(shape), np.zeros(shape, bool)
    clipped = np.zeros(shape, np.int8) if clipping else None
    b = 0
    for _, of_view in itertools.groupby(parts, key=lambda part: id(part.samples)):
        run = [part.pixels for part in of_view]
        pixels, samples = np.concatenate(run), parts[b].samples
        values, used = samples.values(pixels), samples.photograph.shape[2]
        ends = None if clipped is None else samples.sensor_range.clipped(values)
        start = 0
        for piece in run:
            n = len(piece)
            of = slice(start, start + n)
            target[b, :used, :n] = values[of].T
            counts[b, :used, :n] = True
            if clipped is not None and ends is not None:
                clipped[b, :used, :n] = ends[of].T
            b, start = b + 1, start + n
    return Observed(target, counts, clipped)


def rows_and_columns(
    parts: Sequence[Piece], size: int, length: int | None = None
) -> tuple[Float[np.ndarray, "blocks size"], Float[np.ndarray, "blocks size"]]:
    """Return the row and the column of each pixel of a chunk; 0 where it is padded."""
    row, column = (aligned_zeros((length or len(parts), size)) for _ in range(2))
    for b, (_, samples, pixels) in enumerate(parts):
        n, width = len(pixels), samples.photograph.shape[1]
        row[b, :n] = pixels // width
        column[b, :n] = pixels - width * row[b, :n]
    return row, column


def aligned_zeros(shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    """Return zeros that JAX takes as they are on a CPU, where it copies an array that begins within a cache line."""
    count = int(np.prod(shape))
    memory = np.zeros(count + CACHE_LINE // 8)
    first = -memory.ctypes.data % CACHE_LINE // 8
    return memory[first : first + count].reshape(shape)


def total(parts: Sequence[Any]) -> Any:
    """Add trees leaf by leaf, always in the same order."""
    return functools.reduce(lambda a, b: jax.tree.map(np.add, a, b), [jax.tree.map(np.asarray, p) for p in parts])
