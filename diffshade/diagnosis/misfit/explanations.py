"""Explanations: the faults of the table that explain the residuals: of one view, light or region, or of all views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ...inverse.result import Fit
from .faults import FAULTS
from .found import Found
from .linearised import Linearised, linearise
from .regional import PROMISING_PART
from .residual_correlation import correlation_of
from .scores import refitted, scored
from .set_up import SetUp

MAX_REFITS = 3  # of one kind at a time
MIN_EXPLAINED = 0.5  # the least that a fault explains of the structure in the residuals
RIVAL_GAIN = 0.5  # another fault with this fraction of the best fault's gain may be the cause as well
NEXT_GAIN = 0.25  # the least gain of a second fault, over the best fault's
MAX_FAULTS = 3  # faults of all views
SIMPLER_GAIN = 0.85  # a simpler fault with more than this fraction of the best one's gain is preferred

OF_ONE = [fault for fault in FAULTS if fault.cases and fault.least_share]
REGIONAL = [fault for fault in FAULTS if fault.regions]
OF_ALL = [fault for fault in FAULTS if fault.cases and not fault.least_share]


def at_minimum(fit: Fit) -> Linearised:
    """Return a fit where the faults of the table can be scored. In float64."""
    set_up = SetUp(fit, (place for fault in FAULTS for place in fault.numbers(fit)))
    return linearise(set_up, set_up.base)


def of_one_view(at: Linearised) -> list[Found]:
    """Return the faults of one view, light or region that explain enough, each by a refit with it corrected."""
    set_up, state, found = at.set_up, at.state, []
    seen = [f for f in scored(at, OF_ONE) if (f.fault.kind, f.which) not in state.amounts and f.exceeds(PROMISING_PART)]
    for fault in OF_ONE:
        promising = sorted((f for f in seen if f.fault is fault), key=lambda f: -f.share)
        for f in (refitted(at, f) for f in promising[:MAX_REFITS]):
            if f.after is not None and f.exceeds():
                found.append(f)
    moved = [f.after for f in found if f.after]
    for fault in REGIONAL:
        assert fault.regions is not None
        assert fault.confirmed is not None
        if not (masks := fault.regions(set_up, state)):
            continue
        after = set_up.exclude(state, masks)
        if kept := fault.confirmed(set_up, state, after, masks, moved):
            after = after if len(kept) == len(masks) else set_up.exclude(state, kept)
            share, own_share = state.share(after), state.share(after, kept)
            one = Found(fault, set_up.fit, 0, tuple(kept), share, own_share, after=after, masks=kept)
            found += [one] if one.exceeds() else []
    return found


def of_all_views(at: Linearised) -> tuple[list[Found], list[Found]]:
    """Return the faults of all views that move a value which the fit determines, and what may be the cause as well.

    The one that explains most comes first, and the others explain what is left: where its numbers are corrected, or,
    if it moves none, beside its direction.
    """
    structure, base = correlation_of(at.fit, at.state.excluded).least, at.state
    found: list[Found] = []
    rivals: list[Found] = []
    while len(found) < MAX_FAULTS:
        named, left = [f for f in found if f.after is None], 1.0 - base.share(at.state)
        refits = [f if named else refitted(at, f) for f in scored(at, OF_ALL, named)]
        seen = [replace(f, share=left * f.share) for f in refits]
        least = MIN_EXPLAINED * (structure - sum(f.share for f in found))
        least = max(least, NEXT_GAIN * found[0].share if found else 0.0)
        usable = [f for f in seen if f.share > least and f.matters() and f.fault not in [g.fault for g in found]]
        if not usable:
            break
        best = _simplest(usable)
        rivals = rivals if found else [f for f in seen if f is not best and f.share > RIVAL_GAIN * best.share]
        found.append(best)
        at = at if best.after is None else linearise(at.set_up, best.after)
    return found, rivals


def _simplest(found: Sequence[Found]) -> Found:
    """Return the fault that explains most, or a simpler one that explains nearly as much."""
    best = max(found, key=lambda f: f.share)
    simpler = [f for f in found if f.fault.kind in best.fault.yields_to and f.share > SIMPLER_GAIN * best.share]
    return max(simpler, key=lambda f: f.share, default=best)
