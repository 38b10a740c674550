"""Masks: the pixels of an object, found in its photographs in several ways that must agree."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage, spatial

from ...core.extras import check_extra
from ...core.thresholds import CLEARLY, FAR_MORE, MINOR, MOST, NEGLIGIBLE, SLIGHT, SMALL
from ...core.words import listing
from ...io.images import without_alpha

LEAST = 0.002  # share of the picture
SIDE = 400  # pixels at most of the small pictures in which objects are looked for
LIT = 0.75  # quantile over the photographs, which shadows leave alone


@dataclass(frozen=True, eq=False)
class FoundMask:
    """The mask of an object, and the masks that each way of looking for it found."""

    mask: Bool[np.ndarray, "h w"]
    """True on the object."""
    ways: dict[str, Bool[np.ndarray, "h w"]]
    """What each way found, in a small picture; what cannot be an object included."""
    small: Bool[np.ndarray, "h w"]
    """The mask in that picture."""
    picture: Float[np.ndarray, "h w"]
    """The brightest value of each of its pixels."""
    agreeing: tuple[str, ...]
    """The ways whose masks the mask is made of."""
    agreement: float
    """Intersection over union of the best way with the two that are most like it; 0 where there are none."""
    notes: tuple[str, ...]
    """What is suspicious."""

    def __str__(self) -> str:
        """Return the share of the picture, and the ways that agree."""
        how = f"by {listing(self.agreeing)} (overlap {self.agreement:.2f})"
        return f"the object has {self.mask.mean():.0%} of the picture, {how}"


def find_mask(images: Iterable[Any]) -> FoundMask:
    """Find an object in photographs of it under one light each.

    It is the largest region that is *brighter* than the rest; of another *colour* or brightness than the pictures'
    border; whose brightness changes otherwise with the light (*shading*) than that of most of the border, shadows left
    out; and that *edges* enclose which are in most photographs, as those of shadows are not. Each has Otsu's threshold
    (1979, "A threshold selection method from gray-level histograms", IEEE SMC 9(1)), and what has most of the border is
    no object. The way that is most like two others is taken, with those that overlap with it: what most of them say.

    Args:
        images: The photographs, (H, W) or (H, W, C), of one size; one at least.

    Returns:
        The mask, and how well the ways agree. Its outline is that of the whole picture where brightness shows it, else
        of one of 400 pixels.

    Raises:
        ValueError: If no such region is found.
        ImportError: OpenCV is not installed.
    """
    check_extra("photographs", "cannot find an object in photographs", "cv2")
    brightest, small = None, []
    for image in images:  # one at a time
        pixels = np.nan_to_num(np.asarray(image[:], np.float64), posinf=0.0)
        pixels = pixels[..., None] if pixels.ndim == 2 else without_alpha(pixels)
        grey = pixels.mean(-1)
        if brightest is not None and brightest.shape != grey.shape:
            raise ValueError(
                f"photographs must have one size; got {brightest.shape} and {grey.shape}. Crop them alike."
            )
        brightest = grey if brightest is None else np.maximum(brightest, grey)
        small.append(_shrunk(pixels))
    assert brightest is not None
    bright, pictures = _brighter(brightest), np.stack(small)
    ways = {"brightness": _resized(bright, pictures.shape[1:3])}
    ways |= {name: _object(way(pictures)) for name, way in WAYS.items()}
    possible = {name: way for name, way in ways.items() if _possible(way)}
    if not possible:
        raise ValueError(
            f"no object was found before a background: the brightest region has {bright.mean():.1%} of the pixels, and "
            "no edges, colours or shading set one apart. Draw a mask that is white on the object, and give it with "
            "--mask."
        )
    like = {a: sorted((overlap(possible[a], possible[b]) for b in possible if b != a), reverse=True) for a in possible}
    best = max(possible, key=lambda name: sum(like[name][:2]))
    agreeing = tuple(name for name, way in possible.items() if overlap(way, possible[best]) > MOST)
    mask = _object(np.mean([possible[name] for name in agreeing], 0) > MOST)
    sure = "brightness" in agreeing and overlap(ways["brightness"], mask) > 1.0 - FAR_MORE * SLIGHT
    agreement = sum(like[best][:2]) / 2
    whole = bright if sure else _resized(mask, brightest.shape)
    notes = _suspicions(whole, ways, agreement)
    return FoundMask(whole, ways, mask, pictures.mean(-1).max(0), agreeing, agreement, notes)


def overlap(one: Bool[np.ndarray, "h w"], other: Bool[np.ndarray, "h w"]) -> float:
    """Return the intersection of two masks over their union."""
    return float(np.sum(one & other) / max(np.sum(one | other), 1))


def _suspicions(mask: np.ndarray, ways: dict[str, np.ndarray], agreement: float) -> tuple[str, ...]:
    notes = []
    if agreement < 1.0 / CLEARLY:
        shares = listing([f"{name} {way.mean():.0%}" for name, way in ways.items()])
        notes.append(
            f"the ways of finding the object disagree (overlap {agreement:.2f}; {shares} of the picture). Draw a mask "
            "that is white on the object, or photograph it before a black cloth."
        )
    edge = _ring(mask.shape, 1)
    if (touching := mask[edge].mean()) > SMALL:
        notes.append(
            f"the mask has {touching:.0%} of the picture's border, where an object seldom is: it may hold the "
            "background. Look at it, and draw another where it does."
        )
    return tuple(notes)


def _possible(mask: np.ndarray) -> bool:
    return bool(LEAST < mask.mean() < 1.0 - MINOR and mask[_border(mask.shape)].mean() < MOST)


def _shrunk(pixels: Float[np.ndarray, "h w c"]) -> Float[np.ndarray, "h w c"]:
    import cv2

    rows, columns, bands = pixels.shape
    by = min(1.0, SIDE / max(rows, columns))
    if by == 1.0:
        return pixels.astype(np.float32)
    size = (max(1, round(by * columns)), max(1, round(by * rows)))
    return cv2.resize(pixels.astype(np.float32), size, interpolation=cv2.INTER_AREA).reshape(*size[::-1], bands)


def _resized(mask: np.ndarray, shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    import cv2

    way = cv2.INTER_AREA if mask.shape[0] > shape[0] else cv2.INTER_LINEAR
    return cv2.resize(mask.astype(np.float32), shape[1::-1], interpolation=way) > MOST


def _ring(shape: tuple[int, ...], wide: int) -> Bool[np.ndarray, "h w"]:
    ring = np.ones(shape[:2], bool)
    ring[wide:-wide, wide:-wide] = False
    return ring


def _border(shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    return _ring(shape, max(2, round(MINOR * min(shape[:2]))))


def _object(of: np.ndarray) -> Bool[np.ndarray, "h w"]:
    """Return the largest region of what is true, without threads of it and with its holes filled."""
    inside = ndimage.binary_opening(of, np.ones((3, 3)))
    labels, regions = ndimage.label(inside)  # pyright: ignore[reportGeneralTypeIssues]
    largest = labels == 1 + np.bincount(labels.ravel())[1:].argmax() if regions else inside
    return np.asarray(ndimage.binary_fill_holes(largest))


def _above(values: np.ndarray) -> Bool[np.ndarray, "h w"]:
    """Return where values are above Otsu's threshold."""
    import cv2

    low, high = np.quantile(values, (NEGLIGIBLE, 1.0 - NEGLIGIBLE))
    level = np.clip((values - low) / max(high - low, NEGLIGIBLE), 0.0, 1.0)
    return cv2.threshold((255.0 * level).astype(np.uint8), 0, 1, cv2.THRESH_OTSU)[1] > 0


def _brighter(brightest: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Return what is brighter than the rest under any light."""
    import cv2

    top = float(np.quantile(brightest, 0.99))
    level = 1.0 - np.log(np.clip(brightest / max(top, 1e-30), NEGLIGIBLE, 1.0)) / np.log(NEGLIGIBLE)
    return _object(cv2.threshold((255.0 * level).astype(np.uint8), 0, 1, cv2.THRESH_OTSU)[1])


def _logarithms(pictures: np.ndarray) -> np.ndarray:
    """Return logarithms of brightness, of which noise in the dark is no part."""
    return np.log(pictures + max(MINOR * np.quantile(pictures, 0.99), NEGLIGIBLE * SLIGHT))


def _colour(pictures: Float[np.ndarray, "n h w c"]) -> Bool[np.ndarray, "h w"]:
    """Return what is unlike nine tenths of the border's colours, shadows left out."""
    colours = np.quantile(_logarithms(pictures), LIT, axis=0)
    border = colours[_border(colours.shape)]
    border = border[:: max(1, len(border) // SIDE)]
    nearest = max(2, round(SMALL * len(border)))
    far = spatial.KDTree(border).query(colours.reshape(-1, colours.shape[-1]), k=nearest)[0][:, -1]
    return _above(np.log(far.reshape(colours.shape[:2]) + MINOR))


def _shading(pictures: Float[np.ndarray, "n h w c"]) -> Bool[np.ndarray, "h w"]:
    """Return where brightness changes otherwise with the light than on most of the border, where it is lit."""
    import cv2

    logs = _logarithms(pictures.mean(-1))
    border = logs[:, _border(logs.shape[1:])]
    of = logs - np.median(border - np.quantile(border, LIT, axis=0), 1)[:, None, None]
    lit = of > np.quantile(of, LIT, axis=0) - np.log(FAR_MORE)
    spread = np.where(lit.sum(0) > 2, np.std(of, 0, where=lit), 0.0)
    found = _above(np.log(cv2.GaussianBlur(spread, (0, 0), 1.0) + SLIGHT))
    return ndimage.binary_erosion(found, np.ones((3, 3)), border_value=1)  # what the blur added


def _edges(pictures: Float[np.ndarray, "n h w c"]) -> Bool[np.ndarray, "h w"]:
    """Return what edges enclose that most photographs show."""
    import cv2

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
