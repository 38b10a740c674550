"""Run store: a run over tiles (maps of texels) on disk, its arrays with a mark for each finished tile, to resume."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from ..io.files import replacing, reserve
from .devices import DeviceGroup
from .run_folders import open_folder, release


class RunStore:
    """The arrays of a run, mapped from files of a folder or held in memory, and which of its tiles are finished.

    A tile is written before it is marked as finished, so a run that was killed repeats at most the tile at work and
    counts none twice. Where several processes share the folder, the first one makes the files.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str] | None,
        problem: str,
        rows: int,
        tiles: Callable[[int], int],
        device_group: DeviceGroup | None,
    ):
        """Open the folder of a run, or begin one.

        Args:
            folder: Where the arrays are kept; None keeps them in memory.
            problem: Fingerprint of the computation.
            rows: Rows of a tile of a new run; a resumed run keeps its own.
            tiles: Number of tiles for a number of rows.
            device_group: Devices that share the work.

        Raises:
            ValueError: The folder holds other files, belongs to another run, or is in use.
        """
        self.folder = None if folder is None else Path(folder)
        self.device_group = device_group if device_group is not None and device_group.several else None
        self.first = self.device_group is None or self.device_group.first
        self.rows = rows
        self.arrays: dict[str, np.ndarray] = {}
        self.lock: TextIO | None = None
        refused: Exception | None = None
        if self.folder is not None and self.first:
            try:
                self.rows, self.lock = open_folder(self.folder, problem, rows)
            except (ValueError, OSError) as error:
                refused = error
        if self.device_group is not None:  # the other processes must learn that the first one has refused
            rows_of_first = 0.0 if refused or not self.first else float(self.rows)
            self.rows = int(self.device_group.total(np.array(rows_of_first)))
        if refused or not self.rows:
            self.close()
            raise refused or ValueError("the first process refused the folder of maps. Read its message.")
        self.done = self.array("done", (tiles(self.rows),), np.uint8)

    def array(self, name: str, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
        """Return an array of zeros, or the one that exists; all processes ask for the same arrays in the same order."""
        if name not in self.arrays:
            self.arrays[name] = np.zeros(shape, dtype) if self.folder is None else self._mapped(name, shape, dtype)
        return self.arrays[name]

    def _mapped(self, name: str, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
        assert self.folder is not None
        path = self.folder / f"{name}.npy"
        if self.first and not path.exists():
            if name != "done":
                self._check_is_new(path)
            with replacing(path) as temporary:  # written whole or not at all
                made = np.lib.format.open_memmap(temporary, "w+", dtype, shape)
                made.flush()
                reserve(temporary, made.offset)
        self.wait_for_all()
        array = np.lib.format.open_memmap(path, "r+")
        if array.shape != shape or array.dtype != dtype:
            raise ValueError(
                f"{path} has {array.dtype} numbers of shape {array.shape}, as another version of diffshade wrote them; "
                f"this one needs {np.dtype(dtype)} of {shape}. Remove the folder {self.folder} and begin anew."
            )
        return array

    def kept(self, name: str, make: Callable[[], Sequence[np.ndarray]]) -> list[np.ndarray]:
        """Return arrays as the run first made them: what rounding decides must not change when it is resumed.

        Args:
            name: The file's name.
            make: Computes the arrays.

        Raises:
            ValueError: Tiles are finished, and the file is missing.
        """
        if self.folder is None:
            return list(make())
        path = self.folder / f"{name}.npz"
        if not path.exists():
            self._check_is_new(path)
            arrays = make()
            if self.first:
                with replacing(path) as temporary, temporary.open("wb") as file:
                    np.savez(file, *arrays)
        self.wait_for_all()
        with np.load(path) as file:
            return [file[f"arr_{i}"] for i in range(len(file.files))]

    def _check_is_new(self, path: Path) -> None:
        """Refuse to make a file anew where tiles are finished."""
        if self.done.any():
            raise ValueError(f"{path} of an earlier run is missing. Remove the folder {self.folder} and begin anew.")

    def read(self, name: str) -> np.ndarray:
        """Return a read-only view of an array."""
        array = self.arrays[name].view()
        array.flags.writeable = False
        return array

    def finish(self, tile: int, name: str = "done") -> None:
        """Mark a tile as finished, after all its numbers are on disk."""
        for array in self.arrays.values():
            if isinstance(array, np.memmap):
                array.flush()
        self.arrays[name][tile] = 1

    def close(self) -> None:
        """Release the folder."""
        release(self.lock)

    def wait_for_all(self) -> None:
        """Wait for the other processes; raise LostProcess if one is gone."""
        if self.device_group is not None:
            self.device_group.total(np.zeros(1))
