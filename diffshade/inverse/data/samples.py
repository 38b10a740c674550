"""Samples: the samples of a view that count (on the object, inside the mask), and which of them are clipped."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from ...core.masks import Mask
from ...io.lazy_images import LazyImage
from ...model.cameras import AbstractCamera
from ...model.rendering import select, silhouette
from ...model.scenes import Scene, check_positions, check_shapes
from .views import Image, View, camera_key, colours, find_repeats, has_alpha, has_mask

Masks = Sequence[Mask | None]
"""For each view the pixels to keep; None keeps all."""

RUN = 1 << 16  # pixels that are ordered by their brightness at a time
LEAST = 256  # pixels of a view, if it has as many, among those of a part


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples of one view that count: a sample is one channel of a pixel."""

    inside: Bool[np.ndarray, "h w"]
    """Pixels that show an object."""
    pixels: Int[np.ndarray, " n"]
    """Where those pixels are in the flattened image. Views of one camera that show the same ones share the array."""
    photograph: Image
    """The photograph without alpha, not copied."""
    floor: float
    """The sensor's range: samples at or below its floor, and at or above its level, are clipped."""
    level: float
    brightest: float
    """The largest sample."""

    def values(self, pixels: Int[np.ndarray, " m"]) -> Float[np.ndarray, "m c"]:
        """Return the photograph at some of its pixels."""
        if isinstance(self.photograph, LazyImage):
            return self.photograph.at(pixels)
        h, w, c = self.photograph.shape
        return self.photograph.reshape(h * w, c).take(pixels, 0)

    def whole(self) -> Float[np.ndarray, "h w c"]:
        """Return the whole photograph, which is read here where it is lazy."""
        return self.photograph[:]

    def clipped(self, values: Float[np.ndarray, "m c"]) -> Int8[np.ndarray, "m c"]:
        """Return 1 where the sensor clipped a sample at the top of its range, -1 at the bottom, else 0."""
        return (values >= self.level).astype(np.int8) - (values <= self.floor).astype(np.int8)

    def ends(self) -> Int8[np.ndarray, "n c"]:
        """Return `clipped` of all the samples."""
        if self.brightest < self.level and self.floor == -np.inf:  # nothing can be
            return np.zeros((len(self.pixels), self.photograph.shape[2]), np.int8)
        return self.clipped(self.values(self.pixels))


class Counts(eqx.Module):
    """How many pixels and samples (channels of pixels) a fit looks at."""

    views: int
    pixels: int
    samples: int
    clipped: int
    """Samples at an end of the sensor's range, which say only that the truth is beyond it."""
    left_out: int
    """Samples at an end of the sensor's range that were left out, with their pixels."""
    repeats: tuple[tuple[int, int], ...] = ()
    """Pairs of a view that repeats an earlier one, and that earlier view; the two are counted once."""
    beyond_memory: int = 0
    """Pixels that were not looked at, since they did not fit into memory."""

    def of(self, samples: Sequence[Samples]) -> Counts:
        """Return the counts of other samples of the same views, of which fewer may be left."""
        pixels = [len(s.pixels) for s in samples]
        number = sum(n * s.photograph.shape[2] for n, s in zip(pixels, samples, strict=True))
        clipped = sum(int(np.abs(s.ends()).sum()) for s in samples)
        return dataclasses.replace(
            self, views=sum(n > 0 for n in pixels), pixels=sum(pixels), samples=number, clipped=clipped
        )


def collect_samples(
    scene: Scene,
    views: Sequence[View],
    clipped: str,
    *,
    unknowns: int,
    moving: bool,
    at_most: float = np.inf,
    forecast: bool = False,
) -> tuple[list[Samples], Counts]:
    """Find the samples of every view; raise ValueError that names the view, or says that there are too few.

    A view that is an earlier one again has none.

    Args:
        scene: The scene, whose objects the pixels must show.
        views: The photographs.
        clipped: What samples at an end of the sensor's range say; "exclude" leaves their pixels out.
        unknowns: How many numbers are to be found, which there must be as many samples for.
        moving: Whether a surface is free, which takes a mask.
        at_most: The most pixels of all views; of more, each view has its share.
        forecast: Whether the photographs are still to be taken, so that equal ones are no repetition.
    """
    samples, again = [], {} if forecast else find_repeats(scene, views)
    left_out = 0
    outlines: dict[Any, Mask] = {}
    shown: dict[Any, Int[np.ndarray, " n"]] = {}

    def outline(camera: AbstractCamera) -> Mask:  # rendered once for the views of one camera
        key = camera_key(camera)
        if key not in outlines:
            outlines[key] = outline_of(scene, camera)
        return outlines[key]

    for i, view in enumerate(views):
        try:
            found = find_samples(scene, view, moving=moving, outline=outline)
        except ValueError as error:
            raise ValueError(f"views[{i}]: {error}") from None
        if i in again:  # the same numbers tell nothing more
            found = dataclasses.replace(found, pixels=found.pixels[:0])
        if clipped == "exclude" and (ends := found.ends()).any():
            left_out += int(np.abs(ends).sum())
            found = dataclasses.replace(found, pixels=found.pixels[~ends.any(-1)])
        same = shown.setdefault((camera_key(view.camera), blake2b(found.pixels.data).digest()), found.pixels)
        samples.append(dataclasses.replace(found, pixels=same))
    whole = sum(len(s.pixels) for s in samples)
    if whole > at_most:
        samples = [share_of(s, max(int(len(s.pixels) * at_most / whole), LEAST)) for s in samples]
    beyond = whole - sum(len(s.pixels) for s in samples)
    counts = Counts(0, 0, 0, 0, left_out, tuple(again.items()), beyond).of(samples)
    counts = dataclasses.replace(counts, views=len(views) - len(again))
    check_enough(counts, unknowns, [s.brightest for s in samples])
    return samples, counts


def share_of(samples: Samples, count: int) -> Samples:
    """Return so many of the samples' pixels, evenly spread over the image and over their brightness.

    The pixels of each run are taken at equal steps in the order of their brightness, so that each part of a highlight,
    however small, has its share, whatever the width of the image.
    """
    n = len(samples.pixels)
    if count >= n:
        return samples
    kept = []
    for start in range(0, n, RUN):
        run = samples.pixels[start : start + RUN]
        few = (start + len(run)) * count // n - start * count // n
        order = np.argsort(samples.values(run).mean(-1), kind="stable")
        kept.append(np.sort(run[order[((np.arange(few) + 0.5) * len(run) / max(few, 1)).astype(int)]]))
    return dataclasses.replace(samples, pixels=np.concatenate(kept))


def keep_pixels(samples: Sequence[Samples], masks: Masks) -> list[Samples]:
    """Return the samples of the pixels that masks keep."""
    return [
        s if kept is None else dataclasses.replace(s, pixels=s.pixels[kept.reshape(-1)[s.pixels]])
        for s, kept in zip(samples, masks, strict=True)
    ]


def check_enough(counts: Counts, unknowns: int, brightest: Sequence[float]) -> None:
    """Refuse fewer pixels or samples than unknowns, and black images."""
    for noun, have in (("pixels", counts.pixels), ("samples that are not clipped", counts.samples - counts.clipped)):
        if have < unknowns:
            raise ValueError(
                f"these views have fewer {noun} than there are unknowns, {have} for {unknowns}. Free fewer "
                "parameters or add views."
            )
    if all(most <= 0.0 for most in brightest):
        raise ValueError("the images are black: no pixel that shows an object is above 0. Check the files and masks.")


def outline_of(scene: Scene, camera: AbstractCamera) -> Mask:
    """Return the pixels that show an object of the scene."""
    return np.asarray(silhouette(scene.objects, camera))


def find_samples(
    scene: Scene, view: View, *, moving: bool = False, outline: Callable[[AbstractCamera], Mask] | None = None
) -> Samples:
    """Find the samples of a view that count.

    `moving` says that a surface is free: then the view needs a mask, which is eroded by one pixel and stays fixed;
    otherwise what the mask and the alpha channel leave of the objects' own silhouette counts, which `outline` returns
    for a camera. Raises ValueError.
    """
    check_view(scene, view, moving=moving)
    masks = [] if view.mask is None else [view.mask]
    if has_alpha(view):
        masks.append(_alpha(view.image))
    if not moving:
        masks.append(outline_of(scene, view.camera) if outline is None else outline(view.camera))
    inside = np.logical_and.reduce(masks)
    if moving:
        inside = erode(inside)
    pixels = np.flatnonzero(inside).astype(np.int32)
    check_any(len(pixels))
    samples = Samples(inside, pixels, colours(view), -np.inf, np.inf, 0.0)
    least, most = extremes(samples)
    return Samples(inside, pixels, samples.photograph, *sensor_range(view, least, most), most)


def check_view(scene: Scene, view: View, *, moving: bool) -> None:
    """Refuse a view that does not fit the scene, or has no mask where a surface is free."""
    select(scene, view.lit)
    check_shapes(scene, view.camera)
    check_positions(scene, view.camera)
    if moving and not has_mask(view):
        raise ValueError("a fit of a surface needs a mask of its pixels; got none. Give View.mask.")


def check_any(pixels: int) -> None:
    """Refuse a view of which no pixel counts."""
    if not pixels:
        raise ValueError(
            "no pixel is left to fit: the mask, the alpha channel and the objects' silhouette have none in common. "
            "Check the camera, and that the mask is white on the object."
        )


def sensor_range(view: View, least: float, most: float) -> tuple[float, float]:
    """Return the levels at which the sensor clips, at the bottom and at the top, given the extreme samples."""
    rounded = view.image.dtype.type  # a file or sensor of float32 ends at float32(0.45), which is below 0.45
    level = (1.0 if most == 1.0 else np.inf) if view.saturation is None else float(rounded(view.saturation))
    if least >= level:
        raise ValueError(f"every pixel is saturated: all are at least {level:g}. Give a shorter exposure.")
    return -np.inf if view.floor is None else float(rounded(view.floor)), level


def _alpha(image: Image) -> Bool[np.ndarray, "h w"]:
    """Return where the last channel is at least half."""
    if isinstance(image, LazyImage):
        return np.concatenate([tile[..., -1] >= 0.5 for _, tile in image.tiles()])
    return image[..., -1] >= 0.5


def extremes(samples: Samples) -> tuple[float, float]:
    """Return the smallest and the largest sample, piece by piece; raise ValueError where one is not finite."""
    least, most = np.inf, -np.inf
    for start in range(0, len(samples.pixels), 1 << 16):
        pixels = samples.pixels[start : start + (1 << 16)]
        values = samples.values(pixels)
        low, high = float(values.min()), float(values.max())  # NaN where one is
        if not np.isfinite(low + high):
            wrong = ~np.isfinite(values).all(-1)
            first = int(wrong.argmax())
            row, column = divmod(int(pixels[first]), samples.photograph.shape[1])
            count = int((~np.isfinite(samples.values(samples.pixels)).all(-1)).sum())
            raise ValueError(
                f"the image must be finite inside the mask; got {values[first]} at row {row}, column {column} "
                f"({count} such pixels). Mask them out."
            )
        least, most = min(least, low), max(most, high)
    return least, most


def erode(mask: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Take one pixel off the edge of a mask."""
    padded = np.pad(mask, 1)
    return padded[1:-1, 1:-1] & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
