"""Masks: the pixels of an object, found in its photographs in several ways that must agree."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ...core.extras import check_extra
from ...core.thresholds import CLEARLY, FAR_MORE, MOST, SLIGHT, SMALL
from ...core.words import listing
from ...io.images import without_alpha


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
    from .mask_ways import WAYS, border_of, brighter, is_possible, largest, resized, ring, shrunk

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
        small.append(shrunk(pixels))
    assert brightest is not None
    bright, pictures = brighter(brightest), np.stack(small)
    ways = {"brightness": resized(bright, pictures.shape[1:3])}
    ways |= {name: largest(way(pictures)) for name, way in WAYS.items()}
    possible = {name: way for name, way in ways.items() if is_possible(way)}
    if not possible:
        raise ValueError(
            f"no object was found before a background: the brightest region has {bright.mean():.1%} of the pixels, and "
            "no edges, colours or shading set one apart. Draw a mask that is white on the object, and give it with "
            "--mask."
        )
    like = {a: sorted((overlap(possible[a], possible[b]) for b in possible if b != a), reverse=True) for a in possible}
    best = max(possible, key=lambda name: sum(like[name][:2]))
    agreeing = tuple(name for name, way in possible.items() if overlap(way, possible[best]) > MOST)
    mask = largest(np.mean([possible[name] for name in agreeing], 0) > MOST)
    sure = "brightness" in agreeing and overlap(ways["brightness"], mask) > 1.0 - FAR_MORE * SLIGHT
    agreement = sum(like[best][:2]) / 2
    whole = bright if sure else resized(mask, brightest.shape)
    box = whole[whole.any(1)][:, whole.any(0)]
    straight = float(box[border_of(box.shape)].mean()) if box.size else 0.0
    notes = _suspicions(float(whole[ring(whole.shape, 1)].mean()), straight, ways, agreement)
    return FoundMask(whole, ways, mask, pictures.mean(-1).max(0), agreeing, agreement, notes)


def overlap(one: Bool[np.ndarray, "h w"], other: Bool[np.ndarray, "h w"]) -> float:
    """Return the intersection of two masks over their union."""
    return float(np.sum(one & other) / max(np.sum(one | other), 1))


def _suspicions(touching: float, straight: float, ways: dict[str, np.ndarray], agreement: float) -> tuple[str, ...]:
    """Return what is suspicious of a mask that has these shares of the picture's border and of its own rectangle's."""
    notes = []
    if agreement < 1.0 / CLEARLY:
        shares = listing([f"{name} {way.mean():.0%}" for name, way in ways.items()])
        notes.append(
            f"the ways of finding the object disagree (overlap {agreement:.2f}; {shares} of the picture). Draw a mask "
            "that is white on the object, or photograph it before a black cloth."
        )
    if touching > SMALL:
        notes.append(
            f"the mask has {touching:.0%} of the picture's border, where an object seldom is: it may hold the "
            "background. Look at it, and draw another where it does."
        )
    if straight > MOST:
        notes.append(
            f"the mask has {straight:.0%} of the border of an upright rectangle, as a picture within a frame or a "
            "mount has: if that is not the object, crop the photographs, or draw a mask."
        )
    return tuple(notes)
