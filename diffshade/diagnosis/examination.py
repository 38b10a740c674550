"""Examination: intervals of a fit, their dependence on the data, and a check against the scene description."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float
from scipy import special

from ..core.backend import in_float64
from ..core.fields import check_kind
from ..core.progress import showing
from ..core.tables import as_text, cells, parameters
from ..core.thresholds import INTERVALS, MINOR, VAGUE
from ..core.words import count, listing
from ..inverse.result import Fit
from ..inverse.statistics.clusters import Clusters
from ..inverse.statistics.identifiability import VAGUE_LOG, relative_errors, remedy, some_channels
from ..inverse.statistics.uncertainty import Vector
from ..inverse.unknowns.unknown import logarithms
from ..inverse.verdicts.stability import FitWithout, dependence, left_out, moves, refits
from .intervals import LikelihoodProfile, intervals
from .patches import find_clusters
from .suspicions import Suspicion, suspicions


@dataclass(frozen=True, eq=False)
class Examination:
    """A fit with intervals and checks; `print` it for the table. Every array is NumPy float64."""

    fit: Fit = field(repr=False)
    errors: Vector
    """Standard errors: for independent noise if the views agree within it, else by clusters."""
    interval_68: Float[np.ndarray, "p 2"]
    """Profile intervals; the true value lies inside 68 % of the time. One-sided at a bound."""
    interval_95: Float[np.ndarray, "p 2"]
    """Profile intervals; the true value lies inside 95 % of the time."""
    profiles: tuple[Float[np.ndarray, "_ 2"], ...]
    """For each unknown: the values at which its profile was evaluated, and their distances in errors by the cost."""
    determined: Bool[np.ndarray, " p"]
    """Whether a value is determined: by the fit, whichever data are included, and within a finite interval."""
    refits: tuple[FitWithout, ...] = field(repr=False)
    suspicions: tuple[Suspicion, ...]
    """Where the residuals contradict the scene description."""
    notes: tuple[str, ...]
    """What the views do not determine, how the errors were found, what moved: a sentence each."""

    def __str__(self) -> str:
        """Return the table of parameters with intervals, and the notes below it."""
        fit = self.fit
        columns = parameters(fit.names, fit.values, self.errors, self.determined)
        for level, interval in (("68 %", self.interval_68), ("95 %", self.interval_95)):
            ends = np.where(self.determined[:, None], cells(interval, self.errors[:, None]), "")
            columns[level] = [" to ".join(pair).removeprefix(" to ") for pair in ends]
        title = f"examination of a fit of {count(fit.counts.views, 'view')}, {fit.counts.pixels:,} pixels"
        return as_text(title, columns, notes=self.notes)


def examine(fit: Fit, *, progress: bool = False) -> Examination:
    """Examine a fit: intervals, their dependence on the data, and a check against the scene description.

    1. Errors are for independent noise if the views' own optima scatter no more than that noise explains. Otherwise
       they are by delete-one jackknife over the views, with Student's t, or over patches if there are fewer than three
       views.
    2. Intervals are profile-likelihood intervals (Venzon and Moolgavkar 1988): the cost, minimised over the other
       unknowns, rises by the square of the number of errors. They may be asymmetric, and end at bounds.
    3. The fit is repeated without half of the views, without saturated pixels and 1 and 3 px around them, without the
       brightest half of the highlight, and without 2 and 5 degrees around it, unless its residuals name a cause. How
       far a value moves is added to its error, if that is more than three errors and the remaining data contradict the
       old value; one that moves by 30 % is not determined.
    4. The faults of the description that the fit found in its residuals are corrected one by one, with cast shadows and
       interreflection at a rim, so that each has its size beside the others.

    Args:
        fit: The fit to examine.
        progress: Show a progress line on the terminal.

    Returns:
        `interval_68`, `interval_95`, `errors` and `determined` in the order of `fit.names`; `refits`, `suspicions` and
        `notes`. `print` shows them.

    Raises:
        TypeError: If `fit` is not a `Fit`.
    """
    check_kind("fit", fit, Fit, "ds.fit(scene, views, free=('k_d',))")
    with showing("examine", show=progress) as report_progress, in_float64(fit) as own:
        report_progress("errors")
        clusters = find_clusters(own)
        profile = LikelihoodProfile(own, clusters)
        found = intervals(profile, INTERVALS, report_progress)
        profiles = tuple(profile.curve(j) for j in range(len(own.unknowns)))
        refitted = refits(own, clusters, left_out(own), report_progress)
        report_progress("checking the residuals")
        suspected = suspicions(own)
    return summarise(fit, clusters, found, profiles, refitted, suspected)


def summarise(
    fit: Fit,
    clusters: Clusters,
    found: Float[np.ndarray, "2 p 2"],
    profiles: tuple[Float[np.ndarray, "_ 2"], ...],
    refitted: list[FitWithout],
    suspected: tuple[Suspicion, ...],
) -> Examination:
    """Return an examination: what stays determined, and the notes.

    Args:
        fit: The fit.
        clusters: The clusters of its errors.
        found: The intervals at 68 % and 95 %.
        profiles: The profile of each unknown.
        refitted: The fits without some of the data.
        suspected: Where the residuals contradict the scene description.
    """
    distance, unstable = moves(fit, refitted)
    added = np.hypot(fit.added_errors, distance)
    errors = np.hypot(clusters.wide_errors(), added)
    interval_68, interval_95 = _allowing_for(fit, added, found)
    lower, upper = (np.array([getattr(u, end) for u in fit.unknowns]) for end in ("lower", "upper"))
    unconstrained = fit.determined & (interval_95[:, 0] <= lower) & (interval_95[:, 1] >= upper)
    wide = _too_wide(fit, interval_95) & fit.determined & ~unconstrained
    determined = fit.determined & ~unconstrained & ~wide & ~unstable
    notes = [
        *(suspicion.sentence for suspicion in suspected),
        *_not_determined(fit, unconstrained, wide, interval_95),
        *dependence(fit, refitted, unstable | wide),
        *_correlated(fit),
        f"errors: {fit.what_errors_hold(clusters)}",
        *(n for n in fit.notes if n.kind != "0 within noise" and n not in [s.sentence for s in suspected]),
        *_upper_limits(fit, determined, interval_95),
    ]
    return Examination(
        fit, errors, interval_68, interval_95, profiles, determined, tuple(refitted), suspected, tuple(notes)
    )


def _allowing_for(fit: Fit, added: Vector, found: Float[np.ndarray, "2 p 2"]) -> Float[np.ndarray, "2 p 2"]:
    """Return intervals whose ends lie as much farther out as is added to the errors."""
    wider = np.array([special.ndtri(0.5 + 0.5 * level) for level in INTERVALS])[:, None, None]
    away = np.array(found) - fit.values[:, None]
    out = np.hypot(away, wider * added[:, None])
    lower, upper = (np.array([getattr(u, end) for u in fit.unknowns]) for end in ("lower", "upper"))
    ends = fit.values[:, None] + np.where(np.arange(2) == 0, -out, out)
    lower, upper = np.minimum(lower, found[..., 0].min(0)), np.maximum(upper, found[..., 1].max(0))
    return np.where(added[:, None] > 0, np.clip(ends, lower[:, None], upper[:, None]), found)


def _not_determined(
    fit: Fit,
    unconstrained: Bool[np.ndarray, " p"],
    wide: Bool[np.ndarray, " p"],
    interval_95: Float[np.ndarray, "p 2"],
) -> Iterator[str]:
    """Name what the views do not constrain, and what is lost in the noise."""
    if unconstrained.any():
        names = listing(some_channels(unconstrained, fit.unknowns))
        yield f"the views do not constrain {names}: any value within the bounds fits."
    if wide.any():
        lost = np.flatnonzero(wide)
        ranges = [f"{fit.names[j]} in {interval_95[j, 0]:.3g} to {interval_95[j, 1]:.3g}" for j in lost]
        fix = remedy(list(dict.fromkeys(fit.unknowns[j].quantity for j in lost)), fit.unknowns)
        yield f"lost in the noise, by the 95 % intervals: {listing(ranges)}. {fix}"


def _too_wide(fit: Fit, interval_95: Float[np.ndarray, "p 2"]) -> Bool[np.ndarray, " p"]:
    """Return what is lost in the noise by its interval, which covers cases that errors at a bound miss."""
    log = logarithms(fit.unknowns)
    lower, upper = interval_95.T
    width = np.where(log, fit.values * np.log(np.where(log, upper, 1.0) / np.where(log, lower, 1.0)), upper - lower)
    half = np.where(np.isfinite(interval_95).all(1), 0.5 * width, np.inf) / 1.96
    lost = relative_errors(fit.unknowns, fit.values, half, fit.scales) > np.where(log, VAGUE_LOG, VAGUE)
    return lost & ~(~log & (upper <= VAGUE * fit.scales))


def _upper_limits(fit: Fit, determined: Bool[np.ndarray, " p"], interval_95: Float[np.ndarray, "p 2"]) -> list[str]:
    """Name what is 0 within the noise, with upper limits."""
    lower = np.array([u.lower for u in fit.unknowns])
    small = determined & (interval_95[:, 0] <= lower) & (lower == 0.0)
    limits = [f"{fit.names[j]} {interval_95[j, 1]:.2g}" for j in np.flatnonzero(small)]
    return [f"0 within the noise, with upper limits (95 %): {listing(limits)}."] if limits else []


def _correlated(fit: Fit) -> list[str]:
    """Name the quantities that are strongly correlated."""
    correlation = fit.correlation
    pairs = np.argwhere(np.triu(np.abs(correlation) > (1.0 - MINOR), 1))
    groups: dict[tuple[str, str], float] = {}
    for i, j in pairs:
        key = (fit.unknowns[i].quantity, fit.unknowns[j].quantity)
        groups[key] = max(groups.get(key, 0.0), abs(float(correlation[i, j])))
    return [f"{a} and {b} are strongly correlated ({c:.3f})." for (a, b), c in groups.items() if a != b]
