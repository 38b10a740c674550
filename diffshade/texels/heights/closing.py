"""Closing: what makes squares of pixels one surface without slits, spikes and fragments.

Squares on the two sides of a jump have corners of their own. Walls along the lines of sight join them, so that a turned
surface is whole. With a back, what lies outside the object counts as a square on the back: the same walls close the
border, and the mesh is watertight.

Where parts lie relative to each other is not known from normals. Each is placed so that the median of the seam to its
neighbours has no jump.

A corner at a rim stands anywhere within its pixel, and where the surface turns away a pixel is deep. Its distance d is
therefore that of the least

    sum cot(theta)^2 (d - d_0)^2 + sum (d - d')^2

over the corners of borders and jumps and the sides between them, theta the angle between normal and line of sight: a
frontal border stays, and a grazing one is as smooth as a rim is.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from ...core.thresholds import SINGLE

# The corners of each pixel's square: top left, top right, bottom left, bottom right; -1 where there is none, as all
# around the image.
Squares = Int[np.ndarray, "h w 4"]


def walls(corner: Squares, *, ends: bool) -> Int[np.ndarray, "faces 3"]:
    """Return the triangles between neighbouring squares that do not share their corners.

    Args:
        corner: The corners of the squares.
        ends: Close the ends of walls, where several meet, by triangles without an area.
    """
    loops = sides(corner)
    if ends:
        around = corner[:-1, :-1, 3], corner[1:, :-1, 1], corner[1:, 1:, 0], corner[:-1, 1:, 2]
        loops = np.concatenate([loops, np.stack(around, -1).reshape(-1, 4)])
    face = loops[(loops >= 0).all(-1)][:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    return face[(face != np.roll(face, 1, axis=1)).all(1)]


def placed(distance: Float[np.ndarray, " n"], corner: Squares, part: Int[np.ndarray, "h w"]) -> Float[np.ndarray, " m"]:
    """Return how much farther each part is placed, so that the median of the seam to those placed before has no jump.

    Args:
        distance: Of the corners, or its logarithm.
        corner: The corners of the squares.
        part: The part of each pixel, the largest first; -1 where there is none.
    """
    loops, pairs = sides(corner), sides(np.repeat(part[..., None], 4, -1))[:, 1:3]
    seam = (pairs >= 0).all(-1) & (pairs[:, 0] != pairs[:, 1])
    loops, pairs = loops[seam], pairs[seam]
    jump = distance[loops[:, [3, 2]]] - distance[loops[:, [0, 1]]]
    moved, known = np.zeros(part.max() + 1), np.zeros(part.max() + 1, bool)
    for first in range(len(moved)):  # of each region of parts that touch, the largest one stays
        known[first] = True
        while len(between := np.flatnonzero(known[pairs].sum(-1) == 1)):
            outward = known[pairs[between, 0]]
            new = np.where(outward, pairs[between, 1], pairs[between, 0])
            nearest = int(np.bincount(new).argmax())  # that of the longest seam
            of, sign = between[new == nearest], np.where(outward, 1.0, -1.0)[new == nearest]
            step = moved[pairs[of, 1]] - moved[pairs[of, 0]]
            moved[nearest], known[nearest] = -np.median(sign[:, None] * (jump[of] + step[:, None])), True
    return moved


def smoothed_rims(
    distance: Float[np.ndarray, " n"],
    corner: Squares,
    owner: Int[np.ndarray, "pixels 4"],
    cosine: Float[np.ndarray, " pixels"],
) -> Float[np.ndarray, " n"]:
    """Return the distances of corners, smooth along the rims of squares that the camera sees at a grazing angle.

    Args:
        distance: Of the corners.
        corner: The corners of the squares.
        owner: The same of the pixels inside alone.
        cosine: Of each one's normal with its line of sight.
    """
    loops = sides(corner)
    apart = loops[(loops[:, :2] != loops[:, :1:-1]).any(-1)]
    edge = np.concatenate([apart[:, :2], apart[:, 2:]])
    rim, at = np.unique(edge[(edge >= 0).all(-1)], return_inverse=True)
    square = np.clip(cosine, SINGLE, 1.0 - SINGLE) ** 2
    hold = np.bincount(owner.ravel(), np.repeat(square / (1.0 - square), 4), len(distance))[rim]
    edges = scipy.sparse.coo_array((np.ones(at.size // 2), at.reshape(-1, 2).T), (len(rim), len(rim)))
    matrix = scipy.sparse.csgraph.laplacian(edges, symmetrized=True) + scipy.sparse.diags_array(hold)
    found = distance.copy()
    found[rim] = scipy.sparse.linalg.spsolve(matrix.tocsc(), hold * distance[rim])
    return found


def corners_of_all(shape: tuple[int, ...]) -> Squares:
    """Return the corners of squares that share all of theirs, by the rows and columns of corners."""
    vertex = np.pad(np.arange(np.prod(shape)).reshape(shape), 1, mode="edge")
    return np.stack([vertex[:-1, :-1], vertex[:-1, 1:], vertex[1:, :-1], vertex[1:, 1:]], -1)


def sides(corner: Squares) -> Int[np.ndarray, "sides 4"]:
    """Return, at each side between neighbours, its two corners in one square and back in the other one."""
    left, right, upper, lower = corner[:, :-1], corner[:, 1:], corner[:-1], corner[1:]
    across = np.stack([left[..., 1], left[..., 3], right[..., 2], right[..., 0]], -1)
    down = np.stack([upper[..., 3], upper[..., 2], lower[..., 0], lower[..., 1]], -1)
    return np.concatenate([across.reshape(-1, 4), down.reshape(-1, 4)])
