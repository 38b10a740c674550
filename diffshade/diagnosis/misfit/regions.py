"""Regions: where photographs are darker than any light that reaches them allows, or brighter at an object's rim."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from ...inverse.data.samples import Samples
from ...inverse.data.views import View, is_grey
from ...inverse.result import Fit
from ...model.cameras import AbstractCamera, Projection
from ...model.rendering import render, visible_points
from ...model.scenes import Object
from ...model.vectors import Vec3, dot

Mask = Bool[np.ndarray, "h w"]
Picture = Float[np.ndarray, "h w"]

DARK = 0.4  # of a light's own part of the prediction: a photograph that shows less is dark there
SHADED = 0.25  # what the median pixel of a cast shadow shows at most
CLEAR = 6.0  # standard deviations of the residuals that a light's part must be to be missed
BRIGHT = 0.1  # of a light's brightest part: where it shines less, darkness is no shadow
LEAST = 0.003  # of a view's pixels, and at least FEWEST: the smallest shadow that is told
FEWEST = 12
GRAZING = 0.35  # n.v below which a pixel belongs to the rim
SECTORS = 8  # of a rim, whose excesses are compared


@dataclass(frozen=True, eq=False)
class Seen:
    """A view's photograph beside a prediction, the channels' mean, and the pixels that can be compared."""

    photograph: Picture
    predicted: Picture
    counts: Mask

    @property
    def excess(self) -> Picture:
        """Photograph - prediction where it counts, else 0."""
        return np.where(self.counts, self.photograph - self.predicted, 0.0)

    @property
    def noise(self) -> float:
        """The residuals' standard deviation, by the median of their size."""
        return float(1.4826 * np.median(np.abs(self.excess[self.counts]))) if self.counts.any() else 0.0


@dataclass(frozen=True, eq=False)
class Shadow:
    """A connected region of a view that some of its lights do not reach."""

    lights: tuple[int, ...]
    mask: Mask
    shown: float
    """Which part of these lights' prediction its median pixel shows."""


@dataclass(frozen=True, eq=False)
class Rim:
    """What a rim shows beyond the prediction."""

    excess: float
    """The mean over its sectors."""
    errors: float
    """Standard errors of that mean, from how the sectors differ."""
    positive: float
    """Which part of the views has a brighter rim."""
    relative: float
    """The excess over the mean brightness of the object."""


def predicted(fit: Fit, view: View, lit: Sequence[int] | None) -> Picture:
    """Return the mean of the channels that a fit predicts with these lights on."""
    image = np.asarray(render(fit.scene, view.camera, lit=lit)).mean(-1)
    return float(view.exposure) * image + float(view.black)


def see(fit: Fit, view: View, samples: Samples, out: Mask | None) -> Seen:
    """Return a view beside its prediction; samples clipped at the top of the range, and pixels left out, do not count.

    Those clipped at the bottom do: a shadow may be there.
    """
    photograph = samples.whole()
    photograph = (photograph[..., 0] if is_grey(view) else photograph.mean(-1)).astype(np.float64)
    counts = np.zeros(photograph.shape, bool)
    counts.reshape(-1)[samples.pixels] = (samples.ends() <= 0).all(-1)
    if out is not None:
        counts &= ~out
    return Seen(np.where(counts, photograph, 0.0), predicted(fit, view, view.lit), counts)


def level(seen: Seen, black: float) -> float:
    """Return how bright the median pixel is over its prediction, of those that are predicted to be bright; else 1."""
    light = np.where(seen.counts, seen.predicted - black, 0.0)
    if not light.any():
        return 1.0
    bright = light > 0.3 * float(np.quantile(light[seen.counts], 0.95))
    if not bright.any():
        return 1.0
    return max(float(np.median((seen.photograph - black)[bright] / light[bright])), 1e-9)


def cast_shadows(seen: Seen, unlit: Mapping[tuple[int, ...], Picture]) -> list[Shadow]:
    """Return the regions that lights do not reach though they face them; `unlit`: the prediction without these lights.

    There the photograph shows less than DARK of the lights' own part, and does not miss more than that, where the part
    is clear of the noise and not small beside what it is elsewhere; a region is connected and has a pixel whose
    neighbours are all in it. Of regions that overlap, the one whose lights are missing most exactly is told.
    """
    found = []
    least = max(FEWEST, LEAST * seen.counts.sum())
    for lights, without in unlit.items():
        part = np.where(seen.counts, seen.predicted - without, 0.0)
        if not part.any():  # it shines nowhere that counts
            continue
        clear = part > max(CLEAR * seen.noise, BRIGHT * float(np.quantile(part[seen.counts], 0.95)))
        shown = np.where(clear, (seen.photograph - without) / np.where(clear, part, 1.0), 1.0)
        dark = np.abs(shown) < DARK if len(unlit) > 1 else shown < DARK
        labels = np.asarray(ndimage.label(dark)[0])  # pyright: ignore[reportIndexIssue]
        count = int(labels.max())
        for label in range(1, count + 1):
            mask = labels == label
            if mask.sum() < least or not ndimage.binary_erosion(mask, np.ones((3, 3))).any():
                continue
            if (median := float(np.median(shown[mask]))) < SHADED:
                found.append(Shadow(lights, mask, median))
    kept: list[Shadow] = []
    for shadow in sorted(found, key=lambda s: abs(s.shown)):
        if not any((shadow.mask & other.mask).sum() > 0.5 * shadow.mask.sum() for other in kept):
            kept.append(shadow)
    return kept


def rims(objects: tuple[Object, ...], camera: AbstractCamera) -> tuple[Mask, np.ndarray]:
    """Return the pixels whose surface is seen at a grazing angle, n.v < GRAZING, and the sector of each pixel."""
    n_v = np.asarray(_n_v(objects, camera))
    inside = n_v > -np.inf
    row, column = np.mgrid[: inside.shape[0], : inside.shape[1]]
    middle = [float(x[inside].mean()) if inside.any() else 0.0 for x in (row, column)]
    angle = np.arctan2(row - middle[0], column - middle[1])
    return inside & (n_v < GRAZING), np.floor((angle / (2 * np.pi) + 0.5) * SECTORS).astype(int) % SECTORS


def measure_rim(views: Iterable[tuple[Seen, Mask, np.ndarray]]) -> Rim | None:
    """Return by how much rims are brighter than predicted; None where too little of them is seen."""
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


@jax.jit
def _n_v(objects: tuple[Object, ...], camera: AbstractCamera) -> jax.Array:
    """Return n.v of every pixel; -inf where there is no surface."""
    normal, position, inside = visible_points(objects, camera)
    projection: Projection = camera.projection()
    n_v = dot(Vec3.of(normal), projection.viewer(None if position is None else Vec3.of(position)))
    return jax.numpy.where(inside, n_v, -jax.numpy.inf)


def center_of(objects: tuple[Object, ...], camera: AbstractCamera) -> Float[np.ndarray, "3"]:
    """Return the mean of the points that a camera sees; the origin where they are not known."""
    _, position, inside = visible_points(objects, camera)
    inside = np.asarray(inside)
    return np.zeros(3) if position is None or not inside.any() else np.asarray(position)[inside].mean(0)
