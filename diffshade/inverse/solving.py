"""Solving: from a problem to its minimum: a start is searched for on a part of the pixels, then all of them count."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np

from ..core.progress import ReportProgress, silent
from ..core.robust_scale import robust_scale
from ..core.thresholds import MAX_STEPS, ROUNDING
from ..model.scenes import Scene
from .data.view_sets import ViewSet
from .forward.losses import NOT_CONVEX
from .forward.rendered import prepare
from .forward.sums import residuals
from .laid_out import LaidOut, lay_out
from .pixels.blocks import Block, shares
from .problem import PART, FitProblem, Theta, fit_problem
from .solve.descent import STALLED
from .solve.interchangeable import by_rising_exponent
from .solve.light_search import at_better_places, from_broad_highlights
from .solve.solvers import FAR, NEAR, STATED, Minimum, Task, minimise
from .solve.start_search import is_local, search, with_wide_edges
from .unknowns.unknown import coordinates, values_at
from .unknowns.visibility import places_apart

REPEATS = 20  # of the alternation between the scale and the minimum

ELSEWHERE = 4  # times that lights whose views cost much more than others' are tried at other places


def solve(
    problem: FitProblem,
    *,
    from_scene: bool = False,
    devices: Sequence[Any] = (),
    report_progress: ReportProgress = silent,
) -> tuple[LaidOut, Minimum]:
    """Return a problem laid out, the scale of its residuals settled, and its minimum. In float64.

    Args:
        problem: What is to be fitted.
        from_scene: Whether to begin at the scene's values in place of a search.
        devices: Those that the pixels are spread over; none is the default device, with a thread for each core.
        report_progress: Reports progress.
    """
    part = lay_out_part(problem)
    laid, damping = find_start(part, from_scene=from_scene, report_progress=report_progress)
    if problem.data.counts.pixels > PART:
        laid = lay_out(laid.problem, laid.theta, laid.squares * problem.data.counts.pixels / laid.pixels)
    if devices:
        spread = [jax.device_put(chunk, devices[k % len(devices)]) for k, chunk in enumerate(laid.chunks)]
        laid = dataclasses.replace(laid, chunks=spread)
    end = laid.minimise(damping=damping, report_progress=report_progress)
    return laid, _with_lights_elsewhere(laid, end, report_progress)


def solve_again(problem: FitProblem, scene: Scene, data: ViewSet, theta: Theta) -> tuple[LaidOut, Minimum]:
    """Return another scene or other views fitted anew, by a search from these values."""
    values = values_at(theta, problem.unknowns).tolist()
    start = [dataclasses.replace(u, start=v) for u, v in zip(problem.unknowns, values, strict=True)]
    return solve(fit_problem(scene, data, start, problem.loss))


def lay_out_part(problem: FitProblem) -> LaidOut:
    """Return a problem with `PART` of its pixels at most laid out, at the scene's values and weighed by their noise."""
    size = problem.size_for(PART)
    parts = problem.pieces(PART, size)
    chunks = problem.lay_out(parts, size)
    begin = coordinates(np.array([u.start for u in problem.unknowns]), problem.unknowns)
    return LaidOut(problem, begin, problem.sum_of_squares(problem.measured(chunks)), parts, chunks)


def find_start(
    part: LaidOut, *, from_scene: bool = False, report_progress: ReportProgress = silent
) -> tuple[LaidOut, float]:
    """Search on a part of the pixels, and settle their weights and their scale there.

    Args:
        part: The problem with `PART` of its pixels at most laid out, at the scene's values.
        from_scene: Whether to begin there in place of a search.
        report_progress: Reports progress.

    Returns:
        The part where the fit begins; and the damping of the first step, `NEAR` if that is the minimum over the part,
        so that the one over all pixels is near.
    """
    problem, theta, chunks, near = part.problem, part.theta, part.chunks, False
    if not from_scene:
        theta, near = _search(problem, problem.measured(chunks), part.squares, report_progress)
        theta = by_rising_exponent(theta, problem.scene, problem.unknowns)
    if problem.settles:
        problem, chunks, theta, near = _settle(problem, chunks, part.squares, theta)
    start = dataclasses.replace(part, problem=problem, theta=theta, chunks=problem.reweigh(theta, chunks))
    return start, NEAR if near else STATED if from_scene else FAR


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
    end = search(task, coarse, measured, report_progress)
    if lights := places_apart(problem.unknowns, problem.box.arrow):
        if not problem.data.noise_known:  # else priors of a scale of 1 would hold the lights
            task = problem.with_scale(_scale(task, measured, end[1], robust=False), "squares").task(squares)
        end = from_broad_highlights(end[1], lights, task, measured)
    _, theta, ended = end
    return theta, ended and near


def _settle(
    problem: FitProblem, part: list[Block], squares: float, theta: Theta
) -> tuple[FitProblem, list[Block], Theta, bool]:
    """Alternate between the scale of the residuals, their weights and the minimum; then take a loss not convex.

    Returns also whether the last minimum was reached.
    """

    def polished(task: Task, part: list[Block], theta: Theta) -> tuple[Theta, bool]:
        end = minimise(theta, task, part, max_steps=MAX_STEPS, rtol=ROUNDING, stalled=STALLED)
        return end.theta, not end.message

    robust = problem.loss != "squares"
    rms = float(np.sqrt(squares / sum(shares(problem.data.pixels, PART))))
    sigma, near, task = 0.0, False, problem.task(squares)
    for repeat in range(REPEATS):
        part = problem.reweigh(theta, part)
        new = 1.0 if problem.data.noise_known else max(_scale(task, part, theta, robust=robust), 1e-9 * rms)
        problem = problem.with_scale(new, "huber" if robust else "squares")
        task = problem.task(squares)
        theta, near = polished(task, part, theta)
        if abs(new - sigma) <= 0.01 * new and (problem.data.homoscedastic or repeat > 1):
            break
        sigma = new
    if problem.loss in NOT_CONVEX:
        problem = problem.with_scale(float(problem.model.likelihood.sigma), problem.loss)
        theta, near = polished(problem.task(squares), part, theta)
    return problem, part, theta, near


def _scale(task: Task, part: list[Block], theta: Theta, *, robust: bool) -> float:
    """Return the scale of the residuals: by the median of their size, or their root mean square."""
    found = task.on_all_cores(residuals, theta, part)
    r = np.concatenate([np.asarray(r)[np.asarray(counts)] for r, counts, _ in found])
    return robust_scale(r) if robust else float(np.sqrt(np.mean(r**2)))


def _with_lights_elsewhere(laid: LaidOut, end: Minimum, report_progress: ReportProgress) -> Minimum:
    """Return the minimum, or a lower one that is reached from better places of the lights."""
    problem = laid.problem
    lights = places_apart(problem.unknowns, problem.box.arrow)
    if not lights:
        return end
    samples = np.array([s.count for s in problem.data.samples], float)
    for _ in range(ELSEWHERE):
        report_progress("trying lights at other places")
        theta = at_better_places(end.point, samples, lights, laid.task, laid.chunks)
        if theta is None:
            break
        again = laid.minimise(theta=theta, report_progress=report_progress)
        if not again.point.total.cost < end.point.total.cost:
            break
        end = again
    return end
