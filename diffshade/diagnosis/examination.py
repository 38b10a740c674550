"""Examination: a fit with all that can be said of it: intervals, and what moves when data are left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..core.backend import in_float64
from ..core.fields import check_kind
from ..core.progress import showing
from ..core.words import count, listing
from ..inverse.checks.stability import Refit, dependence, left_out, refits
from ..inverse.result import Fit
from ..inverse.statistics.clusters import Clusters
from ..inverse.statistics.identifiability import VAGUE, VAGUE_LOG, relative_errors, remedy
from ..inverse.statistics.uncertainty import Vector
from ..inverse.unknowns.unknown import logarithms
from .intervals import Profile, intervals
from .misfit.leftovers import inflated
from .misfit.suspicions import Suspicion, suspicions
from .patches import find_clusters

LEVELS = (0.68, 0.95)
TOGETHER = 0.95  # correlation, from which two numbers are said to move together


@dataclass(frozen=True, eq=False)
class Examination:
    """A fit with all that can be said of it; `print` it for the table. Every array is NumPy float64."""

    fit: Fit
    errors: Vector
    """Standard errors: plain where the views agree as far as independent noise lets them, else by clusters."""
    interval_68: Float[np.ndarray, "p 2"]
    """Profile intervals that hold the truth with 68 %; one-sided at a bound."""
    interval_95: Float[np.ndarray, "p 2"]
    """Profile intervals that hold the truth with 95 %."""
    profiles: tuple[Float[np.ndarray, "_ 2"], ...]
    """Of each unknown the values that its intervals were found by, and how many errors the cost says each is away."""
    determined: Bool[np.ndarray, " p"]
    """What the fit determines, less what moves with the data kept, and what may be anything within its bounds."""
    refits: tuple[Refit, ...]
    suspicions: tuple[Suspicion, ...]
    """What the residuals show to be other than was said."""
    notes: tuple[str, ...]
    """What these views cannot tell, how the errors were made, what moved: a sentence each."""

    def __str__(self) -> str:
        """Return the table of parameters with intervals, and below it the notes."""
        fit, width = self.fit, max(len("parameter"), *map(len, self.fit.names))
        counts = fit.counts
        lines = [
            f"examination of a fit of {count(counts.views, 'view')}, {counts.pixels:,} pixels",
            f"{'parameter':<{width}} {'value':>12} {'error':>9} {'68 %':>23} {'95 %':>23}",
        ]
        for j, name in enumerate(fit.names):
            if not self.determined[j]:
                lines.append(f"{name:<{width}} {'not determined':>12}")
                continue
            ranges = [f"{f'{low:.5g} to {high:.5g}':>23}" for low, high in (self.interval_68[j], self.interval_95[j])]
            lines.append(f"{name:<{width}} {fit.values[j]:>12.6g} {self.errors[j]:>9.2g} {' '.join(ranges)}")
        return "\n".join([*lines, *(f"- {note}" for note in self.notes)])


def examine(fit: Fit, *, progress: bool = False) -> Examination:
    """Examine a fit: intervals that cover, and in words what cannot be believed.

    Errors are for independent noise where the views' own optima scatter no more than it lets them, else by delete-one
    jackknife over the views (patches of them, where there are fewer than three), with Student's t. Intervals are where
    the cost, the other unknowns at their best, has risen by the square of so many errors (profile likelihood; Venzon
    and Moolgavkar 1988): they bend with the problem and end at bounds. Then the fit is made anew without half of the
    views, without saturated pixels and 1 and 3 px about them, without the brightest half of the highlight, and without
    2 and 5 degrees about it: a number that moves by 30 %, or by three errors, and to whose old value what is left
    objects, is not determined. At last the residuals are asked for what is other than was said: the files' curve, an
    exposure, a light's place, cast shadows, light between surfaces at a rim, and, in all views together, vignetting, a
    gamma, blur, the other lobe, a sphere's size or place, and all lights turned. What such a fault moves by two errors
    is not determined. `progress`: show a line on the terminal.

    Raises TypeError for anything but a fit.
    """
    check_kind("fit", fit, Fit, "ds.fit(scene, views, free=('k_d',))")
    with showing("examine", show=progress) as report_progress, in_float64(fit) as own:
        report_progress("errors")
        clusters, alike = inflated(own, find_clusters(own))
        profile = Profile(own, clusters)
        found = intervals(profile, LEVELS, report_progress)
        profiles = tuple(profile.curve(j) for j in range(len(own.unknowns)))
        again, shifted = refits(own, clusters, left_out(own), report_progress)
        report_progress("looking at the residuals")
        suspected = suspicions(own)
    return _say(fit, clusters, found, profiles, again, shifted & fit.determined, suspected, alike)


def _say(
    fit: Fit,
    clusters: Clusters,
    found: Float[np.ndarray, "2 p 2"],
    profiles: tuple[Float[np.ndarray, "_ 2"], ...],
    again: list[Refit],
    shifted: Bool[np.ndarray, " p"],
    suspected: tuple[Suspicion, ...],
    alike: str = "",
) -> Examination:
    errors = clusters.wide_errors()
    interval_68, interval_95 = found
    lower, upper = (np.array([getattr(u, end) for u in fit.unknowns]) for end in ("lower", "upper"))
    anything = fit.determined & (interval_95[:, 0] <= lower) & (interval_95[:, 1] >= upper)
    wide = _too_wide(fit, interval_95) & fit.determined & ~anything
    corrupted = fit.determined & np.isin(fit.names, [name for of in suspected for name in of.withdrawn])
    determined = fit.determined & ~anything & ~wide & ~shifted & ~corrupted
    notes = [
        *(suspicion.sentence for suspicion in suspected),
        *_withdrawn(fit, corrupted),
        *([f"{listing(_names(fit, anything))} may be anything within the bounds."] if anything.any() else []),
        *_wide(fit, wide, interval_95),
        *dependence(fit, again, shifted),
        *_together(fit),
        *([alike] if alike else []),
        f"errors: {fit.what_errors_hold(clusters)}",
        *(n for n in fit.notes if not n.startswith("0 within") and n not in [s.sentence for s in suspected]),
        *_at_most(fit, determined, interval_95),
    ]
    return Examination(
        fit, errors, interval_68, interval_95, profiles, determined, tuple(again), suspected, tuple(notes)
    )


def _withdrawn(fit: Fit, corrupted: Bool[np.ndarray, " p"]) -> list[str]:
    """Say what is not determined for what the residuals show to be wrong."""
    if not corrupted.any():
        return []
    names = _names(fit, corrupted)
    return [f"until that is corrected {listing(names)} {'is' if len(names) == 1 else 'are'} not determined."]


def _too_wide(fit: Fit, interval_95: Float[np.ndarray, "p 2"]) -> Bool[np.ndarray, " p"]:
    """Return what is lost in the noise by its interval, which sees what errors at a bound do not (see `vague`)."""
    log = logarithms(fit.unknowns)
    half = np.where(np.isfinite(interval_95).all(1), 0.5 * (interval_95[:, 1] - interval_95[:, 0]), np.inf) / 1.96
    in_log = 0.5 * np.log(np.where(log, interval_95[:, 1], 1.0) / np.where(log, interval_95[:, 0], 1.0)) / 1.96
    lost = np.where(log, in_log > VAGUE_LOG, relative_errors(fit.unknowns, fit.values, half, fit.scales) > VAGUE)
    return lost & ~(~log & (interval_95[:, 1] <= VAGUE * fit.scales))


def _wide(fit: Fit, wide: Bool[np.ndarray, " p"], interval_95: Float[np.ndarray, "p 2"]) -> list[str]:
    """Say between what the unknowns may be that are lost in the noise by their intervals."""
    ranges = [f"{fit.names[j]} in {interval_95[j, 0]:.3g} to {interval_95[j, 1]:.3g}" for j in np.flatnonzero(wide)]
    quantities = list(dict.fromkeys(fit.unknowns[j].quantity for j in np.flatnonzero(wide)))
    return [f"lost in the noise by the 95 % intervals: {listing(ranges)}. {remedy(quantities)}"] if ranges else []


def _at_most(fit: Fit, determined: Bool[np.ndarray, " p"], interval_95: Float[np.ndarray, "p 2"]) -> list[str]:
    """Say what is 0 within the noise, and what it is at most."""
    lower = np.array([u.lower for u in fit.unknowns])
    small = determined & (interval_95[:, 0] <= lower) & (lower == 0.0)
    limits = [f"{fit.names[j]} {interval_95[j, 1]:.2g}" for j in np.flatnonzero(small)]
    return [f"0 within the noise, and at most (95 %): {listing(limits)}."] if limits else []


def _together(fit: Fit) -> list[str]:
    """Say which numbers can hardly move apart."""
    correlation = fit.correlation
    pairs = np.argwhere(np.triu(np.abs(correlation) > TOGETHER, 1))
    groups: dict[tuple[str, str], float] = {}
    for i, j in pairs:
        key = (fit.unknowns[i].quantity, fit.unknowns[j].quantity)
        groups[key] = max(groups.get(key, 0.0), abs(float(correlation[i, j])))
    return [f"{a} and {b} move together (correlation {c:.3f})." for (a, b), c in groups.items() if a != b]


def _names(fit: Fit, which: Bool[np.ndarray, " p"]) -> list[str]:
    return [name for name, here in zip(fit.names, which, strict=True) if here]
