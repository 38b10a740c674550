"""Masks: the pixels of an object that is brighter than what lies behind it, found in its photographs."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from ...core.thresholds import MINOR, NEGLIGIBLE
from ...io.images import without_alpha

LEAST = 0.002  # share of the picture


def find_mask(images: Iterable[Any]) -> Bool[np.ndarray, "h w"]:
    """Find an object that is brighter than its background: the largest such region under any light, holes filled.

    The threshold is Otsu's (1979, "A threshold selection method from gray-level histograms", IEEE SMC 9(1)), of the
    logarithm of the brightest value of each pixel over the photographs.

    Args:
        images: The photographs, (H, W) or (H, W, C), of one size; one at least.

    Returns:
        True on the object.

    Raises:
        ValueError: If no such region is found.
    """
    brightest = functools.reduce(_brighter, (_grey(image) for image in images))  # one at a time
    top = float(np.quantile(brightest, 0.99))
    level = 1.0 - np.log(np.clip(brightest / max(top, 1e-30), NEGLIGIBLE, 1.0)) / np.log(NEGLIGIBLE)
    _, bright = cv2.threshold((255.0 * level).astype(np.uint8), 0, 1, cv2.THRESH_OTSU)
    inside = ndimage.binary_opening(bright, np.ones((3, 3)))
    labels, regions = ndimage.label(inside)  # pyright: ignore[reportGeneralTypeIssues]
    largest = labels == 1 + np.bincount(labels.ravel())[1:].argmax() if regions else inside
    mask = np.asarray(ndimage.binary_fill_holes(largest))
    if not LEAST < mask.mean() < 1.0 - MINOR:
        raise ValueError(
            f"no object was found before a darker background: the brightest region has {mask.mean():.1%} of the "
            "pixels. Draw a mask that is white on the object, and give it with --mask."
        )
    return mask


def _brighter(one: Float[np.ndarray, "h w"], other: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    if one.shape != other.shape:
        raise ValueError(f"photographs must have one size; got {one.shape} and {other.shape}. Crop them alike.")
    return np.maximum(one, other)


def _grey(image: Any) -> Float[np.ndarray, "h w"]:
    pixels = np.nan_to_num(np.asarray(image[:], np.float64), posinf=0.0)
    return pixels if pixels.ndim == 2 else without_alpha(pixels).mean(-1)
