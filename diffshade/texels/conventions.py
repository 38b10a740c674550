r"""Conventions: lights in other axes or in another order than the photographs, where the normals are unknown.

A matte texel has b = k_d n (Woodham 1980). In another order of the lights no b explains the photographs; what is not
matte, `random_orders` judges. In other axes A b explains them as well as b does; but the normals of a thing face the
camera, point outward at its outline, and are those of a surface:

$$ \partial_y (b_1 / b_3) = \partial_x (b_2 / b_3) $$
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from scipy.ndimage import binary_erosion, binary_fill_holes, gaussian_filter

from ..core.fields import Array
from ..core.robust_scale import robust_scale
from ..core.thresholds import BLACK, CLEARLY, FAR_MORE, FEW, MINOR, MOST, SLIGHT, SMALL, TINY
from ..core.words import Note
from ..inverse.data.views import View
from ..inverse.misfit.conventions import axes_in_words, orders, other_axes
from ..model.cameras import axes
from ..model.lights import AbstractEmitter
from ..model.scenes import Scene
from ..model.vectors import Vec3
from .light_directions import MIN_SPREAD
from .lights.matte import SIGMA, Cells, cells_of, surface_under
from .lights.placing import one_light_each
from .random_orders import random_order_is_as_good
from .tiles import SAMPLED_ROWS, TexelTile, ViewReader


class _Shape(NamedTuple):
    """What the photographs say of the object's shape under lights of some order, in the axes of the lights."""

    misfit: float
    """Typical residual of a cell, relative to its brightness."""
    b: Float[np.ndarray, "n 3"]
    curl: tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]
    """b x its slope along x, and up: other axes A change them as they change b, but for the sign of both."""
    edge: Float[np.ndarray, "k 3"]
    """The unit normals at the outline."""
    outward: Float[np.ndarray, "k 2"]
    """Unit vectors that point out of it, right and up."""
    cast: float
    """The share of dark cells among those on which a lamp should graze, since a hollow shades itself; of a ring 1."""


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
    power = np.array([np.mean(_arriving(scene.lights[i], middle)) for i in lights.used])
    off_plane = np.linalg.svd(towards, compute_uv=False)[2] / np.sqrt(len(views))
    cells = cells_of(views, reader, sample, SAMPLED_ROWS, np.ones((len(views), 1)))  # whatever light each is given
    given, found = _shape(cells, towards, power), None
    if given is not None and off_plane >= MIN_SPREAD:
        camera = np.array([np.asarray(axis.stack()) for axis in axes(reader.camera)])
        alone = len({view.lit for view in views}) == len(views)
        others = [(_shape(cells, towards[k], power[k]), words) for words, k in orders(len(views)) if alone]
        moved = [(_doubt(shape, camera), words) for shape, words in others if shape is not None]
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
    given: _Shape, moved: Sequence[tuple[float, str]], camera: Float[np.ndarray, "3 3"]
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


@jax.jit
def _arriving(light: AbstractEmitter, p: Vec3) -> Array:
    """Return the light that arrives at a point."""
    return light.arriving(p)[1].stack()


def _shape(cells: Cells, towards: Float[np.ndarray, "views 3"], power: Float[np.ndarray, " views"]) -> _Shape | None:
    """Return what the cells say of the shape under lights; None if no cell has neighbours."""
    found = surface_under(cells, towards, power)
    if not found.whole.any() or np.isinf(found.misfit):
        return None
    b = found.b[cells.inside]
    square = np.maximum((found.smooth**2).sum(-1, keepdims=True), TINY)
    within = binary_erosion(cells.inside, border_value=1)  # the picture's end is no outline
    edge = np.greater(cells.inside, within)
    down, right = np.gradient(gaussian_filter(cells.inside.astype(float), SIGMA))
    ring = (binary_fill_holes(cells.inside) != cells.inside).any()  # a groove is too narrow to shade itself much
    shading = towards @ b.T
    grazed = found.counts & (np.abs(shading / np.maximum(np.linalg.norm(b, axis=-1), TINY) - BLACK) < SMALL)
    return _Shape(
        found.misfit,
        b,
        (np.cross(found.smooth, found.by_x) / square, np.cross(found.smooth, found.by_y) / square),
        _unit(found.b[edge]),
        _unit(np.stack([-right, down], -1)[edge]),
        float(np.mean((found.y < MOST * shading)[grazed])) if grazed.any() and not ring else 1.0,
    )


def _unit(vectors: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "n c"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), TINY)


def _doubt(shape: _Shape, A: Float[np.ndarray, "3 3"]) -> float:
    """Return how little a shape is that of a thing, in the axes to which A turns it: a sum of four squared shares.

    They are the misfit of the photographs, the curl of the surface, the share of the normals that face away from the
    camera, and whether those at an outline point neither outward nor inward, as in a hollow, which shades itself.
    """
    across, up = (of @ A.T for of in shape.curl)
    size = np.sqrt(np.sum(shape.curl[0] ** 2 + shape.curl[1] ** 2, -1))
    flat = 3.0 * SLIGHT  # from cell to cell: less than that, noise alone turns normals
    curl = robust_scale(across[:, 0] + up[:, 1]) / max(robust_scale(size), flat)
    away = np.mean(shape.b @ A[2] <= 0.0)
    edge = (shape.edge @ A.T)[:, :2]
    steep = np.linalg.norm(edge, axis=-1) > 1.0 - BLACK  # elsewhere a mask's border is no outline
    misled = False
    if steep.sum() > MOST * len(steep):
        outward = np.mean(np.sum(edge * shape.outward, -1)[steep])
        misled = abs(outward) < BLACK or (outward < -MOST and shape.cast < MINOR)
    return float(shape.misfit**2 + curl**2 + away**2 + misled)
