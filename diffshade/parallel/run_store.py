"""Records: what a long run has found so far, in a folder, so that it goes on where it was when it was stopped."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..io.files import replacing
from .devices import DeviceGroup


class RunStore:
    """The arrays of a run, mapped from files of a folder, or in memory alone; and which of its tiles are done.

    A tile is written before it is marked, so that a run that was killed does it again, whole: nothing is lost but the
    tile at work, and nothing counts twice. Of several processes, which share the folder, the first makes the files.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str] | None,
        problem: str,
        rows: int,
        tiles: Callable[[int], int],
        device_group: DeviceGroup | None,
    ):
        """Open the record of a run in a folder, or begin one with `rows` a tile; `tiles` gives their number.

        `problem`: the fingerprint of what is computed. Raises ValueError where the folder has the record of another
        run, or one is at work in it.
        """
        self.folder = None if folder is None else Path(folder)
        self.device_group = device_group if device_group is not None and device_group.several else None
        self.first = self.device_group is None or self.device_group.first
        self.rows = rows
        self.arrays: dict[str, np.ndarray] = {}
        self.lock: Any = None
        refused: Exception | None = None
        if self.folder is not None and self.first:
            try:
                self.rows = self._open(self.folder, problem, rows)
            except (ValueError, OSError) as error:
                refused = error
        if self.device_group is not None:  # the others must learn that the first one has refused
            self.rows = int(self.device_group.from_first(np.array([0.0 if refused else float(self.rows)]))[0])
        if refused or not self.rows:
            self.close()
            raise refused or ValueError("the first process refused the folder of maps. Read its message.")
        self.done = self.array("done", (tiles(self.rows),), np.uint8)

    def _open(self, folder: Path, problem: str, rows: int) -> int:
        """Lock the folder and return the rows of a tile in its record, or begin a record."""
        run = folder / "run.json"
        strange = (
            not folder.is_dir() or any(_is_strange(path) for path in folder.iterdir()) if folder.exists() else False
        )
        if strange and not run.exists():
            raise ValueError(f"{folder} is no folder of maps of an earlier run. Give out the name of a new folder.")
        folder.mkdir(parents=True, exist_ok=True)
        self.lock = _locked(folder)
        if not run.exists():
            with replacing(run) as temporary:
                temporary.write_text(json.dumps({"problem": problem, "rows": rows}), encoding="utf-8")
        try:
            was = json.loads(run.read_text(encoding="utf-8"))
            rows, known = int(was["rows"]), was["problem"]
        except (ValueError, KeyError, TypeError):
            raise ValueError(f"{run} is no record of a run. Give out the name of a new folder.") from None
        if known != problem:
            raise ValueError(
                f"{folder} has the maps of another run: its scene, views or options are not these. Give out another "
                "folder, or remove this one."
            )
        return rows

    def array(self, name: str, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
        """Return an array of zeros, or what is there already; all processes ask for the same arrays in turn."""
        if name not in self.arrays:
            self.arrays[name] = np.zeros(shape, dtype) if self.folder is None else self._mapped(name, shape, dtype)
        return self.arrays[name]

    def _mapped(self, name: str, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
        assert self.folder is not None
        path = self.folder / f"{name}.npy"
        if self.first and not path.exists():
            if name != "done" and self.done.any():
                raise ValueError(
                    f"{path} of an earlier run is missing. Remove the folder {self.folder} and begin anew."
                )
            with replacing(path) as temporary:  # whole, or not there
                np.lib.format.open_memmap(temporary, "w+", dtype, shape).flush()
        self.meet()
        return np.lib.format.open_memmap(path, "r+")

    def read(self, name: str) -> np.ndarray:
        """Return an array, not to be written to."""
        array = self.arrays[name].view()
        array.flags.writeable = False
        return array

    def finish(self, tile: int, name: str = "done") -> None:
        """Mark a tile, after all that was written of it."""
        for array in self.arrays.values():
            if isinstance(array, np.memmap):
                array.flush()
        self.arrays[name][tile] = 1

    def close(self) -> None:
        """Let go of the folder."""
        if self.lock is not None:
            self.lock.close()

    def meet(self) -> None:
        """Wait for the other processes; raise LostProcess where one is gone."""
        if self.device_group is not None:
            self.device_group.total([np.zeros(1)] * len(self.device_group.own))


def _is_strange(folder: Path) -> bool:
    """Whether there is anything that a run may not have left before it wrote its record."""
    return not folder.is_dir() or any(path.name != "lock" and path.name[0] != "." for path in folder.iterdir())


def _locked(folder: Path) -> Any:
    """Return a lock on the folder, which ends with the process; raise ValueError where another run has it."""
    try:
        import fcntl
    except ImportError:  # not on this system
        return None
    file = (folder / "lock").open("w")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        raise ValueError(f"another run is at work in {folder}. Wait for it, or give out another folder.") from None
    return file
