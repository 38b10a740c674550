"""Shots: photographs that could be taken, and the information that each would carry about a fit's unknowns."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import numpy as np

from ..core.fields import Checked, Scalar, as_scalar, check_kind, is_concrete, parameter_of, quantities
from ..core.words import errors_at
from ..inverse.data.recording import photograph
from ..inverse.data.samples import find_samples
from ..inverse.data.view_sets import ViewSet
from ..inverse.data.views import View, channels, lights_on
from ..inverse.problem import fit_problem, moves_surface
from ..inverse.result import Fit
from ..inverse.statistics.uncertainty import Matrix
from ..inverse.unknowns.places import Place
from ..inverse.unknowns.slots import put_back
from ..inverse.unknowns.unknown import Unknown, coordinate_slopes, coordinates
from ..model.cameras import AbstractCamera
from ..model.gbuffers import GBuffer
from ..model.lights import AbstractLight
from ..model.rendering import silhouette
from ..model.scenes import Scene
from .grams import gram_of

# A shot states where its light is and where it points. The lamp's other unknowns are shared with the fit's lamps.
PLACED = {"position", "direction", "edge"}  # roles of the numbers that say where a light is


class Shot(Checked):
    """A photograph that could be taken, for `plan`.

    Args:
        light: The only light that is on; by default the lights of the fit's first view. A parameter that the fit shares
            between all of its lamps of this kind, such as `attenuation`, is unknown for this light too: it is the same
            lamp in another place.
        camera: By default the camera of the first view.
        exposure: The factor from radiance to image values, above 0, taken as known; 1 by default.
        name: A name for the table; by default the shot's index.

    Raises:
        ValueError: If `exposure` is not above 0.
        TypeError: If an argument has another type.
    """

    light: AbstractLight | None = None
    camera: AbstractCamera | None = None
    exposure: Scalar = eqx.field(converter=as_scalar, default=1.0)
    name: str = eqx.field(static=True, default="")

    def check_together(self) -> None:
        if self.light is not None:
            check_kind("Shot.light", self.light, AbstractLight, "PointLight((0, 0, 3))")
        if self.camera is not None:
            check_kind("Shot.camera", self.camera, AbstractCamera, "Camera(eye=(0, 0, 4))")
        if is_concrete(self.exposure) and not self.exposure > 0:
            raise ValueError(f"Shot.exposure must be above 0; got {self.exposure}. Give 1 if it is not known.")
        if not isinstance(self.name, str):
            raise TypeError(f"Shot.name must be a string; got {self.name!r}. Give for example 'lamp near'.")


def information_of_shot(fit: Fit, shot: Shot, name: str) -> tuple[Matrix, float]:
    """Return what a shot adds to the Fisher information of a fit, at the fitted values. Runs in float64.

    Args:
        fit: The fit.
        shot: The photograph to come.
        name: Its name.

    Returns:
        The Gram matrix J^T J of its samples, in the units of the fitted values, and the fraction of its pixels that
        the sensor would clip; they do not count.

    Raises:
        ValueError: If the shot sees no object, or needs a camera that the scene's surface does not allow.
    """
    moving = moves_surface(fit.unknowns)
    scene, unknowns, view = place_shot(fit, shot, name, moving=moving)
    with errors_at(name):
        view = dataclasses.replace(view, image=photograph(scene, view))
        samples = find_samples(scene, view, moving=moving)
    measured = ~samples.ends().any(-1)
    if not measured.any():
        return np.zeros((len(unknowns),) * 2), 1.0
    data = ViewSet.of(scene, [view]).with_samples([samples.at(samples.pixels[measured])])
    problem = fit_problem(scene, data, unknowns, "squares")
    gram = gram_of(coordinates(fit.values, unknowns), problem.model, problem.chunks())
    slope = coordinate_slopes(fit.values, unknowns)
    # A robust loss gives the shot's samples the mean weight of the views' samples.
    count, _, _, _, weight = fit.evidence.spread
    return gram.scaled(slope).total(len(slope)) * weight / count, 1.0 - float(measured.mean())


def place_shot(fit: Fit, shot: Shot, name: str, *, moving: bool) -> tuple[Scene, list[Unknown], View]:
    """Put the shot's light into the fitted scene, and find the fit's unknowns there.

    An unknown of the views alone has no place there. The view has the first one's sensor, but no image yet.
    """
    places = [[place for place in u.places if place.owner != "views"] for u in fit.unknowns]
    scene, first = fit.scene, fit.views[0]
    lit, camera = first.lit, first.camera if shot.camera is None else shot.camera
    if shot.light is not None:
        lit = (len(scene.lights),)
        light = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), shot.light)
        scene = dataclasses.replace(scene, lights=(*scene.lights, light))
        for place, shared in unknowns_of_lamp(fit, light).items():
            if len(shared) == 1 and (j := next(iter(shared))) is not None:
                places[j].append(dataclasses.replace(place, item=lit[0]))
    unknowns = [dataclasses.replace(u, places=tuple(of)) for u, of in zip(fit.unknowns, places, strict=True)]
    scene, _ = put_back(scene, (), unknowns, fit.values)
    _check_camera(fit, camera, name)
    inside = np.asarray(silhouette(scene.objects, camera))
    if not inside.any():
        eye = ", ".join(f"{x:g}" for x in camera.eye)
        raise ValueError(f"{name} sees no object from its camera at ({eye}). Set the camera's target to one.")
    view = dataclasses.replace(
        first,
        image=np.zeros((*camera.shape, channels(first))),
        camera=camera,
        mask=inside if moving else None,
        lit=lit,
        exposure=shot.exposure,
        saturation=fit.solved.problem.data.samples[0].sensor_range.level,
    )
    return scene, unknowns, view


def _check_camera(fit: Fit, camera: AbstractCamera, name: str) -> None:
    """Refuse another camera where the surface is known only per pixel of the fit's cameras."""
    same = eqx.tree_equal(*(jax.tree.map(np.asarray, c) for c in (camera, fit.views[0].camera)))
    if not same and any(isinstance(item.surface, GBuffer) for item in fit.scene.objects):
        raise ValueError(
            f"{name} has a camera of its own, but this scene has a GBuffer, which holds the surface for the fit's "
            "cameras only. Leave Shot.camera out."
        )


def unknowns_of_lamp(fit: Fit, light: AbstractLight) -> dict[Place, set[int | None]]:
    """Return the unknowns behind each number of a light, taken from the fit's lights of the same kind.

    The places are those of a light without an index. None stands for a known number. One unknown for all of these
    lights belongs to the lamp. A light that is off in every view is ignored.
    """
    on = {i for view in fit.views for i in lights_on(fit.scene, view)}
    same_kind = [i for i in sorted(on) if _kind(fit.scene.lights[i]) == _kind(light)]
    unknown_at = {place: j for j, u in enumerate(fit.unknowns) for place in u.places}
    return {
        Place("lights", None, fields, c): {unknown_at.get(Place("lights", i, fields, c)) for i in same_kind}
        for fields, value, spec in quantities(light)
        if parameter_of(spec).role not in PLACED
        for c in range(np.size(value))
    }


def _kind(light: AbstractLight) -> tuple[type, type]:
    """Return what kind a light is, and its law of attenuation."""
    return type(light), type(getattr(light, "attenuation", None))
