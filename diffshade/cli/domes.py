"""A dome of lights: the candidate photographs for `plan` if none are given."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    import diffshade as ds

    from ..model.lights import AbstractLight

SIDES = ("right", "upper right", "above", "upper left", "left", "lower left", "below", "lower right")
DISTANT = ((20.0, 8), (45.0, 8), (70.0, 8))  # degrees from the camera's axis, and number of lights around it
NEAR = ((30.0, 4), (60.0, 4))
DISTANCES = (0.6, 1.0, 2.0)  # over the lights' own distance


def dome(fit: ds.Fit) -> list[ds.Shot]:
    """Return shots with a light like the fit's first one from all sides of the camera; none for a spot or area light.

    A light at infinity comes from 25 directions, a point light from 9, each at 3 distances from the visible surface.
    """
    import numpy as np

    import diffshade as ds

    from ..inverse.misfit.regions import center_of
    from ..model.cameras import camera_axes

    light, camera = fit.scene.lights[0], fit.views[0].camera
    frame = np.stack(camera_axes(camera))
    if light.placement == ("direction",):
        return [
            ds.Shot(light=dataclasses.replace(light, direction=-towards), name=name)
            for name, towards in _directions(DISTANT, frame)
        ]
    if light.placement != ("position",):
        return []
    center = center_of(fit.scene.objects, camera)
    lamps = [getattr(other, *other.placement) for other in fit.scene.lights if other.placement == ("position",)]
    usual = np.median([np.linalg.norm(position - center) for position in lamps])
    shots = []
    for name, towards in _directions(NEAR, frame):
        for far in usual * np.array(DISTANCES):
            lamp = dataclasses.replace(light, position=center + far * towards)
            shots.append(ds.Shot(light=lamp, name=f"{name}, {far:.3g} away"))
    return shots


def place_of(light: AbstractLight) -> str:
    """Return a name for a light: its position, or the direction towards it."""
    import numpy as np

    place = getattr(light, "position", getattr(light, "corner", None))
    towards = -np.asarray(getattr(light, "direction", 0.0)) if place is None else np.asarray(place)
    numbers = [f"{round(float(number), 3) + 0.0:g}" for number in np.ravel(towards)]
    return f"light {'from' if place is None else 'at'} {', '.join(numbers)}"


def _directions(rings: tuple[tuple[float, int], ...], frame: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Return names and unit directions towards the lights, for a camera with the axes right, up and backward."""
    import numpy as np

    right, up, backward = frame
    found = [("at the camera", backward)]
    for off, count in rings:
        for k in range(0, 8, 8 // count):
            around, away = np.deg2rad(45.0 * k), np.deg2rad(off)
            across = np.cos(around) * right + np.sin(around) * up
            found.append((f"{SIDES[k]}, {off:.0f} degrees off", np.cos(away) * backward + np.sin(away) * across))
    return found
