"""Mask ways: how an object is looked for in its photographs, with OpenCV."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import scipy
from jaxtyping import Bool, Float
from scipy import ndimage

from ...core.thresholds import FAR_MORE, MINOR, MOST, NEGLIGIBLE, SIDE, SLIGHT, SMALL

LEAST = 0.002  # share of the picture that an object has
LIT = 0.75  # quantile over the photographs, which shadows leave alone


def shrunk(pixels: Float[np.ndarray, "h w c"]) -> Float[np.ndarray, "h w c"]:
    """Return a small picture of a photograph."""
    rows, columns, bands = pixels.shape
    by = min(1.0, SIDE / max(rows, columns))
    if by == 1.0:
        return pixels.astype(np.float32)
    size = (max(1, round(by * columns)), max(1, round(by * rows)))
    return cv2.resize(pixels.astype(np.float32), size, interpolation=cv2.INTER_AREA).reshape(*size[::-1], bands)


def resized(mask: np.ndarray, shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    """Return a mask in a picture of another size."""
    way = cv2.INTER_AREA if mask.shape[0] > shape[0] else cv2.INTER_LINEAR
    return cv2.resize(mask.astype(np.float32), shape[1::-1], interpolation=way) > MOST


def ring(shape: tuple[int, ...], wide: int) -> Bool[np.ndarray, "h w"]:
    """Return the outermost pixels of a picture."""
    found = np.ones(shape[:2], bool)
    found[wide:-wide, wide:-wide] = False
    return found


def is_possible(mask: np.ndarray) -> bool:
    """Return whether a mask can be an object's: not nearly nothing or all, nor most of the border."""
    return bool(LEAST < mask.mean() < 1.0 - MINOR and mask[border_of(mask.shape)].mean() < MOST)


def border_of(shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    """Return the outer twentieth of a picture, all around."""
    return ring(shape, max(2, round(MINOR * min(shape[:2]))))


def largest(of: np.ndarray) -> Bool[np.ndarray, "h w"]:
    """Return the largest region of what is true, without threads of it and with its holes filled."""
    inside = ndimage.binary_opening(of, np.ones((3, 3)))
    labels, regions = ndimage.label(inside)  # pyright: ignore[reportGeneralTypeIssues]
    found = labels == 1 + np.bincount(labels.ravel())[1:].argmax() if regions else inside
    return np.asarray(ndimage.binary_fill_holes(found))


def _above(values: np.ndarray) -> Bool[np.ndarray, "h w"]:
    """Return where values are above Otsu's threshold."""
    low, high = np.quantile(values, (NEGLIGIBLE, 1.0 - NEGLIGIBLE))
    level = np.clip((values - low) / max(high - low, NEGLIGIBLE), 0.0, 1.0)
    return cv2.threshold((255.0 * level).astype(np.uint8), 0, 1, cv2.THRESH_OTSU)[1] > 0


def brighter(brightest: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Return what is brighter than the rest under any light."""
    top = float(np.quantile(brightest, 0.99))
    level = 1.0 - np.log(np.clip(brightest / max(top, 1e-30), NEGLIGIBLE, 1.0)) / np.log(NEGLIGIBLE)
    return largest(cv2.threshold((255.0 * level).astype(np.uint8), 0, 1, cv2.THRESH_OTSU)[1])


def _logarithms(pictures: np.ndarray) -> np.ndarray:
    """Return logarithms of brightness, of which noise in the dark is no part."""
    return np.log(pictures + max(MINOR * np.quantile(pictures, 0.99), NEGLIGIBLE * SLIGHT))


def _colour(pictures: Float[np.ndarray, "n h w c"]) -> Bool[np.ndarray, "h w"]:
    """Return what is unlike nine tenths of the border's colours, shadows left out."""
    colours = np.quantile(_logarithms(pictures), LIT, axis=0)
    border = colours[border_of(colours.shape)]
    border = border[:: max(1, len(border) // SIDE)]
    nearest = max(2, round(SMALL * len(border)))
    far = scipy.spatial.KDTree(border).query(colours.reshape(-1, colours.shape[-1]), k=nearest)[0][:, -1]
    return _above(np.log(far.reshape(colours.shape[:2]) + MINOR))


def _shading(pictures: Float[np.ndarray, "n h w c"]) -> Bool[np.ndarray, "h w"]:
    """Return where brightness changes otherwise with the light than on most of the border, where it is lit."""
    logs = _logarithms(pictures.mean(-1))
    border = logs[:, border_of(logs.shape[1:])]
    of = logs - np.median(border - np.quantile(border, LIT, axis=0), 1)[:, None, None]
    lit = of > np.quantile(of, LIT, axis=0) - np.log(FAR_MORE)
    spread = np.where(lit.sum(0) > 2, np.std(of, 0, where=lit), 0.0)
    found = _above(np.log(cv2.GaussianBlur(spread, (0, 0), 1.0) + SLIGHT))
    return ndimage.binary_erosion(found, np.ones((3, 3)), border_value=1)  # what the blur added


def _edges(pictures: Float[np.ndarray, "n h w c"]) -> Bool[np.ndarray, "h w"]:
    """Return what edges enclose that most photographs show."""
    logs = [cv2.GaussianBlur(of, (0, 0), 1.0) for of in _logarithms(pictures.mean(-1))]
    edges = np.median([np.hypot(cv2.Sobel(of, -1, 1, 0), cv2.Sobel(of, -1, 0, 1)) for of in logs], 0)
    gap = 5  # pixels: what blur and Sobel's filter smear, on both sides
    near = np.ones((gap, gap))
    closed = ndimage.binary_closing(np.pad(_above(np.log(edges + SLIGHT)), gap), near)[gap:-gap, gap:-gap]
    inside = ndimage.binary_opening(ndimage.binary_fill_holes(closed), near)
    return ndimage.binary_erosion(inside, near, border_value=1)


WAYS: dict[str, Callable[[Float[np.ndarray, "n h w c"]], np.ndarray]] = {
    "colour": _colour,
    "shading": _shading,
    "edges": _edges,
}
