r"""Exposures: how much more each photograph shows than it is said to, channel by channel, from all texels of an object.

What a texel shows of each channel, relative to its mean over the channels, is the same in all photographs, so that a
photograph's own colour is the median of what its texels differ by. Its brightness follows with all texels eliminated
(`joint`), and with the directions of the lights, which are known to a degree or so, left to move as far.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from ...core.fields import Array
from ...core.thresholds import CLEARLY, DEGREE, MINOR, SMALL
from ...core.words import MAX_NAMED, Note
from ...inverse.data.recording import developed
from ...inverse.data.sensors import Sensor
from ...inverse.data.views import View, lights_on
from ...inverse.unknowns.light_priors import middle_of
from ...model.scenes import Scene
from ..between_lights import MIN_VIEWS
from ..blocks import TexelBlock
from ..geometry import lighting_geometry
from ..lighting import Exposures, LightErrors, LightingSetup, lighting_setup
from ..prediction import KnownCoefficients
from ..robust.calibration import GROUPS
from ..robust.choice import errors_of_shared, fewer, mean_error
from ..robust.learning import MIN_SAMPLES, ObjectModel
from ..robust.observations import reflectances
from ..robust.run import RobustRun
from ..robust.turned_lights import note_on_directions
from ..tiles import LEARNING_SAMPLE, TexelTile, ViewReader
from .joint import Responses, light_equations, responses
from .placing import LightEstimates, directions_to, scene_with
from .refining import Stated, refine

ANOTHER_BRIGHTNESS = CLEARLY * SMALL  # of the logarithm: what a model leaves out of real photographs moves none as far
HARDLY_LIT = MINOR  # of a texel's brightest: below it noise and ambient light have a colour of their own


def notes_on(found: Exposures, scene: Scene, views: Sequence[View]) -> tuple[Note, ...]:
    """Return in words what was found, and which lights are far from where the scene says."""
    note = Note(
        "photographs are brighter or darker than their exposures say, or of another colour: "
        f"{_named(found.factor)}, within {np.median(found.error):.1%}. This was found from the object and undone; "
        "match_exposures=False, or --no-exposure, takes them as they are said to be.",
        "exposure",
    )
    said = directions_to(scene, _lights_of(scene, views), middle_of(scene))
    return (note, *note_on_directions(found.directions, said, np.ones(len(views), bool)))


def _lights_of(scene: Scene, views: Sequence[View]) -> Int[np.ndarray, " views"]:
    """Return the light of each view."""
    return np.array([lights_on(scene, view)[0] for view in views])


def undone(found: Exposures, scene: Scene, views: Sequence[View]) -> tuple[Scene, tuple[View, ...]]:
    """Return a scene with the lights as found, and views that say how they were exposed."""
    used = _lights_of(scene, views)
    lamps = LightEstimates(found.directions, np.ones(len(views)))
    moved = scene_with(scene, used, lamps, middle_of(scene))
    return moved, tuple(_exposed(view, factor) for view, factor in zip(views, found.factor, strict=True))


def _exposed(view: View, factor: Float[np.ndarray, " channels"]) -> View:
    """Return a view that says by how much more it shows; what only a channel shows is taken from its image."""
    of_green = factor[len(factor) // 2]
    view = dataclasses.replace(view, exposure=float(view.exposure) * of_green)
    if (factor == of_green).all():
        return view
    return developed(dataclasses.replace(view, sensor=Sensor(red=factor[0] / of_green, blue=factor[-1] / of_green)))


class Taught(NamedTuple):
    """Photographs of an object, what works on their texels, and what a sample of these has taught."""

    run: RobustRun
    models: Sequence[ObjectModel]
    """Of the object's regions."""
    sample: TexelTile

    @property
    def error(self) -> float:
        """How far photographs that are left out are from what the others predict."""
        return mean_error(errors_of_shared(self.run, fewer(self.sample), self.models))


def found_exposures(
    scene: Scene, views: Sequence[View], first: Taught, light_error: LightErrors | None
) -> Exposures | Note | None:
    """Return how much more each photograph shows than it is said to; None where that is less than models leave out.

    Brightness is believed only if photographs that are left out are predicted better; else, and with less than twelve
    photographs, a note says that it differs. Each photograph must have one light of its own.

    Args:
        scene: One object and its lights.
        views: The photographs.
        first: What they teach with the exposures as they are said to be.
        light_error: How well the lights are known; None is a degree.
    """
    if not _one_light_each(scene, views):
        return None
    colour, every = _colours(first), len(views)
    coloured, step = np.abs(np.log(colour)).max() > MINOR, _first_step(first)
    if not coloured and np.abs(step).max() < ANOTHER_BRIGHTNESS:
        return None
    given = directions_to(scene, _lights_of(scene, views), middle_of(scene))
    as_said = Exposures(colour if coloured else np.ones_like(colour), np.abs(step), given)
    if every >= MIN_VIEWS:
        turn = errors_with(as_said, light_error).direction
        error, found = np.sqrt(np.square(turn).sum((1, 2)) / 3.0), as_said
        for held in (0.0, 1.0):  # lights that may move at once take the exposures' part
            found = _refined(found, scene, views, first.run, held * error)
        if _taught(first.run, *undone(found, scene, views)).error < first.error:
            return found
    if coloured:
        return as_said
    return Note(
        f"photographs seem to be brighter or darker than their exposures say, {_named(np.exp(step)[:, None])}, but do "
        f"not tell by how much: it takes {MIN_VIEWS} that agree. State their exposures.",
        "exposure",
    )


def errors_with(found: Exposures, light_error: LightErrors | None) -> LightErrors:
    """Return how well the lights are known with these exposures: their directions to a degree, if nothing is said."""
    each = np.broadcast_to(DEGREE * np.eye(3), (len(found.error), 3, 3))
    return LightErrors(each if light_error is None else light_error.direction, found.error)


def _named(factor: Float[np.ndarray, "views channels"]) -> str:
    """Return in words by how much the photographs that differ most do."""
    most = np.argsort(-np.abs(np.log(factor)).max(-1), kind="stable")[:MAX_NAMED]
    return ", ".join(f"views[{v}] {' '.join(f'{one:.2f}' for one in factor[v])}" for v in most) + " times"


def _one_light_each(scene: Scene, views: Sequence[View]) -> bool:
    """Whether each view has one light, of which the direction is known, and no other view has it."""
    on = [lights_on(scene, view) for view in views]
    if any(len(lights) != 1 for lights in on) or len({i for (i,) in on}) < max(len(views), GROUPS):
        return False
    return all(scene.lights[i].placement in (("direction",), ("position",)) for (i,) in on)


def _run_like(run: RobustRun, scene: Scene, views: Sequence[View]) -> RobustRun:
    """Return what works on the texels of other views of the same object."""
    setup = lighting_setup(scene, views)
    return RobustRun(
        setup, run.known, run.loss, run.regions, run.tiles, neighbours=run.neighbours, light_error=run.light_error
    )


def _taught(run: RobustRun, scene: Scene, views: Sequence[View]) -> Taught:
    """Return what other views of the same object teach."""
    other, sample = _run_like(run, scene, views), ViewReader(scene, views).sample(LEARNING_SAMPLE)
    return Taught(other, other.learn(sample), sample)


def _refined(
    found: Exposures, scene: Scene, views: Sequence[View], run: RobustRun, error: Float[np.ndarray, " views"]
) -> Exposures:
    """Return exposures that agree better with all texels, with lights that are known to an error, from those found."""
    used, middle = _lights_of(scene, views), middle_of(scene)
    given = directions_to(scene, used, middle)
    _, exposed = undone(found, scene, views)
    refined = refine(
        lambda lamps: scene_with(scene, used, lamps, middle),
        exposed,
        _run_like(run, scene, exposed),
        ViewReader(scene, exposed).sample(LEARNING_SAMPLE),
        np.arange(len(views)),
        Stated(given, error, np.full(len(views), np.inf)),
        run.tiles.report_progress,
    )
    directions, gain = refined.lamps
    off = np.sqrt(refined.own[:, 2, 2] + refined.shared[:, 2, 2])
    return Exposures(found.factor * gain[:, None], off, directions)


def _first_step(taught: Taught) -> Float[np.ndarray, " views"]:
    """Return the first Gauss-Newton step of the logarithm of each photograph's brightness, 0 in the mean."""
    run, models, sample = taught

    def program(block: TexelBlock, model: ObjectModel, _: np.ndarray | None) -> Responses:
        return responses([run.setup], run.known, block, model)

    every, texels = len(sample.counts), len(sample.pixels)
    equations = light_equations(run.each(sample, program, models), np.arange(every), every, np.zeros(texels, int), 1)
    # k_d takes back what all photographs have in common
    step = -np.linalg.pinv(equations.S, rcond=MINOR / every, hermitian=True) @ equations.gradient[0]
    return step - step.mean()


def _colours(taught: Taught) -> Float[np.ndarray, "views channels"]:
    """Return how much more each photograph shows of each channel than of their mean, 1 on average."""
    run, models, sample = taught

    def program(block: TexelBlock, _: ObjectModel, __: np.ndarray | None) -> Array:
        return _reflected(run.setup, run.known, block)

    shown = np.asarray(run.each(sample, program, models))
    grey = shown.mean(1)
    counts = sample.counts & (grey > HARDLY_LIT * grey.max(0)) & (shown > 0.0).all(1)
    with np.errstate(invalid="ignore", divide="ignore"):
        colour = np.where(counts[:, None], np.log(shown / grey[:, None]), np.nan)
    enough = counts.sum(0) > len(counts) // 2
    if enough.sum() < MIN_SAMPLES or shown.shape[1] == 1:
        return np.ones(shown.shape[:2])
    colour = colour[..., enough]
    off = np.nanmedian(colour - np.nanmedian(colour, 0), -1)
    off = np.where(np.isfinite(off), off, 0.0)
    return np.exp(off - off.mean(0) - (off - off.mean(0)).mean(1, keepdims=True))


@jax.jit
def _reflected(
    setup: LightingSetup, known: KnownCoefficients, block: TexelBlock
) -> Float[Array, "views channels texels"]:
    return reflectances(setup, known, block, lighting_geometry(setup, block.p, block.v))[0]
