"""Views: photographs and how they were taken."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import partial
from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Bool, Float, Int

from ...core.arrays import check_load, is_number, named_plain
from ...core.fields import MOST_BANDS, Array, Checked, Scalar, as_scalar, check_kind, is_concrete, parameter
from ...core.masks import as_mask
from ...io.lazy_images import LazyImage, sliced
from ...model.cameras import AbstractCamera
from ...model.scenes import Scene
from .sensors import Sensor

# Float[np.ndarray, "h w c"], or a LazyImage; Any, so that a type checker takes it for what one knows it is.
Image: TypeAlias = Any

EXPOSURE = parameter("camera", gauge=-1, fit_range=(1e-9, np.inf), by_own_name=True)


def as_image(image: Any, name: str = "View.image") -> Any:
    """Make an image a NumPy array with its channels last; what is read by rows, lazily, stays so.

    Anything else is handed on for the check to refuse.
    """
    if isinstance(image, LazyImage):
        return image
    if isinstance(image, Tracer):
        raise TypeError(
            f"{name} must be numbers, and is traced by jax.grad, jit or vmap. Make the view and fit outside; the "
            "derivative of a fit by a photograph is ds.image_sensitivity(fit, view)."
        )
    check_load(name, image)
    in_memory = hasattr(image, "__dlpack__") or isinstance(image, np.generic)  # NumPy, JAX, PyTorch
    if not in_memory and all(hasattr(image, part) for part in ("shape", "dtype", "__getitem__")):
        return LazyImage(partial(sliced, image), image.shape, image.dtype)
    array = named_plain(name, image)
    if not np.issubdtype(array.dtype, np.number) and is_number(array.dtype):  # bfloat16 and its like
        array = array.astype(np.float32)
    if array.dtype == np.longdouble:  # which JAX has not
        array = array.astype(np.float64)
    return array[..., None] if array.ndim == 2 else array


def check_floats(name: str, dtype: np.dtype) -> None:
    """Refuse an image of whole numbers: which of them is 1, and whether they have a curve, only its file says."""
    if not np.issubdtype(dtype, np.floating):
        raise ValueError(
            f"{name} must be linear radiance in floats; got {dtype}. Read the file with ds.read_image, or divide by "
            "the full range, and decode with ds.srgb_decode what has the sRGB curve."
        )


def as_lit(lit: Sequence[int] | int | None) -> Any:
    """Make a tuple of the indices of the lights that are on; None is all of them, and switches are no indices."""
    if lit is None or (np.size(lit) and not np.issubdtype(np.asarray(lit).dtype, np.integer)):
        return lit
    return tuple(int(i) for i in np.ravel(lit))


def as_level(level: Any) -> Any:
    """Make a number a Python float; anything else is handed on for the check to refuse."""
    number = isinstance(level, np.number | int | float | np.ndarray) and not isinstance(level, bool)
    return float(level) if np.ndim(level) == 0 and number else level


def srgb_curve(m: Float[Array, "..."]) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Return linear levels on the sRGB curve, and its slope there: `io.encodings.srgb_encode` in JAX."""
    bright = m > 0.0031308
    level = jnp.where(bright, m, 1.0)
    root = level ** (1.0 / 2.4)
    return jnp.where(bright, 1.055 * root - 0.055, 12.92 * m), jnp.where(bright, 1.055 / 2.4 * root / level, 12.92)


class Noise(Checked):
    r"""How much a photograph's samples scatter, at the level m of the image (Healey and Kondepudy 1994).

    $$ variance = {read}^2 + shot \cdot m + (s / levels)^2 / 12 $$

    All are at least 0, in the image's linear units; read and levels must not both be 0.

    Args:
        read: Standard deviation in the dark; default 0.
        shot: Variance for each unit of signal, that of counted photons; default 0.
        levels: Steps of an integer file, 255 for 8 bits, whose rounding is the last term; default 0, none.
        srgb: 1 where the steps are spaced by the sRGB curve, so that s is its slope at m; 0, the default, where s = 1.
    """

    read: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata={"lower": 0})
    shot: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata={"lower": 0})
    levels: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata={"lower": 0})
    srgb: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata={"lower": 0, "upper": 1})

    def check_together(self) -> None:
        if is_concrete(self.srgb) and self.srgb not in (0.0, 1.0):
            raise ValueError(f"Noise.srgb must be 0 or 1; got {self.srgb}. Give 1 where the file has the sRGB curve.")
        if is_concrete(self.read, self.shot, self.levels) and not (self.read > 0 or self.levels > 0):
            raise ValueError(
                f"Noise must not vanish in the dark; got read {self.read} and levels {self.levels}. Give the standard "
                "deviation of a dark image as read, or the levels of the file."
            )

    @property
    def is_uniform(self) -> bool:
        """Whether the variance is the same at every level."""
        return float(self.shot) == 0.0 and (float(self.levels) == 0.0 or float(self.srgb) == 0.0)

    def variance(self, m: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return the variance at the level m."""
        m = jnp.where(m > 0.0, m, 0.0)
        spacing = jnp.where(self.srgb > 0.5, 1.0 / srgb_curve(m)[1], 1.0)
        step = jnp.where(self.levels > 0, spacing / jnp.where(self.levels > 0, self.levels, 1.0), 0.0)
        return self.read**2 + self.shot * m + step**2 / 12.0


def as_noise(noise: Noise | float | None) -> Any:
    """Make a number the standard deviation of noise that is the same everywhere."""
    return noise if noise is None or isinstance(noise, Noise) else Noise(read=noise)


class View(Checked):
    r"""A photograph (or render) and how it was taken.

    $$ image = exposure \cdot radiance + black + noise $$

    The sensor then clips it to [floor, saturation]. What else a camera does, such as a response curve, is a `Sensor`.

    Args:
        image: Linear radiance, unless `sensor` says what else it is, (H, W), (H, W, 1) grey or (H, W, 3). A further
            channel is alpha; alpha of at least half is inside the mask. For a scene of `bands`, (H, W, C) with a
            channel for each of them and no alpha. For images larger than memory: what
            `open_image` returns, or any array with `shape`, a floating `dtype` and `array[r0:r1]`, rows as NumPy floats
            (h5py, zarr).
        camera: A camera of the image's shape.
        mask: (H, W); True where pixels count. Whole numbers of 0 and 1 are False and True; other unsigned ones count
            from half of their type's range (128 of 255), floats from .5; of (H, W, C), alpha or else the mean colour,
            as for `read_mask`. Default: the scene's own silhouette.
        lit: Indices of the lights that were on. Default: all.
        exposure: The factor from radiance to the image, above 0; default 1.
        black: What the image shows where there is no light; default 0.
        noise: A `Noise`, or the standard deviation of noise that is the same everywhere. Default: it is estimated.
        saturation: Samples at or above it are clipped. Default: the largest value that counts, if it is exactly 1, the
            top of an integer file's range, or stands there much oftener than any value just below; else none.
        floor: Samples at or below it are clipped from below. Default: none.
        sensor: Response, white balance, vignetting and blur of the camera. Default: none of these.
        bands: Whether each channel is a band, and none of them alpha; `fit` sets it as the scene says.
    """

    image: Image = eqx.field(converter=as_image)
    camera: AbstractCamera
    mask: Bool[np.ndarray, "h w"] | None = eqx.field(
        converter=lambda mask: None if mask is None else np.asarray(as_mask(mask, "View.mask")), default=None
    )
    lit: tuple[int, ...] | None = eqx.field(converter=as_lit, static=True, default=None)
    exposure: Scalar = eqx.field(converter=as_scalar, default=1.0, metadata=EXPOSURE)
    black: Scalar = eqx.field(
        converter=as_scalar, default=0.0, metadata=parameter("camera", linear=True, by_own_name=True)
    )
    noise: Noise | None = eqx.field(converter=as_noise, default=None)
    saturation: float | None = eqx.field(converter=as_level, static=True, default=None)
    floor: float | None = eqx.field(converter=as_level, static=True, default=None)
    sensor: Sensor | None = None
    bands: bool = eqx.field(static=True, default=False)

    def check_together(self) -> None:
        if self.sensor is not None:
            check_kind("View.sensor", self.sensor, Sensor, "Sensor(gamma=1.8)")
        check_kind("View.camera", self.camera, AbstractCamera, "Camera(eye=(0, 0, 4))")
        image, shape = self.image, self.camera.shape
        check_floats("View.image", image.dtype)
        if image.ndim == 3 and image.shape[1:] == shape and image.shape[:2] != shape:
            raise ValueError(
                f"View.image must have its channels last, shape {(*shape, image.shape[0])}; got {image.shape}. Move "
                "the colours to the last axis: np.moveaxis(image, 0, -1)."
            )
        if image.ndim != 3 or not 1 <= image.shape[2] <= MOST_BANDS:
            raise ValueError(
                f"View.image must have shape (H, W), or (H, W, C) with 1 to 4 channels, or one for each band of a "
                f"scene; got {image.shape}. Give a grey or RGB image, with alpha or without, or at most {MOST_BANDS} "
                "bands."
            )
        if image.shape[:2] != shape:
            if image.shape[1::-1] == shape:
                raise ValueError(
                    f"View.image must have the camera's shape {shape}; got {image.shape[:2]}: one of the two is "
                    f"transposed. Give np.swapaxes(image, 0, 1), or the camera shape={image.shape[:2]}."
                )
            raise ValueError(
                f"View.image must have the camera's shape {shape}; got {image.shape[:2]}. "
                f"Give the camera shape={image.shape[:2]}."
            )
        if self.lit is not None and not (isinstance(self.lit, tuple) and all(type(i) is int for i in self.lit)):
            raise TypeError(f"View.lit must hold indices of lights; got {self.lit!r}. Give for example (0, 2).")
        if self.lit is not None and len(set(self.lit)) < len(self.lit):
            raise ValueError(f"View.lit must name each light once; got {self.lit}. Name those that were on.")
        if self.mask is not None and self.mask.dtype != bool:  # put there by eqx.tree_at
            raise TypeError(f"View.mask must be boolean; got {self.mask.dtype}. Make a new View of it.")
        if self.mask is not None and self.mask.shape != shape:
            raise ValueError(f"View.mask must have the image's shape {shape}; got {self.mask.shape}. Resize it.")
        for name, level in (("saturation", self.saturation), ("floor", self.floor)):
            if level is not None and not (isinstance(level, float) and not np.isnan(level)):
                raise ValueError(f"View.{name} must be a number or None; got {level!r}. Give the level in the image.")
        if self.saturation is not None and self.floor is not None and not self.floor < self.saturation:
            raise ValueError(
                f"View.floor must be less than saturation; got {self.floor:g} and {self.saturation:g}. Give the levels "
                "of the sensor in the dark and in full light."
            )
        if is_concrete(self.exposure) and not self.exposure > 0:
            raise ValueError(f"View.exposure must be above 0; got {self.exposure}. Give 1 if it is not known.")


def is_grey(view: View) -> bool:
    """Whether a view has one channel, and so one residual a pixel."""
    return not view.bands and view.image.shape[2] < 3


def channels(view: View) -> int:
    """Return how many samples a pixel of a view has: its channels without alpha."""
    return view.image.shape[2] - has_alpha(view)


def lights_on(scene: Scene, view: View) -> tuple[int, ...]:
    """Return the indices of the lights that are on in a view."""
    return tuple(range(len(scene.lights))) if view.lit is None else view.lit


def switches(rows: Sequence[Sequence[int]]) -> tuple[Int[np.ndarray, "views _"], Float[np.ndarray, "views _"]]:
    """Return what is on in each view as an index, padded to the same number, and 1 for each, or 0 for padding."""
    index = np.array([*itertools.zip_longest(*rows, fillvalue=-1)], int).reshape(-1, len(rows)).T
    return np.maximum(index, 0), 1.0 * (index >= 0)


def camera_key(camera: AbstractCamera) -> tuple[Any, ...]:
    """Return a key that two cameras share where all their numbers are equal, though they are two objects."""
    leaves, structure = jax.tree.flatten(camera)
    return structure, *(np.asarray(leaf).tobytes() for leaf in leaves)


def noises(views: Sequence[View]) -> Any:
    """Return the `Noise` of each view, stacked; None where it is not known."""
    of = [view.noise for view in views]
    return None if None in of else jax.tree.map(lambda *leaves: np.stack(leaves), *of)


def has_alpha(view: View) -> bool:
    """Whether the last channel of a view's image is alpha."""
    return not view.bands and view.image.shape[2] in (2, 4)


def colours(view: View) -> Image:
    """Return a view's image without alpha, not copied."""
    if not has_alpha(view):
        return view.image
    return view.image.colours() if isinstance(view.image, LazyImage) else view.image[..., :-1]


def has_mask(view: View) -> bool:
    """Whether a view says which of its pixels count."""
    return view.mask is not None or has_alpha(view)
