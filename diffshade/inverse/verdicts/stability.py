"""Stability: how far each value moves if some of the data are left out and the fit is repeated."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Bool, Float

from ...core.progress import ReportProgress
from ...core.robust_scale import RARE
from ...core.thresholds import ROUNDING, SLIGHT, SMALL, VAGUE
from ...core.words import Note
from ...model.materials import Material
from ...model.rendering import render_once
from ...model.scenes import Scene
from ..data.view_sets import Masks
from ..data.views import View, lights_on
from ..forward.gram import Point
from ..result import Fit
from ..solving import solve_again
from ..statistics.clusters import Clusters
from ..statistics.identifiability import relative_errors, vague
from ..statistics.uncertainty import Vector, inverse
from ..summary import summarise
from ..unknowns.unknown import coordinate_slopes, coordinates, logarithms

SEEN = 2.0 * SLIGHT  # the highlight is where it has more than this fraction of its largest brightness in the view


@dataclass(frozen=True, eq=False)
class FitWithout:
    """A fit with some of the data left out."""

    without: str
    """What was left out, in words."""
    fit: Fit
    moved: Bool[np.ndarray, " p"]
    """What moved further than noise explains: by 30 % or three errors."""


def left_out(fit: Fit) -> Iterator[tuple[str, Masks]]:
    """Yield what an examination leaves out each time, and the pixels that are kept."""
    if fit.evidence.count >= 4:
        for half, name in ((0, "the odd views"), (1, "the even views")):
            yield name, [None if i % 2 == half else np.zeros(v.camera.shape, bool) for i, v in enumerate(fit.views)]
    yield from without_saturated(fit, (1, 3))
    if not _is_glossy(fit):
        return
    yield from without_brightest(fit)
    angles = [angle_to_highlight(fit.scene, view) for view in fit.views]
    for degrees in (2.0, 5.0):
        if any((angle < degrees).any() for angle in angles):
            yield f"{degrees:g} degrees around the highlight", [angle >= degrees for angle in angles]


def without_saturated(fit: Fit, widths: Sequence[int]) -> Iterator[tuple[str, Masks]]:
    """Yield, for each width, the pixels farther than that from saturated ones; nothing if no pixel is saturated."""
    ends = [np.zeros(view.camera.shape, bool) for view in fit.views]
    for end, of_view in zip(ends, fit.solved.problem.data.samples, strict=True):
        if fit.clipped == "exclude":  # with those that the fit left out
            of_view = of_view.at(np.flatnonzero(of_view.inside))
        end.reshape(-1)[of_view.pixels] = of_view.ends().any(-1)
    if any(end.any() for end in ends):
        for width in widths:
            masks = [np.logical_not(scipy.ndimage.binary_dilation(end, iterations=width)) for end in ends]
            yield f"saturated pixels and {width} px around them", masks


def without_brightest(fit: Fit) -> Iterator[tuple[str, Masks]]:
    """Yield the pixels outside the brightest half of each highlight; nothing if there is no highlight."""
    shine = [np.asarray(highlight(fit.scene, view)) for view in fit.views]
    in_it = [s > SEEN * s.max() if s.max() > 0 else np.zeros(s.shape, bool) for s in shine]
    if any(here.any() for here in in_it):
        yield (
            "the brightest half of the highlight",
            [~(here & (s > np.median(s[here]))) if here.any() else None for s, here in zip(shine, in_it, strict=True)],
        )


def _is_glossy(fit: Fit) -> bool:
    """Whether a highlight's numbers are free."""
    return any(u.kind == "k_s" or "n_s" in place.fields for u in fit.unknowns for place in u.places)


def highlight(scene: Scene, view: View) -> Float[np.ndarray, "h w"]:
    """Return what the highlights alone add to a photograph, the mean of the channels."""
    scene = replace(scene, lights=[scene.lights[i] for i in lights_on(scene, view)])
    black = np.zeros(len(scene.channels))
    dull = eqx.tree_at(lambda s: [item.material.k_s for item in s.objects], scene, [black] * len(scene.objects))
    with_it, without = (np.asarray(render_once(s, view.camera)) for s in (scene, dull))
    return (with_it - without).mean(-1)


def angle_to_highlight(scene: Scene, view: View) -> Float[np.ndarray, "h w"]:
    """Return the angle between v and the nearest mirror direction r of a light that is on, in degrees; 180 for none.

    It is found by rendering a white mirror: with k_s = 1, n_s = 1 and an unattenuated light of unit intensity, the
    radiance is v . r (E5).
    """
    mirror = Material(k_s=1.0, n_s=1.0)
    objects = [replace(item, material=mirror) for item in scene.objects]
    plain = Scene(objects, shadows=scene.shadows, bands=scene.bands)
    nearest = np.full(view.camera.shape, -1.0)
    for i in lights_on(scene, view):
        cosine = np.asarray(render_once(replace(plain, lights=(scene.lights[i].bare(),)), view.camera)).max(-1)
        nearest = np.maximum(nearest, np.where(cosine > 0, cosine, -1.0))
    return np.rad2deg(np.arccos(np.clip(nearest, -1.0, 1.0)))


def refits(
    fit: Fit, clusters: Clusters, cases: Iterable[tuple[str, Masks]], report_progress: ReportProgress
) -> list[FitWithout]:
    """Fit again with some of the data left out. In float64.

    Nothing is left out where the residuals name a cause, since without some of the data it moves the values otherwise,
    and where there is no noise, so that only rounding could move them.
    """
    if any(note.kind == "cause" for note in fit.notes) or fit.evidence.spread[1] <= ROUNDING * fit.squares:
        return []
    errors, rises = clusters.standard_errors(), clusters.rises()
    added = np.where(fit.determined, fit.added_errors / np.where(fit.determined, errors, 1.0), 0.0)
    errors, rises = errors * np.hypot(1.0, added), rises * (1.0 + added**2)  # they hold what a fault may have moved
    cases, found = [(without, keep) for without, keep in cases if _enough(fit, keep)], []
    for k, (without, keep) in enumerate(cases):
        report_progress(f"without {without}", k / len(cases))
        again = refit(fit, keep)
        found.append(FitWithout(without, again, moved(fit, errors, rises, again, keep)))
    return found


def refit(fit: Fit, keep: Masks) -> Fit:
    """Fit anew on the pixels to keep, with a search of its own. In float64.

    An unknown that none of the pixels shows is not determined.
    """
    problem = fit.solved.problem
    return summarise(*solve_again(problem, fit.scene, problem.data.keeping(keep), fit.solved.theta))


def moves(fit: Fit, again: Iterable[FitWithout]) -> tuple[Vector, Bool[np.ndarray, " p"]]:
    """Return how far refits move each value at most, 0 where noise explains it, and which of them by 30 %."""
    distance, far = np.zeros(len(fit.values)), np.zeros(len(fit.values), bool)
    for r in again:
        distance = np.maximum(distance, np.where(r.moved, np.abs(r.fit.values - fit.values), 0.0))
        far |= r.moved & (how_far(fit, r.fit.values) > VAGUE)
    return distance, far


def _enough(fit: Fit, keep: Masks) -> bool:
    """Whether the pixels to keep are as many as the unknowns."""
    counts = fit.solved.problem.data.keeping(keep).counts
    return min(counts.pixels, counts.samples - counts.clipped) >= len(fit.unknowns)


def how_far(fit: Fit, values: Vector) -> Vector:
    """Return the distance of values from those of a fit, relative to the value or in a logarithm."""
    log = logarithms(fit.unknowns)
    ratio = np.abs(np.log(np.where(log, values, 1.0) / np.where(log, fit.values, 1.0)))
    plain = relative_errors(fit.unknowns, fit.values, np.abs(values - fit.values), fit.scales)
    return np.where(log, ratio, plain)


def moved(fit: Fit, errors: Vector, rises: Vector, again: Fit, keep: Masks) -> Bool[np.ndarray, " p"]:
    """Return the values that a refit moves further than noise explains.

    They move by 30 % or three errors, and the remaining data contradict the old value: holding it raises their cost by
    three errors squared, as in a profile (`rises` is the rise for one error). Data that say hardly anything about a
    value do not contradict its old one; where even a tenth of that rise is not to be expected, none is computed.
    """
    far = how_far(fit, again.values)
    distance = np.where(logarithms(fit.unknowns), far * fit.values, np.abs(again.values - fit.values))
    known = again.evidence.regular & fit.evidence.regular
    expected = _expected_rises(fit, again)
    suspects = np.flatnonzero(
        known & ((far > VAGUE) | (distance > RARE * errors)) & (expected > SMALL * RARE**2 * rises)
    )
    found = np.zeros(len(known), bool)
    if not len(suspects):
        return found
    laid = fit.solved.keeping(keep).laid_out()
    there = coordinates(again.values, fit.unknowns)

    def lowest(held: dict[int, float], *begins: Vector) -> Point:
        ends = [laid.minimise(held, theta, rtol=1e-8).point for theta in begins]
        return min(ends, key=lambda end: float(end.total.cost))

    if again.evidence.shared > 0.0:  # to a highlight that is masked, rounding is as good as light
        rises = np.maximum(rises, again.clusters.rises().max())
    best = lowest({}, there, laid.theta)
    for j in suspects.tolist():
        end = lowest({j: float(laid.theta[j])}, laid.theta, there)
        found[j] = 2.0 * float(end.total.cost - best.total.cost) > RARE**2 * rises[j]
    return found


def _expected_rises(fit: Fit, again: Fit) -> Vector:
    """Return by how much twice a refit's cost would rise with each unknown at its old value, if it were quadratic.

    Infinite where the refit has it at a bound.
    """
    slope, inside = coordinate_slopes(again.values, fit.unknowns), ~again.at_bound
    H = again.evidence.total / np.outer(slope, slope)
    variance = np.full(len(slope), np.nan)
    variance[inside] = np.diag(inverse(H[np.ix_(inside, inside)]))
    moved = coordinates(again.values, fit.unknowns) - coordinates(fit.values, fit.unknowns)
    return np.where(variance > 0.0, moved**2 / np.where(variance > 0.0, variance, 1.0), np.inf)


def dependence(fit: Fit, again: Sequence[FitWithout], lost: Bool[np.ndarray, " p"]) -> list[Note]:
    """Return notes on the values that depend on the data, each with the omission that moves it furthest."""
    notes, shifted = [], np.any([r.moved for r in again], 0) & fit.determined if again else []
    for quantity in dict.fromkeys(fit.unknowns[j].quantity for j in np.flatnonzero(shifted)):
        members = [j for j in np.flatnonzero(shifted) if fit.unknowns[j].quantity == quantity]
        *_, j, worst = max(
            ((r.moved[j], how_far(fit, r.fit.values)[j], j, r) for r in again for j in members), key=lambda at: at[:2]
        )
        end = "" if lost[members].any() else " Its error allows for this."
        text = (
            f"{quantity} depends on which data are included: {fit.names[j]} is {fit.values[j]:.3g} with all of them, "
            f"and {worst.fit.values[j]:.3g} without {worst.without}. Fix {quantity}, or mask pixels that the model "
            f"does not describe.{end}"
        )
        notes.append(Note(text, "depends on data", (quantity,)))
    return notes


def allow_for_omissions(fit: Fit, report_progress: ReportProgress) -> Fit:
    """Return a fit whose errors hold how far values move without the pixels that decide most. In float64.

    This is the cheap part of an examination, two fits at most: without the saturated pixels, and without the brightest
    half of the highlight. It is skipped if the views agree and no sample is clipped, since then noise explains the
    residuals, and if no highlight is free. What one view alone shows, such as the direction of its light, is held where
    the fit found it. A value that moves by 30 %, or is lost in its error, is not determined.
    """
    if not _doubtful(fit) or not fit.determined.any():
        return fit
    alone = (fit.evidence.single_view >= 0) & (not any(u.products for u in fit.unknowns))
    shared, errors, kept = fit.holding(alone), fit.errors.copy(), fit.determined.copy()
    cases = [*without_saturated(fit, (3,)), *without_brightest(fit)]
    again = refits(shared, shared.clusters, cases, report_progress)
    distance, far = moves(shared, again)
    errors[~alone] = np.hypot(shared.errors, distance)
    vaguely, _ = vague(shared.unknowns, shared.values, errors[~alone], shared.scales)
    lost = shared.determined & (far | (distance > 0.0) & vaguely)
    kept[~alone] &= ~lost
    notes = (*dependence(shared, again, lost), *fit.notes)
    return replace(fit, errors=errors, determined=kept, notes=notes)


def _doubtful(fit: Fit) -> bool:
    """Whether a few pixels may decide a highlight's numbers: the views disagree, or samples are clipped."""
    return bool(fit.clusters.disagree or fit.counts.clipped or fit.counts.left_out) and _is_glossy(fit)
