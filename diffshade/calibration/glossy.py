"""Glossy balls: pose, light and material together, from one photograph on, and what cannot be known from it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..core.backend import in_float64
from ..diagnosis.patches import find_clusters
from ..inverse.data.views import View
from ..inverse.fitting import fit
from ..inverse.result import Fit
from ..inverse.statistics.clusters import Clusters
from ..model.cameras import Camera
from ..model.lights import DirectionalLight
from ..model.materials import Material
from ..model.scenes import Object, Scene
from .balls import Ball, axes
from .laws import find_lamps
from .matte import see
from .outcome import Calibration, degrees, views_of
from .photographs import Photographs

FREE = ("center", "k_a", "k_d", "k_s", "n_s", "direction")
SHAKEN = 2.0  # times the variance that independent noise explains, by which patches of a ball disagree
HELD = 1e-3  # of its error, within which a pose is held


def by_fit(taken: Photographs, ball: Ball, report_progress: Callable[[str], None]) -> Calibration:
    """Fit pose, light and material of a ball to its photographs.

    The outline's pose, with its errors, is a prior of centre and radius. The search for the lights begins where a matte
    ball's would be. The first light has intensity 1; of further photographs the intensity is fitted. Errors are by
    patches of the ball where those disagree more than noise lets them; then the pose is the outline's.
    """
    report_progress("shading")
    lamps = find_lamps(see(taken, ball)[2], "any")
    scene = Scene(Object(ball.sphere, Material()), [DirectionalLight(-l) for l in lamps.direction])
    views = [View(view.image, ball.camera, ball.mask, lit=view.lit) for view in views_of(taken, (ball,))]
    priors = _pose(ball)
    free = [
        *FREE,
        *(["radius"] if "radius" in priors else []),
        *(f"lights.{i}.intensity" for i in range(1, len(views))),
    ]
    report_progress("pose, light and material")
    found = fit(scene, views, free=free, priors=priors)
    report_progress("errors")
    clusters = _clusters(found)
    errors = clusters.errors()
    determined, misled = found.determined, np.zeros(len(views))
    if clusters.rejects_independence.any() and clusters.scatter > SHAKEN:
        # what is left over is model error, of which the outline knows nothing: it alone tells the pose
        tight = {name: (value, HELD * error) for name, (value, error) in priors.items()}
        found = fit(found.scene, views, free=free, priors=tight, start="scene")
        clusters = _clusters(found)
        turned = float(np.linalg.norm(ball.errors[:2])) / float(ball.sphere.radius) / np.sqrt(3.0)
        known = {name: error for name, (_, error) in priors.items()}
        known |= {unknown.name: turned for unknown in found.unknowns if unknown.kind == "direction"}
        errors = np.hypot(clusters.errors(), [known.get(name, 0.0) for name in found.names])
        determined = found.determined | np.isin(found.names, list(priors))
        misled = degrees(lamps.direction, _directions(found.scene))
    if not isinstance(ball.camera, Camera):  # it does not see how far away things are
        determined = determined & (np.array(found.names) != "center.z")
    errors = np.where(determined, errors, np.inf)
    paths = np.array([unknown.places[0][0] for unknown in found.unknowns])
    turns = [errors[paths == f"lights.{i}.direction"] for i in range(len(views))]
    # of the pose the outline knows, and the errors are by patches
    notes = [note for note in found.notes if not note.startswith("center")]
    return Calibration(
        ball="glossy",
        names=taken.names,
        balls=(ball,),
        scene=found.scene,
        views=found.views,
        directions=_directions(found.scene),
        errors=np.hypot(np.rad2deg(np.sqrt(np.square(turns).sum(-1))), misled),
        intensities=np.array([np.asarray(light.intensity) for light in found.scene.lights]),  # pyright: ignore[reportAttributeAccessIssue]
        fit=found,
        fit_errors=errors,
        notes=(
            *notes,
            *_misled(misled),
            f"errors: {clusters.sentence([u.quantity for u in found.unknowns])}",
            *_dark(taken, ball),
            *_unknowable(ball, len(views)),
            *taken.notes,
        ),
    )


def _directions(scene: Scene) -> np.ndarray:
    """Return the unit vectors towards the lights."""
    return -np.array([np.asarray(light.direction) for light in scene.lights])  # pyright: ignore[reportAttributeAccessIssue]


def _misled(misled: np.ndarray) -> list[str]:
    """Say by how much the shading by itself, whatever its law, turns the lights."""
    if not misled.any():
        return []
    return [
        f"this material does not explain the ball, whose shading alone turns the directions by {misled.max():.2g} "
        "degrees at most, which is in their errors."
    ]


def _clusters(found: Fit) -> Clusters:
    with in_float64(found) as found:
        return find_clusters(found)


def _pose(ball: Ball) -> dict[str, Any]:
    """Return what the outline knows of the pose: the numbers and their errors."""
    spread, priors = ball.errors.copy(), {}
    if isinstance(ball.camera, Camera):  # a pinhole sees the radius over the distance: the radius is the unit
        away = np.asarray(ball.sphere.center) - np.asarray(ball.camera.eye)
        spread[2] *= np.linalg.norm(away) / float(ball.sphere.radius)
    else:
        priors["radius"] = (float(ball.sphere.radius), float(ball.errors[2]))
    along = np.sqrt(np.square(spread[:, None] * axes(ball.projection)).sum(0))
    for axis, x, error in zip("xyz", np.asarray(ball.sphere.center), along, strict=True):
        priors[f"center.{axis}"] = (float(x), float(error))
    return priors


def _dark(taken: Photographs, ball: Ball) -> list[str]:
    """Say that shadows are cut off at 0, where noise then only brightens them."""
    share = np.mean([np.mean(np.asarray(image[:])[ball.mask] <= 0.0) for image in taken.images])
    if share < 0.01:
        return []
    return [
        f"{100 * share:.0f} % of the ball's samples are 0: noise that is cut off there makes k_a too large, by up to "
        "what the noise is. Give the fit View(noise=..., floor=0) and clipped='tobit'."
    ]


def _unknowable(ball: Ball, photographs: int) -> list[str]:
    """Say what photographs of one ball cannot tell, however good they are."""
    far = "" if isinstance(ball.camera, Camera) else " Its distance is not known without the camera's intrinsics."
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
        "which of the numbers hang on a few pixels, ds.examine(calibration.fit) tells.",
    ]
