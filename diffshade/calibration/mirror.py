"""Mirror balls: directions from one, positions from several."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..core.words import listing
from ..model.lights import DirectionalLight, PointLight
from ..model.materials import Material
from ..model.scenes import Object, Scene
from .balls import Ball
from .highlights import Glint, find_glint, find_position
from .photographs import Photographs
from .result import Calibration

SECOND = 0.3  # a second highlight with more than this fraction of the brightest one's light is reported


def by_mirrors(taken: Photographs, balls: tuple[Ball, ...], report_progress: Callable[[str], None]) -> Calibration:
    """Find the light of each photograph from its highlight on one mirror ball or several."""
    glints = []
    for i, name in enumerate(taken.names):
        report_progress(name)
        try:
            glints.append([find_glint(taken.grey(i), ball) for ball in balls])
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
    notes = _notes(taken, balls, glints)
    objects = [Object(ball.sphere, Material(k_d=1.0)) for ball in balls]
    directions = np.array([np.mean([g.direction for g in of], 0) for of in glints])
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    errors = np.array([np.sqrt(np.mean([g.error**2 for g in of]) / len(of)) for of in glints])
    positions = position_errors = None
    lights = [DirectionalLight(-l) for l in directions]
    if len(balls) == 1:
        notes.append(
            "one ball shows the direction to a light, not how far away it is. The direction is from the highlight; "
            "from the ball's centre that of a lamp 10 radii away differs by up to 6 degrees. Photograph two balls for "
            "the lamp's position."
        )
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
            notes.append(
                f"the rays from the balls to the light of {names} do not meet: this light is assumed to be far away."
            )
    return Calibration(
        ball="mirror",
        names=taken.names,
        balls=balls,
        scene=Scene(objects, lights),
        images=taken.images,
        directions=directions,
        errors=errors,
        positions=positions,
        position_errors=position_errors,
        notes=tuple(notes),
    )


def _notes(taken: Photographs, balls: tuple[Ball, ...], glints: Sequence[Sequence[Glint]]) -> list[str]:
    """Return how exact the outline is, and what the highlights do not show or show twice."""
    shift = np.rad2deg(2.0 / min(ball.radius for ball in balls))
    uncertain = max(float(np.sqrt(np.mean(ball.errors[:2] ** 2))) / ball.pixel for ball in balls)
    notes = [
        *taken.notes,
        f"an outline shifted by one pixel would turn every direction by {shift:.2g} degrees; the errors include a "
        f"shift of {uncertain:.2g} pixels.",
        "the brightness of the highlights was not used: all intensities are 1. Photograph a matte ball for them.",
    ]
    if several := [name for name, of in zip(taken.names, glints, strict=True) if max(g.second for g in of) > SECOND]:
        notes.append(
            f"{listing(several)} {'shows' if len(several) == 1 else 'show'} more than one highlight; the brightest was "
            "used. Switch the other lamps off, or exclude their reflections with the mask."
        )
    return notes
