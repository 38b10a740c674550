"""Level: what all photographs of an object show beside its light: a black level, haze, or what the lens scatters.

Where a light does not reach a texel, the darkest of all photographs show what is in all of them. If that is taken off
and the texels agree better with their model, it is no light of theirs. Light of the room that the object reflects is
not told apart from it where it is as dark.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ...core.thresholds import BLACK, NEGLIGIBLE, SLIGHT
from ...core.words import Note
from ...inverse.data.views import View
from ...model.scenes import Scene
from ..lighting import lighting_setup
from ..robust.learning import MIN_SAMPLES
from .exposures import Taught


def darker(views: Sequence[View], level: float) -> list[View]:
    """Return views whose black is higher by a level."""
    return [dataclasses.replace(view, black=float(view.black) + level) for view in views]


def found_level(scene: Scene, views: Sequence[View], first: Taught) -> tuple[float, Taught, tuple[Note, ...]]:
    """Return the level that all photographs share, what they teach with it taken off, and a note.

    0, and what was taught first, where there is none, or where the texels agree no better without it.

    Args:
        scene: One object and its lights.
        views: The photographs.
        first: What they teach as they are.
    """
    sample, black = first.sample, np.array([float(view.black) for view in views])
    seen = sample.target.mean(1) - black[:, None]
    in_shadow = sample.counts & ~np.asarray(first.run.sample_at_minimum(sample, first.models[0]).lit)
    if in_shadow.sum() < MIN_SAMPLES:
        return 0.0, first, ()
    level, typical = float(np.quantile(seen[in_shadow], SLIGHT)), float(np.median(seen[sample.counts]))
    if not NEGLIGIBLE * typical < level < BLACK * typical:
        return 0.0, first, ()
    run = first.run.under(lighting_setup(scene, darker(views, level)))
    misfit = Taught(run, run.learn(sample, first.models[0].assumed), sample).misfit
    if not misfit < first.misfit:
        return 0.0, first, ()
    text = (
        f"all photographs show {level:.2g} where no light reaches the object, {level / typical:.1%} of what it "
        "typically shows: a black level or haze. It is taken off, for the texels then agree better (their misfit is "
        f"{misfit:.2%}, and was {first.misfit:.2%}); match_exposures=False, or --no-exposure, leaves it."
    )
    return level, Taught(run, run.learn(sample), sample), (Note(text, "black"),)  # other things may be assumed now
