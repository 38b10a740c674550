"""Exposures: those of a folder's photographs, and several of one light merged, so that a highlight is not clipped."""

from __future__ import annotations

import itertools
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from ...core.arrays import float64_of
from ...core.backend import in_float64
from ...core.fields import Numbers
from ...core.thresholds import SLIGHT
from ...core.words import count
from ...io.exif import stated_exposures
from ...io.images import without_alpha
from .samples import top_of
from .views import Noise, as_image, as_noise, check_floats


@dataclass(frozen=True, eq=False)
class MergedExposures:
    """Photographs of different exposures as one: `View(merged.image, camera, noise=merged.noise, ...)`."""

    image: Float[np.ndarray, "h w c"]
    """What a photograph of exposure 1 would show, without an upper end of its range."""
    error: Float[np.ndarray, "h w c"]
    """Standard deviation of each sample; infinite where every photograph is clipped, NaN where noise is not known."""
    noise: Noise | None
    """The noise that describes these errors best by the level of the image; None where no noise was given, and no
    sample is between dark and clipped in two photographs, so that they do not show theirs."""
    saturation: float | None
    """The level at which the shortest exposure clips, for `View.saturation`; None if nothing does."""


def merge_exposures(
    images: Sequence[Any],
    exposures: Numbers,
    *,
    noise: Noise | float | None = None,
    floor: float | int = 0.0,
    saturation: float | int | None = None,
) -> MergedExposures:
    r"""Merge photographs of one scene under one light, which differ in exposure alone.

    $$ image = \frac{\sum_j w_j t_j z_j}{\sum_j w_j t_j^2}, \quad w = \max(\min(z - floor, saturation - z), 0) $$

    with the exposures t. Clipped and dark samples have no weight: the hat function of Debevec and Malik ("Recovering
    high dynamic range radiance maps from photographs", SIGGRAPH 1997), here in least squares of linear photographs.
    Where no sample has weight, the longest exposure that is not clipped counts.

    Args:
        images: At least 2 linear photographs, (H, W) or (H, W, C), as `read_image` returns them; alpha is left out.
        exposures: The exposure of each, above 0, in any unit: `image` is that of exposure 1.
        noise: Noise of each photograph, a `Noise` or a standard deviation. Default: from how they differ.
        floor: Samples at or below it are dark; default 0.
        saturation: Samples at or above it are clipped. Default: 1 if the largest sample is exactly 1, the top of an
            integer file's range; else none.

    Returns:
        The merged photograph and its noise.

    Raises:
        ValueError: If there are fewer than two photographs, their shapes differ, or an exposure is not above 0.
    """
    z = _stacked(images)
    t = float64_of("exposures", exposures)
    if t.shape != (len(z),) or not ((t > 0.0) & np.isfinite(t)).all():
        raise ValueError(
            f"exposures must be a number above 0 for each of the {len(z)} images; got {t.tolist()}. Give for "
            "example the exposure times."
        )
    order = np.argsort(-t, kind="stable")  # the longest first
    z, t = z[order], t[order, None, None, None]
    top = top_of(z) if saturation is None else float(saturation)
    hat = np.maximum(np.minimum(z - floor, top - z), 0.0)
    unclipped = z < top
    longest = unclipped & (np.cumsum(unclipped, 0) == 1)
    clipped = ~unclipped.any(0)
    weight = np.where(hat.any(0), hat, longest)
    weight[-1] += clipped
    total = (weight * t**2).sum(0)
    image = (weight * t * np.minimum(z, top)).sum(0) / total
    variance = _variance(z, t, image, weight, noise)
    error = np.where(clipped, np.inf, np.sqrt((weight**2 * t**2 * variance).sum(0)) / total)
    return MergedExposures(image, error, _described(image, error), float(top / t[-1].item()) if top < np.inf else None)


def _stacked(images: Sequence[Any]) -> Float[np.ndarray, "photographs h w c"]:
    given = [as_image(image, f"images[{i}]") for i, image in enumerate(images)]
    for i, image in enumerate(given):
        check_floats(f"images[{i}]", image.dtype)
    pixels = [without_alpha(np.asarray(image[:], np.float64)) for image in given]
    if len(pixels) < 2:
        raise ValueError(f"merge_exposures takes at least 2 images; got {len(pixels)}. Give those of one light.")
    other = next((i for i, image in enumerate(pixels) if image.shape != pixels[0].shape), None)
    if other is not None:
        raise ValueError(
            f"images must have one shape; got {pixels[0].shape}, and {pixels[other].shape} of images[{other}]. Crop "
            "them alike."
        )
    return np.stack(pixels)


def _variance(z: Any, t: Any, image: Any, weight: Any, noise: Noise | float | None) -> Any:
    """Return the variance of every sample: that of a known noise, or how much photographs of one level differ."""
    known = as_noise(noise)
    if known is not None:
        with in_float64(known) as known:
            return np.asarray(known.variance(t * image))
    used = (weight > 0.0).sum(0)
    several = used > 1
    squares = np.where(weight > 0.0, (z - t * image) ** 2, 0.0).sum(0)
    if not several.any():
        return np.full(z.shape, np.nan)
    variance = float(np.mean(squares[several] / (used[several] - 1)))
    return np.full(z.shape, max(variance, np.finfo(float).eps ** 2))  # above 0 where photographs agree exactly


def _described(image: Float[np.ndarray, "h w c"], error: Float[np.ndarray, "h w c"]) -> Noise | None:
    """Return the noise read^2 + shot m whose variance at the level m is nearest to the errors, relative to them."""
    known = np.isfinite(error)
    if not known.any():
        return None
    variance, m = error[known] ** 2, np.maximum(image[known], 0.0)
    Q, R = np.linalg.qr(np.stack([1.0 / variance, m / variance], -1))
    (read, shot), _ = scipy.optimize.nnls(R, Q.sum(0))
    return Noise(read=max(float(np.sqrt(read)), float(error[known].min())), shot=float(shot))


def exposures_of(files: Sequence[Path]) -> tuple[Float[np.ndarray, " photographs"], list[str]]:
    """Return the exposure of each photograph by its EXIF, relative to the first, and a sentence on them.

    They are 1 where they are equal, or one of them is not stated.
    """
    stated = stated_exposures(files)
    silent = int(np.isnan(stated).sum())
    equal = np.ones(len(files))
    if silent == len(files):
        return equal, []
    if silent:
        return equal, [
            f"{silent} of {count(len(files), 'photograph')} state no exposure (EXIF): all are taken to be equal."
        ]
    ratio = stated.max() / stated.min()
    if ratio < 1.0 + SLIGHT:
        return equal, []
    return stated / stated[0], [
        f"exposures differ by a factor of up to {ratio:.3g} by the files' EXIF, which is used; exif=False (--no-exif) "
        "takes them to be equal."
    ]


def by_light(lights: Sequence[Hashable], exposures: Float[np.ndarray, " photographs"]) -> list[list[int]]:
    """Return the photographs of each view: one each, or all under one light if their exposures differ."""
    under: dict[Hashable, list[int]] = {}
    for i, light in enumerate(lights):
        under.setdefault(light, []).append(i)
    differ = [np.ptp(exposures[group]) > SLIGHT * exposures[group].max() for group in under.values()]
    views = [[group] if apart else [[i] for i in group] for group, apart in zip(under.values(), differ, strict=True)]
    return sorted(itertools.chain.from_iterable(views))
