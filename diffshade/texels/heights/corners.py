"""Corners between pixels: a surface of one square a pixel, each nearly in the plane that its normal gives.

A pixel's plane passes through its integrated point P, across its normal n. Pixels without a jump between them share
their corners. A corner stands on its line of sight, at the distance d of the least

    sum ((n . (S - d t - P))^2 + HOLD^2 (d - d_P)^2)

over the pixels that share it. The second term, d_P the distance of their points, decides only at the border, where a
plane seen from its edge would leave the surface. From there `facets` moves all corners together, and `closing` smooths
rims, places parts and joins what jumps separate.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...core.thresholds import MINOR, SMALL
from .closing import corners_of_all, placed, sides, smoothed_rims, walls
from .differences import rays_of
from .facets import Facets, refined
from .map import HeightMap
from .regions import image_of, joined

HOLD = SMALL  # weight of a pixel's height beside its plane


class Corners(NamedTuple):
    """Corners of pixels, and the four of each pixel inside."""

    position: Float[np.ndarray, "n 3"]
    errors: Float[np.ndarray, " n"]
    """Means of the standard errors of the pixels that share them, scene units; infinite at the back."""
    of_pixel: Int[np.ndarray, "pixels 4"]
    """Top left, top right, bottom left, bottom right."""
    face: Int[np.ndarray, "faces 3"]
    """The two triangles of each pixel, then those that close the surface."""


def corners_of(heights: HeightMap, *, back: bool = False) -> Corners:
    """Return the corners of the pixels of heights and their triangles; `back` closes the surface to a solid."""
    inside = heights.mask
    owner = _shared(heights)
    count = int(owner.max()) + 1
    rays = rays_of(heights.camera, corners=True)
    shape = tuple(side + 1 for side in inside.shape)
    within, everywhere = np.pad(inside, 1), corners_of_all(shape)
    at = everywhere[within]
    start, toward = rays.start.reshape(-1, 3), rays.toward.reshape(-1, 3)
    n, depth, P = (of[inside][:, None] for of in (heights.normal, heights.depth, heights.position))
    facing = (n * toward[at]).sum(-1)
    ahead = (n * (start[at] - P)).sum(-1)

    def total(of: Float[np.ndarray, "pixels 4"]) -> Float[np.ndarray, " n"]:
        return np.bincount(owner.ravel(), of.ravel(), count)

    begun = total(facing * ahead + HOLD**2 * depth) / total(facing**2 + HOLD**2)
    frontal = start[at] - depth[..., None] * toward[at]
    size = np.linalg.norm(frontal[:, 3] - frontal[:, 0], axis=-1) / np.sqrt(2.0)
    cosine = np.maximum((facing / np.linalg.norm(toward[at], axis=-1)).mean(-1), 0.0)
    d = refined(Facets(owner, facing, ahead, size, cosine), inside, begun)
    line = np.zeros(count, int)
    line[owner] = at
    errors = total(np.broadcast_to(heights.errors[inside][:, None], owner.shape)) / np.bincount(owner.ravel())
    squares = image_of(within, owner, -1)
    d = smoothed_rims(d, squares, owner, cosine)
    moved = placed(d if rays.parallel else np.log(d), squares, np.pad(heights.part, 1, constant_values=-1))
    by = np.zeros(count)
    by[owner] = moved[heights.part[inside]][:, None]
    d = d + by if rays.parallel else d * np.exp(by)
    place = np.stack([line, d.astype(np.float32)], -1)  # parts that were placed meet somewhere exactly
    _, first, same = np.unique(place, axis=0, return_index=True, return_inverse=True)
    owner, line, d, errors = same.ravel()[owner], line[first], d[first], errors[first]
    squares = image_of(within, owner, -1)
    face = owner[:, [[0, 2, 1], [1, 2, 3]]].reshape(-1, 3)
    if back:
        behind = len(d) + everywhere
        squares = np.where(within[..., None], squares, behind)
        face = np.concatenate([face, behind[within][:, [[0, 1, 2], [1, 3, 2]]].reshape(-1, 3)])
        deep = d.max() + MINOR * np.linalg.norm(size)
        line, d = np.append(line, np.arange(len(start))), np.append(d, np.full(len(start), deep))
        errors = np.append(errors, np.full(len(start), np.inf))
    face = np.concatenate([face, walls(squares, ends=back)])
    return Corners(start[line] - d[:, None] * toward[line], errors, owner, face)


def _shared(heights: HeightMap) -> Int[np.ndarray, "pixels 4"]:
    """Return the number of each pixel's corners: neighbours without a jump between them share two."""
    count = int(heights.mask.sum())
    loops = sides(image_of(heights.mask, np.arange(4 * count).reshape(-1, 4), -1))
    jump = np.concatenate([heights.jump_right[:, :-1].ravel(), heights.jump_below[:-1].ravel()])
    same = loops[(loops >= 0).all(-1) & ~jump]
    return joined(4 * count, same[:, :2], same[:, :1:-1]).reshape(count, 4)
