"""Regional faults: the pixels that cast shadows and bright rims spoil, which of them to believe, and where they are."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from ...core.masks import Mask
from ...core.robust_scale import OUTLIER
from ...core.thresholds import MOST, SLIGHT, SMALL
from ...core.words import listing
from .changes import MAX_ALONE
from .regions import MeanPrediction, Shadow, cast_shadows, measure_rim, predicted, see
from .set_up import Corrected, MasksOf, SetUp

MIN_RIM_EXCESS = 2.0 * SLIGHT  # the least excess of a rim over the mean brightness
MIN_AGREEMENT = 0.75  # fraction of the views that must agree on a fault of all views


def shadows(set_up: SetUp, state: Corrected) -> MasksOf:
    """Return the cast shadows of each view."""
    found = {i: shadows_of(set_up, state, i, state.excluded[i]) for i in range(len(set_up.samples))}
    return {i: union(of) for i, of in found.items() if of}


def in_shadow(set_up: SetUp, before: Corrected, after: Corrected, masks: MasksOf) -> MasksOf:
    """Return the shadows of the views of whose cost they explain enough."""
    return {i: mask for i, mask in masks.items() if before.share(after, [i]) > SMALL}


def where_shadows_are(set_up: SetUp, end: Corrected, masks: MasksOf) -> tuple[str, MasksOf]:
    """Return in words where shadows are and how dark, and their pixels, where all other faults are corrected."""
    regions, places = {}, []
    for i, mask in masks.items():
        found = [s for s in shadows_of(set_up, end, i, None) if (s.mask & mask).any()]
        regions[i] = union(found) if found else mask
        lights = [f"lights.{j}" for j in dict.fromkeys(j for s in found for j in s.lights)]
        source = f" under {listing(lights)}" if lights and len(lights) <= MAX_ALONE else ""
        shown = max((s.shown for s in found), default=0.0)
        row, column = (round(float(x.mean())) for x in np.nonzero(regions[i]))
        places.append(
            f"{regions[i].sum():,} pixels of views[{i}] around row {row}, column {column}{source} show "
            f"{max(shown, 0.0):.0%} of that light"
        )
    rest = f"; and {len(places) - 3} more views" if len(places) > 3 else ""
    return f"{'; '.join(places[:3])}{rest}", regions


def bright_rims(set_up: SetUp, state: Corrected) -> MasksOf:
    """Return the rims if they seem brighter than predicted."""
    rim = measure_rim(_see_rims(set_up, state, state))
    if rim is None or rim.excess <= 0 or rim.errors < MOST * OUTLIER:
        return {}
    return {i: mask for i, (mask, _) in enumerate(set_up.rims) if mask.any()}


def at_bright_rims(set_up: SetUp, before: Corrected, after: Corrected, masks: MasksOf) -> MasksOf:
    """Return the rims if they are brighter than what is fitted without them predicts."""
    rim = measure_rim(_see_rims(set_up, after, before))
    sure = rim is not None and rim.relative > MIN_RIM_EXCESS and rim.errors > OUTLIER and rim.positive >= MIN_AGREEMENT
    return masks if sure else {}


def how_bright_rims_are(set_up: SetUp, end: Corrected, masks: MasksOf) -> tuple[str, MasksOf]:
    """Return in words by how much rims are brighter and over how many pixels, and these pixels."""
    rim = measure_rim(_see_rims(set_up, end, set_up.base))
    size = "" if rim is None else f" by {rim.excess:.2g} ({rim.relative:.0%} of the object's mean)"
    regions = {i: mask & set_up.samples[i].inside for i, mask in masks.items()}
    return f"{size}, over {sum(int(r.sum()) for r in regions.values()):,} pixels at a grazing angle", regions


def shadows_of(set_up: SetUp, state: Corrected, i: int, excluded: Mask | None) -> list[Shadow]:
    """Return the cast shadows in a view, from each of its lights or from all together."""
    lit, seen = set_up.lit[i], see(state.fit, state.fit.views[i], set_up.samples[i], excluded)
    if not seen.counts.any():
        return []
    off: list[tuple[int, ...]] = [(j,) for j in lit] if len(lit) <= MAX_ALONE else []
    off += [lit] if len(lit) != 1 else []
    view = state.fit.views[i]
    return cast_shadows(seen, {js: predicted(state.fit, view, [k for k in lit if k not in js]) for js in off})


def union(of: Sequence[Shadow]) -> Mask:
    """Return the pixels that are in any of the shadows."""
    return np.logical_or.reduce([shadow.mask for shadow in of])


def _see_rims(set_up: SetUp, state: Corrected, of: Corrected) -> list[tuple[MeanPrediction, Mask, np.ndarray]]:
    """Return for each view photograph and prediction without what a state leaves out, the rim, and its sectors."""
    seen = map(partial(see, state.fit), state.fit.views, set_up.samples, of.excluded)
    return [(view, *rim) for view, rim in zip(seen, set_up.rims, strict=True)]
