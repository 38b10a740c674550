"""Outcome: the fitted numbers, their errors, and in words what is not known about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Bool, Float

from ..materials import Material
from ..rendering import render
from ..scenes import Scene
from .parameters import Unknown, put_back, values_in
from .residuals import Counts
from .solvers import Gram
from .uncertainty import (
    condition_number,
    deciding_view,
    jackknife_covariance,
    listing,
    null_directions,
    plain_covariance,
    sentences,
    standard_errors,
)
from .views import View, find_samples, is_grey


@dataclass(frozen=True, eq=False)
class Fit:
    """The outcome of a fit; `print` it for the table. Every array is NumPy float64, one entry an unknown."""

    scene: Scene
    """The scene with the fitted values; what is not `determined` is one of many that fit as well."""
    views: tuple[View, ...]
    unknowns: tuple[Unknown, ...]
    values: Float[np.ndarray, " p"]
    errors: Float[np.ndarray, " p"] | None
    """Standard errors by delete-one-view jackknife, to be used with t of views - 1 degrees of freedom; infinite where
    nothing is determined; None with fewer than three views."""
    plain_errors: Float[np.ndarray, " p"]
    """Standard errors sigma^2 (J^T J)^-1 for independent noise of equal size; too small on real photographs, whose
    residuals are correlated. Infinite where nothing is determined."""
    covariance: Float[np.ndarray, "p p"]
    """The plain covariance of the determined unknowns that are not at a bound; 0 elsewhere."""
    determined: Bool[np.ndarray, " p"]
    at_bound: Bool[np.ndarray, " p"]
    rmse: float
    """Root mean square residual, in the images' units."""
    condition: float
    """Condition number of the Jacobian with columns of unit length; infinite where it is singular."""
    counts: Counts
    steps: int
    converged: bool
    notes: tuple[str, ...]
    """What these views cannot tell, what stands at a bound, what was left out: a sentence each."""

    @property
    def names(self) -> tuple[str, ...]:
        """A short name of each unknown; a colour's channels end in .r, .g, .b."""
        return tuple(unknown.name for unknown in self.unknowns)

    @property
    def material(self) -> Material:
        """The fitted material of the scene's only object."""
        if len(self.scene.objects) != 1:
            raise ValueError(
                f"this scene has {len(self.scene.objects)} objects, so which material is meant is not known. "
                "Use fit.scene.objects[i].material."
            )
        return self.scene.objects[0].material

    def values_in(self, scene: Scene) -> Float[np.ndarray, " p"]:
        """Return what the unknowns are in another scene of the same structure, such as the truth of a test."""
        return values_in(scene, self.unknowns)

    def predict(self, view: View) -> Prediction:
        """Return what a view's photograph would be by this fit, beside what it is; any view, fitted or held out."""
        samples = find_samples(self.scene, view)
        with jax.enable_x64(True):
            image = float(view.exposure) * np.asarray(render(self.scene, view.camera, lit=view.lit))
        if is_grey(view):
            image = image.mean(-1, keepdims=True)
        return Prediction(samples.values, image, samples.counts)

    def __str__(self) -> str:
        """Return the table of parameters, and below it the notes."""
        width = max(len("parameter"), *map(len, self.names))
        counts = self.counts
        lines = [
            f"fit of {_count(counts.views, 'view')}, {counts.pixels:,} pixels, {counts.samples:,} samples",
            f"{'parameter':<{width}} {'value':>12} {'error':>11} {'plain error':>11}",
        ]
        for j, name in enumerate(self.names):
            if not self.determined[j]:
                lines.append(f"{name:<{width}} {'not determined':>12}")
                continue
            error = "-" if self.errors is None else f"{self.errors[j]:.2g}"
            flag = "  at a bound" if self.at_bound[j] else ""
            lines.append(f"{name:<{width}} {self.values[j]:>12.6g} {error:>11} {self.plain_errors[j]:>11.2g}{flag}")
        lines.append(f"RMSE {self.rmse:.4g}   steps {self.steps}   condition number {self.condition:.3g}")
        return "\n".join([*lines, *(f"- {note}" for note in self.notes)])


@dataclass(frozen=True, eq=False)
class Prediction:
    """A photograph and what a fit says it should be: exposure * radiance, unclipped, in the photograph's channels."""

    target: Float[np.ndarray, "h w c"]
    image: Float[np.ndarray, "h w c"]
    counts: Bool[np.ndarray, "h w c"]
    """Samples that count: on the object, inside the mask, not clipped."""

    @property
    def difference(self) -> Float[np.ndarray, "h w c"]:
        """image - target where it counts, else 0."""
        return np.where(self.counts, self.image - np.where(self.counts, self.target, 0.0), 0.0)

    @property
    def rmse(self) -> float:
        """Root mean square of the difference where it counts."""
        return float(np.sqrt(np.sum(self.difference**2) / self.counts.sum()))


def diagnose(
    scene: Scene,
    views: tuple[View, ...],
    unknowns: Sequence[Unknown],
    values: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    gram: Gram,
    counts: Counts,
    steps: int,
    result: str,
) -> Fit:
    """Say what is known about the values: errors, bounds, what is not determined."""
    # in the unknowns' own units: d/dn_s = (1/n_s) d/d log n_s
    unit = np.array([1.0 / value if u.logarithmic else 1.0 for u, value in zip(unknowns, values, strict=True)])
    H, g = np.asarray(gram.hessian) * np.outer(unit, unit), np.asarray(gram.gradient) * unit
    total = H.sum(0)
    at_bound = (values <= lower) | (values >= upper)
    zero, directions = null_directions(total)
    determined = ~zero & ~directions.any(0)
    squares = 2.0 * float(np.sum(gram.cost))
    sigma2 = squares / max(counts.samples - int(np.sum(~at_bound)), 1)

    def plain(which: np.ndarray) -> np.ndarray:
        return plain_covariance(total[np.ix_(which, which)], sigma2)

    def clustered(which: np.ndarray) -> np.ndarray:
        return jackknife_covariance(H[:, which][:, :, which], g[:, which])

    plain_errors = np.where(determined, standard_errors(plain, at_bound), np.inf)
    errors, why_not = None, None
    if counts.views < 3:
        why_not = f"{_count(counts.views, 'view')}: no errors by jackknife, which needs three or more"
    elif (deciding := deciding_view(H)) is not None:
        why_not = f"no errors by jackknife: without views[{deciding}] the others determine less"
    else:
        errors = np.where(determined, standard_errors(clustered, at_bound), np.inf)
    known = ~at_bound & determined
    covariance = np.zeros_like(total)
    covariance[np.ix_(known, known)] = plain(~at_bound)[np.ix_(known[~at_bound], known[~at_bound])]
    converged = result == ""
    notes = [
        *([] if converged else [f"the fit did not converge in {steps} steps: {result}"]),
        *sentences(zero, directions, unknowns, values),
        *_warnings(unknowns, values, plain_errors if errors is None else errors, determined, lower, upper),
        *([f"{why_not}; the plain errors are right for independent noise only."] if why_not else []),
        *(
            [f"{_count(counts.saturated, 'sample')} left out, at the top of the sensor's range."]
            if counts.saturated
            else []
        ),
    ]
    return Fit(
        scene=put_back(scene, unknowns, values),
        views=views,
        unknowns=tuple(unknowns),
        values=values,
        errors=errors,
        plain_errors=plain_errors,
        covariance=covariance,
        determined=determined,
        at_bound=at_bound,
        rmse=float(np.sqrt(squares / counts.samples)),
        condition=condition_number(total),
        counts=counts,
        steps=steps,
        converged=converged,
        notes=tuple(notes),
    )


def _warnings(
    unknowns: Sequence[Unknown],
    values: np.ndarray,
    errors: np.ndarray,
    determined: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> list[str]:
    """Say which values stand at a bound, are mostly error, or are more than a surface can reflect."""
    said = []
    for side, bound, there in (("lower", lower, values <= lower), ("upper", upper, values >= upper)):
        for value in np.unique(bound[there & determined]):
            names = [u.name for u, at in zip(unknowns, there & determined & (bound == value), strict=True) if at]
            verb = "is at its" if len(names) == 1 else "are at their"
            said.append(f"{listing(names)} {verb} {side} bound {value:g}.")
    for unknown, value, error, inside in zip(
        unknowns, values, errors, determined & (values > lower) & (values < upper), strict=True
    ):
        if inside and error > 0.3 * abs(value):
            share = f"{error / abs(value):.0%}" if value else "all"
            said.append(f"{unknown.name} is poorly determined: its error is {share} of its value.")
    bright = [u.name for u, above in zip(unknowns, determined & (values > 1.0), strict=True) if above and _is(u, "k_d")]
    if bright:
        verb = "is" if len(bright) == 1 else "are"
        said.append(
            f"{listing(bright)} {verb} above 1: more light leaves than arrives. Check intensities and exposure."
        )
    return said


def _is(unknown: Unknown, quantity: str) -> bool:
    return unknown.quantity.split(".")[-1] == quantity


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
