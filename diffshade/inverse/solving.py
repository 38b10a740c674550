"""Solving: a problem to its minimum, and what verdicts and diagnoses begin with afterwards."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from ..core.progress import ReportProgress, silent
from .laid_out import LaidOut, lay_out
from .problem import PART, FitProblem
from .solve.light_search import at_better_places
from .solve.solvers import Minimum
from .starting import Start, find_start, needs_part
from .unknowns.visibility import places_apart

ELSEWHERE = 4  # times that lights whose views cost much more than others' are tried at other places


def solve(
    problem: FitProblem,
    *,
    from_scene: bool = False,
    devices: Sequence[Any] = (),
    report_progress: ReportProgress = silent,
) -> tuple[LaidOut, Minimum, Start]:
    """Return a problem laid out, its minimum, and the start. In float64.

    Args:
        problem: What is to be fitted.
        from_scene: Whether to begin at the scene's values in place of a search.
        devices: Those that the pixels are spread over; none is the default device, with a thread for each core.
        report_progress: Reports progress.
    """
    size, all_of_them = problem.size_for(PART), problem.data.counts.pixels <= PART
    parts = problem.pieces(PART, size)
    part = problem.lay_out(parts, size) if all_of_them or needs_part(problem, from_scene=from_scene) else []
    start = find_start(problem, parts, part, from_scene=from_scene, report_progress=report_progress)
    settled = problem.with_scale(start.sigma, problem.loss).with_rounding(start.rounding)
    squares = start.squares * max(problem.data.counts.pixels / PART, 1.0)
    if all_of_them:
        laid = LaidOut(settled, start.theta, squares, parts, settled.reweigh(start.theta, part))
    else:
        laid = lay_out(settled, start.theta, squares)
    if devices:
        spread = [jax.device_put(chunk, devices[k % len(devices)]) for k, chunk in enumerate(laid.chunks)]
        laid = dataclasses.replace(laid, chunks=spread)
    end = laid.minimise(damping=start.damping, report_progress=report_progress)
    return laid, _with_lights_elsewhere(laid, end, report_progress), start


def _with_lights_elsewhere(laid: LaidOut, end: Minimum, report_progress: ReportProgress) -> Minimum:
    """Return the minimum, or a lower one that is reached from better places of the lights."""
    problem = laid.problem
    lights = places_apart(problem.unknowns, problem.box.arrow)
    if not lights:
        return end
    samples = np.array([s.count for s in problem.data.samples], float)
    for _ in range(ELSEWHERE):
        report_progress("trying lights at other places")
        theta = at_better_places(end.point, samples, lights, problem.unknowns, problem.scene, laid.task, laid.chunks)
        if theta is None:
            break
        again = laid.minimise(theta=theta, report_progress=report_progress)
        if not again.point.total.cost < end.point.total.cost:
            break
        end = again
    return end
