"""Streams: sums over all pixels, laid out anew at each pass, tile by tile, on all cores or the devices of a mesh."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeAlias, TypeVar

import jax
import numpy as np

from ...core.backend import UNFUSED
from ...core.progress import ReportProgress, silent
from ...parallel.checkpoints import Checkpoint
from ...parallel.devices import DeviceGroup, on_devices, zeros
from ...parallel.threads import cores, in_order, on_all_cores
from ..pixels.blocks import Block, Piece, padded_length, total
from ..pixels.tiles import Survey, Tile, Tiles
from .interface import AbstractForwardModel

S = TypeVar("S")
T = TypeVar("T")


class StreamingReduction:
    """All pixels of a fit, to be summed over once a step.

    Chunks, one a tile, are kept while they fit `memory` bytes; the others are laid out anew at each pass. Sums are made
    in the order of the tiles, so that nothing depends on which thread was first.
    """

    def __init__(
        self,
        tiles: Tiles,
        gather: Callable[[list, int | None], Block],
        lay: Callable[[Any, AbstractForwardModel, Block], Block],
        size: int,
        *,
        weigh_at: Any,
        memory: float | int,
        checkpoint: Checkpoint,
        device_group: DeviceGroup | None,
        report_progress: ReportProgress = silent,
    ):
        """Store how chunks are made: `gather` makes one from pieces, in NumPy; `lay`, compiled, adds the points.

        `weigh_at`: the theta whose predicted levels give the weights by noise; None takes the photographs' levels.
        """
        self.tiles, self.gather, self.lay, self.size, self.report_progress = tiles, gather, lay, size, report_progress
        self.checkpoint, self.device_group = checkpoint, device_group
        self.weigh_at = weigh_at
        self.room = float(memory)
        self.kept: dict[int, Block] = {}
        self.shapes: dict[Any, Any] = {}
        self.count = 0

    def summed(
        self, program: Callable[[Any, AbstractForwardModel, Block], T], theta: Any, model: AbstractForwardModel
    ) -> T:
        """Return the sum of `program(theta, model, chunk)` over all chunks, by a pass or from the checkpoint."""
        name = f"pass-{self.count:04d}"
        self.count += 1
        theta = np.asarray(theta)
        if program not in self.shapes:
            self.shapes[program] = jax.eval_shape(
                lambda model, chunk: program(theta, model, self.lay(self.weigh_at, model, chunk)),
                model,
                self.gather([], 1),
            )
        nothing = zeros(self.shapes[program])

        def make() -> list[np.ndarray]:
            walk = self._on_cores if self.device_group is None else self._on_devices
            return [theta, *jax.tree.leaves(walk(name, program, theta, model, nothing))]

        at, *leaves = self.checkpoint.once(name, make)
        if not np.allclose(at, theta, rtol=1e-9, atol=1e-12):
            raise ValueError(
                f"the checkpoint {self.checkpoint.folder} was made by other software: its steps differ from those of "
                "this fit. Give checkpoint another folder, or remove this one."
            )
        return jax.tree.unflatten(jax.tree.structure(nothing), leaves)

    def _on_cores(self, name: str, program: Any, theta: Any, model: AbstractForwardModel, total: Any) -> Any:
        """Sum on this process's cores."""
        lay, run = compiled(self.lay), compiled(program, model.transparent)

        def work(item: tuple[int, Any]) -> Any:
            k, read = item
            chunk = self.kept.get(k)
            if chunk is None:
                chunk = jax.block_until_ready(lay(self.weigh_at, model, self._gathered(self.tiles.all[k], read)))
            return k, chunk, jax.tree.map(np.asarray, run(theta, model, chunk))

        def fold(total: Any, start: int) -> Iterator[Any]:
            for found in in_order(work, self._read(range(start, len(self.tiles.all))), threads=cores(), ahead=cores()):
                self._keep(*found[:2])
                total = jax.tree.map(np.add, total, found[2])
                yield total

        return self._resumed(name, fold, total, len(self.tiles.all))

    def _on_devices(self, name: str, program: Any, theta: Any, model: AbstractForwardModel, total: Any) -> Any:
        """Sum on the devices of the mesh, each a tile at a time, and then over all of them."""
        assert self.device_group is not None
        device_group, number = self.device_group, len(self.tiles.all)
        options = tuple(UNFUSED.items()) if model.transparent and jax.default_backend() == "cpu" else None
        lay, run = _lay_on(self.lay, device_group.here), on_devices(_added(program), device_group.here, options)
        longest = padded_length(-(-self.tiles.longest // self.size))
        batches = [
            [lane + b * device_group.count for lane in device_group.own]
            for b in range(-(-number // device_group.count))
        ]

        def work(item: tuple[int, Sequence[Any]]) -> Any:
            b, reads = item
            if b in self.kept:
                return b, None
            one = [None if k >= number else self.tiles.all[k] for k in batches[b]]
            return b, [
                self.gather([], longest) if tile is None else self._gathered(tile, read, longest)
                for tile, read in zip(one, reads, strict=True)
            ]

        def fold(total: Any, start: int) -> Iterator[Any]:
            ready = in_order(work, self._read_batches(batches, start, number), threads=cores(), ahead=cores())
            for b, gathered in ready:
                if b not in self.kept:
                    chunk = lay((self.weigh_at, model), device_group.put(gathered))
                    self._keep(b, chunk)
                else:
                    chunk = self.kept[b]
                total = jax.block_until_ready(run((theta, model), (total, chunk)))
                yield total

        begin = device_group.put([total] * len(device_group.own))
        ends = jax.tree.map(np.asarray, self._resumed(f"{name}-on-{device_group.count}", fold, begin, len(batches)))
        with_lane = [jax.tree.map(lambda leaf, lane=lane: leaf[lane], ends) for lane in range(len(device_group.own))]
        self.checkpoint.forget_part(f"{name}-on-{device_group.count}")
        return device_group.total(with_lane)

    def _gathered(self, tile: Tile, read: Any, length: int | None = None) -> Block:
        return self.gather(_pieces_of(self.tiles, tile, read, self.size), length)

    def _keep(self, key: int, chunk: Block) -> None:
        """Keep a chunk while there is room."""
        if key not in self.kept and self.room > 0:
            needs = sum(leaf.nbytes for leaf in jax.tree.leaves(chunk))
            if needs > self.room:
                self.room = 0.0
                return
            self.room -= needs
            self.kept[key] = chunk

    def _read(self, indices: Iterable[int]) -> Iterator[tuple[int, Any]]:
        """Read tiles that are not kept, one thread ahead of the others."""

        def read(k: int) -> tuple[int, Any]:
            return k, None if k in self.kept else self.tiles.read(self.tiles.all[k])

        return in_order(read, indices, threads=1, ahead=cores())

    def _read_batches(self, batches: list[list[int]], start: int, number: int) -> Iterator[tuple[int, list[Any]]]:
        def read(b: int) -> tuple[int, list[Any]]:
            kept = b in self.kept
            return b, [None if kept or k >= number else self.tiles.read(self.tiles.all[k]) for k in batches[b]]

        return in_order(read, range(start, len(batches)), threads=1, ahead=1)

    def _resumed(self, name: str, fold: Callable[[Any, int], Iterator[Any]], total: Any, number: int) -> Any:
        """Sum from where the checkpoint is."""
        return resumed(self.checkpoint, name, fold, total, number, f"pass {self.count}", self.report_progress)


AllPixels: TypeAlias = Sequence[Block] | StreamingReduction
"""All pixels of a fit: the chunks in memory, or what lays them out anew at each pass."""


def sum_over(
    pixels: AllPixels, program: Callable[[Any, AbstractForwardModel, Block], T], theta: Any, model: AbstractForwardModel
) -> T:
    """Return the sum of `program(theta, model, chunk)` over all pixels: one pass."""
    if isinstance(pixels, StreamingReduction):
        return pixels.summed(program, theta, model)
    run = compiled(program, model.transparent)
    return total(on_all_cores(lambda chunk: run(theta, model, chunk), pixels))


def surveyed(
    tiles: Tiles, checkpoint: Checkpoint, device_group: DeviceGroup | None, report_progress: ReportProgress
) -> Survey:
    """Return the survey of all tiles: each process looks at its own."""
    own = [k for k in range(len(tiles.all)) if device_group is None or k % device_group.count in device_group.own]

    def fold(total: Survey, start: int) -> Iterator[Survey]:
        read = in_order(lambda k: (k, tiles.read(tiles.all[k])), own[start:], threads=1, ahead=cores())
        look = in_order(lambda item: tiles.look(tiles.all[item[0]], item[1]), read, threads=cores(), ahead=cores())
        for found in look:
            total = tiles.add(total, found)
            yield total

    def make() -> list[np.ndarray]:
        found = resumed(checkpoint, "survey", fold, tiles.nothing(), len(own), "reading the views", report_progress)
        if device_group is None:
            return list(found)
        mine = (found.rows, found.sums)
        rows, sums = device_group.total([mine, *[jax.tree.map(np.zeros_like, mine)] * (len(device_group.own) - 1)])
        ends = device_group.gathered(found.ends)
        return [rows, sums, np.stack([ends[..., 0].min(0), ends[..., 1].max(0)], -1)]

    return Survey(*checkpoint.once("survey", make))


def resumed(
    checkpoint: Checkpoint,
    name: str,
    fold: Callable[[S, int], Iterator[S]],
    total: S,
    number: int,
    words: str,
    report_progress: ReportProgress,
) -> S:
    """Return the last total that `fold` yields (one per tile), starting at the checkpoint and writing each to it."""
    done = 0
    if (part := checkpoint.part(name)) is not None:
        done, sums = part
        there = jax.tree.unflatten(jax.tree.structure(total), list(sums))
        total = jax.tree.map(_as_placed, total, there)
    shown = 0.0
    for latest in fold(total, done):
        done, total = done + 1, latest
        checkpoint.keep_part(name, done, total)
        now = time.monotonic()
        if now - shown > 0.2:
            shown = now
            report_progress(words, done / number)
    return total


def _as_placed(leaf: Any, new: np.ndarray) -> Any:
    """Return new numbers in the place of old ones, in memory or on devices."""
    return jax.device_put(new, leaf.sharding) if isinstance(leaf, jax.Array) else new


def _pieces_of(tiles: Tiles, tile: Tile, read: Any, size: int) -> list:
    found = tiles.samples(tile, read)
    return [Piece(tile.view, found, found.pixels[at : at + size]) for at in range(0, len(found.pixels), size)]


@functools.lru_cache
def compiled(program: Callable[..., Any], unfused: bool = False) -> Callable[..., Any]:
    """Return a compiled program; `unfused` turns off fusion, with which XLA's CPU compiler can be slow."""
    return jax.jit(program, compiler_options=UNFUSED if unfused and jax.default_backend() == "cpu" else None)


@functools.lru_cache
def _added(program: Callable[..., Any]) -> Callable[..., Any]:
    """Return the program that adds what a chunk gives to a running total."""

    def add(shared: Any, of_lane: Any) -> Any:
        total, chunk = of_lane
        return jax.tree.map(lambda t, new: t + new, total, program(*shared, chunk))

    return add


@functools.lru_cache
def _lay_on(lay: Callable[..., Any], mesh: Any) -> Callable[..., Any]:
    return on_devices(lambda shared, gathered: lay(*shared, gathered), mesh)
