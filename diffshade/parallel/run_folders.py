"""Run folders: a folder on disk that belongs to one computation, recognised by the fingerprint in its marker file."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import jax
import numpy as np

from ..io.files import replacing
from ..io.lazy_images import LazyImage

SAMPLED_ROWS = 8  # rows of a lazy image that enter its fingerprint
LOCK = "lock"


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


@dataclass(frozen=True)
class FolderKind:
    """What kind of results a folder holds: how it is marked, and the words of its error messages."""

    contents: str
    """What the folder holds, for messages: "maps"."""
    argument: str
    """The argument of the public function that names the folder."""
    marker: str
    """Name of the file that holds the fingerprint."""
    read_fingerprint: Callable[[str], str]
    """Return the fingerprint from the marker's text; may raise ValueError, KeyError or TypeError."""
    locked: bool
    """Whether one run at a time may use the folder."""


class RunFolder:
    """A folder that holds the results of one computation, opened for it, and locked if its kind says so."""

    def __init__(self, folder: Path, kind: FolderKind, problem: str, marker_text: str):
        """Open the folder, or make it and write its marker file.

        Args:
            folder: The folder; it need not exist.
            kind: What it holds.
            problem: Fingerprint of the computation.
            marker_text: Text of a new marker file; it contains the fingerprint.

        Raises:
            ValueError: The folder holds other files, belongs to another computation, or is in use by another run.
        """
        self.path, self.kind = folder, kind
        self.lock: TextIO | None = None
        marker = folder / kind.marker
        if folder.exists() and not marker.is_file() and self._has_other_files():
            raise ValueError(
                f"{folder} holds other files, and no {kind.contents} of an earlier run. Give {kind.argument} the name "
                "of a new folder."
            )
        folder.mkdir(parents=True, exist_ok=True)
        if kind.locked:
            self.lock = self._locked()
        try:
            if not marker.exists():
                with replacing(marker) as temporary:
                    temporary.write_text(marker_text, encoding="utf-8")
            self.marker_text = marker.read_text(encoding="utf-8")
            self._check(marker, problem)
        except BaseException:
            self.close()
            raise

    def _has_other_files(self) -> bool:
        """Whether the folder holds anything that a run does not write before its marker file."""
        expected = {LOCK} if self.kind.locked else set()
        return not self.path.is_dir() or any(
            path.name not in expected and not path.name.startswith(".") for path in self.path.iterdir()
        )

    def _check(self, marker: Path, problem: str) -> None:
        """Raise ValueError unless the marker file holds this fingerprint."""
        kind = self.kind
        try:
            known = kind.read_fingerprint(self.marker_text)
        except (ValueError, KeyError, TypeError):
            raise ValueError(
                f"{marker} is damaged: it holds no fingerprint of a run. Give {kind.argument} the name of a new folder."
            ) from None
        if known != problem:
            raise ValueError(
                f"{self.path} holds the {kind.contents} of another run, whose scene, views, options or version of "
                f"diffshade differ. Give {kind.argument} another folder, or remove this one."
            )

    def _locked(self) -> TextIO | None:
        """Return a lock on the folder, which ends with the process; None where the system has no such locks."""
        try:
            import fcntl
        except ImportError:
            return None
        file = (self.path / LOCK).open("w")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            file.close()
            raise ValueError(
                f"another run is at work in {self.path}. Wait for it, or give {self.kind.argument} another folder."
            ) from None
        return file

    def close(self) -> None:
        """Release the lock."""
        if self.lock is not None:
            self.lock.close()
