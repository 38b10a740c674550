"""Outcome: the fitted numbers, their errors, and in words what is not known about them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Bool, Float

from ..core.backend import in_float64
from ..core.fields import parameter_of
from ..core.words import count, listing
from ..model.materials import Material
from ..model.patterns import Chequer
from ..model.scenes import Scene
from .data.samples import Counts, find_samples
from .data.views import View, has_mask, photograph, repeated, setups
from .forward.losses import Likelihood, variance
from .forward.rounding import Rounding, no_rounding
from .problem import LaidOutProblem
from .solve.solvers import Minimum
from .statistics.clusters import Clusters, compared, independent
from .statistics.identifiability import (
    condition_number,
    null_directions,
    singular_sentences,
    vague,
    vague_sentences,
    weak_directions,
    weak_sentences,
)
from .statistics.intensities import taken_as_exact
from .statistics.uncertainty import Evidence
from .unknowns.names import everything as everything_in
from .unknowns.slots import put_back, values_in
from .unknowns.unknown import Unknown, coordinate_slopes, unit_vectors, values_at

MEMORY = 4e9  # bytes that the pixels of a fit may take laid out


@dataclass(frozen=True, eq=False)
class Fit:
    """The outcome of a fit; `print` it for the table. Every array is NumPy float64, one entry an unknown."""

    scene: Scene
    """The scene with the fitted values; what is not `determined` is one of many that fit as well."""
    views: tuple[View, ...]
    """The views, with the fitted exposures and blacks."""
    unknowns: tuple[Unknown, ...]
    values: Float[np.ndarray, " p"]
    errors: Float[np.ndarray, " p"]
    """Standard errors: the truth lies within 1.96 of them 95 % of the time; infinite where nothing is determined. They
    are for independent noise where the views agree within it, else by leaving out one view at a time, widened by
    Student's t (`clusters`); where the images are rounded to steps larger than their noise, with what that adds
    (`rounding`)."""
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
    costs: Float[np.ndarray, " passes"]
    """The cost at the start of the last minimisation, and the lowest after each of its passes."""
    likelihood: Likelihood
    """The loss, and the scale of the residuals that it was used with."""
    clipped: str
    """What clipped samples say, as given to the fit."""
    squares: float
    """Sum of squares of the samples, weighted: what a residual is small or large against."""
    clusters: Clusters
    """The Gram of each view, whether the views agree, and the errors that follow."""
    scales: Float[np.ndarray, " p"]
    """What each number may be small against, such as the largest reflection of its object; 0 where nothing is."""
    notes: tuple[str, ...]
    """What these views cannot tell, what stands at a bound, what was left out: a sentence each."""
    rounding: Rounding
    """The steps of the views' files where their rounding adds to the errors, else none."""
    memory: float | int = MEMORY
    """Bytes that the pixels may take laid out, as given to the fit."""

    @property
    def evidence(self) -> Evidence:
        """The Gram of each view: what errors, plans and examinations are made of."""
        return self.clusters.evidence

    @property
    def names(self) -> tuple[str, ...]:
        """A short name of each unknown; a colour's channels end in .r, .g, .b."""
        return tuple(unknown.name for unknown in self.unknowns)

    @property
    def material(self) -> Material:
        """The fitted material of the scene's only object; ValueError where there are several."""
        if len(self.scene.objects) != 1:
            raise ValueError(
                f"this scene has {len(self.scene.objects)} objects, so which material is meant is not known. "
                "Use fit.scene.objects[i].material."
            )
        return self.scene.objects[0].material

    @property
    def correlation(self) -> Float[np.ndarray, "p p"]:
        """Correlations of the unknowns, from the plain covariance; 0 where there is none."""
        errors = np.sqrt(np.diag(self.covariance))
        unit = np.where(errors > 0, 1.0 / np.where(errors > 0, errors, 1.0), 0.0)
        return self.covariance * np.outer(unit, unit)

    def values_in(self, scene: Scene) -> Float[np.ndarray, " p"]:
        """Return what the unknowns are in another scene of the same structure, such as the truth of a test."""
        return values_in(scene, self.views, self.unknowns)

    def predict(self, view: View) -> Prediction:
        """Return what a view's photograph would be by this fit, beside what it is; any view, fitted or held out."""
        moving = any("surface" in path.split(".") for unknown in self.unknowns for path, _ in unknown.places)
        with in_float64((self.scene, view)) as (scene, view):
            samples = find_samples(scene, view, moving=moving and has_mask(view))
            image = photograph(scene, view)
        counts = np.zeros(image.shape, bool)
        counts.reshape(-1, image.shape[2])[samples.pixels] = samples.ends() == 0
        return Prediction(samples.whole(), image, counts)

    def what_errors_hold(self, clusters: Clusters) -> str:
        """Say what the errors of these clusters are made of, and what is taken as exact."""
        made = clusters.sentence([unknown.quantity for unknown in self.unknowns])
        return f"{made} {taken_as_exact(self.unknowns, len(self.scene.lights), len(self.views))}".rstrip()

    def __str__(self) -> str:
        """Return the table of parameters, and below it the notes."""
        width = max(len("parameter"), *map(len, self.names))
        counts = self.counts
        lines = [
            f"fit of {count(counts.views, 'view')}, {counts.pixels:,} pixels, {counts.samples:,} samples",
            f"{'parameter':<{width}} {'value':>12} {'error':>11}",
        ]
        for j, name in enumerate(self.names):
            if not self.determined[j]:
                lines.append(f"{name:<{width}} {'not determined':>12}")
                continue
            side = "+" if self.at_lower[j] else "-" if self.at_bound[j] else ""  # at a bound, the only way to err
            flag = "  at a bound" if side else ""
            lines.append(f"{name:<{width}} {self.values[j]:>12.6g} {f'{side}{self.errors[j]:.2g}':>11}{flag}")
        lines.append(f"errors: {self.what_errors_hold(self.clusters)}")
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


def diagnose(laid: LaidOutProblem, end: Minimum, *, forecast: bool = False) -> Fit:
    """Say what is known at the end of a fit: values, errors, bounds, what is not determined.

    `forecast` says that nothing was measured, so that no view disagrees with another.
    """
    problem = laid.problem
    scene, views, unknowns, counts = problem.scene, problem.views, problem.unknowns, problem.counts
    likelihood, squares, beside, spread = problem.model.likelihood, laid.squares, laid.prior_gram(end), laid.spread(end)
    rounded = laid.rounded(end, spread)
    theta = end.theta
    if not (np.isfinite(theta).all() and np.isfinite(end.point.total.cost)):
        raise FloatingPointError(
            f"the fit met a number that is not finite at {', '.join(f'{t:g}' for t in theta)}. Check the scene for "
            "extreme values."
        )
    lower, upper = (np.array([getattr(u, name) for u in unknowns]) for name in ("lower", "upper"))
    values = values_at(theta, unknowns)
    for bound in (lower, upper):  # right at the bound, not a rounding beside it
        values = np.where(np.isclose(values, bound, rtol=1e-12, atol=0.0), bound, values)
    at_bound = (values <= lower) | (values >= upper)
    at_lower = values <= lower
    units = np.array(unit_vectors(unknowns), int).reshape(-1, 3)
    for unit in units:
        values[unit] /= np.linalg.norm(values[unit])
    slope = coordinate_slopes(values, unknowns)  # what follows is in the unknowns' own units
    H, g = np.asarray(end.point.views.hessian) * np.outer(slope, slope), np.asarray(end.point.views.gradient) * slope
    H_0, g_0 = np.asarray(beside.hessian) * np.outer(slope, slope), np.asarray(beside.gradient) * slope
    everything = H.sum(0) + H_0
    zero, directions = null_directions(everything)
    regular = ~zero & ~directions.any(0)
    noisy = views[0].noise is not None
    sigma2 = 1.0 if noisy and likelihood.loss == "squares" else variance(spread, int(np.sum(~at_bound)))
    groups = [group for group in setups(scene, views) if H[group].any()] or [[*range(len(views))]]
    H, g = (np.array([of[group].sum(0) for group in groups]) for of in (H, g))
    evidence = Evidence(H, g, H_0, g_0, values, at_bound, regular, units, sigma2, spread)
    if rounded is not None:
        waves = slope[:, None] * rounded.waves
        waves = np.array([waves[group].sum(0) for group in groups])
        evidence = dataclasses.replace(evidence, waves=waves, shared=rounded.shared, steps=str(rounded.rounding))
    fitted, seen = put_back(scene, views, unknowns, values)
    scales = _scales(fitted, seen, unknowns, np.diag(everything), squares)
    # what is at a bound and lost there may be elsewhere: then the others' errors are not those of it held
    held = ~(at_bound & vague(unknowns, values, evidence.plain_errors(), scales)[0])
    evidence = dataclasses.replace(evidence, at_bound=at_bound & held)
    plain_errors = evidence.plain_errors()
    clusters = (
        independent(evidence, _views(groups, counts))
        if forecast or len(groups) < 2
        else compared(evidence, len(groups), _views(groups, counts))
    )
    errors = plain_errors if forecast else clusters.wide_errors()
    lost, small = (mask & regular for mask in vague(unknowns, values, errors, scales))
    free = ~evidence.at_bound
    known = free & regular
    covariance = np.zeros_like(everything)
    covariance[np.ix_(known, known)] = evidence.covariance(free)[np.ix_(known[free], known[free])]
    weak = weak_directions(everything[np.ix_(known, known)])
    notes = [
        *(
            [f"the fit did not converge in {end.steps} steps: {end.message}. Fix or bound an unknown."]
            if end.message
            else []
        ),
        *singular_sentences(zero, directions, unknowns, values),
        *weak_sentences([np.flatnonzero(known)[which] for which in weak], unknowns),
        *vague_sentences(lost, small & ~at_bound, unknowns, values, errors, scales),
        *([] if forecast else _at_bounds(unknowns, regular & ~lost, at_bound, at_lower)),
        *_too_bright(unknowns, values, regular & ~lost),
        *([] if forecast else repeated(scene, views)),
        *_ends(counts),
        *(_beyond_noise(float(np.sqrt(spread[1] / spread[0]))) if noisy and likelihood.loss == "squares" else []),
        *_jumps(scene, unknowns),
    ]
    return Fit(
        scene=fitted,
        views=seen,
        unknowns=tuple(unknowns),
        values=values,
        errors=errors,
        plain_errors=plain_errors,
        covariance=covariance,
        determined=regular & ~lost,
        at_bound=at_bound,
        at_lower=at_lower,
        rmse=float(np.sqrt(spread[1] / spread[0])),
        condition=condition_number(everything),
        counts=counts,
        steps=end.steps,
        converged=not end.message,
        costs=np.array(end.costs),
        likelihood=jax.tree.map(np.asarray, likelihood),
        clipped=problem.clipped,
        squares=squares,
        clusters=clusters,
        scales=scales,
        notes=tuple(notes),
        rounding=no_rounding(len(views)) if rounded is None else rounded.rounding,
    )


def _views(groups: Sequence[Sequence[int]], counts: Counts) -> str:
    """Name the clusters of a fit: views, or the ways in which they were taken."""
    views = count(counts.views, "view")
    return views if len(groups) == counts.views else f"{views}, taken in {count(len(groups), 'way')},"


def _scales(
    scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown], curvature: np.ndarray, squares: float
) -> np.ndarray:
    """Return what a number may be small against; 0 where nothing is.

    Of a reflection, the largest of its object; of what fades light, what would change the image by a sixth; of a
    transmission 1; of a coordinate, how far the objects reach: where the origin is says nothing.
    """
    extent = max(item.surface.extent() for item in scene.objects)
    reflections = {
        path: float(np.max(value))
        for path, value, spec in everything_in(scene, views)
        if np.size(value) and parameter_of(spec).role == "reflection"
    }
    scales = np.zeros(len(unknowns))
    for j, unknown in enumerate(unknowns):
        role = unknown.parameter.role
        if role == "reflection" and unknown.places:
            material = unknown.places[0][0].rpartition(".")[0]
            scales[j] = max(value for path, value in reflections.items() if path.rpartition(".")[0] == material)
        elif role == "attenuation" and unknown.kind != "constant" and curvature[j] > 0:
            scales[j] = np.sqrt(squares / curvature[j]) / 6.0
        elif role == "transmission":
            scales[j] = 1.0
        elif role == "position":
            scales[j] = extent
    return scales


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
        return [f"{count(counts.left_out, 'sample')} at an end of the sensor's range left out, with their pixels."]
    if counts.clipped:
        return [f"{count(counts.clipped, 'sample')} at an end of the sensor's range, taken to be that or beyond."]
    return []


def _beyond_noise(rmse: float) -> list[str]:
    """Say that the residuals are more than the noise that was given, from which the errors follow."""
    if rmse <= 1.5:
        return []
    wrong = "the model, or the minimum found, is wrong, or the noise is more than that"
    return [f"the residuals are {rmse:.3g} times the noise given: {wrong}."]


def _at_bounds(unknowns: Sequence[Unknown], known: np.ndarray, at_bound: np.ndarray, at_lower: np.ndarray) -> list[str]:
    """Say which values stand at a bound."""
    said = []
    for side, there in (("lower", at_lower), ("upper", at_bound & ~at_lower)):
        bound = np.array([getattr(u, side) for u in unknowns])
        for value in np.unique(bound[there & known]):
            names = [u.name for u, at in zip(unknowns, there & known & (bound == value), strict=True) if at]
            verb = "is at its" if len(names) == 1 else "are at their"
            said.append(f"{listing(names)} {verb} {side} bound {value:g}.")
    return said


def _too_bright(unknowns: Sequence[Unknown], values: np.ndarray, known: np.ndarray) -> list[str]:
    """Say where more light leaves than a surface can reflect."""
    bright = [u.name for u, above in zip(unknowns, known & (values > 1.0), strict=True) if above and _is(u, "k_d")]
    if not bright:
        return []
    verb = "is" if len(bright) == 1 else "are"
    return [f"{listing(bright)} {verb} above 1: more light leaves than arrives. Check intensities and exposure."]


def _is(unknown: Unknown, quantity: str) -> bool:
    return unknown.kind == quantity and "/" not in unknown.quantity
