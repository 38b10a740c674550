"""Plan notes: what the best shot determines, what no shot determines, and what was assumed, a sentence each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.words import listing
from ..inverse.result import Fit
from ..inverse.statistics.identifiability import VAGUE, VAGUE_LOG, some_channels
from ..inverse.statistics.uncertainty import Vector
from ..inverse.unknowns.unknown import logarithms
from .shot_ranking import relative_to_values
from .shots import Shot, unknowns_of_lamp

MUCH_CLIPPED = 0.05  # a fraction of a shot's pixels; with more of them clipped, the exposure is too long


@dataclass(frozen=True, eq=False)
class Ranked:
    """Shots with the errors to expect, and their order."""

    fit: Fit
    shots: Sequence[Shot]
    names: Sequence[str]
    order: Sequence[int]
    aim: Bool[np.ndarray, " p"]
    now: Vector
    errors: Float[np.ndarray, "shots p"]
    rank: Int[np.ndarray, " shots"]
    clipped: Float[np.ndarray, " shots"]

    @property
    def best(self) -> str:
        """The name of the best shot."""
        return self.names[self.order[0]]

    @property
    def best_errors(self) -> Vector:
        """The errors to expect with the best shot."""
        return self.errors[self.order[0]]

    def names_of(self, which: Bool[np.ndarray, " p"]) -> str:
        """Return the names of some unknowns as a phrase, a quantity's where all its channels are among them."""
        return listing(some_channels(which, self.fit.unknowns))


def plan_notes(ranked: Ranked) -> list[str]:
    """Return the sentences below a plan's table."""
    return [
        *_newly_determined(ranked),
        *_error_ratio(ranked),
        *_undetermined(ranked),
        *_too_uncertain(ranked),
        *_new_directions(ranked),
        *_clipped(ranked),
        *_assumed_known(ranked),
        "errors assume independent noise as large as the fit's; use them only to compare shots with each other.",
    ]


def _newly_determined(ranked: Ranked) -> list[str]:
    new = ~np.isfinite(ranked.now) & np.isfinite(ranked.best_errors)
    return [f"{ranked.best} determines {ranked.names_of(new)}, which the views do not."] if new.any() else []


def _error_ratio(ranked: Ranked) -> list[str]:
    """Compare the errors with the best shot to those of now, as a geometric mean."""
    now, then = ranked.now, ranked.best_errors
    chosen = np.isfinite(now) & np.isfinite(then) & (now > 0) & (ranked.aim if ranked.aim.any() else True)
    if not chosen.any():
        return []
    ratio = float(np.exp(np.mean(np.log(then[chosen] / now[chosen]))))
    what = ranked.names_of(chosen) if ranked.aim.any() else "what the views determine"
    return [f"with {ranked.best}, the errors of {what} are {ratio:.2g} times the present ones."]


def _undetermined(ranked: Ranked) -> list[str]:
    never = np.array(~np.isfinite(ranked.errors).any(0))
    if never.any():
        fix = "it" if never.sum() == 1 else "one"
        return [
            f"none of these shots determines {ranked.names_of(never)} (-). Fix {fix}, or plan with other lights, "
            "distances or cameras."
        ]
    if not np.isfinite(ranked.errors).all() or not np.isfinite(ranked.now).all():
        return ["a dash marks an unknown that is not determined."]
    return []


def _too_uncertain(ranked: Ranked) -> list[str]:
    fit, then = ranked.fit, ranked.best_errors
    limit = np.where(logarithms(fit.unknowns), VAGUE_LOG, VAGUE)
    relative = relative_to_values(fit.unknowns, fit.values, then, fit.scales)
    lost = ~fit.determined & np.isfinite(then) & (relative > limit)
    return [f"even with {ranked.best}, {ranked.names_of(lost)} would be lost in the noise."] if lost.any() else []


def _new_directions(ranked: Ranked) -> list[str]:
    if not ranked.rank.any():
        return []
    return ["'new' counts the directions that a shot determines and the views do not; such shots rank first."]


def _clipped(ranked: Ranked) -> list[str]:
    return [
        f"{ranked.names[i]} would have {ranked.clipped[i]:.0%} of its pixels clipped; they do not count. Give it a "
        "shorter exposure."
        for i in ranked.order
        if ranked.clipped[i] > MUCH_CLIPPED
    ]


def _assumed_known(ranked: Ranked) -> list[str]:
    """Name the parameters that differ from lamp to lamp, or from view to view: a shot's own are taken as known."""
    own = {
        leaf
        for shot in ranked.shots
        if shot.light is not None
        for (leaf, _), unknowns in unknowns_of_lamp(ranked.fit, shot.light).items()
        if len(unknowns) > 1
    }
    own |= {f"{u.kind} of a view" for u in ranked.fit.unknowns if any(p.startswith("views.") for p, _ in u.places)}
    return [f"assumed known for each shot, though unknown in the views: {listing(sorted(own))}."] if own else []
