"""Map arrays: the arrays in which a run stores its maps: the numbers, their errors, the status and the residual."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..core.fields import Array
from ..model.scenes import Scene
from .checks import check_anything_left
from .maps import TexelMaps
from .tile_runner import TileRunner
from .tiles import TexelTile

WIDTHS = {"n_s": 1, "n_s_error": 1, "status": 1, "residual": 1, "normal": 3, "normal_error": 1}


class MapArrays:
    """The maps of a run, (H, W, C) each, and those of their errors."""

    def __init__(self, tiles: TileRunner, names: tuple[str, ...]):
        """Make the arrays, or open those of an earlier run.

        Args:
            tiles: What reads the tiles and stores the maps.
            names: The numbers that are free.
        """
        self.tiles, self.names, reader = tiles, names, tiles.reader
        self.arrays: dict[str, np.ndarray] = {}
        for name in [f"{name}{end}" for name in names for end in ("", "_error")] + ["status", "residual"]:
            dtype = np.uint8 if name == "status" else np.float32
            self.arrays[name] = tiles.store.array(name, (*reader.shape, WIDTHS.get(name, reader.channels)), dtype)

    def fill(self, fit: Callable[[int, TexelTile], None], margin: int = 0) -> None:
        """Call `fit(index, tile)` for every tile that is not done; raise ValueError if no process fitted a texel."""
        self.tiles.each_tile(fit, "fitted", margin=margin)
        self.tiles.store.wait_for_all()
        check_anything_left(self.arrays["status"])

    def write(self, pixels: np.ndarray, numbers: Mapping[str, Array]) -> None:
        """Write numbers of some texels, each (channels, texels), into the arrays of their names.

        Args:
            pixels: Indices of the texels in the flattened image.
            numbers: By the names of the arrays.
        """
        for name, value in numbers.items():
            whole = self.arrays[name]
            with np.errstate(over="ignore"):  # an error too large for float32 becomes infinite
                whole.reshape(-1, whole.shape[2])[pixels] = np.asarray(value).T

    def maps(self, scene: Scene, notes: tuple[str, ...], **more: Any) -> TexelMaps:
        """Return the maps, read-only."""
        read = self.tiles.store.read
        values, errors = ({name: read(f"{name}{end}") for name in self.names} for end in ("", "_error"))
        status, residual = (read(name)[..., 0] for name in ("status", "residual"))
        return TexelMaps(values, errors, status, residual, scene, self.tiles.reader.camera, notes, **more)
