"""Running: one fit, from the samples to what is known at the minimum, by the same code in memory and by tiles."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..core.progress import ReportProgress, silent
from ..model.scenes import Scene
from ..parallel.checkpoints import Checkpoint
from ..parallel.devices import DeviceGroup
from .data.samples import Counts, Samples, collect_samples
from .data.views import View, channels
from .forward.streams import StreamingReduction
from .laid_out_problem import LaidOutProblem, Start, lay_out_all
from .pixels.blocks import Block
from .pixels.tiles import Tiles
from .problem import PART, FitProblem, fit_problem
from .result import Fit
from .solve.light_search import at_better_places
from .solve.solvers import FAR, Minimum
from .starting import find_start, needs_part
from .summary import summarise
from .unknowns.unknown import Unknown
from .unknowns.visibility import places_apart

ELSEWHERE = 4  # times that lights whose views cost much more than others' are tried at other places


def samples_for(
    scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown], clipped: str, *, forecast: bool = False
) -> tuple[list[Samples], Counts]:
    """Return the samples that a fit of these unknowns looks at, and their counts; see `collect_samples`."""
    moving = moves_surface(unknowns)
    return collect_samples(scene, views, clipped, unknowns=len(unknowns), moving=moving, forecast=forecast)


def moves_surface(unknowns: Sequence[Unknown]) -> bool:
    """Whether a surface is free."""
    return any("surface" in path.split(".") for unknown in unknowns for path, _ in unknown.places)


def solve(
    problem: FitProblem,
    *,
    from_scene: bool = False,
    memory: float | int = np.inf,
    checkpoint: Checkpoint | None = None,
    device_group: DeviceGroup | None = None,
    report_progress: ReportProgress = silent,
) -> tuple[LaidOutProblem, Minimum]:
    """Return a problem laid out, and its minimum. In float64.

    Args:
        problem: What is to be fitted.
        from_scene: Whether to begin at the scene's values in place of a search.
        memory: Bytes that tiles may take laid out.
        checkpoint: Keeps what is found on the way; None keeps it in memory.
        device_group: The devices to sum over, of which one process finds the start for all.
        report_progress: Reports progress.
    """
    part: list[Block] = []
    kept = Checkpoint(None, "") if checkpoint is None else checkpoint

    def begin() -> list[np.ndarray]:
        numbers = Start.zeros(problem)
        if device_group is None or device_group.first:
            size = problem.size_for(PART)
            parts = problem.pieces(PART, size)
            if problem.counts.pixels <= PART or needs_part(problem, from_scene=from_scene):
                part.extend(problem.lay_out(parts, size))
            start = find_start(problem, parts, part, from_scene=from_scene, report_progress=report_progress)
            numbers = start.to_array()
        return [numbers if device_group is None else device_group.from_first(numbers)]

    start = Start.from_array(kept.once("start", begin)[0], len(problem.views))
    laid = lay_out_all(
        problem, start, part, memory=memory, checkpoint=kept, device_group=device_group, report_progress=report_progress
    )
    return laid, _with_lights_elsewhere(laid, laid.minimise(report_progress), report_progress)


def _with_lights_elsewhere(laid: LaidOutProblem, end: Minimum, report_progress: ReportProgress) -> Minimum:
    """Return the minimum, or a lower one that is reached from better places of the lights; not by tiles."""
    problem = laid.problem
    lights = places_apart(problem.unknowns, problem.box.arrow)
    if not lights or isinstance(laid.pixels, StreamingReduction):
        return end
    samples = np.array([n * channels(view) for n, view in zip(problem.pixels, problem.views, strict=True)], float)
    for _ in range(ELSEWHERE):
        report_progress("trying lights at other places")
        theta = at_better_places(end.point, samples, lights, problem.unknowns, problem.scene, laid.task, laid.pixels)
        if theta is None:
            break
        start = dataclasses.replace(laid.start, theta=theta, damping=FAR)
        again = dataclasses.replace(laid, start=start).minimise(report_progress)
        if not again.point.total.cost < end.point.total.cost:
            break
        end = again
    return end


def run(
    scene: Scene,
    views: tuple[View, ...],
    unknowns: Sequence[Unknown],
    samples: Sequence[Samples] | Tiles,
    counts: Counts,
    loss: str,
    clipped: str,
    *,
    from_scene: bool = False,
    memory: float | int = np.inf,
    checkpoint: Checkpoint | None = None,
    device_group: DeviceGroup | None = None,
    report_progress: ReportProgress = silent,
) -> Fit:
    """Find the minimum for these unknowns over these samples, and say what is known there. In float64."""
    problem = fit_problem(scene, views, unknowns, samples, counts, loss, clipped)
    laid, end = solve(
        problem,
        from_scene=from_scene,
        memory=memory,
        checkpoint=checkpoint,
        device_group=device_group,
        report_progress=report_progress,
    )
    return summarise(laid, end)
