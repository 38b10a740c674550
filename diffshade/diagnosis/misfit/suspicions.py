"""Suspicions: where the residuals of a fit contradict the scene description, in words and with a remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...core.backend import in_float64
from ...core.masks import Mask
from ...inverse.result import Fit
from ...inverse.verdicts.outlines import said, wrong_outline
from .encodings import better_encoding
from .explanations import NEXT_GAIN, at_minimum, of_all_views, of_one_view
from .found import Found
from .linearised import Linearised, linearise
from .scores import refitted
from .set_up import Corrected, SetUp

MAX_ROUNDS = 12
ROUNDING_SHARE = 1e-10  # residuals below this fraction of the images' sum of squares are rounding


@dataclass(frozen=True, eq=False)
class Suspicion:
    """A place where the residuals of a fit contradict the scene description."""

    kind: str
    """"encoding", "outline", or that of a fault of the table (`faults.FAULTS`)."""
    views: tuple[int, ...]
    region: tuple[Mask, ...] | None = field(repr=False)
    """The affected pixels of each of these views; None for the whole image."""
    sentence: str
    """What it is, its size, where, and the remedy."""
    affected: tuple[str, ...] = field(default=())
    """The unknowns that are not determined until it is corrected."""


def suspicions(fit: Fit) -> tuple[Suspicion, ...]:
    """Return where the residuals contradict the scene description; empty if they do not.

    Faults of one view, light or region compete. The one that explains most of the cost is corrected, and the remaining
    residuals are examined again, so that its side effects are not reported. If the images have the other encoding, or
    background lies inside the outline, nothing else is reported. Faults of all views together compete with the best of
    one view; if they lose, the remaining residuals are tested for them.
    """
    with in_float64(fit) as fit:
        views = tuple(range(len(fit.views)))
        if fit.counts.pixels == 0 or float(fit.evidence.spread[1]) <= ROUNDING_SHARE * fit.squares:
            return ()
        outline = wrong_outline(fit)
        if outline is not None and outline.large:
            return (Suspicion("outline", views, None, said(fit.scene, outline), fit.names),)
        at = first = at_minimum(fit)
        set_up = first.set_up
        found: list[Found] = []
        for _ in range(MAX_ROUNDS):
            explanations = of_one_view(at)
            rival = max((f.share for f in explanations), default=0.0)
            if not found and (encoding := better_encoding(fit, rival)):
                return (Suspicion("encoding", views, None, encoding),)
            if not explanations:
                break
            found.append(max(explanations, key=lambda f: f.share))
            at = _corrected(at, found[-1])
        everywhere, rivals = of_all_views(first)
        if found and not any(f.share > found[0].share for f in everywhere):
            end = settled(at, found)
            of_all, rivals = of_all_views(end)
            rest = 1.0 - set_up.base.share(end.state)
            everywhere = [f for f in of_all if rest * f.share > NEXT_GAIN * found[0].share]
            return (*described(set_up, end.state, found), *_of_all_views(fit, everywhere, rivals))
        return _of_all_views(fit, everywhere, rivals)


def settled(at: Linearised, found: Sequence[Found]) -> Linearised:
    """Return the minimum over all that was found, in turn: each was found before later faults were corrected."""
    moved = [f for f in found if not f.masks]
    for f in 2 * moved if len(moved) > 1 else ():
        if (again := refitted(at, f)) is not f:
            at = _corrected(at, again)
    return at


def _corrected(at: Linearised, found: Found) -> Linearised:
    return at if found.after is None else linearise(at.set_up, found.after)


def _of_all_views(fit: Fit, found: Sequence[Found], rivals: Sequence[Found]) -> tuple[Suspicion, ...]:
    """Return the faults of all views as suspicions."""
    affected = [f.affected for f in (*found, *rivals)]
    names = tuple(name for name, *here in zip(fit.names, *affected, strict=True) if any(here))
    return tuple(Suspicion(f.fault.kind, f.views, None, str(f), names) for f in found)


def described(set_up: SetUp, end: Corrected, found: Sequence[Found]) -> tuple[Suspicion, ...]:
    """Return the faults of one view, light or region as suspicions, as they are where all of them are corrected.

    Those of most views or lights are merged, since they probably have one cause; those that vanish there are left out.
    """
    suspected: list[Suspicion] = []
    for fault in dict.fromkeys(f.fault for f in found):
        alike = [f for f in found if f.fault is fault]
        if fault.described is None:
            there = [replace(f, amount=_amount(set_up, end, f), after=end) for f in alike]
            alike = [f for f in there if f.length >= fault.least]
        else:  # a round may have found only the darkest of a shadow
            masks = {i: np.any([f.masks[i] for f in alike if i in f.masks], 0) for f in alike for i in f.masks}
            where, regions = fault.described(set_up, end, masks)
            alike = [replace(alike[0], where=where, masks=regions, views=tuple(regions))]
        of = len(set_up.lit) if fault.relative else len(set_up.fit.scene.lights)
        if fault.of_most and len(alike) > max(of / 2, 2):
            views, sizes = sorted({view for f in alike for view in f.views}), [f.size for f in alike]
            text = fault.of_most.format(count=len(alike), of=of, smallest=min(sizes), largest=max(sizes))
            suspected.append(Suspicion(fault.kind, tuple(views), None, text))
        else:
            suspected += [Suspicion(fault.kind, f.views, tuple(f.masks.values()) or None, str(f)) for f in alike]
    return tuple(suspected)


def _amount(set_up: SetUp, end: Corrected, f: Found) -> np.ndarray:
    """Return a fault's amount; that of an exposure relative to the median of all views if there are at least three."""
    amounts = [end.amounts.get((f.fault.kind, i), np.zeros(1)) for i in range(len(set_up.lit))]
    if not f.fault.relative or len(amounts) < 3:
        return end.amounts[f.fault.kind, f.which]
    return (1.0 + amounts[f.which]) / (1.0 + np.median(amounts)) - 1.0
