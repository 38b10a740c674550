"""Checkpoints: what a long computation has found so far, in a folder, so that the same call goes on after any end."""

from __future__ import annotations

import hashlib
import io
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ..io.files import replacing
from ..io.lazy_images import LazyImage

SECONDS = 3.0  # between two writings of the sums of a pass under way
ROWS = 8  # of a lazy image, by which it is known again

Arrays = Sequence[np.ndarray]


def fingerprint(*parts: Any) -> str:
    """Return a hash of trees of numbers, lazy images, texts and what has a telling repr.

    Of a lazy image its shape, its type and a few of its rows are looked at.
    """
    digest = hashlib.sha256()
    for part in parts:
        leaves, structure = jax.tree.flatten(part)
        digest.update(str(structure).encode())
        for leaf in leaves:
            for piece in _bytes_of(leaf):
                digest.update(piece)
    return digest.hexdigest()


def _bytes_of(leaf: Any) -> list[bytes]:
    if isinstance(leaf, LazyImage):
        rows = sorted({int(row) for row in np.linspace(0, leaf.shape[0] - 1, ROWS)})
        return [repr(leaf).encode(), *(leaf[row : row + 1].tobytes() for row in rows)]
    if isinstance(leaf, np.ndarray | jax.Array):
        array = np.ascontiguousarray(leaf)
        return [f"{array.dtype}{array.shape}".encode(), array.tobytes()]
    return [repr(leaf).encode()]


class Checkpoint:
    """Findings by name, each a few arrays, in a folder: `name.npz`, written whole or not at all.

    What is found once is not computed again. `problem` is the fingerprint of what is computed: a folder of another
    problem is refused. Without a folder nothing is kept. `parts`: whether sums of a pass under way are.
    """

    def __init__(self, folder: str | Path | None, problem: str, *, parts: bool = True):
        self.folder = None if folder is None else Path(folder)
        self.parts = parts and folder is not None
        self.written = time.monotonic()
        self.found: dict[str, list[np.ndarray]] = {}
        if self.folder is None or not self.folder.exists():
            self._begin(problem)
            return
        told = self.folder / "problem.txt"
        if not told.is_file():
            if not self.folder.is_dir() or any(not path.name.startswith(".") for path in self.folder.iterdir()):
                raise ValueError(f"{folder} is no checkpoint. Give checkpoint the name of a new folder.")
            self._begin(problem)
        elif told.read_text(encoding="ascii").strip() != problem:
            raise ValueError(
                f"the checkpoint {folder} is of another problem: its scene, views or options are not these. Give "
                "checkpoint another folder, or remove this one."
            )
        for path in self.folder.glob("[!.]*.npz"):
            with np.load(path, allow_pickle=False) as file:
                self.found[path.stem] = [file[f"arr_{k}"] for k in range(len(file.files))]

    def _begin(self, problem: str) -> None:
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
            with replacing(self.folder / "problem.txt") as temporary:
                temporary.write_text(problem, encoding="ascii")

    def once(self, name: str, make: Callable[[], Arrays]) -> list[np.ndarray]:
        """Return what was found under a name, or make it and keep it."""
        if name not in self.found:
            self.found[name] = [np.asarray(array) for array in make()]
            self._write(name, self.found[name])
            self.forget_part(name)
        return self.found[name]

    def part(self, name: str) -> tuple[int, list[np.ndarray]] | None:
        """Return how many tiles the last sums of a pass under way hold, and these sums; None without any."""
        kept = self.found.get(_part(name)) if self.parts else None
        return None if kept is None else (int(kept[0]), kept[1:])

    def keep_part(self, name: str, count: int, sums: Any) -> None:
        """Write the sums, a tree, of the first `count` tiles of a pass, if the last writing was seconds ago."""
        if self.parts and time.monotonic() - self.written > SECONDS:
            self._write(_part(name), [np.asarray(count), *map(np.asarray, jax.tree.leaves(sums))])

    def forget_part(self, name: str) -> None:
        """Remove the sums of a pass that is complete."""
        self.found.pop(_part(name), None)
        if self.folder is not None:
            (self.folder / f"{_part(name)}.npz").unlink(missing_ok=True)

    def to_bytes(self) -> bytes:
        """Return all findings, for other processes."""
        file = io.BytesIO()
        named: dict[str, Any] = {f"{n}/{k}": a for n, arrays in self.found.items() for k, a in enumerate(arrays)}
        np.savez(file, **named)
        return file.getvalue()

    def take(self, findings: bytes) -> None:
        """Take the findings of another process."""
        self.found = {}
        with np.load(io.BytesIO(findings), allow_pickle=False) as file:
            for key in file.files:  # in their order
                self.found.setdefault(key.rpartition("/")[0], []).append(file[key])

    def _write(self, name: str, arrays: Arrays) -> None:
        if self.folder is not None:
            with replacing(self.folder / f"{name}.npz") as temporary, temporary.open("wb") as file:
                np.savez(file, *arrays)
        self.written = time.monotonic()


def _part(name: str) -> str:
    return f"{name}.part"
