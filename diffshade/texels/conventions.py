r"""Conventions: lights in other axes or in another order than the photographs, where the normals are unknown.

A matte texel has b = k_d n (Woodham 1980). In another order of the lights no b explains the photographs; what is not
matte, `random_orders` judges. In other axes A b explains them as well as b does; but the normals of a thing face the
camera, point outward at its outline, and are those of a surface:

$$ \partial_y (b_1 / b_3) = \partial_x (b_2 / b_3) $$
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.ndimage import binary_erosion, binary_fill_holes, gaussian_filter

from ..core.robust_scale import robust_scale
from ..core.thresholds import BLACK, CLEARLY, FAR_MORE, FEW, MINOR, MOST, SLIGHT, SMALL, TINY
from ..core.words import Note
from ..inverse.data.views import View
from ..inverse.misfit.conventions import axes_in_words, orders, other_axes
from ..model.cameras import axes
from ..model.scenes import Scene
from ..model.vectors import Vec3
from .light_directions import MIN_SPREAD
from .lights.matte import SIGMA, Surface, cells_of, surface_under
from .lights.placing import one_light_each
from .random_orders import random_order_is_as_good
from .tiles import SAMPLED_ROWS, TexelTile, ViewReader


def other_light_convention(scene: Scene, views: Sequence[View], reader: ViewReader, sample: TexelTile) -> Note | None:
    """Return a sentence if the lights are described in other axes, or listed in another order, than the photographs.

    Nothing is said of fewer than eight photographs, nor where several lights are on, nor of axes where all are close to
    each other or to one plane, or where several explain the photographs. If no outline tells whether the object
    bulges, two descriptions are named, of which one is right. An order that is none of the usual ones is not found:
    it is said that one in random order is as good.

    Args:
        scene: The scene.
        views: The photographs.
        reader: What reads them.
        sample: Texels from all over the object.
    """
    lights = one_light_each(scene, views)
    if lights is None or len(views) < FEW or not len(sample.pixels):
        return None
    towards, middle = lights.directions, Vec3.of(lights.middle)
    power = np.array([np.mean(scene.lights[i].arriving(middle)[1].stack()) for i in lights.used])
    off_plane = np.linalg.svd(towards, compute_uv=False)[2] / np.sqrt(len(views))
    cells = cells_of(views, reader, sample, SAMPLED_ROWS, np.ones((len(views), 1)))  # whatever light each is given
    given, found = surface_under(cells, towards, power), None
    if given.tells and off_plane >= MIN_SPREAD:
        camera = np.array([np.asarray(axis.stack()) for axis in axes(reader.camera)])
        alone = len({view.lit for view in views}) == len(views)
        others = [(surface_under(cells, towards[k], power[k]), words) for words, k in orders(len(views)) if alone]
        moved = [(_doubt(surface, camera), words) for surface, words in others if surface.tells]
        found = _described_otherwise(given, moved, camera)
    shown = (cells.seen[:, cells.inside], cells.counts[:, cells.inside])
    if found is None and random_order_is_as_good(*shown, towards, power):
        found = (
            "the photographs do not belong to their lights: listed in a random order, the lights agree with them as "
            "well. Check the order of the lights and of the photographs"
        )
    if found is None:
        return None
    return Note(f"{found}. Nothing is determined until it is corrected.", "cause", ("convention",))


def _described_otherwise(
    given: Surface, moved: Sequence[tuple[float, str]], camera: Float[np.ndarray, "3 3"]
) -> str | None:
    """Return in words in which axes, or in which of the usual orders, the lights are those of a thing, if in one only.

    Args:
        given: What the photographs say of the shape under the lights as they are given.
        moved: The doubt that the usual other orders leave, and their sentences.
        camera: The axes of the camera.
    """
    others = [(_doubt(given, camera @ A), A, axes_in_words(A)) for A in other_axes()]
    others += [(of, None, words) for of, words in moved]
    best = min(of for of, *_ in others)
    as_good = [(A, words) for of, A, words in others if of < CLEARLY * best]
    turned = [A for A, _ in as_good if A is not None]
    stands_out = FAR_MORE**3 if turned else FAR_MORE**2  # other axes leave the photographs explained as they were
    if best > SMALL or _doubt(given, camera) < max(stands_out * best, SMALL**2):  # a sum of squares of shares
        return None
    half_turn = camera.T @ np.diag([-1.0, -1.0, 1.0]) @ camera
    if len(as_good) == 1:
        found = as_good[0][1]
    elif len(as_good) == len(turned) == 2 and np.allclose(half_turn @ turned[0], turned[1]):
        found = axes_in_words(*turned)
    else:
        return None
    inside_out = any(np.allclose(A, half_turn) for A in turned)
    return f"{found}{', unless the object is hollow at its outline' if inside_out else ''}"


def _doubt(surface: Surface, A: Float[np.ndarray, "3 3"]) -> float:
    """Return how little a surface is that of a thing, in the axes to which A turns it: a sum of four squared shares.

    They are the misfit of the photographs, the curl of the surface, the share of the normals that face away from the
    camera, and whether those at an outline point neither outward nor inward, as in a hollow, which shades itself.
    """
    # b x its slopes: other axes A change them as they change b, but for the sign of both
    square = np.maximum((surface.smooth**2).sum(-1, keepdims=True), TINY)
    along_x, along_y = (np.cross(surface.smooth, by) / square for by in (surface.by_x, surface.by_y))
    size = np.sqrt(np.sum(along_x**2 + along_y**2, -1))
    flat = 3.0 * SLIGHT  # from cell to cell: less than that, noise alone turns normals
    curl = robust_scale(along_x @ A[0] + along_y @ A[1]) / max(robust_scale(size), flat)
    away = np.mean(surface.b[surface.inside] @ A[2] <= 0.0)
    return float(surface.misfit**2 + curl**2 + away**2 + _misled(surface, A))


def _misled(surface: Surface, A: Float[np.ndarray, "3 3"]) -> bool:
    """Whether the normals at the outline point neither outward nor inward, or inward where no hollow shades itself."""
    inside = surface.inside
    edge = np.greater(inside, binary_erosion(inside, border_value=1))  # the picture's end is no outline
    normal = (_unit(surface.b[edge]) @ A.T)[:, :2]
    steep = np.linalg.norm(normal, axis=-1) > 1.0 - BLACK  # elsewhere a mask's border is no outline
    if steep.sum() <= MOST * len(steep):
        return False
    down, right = np.gradient(gaussian_filter(inside.astype(float), SIGMA))
    outward = np.mean(np.sum(normal * _unit(np.stack([-right, down], -1)[edge]), -1)[steep])
    return bool(abs(outward) < BLACK or (outward < -MOST and _cast(surface) < MINOR))


def _cast(surface: Surface) -> float:
    """Return the share of dark cells among those on which a lamp should graze, since a hollow shades itself."""
    b, inside = surface.b[surface.inside], surface.inside
    shading = surface.s @ b.T
    grazed = surface.counts & (np.abs(shading / np.maximum(np.linalg.norm(b, axis=-1), TINY) - BLACK) < SMALL)
    ring = (binary_fill_holes(inside) != inside).any()  # a groove is too narrow to shade itself much
    return float(np.mean((surface.y < MOST * shading)[grazed])) if grazed.any() and not ring else 1.0


def _unit(vectors: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "n c"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), TINY)
