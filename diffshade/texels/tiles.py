"""Tiles: bands of rows of the views, read one after another, and the texels in them to be fitted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.backend import at_once, in_float64
from ..core.fields import Array
from ..inverse.data.samples import SensorRange, kept, not_finite, top_of, top_of_view
from ..inverse.data.view_sets import ViewSet
from ..inverse.data.views import View, is_grey
from ..inverse.forward.rendered import projection_of
from ..inverse.pixels.blocks import BLOCK as PIXELS_OF_BLOCK
from ..io.lazy_images import LazyImage
from ..model.cameras import Projection
from ..model.gbuffers import GBuffer
from ..model.scenes import Scene
from ..model.surfaces import AbstractSurface
from ..model.vectors import Vec3
from .prediction import Observations, TexelBlock

SAMPLED_ROWS = 64  # rows from which a sample of texels is taken
MAX_OF_ROW = 4  # times its even share that a row may have of a sample
BLOCK = 2 * PIXELS_OF_BLOCK  # texels in one call of a compiled program at most, but for a GPU
MIN_BLOCK = 64
LEARNING_SAMPLE = 2048  # texels from which is learned what all of an object share
SQUARE = 16  # side of a square of the image over which the directions to near lamps may be taken as one


class TexelTile(eqx.Module):
    """The texels of a band of rows that are to be fitted, and what the views show of them."""

    pixels: Int[np.ndarray, " n"]
    """Their indices in the flattened image."""
    normal: Float[np.ndarray, "n 3"]
    position: Float[np.ndarray, "n 3"] | None
    target: Float[np.ndarray, "views channels n"]
    counts: Bool[np.ndarray, "views n"]

    def part(self, which: Int[np.ndarray, " m"]) -> TexelTile:
        """Return the texels of these indices."""
        position = None if self.position is None else self.position[which]
        seen, counts = self.target[..., which], self.counts[:, which]
        return TexelTile(self.pixels[which], self.normal[which], position, seen, counts)


def joined(tiles: Sequence[TexelTile]) -> TexelTile:
    """Return the texels of all tiles as one."""
    position = None if tiles[0].position is None else np.concatenate([cast(np.ndarray, t.position) for t in tiles])
    return TexelTile(
        np.concatenate([tile.pixels for tile in tiles]),
        np.concatenate([tile.normal for tile in tiles]),
        position,
        np.concatenate([tile.target for tile in tiles], -1),
        np.concatenate([tile.counts for tile in tiles], -1),
    )


def _evenly(tile: TexelTile, most: int) -> TexelTile:
    """Return at most so many texels of a tile, spread evenly."""
    count = len(tile.pixels)
    return tile.part(np.unique(np.linspace(0, max(count - 1, 0), min(most, count)).astype(int))[:count])


class TexelPart(NamedTuple):
    """Some texels of a tile that make one block."""

    tile: TexelTile
    part: Int[np.ndarray, " m"]
    """Their indices in the tile."""
    size: int
    """Texels of the block, padding included."""
    log_n_s: Float[np.ndarray, "2 n"]
    """log n_s of all texels of the tile where it is not fitted, and its standard error."""
    region: int = 0

    @property
    def padded(self) -> Int[np.ndarray, " size"]:
        """The indices with those of the padding, which repeats the first texel."""
        return np.concatenate([self.part, np.full(self.size - len(self.part), self.part[0])])


class ViewReader:
    """The views of one camera, read band by band."""

    def __init__(self, scene: Scene, views: Sequence[View]):
        self.scene, self.views = scene, views
        self.camera = views[0].camera
        self.shape = self.camera.shape
        self.surface = scene.objects[0].surface
        with in_float64():
            self.projection = projection_of(self.camera)
        near = self.camera.local_viewer or any(light.is_local for light in scene.lights)
        self.with_position = near
        self.channels = 1 if is_grey(views[0]) else 3
        self.repeated = ViewSet.of(scene, views).repeats
        self.tops = [top_of_view(view) for view in views]

    def rows_of(self, memory: float | int) -> int:
        """Return how many rows a band may have for its photographs, as read and laid out, to fit in `memory` bytes."""
        images = (v.image for v in self.views)
        row = sum(2 * image.shape[1] * image.shape[2] * np.dtype(image.dtype).itemsize for image in images)
        geometry = 2 * 8 * 9 * self.shape[1]
        return int(np.clip(memory // (row + geometry), 1, self.shape[0]))

    def read(self, first: int, last: int, height: int) -> TexelTile:
        """Read the rows from `first` up to, not including, `last`.

        Args:
            first: First row.
            last: End of the rows.
            height: Rows of a whole band, so that one compiled program serves all bands.

        Raises:
            ValueError: A photograph is not finite at an observation that counts.
        """
        width = self.shape[1]
        inside, normal, position = self._geometry(first, last, height)
        seen = []
        for i, view in enumerate(self.views):
            image = np.asarray(view.image[first:last])
            counts = inside & kept(view, image, first).reshape(-1)
            if i in self.repeated:  # the same numbers again are no further observation
                counts[:] = False
            seen.append((i, view, image.reshape(-1, image.shape[2])[:, : self.channels], counts))
        pixels = np.flatnonzero(np.logical_or.reduce([counts for *_, counts in seen]))
        which = slice(None) if len(pixels) == len(inside) else pixels  # a slice makes no copy
        # one type for all views, in native byte order, which compiled programs require
        dtype = np.result_type(*(image.dtype for _, _, image, _ in seen)).newbyteorder("=")
        target = np.empty((len(seen), self.channels, len(pixels)), dtype)
        usable = np.empty((len(seen), len(pixels)), bool)
        for i, view, image, counts in seen:
            given, values = image[which].T, target[i]
            values[:] = given
            finite = np.isfinite(values).all(0)
            shown = counts[which]
            top = self.tops[i]
            if isinstance(view.image, LazyImage):  # which is not read as a whole
                top = top_of(given[:, shown & finite])
            usable[i] = shown & (SensorRange.of(view, top).clipped(given) == 0).all(0)
            if (bad := usable[i] & ~finite).any():
                where = pixels[bad] + first * width
                raise ValueError(f"views[{i}]: {not_finite(values[:, bad].T, where, width)}")
            values[:, ~(finite & shown)] = 0.0
        position = None if position is None else position[which]
        return TexelTile(pixels + first * width, normal[which], position, target, usable)

    def sample(self, most: int) -> TexelTile:
        """Return about `most` texels of rows spread evenly over the image, whatever the bands are."""
        height = self.shape[0]
        rows = np.unique(np.linspace(0, height - 1, min(height, SAMPLED_ROWS)).astype(int))
        counts, tiles = [], []
        for row in rows:
            tile = self.read(int(row), int(row) + 1, 1)
            counts.append(len(tile.pixels))
            tiles.append(_evenly(tile, MAX_OF_ROW * most // len(rows)))  # the rest need not stay in memory
        share = most / max(sum(counts), 1)
        # as many of a row as its share of the object
        return joined([_evenly(tile, int(np.ceil(share * n))) for tile, n in zip(tiles, counts, strict=True)])

    def _geometry(self, first: int, last: int, height: int) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return where the camera sees the object in a band, the normals there, and the points if they are needed."""
        count = (last - first) * self.shape[1]
        if isinstance(self.surface, GBuffer):
            inside = np.asarray(self.surface.mask[first:last]).reshape(-1)
            normal = np.asarray(self.surface.normal[first:last]).reshape(-1, 3)
            place = self.surface.position
            position = (
                np.asarray(place[first:last]).reshape(-1, 3) if self.with_position and place is not None else None
            )
            return inside, normal, position
        row = np.arange(first, first + height, dtype=np.float64)
        with in_float64():
            seen = _points(self.surface, self.projection, row, np.arange(self.shape[1], dtype=np.float64))
        inside, normal, position = (np.asarray(a).reshape(height * self.shape[1], *a.shape[2:])[:count] for a in seen)
        return inside, normal, position if self.with_position else None

    def pieces(
        self, tile: TexelTile, log_n_s: Float[np.ndarray, "2 n"], which: Int[np.ndarray, " m"] | None = None
    ) -> list[TexelPart]:
        """Cut a tile into pieces of at most one block each.

        Args:
            tile: The tile.
            log_n_s: log n_s of its texels where it is not fitted, and its standard error.
            which: Indices of the texels; by default all.
        """
        index = np.arange(len(tile.pixels)) if which is None else which
        size = min(at_once(BLOCK), max(MIN_BLOCK, 1 << int(np.ceil(np.log2(max(len(tile.pixels), 1))))))
        starts = range(0, len(index), size)
        return [TexelPart(tile, index[start : start + size], size, log_n_s) for start in starts]

    def lay_out(self, piece: TexelPart) -> TexelBlock:
        """Return the block of a piece, padded with texels that no view counts."""
        tile, part, size = piece.tile, piece.part, piece.size
        whole = len(part) == size and part[-1] - part[0] == size - 1  # a slice then serves, and makes no copy
        padded = slice(part[0], part[-1] + 1) if whole else piece.padded
        counts = tile.counts[:, padded]
        if not whole:
            counts[:, len(part) :] = False
        n = Vec3(*tile.normal[padded].T)
        p = None if tile.position is None else Vec3(*tile.position[padded].T)
        v = self.projection.viewer(None)
        if self.camera.local_viewer and p is not None:
            v = _viewer(self.projection, p)
        return TexelBlock(n, p, v, Observations(tile.target[..., padded], counts), *piece.log_n_s[:, padded])


@jax.jit
def _viewer(projection: Projection, p: Vec3) -> Vec3:
    """Return the directions from points to the camera."""
    return projection.viewer(p)


@jax.jit
def _points(surface: AbstractSurface, projection: Projection, row: Array, column: Array) -> tuple[Array, Array, Array]:
    """Return the mask, normals and points of the pixels of some rows."""
    hit = surface.intersect(projection.rays(*jnp.meshgrid(row, column, indexing="ij")))
    assert hit.p is not None
    return hit.inside, hit.n.stack(), hit.p.stack()
