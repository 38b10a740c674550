"""Laid out: a problem with its pixels in blocks, weighed by their noise, ready to be minimised."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import equinox as eqx
import numpy as np

from ..core.progress import ReportProgress, silent
from ..core.thresholds import MAX_STEPS
from .data.view_sets import Masks
from .forward.interface import AbstractForwardModel
from .pixels.blocks import Block, Piece
from .pixels.blocks import chunks as in_chunks
from .problem import FitProblem, Theta
from .solve.solvers import FAR, Minimum, Task, minimise


@dataclass(frozen=True, eq=False)
class LaidOut:
    """A problem with its pixels, or an even part of them, in chunks of blocks. To be used in float64."""

    problem: FitProblem
    theta: Theta
    """Where the samples are weighed by their noise, and where a minimisation begins."""
    squares: float
    """Weighted sum of squares of the images, with which costs are compared."""
    parts: list[Piece]
    chunks: list[Block]

    @property
    def model(self) -> AbstractForwardModel:
        """The model that predicts the samples."""
        return self.problem.model

    @cached_property
    def task(self) -> Task:
        """What is to be minimised."""
        return self.problem.task(self.squares)

    @property
    def pixels(self) -> int:
        """How many pixels are laid out."""
        return sum(len(part.pixels) for part in self.parts)

    @property
    def size(self) -> int:
        """Pixels of a block."""
        return self.chunks[0].observed.target.shape[-1]

    def minimise(
        self,
        held: Mapping[int, float] | None = None,
        theta: Theta | None = None,
        chunks: Sequence[Block] | None = None,
        *,
        rtol: float = 1e-16,
        damping: float = FAR,
        report_progress: ReportProgress = silent,
    ) -> Minimum:
        """Return the minimum; all numbers are in the solver's coordinates.

        Args:
            held: Unknowns, and the values at which they are held.
            theta: Where to begin, by default where the problem was laid out.
            chunks: Other chunks of the same problem.
            rtol: The decrease, relative to the cost, below which the solver stops.
            damping: That of the first step.
            report_progress: Reports progress.
        """
        theta, task = self.theta if theta is None else theta, self.task
        if held:
            lower, upper = (np.array(bound) for bound in (self.problem.box.lower, self.problem.box.upper))
            lower[list(held)] = upper[list(held)] = list(held.values())
            theta = np.clip(theta, lower, upper)
            box = dataclasses.replace(self.problem.box, lower=lower, upper=upper)
            task = task.within(box)
        return minimise(
            theta,
            task,
            self.chunks if chunks is None else chunks,
            max_steps=MAX_STEPS,
            rtol=rtol,
            damping=damping,
            report_progress=lambda step, cost: report_progress(f"step {step}, cost {cost:.6g}"),
        )

    def without(self, masks: Masks) -> list[Block]:
        """Return the chunks with no weight on the masked pixels: the same programs serve."""
        size = self.size

        def weigh(chunk: Block, parts: Sequence[Piece]) -> Block:
            kept = np.ones((len(chunk.view), 1, size))
            for b, part in enumerate(parts):
                if (mask := masks[part.view]) is not None:
                    kept[b, 0, : len(part.pixels)] = ~mask.reshape(-1)[part.pixels]
            return eqx.tree_at(lambda c: c.observed.weight, chunk, chunk.observed.weight * kept)

        return [weigh(*of) for of in zip(self.chunks, in_chunks(self.parts), strict=True)]


def lay_out(problem: FitProblem, theta: Theta, squares: float, at_most: int | None = None) -> LaidOut:
    """Return a problem with its pixels laid out, or with so many at most, evenly spread, weighed at theta."""
    size = problem.size_for(at_most)
    parts = problem.pieces(at_most, size)
    return LaidOut(problem, theta, squares, parts, problem.reweigh(theta, problem.lay_out(parts, size)))
