"""Starting: where a fit begins, the scale of its residuals and the steps of its files, from a part of the pixels."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..core.progress import ReportProgress, silent
from ..core.robust_scale import robust_scale
from ..parallel.threads import on_all_cores
from .data.views import View
from .forward.layout import without_clipped
from .forward.losses import NOT_CONVEX
from .forward.rendered import prepare
from .forward.rounding import Rounding, find_rounding
from .forward.sums import residuals, variance_of_steps
from .pixels.blocks import Block, Piece, total
from .problem import MAX_STEPS, PART, FitProblem, Theta
from .solve.interchangeable import by_rising_exponent
from .solve.light_search import from_broad_highlights
from .solve.solvers import FAR, NEAR, STATED, minimise
from .solve.start_search import is_local, search, with_wide_edges
from .unknowns.unknown import coordinates
from .unknowns.visibility import places_apart

SETTLED = 1e-10  # decrease of the cost that a step promises, relative, below which the scale is no longer followed
STALLED = 1e-8  # ... and that several steps together must keep
REPEATS = 20  # of the alternation between the scale and the minimum


@dataclass(frozen=True, eq=False)
class Start:
    """Where a fit begins, and the scale and steps, all found on a part of the pixels."""

    theta: Theta
    sigma: float
    """The scale of the residuals."""
    squares: float
    """Sum of squares of that part of the images, weighted."""
    rounding: Rounding
    """The steps of the views' files."""
    step_variance: float
    """Mean square of the weighted residuals that rounding alone makes."""
    damping: float
    """Of the first step from theta: `NEAR` if that is the minimum over that part, so that the one over all is near."""


def find_start(
    problem: FitProblem,
    parts: list[Piece],
    part: list[Block],
    *,
    from_scene: bool,
    report_progress: ReportProgress = silent,
) -> Start:
    """Search on a part of the pixels, `PART` of them at most, and settle weights, scale and steps there.

    Args:
        problem: What is to be fitted.
        parts: The pieces of that part, of `problem.size_for(PART)` pixels at most.
        part: Its chunks; empty if nothing is to be searched for and nothing settled (`needs_part`).
        from_scene: Whether to begin at the scene's values in place of a search.
        report_progress: Reports progress.
    """
    values = problem.values(parts)
    measured = on_all_cores(without_clipped, part) if problem.data.counts.clipped else part
    squares = problem.sum_of_squares(measured) if part else problem.squares_of_values(values)
    theta, near = coordinates(np.array([u.start for u in problem.unknowns]), problem.unknowns), False
    if not from_scene:
        theta, near = _search(problem, measured, squares, report_progress)
        theta = by_rising_exponent(theta, problem.scene, problem.unknowns)
    settled = problem
    if problem.settles:
        settled, part, theta, near = _settle(problem, part, squares, theta)
    rounding = find_rounding(values, [_levels(view) for view in problem.data.views])
    step_variance = 0.0
    if rounding.exists:
        model = settled.with_rounding(rounding).model
        chunks = part or problem.lay_out(parts, problem.size_for(PART))
        count, sum_ = total(on_all_cores(lambda chunk: variance_of_steps(model, chunk), chunks))
        step_variance = float(sum_ / max(count, 1.0))
    sigma = float(settled.model.likelihood.sigma)
    damping = NEAR if near else STATED if from_scene else FAR
    steps = jax.tree.map(np.asarray, rounding)
    return Start(theta, sigma, squares, steps, step_variance, damping)


def needs_part(problem: FitProblem, *, from_scene: bool) -> bool:
    """Whether finding the start needs laid-out pixels: for a search, or for a scale to settle."""
    return not from_scene or problem.settles


def _levels(view: View) -> float:
    return 0.0 if view.noise is None else float(view.noise.levels)


def _search(
    problem: FitProblem, measured: list[Block], squares: float, report_progress: ReportProgress
) -> tuple[Theta, bool]:
    """Return the best start, and whether it is the minimum of the problem over these chunks.

    Where a cutoff is unknown, the search is as its spot would be seen with a wider edge.
    """
    near, wide = True, with_wide_edges(problem.scene, problem.unknowns)
    if wide is not problem.scene:
        setting = prepare(wide, problem.data.views, problem.unknowns)
        model = eqx.tree_at(lambda m: m.setting, problem.model, setting)
        problem, near = dataclasses.replace(problem, model=model), False
    if problem.model.setting.blurred:  # a pixel is rendered at many places, so that few of them must do
        measured, near = problem.few(), False
        squares = problem.sum_of_squares(measured)
    coarse, task = problem.few() if is_local(problem.unknowns) else measured, problem.task(squares)
    end = search(problem.unknowns, problem.scene, task, coarse, measured, squares, report_progress)
    if lights := places_apart(problem.unknowns, problem.box.arrow):
        if not problem.data.noise_known:  # else priors of a scale of 1 would hold the lights
            task = problem.with_scale(_scale(problem, measured, end[1], robust=False), "squares").task(squares)
        end = from_broad_highlights(end[1], lights, problem.unknowns, problem.scene, task, measured, squares)
    _, theta, ended = end
    return theta, ended and near


def _settle(
    problem: FitProblem, part: list[Block], squares: float, theta: Theta
) -> tuple[FitProblem, list[Block], Theta, bool]:
    """Alternate between the scale of the residuals, their weights and the minimum; then take a loss not convex.

    Returns also whether the last minimum was reached.
    """

    def polished(problem: FitProblem, part: list[Block], theta: Theta) -> tuple[Theta, bool]:
        task = problem.task(squares)
        end = minimise(theta, task, part, squares=squares, max_steps=MAX_STEPS, rtol=SETTLED, stalled=STALLED)
        return end.theta, not end.message

    robust = problem.loss != "squares"
    rms = float(np.sqrt(squares / min(problem.data.counts.pixels, PART)))
    sigma, near = 0.0, False
    for repeat in range(REPEATS):
        part = problem.reweigh(theta, part)
        new = 1.0 if problem.data.noise_known else max(_scale(problem, part, theta, robust=robust), 1e-9 * rms)
        problem = problem.with_scale(new, "huber" if robust else "squares")
        theta, near = polished(problem, part, theta)
        if abs(new - sigma) <= 0.01 * new and (problem.data.homoscedastic or repeat > 1):
            break
        sigma = new
    if problem.loss in NOT_CONVEX:
        problem = problem.with_scale(float(problem.model.likelihood.sigma), problem.loss)
        theta, near = polished(problem, part, theta)
    return problem, part, theta, near


def _scale(problem: FitProblem, part: list[Block], theta: Theta, *, robust: bool) -> float:
    """Return the scale of the residuals: by the median of their size, or their root mean square."""
    found = on_all_cores(lambda chunk: residuals(jnp.asarray(theta), problem.model, chunk), part)
    r = np.concatenate([np.asarray(r)[np.asarray(counts)] for r, counts in found])
    return robust_scale(r) if robust else float(np.sqrt(np.mean(r**2)))
