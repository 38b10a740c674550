"""Devices: those of the caller's mesh, in one process or several, and the sum over all of them.

The caller joins the processes by `jax.distributed.initialize`; each process then works on its own lanes.
"""

from __future__ import annotations

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

LANE = "lane"


class LostProcess(RuntimeError):
    """Another process of the run was lost, so the sum over all processes cannot be computed.

    The folder of the run holds the results so far. JAX's runtime soon ends the remaining processes by force; a program
    that needs an exit status of its own must end at once, by `os._exit`.
    """


class DeviceGroup:
    """The devices of a mesh in its order, each one a lane; this process supplies the data of its own lanes."""

    def __init__(self, mesh: Mesh):
        self.devices = list(mesh.devices.flat)
        me = jax.process_index()
        self.own = [lane for lane, device in enumerate(self.devices) if device.process_index == me]
        if not self.own:
            raise ValueError(f"mesh needs a device of every process; it has none of process {me}. Use jax.devices().")
        self.here = [self.devices[lane] for lane in self.own]
        self.several = len(self.own) < len(self.devices)
        self.first = self.own[0] == 0

    def total(self, mine: np.ndarray) -> np.ndarray:
        """Return the sum over all processes of an array of float64 that each of them gives."""
        lanes = [mine, *[np.zeros_like(mine)] * (len(self.own) - 1)]
        everywhere = Mesh(np.array(self.devices), (LANE,))
        add = jax.jit(_sum_over_lanes, out_shardings=NamedSharding(everywhere, P()))
        parts = [jax.device_put(lane[None], device) for lane, device in zip(lanes, self.here, strict=True)]
        try:
            spread = jax.make_array_from_single_device_arrays(
                (len(self.devices), *mine.shape), NamedSharding(everywhere, P(LANE)), parts
            )
            return np.asarray(add(spread).addressable_data(0))
        except (RuntimeError, ValueError) as error:
            raise LostProcess(
                "a process of this run was lost, so the sum over all processes cannot be computed. Start the same run "
                "again: it resumes from the files on disk."
            ) from error


def _sum_over_lanes(array: jax.Array) -> jax.Array:
    return array.sum(0)
