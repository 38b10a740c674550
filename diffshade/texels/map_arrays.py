"""Map arrays: the arrays in which a run stores its maps: the numbers, their errors, the status and the residual."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..core.fields import Array
from ..parallel.run_store import RunStore
from .estimates import Estimates

WIDTHS = {"n_s": 1, "n_s_error": 1, "status": 1, "residual": 1, "normal": 3, "normal_error": 1}


class MapArrays:
    """The maps of a run, (H, W, C) each, and those of their errors."""

    def __init__(self, store: RunStore, names: tuple[str, ...], shape: tuple[int, int], channels: int):
        """Make the arrays, or open those of an earlier run.

        Args:
            store: Where they are stored.
            names: The numbers that are free.
            shape: Rows and columns.
            channels: Channels of a photograph, and of the maps of the coefficients.
        """
        self.store, self.names = store, names
        self.arrays: dict[str, np.ndarray] = {}
        for name in [f"{name}{end}" for name in names for end in ("", "_error")] + ["status", "residual"]:
            dtype = np.uint8 if name == "status" else np.float32
            self.arrays[name] = store.array(name, (*shape, WIDTHS.get(name, channels)), dtype)

    def write(self, pixels: np.ndarray, found: Estimates) -> None:
        """Write the estimates of some texels, given by their indices in the flattened image."""
        numbers = {"status": found.status[None], "residual": found.residual[None], **found.values}
        self.write_numbers(pixels, numbers | {f"{name}_error": error for name, error in found.errors.items()})

    def write_numbers(self, pixels: np.ndarray, numbers: Mapping[str, Array]) -> None:
        """Write numbers of some texels, each (channels, texels), into the arrays of their names."""
        for name, value in numbers.items():
            whole = self.arrays[name]
            with np.errstate(over="ignore"):  # an error too large for float32 becomes infinite
                whole.reshape(-1, whole.shape[2])[pixels] = np.asarray(value).T

    def values(self) -> dict[str, np.ndarray]:
        """Return the maps, read-only."""
        return {name: self.store.read(name) for name in self.names}

    def errors(self) -> dict[str, np.ndarray]:
        """Return the maps of the errors, read-only."""
        return {name: self.store.read(f"{name}_error") for name in self.names}
