"""Intervals by profile likelihood: how far a value can move before the photographs contradict it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from jaxtyping import Float
from scipy import optimize

from ..core.progress import ReportProgress, silent
from ..core.thresholds import NEGLIGIBLE, SINGLE, SLIGHT
from ..inverse.result import Fit
from ..inverse.solve.solvers import evaluate
from ..inverse.statistics.clusters import Clusters
from ..inverse.statistics.uncertainty import Vector
from ..inverse.unknowns.unknown import coordinate_slopes

ACCURATE = NEGLIGIBLE  # largest error of a minimisation, as a fraction of the rise for one error
CLOSE = SLIGHT  # relative tolerance of the number of errors at an end
EVALUATIONS = 16
FAR = 1.0 / SINGLE  # errors; beyond this an interval has no end


class LikelihoodProfile:
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
        self.best = float(evaluate(self.laid.theta, self.laid.task, self.laid.chunks).total.cost)
        # A difference of costs is known to within the rounding of the sum of squares.
        self.evaluated: list[list[tuple[float, float]]] = [[] for _ in fit.unknowns]
        self.visible = 1e-2 * self.variance > 64.0 * np.finfo(float).eps * fit.squares

    def errors_away(self, j: int, t: float) -> float:
        """Return the distance of t from the minimum in errors, by the cost; t in the solver's coordinates."""
        variance = float(self.variance[j])
        rtol = min(ACCURATE * variance / max(self.best, 1e-300), SINGLE)
        rise = float(self.laid.minimise({j: t}, self._start(j, t), rtol=rtol).point.total.cost) - self.best
        away = min(float(np.sqrt(2.0 * max(rise, 0.0) / variance)), FAR) if np.isfinite(rise) else FAR
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
        column = fit.evidence.covariance(which)[:, j] / (self.unit * self.unit[j])
        theta = self.laid.theta.copy()
        if (own := column[j]) > 0:
            theta[which] += (t - theta[j]) * column[which] / own
        return theta

    def end(self, j: int, side: int, errors: float) -> float:
        """Return the interval's end on one side, in the unknown's own unit, or its bound if that comes first."""
        unknown, fit = self.fit.unknowns[j], self.fit
        bound = unknown.lower if side < 0 else unknown.upper
        if fit.values[j] == bound or not np.isfinite(self.errors[j]) or not fit.evidence.regular[j]:
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
        unit = self.errors[j]

        def beyond(reach: float) -> float:  # in standard errors
            away = self.errors_away(j, self.laid.theta[j] + side * reach * unit) / errors - 1.0 if reach else -1.0
            return away if abs(away) >= CLOSE else 0.0

        reach, away, known = min(errors, to_bound / unit), -1.0, cache(beyond)
        for _ in range(EVALUATIONS):
            away = known(reach)
            if away >= 0.0:
                break
            if reach >= min(to_bound / unit, FAR):
                return to_bound
            reach = min(reach * min(max(1.0 / max(1.0 + away, 1e-9), 1.1), 4.0), to_bound / unit)
        if away > 0.0:
            reach = optimize.root_scalar(known, bracket=(0.0, reach), method="brentq", rtol=CLOSE).root
        return unit * reach


def intervals(
    profile: LikelihoodProfile, levels: Sequence[float], report_progress: ReportProgress = silent
) -> Float[np.ndarray, "levels p 2"]:
    """Return the two-sided intervals at each level; they end at the bounds.

    The interval of an unknown that is not determined is its whole range.
    """
    names, reach = profile.fit.names, [profile.clusters.quantiles(level) for level in levels]
    found = np.zeros((len(reach), len(names), 2))
    for j, name in enumerate(names):
        report_progress(f"interval of {name}", j / len(names))
        found[:, j] = [[profile.end(j, side, q[j]) for side in (-1, 1)] for q in reach]
    return found
