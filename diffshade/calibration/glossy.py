"""Glossy balls: pose, light and material together, from one photograph on, and what cannot be known from it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from ..cameras import Camera
from ..diagnosis.clusters import Clusters, find_clusters
from ..inverse.fitting import fit
from ..inverse.outcome import Fit
from ..inverse.views import View
from ..lights import DirectionalLight
from ..materials import Material
from ..scenes import Object, Scene
from .balls import Ball, axes
from .laws import find_lamps
from .matte import see
from .outcome import Calibration, views_of
from .photographs import Photographs

FREE = ("center", "k_a", "k_d", "k_s", "n_s", "direction")
SHAKEN = 2.0  # times the variance that independent noise explains, by which patches of a ball disagree


def by_fit(taken: Photographs, ball: Ball, tell: Callable[[str], None]) -> Calibration:
    """Fit pose, light and material of a ball to its photographs.

    The outline's pose, with its errors, is a prior of centre and radius. The search for the lights begins where a matte
    ball's would be. The first light has intensity 1; of further photographs the intensity is fitted. Errors are by
    patches of the ball where those disagree more than noise lets them; then the pose is left to the outline.
    """
    tell("shading")
    lamps = find_lamps(see(taken, ball)[2], "any")
    scene = Scene(Object(ball.sphere, Material()), [DirectionalLight(-l) for l in lamps.direction])
    views = [View(view.image, ball.camera, ball.mask, lit=view.lit) for view in views_of(taken, (ball,))]
    free = [*FREE, *(f"lights.{i}.intensity" for i in range(1, len(views)))]
    priors: dict[str, Any] = {}
    spread = np.array([*ball.errors[:2], ball.errors[2]])
    if isinstance(ball.camera, Camera):  # a pinhole sees the radius over the distance: the radius is the unit
        away = np.asarray(ball.sphere.center) - np.asarray(ball.camera.eye)
        spread[2] *= np.linalg.norm(away) / float(ball.sphere.radius)
    else:
        free.append("radius")
        priors["radius"] = (float(ball.sphere.radius), float(ball.errors[2]))
    along = np.sqrt(np.square(spread[:, None] * axes(ball.projection)).sum(0))
    for axis, x, error in zip("xyz", np.asarray(ball.sphere.center), along, strict=True):
        priors[f"center.{axis}"] = (float(x), float(error))
    tell("pose, light and material")
    found = fit(scene, views, free=free, priors=priors)
    tell("errors")
    clusters = _clusters(found)
    pose = np.zeros(len(found.unknowns))
    if clusters.shaken.any() and clusters.scatter > SHAKEN:
        # residuals are model error, of which the outline knows nothing: it counts as much more as they do
        tight = {name: (value, error / np.sqrt(clusters.scatter)) for name, (value, error) in priors.items()}
        found = fit(found.scene, views, free=free, priors=tight, start="scene")
        clusters = _clusters(found)
        turned = float(np.linalg.norm(ball.errors[:2])) / float(ball.sphere.radius) / np.sqrt(3.0)
        kept = {**{name: error for name, (_, error) in priors.items()}, **dict.fromkeys(_directions(found), turned)}
        pose = np.array([kept.get(name, 0.0) for name in found.names])
    fitted_errors = np.hypot(clusters.errors(), pose)
    directions = -np.array([np.asarray(light.direction) for light in found.scene.lights])  # pyright: ignore[reportAttributeAccessIssue]
    paths = [unknown.places[0][0] for unknown in found.unknowns]
    of = [[j for j, path in enumerate(paths) if path == f"lights.{i}.direction"] for i in range(len(views))]
    errors = np.rad2deg(np.sqrt([np.square(fitted_errors[members]).sum() for members in of]))
    notes = [note for note in found.notes if not note.startswith(("center.z", "1 view: no errors"))]
    return Calibration(
        ball="glossy",
        names=taken.names,
        balls=(ball,),
        scene=found.scene,
        views=found.views,
        directions=directions,
        errors=errors,
        intensities=np.array([np.asarray(light.intensity) for light in found.scene.lights]),  # pyright: ignore[reportAttributeAccessIssue]
        fit=found,
        fit_errors=fitted_errors,
        notes=(
            *notes,
            clusters.sentence([u.quantity for u in found.unknowns]),
            *_unknowable(ball, len(views)),
            *taken.notes,
        ),
    )


def _clusters(found: Fit) -> Clusters:
    with jax.enable_x64(True):
        return find_clusters(found)


def _directions(found: Fit) -> list[str]:
    """Return the names of the numbers of the lights' directions."""
    return [unknown.name for unknown in found.unknowns if unknown.kind == "direction"]


def _unknowable(ball: Ball, photographs: int) -> list[str]:
    """Say what photographs of one ball cannot tell, however good they are."""
    far = (
        "" if isinstance(ball.camera, Camera) else " How far away it is, is not known without the camera's intrinsics."
    )
    one = photographs == 1
    lobes = ["one photograph does not tell Phong's highlight from Blinn's, of about four times the n_s."]
    return [
        "k_d and k_s are known times the light's intensity, which was put at 1, and k_a times the ambient light's. "
        "Photograph a card of known reflectance in the ball's place for the factor.",
        f"lengths are in the unit in which the ball's radius is {float(ball.sphere.radius):.4g}.{far}",
        "the light was taken to be one, and far away: over one ball the fading of a near lamp looks like a turned "
        "light and another k_d, a second light on the same side like a part of the first, and light from all around "
        "like k_a. Two mirror balls tell where a lamp is.",
        *(lobes if one else []),
    ]
