"""Summary: what is known at the minimum of a fit: values, errors, bounds, and what the views do not determine."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.fields import parameter_of
from ..core.robust_scale import OUTLIER
from ..core.thresholds import CLEARLY, NEGLIGIBLE
from ..core.words import Note, count, listing
from ..model.patterns import Chequer
from ..model.scenes import Scene
from .data.view_sets import Counts
from .forward.losses import variance
from .forward.rounding import Rounded, no_rounding
from .hidden_highlights import hidden_highlights, hidden_notes
from .laid_out import LaidOut
from .problem import FitProblem
from .result import Fit
from .solve.interchangeable import note_order
from .solve.solvers import Minimum
from .solved import Solved
from .spreads import rounded_at, spread_at
from .statistics.clusters import compared, independent
from .statistics.evidence import Evidence
from .statistics.gauges import set_by_priors
from .statistics.identifiability import (
    condition_number,
    null_directions,
    singular_notes,
    vague,
    vague_notes,
    weak_directions,
    weak_notes,
)
from .statistics.uncertainty import Matrix, Vector
from .unknowns.places import Place, everything
from .unknowns.unknown import Unknown, coordinate_slopes, unit_vectors, values_at


@dataclass(frozen=True)
class _Values:
    """The values at the minimum, in their own units, and which of them are at a bound."""

    values: Vector
    at_bound: Bool[np.ndarray, " p"]
    at_lower: Bool[np.ndarray, " p"]
    units: Int[np.ndarray, "u 3"]
    """The unknowns that are a unit vector together."""


def summarise(laid: LaidOut, end: Minimum, *, forecast: bool = False) -> Fit:
    """Return what is known at the minimum of a fit: values, errors, bounds, and what is not determined.

    Args:
        laid: The problem that was minimised.
        end: Its minimum.
        forecast: Whether nothing was measured, so that no view can disagree with another.

    Raises:
        FloatingPointError: Where a value or the cost is not finite.
    """
    problem = laid.problem
    scene, views, unknowns = problem.scene, problem.data.views, problem.unknowns
    found, spread = _values_at(end, unknowns), spread_at(end, laid)
    rounded = None if forecast else rounded_at(end, laid, spread)
    slope = coordinate_slopes(found.values, unknowns)  # what follows is in the unknowns' own units
    evidence, groups, (zero, directions) = _evidence(laid, end, found, slope, spread, rounded)
    everything, regular = evidence.total, evidence.regular
    steps = no_rounding(len(views)) if rounded is None else rounded.rounding
    solved = Solved.of(problem.with_rounding(steps), found.values, laid.squares)
    scales = _scales(solved.problem.scene, unknowns, np.diag(everything), laid.squares)
    plain_errors = evidence.plain_errors()
    unclear = vague(unknowns, found.values, plain_errors, scales)[0] | found.at_bound | ~regular
    hidden = hidden_highlights(laid, end, unclear, evidence.sigma2)
    # an unknown at a bound but lost in the noise may lie elsewhere: the others' errors must not hold it fixed
    may_move = vague(unknowns, found.values, np.maximum(plain_errors, hidden.errors), scales)[0]
    evidence = dataclasses.replace(evidence, at_bound=found.at_bound & ~may_move)
    which = _clusters_in_words(groups, problem.data.counts)
    alone = forecast or len(groups) < 2
    clusters = independent(evidence, which) if alone else compared(evidence, len(groups), which)
    plain_errors = evidence.plain_errors()
    errors = np.maximum(plain_errors if forecast else clusters.wide_errors(), hidden.errors)
    lost, small = (mask & regular for mask in vague(unknowns, found.values, errors, scales))
    known = ~evidence.at_bound & regular
    weak = weak_directions(everything[np.ix_(known, known)])
    covariance = np.where(np.outer(known, known), evidence.covariance(~evidence.at_bound), 0.0)
    rmse = float(np.sqrt(spread[1] / spread[0]))
    notes = [
        *_not_converged(end),
        *singular_notes(zero, directions, unknowns, found.values),
        *set_by_priors(_held_by_priors(laid, everything, slope), covariance, unknowns, found.values),
        *weak_notes([np.flatnonzero(known)[which] for which in weak], unknowns),
        *vague_notes(lost, small & ~found.at_bound, unknowns, found.values, errors, scales),
        *hidden_notes(hidden, lost, unknowns),
        *([] if forecast else _at_bounds(unknowns, regular & ~lost, found)),
        *_too_bright(unknowns, found.values, regular & ~lost),
        *_what_counts(problem.data.counts),
        *([] if forecast else _stated_noise(problem, spread, found.at_bound, evidence.sigma2)),
        *_jumps(scene, unknowns),
        *note_order(scene, unknowns),
    ]
    return Fit(
        solved=solved,
        values=found.values,
        errors=errors,
        plain_errors=plain_errors,
        covariance=covariance,
        determined=regular & ~lost,
        at_bound=found.at_bound,
        at_lower=found.at_lower,
        rmse=rmse,
        condition=condition_number(everything),
        steps=end.steps,
        converged=not end.message,
        costs=np.array(end.costs),
        clusters=clusters,
        scales=scales,
        notes=tuple(notes),
    )


def _values_at(end: Minimum, unknowns: Sequence[Unknown]) -> _Values:
    """Return the values at a minimum: directions as unit vectors, and values within rounding of a bound put on it."""
    theta = end.theta
    if not (np.isfinite(theta).all() and np.isfinite(end.point.total.cost)):
        raise FloatingPointError(
            f"the fit reached a value or a cost that is not finite, at {', '.join(f'{t:g}' for t in theta)}. Check the "
            "scene for extreme values."
        )
    lower, upper = (np.array([getattr(u, name) for u in unknowns]) for name in ("lower", "upper"))
    values = values_at(theta, unknowns)
    for bound in (lower, upper):
        values = np.where(np.isclose(values, bound, rtol=1e-12, atol=0.0), bound, values)
    at_bound, at_lower = (values <= lower) | (values >= upper), values <= lower
    units = np.array(unit_vectors(unknowns), int).reshape(-1, 3)
    for unit in units:
        values[unit] /= np.linalg.norm(values[unit])
    return _Values(values, at_bound, at_lower, units)


def _evidence(
    laid: LaidOut,
    end: Minimum,
    found: _Values,
    slope: Vector,
    spread: Float[np.ndarray, "5"],
    rounded: Rounded | None,
) -> tuple[Evidence, list[list[int]], tuple[Bool[np.ndarray, " p"], Float[np.ndarray, "m p"]]]:
    """Return the evidence for the errors, in the unknowns' own units, the views by cluster, and what is singular."""
    problem, point, prior, p = laid.problem, end.point, laid.task.of_priors(end.theta), len(end.theta)
    H_0, g_0 = np.asarray(prior.hessian) * np.outer(slope, slope), np.asarray(prior.gradient) * slope
    shows = point.views.seen(p) > 0.0
    groups = [group for group in problem.data.setups if shows[group].any()] or [[*range(len(problem.data.views))]]
    clusters = point.views.together(groups, p).scaled(slope)
    zero, directions = null_directions(clusters.total(p) + H_0)
    regular = ~zero & ~directions.any(0)
    sigma2 = _times_the_noise(spread, found.at_bound) ** 2
    held = any(u.prior is not None for u in problem.unknowns)  # priors that are wrong make residuals too
    if _is_noise_known(problem) and (held or sigma2 <= CLEARLY**2):  # else the errors are by the residuals
        sigma2 = 1.0
    of = (H_0, g_0, found.values, found.at_bound, regular, found.units, sigma2, spread)
    evidence = Evidence(clusters, *of)
    if rounded is not None:
        waves = slope[:, None] * rounded.waves
        waves = np.array([waves[group].sum(0) for group in groups])
        evidence = dataclasses.replace(evidence, waves=waves, shared=rounded.shared, steps=str(rounded.rounding))
    return evidence, groups, (zero, directions)


def _is_noise_known(problem: FitProblem) -> bool:
    """Whether the errors follow from a noise that is stated."""
    return problem.data.noise_known and problem.model.likelihood.loss == "squares"


def _held_by_priors(laid: LaidOut, everything: Matrix, slope: Vector) -> Float[np.ndarray, "m p"]:
    """Return the directions of several unknowns along which no pixel changes, and which their priors hold."""
    priors = laid.task.priors
    if not len(priors.index):
        return np.zeros((0, len(slope)))
    without = np.array(everything)
    index = np.asarray(priors.index)
    without[index, index] -= (np.asarray(priors.weight) * slope[index]) ** 2
    return null_directions(without)[1]


def _not_converged(end: Minimum) -> Iterator[Note]:
    """Say that the solver gave up."""
    if end.message:
        text = f"the fit did not converge in {end.steps} steps: {end.message}. Fix or bound an unknown."
        yield Note(text, "not converged")


def _clusters_in_words(groups: Sequence[Sequence[int]], counts: Counts) -> str:
    """Name the clusters of a fit: views, or setups (a camera with a set of lights) with several views."""
    views = count(counts.views, "view")
    return views if len(groups) == counts.views else f"{views} in {count(len(groups), 'setup')}"


def _scales(scene: Scene, unknowns: Sequence[Unknown], curvature: np.ndarray, squares: float) -> np.ndarray:
    """Return the size with which each value is compared; 0 if there is none.

    For a reflection this is the largest one of its object; for an attenuation, the value that changes the image by a
    sixth; for a transmission, 1; for a coordinate, the size of the objects, since the origin is arbitrary.
    """
    extent = max(item.surface.extent() for item in scene.objects)
    reflections = {
        place: float(np.max(value))
        for place, value, spec in everything(scene, ())
        if np.size(value) and parameter_of(spec).role == "reflection"
    }
    scales = np.zeros(len(unknowns))
    for j, unknown in enumerate(unknowns):
        role = unknown.parameter.role
        if role == "reflection" and unknown.places:
            holder = unknown.places[0].holder
            scales[j] = max(value for place, value in reflections.items() if place.holder == holder)
        elif role == "attenuation" and curvature[j] > 0:
            scales[j] = np.sqrt(squares / curvature[j]) / 6.0
        elif role == "transmission":
            scales[j] = 1.0
        elif role == "position":
            scales[j] = extent
    return scales


def _jumps(scene: Scene, unknowns: Sequence[Unknown]) -> Iterator[Note]:
    """Name the unknowns that move hard squares over the pixels: these jump, and have no derivative."""
    hard = [p for item in scene.objects for p in item.material.patterns if isinstance(p, Chequer) and not p.smooth]
    movers = {u.quantity: None for u in unknowns for place in u.places if _moves_points(place)}
    if hard and movers:
        names = listing(list(movers))
        text = f"changing {names} makes hard squares of a Chequer jump; no derivative shows that. Give it smooth=True."
        yield Note(text, "hard edge", tuple(movers))


def _moves_points(place: Place) -> bool:
    return place.part == "surface" or place.field in ("eta", "period", "u", "v")


def _what_counts(counts: Counts) -> Iterator[Note]:
    """Say which views and pixels do not count, and how clipped samples do."""
    yield from _repeated(counts.repeats)
    yield from _clipped(counts)
    yield from _mixed(counts)
    yield from _beyond_memory(counts)


def _repeated(pairs: Sequence[tuple[int, int]]) -> Iterator[Note]:
    """Name the views that repeat an earlier one."""
    for i, j in pairs[:1]:
        text = f"views[{i}] repeats views[{j}] and is not counted again."
        if (n := len(pairs)) > 1:
            text = f"{n} views repeat earlier ones, as views[{i}] repeats views[{j}], and are not counted again."
        yield Note(text, "repeated views", tuple(f"views[{i}]" for i, _ in pairs))


def _clipped(counts: Counts) -> Iterator[Note]:
    """Say how samples at an end of the sensor's range were used."""
    if counts.left_out:
        text = f"the fit excludes {count(counts.left_out, 'clipped sample')} and the other channels of their pixels."
        yield Note(text, "clipped")
    elif counts.clipped:
        text = f"the fit uses {count(counts.clipped, 'clipped sample')} as limits: the true value is there or beyond."
        yield Note(text, "clipped")


def _mixed(counts: Counts) -> Iterator[Note]:
    """Say that pixels along edges were left out."""
    if counts.mixed:
        text = (
            f"the fit leaves out {count(counts.mixed, 'pixel')} along edges, in which the photographs mix what is on "
            "both sides, as cameras do, and renderers that take several rays a pixel."
        )
        yield Note(text, "edges")


def _beyond_memory(counts: Counts) -> Iterator[Note]:
    """Say that pixels were left out to save memory, and what that costs."""
    if counts.beyond_memory:
        every = counts.pixels + counts.beyond_memory
        times = np.sqrt(every / counts.pixels)
        text = (
            f"the fit uses {counts.pixels:,} of {every:,} pixels, evenly spread, since memory holds no more: errors "
            f"are up to {times:.2g} times those of all pixels. Give {times**2:.2g} times the memory for all."
        )
        yield Note(text, "memory")


def _stated_noise(
    problem: FitProblem, spread: Float[np.ndarray, "5"], at_bound: Bool[np.ndarray, " p"], sigma2: float
) -> Iterator[Note]:
    """Say where the residuals contradict a noise that is stated."""
    if _is_noise_known(problem):
        freedom = max(float(spread[0]) - np.sum(~at_bound), 1.0)
        yield from _noise_contradicted(_times_the_noise(spread, at_bound), freedom, sigma2)


def _noise_contradicted(times: float, freedom: float, sigma2: float) -> Iterator[Note]:
    """Say that the residuals are clearly larger than the given noise, or smaller, as chance does not make them.

    Of pictures without noise nothing is said: theirs may stand for that of photographs to come.
    """
    if times > CLEARLY:
        followed = "the residuals" if sigma2 > 1.0 else "the given noise, and are too small if it is larger"
        wrong = f"the noise is larger, or the model, a prior or the minimum is wrong. The errors follow from {followed}"
        yield Note(f"the residuals are {times:.3g} times the given noise: {wrong}.", "beyond noise")
    elif NEGLIGIBLE < times < 1.0 / CLEARLY and 1.0 - times > OUTLIER / np.sqrt(2.0 * freedom):
        wrong = "it is stated too large, and so are the errors. Give View.noise as it is, or leave it to the fit"
        yield Note(f"the residuals are {times:.3g} times the given noise: {wrong}.", "below noise")


def _times_the_noise(spread: Float[np.ndarray, "5"], at_bound: Bool[np.ndarray, " p"]) -> float:
    """Return how large the residuals are, in units of the noise by which they are weighted."""
    return float(np.sqrt(variance(spread, int(np.sum(~at_bound)))))


def _at_bounds(unknowns: Sequence[Unknown], known: Bool[np.ndarray, " p"], found: _Values) -> Iterator[Note]:
    """Say which values are at a bound."""
    for side, there in (("lower", found.at_lower), ("upper", found.at_bound & ~found.at_lower)):
        bound = np.array([getattr(u, side) for u in unknowns])
        for value in np.unique(bound[there & known]):
            names = [u.name for u, at in zip(unknowns, there & known & (bound == value), strict=True) if at]
            verb = "is at its" if len(names) == 1 else "are at their"
            yield Note(f"{listing(names)} {verb} {side} bound {value:g}.", "at bound", tuple(names))


def _too_bright(unknowns: Sequence[Unknown], values: np.ndarray, known: np.ndarray) -> Iterator[Note]:
    """Say where more light leaves than a surface can reflect."""
    bright = [
        u.name for u, above in zip(unknowns, known & (values > 1.0), strict=True) if above and u.kind in ("k_a", "k_d")
    ]
    if bright:
        verb = "is" if len(bright) == 1 else "are"
        text = f"{listing(bright)} {verb} above 1: more light leaves than arrives. Check the lights and exposure."
        yield Note(text, "above 1", tuple(bright))
