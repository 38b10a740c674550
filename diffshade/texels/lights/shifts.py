"""Shifts: photographs that are moved in the picture, as by a shaken tripod, are told of and moved back."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from ...core.thresholds import FEW, MINOR, TINY
from ...core.words import Note, first_of
from ...inverse.data.samples import SensorRange, kept, top_of_view
from ...inverse.data.views import View, colours
from ...io.lazy_images import LazyImage
from ...model.rendering import silhouette
from ...model.scenes import Scene
from ...parallel.threads import ONE_BLAS_THREAD
from ..lighting import Shifts
from ..robust.choice import mean_error
from ..robust.learning import MIN_SAMPLES
from ..tiles import LEARNING_SAMPLE, SQUARE, TexelTile, ViewReader
from .placing import one_light_each
from .shift_search import found_shifts, pictures_of
from .taught import Taught


def without_shifts(first: Taught) -> Taught:
    """Return what the photographs teach with their shifts undone, the shifts, and a note.

    The search takes texels to be matte, and highlights that cover a flat object imitate shifts. So shifts are believed
    only if photographs that are moved back are predicted better by the others, when they are left out, than they were
    where they are; else what was taught first is returned.
    """
    moved, shifts, notes = undone_shifts(first.scene, first.views, first.sample)
    if shifts is None:
        return first
    found = first.under(first.scene, moved, sample=ViewReader(first.scene, moved).sample(LEARNING_SAMPLE))
    before, after = (mean_error(of.errors[shifts.undone]) for of in (first, found))
    return found._replace(shifts=shifts).noted(*notes) if before - after > MINOR else first


def undone_shifts(
    scene: Scene, views: Sequence[View], sample: TexelTile
) -> tuple[Sequence[View], Shifts | None, tuple[Note, ...]]:
    """Return the views with their shifts undone, the shifts, and notes; the views as they are where none is told.

    Each photograph must have one light of its own, and there must be eight or more. A shift is told if it is beyond
    three of its errors and half a pixel, and if without it the photograph is clearly farther from what the others show.

    Args:
        scene: One object and its lights.
        views: The photographs.
        sample: Texels of the object.
    """
    lights = one_light_each(scene, views)
    if lights is None or len(views) < FEW or len(sample.pixels) < MIN_SAMPLES:
        return views, None, ()
    intensity = np.array([np.ones(3) * np.asarray(getattr(scene.lights[i], "intensity", 1.0)) for i in lights.used])
    mask = np.asarray(silhouette(scene.objects, views[0].camera)) & np.any([kept(view) for view in views], 0)
    pictures = pictures_of(views, np.maximum(intensity, TINY), sample, mask)
    with ONE_BLAS_THREAD:
        found = found_shifts(pictures, lights.directions)
    if found is None:
        return views, None, ()
    each = zip(views, found.pixels, found.undone, strict=True)
    moved = [_moved_back(view, by) if undone else view for view, by, undone in each]
    text = (
        f"photographs are shifted: {_named(found)}. This was found from the object and undone; align=False, or "
        "--no-align, takes them as they are."
    )
    return moved, found, (Note(text, "shift"),)


def _named(found: Shifts) -> str:
    """Return in words which photographs are shifted most, and how far."""
    far = np.linalg.norm(found.pixels, axis=-1) * found.undone

    def by(x: float, y: float) -> str:
        return f"{abs(x):.1f} to the {'right' if x > 0.0 else 'left'} and {abs(y):.1f} {'down' if y > 0.0 else 'up'}"

    most = np.argsort(-far, kind="stable")[: found.undone.sum()]
    named = first_of([f"views[{v}] by {by(*found.pixels[v])}" for v in most])
    return f"{named}, pixels, within {np.median(found.error[found.undone]):.1f}"


def _moved_back(view: View, by: Float[np.ndarray, "2"]) -> View:
    """Return a view whose image is moved back by some pixels to the right and down, and the mask stays.

    What comes from outside the image, or from samples that the sensor clipped, does not count.
    """
    height, width = view.camera.shape
    seen, inside = colours(view), kept(view)
    ends, (right, down) = SensorRange.of(view, top_of_view(view)), by
    margin = int(np.ceil(abs(down))) + SQUARE  # beyond it, cubic splines give nothing

    def moved(rows: np.ndarray, order: int) -> np.ndarray:
        return ndimage.shift(rows, (-down, -right, 0.0), order=order, mode="nearest")

    def read(first: int, last: int) -> np.ndarray:
        above = max(first - margin, 0)
        rows = np.nan_to_num(seen[above : min(last + margin, height)], posinf=0.0, neginf=0.0)
        return moved(rows, 3)[first - above : last - above].astype(view.image.dtype)

    row, column = (np.arange(n) + of for n, of in ((height, down), (width, right)))
    counts = inside & ((row >= 0) & (row <= height - 1))[:, None] & ((column >= 0) & (column <= width - 1))
    if isinstance(seen, LazyImage):
        clipped = [(ends.clipped(rows) != 0).any(-1) for _, rows in seen.tiles()]
        image = LazyImage(read, seen.shape, view.image.dtype)
    else:
        clipped, image = [(ends.clipped(seen) != 0).any(-1)], read(0, height)
    near = ndimage.binary_dilation(np.concatenate(clipped), iterations=2)
    counts &= moved(near[..., None].astype(np.float32), 1)[..., 0] <= 0.0
    return dataclasses.replace(view, image=image, mask=counts)
