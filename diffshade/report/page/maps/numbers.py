"""Numbers of the texels, as the page's shaders take them: coefficients, normals, heights and errors, maybe reduced."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ....core.backend import in_float64
from ....model.cameras import AbstractCamera, camera_axes
from ....model.rendering import intersect
from ....texels.heights.closing import placed
from ....texels.heights.map import HeightMap
from ....texels.maps import TexelMaps
from ....texels.status import OUTSIDE

MOST_TEXELS = 1 << 22  # on the page; larger maps are reduced by averages
MOST_SIDE = 8192  # pixels that every desktop's WebGL 2 holds in a texture


@dataclass(frozen=True, eq=False)
class Numbers:
    """What every texel of the page has; row 0 is on top."""

    k_d: Float[np.ndarray, "h w 3"]
    k_s: Float[np.ndarray, "h w 3"]
    n_s: Float[np.ndarray, "h w"]
    own: Float[np.ndarray, "h w 3"]
    """What needs no light of the scene's: k_e + k_a I_a."""
    normal: Float[np.ndarray, "h w 3"]
    height: Float[np.ndarray, "h w"] | None
    """Towards the camera above the plane through its target, scene units."""
    status: Int[np.ndarray, "h w"]
    region: Int[np.ndarray, "h w"]
    """Index into `shapes`."""
    first_power: float
    """The lowest exponent of a shared highlight; each further one is twice the one before."""
    shapes: tuple[tuple[float, ...], ...]
    """The weight of each power, for each region; empty where n_s is used."""
    beyond: Float[np.ndarray, "h w 3 parts"] | None
    """What is kept of the light beyond the model."""
    errors: Mapping[str, Float[np.ndarray, "h w"]]
    """Standard errors, and the residual; infinite where nothing is known."""
    factor: int
    """How many texels of the maps a texel of the page is wide."""

    @property
    def inside(self) -> Bool[np.ndarray, "h w"]:
        """Where the object is."""
        return self.status != OUTSIDE


def numbers_of(maps: TexelMaps, heights: HeightMap | None) -> Numbers:
    """Return the numbers of maps; larger maps than the page can hold are averaged over squares of texels."""
    with in_float64((maps.as_scene(), maps.camera)) as (scene, camera):
        surface = intersect(scene, camera)
        normal = np.asarray(surface.normal)
        height = _heights(surface.position, camera) if heights is None else _placed(heights)
    material, known, shape = maps.as_scene().objects[0].material, maps.scene.objects[0].material, maps.status.shape
    k_s, n_s = (maps.values.get(name, getattr(known, name)) for name in ("k_s", "n_s"))
    region, shapes = _shapes(maps)
    parts = None
    if maps.unexplained is not None:
        kept = maps.unexplained.parts.astype(np.float32)
        parts = kept.reshape(*shape, -1, len(maps.unexplained.interpolation.given[0]))
        parts = np.broadcast_to(parts, (*shape, 3, parts.shape[-1]))
    own = np.asarray(material.k_e) + _over(material.k_a, shape) * np.asarray(maps.scene.ambient)
    found = Numbers(
        k_d=_over(material.k_d, shape),
        k_s=_over(k_s, shape),
        n_s=_over(n_s, shape)[..., 0],
        own=_over(own, shape),
        normal=normal,
        height=None if height is None else np.where(maps.status != OUTSIDE, height, 0.0),
        status=maps.status.astype(int),
        region=region,
        first_power=maps.highlights[0].n_s if maps.highlights else 1.0,
        shapes=shapes,
        beyond=parts,
        errors=_errors(maps, heights),
        factor=1,
    )
    height_, width = shape
    factor = max(int(np.ceil(np.sqrt(height_ * width / MOST_TEXELS))), -(-max(shape) // MOST_SIDE))
    return found if factor == 1 else _reduced(found, factor)


def _over(value: Any, shape: tuple[int, int]) -> Float[np.ndarray, "h w 3"]:
    """Return a coefficient at every texel, in three channels."""
    of = np.asarray(value, np.float32)
    return np.broadcast_to(of, (*shape, 3))


def _placed(heights: HeightMap) -> np.ndarray:
    """Return heights whose parts stand where most of the seams between them have no jump."""
    index = np.arange(heights.part.size).reshape(*heights.part.shape, 1)
    moved = placed(heights.height.ravel(), np.repeat(index, 4, -1), heights.part)
    return heights.height + np.append(moved, 0.0)[heights.part]


def _heights(position: Any, camera: AbstractCamera) -> np.ndarray | None:
    if position is None:
        return None
    return (np.asarray(position) - np.asarray(camera.target)) @ camera_axes(camera)[2]


def _shapes(maps: TexelMaps) -> tuple[np.ndarray, tuple[tuple[float, ...], ...]]:
    """Return the region of each texel, and the weights of the powers of each region's highlight."""
    shape = maps.status.shape
    if not maps.highlights:
        return np.zeros(shape, int), ()
    places = [doublings(n_s / maps.highlights[0].n_s) for _, n_s in maps.highlights]
    given = [weight for weight, _ in maps.highlights]
    if all(np.ndim(weight) == 0 for weight in given):
        rows, region = np.array([given], float), np.zeros(shape, int)
    else:
        weights = np.concatenate([np.broadcast_to(weight, (*shape, 1)) for weight in given], -1)
        rows, region = np.unique(weights.reshape(-1, len(given)), axis=0, return_inverse=True)
    dense = np.zeros((len(rows), max(places) + 1))
    dense[:, places] = rows
    return region.reshape(shape), tuple(map(tuple, dense.tolist()))


def doublings(ratio: float) -> int:
    """Return how often 1 is doubled to become a ratio."""
    return int(np.rint(np.log2(ratio)))


def _errors(maps: TexelMaps, heights: HeightMap | None) -> dict[str, np.ndarray]:
    """Return the errors of each map, that of the worst channel, with the heights' and the residual."""
    found = {name: error.max(-1) for name, error in maps.errors.items()}
    if heights is not None:
        found["height"] = heights.errors
    return {**found, "residual": maps.residual}


def _reduced(numbers: Numbers, factor: int) -> Numbers:
    """Return the means over squares of texels, of those inside; status and region are the first texel's."""
    inside = numbers.inside
    weight = np.maximum(_over_squares(np.add, inside.astype(float), factor), 1e-12)

    def mean(of: np.ndarray) -> np.ndarray:
        sums = _over_squares(np.add, np.where(inside.T, of.T, 0.0).T, factor)
        return (sums.T / weight.T).T

    normal = mean(numbers.normal)
    of_texels = {name: getattr(numbers, name) for name in ("k_d", "k_s", "n_s", "own", "height", "beyond")}
    return dataclasses.replace(
        numbers,
        **{name: mean(of) for name, of in of_texels.items() if of is not None},
        normal=normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12),
        status=_over_squares(np.maximum, np.where(inside, numbers.status, 0), factor),
        region=numbers.region[::factor, ::factor],
        errors={name: mean(error) for name, error in numbers.errors.items()},
        factor=factor,
    )


def _over_squares(of: np.ufunc, image: np.ndarray, factor: int) -> np.ndarray:
    """Return the sums, or the largest numbers, of an image over squares of texels."""
    for axis in (0, 1):
        image = of.reduceat(image, np.arange(0, image.shape[axis], factor), axis)
    return image
