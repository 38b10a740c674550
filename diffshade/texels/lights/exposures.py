r"""Exposures: how much more each photograph shows than it is said to, channel by channel, from all texels of an object.

What a texel shows of each channel beside its highlight, relative to its mean over the channels, is the same in all
photographs, so that a photograph's own colour is the median of what its texels differ by. Its brightness follows with
all texels eliminated (`joint`), and with the directions of the lights, which are known to a degree or so, left to move
as far. The median photograph is as bright as it is said to be, for k_d takes back what all have in common.
"""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Float

from ...core.fields import Array
from ...core.robust_scale import RARE
from ...core.thresholds import CLEARLY, MINOR, SLIGHT, SMALL, TINY
from ...core.words import Note, first_of
from ...model.scenes import Scene
from ..geometry import lighting_geometry
from ..lighting import Exposures, LightErrors, LightingSetup
from ..prediction import KnownCoefficients, TexelBlock
from ..robust.calibration import GROUPS
from ..robust.choice import clearly_better
from ..robust.learning import MIN_SAMPLES
from ..robust.observations import reflectances
from ..robust.turned_lights import matte_texels, note_on_directions
from .joint import light_equations, responses
from .placing import LightEstimates, PlacedLights, one_light_each
from .refining import Stated, refine
from .taught import Taught

ENOUGH = 2 * GROUPS  # photographs: of nine under lights on one side, another minimum explains other exposures as well
ANOTHER_BRIGHTNESS = CLEARLY * SMALL  # of the logarithm: what a model leaves out of real photographs moves none as far
HARDLY_LIT = MINOR  # of a texel's brightest: below it noise and ambient light have a colour of their own


def with_exposures(first: Taught) -> Taught:
    """Return what photographs teach with how much more each shows than it is said to undone, the exposures, and notes.

    What was taught first, where it is not told. Each photograph must have one light of its own. Brightness is
    believed only if photographs that are left out are clearly predicted better, of twelve or more, if its error is
    below a tenth, and if one is beyond three errors, since wrong lights look like exposures that are hardly told; else
    a note says that it differs.
    """
    said, every = one_light_each(first.scene, first.views), len(first.views)
    colour = None if said is None or len(set(said.used)) < max(every, GROUPS) else _colours(first)
    if said is None or colour is None:
        return first
    coloured, step = np.abs(np.log(colour)).max() > MINOR, _first_step(first)
    if not coloured and np.abs(step).max() < ANOTHER_BRIGHTNESS:
        return first
    as_said = Exposures(colour if coloured else np.ones_like(colour), np.maximum(np.abs(step), SLIGHT), said.directions)
    found, vague = as_said, False
    if every >= ENOUGH:
        for free in (0.0, 1.0):  # lights that may move at once take the exposures' part
            found = _refined(found, said, first, free * _of_directions(as_said, first.run.light_error))
        taught = _taught_with(found, said, first)
        agrees = clearly_better(first.errors, taught.errors)
        known = np.abs(np.log(found.factor)).max(-1) > RARE * found.error
        vague = agrees and not (known.any() and np.median(found.error) < SMALL)
        if agrees and not vague:
            return taught
    taught = _taught_with(as_said, said, first) if coloured else first
    if np.abs(step).max() < ANOTHER_BRIGHTNESS or not (vague or every < ENOUGH):
        return taught
    told = f"they tell it to {np.median(found.error):.0%} only" if vague else f"fewer than {ENOUGH} do not tell it"
    text = (
        f"photographs seem to be brighter or darker than their exposures say, {_named(np.exp(step)[:, None])}, but "
        f"{told}: that was not undone. State their exposures, or add photographs."
    )
    return taught.noted(Note(text, "exposure"))


def undone(found: Exposures, said: PlacedLights) -> Scene:
    """Return a scene whose lights are where they were found, and as much brighter as their photographs are exposed."""
    return said.moved(LightEstimates(found.directions, found.factor))


def _taught_with(found: Exposures, said: PlacedLights, first: Taught) -> Taught:
    """Return what the same texels teach with exposures undone, with errors that contain those of the exposures."""
    taught = first.under(undone(found, said), first.views, light_error=_errors_with(found, first.run.light_error))
    return taught._replace(exposures=found).noted(*_notes_on(found, said.directions))


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

    def times(of: Float[np.ndarray, " channels"]) -> str:
        if np.ptp(of) < SLIGHT:
            return f"{of[0]:.2f} times"
        return " ".join(f"{name} {one:.2f}" for name, one in zip(("red", "green", "blue"), of, strict=True)) + " times"

    most = np.argsort(-np.abs(np.log(factor)).max(-1), kind="stable")
    return first_of([f"views[{v}] {times(factor[v])}" for v in most])


def _refined(found: Exposures, said: PlacedLights, first: Taught, error: Float[np.ndarray, " views"]) -> Exposures:
    """Return exposures that agree better with all texels, from those found, with lights that are known to an error."""
    every = len(first.views)
    stated = Stated(said.directions, error, np.full(every, np.inf))
    bright = said._replace(scene=said.moved(LightEstimates(said.directions, found.factor)))
    lambertian = bool(first.models[0].assumed.lambertian)
    refined = refine(bright, first.views, first.run, first.sample, np.arange(every), stated, lambertian=lambertian)
    directions, gain = refined.lamps
    # what the model leaves out of a texel is alike over a photograph: it is no smaller for all of them
    error = np.sqrt(refined.own[:, 2] + refined.shared[:, 2] + refined.misfit**2)
    return Exposures(found.factor * (gain / np.median(gain))[:, None], error, directions)


def _first_step(taught: Taught) -> Float[np.ndarray, " views"]:
    """Return by how much brighter each photograph is to first order, as a logarithm, 0 in the median."""
    every, one_cell = len(taught.views), np.zeros(len(taught.sample.pixels), int)
    answer = responses(taught.run, taught.sample, taught.models, [taught.run.setup])
    S, by_cell = light_equations(answer, np.arange(every), every, one_cell, 1)
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
    run, models, sample = taught.run, taught.models, taught.sample
    shown = run.each(sample, lambda block, *_: _reflected(run.setup, run.known, block), models)
    matte, grey = matte_texels(run, models, sample), shown.mean(1)
    lit = sample.counts & (grey > HARDLY_LIT * grey.max(0)) & (shown > 0.0).all(1)
    if (lit.sum(1) < MIN_SAMPLES).any():
        return None
    # what highlights add then changes no channel by what makes a photograph coloured
    lit &= matte.highlight * grey < MINOR * shown.min(1) * (matte.shown + matte.highlight)
    told = lit.sum(1) >= MIN_SAMPLES
    known = np.broadcast_to((lit & told[:, None])[:, None], shown.shape)
    colour = np.ma.masked_array(np.log(np.where(known, shown / np.where(lit, grey, 1.0)[:, None], 1.0)), ~known)
    off = np.ma.median(colour - np.ma.median(colour, 0), -1).filled(0.0)
    off = np.where(told[:, None], off - np.median(off[told], 0), 0.0) if told.any() else off
    return np.exp(off - off.mean(1, keepdims=True))


@jax.jit
def _reflected(
    setup: LightingSetup, known: KnownCoefficients, block: TexelBlock
) -> Float[Array, "views channels texels"]:
    return reflectances(setup, known, block, lighting_geometry(setup, block.p, block.v))[0]
