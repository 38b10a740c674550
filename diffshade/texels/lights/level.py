"""Level: what all photographs of an object show beside its light: a black level, haze, or what the lens scatters.

Where a light does not reach a texel, the darkest of all photographs show what is in all of them. If that is taken off
and the texels agree better with their model, it is no light of theirs. Light of the room that the object reflects is
not told apart from it where it is as dark.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ...core.thresholds import BLACK, NEGLIGIBLE, SLIGHT
from ...core.words import Note
from ..robust.learning import MIN_SAMPLES
from .taught import Taught


def without_level(first: Taught) -> Taught:
    """Return what the texels teach with the level that all photographs share taken off, and a note.

    What was taught first, where there is none, or where the texels agree no better without it.
    """
    sample, black = first.sample, np.array([float(view.black) for view in first.views])
    seen = sample.target.mean(1) - black[:, None]
    in_shadow = sample.counts & ~np.asarray(first.run.sample_at_minimum(sample, first.models[0]).lit)
    if in_shadow.sum() < MIN_SAMPLES:
        return first
    level, typical = float(np.quantile(seen[in_shadow], SLIGHT)), float(np.median(seen[sample.counts]))
    if not NEGLIGIBLE * typical < level < BLACK * typical:
        return first
    darker = [dataclasses.replace(view, black=float(view.black) + level) for view in first.views]
    found = first.under(first.scene, darker, assumed=first.models[0].assumed)
    if not found.misfit < first.misfit:
        return first
    text = (
        f"all photographs show {level:.2g} where no light reaches the object, {level / typical:.1%} of what it "
        "typically shows: a black level or haze. It is taken off, for the texels then agree better (their misfit is "
        f"{found.misfit:.2%}, and was {first.misfit:.2%}); match_exposures=False, or --no-exposure, leaves it."
    )
    models = found.run.learn(sample)  # other things may be assumed now
    return found._replace(models=models, level=level).noted(Note(text, "black"))
