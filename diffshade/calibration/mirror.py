"""Mirror balls: directions from one, positions from several."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..inverse.identifiability import listing
from ..lights import DirectionalLight, PointLight
from ..materials import Material
from ..scenes import Object, Scene
from .balls import Ball
from .highlights import find_glint, find_position
from .outcome import Calibration, views_of
from .photographs import Photographs


def by_mirrors(taken: Photographs, balls: tuple[Ball, ...], tell: Callable[[str], None]) -> Calibration:
    """Find the light of each photograph from its highlight on one mirror ball or several."""
    glints = []
    for i, name in enumerate(taken.names):
        tell(name)
        try:
            glints.append([find_glint(taken.grey(i), ball) for ball in balls])
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
    shift = np.rad2deg(2.0 / min(ball.radius for ball in balls))
    notes = [
        f"a mask that lies a pixel to one side turns every direction by {shift:.2g} degrees, of which .29 is in "
        "the errors.",
        "how bright a highlight is was not looked at: the intensities are put at 1. A matte ball tells them.",
    ]
    objects = [Object(ball.sphere, Material(k_d=1.0)) for ball in balls]
    directions = np.array([np.mean([g.direction for g in of], 0) for of in glints])
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    errors = np.array([np.sqrt(np.mean([g.error**2 for g in of]) / len(of)) for of in glints])
    positions = position_errors = None
    lights = [DirectionalLight(-l) for l in directions]
    if len(balls) == 1:
        notes.append("one ball tells the way to a light, not how far it is. Photograph two balls for its position.")
    else:
        found = [find_position(of) for of in glints]
        positions, position_errors = np.array([x for x, _ in found]), np.array([error for _, error in found])
        known = np.asarray(np.isfinite(positions).all(-1))
        middle = np.mean([np.asarray(ball.sphere.center) for ball in balls], 0)
        to = np.where(known[:, None], positions - middle, directions)
        far = np.linalg.norm(to, axis=-1, keepdims=True)
        directions = to / far
        lights = [
            PointLight(x) if near else DirectionalLight(-l)
            for x, l, near in zip(positions, directions, known, strict=True)
        ]
        if not known.all():
            names = listing([name for name, near in zip(taken.names, known, strict=True) if not near])
            notes.append(f"the rays from the balls to the light of {names} do not meet: it is taken to be far away.")
    return Calibration(
        ball="mirror",
        names=taken.names,
        balls=balls,
        scene=Scene(objects, lights),
        views=views_of(taken, balls),
        directions=directions,
        errors=errors,
        positions=positions,
        position_errors=position_errors,
        notes=tuple(notes),
    )
