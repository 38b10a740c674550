"""Regions: cast shadows, where photographs miss the light that is predicted, and rims brighter than predicted."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from ...core.backend import SOONER, jit_quickly
from ...core.masks import Mask
from ...core.robust_scale import robust_scale
from ...core.thresholds import SMALL
from ...model.cameras import AbstractCamera, Projection
from ...model.rendering import pixel_rays, visible_points
from ...model.scenes import Object
from ...model.surfaces import Sphere
from ...model.vectors import Vec3, dot
from ..data.recording import photograph
from ..data.samples import MIN_PILE, Samples
from ..data.views import View
from ..result import Fit

Picture = Float[np.ndarray, "h w"]

DARK_SHARE = 0.4  # a pixel is dark if it shows less than this fraction of a light's contribution
SHADED_SHARE = 0.25  # the most that the median pixel of a cast shadow shows of a light's contribution
CLEAR_SIGMAS = 6.0  # standard deviations of the residuals: the least contribution for a shadow
MIN_SHADOW_SHARE = 0.003  # the smallest shadow as a fraction of a view's pixels, but at least MIN_PILE
GRAZING_COSINE = 0.35  # n.v below which a pixel belongs to the rim
SECTORS = 8  # number of sectors of a rim, whose excesses are compared


@dataclass(frozen=True, eq=False)
class MeanPrediction:
    """A view's photograph and its prediction, the mean of the channels, and the pixels that can be compared."""

    photograph: Picture
    predicted: Picture
    counts: Mask

    @property
    def excess(self) -> Picture:
        """Photograph - prediction; 0 for a pixel that does not count."""
        return np.where(self.counts, self.photograph - self.predicted, 0.0)

    @property
    def noise(self) -> float:
        """The residuals' standard deviation, by the median of their absolute values."""
        return robust_scale(self.excess[self.counts]) if self.counts.any() else 0.0


@dataclass(frozen=True, eq=False)
class Shadow:
    """A connected region of a view that some of the lights do not reach."""

    lights: tuple[int, ...]
    mask: Mask
    shown: float
    """The fraction of these lights' contribution that the median pixel shows."""


@dataclass(frozen=True, eq=False)
class Rim:
    """The brightness of the rims above the prediction."""

    excess: float
    """The mean over the sectors."""
    errors: float
    """That mean in standard errors, by the scatter of the sectors."""
    positive: float
    """The fraction of the views with a brighter rim."""
    relative: float
    """The excess over the mean brightness of the object."""


def predicted(fit: Fit, view: View, lit: Sequence[int] | None) -> Picture:
    """Return a fit's prediction with these lights on, the mean of the channels."""
    return photograph(fit.scene, replace(view, lit=lit)).mean(-1)


def see(fit: Fit, view: View, samples: Samples, excluded: Mask | None) -> MeanPrediction:
    """Return a view and its prediction; excluded pixels and samples clipped at the top of the range do not count.

    Samples clipped at the bottom count: they may be in a shadow.
    """
    shown = samples.photograph[:].astype(np.float64).mean(-1)
    counts = np.zeros(shown.shape, bool)
    counts.reshape(-1)[samples.pixels] = (samples.ends() <= 0).all(-1)
    if excluded is not None:
        counts &= ~excluded
    return MeanPrediction(np.where(counts, shown, 0.0), predicted(fit, view, view.lit), counts)


def cast_shadows(seen: MeanPrediction, unlit: Mapping[tuple[int, ...], Picture]) -> list[Shadow]:
    """Return the regions that face some lights but are not reached by them.

    In a shadow the photograph shows less than DARK_SHARE of the lights' contribution, and lacks no more than all of it.
    Only pixels count whose contribution is well above the noise and not small compared with its brightest. A region is
    connected, and has a pixel with all of its neighbours inside. Of overlapping regions the one is kept whose missing
    light matches best.

    Args:
        seen: The photograph and its prediction.
        unlit: The prediction without some lights, for each set of lights to test.
    """
    found = []
    least = max(MIN_PILE, MIN_SHADOW_SHARE * seen.counts.sum())
    for lights, without in unlit.items():
        part = np.where(seen.counts, seen.predicted - without, 0.0)
        if not part.any():  # these lights reach no pixel that counts
            continue
        clear = part > max(CLEAR_SIGMAS * seen.noise, SMALL * float(np.quantile(part[seen.counts], 0.95)))
        shown = np.where(clear, (seen.photograph - without) / np.where(clear, part, 1.0), 1.0)
        dark = np.abs(shown) < DARK_SHARE if len(unlit) > 1 else shown < DARK_SHARE
        labels, count = ndimage.label(dark)  # pyright: ignore[reportGeneralTypeIssues]
        for mask in (labels == label for label in range(1, count + 1)):
            if mask.sum() < least or not ndimage.binary_erosion(mask, np.ones((3, 3))).any():
                continue
            if (median := float(np.median(shown[mask]))) < SHADED_SHARE:
                found.append(Shadow(lights, mask, median))
    kept: list[Shadow] = []
    for shadow in sorted(found, key=lambda s: abs(s.shown)):
        if not any((shadow.mask & other.mask).sum() > 0.5 * shadow.mask.sum() for other in kept):
            kept.append(shadow)
    return kept


def rims(objects: tuple[Object, ...], camera: AbstractCamera) -> tuple[Mask, np.ndarray]:
    """Return the pixels at a grazing angle, n.v < GRAZING_COSINE, and the sector of each pixel."""
    seen = seen_points(objects, camera)
    inside = seen.inside
    row, column = np.mgrid[: inside.shape[0], : inside.shape[1]]
    middle = [float(x[inside].mean()) if inside.any() else 0.0 for x in (row, column)]
    angle = np.arctan2(row - middle[0], column - middle[1])
    return seen.grazing, np.floor((angle / (2 * np.pi) + 0.5) * SECTORS).astype(np.int8) % SECTORS


def measure_rim(views: Iterable[tuple[MeanPrediction, Mask, np.ndarray]]) -> Rim | None:
    """Return the excess brightness of the rims; None if too little of them is visible."""
    excesses, by_view, brightness = [], [], []
    for seen, rim, sector in views:
        rim = rim & seen.counts
        parts = [part for s in range(SECTORS) if (part := rim & (sector == s)).sum() >= 3]
        if len(parts) < SECTORS // 2:
            continue
        found = [float(seen.excess[part].mean()) for part in parts]
        excesses += found
        by_view.append(float(np.mean(found)))
        brightness.append(float(seen.photograph[seen.counts].mean()))
    if not by_view or not np.mean(brightness) > 0:
        return None
    mean, spread = float(np.mean(excesses)), float(np.std(excesses, ddof=1))
    errors = mean / (spread / np.sqrt(len(excesses))) if spread > 0 else 0.0
    return Rim(mean, errors, float(np.mean(np.array(by_view) > 0)), mean / float(np.mean(brightness)))


class SeenPoints(NamedTuple):
    """What a camera sees at each pixel."""

    normal: Float[np.ndarray, "h w 3"]
    position: Float[np.ndarray, "h w 3"] | None
    inside: Bool[np.ndarray, "h w"]
    n_v: Float[np.ndarray, "h w"]
    """-inf without a surface."""
    ray: Float[np.ndarray, "h w 3"]
    """The unit direction of the ray through the centre of the pixel."""

    @property
    def grazing(self) -> Mask:
        """The pixels that show a surface at a grazing angle."""
        return self.inside & (self.n_v < GRAZING_COSINE)


def seen_points(objects: tuple[Object, ...], camera: AbstractCamera) -> SeenPoints:
    """Return what a camera sees of objects. All that faults need of it is one program, which is compiled once."""
    return jax.tree.map(np.asarray, _seen_points(objects, camera))


@partial(jit_quickly, options=SOONER)
def _seen_points(objects: tuple[Object, ...], camera: AbstractCamera) -> SeenPoints:
    normal, position, inside = visible_points(objects, camera)
    projection: Projection = camera.projection()
    n_v = dot(Vec3.of(normal), projection.viewer(None if position is None else Vec3.of(position)))
    ray = pixel_rays(projection, camera.shape).direction.stack()
    found: Any = normal, position, inside, jnp.where(inside, n_v, -jnp.inf), ray  # arrays of JAX, not yet the host's
    return SeenPoints(*found)


def center_of(objects: tuple[Object, ...], camera: AbstractCamera) -> Float[np.ndarray, "3"]:
    """Return the centre of a sphere, or the mean of the points that a camera sees; the origin if they are unknown."""
    if len(objects) == 1 and isinstance(objects[0].surface, Sphere):
        return np.asarray(objects[0].surface.center)
    seen = seen_points(objects, camera)
    return np.zeros(3) if seen.position is None or not seen.inside.any() else seen.position[seen.inside].mean(0)
