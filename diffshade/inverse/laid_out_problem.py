"""Laid-out problem: where a fit begins, and the problem with all of its pixels, weighed, which is minimised."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import jax
import numpy as np
from jaxtyping import Float

from ..core.backend import jit_quickly
from ..core.fields import Array
from ..core.progress import ReportProgress
from ..parallel.checkpoints import Checkpoint
from ..parallel.devices import DeviceGroup
from .data.views import channels
from .forward.gram import Gram
from .forward.layout import lay_plain, lay_weighed
from .forward.rounding import MOST_NOISE, Rounded, Rounding, share_of_waves
from .forward.streams import AllPixels, StreamingReduction, sum_over
from .forward.sums import spread, waves
from .pixels.blocks import Block
from .pixels.tiles import Tiles
from .problem import MAX_STEPS, PART, FitProblem, Theta
from .solve.solvers import Minimum, PriorResiduals, Task, minimise


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

    def to_array(self) -> Float[np.ndarray, " n"]:
        """Return all numbers, for a checkpoint and for other processes."""
        known = self.sigma, self.squares, self.step_variance, self.damping
        return np.array([*self.theta, *known, *np.asarray(self.rounding.step), *np.asarray(self.rounding.srgb)])

    @staticmethod
    def zeros(problem: FitProblem) -> Float[np.ndarray, " n"]:
        """Return zeros of the length of `to_array`, for a process that receives its start from another."""
        return np.zeros(len(problem.unknowns) + 4 + 2 * len(problem.views))

    @staticmethod
    def from_array(numbers: Float[np.ndarray, " n"], views: int) -> Start:
        """Return the start from its array, as made by `to_array`."""
        theta, known, step, srgb = np.split(numbers, np.cumsum([len(numbers) - 4 - 2 * views, 4, views]))
        sigma, squares, step_variance, damping = known.tolist()
        return Start(theta, sigma, squares, Rounding(step, srgb, np.zeros(())), step_variance, damping)


@dataclass(frozen=True, eq=False)
class LaidOutProblem:
    """A problem whose scale is settled, with all of its pixels, weighed. To be used in float64."""

    problem: FitProblem
    start: Start
    pixels: AllPixels
    squares: float
    """Sum of squares of the images, weighted."""

    @cached_property
    def task(self) -> Task:
        """What is to be minimised."""
        return self.problem.task(self.squares)

    def minimise(self, report_progress: ReportProgress) -> Minimum:
        """Return the minimum over all pixels."""
        return minimise(
            self.start.theta,
            self.task,
            self.pixels,
            squares=self.squares,
            max_steps=MAX_STEPS,
            damping=self.start.damping,
            report_progress=lambda step, cost: report_progress(f"step {step}, cost {cost:.6g}"),
        )

    def prior_gram(self, end: Minimum) -> Gram:
        """Return the Gram of the priors and unit vectors at the end."""
        return prior_gram(end.point.theta, self.problem.priors(self.squares))

    def spread(self, end: Minimum) -> Float[np.ndarray, "5"]:
        """Return the sums of `Likelihood.spread` at the end."""
        cost, model = float(end.point.views.cost.sum()), self.problem.model
        if model.projects and cost > 1e-8 * self.squares:  # a smaller cost has lost its digits by cancellation
            sizes = zip(self.problem.pixels, self.problem.views, strict=True)
            count = float(sum(n * channels(view) for n, view in sizes))
            return np.array([count, *[2 * cost] * 2, *[count] * 2])
        return np.asarray(sum_over(self.pixels, spread, end.point.theta, model))

    def rounded(self, end: Minimum, of: Float[np.ndarray, "5"]) -> Rounded | None:
        """Return what rounding adds to the errors, given the spread; None without steps, or where noise hides them."""
        square, variance = float(of[2] / of[0]), self.start.step_variance
        beyond = max(square - variance, 0.0)
        if not self.start.rounding.exists or beyond > 12.0 * MOST_NOISE**2 * variance:
            return None
        rounding = dataclasses.replace(self.start.rounding, noise=np.asarray(np.sqrt(beyond)))
        model = self.problem.with_rounding(rounding).model
        held = variance * share_of_waves(beyond / (12.0 * variance))
        rows = np.asarray(sum_over(self.pixels, waves, end.point.theta, model))
        return Rounded(rounding, rows, min(held / max(square, 1e-300), 1.0))


def lay_out_all(
    problem: FitProblem,
    start: Start,
    part: list[Block],
    *,
    memory: float | int,
    checkpoint: Checkpoint,
    device_group: DeviceGroup | None,
    report_progress: ReportProgress,
) -> LaidOutProblem:
    """Return the problem with the scale and steps of a start, and all of its pixels, with weights at the start.

    Args:
        problem: The problem, with the scale and loss that it was made with.
        start: Where to begin.
        part: Chunks of the pixels on which the start was found. If these are all pixels, they are not laid out again.
        memory: Bytes for tiles that stay laid out; the other tiles are laid out again at each pass.
        checkpoint: Keeps the sums of each pass over tiles.
        device_group: The devices to sum over; None for this process's cores.
        report_progress: Reports progress.
    """
    settled = problem.with_scale(start.sigma, problem.loss).with_rounding(start.rounding)
    squares = start.squares * max(problem.counts.pixels / PART, 1.0)
    if not isinstance(problem.samples, Tiles):
        all_chunks = part if problem.counts.pixels <= PART else settled.chunks()
        return LaidOutProblem(settled, start, settled.reweigh(start.theta, all_chunks), squares)

    def gather(parts: list, length: int | None) -> Block:
        return settled.gather(parts, settled.block_size, length)

    tiles = StreamingReduction(
        problem.samples,
        gather,
        lay_weighed if settled.noise_known else lay_plain,
        settled.block_size,
        weigh_at=None if settled.homoscedastic else start.theta,
        memory=memory,
        checkpoint=checkpoint,
        device_group=device_group,
        report_progress=report_progress,
    )
    return LaidOutProblem(settled, start, tiles, squares)


@jit_quickly
def _prior_gram(theta: Array, priors: PriorResiduals) -> Gram:
    gram = priors.gram(theta)
    return Gram(gram.cost, gram.gradient, gram.hessian.as_matrix())


def prior_gram(theta: Array, priors: PriorResiduals) -> Gram:
    """Return the Gram of the priors and unit vectors, as NumPy arrays."""
    if not (len(priors.index) or len(priors.units)):
        p = len(theta)
        return Gram(np.zeros(()), np.zeros(p), np.zeros((p, p)))
    return jax.tree.map(np.asarray, _prior_gram(theta, priors))
