"""Samples: the pixels of a view that count (on the object, inside the mask), and which samples of them are clipped."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Int8
from scipy import ndimage

from ...core.thresholds import SMALL
from ...io.lazy_images import TILE, LazyImage
from ...model.rendering import select
from ...model.scenes import Scene, check_positions, check_shapes
from .mixed_pixels import Edges, SeenEdges
from .views import Image, View, camera_key, colours, has_alpha, has_mask

JUST_BELOW = 1.0 - SMALL  # of the largest value: so far down values are compared with it

MIN_LEVELS, MIN_PILE = 3, 12  # different values there, and samples of the largest, that are enough to compare
PILED = 4.0  # times as many samples of the largest value as of any below it, where a sensor clipped
MIN_PIXELS = 256  # of a view, if it has as many, among those of a part


class SensorRange(NamedTuple):
    """The levels at which a sensor clips: samples at or below the floor, and at or above the level."""

    floor: float = -np.inf
    level: float = np.inf

    @classmethod
    def of(cls, view: View, top: float) -> SensorRange:
        """Return the range of a view, given where its samples show that they end (`top_of`)."""
        rounded = view.image.dtype.type  # a file or sensor of float32 ends at float32(0.45), which is below 0.45
        level = top if view.saturation is None else float(rounded(view.saturation))
        return cls(-np.inf if view.floor is None else float(rounded(view.floor)), level)

    def clipped(self, values: Float[np.ndarray, "..."]) -> Int8[np.ndarray, "..."]:
        """Return 1 where the sensor clipped a sample at the top of its range, -1 at the bottom, else 0."""
        return (values >= self.level).astype(np.int8) - (values <= self.floor).astype(np.int8)


def top_of(values: Float[np.ndarray, "..."]) -> float:
    """Return where an image of unknown saturation clips; infinity where it does not.

    It does at 1, the top of an integer file's range, if it ends there; and at its largest value, whatever that is, if
    it has that one much oftener than any of the values just below: a sensor of 12 bits in a file of 16, say.
    """
    most = float(values.max(initial=-np.inf))
    if most == 1.0:
        return 1.0
    at_top = np.count_nonzero(values == most)
    _, times = np.unique(values[(values > JUST_BELOW * most) & (values < most)], return_counts=True)
    return most if at_top >= MIN_PILE and len(times) >= MIN_LEVELS and at_top > PILED * times.max() else np.inf


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples of one view that count: a sample is one channel of a pixel."""

    inside: Bool[np.ndarray, "h w"]
    """Pixels that show an object."""
    pixels: Int[np.ndarray, " n"]
    """Those that count, in the flattened image. Views of one camera that show the same ones share the array."""
    photograph: Image
    """The photograph without alpha, not copied."""
    sensor_range: SensorRange
    brightest: float
    """The largest sample."""
    zeros: int = 0
    """How many are exactly 0, if none is below."""
    reach: int = 0
    """How many pixels from edges the photograph mixes what is on both sides."""

    @property
    def count(self) -> int:
        """How many samples there are."""
        return len(self.pixels) * self.photograph.shape[2]

    def at(self, pixels: Int[np.ndarray, " m"]) -> Samples:
        """Return the samples of other pixels of the same view."""
        return dataclasses.replace(self, pixels=pixels)

    def values(self, pixels: Int[np.ndarray, " m"]) -> Float[np.ndarray, "m c"]:
        """Return the photograph at some of its pixels."""
        if isinstance(self.photograph, LazyImage):
            return self.photograph.at(pixels)
        h, w, c = self.photograph.shape
        return self.photograph.reshape(h * w, c).take(pixels, 0)

    def ends(self) -> Int8[np.ndarray, "n c"]:
        """Return which of the samples are clipped, as `SensorRange.clipped` says."""
        if self.brightest < self.sensor_range.level and self.sensor_range.floor == -np.inf:  # nothing can be
            return np.zeros((len(self.pixels), self.photograph.shape[2]), np.int8)
        return self.sensor_range.clipped(self.values(self.pixels))


def share_of(samples: Samples, count: int) -> Samples:
    """Return so many of the samples' pixels, evenly spread over the image and over their brightness.

    The pixels of each run are taken at equal steps in the order of their brightness, so that each part of a highlight,
    however small, has its share, whatever the width of the image.
    """
    n = len(samples.pixels)
    if count >= n:
        return samples
    parts = []
    for start in range(0, n, TILE):
        run = samples.pixels[start : start + TILE]
        few = (start + len(run)) * count // n - start * count // n
        order = np.argsort(samples.values(run).mean(-1), kind="stable")
        parts.append(np.sort(run[order[((np.arange(few) + 0.5) * len(run) / max(few, 1)).astype(int)]]))
    return samples.at(np.concatenate(parts))


def find_samples(scene: Scene, view: View, *, moving: bool = False, edges: dict[Any, Edges] | None = None) -> Samples:
    """Find the samples of a view that count.

    Args:
        scene: The scene, whose objects the pixels must show.
        view: The photograph.
        moving: Whether a surface is free: then the view needs a mask, which is eroded by one pixel and stays fixed;
            otherwise what the mask and the alpha channel leave of the objects' own silhouette counts, but for what
            the photograph mixes along edges; of a lazy image that is not looked at.
        edges: Those of each camera, to which this camera's are added.

    Raises:
        ValueError: If the view does not fit the scene, or nothing of it is left to fit.
    """
    select(scene, view.lit)
    check_shapes(scene, view.camera)
    check_positions(scene, view.camera)
    if moving and not has_mask(view):
        raise ValueError("a fit of a surface needs a mask of its pixels; got none. Give View.mask.")
    key, inside, edges = camera_key(view.camera), kept(view), {} if edges is None else edges
    if not moving and key not in edges:
        edges[key] = SeenEdges(scene.objects, view.camera)
    of = Edges(inside) if moving else edges[key]
    reach = 0 if isinstance(view.image, LazyImage) else of.reach(colours(view))
    inside = ndimage.binary_erosion(inside) if moving else inside & of.inside
    counting = of.unmixed(inside, reach)
    pixels = np.flatnonzero(counting).astype(np.int32)
    if not len(pixels):
        raise ValueError(
            "no pixel is left to fit: the mask, the alpha channel and the objects' silhouette have none in common. "
            "Check the camera, and that the mask is white on the object."
        )
    samples = Samples(inside, pixels, colours(view), SensorRange(), 0.0, reach=reach)
    least, most, zeros, at_top = _extremes(samples)
    near_top = np.array([most])
    if at_top >= MIN_PILE and most != 1.0:
        near_top = np.concatenate([values[values > JUST_BELOW * most] for values in _pieces(samples)])
    ends = SensorRange.of(view, top_of(near_top))
    if least >= ends.level:
        raise ValueError(f"every pixel is saturated: all are at least {ends.level:g}. Give a shorter exposure.")
    return dataclasses.replace(samples, sensor_range=ends, brightest=most, zeros=zeros)


def kept(view: View, rows: Any = None, first: int = 0) -> Bool[np.ndarray, "r w"]:
    """Return where the mask and the alpha channel of a view keep pixels, in all rows or in `rows` from `first`."""
    if rows is None and isinstance(view.image, LazyImage) and has_alpha(view):
        return np.concatenate([kept(view, tile, at) for at, tile in view.image.tiles()])
    rows = view.image if rows is None else rows
    inside = np.ones(rows.shape[:2], bool) if view.mask is None else view.mask[first : first + rows.shape[0]]
    return inside & (rows[..., -1] >= 0.5) if has_alpha(view) else inside


def top_of_view(view: View) -> float:
    """Return `top_of` of the samples that mask and alpha keep; infinity for a lazy image, which is not read for it."""
    return np.inf if isinstance(view.image, LazyImage) else top_of(colours(view)[kept(view)])


def _pieces(samples: Samples) -> Iterator[Float[np.ndarray, "m c"]]:
    """Yield the samples, `TILE` pixels at a time."""
    for start in range(0, len(samples.pixels), TILE):
        yield samples.values(samples.pixels[start : start + TILE])


def _extremes(samples: Samples) -> tuple[float, float, int, int]:
    """Return the smallest and the largest sample, and how many are 0 and that; ValueError where one is not finite."""
    least, most, zeros, at_top = np.inf, -np.inf, 0, 0
    for values in _pieces(samples):
        low, high = float(values.min()), float(values.max())  # NaN where one is
        if not np.isfinite([low, high]).all():
            every = samples.values(samples.pixels)
            wrong = ~np.isfinite(every).all(-1)
            raise ValueError(not_finite(every[wrong], samples.pixels[wrong], samples.photograph.shape[1]))
        zeros += int(np.count_nonzero(values == 0.0)) if low <= 0.0 else 0
        at_top = (at_top if most >= high else 0) + (int(np.count_nonzero(values == high)) if high >= most else 0)
        least, most = min(least, low), max(most, high)
    return least, most, zeros if least == 0.0 else 0, at_top


def not_finite(values: Float[np.ndarray, "m c"], pixels: Int[np.ndarray, " m"], width: int) -> str:
    """Return the message about these pixels of an image of this width."""
    row, column = divmod(int(pixels[0]), width)
    return (
        f"the image must be finite inside the mask; got {values[0]} at row {row}, column {column} ({len(pixels)} such "
        "pixels). Mask them out."
    )
