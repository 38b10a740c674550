"""Placing: the lights of a scene as directions from the middle of an object, and a scene with lights in others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from ...inverse.data.views import View, lights_on
from ...inverse.unknowns.light_priors import middle_of
from ...model.scenes import Scene

MOVABLE = ("direction",), ("position",)  # placements of the lights that are moved


class LightEstimates(NamedTuple):
    """Lights: unit directions towards them, and how much brighter they are than the scene says."""

    directions: Float[np.ndarray, "lights 3"]
    gain: Float[np.ndarray, "lights *channels"]


class PlacedLights(NamedTuple):
    """Some lights of a scene, as they are seen from the middle of its object."""

    scene: Scene
    used: Int[np.ndarray, " lights"]
    """Which lights of the scene they are."""
    middle: Float[np.ndarray, "3"]
    directions: Float[np.ndarray, "lights 3"]
    """Unit vectors towards them."""

    @classmethod
    def of(cls, scene: Scene, used: Int[np.ndarray, " lights"]) -> PlacedLights:
        """Return lights of a scene, each of which is a direction or a position."""
        middle, lights = middle_of(scene), [scene.lights[i] for i in used]
        towards = np.array([_place(light) - middle if light.is_local else -_place(light) for light in lights])
        return cls(scene, used, middle, towards / np.linalg.norm(towards, axis=-1, keepdims=True))

    def moved(self, lamps: LightEstimates) -> Scene:
        """Return the scene with its lights in these directions, each as far away as before."""
        lights: list[Any] = list(self.scene.lights)
        for i, towards, gain in zip(self.used, lamps.directions, lamps.gain, strict=True):
            (where,), place = lights[i].placement, -towards
            if lights[i].is_local:
                place = self.middle + np.linalg.norm(_place(lights[i]) - self.middle) * towards
            lights[i] = eqx.tree_at(
                lambda one, where=where: (getattr(one, where), one.intensity),
                lights[i],
                (place, gain * np.asarray(lights[i].intensity)),
            )
        return eqx.tree_at(lambda s: s.lights, self.scene, tuple(lights))


def _place(light: Any) -> Float[np.ndarray, "3"]:
    """Return the position of a light, or the direction in which it shines."""
    return np.asarray(getattr(light, light.placement[0]), np.float64)


def one_light_each(scene: Scene, views: Sequence[View]) -> PlacedLights | None:
    """Return the light of each view; None where one has several, or one that is neither a direction nor a position."""
    on = [lights_on(scene, view) for view in views]
    if not all(len(lights) == 1 and scene.lights[lights[0]].placement in MOVABLE for lights in on):
        return None
    return PlacedLights.of(scene, np.array([lights[0] for lights in on]))
