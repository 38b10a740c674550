"""Outlines: whether photographs show the background inside the scene's silhouette, or the object outside of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from ...core.masks import Mask
from ...core.progress import ReportProgress, silent
from ...core.robust_scale import OUTLIER, robust_scale
from ...core.thresholds import BLACK, CLEARLY, MINOR, MOST, SMALL
from ...core.words import Note
from ...io.lazy_images import LazyImage
from ...model.gbuffers import GBuffer
from ...model.rendering import silhouette
from ...model.scenes import Scene
from ...model.surfaces import Sphere
from ...parallel.threads import on_all_cores
from ..data.recording import developed
from ..data.views import View, camera_key, colours, has_alpha
from ..result import Fit

ROWS = 48  # most rows of an object from which the noise of a photograph is estimated
FAR = 3.0  # pixels: the least distance of background pixels from the outline
BACKGROUND = 64  # the fewest background pixels
STEP = 0.15  # the least brightness of the object right behind that background, over its usual brightness
OUTSIDE = 0.55  # the least brightness outside the outline, over that just inside: at a blurred edge it is a half
THIN = 0.75  # pixels: the outline is right if the border is narrower
WIDEST = 0.35  # the widest border of background, over the silhouette's largest depth: else it is the unlit side


@dataclass(frozen=True)
class WrongOutline:
    """A border along which the scene's silhouette differs from the object in the photographs."""

    large: bool
    """Whether the silhouette is too large, with background inside; otherwise the object extends beyond it."""
    pixels: int
    width: float
    """The width of the border in pixels."""
    share: float
    """The share of the outline that has this border."""
    by_alpha: bool = False
    """Whether an alpha channel says so."""


def check_outlines(fit: Fit, _: ReportProgress = silent) -> Fit:
    """Return a fit with a note if photographs without a mask, or their alpha, contradict the scene's outline.

    If background lies inside the outline, nothing is determined.
    """
    found = wrong_outline(fit)
    if found is None:
        return fit
    determined = fit.determined & (not found.large or found.by_alpha)
    return replace(fit, determined=determined, notes=(Note(said(fit.scene, found), "outline"), *fit.notes))


def wrong_outline(fit: Fit) -> WrongOutline | None:
    """Return how the silhouette differs from what the views without a mask show; None where it does not. In float64.

    Of such views all pixels in the silhouette are looked at. If the residuals do not exceed the photographs' noise, the
    outline is right.
    """
    groups: dict[Any, tuple[Mask, list[View]]] = {}
    for view, samples in zip(fit.views, fit.solved.problem.data.samples, strict=True):
        if view.mask is None and not isinstance(view.image, LazyImage):
            inside = np.asarray(silhouette(fit.scene.objects, view.camera)) if has_alpha(view) else samples.inside
            groups.setdefault((camera_key(view.camera), has_alpha(view)), (inside, []))[1].append(view)
    found = []
    for (_, by_alpha), (inside, group) in groups.items():
        noise = 1.0 if fit.views[0].noise is not None else noise_of(group, inside)
        if fit.rmse > CLEARLY * noise:
            shown = [np.asarray(view.image)[..., -1] if by_alpha else _brightness(view) for view in group]
            found.append(compare(inside, np.max(shown, 0), by_alpha=by_alpha))
    mapped = any(isinstance(item.surface, GBuffer) for item in fit.scene.objects)  # whose outline is a given mask
    usable = [f for f in found if f is not None and (f.large or not mapped)]
    return max(usable, key=lambda f: f.pixels, default=None)


def _brightness(view: View) -> Float[np.ndarray, "h w"]:
    linear = developed(view)
    return (np.asarray(colours(linear), np.float64).mean(-1) - float(view.black)) / float(view.exposure)


def noise_of(views: Sequence[View], inside: Mask) -> float:
    """Return the noise of photographs by second differences along rows of an object; infinity where it has none."""
    if not inside.any():
        return np.inf
    on_object = np.flatnonzero(inside.any(1))
    rows = on_object[np.unique(np.linspace(0, len(on_object) - 1, ROWS).astype(int))]
    three = inside[rows, 2:] & inside[rows, 1:-1] & inside[rows, :-2]
    if not three.any():
        return np.inf

    def scatter(view: View) -> float:
        bends = np.diff(np.asarray(colours(view)[rows], np.float64), n=2, axis=1)[three]
        return float(robust_scale(bends) / np.sqrt(6.0))

    return float(np.median(on_all_cores(scatter, views)))


def compare(inside: Mask, brightness: Float[np.ndarray, "h w"], *, by_alpha: bool = False) -> WrongOutline | None:
    """Compare a silhouette with the brightest of the photographs taken by one camera, or their alpha, pixel by pixel.

    This works only if the background is uniform, and dark compared with the object.
    """
    if not inside.any() or inside.all():
        return None
    outside = np.asarray(scipy.ndimage.distance_transform_edt(~inside))
    depth = np.asarray(scipy.ndimage.distance_transform_edt(inside))
    bright = float(np.quantile(brightness[inside], 0.9))
    largest = float(depth.max())
    far = outside > max(FAR, 0.25 * largest)
    if far.sum() < BACKGROUND:
        return None
    level = float(np.median(brightness[far]))
    scatter = robust_scale(brightness[far] - level)
    light = bright - level
    alike = np.abs(brightness[far] - level) <= max(OUTLIER * scatter, SMALL * light)
    if not light > 0 or level > BLACK * bright or scatter > SMALL * light or alike.mean() < (1.0 - MINOR):
        return None
    dark = brightness <= level + max(OUTLIER * scatter, 1e-3 * light)
    above = brightness - level
    found = _too_large(inside, depth, dark, above, light) or _too_small(inside, depth, outside, above)
    return found and replace(found, by_alpha=by_alpha)


def _too_large(inside: Mask, depth: np.ndarray, dark: Mask, above: np.ndarray, light: float) -> WrongOutline | None:
    """Return the border where background reaches into the silhouette, if the object begins right behind it."""
    rim = inside & (depth < 1.5)
    # filled up over single pixels of noise
    closed: Any = scipy.ndimage.binary_closing(dark | ~inside, iterations=1, border_value=1)
    like = closed & inside
    border = np.asarray(scipy.ndimage.binary_propagation(rim & like, np.ones((3, 3)), mask=like))
    share = float((border & rim).sum() / rim.sum())
    if share < MOST:
        return None
    next_to = np.asarray(scipy.ndimage.binary_dilation(border, iterations=2)) & inside & ~border
    if not next_to.any() or float(np.mean(above[next_to] > STEP * light)) < MOST:
        return None
    width = _width(depth[border])
    wrong = THIN < width < WIDEST * float(depth.max())
    return WrongOutline(True, int(border.sum()), width, share) if wrong else None


def _too_small(inside: Mask, depth: np.ndarray, outside: np.ndarray, above: np.ndarray) -> WrongOutline | None:
    """Return the border where the object continues outside the silhouette, nearly as bright as just inside it."""
    nearest: Any = scipy.ndimage.distance_transform_edt(
        ~(inside & (depth > 1.5)), return_distances=False, return_indices=True
    )
    next_inside = np.maximum(above[nearest[0], nearest[1]], 0.0)
    ring = (outside > 0) & (outside < 1.5)
    shows = (above > OUTSIDE * next_inside) & (next_inside > 0.05 * float(np.quantile(above[inside], 0.9))) & ~inside
    border = np.asarray(scipy.ndimage.binary_propagation(ring & shows, mask=shows))
    share = float((border & ring).sum() / ring.sum())
    width = _width(outside[border])
    return WrongOutline(False, int(border.sum()), width, share) if share > MOST and width > THIN else None


def _width(distances: np.ndarray) -> float:
    """Return the width of a border, given its pixels' distances (at least 1) to the nearest one across the outline."""
    return 2.0 * float(distances.mean()) - 1.0 if len(distances) else 0.0


def said(scene: Scene, found: WrongOutline) -> str:
    """Say what shows where, and the remedy."""
    (item, *more) = scene.objects
    sphere = isinstance(item.surface, Sphere) and not more
    what = f"objects.{item.name or 0}.surface.radius" if sphere else "an object"
    size = "too large" if found.large else "too small"
    wrong = f"{what} is {size}, or the sphere is out of place," if sphere else f"{what} is {size} or out of place,"
    along = f"along {found.share:.0%} of the outline"
    if found.large:
        background = "transparent" if found.by_alpha else "as dark as the background"
        where = f"{found.pixels:,} pixels inside the outline are {background}, {along}"
    else:
        where = f"{found.pixels:,} pixels outside the outline show the object, {along}"
    nothing = " Nothing is determined until that is corrected." if found.large and not found.by_alpha else ""
    return (
        f"{where}: {wrong} by about {max(found.width, 1.0):.0f} px.{nothing} Measure it again, check the camera, its "
        f"fov too, or give each View a mask and free {'it' if sphere else 'the wrong parameter'}."
    )
