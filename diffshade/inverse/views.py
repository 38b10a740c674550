"""Views: photographs and how they were taken, and which of their samples count."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike, Bool, Float

from ..cameras import AbstractCamera
from ..fields import Checked, Scalar, as_scalar, check_kind, is_concrete
from ..rendering import select, visible_points
from ..scenes import Scene, check_positions, check_shapes


def as_image(image: ArrayLike) -> Any:
    """Make an image a NumPy array with its channels last; anything else is handed on for the check to refuse."""
    array = np.asarray(image)
    return array[..., None] if array.ndim == 2 else array


def as_lit(lit: Sequence[int] | int | None) -> Any:
    """Make a tuple of the indices of the lights that are on; None is all of them, and switches are no indices."""
    if lit is None or np.asarray(lit).dtype == bool:
        return lit
    return tuple(int(i) for i in np.ravel(lit))


class View(Checked):
    """A photograph (or render) and how it was taken: exposure * radiance, clipped by the sensor.

    `image`: linear radiance, (H, W), (H, W, 1) grey or (H, W, 3); a further channel is alpha, and alpha of at least
    half is inside the mask. `camera`: of the image's shape. `mask`: (H, W), True or at least half where pixels count;
    by default the scene's own silhouette. `lit`: the indices of the lights that were on; by default all. `exposure`:
    the factor from radiance to the image, above 0. `saturation`: samples at or above it are clipped and are left out;
    by default 1 in an image whose largest value is exactly 1, the top of an integer file's range, else none.
    """

    image: Float[np.ndarray, "h w c"] = eqx.field(converter=as_image)
    camera: AbstractCamera
    mask: Bool[np.ndarray, "h w"] | None = eqx.field(
        converter=lambda mask: None if mask is None else np.asarray(mask), default=None
    )
    lit: tuple[int, ...] | None = eqx.field(converter=as_lit, static=True, default=None)
    exposure: Scalar = eqx.field(converter=as_scalar, default=1.0)
    saturation: float | None = eqx.field(static=True, default=None)

    def check_together(self) -> None:
        check_kind("View.camera", self.camera, AbstractCamera, "Camera(eye=(0, 0, 4))")
        image, shape = self.image, self.camera.shape
        if not np.issubdtype(image.dtype, np.floating):
            raise ValueError(
                f"View.image must be linear radiance in floats; got {image.dtype}. Read the file with ds.read_image."
            )
        if image.ndim != 3 or image.shape[2] not in (1, 2, 3, 4):
            raise ValueError(
                f"View.image must have shape (H, W), or (H, W, C) with 1 to 4 channels; got {image.shape}. "
                "Give a grey or RGB image, with alpha or without."
            )
        if image.shape[:2] != shape:
            raise ValueError(
                f"View.image must have the camera's shape {shape}; got {image.shape[:2]}. "
                f"Give the camera shape={image.shape[:2]}."
            )
        if (self.lit is not None and not isinstance(self.lit, tuple)) or (self.lit and isinstance(self.lit[0], bool)):
            raise TypeError(f"View.lit must hold indices of lights; got {self.lit!r}. Give (0, 2), not switches.")
        if self.mask is not None and self.mask.shape != shape:
            raise ValueError(f"View.mask must have the image's shape {shape}; got {self.mask.shape}. Resize it.")
        if is_concrete(self.exposure) and not self.exposure > 0:
            raise ValueError(f"View.exposure must be above 0; got {self.exposure}. Give 1 if it is not known.")


class Samples(eqx.Module):
    """The samples of one view that count: a sample is one channel of a pixel."""

    inside: Bool[np.ndarray, "h w"]
    """Pixels that show an object."""
    values: Float[np.ndarray, "h w c"]
    """The photograph without alpha."""
    counts: Bool[np.ndarray, "h w c"]
    """Samples that count: inside, and not clipped."""

    @property
    def saturated(self) -> int:
        """Number of samples at the top of the sensor's range, left out."""
        return int((self.inside[..., None] & ~self.counts).sum())


def is_grey(view: View) -> bool:
    """Whether a view has one channel, and so one residual a pixel."""
    return view.image.shape[2] < 3


def find_samples(scene: Scene, view: View, *, moving: bool = False) -> Samples:
    """Find the samples of a view that count.

    `moving` says that a surface is free: then the view needs a mask, which is eroded by one pixel and stays fixed;
    otherwise what the mask and the alpha channel leave of the objects' own silhouette counts. Raises ValueError.
    """
    select(scene, view.lit)
    check_shapes(scene, view.camera)
    check_positions(scene, view.camera)
    alpha = view.image.shape[2] in (2, 4)
    values = view.image[..., :-1] if alpha else view.image
    inside = np.ones(values.shape[:2], bool) if view.mask is None else view.mask >= 0.5
    if alpha:
        inside = inside & (view.image[..., -1] >= 0.5)
    if not moving:
        inside = inside & np.asarray(visible_points(scene.objects, view.camera)[2])
    elif alpha or view.mask is not None:
        inside = _erode(inside)
    else:
        raise ValueError("a fit of a surface needs a mask of what shows it; got none. Give View.mask.")
    if not inside.any():
        raise ValueError(
            "no pixel is left to fit: the mask, the alpha channel and the objects' silhouette have none in common. "
            "Check that the mask is white on the object, and the camera."
        )
    wrong = inside & ~np.isfinite(values).all(-1)
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        raise ValueError(
            f"the image must be finite inside the mask; got {values[row, column]} at row {row}, column {column} "
            f"({wrong.sum()} such pixels). Mask them out."
        )
    level = view.saturation
    if level is None:
        level = 1.0 if values[inside].max() == 1.0 else np.inf
    counts = inside[..., None] & (values < level)
    if not counts.any():
        raise ValueError(f"every pixel is saturated: all are at least {level:g}. Give a shorter exposure.")
    return Samples(inside, values, counts)


def _erode(mask: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Take one pixel off the edge of a mask."""
    padded = np.pad(mask, 1)
    return padded[1:-1, 1:-1] & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
