"""Regions of a mask: connected ones, which texel of them is nearest, and numbers of theirs as an image."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.ndimage
import scipy.sparse
from jaxtyping import Bool, Int, Shaped


def connected(mask: Bool[np.ndarray, "h w"], *, diagonally: bool = False) -> Int[np.ndarray, "h w"]:
    """Return the connected regions of a mask, from 1; 0 outside. Texels touch by their sides, or by corners too."""
    found: Any = scipy.ndimage.label(mask, np.ones((3, 3), int) if diagonally else None)
    return found[0]


def joined(count: int, one: Int[np.ndarray, "..."], other: Int[np.ndarray, "..."]) -> Int[np.ndarray, " count"]:
    """Return the group of each of so many things, of which these are joined."""
    pairs = scipy.sparse.coo_array((np.ones(one.size, bool), (one.ravel(), other.ravel())), (count, count))
    return scipy.sparse.csgraph.connected_components(pairs, directed=False)[1]


def nearest(mask: Bool[np.ndarray, "h w"]) -> tuple[Int[np.ndarray, "h w"], ...]:
    """Return row and column of the texel of a mask that is nearest to each texel."""
    place: Any = scipy.ndimage.distance_transform_edt(~mask, return_distances=False, return_indices=True)
    return tuple(place)


def image_of(where: Bool[np.ndarray, "..."], values: np.ndarray, outside: float | int = 0) -> np.ndarray:
    """Return an image with these values in a mask, in the order of the image, and with one outside."""
    found = np.full((*where.shape, *values.shape[1:]), outside, values.dtype)
    found[where] = values
    return found


def following(image: Shaped[np.ndarray, "h w"]) -> Shaped[np.ndarray, "2 h w"]:
    """Return the next texels' values, to the right and below; 0 beyond the border."""
    return np.stack([np.pad(image[:, 1:], ((0, 0), (0, 1))), np.pad(image[1:], ((0, 1), (0, 0)))])
