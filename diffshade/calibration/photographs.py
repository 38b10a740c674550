"""Photographs of a ball from a folder, files or arrays; and the mask, which is read or found."""

from __future__ import annotations

import functools
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.arrays import float64_of
from ..core.masks import Mask
from ..inverse.data.folders import list_folder
from ..inverse.data.photograph_files import photograph_files
from ..inverse.data.photographs import as_given
from ..inverse.data.samples import top_of
from ..inverse.data.views import as_image, check_floats
from ..io.images import read_image, without_alpha
from ..io.lazy_images import LazyImage, row_tiles
from .balls import MIN_FRACTION, largest, roundness
from .edges import ANGLES, disc, shrunk
from .outlines import JUDGED, Outline, find_outline

_LOGGER = logging.getLogger("diffshade")

LEVELS = (0.02, 0.04, 0.08, 0.15, 0.25, 0.4)  # thresholds between background and ball, over the 99th percentile


@dataclass(frozen=True, eq=False)
class Photographs:
    """Photographs of one size, by one camera: linear radiance, their names, and the masks of the balls."""

    names: tuple[str, ...]
    images: tuple[Any, ...]
    """(H, W, 1) or (H, W, 3) each, without alpha."""
    masks: tuple[Mask, ...]
    found: bool
    """Whether the mask was found in the photographs."""
    outlines: tuple[Outline, ...] = ()
    """The outline of each ball, where it was found by its edge, or given as a circle."""

    @property
    def notes(self) -> list[str]:
        """A note on a mask that was found."""
        how = "by its edge" if self.outlines else "by brightness"
        note = f"the ball's outline was found {how}; look at it, for a mask drawn by hand may be more accurate."
        return [note] if self.found else []

    def grey(self, i: int) -> Float[np.ndarray, "h w"]:
        """Return the mean of the channels of one photograph, in the rows of the balls; 0 elsewhere."""
        rows = _rows_of(np.logical_or.reduce(self.masks))
        found = np.zeros(self.images[i].shape[:2])
        found[rows] = _grey(np.asarray(self.images[i][rows], np.float64))
        return found

    def clipped(self, i: int) -> Mask:
        """Return the pixels of one photograph with a sample at 1, the top of a file's range, or above."""
        image = np.asarray(self.images[i][:])
        return np.asarray((image >= top_of(image)).any(-1))


def gather(photographs: Any, mask: Any, srgb: bool | None, *, mirror: bool = False, circle: Any = None) -> Photographs:
    """Read photographs and masks in any of the forms that `calibrate` takes.

    Args:
        photographs: The photographs.
        mask: The mask, or masks; None finds it.
        srgb: Whether to decode files from the sRGB curve.
        mirror: Whether the ball is a mirror, whose outline is found by its edge.
        circle: Column, row and radius of the ball, or of each ball, instead of a mask.
    """
    given = None if circle is None else _given_circles(circle, mask)
    names, images, mask, extras = _read(photographs, srgb, mask, own=given is None, hold=mirror)
    shapes = [image.shape[:2] for image in images]
    if len(set(shapes)) > 1:
        other = next(i for i, shape in enumerate(shapes) if shape != shapes[0])
        raise ValueError(
            f"photographs must have one size; got {names[0]} of {shapes[0]} and {names[other]} of {shapes[other]}. "
            "Give photographs by one camera that did not move."
        )
    alpha = next((image[:][..., -1] for image in images if image.shape[2] in (2, 4)), None)
    images = [_colours(image) if image.shape[2] in (2, 4) else image for image in images]
    for name, image in zip(names, images, strict=True):
        check_floats(name, image.dtype)
    mask = [as_given(alpha)] if mask is None and given is None and alpha is not None else mask
    outlines = given or ((_outline(images, extras, srgb),) if mask is None and mirror else ())
    if outlines:
        masks = tuple(disc(outline.circle, shapes[0]) for outline in outlines)
    else:
        masks = (_round_piece(images),) if mask is None else tuple(_of_shape(m, shapes[0]) for m in mask)
    mask_of_all = np.logical_or.reduce(masks)
    for name, image in zip(names, images, strict=True):
        _check_finite(name, image, mask_of_all)
    return Photographs(tuple(names), tuple(images), masks, mask is None and given is None, outlines)


def _given_circles(circle: Any, mask: Any) -> tuple[Outline, ...]:
    """Return the outline that each given circle is."""
    if mask is not None:
        raise ValueError("a ball has a mask or a circle; got both. Leave one out.")
    circles = np.atleast_2d(float64_of("circle", circle))
    if circles.ndim != 2 or circles.shape[1] != 3 or not np.isfinite(circles).all() or not (circles[:, 2] > 0.0).all():
        raise ValueError(
            f"circle must be column, row and radius, pixels; got {circle!r}. Give for example (320, 240, 100)."
        )
    angle = np.linspace(0.0, 2.0 * np.pi, ANGLES, endpoint=False)
    return tuple(
        Outline(one, (one[1] + one[2] * np.sin(angle), one[0] + one[2] * np.cos(angle)), np.zeros(3)) for one in circles
    )


def _grey(image: np.ndarray) -> np.ndarray:
    """Return the mean of the channels; a product takes a third of the time of NumPy's mean over so few."""
    return image @ np.full(image.shape[-1], 1.0 / image.shape[-1], image.dtype)


def _colours(image: Any) -> Any:
    return image.colours() if isinstance(image, LazyImage) else without_alpha(image)


def _rows_of(mask: Mask) -> slice:
    """Return the rows that a mask has something in."""
    rows = np.flatnonzero(mask.any(1))
    return slice(int(rows[0]), int(rows[-1]) + 1) if len(rows) else slice(0)


def _check_finite(name: str, image: Any, mask: Mask) -> None:
    rows = _rows_of(mask)
    seen = np.asarray(image[rows])[mask[rows]]
    bad = ~np.isfinite(seen).all(-1)
    if bad.any():
        row, column = np.argwhere(mask)[bad.argmax()]
        raise ValueError(
            f"{name} must be finite; got {seen[bad.argmax()].tolist()} at row {row}, column {column}. Correct the "
            "file, or exclude the pixel with the mask."
        )


def _outline(images: Sequence[Any], extras: Sequence[Path], srgb: bool | None) -> Outline:
    """Return the outline of a mirror ball, by a picture under room light where the folder has one."""
    height, width = images[0].shape[:2]
    total, small = np.zeros((height, width), np.float32), []
    for image in images:
        tiles = (image[first:last] for first, last in row_tiles(height, width))
        grey = np.concatenate([_grey(np.asarray(tile, np.float32)) for tile in tiles])
        total += grey
        small.append(shrunk(grey, JUDGED)[0])
    rooms = []
    for file in extras:
        try:
            rooms.append(without_alpha(read_image(file, srgb=srgb)).mean(-1))
        except (OSError, ValueError):  # no picture of the ball
            continue
    return find_outline(small, total / len(images), [room for room in rooms if room.shape == total.shape])


def _given_masks(mask: Any) -> list[Mask] | None:
    """Read one mask or several; None stays what it is."""
    if mask is None:
        return None
    each = mask if isinstance(mask, tuple | list) else (mask,)
    if not each:
        raise ValueError("mask must hold at least one; got none. Give a mask for each ball, or leave it out.")
    return [as_given(one) for one in each]


def _read(
    photographs: Any, srgb: bool | None, mask: Any, *, own: bool, hold: bool
) -> tuple[list[str], list[Any], list[Mask] | None, tuple[Path, ...]]:
    """Return names and images, the masks, by default the folder's `own`, and images left out there.

    With `hold`, the numbers of files are held as they are stored.
    """
    masks: list[Path] = []
    extras: tuple[Path, ...] = ()
    if isinstance(photographs, str | Path) and Path(photographs).is_dir():
        folder = Path(photographs)
        found = list_folder(folder)
        for note in found.notes:
            _LOGGER.warning("%s: %s", folder, note)
        files, masks, extras = list(found.files), list(found.masks) if own else [], found.extras
    elif isinstance(photographs, str | Path) or (hasattr(photographs, "shape") and len(photographs.shape) < 4):
        files = [photographs]
    elif isinstance(photographs, Sequence) or hasattr(photographs, "shape"):
        files = list(photographs)
    else:
        raise TypeError(
            f"photographs must be a folder, files or arrays; got {type(photographs).__name__}. Give for example "
            "['0.png', '1.png']."
        )
    if not files:
        raise ValueError("photographs must hold at least one; got none. Give a folder, files or arrays.")
    names = [Path(file).name if isinstance(file, str | Path) else f"photograph {i}" for i, file in enumerate(files)]
    if mask is None and len(masks) > 1:
        listed = ", ".join(sorted(file.name for file in masks))
        raise ValueError(f"{photographs} holds several masks, {listed}. Choose one with mask= (--mask).")
    given = _given_masks(masks[0] if mask is None and masks else mask)
    shape = None if given is None else given[0].shape
    paths = [Path(file) for file in files if isinstance(file, str | Path)]
    read = photograph_files(paths, srgb=srgb, shape=shape)
    for note in read.notes:
        _LOGGER.warning("%s: %s", paths[0].parent, note)
    pictures = map(read.hold if hold else read.read, range(len(paths)))
    images = [
        next(pictures) if isinstance(file, str | Path) else as_image(file, name)
        for name, file in zip(names, files, strict=True)
    ]
    for name, image in zip(names, images, strict=True):
        if image.ndim != 3 or image.shape[2] not in (1, 2, 3, 4):
            raise ValueError(
                f"{name} must be an image (H, W) or (H, W, C); got shape {image.shape}. Give one image each."
            )
    return names, images, given, extras


def _of_shape(mask: Mask, shape: tuple[int, ...]) -> Mask:
    if mask.shape != shape:
        raise ValueError(f"mask must have the photographs' shape {shape}; got {mask.shape}. Resize it.")
    return mask


def _round_piece(images: Sequence[Any]) -> Mask:
    """Return the bright region whose edge is closest to a circle, among the largest regions above several thresholds.

    Raises:
        ValueError: If no region is round.
    """
    greys = (np.nan_to_num(np.asarray(image[:], np.float64).mean(-1), posinf=0.0) for image in images)
    most = functools.reduce(np.maximum, greys)
    pieces = [largest(most > level * float(np.quantile(most, 0.99))) for level in LEVELS]
    best = max(pieces, key=roundness)
    if roundness(best) < MIN_FRACTION:
        raise ValueError(
            f"no ball stands out from the background in these photographs: only {100 * roundness(best):.0f} % of the "
            "roundest bright region's edge lies on a circle. Give the ball's mask: mask='mask.png' (--mask)."
        )
    return best
