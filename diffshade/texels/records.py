"""Records: what a long run has found so far, in a folder, so that it goes on where it was when it was stopped."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ..files import replacing
from ..inverse.views import View
from ..scenes import Scene

LOOKED_AT = 8  # rows of an image that tell it from another


class Record:
    """The arrays of a run, mapped from files of a folder, or in memory alone; and which of its tiles are done.

    A tile is written before it is marked, so that a run that was killed does it again, whole: nothing is lost but the
    tile at work, and nothing counts twice. `done` is one byte a tile.
    """

    def __init__(self, folder: str | os.PathLike[str] | None, about: Mapping[str, Any], tile: int, tiles: Any):
        """Open the record of a run in a folder, or begin one; `tiles` gives their number for so many rows a tile.

        Raises ValueError where the folder has the record of another run.
        """
        self.folder = None if folder is None else Path(folder)
        self.arrays: dict[str, np.ndarray] = {}
        self.tile = tile
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
            run = self.folder / "run.json"
            if run.exists():
                was = json.loads(run.read_text(encoding="utf-8"))
                for name, value in about.items():
                    if was.get(name) != value:
                        raise ValueError(
                            f"{self.folder} has the maps of another run: its {name} differ. Give another folder for "
                            "out, or delete that one to begin anew."
                        )
                self.tile = was["rows"]
            else:
                with replacing(run) as temporary:
                    temporary.write_text(json.dumps({**about, "rows": tile}, indent=1), encoding="utf-8")
        self.done = self.array("done", (tiles(self.tile),), np.uint8)

    def array(self, name: str, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
        """Return an array of zeros, or what is there already."""
        if name not in self.arrays:
            self.arrays[name] = np.zeros(shape, dtype) if self.folder is None else self._mapped(name, shape, dtype)
        return self.arrays[name]

    def _mapped(self, name: str, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
        assert self.folder is not None
        path = self.folder / f"{name}.npy"
        if not path.exists():
            with replacing(path) as temporary:  # whole, or not there
                np.lib.format.open_memmap(temporary, "w+", dtype, shape).flush()
        return np.lib.format.open_memmap(path, "r+")

    def finish(self, tile: int, name: str = "done") -> None:
        """Mark a tile, after all that was written of it."""
        for array in self.arrays.values():
            if isinstance(array, np.memmap):
                array.flush()
        self.arrays[name][tile] = 1


def fingerprint(scene: Scene, views: Sequence[View], more: Mapping[str, Any]) -> dict[str, str]:
    """Return what tells a run from another: digests of the scene, of how the views were taken, and of their images.

    Of an image its shape, its type and a few of its rows.
    """

    def digest(*parts: Any) -> str:
        found = hashlib.blake2b(digest_size=16)
        for part in parts:
            for leaf in jax.tree.leaves(part):
                array = (
                    np.ascontiguousarray(leaf) if not isinstance(leaf, str) else np.frombuffer(leaf.encode(), np.uint8)
                )
                found.update(f"{array.shape}{array.dtype}".encode())
                found.update(array.tobytes())
        return found.hexdigest()

    images = []
    for view in views:
        height = view.image.shape[0]
        rows = np.unique(np.linspace(0, height - 1, LOOKED_AT).astype(int))
        images += [str(view.image.shape), *(np.asarray(view.image[r : r + 1]) for r in rows)]
    taken = [(v.camera, v.mask, v.exposure, v.black, v.noise, str((v.lit, v.saturation, v.floor))) for v in views]
    return {
        "scene": digest(scene, str(jax.tree.structure(scene))),
        "views": digest(taken, str(jax.tree.structure(taken))),
        "images": digest(images),
        **{name: digest(value) if isinstance(value, np.ndarray) else str(value) for name, value in more.items()},
    }
