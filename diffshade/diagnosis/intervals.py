"""Intervals by profile likelihood: how far a value can move before the photographs contradict it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from jaxtyping import Float

from ..core.progress import ReportProgress, silent
from ..inverse.own_views import OthersAsQuadratics, OwnViews
from ..inverse.result import Fit
from ..inverse.solve.solvers import evaluate
from ..inverse.statistics.clusters import Clusters
from ..inverse.statistics.uncertainty import Vector
from ..inverse.unknowns.unknown import coordinate_slopes
from ..parallel.threads import on_all_cores

CLOSE = 0.01  # relative tolerance of the number of errors at an end
EVALUATIONS = 16
ACCURATE = 1e-3  # largest error of a minimisation, as a fraction of the rise for one error
SAME = 0.3 * CLOSE  # relative; numbers of errors by an unknown's own views and by all views are alike within it
ALIKE = 4  # consecutive agreements, after which the other unknowns are not compared
FAR = 1e6  # errors; beyond this an interval has no end


class Profile:
    """The cost of a fit as a function of one unknown, minimised over the others.

    2 (C(t) - C_min) / (sigma^2 phi) is the square of the number of errors between t and the minimum. phi is the
    clusters' variance over that of independent noise (Venzon and Moolgavkar 1988). Runs in float64.
    """

    def __init__(self, fit: Fit, clusters: Clusters):
        self.laid = fit.solved.laid_out()
        self.fit, self.clusters = fit, clusters
        self.variance = clusters.rises()
        self.unit = 1.0 / coordinate_slopes(fit.values, fit.unknowns)
        self.errors = clusters.standard_errors() / self.unit  # in the solver's coordinates
        self.bounds = [np.asarray(bound) for bound in (self.laid.problem.box.lower, self.laid.problem.box.upper)]
        end = evaluate(self.laid.theta, self.laid.task, self.laid.chunks)
        self.best = float(end.total.cost)
        self.others = None if self.laid.problem.box.arrow is None else OthersAsQuadratics(fit, self.laid, end)
        self.alone: dict[int, OwnViews] = {}
        self.of_others = np.zeros(len(fit.unknowns))
        # A difference of costs is known to within the rounding of the sum of squares.
        self.evaluated: list[list[tuple[float, float]]] = [[] for _ in fit.unknowns]
        self.visible = 1e-2 * self.variance > 64.0 * np.finfo(float).eps * fit.squares

    def errors_away(self, j: int, t: float) -> float:
        """Return the distance of t from the minimum in errors, by the cost; t in the solver's coordinates."""
        variance, start = float(self.variance[j]), self._start(j, t)
        if j in self.alone:
            rise, of_others = self.alone[j].rise(j, t, start, ACCURATE * variance)
            self.of_others[j] = max(self.of_others[j], of_others / variance if np.isfinite(rise) else np.inf)
        else:
            rtol = ACCURATE * variance / max(self.best, 1e-300)
            end = self.laid.minimise({j: t}, start, rtol=min(rtol, 1e-6))
            rise = float(end.point.total.cost) - self.best
        away = float(np.sqrt(2.0 * max(rise, 0.0) / variance))
        self.evaluated[j].append((t, away))
        return away

    def curve(self, j: int) -> Float[np.ndarray, "points 2"]:
        """Return the values at which an unknown's profile was evaluated, in order, and their distances in errors."""
        points = np.array(sorted([(float(self.laid.theta[j]), 0.0), *self.evaluated[j]]))
        if self.fit.unknowns[j].logarithmic:
            points[:, 0] = np.exp(points[:, 0])
        return points

    def _start(self, j: int, t: float) -> Vector:
        """Return the other unknowns to first order when one is held at t."""
        fit = self.fit
        which = ~fit.at_bound
        which[j] = True
        k = int(np.sum(which[:j]))
        column = fit.evidence.covariance(which)[:, k] / (self.unit[which] * self.unit[j])
        theta = self.laid.theta.copy()
        if (own := column[k]) > 0:
            theta[which] += (t - theta[j]) * column / own
        return theta

    def by_own_views(self, search: Callable[[int], None], report_progress: ReportProgress) -> list[int]:
        """Search the unknowns that few views show, with all other views to second order; return these unknowns.

        This takes a time linear in the views, where all views for each unknown would take one that is quadratic.
        """
        if self.others is None:
            return []
        blocks = self.others.blocks(range(len(self.fit.unknowns)))
        for k, (b, members) in enumerate(blocks.items()):
            report_progress("intervals of what few views show", k / len(blocks))
            self.alone = dict.fromkeys(members, self.others.of(b))
            on_all_cores(search, members)
        self.alone = {}
        return [j for members in blocks.values() for j in members]

    def unlike_all_views(self, searched: Sequence[int]) -> Iterator[int]:
        """Yield the unknowns whose profiles by their own views differ from those by all views.

        They are compared where they were evaluated farthest away, in the order of what their moves of the border cost
        other views, until `ALIKE` consecutive ones agree.
        """
        alike = 0
        for j in sorted(searched, key=lambda j: -self.of_others[j]):
            if alike == ALIKE:
                return
            if points := self.evaluated[j]:
                farthest = {min(points), max(points)}
                self.evaluated[j] = []
                same = all(abs(self.errors_away(j, t) - away) <= SAME * away for t, away in farthest)
                self.evaluated[j] = points if same else []
                alike = alike + 1 if same else 0
                if not same:
                    yield j

    def end(self, j: int, side: int, errors: float) -> float:
        """Return the interval's end on one side, in the unknown's own unit, or its bound if that comes first."""
        unknown, fit = self.fit.unknowns[j], self.fit
        bound = unknown.lower if side < 0 else unknown.upper
        if fit.values[j] == bound:
            return float(bound)
        if not np.isfinite(self.errors[j]) or not fit.evidence.regular[j]:
            return float(bound)
        to_bound = abs(self.bounds[side > 0][j] - self.laid.theta[j])
        reach = errors * self.errors[j]
        if self.visible[j]:
            reach = self._search(j, side, errors, to_bound)
        if reach >= to_bound:
            return float(bound)
        t = self.laid.theta[j] + side * reach
        return float(np.exp(t)) if unknown.logarithmic else float(t)

    def _search(self, j: int, side: int, errors: float, to_bound: float) -> float:
        """Find the distance to the end: a first guess from the standard error, then along chords of the profile."""
        inner, outer = (0.0, 0.0), (np.inf, np.inf)
        reach = min(errors * self.errors[j], to_bound)
        for _ in range(EVALUATIONS):
            away = self.errors_away(j, self.laid.theta[j] + side * reach)
            if abs(away / errors - 1.0) < CLOSE:
                return reach
            if away < errors:
                inner = (reach, away)
                if reach >= min(to_bound, FAR * self.errors[j]):
                    return to_bound
            else:
                outer = (reach, away)
            if np.isfinite(outer[0]):
                share = (errors - inner[1]) / (outer[1] - inner[1])
                reach = inner[0] + min(max(share, 0.1), 0.9) * (outer[0] - inner[0])
            else:
                reach = min(reach * min(max(errors / max(away, 1e-9), 1.1), 4.0), to_bound)
        return reach


def intervals(
    profile: Profile, levels: Sequence[float], report_progress: ReportProgress = silent
) -> Float[np.ndarray, "levels p 2"]:
    """Return the two-sided intervals at each level; they end at the bounds.

    The interval of an unknown that is not determined is its whole range.
    """
    p, reach = len(profile.fit.unknowns), [profile.clusters.quantiles(level) for level in levels]
    found = np.zeros((len(reach), p, 2))

    def search(j: int) -> None:
        found[:, j] = [[profile.end(j, side, q[j]) for side in (-1, 1)] for q in reach]

    by_own_views = profile.by_own_views(search, report_progress)
    remaining = np.setdiff1d(np.arange(p), by_own_views)
    for k, j in enumerate(remaining.tolist()):
        report_progress(f"interval of {profile.fit.names[j]}", k / len(remaining))
        search(j)
    for j in profile.unlike_all_views(by_own_views):
        report_progress(f"interval of {profile.fit.names[j]}")
        search(j)
    return found
