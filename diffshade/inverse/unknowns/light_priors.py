"""Light priors: what stated errors of the lights say of their unknown directions, positions and intensities."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import ArrayLike, Float

from ...model.scenes import Scene
from .unknown import Unknown

LEAST_INTENSITY = 1e-6  # over that of the scene


def checked_errors(name: str, errors: ArrayLike, scene: Scene, example: str) -> Float[np.ndarray, " lights"]:
    """Return the error of each light, above 0; raise ValueError for wrong ones."""
    each, count = np.asarray(errors, np.float64), len(scene.lights)
    if each.shape not in ((), (count,)) or not (np.isfinite(each) & (each > 0.0)).all():
        raise ValueError(
            f"{name} must be one number above 0, or one for each of the {count} lights; got {errors}. Give for example "
            f"{name}={example}."
        )
    return np.broadcast_to(each, (count,))


def set_direction_priors(unknowns: Sequence[Unknown], scene: Scene, error: Float[np.ndarray, " lights"]) -> None:
    """Give each free direction and position of a light, without a prior of its own, the one of its stated error.

    Args:
        unknowns: The unknowns, some of which get a prior about the scene's value.
        scene: The scene.
        error: Standard deviation of each light's direction about each axis, seen from the objects, radians.
    """
    middle = middle_of(scene)
    found = False
    for unknown, i, name in _of_lights(unknowns, ("direction", "position")):
        light = scene.lights[i]
        if name == "direction" and light.is_local:  # where a spot points, which moves no light
            continue
        found = True
        far = 1.0 if name == "direction" else float(np.linalg.norm(np.asarray(getattr(light, name)) - middle))
        if unknown.prior is None:
            unknown.prior = (unknown.start, float(error[i]) * far)
    if not found:
        raise ValueError(
            "light_error needs a free direction or position of a light; got none. Add 'direction' to free, or leave "
            "light_error out."
        )


def set_intensity_priors(unknowns: Sequence[Unknown], scene: Scene, error: Float[np.ndarray, " lights"]) -> None:
    """Solve for each free intensity of a light as its logarithm, with a prior about the scene's value.

    In the logarithm, since the mean of intensities with relative errors would pull the scale of all to their low side.

    Args:
        unknowns: The unknowns, some of which change.
        scene: The scene.
        error: Relative standard deviation of each light's intensity.
    """
    free = list(_of_lights(unknowns, ("intensity",)))
    for unknown, i, _ in free:
        stated = float(np.ravel(np.asarray(scene.lights[i].intensity))[unknown.places[0][1]])  # pyright: ignore[reportAttributeAccessIssue]
        if not stated > 0.0:
            raise ValueError(
                f"{unknown.name} is {stated:g}, of which no error is relative. Give that light an intensity above 0, "
                "or leave intensity_error out."
            )
        unknown.parameter = dataclasses.replace(unknown.parameter, logarithmic=True)
        unknown.lower, unknown.start = max(unknown.lower, LEAST_INTENSITY * stated), stated
        unknown.prior = (float(np.log(stated)), float(error[i]))
    if not free:
        raise ValueError(
            "intensity_error needs a free intensity of a light; got none. Add 'intensity' to free, or leave "
            "intensity_error out."
        )


def _of_lights(unknowns: Sequence[Unknown], names: Sequence[str]) -> Iterator[tuple[Unknown, int, str]]:
    """Yield the unknowns that are numbers of a light by these names, with the index of the light and the name."""
    for unknown in unknowns:
        path = unknown.places[0][0].split(".") if unknown.places else []
        if len(path) == 3 and path[0] == "lights" and path[2] in names:
            yield unknown, int(path[1]), path[2]


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
