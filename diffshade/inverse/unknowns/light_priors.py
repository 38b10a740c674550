"""Light priors: what stated errors of the lights say of their directions, positions and intensities."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike, Float

from ...core.arrays import float64_of
from ...model.scenes import Scene
from .unknown import Unknown

LEAST_INTENSITY = 1e-6  # over that of the scene


@dataclass(frozen=True)
class LightErrors:
    """Stated errors of lights that a fit takes as known; None where none are stated."""

    direction: Float[np.ndarray, " lights"] | None
    """Standard deviation of each light's direction about each axis, seen from the objects, radians."""
    intensity: Float[np.ndarray, " lights"] | None
    """Relative standard deviation of each light's intensity."""

    def of_known(self, scene: Scene, free: Collection[str]) -> bool:
        """Whether the errors are those of a light that has none of these paths free."""
        lights = range(len(scene.lights))
        places = self.direction is not None and any(_place(scene, i) and not _is_free(scene, i, free) for i in lights)
        return places or (self.intensity is not None and any(f"lights.{i}.intensity" not in free for i in lights))

    def moved(self, scene: Scene, free: Collection[str], draw: Float[np.ndarray, "lights 4"]) -> Scene:
        """Return the scene with its known lights moved by their errors times numbers drawn from N(0, 1)."""
        middle, lights = middle_of(scene), []
        for i, light in enumerate(scene.lights):
            place = _place(scene, i)
            if self.direction is not None and place and not _is_free(scene, i, free):
                at = np.asarray(getattr(light, place), np.float64)
                far = np.linalg.norm(at if place == "direction" else at - middle)
                light = dataclasses.replace(light, **{place: at + far * self.direction[i] * draw[i, :3]})
            if self.intensity is not None and f"lights.{i}.intensity" not in free:
                factor = np.exp(self.intensity[i] * draw[i, 3])
                light = eqx.tree_at(lambda of: of.intensity, light, factor * np.asarray(light.intensity))  # pyright: ignore[reportAttributeAccessIssue]
            lights.append(light)
        return dataclasses.replace(scene, lights=tuple(lights))


def stated_errors(scene: Scene, light_error: ArrayLike | None, intensity_error: ArrayLike | None) -> LightErrors:
    """Return the errors as they are stated in a call, in degrees and relative; raise ValueError for wrong ones."""
    return LightErrors(
        None if light_error is None else np.deg2rad(_checked("light_error", light_error, scene, "1.0")),
        None if intensity_error is None else _checked("intensity_error", intensity_error, scene, "0.05"),
    )


def _place(scene: Scene, i: int) -> str:
    """Return the name of what says where a light is: its position, or its direction if it is at infinity, or ""."""
    light = scene.lights[i]
    if hasattr(light, "position"):
        return "position"
    return "direction" if hasattr(light, "direction") and not light.is_local else ""


def _is_free(scene: Scene, i: int, free: Collection[str]) -> bool:
    return f"lights.{i}.{_place(scene, i)}" in free


def _checked(name: str, errors: ArrayLike, scene: Scene, example: str) -> Float[np.ndarray, " lights"]:
    """Return the error of each light, above 0; raise ValueError for wrong ones."""
    each, count = float64_of(name, errors), len(scene.lights)
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
    for unknown, i, name in _of_lights(unknowns, ("direction", "position")):
        light = scene.lights[i]
        if name != _place(scene, i):  # where a spot points, which moves no light
            continue
        far = 1.0 if name == "direction" else float(np.linalg.norm(np.asarray(getattr(light, name)) - middle))
        if unknown.prior is None:
            unknown.prior = (unknown.start, float(error[i]) * far)


def set_intensity_priors(unknowns: Sequence[Unknown], scene: Scene, error: Float[np.ndarray, " lights"]) -> None:
    """Solve for each free intensity of a light as its logarithm, with a prior about the scene's value.

    In the logarithm, since the mean of intensities with relative errors would pull the scale of all to their low side.

    Args:
        unknowns: The unknowns, some of which change.
        scene: The scene.
        error: Relative standard deviation of each light's intensity.
    """
    for unknown, i, _ in _of_lights(unknowns, ("intensity",)):
        stated = float(np.ravel(np.asarray(scene.lights[i].intensity))[unknown.places[0][1]])  # pyright: ignore[reportAttributeAccessIssue]
        if not stated > 0.0:
            raise ValueError(
                f"{unknown.name} is {stated:g}, of which no error is relative. Give that light an intensity above 0, "
                "or leave intensity_error out."
            )
        unknown.parameter = dataclasses.replace(unknown.parameter, logarithmic=True)
        unknown.lower, unknown.start = max(unknown.lower, LEAST_INTENSITY * stated), stated
        unknown.prior = (float(np.log(stated)), float(error[i]))


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
