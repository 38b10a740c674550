"""Finding lights: `find_lights` refines lights that are known roughly, or finds unknown ones, from a whole object."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import ArrayLike, Float, Int

from ...core.backend import check_backend, in_float64
from ...core.fields import as_float64
from ...core.progress import showing
from ...core.thresholds import MOST
from ...core.words import Note
from ...inverse.data.recording import developed
from ...inverse.data.views import View, lights_on
from ...inverse.unknowns.light_priors import error_of_each
from ...model.scenes import Scene
from ..checks import check_anything_left, checked
from ..conventions import other_light_convention
from ..fitting import MEMORY
from ..robust.run import RobustRun
from ..robust.turned_lights import angle
from ..run import TexelRun
from ..tile_runner import TileRunner
from ..tiles import LEARNING_SAMPLE
from .encoding import MIN_PHOTOGRAPHS
from .found import FoundLights, notes_on
from .placing import MOVABLE, LightEstimates, PlacedLights
from .refining import LOOSE, Refined, Stated, refine
from .uncalibrated import find_uncalibrated

_LOGGER = logging.getLogger("diffshade")
FREE = ("k_d", "k_s", "n_s", "normal")


def find_lights(
    scene: Scene,
    views: Sequence[View],
    *,
    light_error: Float[ArrayLike, " lights"] | float | None = None,
    intensity_error: Float[ArrayLike, " lights"] | float | None = 0.0,
    progress: bool = False,
) -> FoundLights:
    """Find the lights of photographs of an object of unknown shape, together with the normals of its texels.

    Each light moves to where all texels agree with it, and each texel to where it agrees with all lights, with the
    texels eliminated (as in bundle adjustment; Triggs et al. 2000), under a Cauchy loss and with the highlight that all
    texels share. A linear map of all lights, with its inverse on the normals, changes a matte object's photographs not
    at all, and of others by less than what a model leaves out: it is taken from the stated directions.

    Without directions (`light_error=None`) the map is found as well as it can be. The photographs are a product of
    texels and lights (Hayakawa 1994); stated or equal intensities leave a rotation (Woodham et al. 1991), and the
    rotation is the one with which the normals are those of a surface (Belhumeur, Kriegman and Yuille 1999).

    Args:
        scene: One object and all lights, at least six; each is a direction or a position. A position keeps its distance
            from the middle of the object.
        views: Photographs of one camera, one light on in each.
        light_error: Standard deviation of the scene's directions to the lights about each axis, degrees: one number, or
            one for each light; 0 for all if they are exact. By default nothing is stated: all are found, without a
            prior.
        intensity_error: Relative standard deviation of the lights' intensities (.05 for 5 %): one number, or one for
            each light; 0, the default, for all if they are exact. With None nothing is stated of them.
        progress: Show a line of progress on the terminal.

    Returns:
        The lights with their errors, and what cannot be known of them. Directions that are described in other axes, or
        listed in another order, than the photographs are returned as they are, with infinite errors and a note.

    Raises:
        ValueError: An argument is wrong, or the lights are too few or in one plane; the message has the remedy.
        TypeError: An argument has the wrong type.
    """
    views = tuple(views)
    checked(scene, views, FREE, None, "cauchy")
    views = tuple(map(developed, views))
    light_of = _light_of(scene, views)
    lights = len(scene.lights)
    error = None if light_error is None else np.deg2rad(_errors("light_error", light_error, lights, "1.0"))
    brighter = np.full(lights, np.inf)
    if intensity_error is not None:
        brighter = _errors("intensity_error", intensity_error, lights, "0.05")
    check_backend()
    scene = jax.tree.map(as_float64, scene)
    with showing("lights", show=progress) as report_progress, in_float64((scene, views)) as (scene, views):
        used, index = np.unique(light_of, return_inverse=True)
        given = PlacedLights.of(scene, used)
        tiles = TileRunner(scene, views, "", report_progress, out=None, memory=MEMORY, devices=None)
        with contextlib.closing(tiles):
            sample = tiles.reader.sample(LEARNING_SAMPLE)
            check_anything_left(np.ones(len(sample.pixels)))
            stated = Stated(given.directions, np.full(len(used), LOOSE[0]), brighter[used])
            if error is not None:
                other = other_light_convention(scene, views, tiles.reader, sample)
                if other is not None:
                    _LOGGER.warning(other)
                    return _unmoved(given, light_of, other)
                stated = stated._replace(error=error[used])
            else:
                stated = stated._replace(directions=find_uncalibrated(scene, views, tiles.reader, sample, index))
            placed = given.moved(LightEstimates(stated.directions, np.ones(len(used))))
            each = TexelRun(placed, views, FREE, "cauchy", None, tiles)
            if error is not None and each.lights().coplanar > MOST:
                raise ValueError(
                    "the lights lie in one plane with the object, which leaves its normals, and so the lights, open. "
                    "Add photographs under lights out of the plane."
                )
            run = RobustRun(each.setup, each.known, "cauchy", None, tiles, neighbours=False)
            found = refine(given, views, run, sample, index, stated)
        return _result(given, found, light_of, stated, known=error is not None)


def _result(
    given: PlacedLights, found: Refined, light_of: Int[np.ndarray, " views"], stated: Stated, *, known: bool
) -> FoundLights:
    """Return what was found, for all lights of the scene."""
    directions, gain = found.lamps
    own, shared = (np.rad2deg(np.sqrt(of[:, :2].mean(1))) for of in (found.own, found.shared))
    brighter = np.sqrt(found.own[:, 2] + found.shared[:, 2])
    exact = bool((stated.intensity_error == 0.0).all())
    if exact:
        gain, brighter = np.ones_like(gain), np.zeros_like(brighter)

    def of_all(values: np.ndarray, nothing: float) -> np.ndarray:
        whole = np.full((len(given.scene.lights), *values.shape[1:]), nothing)
        whole[given.used] = values
        return whole

    notes = notes_on(
        stated=known,
        exact_directions=known and not (stated.error > 0.0).any(),
        exact_intensities=exact,
        shared=float(np.median(shared)),
        settled=found.settled,
        spread=float(np.std(np.log(gain))),
    )
    return FoundLights(
        given.moved(LightEstimates(directions, gain)),
        of_all(directions, np.nan),
        of_all(np.hypot(own, shared if known else np.inf), np.inf),
        of_all(own, np.inf),
        of_all(gain, 1.0),
        of_all(brighter, np.inf),
        of_all(np.rad2deg(angle(directions, given.directions)), 0.0),
        light_of,
        found.misfit,
        found.settled,
        tuple(notes),
    )


def _unmoved(given: PlacedLights, light_of: Int[np.ndarray, " views"], other: Note) -> FoundLights:
    """Return the lights as they were given, with nothing known of them: they are described otherwise than the views."""
    nothing = np.full(len(given.used), np.inf)
    unknown = np.full((len(nothing), 3), np.inf)
    kept = Refined(LightEstimates(given.directions, np.ones(len(nothing))), unknown, unknown, np.nan, settled=True)
    found = _result(given, kept, light_of, Stated(given.directions, nothing, nothing), known=True)
    return replace(found, notes=(other,))


def _light_of(scene: Scene, views: Sequence[View]) -> Int[np.ndarray, " views"]:
    """Return the light of each view; raise ValueError where there are several, too few, or of another kind."""
    found = []
    for v, view in enumerate(views):
        on = lights_on(scene, view)
        if len(on) != 1:
            raise ValueError(
                f"find_lights needs one light in each view; views[{v}] has {len(on)}. Give View.lit, or leave it out."
            )
        if scene.lights[on[0]].placement not in MOVABLE:
            raise ValueError(
                f"find_lights moves directions and positions; lights[{on[0]}] is a "
                f"{type(scene.lights[on[0]]).__name__}. Give a DirectionalLight or a PointLight."
            )
        if not np.min(np.asarray(getattr(scene.lights[on[0]], "intensity", 1.0))) > 0.0:
            raise ValueError(
                f"find_lights needs an intensity above 0 in every channel; lights[{on[0]}] has "
                f"{scene.lights[on[0]].intensity}. Give 1 where it is not known, or leave the view out."  # pyright: ignore[reportAttributeAccessIssue]
            )
        found.append(on[0])
    if len(set(found)) < MIN_PHOTOGRAPHS:
        raise ValueError(
            f"find_lights needs at least {MIN_PHOTOGRAPHS} lights; the views have {len(set(found))}. Add photographs "
            "under other lights."
        )
    return np.array(found)


def _errors(name: str, given: ArrayLike, lights: int, example: str) -> Float[np.ndarray, " lights"]:
    """Return the error of each light; raise ValueError for wrong ones."""
    each = error_of_each(name, given, lights, example)
    if (each == 0.0).any() != (each == 0.0).all():
        raise ValueError(
            f"{name} must be 0 for all lights or above 0 for all; got {given}. Give exact ones a small error."
        )
    return each
