"""Placing: the lights of a scene as directions from the middle of an object, and a scene with lights in others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from ...inverse.data.views import View, lights_on
from ...model.scenes import Scene


class LightEstimates(NamedTuple):
    """Lights: unit directions towards them, and how much brighter they are than the scene says."""

    directions: Float[np.ndarray, "lights 3"]
    gain: Float[np.ndarray, "lights *channels"]


def one_light_each(scene: Scene, views: Sequence[View]) -> Int[np.ndarray, " views"] | None:
    """Return the light of each view; None where one has several, or one that is neither a direction nor a position."""
    on = [lights_on(scene, view) for view in views]
    placed = [
        len(lights) == 1 and scene.lights[lights[0]].placement in (("direction",), ("position",)) for lights in on
    ]
    return np.array([lights[0] for lights in on]) if all(placed) else None


def directions_to(
    scene: Scene, used: Int[np.ndarray, " used"], middle: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "lights 3"]:
    """Return unit vectors from the middle of the object towards lights."""
    found = []
    for i in used:
        light: Any = scene.lights[i]
        found.append(np.asarray(light.position) - middle if light.is_local else -np.asarray(light.direction))
    towards = np.array(found, np.float64)
    return towards / np.linalg.norm(towards, axis=-1, keepdims=True)


def scene_with(
    scene: Scene, used: Int[np.ndarray, " used"], lamps: LightEstimates, middle: Float[np.ndarray, "3"]
) -> Scene:
    """Return the scene with lights in these directions, each as far away as before."""
    lights = list(scene.lights)
    for i, towards, gain in zip(used, lamps.directions, lamps.gain, strict=True):
        light: Any = lights[i]
        place = -towards
        if light.is_local:
            place = middle + np.linalg.norm(np.asarray(light.position) - middle) * towards
        where = "position" if light.is_local else "direction"
        lights[i] = eqx.tree_at(
            lambda one, where=where: (getattr(one, where), one.intensity),
            light,
            (place, gain * np.asarray(light.intensity)),
        )
    return eqx.tree_at(lambda s: s.lights, scene, tuple(lights))
