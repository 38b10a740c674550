"""Regions of a mask: connected ones, and which texel of them is nearest."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.ndimage
from jaxtyping import Bool, Float, Int


def connected(mask: Bool[np.ndarray, "h w"], *, diagonally: bool = False) -> Int[np.ndarray, "h w"]:
    """Return the connected regions of a mask, from 1; 0 outside. Texels touch by their sides, or by corners too."""
    found: Any = scipy.ndimage.label(mask, np.ones((3, 3), int) if diagonally else None)
    return found[0]


def distance(mask: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Return each texel's distance to the nearest one of a mask, in texels."""
    found: Any = scipy.ndimage.distance_transform_edt(~mask)
    return found


def widened(mask: Bool[np.ndarray, "h w"], reach: int) -> Bool[np.ndarray, "h w"]:
    """Return the texels less than `reach` rows and columns from a mask's."""
    found: Any = scipy.ndimage.distance_transform_cdt(~mask, "chessboard")
    return found < reach


def spread(labels: Int[np.ndarray, "h w"]) -> Int[np.ndarray, "h w"]:
    """Return labels everywhere: those of the nearest texel that has one, where it is 0."""
    place: Any = scipy.ndimage.distance_transform_edt(labels == 0, return_distances=False, return_indices=True)
    return labels[tuple(place)]
