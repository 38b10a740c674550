r"""Exposures: how much more each photograph shows than it is said to, channel by channel, from all texels of an object.

What a texel shows of each channel beside its highlight, relative to its mean over the channels, is the same in all
photographs, so that a photograph's own colour is the median of what its texels differ by. Its brightness follows with
all texels eliminated (`joint`), and with the directions of the lights, which are known to a degree or so, left to move
as far. The median photograph is as bright as it is said to be, for k_d takes back what all have in common.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from ...core.fields import Array
from ...core.thresholds import CLEARLY, MINOR, SLIGHT, SMALL, TINY
from ...core.words import MAX_NAMED, Note
from ...inverse.data.views import View
from ...inverse.unknowns.light_priors import middle_of
from ...model.scenes import Scene
from ..blocks import TexelBlock
from ..geometry import lighting_geometry
from ..lighting import Exposures, LightErrors, LightingSetup, lighting_setup
from ..prediction import KnownCoefficients
from ..robust.block_fits import lowest_state
from ..robust.calibration import GROUPS
from ..robust.choice import clearly_better, errors_of_shared, fewer
from ..robust.learning import MIN_SAMPLES, ObjectModel
from ..robust.observations import BlockObservations, observe, reflectances
from ..robust.robust_descent import DescentState
from ..robust.run import RobustRun
from ..robust.turned_lights import note_on_directions
from ..tiles import TexelTile
from .joint import Responses, light_equations, responses
from .placing import LightEstimates, directions_to, one_light_each, scene_with
from .refining import Stated, refine

ENOUGH = 2 * GROUPS  # photographs: of nine under lights on one side, another minimum explains other exposures as well
ANOTHER_BRIGHTNESS = CLEARLY * SMALL  # of the logarithm: what a model leaves out of real photographs moves none as far
HARDLY_LIT = MINOR  # of a texel's brightest: below it noise and ambient light have a colour of their own


class Taught(NamedTuple):
    """What works on the texels of an object, and what a sample of them has taught."""

    run: RobustRun
    models: Sequence[ObjectModel]
    """Of the object's regions."""
    sample: TexelTile

    @property
    def errors(self) -> Float[np.ndarray, " views"]:
        """How far each photograph is from what the others predict."""
        return errors_of_shared(self.run, fewer(self.sample), self.models)

    @property
    def misfit(self) -> float:
        """The typical residual, relative to the level of a texel."""
        return float(np.mean([model.relative_misfit for model in self.models]))


def found_exposures(
    scene: Scene, views: Sequence[View], first: Taught
) -> tuple[Exposures | None, Taught, tuple[Note, ...]]:
    """Return how much more each photograph shows than it is said to, what they teach with that undone, and notes.

    None, and what was taught first, where it is not told. Each photograph must have one light of its own. Brightness is
    believed only if photographs that are left out are clearly predicted better, of twelve or more, and if its error is
    below a tenth, since wrong lights look like exposures that are hardly told; else a note says that it differs.

    Args:
        scene: One object and its lights.
        views: The photographs.
        first: What they teach with the exposures as they are said to be.
    """
    used, every = one_light_each(scene, views), len(views)
    colour = None if used is None or len(set(used)) < max(every, GROUPS) else _colours(first)
    if used is None or colour is None:
        return None, first, ()
    coloured, step = np.abs(np.log(colour)).max() > MINOR, _first_step(first)
    if not coloured and np.abs(step).max() < ANOTHER_BRIGHTNESS:
        return None, first, ()
    rig = _Rig(scene, views, used, directions_to(scene, used, middle_of(scene)))
    as_said = Exposures(colour if coloured else np.ones_like(colour), np.maximum(np.abs(step), SLIGHT), rig.given)
    found, vague = as_said, False
    if every >= ENOUGH:
        for free in (0.0, 1.0):  # lights that may move at once take the exposures' part
            found = _refined(found, rig, first, free * _of_directions(as_said, first.run.light_error))
        taught = _taught_with(found, rig, first)
        agrees = clearly_better(first.errors, taught.errors)
        vague = agrees and bool(np.median(found.error) > SMALL)
        if agrees and not vague:
            return found, taught, _notes_on(found, rig.given)
    left: tuple[Note, ...] = ()
    if np.abs(step).max() >= ANOTHER_BRIGHTNESS and (vague or every < ENOUGH):
        told = f"they tell it to {np.median(found.error):.0%} only" if vague else f"fewer than {ENOUGH} do not tell it"
        text = (
            f"photographs seem to be brighter or darker than their exposures say, {_named(np.exp(step)[:, None])}, but "
            f"{told}: that was not undone. State their exposures, or add photographs."
        )
        left = (Note(text, "exposure"),)
    if not coloured:
        return None, first, left
    return as_said, _taught_with(as_said, rig, first), (*_notes_on(as_said, rig.given), *left)


class _Rig(NamedTuple):
    """Photographs under one light each, as they are said to be."""

    scene: Scene
    views: Sequence[View]
    used: Int[np.ndarray, " views"]
    """The light of each."""
    given: Float[np.ndarray, "views 3"]
    """Unit vectors to the lights."""

    def lit(self, lamps: LightEstimates) -> Scene:
        """Return the scene with its lights in these directions, and as much brighter."""
        return scene_with(self.scene, self.used, lamps, middle_of(self.scene))


def undone(found: Exposures, rig: _Rig) -> Scene:
    """Return a scene whose lights are where they were found, and as much brighter as their photographs are exposed."""
    return rig.lit(LightEstimates(found.directions, found.factor))


def _taught_with(found: Exposures, rig: _Rig, first: Taught) -> Taught:
    """Return what the same texels teach with exposures undone, with errors that contain those of the exposures."""
    run = first.run.under(lighting_setup(undone(found, rig), rig.views), _errors_with(found, first.run.light_error))
    return Taught(run, run.learn(first.sample), first.sample)


def _errors_with(found: Exposures, light_error: LightErrors) -> LightErrors:
    """Return how well the lights are known with these exposures.

    What a model leaves out is alike under lights that are near each other, and so are the exposures' errors by it. They
    are taken to change linearly with the light's direction, each of three ways as likely, which turns all normals.
    """
    apart, size, _ = np.linalg.svd(found.directions - found.directions.mean(0), full_matrices=False)
    apart = apart * (size > SMALL * size[0])  # lights of one height differ in two ways
    alike = found.error * apart.T * np.sqrt(len(apart) / 3.0)
    return LightErrors(light_error.direction, found.error, alike)


def _of_directions(found: Exposures, light_error: LightErrors) -> Float[np.ndarray, " views"]:
    """Return the standard deviation of each direction about each of the two axes across it."""
    root = light_error.direction
    along = np.einsum("vi,vij->vj", found.directions, root)
    return np.sqrt((np.square(root).sum((1, 2)) - np.square(along).sum(1)) / 2.0)


def _notes_on(found: Exposures, said: Float[np.ndarray, "views 3"]) -> tuple[Note, ...]:
    """Return in words what was found, and which lights are far from where the scene says."""
    text = (
        "photographs are brighter or darker than their exposures say, or of another colour: "
        f"{_named(found.factor)}, within {np.median(found.error):.1%}, if the median one is as bright as stated, "
        "which none tells from k_d. This was found from the object and undone; "
        "match_exposures=False, or --no-exposure, takes them as they are said to be."
    )
    moved = note_on_directions(found.directions, said, np.ones(len(said), bool))
    return (Note(text, "exposure"), *moved)


def _named(factor: Float[np.ndarray, "views channels"]) -> str:
    """Return in words by how much the photographs that differ most do."""
    most = np.argsort(-np.abs(np.log(factor)).max(-1), kind="stable")[:MAX_NAMED]

    def times(of: Float[np.ndarray, " channels"]) -> str:
        if np.ptp(of) < SLIGHT:
            return f"{of[0]:.2f} times"
        return " ".join(f"{name} {one:.2f}" for name, one in zip(("red", "green", "blue"), of, strict=True)) + " times"

    more = f", and {len(factor) - len(most)} more" if len(factor) > len(most) else ""
    return ", ".join(f"views[{v}] {times(factor[v])}" for v in most) + more


def _refined(found: Exposures, rig: _Rig, first: Taught, error: Float[np.ndarray, " views"]) -> Exposures:
    """Return exposures that agree better with all texels, from those found, with lights that are known to an error."""

    def lit(lamps: LightEstimates) -> Scene:
        return rig.lit(LightEstimates(lamps.directions, found.factor * lamps.gain[:, None]))

    views, every = rig.views, len(rig.views)
    stated = Stated(rig.given, error, np.full(every, np.inf))
    run = first.run.under(lighting_setup(lit(LightEstimates(rig.given, np.ones(every))), views))
    refined = refine(lit, views, run, first.sample, np.arange(every), stated, run.tiles.report_progress)
    directions, gain = refined.lamps
    # what the model leaves out of a texel is alike over a photograph: it is no smaller for all of them
    error = np.sqrt(refined.own[:, 2, 2] + refined.shared[:, 2, 2] + refined.misfit**2)
    return Exposures(found.factor * (gain / np.median(gain))[:, None], error, directions)


def _first_step(taught: Taught) -> Float[np.ndarray, " views"]:
    """Return by how much brighter each photograph is to first order, as a logarithm, 0 in the median."""
    run, models, sample = taught

    def program(block: TexelBlock, model: ObjectModel, _: np.ndarray | None) -> Responses:
        return responses([run.setup], run.known, block, model)

    every, texels = len(sample.counts), len(sample.pixels)
    S, by_cell = light_equations(run.each(sample, program, models), np.arange(every), every, np.zeros(texels, int), 1)
    # a photograph that is far off has lost its weight: each by its own curvature, and what all share is nobody's
    scale = 1.0 / np.sqrt(np.maximum(np.diag(S), TINY))
    inverse = np.linalg.pinv(scale[:, None] * S * scale, rcond=MINOR / every, hermitian=True)
    step = -scale * (inverse @ (scale * by_cell[0]))
    return np.log(np.maximum(1.0 + step - np.median(step), SMALL))


def _colours(taught: Taught) -> Float[np.ndarray, "views channels"] | None:
    """Return how much more each photograph shows of each channel than of their mean, 1 in the median.

    None where a photograph lights too few texels. A highlight has a colour of its own: only what is matte tells, and a
    photograph that shows too little of it has the colour that it is said to have.
    """
    run, models, sample = taught

    def program(block: TexelBlock, model: ObjectModel, _: np.ndarray | None) -> tuple[Array, Array]:
        observed = observe(run.setup, run.known, block, model.assumed.dark_is_shadow)
        highlight = _highlight(observed, model, lowest_state(observed, model))
        return _reflected(run.setup, run.known, block), highlight

    shown, highlight = map(np.asarray, run.each(sample, program, models))
    grey = shown.mean(1)
    lit = sample.counts & (grey > HARDLY_LIT * grey.max(0)) & (shown > 0.0).all(1)
    if (lit.sum(1) < MIN_SAMPLES).any():
        return None
    lit &= highlight < MINOR * shown.min(1)  # it then changes no channel by what makes a photograph coloured
    told = lit.sum(1) >= MIN_SAMPLES
    known = np.broadcast_to((lit & told[:, None])[:, None], shown.shape)
    colour = np.ma.masked_array(np.log(np.where(known, shown / np.where(lit, grey, 1.0)[:, None], 1.0)), ~known)
    off = np.ma.median(colour - np.ma.median(colour, 0), -1).filled(0.0)
    off = np.where(told[:, None], off - np.median(off[told], 0), 0.0) if told.any() else off
    return np.exp(off - off.mean(1, keepdims=True))


@jax.jit
def _highlight(observed: BlockObservations, model: ObjectModel, state: DescentState) -> Float[Array, "views texels"]:
    """Return how much of what texels reflect is their highlight."""
    return observed.level[None] * state.k_s[None] * observed.lights.shading(model.shape, state.n)[1]


@jax.jit
def _reflected(
    setup: LightingSetup, known: KnownCoefficients, block: TexelBlock
) -> Float[Array, "views channels texels"]:
    return reflectances(setup, known, block, lighting_geometry(setup, block.p, block.v))[0]
