"""Shots: photographs that could be taken, and the information that each would carry about a fit's unknowns."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..core.fields import Array, Checked, Scalar, as_scalar, check_kind, is_concrete, parameter_of, quantities
from ..inverse.data.recording import photograph
from ..inverse.data.samples import Samples, find_samples
from ..inverse.data.view_sets import ViewSet
from ..inverse.data.views import View, channels, has_mask, lights_on
from ..inverse.forward.gram import Gram
from ..inverse.forward.interface import AbstractForwardModel
from ..inverse.pixels.blocks import Block, total
from ..inverse.problem import fit_problem
from ..inverse.result import Fit
from ..inverse.statistics.uncertainty import Matrix
from ..inverse.unknowns.slots import put_back
from ..inverse.unknowns.unknown import Unknown, coordinate_slopes, coordinates
from ..model.cameras import AbstractCamera
from ..model.gbuffers import GBuffer
from ..model.lights import AbstractLight
from ..model.rendering import silhouette
from ..model.scenes import Scene
from ..parallel.threads import on_all_cores

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


class ShotInformation(NamedTuple):
    """What a shot would measure."""

    hessian: Matrix
    """The Gram matrix J^T J of its samples, in the units of the fitted values."""
    clipped: float
    """The fraction of its pixels that the sensor would clip; they do not count."""


class PlacedShot(NamedTuple):
    """A shot in the fitted scene."""

    scene: Scene
    lit: tuple[int, ...] | None
    unknowns: list[Unknown]
    """The fit's unknowns with their places in this scene; an unknown of the views alone has no place in a shot."""
    camera: AbstractCamera


def information_of_shot(fit: Fit, shot: Shot, name: str) -> ShotInformation:
    """Return the information that a shot adds about the fit's unknowns, at the fitted values. Runs in float64.

    Raises:
        ValueError: If the shot sees no object, or needs a camera that the scene's surface does not allow.
    """
    placed = place_shot(fit, shot)
    _check_camera(fit, placed, name)
    inside = _visible_object(placed, name)
    moving = any("surface" in path.split(".") for unknown in placed.unknowns for path, _ in unknown.places)
    try:
        view = _predicted_view(fit, shot, placed, mask=inside if moving else None, moving=moving)
        samples = find_samples(placed.scene, view, moving=moving)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    measured = ~samples.ends().any(-1)
    clipped = 1.0 - float(measured.mean())
    if not measured.any():
        return ShotInformation(np.zeros((len(placed.unknowns),) * 2), clipped)
    return ShotInformation(_gram_of_view(fit, placed, view, samples.at(samples.pixels[measured])), clipped)


def place_shot(fit: Fit, shot: Shot) -> PlacedShot:
    """Put the shot's light into the fitted scene, and find the fit's unknowns there."""
    new: dict[int, list[tuple[str, int]]] = {}
    scene, lit = fit.scene, fit.views[0].lit
    if shot.light is not None:
        number = len(scene.lights)
        light = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), shot.light)
        scene, lit = dataclasses.replace(scene, lights=(*scene.lights, light)), (number,)
        for leaf, unknowns in unknowns_of_lamp(fit, light).items():
            if len(unknowns) == 1 and None not in unknowns:
                new.setdefault(unknowns.pop() or 0, []).append((f"lights.{number}.{leaf[0]}", leaf[1]))
    unknowns = [
        dataclasses.replace(u, places=[*(p for p in u.places if not p[0].startswith("views.")), *new.get(j, [])])
        for j, u in enumerate(fit.unknowns)
    ]
    camera = fit.views[0].camera if shot.camera is None else shot.camera
    return PlacedShot(put_back(scene, (), unknowns, fit.values)[0], lit, unknowns, camera)


def unknowns_of_lamp(fit: Fit, light: AbstractLight) -> dict[tuple[str, int], set[int | None]]:
    """Return the unknowns behind each number of a light, taken from the fit's lights of the same kind.

    None stands for a known number. One unknown for all of these lights belongs to the lamp. A light that is off in
    every view is ignored.
    """
    on = {i for view in fit.views for i in lights_on(fit.scene, view)}
    same_kind = [i for i in sorted(on) if _kind(fit.scene.lights[i]) == _kind(light)]
    unknown_at = {place: j for j, u in enumerate(fit.unknowns) for place in u.places}
    return {
        (leaf, c): {unknown_at.get((f"lights.{i}.{leaf}", c)) for i in same_kind}
        for leaf, value, spec in quantities(light)
        if parameter_of(spec).role not in PLACED
        for c in range(np.size(value))
    }


def _kind(light: AbstractLight) -> tuple[type, type]:
    """Return what kind a light is, and its law of attenuation."""
    return type(light), type(getattr(light, "attenuation", None))


def _check_camera(fit: Fit, placed: PlacedShot, name: str) -> None:
    """Refuse another camera where the surface is known only per pixel of the fit's cameras."""
    same = eqx.tree_equal(*(jax.tree.map(np.asarray, c) for c in (placed.camera, fit.views[0].camera)))
    if not same and any(isinstance(item.surface, GBuffer) for item in placed.scene.objects):
        raise ValueError(
            f"{name} has a camera of its own, but this scene has a GBuffer, which holds the surface for the fit's "
            "cameras only. Leave Shot.camera out."
        )


def _visible_object(placed: PlacedShot, name: str) -> Any:
    """Return the pixels that show an object."""
    inside = np.asarray(silhouette(placed.scene.objects, placed.camera))
    if not inside.any():
        eye = ", ".join(f"{x:g}" for x in placed.camera.eye)
        raise ValueError(f"{name} sees no object from its camera at ({eye}). Set the camera's target to one.")
    return inside


def _predicted_view(fit: Fit, shot: Shot, placed: PlacedShot, *, mask: Any, moving: bool) -> View:
    """Return the photograph to expect, with the first view's sensor: black level, noise and saturation."""
    first = fit.views[0]
    view = View(
        np.zeros((*placed.camera.shape, channels(first))),
        placed.camera,
        mask=mask,
        lit=placed.lit,
        exposure=shot.exposure,
        black=first.black,
        noise=first.noise,
        saturation=find_samples(fit.scene, first, moving=moving and has_mask(first)).sensor_range.level,
        floor=first.floor,
        sensor=first.sensor,
        bands=first.bands,
    )
    return dataclasses.replace(view, image=photograph(placed.scene, view))


def _gram_of_view(fit: Fit, placed: PlacedShot, view: View, samples: Samples) -> Matrix:
    """Return J^T J of a view's samples, in the units of the fitted values."""
    unknowns, data = placed.unknowns, ViewSet.of(placed.scene, [view]).with_samples([samples])
    problem = fit_problem(placed.scene, data, unknowns, "squares")
    theta = jnp.asarray(coordinates(fit.values, unknowns))
    summaries = on_all_cores(lambda chunk: _summary(theta, problem.model, chunk), problem.chunks())
    H = np.asarray(_gram(theta, problem.model, total(summaries)).hessian)
    slope = coordinate_slopes(fit.values, unknowns)
    # A robust loss gives the shot's samples the mean weight of the views' samples.
    count, _, _, _, weight = fit.evidence.spread
    return H * np.outer(slope, slope) * weight / count


@jax.jit
def _summary(theta: Array, model: AbstractForwardModel, chunk: Block) -> Any:
    return model.summary(theta, chunk)


@jax.jit
def _gram(theta: Array, model: AbstractForwardModel, summary: Any) -> Gram:
    return model.gram(theta, summary).total(len(theta))
