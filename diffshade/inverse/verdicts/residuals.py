"""Residuals: whether a fit leaves noise alone of its photographs, or faults that its errors must allow for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from ...core.progress import ReportProgress
from ...core.thresholds import MOST, NEGLIGIBLE, ROUNDING, SMALL
from ...core.words import MAX_NAMED, Note, listing
from ..data.samples import MIN_PILE
from ..misfit.beside import beside, p_of_level
from ..misfit.changes import bounded
from ..misfit.conventions import other_convention
from ..misfit.encodings import Mended, better_than_gamma
from ..misfit.explained import Explained, explain
from ..misfit.fault_words import beyond_bounds
from ..misfit.found import Found
from ..misfit.noise_tests import FALSE_ALARM, Whiteness
from ..result import Fit
from ..statistics.identifiability import some_channels, vague
from .outliers import WithoutOutliers, without_outliers


def allow_for_faults(fit: Fit, report_progress: ReportProgress, *, residuals: Whiteness) -> Fit:
    """Return a fit whose errors allow for the faults that its residuals show. In float64.

    The values stay as they are; one that is lost in its new error is not determined.

    Args:
        fit: The fit.
        report_progress: Reports progress.
        residuals: Whether its residuals are noise.
    """
    exact = fit.evidence.spread[1] <= ROUNDING * fit.squares  # only rounding is left
    outside = any(note.kind == "outline" for note in fit.notes) and not fit.determined.any()
    if exact or outside:
        return fit
    steps = fit.evidence.shared > 0.0  # of files, that no noise hides
    is_noise, shown = steps or residuals.p_value > FALSE_ALARM, beside(fit)
    sure = fit.evidence.shared > 1.0 - SMALL or residuals.p_value > FALSE_ALARM  # else the steps hide what it is
    known = any(samples.zeros >= MIN_PILE or samples.reach for samples in fit.solved.problem.data.samples)
    held, free = bounded(fit), np.flatnonzero(~fit.at_bound)
    beyond = fit.evidence.p_of_holding(held, free) <= FALSE_ALARM  # few pixels tell of a highlight, and all are judged
    level = 1.0 if shown is None else p_of_level(shown)
    if sure and not known and not beyond and level > FALSE_ALARM:
        return fit
    report_progress("what the residuals show")
    if other := other_convention(fit, residuals.squares):
        lost = np.zeros_like(fit.determined)
        return replace(fit, determined=lost, notes=(Note(other, "cause", ("convention",)), *fit.notes))
    shared = residuals.shared or 1.0
    seen = explain(fit, residuals.squares, residuals.correlation if steps else shared)
    if is_noise and not seen.found:
        return fit
    gamma = next((f.share for f in seen.found if f.fault.kind == "gamma" or f.fault.mended is not None), None)
    better = None if gamma is None else better_than_gamma(fit, gamma, seen.like_gamma)
    apart = None if is_noise else _outliers(fit, seen, report_progress)
    if apart is not None and apart.is_noise:
        errors = np.hypot(np.maximum(fit.errors, seen.of_noise), apart.moves)
    else:
        correlated = np.sqrt(shared if seen.found else residuals.correlation)
        errors = np.maximum(fit.errors, np.hypot(correlated * np.maximum(fit.plain_errors, seen.of_noise), seen.errors))
        if better is not None:
            errors = np.maximum(errors, np.abs(better.values - fit.values))
        if apart is not None:
            errors = np.hypot(errors, apart.moves)
    lost = vague(fit.unknowns, fit.values, errors, fit.scales)[0] & fit.determined
    for found in seen.found:  # a value at a bound that the photographs contradict is known no better than the bound
        lost[beyond_bounds(found)] = fit.determined[beyond_bounds(found)]
    found = _notes(fit, seen, better, apart, lost, residuals)
    notes = (*fit.notes, *found) if fit.determined.any() else (*found, *fit.notes)  # the cause of all comes first
    return replace(fit, errors=errors, determined=fit.determined & ~lost, notes=notes)


def _outliers(fit: Fit, seen: Explained, report_progress: ReportProgress) -> WithoutOutliers | None:
    """Return the fit without outliers, where there are some and no named fault explains a tenth of the residuals.

    Where they are most of a view, the view is wrong. If the rest is no noise either, they may be none: they must be
    most of what is wrong, or move a value by more than its error.
    """
    sure = any(
        f.fault.beside or f.fault.kind in ("bound", "pixels") or (f.share > SMALL and not f.fault.unnamed)
        for f in seen.found
    )
    if fit.likelihood.loss != "squares" or sure or not fit.determined.any():
        return None
    report_progress("what single pixels show")
    apart = without_outliers(fit)
    far = np.abs(apart.moves) > np.hypot(fit.errors, seen.errors)
    matters = apart.is_the_cause or bool(np.any(fit.determined & far))
    return apart if apart.share > NEGLIGIBLE and apart.of_a_view < MOST and matters else None


def _notes(
    fit: Fit,
    seen: Explained,
    better: Mended | None,
    apart: WithoutOutliers | None,
    lost: Bool[np.ndarray, " p"],
    residuals: Whiteness,
) -> list[Note]:
    """Say what the residuals show, how sure that is, and what to do."""
    named = [f for f in seen.found if not f.fault.unnamed][:MAX_NAMED]
    kinds, is_known = tuple(f.fault.kind for f in seen.found), bool(named) and not seen.found[0].fault.unnamed
    if apart is not None and apart.is_the_cause:
        why, kinds, is_known = f"{apart.sentence(fit)} The errors allow for this.", ("outliers",), True
    elif better is not None:
        left = "." if better.leaves_noise else ", but what is left is no noise either: treat them as lower limits."
        why, kinds, is_known = f"{better.sentence} The errors allow for this{left}", (better.kind,), True
    elif is_known:
        why = f"{_sentences(seen.found[:MAX_NAMED])} The errors allow for this."
    elif not seen.found or residuals.shared is not None:  # what has no name is smooth, and would grow with the cells
        why = (
            "no fault of the description explains them. The noise differs with brightness, or neighbours share it, as "
            "after JPEG, demosaicing or denoising, and in pictures by path tracing. The errors are by the scatter of "
            "the samples, and of sums over neighbours."
        )
        kinds = ()
    else:
        why = (
            f"{seen.found[0]} No fault that has a name explains it, so the model may not have its cause. The errors "
            "allow for such a change; treat them as lower limits."
        )
    if apart is not None and not apart.is_the_cause:
        why, kinds = f"{why} Perhaps also: {apart.sentence(fit)}", (*kinds, "outliers")
    lead = "" if residuals.p_value > FALSE_ALARM else "the residuals are not noise: "
    notes = [Note(f"{lead}{why}", "cause" if is_known else "misfit", kinds)]
    if lost.any():
        names = some_channels(lost, fit.unknowns)
        text = f"{listing(names)} {'is' if len(names) == 1 else 'are'} not determined until this is corrected."
        notes.append(Note(text, "not determined", tuple(names)))
    return notes


def _sentences(named: Sequence[Found]) -> str:
    first, *others = map(str, named)
    return " ".join([first, *(f"Perhaps also, or instead: {other}" for other in others)])
