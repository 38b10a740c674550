"""Checkpoints: the intermediate results of a long computation, in a folder, from which the same call resumes."""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ..io.files import replacing
from .run_folders import FolderKind, RunFolder

SECONDS = 3.0  # between two writings of the partial sums of a pass
CHECKPOINT = FolderKind("checkpoint", "checkpoint", "problem.txt", str.strip, locked=False)

Arrays = Sequence[np.ndarray]


class Checkpoint:
    """Results by name, a few arrays each, in a folder: `NAME.npz`, written whole or not at all.

    A result that is in the folder is not computed again.
    """

    def __init__(self, folder: str | Path | None, problem: str, *, parts: bool = True):
        """Open a folder and read its results, or begin one.

        Args:
            folder: Where results are kept; None keeps them in memory.
            problem: Fingerprint of the computation.
            parts: Whether the partial sums of a pass are kept too.

        Raises:
            ValueError: The folder holds other files or belongs to another computation.
        """
        self.folder = None if folder is None else Path(folder)
        self.parts = parts and folder is not None
        self.written = time.monotonic()
        self.found: dict[str, list[np.ndarray]] = {}
        if self.folder is None:
            return
        RunFolder(self.folder, CHECKPOINT, problem, problem)
        for path in self.folder.glob("[!.]*.npz"):
            with np.load(path, allow_pickle=False) as file:
                self.found[path.stem] = [file[f"arr_{k}"] for k in range(len(file.files))]

    def once(self, name: str, make: Callable[[], Arrays]) -> list[np.ndarray]:
        """Return the result of a name, or compute it by `make` and keep it."""
        if name not in self.found:
            self.found[name] = [np.asarray(array) for array in make()]
            self._write(name, self.found[name])
            self.forget_part(name)
        return self.found[name]

    def part(self, name: str) -> tuple[int, list[np.ndarray]] | None:
        """Return the number of tiles in the partial sums of a pass, and these sums; None if there are none."""
        kept = self.found.get(_part(name)) if self.parts else None
        return None if kept is None else (int(kept[0]), kept[1:])

    def keep_part(self, name: str, count: int, sums: Any) -> None:
        """Write the sums, a tree, over the first `count` tiles of a pass, unless the last write was moments ago."""
        if self.parts and time.monotonic() - self.written > SECONDS:
            self._write(_part(name), [np.asarray(count), *map(np.asarray, jax.tree.leaves(sums))])

    def forget_part(self, name: str) -> None:
        """Remove the partial sums of a pass that is complete."""
        self.found.pop(_part(name), None)
        if self.folder is not None:
            (self.folder / f"{_part(name)}.npz").unlink(missing_ok=True)

    def to_bytes(self) -> bytes:
        """Return all results as bytes, for other processes."""
        file = io.BytesIO()
        named: dict[str, Any] = {f"{n}/{k}": a for n, arrays in self.found.items() for k, a in enumerate(arrays)}
        np.savez(file, **named)
        return file.getvalue()

    def replace_from(self, results: bytes) -> None:
        """Replace all results by those of another process."""
        self.found = {}
        with np.load(io.BytesIO(results), allow_pickle=False) as file:
            for key in file.files:  # in the order of writing
                self.found.setdefault(key.rpartition("/")[0], []).append(file[key])

    def _write(self, name: str, arrays: Arrays) -> None:
        if self.folder is not None:
            with replacing(self.folder / f"{name}.npz") as temporary, temporary.open("wb") as file:
                np.savez(file, *arrays)
        self.written = time.monotonic()


def _part(name: str) -> str:
    return f"{name}.part"
