"""Suspicions: what the residuals of a fit show to be other than the user said, in words and with the remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool

from ...core.backend import in_float64
from ...core.words import listing
from ...inverse.checks.outlines import said, wrong_outline
from ...inverse.result import Fit
from ...model.lights import DirectionalLight
from .alternatives import Key, State, share
from .encodings import Encoding
from .explanations import APART, Explanation, MisfitSearch, matters, union
from .regions import measure_rim
from .wrong_set_ups import BESIDE, WrongSetUp, wrong_set_ups

ROUNDS = 12
ROUNDING = 1e-10  # of the sum of squares of the images, below which residuals show nothing

Mask = Bool[np.ndarray, "h w"]


@dataclass(frozen=True, eq=False)
class Suspicion:
    """What the residuals of a fit show to be other than the user said."""

    kind: str
    """"encoding", "exposure", "light", "shadow" or "rim"; of all views together "vignetting", "gamma", "blur", "lobe",
    "radius", "center", "rotation" (of all lights) or "outline"."""
    views: tuple[int, ...]
    region: tuple[Mask, ...] | None
    """For each of these views the pixels where it shows; None where that is the whole image."""
    sentence: str
    """What it is, how much, where, and the remedy."""
    withdrawn: tuple[str, ...] = field(default=())
    """The numbers that are not determined as long as it is not put right."""


def suspicions(fit: Fit) -> tuple[Suspicion, ...]:
    """Return what the residuals show to be other than was said; empty where they show nothing.

    Explanations compete: each is a refit with one thing let go, an encoding, an exposure, a light's place, or the
    pixels of shadows or rims. The one that explains most of the cost is taken and put right, and what is left is looked
    at again, so that no echo of it is reported. Images that are encoded otherwise leave nothing else to be said, and
    neither does background inside the outline. What is wrong with all views together (`wrong_set_ups`) competes with
    the best of these, and, where it loses, is looked for in what they leave over.
    """
    with in_float64(fit) as fit:
        if fit.counts.pixels == 0 or float(fit.evidence.spread[1]) <= ROUNDING * fit.squares:
            return ()
        outline = wrong_outline(fit)
        if outline is not None and outline.large:
            return (Suspicion("outline", tuple(range(len(fit.views))), None, said(fit.scene, outline), fit.names),)
        desk = MisfitSearch(fit)
        state, found = desk.alternatives.base, []
        for _ in range(ROUNDS):
            explanations = desk.explanations(state)
            if not found and (encodings := desk.encodings(explanations)):
                return (_say_encoding(encodings[0], len(fit.views)),)
            if not explanations:
                break
            found.append(max(explanations, key=lambda e: e.share))
            state = found[-1].after
        everywhere = wrong_set_ups(fit)
        if found and not any(fault.share > found[0].share for fault in everywhere):
            end = desk.alternatives.settle(state)
            rest = 1.0 - share(desk.alternatives.base, end)
            beside = [f for f in wrong_set_ups(end.fit, end.out) if rest * f.share > BESIDE * found[0].share]
            return (*_said(desk, end, found), *_of_all_views(fit, beside))
        return _of_all_views(fit, everywhere)


def _of_all_views(fit: Fit, found: Sequence[WrongSetUp]) -> tuple[Suspicion, ...]:
    """Return the faults of all views as suspicions."""
    views = tuple(range(len(fit.views)))
    return tuple(Suspicion(f.kind, views, None, f.sentence, f.withdrawn) for f in found)


def _said(desk: MisfitSearch, end: State, found: Sequence[Explanation]) -> tuple[Suspicion, ...]:
    """Return the suspicions; those of most views or lights together as one, whose cause is rather one thing."""
    told = [(e.key, s) for e in _shadows_as_one(found) if (s := _say(desk, end, e)) is not None]
    for kind, count in (("exposure", len(desk.fit.views)), ("light", len(desk.fit.scene.lights))):
        keys = [key for key, _ in told if key is not None and key[0] == kind]
        if len(keys) > max(count / 2, 2):
            together = (None, _say_all(desk, end, keys))
            first = next(i for i, (key, _) in enumerate(told) if key in keys)
            told = [together if i == first else of for i, of in enumerate(told) if i == first or of[0] not in keys]
    return tuple(suspicion for _, suspicion in told)


def _shadows_as_one(found: Sequence[Explanation]) -> list[Explanation]:
    """Return the explanations with the shadows of all rounds in the first: a darker part of one may be seen first."""
    shadows = [e for e in found if e.kind == "shadow"]
    masks: dict[int, Mask] = {}
    for e in shadows:
        masks |= {i: mask | masks[i] if i in masks else mask for i, mask in e.masks.items()}
    others = [e for e in found if e not in shadows[1:]]
    return [replace(e, masks=masks) if e in shadows else e for e in others]


def _say(desk: MisfitSearch, end: State, found: Explanation) -> Suspicion | None:
    """Return an explanation in words, from the minimum with everything put right; None where nothing of it is left."""
    return {"exposure": _say_exposure, "light": _say_light, "shadow": _say_shadows, "rim": _say_rim}[found.kind](
        desk, end, found
    )


def _say_all(desk: MisfitSearch, end: State, keys: Sequence[Key]) -> Suspicion:
    kind = keys[0][0]
    views = tuple(sorted({view for key in keys for view in desk.alternatives.views_of(key)}))
    if kind == "exposure":
        factors = [desk.factor(end, i) for _, i in keys]
        sentence = (
            f"{len(keys)} of the {len(desk.fit.views)} views are darker or brighter than the others say, "
            f"{min(factors):.3g} to {max(factors):.3g} times. Check the lights' intensities, their distances and "
            "attenuation and whether the material has all it needs, or free 'exposure'."
        )
    else:
        tilts = [desk.alternatives.effect(end, key) for key in keys]
        sentence = (
            f"{len(keys)} of the {len(desk.fit.scene.lights)} lights are {min(tilts):.2g} to {max(tilts):.2g} degrees "
            "away from where the scene has them, as the shading shows. Check the axes that directions and normals are "
            "given in, whether directions are those that light travels in, and whether the material has all it needs."
        )
    return Suspicion(kind, views, None, sentence)


def _say_exposure(desk: MisfitSearch, end: State, found: Explanation) -> Suspicion | None:
    assert found.key is not None
    i, count = found.key[1], len(desk.fit.views)
    factor = desk.factor(end, i)
    if not matters(found.key, factor):
        return None
    than = "the others say" if count > 2 else f"views[{1 - i}] says" if count == 2 else "the scene says"
    which = " (or the other is wrong by the inverse)" if count == 2 else ""
    exposure = factor * float(desk.fit.views[i].exposure)
    sentence = (
        f"views[{i}] is {factor:.3g} times as bright as {than}{which}, which explains {found.gone:.0%} of its "
        f"residuals. Give it exposure={exposure:.3g} or free 'views.{i}.exposure', and check its lights: their "
        "intensity or distance would show the same."
    )
    return Suspicion("exposure", (i,), None, sentence)


def _say_light(desk: MisfitSearch, end: State, found: Explanation) -> Suspicion:
    assert found.key is not None
    i, views = found.key[1], desk.alternatives.views_of(found.key)
    what = "direction" if isinstance(desk.fit.scene.lights[i], DirectionalLight) else "position"
    place = ", ".join(f"{x:.3g}" for x in np.asarray(getattr(end.fit.scene.lights[i], what)))
    sentence = (
        f"lights.{i} is {desk.alternatives.effect(end, found.key):.2g} degrees away from where the scene has it, seen "
        f"from the surface, as the shading in {_views(views)} shows, which explains {found.gone:.0%} of the residuals "
        f"there. Measure it again, or free 'lights.{i}.{what}', which is near ({place})."
    )
    return Suspicion("light", views, None, sentence)


def _say_shadows(desk: MisfitSearch, end: State, found: Explanation) -> Suspicion:
    regions, said = [], []
    for i, mask in found.masks.items():
        shadows = [s for s in desk.shadows_of(end, i, None) if (s.mask & mask).any()]
        region = union(shadows) if shadows else mask
        regions.append(region)
        lights = [f"lights.{j}" for j in dict.fromkeys(j for s in shadows for j in s.lights)]
        of = f" out of {listing(lights)}" if lights and len(lights) <= APART else ""
        shown = max((s.shown for s in shadows), default=0.0)
        said.append(
            f"{region.sum():,} pixels of views[{i}] {_where(region)}{of} show {max(shown, 0.0):.0%} of that light"
        )
    rest = f"; and {len(said) - 3} more views" if len(said) > 3 else ""
    sentence = (
        f"it is dark where light should fall, as in a cast shadow: {'; '.join(said[:3])}{rest}. Mask these pixels out "
        "with View.mask, or fit with loss='cauchy'."
    )
    return Suspicion("shadow", tuple(found.masks), tuple(regions), sentence)


def _say_rim(desk: MisfitSearch, end: State, found: Explanation) -> Suspicion:
    rim = measure_rim(desk.see_rims(end, found.before.out))
    size = "" if rim is None else f" by {rim.excess:.2g} ({rim.relative:.0%} of the object's mean)"
    regions = tuple(mask & desk.samples[i].inside for i, mask in found.masks.items())
    sentence = (
        f"the rim in {_views(tuple(found.masks))} is brighter than predicted{size}, over "
        f"{sum(int(r.sum()) for r in regions):,} pixels seen at a grazing angle, as light from surfaces around it "
        "(interreflection) or another form of highlight makes it. Mask the rim out with View.mask, or fit with "
        "loss='cauchy'."
    )
    return Suspicion("rim", tuple(found.masks), regions, sentence)


def _say_encoding(encoding: Encoding, count: int) -> Suspicion:
    before, after = encoding.rmse
    said, remedy = (
        ("sRGB-encoded, though they were read as linear: decoded", "srgb=True")
        if encoding.decoded
        else ("linear, though they were decoded from sRGB: encoded again", "srgb=False")
    )
    return Suspicion(
        "encoding",
        tuple(range(count)),
        None,
        f"the images seem to be {said}, they fit with RMSE {after:.3g} instead of {before:.3g}. Read them with "
        f"ds.read_image(path, {remedy}).",
    )


def _where(region: Mask) -> str:
    row, column = (round(float(x.mean())) for x in np.nonzero(region))
    return f"about row {row}, column {column}"


def _views(views: tuple[int, ...]) -> str:
    names = [f"views[{i}]" for i in views]
    return listing(names) if len(names) <= 4 else f"{len(names)} views ({names[0]} to {names[-1]})"
