"""Residuals: photographs beside what a scene would show, one block of pixels at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..cameras import AbstractCamera, Projection
from ..fields import Array
from ..rendering import radiance, reflected
from ..scenes import Scene, StackedScene, light_kinds, stack_scene
from ..surfaces import GBuffer
from .parameters import Slots
from .views import Samples, View, find_samples, is_grey

BLOCK = 2048  # pixels; what a block needs stays in a core's cache


class Block(eqx.Module):
    """Pixels of one view, padded with pixels of weight 0 to a fixed number. A block of blocks has a leading axis."""

    view: Int[Array, "..."]
    row: Float[Array, "... pixels"]
    column: Float[Array, "... pixels"]
    target: Float[Array, "... channels pixels"]
    weight: Float[Array, "... channels pixels"]
    gbuffers: tuple[GBuffer | None, ...]
    """For each object that is a G-buffer, its points at these pixels."""


class Problem(eqx.Module):
    """All that the residuals depend on but the unknowns."""

    scene: StackedScene
    slots: Slots
    blocks: Block
    projections: Projection
    exposures: Float[Array, " views"]
    lit: tuple[tuple[Int[Array, "views _"], Float[Array, "views _"]], ...]
    """For each kind of light: which of its lights are on in each view, and 1 for each, or 0 for padding."""
    grey: Float[Array, " views"]

    def residuals(self, theta: Float[Array, " p"], block: Block) -> tuple[Float[Array, " pixels"], ...]:
        """Return exposure * radiance - image, one array a channel, 0 where a sample does not count.

        A grey view is compared with the mean of the three channels.
        """
        scene = self.slots.insert(theta, self.scene)
        view = block.view
        lights = tuple(
            _switch(jax.tree.map(lambda leaf, index=index: leaf[index[view]], stack), on[view])
            for stack, (index, on) in zip(scene.lights, self.lit, strict=True)
        )
        scene = eqx.tree_at(lambda s: s.lights, scene, lights)
        for i, gbuffer in enumerate(block.gbuffers):
            if gbuffer is not None:
                scene = eqx.tree_at(lambda s, i=i: s.objects[i].surface, scene, gbuffer)
        projection = jax.tree.map(lambda leaf: leaf[view], self.projections)
        rays = projection.rays(block.row, block.column)
        if len(scene.objects) == 1:  # every pixel shows it: where free geometry makes a ray miss, its nearest point
            seen = reflected(scene, scene.objects[0], scene.objects[0].surface.intersect(rays), projection)
        else:
            seen = radiance(scene, rays, projection)
        mean = (seen.x + seen.y + seen.z) / 3.0
        grey = self.grey[view] > 0
        channels = [mean] if len(block.target) == 1 else [jnp.where(grey, mean, c) for c in (seen.x, seen.y, seen.z)]
        return tuple(
            (self.exposures[view] * predicted - target) * weight
            for predicted, target, weight in zip(channels, block.target, block.weight, strict=True)
        )


def _switch(lights: Any, on: Array) -> Any:
    return eqx.tree_at(lambda light: light.intensity, lights, lights.intensity * on[:, None])


class Counts(eqx.Module):
    """How many pixels and samples (channels of pixels) a fit looks at."""

    views: int
    pixels: int
    samples: int
    saturated: int
    """Samples at the top of the sensor's range, left out."""


def prepare(scene: Scene, views: Sequence[View], slots: Slots, *, moving: bool) -> tuple[Problem, Counts]:
    """Lay the views out in blocks, with all that the residuals depend on.

    `moving` says that a surface is free: then each view needs a mask, which is eroded by one pixel and stays fixed.
    Raises ValueError that names the view (and the pixel) where something does not fit.
    """
    channels = 1 if all(is_grey(view) for view in views) else 3
    blocks: list[Block] = []
    saturated = pixels = counting = 0
    for i, view in enumerate(views):
        try:
            samples = find_samples(scene, view, moving=moving)
        except ValueError as error:
            raise ValueError(f"views[{i}]: {error}") from None
        saturated += samples.saturated
        pixels += int(samples.inside.sum())
        counting += int(samples.counts.sum())
        blocks += _blocks(scene, samples, i, channels)
    problem = Problem(
        stack_scene(scene),
        slots,
        jax.tree.map(lambda *leaves: np.stack(leaves), *blocks),
        jax.tree.map(lambda *leaves: np.stack(leaves), *(_projection(view.camera) for view in views)),
        np.array([float(view.exposure) for view in views]),
        _lit(scene, views),
        np.array([1.0 * is_grey(view) for view in views]),
    )
    return problem, Counts(len(views), pixels, counting, saturated)


def _blocks(scene: Scene, samples: Samples, view: int, channels: int) -> list[Block]:
    """Cut the pixels of a view that count into blocks."""
    row, column = np.nonzero(samples.inside)
    count = -(-len(row) // BLOCK)

    def cut(array: Array) -> np.ndarray:
        """Pad the pixel axis, the first, with zeros to whole blocks."""
        padded = np.zeros((count * BLOCK, *array.shape[1:]))
        padded[: len(array)] = array
        return padded.reshape(count, BLOCK, *array.shape[1:])

    def by_channel(array: Array) -> np.ndarray:
        """Give a grey view of a set with colour ones two channels more, of weight 0."""
        wide = np.zeros((len(array), channels))
        wide[:, : array.shape[1]] = array
        return cut(wide).transpose(0, 2, 1)

    weight = by_channel(samples.counts[samples.inside])
    target = by_channel(np.where(samples.counts, samples.values, 0.0)[samples.inside])
    row, column = cut(row), cut(column)
    buffers = [item.surface if isinstance(item.surface, GBuffer) else None for item in scene.objects]
    parts = [_parts(buffer, samples.inside, cut) if buffer is not None else [None] * count for buffer in buffers]
    return [
        Block(np.asarray(view), row[b], column[b], target[b], weight[b], tuple(part[b] for part in parts))
        for b in range(count)
    ]


def _parts(gbuffer: GBuffer, inside: Bool[np.ndarray, "h w"], cut: Callable[[Array], np.ndarray]) -> list[GBuffer]:
    """Cut a G-buffer's points at the pixels into blocks; a padded pixel has a zero normal and is outside the mask."""
    flat = jax.tree.map(lambda leaf: cut(np.asarray(leaf)[inside]).astype(leaf.dtype), gbuffer)
    return [jax.tree.map(lambda leaf, b=b: leaf[b], flat) for b in range(len(flat.mask))]


@jax.jit
def _jitted_projection(camera: AbstractCamera) -> Projection:
    return camera.projection()


def _projection(camera: AbstractCamera) -> Projection:
    return jax.tree.map(np.asarray, _jitted_projection(camera))


def _lit(scene: Scene, views: Sequence[View]) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Return for each kind of light which of its lights are on in each view, padded to the same number."""
    everything = range(len(scene.lights))
    switches = []
    for members in light_kinds(scene.lights):
        on = [[members.index(i) for i in (everything if v.lit is None else v.lit) if i in members] for v in views]
        most = max(map(len, on))
        index = np.array([row + [0] * (most - len(row)) for row in on]).reshape(len(views), most)
        weight = np.array([[1.0] * len(row) + [0.0] * (most - len(row)) for row in on]).reshape(len(views), most)
        switches.append((index.astype(int), weight))
    return tuple(switches)
