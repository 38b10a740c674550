"""Light priors: what stated errors of the lights say of their directions, positions and intensities."""

from __future__ import annotations

import numpy as np
from jaxtyping import ArrayLike, Float

from ...core.arrays import float64_of
from ...model.scenes import Scene
from .places import Place


def stated_errors(scene: Scene, light_error: ArrayLike | None, intensity_error: ArrayLike | None) -> dict[Place, float]:
    """Return the standard deviation that stated errors give each number of the lights.

    That of a position is in scene units, that of a direction is of the unit vector, that of an intensity is relative.

    Args:
        scene: The scene.
        light_error: Standard deviation of the directions of all lights, or of each, about each axis, seen from the
            objects, degrees; None where it is not stated.
        intensity_error: Relative standard deviation of the intensities of all lights, or of each.

    Raises:
        ValueError: An error is below 0, or there is one for another number of lights.
    """
    found = {}
    if light_error is not None:
        middle = middle_of(scene)
        for i, error in enumerate(np.deg2rad(error_of_each("light_error", light_error, len(scene.lights), "1.0"))):
            light = scene.lights[i]
            for name in light.placement[:1]:
                far = 1.0 if name == "direction" else np.linalg.norm(np.asarray(getattr(light, name)) - middle)
                found[Place("lights", i, (name,))] = float(error * far)
    if intensity_error is not None:
        for i, error in enumerate(error_of_each("intensity_error", intensity_error, len(scene.lights), "0.05")):
            found[Place("lights", i, ("intensity",))] = float(error)
    return found


def error_of_each(name: str, errors: ArrayLike, count: int, example: str) -> Float[np.ndarray, " lights"]:
    """Return the error of each light; raise ValueError for one below 0, or for errors of another number of lights."""
    each = float64_of(name, errors)
    if each.shape not in ((), (count,)) or not (np.isfinite(each) & (each >= 0.0)).all():
        raise ValueError(
            f"{name} must be one number of at least 0, or one for each of the {count} lights; got {errors}. Give for "
            f"example {name}={example}."
        )
    return np.broadcast_to(each, (count,))


def middle_of(scene: Scene) -> np.ndarray:
    """Return a point in the middle of the objects."""
    points = []
    for item in scene.objects:
        center, position = getattr(item.surface, "center", None), getattr(item.surface, "position", None)
        if center is not None:
            points.append(np.asarray(center))
        elif position is not None:
            points.append(np.asarray(position)[np.asarray(item.surface.mask)].mean(0))  # pyright: ignore[reportAttributeAccessIssue]
    return np.mean(points, 0) if points else np.zeros(3)
