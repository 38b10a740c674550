r"""Two balls: where each lamp stands, from the directions to it from two places that need not be known.

A lamp in the direction m from the middle between the balls, 1/w times as far away as the balls are apart, is seen from
the point p in the direction

$$ l \propto m - w p, \quad p = \pm b/2 + r n $$

with the unit vector b from one ball to the other, and the highlight's normal n on a ball of radius r. Lengths are in
units of the distance between the balls, which directions alone do not show: twice the distance to everything looks
alike. w, the nearness, has symmetric errors, and is 0 for a lamp far away.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares

from ..core.robust_scale import GAUSS_95
from ..core.thresholds import SMALL
from ..texels.lights.refining import tangents_to

MIN_SCATTER = SMALL  # relative, of the lamps' nearness: no frame for lamps is rounder

Vector = Float[np.ndarray, "3"]
Vectors = Float[np.ndarray, "lamps 3"]
Numbers = Float[np.ndarray, " lamps"]

MIN_LAMPS = 4  # lamps that determine the direction from ball to ball with something left over
MAX_TURNED = 30.0  # degrees, above which the error of the direction from ball to ball leaves all distances open


class LampPlaces(NamedTuple):
    """Lamps around a place, in the camera's axes: right, up, backward."""

    directions: Vectors
    """Unit vectors from the place."""
    errors: Numbers
    """Root mean square error of each direction, degrees."""
    nearness: Numbers
    """1 / distance, per length unit."""
    nearness_errors: Numbers
    baseline: Vector
    """Unit vector from the first ball to the second."""
    baseline_error: float
    """Degrees; 0 where it was known."""

    @property
    def near(self) -> Bool[np.ndarray, " lamps"]:
        """Whether a lamp's distance is known, rather than that it is far away."""
        return (self.nearness > GAUSS_95 * self.nearness_errors) & (self.baseline_error < MAX_TURNED)

    def seen_from(self, place: Vector) -> LampPlaces:
        """Return the same lamps around another place."""
        towards = self.directions - self.nearness[:, None] * place
        length = np.linalg.norm(towards, axis=-1)
        moved = np.rad2deg(self.nearness_errors * np.linalg.norm(np.cross(self.directions, place), axis=-1))
        return self._replace(
            directions=towards / length[:, None],
            errors=np.hypot(self.errors, moved),
            nearness=self.nearness / length,
            nearness_errors=self.nearness_errors / length,
        )


def find_lamps(
    directions: Float[np.ndarray, "2 lamps 3"],
    errors: Float[np.ndarray, "2 lamps"],
    radius: float,
    baseline: Vector | None = None,
) -> LampPlaces:
    """Return the lamps around the middle between two balls; lengths in units of the distance between the balls.

    The lamps' nearness is taken to scatter about its mean by what the highlights show, and by MIN_SCATTER at least, so
    that a lamp whose highlights say little of it is as near as the others (a hierarchical model; DerSimonian and Laird
    1986).

    Args:
        directions: Unit vectors to the lamps from their highlights on each ball, in the camera's axes.
        errors: Root mean square error of each, degrees.
        radius: Of both balls.
        baseline: Unit vector from the first ball to the second, where it is known.
    """
    problem = _Problem(directions, np.deg2rad(errors) / np.sqrt(2.0), radius, baseline)
    found = min((problem.solve(start) for start in problem.starts()), key=lambda solution: solution.cost)
    if baseline is None and np.sum(found.x[problem.of_nearness]) < 0.0:  # the same, with the balls exchanged
        found = problem.solve(problem.mirrored(found.x))
    spare = max(directions.shape[1] - (2 if baseline is None else 0), 1)
    problem.sigma = problem.sigma * max(np.sqrt(2.0 * found.cost / spare), 1.0)
    found = problem.solve(found.x)
    w, error = found.x[problem.of_nearness], np.sqrt(np.diag(_inverse(found.jac))[problem.of_nearness])
    mean, scatter, of_mean = _scatter(w, error)
    problem.prior = mean, scatter
    found = problem.solve(found.x)
    variance = np.diag(_inverse(found.jac))
    b, m, w = problem.parts(found.x)
    turned = variance[problem.of_directions].reshape(-1, 2).sum(-1)
    own = variance[problem.of_nearness]
    tilted = 0.0 if baseline is not None else float(variance[:2].sum())
    return LampPlaces(
        m,
        np.rad2deg(np.sqrt(turned)),
        np.maximum(w, 0.0),
        np.sqrt(own + (own / scatter**2 * of_mean) ** 2),  # as far as a lamp is the mean, it has the error of that
        b,
        float(np.rad2deg(np.sqrt(tilted))),
    )


class _Problem:
    """The residuals of both balls' highlights, in errors."""

    def __init__(self, l: np.ndarray, sigma: np.ndarray, radius: float, baseline: Vector | None):
        self.l, self.sigma, self.known = l, sigma, baseline
        half = l + np.array([0.0, 0.0, 1.0])  # the viewer is backward
        self.on_ball = radius * half / np.linalg.norm(half, axis=-1, keepdims=True)
        mean = l.sum(0)
        self.mean = mean / np.linalg.norm(mean, axis=-1, keepdims=True)
        self.across, self.across_mean = tangents_to(l), tangents_to(self.mean)
        self.prior: tuple[float, float] | None = None
        before, lamps = 0 if baseline is not None else 2, l.shape[1]
        self.of_directions = slice(before, before + 2 * lamps)
        self.of_nearness = slice(before + 2 * lamps, before + 3 * lamps)
        self.frame = np.eye(3)

    def starts(self) -> list[np.ndarray]:
        """Return where to start: with the baseline along the mean shift of the highlights, or turned from it."""
        lamps = self.l.shape[1]
        shift = self.l[0] - self.l[1]
        typical = float(np.linalg.norm(shift, axis=-1).mean())
        rest = np.concatenate([np.zeros(2 * lamps), np.full(lamps, typical)])
        if self.known is not None:
            return [rest]
        along = shift.mean(0)
        self.frame = _frame(along)
        return [np.concatenate([tilt, rest]) for tilt in ((0.0, 0.0), (0.7, 0.0), (-0.7, 0.0), (0.0, 0.7), (0.0, -0.7))]

    def mirrored(self, x: np.ndarray) -> np.ndarray:
        """Return the solution with the baseline turned round, and the nearness of the other sign."""
        self.frame = _frame(-self.parts(x)[0])
        return np.concatenate([np.zeros(2), x[self.of_directions], -x[self.of_nearness]])

    def parts(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the baseline, the directions from the middle, and the nearness."""
        b = self.known
        if b is None:
            b = self.frame[0] + x[:2] @ self.frame[1:]
            b = b / np.linalg.norm(b)
        m = self.mean + np.einsum("la,lai->li", x[self.of_directions].reshape(-1, 2), self.across_mean)
        return b, m / np.linalg.norm(m, axis=-1, keepdims=True), x[self.of_nearness]

    def residuals(self, x: np.ndarray) -> np.ndarray:
        b, m, w = self.parts(x)
        p = self.on_ball + np.array([-0.5, 0.5])[:, None, None] * b
        towards = m - w[:, None] * p
        towards = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
        off = np.einsum("klai,kli->kla", self.across, towards) / self.sigma[..., None]
        if self.prior is None:
            return off.ravel()
        mean, scatter = self.prior
        return np.concatenate([off.ravel(), (w - mean) / scatter])

    def solve(self, start: np.ndarray):
        return least_squares(self.residuals, start, method="lm", x_scale="jac")


def _frame(along: Vector) -> Float[np.ndarray, "3 3"]:
    along = along / np.linalg.norm(along) if np.any(along) else np.array([1.0, 0.0, 0.0])
    return np.concatenate([along[None], tangents_to(along)])


def _inverse(jacobian: np.ndarray) -> np.ndarray:
    return np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)


def _scatter(w: Numbers, error: Numbers) -> tuple[float, float, float]:
    """Return mean and scatter of numbers with errors, by the method of moments, and the error of the mean."""
    weight = 1.0 / error**2
    mean = float(weight @ w / weight.sum())
    excess = float(weight @ (w - mean) ** 2) - (len(w) - 1)
    scatter2 = max(excess, 0.0) / float(weight.sum() - (weight**2).sum() / weight.sum())
    weight = 1.0 / (error**2 + scatter2)
    mean = float(weight @ w / weight.sum())
    return mean, float(max(np.sqrt(scatter2), MIN_SCATTER * abs(mean), 1e-9)), float(weight.sum() ** -0.5)
