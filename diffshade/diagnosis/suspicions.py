"""Suspicions: where the residuals of a fit contradict the scene description, in words and with a remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..core.backend import in_float64
from ..core.masks import Mask
from ..core.thresholds import MAX_STEPS, NEGLIGIBLE, ROUNDING
from ..inverse.misfit.changes import Move
from ..inverse.misfit.directions import amount_alone, changes_of
from ..inverse.misfit.explained import explained
from ..inverse.misfit.faults import FAULTS
from ..inverse.misfit.found import Found
from ..inverse.misfit.linearised import Linearised, linearise
from ..inverse.misfit.set_up import Corrected, SetUp
from ..inverse.result import Fit
from ..inverse.verdicts.outlines import said, wrong_outline
from ..parallel.threads import ONE_BLAS_THREAD

MAX_ROUNDS = 12
MIN_REGION = 0.25  # of what the best other fault explains: a region that explains more is where it is


@dataclass(frozen=True, eq=False)
class Suspicion:
    """A place where the residuals of a fit contradict the scene description."""

    kind: str
    """"outline", "encoding", "convention", or that of a fault of the table (`faults.FAULTS`)."""
    views: tuple[int, ...]
    region: tuple[Mask, ...] | None = field(repr=False)
    """The affected pixels of each of these views; None for the whole image."""
    sentence: str
    """What it is, its size, where, and the remedy."""
    affected: tuple[str, ...] = field(default=())
    """The unknowns that it moves by more than two errors of independent noise."""


def suspicions(fit: Fit) -> tuple[Suspicion, ...]:
    """Return where the residuals contradict the scene description; empty if they do not.

    A fit has already explained its residuals, to first order. Here the faults that move numbers of the set-up, and
    regions such as shadows, are corrected one after the other, that which explains most first, and what is left is
    explained anew, so that side effects are not reported. If background lies inside the outline, nothing else is.
    """
    with in_float64(fit) as fit, ONE_BLAS_THREAD:
        views = tuple(range(len(fit.views)))
        if fit.counts.pixels == 0 or float(fit.evidence.spread[1]) <= ROUNDING * fit.squares:
            return ()
        outline = wrong_outline(fit)
        if outline is not None and outline.large:
            return (Suspicion("outline", views, None, said(fit.scene, outline), fit.names),)
        said_by_fit = next((note for note in fit.notes if note.kind in ("cause", "misfit")), None)
        if said_by_fit is None:
            return ()
        if said_by_fit.names in (("encoding",), ("convention",)):
            return (Suspicion(said_by_fit.names[0], views, None, said_by_fit),)
        set_up = SetUp(fit, (place for fault in FAULTS for place in fault.numbers(fit)))
        at, corrected = linearise(set_up, set_up.base), []
        while len(corrected) < MAX_ROUNDS and (best := _best(at)) is not None:
            corrected.append(best)
            assert best.after is not None
            at = linearise(set_up, best.after)
        left = [f for f in explained(at).found if (f.fault.kind, f.which) not in at.state.amounts]
        named = [f for f in left if not f.fault.unnamed]
        return _as_suspicions(set_up, at.state, [*corrected, *(named or ([] if corrected else left[:1]))])


def _best(at: Linearised) -> Found | None:
    """Return the fault that explains most, corrected; None where the first that remains cannot be."""
    regions = _regions(at)
    open_ = [f for f in explained(at).found if (f.fault.kind, f.which) not in at.state.amounts]
    named = next((f for f in open_ if not f.fault.unnamed), None)
    region = max(regions, key=lambda f: f.share, default=None)
    if region is not None and (named is None or region.share > MIN_REGION * named.share):
        return region
    return None if named is None else corrected_for(at, named)


def _regions(at: Linearised) -> list[Found]:
    """Return the regions that explain enough of the cost, each by a minimisation without it."""
    set_up, state, found = at.set_up, at.state, []
    for fault in FAULTS:
        if fault.regions is None or not (masks := fault.regions(set_up, state)):
            continue
        assert fault.confirmed is not None
        after = set_up.exclude(state, masks)
        if kept := fault.confirmed(set_up, state, after, masks):
            after = after if len(kept) == len(masks) else set_up.exclude(state, kept)
            moves = state.fit.values - after.fit.values
            found.append(Found(fault, set_up.fit, 0, tuple(kept), state.share(after), np.zeros(1), moves, after, kept))
    return found


def corrected_for(at: Linearised, found: Found) -> Found | None:
    """Return a fault at its best amount, beyond first order, if it moves numbers of the set-up; else None.

    Each step of its amount is followed by a minimisation over the fit's unknowns.
    """
    before, state, key = at.state, at.state, (found.fault.kind, found.which)
    for _ in range(MAX_STEPS):
        case, change = next((case, x) for case, x in changes_of(at, found.fault) if case.which == found.which)
        if not isinstance(case.change, Move):
            return None
        amount, moves = amount_alone(at, change)
        theta = state.theta.copy()
        theta[np.flatnonzero(~at.set_up.fit.at_bound)] -= moves
        amounts = {**state.amounts, key: state.amounts.get(key, 0.0) + amount}
        then = at.set_up.minimise(case.change.along(theta, amount), state.excluded, amounts)
        less = state.share(then)
        if less <= 0.0:
            break
        state, at = then, linearise(at.set_up, then)
        if less < NEGLIGIBLE:
            break
    if state is before:
        return None
    moved = before.fit.values - state.fit.values
    return replace(found, amount=state.amounts[key], share=before.share(state), moves=moved, after=state)


def _as_suspicions(set_up: SetUp, end: Corrected, found: Sequence[Found]) -> tuple[Suspicion, ...]:
    """Return faults as suspicions, as they are where all of them are corrected.

    Those of most views or lights are merged, since they probably have one cause.
    """
    suspected: list[Suspicion] = []
    for fault in dict.fromkeys(f.fault for f in found):
        alike = [f for f in found if f.fault is fault]
        if fault.described is not None:  # a round may have found only the darkest of a shadow
            masks = {i: np.any([f.masks[i] for f in alike if i in f.masks], 0) for f in alike for i in f.masks}
            where, regions = fault.described(set_up, end, masks)
            alike = [replace(alike[0], where=where, masks=regions, views=tuple(regions))]
        else:
            alike = [f if f.after is None else replace(f, amount=_amount(set_up, end, f), after=end) for f in alike]
        of = len(set_up.lit) if fault.relative else len(set_up.fit.scene.lights)
        names = tuple(n for n, *here in zip(set_up.fit.names, *(f.affected for f in alike), strict=True) if any(here))
        if fault.of_most and len(alike) > max(of / 2, 2):
            views, sizes = sorted({view for f in alike for view in f.views}), [f.size for f in alike]
            text = fault.of_most.format(count=len(alike), of=of, smallest=min(sizes), largest=max(sizes))
            suspected.append(Suspicion(fault.kind, tuple(views), None, text, names))
        else:
            suspected += [Suspicion(fault.kind, f.views, tuple(f.masks.values()) or None, str(f), names) for f in alike]
    return tuple(suspected)


def _amount(set_up: SetUp, end: Corrected, f: Found) -> np.ndarray:
    """Return a fault's amount; that of an exposure relative to the median of all views if there are at least three."""
    amounts = [end.amounts.get((f.fault.kind, i), np.zeros(1)) for i in range(len(set_up.lit))]
    if not f.fault.relative or len(amounts) < 3:
        return end.amounts[f.fault.kind, f.which]
    return (1.0 + amounts[f.which]) / (1.0 + np.median(amounts)) - 1.0
