"""Devices: those of the caller's mesh, in one process or several, and the sum over all of them.

The caller joins the processes by `jax.distributed.initialize`; each process then works on its own lanes.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

T = TypeVar("T")
LANE = "lane"


class LostProcess(RuntimeError):
    """Another process of the run was lost, so the sum over all processes cannot be computed.

    The folder of the run holds the results so far. JAX's runtime soon ends the remaining processes by force; a program
    that needs an exit status of its own must end at once, by `os._exit`.
    """


class DeviceGroup:
    """The devices of a mesh in its order, each one a lane; this process supplies the data of its own lanes."""

    def __init__(self, mesh: Mesh):
        devices = list(mesh.devices.flat)
        me = jax.process_index()
        self.own = [lane for lane, device in enumerate(devices) if device.process_index == me]
        if not self.own:
            raise ValueError(
                f"mesh must hold a device of every process; it has none of process {me}. Make it of jax.devices()."
            )
        self.count = len(devices)
        self.several = len({device.process_index for device in devices}) > 1
        self.first = self.own[0] == 0
        self.here = Mesh(np.array([devices[lane] for lane in self.own]), (LANE,))
        self.everywhere = Mesh(np.array(devices), (LANE,))

    def total(self, items: Sequence[T]) -> T:
        """Return the sum over all processes of trees of float64 arrays, given one tree a lane, by one `psum`."""
        vectors = [_ravel(item) for item in items]
        devices = self.here.devices.flat
        parts = [jax.device_put(v[None], device) for v, device in zip(vectors, devices, strict=True)]
        sharding = NamedSharding(self.everywhere, P(LANE))
        try:
            spread = jax.make_array_from_single_device_arrays((self.count, len(vectors[0])), sharding, parts)
            everything = np.asarray(_sum(self.everywhere)(spread).addressable_data(0))
        except (RuntimeError, ValueError) as error:
            if not self.several:
                raise
            raise LostProcess(
                "a process of this run was lost, so the sum over all processes cannot be computed. Start the same run "
                "again: it resumes from the files on disk."
            ) from error
        return _unravel(everything, items[0])

    def from_first(self, value: np.ndarray) -> np.ndarray:
        """Return the value of the process that has the first lane; the shapes of all processes agree."""
        mine = [value if lane == 0 else np.zeros_like(value) for lane in self.own]
        return self.total(mine)


def _ravel(tree: Any) -> np.ndarray:
    return np.concatenate([np.ravel(np.asarray(leaf, np.float64)) for leaf in jax.tree.leaves(tree)])


def _unravel(vector: np.ndarray, like: Any) -> Any:
    leaves, structure = jax.tree.flatten(like)
    ends = np.cumsum([np.size(leaf) for leaf in leaves])
    parts = np.split(vector, ends[:-1])
    return jax.tree.unflatten(
        structure, [part.reshape(np.shape(leaf)) for part, leaf in zip(parts, leaves, strict=True)]
    )


@functools.lru_cache
def _sum(mesh: Mesh) -> Callable[[Any], Any]:
    """Return the compiled sum over the lanes of a mesh."""
    add = jax.shard_map(lambda x: jax.lax.psum(x[0], LANE), mesh=mesh, in_specs=P(LANE), out_specs=P(), check_vma=False)
    return jax.jit(add)
