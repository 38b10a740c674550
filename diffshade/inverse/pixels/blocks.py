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

from ...core.fields import Array
from ..data.samples import MIN_PIXELS, Samples

T = TypeVar("T")
BLOCK = 2048  # places, of a blurred pixel several; what a block needs stays in a core's cache
LARGE = 8  # blocks: a view of more has a little of one of them padded at most
MANY = LARGE * BLOCK  # pixels of all views: passes over more are worth compiling for their own size of block
CACHE_LINE = 64  # bytes
OF_PART = 8  # blocks in a chunk of few, such as a part of the pixels
SEVERAL = 16 * OF_PART  # the most blocks that are few
OWN = OF_PART // 2  # views at most, or blocks in a chunk, that have programs for their own number
CHUNK = 32  # blocks at most in one call of a compiled program


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
    """Return how many pixels of each view are among `at_most`, evenly spread, with some of every view; None: all."""
    total = sum(pixels)
    if at_most is None or at_most >= total:
        return list(pixels)
    if len(pixels) > OWN:
        at_most = len(pixels) * few_sizes(at_most // len(pixels))
    return [max(n * at_most // total, min(n, MIN_PIXELS)) for n in pixels]


def filled(count: int) -> int:
    """Return to how many views so many are filled up: a few numbers."""
    if count <= OWN:
        return count
    return -(-count // CHUNK) * CHUNK if count > CHUNK else 1 << (count - 1).bit_length()


def few_sizes(count: int) -> int:
    """Return a power of two, or one and a half of it, of at most `count`: views in many numbers have equal shares."""
    power = 1 << max(count.bit_length() - 1, 0)
    return power + power // 2 if power + power // 2 <= count else power


def block_size(pixels: Sequence[int], places: int = 1) -> int:
    """Return how many pixels a block holds, given those of each view; `places` is at how many each is rendered.

    It is `BLOCK` where views are large, and a power of two where all of them together are small: few sizes serve, so
    that another mask seldom needs another program. Between these a block is chosen by the size of a view, up to half as
    large again, so that little of it is padded.
    """
    mean, most = max(sum(pixels) / len(pixels), 1.0), BLOCK // places
    if mean > LARGE * most:
        return most
    if filled(len(pixels)) * mean <= MANY:
        return min(most, max(1 << int(np.ceil(np.log2(mean))), 64))
    of_view = mean / max(round(mean / most), 1)
    step = 1 << max(int(np.log2(of_view)) - 3, 0)
    return max(step * int(np.ceil(of_view / step)), 64)


def chunks(parts: Sequence[Piece]) -> list[list[Piece]]:
    """Gather blocks into chunks, filled up with empty ones to one length, so that one program serves all.

    Where all views have the same pieces, chunks have the same pieces too, as far as that leaves few blocks empty.
    """
    if not parts:
        return []
    runs = [list(of) for _, of in itertools.groupby(parts, key=lambda part: part.view)]
    length, of_view = _chunk_length(len(parts), alone=len(runs) == 1), len(runs[0])
    if len({tuple(id(part.pixels) for part in run) for run in runs}) == 1 < len(runs):
        if of_view > CHUNK:
            share = -(-of_view // -(-of_view // CHUNK))
            return [cut for run in runs for cut in _cut(run, share)]
        at_once = of_view * max(length // of_view, 1)
        if 8 * (-len(parts) % at_once) <= len(parts):
            length = at_once
    return _cut(parts, length)


def _cut(parts: Sequence[Piece], length: int) -> list[list[Piece]]:
    """Cut blocks into chunks of a length; the last is filled up with empty blocks of its view."""
    last = parts[-1]
    filled = [*parts, *[last._replace(pixels=last.pixels[:0])] * (-len(parts) % length)]
    return [filled[start : start + length] for start in range(0, len(filled), length)]


def _chunk_length(count: int, *, alone: bool) -> int:
    """Return the number of blocks in each of the chunks that hold `count` of them, of one view alone or of several.

    A few lengths serve any number of views, and a part of the pixels (`problem.PART`) as all of them.
    """
    if alone and count <= 2 * OF_PART:
        return padded_length(-(-count // min(max(count // 4, 1), 2)))
    if count <= OF_PART:
        return min(count, OWN)
    return OF_PART if count <= SEVERAL else CHUNK


def padded_length(count: int) -> int:
    """Return the number of blocks of a chunk of at least `count`: few different ones, so that few programs compile."""
    if count > CHUNK:
        return -(-count // CHUNK) * CHUNK
    return next(length for length in (1, 2, 3, 4, 6, 8, 12, 16, 24, CHUNK) if length >= count)


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
