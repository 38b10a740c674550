"""Outcome: the fitted numbers, their errors, and in words what is not known about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Bool, Float

from ..materials import Material
from ..patterns import Chequer
from ..rendering import render
from ..scenes import Scene
from .gram import Gram
from .losses import Likelihood, variance
from .parameters import Unknown, put_back, unit_vectors, values_in
from .residuals import Counts
from .solvers import Minimum
from .uncertainty import (
    condition_number,
    deciding_view,
    jackknife_covariance,
    listing,
    lone_views,
    null_directions,
    on_unit_vectors,
    plain_covariance,
    sentences,
    standard_errors,
    without_lone,
)
from .views import View, find_samples, is_grey


@dataclass(frozen=True, eq=False)
class Fit:
    """The outcome of a fit; `print` it for the table. Every array is NumPy float64, one entry an unknown."""

    scene: Scene
    """The scene with the fitted values; what is not `determined` is one of many that fit as well."""
    views: tuple[View, ...]
    """The views, with the fitted exposures and blacks."""
    unknowns: tuple[Unknown, ...]
    values: Float[np.ndarray, " p"]
    errors: Float[np.ndarray, " p"] | None
    """Standard errors by delete-one-view jackknife, to be used with t of views - 1 degrees of freedom; of what one view
    alone shows, such as its exposure, the plain ones (a note says so); infinite where nothing is determined; None with
    fewer than three views, or where the others determine less without one of them."""
    plain_errors: Float[np.ndarray, " p"]
    """Standard errors sigma^2 (J^T J)^-1 for independent noise, of equal size or as the views' `Noise` says; too small
    on real photographs, whose residuals are correlated. Infinite where nothing is determined."""
    covariance: Float[np.ndarray, "p p"]
    """The plain covariance of the determined unknowns that are not at a bound; 0 elsewhere."""
    determined: Bool[np.ndarray, " p"]
    at_bound: Bool[np.ndarray, " p"]
    at_lower: Bool[np.ndarray, " p"]
    """At the lower of its bounds; an error at a bound is one-sided, into the range."""
    rmse: float
    """Root mean square residual of the samples that were measured, in the images' units; where the noise of the views
    is given, in units of that noise: 1 is as it should be."""
    condition: float
    """Condition number of the Jacobian with columns of unit length; infinite where it is singular."""
    counts: Counts
    steps: int
    """Passes over all pixels of the last minimisation; the search and the settling of a scale come before."""
    converged: bool
    likelihood: Likelihood
    """The loss, and the scale of the residuals that it was used with."""
    clipped: str
    """What clipped samples say, as given to the fit."""
    squares: float
    """Sum of squares of the samples, weighted: what a residual is small or large against."""
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
        return values_in(scene, self.views, self.unknowns)

    def predict(self, view: View) -> Prediction:
        """Return what a view's photograph would be by this fit, beside what it is; any view, fitted or held out."""
        moving = any("surface" in path.split(".") for unknown in self.unknowns for path, _ in unknown.places)
        with jax.enable_x64(True):
            samples = find_samples(self.scene, view, moving=moving and _has_mask(view))
            image = float(view.exposure) * np.asarray(render(self.scene, view.camera, lit=view.lit)) + float(view.black)
        if is_grey(view):
            image = image.mean(-1, keepdims=True)
        counts = np.zeros(image.shape, bool)
        counts.reshape(-1, image.shape[2])[samples.pixels] = samples.ends() == 0
        return Prediction(samples.photograph, image, counts)

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
            side = "+" if self.at_lower[j] else "-" if self.at_bound[j] else ""  # at a bound, the only way to err
            error = "-" if self.errors is None else f"{side}{self.errors[j]:.2g}"
            flag = "  at a bound" if side else ""
            plain = f"{side}{self.plain_errors[j]:.2g}"
            lines.append(f"{name:<{width}} {self.values[j]:>12.6g} {error:>11} {plain:>11}{flag}")
        lines.append(f"RMSE {self.rmse:.4g}   steps {self.steps}   condition number {self.condition:.3g}")
        return "\n".join([*lines, *(f"- {note}" for note in self.notes)])


@dataclass(frozen=True, eq=False)
class Prediction:
    """A photograph and what a fit says it should be: exposure * radiance + black, unclipped, in its channels."""

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
    likelihood: Likelihood,
    clipped: str,
    end: Minimum,
    beside: Gram,
    spread: Float[np.ndarray, "5"],
    counts: Counts,
    squares: float,
) -> Fit:
    """Say what is known at the end of a fit: values, errors, bounds, what is not determined.

    `beside` is the Gram of what is known beside the views, `spread` the sums of `Likelihood.spread`, `squares` the sum
    of squares of the images.
    """
    theta = end.theta
    if not (np.isfinite(theta).all() and np.isfinite(end.point.total.cost)):
        raise FloatingPointError(
            f"the fit met a number that is not finite at {', '.join(f'{t:g}' for t in theta)}. Check the scene for "
            "extreme values."
        )
    lower, upper = (np.array([getattr(u, name) for u in unknowns]) for name in ("lower", "upper"))
    log = np.array([u.logarithmic for u in unknowns])
    values = np.where(log, np.exp(np.where(log, theta, 0.0)), theta)
    for bound in (lower, upper):  # right at the bound, not a rounding beside it
        values = np.where(np.isclose(values, bound, rtol=1e-12, atol=0.0), bound, values)
    at_bound = (values <= lower) | (values >= upper)
    at_lower = values <= lower
    units = np.array(unit_vectors(unknowns), int).reshape(-1, 3)
    for unit in units:
        values[unit] /= np.linalg.norm(values[unit])
    # in the unknowns' own units: d/dn_s = (1/n_s) d/d log n_s
    slope = np.where(log, 1.0 / np.where(log, values, 1.0), 1.0)
    H, g = np.asarray(end.point.views.hessian) * np.outer(slope, slope), np.asarray(end.point.views.gradient) * slope
    H_0, g_0 = np.asarray(beside.hessian) * np.outer(slope, slope), np.asarray(beside.gradient) * slope
    everything = H.sum(0) + H_0
    zero, directions = null_directions(everything)
    determined = ~zero & ~directions.any(0)
    noisy = views[0].noise is not None
    sigma2 = 1.0 if noisy and likelihood.loss == "squares" else variance(spread, int(np.sum(~at_bound)))

    # H has the weights rho' of a robust loss where a view's move is by its slopes psi', the same only for squares
    stiffness = float(spread[4] / max(spread[3], 1e-3 * spread[0]))

    def spread_of(covariance: np.ndarray, which: np.ndarray) -> np.ndarray:
        whole = np.zeros_like(everything)
        whole[np.ix_(which, which)] = covariance
        return on_unit_vectors(whole, values, units)[np.ix_(which, which)]

    def plain(which: np.ndarray) -> np.ndarray:
        return spread_of(plain_covariance(everything[np.ix_(which, which)], sigma2), which)

    def clustered(which: np.ndarray) -> np.ndarray:
        covariance = plain(which)  # for what one view alone sees: there is no deleting that
        shared = lone[which] < 0
        reduced = without_lone(H[:, which][:, :, which], g[:, which], H_0[np.ix_(which, which)], lone[which])
        kept = which & (lone < 0)
        jackknife = jackknife_covariance(*reduced, H_0[np.ix_(kept, kept)], g_0[kept])
        covariance[np.ix_(shared, shared)] = stiffness**2 * spread_of(jackknife, kept)
        return covariance

    lone = np.where(determined, lone_views(H), -1) if counts.views > 1 else np.full(len(values), -1)
    plain_errors = np.where(determined, standard_errors(plain, at_bound), np.inf)
    errors, why_not = None, None
    if counts.views < 3:
        why_not = f"{_count(counts.views, 'view')}: no errors by jackknife, which needs three or more"
    elif (deciding := deciding_view(without_lone(H, g, H_0, lone)[0], H_0[np.ix_(lone < 0, lone < 0)])) is not None:
        why_not = f"no errors by jackknife: without views[{deciding}] the others determine less"
    else:
        errors = np.where(determined, standard_errors(clustered, at_bound), np.inf)
        if (lone >= 0).any():
            names = dict.fromkeys(u.quantity for u, alone in zip(unknowns, lone >= 0, strict=True) if alone)
            why_not = f"one view alone shows each of {listing(list(names))}, so that there is no jackknife of them"
    known = ~at_bound & determined
    covariance = np.zeros_like(everything)
    covariance[np.ix_(known, known)] = plain(~at_bound)[np.ix_(known[~at_bound], known[~at_bound])]
    notes = [
        *(
            [f"the fit did not converge in {end.steps} steps: {end.message}. Fix or bound an unknown."]
            if end.message
            else []
        ),
        *sentences(zero, directions, unknowns, values),
        *_warnings(unknowns, values, plain_errors if errors is None else errors, determined, at_bound, at_lower),
        *([f"{why_not}; the plain errors are right for independent noise only."] if why_not else []),
        *_ends(counts),
        *(_beyond_noise(float(np.sqrt(spread[1] / spread[0]))) if noisy and likelihood.loss == "squares" else []),
        *_jumps(scene, unknowns),
    ]
    fitted, seen = put_back(scene, views, unknowns, values)
    return Fit(
        scene=fitted,
        views=seen,
        unknowns=tuple(unknowns),
        values=values,
        errors=errors,
        plain_errors=plain_errors,
        covariance=covariance,
        determined=determined,
        at_bound=at_bound,
        at_lower=at_lower,
        rmse=float(np.sqrt(spread[1] / spread[0])),
        condition=condition_number(everything),
        counts=counts,
        steps=end.steps,
        converged=not end.message,
        likelihood=jax.tree.map(np.asarray, likelihood),
        clipped=clipped,
        squares=squares,
        notes=tuple(notes),
    )


def _jumps(scene: Scene, unknowns: Sequence[Unknown]) -> list[str]:
    """Say which unknowns move hard squares over the pixels: a jump, of which a derivative sees nothing."""
    hard = [p for item in scene.objects for p in item.material.patterns if isinstance(p, Chequer) and not p.smooth]
    movers = {u.quantity: None for u in unknowns for path, _ in u.places if _moves_points(path)}
    if not (hard and movers):
        return []
    names = listing(list(movers))
    return [f"hard squares of a Chequer jump with {names}, of which a fit sees nothing. Give the Chequer smooth=True."]


def _moves_points(path: str) -> bool:
    segments = path.split(".")
    return "surface" in segments or segments[-1] in ("eta", "period", "u", "v")


def _ends(counts: Counts) -> list[str]:
    """Say what became of samples at an end of the sensor's range."""
    if counts.left_out:
        return [f"{_count(counts.left_out, 'sample')} at an end of the sensor's range left out, with their pixels."]
    if counts.clipped:
        return [f"{_count(counts.clipped, 'sample')} at an end of the sensor's range, taken to be that or beyond."]
    return []


def _beyond_noise(rmse: float) -> list[str]:
    """Say that the residuals are more than the noise that was given, from which the errors follow."""
    if rmse <= 1.5:
        return []
    wrong = "the model, or the minimum found, is wrong, or the noise is more than that"
    return [f"the residuals are {rmse:.3g} times the noise given: {wrong}."]


def _has_mask(view: View) -> bool:
    return view.mask is not None or view.image.shape[2] in (2, 4)


def _warnings(
    unknowns: Sequence[Unknown],
    values: np.ndarray,
    errors: np.ndarray,
    determined: np.ndarray,
    at_bound: np.ndarray,
    at_lower: np.ndarray,
) -> list[str]:
    """Say which values stand at a bound, are mostly error, or are more than a surface can reflect."""
    said = []
    for side, there in (("lower", at_lower), ("upper", at_bound & ~at_lower)):
        bound = np.array([getattr(u, side) for u in unknowns])
        for value in np.unique(bound[there & determined]):
            names = [u.name for u, at in zip(unknowns, there & determined & (bound == value), strict=True) if at]
            verb = "is at its" if len(names) == 1 else "are at their"
            said.append(f"{listing(names)} {verb} {side} bound {value:g}.")
    for unknown, value, error, inside in zip(unknowns, values, errors, determined & ~at_bound, strict=True):
        if inside and np.isfinite(unknown.lower) and error > 0.3 * abs(value):
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
    return unknown.kind == quantity and "/" not in unknown.quantity


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
