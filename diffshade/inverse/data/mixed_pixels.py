"""Mixed pixels: those along edges, in which a photograph mixes what is on both sides.

A camera and most renderers average over a pixel and its surroundings, where the model shades the pixel's centre.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from ...core.masks import Mask
from ...core.robust_scale import OUTLIER
from ...core.thresholds import CLEARLY, MOST, NEGLIGIBLE
from ...model.cameras import AbstractCamera
from ...model.rendering import silhouette, surface_seen
from ...model.scenes import Object

FAR = 4  # pixels: the least distance from the outline at which a pixel shows the background alone


class Rings(NamedTuple):
    """Pixels near an outline, in the flattened image."""

    inside: Int[np.ndarray, " n"]
    """Of the object, `FAR` from the outline."""
    background: Int[np.ndarray, " m"]
    """As far outside."""
    beside: list[Int[np.ndarray, " k"]]
    """Outside, at each distance up to there."""


class Edges:
    """The pixels that show objects, and how far they are from edges."""

    def __init__(self, inside: Mask):
        """Take the outline alone for an edge."""
        self.inside = inside

    @cached_property
    def depths(self) -> list[Int[np.ndarray, "h w"]]:
        """How many pixels each is from what lies beyond the nearest edge; then the same of fewer edges."""
        return [distance(self.inside)]

    @cached_property
    def rings(self) -> Rings:
        """The pixels near the outline."""
        outwards, inwards = distance(~self.inside), distance(self.inside)

        def between(steps: Int[np.ndarray, "h w"], first: int, last: int) -> Int[np.ndarray, " n"]:
            return np.flatnonzero((steps > first) & (steps <= last))

        within = int(np.clip(inwards.max() - 1, 0, FAR))  # less where the object is small
        beside = [between(outwards, k, k + 1) for k in range(FAR)]
        return Rings(between(inwards, within, 2 * FAR), between(outwards, FAR, 2 * FAR), beside)

    def reach(self, image: Float[np.ndarray, "h w c"]) -> int:
        """Return how many pixels from edges a photograph seems to mix what is on both sides; 0 where nothing shows it.

        They are as many as those outside of the outline that are clearly more like the object than the background
        farther out is, `FAR` at most. Mixing is less than half at an outline and falls off steeply; shadows
        and lit backgrounds change slowly.
        """
        inside, background, *beside = (
            image.reshape(-1, image.shape[2])[of].mean(-1)
            for of in (self.rings.inside, self.rings.background, *self.rings.beside)
        )
        if not all(of.size and np.isfinite(of).all() for of in (inside, background, *beside)):
            return 0
        if not (contrast := float(inside.mean() - background.mean())):
            return 0
        share = np.array([of.mean() - background.mean() for of in beside]) / contrast
        by_chance = np.sqrt([of.var() / of.size + background.var() / background.size for of in beside]) / abs(contrast)
        seen = share > np.maximum(NEGLIGIBLE, OUTLIER * by_chance)
        falls = share > CLEARLY * np.append(share[1:], 0.0)
        return int(np.argmin([*(seen & falls), False])) if share[0] < MOST else 0

    def unmixed(self, inside: Mask, reach: int) -> Mask:
        """Return those of some pixels that show one side of every edge alone.

        Where that leaves less than half of them, as of fine relief, creases are kept; where that does too, all pixels.
        """
        left = [inside & (depth > reach) for depth in self.depths] if reach else []
        return next((of for of in left if of.sum() >= MOST * inside.sum()), inside)


class SeenEdges(Edges):
    """Those of objects as a camera sees them: outlines, creases, and borders between objects."""

    def __init__(self, objects: tuple[Object, ...], camera: AbstractCamera):
        """Find the silhouette."""
        super().__init__(np.asarray(silhouette(objects, camera)))
        self.objects, self.camera = objects, camera

    @cached_property
    def depths(self) -> list[Int[np.ndarray, "h w"]]:
        """How many pixels each is from what lies beyond the nearest edge; then the same without creases.

        At a crease normals half a unit apart, by 29 degrees, are within three pixels.
        """
        surface = surface_seen(self.objects, self.camera)
        change = ndimage.maximum_filter(surface, (3, 3, 1)) - ndimage.minimum_filter(surface, (3, 3, 1))
        border, crease = change[..., 3] > 0.0, np.square(change[..., :3]).sum(-1) > MOST**2
        return [distance(~edge) + 1 for edge in (border | crease, border)]


def distance(inside: Mask) -> Int[np.ndarray, "h w"]:
    """Return how many steps to a neighbour, along a diagonal too, each pixel is from the nearest outside; 0 there."""
    return np.asarray(ndimage.distance_transform_cdt(inside, "chessboard"))
