"""Glossy balls: pose, lights and material in one fit, from one photograph on, and what no such fit determines."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from ..core.backend import in_float64
from ..core.thresholds import FAR_MORE, NEGLIGIBLE, SLIGHT
from ..diagnosis.patches import find_clusters
from ..inverse.data.views import View
from ..inverse.fitting import fit
from ..inverse.result import Fit
from ..inverse.statistics.clusters import Clusters
from ..model.cameras import Camera
from ..model.lights import DirectionalLight
from ..model.materials import Material
from ..model.scenes import Object, Scene
from .balls import Ball
from .laws import find_lamps
from .matte import Vectors, sample_ball
from .photographs import Photographs
from .result import Calibration, degrees, views_of

FREE = ("center", "k_a", "k_d", "k_s", "n_s", "direction")

Priors: TypeAlias = Mapping[str, tuple[float, float]]
"""The value and the standard deviation of each number."""


@dataclass(frozen=True, eq=False)
class BallFit:
    """The fit of a ball, and its errors by patches of the ball."""

    fit: Fit
    clusters: Clusters
    errors: Float[np.ndarray, " p"]
    determined: Bool[np.ndarray, " p"]
    model_error: Float[np.ndarray, " views"]
    """The error of each direction, in degrees, that comes from the model itself; 0 if the model fits the ball."""

    @property
    def printed_errors(self) -> Float[np.ndarray, " p"]:
        """The errors; infinite where a value is not determined."""
        return np.where(self.determined, self.errors, np.inf)

    @property
    def direction_errors(self) -> Float[np.ndarray, " views"]:
        """The root mean square error of each light's direction, degrees."""
        errors = self.printed_errors
        turns = np.reshape(errors[[unknown.kind == "direction" for unknown in self.fit.unknowns]], (-1, 3))
        return np.hypot(np.rad2deg(np.sqrt(np.square(turns).sum(-1))), self.model_error)


def by_fit(taken: Photographs, ball: Ball, report_progress: Callable[[str], None]) -> Calibration:
    """Fit pose, lights and material of a ball to its photographs.

    The pose and its errors from the outline are the prior of centre and radius. The search for the lights starts at the
    result for a matte ball. The first light has intensity 1; the intensities of the other photographs are fitted.

    Errors are by patches of the ball if these disagree more than noise explains. Then the residuals are model error,
    and the pose is the outline's.
    """
    report_progress("shading")
    shaded = find_lamps(sample_ball(taken, ball)[2], "any").direction
    scene = Scene(Object(ball.sphere, Material()), [DirectionalLight(-l) for l in shaded])
    views = list(views_of(taken.images, (ball,)))
    priors = pose_priors(ball)
    report_progress("pose, light and material")
    found = _fit_ball(scene, views, priors)
    report_progress("errors")
    if found.clusters.by_jackknife.any() and found.clusters.scatter > FAR_MORE:  # patches disagree beyond noise
        found = _fit_with_pose_held(found.fit, views, ball, priors, shaded)
    return _as_calibration(taken, ball, _without_unseen_depth(found, ball))


def pose_priors(ball: Ball) -> Priors:
    """Return the pose that the outline shows, with its errors."""
    spread, priors = ball.errors.copy(), {}
    if isinstance(ball.camera, Camera):  # a pinhole camera sees radius / distance, so that the radius is the unit
        away = np.asarray(ball.sphere.center) - np.asarray(ball.camera.eye)
        spread[2] *= np.linalg.norm(away) / float(ball.sphere.radius)
    else:
        priors["radius"] = (float(ball.sphere.radius), float(ball.errors[2]))
    along = np.sqrt(np.square(spread[:, None] * ball.axes).sum(0))
    for axis, x, error in zip("xyz", np.asarray(ball.sphere.center), along, strict=True):
        priors[f"center.{axis}"] = (float(x), float(error))
    return priors


def _fit_ball(scene: Scene, views: Sequence[View], priors: Priors, *, start: str = "search") -> BallFit:
    """Fit pose, lights and material, and find the errors."""
    intensities = [f"lights.{i}.intensity" for i in range(1, len(views))]
    free = [*FREE, *(["radius"] if "radius" in priors else []), *intensities]
    found = fit(scene, views, free=free, priors=priors, start=start)
    with in_float64(found) as own:
        clusters = find_clusters(own)
    return BallFit(found, clusters, clusters.standard_errors(), found.determined, np.zeros(len(views)))


def _fit_with_pose_held(first: Fit, views: Sequence[View], ball: Ball, priors: Priors, shaded: Vectors) -> BallFit:
    """Fit again with the pose held at the outline's, where the model does not fit the ball.

    The residuals are then model error, which does not affect the outline. The errors of the pose are the outline's, and
    those of the directions include what the pose leaves open and how far the shading alone turns them.
    """
    tight = {name: (value, NEGLIGIBLE * error) for name, (value, error) in priors.items()}  # it holds the pose
    again = _fit_ball(first.scene, views, tight, start="scene")
    names = again.fit.names
    by_pose = {name: error for name, (_, error) in priors.items()}
    turned = float(np.linalg.norm(ball.errors[:2])) / float(ball.sphere.radius) / np.sqrt(3.0)
    by_pose |= {unknown.name: turned for unknown in again.fit.unknowns if unknown.kind == "direction"}
    return dataclasses.replace(
        again,
        errors=np.hypot(again.errors, [by_pose.get(name, 0.0) for name in names]),
        determined=again.determined | np.isin(names, list(priors)),
        model_error=degrees(shaded, _directions(again.fit.scene)),
    )


def _without_unseen_depth(found: BallFit, ball: Ball) -> BallFit:
    """Return the fit with center.z undetermined where the camera's rays are parallel, which do not show distance."""
    if isinstance(ball.camera, Camera):
        return found
    return dataclasses.replace(found, determined=found.determined & (np.array(found.fit.names) != "center.z"))


def _as_calibration(taken: Photographs, ball: Ball, found: BallFit) -> Calibration:
    scene = found.fit.scene
    return Calibration(
        ball="glossy",
        names=taken.names,
        balls=(ball,),
        scene=scene,
        images=taken.images,
        directions=_directions(scene),
        errors=found.direction_errors,
        intensities=np.array([np.asarray(light.intensity) for light in scene.lights]),  # pyright: ignore[reportAttributeAccessIssue]
        fit=found.fit,
        fit_errors=found.printed_errors,
        notes=(
            *_notes_of_fit(found.fit),
            *_of_model_error(found.model_error),
            f"errors: {found.clusters.sentence([u.quantity for u in found.fit.unknowns])}",
            *_of_cut_off_shadows(taken, ball),
            *_not_determined(ball, len(found.fit.views)),
            *taken.notes,
        ),
    )


def _notes_of_fit(found: Fit) -> list[str]:
    """Return the fit's notes but those on the pose, which comes from the outline."""
    center = {
        name for unknown in found.unknowns if unknown.kind == "center" for name in (unknown.quantity, unknown.name)
    }
    return [note for note in found.notes if center.isdisjoint(note.names)]


def _directions(scene: Scene) -> Vectors:
    """Return the unit vectors towards the lights."""
    return -np.array([np.asarray(light.direction) for light in scene.lights])  # pyright: ignore[reportAttributeAccessIssue]


def _of_model_error(model_error: Float[np.ndarray, " views"]) -> list[str]:
    if not model_error.any():
        return []
    return [
        "the model does not fit this ball: the shading alone, whatever its law, turns the directions by up to "
        f"{model_error.max():.2g} degrees, which their errors include."
    ]


def _of_cut_off_shadows(taken: Photographs, ball: Ball) -> list[str]:
    """Warn of shadows that are cut off at 0, where noise can only brighten them."""
    share = np.mean([np.mean(np.asarray(image[:])[ball.mask] <= 0.0) for image in taken.images])
    if share < SLIGHT:
        return []
    return [
        f"{100 * share:.0f} % of the ball's samples are 0: noise cut off at 0 makes k_a too large, by up to the "
        "noise's standard deviation. Fit with View(noise=..., floor=0) and clipped='tobit'."
    ]


def _not_determined(ball: Ball, photographs: int) -> list[str]:
    """Return what photographs of one ball do not determine, however good they are."""
    far = "" if isinstance(ball.camera, Camera) else " Its distance is unknown without the camera's intrinsics."
    lobes = "one photograph does not distinguish Phong's highlight from Blinn's, whose n_s is about four times larger."
    return [
        "k_d and k_s are known only times the light's intensity, taken as 1, and k_a only times the ambient light's. "
        "Photograph a card of known reflectance in the ball's place to find the factor.",
        f"lengths are in the unit in which the ball's radius is {float(ball.sphere.radius):.4g}.{far}",
        "one light, far away, was assumed: on one ball a near lamp's falloff looks like a turned light and another "
        "k_d, a second light on the same side like part of the first, and light from all around like k_a. Two mirror "
        "balls show where a lamp is.",
        *([lobes] if photographs == 1 else []),
        "ds.examine(calibration.fit) shows which numbers depend on a few pixels.",
    ]
