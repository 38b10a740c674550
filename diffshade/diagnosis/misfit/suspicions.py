"""Suspicions: where the residuals of a fit contradict the scene description, in words and with a remedy.

What counts as one is decided in `explanations`, for a single view or light, and in `setup_faults`, for the whole setup.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool

from ...core.backend import in_float64
from ...core.words import listing
from ...inverse.result import Fit
from ...inverse.verdicts.outlines import said, wrong_outline
from .alternatives import Key, State, share
from .encodings import Encoding
from .explanations import APART, Explanation, MisfitSearch, matters, union
from .regions import measure_rim
from .setup_faults import NEXT, SetupFault, setup_faults

ROUNDS = 12
ROUNDING = 1e-10  # residuals below this fraction of the images' sum of squares are rounding

Mask = Bool[np.ndarray, "h w"]


@dataclass(frozen=True, eq=False)
class Suspicion:
    """A place where the residuals of a fit contradict the scene description."""

    kind: str
    """"encoding", "exposure", "light", "shadow" or "rim"; for all views together "vignetting", "gamma", "blur", "lobe",
    "radius", "center", "rotation" (of all lights) or "outline"."""
    views: tuple[int, ...]
    region: tuple[Mask, ...] | None
    """The affected pixels of each of these views; None for the whole image."""
    sentence: str
    """What it is, its size, where, and the remedy."""
    affected: tuple[str, ...] = field(default=())
    """The unknowns that are not determined until it is corrected."""


def suspicions(fit: Fit) -> tuple[Suspicion, ...]:
    """Return where the residuals contradict the scene description; empty if they do not.

    Explanations compete. Each is a refit with one thing changed: an encoding, an exposure, a light's place, or the
    pixels of shadows or rims excluded. The one that explains most of the cost is corrected, and the remaining residuals
    are examined again, so that its side effects are not reported. If the images have the other encoding, or background
    lies inside the outline, nothing else is reported. Faults of all views together (`setup_faults`) compete with the
    best explanation; if they lose, the remaining residuals are tested for them.
    """
    with in_float64(fit) as fit:
        if fit.counts.pixels == 0 or float(fit.evidence.spread[1]) <= ROUNDING * fit.squares:
            return ()
        outline = wrong_outline(fit)
        if outline is not None and outline.large:
            return (Suspicion("outline", tuple(range(len(fit.views))), None, said(fit.scene, outline), fit.names),)
        search = MisfitSearch(fit)
        state, found = search.alternatives.base, []
        for _ in range(ROUNDS):
            explanations = search.explanations(state)
            if not found and (encodings := search.encodings(explanations)):
                return (_describe_encoding(encodings[0], len(fit.views)),)
            if not explanations:
                break
            found.append(max(explanations, key=lambda e: e.share))
            state = found[-1].after
        everywhere = setup_faults(fit)
        if found and not any(fault.share > found[0].share for fault in everywhere):
            end = search.alternatives.settle(state)
            rest = 1.0 - share(search.alternatives.base, end)
            second = [f for f in setup_faults(end.fit, end.excluded) if rest * f.share > NEXT * found[0].share]
            return (*describe(search, end, found), *_of_all_views(fit, second))
        return _of_all_views(fit, everywhere)


def _of_all_views(fit: Fit, found: Sequence[SetupFault]) -> tuple[Suspicion, ...]:
    """Return the faults of all views as suspicions."""
    views = tuple(range(len(fit.views)))
    return tuple(Suspicion(f.kind, views, None, f.sentence, f.affected) for f in found)


def describe(search: MisfitSearch, end: State, found: Sequence[Explanation]) -> tuple[Suspicion, ...]:
    """Return the suspicions; those of most views or lights are merged, since they probably have one cause."""
    described = [(e.key, s) for e in _shadows_as_one(found) if (s := _describe_one(search, end, e)) is not None]
    for kind, count in (("exposure", len(search.fit.views)), ("light", len(search.fit.scene.lights))):
        keys = [key for key, _ in described if key is not None and key[0] == kind]
        if len(keys) > max(count / 2, 2):
            merged = (None, _describe_all(search, end, keys))
            first = next(i for i, (key, _) in enumerate(described) if key in keys)
            described = [
                merged if i == first else one for i, one in enumerate(described) if i == first or one[0] not in keys
            ]
    return tuple(suspicion for _, suspicion in described)


def _shadows_as_one(found: Sequence[Explanation]) -> list[Explanation]:
    """Return the explanations with the shadows of all rounds merged: a round may find only the darker part of one."""
    shadows = [e for e in found if e.kind == "shadow"]
    masks: dict[int, Mask] = {}
    for e in shadows:
        masks |= {i: mask | masks[i] if i in masks else mask for i, mask in e.masks.items()}
    others = [e for e in found if e not in shadows[1:]]
    return [replace(e, masks=masks) if e in shadows else e for e in others]


def _describe_one(search: MisfitSearch, end: State, found: Explanation) -> Suspicion | None:
    """Return an explanation in words, at the minimum with everything corrected; None if it vanishes there."""
    by_kind = {
        "exposure": _describe_exposure,
        "light": _describe_light,
        "shadow": _describe_shadows,
        "rim": _describe_rim,
    }
    return by_kind[found.kind](search, end, found)


def _describe_all(search: MisfitSearch, end: State, keys: Sequence[Key]) -> Suspicion:
    kind = keys[0][0]
    views = tuple(sorted({view for key in keys for view in search.alternatives.views_of(key)}))
    if kind == "exposure":
        factors = [search.factor(end, i) for _, i in keys]
        sentence = (
            f"{len(keys)} of the {len(search.fit.views)} views are darker or brighter than the other views predict, by "
            f"factors of {min(factors):.3g} to {max(factors):.3g}. Check the lights' intensities, distances and "
            "attenuation and whether the material model is complete, or free 'exposure'."
        )
    else:
        tilts = [search.alternatives.effect(end, key) for key in keys]
        sentence = (
            f"{len(keys)} of the {len(search.fit.scene.lights)} lights are {min(tilts):.2g} to {max(tilts):.2g} "
            "degrees off, judging by the shading. Check the axes of directions and normals, that directions point the "
            "way the light travels, and whether the material model is complete."
        )
    return Suspicion(kind, views, None, sentence)


def _describe_exposure(search: MisfitSearch, end: State, found: Explanation) -> Suspicion | None:
    assert found.key is not None
    i, count = found.key[1], len(search.fit.views)
    factor = search.factor(end, i)
    if not matters(found.key, factor):
        return None
    source = (
        "the other views predict" if count > 2 else f"views[{1 - i}] predicts" if count == 2 else "the scene predicts"
    )
    which = " (or the other view is wrong by the inverse factor)" if count == 2 else ""
    exposure = factor * float(search.fit.views[i].exposure)
    sentence = (
        f"views[{i}] is {factor:.3g} times as bright as {source}{which}, which explains {found.own_share:.0%} of its "
        f"residuals. Give it exposure={exposure:.3g} or free 'views.{i}.exposure', and check its lights: a wrong "
        "intensity or distance looks the same."
    )
    return Suspicion("exposure", (i,), None, sentence)


def _describe_light(search: MisfitSearch, end: State, found: Explanation) -> Suspicion | None:
    assert found.key is not None
    i, views = found.key[1], search.alternatives.views_of(found.key)
    degrees = search.alternatives.effect(end, found.key)
    if not matters(found.key, degrees):
        return None
    light = end.fit.scene.lights[i]
    what = light.placement[0]
    place = ", ".join(f"{x:.3g}" for x in np.asarray(getattr(light, what)))
    sentence = (
        f"judging by the shading in {_views(views)}, lights.{i} is {degrees:.2g} degrees off as seen from the surface. "
        f"This explains {found.own_share:.0%} of the residuals there. Measure the light again, or free "
        f"'lights.{i}.{what}', which is near ({place})."
    )
    return Suspicion("light", views, None, sentence)


def _describe_shadows(search: MisfitSearch, end: State, found: Explanation) -> Suspicion:
    regions, places = [], []
    for i, mask in found.masks.items():
        shadows = [s for s in search.shadows_of(end, i, None) if (s.mask & mask).any()]
        region = union(shadows) if shadows else mask
        regions.append(region)
        lights = [f"lights.{j}" for j in dict.fromkeys(j for s in shadows for j in s.lights)]
        source = f" under {listing(lights)}" if lights and len(lights) <= APART else ""
        shown = max((s.shown for s in shadows), default=0.0)
        places.append(
            f"{region.sum():,} pixels of views[{i}] {_where(region)}{source} show {max(shown, 0.0):.0%} of that light"
        )
    rest = f"; and {len(places) - 3} more views" if len(places) > 3 else ""
    sentence = (
        f"predicted light is missing, as in a cast shadow: {'; '.join(places[:3])}{rest}. Exclude these pixels with "
        "View.mask, or fit with loss='cauchy'."
    )
    return Suspicion("shadow", tuple(found.masks), tuple(regions), sentence)


def _describe_rim(search: MisfitSearch, end: State, found: Explanation) -> Suspicion:
    rim = measure_rim(search.see_rims(end, found.before.excluded))
    size = "" if rim is None else f" by {rim.excess:.2g} ({rim.relative:.0%} of the object's mean)"
    regions = tuple(mask & search.samples[i].inside for i, mask in found.masks.items())
    sentence = (
        f"the rim in {_views(tuple(found.masks))} is brighter than predicted{size}, over "
        f"{sum(int(r.sum()) for r in regions):,} pixels at a grazing angle. Possible causes are interreflection or "
        "another form of highlight. Exclude the rim with View.mask, or fit with loss='cauchy'."
    )
    return Suspicion("rim", tuple(found.masks), regions, sentence)


def _describe_encoding(encoding: Encoding, count: int) -> Suspicion:
    before, after = encoding.rmse
    what, remedy = (
        ("sRGB-encoded, but were read as linear: decoded", "srgb=True")
        if encoding.decoded
        else ("linear, but were decoded from sRGB: encoded again", "srgb=False")
    )
    return Suspicion(
        "encoding",
        tuple(range(count)),
        None,
        f"the images seem to be {what}, they fit with RMSE {after:.3g} instead of {before:.3g}. Read them with "
        f"ds.read_image(path, {remedy}).",
    )


def _where(region: Mask) -> str:
    row, column = (round(float(x.mean())) for x in np.nonzero(region))
    return f"around row {row}, column {column}"


def _views(views: tuple[int, ...]) -> str:
    names = [f"views[{i}]" for i in views]
    return listing(names) if len(names) <= 4 else f"{len(names)} views ({names[0]} to {names[-1]})"
