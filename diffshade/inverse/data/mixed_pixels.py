"""Mixed pixels: those along edges, in which a photograph mixes what is on both sides.

A camera and most renderers average over a pixel and its surroundings, where the model shades the pixel's centre.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from ...core.masks import Mask
from ...core.robust_scale import OUTLIER
from ...core.thresholds import MOST, NEGLIGIBLE
from ...model.cameras import AbstractCamera
from ...model.rendering import silhouette, surface_seen
from ...model.scenes import Object

FAR = 4  # pixels: the least distance from the outline at which a pixel shows the background alone


class Edges:
    """The pixels that show objects, and how far they are from edges."""

    def __init__(self, inside: Mask):
        """Take the outline alone for an edge."""
        self.inside = inside

    @cached_property
    def depth(self) -> Int[np.ndarray, "h w"]:
        """How many pixels each is from what lies beyond the nearest edge."""
        return distance(self.inside)

    @cached_property
    def rings(self) -> list[Int[np.ndarray, " n"]]:
        """Pixels inside and outside, both `FAR` from the outline, then those beyond it at each distance up to there."""
        away, depth = distance(~self.inside), distance(self.inside)
        within = np.clip(depth.max() - 1, 0, FAR)
        places = [(depth, within, 2 * FAR), (away, FAR, 2 * FAR), *((away, k, k + 1) for k in range(FAR))]
        return [np.flatnonzero((of > first) & (of <= last)) for of, first, last in places]

    def reach(self, image: Float[np.ndarray, "h w c"]) -> int:
        """Return how many pixels from edges a photograph mixes what is on both sides; 0 where nothing shows it.

        They are as many as those outside of the outline that clearly differ from the background, `FAR` at most. Where
        the first of them are more like the object, this is no outline, but a mask within it.
        """
        inside, background, *rings = (image.reshape(-1, image.shape[2])[ring].mean(-1) for ring in self.rings)
        if not inside.size or not background.size or not all(ring.size for ring in rings):
            return 0
        level, contrast = background.mean(), abs(inside.mean() - background.mean())
        off = np.array([abs(ring.mean() - level) for ring in rings])
        by_chance = background.std() * np.sqrt([1.0 / ring.size + 1.0 / background.size for ring in rings])
        mixed = off > np.maximum(NEGLIGIBLE * contrast, OUTLIER * by_chance)
        return 0 if off[0] > MOST * contrast else int(np.argmin([*mixed, False]))

    def unmixed(self, inside: Mask, reach: int) -> Mask:
        """Return those of some pixels that show one side of every edge alone; all where that leaves none."""
        left = inside & (self.depth > reach) if reach else inside
        return left if left.any() else inside


class SeenEdges(Edges):
    """Those of objects as a camera sees them: outlines, creases, and borders between objects."""

    def __init__(self, objects: tuple[Object, ...], camera: AbstractCamera):
        """Find the silhouette."""
        super().__init__(np.asarray(silhouette(objects, camera)))
        self.objects, self.camera = objects, camera

    @cached_property
    def depth(self) -> Int[np.ndarray, "h w"]:
        """How many pixels each is from what lies beyond the nearest edge: the background, another object, another face.

        Faces differ where normals half a unit apart, by 29 degrees, are within three pixels.
        """
        surface = surface_seen(self.objects, self.camera)
        change = ndimage.maximum_filter(surface, (3, 3, 1)) - ndimage.minimum_filter(surface, (3, 3, 1))
        edge = (change[..., 3] > 0.0) | (np.square(change[..., :3]).sum(-1) > MOST**2)
        return distance(~edge) + 1


def distance(inside: Mask) -> Int[np.ndarray, "h w"]:
    """Return how many steps to a neighbour, along a diagonal too, each pixel is from the nearest outside; 0 there."""
    return np.asarray(ndimage.distance_transform_cdt(inside, "chessboard"))
