"""Run folders: a folder on disk that belongs to one computation, recognised by the fingerprint in its marker file."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, TextIO

import jax
import numpy as np

from ..io.files import write_file
from ..io.lazy_images import LazyImage

SAMPLED_ROWS = 8  # rows of a lazy image that enter its fingerprint
MARKER, LOCK = "run.json", "lock"


def fingerprint(*parts: Any) -> str:
    """Return a SHA-256 hash of trees whose leaves are numbers, arrays, lazy images, texts or have a stable repr.

    A lazy image enters with its shape, its type and a few of its rows.
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
        rows = sorted({int(row) for row in np.linspace(0, leaf.shape[0] - 1, SAMPLED_ROWS)})
        return [repr(leaf).encode(), *(leaf[row : row + 1].tobytes() for row in rows)]
    if isinstance(leaf, np.ndarray | jax.Array):
        array = np.ascontiguousarray(leaf)
        return [f"{array.dtype}{array.shape}".encode(), array.tobytes()]
    return [repr(leaf).encode()]


def open_folder(folder: Path, problem: str, rows: int) -> tuple[int, TextIO | None]:
    """Open a folder for a run of `fit_texels`, or make it and write its marker file.

    Args:
        folder: The folder; it need not exist.
        problem: Fingerprint of the run.
        rows: Rows of a tile of a new run.

    Returns:
        The rows of a tile, and a lock on the folder.

    Raises:
        ValueError: The folder holds other files, belongs to another run, or is in use by another run.
    """
    marker = folder / MARKER
    if folder.exists() and not marker.is_file() and _has_other_files(folder):
        raise ValueError(f"{folder} holds other files, and no maps of a run. Give out the name of a new folder.")
    folder.mkdir(parents=True, exist_ok=True)
    lock = _locked(folder)
    try:
        if not marker.exists():
            write_file(marker, json.dumps({"problem": problem, "rows": rows}))
        return _rows_in(marker, problem), lock
    except BaseException:
        release(lock)
        raise


def _has_other_files(folder: Path) -> bool:
    """Whether a path is no folder, or holds anything that a run does not write before its marker file."""
    return not folder.is_dir() or any(path.name != LOCK and path.name[0] != "." for path in folder.iterdir())


def _rows_in(marker: Path, problem: str) -> int:
    """Return the rows of a tile from a marker file; raise ValueError unless it holds this fingerprint."""
    try:
        run = json.loads(marker.read_text(encoding="utf-8"))
        known, rows = run["problem"], int(run["rows"])
    except (ValueError, KeyError, TypeError):
        raise ValueError(
            f"{marker} is damaged: it holds no fingerprint and rows of a run. Give out the name of a new folder."
        ) from None
    if known != problem:
        raise ValueError(
            f"{marker.parent} holds the maps of another run, whose scene, views, options or version of diffshade "
            "differ. Give out another folder, or remove this one."
        )
    return rows


def _locked(folder: Path) -> TextIO | None:
    """Return a lock on a folder, which ends with the process; None where the system has no such locks."""
    try:
        import fcntl
    except ImportError:
        return None
    file = (folder / LOCK).open("w")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        raise ValueError(f"another run is at work in {folder}. Wait for it, or give out another folder.") from None
    return file


def release(lock: TextIO | None) -> None:
    """Release a lock."""
    if lock is not None:
        lock.close()
