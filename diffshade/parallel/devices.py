"""Hosts: the devices of a caller's mesh, of one process or several, and the one sum over all of them.

JAX's own runtime joins the processes (`jax.distributed.initialize`, which the caller calls); here each takes its share.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from .checkpoints import Checkpoint, fingerprint

LANE = "lane"
FORMAT = 2  # of what a checkpoint keeps: one of another is that of another problem


class LostProcess(RuntimeError):
    """A process of a fit on several was lost: the sum over all cannot be made.

    The fit's checkpoint holds what was found. JAX's runtime ends the other processes too, by force, once it misses the
    lost one: a program that wants to end with a status of its own does so at once, by `os._exit`.
    """


class DeviceGroup:
    """The devices of a mesh, a lane each, in the mesh's order; this process feeds its own."""

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

    def put(self, items: Sequence[Any]) -> Any:
        """Return trees of NumPy arrays, one a lane of this process, each on its device, as one of a leading axis."""
        sharding = NamedSharding(self.here, P(LANE))
        return jax.tree.map(lambda *leaves: jax.device_put(np.stack(leaves), sharding), *items)

    def total(self, items: Sequence[Any]) -> Any:
        """Return the sum of trees of NumPy float64 arrays, one a lane of each process, in all: one `psum`."""
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
                "a process of this fit was lost, so that no sum over all can be made. Start the same fit again: it "
                "goes on from what is on disk."
            ) from error
        return _unravel(everything, items[0])

    def from_first(self, value: np.ndarray) -> np.ndarray:
        """Return the value that the process of the first lane has; all have one of the same shape."""
        mine = [value if lane == 0 else np.zeros_like(value) for lane in self.own]
        return self.total(mine)

    def gathered(self, value: np.ndarray) -> np.ndarray:
        """Return the values of all processes, of one shape, on a leading axis of lanes; 0 where a lane has none."""
        slots = np.zeros((self.count, *value.shape))
        slots[self.own[0]] = value
        return self.total([slots, *[np.zeros_like(slots)] * (len(self.own) - 1)])

    def text_from_first(self, text: bytes) -> bytes:
        """Return the bytes that the process of the first lane has."""
        length = int(self.from_first(np.array([float(len(text))]))[0])
        mine = np.frombuffer(text, np.uint8) if self.first else np.zeros(length, np.uint8)
        return self.from_first(mine.astype(np.float64)).astype(np.uint8).tobytes()


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
    """Return the one collective."""
    add = jax.shard_map(lambda x: jax.lax.psum(x[0], LANE), mesh=mesh, in_specs=P(LANE), out_specs=P(), check_vma=False)
    return jax.jit(add)


@functools.lru_cache
def on_devices(program: Callable[..., Any], mesh: Mesh, options: Any = None) -> Callable[..., Any]:
    """Return `program(shared, of_lane)` compiled to run on each device of this process's mesh, on its own `of_lane`."""

    def each(shared: Any, of_lane: Any) -> Any:
        return jax.tree.map(lambda x: x[None], program(shared, jax.tree.map(lambda x: x[0], of_lane)))

    spread = jax.shard_map(each, mesh=mesh, in_specs=(P(), P(LANE)), out_specs=P(LANE), check_vma=False)
    return jax.jit(spread, compiler_options=dict(options) if options else None)


def zeros(shapes: Any) -> Any:
    """Return zeros of the shapes of a tree."""
    return jax.tree.map(lambda shape: np.zeros(shape.shape, np.dtype(jnp.float64)), shapes)


def open_checkpoint(folder: str | Path | None, device_group: DeviceGroup | None, *problem: Any) -> Checkpoint:
    """Open the checkpoint of a problem; of several processes the first one does, and tells the others what is found."""
    known = fingerprint(FORMAT, *problem)
    if device_group is None or not device_group.several:
        return Checkpoint(folder, known)
    mine = Checkpoint(None, known)
    refused: Exception | None = None
    if device_group.first:
        try:
            mine = Checkpoint(folder, known, parts=False)
        except (ValueError, OSError) as error:
            refused = error
    told = device_group.text_from_first(b"" if refused else mine.to_bytes())
    if refused or not told:
        raise refused or ValueError("the first process refused the checkpoint. Read its message.")
    mine.take(told)
    return mine
