"""Stage: camera, lights and photographs of the maps as the numbers that the page's shaders take."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ....core.backend import in_float64
from ....model.cameras import AbstractCamera, affine_rays, camera_axes, pixel_matrix
from ....model.lights import AbstractLight
from ....model.lobes import AbstractLobe
from ....model.rendering import intersect, select
from ....texels.maps import TexelMaps
from ....texels.status import OUTSIDE
from ....texels.unexplained import Unexplained
from ..ball import emitter_rows, lobe_number, own_lobes, ray_rows


class Lighting(NamedTuple):
    """The lights that are on, and how they are exposed."""

    lit: tuple[int, ...] | None
    exposure: float
    black: float


def stage_of(maps: TexelMaps, lightings: Sequence[Lighting], white: float, factor: int) -> dict[str, Any]:
    """Return the stage, ready for JSON: lengths are seen from the camera's target.

    A texel of the page is `factor` texels of the maps wide. Runs in float64.
    """
    with in_float64((maps.as_scene(), maps.camera)) as (scene, camera):
        surface = intersect(scene, camera)
        position = None if surface.position is None else np.asarray(surface.position)
        target = np.asarray(camera.target)
        lobe = scene.objects[0].material.lobe
        assert isinstance(lobe, AbstractLobe)  # as every lobe of a fit of texels is
        lobes = own_lobes([lobe])
        inside = maps.status != OUTSIDE
        laws: list[str] = []
        found = [_lighting(maps, select(scene, of.lit), laws, position, inside, target) for of in lightings]
    given = None if maps.unexplained is None else maps.unexplained.interpolation
    told = ("toward", "width", "given")  # of an interpolation
    return {
        "camera": _camera(camera, factor),
        "placed": position is not None,
        "lobe": lobe_number(lobe, lobes),
        "lobes": lobes,
        "laws": laws,
        "views": [
            {**lights, "gain": of.exposure / white, "black": of.black / white}
            for of, lights in zip(lightings, found, strict=True)
        ],
        "interpolation": given and {name: np.asarray(getattr(given, name)).tolist() for name in told},
    }


def _camera(camera: AbstractCamera, factor: int) -> dict[str, Any]:
    """Return a camera whose rays are affine in column and row: p = origin - h direction at the height h.

    `to_pixel` has the rows of a matrix that takes a point, with 1 appended, to (column w, row w, w).
    """
    target, (right, up, backward) = np.asarray(camera.target), camera_axes(camera)
    eye = np.asarray(camera.eye) - target
    plane, lean = (of.T * (factor, factor, 1.0) for of in affine_rays(camera))
    plane[:, 2] -= target
    plane += lean * (eye @ backward)
    to_pixel = pixel_matrix(camera)
    to_pixel[:2] /= factor
    to_pixel[:, 3] += to_pixel[:, :3] @ target
    return {
        **ray_rows(plane.T, lean.T),
        "eye": eye.tolist(),
        "right": right.tolist(),
        "up": up.tolist(),
        "backward": backward.tolist(),
        "to_pixel": to_pixel.tolist(),
        "texel": float(np.linalg.norm(plane[:, 0])),
        "local_viewer": bool(camera.local_viewer),  # pyright: ignore[reportAttributeAccessIssue]
    }


def _lighting(
    maps: TexelMaps,
    lights: Sequence[AbstractLight],
    laws: list[str],
    position: Float[np.ndarray, "h w 3"] | None,
    inside: Bool[np.ndarray, "h w"],
    target: Float[np.ndarray, "3"],
) -> dict[str, Any]:
    """Return the emitters of a view's lights, and where its light comes from and how much arrives in the middle."""
    rows, unknown, toward, arriving = [], False, np.zeros(3), np.zeros(3)
    for light in lights:
        found = emitter_rows(light, laws)
        unknown = unknown or found is None
        l, everywhere = Unexplained.toward(light, position, inside)
        light_here = (everywhere if everywhere.ndim == 2 else everywhere[inside].mean(0)).sum(0)
        toward, arriving = toward + l * light_here.mean(), arriving + light_here
        weights = [] if maps.unexplained is None else _weights(maps.unexplained, l)
        for row in found or ():
            seen_from_target = [*(np.asarray(row[:3]) - (target if row[3] else 0.0)).tolist(), *row[3:]]
            rows.append([*seen_from_target, *weights])
    length = np.linalg.norm(toward)
    return {
        "emitters": rows,
        "complete": not unknown,
        "toward": (toward / length).tolist() if length > 0.0 else [0.0, 0.0, 1.0],
        "arriving": arriving.tolist(),
    }


def _weights(unexplained: Unexplained, toward: Float[np.ndarray, "3"]) -> list[float]:
    weights = unexplained.interpolation.weights(toward)
    return (weights if np.any(toward) else np.zeros_like(weights)).tolist()
