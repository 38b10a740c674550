"""Tile runner: reads the tiles of a run one after another, works on all cores or devices, and resumes from disk."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import TypeVar

import jax
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Float

from ..core.progress import ReportProgress
from ..inverse.data.views import View
from ..model.scenes import Scene
from ..parallel.devices import DeviceGroup
from ..parallel.run_store import RunStore
from ..parallel.threads import on_all_cores, one_ahead
from .prediction import TexelBlock
from .tiles import SQUARE, TexelPart, TexelTile, ViewReader

S = TypeVar("S")
T = TypeVar("T")


class TileRunner:
    """The tiles of one run: what reads them, what computes on them, and what stores the results."""

    def __init__(
        self,
        scene: Scene,
        views: Sequence[View],
        problem: str,
        report_progress: ReportProgress,
        *,
        out: str | os.PathLike[str] | None,
        memory: float | int,
        devices: Mesh | None,
    ):
        """Cut the views into tiles and open the store of the results.

        Args:
            scene: One object and its lights.
            views: The photographs.
            problem: Fingerprint of the fit.
            report_progress: Called with what is being done, and how much of it is done.
            out: Folder of the results; None keeps them in memory.
            memory: Bytes that the photographs of a tile may take.
            devices: Devices to use; None uses all cores.

        Raises:
            ValueError: There are several processes without `out`, or the folder belongs to another run.
        """
        self.reader = ViewReader(scene, views)
        self.report_progress = report_progress
        self.device_group = None if devices is None else DeviceGroup(devices)
        if self.device_group is not None and self.device_group.several and out is None:
            raise ValueError(
                "several processes need one folder for their maps; got out=None. Give out a shared folder."
            )
        height, rows = self.reader.shape[0], self.reader.rows_of(memory)
        if self.device_group is not None:  # every device gets a tile
            rows = min(rows, -(-height // len(self.device_group.devices)))
        if self.reader.with_position:  # no square of texels that share their lamps' directions is cut
            rows = max(rows // SQUARE, 1) * SQUARE
        self.store = RunStore(out, problem, rows, lambda rows: -(-height // rows), self.device_group)
        self.count = len(self.store.done)

    @property
    def own(self) -> Sequence[int]:
        """The tiles of this process."""
        group = self.device_group
        return [t for t in range(self.count) if group is None or t % len(group.devices) in group.own]

    def close(self) -> None:
        """Release the store's folder."""
        self.store.close()

    def rows_of(self, t: int) -> tuple[int, int]:
        """Return the first row of a tile, and the end of its rows."""
        return t * self.store.rows, min((t + 1) * self.store.rows, self.reader.shape[0])

    def each_tile(
        self, work: Callable[[int, TexelTile], None], verb: str, *, done: str = "done", margin: int = 0
    ) -> None:
        """Read every tile of this process that is not done, call `work(index, tile)` if it has texels, and store that.

        Args:
            work: What to do with a tile.
            verb: What is being done, for the progress.
            done: Name of the array that says which tiles are done.
            margin: Rows of the neighbouring tiles, above and below, that are read as well.
        """
        height, rows = self.reader.shape[0], self.store.rows
        finished = self.store.array(done, (self.count,), np.uint8)
        own = self.own
        todo = [t for t in own if not finished[t]]

        def read(t: int) -> tuple[int, TexelTile]:
            first, last = self.rows_of(t)
            return t, self.reader.read(max(first - margin, 0), min(last + margin, height), rows + 2 * margin)

        for k, (t, tile) in enumerate(one_ahead(read, todo)):
            if len(tile.pixels):
                work(t, tile)
            self.store.finish(t, done)
            self.report_progress(verb, (len(own) - len(todo) + k + 1) / len(own))

    def on_all(self, work: Callable[[S], T], pieces: Sequence[S]) -> list[T]:
        """Return work(piece) for each piece, in order: on all cores, or each on the next device of the mesh."""
        if self.device_group is None:
            return on_all_cores(work, pieces)
        devices = self.device_group.here

        def on_device(item: tuple[int, S]) -> T:
            k, piece = item
            with jax.default_device(devices[k % len(devices)]):
                return work(piece)

        return on_all_cores(on_device, list(enumerate(pieces)))

    def each(self, program: Callable[[TexelBlock, TexelPart], T], pieces: Sequence[TexelPart]) -> T:
        """Return what a compiled program gives for pieces, one after another, as NumPy arrays without the padding."""

        def of_piece(piece: TexelPart) -> T:
            found = program(self.reader.lay_out(piece), piece)
            return jax.tree.map(lambda leaf: np.asarray(leaf)[..., : len(piece.part)], found)

        return jax.tree.map(lambda *parts: np.concatenate(parts, -1), *self.on_all(of_piece, pieces))

    def sum_over_tiles(
        self, name: str, shape: tuple[int, ...], of_tile: Callable[[TexelTile], np.ndarray], verb: str
    ) -> Float[np.ndarray, "..."]:
        """Return the sum of an array over all tiles; each tile's share is stored under `name`, for a resumed run."""
        shares = self.store.array(f"{name}_sums", (self.count, *shape), np.float64)

        def add(t: int, tile: TexelTile) -> None:
            shares[t] = of_tile(tile)

        self.each_tile(add, verb, done=f"{name}_done")
        if self.device_group is None or not self.device_group.several:
            return shares.sum(0)
        mine = np.zeros(shape) + sum(shares[t] for t in self.own)
        return self.device_group.total(mine)
