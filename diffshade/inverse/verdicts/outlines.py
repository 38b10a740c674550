"""Outlines: whether photographs show the background inside the scene's silhouette, or the object outside of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from ...core.words import Note
from ...io.lazy_images import LazyImage
from ...model.gbuffers import GBuffer
from ...model.rendering import silhouette
from ...model.scenes import Scene
from ...model.surfaces import Sphere
from ..data.views import View, colours, has_mask
from ..result import Fit

BEYOND_NOISE = 1.5  # residuals over the photographs' own noise, from which outlines are looked at
ROWS = 256  # of a photograph at most, by which its noise is estimated
FAR = 3.0  # pixels from the outline, from which a photograph shows the background
BACKGROUND = 64  # pixels of it, at least
DARK = 5.0  # standard deviations above the background, within which a pixel looks like it
UNIFORM = 0.1  # of the object's brightness, by which the background varies at most
BLACK = 0.2  # of the object's brightness, which the background has at most
ALIKE = 0.98  # of the background, that is so
BORDER = 0.5  # of the outline, along which the background is inside
STEP = 0.15  # of the object's brightness, which it has right behind the background that is inside
STEEP = 0.6  # of the edge of that background, along which the object is so bright
OUTSIDE = 0.55  # of the brightness next to the outline inside, which the object has outside
THIN = 0.75  # pixels of background or object, below which an outline is right
WIDEST = 0.35  # of the largest depth, that the background reaches into the silhouette at most
LIKE = 0.5  # of the length of the outline, along which the object is outside

Mask = Bool[np.ndarray, "h w"]


@dataclass(frozen=True)
class WrongOutline:
    """Where the scene's silhouette is not the photographs'."""

    large: bool
    """Whether the background shows inside; else the object shows outside."""
    pixels: int
    width: float
    """How wide that border is, in pixels."""
    share: float
    """Along which part of the outline it is."""


def check_outlines(fit: Fit) -> Fit:
    """Return a fit that says where photographs without a mask show another outline than the scene's.

    With the background inside nothing is determined.
    """
    found = wrong_outline(fit)
    if found is None:
        return fit
    determined = fit.determined & (not found.large)
    return replace(fit, determined=determined, notes=(Note(said(fit.scene, found), "outline"), *fit.notes))


def wrong_outline(fit: Fit) -> WrongOutline | None:
    """Return how the silhouette differs from what the views without a mask show; None where it does not. In float64.

    Nothing is rendered but the silhouette. Where the residuals are no more than the photographs' noise all is well.
    """
    views = [v for v in fit.views if not has_mask(v) and not isinstance(v.image, LazyImage)]
    groups: list[list[View]] = []
    for view in views:
        same = next((g for g in groups if _same_camera(g[0], view)), None)
        groups.append([view]) if same is None else same.append(view)
    found = []
    for group in groups:
        inside = np.asarray(silhouette(fit.scene.objects, group[0].camera))
        if _unlike_noise(fit, group, inside):
            found.append(compare(inside, np.max([_brightness(view) for view in group], 0)))
    mapped = any(isinstance(item.surface, GBuffer) for item in fit.scene.objects)  # whose outline is a given mask
    usable = [f for f in found if f is not None and (f.large or not mapped)]
    return max(usable, key=lambda f: f.pixels, default=None)


def _same_camera(one: View, other: View) -> bool:
    return bool(eqx.tree_equal(*(jax.tree.map(np.asarray, view.camera) for view in (one, other))))


def _brightness(view: View) -> Float[np.ndarray, "h w"]:
    return (np.asarray(colours(view), np.float64).mean(-1) - float(view.black)) / float(view.exposure)


def _unlike_noise(fit: Fit, views: Sequence[View], inside: Mask) -> bool:
    """Whether the residuals are more than the noise, known or by second differences of the photographs' rows."""
    if fit.views[0].noise is not None:
        return fit.rmse > BEYOND_NOISE
    rows = np.unique(np.linspace(0, len(inside) - 1, ROWS).astype(int))
    three = inside[rows, 2:] & inside[rows, 1:-1] & inside[rows, :-2]
    if not three.any():
        return False
    bends = [np.diff(np.asarray(colours(view)[rows], np.float64), n=2, axis=1)[three] for view in views]
    noise = float(np.median([1.4826 * np.median(np.abs(b)) / np.sqrt(6.0) for b in bends]))
    return fit.rmse > BEYOND_NOISE * noise


def compare(inside: Mask, brightness: Float[np.ndarray, "h w"]) -> WrongOutline | None:
    """Compare a silhouette with the brightest of the photographs taken by one camera, pixel by pixel.

    It tells something only before a background that is dark and alike all over, beside the object.
    """
    if not inside.any() or inside.all():
        return None
    outside = np.asarray(ndimage.distance_transform_edt(~inside))
    depth = np.asarray(ndimage.distance_transform_edt(inside))
    bright = float(np.quantile(brightness[inside], 0.9))
    largest = float(depth.max())
    far = outside > max(FAR, 0.25 * largest)
    if far.sum() < BACKGROUND:
        return None
    level = float(np.median(brightness[far]))
    scatter = float(1.4826 * np.median(np.abs(brightness[far] - level)))
    light = bright - level
    alike = np.abs(brightness[far] - level) <= max(DARK * scatter, UNIFORM * light)
    if not light > 0 or level > BLACK * bright or scatter > UNIFORM * light or alike.mean() < ALIKE:
        return None
    dark = brightness <= level + max(DARK * scatter, 1e-3 * light)
    above = brightness - level
    return _too_large(inside, depth, dark, above, light) or _too_small(inside, depth, outside, above)


def _too_large(inside: Mask, depth: np.ndarray, dark: Mask, above: np.ndarray, light: float) -> WrongOutline | None:
    """Return where the background reaches into the silhouette, and the object begins at once behind it."""
    rim = inside & (depth < 1.5)
    # filled up over single pixels of noise
    closed: Any = ndimage.binary_closing(dark | ~inside, iterations=1, border_value=1)
    like = closed & inside
    labels = np.asarray(ndimage.label(like, np.ones((3, 3)))[0])  # pyright: ignore[reportIndexIssue]
    reached = np.unique(labels[rim & like])
    border = np.isin(labels, reached[reached > 0])
    share = float((border & rim).sum() / rim.sum())
    if share < BORDER:
        return None
    next_to = np.asarray(ndimage.binary_dilation(border, iterations=2)) & inside & ~border
    if not next_to.any() or float(np.mean(above[next_to] > STEP * light)) < STEEP:
        return None
    width = _width(depth[border])
    thin = width < WIDEST * float(depth.max())  # else it is the unlit side
    return WrongOutline(True, int(border.sum()), width, share) if width > THIN and thin else None


def _too_small(inside: Mask, depth: np.ndarray, outside: np.ndarray, above: np.ndarray) -> WrongOutline | None:
    """Return where the object goes on outside the silhouette nearly as bright as next to the outline inside."""
    nearest: Any = ndimage.distance_transform_edt(
        ~(inside & (depth > 1.5)), return_distances=False, return_indices=True
    )
    next_inside = np.maximum(above[nearest[0], nearest[1]], 0.0)
    ring = (outside > 0) & (outside < 1.5)
    shows = (above > OUTSIDE * next_inside) & (next_inside > 0.05 * float(np.quantile(above[inside], 0.9))) & ~inside
    labels = np.asarray(ndimage.label(shows)[0])  # pyright: ignore[reportIndexIssue]
    reached = np.unique(labels[ring & shows])
    border = np.isin(labels, reached[reached > 0])
    share = float((border & ring).sum() / ring.sum())
    width = _width(outside[border])
    return WrongOutline(False, int(border.sum()), width, share) if share > LIKE and width > THIN else None


def _width(distances: np.ndarray) -> float:
    """Return how wide a border is, from its pixels' distances to the nearest pixel beyond the outline, 1 and more."""
    return 2.0 * float(distances.mean()) - 1.0 if len(distances) else 0.0


def said(scene: Scene, found: WrongOutline) -> str:
    """Say what shows where, and the remedy."""
    (item, *more) = scene.objects
    sphere = isinstance(item.surface, Sphere) and not more
    what = f"objects.{item.name or 0}.surface.radius" if sphere else "an object"
    size = "too large" if found.large else "too small"
    wrong = f"{what} is {size} or its centre off" if sphere else f"{what} is {size} or not in its place"
    along = f"along {found.share:.0%} of the outline"
    if found.large:
        where = f"{found.pixels:,} pixels inside the outline are as dark as the background, {along}"
    else:
        where = f"{found.pixels:,} pixels outside the outline show the object, {along}"
    nothing = " Nothing is determined until that is corrected." if found.large else ""
    return (
        f"{where}: {wrong} by about {max(found.width, 1.0):.0f} px.{nothing} Measure it again, check the camera, or "
        f"give each View a mask and free {'it' if sphere else 'what is wrong'}."
    )
